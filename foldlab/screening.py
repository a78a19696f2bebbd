"""When a coarse mesh is enough: labels whose answer cannot hang on the mesh.

Most designs miss the thresholds of :mod:`foldlab.foldability` by far. For those the coarsest mesh
gives the answer, and its error need not be measured on a second mesh: a bound measured once, on
other designs, will do. It covers a stated share of designs like those it was measured on, not each
of them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from foldlab.foldability import Thresholds

COARSE_ERROR = 0.14
"""Error on the coarsest mesh of m1 over max(|m1|, |g|π) and of m2 over |g|π: 95 % of designs."""
COARSE_SLIP = 1e-3
"""The same of m3 and m4, absolute: all designs."""
LARGEST_SLENDERNESS = 3e-2
"""h_s/l_s up to which both were measured."""


def near(measures: Mapping[str, float], contraction: float, thresholds: Thresholds) -> list[str]:
    """Which measures of a coarse state, m1 … m4, lie so near their thresholds that they may cross.

    One phrase each. None where one tag of F1 … F4 fails by more than its error: then the design
    doesn't fold, whatever the others are.
    """
    need = contraction * thresholds.turning
    m1, m2 = measures["m1"], measures["m2"]
    across, most = thresholds.across * need, thresholds.parallel
    rooms = [
        (m1 - need, COARSE_ERROR * max(abs(m1), need), f"m1 is {m1:.3g} rad, {need:.3g} needed"),
        (across - m2, COARSE_ERROR * need, f"m2 is {m2:.3g} rad, {across:.3g} allowed"),
    ]
    for name in ("m3", "m4"):
        off = abs(measures[name] - 1)
        rooms.append((most - off, COARSE_SLIP, f"{name} is off 1 by {off:.3g}, {most:g} allowed"))
    if any(room < -slack for room, slack, _ in rooms):
        return []
    return [text for room, slack, text in rooms if abs(room) <= slack]


def decided(
    design: Mapping[str, float],
    last: Mapping[str, float],
    happenings: Collection[str],
    closed: bool,
    thresholds: Thresholds,
) -> bool:
    """Whether a settled path on the coarsest mesh decides the label of a design.

    ``last``: m1 … m4 and ``unstable`` modes of its last state; ``happenings``: kinds of what
    happened on the way. It doesn't decide where it ends at a full turn or in an unstable state,
    where it jumped or lost a symmetry, near a threshold, and for sheets thicker than those whose
    error was measured.
    """
    quiet = last["unstable"] == 0 and not closed and not set(happenings) - {"toppling"}
    known = design["slenderness"] <= LARGEST_SLENDERNESS
    return bool(quiet and known and not near(last, design["contraction"], thresholds))
