"""Seeded noise by which a path leaves unstable states."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from solver.equilibrium.clock import Timed
from solver.equilibrium.linear import SingularMatrix
from solver.equilibrium.newton import largest
from solver.equilibrium.scene import Scene
from solver.paths.point import Point
from solver.physics.loads import Gravity


@dataclass(frozen=True)
class Noise:
    """Seeded noise on the guess of every step (§4.3.3), so that unstable states are left.

    ``amplitude``: largest noise over the largest displacement of the guess; the dissertation takes
    1e-3 … 1e-2. The field is the body's answer to random forces: independent noise on each node
    would strain a thin body more than it bends it. ``scene``: the scene to solve in a step, drawn
    from the given scene and a generator, for noise on densities and other fields; it must have the
    same unknowns. The numbers depend on ``seed`` and the index of the point only.
    """

    amplitude: float
    seed: int
    scene: Callable[[Scene, np.random.Generator], Scene] | None = None

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


def uneven(
    amplitude: float, clock: dict[str, list[float]] | None = None
) -> Callable[[Scene, np.random.Generator], Scene]:
    """For :class:`Noise`: scenes whose cells are by up to ``amplitude`` too heavy or too light.

    Their own density, one number or one per cell, may depend on e. ``clock``: that of the scene's
    :class:`~solver.equilibrium.clock.Timed` terms, if any.
    """

    def drawn(term: Gravity, rng: np.random.Generator):
        factors = 1 + amplitude * rng.uniform(-1, 1, len(term.body.cells))
        rho = term.density
        density = (lambda e: factors * rho(e)) if callable(rho) else factors * rho
        new = Gravity(term.body, density, term.g, name=term.name)
        return new if clock is None else Timed(new, clock)

    def scene(given: Scene, rng: np.random.Generator) -> Scene:
        # A term that keeps time has the name and fields of its own.
        terms = [drawn(t, rng) if t.name == "gravity" else t for t in given.terms]
        return given.with_terms(terms)

    return scene
