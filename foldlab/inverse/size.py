"""Where nothing folds at the wished size: the largest at which something does, and what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from foldlab.errors import InputError
from foldlab.inverse.wish import Angle, Wish

SMALLEST = 1e-3  # m: below, nobody cuts a sheet
STEPS = 6  # halvings of a factor of 2, so that the size is known within 1 %
WALKERS = 1024
ATTEMPTS = 6  # designs that the solver may reject, each 3 % smaller
BACK = 0.97


def largest(
    wish: Wish, *, seed: int, source=None, tell: Callable[[str], None] = lambda text: None
) -> tuple[dict[str, Any] | None, str]:
    """The largest unit that does as wished, all other limits the same, and a sentence.

    By the rod; confirmed by ``source`` where one is given. Lengths other than l_s that the wish
    fixes stay. None where l_s is not limited from below, or where no smaller unit does either.
    """
    from foldlab.inverse.finish import finish
    from foldlab.inverse.weighted import Draft, Work, drafts, regions_of

    what = _what(wish)
    size = _smallest_asked(wish)
    if size is None or wish.want == "flat":
        return None, f"no design within the limits {what}"

    def at(length: float) -> list[Draft]:
        try:
            some = regions_of(_sized(wish, length))
        except InputError:
            return []
        return drafts(_sized(wish, length), some, 3, seed=seed, walkers=WALKERS)[0]

    tell(f"nothing {what} at l_s = {1e3 * size:.4g} mm by the rod; smaller units are tried …")
    bad, good, best = size, size / 2, []
    while good >= SMALLEST and not (best := at(good)):
        bad, good = good, good / 2
    if not best:
        return None, (
            f"no design within the limits {what}, at l_s = {1e3 * size:.4g} mm or at any smaller "
            f"size down to {1e3 * SMALLEST:g} mm; relax another limit"
        )
    for _ in range(STEPS):
        middle = (good * bad) ** 0.5
        if found := at(middle):
            good, best = middle, found
        else:
            bad = middle
    by = "the rod"
    proposal = None
    if source is not None:
        for _ in range(ATTEMPTS):
            for draft in best[:2]:
                proposal = finish(Work(_sized(wish, good), draft, source, box=False))
                if proposal.confirmed:
                    break
            if proposal is not None and proposal.confirmed:
                break
            good *= BACK
            best = at(good)
        if proposal is None or not proposal.confirmed:
            return None, (
                f"no design within the limits {what}, and what does by the rod at "
                f"l_s = {1e3 * good:.3g} mm the solver did not confirm"
            )
        by = "the solver"
    draft = best[0]
    told = {
        "l_s": good,
        "physical": dict(proposal.physical if proposal else draft.physical),
        "groups": dict(proposal.groups if proposal else draft.groups),
        "fold_angle": proposal.angle if proposal else draft.angle,
        "materials": list(draft.pair),
        "confirmed": bool(proposal),
    }
    return told, (
        f"not at this size: at most l_s = {1e3 * good:.3g} mm, by {by}, with the limits otherwise "
        f"as they are; no design {what} at l_s = {1e3 * size:.4g} mm"
    )


def _what(wish: Wish) -> str:
    want = wish.want
    if isinstance(want, Angle):
        return f"folds by {np.degrees(want.value):.3g}°"
    return "folds" if want == "foldable" else "stays flat"


def _smallest_asked(wish: Wish) -> float | None:
    """l_s that the wish doesn't go below, m."""
    if "l_s" in wish.fixed:
        return float(wish.fixed["l_s"])
    return float(wish.ranges["l_s"][0]) if "l_s" in wish.ranges else None


def _sized(wish: Wish, length: float) -> Wish:
    ranges = {name: ends for name, ends in wish.ranges.items() if name != "l_s"}
    return replace(wish, fixed={**wish.fixed, "l_s": length}, ranges=ranges)
