"""Drafts: designs by the rod, on their way to the solver, and driven to a wished angle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from foldlab.errors import InputError
from foldlab.inverse.points import columns_of, groups_of, physical_of
from foldlab.inverse.region import Region
from foldlab.inverse.rungs import Rungs, answered, turned
from foldlab.inverse.wish import Wish
from foldlab.materials import read_materials

# What is changed to reach an angle, in this order: the first that the wish leaves free.
DRIVERS = ("contraction", "hinge_length", "h_ratio", "slenderness", "E_ratio", "l_s")
FREE = 0.2  # decades that one correction of an angle may take


@dataclass(frozen=True)
class Draft:
    """A design by the rod: log10 variables ``x`` (see :class:`Region`);
    ``driver``: the group along which an angle is reached, or None."""

    pair: tuple[str | None, str | None]
    region: Region
    x: np.ndarray
    driver: str | None = None

    @property
    def groups(self) -> dict[str, float]:
        columns = columns_of(self.region, self.x[None])
        return {name: float(value[0]) for name, value in columns.items()}

    @property
    def physical(self) -> dict[str, float]:
        groups = groups_of(self.region, self.x[None])
        return physical_of(self.region, groups, self.x[None]).iloc[0].dropna().to_dict()


def bearable(wish: Wish, pair: tuple[str | None, str | None]) -> dict[str, float]:
    """Strain that each layer surely bears; raises :class:`InputError` where nothing is known."""
    table, out = read_materials(wish.materials), {}
    for layer, name in zip(("passive", "active"), pair, strict=True):
        low = np.nan if name is None else float(table.loc[name, "strain_low"])
        if not np.isfinite(low):
            whom = name or f"the {layer} layer, which has no material"
            raise InputError(
                f"strain_margin = {wish.strain_margin:g} asks for the strain that {whom} bears, "
                "and none is known; name a material whose table has strain_low"
            )
        out[layer] = low
    return out


@dataclass(frozen=True)
class Work:
    """What :func:`foldlab.inverse.finish.finish` is asked for; it travels to workers."""

    wish: Wish
    draft: Draft
    source: Any
    box: bool = True


def driven(draft: Draft, rungs: Rungs) -> Draft | None:
    """The design nearest to a draft, along the first free driver, whose rod has the wished angle;
    None where there is none."""
    wanted = rungs.wish.want.value
    for name in DRIVERS:
        line = draft.region.line(draft.x, name)
        if line is None:
            continue
        direction, low, high = line
        low, high = max(low, -1.0), min(high, 1.0)
        if high - low < 1e-6:
            continue

        def off(t, direction=direction):
            design = columns_of(draft.region, (draft.x + t * direction)[None])
            return turned({name: float(value[0]) for name, value in design.items()})[0] - wanted

        grid = np.unique(np.r_[np.linspace(low, high, 9), 0.0])
        values = np.array([off(t) for t in grid])
        change = np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) <= 0)
        ends = sorted(change, key=lambda k: min(abs(grid[k]), abs(grid[k + 1])))
        for k in ends:
            if not np.isfinite(values[k : k + 2]).all():
                continue
            t = _root(off, grid[k], grid[k + 1])
            if t is None:
                continue
            there = replace(draft, x=draft.x + t * direction, driver=name)
            if not (rungs.wish.stands and not rungs.rocking and answered(there.groups)[2]):
                return there
    return None


def _root(off: Callable[[float], float], low: float, high: float) -> float | None:
    """Where a function is 0; None at a jump or where it is nowhere known."""
    try:
        t = brentq(off, low, high, xtol=1e-5, maxiter=30)
    except (ValueError, RuntimeError):
        return None
    return t if abs(off(t)) < 0.01 else None


def steered(draft: Draft, rungs: Rungs, turn: float) -> Draft:
    """The same design with the first driver, its own before others, that turns the rod by ``turn``
    rad; with the one that turns it the most towards that where none does.

    Where something is least, the first free group often lies on its bound or moves nothing.
    """
    best, most = draft, 0.0
    for name in dict.fromkeys((draft.driver, *DRIVERS)):
        line = draft.region.line(draft.x, name)
        if line is None:
            continue
        ends = np.array([max(-FREE, line[1]), 0.0, min(FREE, line[2])])
        angles = rungs.rod(groups_of(draft.region, draft.x + ends[:, None] * line[0]))["angle"]
        turns = (angles.to_numpy() - angles[1]) * np.sign(turn)
        reach = float(np.nanmax(turns, initial=0.0))
        if reach > most:
            best, most = replace(draft, driver=name), reach
        if reach >= abs(turn):
            break
    return best
