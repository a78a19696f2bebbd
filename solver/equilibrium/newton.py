"""Newton's method at one load, to an equilibrium nearby, stable or not.

Algorithm 1 with safeguards. Sizes are ratios: a correction is judged by max|Δu| / length, because
in a thin structure a residual in units of force says little: membrane forces drown bending.

A step is shortened until one of two measures is satisfied. With an energy and a tangent without
unstable modes the step goes downhill and the energy has to fall. Elsewhere the simplified
correction, the new residual seen through the old factor, has to be shorter than the step was
(Deuflhard's natural monotonicity test); it doesn't mind indefinite or unsymmetric tangents. Further
corrections with the old factor (chords) follow while they contract well: each costs a residual and
a back-substitution, a small part of a factorisation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from solver.equilibrium.linear import SingularMatrix
from solver.equilibrium.scene import Scene, System


class Outcome(Enum):
    """How an iteration or a path ended; the value is a sentence for people."""

    CONVERGED = "the iteration met its tolerance"
    REACHED = "the path reached its target"
    NOT_CONVERGED = "the iteration did not meet its tolerance in the iterations it was allowed"
    SINGULAR = "the tangent is singular: something can move freely, or this is a critical point"
    INADMISSIBLE = (
        "the state is not admissible (an inverted element, a node beyond a barrier), and a shorter "
        "step does not help"
    )
    STAGNATED = (
        "the corrections stopped shrinking above the tolerance: roundoff; ask for a looser rtol"
    )
    NO_PROGRESS = "no step along the correction, however short, came nearer to equilibrium"
    NO_STABLE_STATE = "the energy fell without coming to rest in a stable equilibrium"
    NO_START = "there is no equilibrium near the start at its load; the path has no points"
    MIN_STEP = "the step fell below its minimum; the path stops at the last converged point"
    MAX_STEPS = "the steps allowed were used up; the path stops at the last converged point"
    OUT_OF_BOUNDS = "the load left its bounds; the path stops at the last point within them"
    DISSIPATION = (
        "the dashpots gave energy instead of taking it, and a shorter step does not help; the path "
        "stops at the last state before"
    )
    NO_BRANCH = "no second branch was found along the critical vector"


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
    ``fresh``: factorise once more where only chords met the tolerance, so that the factor belongs
    to the result; a path needs it for stability and tangent.

    Raises ValueError for a tolerance ≤ 0 and for a guess of the wrong shape.
    """
    x = checked(scene, x, rtol)
    n, length = scene.n_free, scene.scales.length

    def size(dx):
        return largest(dx[:n]) / length

    def norm(dx):
        return float(np.linalg.norm(dx[:n]))

    def residual(z):
        return scene.residual(z, e)

    watch, correction, ratio = Stagnation(rtol), np.inf, np.inf
    system = None
    for k in range(1, max_iterations + 1):
        system = scene.system(x, e)
        if system is None:
            return NewtonResult(x, e, Outcome.INADMISSIBLE, k - 1, correction, ratio, None)
        ratio = largest(system.residual) / scene.scales.force
        try:
            solve = system.factorise().solve
            dx = -solve(system.residual)
        except SingularMatrix:
            dx = np.full_like(x, np.nan)
        correction = size(dx)
        if not np.isfinite(correction):
            return NewtonResult(x, e, Outcome.SINGULAR, k, np.inf, ratio, system)
        share = scene.longest_step(x, dx, e)
        # A barrier may be thinner than the tolerance: what oversteps it is no solution.
        if correction <= rtol and share >= 1.0:
            return NewtonResult(x + dx, e, Outcome.CONVERGED, k, correction, ratio, system)
        if watch.stuck(correction):
            return NewtonResult(x, e, Outcome.STAGNATED, k, correction, ratio, system)
        step = None
        # Without a count the slope alone says whether the step goes downhill.
        count = system.unstable
        guided = count in (0, None) if unstable is None else unstable == 0
        if system.energy is not None and guided:
            if count != 0:
                step = damped(residual, solve, x, dx, norm, share, trials=1)
                step = step if isinstance(step, Step) else None
            if step is None:
                step = downhill(scene, system, x, e, dx, share)
            if step is None and unstable == 0 and count != 0:
                step = downhill(scene, system, x, e, -dx, share)
        if step is None:
            step = damped(residual, solve, x, dx, norm, share)
        if isinstance(step, Outcome):
            return NewtonResult(x, e, step, k, correction, ratio, system)
        x, left = chords(residual, solve, step, size, rtol)
        if left <= rtol and not fresh:
            return NewtonResult(x, e, Outcome.CONVERGED, k, left, ratio, system)
    return NewtonResult(x, e, Outcome.NOT_CONVERGED, max_iterations, correction, ratio, system)


def checked(scene: Scene, x: np.ndarray, rtol: float) -> np.ndarray:
    """x as floats; raises ValueError for a wrong shape or a tolerance ≤ 0."""
    x = np.asarray(x, dtype=float)
    if x.shape != (scene.size,):
        raise ValueError(
            f"the guess has shape {x.shape}; expected ({scene.size},): Scene.unknowns(u) makes it "
            "from displacements (nodes, 3)"
        )
    if not rtol > 0:
        raise ValueError(f"rtol = {rtol}; expected a ratio > 0, such as 1e-8")
    return x


def largest(v: np.ndarray) -> float:
    """max|v|, 0 of nothing."""
    return float(np.abs(v).max()) if v.size else 0.0


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


@dataclass(frozen=True, eq=False)
class Step:
    """An accepted step to z: the share taken, the residual there, the correction it calls for."""

    z: np.ndarray
    share: float
    residual: np.ndarray
    left: np.ndarray | None = None


def damped(
    residual: Callable[[np.ndarray], np.ndarray | None],
    solve: Callable[[np.ndarray], np.ndarray],
    z: np.ndarray,
    dz: np.ndarray,
    norm: Callable[[np.ndarray], float],
    share: float = 1.0,
    trials: int = 20,
) -> Step | Outcome:
    """A share of dz that passes the natural monotonicity test ‖A⁻¹R(z + t dz)‖ ≤ (1 − t/4)‖dz‖.

    After Deuflhard, Newton Methods for Nonlinear Problems, NLEQ-ERR.
    """
    full, t, seen = norm(dz), share, False
    for _ in range(trials):
        if t < 1e-4 * share:
            break
        trial = z + t * dz
        R = residual(trial)
        if R is None:
            t /= 2
            continue
        seen = True
        left = -solve(R)
        length = norm(left)
        if length <= (1 - t / 4) * full:
            return Step(trial, t, R, left)
        curved = norm(left - (1 - t) * dz)
        t = min(max(0.5 * full * t * t / curved, 0.1 * t), 0.5 * t) if curved > 0 else t / 2
    return Outcome.NO_PROGRESS if seen else Outcome.INADMISSIBLE


def downhill(
    scene: Scene, system: System, x: np.ndarray, e: float, dx: np.ndarray, share: float
) -> Step | Outcome | None:
    """A share of dx along which the energy falls (Armijo); None where dx is not downhill.

    On the constraint rows: the energy is completed by the new multipliers times what is left of the
    rows' residual, (1 − t) r, so that a guess which violates the rows may have to climb.
    """
    n = scene.n_free
    dq, dm, r = dx[:n], dx[n:], system.residual[n:]
    lift = float((x[n:] + dm) @ r)

    def slope_of(R, t):
        return float(R[:n] @ dq - (1 - t) * (dm @ r))

    start, slope = system.energy + lift, slope_of(system.residual, 0.0)
    if not slope < 0:
        return None
    # ψ near 0 is a difference of numbers near 1: the energy of a thin body is roundoff to ~1e-6,
    # and only the slopes are to be believed (Hager and Zhang 2005, approximate Wolfe).
    # Next to no strain at all it is roundoff of the scene's own energy.
    noise = 1e-6 * (abs(start) + abs(system.energy)) + 1e-15 * scene.scales.energy
    t, seen = share, False
    while t > 1e-4 * share:
        trial = x + t * dx
        found = scene.gradient(trial, e)
        if found is None:
            t /= 2
            continue
        seen = True
        energy, R = found
        value, there = energy + (1 - t) * lift, slope_of(R, t)
        falls = value <= start + 1e-4 * t * slope
        if falls or (value <= start + noise and abs(there) <= 0.8 * abs(slope)):
            return Step(trial, t, R)
        # Minimum of the parabola through both slopes, or through values where slopes mislead.
        lower = -slope * t * t / (2 * (value - start - slope * t))
        if there > 0:
            lower = min(lower, t * slope / (slope - there))
        t = min(max(lower, 0.1 * t), 0.6 * t)
    return Outcome.NO_PROGRESS if seen else Outcome.INADMISSIBLE


def chords(
    residual: Callable[[np.ndarray], np.ndarray | None],
    solve: Callable[[np.ndarray], np.ndarray],
    step: Step,
    size: Callable[[np.ndarray], float],
    rtol: float,
    most: int = 4,
) -> tuple[np.ndarray, float]:
    """Corrections with the old factor while they contract fourfold; (z, size of the last one).

    ``size`` inf: the step was shortened, or the old factor has nothing good to say.
    """
    z, left = step.z, step.left
    if step.share < 1:
        return z, np.inf
    if left is None:
        left = -solve(step.residual)
    now = size(left)
    for _ in range(most):
        if now <= rtol:
            return z + left, now
        R = residual(z + left)
        if R is None:
            break
        after = -solve(R)
        then = size(after)
        if then > 0.25 * now:
            break
        z, left, now = z + left, after, then
    return z, np.inf
