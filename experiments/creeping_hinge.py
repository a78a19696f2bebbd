"""How far does a folded unit sink back on its own weight when its hinge creeps?

A folding unit (quarter, gravity and ground) whose hinge is swapped for a standard linear solid: it
folds within a fraction of a relaxation time and is then left alone. The more of the hinge's
stiffness relaxes, the farther the panels sink; without weight the fold would stay.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from foldlab.labels import foldability
from foldlab.plots import LINES, STYLE
from solver.cases.tissue.model import ramp
from solver.cases.unit.choices import Meshing, Physics
from solver.cases.unit.model import build
from solver.cases.unit.unit import Unit
from solver.viscous.evolution import TimeSteps, evolve, start
from solver.viscous.rheology import SLS
from solver.viscous.term import softened

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    """``fractions``: of the hinge's stiffness that relaxes; ``t_fin``, ``until``: of the
    contraction and of the path, in relaxation times η/E_m."""

    seed: int = 0
    level: int = 0
    element: str = "hex20"
    fractions: tuple[float, ...] = (0.25, 0.5, 0.75)
    contraction: float = 0.1
    stiffness_to_weight: float = 0.2
    t_fin: float = 0.02
    until: float = 20.0
    tolerance: float = 1e-3


TINY = Config(fractions=(0.5,), contraction=0.02, until=1.0, tolerance=1e-2)


def run(config: Config, tracker) -> dict[str, Any]:
    rows, curves = [], []
    for fraction in config.fractions:
        for weight in (True, False):
            row, curve = follow(config, fraction, weight)
            print(row, file=sys.stderr)
            rows.append(row)
            curves.append(curve)
    curves = pd.concat(curves)
    tracker.table("hinges", pd.DataFrame(rows))
    tracker.table("curves", curves)
    figure = plot(curves)
    save_figure(figure, "creeping_hinge")
    tracker.figure("creeping_hinge", figure)
    return {"table": rows, "curves": curves.to_dict("records")}


def follow(config: Config, fraction: float, weight: bool):
    """The path of one hinge: its row, and fold angle and height of the panel's end over time."""
    unit = Unit(
        E_ratio=0.1, rho_ratio=1.0, hinge_length=0.25, hinge_width=1.0, h_ratio=5.0,
        stiffness_to_weight=config.stiffness_to_weight, aspect=0.2, slenderness=4e-3,
        contraction=config.contraction,
    )  # fmt: skip
    effects = ("gravity", "ground") if weight else ()
    model = build(unit, Meshing(config.level, element=config.element), Physics(effects))
    hinge = model.body.cells_where(lambda X: np.abs(X[:, 1]) < unit.hinge_length / 2)
    E = np.where(model.body.cells_of("active"), unit.E_ratio, 1.0)
    clock = time.perf_counter()
    branch = SLS((1 - fraction) * E, fraction * E, unit.nu, fraction * E)  # η/E_m = 1
    scene = softened(model.scene, branch, dt=config.t_fin / 20, cells=hinge)
    stepper = TimeSteps(1e-7, config.t_fin / 20, tolerance=config.tolerance)
    path = evolve(
        scene,
        start(scene),
        stepper,
        until=config.until,
        load=ramp(config.t_fin),
        breaks=(config.t_fin,),
    )
    angles = [
        foldability.measure(model.curves(s.x, s.e), unit.hinge_length).m1 for s in path.states
    ]
    folded = int(np.searchsorted(path.times, config.t_fin * (1 - 1e-9)))
    row = {
        "fraction": fraction,
        "weight": weight,
        "folded": angles[folded],
        "at_last": angles[-1],
        "lost": 1 - angles[-1] / angles[folded],
        "dissipated": path.last.dissipated,
        "unknowns": scene.size,
        "steps": len(path.states) - 1,
        "seconds": time.perf_counter() - clock,
        "outcome": path.reason,
    }
    names = {"fraction": fraction, "weight": weight, "t": path.times}
    return row, pd.DataFrame({**names, "angle": angles})


def plot(curves: pd.DataFrame):
    """Fold angle over time."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.6, 2.9), layout="constrained")
        ax = figure.subplots()
        for colour, (fraction, part) in zip(LINES, curves.groupby("fraction"), strict=False):
            for weight, style in ((True, "-"), (False, "--")):
                rows = part[(part["weight"] == weight) & (part["t"] > 0)]
                text = f"{fraction:.0%} relaxes" + ("" if weight else ", no weight")
                ax.semilogx(rows["t"], rows["angle"], style, color=colour, lw=1, label=text)
        ax.set_xlabel(r"time over relaxation time $t E_m/\eta$")
        ax.set_ylabel("fold angle, rad")
        ax.legend(fontsize=7)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
