"""Down the energy at one load, to the next stable equilibrium.

Damped Newton first: where the tangent has unstable modes, a multiple of the identity is added until
it has none (Levenberg); the step goes downhill, and a line search makes the energy fall. That is
quick nearby. Far away a straight step of a thin body stretches it, and the line search leaves next
to nothing of it; then the body flows: x' = −∇E in implicit steps (backward Euler), each a minimum
of E + s/2 |x − xₙ|² found by Newton from an extrapolation, as a load step would be. Also the
critical mode: the eigenvector whose eigenvalue is nearest to zero.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver.equilibrium.linear import Factor, SingularMatrix
from solver.equilibrium.linesearch import Step, chords, downhill, largest
from solver.equilibrium.newton import NewtonResult, checked, newton, roundoff
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene, System

_DIRECT = 25  # factorisations before the body flows
# Steps of the flow without a refused one after which its pace rises as it may, and the most between
# two attempts at the equilibrium itself.
_CALM, _WAITS = 4, 8


def critical_mode(
    scene: Scene, factor: Factor, start: np.ndarray | None = None, *, sweeps: int = 8
) -> tuple[float, np.ndarray]:
    """Eigenvalue nearest to zero of the stiffness on the rows' manifold, and its vector (size,).

    Inverse iteration with a factor that is at hand. The vector is 1 in the Euclidean norm of the
    free components, 0 in the multipliers; the eigenvalue is a stiffness, in force per length.
    Raises :class:`solver.equilibrium.linear.SingularMatrix` if the factor gives nothing finite.
    """
    n = scene.n_free
    if start is None:
        start = np.zeros(scene.size)
        start[:n] = np.random.default_rng(0).standard_normal(n)
    v = np.zeros(scene.size)
    v[:n] = start[:n] / np.linalg.norm(start[:n])
    value = np.inf
    for _ in range(sweeps):
        w = factor.solve(v)
        w[n:] = 0.0
        norm = np.linalg.norm(w)
        if not (np.isfinite(norm) and norm > 0):
            raise SingularMatrix("inverse iteration met a singular factor")
        before, value = value, 1.0 / (v @ w) if v @ w != 0 else np.inf
        v = w / norm
        if abs(value - before) < 1e-3 * abs(value):
            break
    return float(value), v


def descend(
    scene: Scene,
    x: np.ndarray,
    e: float,
    *,
    rtol: float,
    max_iterations: int = 600,
    reach: float = 0.1,
) -> NewtonResult:
    """Stable equilibrium down the energy from ``x`` (size,) at the load ``e``.

    ``rtol``: as in :func:`solver.equilibrium.newton.newton`. ``reach``: longest step, max|Δu| /
    length, so that it ends in the next valley and not in some valley. At a saddle it leaves along
    the lowest mode, to the side where the energy is lower. Outcomes: CONVERGED (no unstable modes),
    NO_STABLE_STATE, NO_PROGRESS, STAGNATED, INADMISSIBLE, SINGULAR, ILL_CONDITIONED.

    Raises ValueError for a scene without energy or whose linear solver can't count negative pivots,
    a tolerance ≤ 0 or a guess of the wrong shape.
    """
    x = checked(scene, x, rtol)
    n, length = scene.n_free, scene.scales.length
    shift, iterations, correction, ratio = 0.0, 0, np.inf, np.inf
    system = None

    def size(dx):
        return largest(dx[:n]) / length

    def residual(z):
        return scene.residual(z, e)

    def moved(z, dz):
        return scene.moved(z, dz, e)

    def result(outcome, x=None):
        where = here if x is None else x
        return NewtonResult(where, e, outcome, iterations, correction, ratio, system)

    here = x
    while iterations < min(max_iterations, _DIRECT):
        system = scene.system(here, e)
        if system is None:
            return result(Outcome.INADMISSIBLE)
        if system.energy is None:
            raise ValueError(
                "descend needs an energy, and a term of this scene has none; "
                "use newton, or replace the term by one with a potential"
            )
        ratio = largest(system.residual) / scene.scales.force
        try:
            used, shift, spent = _definite(scene, system, shift)
            iterations += spent
            factor = used.factorise()
        except SingularMatrix:
            return result(Outcome.SINGULAR)
        dx = -factor.solve(system.residual)
        correction = size(dx)
        if not np.isfinite(correction):
            return result(Outcome.SINGULAR)
        longest = scene.longest_step(here, dx, e)
        if correction <= rtol and (shift > 0 or longest >= 1.0):
            if shift == 0:
                if roundoff(system.linear_residual, factor.solve, dx, size):
                    return result(Outcome.ILL_CONDITIONED)
                return result(Outcome.CONVERGED, here + dx)
            if system.unstable == 0:
                shift = 0.0
                continue
            try:
                here = _off_saddle(scene, system, here, e, rtol)
            except SingularMatrix:
                return result(Outcome.SINGULAR)
            continue
        fraction = min(longest, reach / correction, 1.0)
        step = downhill(scene, system, here, e, dx, fraction)
        if not isinstance(step, Step):
            if shift == 0 and roundoff(system.linear_residual, factor.solve, dx, size):
                return result(Outcome.ILL_CONDITIONED)
            if shift == 0 and correction <= 1e3 * rtol:
                return result(Outcome.STAGNATED)
            break
        if shift == 0:
            here, last = chords(residual, factor.solve, step, size, rtol, moved=moved)
            if last <= rtol:
                correction = last
        else:
            here = step.z
            # A full step says that the shifted model is good: lean on it less.
            shift *= 0.25 if step.fraction >= 1 else 1.0
    try:
        if iterations >= max_iterations:
            return _doubted(scene, result(Outcome.NO_STABLE_STATE), x)
        flown = _flow(scene, here, e, rtol, reach, max_iterations, iterations, shift)
        return _doubted(scene, flown, x)
    except SingularMatrix:
        return result(Outcome.SINGULAR)


def _doubted(scene: Scene, result: NewtonResult, start: np.ndarray) -> NewtonResult:
    """The result; where nothing came of it, and solves where it ended or set out are roundoff, with
    that outcome. ``start``: where it set out."""
    if result.converged:
        return result
    for x in (result.x, start):
        system = scene.system(x, result.e)
        if system is not None and _blind(scene, system):
            return replace(result, outcome=Outcome.ILL_CONDITIONED)
    return result


def _blind(scene: Scene, system: System) -> bool:
    """Whether a solve for forces in no order is roundoff."""
    push = np.random.default_rng(0).standard_normal(scene.size)
    push[scene.n_free :] = 0.0
    probe, solve = system.pushed(push), system.factorise().solve
    return roundoff(
        probe.linear_residual, solve, -solve(push), lambda dx: largest(dx[: scene.n_free])
    )


class _Drag:
    """The scene with s/2 |x − xₙ|² added to its energy; what :func:`newton` asks of a scene."""

    def __init__(self, scene: Scene, anchor: np.ndarray, drag: float):
        self._scene, self._anchor, self._drag = scene, anchor, drag

    def __getattr__(self, name):
        return getattr(self._scene, name)

    def _pull(self, x):
        n, d = self._scene.n_free, np.zeros(self._scene.size)
        d[:n] = x[:n] - self._anchor[:n]
        return 0.5 * self._drag * float(d @ d), self._drag * d

    def system(self, x, e, stresses=None):
        system = self._scene.system(x, e, stresses)
        if system is None:
            return None
        energy, force = self._pull(x)
        return system.plus(self._drag, force, energy)

    def residual(self, x, e):
        R = self._scene.residual(x, e)
        return None if R is None else R + self._pull(x)[1]

    def gradient(self, x, e):
        gradient = self._scene.gradient(x, e)
        if gradient is None:
            return None
        energy, force = self._pull(x)
        return gradient[0] + energy, gradient[1] + force


def _flow(scene, x, e, rtol, reach, max_iterations, spent, drag) -> NewtonResult:
    """Implicit gradient flow from x until plain Newton reaches a stable equilibrium."""
    n, length = scene.n_free, scene.scales.length
    system = scene.system(x, e)
    last = NewtonResult(x, e, Outcome.NO_STABLE_STATE, spent, np.inf, np.inf, system)
    # A body so thin that its energy is roundoff may be admissible to a line search only.
    lost = replace(last, outcome=Outcome.INADMISSIBLE)
    if system is None:
        return lost
    _, first, more = _definite(scene, system, drag)
    drag, spent = max(first, drag), spent + more
    if drag == 0:
        value, _ = critical_mode(scene, system.factorise(), sweeps=4)
        drag = abs(value)
    velocity, failed = np.zeros(scene.size), 0
    calm, waits, wait = _CALM, 1, 0
    while spent < max_iterations and failed < 12:
        step = newton(
            _Drag(scene, x, drag), _ahead(scene, x, velocity / drag, e), e,
            rtol=max(rtol, 1e-3 * reach), max_iterations=10, unstable=0, fresh=False,
        )  # fmt: skip
        spent += step.iterations + 1
        moved = largest(step.x[:n] - x[:n]) / length
        energy = scene.energy(step.x, e)
        # Differences of a thin body's energy are roundoff to ~1e-6 of it.
        falls = energy <= system.energy + 1e-6 * abs(system.energy)
        if not (falls and 0 < moved <= 3 * reach):
            drag, failed, calm = 4 * drag, failed + 1, 0
            # After Newton's method has moved on, the pace is another place's and may overshoot.
            velocity = (0.0 if failed > 2 else 1.0 if step.iterations < 3 else 0.5) * velocity
            continue
        failed, calm = 0, calm + 1
        velocity = drag * (step.x - x)
        velocity[n:] = 0.0
        # Unfinished, a step is still one downhill, but its pace says little.
        settled = step.outcome in (Outcome.CONVERGED, Outcome.STAGNATED)
        faster = 0.3 if calm >= _CALM else 0.6
        drag *= (faster if moved < reach else 1.0) if settled else 2.0
        x, system = step.x, scene.system(step.x, e)
        if system is None:
            return replace(lost, x=x, iterations=spent)
        wait -= 1
        if system.unstable == 0 and (wait < 0 or moved <= 10 * rtol):
            plain = newton(scene, x, e, rtol=rtol, max_iterations=8, unstable=0)
            spent += plain.iterations
            if largest(plain.x[:n] - x[:n]) / length <= 3 * reach:
                if plain.converged and plain.system.unstable == 0:
                    return replace(plain, iterations=spent)
                lower = scene.system(plain.x, e)
                if lower is not None and lower.energy < system.energy:
                    x, system = plain.x, lower
            wait, waits = waits, min(2 * waits, _WAITS)
        elif moved <= rtol and system.unstable != 0:
            x, velocity = _off_saddle(scene, system, x, e, rtol), 0 * velocity
            system = scene.system(x, e)
            if system is None:
                return replace(lost, x=x, iterations=spent)
    return replace(last, x=x, iterations=spent)


def _ahead(scene: Scene, x: np.ndarray, dx: np.ndarray, e: float) -> np.ndarray:
    """As far along dx as the barriers admit."""
    size = scene.longest_step(x, dx, e)
    for _ in range(6):
        there = scene.moved(x, size * dx, e)
        if np.isfinite(scene.energy(there, e)):
            return there
        size /= 2
    return x


def _definite(scene: Scene, system: System, shift: float) -> tuple[System, float, int]:
    """A shifted tangent without unstable modes, its shift, and the factorisations it took."""
    spent = 1
    if system.unstable == 0:
        return system, 0.0, spent
    value, _ = critical_mode(scene, system.factorise(), sweeps=4)
    shift = max(shift, 2 * abs(value), 1e-14 * scene.scales.force / scene.scales.length)
    counted = system.unstable is not None
    for _ in range(40):
        trial = system.shifted(shift)
        spent += 1
        count = trial.unstable
        counted |= count is not None
        if count == 0:
            return trial, shift, spent
        shift *= 4
    if not counted:
        raise ValueError(
            "descend needs to count negative pivots, and this scene's linear solver gives none; "
            "use linear='pardiso' and terms that are all symmetric"
        )
    raise SingularMatrix("no shift makes the tangent positive definite")


def _off_saddle(scene: Scene, system: System, x: np.ndarray, e: float, rtol: float) -> np.ndarray:
    """A state of lower energy beside a saddle, along its lowest mode.

    Where roundoff hides the fall, a small step along the mode. Raises
    :class:`solver.equilibrium.linear.SingularMatrix` where no shift makes the tangent definite.
    """
    # The eigenvalue nearest to zero may be a positive one. Of a tangent shifted until it is
    # definite it is the lowest.
    used, _, _ = _definite(scene, system, 0.0)
    _, mode = critical_mode(scene, used.factorise(), sweeps=60)
    mode = mode * scene.scales.length / largest(mode)
    for amount in (1e-3, 1e-2, 1e-4, 1e-5, 10 * rtol):
        sides = []
        for side in (1.0, -1.0):
            energy = scene.energy(x + side * amount * mode, e)
            if energy is not None and energy < system.energy:
                sides.append((energy, side))
        if sides:
            return x + min(sides)[1] * amount * mode
    return x + 1e-4 * mode
