"""Growth that answers to stress, in a bar and in a ring, each with a solution of its own.

The bar 0 ≤ x ≤ 1, ½ wide and high, is stretched at once and held; its sides are free, so its state
is uniform and the law an ordinary differential equation. The ring 1 ≤ R ≤ 1½ is a wedge between
mirror planes, in plane strain: of its radial equilibrium and the law at Chebyshev points of R the
same becomes of it. Both materials are neo-Hookean (Eq. 2.25), E = 1 the unit of stress.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box, polar
from solver.physics.materials import lame
from solver.physics.pressure import Pressure
from solver.physics.supports import Fixed
from solver.viscous.feedback import Feedback, Growing
from solver.viscous.rheology import Spring

E, NU = 1.0, 0.3
LAMBDA, MU = lame(E, NU)
INNER, OUTER, WEDGE = 1.0, 1.5, 0.15
WIDENED = 0.2  # time at which the ring's inside rests


def uniaxial(stretch: float) -> tuple[float, float, float]:
    """Mandel stress, its derivative in the stretch, and ψ of a bar with free sides."""

    def side(c):
        return MU * (c * c - 1) + LAMBDA * np.log(stretch * c * c)

    c = brentq(side, 1e-3, 30.0, xtol=1e-15)
    rate = -(LAMBDA / stretch) / (2 * MU * c + 2 * LAMBDA / c)
    x = np.log(stretch * c * c)
    mandel = MU * (stretch**2 - 1) + LAMBDA * x
    slope = 2 * MU * stretch + LAMBDA / stretch + 2 * LAMBDA * rate / c
    return mandel, slope, MU / 2 * (stretch**2 + 2 * c * c - 3 - 2 * x) + LAMBDA / 2 * x * x


@dataclass(frozen=True)
class Bar:
    """A clamped bar: ``stretch`` at which it is held; ``rate`` (1/(stress · time)), ``target``
    (stress), ``baseline`` (1/time) and ``measure`` of its :class:`Feedback`; ``along``: growth
    along the bar, else of the volume."""

    stretch: float = 1.2
    rate: float = 2.0
    target: float = 0.1
    baseline: float = 0.05
    along: bool = True
    measure: str = "mandel"

    @property
    def law(self) -> Feedback:
        """Its feedback."""
        fibre = (1.0, 0.0, 0.0) if self.along else None
        return Feedback(self.rate, self.target, self.baseline, fibre=fibre, measure=self.measure)

    def scene(self, dt: float, element: str = "hex8") -> Scene:
        """One element of it."""
        body = Body.build(box([0, 1], [0, 0.5], [0, 0.5]), element)
        x = body.nodes
        fixed = [Fixed(x[:, k] < 1e-9, np.eye(3)[k]) for k in range(3)]
        fixed.append(Fixed(x[:, 0] > 1 - 1e-9, (1, 0, 0), self.stretch - 1))
        return Scene(body, [Growing(body, Spring(E, NU), self.law, dt=dt)], fixed=fixed)

    def stress(self, gamma: float) -> float:
        """s at a growth γ."""
        mandel, _, psi = uniaxial(self.stretch * np.exp(-gamma))
        s = mandel if self.along else mandel / 3
        return s - psi if self.measure == "eshelby" else s

    def exact(self, t: np.ndarray) -> np.ndarray:
        """γ at times in order, by an integrator of its own."""

        def speed(_, gamma):
            return [self.baseline + self.rate * (self.stress(gamma[0]) - self.target)]

        span = (0.0, float(np.max(t)))
        return solve_ivp(speed, span, [0.0], t_eval=t, rtol=1e-11, atol=1e-13).y[0]

    @property
    def rest(self) -> float:
        """The stress s that the law seeks: target − baseline/rate."""
        return self.target - self.baseline / self.rate

    def eigenvalue(self, gamma: float) -> float:
        """d γ̇ / d γ of uniform growth, 1/time: −rate λ dM/dλ, over 3 for growth of the volume."""
        stretch = self.stretch * np.exp(-gamma)
        mandel, slope, _ = uniaxial(stretch)
        change = slope if self.along else slope / 3
        if self.measure == "eshelby":
            # dψ = P dλ = (M/λ) dλ with free sides.
            change = change - mandel / stretch
        return -self.rate * stretch * change


def cylindrical(_: float, X: np.ndarray) -> np.ndarray:
    """Rows e_r, e_θ, e_z at positions X (m, q, 3)."""
    r = np.hypot(X[..., 0], X[..., 1])
    c, s, o = X[..., 0] / r, X[..., 1] / r, np.zeros_like(r)
    rows = [np.stack(row, -1) for row in ((c, s, o), (-s, c, o), (o, o, o + 1))]
    return np.stack(rows, -2)


@dataclass(frozen=True)
class Ring:
    """A ring that grows along r, θ and z by a law each: ``rates`` (3,), 1/(stress · time), and
    ``targets`` (3,), stress; the baseline of θ falls from ``baseline`` (1/time) inside to 0
    outside. ``widened``: displacement of the inside, reached at the time ``WIDENED`` and held; 0:
    the inside is free, under ``pressure`` (stress). ``settled``: the targets are instead the
    stresses of the ring that has not grown, which is homeostatic so if there is no baseline.
    """

    rates: tuple[float, float, float] = (0.5, 1.5, 0.0)
    targets: tuple[float, float, float] = (0.0, 0.05, 0.0)
    baseline: float = 0.075
    widened: float = 0.0
    pressure: float = 0.0
    settled: bool = False

    def hoop(self, R: np.ndarray) -> np.ndarray:
        """The baseline of θ at R."""
        return self.baseline * (OUTER - R) / (OUTER - INNER)

    def law(self) -> Feedback:
        """Its feedback."""

        def hoop(_, X):
            return self.hoop(np.hypot(X[..., 0], X[..., 1]))

        targets = self.targets
        if self.settled:
            radial = Radial(self)
            rest, _ = radial.mandel(radial.radius(WIDENED, radial.still), radial.still)

            def target(k):
                return lambda _, X: radial.at(np.hypot(X[..., 0], X[..., 1]), rest)[..., k]

            targets = tuple(map(target, range(3)))
        return Feedback(self.rates, targets, (0.0, hoop, 0.0), frame=cylindrical)

    def opening(self, t: float) -> float:
        """Displacement of the inside."""
        return self.widened * min(t / WIDENED, 1.0)

    def scene(self, cells: int, dt: float) -> Scene:
        """A wedge of ``cells`` along R, hex27; e is the time."""
        grid = (np.linspace(INNER, OUTER, cells + 1), [0, WEDGE], [0, 0.1])
        body = Body.build(box(*grid, shape=polar), "hex27")
        x, normal = body.nodes, np.array([-np.sin(WEDGE), np.cos(WEDGE), 0])
        fixed = [Fixed(np.abs(x @ n) < 1e-9, n) for n in (np.array([0, 1.0, 0]), normal)]
        fixed += [Fixed(np.abs(x[:, 2] - z) < 1e-9, (0, 0, 1)) for z in (0, 0.1)]
        if self.widened:
            inside = np.flatnonzero(np.abs(np.hypot(*x.T[:2]) - INNER) < 1e-9)
            fixed += [Fixed([k], (*x[k, :2], 0), self.opening) for k in inside]
        terms = [Growing(body, Spring(E, NU), self.law(), dt=dt)]
        if self.pressure:
            terms.append(Pressure(body, body.surface("x-"), self.pressure))
        return Scene(body, terms, fixed=fixed)


class Radial:
    """A ring's radial solution: r(R) at n + 1 Chebyshev points, equilibrium by collocation."""

    def __init__(self, ring: Ring, n: int = 16):
        k = np.arange(n + 1)
        x = -np.cos(np.pi * k / n)
        # Trefethen, Spectral Methods in MATLAB, Eq. 6.5.
        c = np.where((k == 0) | (k == n), 2.0, 1.0) * (-1.0) ** k
        D = np.outer(c, 1 / c) / (np.subtract.outer(x, x) + np.eye(n + 1))
        D -= np.diag(D.sum(axis=1))
        self.ring, self.x = ring, x
        self.R = INNER + (OUTER - INNER) * (x + 1) / 2
        self._D = D * 2 / (OUTER - INNER)
        self._r, self.still = self.R.copy(), np.zeros((3, n + 1))

    def mandel(self, r: np.ndarray, growth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """M (3, n + 1) along r, θ, z and the elastic stretches, of r and γ (3, n + 1).

        Of several r as columns (n + 1, k): (3, n + 1, k).
        """
        shape = (-1, *[1] * (r.ndim - 1))
        stretch = np.stack([self._D @ r, r / self.R.reshape(shape), np.ones_like(r)])
        stretch = stretch * np.exp(-growth).reshape(3, *shape)
        return MU * (stretch**2 - 1) + LAMBDA * np.log(stretch).sum(0), stretch

    def radius(self, t: float, growth: np.ndarray) -> np.ndarray:
        """r in equilibrium at γ; ArithmeticError where Newton's method does not find it."""
        opening, volume = self.ring.opening(t), np.exp(growth.sum(0) - growth)[..., None]

        def off(r):
            M, stretch = self.mandel(r, growth)
            P = volume * M / stretch
            left = self._D @ P[0] + (P[0] - P[1]) / self.R[:, None]
            left[-1] = P[0, -1]
            free = P[0, 0] + self.ring.pressure * r[0] / INNER
            left[0] = r[0] - INNER - opening if self.ring.widened else free
            return left

        r, small = self._r[:, None], 1e-30
        for _ in range(30):
            # The complex step gives the Jacobian to rounding.
            J = off(r + 1j * small * np.eye(len(r))).imag / small
            step = np.linalg.solve(J, off(r))
            r = r - step
            if np.abs(step).max() < 1e-12:
                self._r = r[:, 0]
                return self._r
        raise ArithmeticError("no radial equilibrium was found; take a smaller growth or opening")

    def growth(self, until: float) -> np.ndarray:
        """γ (3, n + 1) at a time after ``WIDENED``."""
        flat = np.zeros(3 * len(self.R))
        for a, b in ((0.0, WIDENED), (WIDENED, until)):
            flat = solve_ivp(self.speed(), (a, b), flat, rtol=1e-9, atol=1e-11).y[:, -1]
        return flat.reshape(3, -1)

    def speed(self) -> Callable[[float, np.ndarray], np.ndarray]:
        """γ̇ of the time and γ, flat (3 (n + 1),)."""
        rate, target = (np.array(v)[:, None] for v in (self.ring.rates, self.ring.targets))
        if self.ring.settled:
            target, _ = self.mandel(self.radius(WIDENED, self.still), self.still)
        free = np.zeros((3, len(self.R)))
        free[1] = self.ring.hoop(self.R)

        def of(t, flat):
            growth = flat.reshape(3, -1)
            M, _ = self.mandel(self.radius(t, growth), growth)
            return (free + rate * (M - target)).ravel()

        return of

    def rates(self, growth: np.ndarray) -> np.ndarray:
        """Eigenvalues of ∂γ̇/∂γ at γ late, the largest real part first, by central differences."""
        of, h, flat = self.speed(), 1e-5, growth.ravel()
        late = 10 * WIDENED
        columns = [
            (of(late, flat + d) - of(late, flat - d)) / (2 * h) for d in h * np.eye(len(flat))
        ]
        found = np.linalg.eigvals(np.array(columns).T)
        return found[np.argsort(-found.real)]

    def cauchy(self, t: float, growth: np.ndarray) -> np.ndarray:
        """Stresses (3, n + 1) along r, θ and z."""
        M, stretch = self.mandel(self.radius(t, growth), growth)
        return M / stretch.prod(axis=0)

    def at(self, R: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values (3, n + 1) at other radii, (..., 3)."""
        x = 2 * (R - INNER) / (OUTER - INNER) - 1
        fit = np.polynomial.chebyshev.chebfit(self.x, values.T, len(self.x) - 1)
        return np.moveaxis(np.polynomial.chebyshev.chebval(x, fit), 0, -1)
