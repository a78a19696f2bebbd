"""Inverse design: from a wish to designs (§4.2.3, §4.8.2).

The limits of the wish leave a region (``region``); a classifier says where in it the wanted label
is predicted; of these designs those are proposed that keep a distance from the predicted boundary
and from each other; a label source confirms them (``confirm``). What margin and box mean:
``robust``. Wishes that feel weight: ``weighted``.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from foldlab.inverse.answer import Answer, Proposal
from foldlab.inverse.points import MASS_COLUMNS, groups_of, named, physical_of, spread
from foldlab.inverse.region import Region
from foldlab.inverse.robust import Score
from foldlab.inverse.wish import Angle, Wish, limits_of, mass_of
from foldlab.materials import read_materials

WALKERS = 4096
_CLIMBS = 12


def propose(wish: Wish, classifier=None, n: int = 5, *, seed: int, angle_model=None) -> Answer:
    """``n`` diverse designs that are predicted to fulfil a wish with its margin.

    ``classifier``: ``predict_proba`` on a frame of groups; needed for a label. ``angle_model``,
    needed for an :class:`Angle`: a formula source (``evaluate``), or a regressor whose ``predict``
    gives κ l_s/g in the reduced space and the fold angle in rad in the full space.

    Raises :class:`InputError` for a wish whose limits exclude each other or whose mass or size is
    out of reach. Where the limits can be met but the behaviour is not predicted anywhere, or not
    with this margin, or not often enough, the answer is short and its reason says what binds.
    """
    if n < 1:
        raise InputError(f"n = {n}; ask for at least one design")
    if wish.patterned or wish.touching is not None:
        raise InputError(
            "strips and panels that touch are known to the solver only, under weight; wish for "
            "neither where nothing weighs"
        )
    start = time.perf_counter()
    score = Score(wish, classifier, angle_model)
    table = read_materials(wish.materials) if wish.passive or wish.active else None
    pairs = [named(table, pair) for pair in wish.pairs]
    regions, failures = [], []
    for pair in pairs:
        try:
            regions.append((pair, Region(wish, limits_of(wish, pair, table))))
        except InputError as error:
            # Without alternatives the names would only repeat what the wish says.
            name = f"{' + '.join(filter(None, pair))}: " if len(pairs) > 1 else ""
            failures.append(f"{name}{error}")
    if not regions:
        raise InputError("; ".join(dict.fromkeys(failures)))
    walkers = max(WALKERS, 8 * n)
    tries = [_search(score, region, n, seed, walkers) for _, region in regions]
    reached = [
        (pair, region, x[robust])
        for (pair, region), (x, robust, _) in zip(regions, tries, strict=True)
        if robust.any()
    ]
    if not reached:
        return Answer(wish, n, (), _why_none(score, regions, tries, seed), _since(start))
    proposals = _assemble(score, reached, n, seed)
    reason = f"{n} designs found"
    if len(proposals) < n:
        reason = f"only {len(proposals)} distinct designs within the limits; widen a range"
    return Answer(wish, n, tuple(proposals), reason, _since(start))


def _since(start: float) -> float:
    return time.perf_counter() - start


def climb(score, region, x, rng, *, need: int, rounds: int = _CLIMBS, steps: int = 6):
    """Walkers driven towards higher scores until ``need`` are ≥ 0 (levels of the best tenth)."""
    worth = score(x)
    for _ in range(rounds):
        if (worth >= 0).sum() >= need:
            break
        level = min(np.quantile(worth, 0.9), 0.0)
        seeds = x[worth >= level]
        x = seeds[rng.integers(len(seeds), size=len(x))]
        x = region.walk(x, steps, rng, accept=lambda y, level=level: score(y) >= level)
        worth = score(x)
    return x, worth


def _search(score: Score, region: Region, n: int, seed: int, walkers: int):
    """Designs reached, which of them are as wished with the margin, and the best score."""
    rng = np.random.default_rng(seed)

    def nominal(x):
        return score(groups_of(region, x))

    def worst(x):
        unit = score.unit(groups_of(region, x))
        return score.everywhere(unit - score.wish.margin, unit + score.wish.margin)

    x, worth = climb(nominal, region, region.sample(walkers, rng), rng, need=max(4 * n, 64))
    best = float(worth.max())
    good = x[worth >= 0]
    if len(good) == 0 or score.wish.margin == 0:
        return x, worth >= 0, best
    kept = worst(good) >= 0
    if kept.sum() >= 2 * n:
        return good, kept, best
    few = good[rng.integers(len(good), size=max(walkers // 8, 4 * n))]
    more, worth = climb(worst, region, few, rng, need=2 * n)
    return np.vstack([good, more]), np.concatenate([kept, worth >= 0]), best


def _why_none(score: Score, regions, tries, seed: int) -> str:
    """One sentence: how close the search came, which limit binds and where it would let go."""
    wish = score.wish
    angle = isinstance(wish.want, Angle)
    what = f"a fold angle of {wish.want.value:g} rad" if angle else f"{wish.want!r}"
    best = int(np.argmax([best for *_, best in tries]))
    region, (x, _, reached) = regions[best][1], tries[best]
    groups = groups_of(region, x)
    value = score(groups)
    if reached >= 0:
        zero = Score(replace(wish, margin=0.0), score.classifier, score.angle_model)
        most = float(zero.margin(zero.unit(groups[value >= 0].iloc[:2000])).max())
        text = f"{what} is predicted, but no design was found with a margin of {wish.margin:g}"
        hint = f"the largest found is {most:.3g}: lower the margin to that"
    else:
        text = f"no design was found within the limits for which {what} is predicted"
        top = groups.iloc[[int(np.argmax(value))]]
        hint = (
            f"the closest angle is {score.angle(top)[0]:.4g} rad"
            if angle
            else f"its probability reaches {reached + wish.min_probability:.2g}"
        )
    nearest = None
    for text_of_limit, quantity, relaxed, distance in region.relaxed():
        # Nothing may be clipped back to the limit that was left out.
        fixed = {k: v for k, v in wish.fixed.items() if k != quantity}
        ranges = {k: v for k, v in wish.ranges.items() if k != quantity}
        relaxed = Region(replace(relaxed.wish, fixed=fixed, ranges=ranges), relaxed.limits)
        x, robust, _ = _search(score, relaxed, 16, seed, WALKERS // 8)
        if robust.any():
            away, value = distance(x[robust])
            if nearest is None or away < nearest[0]:
                nearest = (away, f"{text_of_limit} binds, since {quantity} = {value} would do")
    return f"{text}; {hint}; {nearest[1] if nearest else 'relaxing one limit alone does not help'}"


def _assemble(score: Score, reached, n: int, seed: int) -> list[Proposal]:
    rng = np.random.default_rng(seed)
    groups, physical, owner = [], [], []
    for k, (_, region, x) in enumerate(reached):
        x = x[rng.permutation(len(x))[: max(2000, 4 * n)]]
        groups.append(groups_of(region, x))
        physical.append(physical_of(region, groups[-1], x))
        owner += [k] * len(x)
    groups, physical = (pd.concat(t, ignore_index=True) for t in (groups, physical))
    margin = score.margin(score.unit(groups))
    chosen = spread(groups, physical, margin, n)
    groups, physical = (t.iloc[chosen].reset_index(drop=True) for t in (groups, physical))
    margin, unit = margin[chosen], score.unit(groups)
    low, high = (score.frame(side) for side in score.box(unit, margin))
    mass = mass_of(physical) if {*MASS_COLUMNS} <= {*physical.columns} else None
    probability = None if score.classifier is None else score.probability(groups)
    angle = score.angle(groups) if isinstance(score.wish.want, Angle) else None
    out = []
    for i in range(len(groups)):
        row = groups.iloc[i].to_dict()
        # A design on a bound may sit a rounding error beyond its own box.
        box = {
            name: (min(float(low[name][i]), row[name]), max(float(high[name][i]), row[name]))
            for name in score.names
        }
        out.append(
            Proposal(
                groups=row,
                physical=physical.iloc[i].dropna().to_dict(),
                materials=reached[owner[chosen[i]]][0],
                mass=None if mass is None or np.isnan(mass[i]) else float(mass[i]),
                probability=None if probability is None else float(probability[i]),
                angle=None if angle is None else float(angle[i]),
                margin=float(margin[i]),
                box=box,
            )
        )
    return out
