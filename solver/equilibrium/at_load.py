"""R(x) = 0 at one load, as Newton's method asks for it: with steps that a line search shortens, and
for thin bodies with steps that mind how stresses grow."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from solver.equilibrium.barriers import around
from solver.equilibrium.linear import SingularMatrix
from solver.equilibrium.linesearch import Step, damped, downhill, largest
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene, System

# Of mixed steps: corrections, in tolerances, below which a state's own tangent does; steps after
# which the tangent has to be free of unstable modes; halvings of one that is not admissible.
CLOSE, UNSTABLE, HALVED = 100.0, 4, 8


class Linear(NamedTuple):
    """F(z) and the system of its stiffness; ``solver`` gives A⁻¹ or raises SingularMatrix;
    ``linear_residual`` of a dz: see :meth:`solver.equilibrium.scene.System.linear_residual`."""

    residual: np.ndarray
    system: System
    solver: Callable[[], Callable[[np.ndarray], np.ndarray]]
    linear_residual: Callable[[np.ndarray], tuple[np.ndarray, float]]


class AtLoad:
    """R(x) = 0 at one load; where there is an energy it may guide the steps."""

    def __init__(self, scene: Scene, e: float, unstable: int | None):
        self.scene, self._e, self._unstable = scene, e, unstable

    def state(self, z):
        return z, self._e

    def linearise(self, z):
        return self._linear(z)

    def _linear(self, z, stresses=None):
        system = self.scene.system(z, self._e, stresses)
        if system is None:
            return None
        return Linear(
            system.residual, system, lambda: system.factorise().solve, system.linear_residual
        )

    def residual(self, z):
        return self.scene.residual(z, self._e)

    def size(self, dz):
        return largest(dz[: self.scene.n_free]) / self.scene.scales.length

    def norm(self, dz):
        return float(np.linalg.norm(dz[: self.scene.n_free]))

    def longest_step(self, z, dz):
        return self.scene.longest_step(z, dz, self._e)

    def moved(self, z, dz):
        return self.scene.moved(z, dz, self._e)

    def step(self, system, solve, z, dz, longest):
        # Without a count the slope alone says whether the step goes downhill.
        count, step = None if system.energy is None else system.unstable, None
        guided = count in (0, None) if self._unstable is None else self._unstable == 0
        if system.energy is not None and guided:
            if count != 0:
                step = damped(
                    self.residual, solve, z, dz, self.norm, longest, trials=1, moved=self.moved
                )
                step = step if isinstance(step, Step) else None
            if step is None:
                step = downhill(self.scene, system, z, self._e, dz, longest)
            if step is None and self._unstable == 0 and count != 0:
                step = downhill(self.scene, system, z, self._e, -dz, longest)
        if step is None:
            step = damped(self.residual, solve, z, dz, self.norm, longest, moved=self.moved)
        return step


class Mixed(AtLoad):
    """The same, for thin bodies: stresses are guessed as well as displacements.

    A step of a thin body bends it, and what its displacements do to second order strains it: far
    from the solution membrane stresses of that strain fill the tangent, and a line search leaves
    next to nothing of each step. With stresses as unknowns of their own, which a step changes in
    proportion to it, the tangent between is that of a body under those stresses; the residual stays
    what it is, and so does the solution. A few full steps then lead as far as hundreds of short
    ones. After Magisano, Leonetti and Garcea, How to improve efficiency and robustness of the
    Newton method in geometrically non-linear structural problem discretized via displacement-based
    finite elements, CMAME 313 (2017): there in every integration point, eliminated at once.

    No measure shortens steps; what doesn't come near a solution soon is given up. ``plain``:
    whether the last tangent was the state's own.
    """

    def __init__(self, scene: Scene, e: float, rtol: float):
        super().__init__(scene, e, 0)
        self._close = CLOSE * rtol
        self._stresses, self._where, self._steps = None, None, 0
        self.plain = True

    def linearise(self, z):
        # Chords move on from where the stresses belong to.
        self.plain = z is not self._where
        linear = self._linear(z, None if self.plain else self._stresses)
        convex = None
        if self.plain and linear is not None:
            convex = self.scene.convex(z, self._e)
        if convex is None:
            return linear
        with suppress(SingularMatrix):
            self.plain = linear.system.unstable == 0
        return linear if self.plain else self._linear(z, convex)

    def step(self, system, solve, z, dz, longest):
        self._steps += 1
        correction = self.size(dz)
        if self._steps > UNSTABLE and system.unstable:
            return Outcome.NO_PROGRESS
        if longest < 1 and system.unstable == 0:
            dz = around(self.scene, solve, z, dz, self._e)
            longest = self.longest_step(z, dz)
        if self.size(longest * dz) > 1:
            return Outcome.NO_PROGRESS
        for halved in range(HALVED):
            fraction = longest * 0.5**halved
            there = self.moved(z, fraction * dz)
            residual = self.residual(there)
            if residual is None and self.scene.sections is not None:
                # What a barrier admits of a straight step it may not of one that turns.
                there = z + fraction * dz
                residual = self.residual(there)
            if residual is not None:
                break
        else:
            return Outcome.INADMISSIBLE
        self._where = None
        if correction > self._close:
            self._where = there
            self._stresses = self.scene.extrapolated(z, fraction * dz, self._e)
        return Step(there, fraction, residual)
