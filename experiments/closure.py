"""Where does a neural tube close first if geometry alone decides, and does what fused stay closed?

Plates of one contraction β all along, whose radius, thickness or rise varies along them: the order
in which their sections close is an outcome, with folds that only touch and with folds that fuse. Of
one of them on finer meshes and steps, and after the contraction is taken back.
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
from solver.cases.tissue import neural_tube
from solver.cases.tissue.neural_tube import Shape
from solver.viscous.evolution import TimeSteps, Unresolved, evolve, start

from .common import main, save_figure

# Posterior end first; multiples of radius, thickness and the edges' angle.
GEOMETRIES = {
    "uniform": {},
    "wide posterior": {"radii": (1.2, 1.0)},
    "thick posterior": {"thicknesses": (1.3, 1.0)},
    "flat posterior": {"rises": (0.8, 1.0)},
    "narrow middle": {"radii": (1.15, 1.0, 1.15)},
}


@dataclass(frozen=True)
class Config:
    """``mesh``: element:level of all geometries in ``steps`` of equal size; ``checked``: the one
    that is also followed on ``finer`` meshes and steps (element:level:steps) and unloaded.
    ``sealing``: modulus of the fused layer over the tissue's."""

    seed: int = 0
    geometries: tuple[str, ...] = tuple(GEOMETRIES)
    mesh: str = "hex20:1"
    steps: int = 80
    checked: str = "wide posterior"
    finer: tuple[str, ...] = ("hex20:1:160", "hex20:2:80", "hex27:2:80")
    contraction: float = 0.4
    sealing: float = 1.0


TINY = Config(
    geometries=("wide posterior",), mesh="hex20:0", steps=12, finer=("hex20:0:20",),
    contraction=0.35,
)  # fmt: skip


def run(config: Config, tracker) -> dict[str, Any]:
    for name in (*config.geometries, config.checked):
        if name not in GEOMETRIES:
            raise InputError(f"no geometry {name!r}; there are: {', '.join(GEOMETRIES)}")
    if config.steps < 4 or not config.sealing > 0:
        raise InputError(
            f"steps = {config.steps}, sealing = {config.sealing:g}; expected at least 4 steps and "
            "a modulus > 0"
        )
    own = f"{config.mesh}:{config.steps}"
    for which in (own, *config.finer):
        parsed(which)
    rows, sections = [], []
    for name in config.geometries:
        for sealing in (None, config.sealing):
            row, order = follow(config, name, own, sealing)
            rows.append(row)
            sections += order
    check, _ = follow(config, config.checked, own, config.sealing)
    finer = [check]
    for which in config.finer:
        row, order = follow(config, config.checked, which, config.sealing)
        finer.append(row)
        sections += order
    unloaded = [follow(config, config.checked, own, k, back=True)[0]
                for k in (None, config.sealing)]  # fmt: skip
    tables = {"closure": rows, "finer": finer, "unloaded": unloaded}
    for name, table in tables.items():
        tracker.table(name, pd.DataFrame(table))
    tracker.table("sections", pd.DataFrame(sections))
    figure = plot(config, pd.DataFrame(sections), own)
    save_figure(figure, "closure")
    tracker.figure("closure", figure)
    return {"table": rows, "sections": sections, "finer": finer, "unloaded": unloaded}


def parsed(which: str) -> tuple[str, int, int]:
    """Element, level and number of steps of "hex20:1:80"; raises InputError for another text."""
    element, level, steps = (*which.split(":"), "", "")[:3]
    if not level.isdigit() or not steps.isdigit() or int(steps) < 4:
        raise InputError(f"mesh {which!r}; expected element:level:steps, such as hex20:1:80")
    return element, int(level), int(steps)


def follow(config: Config, name: str, which: str, sealing: float | None, back: bool = False):
    """One path on element:level:steps, its contraction then taken ``back``: its row, and per
    section where it lies and the contraction |g| at which it closes on the way there."""
    element, level, steps = parsed(which)
    try:
        model = neural_tube.build(
            level, element=element, shape=Shape(posterior=1.0, **GEOMETRIES[name]),
            contraction=config.contraction, sealing=sealing,
        )  # fmt: skip
    except ValueError as error:
        raise InputError(str(error)) from error
    clock, dt = time.process_time(), 1 / steps
    scene = model.viscous(dt)
    with warnings.catch_warnings():
        # How far steps are resolved is what ``finer`` tells.
        warnings.simplefilter("ignore", Unresolved)
        path = evolve(
            scene, start(scene), TimeSteps(1e-6, dt), until=2.0 if back else 1.0,
            load=lambda t: min(t, max(2 - t, 0.0)), breaks=(1.0,),
        )  # fmt: skip
    states = [(s.e, scene.displacement(s.x, s.e)) for s in path.states]
    closures = model.closures(states[: 1 + sum(t <= 1 for t in path.times[1:])])
    closed = {c.x: config.contraction * c.load for c in closures if c.load is not None}
    first = min(closed, key=closed.get) if closed else None
    widest = max((model.measure(u).closed for _, u in states), default=0.0)
    row = {
        "geometry": name, "mesh": which, "fuses": sealing is not None, "unknowns": scene.size,
        "first_at": None if first is None else first / closures[-1].x,
        "first_contraction": None if first is None else closed[first],
        "last_contraction": max(closed.values(), default=None),
        "from": min(closed, default=None), "to": max(closed, default=None),
        "closed": model.measure(states[-1][1]).closed, "closed_most": widest,
        "steps": len(path.states) - 1, "cpu_seconds": time.process_time() - clock,
        "outcome": path.reason,
    }  # fmt: skip
    print(row, file=sys.stderr)
    keys = {"geometry": name, "mesh": which, "fuses": sealing is not None}
    return row, [{**keys, "x": c.x, "contraction": closed.get(c.x)} for c in closures]


def plot(config: Config, sections: pd.DataFrame, own: str):
    """Contraction at which each section closes, along the plate: one panel per geometry."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    n = len(config.geometries)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(1.8 * n + 0.6, 2.6), layout="constrained")
        axes = np.atleast_1d(figure.subplots(1, n, sharey=True))
        for ax, name in zip(axes, config.geometries, strict=True):
            mine = sections[(sections["geometry"] == name) & (sections["mesh"] == own)]
            for colour, (fuses, part) in zip(LINES, mine.groupby("fuses"), strict=False):
                label = "folds fuse" if fuses else "folds touch"
                values = part["contraction"].astype(float)
                ax.plot(part["x"], values, "o-", color=colour, lw=1, ms=2.5, label=label)
            ax.set_title(name, fontsize=8)
            ax.set_xlabel("posterior → anterior, $x$")
        axes[0].set_ylabel("closes at contraction $|g|$")
        axes[0].legend(fontsize=7)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
