"""Newton's method at one load, to an equilibrium nearby, stable or not.

Algorithm 1 with safeguards. Sizes are ratios: a correction is judged by max|Δu| / length, because
in a thin structure a residual in units of force says little: membrane forces drown bending.

A step is shortened until one of two measures is satisfied. With an energy and a tangent without
unstable modes the step goes downhill and the energy has to fall. Elsewhere the simplified
correction, the new residual seen through the old factor, has to be shorter than the step was
(Deuflhard's natural monotonicity test); it doesn't mind indefinite or unsymmetric tangents. Further
corrections with the old factor (chords) follow while they contract well: each costs a residual and
a back-substitution, a small part of a factorisation.

The loop, its steps and what ends it are one algorithm, read together; hence the length.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np

from solver.equilibrium.linear import SingularMatrix
from solver.equilibrium.scene import Scene, System
from solver.given import number, numbers


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
    ILL_CONDITIONED = (
        "the stiffness is singular, or too ill-conditioned for floating-point numbers (a body far "
        "too thin, or far too unlike in its stiffness): what the linear solve gave is roundoff"
    )
    NO_PROGRESS = "no step along the correction, however short, came nearer to equilibrium"
    NO_STABLE_STATE = "the energy fell without coming to rest in a stable equilibrium"
    NO_START = "there is no equilibrium near the start at its load; the path has no points"
    NO_EQUILIBRIUM = "the start, at its target, is no equilibrium of the scene; give x as a guess"
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
    ``fresh``: factorise once more where only chords met the tolerance, so that the factor belongs
    to the result; a path needs it for stability and tangent.

    Raises ValueError for a tolerance ≤ 0 and for a guess of the wrong shape.
    """
    x, e = checked(scene, x, rtol), number("e", e)
    return iterate(
        _AtLoad(scene, e, unstable), x, rtol=rtol, max_iterations=max_iterations, fresh=fresh
    )


class Linear(NamedTuple):
    """F(z) and the system of its stiffness; ``solver`` gives A⁻¹ or raises SingularMatrix;
    ``linear_residual`` of a dz: see :meth:`solver.equilibrium.scene.System.linear_residual`."""

    residual: np.ndarray
    system: System
    solver: Callable[[], Callable[[np.ndarray], np.ndarray]]
    linear_residual: Callable[[np.ndarray], tuple[np.ndarray, float]]


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


class _AtLoad:
    """R(x) = 0 at one load; where there is an energy it may guide the steps."""

    def __init__(self, scene: Scene, e: float, unstable: int | None):
        self.scene, self._e, self._unstable = scene, e, unstable

    def state(self, z):
        return z, self._e

    def linearise(self, z):
        system = self.scene.system(z, self._e)
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
