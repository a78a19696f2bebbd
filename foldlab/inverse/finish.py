"""A draft finished by the solver: its angle corrected, its label, and the tolerances it bears.

What the rod misses of an angle at one design it misses at its neighbours too. So one or two steps
along the driver, with the rod's slope and then the solver's, meet the wish; and a box of tolerances
is found with the rod's differences from the solver's answer. The solver then confirms the corners
that the rod thinks worst.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd

from foldlab.design import FULL, RATIOS, to_groups
from foldlab.inverse.answer import Proposal
from foldlab.inverse.points import MASS_COLUMNS, groups_of
from foldlab.inverse.rungs import Rungs
from foldlab.inverse.weighted import Draft, Work
from foldlab.inverse.wish import DEFAULT_MARGIN, Angle, mass_of
from foldlab.labels.label import Label

# What is made: each may be off alone and all together. Without a scale the groups that stand for it.
MADE = {
    "h_s": "slenderness", "h_i": "h_ratio", "l_i": "hinge_length", "b_i": "hinge_width",
    "contraction": "contraction",
}  # fmt: skip
# An angle that is off by less than this fraction of its tolerance is left as it is.
CLOSE = 0.3
LABELS = 4  # answers that an angle may cost
CORNERS = 4  # of a box that the solver confirms
SHRINK, ROUNDS = 0.7, 3
LARGEST = 4.0  # times the margin that a box may reach
# Of the tolerance of an angle, or of what counts as folded, that corners keep by the rod.
GUARD = 0.15
ANSWERS = 1.5 + CORNERS  # of the solver for a proposal, on average


def by_rod(work: Work) -> Proposal:
    """A draft as a proposal, with the box of the rod's word."""
    rungs = Rungs(work.wish, meet=True)
    turned = float(rungs.rod(pd.DataFrame([work.draft.groups]))["angle"].iloc[0])
    proposal = _proposal(work, work.draft, None, turned)
    box = Box(work, work.draft, rungs, 0.0)
    scale = box.scale()
    return replace(proposal, box=box.ends(scale), margin=box.margin(scale))


def finish(work: Work) -> Proposal:
    """A draft corrected and confirmed by the solver, with its box; unconfirmed where it fails."""
    rungs, draft = Rungs(work.wish, meet=True), work.draft
    draft, label, spent = _corrected(work, draft, rungs)
    angle = label.evidence.get("m1")
    proposal = _proposal(work, draft, label, angle)
    done = as_wished(work, label)
    proposal = replace(proposal, confirmed=done, core_seconds=sum(spent), answers=len(spent))
    if not (done and work.box):
        return proposal
    rod = float(rungs.rod(pd.DataFrame([label.design]))["angle"].iloc[0])
    box = Box(work, draft, rungs, angle - rod if np.isfinite(rod) else 0.0)
    scale = box.scale()
    for last in (*[False] * (ROUNDS - 1), True):
        said = []
        for design in box.worst(scale):
            answer = work.source.label(design)
            spent.append(answer.evidence.get("core_seconds", 0.0))
            said.append(as_wished(work, answer))
            if said[-1] is not True and not last:
                break
        if all(verdict is True for verdict in said) or last:
            break
        scale *= SHRINK
    return replace(
        proposal,
        box=box.ends(scale),
        margin=box.margin(scale),
        box_checked=len(said),
        box_held=sum(verdict is True for verdict in said),
        box_unknown=sum(verdict is None for verdict in said),
        core_seconds=sum(spent),
        answers=len(spent),
    )


def as_wished(work: Work, label: Label) -> bool | None:
    """Whether the solver says of a design what was wished; an angle counts where it is stable."""
    want = work.wish.want
    if not isinstance(want, Angle):
        return None if label.foldable is None else label.foldable == (want == "foldable")
    angle = label.evidence.get("m1")
    if angle is None or label.evidence.get("stable") is None:
        return None
    return bool(label.evidence["stable"] and abs(angle - want.value) <= want.tolerance)


def _corrected(work: Work, draft: Draft, rungs: Rungs) -> tuple[Draft, Label, list[float]]:
    """The draft whose angle the solver finds nearest to the wish, its label, and what it cost."""
    want, spent = work.wish.want, []
    line = draft.region.line(draft.x, draft.driver) if draft.driver else None
    tried: list[tuple[float, float]] = []
    best: tuple[float, Draft, Label] | None = None
    t = 0.0
    while True:
        here = draft if line is None else replace(draft, x=draft.x + t * line[0])
        label = work.source.label(here.groups)
        spent.append(label.evidence.get("core_seconds", 0.0))
        angle = label.evidence.get("m1")
        if line is None or angle is None:
            return (best[1], best[2], spent) if best else (here, label, spent)
        off = angle - want.value
        if best is None or abs(off) < best[0]:
            best = abs(off), here, label
        tried.append((t, off))
        if abs(off) <= CLOSE * want.tolerance or len(tried) == LABELS:
            return best[1], best[2], spent
        slope = _slope(tried, draft, line, rungs)
        step = -off / slope if slope and np.isfinite(slope) else np.nan
        if not np.isfinite(step):
            return best[1], best[2], spent
        t = float(np.clip(t + np.clip(step, -0.2, 0.2), line[1], line[2]))
        if any(abs(t - u) < 1e-9 for u, _ in tried):
            return best[1], best[2], spent


def _slope(tried, draft: Draft, line, rungs: Rungs) -> float:
    """rad per decade of the driver: of the solver's last two answers, or of the rod's."""
    if len(tried) > 1:
        (a, fa), (b, fb) = tried[-2:]
        return (fb - fa) / (b - a)
    t, step = tried[0][0], 0.005
    at = np.clip([t - step, t + step], line[1], line[2])
    x = draft.x + at[:, None] * line[0]
    angles = rungs.rod(groups_of(draft.region, x))["angle"].to_numpy()
    return float((angles[1] - angles[0]) / (at[1] - at[0])) if at[1] > at[0] else np.nan


def _proposal(work: Work, draft: Draft, label: Label | None, angle: float | None) -> Proposal:
    physical = draft.physical
    mass = None
    if {*MASS_COLUMNS} <= {*physical}:
        mass = float(mass_of(pd.DataFrame([physical]))[0])
    return Proposal(
        groups=draft.groups, physical=physical, materials=draft.pair, mass=mass,
        probability=None, angle=angle, margin=0.0, box={}, label=label,
    )  # fmt: skip


class Box:
    """Tolerances of a design, all of them as a fraction of the groups' bounds (``margin``) at once.

    ``correction``: the solver's angle less the rod's at the design, rad.
    """

    def __init__(self, work: Work, draft: Draft, rungs: Rungs, correction: float):
        self.wish, self.rungs, self.correction = work.wish, rungs, correction
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
        if not self.sized:
            return table[FULL.names]
        known = {*RATIOS, "E_s", "rho_s", "l_s", "g_earth", "contraction"}
        return to_groups(table[[name for name in table if name in known]])[FULL.names]

    def rooms(self, designs: pd.DataFrame) -> np.ndarray:
        """rad to spare by the rod, corrected, beyond the guard, shape (n,)."""
        angle = self.rungs.rod(designs)["angle"] + self.correction
        contraction = designs["contraction"].to_numpy()
        want = self.wish.want
        need = want.tolerance if isinstance(want, Angle) else np.pi * contraction
        guard = GUARD * need if isinstance(want, Angle) else 0.2 * GUARD * need
        return self.rungs.room(angle, contraction) - guard

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

    def worst(self, scale: float) -> list[Mapping[str, float]]:
        """The corners that are nearest to failing by the rod, an angle's on both sides."""
        designs = self.designs(scale)
        rooms = self.rooms(designs)
        order = list(np.argsort(rooms))
        if isinstance(self.wish.want, Angle):
            angle = self.rungs.rod(designs)["angle"].to_numpy()
            up, down = np.argsort(-angle), np.argsort(angle)
            order = [k for pair in zip(up, down, strict=True) for k in pair]
        chosen = list(dict.fromkeys(int(k) for k in order))[:CORNERS]
        return designs.iloc[chosen].to_dict("records")

