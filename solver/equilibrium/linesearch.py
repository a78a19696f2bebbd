"""How far to go along a step, and corrections with an old factor after it.

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

import numpy as np

from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene, System


def largest(v: np.ndarray) -> float:
    """max|v|, 0 of nothing."""
    return float(np.abs(v).max()) if v.size else 0.0


@dataclass(frozen=True, eq=False)
class Step:
    """An accepted step to z: the fraction taken, the residual there and its correction."""

    z: np.ndarray
    fraction: float
    residual: np.ndarray
    correction: np.ndarray | None = None


def damped(
    residual: Callable[[np.ndarray], np.ndarray | None],
    solve: Callable[[np.ndarray], np.ndarray],
    z: np.ndarray,
    dz: np.ndarray,
    norm: Callable[[np.ndarray], float],
    longest: float = 1.0,
    trials: int = 20,
    moved: Callable[[np.ndarray, np.ndarray], np.ndarray] = np.add,
) -> Step | Outcome:
    """A fraction of dz that passes the natural monotonicity test ‖A⁻¹R(z + t dz)‖ ≤ (1 − t/4)‖dz‖.

    ``moved``: where a step leads to, see :meth:`solver.equilibrium.scene.Scene.moved`.

    After Deuflhard, Newton Methods for Nonlinear Problems, NLEQ-ERR.
    """
    full, t, admissible = norm(dz), longest, False
    for _ in range(trials):
        if t < 1e-4 * longest:
            break
        trial = moved(z, t * dz)
        R = residual(trial)
        if R is None:
            t /= 2
            continue
        admissible = True
        simplified = -solve(R)
        length = norm(simplified)
        if length <= (1 - t / 4) * full:
            return Step(trial, t, R, simplified)
        curved = norm(simplified - (1 - t) * dz)
        t = min(max(0.5 * full * t * t / curved, 0.1 * t), 0.5 * t) if curved > 0 else t / 2
    return Outcome.NO_PROGRESS if admissible else Outcome.INADMISSIBLE


def downhill(
    scene: Scene, system: System, x: np.ndarray, e: float, dx: np.ndarray, longest: float
) -> Step | Outcome | None:
    """A fraction of dx along which the energy falls (Armijo); None where dx is not downhill.

    On the constraint rows: the energy is completed by the new multipliers times what remains of the
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
    t, admissible = longest, False
    while t > 1e-4 * longest:
        trial = scene.moved(x, t * dx, e)
        there = scene.gradient(trial, e)
        if there is None:
            t /= 2
            continue
        admissible = True
        energy, R = there
        value, new_slope = energy + (1 - t) * lift, slope_of(R, t)
        falls = value <= start + 1e-4 * t * slope
        if falls or (value <= start + noise and abs(new_slope) <= 0.8 * abs(slope)):
            return Step(trial, t, R)
        # Minimum of the parabola through both slopes, or through values where slopes mislead.
        lower = -slope * t * t / (2 * (value - start - slope * t))
        if new_slope > 0:
            lower = min(lower, t * slope / (slope - new_slope))
        t = min(max(lower, 0.1 * t), 0.6 * t)
    return Outcome.NO_PROGRESS if admissible else Outcome.INADMISSIBLE


def chords(
    residual: Callable[[np.ndarray], np.ndarray | None],
    solve: Callable[[np.ndarray], np.ndarray],
    step: Step,
    size: Callable[[np.ndarray], float],
    rtol: float,
    most: int = 4,
    moved: Callable[[np.ndarray, np.ndarray], np.ndarray] = np.add,
) -> tuple[np.ndarray, float]:
    """Corrections with the old factor while they contract fourfold; (z, size of the last one).

    ``size`` inf: the step was shortened, or the old factor has nothing good to say.
    """
    z, correction = step.z, step.correction
    if step.fraction < 1:
        return z, np.inf
    if correction is None:
        correction = -solve(step.residual)
    now = size(correction)
    for _ in range(most):
        if now <= rtol:
            return z + correction, now
        ahead = moved(z, correction)
        R = residual(ahead)
        if R is None:
            break
        following = -solve(R)
        then = size(following)
        if then > 0.25 * now:
            break
        z, correction, now = ahead, following, then
    return z, np.inf
