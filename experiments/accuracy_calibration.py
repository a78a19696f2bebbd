"""Are the stated errors of a label error bounds, and the forecast of its seconds a forecast?

Designs are labelled at each accuracy, half of them such that a rod ends within 15 % of the
threshold; their last states are found again on a mesh two levels finer, and what m1 and m2 move by
counts as their true error. Paths that ended at a full turn are compared at the state before it, as
their error is stated.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import binomtest

from foldlab.design import FULL
from foldlab.labels import foldability
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.foldability import Thresholds
from foldlab.labels.forecast import forecast
from foldlab.labels.rod import RodSource
from foldlab.labels.solver import SolverSource
from foldlab.plots import STYLE
from solver.cases.unit import path as unit_path
from solver.cases.unit.mesh import LEVELS, Sizes
from solver.equilibrium.clock import core_seconds

from .common import main, save_figure
from .gravity_campaign import SHEETS

# One finer than the finest of :data:`LEVELS`.
FINEST = Sizes(0.04, 2, 0.18, 0.08, 0.25, 4)


@dataclass(frozen=True)
class Config:
    seed: int = 0
    designs: int = 100
    near: float = 0.15
    accuracies: tuple[float, ...] = (0.02,)
    fine_accuracy: float = 0.005
    fine_designs: int = 12
    effects: str = "gravity,ground"
    timeout: float = 60.0
    reference_timeout: float = 240.0


TINY = Config(designs=1, accuracies=(0.2,), fine_designs=0, timeout=20.0)


def run(config: Config, tracker) -> dict[str, Any]:
    designs = drawn(config)
    plan = [(a, config.designs) for a in config.accuracies]
    plan += [(config.fine_accuracy, config.fine_designs)] if config.fine_designs else []
    rows = []
    for accuracy, count in plan:
        effort = Effort(accuracy, config.timeout)
        source = SolverSource(Conditions(config.effects), effort)
        for k in range(count):
            design = designs.iloc[k][FULL.names].astype(float).to_dict()
            row = {"accuracy": accuracy, "design": k, **one(source, design, config)}
            rows.append(row)
            print(row, file=sys.stderr, flush=True)
    frame = pd.DataFrame(rows)
    tracker.table("designs", frame)
    figure = picture(frame)
    save_figure(figure, "accuracy_calibration")
    tracker.figure("accuracy_calibration", figure)
    return {
        "designs": config.designs,
        "table": [verdict(*group) for group in frame.groupby("accuracy")],
    }


def drawn(config: Config) -> pd.DataFrame:
    """Designs near the threshold and at random, in turn."""
    half = config.designs // 2
    pool = SHEETS.sample(max(60 * half, 100), seed=4243 + config.seed)
    angles = [label.evidence.get("m1", np.nan) for label in RodSource().label_many(pool)]
    off = np.abs(np.array(angles) / Thresholds().angle(pool["contraction"]) - 1)
    near = pool[off < config.near].head(half)
    others = pool[off >= config.near].head(config.designs - len(near))
    return pd.concat([near, others]).sort_index(kind="stable").reset_index(drop=True)


def one(source: SolverSource, design, config: Config) -> dict[str, Any]:
    """Stated and true error of a label, foreseen and measured seconds and memory."""
    expected = forecast(design, source)
    path, label = source.follow(design)
    e = label.evidence
    row = {
        "outcome": e["outcome"], "levels": e["levels"], "unknowns": e["unknowns"],
        "seconds": e["core_seconds"], "expected_seconds": expected.seconds,
        "memory_mb": e["peak_memory_mb"], "expected_memory_mb": expected.memory_mb,
        "stated_m1": e.get("error_m1"), "stated_m2": e.get("error_m2"),
        "true_m1": None, "true_m2": None, "scale": None,
    }  # fmt: skip
    if row["stated_m1"] is None or not path.history:
        return row
    closed = path.closed
    level = (0 if closed else e["levels"] - 1) + 2
    mesh = level if level < len(LEVELS) else FINEST
    finer = unit_path.refined(
        path.folding, mesh, earlier=closed, deadline=core_seconds() + config.reference_timeout
    )
    if finer is None:
        return row
    true = vars(foldability.measure(finer.last.curves, design["hinge_length"]))
    have = path.history[-2 if closed else -1]
    scale = lambda r, m1: max(float(source.thresholds.scale(m1, r["contraction"])), 1e-9)  # noqa: E731
    # Stated errors are in rad at the last state.
    at_last = scale(path.history[-1], path.measures["m1"])
    for m in ("m1", "m2"):
        row[f"true_{m}"] = abs(true[m] - have[m])
        row[f"stated_{m}"] *= scale(have, have["m1"]) / at_last
    row["scale"] = scale(have, true["m1"])
    return row


def verdict(accuracy: float, frame: pd.DataFrame) -> dict[str, Any]:
    """Shares with their 95 % Wilson intervals."""
    known = frame[frame["true_m1"].notna()]
    errors = {}
    for m in ("m1", "m2"):
        true, stated = known[f"true_{m}"], known[f"stated_{m}"]
        below = int((true <= stated).sum())
        errors |= {
            f"{m}_below_stated": below / max(len(known), 1),
            f"{m}_interval": interval(below, len(known)),
            f"{m}_median_stated": float((stated / known["scale"]).median()),
            f"{m}_median_true": float((true / known["scale"]).median()),
        }
    labelled = frame[frame["outcome"] != "timeout"]
    ratio = labelled["seconds"] / labelled["expected_seconds"]
    within = int(np.abs(np.log(ratio)).le(np.log(2)).sum())
    memory = labelled["memory_mb"] / labelled["expected_memory_mb"]
    return {
        "accuracy": accuracy,
        "labels": len(frame),
        "with_reference": len(known),
        **errors,
        "seconds_within_2": within / max(len(labelled), 1),
        "seconds_interval": interval(within, len(labelled)),
        "median_seconds": float(labelled["seconds"].median()),
        "median_seconds_over_expected": float(ratio.median()),
        "memory_within_20_percent": float((np.abs(memory - 1) < 0.2).mean()),
    }


def interval(hits: int, of: int) -> list[float] | None:
    """Wilson's 95 % interval of a fraction."""
    if not of:
        return None
    interval = binomtest(hits, of).proportion_ci(method="wilson")
    return [round(float(interval.low), 3), round(float(interval.high), 3)]


def picture(frame: pd.DataFrame) -> Figure:
    """Stated against true error, foreseen against measured seconds."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7, 3), layout="constrained")
        errors, seconds = figure.subplots(1, 2)
        for colour, (accuracy, part) in zip(
            ("#B8BEC6", "#6C8EBF", "#0B3C9C"), frame.groupby("accuracy"), strict=False
        ):
            style = {"ms": 4, "color": colour, "label": f"{100 * accuracy:g} % asked for"}
            known = part[part["true_m1"].notna()]
            for m, mark in (("m1", "o"), ("m2", "x")):
                true, stated = (
                    known[f"{kind}_{m}"] / known["scale"] for kind in ("true", "stated")
                )
                errors.loglog(stated, true.clip(lower=1e-6), mark, **style)
                style.pop("label", None)
            seconds.loglog(part["expected_seconds"], part["seconds"], "o", **style)
        for ax, band in ((errors, 1.0), (seconds, 2.0)):
            low = min(ax.get_xlim()[0], ax.get_ylim()[0])
            line = np.array([low, max(ax.get_xlim()[1], ax.get_ylim()[1])])
            ax.plot(line, line, color="#333333", lw=0.8)
            if band > 1:
                ax.fill_between(line, line / band, line * band, color="#333333", alpha=0.1, lw=0)
        errors.set(xlabel="stated error of m1 (dots), m2 (crosses)", ylabel="true (finer mesh)")
        seconds.set(xlabel="forecast, core-seconds", ylabel="measured, core-seconds")
        errors.legend(fontsize=6, frameon=False)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
