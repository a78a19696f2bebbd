"""From a path of the solver to a label's verdict, reason and evidence.

What is judged is a :class:`foldlab.labels.run.Run`; nothing here knows how it was solved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.labels import foldability, screening
from foldlab.labels.foldability import TOUCHING, Thresholds
from foldlab.labels.memory import peak_memory_mb
from foldlab.labels.timoshenko import lift_off_stiffness

if TYPE_CHECKING:
    from foldlab.labels.run import Run

# Of the 1000 points of a curve, those that a label keeps.
CURVE_POINTS = np.linspace(0, 999, 28).round().astype(int)

# Stated error over what two meshes differ by, and the least that is stated, by the finer of them:
# they may agree by chance. Chosen so that 29 of 30 designs of a Latin hypercube kept their stated
# error against a mesh two levels finer (experiments/accuracy_calibration.py; half the difference
# alone was kept by 20 of them).
MARGIN = 1.25
FLOOR = {1: 6.5e-3, 2: 3e-3, 3: 1.5e-3}


def stated(difference: float, level: int) -> float:
    """The error that is stated for a difference between the meshes ``level`` − 1 and ``level``."""
    return max(MARGIN * difference, FLOOR[level])


def judge(
    design: Mapping[str, float],
    run: Run,
    error: float | None,
    thresholds: Thresholds,
    *,
    accuracy: float,
    levels: int,
    coarse: bool,
) -> tuple[bool | None, str, dict[str, Any]]:
    """Verdict, reason and evidence of a path.

    ``error``: of the last state, relative, None where no second mesh confirmed it; ``coarse``:
    whether it is the calibrated one of :mod:`foldlab.labels.screening`; ``levels``: meshes that
    were used.
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
        evidence["error_estimate"] = error
    if run.settled and error is None:
        reason = f"unknown, for no finer mesh confirmed it in time: {reason}"
        foldable, evidence["outcome"] = None, "unverified"
    elif run.settled and error > accuracy:
        m1, m2 = run.measures["m1"], run.measures["m2"]
        need = thresholds.angle(design["contraction"])
        most = thresholds.most_across(design["contraction"])
        slack = error * float(thresholds.scale(m1, design["contraction"]))
        near = [f"m1 is {m1:.3g} rad, {need:.3g} needed"] * (abs(m1 - need) < slack)
        near += [f"m2 is {m2:.3g} rad, {most:.3g} allowed"] * (abs(m2 - most) < slack)
        if coarse:
            near = screening.near(run.measures, design["contraction"], thresholds)
        if near and not run.closed:
            foldable, evidence["outcome"] = None, "unresolved"
            reason = f"unknown: {' and '.join(near)}, and the error is {slack:.2g} rad"
    no_state = not run.history and not run.timed_out
    if folding.model.heavy and (no_state or evidence["outcome"] == "unverified"):
        reason += _burden(design)
    return foldable, reason, evidence


def _events(run: Run, design, thresholds) -> list[dict]:
    events = find_events(run.history, design["contraction"], thresholds)
    for h in run.folding.happenings:
        events.append({"kind": h.kind, "contraction": float(h.e) * design["contraction"]})
        if h.size:
            events[-1]["size"] = float(h.size)
    return sorted(events, key=lambda event: event["contraction"])


def row_of(state, unit) -> dict[str, float]:
    """What the history keeps of a state."""
    m = foldability.measure(state.curves, unit.hinge_length)
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
) -> float:
    """Of m1 and m2 of two paths, over the larger of fold angle and |g|π."""
    rows = [r.history[-1] for r in (coarse, fine)]
    if coarse.closed and fine.closed:
        # Both end at about the same angle: what differs is the contraction that it takes.
        turned = [r["m1"] / r["contraction"] for r in rows]
        return abs(turned[1] - turned[0]) / max(abs(turned[1]), 1e-9)
    scale = float(thresholds.scale(rows[1]["m1"], design["contraction"]))
    return max(abs(rows[1][m] - rows[0][m]) for m in ("m1", "m2")) / scale


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
    when = {event["kind"]: event["contraction"] for event in reversed(list(events))}

    def percent(kind):
        return f"at {100 * when[kind]:.3g} % contraction"

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
                "folded, and is stable there"
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


def find_events(
    history: Sequence[Mapping[str, float]], contraction: float, thresholds: Thresholds
) -> list[dict]:
    """Lift-off, contact, curling and warping, each where it set in to stay.

    As {kind, contraction}.
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
            events.append({"kind": kind, "contraction": float(history[first]["contraction"])})
    return events
