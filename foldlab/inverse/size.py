"""Where nothing folds at the wished size: the largest at which something does, and what."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from foldlab.inverse.draft import Draft, Work, driven
from foldlab.inverse.extreme import least
from foldlab.inverse.finish import finish
from foldlab.inverse.rungs import Rungs, turned
from foldlab.inverse.wish import Angle, Wish

SMALLEST = 1e-3  # m: below, nobody cuts a sheet
WALKERS = 1024
STARTS = 6  # designs that are made larger
CLOSE = 1.1  # factor by which the least size that other limits allow is known
# Of the largest designs by the rod those that the solver is asked of, and parts of the way back.
TOPS, BACK = 2, (0.0, 0.05, 0.1, 0.2, 0.4)


def largest(
    wish: Wish, *, seed: int, source=None, tell: Callable[[str], None] = lambda text: None
) -> tuple[dict[str, Any] | None, str]:
    """The largest unit that does as wished, all other limits the same, and a sentence.

    Sizes are halved until the rod has designs, each of which is made larger as far as the rod
    allows (:func:`foldlab.inverse.extreme.least`): local optima, the same for the same seed. The
    largest is confirmed by ``source`` where one is given, or else the first on the way back from
    it. Other lengths that the wish fixes stay. None where l_s is not limited from below, or where
    no smaller unit does either.
    """
    from foldlab.inverse.weighted import drafts, regions_of

    what = _what(wish)
    size = _smallest_asked(wish)
    if size is None or wish.want == "flat":
        return None, f"no design within the limits {what}"

    below = size  # so far, the least of those that other limits allow

    def at(length: float) -> list[Draft] | None:
        try:
            some = regions_of(_between(wish, length, length))
        except InputError:
            return None
        return drafts(some[0][1].wish, some, STARTS, seed=seed, walkers=WALKERS).drafts

    tell(f"nothing {what} at l_s = {1e3 * size:.4g} mm by the rod; smaller units are tried …")
    good, first = size / 2, []
    while good >= SMALLEST and not first:
        first = at(good)
        if first is None:  # other limits end above
            if below / good < CLOSE:
                break
            good = (good * below) ** 0.5
        elif not first:
            below, good = good, good / 2
    if not first:
        return None, (
            f"no design within the limits {what} at l_s = {1e3 * size:.4g} mm, nor at smaller "
            f"sizes as far as other limits allow them ({1e3 * below:.3g} mm); relax another limit"
        )
    tops = _raised(wish, first, good, size)
    proposal, by, draft = None, "the rod", tops[0][1]
    for there in _lower(tops) if source is not None else ():
        by, draft = f"the {source.name}", there
        proposal = finish(Work(draft.region.wish, draft, source, box=False))
        if proposal.confirmed:
            break
    if proposal is not None and not proposal.confirmed:
        return None, (
            f"no design within the limits {what}, and what does by the rod at "
            f"l_s = {1e3 * length_of(tops[0][1]):.3g} mm {by} did not confirm"
        )
    physical = dict(proposal.physical if proposal else draft.physical)
    told = {
        "l_s": physical["l_s"],
        "physical": physical,
        "groups": dict(proposal.groups if proposal else draft.groups),
        "fold_angle": proposal.angle if proposal else turned(draft.groups)[0],
        "materials": list(draft.pair),
        "confirmed": bool(proposal),
    }
    return told, (
        f"not at this size: at most l_s = {1e3 * physical['l_s']:.3g} mm, the largest found that "
        f"{what}, by {by}, with all other limits as they are; it is a local optimum, and a "
        "larger unit may exist"
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


def length_of(draft: Draft) -> float:
    """l_s in m."""
    return float(draft.physical["l_s"])


def _between(wish: Wish, low: float, high: float) -> Wish:
    """The wish with other limits of l_s."""
    fixed = {name: value for name, value in wish.fixed.items() if name != "l_s"}
    ranges = {name: ends for name, ends in wish.ranges.items() if name != "l_s"}
    if low == high:
        return replace(wish, fixed={**fixed, "l_s": low}, ranges=ranges)
    return replace(wish, fixed=fixed, ranges={**ranges, "l_s": (low, high)})


def _raised(wish: Wish, first: list[Draft], good: float, size: float) -> list[tuple[Draft, Draft]]:
    """Drafts and what each becomes at the size up to which the rod still does as wished, the
    largest first."""
    from foldlab.inverse.weighted import regions_of

    wide = _between(wish, good / 2, size)
    meet = Rungs(wide).second(pd.DataFrame([draft.groups for draft in first])).max() < 0
    rungs = Rungs(wide, meet=meet, rocking=True)
    regions = dict(regions_of(wide))
    out = []
    for draft in first:
        region = regions[draft.pair]
        at = region.names.index("l_s")
        start = Draft(draft.pair, region, draft.x, draft.driver)
        out.append((start, least(start, rungs, lambda x, at=at: -x[:, at])))
    return sorted(out, key=lambda pair: -length_of(pair[1]))


def _lower(tops: list[tuple[Draft, Draft]]) -> Iterator[Draft]:
    """The largest designs and, where the source does not confirm them, ones on the way back: the
    largest by the rod lie where weight is about to win, which a solid may feel a little earlier.
    """
    for start, top in tops[:TOPS]:
        rungs = Rungs(top.region.wish, meet=True, rocking=True)
        for back in BACK:
            there: Draft | None = replace(top, x=top.x + back * (start.x - top.x))
            if isinstance(top.region.wish.want, Angle):
                there = there if back == 0 else driven(there, rungs)
            if there is not None:
                yield there
