"""What does a gravity label cost, and how do thousands of designs fold under their weight?

Labels designs of the full space (sheets: h_s/l_s up to 3e-2) with the solver, in pieces into one
store, so that a run that was stopped goes on where it was. ``--set pieces=…`` of ``size`` designs
each; piece k is a Latin hypercube with seed ``seed + k``.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from foldlab.campaign.campaign import run_campaign
from foldlab.design import FULL
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource
from foldlab.labels.store import LabelStore
from foldlab.plots import STYLE

from .common import OUT, main, save_figure

SHEETS = FULL.with_bounds(slenderness=(1e-3, 3e-2))


@dataclass(frozen=True)
class Config:
    seed: int = 0
    pieces: int = 1
    size: int = 100
    growth: str = "uniaxial"
    accuracy: float = 0.02
    timeout: float = 60.0
    workers: int = 1
    store: str = ""


TINY = Config(size=2, timeout=20.0, accuracy=0.2)


def run(config: Config, tracker) -> dict[str, Any]:
    effort = Effort(config.accuracy, config.timeout)
    source = SolverSource(Conditions(growth=config.growth), effort)
    path = Path(config.store) if config.store else OUT / f"gravity_{config.growth}.db"
    path.parent.mkdir(exist_ok=True)
    started = time.perf_counter()
    designs = [SHEETS.sample(config.size, seed=config.seed + k) for k in range(config.pieces)]
    with LabelStore(path) as store:
        for k, piece in enumerate(designs):
            report = run_campaign(piece, source, store, workers=config.workers, progress=False)
            print(f"piece {k}: {report.outcome}", report.as_dict(), file=sys.stderr, flush=True)
        frame = store.frame(source.name, source.version)
    wanted = pd.concat(designs)[FULL.names]
    frame = frame.merge(wanted, on=FULL.names)
    tracker.table("labels", frame.drop(columns=["curves", "history"], errors="ignore"))
    figure = picture(frame)
    save_figure(figure, "gravity_campaign")
    tracker.figure("gravity_campaign", figure)
    return summary(frame, config, time.perf_counter() - started)


def summary(frame: pd.DataFrame, config: Config, wall: float) -> dict[str, Any]:
    """What the labels cost and say; ``wall``: seconds that making them took."""
    seconds = frame["core_seconds"]
    error = pd.to_numeric(frame["error_estimate"], errors="coerce")
    table = (
        frame.groupby("outcome")
        .agg(labels=("outcome", "size"), median_core_seconds=("core_seconds", "median"))
        .sort_values("labels", ascending=False)
        .reset_index()
    )
    return {
        "labels": len(frame),
        "core_seconds_median": float(seconds.median()),
        "core_seconds_mean": float(seconds.mean()),
        "core_seconds_90": float(seconds.quantile(0.9)),
        "error_median": float(error.median()),
        "error_within": float((error <= config.accuracy).mean()),
        "peak_memory_mb_median": float(frame["peak_memory_mb"].median()),
        "peak_memory_mb_most": float(frame["peak_memory_mb"].max()),
        "stable_or_reason": float(frame["foldable"].notna().mean()),
        "folds": int((frame["foldable"] == True).sum()),  # noqa: E712
        "outcomes": dict(Counter(frame["outcome"])),
        "wall_seconds": wall,
        "overhead_seconds": float(
            np.maximum(0, wall * config.workers - frame["seconds"].sum()) / len(frame)
        ),
        "table": table.to_dict("records"),
    }


def picture(frame: pd.DataFrame) -> Figure:
    """What labels cost, and how they end against the weight."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7, 2.8), layout="constrained")
        cost, ends = figure.subplots(1, 2)
        seconds = np.sort(frame["core_seconds"].dropna())
        cost.step(seconds, np.arange(1, len(seconds) + 1) / len(seconds), where="post")
        cost.set(
            xscale="log", xlabel="core-seconds per label", ylabel="fraction of labels", ylim=(0, 1)
        )
        gamma = np.log10(frame["stiffness_to_weight"])
        edges = np.linspace(-2, 2, 9)
        names = list(frame["outcome"].value_counts().index)
        counts = [np.histogram(gamma[frame["outcome"] == name], edges)[0] for name in names]
        whole = np.maximum(np.sum(counts, axis=0), 1)
        below = np.zeros(len(edges) - 1)
        colours = mpl.colormaps["tab20"](np.linspace(0, 1, 20))
        for name, count, colour in zip(names, counts, colours, strict=False):
            fraction = count / whole
            ends.bar(
                10 ** edges[:-1], fraction, np.diff(10**edges), bottom=below, align="edge",
                label=name.replace("_", " "), color=colour,
            )  # fmt: skip
            below += fraction
        ends.set(
            xscale="log", xlabel="Γ = E h² / (ρ g l³)", ylabel="fraction of labels", ylim=(0, 1)
        )
        ends.legend(fontsize=6, loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
