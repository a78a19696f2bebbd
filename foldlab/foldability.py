"""Foldability (§4.5): four curves on the passive layer's mid-plane → measures → tags → a reason.

The curves are C1 (x = 0, along the sheet), C2 (y = 0, across the hinge), C3 and C4 (x = ±b_i/2,
along the sheet), in the deformed state. Everything here is unchanged by rigid motion. Angles in
rad.

    m1  net turning of C1's tangent in its mean bending plane (∫κ ds of Eq. 4.18, unwrapped), with
        its sign: positive where the panels rise. A sheet that only sags turns the other way, and
        taking |m1| would call that folded.
    m2  |net turning| of C2's tangent
    m3, m4  means of t₁·t₃ and t₁·t₄ over the length (4.20), t the unit tangents
    F1  m1 > α₁, α₁ = |g| π (4.21)      F2  m2 < α₁/2 (4.22)
    F3, F4  |m3 − 1|, |m4 − 1| < 0.1 (4.23, 4.24)       folded: all four
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from foldlab.errors import InputError

TAGS = ("F1", "F2", "F3", "F4")

# Distance of a panel from the plane where panels meet, over h_s, at which they touch: the barrier's
# reach (solver.ground.Ground).
TOUCHING = 0.1


@dataclass(frozen=True)
class Measures:
    """m1 … m4 of one state, and the part of m1 that turns within the hinge."""

    m1: float
    m2: float
    m3: float
    m4: float
    hinge: float


@dataclass(frozen=True)
class Thresholds:
    """``turning``: α₁ over |g|; ``across``: α₂ over α₁; ``parallel``: of |m3 − 1| and |m4 − 1|."""

    turning: float = np.pi
    across: float = 0.5
    parallel: float = 0.1

    def tags(self, measures: Measures | Mapping[str, float], contraction: float) -> dict[str, bool]:
        """F1 … F4 at a contraction |g|."""
        m = measures if isinstance(measures, Mapping) else vars(measures)
        angle = contraction * self.turning
        return {
            "F1": bool(m["m1"] > angle),
            "F2": bool(m["m2"] < self.across * angle),
            "F3": bool(abs(m["m3"] - 1) < self.parallel),
            "F4": bool(abs(m["m4"] - 1) < self.parallel),
        }


def measure(curves: np.ndarray, hinge_length: float) -> Measures:
    """Measures of curves (4, n, 3) with points evenly spaced in the reference state.

    ``hinge_length`` l_i/l_s tells the hinge from the panels along C1. Raises :class:`InputError`
    for another shape or values that are not finite.
    """
    curves = np.asarray(curves, dtype=float)
    if curves.ndim != 3 or curves.shape[0] != 4 or curves.shape[2] != 3 or curves.shape[1] < 3:
        raise InputError(f"curves of shape {curves.shape}; expected (4, points, 3)")
    if not np.isfinite(curves).all():
        raise InputError("the curves are not finite; the state that they come from is no state")
    t = np.diff(curves, axis=1)
    t /= np.linalg.norm(t, axis=2, keepdims=True)
    middle = t.shape[1] // 2
    along, across = t[0, middle], t[1, middle]
    angles = _angles(t[0], across)
    s = (np.arange(len(angles)) + 0.5) / len(angles) - 0.5
    ends = np.interp([-hinge_length / 2, hinge_length / 2], s, angles)
    turned = _angles(t[1], along)
    return Measures(
        float(angles[-1] - angles[0]),
        float(abs(turned[-1] - turned[0])),
        float((t[0] * t[2]).sum(axis=1).mean()),
        float((t[0] * t[3]).sum(axis=1).mean()),
        float(ends[1] - ends[0]),
    )


def _angles(t: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Unwrapped angles of unit tangents (n, 3) in their mean plane, whose normal is about ``near``.

    A straight curve has no plane of its own; the small bias towards ``near`` gives it one.
    """
    _, axes = np.linalg.eigh(t.T @ t / len(t) - 1e-6 * np.outer(near, near))
    normal = axes[:, 0] * (1.0 if axes[:, 0] @ near >= 0 else -1.0)
    a = t[len(t) // 2] - (t[len(t) // 2] @ normal) * normal
    a /= np.linalg.norm(a)
    return np.unwrap(np.arctan2(t @ np.cross(normal, a), t @ a))


def since(values: Sequence[bool]) -> int | None:
    """Index from which on all values are true to the end; None if the last one is not."""
    values = list(values)
    if not values or not values[-1]:
        return None
    return len(values) - next((k for k, v in enumerate(reversed(values)) if not v), len(values))


def lift_off_stiffness(design: Mapping[str, float], nu: float = 0.3) -> float:
    """Γ above which rigid panels on a short hinge would leave the ground.

    Θ₀ = κ l_i / 2 and β = w L_p² l_i / (4 B), w the weight of a panel per length and B the
    bilayer's bending stiffness: lift-off at β = Θ₀ (heavy strip, closed form). β is proportional
    to 1/Γ. Flexible panels lift earlier at their tips' cost, so this is an estimate.
    """
    m, n, h = design["h_ratio"], design["E_ratio"], design["slenderness"]
    share = 6 * (1 + m) / (3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n)))
    turning = share * design["contraction"] / h * design["hinge_length"] / 2
    return float(_hinge_turning(design) / turning) if turning > 0 else np.inf


def _hinge_turning(design: Mapping[str, float]) -> float:
    """β Γ: by what the weight of a level panel turns its half of the hinge, times Γ, in rad."""
    m, n = design["h_ratio"], design["E_ratio"]
    length = (1 - design["hinge_length"]) / 2
    # Bilayer about its neutral axis, in units of E_s h_s³ per width.
    bending = (1 + m**3 * n) / 12 + m * n * (1 + m) ** 2 / (4 * (1 + m * n))
    # w = h_s · h_s²/Γ per width of panel; B = E_s h_s³ · bending per width of hinge.
    return length**2 * design["hinge_length"] / (4 * bending * design["hinge_width"])


def weight_turning(design: Mapping[str, float]) -> float:
    """What weight takes at most from m1, times Γ, in rad: both panels level, small deflections.

    Each half of the hinge turns by β, and the end of each panel, a cantilever of bending stiffness
    E_s h_s³/12 under its own weight, by w L_p³ / (6 B) = 2 L_p³/Γ.
    """
    length = (1 - design["hinge_length"]) / 2
    return 2 * (_hinge_turning(design) + 2 * length**3)


def verdict(
    design: Mapping[str, float],
    history: Sequence[Mapping[str, float]],
    tags: Mapping[str, bool],
    events: Sequence[Mapping],
    closed: bool,
) -> tuple[bool, str, str]:
    """Whether it folds, the outcome in one word, and one sentence that says why.

    ``history``: per state ``contraction``, ``m1`` … ``m4`` and, over a ground, ``tip`` (height of
    the panels' ends over h_s).
    """
    last, g = history[-1], design["contraction"]
    need = g * np.pi
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
    angle = contraction * thresholds.turning
    seen = {
        "lift-off": [h.get("tip", 0.0) > 0.5 for h in history],
        "contact": [h.get("clearance", np.inf) < TOUCHING for h in history],
        "curling": [h["m2"] >= thresholds.across * angle for h in history],
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
