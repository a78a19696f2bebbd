"""What does each rung of the ladder buy: formula, model, rod, coarse solver, and mixtures of them?

Designs whose solver labels nothing else has seen are answered by every rung, each at its price in
core-seconds of this machine. A rung that is not sure passes a design on; what reaches the solver
costs what its label took and counts as right. Labels that a model learned from are told beside.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.asked import Effort
from foldlab.labels.rod import RodSource
from foldlab.labels.solver import SolverSource
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.features import as_labels, probability_of_folding
from foldlab.learning.models import make_classifier
from foldlab.learning.scoring import clopper_pearson
from foldlab.plots import STYLE

from .common import counted, main, save_figure


@dataclass(frozen=True)
class Config:
    seed: int = 0
    dataset: str = "gravity"
    test: int = 1000
    coarse: int = 120
    """Of these designs so many also go to the solver on its coarsest mesh."""
    few: int = 250
    """Labels of a model that has few."""
    sure: float = 0.99
    """Probability of an answer from which on a model is sure."""
    room: float = 0.5
    """|T + E − W − S − 1| from which on the formulas are."""


TINY = Config(test=60, coarse=2, few=100)


def run(config: Config, tracker) -> dict[str, Any]:
    table = load_dataset(config.dataset, growth="uniaxial", space="full")
    known = table[table["foldable"].notna()].sample(frac=1.0, random_state=config.seed)
    known = known.iloc[np.argsort(~counted(known), kind="stable")]
    if len(known) < config.test + config.few or counted(known).sum() < config.test:
        raise InputError(f"{len(known)} known labels; test and few ask for more")
    test, rest = known.iloc[: config.test], known.iloc[config.test :]
    designs, truth = test[FULL.names].reset_index(drop=True), as_labels(test["foldable"])
    cost = test["core_seconds"].to_numpy(float)

    rungs: dict[str, tuple[np.ndarray, np.ndarray]] = {}  # answers (1, 0, nan), core-seconds each

    def rung(name, answer):
        began = time.process_time()
        answers = np.asarray(answer(), float)
        rungs[name] = answers, np.full(len(designs), (time.process_time() - began) / len(designs))

    warm = FULL.sample(8, seed=0)
    RodSource().label_many(warm)
    beam.formulas(warm)
    rung(
        "Timoshenko, no weight", lambda: TimoshenkoSource(space=FULL).evaluate(designs)["foldable"]
    )
    net = beam.formulas(designs)["net"].to_numpy() - 1
    rung("beam formulas", lambda: beam.formulas(designs)["net"].to_numpy() > 1)
    rungs["beam formulas, sure"] = _unless(rungs["beam formulas"], np.abs(net) < config.room)
    for name, labels in (("many", rest), ("few", rest.head(config.few))):
        model = make_classifier("boosted", FULL, seed=config.seed)
        model.fit(labels[FULL.names], as_labels(labels["foldable"]))
        p: list[np.ndarray] = []
        rung(
            f"model of {len(labels)} labels",
            lambda model=model, p=p: (
                p.append(probability_of_folding(model, designs)) or p[0] >= 0.5
            ),
        )
        unsure = (p[0] > 1 - config.sure) & (p[0] < config.sure)
        rungs[f"model, {name}, sure"] = _unless(rungs[f"model of {len(labels)} labels"], unsure)
    rod: list[Any] = []
    rung("rod", lambda: [_number(x) for x in rod.extend(_decided(designs)) or rod])
    rung("rod, sure", lambda: [_number(x.foldable) for x in RodSource().label_many(designs)])
    solved = truth.astype(float), cost

    mixtures = {
        "rod → solver": ["rod, sure"],
        "formulas → rod → solver": ["beam formulas, sure", "rod, sure"],
        "model (few) → solver": ["model, few, sure"],
        "model (few) → rod → solver": ["model, few, sure", "rod, sure"],
        "model → rod → solver": ["model, many, sure", "rod, sure"],
    }
    rows = [_row(name, *answer, truth) for name, answer in rungs.items()]
    for name, steps in mixtures.items():
        rows.append(_row(name, *_mixed([*(rungs[step] for step in steps), solved]), truth))
    rows.append(_coarse(designs.head(config.coarse), truth[: config.coarse]))
    rows.append(_row("solver, 2 %", *solved, truth) | {"wrong": None, "wrong_most": None})
    frame = pd.DataFrame(rows)
    tracker.table("rungs", frame)
    figure = picture(frame)
    save_figure(figure, "gravity_ladder")
    tracker.figure("gravity_ladder", figure)
    return {
        "test_labels": len(test),
        "labels_of_models": [len(rest), config.few],
        "core_seconds_of_few_labels": float(rest.head(config.few)["core_seconds"].sum()),
        "table": rows,
    }


def _decided(designs):
    return [x.foldable for x in RodSource(sure=False).label_many(designs)]


def _number(foldable: bool | None) -> float:
    return np.nan if foldable is None else float(foldable)


def _unless(rung, unsure: np.ndarray):
    return np.where(unsure, np.nan, rung[0]), rung[1]


def _mixed(steps) -> tuple[np.ndarray, np.ndarray]:
    """Answers and costs where what one step leaves open goes to the next."""
    answers, costs = (part.copy() for part in steps[0])
    for more, price in steps[1:]:
        open_ = np.isnan(answers)
        answers[open_] = more[open_]
        costs[open_] += price[open_]
    return answers, costs


def _row(name: str, answers: np.ndarray, costs: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    answered = ~np.isnan(answers)
    wrong = int((answers[answered] != truth[answered]).sum())
    n = int(answered.sum())
    return {
        "rung": name,
        "answered": float(answered.mean()),
        "wrong": wrong / n if n else None,
        "wrong_most": clopper_pearson(wrong, n)[1] if n else None,
        "core_seconds": float(costs.mean()),
    }


def _coarse(designs: pd.DataFrame, truth: np.ndarray) -> dict[str, Any]:
    """The solver on its coarsest mesh alone."""
    source = SolverSource(effort=Effort(refine="never"))
    source.label(designs.iloc[0].to_dict())  # compiles
    labels = [source.label(design) for design in designs.to_dict("records")]
    answers = np.array([_number(label.foldable) for label in labels])
    costs = np.array([label.evidence["core_seconds"] for label in labels])
    return _row("solver, coarsest mesh", answers, costs, truth)


def picture(frame: pd.DataFrame) -> Figure:
    """Wrong answers over core-seconds a label, numbered; lines go up to the 95 % bound."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, 3.6), layout="constrained")
        ax = figure.subplots()
        shown = frame[frame["wrong"].notna()].reset_index(drop=True)
        least, key = 3e-4, []
        for number, row in shown.iterrows():
            mixed = "→" in row["rung"]
            wrong = max(row["wrong"], least)
            at = row["core_seconds"]
            ax.errorbar(
                at, wrong, [[0.0], [max(row["wrong_most"] - wrong, 0.0)]], lw=0.7, ms=9,
                fmt="D" if mixed else "o", color="#B3261E" if mixed else "#0B3C9C",
                mfc="none" if row["wrong"] == 0 else None, zorder=2,
            )  # fmt: skip
            ax.annotate(
                f"{number + 1}", (at, wrong), ha="center", va="center", fontsize=5.5,
                color="black" if row["wrong"] == 0 else "white", zorder=3,
            )  # fmt: skip
            partly = "" if row["answered"] > 0.9995 else f", answers {100 * row['answered']:.0f} %"
            none = ", none wrong" if row["wrong"] == 0 else ""
            key.append(f"{number + 1}  {row['rung']}{partly}{none}")
        price = frame.loc[frame["rung"] == "solver, 2 %", "core_seconds"].iloc[0]
        ax.axvline(price, color="0.5", lw=0.8, ls="--")
        key.append("- -  solver, 2 %: the reference")
        ax.set(
            xscale="log", yscale="log", xlabel="core-seconds per label",
            ylabel="wrong answers of those given", xlim=(1e-6, 4), ylim=(2e-4, 0.5),
        )  # fmt: skip
        ax.annotate(
            "\n".join(key), (1.02, 1.0), xycoords="axes fraction", va="top", fontsize=7,
            linespacing=1.5,
        )  # fmt: skip
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
