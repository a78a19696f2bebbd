"""How deep does a hexagonal mesh that contracts corrugate a film that floats on water (Fig. 3.8)?

One mirror wedge of the pattern, free to shrink, on a liquid whose pressure is that of the current
height: the aspect ratio over the contraction for liquids of different weight and bundles of
different stiffness, and on finer meshes.
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
from solver.cases.lung import film as case
from solver.paths.continuation import trace
from solver.paths.steppers import LoadSteps

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    """Sizes in spacings of opposite bundles, stresses in E of the film. ``weights``: specific
    weights of the liquid over E and per spacing; ``stiffnesses``: of the bundles, at the first
    weight; ``cells`` along half of a hole's rim, the first for these, all at the first of both."""

    seed: int = 0
    width: float = 0.1
    height: float = 0.1
    thickness: float = 0.05
    contraction: float = -0.3
    steps: int = 20
    weights: tuple[float, ...] = (1e-3, 1e-2, 0.1, 1.0)
    stiffnesses: tuple[float, ...] = (75.0, 1.0, 5.0, 25.0)
    cells: tuple[int, ...] = (2, 1, 3, 4)


TINY = Config(contraction=-0.1, steps=4, weights=(1e-3, 1.0), stiffnesses=(75.0,), cells=(1,))


def run(config: Config, tracker) -> dict[str, Any]:
    if not (config.weights and config.stiffnesses and config.cells) or config.steps < 1:
        raise InputError("weights, stiffnesses, cells, steps: expected at least one of each")
    weight, stiffness, cells = config.weights[0], config.stiffnesses[0], config.cells[0]
    wanted = [(w, stiffness, cells) for w in config.weights]
    wanted += [(weight, k, cells) for k in config.stiffnesses[1:]]
    wanted += [(weight, stiffness, n) for n in config.cells[1:]]
    films = [made(config, *which) for which in wanted]
    rows, curves = [], []
    for film, which in zip(films, wanted, strict=True):
        row, curve = follow(config, film, which[2])
        rows.append(row)
        curves.append(curve)
    curves = pd.concat(curves)
    tracker.table("films", pd.DataFrame(rows))
    tracker.table("curves", curves)
    figure = plot(config, curves)
    save_figure(figure, "film")
    tracker.figure("film", figure)
    return {"table": rows}


def made(config: Config, weight: float, stiffness: float, cells: int) -> case.Film:
    """The film; raises InputError for what it refuses."""
    try:
        film = case.Film(
            width=config.width, height=config.height, thickness=config.thickness,
            stiffness=stiffness, weight=weight,
        )  # fmt: skip
        case.scene(film, film.body(cells), config.contraction)
    except ValueError as error:
        raise InputError(str(error)) from error
    return film


def follow(config: Config, film: case.Film, cells: int):
    """One path of load steps: its row and the curve of its shape over the contraction."""
    clock, body = time.process_time(), film.body(cells)
    scene = case.scene(film, body, config.contraction)
    steps = LoadSteps(1e-8, 1 / config.steps, smallest=0.02)
    path = trace(scene, np.zeros(scene.size), steps, max_steps=10 * config.steps, events=False)
    names = {"weight": film.weight, "stiffness": film.stiffness, "cells": cells}
    curve = []
    for point in path.points:
        found = case.measure(film, body, scene.displacement(point.x, point.e))
        curve.append({**names, "contraction": config.contraction * point.e,
                      "aspect": found.aspect, **vars(found)})  # fmt: skip
    row = {
        **curve[-1], "unknowns": scene.size, "reached": path.reached,
        "unstable": path.last.unstable, "iterations": path.iterations,
        "cpu_seconds": time.process_time() - clock, "outcome": path.reason,
    }  # fmt: skip
    print(row, file=sys.stderr)
    return row, pd.DataFrame(curve)


def plot(config: Config, curves: pd.DataFrame):
    """Aspect ratio over the contraction: by weight of the liquid, and by stiffness."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    first = {"weight": config.weights[0], "stiffness": config.stiffnesses[0]}
    mine = curves[curves["cells"] == config.cells[0]]
    texts = {"weight": r"$\gamma$ = {:g}", "stiffness": r"$E_{{sm}}/E$ = {:g}"}
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.6), layout="constrained")
        for ax, (key, other) in zip(
            figure.subplots(1, 2, sharey=True),
            (("weight", "stiffness"), ("stiffness", "weight")), strict=True,
        ):  # fmt: skip
            parts = mine[mine[other] == first[other]].groupby(key)
            for colour, (value, part) in zip(np.resize(LINES, len(parts)), parts, strict=True):
                text = texts[key].format(value)
                ax.plot(-part["contraction"], part["aspect"], color=colour, lw=1, label=text)
            ax.set_xlabel("contraction $|g|$")
            ax.legend(fontsize=7)
        figure.axes[0].set_ylabel("depth over spacing")
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
