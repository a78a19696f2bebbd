"""Seeded noise by which a path leaves unstable states."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from solver.equilibrium.linear import SingularMatrix
from solver.equilibrium.linesearch import largest
from solver.equilibrium.scene import Scene
from solver.given import number, whole
from solver.paths.point import Point


@dataclass(frozen=True)
class Noise:
    """Seeded noise on the guess of every step (§4.3.3), so that unstable states are left.

    ``amplitude``: largest noise over the largest displacement of the guess; the dissertation takes
    1e-3 … 1e-2. The field is the body's answer to random forces: independent noise on each node
    would strain a thin body more than it bends it. ``scene``: the scene to solve in a step, drawn
    from the given scene and a generator, for noise on densities and other fields; it must have the
    same unknowns. The numbers depend on ``seed`` and the index of the point only.

    Raises ValueError for an amplitude that is not positive, and a seed below 0.
    """

    amplitude: float
    seed: int
    scene: Callable[[Scene, np.random.Generator], Scene] | None = None

    def __post_init__(self):
        number("amplitude", self.amplitude, above=0)
        whole("seed", self.seed, 0)

    def draw(self, scene: Scene, point: Point) -> tuple[Scene, np.ndarray]:
        """The scene of the step after ``point`` and a field (size,), largest component 1."""
        rng = np.random.default_rng([self.seed, point.index])
        if self.scene is not None:
            scene = self.scene(scene, rng)
        force = np.zeros(scene.size)
        force[: scene.n_free] = rng.standard_normal(scene.n_free)
        field = np.zeros(scene.size)
        system = scene.system(point.x, point.e)
        answer = force
        if system is not None:
            with suppress(SingularMatrix):
                answer = system.factorise().solve(force)
        n = scene.n_free
        field[:n] = answer[:n] / largest(answer[:n])
        return scene, field
