"""Models side by side on the same labels: what accuracy costs in labels, seconds and size."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import pandas as pd

from foldlab.design import DesignSpace
from foldlab.learning.scoring import model_size, score
from foldlab.learning.train import fit

# Accuracy on 1000 test designs after 6000 labels (symbolic regression: 2000), §4.7.1–4.7.3.
# As stated: the formula printed with 0.76 gets 0.61 (Eq. 4.30, experiments/compare_models.py).
DISSERTATION = {"tree": 0.962, "symbolic": 0.76, "dissertation": 0.977}


@dataclass(frozen=True)
class Comparison:
    """``rows``: one dict per model; ``models``: the fitted models by name."""

    rows: list[dict[str, Any]]
    models: dict[str, Any]


def compare(
    names: Iterable[str],
    space: DesignSpace,
    train: pd.DataFrame,
    test: pd.DataFrame,
    fresh: pd.DataFrame,
    *,
    seed: int,
    options: dict[str, dict] | None = None,
    symbolic_labels: int = 2000,
) -> Comparison:
    """Train each model on ``train``; score it on ``test`` and on ``fresh``.

    The tables hold the groups and ``foldable``, and ``normalised_angle`` where the symbolic model
    takes part: it learns from the first ``symbolic_labels`` rows. ``options`` maps a model's name
    to its settings. Columns of a row: model, accuracy (on ``test``) and its 95 % interval,
    accuracy_fresh, false_positive_rate (on ``fresh``), train_seconds, seconds_per_million, labels,
    size, size_unit, dissertation.
    """
    rows, models = [], {}
    for name in names:
        table = train.head(symbolic_labels) if name == "symbolic" else train
        start = time.perf_counter()
        model = fit(name, space, table, seed=seed, **(options or {}).get(name, {}))
        seconds = time.perf_counter() - start
        small = score(model, test[space.names], test["foldable"])
        large = score(model, fresh[space.names], fresh["foldable"])
        size, unit = model_size(model)
        rows.append(
            {
                "model": name,
                "accuracy": small["accuracy"],
                "accuracy_low": small["accuracy_interval"][0],
                "accuracy_high": small["accuracy_interval"][1],
                "accuracy_fresh": large["accuracy"],
                "false_positive_rate": large["false_positive_rate"],
                "train_seconds": seconds,
                "seconds_per_million": large["seconds_per_million"],
                "labels": len(table),
                "size": size,
                "size_unit": unit,
                "dissertation": DISSERTATION.get(name),
            }
        )
        models[name] = model
    return Comparison(rows, models)


def readable(rows: list[dict[str, Any]]) -> list[dict[str, str]]:
    """Rows of :func:`compare` as short texts for a printed table."""
    return [
        {
            "model": row["model"],
            "1000 test": f"{row['accuracy']:.3f}",
            "95 % interval": f"{row['accuracy_low']:.3f}–{row['accuracy_high']:.3f}",
            "fresh": f"{row['accuracy_fresh']:.4f}",
            "false pos.": f"{row['false_positive_rate']:.4f}",
            "train s": f"{row['train_seconds']:.1f}",
            "s / 10⁶": f"{row['seconds_per_million']:.2f}",
            "labels": str(row["labels"]),
            "size": f"{row['size']} {row['size_unit']}",
            "dissertation": f"{row['dissertation']:.3f}" if row["dissertation"] else "–",
        }
        for row in rows
    ]
