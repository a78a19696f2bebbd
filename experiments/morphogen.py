"""Does a morphogen's gradient come out as in closed form, and does growth shrink its reach?

A kept, diffusing and decaying concentration along a bar: at rest beside cosh((L − x)/λ)/cosh(L/λ),
which is exp(−x/λ) in a long bar, on each element and finer meshes; set in at once beside its
Fourier series; and the bar that grows where it is (Eq. 2.33), with the concentration fixed in the
tissue (reference configuration) or diffusing in the deformed bar, which growth dilutes and
stretches, beside an integrator of its own.
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
from solver.cases.tissue.morphogen import Gradient
from solver.mesh.body import ELEMENTS
from solver.transport.morphogen import Morphogen

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    """``cells`` along the bar for the orders in space; ``steps`` for those in time; ``instants``
    at which the series is compared, ``per_instant`` steps up to each; ``sweeps`` of the bar that
    grows until ``until`` in ``growth_steps`` on ``growth_cells``; ``rate`` of its growth."""

    seed: int = 0
    elements: tuple[str, ...] = tuple(ELEMENTS)
    cells: tuple[int, ...] = (6, 12, 24, 48)
    steps: tuple[int, ...] = (10, 20, 40, 80)
    instants: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0)
    per_instant: int = 100
    rate: float = 0.5
    until: float = 1.5
    growth_cells: int = 24
    growth_steps: int = 60
    sweeps: int = 4


TINY = Config(
    elements=("hex8", "hex27"), cells=(4, 8), steps=(10, 20), instants=(0.3, 1.0), per_instant=20,
    growth_cells=6, growth_steps=15, sweeps=1,
)  # fmt: skip


def run(config: Config, tracker) -> dict[str, Any]:
    unknown = [name for name in config.elements if name not in ELEMENTS]
    if unknown:
        raise InputError(f"no element {unknown[0]!r}; there are: {', '.join(ELEMENTS)}")
    for name in ("cells", "steps"):
        if len(getattr(config, name)) < 2:
            raise InputError(f"{name} has fewer than two numbers; expected two for an order")
    space, times = space_study(config), time_study(config)
    transient, curves = series_study(config)
    growth = growth_study(config)
    tables = {"space": space, "time": times, "transient": transient, "growth": growth}
    for name, rows in tables.items():
        print(*rows, sep="\n", file=sys.stderr)
        tracker.table(name, pd.DataFrame(rows))
    tracker.table("curves", curves)
    figure = plot(config, space, curves, growth)
    save_figure(figure, "morphogen")
    tracker.figure("morphogen", figure)
    return {
        "table": space,
        "time": times,
        "transient": transient,
        "growth": growth,
        **{f"order_{name}": order(space, "cells", name) for name in config.elements},
        "order_in_time": order(times, "steps"),
        "worst_transient": max(row["off"] for row in transient),
        "worst_length": max(row["off"] for row in growth),
    }


def space_study(config: Config) -> list[dict]:
    """Errors at rest, √∫(c − exact)² over √∫ exact²."""
    case, rows = Gradient(), []
    for element in config.elements:
        for cells in config.cells:
            body = case.body(cells, element)
            morphogen = case.morphogen(body)
            clock = time.perf_counter()
            c = morphogen.steady()
            seconds = time.perf_counter() - clock
            off = morphogen.error(c, lambda X: case.steady(X[..., 0]))
            rows.append({"element": element, "cells": cells, "unknowns": len(c), "off": off,
                         "seconds": seconds})  # fmt: skip
    return rows


def time_study(config: Config) -> list[dict]:
    """Errors of a wave that decays, after fixed steps, on a mesh fine enough not to show."""
    case = Gradient()
    body = case.body(32, "hex27")
    morphogen = Morphogen(body, case.diffusivity, case.decay)
    k, until = 2 * np.pi / case.length, 1.0
    fade = np.exp(-case.diffusivity * k * k * until)

    def exact(X):
        return (1 + np.cos(k * X[..., 0]) * fade) * np.exp(-case.decay * until)

    first, rows = 1 + np.cos(k * body.nodes[:, 0]), []
    for steps in config.steps:
        c = morphogen.march(until, until / steps, c=first).last
        rows.append({"steps": steps, "off": morphogen.error(c, exact)})
    return rows


def series_study(config: Config) -> tuple[list[dict], pd.DataFrame]:
    """Errors of a gradient that was set in at once, and its profiles."""
    case = Gradient()
    body = case.body(48, "hex27")
    morphogen, x = case.morphogen(body), np.linspace(0, case.length, 61)
    line = body.interpolation(np.stack([x, 0 * x, 0 * x], axis=1))
    rows, curves = [], []
    for t in config.instants:
        c = morphogen.march(t, t / config.per_instant).last
        rows.append({"t": t, "off": morphogen.error(c, lambda X, t=t: case.series(X[..., 0], t))})
        curves.append(pd.DataFrame({"t": t, "x": x, "c": line @ c, "exact": case.series(x, t)}))
    return rows, pd.concat(curves)


def growth_study(config: Config) -> list[dict]:
    """Lengths of the bar that grows, with c in the reference and in the deformed configuration,
    and how far its growth is from that of the integrator."""
    case, rows = Gradient(rate=config.rate), []
    body = case.body(config.growth_cells, "hex27")
    for name, sweeps in (("reference", 0), ("deformed", config.sweeps)):
        clock = time.perf_counter()
        _, _, lengths = case.grown(body, config.until, config.growth_steps, sweeps=sweeps)
        seconds = time.perf_counter() - clock
        exact = case.exact(config.until, deformed=sweeps > 0)
        rows.append(
            {
                "configuration": name,
                "length": lengths[-1],
                "exact": exact,
                "off": abs(lengths[-1] - exact) / (exact - case.length),
                "sweeps": sweeps,
                "last_change": abs(lengths[-1] - lengths[-2]) if sweeps else 0.0,
                "seconds": seconds,
            }
        )
    return rows


def order(rows: list[dict], size: str, element: str | None = None) -> float:
    """Order from the two finest rows, of one element if it is named."""
    chosen = [row for row in rows if element is None or row["element"] == element]
    a, b = sorted(chosen, key=lambda row: row[size])[-2:]
    return float(np.log(a["off"] / b["off"]) / np.log(b[size] / a[size]))


def plot(config: Config, space: list[dict], curves: pd.DataFrame, growth: list[dict]):
    """Errors over the number of cells, profiles over time, and lengths."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    case = Gradient()
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.2), layout="constrained")
        axes = figure.subplots(1, 3, width_ratios=[1, 1, 0.6])
        table = pd.DataFrame(space)
        marks = zip(table.groupby("element", sort=False), "os^vD", strict=False)
        for k, ((name, part), mark) in enumerate(marks):
            label = f"{name}, order {order(space, 'cells', name):.2f}"
            axes[0].loglog(part["cells"], part["off"], marker=mark, ms=4, label=label,
                           color=LINES[k % len(LINES)])  # fmt: skip
        axes[0].set(xlabel="cells along the bar", ylabel="error at rest")
        axes[0].set_xticks(config.cells, [str(n) for n in config.cells])
        axes[0].minorticks_off()
        axes[0].legend(fontsize=7)
        for k, (t, part) in enumerate(curves.groupby("t")):
            color = LINES[k % len(LINES)]
            axes[1].plot(part["x"], part["exact"], color=color, lw=1)
            axes[1].plot(part["x"][::3], part["c"][::3], "o", color=color, ms=2.5,
                         label=f"$t$ = {t:g}")  # fmt: skip
        x = np.linspace(0, case.length, 200)
        axes[1].plot(x, np.exp(-x / case.reach), "--", color="#777777", lw=0.8,
                     label=r"$\exp(-x/\lambda)$")  # fmt: skip
        axes[1].set(xlabel="$x$", ylabel="concentration (lines: series)")
        axes[1].legend(fontsize=7)
        places = np.arange(len(growth))
        lengths = [row["length"] - case.length for row in growth]
        axes[2].bar(places, lengths, color=LINES[0], width=0.5)
        exact = [row["exact"] - case.length for row in growth]
        axes[2].plot(places, exact, "_", color="black", ms=24)
        axes[2].set_xticks(places, [row["configuration"] for row in growth])
        axes[2].set_ylabel("growth of the bar (dash: exact)")
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
