"""Regime maps: where a classifier predicts folding, and where a source agrees (Figs. 4.28, 4.29).

A map is a grid over two groups, repeated on slices of a third; the remaining groups are held. Grid
points are the centres of equal cells on each group's own scale, so the cells tile the bounds.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
import pandas as pd

from foldlab.design import REDUCED, DesignSpace
from foldlab.errors import InputError
from foldlab.labels.label import _as_bool, truth_of
from foldlab.learning.features import _columns_for, probability_of_folding

SLICES = 9
POINTS = 100_000
# About 25 bytes each in the map itself and ten times that on the way; no picture shows more.
MOST_POINTS = 10**7


class Verdict(IntEnum):
    """A prediction against the truth; the values index rows of colours and counts."""

    TRUE_POSITIVE = 0
    TRUE_NEGATIVE = 1
    FALSE_POSITIVE = 2
    FALSE_NEGATIVE = 3
    UNKNOWN = 4


@dataclass(frozen=True)
class RegimeMap:
    """A regime map. Arrays over the grid have shape (slices, y values, x values).

    ``predicted`` is the classifier's decision, ``probability`` its P(foldable). ``truth`` is 1, 0,
    or −1 where the source could not tell; None without a source. ``margin`` is the source's signed
    distance to its own boundary, None where it gives none. Seconds are wall clock. ``beside``: name
    and margin of another source, to compare boundaries.
    """

    space: DesignSpace
    x: str
    y: str
    slice_by: str
    x_values: np.ndarray
    y_values: np.ndarray
    slices: np.ndarray
    fixed: Mapping[str, float]
    probability: np.ndarray = field(repr=False)
    predicted: np.ndarray = field(repr=False)
    seconds: float
    classifier: str = ""
    threshold: float | None = None
    truth: np.ndarray | None = field(default=None, repr=False)
    margin: np.ndarray | None = field(default=None, repr=False)
    source: str = ""
    source_seconds: float = 0.0
    beside: tuple[str, np.ndarray] | None = field(default=None, repr=False)

    def plot(self, **options):
        """The map as a Matplotlib figure; options as in :func:`foldlab.maps.plots.plot_regimes`."""
        from foldlab.maps.plots import plot_regimes

        return plot_regimes(self, **options)

    @property
    def points(self) -> int:
        return self.predicted.size

    @property
    def verdicts(self) -> np.ndarray:
        """:class:`Verdict` of every grid point, int8; raises :class:`InputError` without truth."""
        if self.truth is None:
            raise InputError("this map was not validated; give regime_map a label source")
        verdict = np.where(
            self.predicted,
            np.where(self.truth == 1, Verdict.TRUE_POSITIVE, Verdict.FALSE_POSITIVE),
            np.where(self.truth == 0, Verdict.TRUE_NEGATIVE, Verdict.FALSE_NEGATIVE),
        )
        return np.where(self.truth < 0, Verdict.UNKNOWN, verdict).astype(np.int8)

    @property
    def slice_counts(self) -> pd.DataFrame:
        """Points per slice (rows) and per verdict (columns)."""
        counts = [np.bincount(v.ravel(), minlength=len(Verdict)) for v in self.verdicts]
        index = pd.Index(self.slices, name=self.slice_by)
        return pd.DataFrame(counts, index=index, columns=[v.name.lower() for v in Verdict])

    @property
    def counts(self) -> dict[str, int]:
        """Points per verdict over the whole map."""
        return {name: int(n) for name, n in self.slice_counts.sum().items()}

    @property
    def accuracy(self) -> float | None:
        """Correct over known points; None if no point is known."""
        n = self.counts
        right = n["true_positive"] + n["true_negative"]
        return _fraction(right, right + n["false_positive"] + n["false_negative"])

    @property
    def false_positive_rate(self) -> float | None:
        """Fraction of the designs that do not fold which are predicted to; None without any."""
        n = self.counts
        return _fraction(n["false_positive"], n["false_positive"] + n["true_negative"])

    @property
    def recall(self) -> float | None:
        """Fraction of the designs that fold which are predicted to; None if there are none."""
        n = self.counts
        return _fraction(n["true_positive"], n["true_positive"] + n["false_negative"])

    def summary(self) -> dict:
        """Plain numbers for a log or JSON."""
        out = {
            "space": self.space.name,
            "axes": [self.x, self.y],
            "slice_by": self.slice_by,
            "slices": [float(s) for s in self.slices],
            "fixed": dict(self.fixed),
            "points": self.points,
            "classifier": self.classifier,
            "threshold": self.threshold,
            "predicted_foldable": int(self.predicted.sum()),
            "seconds": self.seconds,
        }
        if self.truth is not None:
            out |= {
                "source": self.source,
                "source_seconds": self.source_seconds,
                **self.counts,
                "accuracy": self.accuracy,
                "false_positive_rate": self.false_positive_rate,
                "recall": self.recall,
            }
        return out


def _fraction(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def regime_map(
    classifier,
    *,
    space: DesignSpace = REDUCED,
    axes: tuple[str, str] = ("E_ratio", "h_ratio"),
    slice_by: str = "slenderness",
    slices=None,
    fixed: Mapping[str, float] | None = None,
    points: int = POINTS,
    source=None,
    threshold: float | None = None,
    executor: Executor | None = None,
    beside: tuple[str, Any] | None = None,
) -> RegimeMap:
    """Map a classifier over two groups on slices of a third, validated if a ``source`` is given.

    ``slices``: values of ``slice_by``; by default nine from bound to bound on its own scale, which
    for the slenderness are 10^(−3 … −1) in steps of 10^0.25 (Fig. 4.28). ``fixed``: a value for
    each remaining group of the space. ``points``: at least so many in total, on square slices;
    at most :data:`MOST_POINTS`.
    ``threshold``: predict folding where P ≥ threshold (Eq. 4.31); without one the classifier's own
    ``predict`` decides. ``executor`` serves sources that label one design at a time. ``beside``: a
    name and a source that gives margins, such as that of the same units without weight.

    Raises :class:`InputError` for unknown, repeated or missing groups and values out of bounds.
    """
    x, y = _check_axes(space, axes, slice_by, fixed or {})
    fixed = {name: float(value) for name, value in (fixed or {}).items()}
    if slices is None:
        slices = space[slice_by].from_unit(np.linspace(0, 1, SLICES))
    slices = np.atleast_1d(np.asarray(slices, dtype=float))
    if points > MOST_POINTS:
        raise InputError(f"{points} points; a map has at most {MOST_POINTS}, more show nothing")
    side = int(np.ceil(np.sqrt(max(points, 1) / max(len(slices), 1)) - 1e-9))
    if points < 1 or len(slices) < 1:
        raise InputError(f"{points} points on {len(slices)} slices; give at least one of each")
    if threshold is not None and not 0 <= threshold <= 1:
        raise InputError(f"threshold = {threshold:g}; a probability lies between 0 and 1")
    cells = (np.arange(side) + 0.5) / side
    x_values, y_values = space[x].from_unit(cells), space[y].from_unit(cells)
    shape = (len(slices), side, side)
    s, b, a = np.meshgrid(slices, y_values, x_values, indexing="ij")
    columns = {slice_by: s.ravel(), y: b.ravel(), x: a.ravel()}
    columns |= {name: np.full(s.size, value) for name, value in fixed.items()}
    designs = space.validate(pd.DataFrame(columns))

    start = time.perf_counter()
    probability = probability_of_folding(classifier, designs)
    if threshold is None:
        answers = classifier.predict(_columns_for(classifier, designs))
        predicted = np.array([_as_bool(v) for v in np.unique(answers)])[
            np.unique(answers, return_inverse=True)[1]
        ]
    else:
        predicted = probability >= threshold
    seconds = time.perf_counter() - start

    truth = margin = None
    start = time.perf_counter()
    if source is not None:
        foldable, margin = truth_of(source, designs, executor=executor)
        truth = foldable.astype("Int8").to_numpy(dtype=np.int8, na_value=-1).reshape(shape)
        seconds_of_source = time.perf_counter() - start
        margin = None if margin is None else margin.reshape(shape)
    other = None
    if beside is not None:
        margins = truth_of(beside[1], designs)[1]
        if margins is None:
            raise InputError(f"the source {beside[1].name!r} gives no margins to draw beside a map")
        other = beside[0], margins.reshape(shape)
    return RegimeMap(
        space=space,
        x=x,
        y=y,
        slice_by=slice_by,
        x_values=x_values,
        y_values=y_values,
        slices=slices,
        fixed=fixed,
        probability=probability.reshape(shape),
        predicted=predicted.reshape(shape),
        seconds=seconds,
        classifier=type(classifier).__name__,
        threshold=threshold,
        truth=truth,
        margin=margin,
        source="" if source is None else source.name,
        source_seconds=0.0 if source is None else seconds_of_source,
        beside=other,
    )


def held_in_the_middle(
    space: DesignSpace, used: Collection[str], fixed: Mapping[str, float]
) -> dict[str, float]:
    """A value for each group of the space that is not ``used``: that of ``fixed``, or the middle of
    its bounds on its own scale. Raises :class:`InputError` for fixed groups that don't exist."""
    for name in fixed:
        space[name]
    middle = {name: float(space[name].from_unit(0.5)) for name in space.names if name not in used}
    return middle | dict(fixed)


def to_verify(regime: RegimeMap, n: int, *, seed: int) -> pd.DataFrame:
    """``n`` designs of a map for a slower source to check: half of them among the tenth of the grid
    nearest to the classifier's boundary, half anywhere; columns are the groups of the space.

    Raises :class:`InputError` for fewer than 1 or more than there are points.
    """
    if not 1 <= n <= regime.points:
        raise InputError(f"{n} points to verify; expected 1 to {regime.points}, those of the map")
    rng = np.random.default_rng(seed)
    level = 0.5 if regime.threshold is None else regime.threshold
    # Ties, as of trees, in no order.
    order = np.lexsort((rng.random(regime.points), np.abs(regime.probability.ravel() - level)))
    near = order[: max(regime.points // 10, -(-n // 2))]
    chosen = rng.choice(near, -(-n // 2), replace=False)
    rest = np.setdiff1d(order, chosen)
    chosen = np.concatenate([chosen, rng.choice(rest, n - len(chosen), replace=False)])
    s, b, a = np.unravel_index(chosen, regime.probability.shape)
    columns = {name: np.full(n, value) for name, value in regime.fixed.items()}
    columns |= {regime.slice_by: regime.slices[s], regime.y: regime.y_values[b]}
    columns |= {regime.x: regime.x_values[a]}
    designs = pd.DataFrame(columns)[regime.space.names]
    return designs.assign(predicted=regime.predicted.ravel()[chosen])


def _check_axes(space, axes, slice_by, fixed) -> tuple[str, str]:
    if len(axes) != 2:
        raise InputError(f"axes = {axes!r}; expected two names of groups")
    used = [*axes, slice_by, *fixed]
    for name in used:
        space[name]
    twice = sorted({name for name in used if used.count(name) > 1})
    if twice:
        raise InputError(
            f"{', '.join(twice)} is used more than once among axes, slices and fixed groups; "
            "use each group once"
        )
    missing = [name for name in space.names if name not in used]
    if missing:
        raise InputError(
            f"{', '.join(missing)}: neither axis, slice nor fixed; give each a fixed value"
        )
    return axes[0], axes[1]
