"""How does a lung whose tissues relax inflate, creep and react to its puncture?

A Maxwell branch beside the spring of epithelium and of muscle (chapter 5's standard linear solid in
chapter 3's lung), on the wedge: inflation, rest under pressure, puncture and rest in 100 steps; the
same at rates from far too fast to far too slow for the branches, beside both elastic limits; which
tissue's relaxation matters; creep under pressures below and above the limit point of what is left
after long, where the lung holds for a while and then gives way; and a long rest after the puncture.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from foldlab.plots import LINES, STYLE
from solver.cases.lung.measures import measure
from solver.cases.lung.mesh import hexahedra
from solver.cases.lung.model import REST, State, scene, to_limit
from solver.cases.lung.model import run as follow_elastic
from solver.cases.lung.viscous import Relaxing, at_once, course, viscous
from solver.mesh.body import Body
from solver.viscous.evolution import TimeSteps, Unresolved, evolve, start

from .common import main, save_figure
from .lung_inflation import memory, prepared


@dataclass(frozen=True)
class Config:
    """Sizes in R, stresses in E_ep, times in the relaxation time τ of both tissues. ``times``: of
    inflation, rest, puncture and rest in ``steps`` equal steps on ``level``; ``rates``: times of
    inflation and of puncture without a rest, on ``coarse``, as the other studies; ``branch``:
    E_m/E_s of both; ``creeps``: pressures over that of the limit point of the slow lung, put on in
    a tenth of τ and left on for ``until``, as the rest after the puncture is."""

    seed: int = 0
    n: int = 2
    epithelium: float = 0.05
    muscle: float = 0.075
    width: float | None = None
    stiffness: float = 75.0
    nu: float = 0.3
    pressure: float = 0.11
    pressure_drop: float = 0.1
    contraction: float = -0.4
    branch: float = 1.0
    times: tuple[float, ...] = (1.2, 1.8, 1.2, 1.8)
    steps: int = 100
    level: int = 2
    coarse: int = 1
    rates: tuple[float, ...] = (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e3, 1e5)
    rate_steps: int = 40
    creeps: tuple[float, ...] = (0.5, 0.9, 0.97, 1.03, 1.06, 1.1, 1.2)
    until: float = 100.0
    tolerance: float = 2e-3


TINY = Config(
    n=1, level=0, coarse=0, pressure=0.05, contraction=-0.05, steps=10, rates=(1e-3, 1e5),
    rate_steps=6, creeps=(0.9,), until=5.0, tolerance=1e-2,
)  # fmt: skip


class Bench:
    """What the studies share: the lung, its states, and paths in time."""

    def __init__(self, config: Config):
        levels = [config.level, config.coarse]
        self.lung, self.tissue = prepared(config, config.contraction, levels)
        self.config = config
        if len(config.times) != 4 or min(config.times, default=0) <= 0:
            raise InputError(f"times = {config.times}; expected four times above 0")
        if min(*config.rates, *config.creeps, config.until, config.tolerance) <= 0:
            raise InputError("rates, creeps, until, tolerance: expected numbers above 0")
        if min(config.steps, config.rate_steps) < 4:
            raise InputError(
                f"steps = {config.steps}, rate_steps = {config.rate_steps}; expected at least 4"
            )
        self.full = State(config.pressure)
        self.low = State(config.pressure * (1 - config.pressure_drop), config.contraction)
        self.both = self.relaxing()

    def relaxing(self, epithelium: bool = True, muscle: bool = True) -> Relaxing:
        """The branches of both tissues or of one."""
        m = self.config.branch
        try:
            return Relaxing(m * epithelium, m * muscle)
        except ValueError as error:
            raise InputError(str(error)) from error

    def path(
        self,
        body: Body,
        states: Sequence[State],
        times: Sequence[float],
        *,
        relaxing: Relaxing | None = None,
        steps: int = 0,
        tolerance: float | None = None,
    ):
        """Path in time through the states, and over it time, inflation and shape: a table."""
        ends = np.cumsum(times)
        dt = ends[-1] / steps if steps else 0.02
        stage = viscous(body, self.lung, self.tissue, relaxing or self.both, states, dt=dt)
        stepper = TimeSteps(1e-7, dt, tolerance=tolerance, smallest=0.01)
        with warnings.catch_warnings():
            # Slow and fast processes are meant; how far steps are resolved a row tells.
            warnings.simplefilter("ignore", Unresolved)
            path = evolve(
                stage, start(stage), stepper, until=float(ends[-1]), load=course(*times),
                breaks=tuple(ends[:-1]),
            )  # fmt: skip
        rows = []
        for state in path.states:
            found = measure(body, self.lung, stage.displacement(state.x, state.e))
            rows.append((state.t, state.e, found.aspect, found.highest, found.lowest))
        names = ["t", "e", "aspect", "highest", "lowest"]
        return stage, path, pd.DataFrame(rows, columns=names)

    def elastic(self, stages: Sequence) -> list[float | None]:
        """Aspect ratios of elastic stages that follow each other, at the end of each; None from
        where one has no state on. A loss of stability settles."""
        out, x = [], None
        for stage in stages:
            path = follow_elastic(stage, x, steps=20, events=False, over="settle")
            if not path.reached:
                break
            x = path.last.x
            u = stage.displacement(x, 1.0)
            out.append(measure(stage.body, self.lung, u).aspect)
        return [*out, *[None] * (len(stages) - len(out))]


def run(config: Config, tracker) -> dict[str, Any]:
    bench = Bench(config)
    table, curves = whole(bench)
    coarse = hexahedra(bench.lung, config.coarse)
    rates, limits = rate_study(bench, coarse)
    tissues = tissue_study(bench, coarse)
    creeps, creep_curves, limit = creep_study(bench, coarse)
    rest, rest_curve = rest_study(bench, coarse)
    tables = {"course": table, "rates": rates, "tissues": tissues, "creeps": creeps, "rest": rest}
    for name, rows in tables.items():
        tracker.table(name, pd.DataFrame(rows))
    tracker.table("curves", curves)
    figure = plot(config, curves, rates, limits, creep_curves, rest_curve)
    save_figure(figure, "lung_viscous")
    tracker.figure("lung_viscous", figure)
    return {
        **tables, "table": table, "limits": limits, "limit_pressure": limit,
        "cpu_seconds_of_100_steps": 100 * table[0]["cpu_seconds"] / table[0]["steps"],
    }  # fmt: skip


def whole(bench: Bench) -> tuple[list[dict], pd.DataFrame]:
    """Inflation, rest, puncture, rest: in the steps, and in twice as many."""
    config = bench.config
    body = hexahedra(bench.lung, config.level)
    states = (REST, bench.full, bench.full, bench.low, bench.low)
    rows, curves = [], []
    for steps in (config.steps, 2 * config.steps):
        clock = time.process_time()
        stage, path, curve = bench.path(body, states, config.times, steps=steps)
        row = {
            "wanted_steps": steps, "steps": len(path.states) - 1, "unknowns": stage.size,
            "internal": 6 * body.weights.size,
            "iterations": sum(s.iterations for s in path.states),
            "cpu_seconds": time.process_time() - clock, "memory_mb": memory(),
            "dissipated": 120 * path.last.dissipated, "outcome": path.reason,
        }  # fmt: skip
        for name, end in zip(
            ("inflated", "rested", "punctured", "rested_again"), np.cumsum(config.times),
            strict=True,
        ):  # fmt: skip
            at = np.flatnonzero(np.isclose(curve["t"], end))
            row[name] = float(curve["aspect"][at[0]]) if len(at) else None
        print(row, file=sys.stderr)
        rows.append(row)
        curves.append(curve.assign(steps=steps))
    return rows, pd.concat(curves)


def rate_study(bench: Bench, body: Body) -> tuple[list[dict], dict]:
    """Inflated and punctured in times from far below to far above τ, and both elastic limits."""
    config = bench.config
    states = (REST, bench.full, bench.low)
    stages = {
        "fast": lambda *s: at_once(body, bench.lung, bench.tissue, bench.both, s),
        "slow": lambda *s: scene(body, bench.lung, bench.tissue, *s),
    }
    limits = {}
    for name, stage in stages.items():
        inflated, punctured = bench.elastic([stage(*pair) for pair in pairwise(states)])
        limits[name] = {"inflated": inflated, "punctured": punctured}
    rows = []
    for rate in config.rates:
        _, path, curve = bench.path(body, states, (rate, rate), steps=2 * config.rate_steps)
        at = np.flatnonzero(np.isclose(curve["t"], rate, rtol=1e-9))
        row = {
            "time": rate,
            "inflated": float(curve["aspect"][at[0]]) if len(at) else None,
            "punctured": float(curve["aspect"].iloc[-1]) if path.reached else None,
            "dissipated": 120 * path.last.dissipated, "outcome": path.reason,
        }  # fmt: skip
        print(row, file=sys.stderr)
        rows.append(row)
    print(limits, file=sys.stderr)
    return rows, limits


def tissue_study(bench: Bench, body: Body) -> list[dict]:
    """The course with branches in one tissue alone."""
    config = bench.config
    states = (REST, bench.full, bench.full, bench.low, bench.low)
    rows = []
    for name, which in (
        ("both", (True, True)), ("epithelium", (True, False)), ("muscle", (False, True)),
    ):  # fmt: skip
        _, path, curve = bench.path(
            body, states, config.times, relaxing=bench.relaxing(*which), steps=config.steps
        )
        found = np.interp(np.cumsum(config.times), curve["t"], curve["aspect"])
        row = {"relaxes": name, **dict(zip(
            ("inflated", "rested", "punctured", "rested_again"), map(float, found), strict=True
        )), "outcome": path.reason}  # fmt: skip
        print(row, file=sys.stderr)
        rows.append(row)
    return rows


def creep_study(bench: Bench, body: Body) -> tuple[list[dict], pd.DataFrame, float]:
    """Pressures that stay on, as fractions of the slow lung's limit point."""
    config = bench.config
    stage = scene(body, bench.lung, bench.tissue, REST, bench.full)
    path = follow_elastic(stage, steps=10, events=False, over=None)
    ahead = to_limit(stage, path, step=0.03)
    if not ahead.reached:
        raise InputError(
            f"no limit point of the pressure was found beyond {config.pressure:g}: "
            f"{ahead.outcome.value}; take another lung"
        )
    limit, rows, curves = config.pressure * ahead.last.e, [], []
    for fraction in config.creeps:
        on = State(fraction * limit)
        slow = None
        if fraction < 1:
            (slow,) = bench.elastic([scene(body, bench.lung, bench.tissue, REST, on)])
        _, path, curve = bench.path(
            body, (REST, on, on), (0.1, config.until), tolerance=config.tolerance
        )
        far = None
        if slow is not None and curve["aspect"].iloc[-1] > 0.95 * slow:
            far = float(np.interp(0.95 * slow, curve["aspect"], curve["t"]))
        row = {
            "fraction": fraction, "pressure": on.pressure, "holds": path.reached,
            "aspect": float(curve["aspect"].iloc[-1]), "slow": slow, "time_to_95": far,
            "gave_way_at": None if path.reached else float(path.last.t),
            "steps": len(path.states) - 1, "outcome": path.reason,
        }  # fmt: skip
        print(row, file=sys.stderr)
        rows.append(row)
        curves.append(curve.assign(fraction=fraction))
    return rows, pd.concat(curves), limit


def rest_study(bench: Bench, body: Body) -> tuple[list[dict], pd.DataFrame]:
    """A long rest after the puncture: when the aspect ratio changes fastest, and where it ends."""
    config = bench.config
    states = (REST, bench.full, bench.full, bench.low, bench.low)
    times = (*config.times[:3], config.until)
    _, path, curve = bench.path(body, states, times, tolerance=config.tolerance)
    rest = curve[curve["t"] >= sum(times[:3]) * (1 - 1e-12)]
    rest = rest.assign(t=rest["t"] - sum(times[:3])).reset_index(drop=True)
    late = rest[rest["t"] > 3.0]
    fastest = None
    if len(late) > 2:
        rate = np.abs(np.diff(late["aspect"]) / np.diff(late["t"]))
        fastest = float(late["t"].iloc[int(rate.argmax())])
    row = {
        "times": times, "punctured": float(rest["aspect"].iloc[0]),
        "lowest": float(rest["aspect"].min()), "aspect": float(rest["aspect"].iloc[-1]),
        "fastest_after_3_at": fastest, "steps": len(path.states) - 1, "outcome": path.reason,
    }  # fmt: skip
    print(row, file=sys.stderr)
    return [row], rest


def plot(config: Config, curves, rates, limits, creeps, rest):
    """The course over time, the rates beside their limits, creep and the long rest."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.6), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        mine = curves[curves["steps"] == config.steps]
        left.plot(mine["t"], mine["aspect"], color=LINES[0], lw=1)
        for end in np.cumsum(config.times)[:-1]:
            left.axvline(end, color="#BBBBBB", lw=0.6)
        left.set_xlabel(r"time $t/\tau$")
        left.set_ylabel("aspect ratio")
        left.set_title("inflate | rest | puncture | rest", fontsize=7)
        for colour, name in zip(LINES, ("inflated", "punctured"), strict=False):
            found = [(row["time"], row[name]) for row in rates if row[name] is not None]
            middle.semilogx(*zip(*found, strict=True), "o-", color=colour, lw=1, ms=2.5, label=name)
            for kind, style in (("fast", "--"), ("slow", ":")):
                if limits[kind][name] is not None:
                    middle.axhline(limits[kind][name], ls=style, color=colour, lw=0.8)
        middle.set_xlabel(r"time of each over $\tau$")
        middle.set_title("dashed: at once, dotted: after long", fontsize=7)
        middle.legend(fontsize=7)
        colours = np.resize(LINES, len(config.creeps))
        for colour, (fraction, part) in zip(colours, creeps.groupby("fraction"), strict=True):
            part = part[part["t"] > 0]
            text = f"{fraction:g} $p_{{lim}}$"
            right.semilogx(part["t"], part["aspect"], color=colour, lw=1, label=text)
        rest = rest[rest["t"] > 0]
        right.semilogx(rest["t"], rest["aspect"], "k--", lw=0.8, label="after puncture")
        right.set_xlabel(r"time $t/\tau$")
        right.set_title("pressure left on", fontsize=7)
        right.set_ylim(0, 1.3)
        right.legend(fontsize=5, ncols=2, loc="upper left")
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
