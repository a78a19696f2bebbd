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

α₁ may be given in rad instead (``need``). A layer much stiffer than the sheet hardly bends, and yet
its two ends turn the sheet by up to 3.4 rad per unit of contraction, more than |g| π asks for; so
the turning by the hinge and that by its ends are told apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from foldlab.errors import InputError

TAGS = ("F1", "F2", "F3", "F4")

# Distance of a panel from the plane where panels meet, over h_s, at which they touch: the barrier's
# reach (solver.physics.ground.Ground).
TOUCHING = 0.1


# Fraction of the full turn that counts as one: panels that have turned over lie on the ground
# again, each turned by π but for what its hinge holds up, and come no nearer.
LYING = 0.995


@dataclass(frozen=True)
class Measures:
    """m1 … m4 of one state, and the part of m1 that turns within the hinge.

    ``turning_hinge``: what the curvature inside the hinge makes over its whole length;
    ``turning_ends``: what the ends of the active layer add to it (or take from it).
    """

    m1: float
    m2: float
    m3: float
    m4: float
    hinge: float
    turning_hinge: float
    turning_ends: float


@dataclass(frozen=True)
class Thresholds:
    """``turning``: α₁ over |g|; ``across``: α₂ over α₁; ``parallel``: of |m3 − 1| and |m4 − 1|.

    ``need``: α₁ in rad where it isn't to depend on the contraction. ``full_turn``: rad along the
    sheet at which a path is closed, and half of it across the hinge: beyond, a unit would pass
    through itself. Raises :class:`InputError` for values that are not above 0.
    """

    turning: float = np.pi
    across: float = 0.5
    parallel: float = 0.1
    full_turn: float = 2 * np.pi
    need: float | None = None

    def __post_init__(self):
        for name, value in vars(self).items():
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} = {value!r}; expected a finite number above 0")

    def angle(self, contraction):
        """α₁ in rad, what m1 must exceed; broadcasts."""
        if self.need is not None:
            return 0.0 * contraction + self.need
        return contraction * self.turning

    def most_across(self, contraction):
        """α₂ in rad, what m2 must stay below; broadcasts."""
        return self.across * self.angle(contraction)

    def scale(self, m1, contraction):
        """What errors of m1 are relative to, in rad: |m1| or α₁, whichever is larger."""
        return np.maximum(np.abs(m1), self.angle(contraction))

    def closed(self, m1, m2):
        """Whether a state has turned fully along the sheet, see :data:`LYING`, or by half across;
        broadcasts."""
        return (np.abs(m1) >= LYING * self.full_turn) | (np.asarray(m2) >= self.full_turn / 2)

    def tags(self, measures: Measures | Mapping[str, float], contraction: float) -> dict[str, bool]:
        """F1 … F4 at a contraction |g|."""
        m = measures if isinstance(measures, Mapping) else vars(measures)
        return {
            "F1": bool(m["m1"] > self.angle(contraction)),
            "F2": bool(m["m2"] < self.most_across(contraction)),
            "F3": bool(abs(m["m3"] - 1) < self.parallel),
            "F4": bool(abs(m["m4"] - 1) < self.parallel),
        }


THICK_HINGE = "this is no thin hinge, and the fold angle of its middle line says little"


def thick_hinge(design):
    """Whether the active layer is thicker than the hinge is long; a design or a table of them."""
    return design["h_ratio"] * design["slenderness"] > design["hinge_length"]


def measure(
    curves: np.ndarray, hinge_length: float, reach: tuple[float, float] = (0.0, 0.0)
) -> Measures:
    """Measures of curves (4, n, 3) with points evenly spaced in the reference state.

    ``hinge_length`` l_i/l_s tells the hinge from the panels along C1. ``reach``: how far, in l_s,
    an end of the active layer makes itself felt inside the hinge and outside of it. Raises
    :class:`InputError` for another shape or values that are not finite.
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
    half, (inside, outside) = hinge_length / 2, reach
    inside = min(inside, half / 2)

    def turning(to: float) -> float:
        return float(np.diff(np.interp([-to, to], s, angles))[0])

    inner = turning(half - inside) * half / (half - inside)
    turned = _angles(t[1], along)
    return Measures(
        float(angles[-1] - angles[0]),
        float(abs(turned[-1] - turned[0])),
        float((t[0] * t[2]).sum(axis=1).mean()),
        float((t[0] * t[3]).sum(axis=1).mean()),
        turning(half),
        inner,
        turning(half + outside) - inner,
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
