"""A draft finished by the solver: its angle corrected, its label, and the tolerances it bears.

What the rod misses of an angle at one design it misses at its neighbours too. So one or two steps
along the driver, with the rod's slope and then the solver's, meet the wish; and a box of tolerances
is found with the rod's differences from the solver's answer. The solver then confirms the corners
that the rod thinks worst.

The solver's own derivatives (:meth:`foldlab.labels.run.Run.sensitivity`) are not asked for: of 15
varied wishes for an angle 14 were met within :data:`CLOSE` by the rod's design and one by a step
with the rod's slope, and all derivatives cost 0.6 core-seconds where an answer costs 0.4.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from foldlab.inverse.answer import Proposal
from foldlab.inverse.box import Box
from foldlab.inverse.draft import FREE, Draft, Work, bearable, steered
from foldlab.inverse.points import MASS_COLUMNS, groups_of
from foldlab.inverse.rungs import Rungs
from foldlab.inverse.wish import Angle, mass_of
from foldlab.labels.label import Label

# An angle that is off by less than this fraction of its tolerance is left as it is.
CLOSE = 0.3
LABELS = 4  # answers that an angle may cost
CORNERS = 4  # of a box that the solver confirms
SHRINK, ROUNDS = 0.7, 3
ANSWERS = 1.5 + CORNERS  # of the solver for a proposal, on average


def by_rod(work: Work) -> Proposal:
    """A draft as a proposal, with the box of the rod's word."""
    rungs = Rungs(work.wish, meet=True, rocking=True)
    turned = float(rungs.rod(pd.DataFrame([work.draft.groups]))["angle"].iloc[0])
    proposal = _proposal(work, work.draft, None, turned)
    box = Box(work.draft, rungs)
    scale = box.scale()
    return replace(proposal, box=box.ends(scale), margin=box.margin(scale))


def finish(work: Work) -> Proposal:
    """A draft corrected and confirmed by the solver, with its box; unconfirmed where it fails."""
    rungs, draft = Rungs(work.wish, meet=True, rocking=True), work.draft
    draft, label, spent = _corrected(work, draft, rungs)
    angle = label.evidence.get("m1")
    proposal = _proposal(work, draft, label, angle)
    done = as_wished(work, label)
    proposal = replace(proposal, confirmed=done, core_seconds=sum(spent), answers=len(spent))
    if not (done and work.box):
        return proposal
    rod = float(rungs.rod(pd.DataFrame([label.design]))["angle"].iloc[0])
    box = Box(draft, rungs, angle - rod if np.isfinite(rod) else 0.0)
    scale = box.scale()
    for last in (*[False] * (ROUNDS - 1), True):
        said = []
        for design in box.worst(scale, CORNERS):
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
    if label.foldable is not None and not (_borne(work, label) and _apart(work, label)):
        return False
    if not isinstance(want, Angle):
        return None if label.foldable is None else label.foldable == (want == "foldable")
    angle = label.evidence.get("m1")
    if angle is None or label.evidence.get("stable") is None:
        return None
    return bool(label.evidence["stable"] and abs(angle - want.value) <= want.tolerance)


def _borne(work: Work, label: Label) -> bool:
    """Whether a design stands and bears its strains, as far as the wish asks for it."""
    wish, evidence = work.wish, label.evidence
    if wish.stands and evidence.get("topples") is not False:
        return False
    if wish.strain_margin is None:
        return True
    peaks = evidence.get("strain") or {}
    errors = (evidence.get("peak_errors") or {}).get("strain") or {}
    most = {k: v * (1 - wish.strain_margin) for k, v in bearable(wish, work.draft.pair).items()}
    return all(
        layer in peaks and peaks[layer] * (1 + errors.get(layer, 0.3)) <= strain
        for layer, strain in most.items()
    )


def _apart(work: Work, label: Label) -> bool:
    """Whether the panels touch at the end, or don't, as far as the wish asks for it."""
    asked = work.wish.touching
    touch = any(event["kind"] == "contact" for event in label.evidence.get("events", ()))
    return asked is None or touch is asked


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
        if len(tried) == 1:
            draft = steered(draft, rungs, -off)
            line = draft.region.line(draft.x, draft.driver)
        slope = _slope(tried, draft, line, rungs)
        step = -off / slope if slope and np.isfinite(slope) else np.nan
        if not np.isfinite(step):
            return best[1], best[2], spent
        t = float(np.clip(t + np.clip(step, -FREE, FREE), line[1], line[2]))
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
        mass = float(mass_of(pd.DataFrame([draft.groups | physical]))[0])
    return Proposal(
        groups=draft.groups, physical=physical, materials=draft.pair, mass=mass,
        probability=None, angle=angle, margin=0.0, box={}, label=label,
    )  # fmt: skip
