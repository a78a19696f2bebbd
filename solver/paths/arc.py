"""The extended system R(x, e) = 0, f(x, e) = 0 that carries a path round folds.

The load e is an unknown and f says where on the path to stop: an ellipsoid about the last point
(Eqs. 2.64–2.71) or a plane. The bordered matrix

    [ K   ∂R/∂e ] [dx]     [R]
    [ rᵀ    d   ] [de] = − [f]

is solved with the one factorisation of K by mixed block elimination (Govaerts and Pryce 1993),
which stays accurate at limit points, where K is singular and the bordered matrix is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.equilibrium.at_load import Linear
from solver.equilibrium.linear import Factor, SingularMatrix
from solver.equilibrium.linesearch import damped, largest
from solver.equilibrium.newton import NewtonResult, iterate
from solver.equilibrium.scene import Scene, System
from solver.paths.point import Metric, Point


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """f = ‖z − centre‖² − 1 (Eq. 2.64); a and b are the metric's."""

    centre: np.ndarray
    metric: Metric

    def value(self, z: np.ndarray) -> float:
        """f(z)."""
        return self.metric.dot(z - self.centre, z - self.centre) - 1.0

    def row(self, z: np.ndarray) -> np.ndarray:
        """∂f/∂z."""
        return 2 * self.metric.row(z - self.centre)


@dataclass(frozen=True, eq=False)
class Plane:
    """f = r · (z − at)."""

    at: np.ndarray
    normal: np.ndarray

    def value(self, z: np.ndarray) -> float:
        """f(z)."""
        return float(self.normal @ (z - self.at))

    def row(self, z: np.ndarray) -> np.ndarray:
        """∂f/∂z."""
        return self.normal


class Bordered:
    """[K c; rᵀ d] with the factor of K: three solves to begin with, one for each right side."""

    def __init__(self, factor: Factor, column: np.ndarray, row: np.ndarray):
        """``column`` ∂R/∂e (size,); ``row`` (size + 1,)."""
        self._factor, self._c, self._r, self._d = factor, column, row[:-1], row[-1]
        self._v = factor.solve(column)
        self._w = factor.solve(self._r, transposed=True)
        self._delta = self._d - self._r @ self._v
        self._delta_w = self._d - self._w @ column
        pivots = (self._delta, self._delta_w)
        if not np.isfinite(pivots).all() or 0.0 in pivots:
            raise SingularMatrix("the bordered matrix is singular")

    def solve(self, b: np.ndarray) -> np.ndarray:
        """z of the bordered system for the right side b (size + 1,)."""
        f, g = b[:-1], b[-1]
        first = (g - self._w @ f) / self._delta_w
        p = self._factor.solve(f - self._c * first)
        second = (g - self._d * first - self._r @ p) / self._delta
        return np.append(p - self._v * second, first + second)


def correct(
    scene: Scene,
    z: np.ndarray,
    constraint: Ellipsoid | Plane,
    *,
    rtol: float,
    load_size: float,
    max_iterations: int,
    system: System | None = None,
) -> NewtonResult:
    """Newton on the extended system (Eqs. 2.65–2.72) from the guess z = (x, e), (size + 1,).

    Converged when max|Δu| / length and |Δe| / ``load_size`` are ≤ ``rtol``. A step is shortened
    until the simplified correction shrinks. ``system``: that at the guess, where it is known. The
    factor of the result's ``system`` is alive.
    """
    extended = _Extended(scene, constraint, load_size, system)
    return iterate(extended, z, rtol=rtol, max_iterations=max_iterations)


class _Extended:
    """R(x, e) = 0, f(x, e) = 0."""

    def __init__(
        self,
        scene: Scene,
        constraint: Ellipsoid | Plane,
        load_size: float,
        first: System | None = None,
    ):
        self.scene, self._constraint, self._load_size = scene, constraint, load_size
        self._first = first

    def state(self, z):
        return z[:-1], float(z[-1])

    def linearise(self, z):
        (x, e), h = self.state(z), 1e-4 * self._load_size
        system, self._first = self._first or self.scene.system(x, e), None
        ahead = None if system is None else self.scene.residual(x, e + h)
        if ahead is None:
            return None
        rate = (ahead - system.residual) / h
        f = self._constraint

        def linear_residual(dz):
            over, work = system.linear_residual(dz[:-1], rate * dz[-1])
            return np.append(over, 0.0), work

        return Linear(
            np.append(system.residual, f.value(z)),
            system,
            lambda: Bordered(system.factorise(), rate, f.row(z)).solve,
            linear_residual,
        )

    def residual(self, z):
        R = self.scene.residual(z[:-1], z[-1])
        return None if R is None else np.append(R, self._constraint.value(z))

    def size(self, dz):
        n, length = self.scene.n_free, self.scene.scales.length
        return max(largest(dz[:n]) / length, abs(dz[-1]) / self._load_size)

    def norm(self, dz):
        n, length = self.scene.n_free, self.scene.scales.length
        return float(
            np.hypot(np.linalg.norm(dz[:n]) / length / np.sqrt(n), dz[-1] / self._load_size)
        )

    def moved(self, z, dz):
        return z + dz

    def longest_step(self, z, dz):
        return self.scene.longest_step(z[:-1], dz[:-1], float(z[-1]))

    def step(self, system, solve, z, dz, longest):
        return damped(self.residual, solve, z, dz, self.norm, longest)


def tangent(
    scene: Scene, x: np.ndarray, e: float, factor: Factor, along: np.ndarray, metric: Metric
) -> np.ndarray | None:
    """Unit d(x, e)/ds (size + 1,) on the side of ``along``; None if it can't be computed.

    K dx + ∂R/∂e de = 0 with ⟨along, (dx, de)⟩ = 1; ∂R/∂e by central differences.
    """
    rate = scene.load_rate(x, e, 1e-3 * metric.b)
    if rate is None:
        return None
    right = np.zeros(len(along))
    right[-1] = 1.0
    try:
        t = Bordered(factor, rate, metric.row(along)).solve(right)
    except SingularMatrix:
        return None
    return metric.unit(t) if np.isfinite(t).all() else None


class NotFollowed(ArithmeticError):
    """The path between two of its points could not be followed to where it was asked for."""


def between(
    scene: Scene,
    before: Point,
    after: Point,
    fraction: float,
    *,
    rtol: float,
) -> tuple[Point, Factor] | None:
    """The path's point between two neighbours, and the factor there; None if it is not reached.

    ``fraction`` in (0, 1): where, along the straight line from ``before`` to ``after``; the point
    lies in the plane across that line.
    """
    start, end = before.z, after.z
    line = end - start
    metric = after.metric
    h = metric.norm(line)
    d0, d1 = (h * metric.unit(p.tangent) for p in (before, after))
    t = fraction
    guess = (2 * t**3 - 3 * t**2 + 1) * start + (t**3 - 2 * t**2 + t) * d0
    guess = guess + (3 * t**2 - 2 * t**3) * end + (t**3 - t**2) * d1
    plane = Plane(start + fraction * line, metric.row(line) / h)
    # The cubic may compress a thin body, in which Newton's method then strays; the tangent of the
    # nearer end stretches it. Not where the tangents say that the ends lie on different paths.
    options, spent = [guess], 0
    near, d, t = (start, d0, fraction) if fraction < 0.5 else (end, d1, fraction - 1)
    smooth = metric.dot(line, d0 + d1) > 0.9 * h * metric.norm(d0 + d1)
    if smooth and (ahead := plane.normal @ d) > 0.1 * h:
        options.append(near + t * h / ahead * d)
    for z in options:
        result = correct(scene, z, plane, rtol=rtol, load_size=metric.b, max_iterations=12)
        spent += result.iterations
        # Back on the path between the two, not on some other path that crosses the plane.
        if result.converged and metric.norm(result.z - guess) <= 0.5 * h:
            break
    else:
        return None
    factor = result.system.factorise()
    way = tangent(scene, result.x, result.e, factor, line, metric)
    if way is None:
        return None
    point = Point(
        index=before.index,
        e=result.e,
        x=result.x,
        tangent=way,
        metric=metric,
        unstable=result.system.unstable,
        energy=result.system.energy,
        iterations=spent,
        step=result.e - before.e,
        residual=result.residual,
        control=before.control,
        history=before.past(),
    )
    return point, factor
