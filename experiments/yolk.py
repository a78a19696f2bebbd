"""What does an incompressible yolk do to a ventral furrow?

The shell of the furrow, empty and full of a yolk of bulk modulus K: depth of the furrow, volume of
the cavity and pressure of the yolk as the ventral side contracts; towards K → ∞, where the volume
stays; on coarser and finer meshes.
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
from solver.cases.tissue import furrow
from solver.cases.tissue.model import ramp
from solver.viscous.evolution import TimeSteps, evolve, start

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    """``bulks``: K over the tissue's E, 0: an empty shell; ``checked``: the one that is followed on
    the meshes of ``finer`` too; ``steps`` of equal size over t_fin = 1 s."""

    seed: int = 0
    mesh: str = "hex20:1"
    bulks: tuple[float, ...] = (0.0, 0.1, 1.0, 10.0, 1000.0)
    checked: float = 10.0
    finer: tuple[str, ...] = ("hex20:0", "hex20:2", "hex27:1")
    steps: int = 50
    contraction: float = 0.5


TINY = Config(mesh="hex20:0", bulks=(0.0, 10.0), finer=(), steps=50, contraction=0.1)


def run(config: Config, tracker) -> dict[str, Any]:
    if not config.bulks or min(*config.bulks, config.checked) < 0 or config.steps < 1:
        raise InputError(
            f"bulks = {config.bulks}, checked = {config.checked}, steps = {config.steps}; expected "
            "moduli of at least 0 and a step"
        )
    wanted = [(config.mesh, bulk) for bulk in config.bulks]
    wanted += [(mesh, config.checked) for mesh in config.finer]
    models = [built(config, mesh, bulk) for mesh, bulk in wanted]
    rows, curves = [], []
    for (mesh, bulk), model in zip(wanted, models, strict=True):
        row, curve = follow(config, model, mesh, bulk)
        rows.append(row)
        curves.append(curve)
    curves = pd.concat(curves)
    table, finer = rows[: len(config.bulks)], rows[len(config.bulks) :]
    tracker.table("yolk", pd.DataFrame(rows))
    tracker.table("curves", curves)
    figure = plot(config, curves)
    save_figure(figure, "yolk")
    tracker.figure("yolk", figure)
    return {"table": table, "finer": finer}


def built(config: Config, mesh: str, bulk: float) -> furrow.Furrow:
    """The model of element:level; raises InputError for what there isn't."""
    element, _, level = mesh.partition(":")
    if not level.isdigit():
        raise InputError(f"mesh {mesh!r}; expected element:level, such as hex20:1")
    try:
        return furrow.build(
            int(level), element=element, contraction=config.contraction, yolk=bulk or None
        )
    except ValueError as error:
        raise InputError(str(error)) from error


def follow(config: Config, model: furrow.Furrow, mesh: str, bulk: float):
    """One path: its row and, over the contraction, depth, indentation, volume and pressure."""
    clock, dt = time.process_time(), 1 / config.steps
    scene = model.viscous(dt)
    path = evolve(scene, start(scene), TimeSteps(1e-6, dt), until=1.0, load=ramp(1.0))
    still = model.measure(np.zeros_like(model.body.nodes))
    curve = []
    for state in path.states:
        u = scene.displacement(state.x, state.e)
        found = model.measure(u)
        p = model.terms[0].pressure(u, state.e) if bulk else 0.0
        curve.append((mesh, bulk, config.contraction * state.e, found.depth, found.indentation,
                      found.cavity / still.cavity, p / model.tissue.E))  # fmt: skip
    names = ["mesh", "bulk", "contraction", "depth", "indentation", "cavity", "pressure"]
    curve = pd.DataFrame(curve, columns=names)
    row = {
        **curve.iloc[-1].to_dict(), "unknowns": scene.size, "steps": path.last.index,
        "iterations": sum(s.iterations for s in path.states),
        "cpu_seconds": time.process_time() - clock, "outcome": path.reason,
    }  # fmt: skip
    print(row, file=sys.stderr)
    return row, curve


def plot(config: Config, curves: pd.DataFrame):
    """Depth, volume and pressure over the contraction, one line per bulk modulus."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.5), layout="constrained")
        axes = figure.subplots(1, 3)
        labels = {"depth": "depth of the furrow (half lengths)", "cavity": "cavity's volume",
                  "pressure": "pressure of the yolk over $E$"}  # fmt: skip
        mine = curves[curves["mesh"] == config.mesh]
        for colour, bulk in zip(np.resize(LINES, len(config.bulks)), config.bulks, strict=True):
            part = mine[mine["bulk"] == bulk]
            part = part[~part["contraction"].duplicated()]
            for ax, (name, label) in zip(axes, labels.items(), strict=True):
                text = f"$K/E = {bulk:g}$" if bulk else "empty"
                ax.plot(part["contraction"], part[name], color=colour, lw=1, label=text)
                ax.set_ylabel(label)
                ax.set_xlabel("contraction $|g|$")
        axes[0].legend(fontsize=7)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
