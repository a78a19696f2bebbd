"""What does it change that a real lung is longer than wide (§3.6.2: the model is a sphere)?

The octant of ellipsoids with the sphere's cage and shell: the pressure at which each passes its
limit, and how far the cells bulge between their bundles, from the equator to the ends, at a
pressure that all of them carry, punctured from that, and at the limit or the pressure aimed at.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from foldlab.plots import LINES, STYLE
from solver.cases.lung import model as case
from solver.cases.lung.elongated import Elongated
from solver.cases.lung.geometry import Lung
from solver.cases.lung.model import REST, State, Tissue

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    """``lengths``: over widths; ``pressure``: p/E_ep that is aimed at, ``low`` one that all carry;
    ``drop`` of it and ``contraction`` in the puncture."""

    seed: int = 0
    n: int = 2
    level: int = 0
    lengths: tuple[float, ...] = (1.0, 1.25, 1.5, 2.0, 3.0)
    pressure: float = 0.11
    low: float = 0.05
    drop: float = 0.1
    contraction: float = -0.2
    steps: int = 10


TINY = Config(n=1, lengths=(1.0, 1.5), pressure=0.02, low=0.01, contraction=-0.05, steps=2)


def run(config: Config, tracker) -> dict[str, Any]:
    if not config.lengths or not 0 < config.low < config.pressure:
        raise InputError("expected at least one length, and 0 < low < pressure")
    rows, cells = [], []
    for length in config.lengths:
        row, own = inflated(config, length)
        print(row, file=sys.stderr)
        rows.append(row)
        cells += own
    table = pd.DataFrame(cells)
    tracker.table("lungs", pd.DataFrame(rows))
    tracker.table("cells", table)
    figure = plot(config, pd.DataFrame(rows), table)
    save_figure(figure, "lung_shape")
    tracker.figure("lung_shape", figure)
    return {"table": rows, "cells": cells}


def inflated(config: Config, length: float) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """A lung's row, and one of each of its cells and states."""
    clock = time.process_time()
    try:
        shape = Elongated.of(Lung(n=config.n), length, config.level)
    except ValueError as error:
        raise InputError(str(error)) from error
    low = State(config.low)
    after = State((1 - config.drop) * config.low, config.contraction)
    stages = {
        "low": shape.scene(Tissue(), (REST, low)),
        "punctured": shape.scene(Tissue(), (low, after)),
        "top": shape.scene(Tissue(), (REST, State(config.pressure))),
    }
    row: dict[str, Any] = {"length": length, "unknowns": stages["low"].size}
    cells, x = [], None
    for name, stage in stages.items():
        start = x if name == "punctured" else None
        path = case.run(stage, start, steps=config.steps, events=False, over=None)
        if name == "top":
            row["reached"] = path.reached
            if not path.reached:
                ahead = case.to_limit(stage, path, step=0.1 / config.steps)
                path = ahead if ahead.reached else path
            row["limit"] = None if row["reached"] else config.pressure * path.last.e
        elif not path.reached:
            continue
        x, u = path.last.x, stage.displacement(path.last.x, path.last.e)
        found = shape.cells(u)
        cells += [
            {"length": length, "state": name, **vars(cell), "aspect": cell.aspect} for cell in found
        ]
        six = [cell for cell in found if cell.edges == 6] or found
        lowest, highest = six[0].height, six[-1].height
        for place, at in (("equator", lowest), ("end", highest)):
            ratios = [cell.aspect for cell in six if abs(cell.height - at) < 1e-9]
            row[f"{name}_{place}"] = float(np.mean(ratios))
    return row | {"cpu_seconds": time.process_time() - clock}, cells


def plot(config: Config, rows: pd.DataFrame, cells: pd.DataFrame):
    """The limit over the length, and corrugation over the height at the low pressure."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        held = rows[rows["limit"].notna()]
        left.plot(held["length"], held["limit"].astype(float), "o-", color=LINES[0], lw=1)
        left.axhline(config.pressure, color="0.6", lw=0.8)
        left.set(xlabel="length over width", ylabel="$p/E_{ep}$ at the limit")
        low = cells[(cells["state"] == "low") & (cells["edges"] == cells["edges"].max())]
        colours = np.resize(LINES, low["length"].nunique())
        for colour, (length, part) in zip(colours, low.groupby("length"), strict=True):
            mean = part.groupby("height")["aspect"].mean()
            right.plot(mean.index, mean, "o-", color=colour, lw=1, ms=3, label=f"length {length:g}")
        right.set(xlabel="height of a cell, equator 0, end 1", ylabel="bulge over spacing")
        right.legend(fontsize=7)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
