"""Where nothing folds at the wished size: the largest at which something does, and what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from foldlab.inverse.draft import Draft, Work
from foldlab.inverse.finish import finish
from foldlab.inverse.points import groups_of
from foldlab.inverse.propose import climb
from foldlab.inverse.rungs import LOST, NEAR, Rungs, turned
from foldlab.inverse.wish import Angle, Wish

SMALLEST = 1e-3  # m: below, nobody cuts a sheet
WALKERS = 1024
# Of the climb to larger sizes by the rod.
CLIMBERS, ROUNDS = 32, 20
CLOSE = 1.1  # factor by which the least size that other limits allow is known
ATTEMPTS = 8  # designs that the solver may reject before smaller ones are no use


def largest(
    wish: Wish, *, seed: int, source=None, tell: Callable[[str], None] = lambda text: None
) -> tuple[dict[str, Any] | None, str]:
    """The largest unit that does as wished, all other limits the same, and a sentence.

    Searched by the rod, for the first pair of materials that has one; confirmed by ``source`` where
    one is given. Other lengths that the wish fixes stay. None where l_s is not limited from below,
    or where no smaller unit does either.
    """
    from foldlab.inverse.weighted import drafts, regions_of

    what = _what(wish)
    size = _smallest_asked(wish)
    if size is None or wish.want == "flat":
        return None, f"no design within the limits {what}"

    least = size  # so far, of those that other limits allow

    def at(length: float) -> list[Draft] | None:
        try:
            some = regions_of(_between(wish, length, length))
        except InputError:
            return None
        return drafts(some[0][1].wish, some, 4, seed=seed, walkers=WALKERS).drafts

    tell(f"nothing {what} at l_s = {1e3 * size:.4g} mm by the rod; smaller units are tried …")
    good, first = size / 2, []
    while good >= SMALLEST and not first:
        first = at(good)
        if first is None:  # other limits end above
            if least / good < CLOSE:
                break
            good = (good * least) ** 0.5
        elif not first:
            least, good = good, good / 2
    if not first:
        return None, (
            f"no design within the limits {what} at l_s = {1e3 * size:.4g} mm, nor at smaller "
            f"sizes as far as other limits allow them ({1e3 * least:.3g} mm); relax another limit"
        )
    best = _raised(wish, first, good, size, np.random.default_rng(seed))
    proposal, by, draft = None, "the rod", best[0]
    for draft in best[:ATTEMPTS] if source is not None else ():
        by = f"the {source.name}"
        proposal = finish(Work(draft.region.wish, draft, source, box=False))
        if proposal.confirmed:
            break
    if proposal is not None and not proposal.confirmed:
        return None, (
            f"no design within the limits {what}, and what does by the rod at "
            f"l_s = {1e3 * length_of(best[0]):.3g} mm {by} did not confirm"
        )
    good = length_of(draft)
    told = {
        "l_s": good,
        "physical": dict(proposal.physical if proposal else draft.physical),
        "groups": dict(proposal.groups if proposal else draft.groups),
        "fold_angle": proposal.angle if proposal else turned(draft.groups)[0],
        "materials": list(draft.pair),
        "confirmed": bool(proposal),
    }
    return told, (
        f"not at this size: at most l_s = {1e3 * good:.3g} mm, the largest found that {what}, by "
        f"{by}, with all other limits as they are"
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


def _raised(wish: Wish, first: list[Draft], good: float, size: float, rng) -> list[Draft]:
    """Drafts at sizes as large as the rod still does as wished, the largest first."""
    from foldlab.inverse.weighted import driven, regions_of

    wide = _between(wish, good / 2, size)
    meet = Rungs(wide).second(pd.DataFrame([draft.groups for draft in first])).max() < 0
    rungs = Rungs(wide, meet=meet, rocking=True)
    regions = {pair: region for pair, region in regions_of(wide)}
    pair = first[0].pair
    region = regions[pair]
    at = region.names.index("l_s")

    def worth(x):
        groups = groups_of(region, x)
        room = rungs.second(groups, NEAR if isinstance(wish.want, Angle) else 0.0)
        return np.where(room >= 0, x[:, at] - np.log10(size) - 1e-9, LOST + np.minimum(room, 0))

    start = np.array([draft.x for draft in first if draft.pair == pair])
    x, value = climb(
        worth, region, start[rng.integers(len(start), size=CLIMBERS)], rng, need=1,
        rounds=ROUNDS, steps=2,
    )  # fmt: skip
    out = []
    for k in [*np.argsort(-value)]:
        if len(out) == ATTEMPTS:
            break
        draft: Draft | None = Draft(pair, region, x[k])
        if isinstance(wish.want, Angle):
            draft = driven(draft, rungs)
        if draft is not None:
            out.append(draft)
    return out or first
