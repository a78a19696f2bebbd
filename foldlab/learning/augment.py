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
    source: LabelSource,
    make_model: Callable[[int, int], Any],
    *,
    strategy: str = "boundary",
    plan: Plan | None = None,
    seed: int,
    test: tuple[pd.DataFrame, np.ndarray],
) -> Augmented:
    """Run Algorithm 5 (``strategy='boundary'``) or its baseline (``'random'``).

    ``make_model(seed, epochs)`` returns an unfitted classifier whose ``fit`` trains that many
    epochs and which has ``continue_fit(X, y, epochs=…)``; ``test`` is (designs, labels) that
    nothing else sees. Designs that the source can't label are
    counted and left out of the training. Raises :class:`InputError` for an unknown strategy, or
    when the first labels are all of one class.
    """
    if strategy not in STRATEGIES:
        raise InputError(f"no strategy {strategy!r}; there are: {', '.join(STRATEGIES)}")
    plan = plan or Plan()
    start = time.perf_counter()
    draws = np.random.SeedSequence(seed).generate_state(2 * plan.cycles)
    model = make_model(seed, plan.epochs)
    added, in_band = space.sample(plan.initial, seed=int(draws[0])), np.nan
    table, rows, asked = pd.DataFrame(), [], 0
    for cycle in range(plan.cycles):
        if cycle:
            added, in_band = _next_designs(
                space, model, strategy, plan, draws[2 * cycle : 2 * cycle + 2]
            )
        table = pd.concat([table, _label(source, added)], ignore_index=True)
        asked += len(added)
        known = table[table["foldable"].notna()]
        y = known["foldable"].to_numpy(bool)
        if y.all() or not y.any():
            raise InputError(
                f"the first {len(y)} labels are all {bool(y.any())}; raise initial above "
                f"{plan.initial} so that both classes are seen"
            )
        with warnings.catch_warnings():
            # A cycle is a part of the training; only the whole of it could be said to converge.
            warnings.simplefilter("ignore", ConvergenceWarning)
            if cycle:
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


def _next_designs(space, model, strategy, plan, draws) -> tuple[pd.DataFrame, float]:
    if strategy == "random":
        return space.sample(plan.per_cycle, seed=int(draws[0])), np.nan
    pool = space.sample(plan.candidates, seed=int(draws[0]))
    folds = list(model.classes_).index(True)
    p = model.predict_proba(pool)[:, folds]
    inside = (p >= plan.band[0]) & (p <= plan.band[1])
    band = np.flatnonzero(inside)
    if len(band) >= plan.per_cycle:
        rng = np.random.default_rng(int(draws[1]))
        chosen = rng.choice(band, plan.per_cycle, replace=False)
    else:
        # A well-trained network leaves few designs in the band: the nearest to 0.5 fill the cycle.
        chosen = np.lexsort((np.abs(p - 0.5), ~inside))[: plan.per_cycle]
    return pool.iloc[chosen].reset_index(drop=True), min(1.0, len(band) / plan.per_cycle)


def _label(source: LabelSource, designs: pd.DataFrame) -> pd.DataFrame:
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
) -> tuple[pd.DataFrame, dict[str, float]]:
    """Algorithm 5 against its baseline over several seeds, on the same fresh test designs.

    Returns the curves of :func:`augment` and a summary: for each strategy ``labels_STRATEGY``
    (median labels to reach ``target``, infinite if it was not reached) and
    ``final_accuracy_STRATEGY``, and ``ratio`` = boundary / random labels (None if one is infinite).
    Raises :class:`InputError` for a ``target`` that is no accuracy.
    """
    if not 0 < target <= 1:
        raise InputError(f"target = {target:g}; an accuracy lies above 0 and is at most 1")
    space = source.space
    designs = space.sample(test_designs, seed=2**31 - 1)
    truth = _label(source, designs)["foldable"]
    test = (designs[truth.notna()], truth[truth.notna()].to_numpy(bool))
    make_model = make_model or partial(_default_network, space)
    curves = []
    for seed in seeds:
        for strategy in STRATEGIES:
            result = augment(
                space, source, make_model, strategy=strategy, plan=plan, seed=seed, test=test
            )
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
    from foldlab.learning.network import SmoothNetwork  # torch takes seconds to import

    return SmoothNetwork(space, epochs=epochs, random_state=seed)
