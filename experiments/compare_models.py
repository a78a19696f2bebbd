"""Which model predicts foldability best, and what does its accuracy cost in labels and seconds?

The table of the README: median over seeds, 6000 training and 1000 test designs (§4.7), every
accuracy also on fresh designs; then the network at a stated false-positive rate, the fraction of
proposed designs that the source confirms, and what the dissertation's formula gets as printed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.inverse.confirm import confirm
from foldlab.inverse.propose import propose
from foldlab.inverse.wish import Wish
from foldlab.labels.timoshenko import FULL_TURN, TimoshenkoSource
from foldlab.learning.compare import DISSERTATION, compare
from foldlab.learning.models import make_classifier
from foldlab.learning.operating_point import at_rate, loss_weight_curve, threshold_curve
from foldlab.learning.plots import plot_pareto, plot_trade_off
from foldlab.learning.scoring import score
from foldlab.learning.train import symbolic_options

from .common import main, save_figure

MODELS = ("tree", "distilled", "forest", "boosted", "dissertation", "network", "symbolic")


@dataclass(frozen=True)
class Config:
    seed: int = 0
    seeds: int = 5
    n_train: int = 6000
    n_test: int = 1000
    n_fresh: int = 200_000
    n_calibration: int = 12_000
    rate: float = 1e-3
    loss_weights: tuple[float, ...] = (1.0, 3.0, 10.0, 30.0)
    proposals: int = 1000
    symbolic_seconds: float = 60.0
    models: tuple[str, ...] = MODELS


TINY = Config(
    seeds=1,
    n_train=400,
    n_test=200,
    n_fresh=2000,
    n_calibration=400,
    rate=0.1,
    loss_weights=(1.0, 10.0),
    proposals=20,
    symbolic_seconds=1.0,
    models=("tree", "network", "symbolic"),
)


def run(config: Config, tracker) -> dict[str, Any]:
    if "network" not in config.models:
        raise InputError(
            f"models = {', '.join(config.models)}; the operating point and the proposals are the "
            "network's: add network"
        )
    source = TimoshenkoSource()
    rows, points, fractions, printed, front = [], [], [], [], None
    for seed in range(config.seed, config.seed + config.seeds):
        train, test, fresh, calibration = (
            source.evaluate(REDUCED.sample(n, seed=1000 * k + seed))
            for k, n in enumerate(
                (config.n_train, config.n_test, config.n_fresh, config.n_calibration)
            )
        )
        last = compare(
            config.models,
            REDUCED,
            train,
            test,
            fresh,
            seed=seed,
            options=symbolic_options(config.symbolic_seconds, seed),
        )
        rows += [{"seed": seed, **row} for row in last.rows]
        printed.append({"seed": seed, **score_of_equation_430(fresh)})
        network = last.models["network"]
        X, y = calibration[REDUCED.names], calibration["foldable"]
        careful, point = at_rate(network, X, y, rate=config.rate)
        result = score(careful, fresh[REDUCED.names], fresh["foldable"])
        points.append(
            {
                "seed": seed,
                "threshold": point.threshold,
                "false_positive_rate": result["false_positive_rate"],
                "upper_95": result["false_positive_rate_upper"],
                "recall": result["recall"],
                "labels": config.n_train + point.labels,
            }
        )
        answer = confirm(propose(Wish(), network, config.proposals, seed=seed), source, seed=seed)
        whole = sum(p.box_confirmed is True for p in answer.proposals) / len(answer.proposals)
        fractions.append(
            {
                "seed": seed,
                "proposals": len(answer.proposals),
                "confirmed": answer.confirmed_fraction,
                "boxes_confirmed": whole,
                "seconds": answer.seconds,
            }
        )
        print(f"seed {seed} done", file=sys.stderr)
        if seed == config.seed:
            curve = threshold_curve(network, fresh[REDUCED.names], fresh["foldable"])
            bias = loss_weight_curve(
                partial(make_classifier, "network", REDUCED, seed=seed),
                train[REDUCED.names],
                train["foldable"],
                fresh[REDUCED.names],
                fresh["foldable"],
                weights=config.loss_weights,
            )
            tracker.table("loss_weights", bias)
            figure = plot_trade_off(curve, bias, point=result, rate=config.rate)
            save_figure(figure, "trade_off")
            tracker.figure("trade_off", figure)
            for name, model in last.models.items():
                tracker.model(name, model, test[REDUCED.names].head())
            if "symbolic" in last.models:
                front = _front(last.models["symbolic"], fresh)
    seeds = pd.DataFrame(rows)
    tracker.table("per_seed", seeds)
    table = summary(seeds)
    for row in table:
        tracker.metrics(row, prefix=f"{row['model']}.")
    out = {
        "table": table,
        "operating_point": _medians(points),
        "inverse": _medians(fractions),
        "equation_430": {"stated": DISSERTATION["symbolic"], **_medians(printed)},
    }
    if front is not None:
        figure = plot_pareto(
            front,
            "size",
            "accuracy",
            axis_labels={"size": "nodes", "accuracy": "accuracy on fresh designs"},
        )
        save_figure(figure, "symbolic_front")
        tracker.figure("symbolic_front", figure)
        out["symbolic_front"] = front.to_dict("records")
    return out


def _front(symbolic, fresh: pd.DataFrame) -> pd.DataFrame:
    """The formulas of the front with their accuracy on fresh designs."""
    X, truth = fresh[REDUCED.names].to_numpy(), fresh["foldable"].to_numpy(bool)
    front = symbolic.front_
    accuracy = [float(np.mean((f(X) >= symbolic.threshold) == truth)) for f in front["formula"]]
    return front.assign(accuracy=accuracy, formula=front["formula"].map(str))


def equation_430(designs: pd.DataFrame) -> np.ndarray:
    """κ l_s / g by the formula printed as the dissertation's best (Eq. 4.30), (designs,)."""
    E, h, s = (designs[name].to_numpy() for name in ("E_ratio", "h_ratio", "slenderness"))
    return 1.19 / (s * h * (E**2 * h + 2.23) + 5.12 * s + s / (h * (h + 0.00521)))


def score_of_equation_430(labelled: pd.DataFrame) -> dict[str, float]:
    """Fraction that Eq. 4.30 gets right at the threshold of Eq. 4.26, and what folds anyway."""
    truth = labelled["foldable"].to_numpy(bool)
    right = (equation_430(labelled) >= FULL_TURN) == truth
    return {"accuracy": float(right.mean()), "always_yes": float(truth.mean())}


def summary(seeds: pd.DataFrame) -> list[dict[str, Any]]:
    """Medians over seeds, and the spread of the accuracy on fresh designs."""
    table = []
    for model, rows in seeds.groupby("model", sort=False):
        medians = rows.median(numeric_only=True)
        table.append(
            {
                "model": model,
                "accuracy": medians["accuracy"],
                "accuracy_fresh": medians["accuracy_fresh"],
                "fresh_min": rows["accuracy_fresh"].min(),
                "fresh_max": rows["accuracy_fresh"].max(),
                "false_positive_rate": medians["false_positive_rate"],
                "train_seconds": medians["train_seconds"],
                "seconds_per_million": medians["seconds_per_million"],
                "labels": int(medians["labels"]),
                "size": f"{medians['size']:.0f} {rows['size_unit'].iloc[0]}",
                "dissertation": rows["dissertation"].iloc[0],
            }
        )
    return table


def _medians(rows: list[dict]) -> dict[str, Any]:
    frame = pd.DataFrame(rows).drop(columns="seed")
    return {**frame.median().to_dict(), "per_seed": rows}


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
