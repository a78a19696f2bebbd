"""Newton's method at one load, to an equilibrium nearby, stable or not.

Algorithm 1 with safeguards. Sizes are ratios: a correction is judged by max|Δu| / length, because
in a thin structure a residual in units of force says little: membrane forces drown bending.

How a step is chosen and shortened: :mod:`solver.equilibrium.at_load` and
:mod:`solver.equilibrium.linesearch`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from solver.equilibrium.at_load import AtLoad, Linear, Mixed
from solver.equilibrium.linear import SingularMatrix
from solver.equilibrium.linesearch import Step, chords, largest
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene, System
from solver.given import number, numbers

MIXED = 12  # iterations that guess stresses, too


@dataclass(frozen=True, eq=False)
class NewtonResult:
    """The last iterate, converged or not.

    ``iterations``: factorisations; ``correction``: the last one, max|Δu| / length; ``residual``:
    largest entry of the last residual over the scene's force; ``system``: the one that gave the
    last correction, its factor alive; with ``fresh`` it lies within rtol of ``x``.
    """

    x: np.ndarray
    e: float
    outcome: Outcome
    iterations: int
    correction: float
    residual: float
    system: System | None

    @property
    def converged(self) -> bool:
        """Whether the tolerance was met."""
        return self.outcome is Outcome.CONVERGED

    @property
    def z(self) -> np.ndarray:
        """(x, e) as one vector, (size + 1,)."""
        return np.append(self.x, self.e)


def newton(
    scene: Scene,
    x: np.ndarray,
    e: float,
    *,
    rtol: float,
    max_iterations: int = 30,
    unstable: int | None = None,
    fresh: bool = True,
) -> NewtonResult:
    """Equilibrium at the load ``e`` from the guess ``x`` (size,); Algorithm 1 with safeguards.

    ``rtol``: largest correction, max|Δu| / length, that counts as converged. It may be a saddle
    point of the energy; :func:`solver.equilibrium.descent.descend` goes to stable equilibria only.
    ``unstable``: modes that the equilibrium is expected to have. With 0 the energy also guides
    iterates whose tangent is indefinite and whose full step isn't good, as on the way to a stable
    state of a thin body; a saddle close by is still found. With others it doesn't guide at all.
    Before that stresses are guessed beside displacements
    (:class:`solver.equilibrium.at_load.Mixed`), which in thin bodies leads farther in fewer steps.
    ``fresh``: factorise once more where only chords met the tolerance, so that the factor belongs
    to the result; a path needs it for stability and tangent.

    Raises ValueError for a tolerance ≤ 0 and for a guess of the wrong shape.
    """
    x, e = checked(scene, x, rtol), number("e", e)
    spent = 0
    if unstable == 0 and any(hasattr(term, "extrapolated") for term in scene.terms):
        mixed = Mixed(scene, e, rtol)
        most = min(max_iterations, MIXED)
        result = iterate(mixed, x, rtol=rtol, max_iterations=most, fresh=fresh)
        spent = result.iterations
        more = min(max_iterations - spent, MIXED)
        if result.outcome is Outcome.NOT_CONVERGED and more and scene.convex(result.x, e):
            # Contact takes its time to find out what touches.
            result = iterate(mixed, result.x, rtol=rtol, max_iterations=more, fresh=fresh)
            spent += result.iterations
            result = replace(result, iterations=spent)
        if result.converged and not mixed.plain:
            # What is stable, and where a path goes on to, is told by the state's own stiffness.
            return replace(result, system=scene.system(result.x, e))
        # A line search comes no nearer in a slender body; a shorter step of the load does.
        if result.converged or scene.sections is not None or spent >= max_iterations:
            return result
    plain = AtLoad(scene, e, unstable)
    result = iterate(plain, x, rtol=rtol, max_iterations=max_iterations - spent, fresh=fresh)
    return replace(result, iterations=result.iterations + spent)


class Equations(Protocol):
    """F(z) = 0, as :func:`iterate` asks for it.

    ``state``: the unknowns and the load in z. ``linearise`` and ``residual``: None where the state
    is not admissible. ``size``: of a correction, as a ratio to be compared with rtol; ``norm``: its
    Euclidean length, by which steps are compared. ``moved``: where a step dz leads to from z.
    ``step``: how far to go along dz, ``longest`` of it at most.
    """

    scene: Scene

    def state(self, z: np.ndarray) -> tuple[np.ndarray, float]: ...

    def linearise(self, z: np.ndarray) -> Linear | None: ...

    def residual(self, z: np.ndarray) -> np.ndarray | None: ...

    def size(self, dz: np.ndarray) -> float: ...

    def norm(self, dz: np.ndarray) -> float: ...

    def longest_step(self, z: np.ndarray, dz: np.ndarray) -> float: ...

    def moved(self, z: np.ndarray, dz: np.ndarray) -> np.ndarray: ...

    def step(self, system: System, solve, z, dz, longest: float) -> Step | Outcome: ...


def iterate(
    equations: Equations, z: np.ndarray, *, rtol: float, max_iterations: int, fresh: bool = True
) -> NewtonResult:
    """Damped Newton's method with chords from the guess z; see :func:`newton` for the options."""
    watch, correction, ratio = Stagnation(rtol), np.inf, np.inf
    system = dz = None

    def ended(outcome, iterations, z, solved=None):
        if solved is not None and roundoff(linear.linear_residual, solve, solved, equations.size):
            outcome = Outcome.ILL_CONDITIONED
        x, e = equations.state(z)
        return NewtonResult(x, e, outcome, iterations, correction, ratio, system)

    for k in range(1, max_iterations + 1):
        linear = equations.linearise(z)
        if linear is None:
            system = None
            return ended(Outcome.INADMISSIBLE, k - 1, z)
        system = linear.system
        ratio = largest(system.residual) / equations.scene.scales.force
        try:
            solve = linear.solver()
            dz = -solve(linear.residual)
        except SingularMatrix:
            dz = np.full_like(z, np.nan)
        correction = equations.size(dz)
        if not np.isfinite(correction):
            correction = np.inf
            return ended(Outcome.SINGULAR, k, z)
        longest = equations.longest_step(z, dz)
        # A barrier may be thinner than the tolerance: what oversteps it is no solution.
        if correction <= rtol and longest >= 1.0:
            return ended(Outcome.CONVERGED, k, z + dz, dz)
        if watch.stuck(correction):
            return ended(Outcome.STAGNATED, k, z, dz)
        step = equations.step(system, solve, z, dz, longest)
        if isinstance(step, Outcome):
            return ended(step, k, z, dz)
        z, last = chords(
            equations.residual, solve, step, equations.size, rtol, moved=equations.moved
        )
        if last <= rtol and not fresh:
            correction = last
            return ended(Outcome.CONVERGED, k, z, dz)
    return ended(Outcome.NOT_CONVERGED, max_iterations, z, dz)


def roundoff(linear_residual: Callable, solve: Callable, dz: np.ndarray, size: Callable) -> bool:
    """Whether a solve gave roundoff: it leaves half of what it had to balance, and refining it once
    changes it. The first alone happens to a sound one where work cancels, as in unstable states.
    """
    over, doubt = linear_residual(dz)
    return doubt > 0.5 and not size(solve(over)) <= 0.1 * size(dz)


def checked(scene: Scene, x: np.ndarray, rtol: float) -> np.ndarray:
    """x as floats; raises ValueError for a wrong shape or a tolerance ≤ 0."""
    x = numbers("the guess", x)
    if x.shape != (scene.size,):
        raise ValueError(
            f"the guess has shape {x.shape}; expected ({scene.size},): Scene.unknowns(u) makes it "
            "from displacements (nodes, 3)"
        )
    if not number("rtol", rtol) > 0:
        raise ValueError(f"rtol = {rtol}; expected a ratio > 0, such as 1e-8")
    return x


class Stagnation:
    """Whether corrections near the tolerance have stopped shrinking: roundoff, not damping."""

    def __init__(self, rtol: float):
        near = max(10 * rtol, min(1e3 * rtol, 1e-5))
        self._near, self._best, self._since = near, np.inf, 0

    def stuck(self, correction: float) -> bool:
        """To be asked once per iteration."""
        if correction < 0.5 * self._best:
            self._best, self._since = correction, 0
        else:
            self._since += 1
        return self._since >= 4 and self._best < self._near
