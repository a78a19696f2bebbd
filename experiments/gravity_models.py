"""How well do models learn folding under weight from solver labels?

The gravity dataset, split once. Each model learns from the same labels and is scored on designs
that nothing else sees; each also gets a threshold for a stated false-positive rate from a third
part. The regime map under gravity shows the best model's answer over two groups on slices of a
third, with designs on it that the solver was asked about afterwards.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.model_selection import StratifiedKFold, train_test_split

from experiments.common import main, save_figure
from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.labels.asked import Effort
from foldlab.labels.foldability import Thresholds
from foldlab.labels.solver import SolverSource
from foldlab.learning.features import probability_of_folding
from foldlab.learning.operating_point import at_rate
from foldlab.learning.scoring import model_size, score
from foldlab.learning.train import fit, known_labels, symbolic_options
from foldlab.maps.plots import plot_regimes
from foldlab.maps.regimes import regime_map
from foldlab.tables import read_table

AXES, SLICED = ("E_ratio", "h_ratio"), "stiffness_to_weight"
HELD = {
    "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0, "aspect": 0.2,
    "slenderness": 4e-3, "contraction": 0.3,
}  # fmt: skip


@dataclass(frozen=True)
class Config:
    seed: int = 0
    dataset: str = "gravity-5k"
    models: tuple[str, ...] = ("tree", "boosted", "symbolic", "network")
    symbolic_seconds: float = 60.0
    test: float = 0.2
    calibration: float = 0.15
    rate: float = 0.02
    points: int = 60_000
    verified: int = 60
    limit: int = 0
    """Labels to use at most; 0: all."""


TINY = Config(
    models=("tree", "symbolic"), symbolic_seconds=2.0, points=600, verified=2, limit=400, rate=0.3
)


def run(config: Config, tracker) -> dict[str, Any]:
    path = config.dataset
    table = read_table(path) if path.endswith(".parquet") else load_dataset(path)
    table["threshold"] = Thresholds().turning
    uniaxial = table[table["growth"] == "uniaxial"]
    if config.limit:
        uniaxial = uniaxial.head(config.limit)
    known, unknown = known_labels(uniaxial, FULL)
    known[["normalised_angle", "threshold"]] = uniaxial[["normalised_angle", "threshold"]]
    if known["foldable"].nunique() < 2:
        raise InputError("all labels of the dataset say the same; there is nothing to learn")
    options = {"random_state": config.seed, "stratify": known["foldable"]}
    rest, test = train_test_split(known, test_size=config.test, **options)
    options["stratify"] = rest["foldable"]
    train, calibration = train_test_split(rest, test_size=config.calibration, **options)
    X, y = test[FULL.names], test["foldable"]
    special = symbolic_options(config.symbolic_seconds, config.seed)
    rows, models = [], {}
    for name in config.models:
        start = time.perf_counter()
        model = fit(name, FULL, train, seed=config.seed, **special.get(name, {}))
        seconds = time.perf_counter() - start
        size, unit = model_size(model)
        result = score(model, X, y)
        try:
            careful, _ = at_rate(
                model, calibration[FULL.names], calibration["foldable"], rate=config.rate
            )
            cautious = score(careful, X, y)
        except InputError as error:
            # A tree that is certain and wrong has no threshold for a small rate.
            print(f"{name}: {error}", file=sys.stderr)
            cautious = {"false_positive_rate": None, "recall": None}
        rows.append(
            {
                "model": name,
                "accuracy": result["accuracy"],
                "accuracy_low": result["accuracy_interval"][0],
                "accuracy_high": result["accuracy_interval"][1],
                "false_positive_rate": result["false_positive_rate"],
                "recall": result["recall"],
                "cautious_false_positive_rate": cautious["false_positive_rate"],
                "cautious_recall": cautious["recall"],
                "train_seconds": seconds,
                "size": f"{size} {unit}",
            }
        )
        models[name] = model
        tracker.model(name, model, X.head())
    best = max(rows, key=lambda row: row["accuracy"])["model"]
    out = {
        "labels": len(known),
        "unknown": unknown,
        "training": len(train),
        "test": len(test),
        "best": best,
        "isotropic": _isotropic(table, config),
        **_map(models[best], config, tracker),
        "table": rows,
    }
    if "symbolic" in models:
        out["formula"] = str(models["symbolic"].formula_)
    return out


def _isotropic(table: pd.DataFrame, config: Config) -> dict[str, Any]:
    """Five-fold accuracy of boosted trees on the labels of isotropic contraction."""
    part = table[(table["growth"] == "isotropic") & table["foldable"].notna()]
    fold_counts = part["foldable"].astype(bool).value_counts()
    if len(fold_counts) < 2 or fold_counts.min() < 5:
        return {"labels": len(part), "accuracy": None}
    X, y = part[FULL.names].reset_index(drop=True), part["foldable"].astype(bool).to_numpy()
    right = []
    for k, (fold, held) in enumerate(
        StratifiedKFold(5, shuffle=True, random_state=config.seed).split(X, y)
    ):
        model = fit("boosted", FULL, part.iloc[fold], seed=config.seed + k)
        right.append(float((model.predict(X.iloc[held]) == y[held]).mean()))
    return {
        "labels": len(part),
        "folds": int(y.sum()),
        "majority": float(max(y.mean(), 1 - y.mean())),
        "accuracy": float(np.mean(right)),
    }


def _map(model, config: Config, tracker) -> dict[str, Any]:
    slices = FULL[SLICED].from_unit((np.arange(6) + 0.5) / 6)
    regime = regime_map(
        model, space=FULL, axes=AXES, slice_by=SLICED, slices=slices, fixed=HELD,
        points=config.points,
    )  # fmt: skip
    rng = np.random.default_rng(config.seed)
    designs = pd.DataFrame(
        {
            **{name: FULL[name].from_unit(rng.random(config.verified)) for name in AXES},
            SLICED: rng.choice(slices, config.verified),
            **HELD,
        }
    )[FULL.names]
    source = SolverSource(effort=Effort(timeout=30.0))
    labels = [source.label(d) for d in designs.to_dict("records")]
    checked = designs.assign(foldable=pd.array([x.foldable for x in labels], dtype="boolean"))
    figure = plot_regimes(
        regime,
        points=checked,
        title="Folding under weight: predicted, and verified by the solver (points)",
    )
    save_figure(figure, "regimes_gravity")
    tracker.figure("regimes_gravity", figure)
    told = checked["foldable"].notna()
    predicted = probability_of_folding(model, designs[told]) >= 0.5
    agreed = predicted == checked.loc[told, "foldable"].to_numpy(bool)
    return {
        "map_points": regime.points,
        "verified": int(told.sum()),
        "verified_agree": float(agreed.mean()) if len(agreed) else None,
    }


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
