"""Recursive boundary augmentation (Algorithm 5) and its random baseline.

Train n epochs, look where the network is unsure (p in [0.4, 0.6]), label designs there, add them,
repeat. The baseline adds as many random designs per cycle and trains for the same number of epochs,
so that both strategies have used the same labels and the same training at every point of the curve.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from sklearn.exceptions import ConvergenceWarning

from foldlab.design import DesignSpace
from foldlab.errors import InputError
from foldlab.labels.label import LabelSource, labels_to_frame
from foldlab.learning.models import make_classifier
from foldlab.learning.train import known_labels

STRATEGIES = ("boundary", "random")


@dataclass(frozen=True)
class Plan:
    """How labels are spent: ``initial`` at first, then ``per_cycle`` in each further cycle."""

    initial: int = 200
    per_cycle: int = 100
    cycles: int = 10
    epochs: int = 200
    band: tuple[float, float] = (0.4, 0.6)
    candidates: int = 20_000

    def __post_init__(self):
        for name in ("initial", "per_cycle", "cycles", "epochs", "candidates"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {getattr(self, name)}; expected at least 1")
        low, high = self.band
        if not 0 <= low < 0.5 < high <= 1:
            raise InputError(
                f"band = {low:g} … {high:g}; expected an interval of probabilities around 0.5"
            )
        if self.per_cycle > self.candidates:
            raise InputError(
                f"per_cycle = {self.per_cycle} exceeds candidates = {self.candidates}; "
                "draw more candidates"
            )


@dataclass(frozen=True)
class Augmented:
    """Result of one run: the last model, every labelled design, and one row per cycle.

    ``curve`` has columns strategy, seed, cycle, labels, accuracy, in_band (fraction of the
    added designs whose p lay in the band; the rest are the nearest to 0.5), unknown, seconds.
    """

    model: Any
    labels: pd.DataFrame
    curve: pd.DataFrame


def augment(
    space: DesignSpace,
    source: LabelSource | Callable[[pd.DataFrame], pd.DataFrame],
    make_model: Callable[[int, int], Any],
    *,
    strategy: str = "boundary",
    plan: Plan | None = None,
    seed: int,
    test: tuple[pd.DataFrame, np.ndarray],
    pool: pd.DataFrame | None = None,
    expand: Callable[[pd.DataFrame], pd.DataFrame] | None = None,
) -> Augmented:
    """Run Algorithm 5 (``strategy='boundary'``) or its baseline (``'random'``).

    ``source``: a label source, or a function that labels a table of designs, row by row as they
    come. ``make_model(seed, epochs)`` returns an unfitted classifier whose ``fit`` trains that many
    epochs; where it has ``continue_fit(X, y, epochs=…)`` it goes on learning, else it is fitted
    anew in each cycle. ``test`` is (designs, labels) that nothing else sees. ``pool``: the designs
    that there are to choose from, each once, instead of fresh ones from the space. ``expand``: what
    the labels so far teach besides, such as :func:`foldlab.learning.along.states_as_labels`.
    Designs that the source can't label are counted and left out of the training. Raises
    :class:`InputError` for an unknown strategy, a pool that is too small, or when the first labels
    are all of one class.
    """
    if strategy not in STRATEGIES:
        raise InputError(f"no strategy {strategy!r}; there are: {', '.join(STRATEGIES)}")
    plan = plan or Plan()
    wanted = plan.initial + plan.per_cycle * (plan.cycles - 1)
    if pool is not None and len(pool) < wanted:
        raise InputError(f"the pool has {len(pool)} designs, and the plan asks for {wanted}")
    start = time.perf_counter()
    draws = np.random.SeedSequence(seed).generate_state(2 * plan.cycles)
    model = make_model(seed, plan.epochs)
    designs = _Designs(space, pool)
    added, in_band = designs.some(plan.initial, int(draws[0])), np.nan
    table, rows, asked = pd.DataFrame(), [], 0
    for cycle in range(plan.cycles):
        if cycle:
            added, in_band = _next_designs(
                designs, model, strategy, plan, draws[2 * cycle : 2 * cycle + 2]
            )
        designs.take(added)
        table = pd.concat([table, _label(source, added)], ignore_index=True)
        asked += len(added)
        known = table[table["foldable"].notna()]
        y = known["foldable"].to_numpy(bool)
        if y.all() or not y.any():
            raise InputError(
                f"the first {len(y)} labels are all {bool(y.any())}; raise initial above "
                f"{plan.initial} so that both classes are seen"
            )
        if expand is not None:
            columns = [*space.names, "foldable"]
            known = pd.concat([known[columns], expand(known)[columns]], ignore_index=True)
            y = known["foldable"].to_numpy(bool)
        with warnings.catch_warnings():
            # A cycle is a part of the training; only the whole of it could be said to converge.
            warnings.simplefilter("ignore", ConvergenceWarning)
            if cycle and hasattr(model, "continue_fit"):
                model.continue_fit(known[space.names], y, epochs=plan.epochs)
            else:
                model.fit(known[space.names], y)
        rows.append(
            {
                "strategy": strategy,
                "seed": seed,
                "cycle": cycle,
                "labels": asked,
                "accuracy": float(np.mean(model.predict(test[0]) == test[1])),
                "in_band": in_band,
                "unknown": int(table["foldable"].isna().sum()),
                "seconds": time.perf_counter() - start,
            }
        )
    return Augmented(model, table, pd.DataFrame(rows))


class _Designs:
    """What there is to label: fresh designs of a space, or what is left of a pool."""

    def __init__(self, space: DesignSpace, pool: pd.DataFrame | None):
        self._space = space
        self._rest = None if pool is None else pool[space.names]

    def some(self, n: int, seed: int) -> pd.DataFrame:
        """``n`` of them at random, or all there are; a pool's keep their index."""
        if self._rest is None:
            return self._space.sample(n, seed=seed)
        return self._rest.sample(min(n, len(self._rest)), random_state=seed)

    def take(self, designs: pd.DataFrame) -> None:
        """These are labelled now."""
        if self._rest is not None:
            self._rest = self._rest.drop(designs.index)


def _next_designs(
    designs: _Designs, model, strategy: str, plan: Plan, draws
) -> tuple[pd.DataFrame, float]:
    if strategy == "random":
        return designs.some(plan.per_cycle, int(draws[0])), np.nan
    some = designs.some(plan.candidates, int(draws[0]))
    folds = list(model.classes_).index(True)
    p = model.predict_proba(some)[:, folds]
    inside = (p >= plan.band[0]) & (p <= plan.band[1])
    band = np.flatnonzero(inside)
    if len(band) >= plan.per_cycle:
        rng = np.random.default_rng(int(draws[1]))
        chosen = rng.choice(band, plan.per_cycle, replace=False)
    else:
        # A well-trained network leaves few designs in the band: the nearest to 0.5 fill the cycle.
        chosen = np.lexsort((np.abs(p - 0.5), ~inside))[: plan.per_cycle]
    return some.iloc[chosen], min(1.0, len(band) / plan.per_cycle)


def _label(
    source: LabelSource | Callable[[pd.DataFrame], pd.DataFrame], designs: pd.DataFrame
) -> pd.DataFrame:
    if callable(source):
        return source(designs)
    if hasattr(source, "label_many"):
        return labels_to_frame(source.label_many(designs))
    return labels_to_frame([source.label(design) for design in designs.to_dict("records")])


def labels_to_reach(curve: pd.DataFrame, accuracy: float) -> float:
    """Labels at which the median accuracy over seeds first reaches ``accuracy``.

    ``curve`` holds one strategy with columns labels and accuracy; linear between cycles; infinite
    if the curve ends below.
    """
    median = curve.groupby("labels")["accuracy"].median()
    labels, values = median.index.to_numpy(float), median.to_numpy()
    reached = np.flatnonzero(values >= accuracy)
    if not len(reached):
        return float("inf")
    k = int(reached[0])
    if k == 0:
        return float(labels[0])
    return float(np.interp(accuracy, values[k - 1 : k + 1], labels[k - 1 : k + 1]))


def compare_strategies(
    source: LabelSource,
    plan: Plan,
    *,
    seeds: Iterable[int],
    target: float = 0.99,
    test_designs: int = 20_000,
    make_model: Callable[[int, int], Any] | None = None,
    progress: Callable[[str], None] | None = None,
    test: pd.DataFrame | None = None,
    label: Callable[[pd.DataFrame], pd.DataFrame] | None = None,
    **options,
) -> tuple[pd.DataFrame, dict[str, float]]:
    """Algorithm 5 against its baseline over several seeds, on the same test designs.

    ``test``: a table of labels that were made before; without one ``test_designs`` fresh designs
    are labelled, which only a source that is a formula can afford. ``label``: how designs are
    labelled, if not one after the other by the source here. ``options``: those of :func:`augment`.

    Returns the curves of :func:`augment` and a summary: for each strategy ``labels_STRATEGY``
    (median labels to reach ``target``, infinite if it was not reached) and
    ``final_accuracy_STRATEGY``, and ``ratio`` = boundary / random labels (None if one is infinite).
    Raises :class:`InputError` for a ``target`` that is no accuracy, and for a source that is no
    formula without ``test``.
    """
    if not 0 < target <= 1:
        raise InputError(f"target = {target:g}; an accuracy lies above 0 and is at most 1")
    space = source.space
    if test is None and not hasattr(source, "label_many"):
        raise InputError(
            f"the source {source.name!r} is no formula, and {test_designs} test designs would cost "
            "more than the comparison: give a table of test labels"
        )
    if test is None:
        designs = space.sample(test_designs, seed=2**31 - 1)
        test = designs.assign(foldable=_label(source, designs)["foldable"])
    known, _ = known_labels(test, space)
    labelled = known[space.names], known["foldable"].to_numpy(bool)
    make_model = make_model or partial(_default_network, space)
    curves = []
    for seed in seeds:
        for strategy in STRATEGIES:
            result = augment(
                space, label or source, make_model, strategy=strategy, plan=plan, seed=seed,
                test=labelled, **options,
            )  # fmt: skip
            curves.append(result.curve)
            if progress:
                last = result.curve.iloc[-1]
                progress(
                    f"seed {seed}, {strategy}: accuracy {last['accuracy']:.4f} after "
                    f"{last['labels']} labels, {last['seconds']:.1f} s"
                )
    table = pd.concat(curves, ignore_index=True)
    summary: dict[str, Any] = {"target": target}
    for strategy, rows in table.groupby("strategy"):
        summary[f"labels_{strategy}"] = labels_to_reach(rows, target)
        last = rows[rows["cycle"] == rows["cycle"].max()]
        summary[f"final_accuracy_{strategy}"] = float(last["accuracy"].median())
    ratio = summary["labels_boundary"] / summary["labels_random"]
    summary["ratio"] = ratio if np.isfinite(ratio) and ratio > 0 else None
    return table, summary


def _default_network(space: DesignSpace, seed: int, epochs: int):
    return make_classifier("network", space, seed=seed, epochs=epochs)
