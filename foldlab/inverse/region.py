"""The designs that a wish's limits allow: a polytope in log10 of groups and scales.

Emptiness is decided exactly by linear programmes, points are drawn by hit-and-run along chords.
Mass and thickness (sums of products, see ``wish``) cut the polytope further and are met by
shrinking each chord onto what they allow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import linprog, minimize

from foldlab.design import PATTERNED, PHYSICAL
from foldlab.errors import InputError
from foldlab.inverse.wish import SCALES, Limit, Wish, mass_of, quantities_of

_TIGHT = 1e-9  # decades: below it a limit counts as an equality


class Region:
    """The allowed designs of one wish and one pair of materials.

    ``names``: the coordinates, whose logarithms make a point; ``centre`` (names,): a point deep
    inside of the polytope; ``start``: one that mass and thickness allow too.
    """

    def __init__(self, wish: Wish, limits: Sequence[Limit]):
        """Raises :class:`InputError` where no design meets all limits, naming those to blame."""
        self.wish, self.limits = wish, tuple(limits)
        used = {name for limit in self.limits for name in limit.powers}
        names = [name for name in (*PATTERNED.names, *SCALES, "g_earth") if name in used]
        self.names = names
        rows = np.array([[limit.powers.get(name, 0.0) for name in names] for limit in self.limits])
        low = np.array([limit.low for limit in self.limits])
        high = np.array([limit.high for limit in self.limits])
        self._rows = rows
        self._low = low
        self._high = high
        equal = high - low < _TIGHT
        centre, radius = self._centre(equal)
        if centre is None:
            raise InputError(self._contradiction())
        if radius < _TIGHT:
            # The limits leave no room somewhere: those rows hold as equalities.
            equal = equal | (self._slack() < _TIGHT)
            centre, _ = self._centre(equal)
        free = ~equal
        # The linear programme keeps equalities to its own tolerance; here they hold to rounding.
        off = rows[equal] @ centre - (low[equal] + high[equal]) / 2
        centre = centre - np.linalg.lstsq(rows[equal], off)[0] if equal.any() else centre
        self.centre = centre
        self._basis = _null(rows[equal], len(names))
        above, below = free & np.isfinite(high), free & np.isfinite(low)
        self._A = np.vstack([rows[above], -rows[below]])
        self._b = np.concatenate([high[above], -low[below]])
        self.start = self._start()

    @property
    def free(self) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Orthonormal directions (names, k) that the equalities leave, and the inequalities as
        (A, b): A x ≤ b of every allowed x."""
        return self._basis, (self._A, self._b)

    # ---- emptiness ------------------------------------------------------------------------

    def _programme(self, cost, extra=None, skip=None):
        """Minimise cost·(x, t) with every limit; column t widens the limit ``skip`` both ways."""
        rows, low, high = self._rows, self._low, self._high
        t = np.zeros((len(rows), 1)) if extra is None else extra[:, None]
        if skip is not None:
            t[skip] = 1.0
        upper, lower = np.isfinite(high), np.isfinite(low)
        A = np.vstack([np.hstack([rows, -t])[upper], np.hstack([-rows, -t])[lower]])
        # Limits written as decimals agree to rounding only.
        b = np.concatenate([high[upper], -low[lower]]) + 1e-12
        bounds = [(None, None)] * len(self.names) + [(0, None)]
        return linprog(cost, A_ub=A, b_ub=b, bounds=bounds, method="highs")

    def _centre(self, equal):
        """Centre and radius of the largest ball inside, or (None, 0) where nothing is inside."""
        free = ~equal
        basis = _null(self._rows[equal], len(self.names))
        lengths = np.where(free, np.linalg.norm(self._rows @ basis, axis=1), 0.0)
        cost = np.append(np.zeros(len(self.names)), -1.0)
        result = self._programme(cost, extra=-lengths)
        if result.status == 3:  # unbounded: every limit is an equality, a single point
            result = self._programme(np.zeros(len(self.names) + 1))
            return (result.x[:-1], 0.0) if result.status == 0 else (None, 0.0)
        return (result.x[:-1], result.x[-1]) if result.status == 0 else (None, 0.0)

    def _slack(self):
        """How far apart each limit's ends can be reached inside, decades."""
        out = np.zeros(len(self.limits))
        for k, row in enumerate(self._rows):
            up = self._programme(np.append(-row, 0.0))
            down = self._programme(np.append(row, 0.0))
            out[k] = -up.fun - down.fun
        return out

    def _contradiction(self) -> str:
        candidates = []
        cost = np.append(np.zeros(len(self.names)), 1.0)
        for k, limit in enumerate(self.limits):
            if limit.soft:
                result = self._programme(cost, skip=k)
                if result.status == 0:
                    value = 10.0 ** float(self._rows[k] @ result.x[:-1])
                    candidates.append((result.x[-1], limit, value))
        if not candidates:
            texts = "; ".join(limit.text for limit in self.limits if limit.soft)
            return f"more than one limit contradicts the others, among {texts}: relax several"
        candidates.sort(key=lambda entry: entry[0])
        texts = "; ".join(limit.text for _, limit, _ in candidates)
        cures = "; or ".join(
            f"{limit.quantity} would have to be {_quantity(limit.quantity, value)}"
            for _, limit, value in candidates
        )
        return f"no design meets all limits; with the bounds of the space clash: {texts}: {cures}"

    # ---- mass and thickness ---------------------------------------------------------------

    def excess(self, x: np.ndarray) -> np.ndarray:
        """Decades by which designs exceed the mass or thickness allowed, shape (n,)."""
        out = np.full(len(x), -np.inf)
        for name in ("mass", "thickness"):
            limit = getattr(self.wish, f"max_{name}")
            if limit is not None:
                out = np.maximum(out, np.log10(self.measure(name, x) / limit))
        return out

    def measure(self, name: str, x: np.ndarray) -> np.ndarray:
        """``'mass'`` in kg or ``'thickness'`` in m of designs given as log10 variables."""
        q = quantities_of(x, self.names)
        return mass_of(q) if name == "mass" else (q["h_s"] + q["h_i"]).to_numpy()

    def _start(self):
        """A design within all limits, mass and thickness too."""
        if self.excess(self.centre[None])[0] <= 0:
            return self.centre
        least = self.centre
        for name in ("thickness", "mass"):
            limit = getattr(self.wish, f"max_{name}")
            if limit is None:
                continue
            least = self._least(name, least)
            value = float(self.measure(name, least[None])[0])
            if value > limit * (1 + 1e-6):
                raise InputError(self._too_much(name, value, limit, least))
        # Off the edge: the furthest point towards the centre that still meets the limits.
        steps = least + np.linspace(1, 0, 201)[:, None] * (self.centre - least)
        good = steps[self.excess(steps) <= 1e-6]
        return (least + good[0]) / 2 if len(good) else least

    def _least(self, name, x):
        basis, A = self._basis, self._A
        slack = self._b - A @ x

        def log_measure(z, what=name):
            return float(np.log10(self.measure(what, (x + basis @ z)[None])[0]))

        conditions = [{"type": "ineq", "fun": lambda z: slack - A @ (basis @ z)}]
        if name == "mass" and self.wish.max_thickness is not None:
            top = np.log10(self.wish.max_thickness)
            conditions.append({"type": "ineq", "fun": lambda z: top - log_measure(z, "thickness")})
        result = minimize(
            log_measure,
            np.zeros(basis.shape[1]),
            method="SLSQP",
            constraints=conditions,
            options={"maxiter": 300, "ftol": 1e-10},
        )
        return x + basis @ result.x

    def _too_much(self, name, value, limit, x):
        unit = "kg" if name == "mass" else "m"
        at = self._rows @ x
        edge = (np.abs(at - self._low) < 1e-4) | (np.abs(at - self._high) < 1e-4)
        binding = [one.text for one, on in zip(self.limits, edge, strict=True) if on and one.soft]
        because = f"; there {'; '.join(binding)} bind" if binding else ""
        return (
            f"{name} ≤ {limit:.4g} {unit} cannot be met: the least within the other limits is "
            f"{value:.4g} {unit}{because}: raise the {name} or relax those"
        )

    # ---- sampling -------------------------------------------------------------------------

    def walk(
        self,
        x: np.ndarray,
        steps: int,
        rng: np.random.Generator,
        accept: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> np.ndarray:
        """Move walkers, shape (n, variables), by hit-and-run; each stays where ``accept`` is true.

        Directions are differences of other walkers (they take on the region's shape) or random.
        """
        n, basis = len(x), self._basis
        if basis.shape[1] == 0:
            return x

        def allowed(y):
            ok = self.excess(y) <= 0
            if accept is not None and ok.any():
                ok[ok] = accept(y[ok])
            return ok

        for step in range(steps):
            direction = rng.normal(size=(n, basis.shape[1])) @ basis.T
            if step > 10 and step % 3:
                apart = x[rng.integers(n, size=n)] - x[rng.integers(n, size=n)]
                far = np.linalg.norm(apart, axis=1) > 1e-6
                direction[far] = apart[far] @ basis @ basis.T
            slack = np.maximum(self._b - x @ self._A.T, 0)
            rate = direction @ self._A.T
            with np.errstate(divide="ignore", invalid="ignore"):
                reach = slack / rate
            top = np.where(rate > 1e-14, reach, np.inf).min(axis=1)
            bottom = np.where(rate < -1e-14, reach, -np.inf).max(axis=1)
            todo = np.flatnonzero(np.isfinite(top) & np.isfinite(bottom))
            for _ in range(8):
                if len(todo) == 0:
                    break
                t = rng.uniform(bottom[todo], np.maximum(top[todo], bottom[todo]))
                y = x[todo] + t[:, None] * direction[todo]
                ok = allowed(y)
                x = x.copy()
                x[todo[ok]] = y[ok]
                bad, t = todo[~ok], t[~ok]
                top[bad] = np.where(t > 0, t, top[bad])
                bottom[bad] = np.where(t > 0, bottom[bad], t)
                todo = bad
        return x

    def sample(self, n: int, rng: np.random.Generator, steps: int = 60) -> np.ndarray:
        """``n`` allowed designs, close to uniform in log10, shape (n, variables)."""
        x = self.walk(np.tile(self.start, (n, 1)), steps, rng)
        inside = self.excess(x) <= 0
        return x[inside] if inside.any() else x

    def line(self, x: np.ndarray, name: str) -> tuple[np.ndarray, float, float] | None:
        """Direction (names,) that changes the variable ``name`` by one decade and as little else as
        the equalities allow, and how far ``x`` may go along it (low ≤ 0 ≤ high); None where the
        variable is fixed or no part of the region."""
        if name not in self.names:
            return None
        k = self.names.index(name)
        direction = self._basis @ self._basis[k]
        if direction[k] < 1e-9:
            return None
        direction = direction / direction[k]
        slack, rate = np.maximum(self._b - self._A @ x, 0), self._A @ direction
        high = np.min(slack[rate > 1e-12] / rate[rate > 1e-12], initial=np.inf)
        low = -np.min(slack[rate < -1e-12] / -rate[rate < -1e-12], initial=np.inf)
        ends = [low, high]
        for i, end in enumerate(ends):
            t = end * np.linspace(0, 1, 65)
            over = self.excess(x + t[:, None] * direction) > 1e-9
            ends[i] = float(t[max(int(np.argmax(over)) - 1, 0)]) if over.any() else float(end)
        return direction, *ends

    def relaxed(self):
        """``(text, quantity, region, distance)`` for each limit left out in turn.

        ``distance(x)``: how many decades the nearest design lies outside it, and its value there.
        """
        for k, limit in enumerate(self.limits):
            if not limit.soft:
                continue
            rest = self.limits[:k] + self.limits[k + 1 :]
            try:
                region = Region(self.wish, rest)
            except InputError:
                continue
            powers = np.array([limit.powers.get(name, 0.0) for name in region.names])

            def distance(x, limit=limit, powers=powers):
                at = x @ powers
                outside = np.maximum(np.maximum(limit.low - at, at - limit.high), 0)
                i = int(np.argmin(outside))
                return float(outside[i]), _quantity(limit.quantity, 10.0 ** float(at[i]))

            yield limit.text, limit.quantity, region, distance
        for name, unit in (("mass", "kg"), ("thickness", "m")):
            limit = getattr(self.wish, f"max_{name}")
            if limit is None:
                continue
            region = Region(replace(self.wish, **{f"max_{name}": None}), self.limits)

            def distance(x, name=name, unit=unit, limit=limit, region=region):
                value = float(region.measure(name, x).min())
                return np.log10(value / limit), f"{value:.3g} {unit}"

            yield f"{name} ≤ {limit:.4g} {unit}", name, region, distance


def _null(rows: np.ndarray, n: int) -> np.ndarray:
    return null_space(rows) if len(rows) else np.eye(n)


def _quantity(name: str, value: float) -> str:
    unit = PHYSICAL.get(name, "1")
    return f"{value:.3g}" + ("" if unit == "1" else f" {unit}")
