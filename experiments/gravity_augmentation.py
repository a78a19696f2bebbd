"""How many labels does choosing near the boundary (Algorithm 5) save under weight?

Labels of the gravity dataset are drawn from as if they were made one by one: those that a model is
least sure of, or any. The same number each, the same test labels, several seeds; with the states
along each path as further labels, which cost nothing, and without. What a strategy's labels cost is
what they took when they were made.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.learning.along import states_as_labels
from foldlab.learning.augment import STRATEGIES, Plan, augment, labels_to_reach
from foldlab.learning.models import make_classifier
from foldlab.learning.plots import plot_learning_curves

from .common import counted, main, save_figure


@dataclass(frozen=True)
class Config:
    seed: int = 0
    seeds: int = 5
    dataset: str = "gravity"
    growth: str = "uniaxial"
    model: str = "boosted"
    test: int = 1500
    targets: tuple[float, ...] = (0.97, 0.98, 0.985)
    plan: Plan = field(default_factory=lambda: Plan(initial=50, per_cycle=25, cycles=31))


TINY = Config(seeds=1, model="tree", targets=(0.7,), plan=Plan(initial=60, per_cycle=20, cycles=3))


def run(config: Config, tracker) -> dict[str, Any]:
    table = load_dataset(config.dataset, growth=config.growth, space="full")
    table = table[counted(table)].sort_values("growth", kind="stable").reset_index(drop=True)
    curves = []
    for seed in range(config.seed, config.seed + config.seeds):
        shuffled = table.sample(frac=1.0, random_state=seed)
        known = shuffled[shuffled["foldable"].notna()]
        test, pool = known.iloc[: config.test], shuffled.drop(known.index[: config.test])
        truth = test[FULL.names], test["foldable"].to_numpy(bool)
        for strategy in STRATEGIES:
            for states in (False, True):
                result = augment(
                    FULL,
                    lambda designs, pool=pool: pool.loc[designs.index],
                    lambda seed, _: make_classifier(config.model, FULL, seed=seed),
                    strategy=strategy, plan=config.plan, seed=seed, test=truth, pool=pool,
                    expand=states_as_labels if states else None,
                )  # fmt: skip
                name = f"{strategy}, states" if states else strategy
                curve = result.curve.assign(strategy=name)
                spent = result.labels["core_seconds"].fillna(0).cumsum().to_numpy()
                curve["core_seconds"] = spent[curve["labels"].to_numpy() - 1]
                curves.append(curve)
                last = curve.iloc[-1]
                print(
                    f"seed {seed}, {name}: {last['accuracy']:.4f} after {last['labels']} labels",
                    file=sys.stderr,
                )
    curves = pd.concat(curves, ignore_index=True)
    tracker.table("curves", curves)
    figure = plot_learning_curves(curves, target=config.targets[-1], as_error=True)
    save_figure(figure, "gravity_augmentation")
    tracker.figure("gravity_augmentation", figure)
    rows = reached_by(curves, config.targets)
    final = curves[curves["labels"] == curves["labels"].max()].groupby("strategy")["accuracy"]
    return {
        "ratio": ratios_of(rows, config.targets),
        "final_accuracy": final.median().to_dict(),
        "final_labels": int(curves["labels"].max()),
        "test_labels": config.test,
        "seeds": config.seeds,
        "table": [
            {**row, "labels": row["labels"] if np.isfinite(row["labels"]) else None} for row in rows
        ],
    }


def reached_by(curves: pd.DataFrame, targets: tuple[float, ...]) -> list[dict[str, Any]]:
    """Labels, and core-seconds of them in the median over seeds, at which each strategy reaches
    each accuracy; infinitely many and None where it doesn't."""
    rows = []
    for name, own in curves.groupby("strategy"):
        at = own.groupby("labels")["core_seconds"].median()
        for target in targets:
            labels = labels_to_reach(own, target)
            costs = float(np.interp(labels, at.index, at)) if np.isfinite(labels) else None
            rows.append(
                {"strategy": name, "accuracy": target, "labels": labels, "core_seconds": costs}
            )
    return rows


def ratios_of(rows: list[dict[str, Any]], targets: tuple[float, ...]) -> dict[str, float | None]:
    """Labels near the boundary over labels at random for each accuracy, with the states along paths
    and without; None where one of them did not reach it."""
    reached = {(row["strategy"], row["accuracy"]): row["labels"] for row in rows}
    ratios = {}
    for target in targets:
        for suffix in ("", ", states"):
            near, random = (reached[name + suffix, target] for name in STRATEGIES)
            both = np.isfinite([near, random]).all()
            ratios[f"{target:g}{suffix}"] = float(near / random) if both else None
    return ratios


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
