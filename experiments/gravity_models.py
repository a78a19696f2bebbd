"""How well do models learn folding under weight from solver labels, and what does physics add?

The gravity dataset's solid layers in five folds: each label is predicted by a model that has not
seen it. Of what it says only designs of the Latin hypercube count, half of the labels; the other
half lies near the boundary, to learn from, and is told apart (``near``). Each model sees the groups
alone, beside them what beam theory says ("physics"), or a rod's answer too ("rod"). One half of
these predictions chooses the threshold for a stated false-positive rate, the other is what it is
stated on; so are the answers and the don't knows of a stated coverage. The learning curve says how
many labels physics is worth. The regime map under gravity shows the best model that needs no rod
over two groups on slices of a third, with designs on it that the solver was asked about afterwards.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.model_selection import StratifiedKFold

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.asked import Effort
from foldlab.labels.foldability import Thresholds
from foldlab.labels.rod import rod_of
from foldlab.labels.solver import SolverSource
from foldlab.learning.conformal import borders_of
from foldlab.learning.features import probability_of_folding
from foldlab.learning.operating_point import threshold_of
from foldlab.learning.plots import plot_learning_curves, plot_reliability
from foldlab.learning.saving import SHIPPED, save_model
from foldlab.learning.scoring import (
    angle_errors,
    calibration_error,
    model_size,
    reliability,
    upper_bound,
)
from foldlab.learning.train import fit, fit_angle, known_labels, symbolic_options, train_on
from foldlab.maps.plots import plot_regimes
from foldlab.maps.regimes import regime_map
from foldlab.tables import read_table
from foldlab.tracking import commit

from .common import counted, main, save_figure

AXES, SLICED = ("E_ratio", "h_ratio"), "stiffness_to_weight"
HELD = {
    "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0, "aspect": 0.2,
    "slenderness": 4e-3, "contraction": 0.3,
}  # fmt: skip


@dataclass(frozen=True)
class Config:
    seed: int = 0
    dataset: str = "gravity"
    models: tuple[str, ...] = ("tree", "small tree", "boosted", "network", "symbolic")
    inputs: tuple[str, ...] = ("groups", "physics", "rod")
    folds: int = 5
    symbolic_seconds: float = 12.0
    symbolic_nodes: int = 30
    rate: float = 0.01
    coverage: float = 0.995
    learner: str = "boosted"
    """Whose learning curve is drawn."""
    curve: tuple[int, ...] = (100, 250, 500, 1000, 2000, 4000)
    points: int = 60_000
    verified: int = 60
    limit: int = 0
    """Labels to use at most; 0: all."""
    write: bool = False
    """Train the models that foldlab ships, too, and put them into its package."""


VARIANTS = {"small tree": ("tree", {"max_leaf_nodes": 16})}

TINY = Config(
    models=("tree", "symbolic"), folds=2, symbolic_seconds=2.0, learner="tree", curve=(60, 120),
    points=600, verified=2, limit=400, rate=0.1, coverage=0.9,
)  # fmt: skip


def run(config: Config, tracker) -> dict[str, Any]:
    path = config.dataset
    table = read_table(path) if path.endswith(".parquet") else load_dataset(path, space="full")
    table["threshold"] = Thresholds().turning
    uniaxial = table[table["growth"] == "uniaxial"]
    if config.limit:
        uniaxial = uniaxial.head(config.limit)
    known, unknown = known_labels(uniaxial, FULL)
    more = ["normalised_angle", "threshold", "fold_angle", "drawn"]
    known[more] = uniaxial.reindex(columns=more)
    known = known.reset_index(drop=True)
    if known["foldable"].nunique() < 2:
        raise InputError("all labels of the dataset say the same; there is nothing to learn")
    rows, probabilities = [], {}
    for name in config.models:
        for inputs in config.inputs:
            row, probability, model = _validated(known, name, inputs, config)
            counts = counted(known)
            told = probability[counts], known["foldable"].to_numpy(bool)[counts]
            rows.append(row | _careful(*told, config) | _sure(*told, config))
            probabilities[name, inputs] = probability
            tracker.model(f"{name}-{inputs}", model, known[FULL.names].head())
    curves = _curves(known, config)
    figure = plot_learning_curves(
        curves, as_error=True, title=f"{config.learner}, {config.folds} folds of solver labels"
    )
    save_figure(figure, "gravity_learning")
    tracker.figure("gravity_learning", figure)
    best = max(
        (row for row in rows if row["inputs"] != "rod"), key=lambda row: row["accuracy"], default={}
    )
    _draw_reliability(probabilities, known, tracker)
    final = _fitted(best["model"], known, best["inputs"], config)
    scored = known[counted(known)]
    y = scored["foldable"].to_numpy(bool)
    median = curves.groupby(["strategy", "labels"])["accuracy"].median()
    if config.write:
        _ship(uniaxial, config)
    return {
        "labels": len(known),
        "scored": len(scored),
        "unknown": unknown,
        "folds": config.folds,
        "majority": float(max(y.mean(), 1 - y.mean())),
        # Neither of these two has seen a label.
        "beam_accuracy": float(np.mean((beam.formulas(scored)["net"].to_numpy() > 1) == y)),
        "rod_accuracy": float(np.mean((rod_of(scored)["rod"].to_numpy() > 1) == y)),
        "best_without_rod": f"{best['model']} {best['inputs']}",
        "learning": [
            {"inputs": inputs, "labels": int(n), "accuracy": float(value)}
            for (inputs, n), value in median.items()
        ],
        "angles": _angles(known, config),
        "isotropic": _isotropic(table, config),
        **_map(final, config, tracker),
        "table": rows,
    }


def _ship(table: pd.DataFrame, config: Config) -> None:
    """The classifier and the regressor that come with foldlab, with what was measured of them."""
    made = {
        "dataset": config.dataset, "growth": "uniaxial",
        "command": "python -m experiments.gravity_models --set write=true", "commit": commit(),
        "limits": "uniaxial contraction under weight on the ground, solid layers, panels that may "
        "pass through each other; outside of the bounds it guesses",
    }  # fmt: skip
    for name, model, options in (
        ("gravity", "network", {"coverage": 0.99, "options": {"inputs": "physics"}}),
        ("gravity-angle", "angle", {"options": {"inputs": "rod"}}),
    ):
        fitted, result = train_on(table, model, seed=config.seed, **options)
        save_model(fitted, SHIPPED / name, result | made, overwrite=True)


def _fitted(name: str, labels: pd.DataFrame, inputs: str, config: Config):
    model, more = VARIANTS.get(name, (name, {}))
    return fit(model, FULL, labels, seed=config.seed, **_options(name, inputs, config) | more)


def _options(name: str, inputs: str, config: Config) -> dict[str, Any]:
    options = {"inputs": inputs}
    if name == "symbolic":
        options |= symbolic_options(config.symbolic_seconds, config.seed)[name]
        options["max_size"] = config.symbolic_nodes
    return options


def _folds(known: pd.DataFrame, config: Config):
    shuffled = StratifiedKFold(config.folds, shuffle=True, random_state=config.seed)
    return list(shuffled.split(known, known["foldable"]))


def _validated(known: pd.DataFrame, name: str, inputs: str, config: Config):
    """A row of the table, the probability of each label (n,) and the last fold's model."""
    y, counts = known["foldable"].to_numpy(bool), counted(known)
    probability, seconds, right = np.full(len(y), np.nan), [], []
    for train, held in _folds(known, config):
        start = time.perf_counter()
        model = _fitted(name, known.iloc[train], inputs, config)
        seconds.append(time.perf_counter() - start)
        probability[held] = probability_of_folding(model, known.iloc[held][FULL.names])
        held = held[counts[held]]
        right.append(float(np.mean((probability[held] >= 0.5) == y[held])))
    near = ~counts
    size, unit = model_size(model)
    row = {
        "model": name,
        "inputs": inputs,
        "accuracy": float(np.mean(right)),
        "accuracy_low": min(right),
        "accuracy_high": max(right),
        "near": float(np.mean((probability[near] >= 0.5) == y[near])) if near.any() else None,
        "calibration_error": calibration_error(probability[counts], y[counts]),
        "train_seconds": float(np.median(seconds)),
        "size": f"{size} {unit}",
    }
    if name == "symbolic":
        row["formula"] = str(model.formula_)
    return row, probability, model


def _careful(probability: np.ndarray, y: np.ndarray, config: Config) -> dict[str, Any]:
    """Recall and false positives at the threshold for the rate, on the half that did not choose."""
    chooses = np.random.default_rng(config.seed).random(len(y)) < 0.5
    try:
        point = threshold_of(probability[chooses], y[chooses], rate=config.rate)
    except InputError as error:
        # A tree that is certain and wrong has no threshold for a small rate.
        print(error, file=sys.stderr)
        return {"recall": None, "false_positive_rate": None, "false_positive_bound": None}
    folds, y = probability[~chooses] >= point.threshold, y[~chooses]
    return {
        "recall": float(folds[y].mean()),
        "false_positive_rate": float(folds[~y].mean()),
        "false_positive_bound": upper_bound(int(folds[~y].sum()), int((~y).sum())),
    }


def _sure(probability: np.ndarray, y: np.ndarray, config: Config) -> dict[str, Any]:
    """Of the same half: the fractions with an answer, and of those told nothing wrong."""
    chooses = np.random.default_rng(config.seed).random(len(y)) < 0.5
    try:
        borders = borders_of(probability[chooses], y[chooses], coverage=config.coverage)
    except InputError as error:
        print(error, file=sys.stderr)
        return {"decided": None, "covered": None}
    answers, y = borders.answers(probability[~chooses]), y[~chooses]
    told = ~answers.isna()
    wrong = told & (answers.to_numpy(dtype=bool, na_value=False) != y)
    return {"decided": float(told.mean()), "covered": float(1 - wrong.mean())}


def _curves(known: pd.DataFrame, config: Config) -> pd.DataFrame:
    """Accuracy on the held fold after so many labels of the others, for each kind of inputs."""
    y, counts, rows = known["foldable"].to_numpy(bool), counted(known), []
    for inputs in config.inputs:
        for k, (train, held) in enumerate(_folds(known, config)):
            held = held[counts[held]]
            for n in sorted({min(n, len(train)) for n in config.curve}):
                some = known.iloc[np.random.default_rng([config.seed, k]).permutation(train)[:n]]
                if some["foldable"].nunique() < 2:
                    continue
                model = _fitted(config.learner, some, inputs, config)
                right = model.predict(known.iloc[held][FULL.names]) == y[held]
                # The folds' largest sizes differ by a label; they are one point of the curve.
                at = min(n, min(len(t) for t, _ in _folds(known, config)))
                rows.append(
                    {"strategy": inputs, "seed": k, "labels": at, "accuracy": float(right.mean())}
                )
    return pd.DataFrame(rows)


def _angles(known: pd.DataFrame, config: Config) -> list[dict[str, Any]]:
    """Errors of the fold angle, each predicted by trees that have not seen it."""
    rows, counts = [], counted(known)
    for inputs in config.inputs:
        told = np.full(len(known), np.nan)
        for train, held in _folds(known, config):
            model = fit_angle(FULL, known.iloc[train], seed=config.seed, inputs=inputs)
            told[held] = model.predict(known.iloc[held][FULL.names])
        scored, told = known[counts], told[counts]
        errors = angle_errors(_Told(told), scored[FULL.names], scored["fold_angle"])
        rows.append({"inputs": inputs, **errors})
    scored = known[counts]
    need = Thresholds().angle(scored["contraction"])
    rod = _Told(rod_of(scored)["rod"].to_numpy() * need)
    rods = angle_errors(rod, scored[FULL.names], scored["fold_angle"])
    return [*rows, {"inputs": "the rod itself", **rods}]


@dataclass(frozen=True)
class _Told:
    """Predictions that were made before."""

    angles: np.ndarray

    def predict(self, X) -> np.ndarray:
        return self.angles


def _draw_reliability(probabilities: dict, known: pd.DataFrame, tracker) -> None:
    counts = counted(known)
    tables = {
        f"{name}, {inputs}": reliability(probability[counts], known["foldable"][counts])
        for (name, inputs), probability in probabilities.items()
        if inputs == "physics"
    }
    figure = plot_reliability(tables, title=f"{counts.sum()} labels, each unseen by its model")
    save_figure(figure, "gravity_reliability")
    tracker.figure("gravity_reliability", figure)


def _isotropic(table: pd.DataFrame, config: Config) -> dict[str, Any]:
    """Accuracy of boosted trees on the labels of isotropic contraction, for each kind of inputs."""
    part = table[(table["growth"] == "isotropic") & table["foldable"].notna()]
    part = part.assign(foldable=part["foldable"].astype(bool)).reset_index(drop=True)
    scored = part.loc[counted(part), "foldable"]
    out = {"labels": len(part), "folds": int(part["foldable"].sum()), "scored": len(scored)}
    if part["foldable"].nunique() < 2 or part["foldable"].value_counts().min() < config.folds:
        return out
    out["majority"] = float(max(scored.mean(), 1 - scored.mean()))
    for inputs in config.inputs:
        row, _, _ = _validated(part, "boosted", inputs, config)
        out[inputs] = row["accuracy"]
    return out


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
