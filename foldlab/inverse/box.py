"""Tolerances of a design under weight, by the rod's differences from the solver's answer."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
import pandas as pd

from foldlab.design import FULL, RATIOS, STRIPS, to_groups
from foldlab.inverse.draft import Draft
from foldlab.inverse.rungs import Rungs
from foldlab.inverse.wish import DEFAULT_MARGIN, Angle

# What is made: each may be off alone and all together. Groups stand for it without a scale.
MADE = {
    "h_s": "slenderness", "h_i": "h_ratio", "l_i": "hinge_length", "b_i": "hinge_width",
    "contraction": "contraction",
}  # fmt: skip
LARGEST = 4.0  # times the margin that a box may reach
# Of the tolerance of an angle, or of what counts as folded, that corners keep by the rod.
GUARD = 0.15


class Box:
    """Tolerances of a design, all of them as a fraction of the groups' bounds (``margin``) at once.

    ``correction``: the solver's angle less the rod's at the design, rad.
    """

    def __init__(self, draft: Draft, rungs: Rungs, correction: float = 0.0):
        self.wish, self.rungs, self.correction = rungs.wish, rungs, correction
        self.groups, physical = draft.groups, draft.physical
        self.sized = {*MADE} <= {*physical} and "E_i" in physical
        self.base = physical if self.sized else self.groups
        self.names = {name if self.sized else group: group for name, group in MADE.items()}
        self.unit = self.wish.margin or DEFAULT_MARGIN
        self.corner = np.array(list(product((0, 1), repeat=len(self.names))))

    def margin(self, scale: float) -> float:
        """Half-width as a fraction of the groups' bounds."""
        return scale * self.unit

    def ends(self, scale: float) -> dict[str, tuple[float, float]]:
        """Low and high by name, SI where the scale is known."""
        out = {}
        for name, group in self.names.items():
            p, value = FULL[group], self.groups[group]
            at = float(p.to_unit(value))
            low, high = (
                float(p.from_unit(np.clip(at + side * self.margin(scale), 0, 1)))
                for side in (-1, 1)
            )
            # A design beyond the bounds of its group keeps its own value as an end.
            low, high = min(low, value), max(high, value)
            out[name] = low / value * self.base[name], high / value * self.base[name]
        return out

    def designs(self, scale: float, at: np.ndarray | None = None) -> pd.DataFrame:
        """Groups of the corners, or of points ``at`` (n, names) between 0 and 1."""
        ends = np.array(list(self.ends(scale).values()))
        at = self.corner if at is None else at
        values = ends[:, 0] + at * (ends[:, 1] - ends[:, 0])
        table = pd.DataFrame([self.base] * len(values))
        table[list(self.names)] = values
        if self.sized:
            known = {*RATIOS, "E_s", "rho_s", "l_s", "g_earth", "contraction"}
            table = to_groups(table[[name for name in table if name in known]])
        cut = {name: self.groups[name] for name in STRIPS if name in self.groups}
        return table[FULL.names].assign(**cut)

    def rooms(self, designs: pd.DataFrame) -> np.ndarray:
        """rad to spare by the rod, corrected, beyond the guard, shape (n,)."""
        want, contraction = self.wish.want, designs["contraction"].to_numpy()
        if isinstance(want, Angle):
            guard = GUARD * want.tolerance
        else:
            guard = 0.2 * GUARD * np.pi * contraction
        return self.rungs.rooms(designs, self.correction) - guard

    def scale(self) -> float:
        """The largest at which every corner does as wished by the rod, at most :data:`LARGEST`."""
        good, bad = 0.0, LARGEST
        if self.rooms(self.designs(LARGEST)).min() >= 0:
            return LARGEST
        for _ in range(10):
            middle = (good + bad) / 2
            ok = self.rooms(self.designs(middle)).min() >= 0
            good, bad = (middle, bad) if ok else (good, middle)
        return good

    def worst(self, scale: float, number: int) -> list[Mapping[str, float]]:
        """The corners that are nearest to failing by the rod, an angle's on both sides."""
        designs = self.designs(scale)
        rooms = self.rooms(designs)
        order = list(np.argsort(rooms))
        if isinstance(self.wish.want, Angle):
            angle = self.rungs.rod(designs)["angle"].to_numpy()
            up, down = np.argsort(-angle), np.argsort(angle)
            order = [k for pair in zip(up, down, strict=True) for k in pair]
        chosen = list(dict.fromkeys(int(k) for k in order))[:number]
        return designs.iloc[chosen].to_dict("records")
