"""Equilibria of an elastic body for the parameters of its contraction, and their derivatives.

At an equilibrium R(x, β) = 0 the force changes by ∂R/∂β = ∫ S'(β) ∂N/∂X at fixed u, exactly
(:meth:`solver.physics.elastic.Elastic.by_growth`); the rest is linear algebra with the tangent of
the last iteration (:mod:`solver.paths.sensitivity`). Backward one transposed solve gives the
derivative of a number by β at every point of the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solver.equilibrium.newton import newton
from solver.equilibrium.scene import Scene, System
from solver.fitting.field import Field, contracted, contracting, gathered, refused, spread
from solver.given import number, numbers
from solver.paths.continuation import load, trace
from solver.paths.sensitivity import Sensitivity
from solver.paths.steppers import LoadSteps
from solver.physics.fields import Unphysical

CORRECTIONS = 12  # iterations from a state nearby; beyond, the path from rest is followed


@dataclass(frozen=True)
class Unreached:
    """Parameters that lead to no state: ``why``, in words, and at which load or time ``at``."""

    why: str
    at: float


@dataclass(frozen=True, eq=False)
class At:
    """An equilibrium at a load e: unknowns x (size,), displacement u (n, 3), its tangent."""

    e: float
    x: np.ndarray
    u: np.ndarray
    system: System
    scene: Scene
    slopes: np.ndarray

    @cached_property
    def _stress(self) -> np.ndarray:
        """How stress at the points changes with β there, (m, q, 3, 3)."""
        term = contracting(self.scene.terms)
        body = self.scene.body
        rate = term.growth.by_beta(self.e, body.weights.shape, body.points)
        return term.by_growth(self.u, self.e, rate)

    @cached_property
    def unknowns(self) -> np.ndarray:
        """dx/dp, (size, k)."""
        force = spread(self.scene.body, self._stress, self.slopes)
        return Sensitivity(self.scene, self.system).rate(force)

    @cached_property
    def rates(self) -> np.ndarray:
        """du/dp, (n, 3, k)."""
        return np.stack([self.scene.step_displacement(dx) for dx in self.unknowns.T], axis=-1)

    def by_beta(self, slope: np.ndarray) -> np.ndarray:
        """dj/dβ at each point (m, q) of a quantity with ∂j/∂u = ``slope`` (n, 3): by one transposed
        solve."""
        back = Sensitivity(self.scene, self.system).adjoint(slope)
        return gathered(self.scene.body, self._stress, back)

    def gradient(self, slope: np.ndarray) -> np.ndarray:
        """dj/dp (k,) of the same."""
        return np.einsum("mq,mqk->k", self.by_beta(slope), self.slopes)


@dataclass(frozen=True, eq=False)
class States:
    """What parameters p (k,) lead to: a state for each load that was asked for."""

    p: np.ndarray
    at: tuple[At, ...]


class Equilibria:
    """States of a body at loads, for the parameters of its β.

    ``scene``: one Elastic term of it grows by Apical(g, beta); β is taken from ``field`` instead.
    ``rtol``: Newton's. ``step``: largest step of the load on the way from rest.

    Raises ValueError for a scene without such a term.
    """

    def __init__(self, scene: Scene, field: Field, *, rtol: float = 1e-10, step: float = 0.25):
        self._term = contracting(scene.terms)
        self.scene, self.field = scene, field
        self.rtol, self.step = number("rtol", rtol, above=0), number("step", step, above=0)
        self.points = scene.body.points()

    def solve(
        self, p: np.ndarray, at: Sequence[float], near: States | None = None
    ) -> States | Unreached:
        """The stable states at the loads ``at`` (increasing, > 0) for parameters p (k,).

        From rest along the path of the load, or from the states ``near`` of other parameters by
        their derivatives where that comes to a stable state at once (which may be on another
        branch: :func:`solver.fitting.fit.fit` follows the path from rest once more in the end).
        """
        p, loads = numbers("parameters", p), increasing("loads", at)
        beta = self.field.values(p, self.points)
        if why := refused(beta):
            return Unreached(why, 0.0)
        scene = contracted(self.scene, self._term, beta)
        found = None if near is None else self._beside(scene, p, loads, near)
        if found is None:
            found = self._from_rest(scene, loads)
        if isinstance(found, Unreached):
            return found
        slopes = self.field.slopes(p, self.points)
        return States(p, tuple(_state(scene, x, e, slopes) for x, e in found))

    def _beside(self, scene, p, loads, near) -> list | None:
        if [state.e for state in near.at] != loads:
            return None
        found = []
        for state in near.at:
            guess = state.x + state.unknowns @ (p - near.p)
            result = newton(
                scene, guess, state.e, rtol=self.rtol, max_iterations=CORRECTIONS, unstable=0
            )
            if not result.converged or result.system.unstable:
                return None
            found.append((result.x, state.e))
        return found

    def _from_rest(self, scene, loads) -> list | Unreached:
        found, start = [], np.zeros(scene.size)
        stepper = LoadSteps(self.rtol, self.step)
        try:
            for e in loads:
                path = trace(scene, start, stepper, until=load(e), max_steps=500)
                start = path.points[-1] if path.points else start
                if not path.reached:
                    return Unreached(path.reason, start.e if path.points else 0.0)
                if start.unstable:
                    return Unreached("the path from rest is not stable there", e)
                found.append((start.x, e))
        except Unphysical as error:
            return Unreached(str(error), e)
        return found


def _state(scene: Scene, x: np.ndarray, e: float, slopes: np.ndarray) -> At:
    return At(e, x, scene.displacement(x, e), scene.system(x, e), scene, slopes)


def increasing(name: str, values: Sequence[float]) -> list[float]:
    """Numbers > 0, each larger than the one before; ValueError else."""
    given = np.atleast_1d(numbers(name, values))
    if given.ndim != 1 or not len(given) or not (np.diff([0.0, *given]) > 0).all():
        raise ValueError(f"{name} {values!r:.60}; expected increasing numbers > 0")
    return given.tolist()
