"""Down the energy at one load, to the next stable equilibrium.

Damped Newton: where the tangent has unstable modes, a multiple of the identity is added until it
has none (Levenberg); the step goes downhill, and a line search makes the energy fall. Also the
critical mode: the eigenvector whose eigenvalue is nearest to zero.
"""

from __future__ import annotations

import numpy as np

from solver.linear import Factor, SingularMatrix
from solver.newton import NewtonResult, Outcome, Step, checked, chords, downhill, largest
from solver.scene import Scene, System


def critical_mode(
    scene: Scene, factor: Factor, start: np.ndarray | None = None, *, sweeps: int = 8
) -> tuple[float, np.ndarray]:
    """Eigenvalue nearest to zero of the stiffness on the rows' manifold, and its vector (size,).

    Inverse iteration with a factor that is at hand. The vector is 1 in the Euclidean norm of the
    free components, 0 in the multipliers; the eigenvalue is a stiffness, in force per length.
    Raises :class:`solver.linear.SingularMatrix` if the factor gives nothing finite.
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
    max_iterations: int = 300,
    reach: float = 0.1,
) -> NewtonResult:
    """Stable equilibrium down the energy from ``x`` (size,) at the load ``e``.

    ``rtol``: as in :func:`solver.newton.newton`. ``reach``: longest step, max|Δu| / length, so that
    it ends in the next valley and not in some valley. At a saddle it leaves along the critical
    mode, to the side where the energy is lower. Outcomes: CONVERGED (no unstable modes),
    NO_STABLE_STATE, NO_PROGRESS, STAGNATED, INADMISSIBLE, SINGULAR.

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

    def result(outcome, x=None):
        where = here if x is None else x
        return NewtonResult(where, e, outcome, iterations, correction, ratio, system)

    here = x
    while iterations < max_iterations:
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
        if correction <= rtol:
            if shift == 0:
                return result(Outcome.CONVERGED, here + dx)
            if system.unstable == 0:
                shift = 0.0
                continue
            left = _off_saddle(scene, system, here, e, rtol)
            if left is None:
                return result(Outcome.NO_STABLE_STATE)
            here = left
            continue
        share = min(scene.longest_step(here, dx, e), reach / correction, 1.0)
        step = downhill(scene, system, here, e, dx, share)
        if not isinstance(step, Step):
            near = shift == 0 and correction <= 1e3 * rtol
            return result(Outcome.STAGNATED if near else step or Outcome.NO_PROGRESS)
        if shift == 0:
            here, left = chords(residual, factor.solve, step, size, rtol)
            if left <= rtol:
                correction = left
        else:
            here = step.z
            # A full step says that the shifted model is good: lean on it less.
            shift *= 0.25 if step.share >= 1 else 1.0
    return result(Outcome.NO_STABLE_STATE)


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


def _off_saddle(
    scene: Scene, system: System, x: np.ndarray, e: float, rtol: float
) -> np.ndarray | None:
    """A state of lower energy beside a saddle, along its critical mode; None if there is none."""
    _, mode = critical_mode(scene, system.factorise(), sweeps=30)
    mode = mode * scene.scales.length / largest(mode)
    for amount in (1e-3, 1e-2, 1e-4, 1e-5, 10 * rtol):
        sides = []
        for side in (1.0, -1.0):
            found = scene.energy(x + side * amount * mode, e)
            if found is not None and found < system.energy:
                sides.append((found, side))
        if sides:
            return x + min(sides)[1] * amount * mode
    return None
