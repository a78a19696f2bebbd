"""Parameters of a growth from a shape, with their uncertainty (§6.3.3).

The most probable parameters under Gaussian noise and a Gaussian prior make

    ½ Σ r(p)² + ½ |A (p − m)|²

least, by Gauss–Newton steps within bounds (SciPy's trust region reflective method) with the exact
Jacobian of the equilibria. Near them the posterior is a Gaussian of the precision JᵀJ + AᵀA
(Laplace's approximation; Bishop, *Pattern Recognition and Machine Learning*, §4.4), from which
intervals come. JᵀJ alone, the information of the data, tells what they fix, and the sum of squares
whether the model explains them at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2, norm

from solver.fitting.elastic import States, Unreached
from solver.fitting.field import Field
from solver.fitting.targets import Target
from solver.given import numbers

# A combination of parameters whose data alone leave it wider than if it were anywhere in its range
# with the same probability, in ranges, is not fixed by them.
LOOSE = 1 / np.sqrt(12)
# Probability of a sum of squares this large under the model, below which it does not explain.
DOUBT = 1e-3
# Of the body's length, by which the fitted state may differ from that on the path from rest.
APART = 1e-6


class Ending(Enum):
    """How a fit ended; the value is a sentence for people."""

    FITTED = "no parameters nearby fit better"
    NOT_CONVERGED = "the evaluations allowed were used up; these are the best parameters so far"
    NO_STATE = "the parameters to start from lead to no stable state of the body"
    OTHER_BRANCH = (
        "the state that fits is not the one to which the path from rest leads with its parameters"
    )


class Forward(Protocol):
    """What leads from parameters to states, such as :class:`solver.fitting.elastic.Equilibria`."""

    field: Field

    def solve(
        self, p: np.ndarray, at: Sequence[float], near: States | None = None
    ) -> States | Unreached: ...


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of parameters beforehand: A (p − m) is standard normal, A (rows, k), m (k,)."""

    A: np.ndarray
    m: np.ndarray

    @classmethod
    def gaussian(cls, mean: np.ndarray, sd: np.ndarray) -> Prior:
        """Of independent parameters (k,)."""
        mean = numbers("mean", mean)
        return cls(np.diag(1 / np.broadcast_to(numbers("sd", sd), mean.shape)), mean)

    @classmethod
    def smooth(cls, rows: np.ndarray, sd: float) -> Prior:
        """Of combinations ``rows`` (r, k), such as differences of neighbours, that are about 0."""
        rows = numbers("rows", rows)
        return cls(rows / sd, np.zeros(rows.shape[1]))

    @property
    def precision(self) -> np.ndarray:
        """AᵀA, (k, k)."""
        return self.A.T @ self.A


@dataclass(frozen=True)
class Combination:
    """A combination of parameters, each in ranges: its ``weights`` by their names, of length 1, and
    how widely the data alone leave it, ``sd`` in ranges (inf: they say nothing)."""

    weights: dict[str, float]
    sd: float

    @property
    def fixed(self) -> bool:
        """Whether the data fix it, to less than being anywhere in its range would."""
        return self.sd < LOOSE

    def __str__(self) -> str:
        parts = sorted(self.weights.items(), key=lambda part: -abs(part[1]))
        shown = [f"{w:+.2f} {name}" for name, w in parts if abs(w) > 0.2]
        how = f"to {self.sd:.2g} of the ranges" if np.isfinite(self.sd) else "not at all"
        return f"{' '.join(shown)}: the data fix it {how}"


@dataclass(frozen=True, eq=False)
class Fit:
    """What a fit found; with ``Ending.NO_STATE`` only ``p``, the start, and ``detail`` mean
    something.

    ``p`` (k,); ``residuals``: of all data, in standard deviations; ``information`` (k, k): JᵀJ;
    ``prior``; ``at_bound`` (k,): parameters that their bounds hold, whose intervals are those of a
    Gaussian that knows no bounds; ``states``: what p leads to.
    """

    field: Field
    p: np.ndarray
    ending: Ending
    detail: str
    evaluations: int
    residuals: np.ndarray
    information: np.ndarray
    prior: Prior | None
    at_bound: np.ndarray
    states: States | None

    @property
    def fitted(self) -> bool:
        """Whether the fit ended as it should."""
        return self.ending is Ending.FITTED

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the posterior, (k, k). What neither data nor prior fix has a huge variance."""
        ranges = self.field.high - self.field.low
        precision = self.information + (0 if self.prior is None else self.prior.precision)
        values, vectors = np.linalg.eigh(precision * np.outer(ranges, ranges))
        values = np.maximum(values, 1e-12 * max(values.max(), 1e-300))
        vectors = ranges[:, None] * vectors
        return (vectors / values) @ vectors.T

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of the parameters, (k,)."""
        return np.sqrt(np.diag(self.covariance))

    def interval(self, level: float = 0.95) -> np.ndarray:
        """Where each parameter is with probability ``level``, (k, 2)."""
        return self.p[:, None] + norm.ppf(0.5 + level / 2) * self.sd[:, None] * [-1, 1]

    def distance(self, p: np.ndarray) -> float:
        """Probability of the smallest ellipsoid of the posterior that parameters p (k,) are in: at
        most 0.95 for 95 of 100 true ones. It bounds all of β at once, see :meth:`band`."""
        off = np.asarray(p) - self.p
        return float(chi2.cdf(off @ np.linalg.solve(self.covariance, off), len(off)))

    def band(self, X: np.ndarray, level: float = 0.95, *, everywhere: bool = False):
        """β and half the width of its band at positions (..., 3): of each place by itself, or such
        that β lies in it ``everywhere`` at once with that probability (Scheffé)."""
        slopes = self.field.slopes(self.p, X)
        sd = np.sqrt(np.einsum("...i,ij,...j->...", slopes, self.covariance, slopes))
        wide = np.sqrt(chi2.ppf(level, len(self.p))) if everywhere else norm.ppf(0.5 + level / 2)
        return self.field.values(self.p, X), wide * sd

    @cached_property
    def _informed(self) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues (k,) and vectors (k, k) of the information in ranges, rounding as 0."""
        ranges = self.field.high - self.field.low
        values, vectors = np.linalg.eigh(self.information * np.outer(ranges, ranges))
        return np.where(values > 1e-12 * values[-1], values, 0.0), vectors

    @cached_property
    def combinations(self) -> tuple[Combination, ...]:
        """Of the parameters, independent by the data, the least fixed first."""
        found = []
        for value, vector in zip(self._informed[0], self._informed[1].T, strict=True):
            sd = float(1 / np.sqrt(value)) if value > 0 else np.inf
            found.append(Combination(dict(zip(self.field.names, vector, strict=True)), sd))
        return tuple(found)

    @property
    def unfixed(self) -> tuple[Combination, ...]:
        """Those that the data do not fix: there the prior speaks, or nobody."""
        return tuple(c for c in self.combinations if not c.fixed)

    @property
    def chi_square(self) -> float:
        """Σ r² of the data."""
        return float(self.residuals @ self.residuals)

    @property
    def freedom(self) -> float:
        """Residuals less the parameters that the data decided, tr(C JᵀJ): what Σ r² should be."""
        values, vectors = self._informed
        ranges = self.field.high - self.field.low
        rest = vectors.T @ (self.covariance / np.outer(ranges, ranges)) @ vectors
        return len(self.residuals) - float(np.diag(rest) @ values)

    @property
    def probability(self) -> float:
        """Of so large a Σ r² if the model were right and σ as stated; with no more data than
        parameters Σ r² should be 0, and is held to one degree of freedom."""
        return float(chi2.sf(self.chi_square, max(self.freedom, 1.0)))

    @property
    def explained(self) -> bool:
        """Whether the model explains the shape, to its stated noise. Where it does not, intervals
        mean nothing: growth, material, supports or σ are others."""
        return self.fitted and self.probability >= DOUBT


class _Residuals:
    """Residuals and Jacobian as the optimiser asks for them, each state solved once."""

    def __init__(self, forward: Forward, data, prior: Prior | None):
        self.forward, self.prior = forward, prior
        self.data = data
        self.at = sorted({float(at) for at, _ in data})
        self.size = sum(target.size for _, target in data)
        self.solved: dict[bytes, States] = {}
        self.near: States | None = None
        self.why = ""
        self.evaluations = 0

    def states(self, p: np.ndarray) -> States | None:
        found = self.solved.get(p.tobytes())
        if found is None:
            self.evaluations += 1
            found = self.forward.solve(p, self.at, self.near)
            if isinstance(found, Unreached):
                self.why = f"{found.why}, at {found.at:.4g}"
                return None
            # That of the trial before may be where the optimiser returns to.
            self.solved = {**dict(list(self.solved.items())[-1:]), p.tobytes(): found}
        return found

    def of(self, states: States) -> np.ndarray:
        parts = [target.residual(states.at[self.at.index(at)].u) for at, target in self.data]
        return np.concatenate(parts)

    def slope(self, states: States) -> np.ndarray:
        parts = []
        for instant, target in self.data:
            state = states.at[self.at.index(instant)]
            parts.append(target.slope(state.u, state.rates))
        return np.concatenate(parts)

    def __call__(self, p: np.ndarray) -> np.ndarray:
        states = self.states(p)
        rows = 0 if self.prior is None else len(self.prior.A)
        if states is None:
            # The optimiser then tries a shorter step.
            return np.full(self.size + rows, np.nan)
        known = np.zeros(0) if self.prior is None else self.prior.A @ (p - self.prior.m)
        return np.concatenate([self.of(states), known])

    def jacobian(self, p: np.ndarray) -> np.ndarray:
        self.near = self.states(p)
        rows = np.zeros((0, len(p))) if self.prior is None else self.prior.A
        return np.concatenate([self.slope(self.near), rows])


def fit(
    forward: Forward,
    data: Sequence[tuple[float, Target]],
    start: np.ndarray | None = None,
    *,
    prior: Prior | None = None,
    most: int = 100,
) -> Fit:
    """Parameters of ``forward.field`` for ``data``: pairs of a load (or time) > 0 and what is known
    of the shape there.

    ``start`` (k,): within the bounds; by default the middle. ``most``: evaluations allowed. States
    that can't be reached are steps refused; the fit is never an exception for it. What was found
    is followed from rest once more, so that it is what growth leads to.

    Raises ValueError for no data, a start of another shape or out of bounds, and a prior of other
    parameters.
    """
    field = forward.field
    low, high = (np.asarray(b, float) for b in (field.low, field.high))
    p = (low + high) / 2 if start is None else numbers("start", start)
    if not len(data):
        raise ValueError("there are no data; give pairs of a load and a target")
    if p.shape != low.shape or not ((p >= low) & (p <= high)).all():
        raise ValueError(f"start = {p}; expected {len(low)} parameters from {low} to {high}")
    if prior is not None and prior.A.shape[1:] != low.shape:
        raise ValueError(f"the prior is of {prior.A.shape[1]} parameters, the field has {len(low)}")
    residuals = _Residuals(forward, data, prior)
    p = np.clip(p, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
    nothing = np.zeros(0), np.zeros((len(low), len(low))), prior, np.zeros(len(low), bool), None
    if residuals.states(p) is None:
        return Fit(field, p, Ending.NO_STATE, residuals.why, 1, *nothing)
    found = least_squares(
        residuals, p, residuals.jacobian, bounds=(low, high), x_scale=high - low, method="trf",
        ftol=1e-11, xtol=1e-8, gtol=1e-8, max_nfev=most,
    )  # fmt: skip
    p = found.x
    states = forward.solve(p, residuals.at)
    ending, detail = Ending.FITTED if found.status > 0 else Ending.NOT_CONVERGED, ""
    fitted = residuals.states(p)
    if isinstance(states, Unreached):
        ending, detail, states = Ending.OTHER_BRANCH, f"{states.why}, at {states.at:.4g}", fitted
    else:
        size = max(np.ptp(state.u, axis=0).max() for state in states.at)
        both = zip(states.at, fitted.at, strict=True)
        apart = max(np.abs(a.u - b.u).max() for a, b in both)
        if apart > APART * max(size, 1e-300):
            ending, detail, states = Ending.OTHER_BRANCH, f"they are {apart:.3g} apart", fitted
    J = residuals.slope(states)
    return Fit(
        field, p, ending, detail, residuals.evaluations, residuals.of(states), J.T @ J, prior,
        found.active_mask != 0, states,
    )  # fmt: skip


def misfit(states: States, data: Sequence[tuple[float, Target]]) -> tuple[float, np.ndarray]:
    """½ Σ r² and its derivative by β at every point of the body, (m, q), by one transposed solve
    for each load: what a free field would have to change.

    Raises ValueError for targets without a matrix.
    """
    loads = [state.e for state in states.at]
    total, slopes = 0.0, [np.zeros_like(state.u) for state in states.at]
    for at, target in data:
        if not hasattr(target, "matrix"):
            raise ValueError(f"{type(target).__name__} has no matrix; take Cloud or Landmarks")
        k = loads.index(at)
        u = states.at[k].u
        r = target.residual(u)
        total += float(r @ r) / 2
        slopes[k] += (target.matrix(u).T @ r).reshape(u.shape)
    return total, sum(s.by_beta(slope) for s, slope in zip(states.at, slopes, strict=True))
