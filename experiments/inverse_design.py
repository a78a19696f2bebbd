"""Of varied wishes under weight, how many are answered by designs that the solver confirms?

Wishes vary in what shall fold (label or angle), materials, size, what is given and how heavy it may
be. Half are "possible": drawn around a unit of which the rod says that it does. Half are "open":
drawn without one, so that some have no answer but a size that is too large. Of the confirmed boxes
random corners are solved, whether the search asked about them or not.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from foldlab.inverse.box import Box
from foldlab.inverse.draft import Draft, Work
from foldlab.inverse.finish import as_wished
from foldlab.inverse.points import groups_of
from foldlab.inverse.rungs import MEET, SPACE, Rungs
from foldlab.inverse.weighted import WALKERS, regions_of, weighted
from foldlab.inverse.wish import Angle, Wish, mass_of
from foldlab.labels.solver import SolverSource
from foldlab.plots import STYLE

from .common import main, save_figure

PAIRS = (
    ("PET", "SMP"), ("polypropylene", "SMP"), ("polyimide film", "SMP"), ("paper", "SMP"),
    ("silicone", "LCE"), ("silicone", "hydrogel"), ("silicone", "SMP"),
)  # fmt: skip
SIZES = (0.01, 0.15)  # m, l_s
GIVEN = ("b_s", "h_s", "l_i")


@dataclass(frozen=True)
class Config:
    seed: int = 0
    wishes: int = 40
    kinds: tuple[str, ...] = ("possible", "open")
    tolerance: float = 0.05  # rad
    corners: int = 4  # solved again per box
    walkers: int = WALKERS


TINY = Config(wishes=2, kinds=("possible",), corners=1, walkers=256)


def run(config: Config, tracker) -> dict[str, Any]:
    source, rows, kinds = SolverSource(), [], config.kinds
    rng = np.random.default_rng(config.seed)
    for number in range(config.wishes):
        kind = kinds[number % len(kinds)]
        wish = (_possible if kind == "possible" else _open)(config, rng, number)
        rows.append({"wish": number, "kind": kind, **_answered(wish, config, source, number)})
    table = pd.DataFrame(rows)
    tracker.table("wishes", table)
    figure = _figure(table, config)
    tracker.figure("inverse_design", figure)
    save_figure(figure, "inverse_design")
    return {"table": rows, **_summary(table, config)}


def _possible(config: Config, rng, number: int) -> Wish:
    """A wish that a unit is known for by the rod: its sizes, its mass or a bit more, its angle."""
    while True:
        pair = PAIRS[rng.integers(len(PAIRS))]
        length = float(np.exp(rng.uniform(*np.log(SIZES))))
        wish = Wish(SPACE, passive=pair[:1], active=pair[1:], fixed={"l_s": length})
        ((_, region),) = regions_of(wish)
        x = region.sample(128, rng)
        groups = groups_of(region, x)
        angle = Rungs(wish).rod(groups)["angle"].to_numpy()
        folds = (angle > np.pi * groups["contraction"]) & (angle < MEET) & (angle > 0.2)
        if folds.any():
            break
    k = rng.choice(np.flatnonzero(folds))
    unit = Draft(pair, region, x[k]).physical
    fixed = {"l_s": length}
    for name in rng.permutation(GIVEN)[: rng.integers(0, 3)]:
        fixed[str(name)] = unit[name]
    mass = float(mass_of(pd.DataFrame([unit]))[0])
    return Wish(
        SPACE, fixed=fixed, passive=pair[:1], active=pair[1:],
        want=_want(number, float(angle[k]), config),
        max_mass=1.5 * mass if rng.random() < 0.5 else None,
    )  # fmt: skip


def _open(config: Config, rng, number: int) -> Wish:
    """A wish that nobody knows a unit for."""
    pair = PAIRS[rng.integers(len(PAIRS))]
    length = float(np.exp(rng.uniform(*np.log(SIZES))))
    return Wish(
        SPACE, fixed={"l_s": length, "b_s": length * float(rng.uniform(0.1, 0.8))},
        passive=pair[:1], active=pair[1:],
        want=_want(number, float(np.radians(rng.uniform(20, 160))), config),
        max_thickness=length * float(np.exp(rng.uniform(*np.log((0.005, 0.08))))),
    )  # fmt: skip


def _want(number: int, angle: float, config: Config):
    """Two angles for every label."""
    return "foldable" if number % 6 in (0, 3) else Angle(angle, config.tolerance)


def _answered(wish: Wish, config: Config, source, number: int) -> dict[str, Any]:
    begun = time.process_time()
    answer = weighted(wish, 1, seed=config.seed, source=source, walkers=config.walkers)
    spent = time.process_time() - begun
    angle = isinstance(wish.want, Angle)
    row = {
        "materials": f"{wish.passive[0]} + {wish.active[0]}",
        "l_s_mm": 1e3 * wish.fixed["l_s"],
        "want": np.degrees(wish.want.value) if angle else None,
        "confirmed": bool(answer.proposals),
        "rejected": answer.rejected,
        "angle_off": None,
        "margin": None,
        "held": None,
        "core_seconds": spent,
        "largest_mm": 1e3 * answer.largest["l_s"] if answer.largest else None,
        "reason": answer.reason,
    }
    for proposal in answer.proposals:
        row["margin"] = proposal.margin
        row["angle_off"] = abs(proposal.angle - wish.want.value) if angle else None
        row["held"] = _held(answer.wish, proposal, config, source, number)
    return row


def _held(wish: Wish, proposal, config: Config, source, number: int) -> float:
    """Fraction of random corners of a confirmed box that do as wished by the solver."""
    pair = proposal.materials
    regions = dict(regions_of(wish))
    names = regions[pair].names
    known = {**proposal.groups, **proposal.physical}
    draft = Draft(pair, regions[pair], np.log10([known[name] for name in names]))
    box = Box(draft, Rungs(wish, meet=True))
    scale = proposal.margin / box.unit
    designs = box.designs(scale)
    chosen = np.random.default_rng([config.seed, number]).permutation(len(designs))
    work = Work(wish, draft, source)
    said = [
        as_wished(work, source.label(design))
        for design in designs.iloc[chosen[: config.corners]].to_dict("records")
    ]
    return float(np.mean([verdict is True for verdict in said]))


def _summary(table: pd.DataFrame, config: Config) -> dict[str, Any]:
    out: dict[str, Any] = {"wishes": len(table)}
    for kind in config.kinds:
        some = table[table["kind"] == kind]
        out[f"confirmed_of_{kind}"] = float(some["confirmed"].mean())
    known = table[table["confirmed"]]
    off = known["angle_off"].dropna().astype(float)
    tried = len(known) + int(table["rejected"].sum())
    return out | {
        "confirmed_of_proposed": len(known) / tried if tried else None,
        "answered_by_a_size": int(table["largest_mm"].notna().sum()),
        "angle_within": float((off <= config.tolerance).mean()) if len(off) else None,
        "angle_off_median": float(off.median()) if len(off) else None,
        "angle_off_most": float(off.max()) if len(off) else None,
        "corners_that_hold": float(known["held"].mean()) if len(known) else None,
        "core_seconds_confirmed_median": float(known["core_seconds"].median()),
        "core_seconds_confirmed_mean": float(known["core_seconds"].mean()),
        "core_seconds_confirmed_most": float(known["core_seconds"].max()),
    }


def _figure(table: pd.DataFrame, config: Config):
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(3.4, 2.6), layout="constrained")
        ax = figure.subplots()
        for kind in config.kinds:
            some = table[(table["kind"] == kind) & table["confirmed"]]
            ax.plot(some["l_s_mm"], some["core_seconds"], "o", ms=4, label=f"{kind}, confirmed")
            rest = table[(table["kind"] == kind) & ~table["confirmed"]]
            ax.plot(rest["l_s_mm"], rest["core_seconds"], "x", ms=4, label=f"{kind}, none")
        ax.set(xscale="log", xlabel="l_s, mm", ylabel="core-seconds of a wish", ylim=(0, None))
        ax.legend()
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
