"""What does accuracy cost in time, from the element to the classifier?

Work–precision diagrams, each with both axes from one run: (a) elements and meshes, (b) steppers,
(c) quarter and whole model, (d) the ladder of label sources, (e) classifiers, (f) few accurate or
many cheap labels for the same hour. Labels go into ``out/accuracy_vs_time.db``: a run that was
stopped goes on where it was. ``choose`` is the table that a user can choose from.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import pandas as pd
from threadpoolctl import threadpool_limits

from foldlab.errors import InputError

from ._accuracy import labels, paths, plots
from .common import main, save_figure

FINE = "--source solver --set accuracy=0.005"
PARTS = ("a", "b", "c", "d", "e", "f")


@dataclass(frozen=True)
class Config:
    seed: int = 0
    parts: tuple[str, ...] = PARTS
    # (a) to (c): paths
    scenes: tuple[str, ...] = (paths.P, *paths.UNITS)
    elements: tuple[str, ...] = plots.ELEMENTS
    levels: tuple[int, ...] = (0, 1, 2, 3)
    first_order_levels: tuple[int, ...] = (1, 2, 3, 4)
    reference: int = paths.FINEST
    stepper_scenes: tuple[str, ...] = (paths.P, "folds")
    stepper_level: int = 0
    steps: tuple[int, ...] = (5, 10, 20, 40)
    rtols: tuple[float, ...] = (1e-3, 1e-6, 1e-9)
    whole_levels: tuple[int, ...] = (0, 1)
    limit: float = 120.0
    """Seconds per path."""
    # (d): labels of new designs
    ladder: int = 50
    ladder_whole: int = 6
    timeout: float = 15.0
    """Seconds per label; of the whole unit four times as long."""
    workers: int = 2
    """Processes that label; 0: this one."""
    # (e), (f): labels of the dataset
    dataset: str = "gravity-5k"
    models: tuple[str, ...] = ("tree", "forest", "boosted", "network")
    counts: tuple[int, ...] = (100, 300, 1000)
    seeds: int = 3
    test: float = 0.25
    cheap: int = 400
    clocked: int = 40
    budgets: tuple[float, ...] = (20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0)
    budget_model: str = "forest"
    budget_test: float = 0.25
    formula_labels: int = 20_000


TINY = Config(
    scenes=(paths.P, "grounded"), elements=("tet4", "hex20"), levels=(0, 1),
    first_order_levels=(0, 1), reference=1, stepper_scenes=(paths.P,), stepper_level=0,
    steps=(8,), rtols=(1e-6,), whole_levels=(0,), ladder=1, ladder_whole=0, workers=0,
    models=("tree",), counts=(100,), seeds=1, cheap=3, clocked=1, budgets=(5.0, 50.0, 100.0, 200.0),
    budget_model="tree", formula_labels=200,
)  # fmt: skip


def run(config: Config, tracker) -> dict[str, Any]:
    wrong = [part for part in config.parts if part not in PARTS]
    if wrong or not config.parts:
        raise InputError(f"parts {config.parts}; expected some of {', '.join(PARTS)}")
    if config.reference not in range(1, paths.FINEST + 1):
        raise InputError(f"reference {config.reference}; expected 1 to {paths.FINEST}")
    with threadpool_limits(1):
        results = _parts(config, tracker)
    choose = chosen(results)
    tracker.table("choose", pd.DataFrame(choose))
    for row in choose:
        print(row, file=sys.stderr)
    return {"choose": choose, **results, "table": choose}


def _parts(config: Config, tracker) -> dict[str, Any]:
    def say(row: dict) -> None:
        print(row, file=sys.stderr, flush=True)

    def keep(name: str, figure, rows: list[dict]) -> None:
        save_figure(figure, f"accuracy_{name}")
        tracker.figure(f"accuracy_{name}", figure)
        tracker.table(f"accuracy_{name}", pd.DataFrame(rows))

    out: dict[str, Any] = {}
    if "a" in config.parts:
        out["elements"], out["references"] = paths.elements(config, say)
        keep("elements", plots.draw_elements(out["elements"]), out["elements"])
    if "b" in config.parts:
        out["steppers"] = paths.steppers(config, say)
        keep("steppers", plots.draw_steppers(out["steppers"]), out["steppers"])
    if "c" in config.parts:
        out["wholes"] = paths.wholes(config, say)
        keep("wholes", plots.draw_wholes(out["wholes"]), out["wholes"])
    made = labels.cheap_labels(config) if {"d", "f"} & set(config.parts) else None
    if "d" in config.parts:
        out["ladder"] = labels.ladder(config, say)
        out["bands"] = labels.mixing(*made)
        out["coarse_error"] = labels.calibration(*made[:2])
        keep("ladder", plots.draw_ladder(out["ladder"], out["bands"]), out["ladder"])
    if "e" in config.parts:
        out["classifiers"] = labels.classifiers(config, say)
        keep("classifiers", plots.draw_classifiers(out["classifiers"]), out["classifiers"])
    if "f" in config.parts:
        table, coarse, fine = made
        price = labels.prices(coarse, fine)
        out["budgets"] = labels.budgets(config, table, coarse, price, say)
        out["hour"] = labels.in_an_hour(out["budgets"], price)
        keep("budgets", plots.draw_budgets(out["budgets"], out["hour"]), out["budgets"])
    return out


def chosen(results: dict[str, Any]) -> list[dict[str, Any]]:
    """What to take for what, from the measured rows: a row per use, its accuracy and its cost."""
    rows = []
    for use, source, how in (
        ("a first look, without weight", "Timoshenko", "--source timoshenko"),
        ("screening", "quarter, coarse", "--source solver --set refine=never"),
        ("a map, labels to learn from", "mixed", "--source solver --set refine=near"),
        ("labels to compare with", "quarter, 2 %", "--source solver"),
        ("a design to be built", labels.FINEST, FINE),
        ("a symmetry in doubt", "whole, 2 %", "--source solver --set seed=0"),
    ):
        for row in results.get("ladder", ()):
            if row["source"] == source:
                low, high = row["disagreement_low"], row["disagreement_high"]
                wrong = f"{row['wrong']} of {row['compared']} ({low:.1%} to {high:.1%})"
                rows.append(
                    {
                        "for": use,
                        "take": f"foldlab label {how}",
                        "wrong": "what the others are compared with" if how == FINE else wrong,
                        "costs": f"{row['core_seconds_mean']:.3g} core-seconds, "
                        f"{row['labels_per_hour']:.0f} labels per core-hour",
                    }
                )
    if results.get("classifiers"):
        table = pd.DataFrame(results["classifiers"])
        full = table[table["labels"] == table["labels"].max()]
        best = full.loc[full["accuracy"].idxmax()]
        rows.append(
            {
                "for": "millions of designs like labelled ones",
                "take": f"foldlab train --model {best['model']}, {best['labels']} labels",
                "wrong": f"{1 - best['accuracy']:.1%} ({1 - best['accuracy_high']:.1%} to "
                f"{1 - best['accuracy_low']:.1%})",
                "costs": f"{best['label_core_seconds']:.0f} core-seconds of labels, "
                f"{best['train_seconds']:.3g} s of training, "
                f"{best['seconds_per_million']:.3g} s per million",
            }
        )
    for row in _cheapest(results.get("elements", [])):
        rows.append(row)
    return rows or [{"for": "–", "take": "parts a, d or e make rows", "wrong": "–", "costs": "–"}]


def _cheapest(rows: list[dict], bounds: tuple[float, ...] = (0.05, 0.005)) -> list[dict]:
    """The element and mesh that keep an error in every scene where it was tried, cheapest first."""
    out = []
    table = pd.DataFrame(rows)
    for bound in bounds if len(table) else ():
        by = table.assign(error=table["error"].fillna(float("inf"))).groupby(["element", "level"])
        kept = by.agg(error=("error", "max"), seconds=("core_seconds", "sum")).reset_index()
        kept = kept[kept["error"] <= bound]
        if len(kept):
            best = kept.loc[kept["seconds"].idxmin()]
            out.append(
                {
                    "for": f"a fold angle to {bound:.1%} on every scene of part (a)",
                    "take": f"{best['element']} on mesh {best['level']}",
                    "wrong": f"{best['error']:.2%} at most",
                    "costs": f"{best['seconds']:.3g} core-seconds for {table['scene'].nunique()} "
                    "paths",
                }
            )
    return out


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
