"""Does creep in three dimensions follow the exact small-strain solution, and at what step?

Kelvin–Voigt, Maxwell and standard linear solid pulled by σ for 0 < t < 1 (Figs. 5.3–5.5), beside
the exact three-dimensional solution with an isotropic dashpot and the one-dimensional formula; the
dissertation's 200 steps of 0.01 beside adaptive ones; and finite strain at the printed σ = 1.
"""

from __future__ import annotations

import sys
import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from foldlab.plots import LINES, STYLE
from solver.cases.tissue import creep
from solver.viscous.evolution import TimeSteps, Unresolved, evolve, start

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    """``stress``: σ, at which strains are small (the printed one is 1); strains are given per σ.
    ``tolerance``: error of an adaptive step, per σ; ``step``: the fixed one."""

    seed: int = 0
    models: tuple[str, ...] = tuple(creep.MODELS)
    stress: float = 1e-2
    step: float = 0.01
    tolerance: float = 1e-5
    until: float = 2.0


TINY = Config(models=("Kelvin-Voigt",), step=0.1, tolerance=1e-3, until=1.2)

STEPS = ("fixed, order 1", "fixed, order 2", "adaptive, order 1", "adaptive, order 2")


def run(config: Config, tracker) -> dict[str, Any]:
    unknown = [name for name in config.models if name not in creep.MODELS]
    if unknown:
        raise InputError(f"no model {unknown[0]!r}; there are: {', '.join(creep.MODELS)}")
    rows, curves = [], []
    for name in config.models:
        model = creep.MODELS[name]
        for steps in STEPS:
            row, curve = follow(config, model, steps, config.stress)
            print(row, file=sys.stderr)
            rows.append(row)
            curves.append(curve)
        # The printed load: what differs from the exact solution then is finite strain.
        row, curve = follow(config, model, STEPS[-1], 1.0)
        rows.append({**row, "steps": "adaptive, printed σ"})
        curves.append(curve.assign(steps="printed σ"))
    curves = pd.concat(curves)
    tracker.table("creep", pd.DataFrame(rows))
    tracker.table("curves", curves)
    figure = plot(config, curves)
    save_figure(figure, "creep")
    tracker.figure("creep", figure)
    best = [row for row in rows if row["steps"] == STEPS[-1]]
    return {
        "table": rows,
        "worst_adaptive": max(max(row["axial"], row["lateral"]) for row in best),
        "worst_printed_steps": max(row["axial"] for row in rows if row["steps"] == STEPS[0]),
        "slowest": max(row["seconds"] for row in rows),
    }


def follow(config: Config, model: creep.Model, steps: str, stress: float):
    """One history: a row with its largest errors as fractions of the exact peak, and its curve."""
    order = int(steps[-1])
    if steps.startswith("fixed"):
        stepper = TimeSteps(1e-10, config.step, order=order)
    else:
        stepper = TimeSteps(1e-10, 1e-4, tolerance=config.tolerance * stress, order=order)
    scene = creep.scene(model.rheology(), stress, stepper.step)
    clock = time.perf_counter()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", Unresolved)
        path = evolve(scene, start(scene), stepper, until=config.until, breaks=(creep.END,))
    seconds = time.perf_counter() - clock
    t = path.times[1:]
    strains = np.array([creep.strains(scene, s.x) for s in path.states[1:]]) / stress
    exact = np.stack(model.exact(t), axis=1)
    dense = np.linspace(0, config.until, 2001)[1:]
    peak = np.abs(model.exact(dense)[0]).max()
    off = np.abs(strains - exact).max(axis=0) / peak
    row = {
        "model": model.name,
        "steps": steps,
        "stress": stress,
        "axial": off[0],
        "lateral": off[1],
        "one_dimensional": np.abs(model.response(dense) - model.exact(dense)[0]).max() / peak,
        "number": len(t),
        "iterations": sum(s.iterations for s in path.states),
        "resolved": not told,
        "dissipated": path.last.dissipated / stress**2,
        "seconds": seconds,
        "outcome": path.reason,
    }
    names = {"model": model.name, "steps": steps, "t": t}
    return row, pd.DataFrame({**names, "axial": strains[:, 0], "lateral": strains[:, 1]})


def plot(config: Config, curves: pd.DataFrame):
    """Strain over time and the load, one panel per model."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    n = len(config.models)
    t = np.linspace(0, config.until, 2001)[1:]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.5 * int(np.ceil(n / 2)) + 0.5), layout="constrained")
        axes = figure.subplots(int(np.ceil(n / 2)), min(n, 2), squeeze=False).ravel()
        for ax, name in zip(axes, config.models, strict=False):
            model = creep.MODELS[name]
            axial, lateral = model.exact(t)
            one = ax.plot(t, 100 * model.response(t), "--", color="#4D4D4D", lw=1)
            exact = ax.plot(t, 100 * axial, color=LINES[0], lw=1.2)
            ax.plot(t, 100 * lateral, color=LINES[0], lw=1.2)
            part = curves[curves["model"] == name]
            mine = part[part["steps"] == STEPS[-1]]
            ours = ax.plot(mine["t"], 100 * mine["axial"], "o", color=LINES[1], ms=2.5)
            ax.plot(mine["t"], 100 * mine["lateral"], "o", color=LINES[1], ms=2.5)
            fixed = part[part["steps"] == STEPS[0]]
            euler = ax.plot(fixed["t"], 100 * fixed["axial"], ":", color=LINES[2], lw=1)
            load = ax.twinx()
            pull = load.step(
                [0, 0, 1, config.until], [0, 1, 0, 0], where="post", color="#999999", lw=0.7
            )
            load.set_ylim(-0.4, 1.6)
            load.set_yticks([0, 1])
            load.set_ylabel(r"load $\sigma$", color="#777777")
            ax.set_title(name)
            ax.set_ylabel(r"strain per $\sigma$, %")
            ax.set_xlabel("time $t$")
        for ax in axes[n:]:
            ax.axis("off")
        lines = [ours[0], exact[0], one[0], euler[0], pull[0]]
        labels = [
            "simulation, adaptive second order",
            "exact, three-dimensional",
            "one-dimensional formula",
            f"simulation, steps of {config.step:g}, first order",
            "load",
        ]
        if n < len(axes):
            axes[n].legend(lines, labels, loc="center")
        else:
            figure.legend(lines, labels, loc="outside lower center", ncols=2)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
