"""From a path of the solver to a label's verdict, reason and evidence.

What is judged is a :class:`foldlab.labels.run.Run`; nothing here knows how it was solved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.labels import foldability, screening
from foldlab.labels.foldability import TOUCHING, Thresholds
from foldlab.labels.timoshenko import lift_off_stiffness
from foldlab.memory import peak_memory_mb

if TYPE_CHECKING:
    from foldlab.labels.run import Run

# Of the 1000 points of a curve, those that a label keeps.
CURVE_POINTS = np.linspace(0, 999, 28).round().astype(int)

# Stated error of m1 over what two meshes differ by, and the least that is stated, by the finer of
# them: they may agree by chance. Chosen on designs of experiments/accuracy_calibration.py of seeds
# 0 and 1; of 109 others, of seed 3, m1 kept it for 95 % and m2 for 99 %.
MARGIN = {1: 1.3, 2: 0.7, 3: 0.7}
FLOOR = {1: 9e-3, 2: 5.5e-3, 3: 2e-3}
# What remains of a difference of m1 on the next mesh.
KEPT = 0.25
# The same of m2, and its least over |g|π by the elements across half the hinge: with one of them
# both meshes miss the bending at its free edges alike.
MARGIN_ACROSS = 1.3
ACROSS = {1: 0.25, 2: 0.02, 3: 0.01}


# Relative difference of two meshes that only another branch explains: the coarsest mesh is wrong by
# more than 0.174 in one of a hundred designs.
BRANCHED = 0.3


# Times the m2 that is allowed beyond which no path comes back: of 47 paths of the shipped dataset
# that were followed to their end (`history`; 39 isotropic, 8 uniaxial) none did, of 67 beyond 1.5
# times one.
RETURN = 2.0


@dataclass(frozen=True)
class Errors:
    """Of m1 and m2, each over the larger of |m1| and the threshold of m1."""

    m1: float
    m2: float

    @property
    def largest(self) -> float:
        """Of the two."""
        return max(self.m1, self.m2)

    def stated(self, level: int, earlier: Errors | None, across: float) -> Errors:
        """What is stated where the meshes ``level`` − 1 and ``level`` differ by these.

        ``earlier``: what the two meshes before differed by, None where there were none; ``across``:
        least of m2, see :data:`ACROSS`.
        """
        # Another branch says nothing about convergence.
        known = earlier is not None and earlier.largest <= BRANCHED
        kept = KEPT * earlier.m1 if known else 0.0
        m1 = max(MARGIN[level] * self.m1, FLOOR[level], kept)
        return Errors(m1, max(MARGIN_ACROSS * self.m2, across))


def calibrated(run: Run, design: Mapping[str, float], thresholds: Thresholds) -> Errors:
    """Of a path on the coarsest mesh, as measured on other designs."""
    m1, g = run.measures["m1"], design["contraction"]
    scale = float(thresholds.scale(m1, g))
    growth = run.folding.model.growth
    bounds = screening.coarse_errors(m1, g, thresholds, growth=growth)
    return Errors(*(off / scale for off in bounds))


def beyond_return(run: Run, design: Mapping[str, float], thresholds: Thresholds) -> bool:
    """Whether a path that has not come to its end had curled too far to come back."""
    if run.settled or not run.history:
        return False
    return curled_away(run.measures, design["contraction"], thresholds)


def curled_away(measures: Mapping[str, float], contraction: float, thresholds: Thresholds) -> bool:
    """Whether a state on the way to a contraction has curled too far to come back, whatever the
    coarsest mesh is off; see :data:`RETURN`."""
    m1, m2 = measures["m1"], measures["m2"]
    off = screening.coarse_errors(m1, contraction, thresholds, growth="isotropic")[1]
    return bool(m2 > RETURN * float(thresholds.most_across(contraction)) + off)


def judge(
    design: Mapping[str, float],
    run: Run,
    errors: Errors | None,
    thresholds: Thresholds,
    *,
    accuracy: float,
    levels: int,
    coarse: bool,
    before: Run | None = None,
    gone: bool = False,
) -> tuple[bool | None, str, dict[str, Any]]:
    """Verdict, reason and evidence of a path.

    ``errors``: of the last state, None where no second mesh confirmed it; ``coarse``: whether they
    are the calibrated ones of :mod:`foldlab.labels.screening`; ``levels``: meshes that were used;
    ``before``: the path on the mesh before. Where two paths end on different branches, so far apart
    that no mesh explains it, the evidence tells the other (``alternatives``); where both are sure
    of the same verdict, it stands. ``gone``: a path that did not come to its end counts as curled,
    see :func:`beyond_return`.
    """
    folding = run.folding
    evidence = {
        "outcome": folding.ending.name.lower(),
        "stable": False,
        "unknowns": folding.model.scene.size,
        "levels": levels,
        "iterations": folding.iterations,
        "steps": len(folding.states),
        "peak_memory_mb": peak_memory_mb(),
    }
    foldable, reason = None, f"unknown: {folding.detail}"
    if run.history:
        last = run.history[-1]
        tags = thresholds.tags(run.measures, design["contraction"])
        events = _events(run, design, thresholds)
        evidence |= {
            "fold_angle": last["m1"],
            **run.measures,
            **tags,
            "contraction_reached": last["contraction"],
            "threshold": thresholds.turning,
            "need": float(thresholds.angle(design["contraction"])),
            "unstable_modes": last["unstable"],
            "stable": last["unstable"] == 0 and run.settled,
            "topples": folding.last.topples,
            "events": events,
            "history": [[round(h[k], 6) for k in ("contraction", "m1", "m2")] for h in run.history],
            "curves": folding.last.curves[:, CURVE_POINTS].round(5).tolist(),
        }
        if "tip" in last:
            first = run.history[0]
            evidence["rest_gap"] = max(first["lowest"], first["tip"])
            evidence["penetration"] = max(0.0, -min(h["lowest"] for h in run.history))
        if last["contraction"] > 0:
            evidence["normalised_angle"] = last["m1"] / last["contraction"]
    if run.settled:
        foldable, outcome, reason = verdict(
            design, run.history, tags, events, run.closed, thresholds
        )
        evidence["outcome"] = outcome
    if run.history:
        scale = float(thresholds.scale(run.measures["m1"], design["contraction"]))
        evidence["error_estimate"] = None if errors is None else errors.m1
        if errors is not None:
            evidence |= {"error_m1": errors.m1 * scale, "error_m2": errors.m2 * scale}
    if run.settled and errors is None:
        reason = f"unknown, for no finer mesh confirmed it in time: {reason}"
        foldable, evidence["outcome"] = None, "unverified"
    elif run.settled:
        branched = before is not None and before.settled and errors.largest > BRANCHED
        if branched and not (run.closed or before.closed):
            other = before.measures
            how = "the path on the mesh before"
            evidence["alternatives"] = [{"m1": other["m1"], "m2": other["m2"], "how": how}]
            told = f"; the mesh before took another branch, to {other['m1']:.3g} rad"
        near = undecided(run, errors, thresholds, accuracy=accuracy, coarse=coarse)
        if near and "alternatives" in evidence and _agree(before, run, thresholds):
            reason += f"{told}, with the same verdict"
        elif near:
            foldable, evidence["outcome"] = None, "unresolved"
            reason = f"unknown: {' and '.join(near)}"
            reason += told if "alternatives" in evidence else ""
    elif gone:
        foldable, evidence["outcome"] = False, "curled"
        allowed = float(thresholds.most_across(design["contraction"]))
        end = "it was not followed beyond" if run.stopped else folding.detail
        reason = (
            f"the hinge curled about the other axis by {last['m2']:.3g} rad at "
            f"{100 * last['contraction']:.3g} % contraction, {last['m2'] / allowed:.1f} times what "
            f"is allowed, and none of 47 measured paths came back from so far; {end}"
        )
    no_state = not run.history and not run.timed_out
    if folding.model.heavy and (no_state or evidence["outcome"] == "unverified"):
        reason += _burden(design)
    return foldable, reason, evidence


def undecided(
    run: Run, errors: Errors, thresholds: Thresholds, *, accuracy: float, coarse: bool = False
) -> list[str]:
    """Which measures of a settled path the errors leave open, one phrase each; see :func:`judge`.

    A measure known as well as was asked for counts on the side where it lies, and so does a path
    that ended at a full turn.
    """
    if run.closed or errors.largest <= accuracy:
        return []
    g = run.folding.model.unit.contraction
    scale = float(thresholds.scale(run.measures["m1"], g))
    open_ = [off * scale if off > accuracy else 0.0 for off in (errors.m1, errors.m2)]
    slip = screening.COARSE_SLIP if coarse else 0.0
    return screening.near(run.measures, g, thresholds, (open_[0], open_[1]), slip)


def _agree(before: Run, run: Run, thresholds: Thresholds) -> bool:
    """Whether two paths settled on the same verdict, each even by the coarsest mesh's errors."""
    if not before.settled:
        return False
    verdicts = []
    for r in (before, run):
        m, g = r.measures, r.folding.model.unit.contraction
        growth = r.folding.model.growth
        errors = screening.coarse_errors(m["m1"], g, thresholds, growth=growth)
        if screening.near(m, g, thresholds, errors):
            return False
        verdicts.append(all(thresholds.tags(m, g).values()))
    return verdicts[0] == verdicts[1]


def _events(run: Run, design, thresholds) -> list[dict]:
    events = find_events(run.history, design["contraction"], thresholds)
    for h in run.folding.happenings:
        events.append({"kind": h.kind, "contraction": float(h.e) * design["contraction"]})
        if run.folding.model.growth == "release":
            # The load is that of the release, at the full contraction.
            events[-1] |= {"contraction": design["contraction"], "release": float(h.e)}
        if h.size:
            events[-1]["size"] = float(h.size)
    return sorted(events, key=lambda event: (event["contraction"], event.get("release", 0.0)))


def row_of(state, unit) -> dict[str, float]:
    """What the history keeps of a state."""
    # An end makes itself felt over about a thickness.
    reach = unit.slenderness + unit.active, 2 * unit.slenderness
    m = foldability.measure(state.curves, unit.hinge_length, reach)
    row = {"contraction": float(state.e) * unit.contraction, **vars(m)}
    row["unstable"] = state.unstable
    if state.tip is not None:
        row["tip"] = state.tip / unit.slenderness
        row["lowest"] = state.lowest / unit.slenderness
    if state.clearance is not None:
        row["clearance"] = state.clearance / unit.slenderness
    return row


def difference(
    coarse: Run, fine: Run, design: Mapping[str, float], thresholds: Thresholds
) -> Errors:
    """Of m1 and m2 of two paths, over the larger of fold angle and its threshold."""
    rows = [r.history[-1] for r in (coarse, fine)]
    if coarse.closed and fine.closed:
        # Both end at about the same angle: what differs is the contraction that it takes.
        turned = [r["m1"] / r["contraction"] for r in rows]
        off = abs(turned[1] - turned[0]) / max(abs(turned[1]), 1e-9)
        return Errors(off, off)
    scale = float(thresholds.scale(rows[1]["m1"], design["contraction"]))
    return Errors(*(abs(rows[1][m] - rows[0][m]) / scale for m in ("m1", "m2")))


def _burden(design: Mapping[str, float]) -> str:
    """What to add to a reason where the active layer bears more than its modulus of own weight.

    It is no verdict: by Hooke's law nothing of such a layer would remain, but a neo-Hookean one
    has an equilibrium, however thin.
    """
    weight = design["slenderness"] ** 2 / design["stiffness_to_weight"]
    load = weight * design["rho_ratio"] * design["h_ratio"] * design["slenderness"]
    if load <= design["E_ratio"]:
        return ""
    return (
        f"; the own weight of the active layer presses on it with {load / design['E_ratio']:.2g} "
        "times its modulus"
    )


def since(values: Sequence[bool]) -> int | None:
    """Index from which on all values are true to the end; None if the last one is not."""
    values = list(values)
    if not values or not values[-1]:
        return None
    return len(values) - next((k for k, v in enumerate(reversed(values)) if not v), len(values))


def verdict(
    design: Mapping[str, float],
    history: Sequence[Mapping[str, float]],
    tags: Mapping[str, bool],
    events: Sequence[Mapping],
    closed: bool,
    thresholds: Thresholds,
) -> tuple[bool, str, str]:
    """Whether it folds, the outcome in one word, and one sentence that says why.

    ``history``: per state ``contraction``, ``m1`` … ``m4`` and, over a ground, ``tip`` (height of
    the panels' ends over h_s).
    """
    last, need = history[-1], thresholds.angle(design["contraction"])
    when = {event["kind"]: event for event in reversed(list(events))}

    def percent(kind):
        if "release" in when[kind]:
            return f"at {100 * when[kind]['release']:.3g} % of the release"
        return f"at {100 * when[kind]['contraction']:.3g} % contraction"

    if all(tags.values()):
        if closed:
            return (
                True,
                "folds",
                (
                    f"folds through a full turn at {100 * last['contraction']:.3g} % contraction; "
                    "it was not followed beyond"
                ),
            )
        return (
            True,
            "folds",
            (
                f"folds by {last['m1']:.3g} rad, more than the {need:.3g} rad that count as "
                f"folded, and is stable there{_by_ends(last)}"
            ),
        )
    if closed and last["m2"] > last["m1"]:
        return (
            False,
            "curled",
            (
                "the hinge curled about the other axis through half a turn at "
                f"{100 * last['contraction']:.3g} % contraction"
            ),
        )
    if not tags["F1"]:
        gamma = design.get("stiffness_to_weight")
        if "tip" in last and "lift-off" not in when and not tags["F2"]:
            return (
                False,
                "curled",
                (
                    f"the hinge curled about the other axis {percent('curling')}, and the panels "
                    "never left the ground"
                ),
            )
        if "tip" in last and "lift-off" not in when:
            least = lift_off_stiffness(design)
            advice = (
                f"lift-off needs Γ ≥ {least:.2g} here, Γ is {gamma:.2g}"
                if least > gamma
                else f"they sag under their weight, and the hinge turns by {last['hinge']:.2g} rad"
            )
            return False, "grounded", f"panels never left the ground: {advice}"
        if not tags["F2"]:
            return False, "curled", f"the hinge curled about the other axis {percent('curling')}"
        sags = "tip" in last and last["hinge"] > need
        if sags:
            return (
                False,
                "sags",
                (
                    f"the hinge turns by {last['hinge']:.3g} rad, but the panels sag and leave "
                    f"{last['m1']:.3g} rad of the {need:.3g} rad needed"
                ),
            )
        return (
            False,
            "too_little",
            (f"the fold ends at {last['m1']:.3g} rad, short of the {need:.3g} rad needed"),
        )
    if not tags["F2"]:
        return False, "curled", f"the hinge curled about the other axis {percent('curling')}"
    return False, "warped", f"the unit warped {percent('warping')}: its edges left the middle line"


def _by_ends(last: Mapping[str, float]) -> str:
    """What to add where the hinge itself bends by less than half of what its ends turn."""
    if "turning_ends" not in last or last["turning_ends"] < last["m1"] / 2:
        return ""
    return (
        f"; the hinge bends by {last['turning_hinge']:.2g} rad only, the ends of its active layer "
        f"turn the sheet by {last['turning_ends']:.2g} rad"
    )


def find_events(
    history: Sequence[Mapping[str, float]], contraction: float, thresholds: Thresholds
) -> list[dict]:
    """Lift-off, contact, curling and warping, each where it set in to stay.

    As {kind, contraction}, with the part of a ``release`` where one follows the contraction.
    """
    most = thresholds.most_across(contraction)
    seen = {
        "lift-off": [h.get("tip", 0.0) > 0.5 for h in history],
        "contact": [h.get("clearance", np.inf) < TOUCHING for h in history],
        "curling": [h["m2"] >= most for h in history],
        "warping": [
            max(abs(h["m3"] - 1), abs(h["m4"] - 1)) >= thresholds.parallel for h in history
        ],
    }
    events = []
    for kind, values in seen.items():
        first = since(values)
        if first is not None:
            row = history[first]
            events.append({"kind": kind, "contraction": float(row["contraction"])})
            if "release" in row:
                events[-1]["release"] = float(row["release"])
    return events
