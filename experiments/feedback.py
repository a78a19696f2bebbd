"""Does growth that answers to stress do as the law says, what does it take, and is its rest stable?

A clamped bar beside the ordinary differential equation, a free ring and one on a mandrel beside
their radial solution, the orders in time, the balance of energy; and the rates at which
disturbances of a homeostatic state die out or grow, of bars and of rings that are held in different
ways, beside closed forms and the radial solution (Eq. 2.32, §6.3.1).
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from foldlab.plots import LINES, STYLE
from solver.cases.tissue.feedback import (
    INNER,
    OUTER,
    WIDENED,
    Bar,
    Radial,
    Ring,
    cylindrical,
    uniaxial,
)
from solver.output import cell_fields
from solver.viscous.balance import balance
from solver.viscous.evolution import TimeSteps, evolve, start, stepped
from solver.viscous.homeostasis import homeostasis

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    """``tolerance``: error of an adaptive step, a log stretch; ``until``, ``ring_until``: times to
    which bars and rings are followed; ``cells``: of a ring along its radius; ``divisions``: numbers
    of steps for the orders; ``pressure`` (stress) and ``widened`` (length): what holds the rings
    whose stability is told."""

    seed: int = 0
    tolerance: float = 1e-6
    until: float = 15.0
    ring_until: float = 2.0
    cells: tuple[int, ...] = (4, 8, 16)
    divisions: tuple[int, ...] = (40, 80, 160)
    pressure: float = 0.05
    widened: float = 0.1


TINY = Config(tolerance=1e-4, until=2.0, ring_until=0.5, cells=(2,), divisions=(40, 80))

BARS = {
    "along the bar": Bar(),
    "of the volume": Bar(along=False, target=0.03),
    "along the bar, Eshelby": Bar(measure="eshelby"),
    "of the volume, Eshelby": Bar(along=False, target=0.03, measure="eshelby"),
    "compressed": Bar(stretch=0.9, target=-0.02),
}
RINGS = {
    "free": Ring(),
    "on a mandrel": Ring(rates=(0.0, 1.5, 0.0), baseline=0.0, widened=0.1),
}


def run(config: Config, tracker) -> dict[str, Any]:
    bars, curves = zip(*(bar(config, name) for name in BARS), strict=True)
    rings, profiles = [], []
    for name in RINGS:
        radial = Radial(RINGS[name])
        wanted = radial.growth(config.ring_until)
        for cells in config.cells:
            row, profile = ring(config, name, cells, radial, wanted)
            rings.append(row)
            profiles.append(profile)
    orders = order_study(config)
    rests = stability(config)
    curves, profiles = pd.concat(curves), pd.concat(profiles)
    for name, rows in (("bars", bars), ("rings", rings), ("orders", orders), ("rests", rests)):
        tracker.table(name, pd.DataFrame(rows))
    tracker.table("curves", curves)
    tracker.table("profiles", profiles)
    figure = plot(config, curves, profiles, rests)
    save_figure(figure, "feedback")
    tracker.figure("feedback", figure)
    finest = [row for row in rings if row["cells"] == max(config.cells)]
    return {
        "table": list(bars),
        "rings": rings,
        "orders": orders,
        "rests": rests,
        "worst_bar": max(row["off"] for row in bars),
        "worst_ring_growth": max(row["growth_off"] for row in finest),
        "worst_ring_stress": max(row["stress_off"] for row in finest),
        "worst_gap": max(row["gap"] for row in bars),
        "worst_rate": max(abs(row["rate"] / row["exact"] - 1) for row in rests),
        **{f"order_{k}": slope([row for row in orders if row["order"] == k]) for k in (1, 2)},
    }


def bar(config: Config, name: str) -> tuple[dict, pd.DataFrame]:
    """How far a clamped bar is from its equation and its stress from what the law seeks."""
    case = BARS[name]
    scene = case.scene(1e-3)
    clock = time.perf_counter()
    path = evolve(scene, start(scene), TimeSteps(1e-10, 1e-3, config.tolerance), until=config.until)
    seconds = time.perf_counter() - clock
    found = np.array([state.level.memories[0].growth.mean() for state in path.states])
    exact = case.exact(path.times)
    stress = [case.stress(gamma) for gamma in found]
    row = {
        "growth": name,
        "at_first": stress[0],
        "at_last": stress[-1],
        "sought": case.rest,
        "off": np.abs(found - exact).max() / np.abs(exact).max(),
        "from_target": abs(stress[-1] / case.rest - 1),
        "gap": balance(scene, path.states).gap,
        "steps": len(path.states) - 1,
        "seconds": seconds,
        "outcome": path.reason,
    }
    print(row, file=sys.stderr)
    columns = {"growth": name, "t": path.times, "gamma": found, "exact": exact}
    return row, pd.DataFrame({**columns, "stress": stress, "sought": case.rest})


def ring(
    config: Config, name: str, cells: int, radial: Radial, wanted: np.ndarray
) -> tuple[dict, pd.DataFrame]:
    """How far a ring is from its radial solution at the end, in γ and in Cauchy stress."""
    until = config.ring_until
    scene = RINGS[name].scene(cells, 1e-2)
    clock = time.perf_counter()
    path = evolve(
        scene,
        start(scene),
        TimeSteps(1e-10, 1e-2, config.tolerance),
        until=until,
        breaks=(WIDENED,),
    )
    seconds = time.perf_counter() - clock
    X = scene.body.points()
    R, axes = np.hypot(X[..., 0], X[..., 1]), cylindrical(0.0, X)
    now, u = stepped(scene, *path.states[-2:]), scene.displacement(path.last.x, path.last.e)
    sigma = cell_fields(scene.body, u, now.terms, path.last.e)["cauchy"]
    sigma = np.einsum("mqai,mqij,mqaj->mqa", axes, sigma, axes)
    growth, cauchy = path.last.level.memories[0].growth, radial.cauchy(until, wanted)
    row = {
        "ring": name,
        "cells": cells,
        "growth_off": np.abs(growth - radial.at(R, wanted)).max() / np.abs(wanted).max(),
        "stress_off": np.abs(sigma - radial.at(R, cauchy)).max() / np.abs(cauchy).max(),
        "inside": cauchy[1, 0],
        "outside": cauchy[1, -1],
        "steps": len(path.states) - 1,
        "seconds": seconds,
        "outcome": path.reason,
    }
    print(row, file=sys.stderr)
    columns = {"R": R.ravel(), "hoop": sigma[..., 1].ravel()}
    columns["exact"] = radial.at(R, cauchy)[..., 1].ravel()
    return row, pd.DataFrame({"ring": name, "cells": cells, **columns}).sort_values("R")


def order_study(config: Config) -> list[dict]:
    """Errors of γ of a bar after fixed steps of first and second order."""
    case, until = BARS["of the volume"], 2.0
    exact, rows = case.exact(np.array([until]))[0], []
    for order in (1, 2):
        for n in config.divisions:
            scene = case.scene(until / n)
            stepper = TimeSteps(1e-12, until / n, order=order)
            path = evolve(scene, start(scene), stepper, until=until)
            off = abs(path.last.level.memories[0].growth.mean() - exact)
            gap = balance(scene, path.states).gap
            rows.append({"order": order, "steps": n, "off": off, "gap": gap})
    return rows


def slope(rows: list[dict]) -> float:
    """Order from the two smallest steps."""
    a, b = sorted(rows, key=lambda row: row["steps"])[-2:]
    return float(np.log(a["off"] / b["off"]) / np.log(b["steps"] / a["steps"]))


def stability(config: Config) -> list[dict]:
    """Rates of homeostatic bars and rings, and the verdict: compared is that of growth which is the
    same everywhere, or most like it."""
    rows = []
    held = uniaxial(1.2)[0]
    for name, case in {
        "bar, clamped": Bar(baseline=0.0, target=held),
        "bar, clamped, rate reversed": Bar(baseline=0.0, target=held, rate=-2.0),
    }.items():
        scene = case.scene(1e-2)
        found = homeostasis(scene, settled(scene))
        shape = (*scene.body.weights.shape, 1)
        rate = found.rate(np.ones(shape)).real
        rows.append(row_of(name, found, rate, case.eigenvalue(0.0)))
    hoop = Ring(rates=(0.0, 1.0, 0.0), baseline=0.0, settled=True)
    pressed = replace(hoop, pressure=config.pressure)
    for name, case in {
        "ring, hoops, on a mandrel": replace(hoop, widened=config.widened),
        "ring, hoops, pressure": pressed,
        "ring, hoops, pressure, rate reversed": replace(pressed, rates=(0.0, -1.0, 0.0)),
    }.items():
        scene = case.scene(4, 1e-2)
        found = homeostasis(scene, settled(scene))
        field = np.zeros(found.modes.shape[1:])
        field[..., 1] = 1.0
        radial = Radial(case)
        rates = radial.rates(radial.still).real
        # That of a mean growth of the hoops stands apart; growth without a rate stays.
        exact = rates[np.abs(rates) > 1e-6]
        rows.append(row_of(name, found, found.rate(field).real, exact[np.abs(exact).argmin()]))
    for row in rows:
        print(row, file=sys.stderr)
    return rows


def settled(scene):
    """The state in which loads and supports have come so fast that nothing grew."""
    path = evolve(
        scene, start(scene), TimeSteps(1e-10, 1e-6), until=1e-5, load=lambda t: 1e5 * WIDENED * t
    )
    if not path.reached:
        raise ArithmeticError(f"the homeostatic state was not reached: {path.reason}")
    return path.last


def row_of(name: str, found, rate: float, exact: float) -> dict:
    """A row of :func:`stability`."""
    return {
        "state": name,
        "rate": rate,
        "exact": exact,
        "fastest": found.rates[0].real,
        "speed": found.speed,
        "neutral": found.neutral,
        "verdict": found.verdict.name.lower(),
    }


def plot(config: Config, curves: pd.DataFrame, profiles: pd.DataFrame, rests: list[dict]):
    """Stress of bars over time, hoop stress of rings over the radius, rates of disturbances."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.2), layout="constrained")
        axes = figure.subplots(1, 3)
        for (name, part), color in zip(curves.groupby("growth", sort=False), LINES, strict=False):
            axes[0].plot(part["t"], part["stress"] / part["sought"], color=color, label=name)
        axes[0].axhline(1.0, color="#777777", lw=0.7)
        axes[0].set(xlabel="time $t$", ylabel="stress over what the law seeks")
        axes[0].legend(fontsize=7)
        finest = profiles[profiles["cells"] == max(config.cells)]
        for (name, part), color in zip(finest.groupby("ring", sort=False), LINES, strict=False):
            axes[1].plot(part["R"], part["exact"], color=color, label=f"{name}, radial solution")
            some = part.iloc[:: max(1, len(part) // 40)]
            axes[1].plot(some["R"], some["hoop"], "o", color=color, ms=2.5, label=f"{name}, found")
        axes[1].set(xlabel="radius $R$", ylabel=r"hoop stress over $E$", xlim=(INNER, OUTER))
        axes[1].legend(fontsize=7)
        places = np.arange(len(rests))
        axes[2].barh(places, [row["rate"] for row in rests], color=LINES[0], height=0.5)
        axes[2].plot([row["exact"] for row in rests], places, "|", color="black", ms=12)
        axes[2].axvline(0.0, color="#777777", lw=0.7)
        axes[2].set_yticks(places, [row["state"] for row in rests], fontsize=7)
        axes[2].set_xlabel("rate of the disturbance (tick: exact)")
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
