"""When a coarse mesh is enough: labels whose answer cannot hang on the mesh.

Most designs miss the thresholds of :mod:`foldlab.labels.foldability` by far. For those the coarsest
mesh gives the answer, and its error need not be measured on a second mesh: a bound measured once,
on other designs, will do. It covers a stated fraction of designs like those it was measured on, not
each of them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from foldlab.labels.foldability import Thresholds

# Measured on 153 designs drawn from gravity-5k (uniaxial; the coarsest path reached the full
# contraction) against their labels there, whose own error is 0.002 in the median. The larger of the
# errors of m1 and m2: median 0.010, 90 % 0.111, 95 % 0.132 (bootstrapped: 0.115 to 0.145), 99 %
# 0.174; of m3 and m4 at most 2e-4. None of these answers changed.
COARSE_ERROR = 0.14
"""Bound for 95 % of designs on the coarsest mesh: of m1 over max(|m1|, |g|π), of m2 over |g|π."""
COARSE_SLIP = 1e-3
"""Bound of m3 and m4 there, absolute."""
ISOTROPIC_ERRORS = (0.2, 0.4)
"""Such bounds of m1 and m2 under isotropic contraction. Measured against the finest mesh of each
label, on the 34 of the first 45 designs of FULL.sample(60, seed=101) whose path reached the full
contraction and was refined. Of m1: median 0.007, 95 % 0.137, largest 0.195; of m2: 0.011, 0.337 and
0.350. None of the 23 that miss a fold by more than these folded on a finer mesh."""
LARGEST_SLENDERNESS = 3e-2
"""h_s/l_s up to which both were measured."""


def coarse_errors(
    m1: float,
    contraction: float,
    thresholds: Thresholds,
    error: float = COARSE_ERROR,
    growth: str = "uniaxial",
) -> tuple[float, float]:
    """Bounds of the errors of m1 and m2 on the coarsest mesh, in rad.

    ``error``: the relative bound of both for uniaxial contraction; other ``growth`` has its own.
    """
    scale = float(thresholds.scale(m1, contraction))
    along, across = (error, error) if growth == "uniaxial" else ISOTROPIC_ERRORS
    return along * scale, across * float(thresholds.angle(contraction))


def near(
    measures: Mapping[str, float],
    contraction: float,
    thresholds: Thresholds,
    errors: tuple[float, float],
    slip: float = COARSE_SLIP,
) -> list[str]:
    """Which measures m1 … m4 lie so near their thresholds that they may cross, with their errors.

    ``errors``: of m1 and m2 in rad; ``slip``: of m3 and m4. One phrase each. None where one tag of
    F1 … F4 fails by more than its error: then the design doesn't fold, whatever the others are.
    """
    m1, m2 = measures["m1"], measures["m2"]
    need, across = thresholds.angle(contraction), thresholds.most_across(contraction)
    most = thresholds.parallel
    rooms = [
        (m1 - need, errors[0], f"m1 is {m1:.3g} rad, {need:.3g} needed"),
        (across - m2, errors[1], f"m2 is {m2:.3g} rad, {across:.3g} allowed"),
    ]
    for name in ("m3", "m4"):
        off = abs(measures[name] - 1)
        rooms.append((most - off, slip, f"{name} is off 1 by {off:.3g}, {most:g} allowed"))
    if any(room < -slack for room, slack, _ in rooms):
        return []
    return [
        f"{text}, and its error is {slack:.2g}" for room, slack, text in rooms if abs(room) <= slack
    ]


def clear(
    measures: Mapping[str, float],
    contraction: float,
    thresholds: Thresholds,
    growth: str,
    closed: bool,
) -> bool:
    """Whether the coarsest mesh is not off by enough to change that a unit doesn't fold, or that it
    folds by a full turn (``closed``).

    Of 150 uniaxial designs of gravity-5k that fold by a full turn, on two meshes or on one, 149 did
    on the coarsest; with m2 off by at most 0.02 rad.
    """
    errors = coarse_errors(measures["m1"], contraction, thresholds, growth=growth)
    decided = not near(measures, contraction, thresholds, errors)
    return decided and (closed or not all(thresholds.tags(measures, contraction).values()))


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
    contraction = design["contraction"]
    errors = coarse_errors(last["m1"], contraction, thresholds)
    return bool(quiet and known and not near(last, contraction, thresholds, errors))
