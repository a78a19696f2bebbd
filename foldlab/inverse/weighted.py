"""Inverse design under weight: drafts from formulas and a rod, confirmed by the solver.

The limits leave a region as in ``propose``. Its designs are screened by ``rungs``; a wished angle
is then reached along one free group by the rod, and finished by the solver (``finish``). Of a named
material the middle of its ranges counts, as for ``foldlab check``, unless the wish limits E or ρ.
Where nothing folds, the largest size that does is searched for (``size``).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from foldlab.design import FULL, PATTERNED
from foldlab.errors import InputError
from foldlab.inverse.answer import Answer, Proposal
from foldlab.inverse.box import Box
from foldlab.inverse.draft import Draft, Work, bearable, driven
from foldlab.inverse.extreme import Price, frugal
from foldlab.inverse.finish import ANSWERS, by_rod, finish
from foldlab.inverse.points import groups_of, named, spread
from foldlab.inverse.propose import climb
from foldlab.inverse.region import Region
from foldlab.inverse.rungs import CUT_SPACE, NEAR, SPACE, Rungs, turned
from foldlab.inverse.wish import Angle, Wish, limits_of, scales_of
from foldlab.materials import read_materials

WALKERS = 4096
RODS = 512
# Walkers and rounds of a climb by the rod, where the formulas see no design that does.
CLIMBERS, ROUNDS = 64, 8
PROBE = 0.05  # times the margin: a small box that tells sensitive designs from others
TRIES = 3  # designs that the solver is asked of at most, for each that is wished for
TRIED = 60  # designs whose margin is found
HANDY = (5e-3, 0.5)  # m, l_s where a wish leaves it open
OF_MATERIAL = {
    "E_s": ("passive", "E", {"E_s", "stiffness_to_weight"}),
    "rho_s": ("passive", "rho", {"rho_s"}),
    "E_i": ("active", "E", {"E_i", "E_ratio"}),
    "rho_i": ("active", "rho", {"rho_i", "rho_ratio"}),
}


def regions_of(wish: Wish) -> list[tuple[tuple[str | None, str | None], Region]]:
    """A region for every pair of materials that has one; raises :class:`InputError` without any."""
    table = read_materials(wish.materials)
    out, failures = [], []
    for given in wish.pairs:
        pair = named(table, given)
        middle = _middle(wish, pair, table)
        try:
            try:
                out.append((pair, Region(middle, limits_of(middle, pair, table))))
            except InputError:
                if middle == wish:
                    raise
                out.append((pair, Region(wish, limits_of(wish, pair, table))))
        except InputError as error:
            name = f"{' + '.join(filter(None, pair))}: " if len(wish.pairs) > 1 else ""
            failures.append(f"{name}{error}")
    if not out:
        raise InputError("; ".join(dict.fromkeys(failures)))
    return out


def _handy(wish: Wish) -> tuple[Wish, list[tuple[tuple[str | None, str | None], Region]]]:
    """The wish and its regions; where it says no l_s, with one that a hand can take, if it may."""
    if not all(scales_of(wish).values()) or "l_s" in {*wish.fixed, *wish.ranges}:
        return wish, regions_of(wish)
    low, high = HANDY
    if wish.max_length is not None:
        low, high = wish.max_length / 4, wish.max_length
    handy = replace(wish, ranges={**wish.ranges, "l_s": (low, high)})
    try:
        return handy, regions_of(handy)
    except InputError:
        return wish, regions_of(wish)


def _middle(wish: Wish, pair, table) -> Wish:
    """With E and ρ of its materials where they are most likely."""
    limited = {*wish.fixed, *wish.ranges}
    fixed = dict(wish.fixed)
    for quantity, (role, column, same) in OF_MATERIAL.items():
        name = pair[0 if role == "passive" else 1]
        if name is None or limited & same:
            continue
        low, high = (float(table.loc[name, f"{column}_{end}"]) for end in ("low", "high"))
        fixed[quantity] = (low * high) ** 0.5 if column == "E" else (low + high) / 2
    return replace(wish, fixed=fixed)


@dataclass(frozen=True)
class Found:
    """``drafts``: that do as wished by the rod, the best first. ``room``: the most that was seen,
    rad, < 0 where nothing does as wished; ``margin``: the largest, as a fraction of the bounds, of
    those that do, None where none was asked for."""

    drafts: list[Draft]
    room: float
    margin: float | None = None


def drafts(
    wish: Wish, regions, n: int, *, seed: int, model: Any = None, walkers: int = WALKERS
) -> Found:
    """At most ``n`` diverse designs that do as wished by the rod, with the wished margin."""
    found = Found([], -np.inf)
    for meet, rocking in product((False, True), (False, True)):
        if (rocking and not wish.stands) or (wish.touching and not meet):
            continue
        rungs, rng = Rungs(wish, model, meet, rocking), np.random.default_rng(seed)
        tries = [_search(rungs, region, pair, n, rng, walkers) for pair, region in regions]
        every = [entry for some, _ in tries for entry in some]
        found = replace(found, room=max(found.room, *(room for _, room in tries)))
        if every and wish.margin > 0:
            good = [(draft, worst) for draft, worst in every if worst >= 0]
            if not good:
                margins = [Box(d, rungs).margin(Box(d, rungs).scale()) for d, _ in every[:16]]
                found = replace(found, margin=max([found.margin or 0.0, *margins]))
            every = good
        if every or (wish.want != "foldable" and rocking == wish.stands):
            break
    if not every:
        return found
    some, worth = [draft for draft, _ in every], np.array([worth for _, worth in every])
    groups = pd.DataFrame([draft.groups for draft in some])
    physical = pd.DataFrame([draft.physical for draft in some])
    chosen = spread(groups, physical, np.maximum(worth, 0), min(n, len(some)))
    return replace(found, drafts=[some[k] for k in chosen])


def _search(rungs: Rungs, region: Region, pair, n: int, rng, walkers: int):
    """Drafts in one region with their worth for :func:`spread`, and the best room seen."""
    angle = isinstance(rungs.wish.want, Angle)
    slack = NEAR if angle else 0.0
    rods = max(RODS * walkers // WALKERS, 8 * n)
    x, worth = climb(
        lambda y: rungs.first(groups_of(region, y)),
        region, region.sample(walkers, rng), rng, need=rods,
    )  # fmt: skip
    order = rng.permutation(len(x))
    x = x[order[np.argsort(-np.minimum(worth[order], 0), kind="stable")][:rods]]

    def second(y):
        return rungs.second(groups_of(region, y), slack)

    value, enough = second(x), max(2 * n, 8)
    if (value >= 0).sum() < enough:
        top = x[np.argsort(-value)[:CLIMBERS]]
        more, worth = climb(second, region, top, rng, need=enough, rounds=ROUNDS, steps=2)
        x, value = np.vstack([x, more]), np.concatenate([value, worth])
    best = float(value.max(initial=-np.inf)) - slack
    x, value = x[value >= 0], value[value >= 0]
    order = rng.permutation(len(x))
    if not angle:  # half of those that are tried for their margin are those with the most room
        order = np.r_[np.argsort(-value)[: TRIED // 2], order]
    out = []
    for k in list(dict.fromkeys(order.tolist()))[: max(4 * n, 24) if angle else TRIED]:
        draft = Draft(pair, region, x[k])
        if not angle:
            out.append((draft, _worst(draft, rungs, float(value[k]))))
        elif (driven_ := driven(draft, rungs)) is not None:
            # An angle is as good as it bears tolerances, and as its rod is sure.
            error = turned(driven_.groups)[1]
            box = Box(driven_, rungs)
            room = float(box.rooms(box.designs(PROBE)).min()) / rungs.wish.want.tolerance
            worth = max(1 + room, 0.05) / (1 + 20 * error)
            out.append((driven_, min(_worst(driven_, rungs, worth), worth)))
            best = max(best, 0.0)
    return out, best


def _worst(draft: Draft, rungs: Rungs, room: float) -> float:
    """The least room in the box of the wished margin, rad; ``room`` itself without a margin."""
    box = Box(draft, rungs)
    return float(box.rooms(box.designs(1.0)).min()) if rungs.wish.margin > 0 else room


def weighted(
    wish: Wish,
    n: int = 5,
    *,
    seed: int,
    source,
    model: Any = None,
    confirmed: bool = True,
    executor: Executor | None = None,
    walkers: int = WALKERS,
    tell: Callable[[str], None] = lambda text: None,
) -> Answer:
    """``n`` diverse designs that do as wished under their weight, confirmed by ``source``.

    ``wish``: of the full space. ``source``: a :class:`foldlab.labels.solver.SolverSource`; without
    ``confirmed`` it isn't asked, and the rod's word stands. ``model``: a classifier of the full
    space that screens beside the formulas. ``executor``: finishes several at a time. ``walkers``:
    designs that are drawn. ``tell`` hears what happens. Raises :class:`InputError` for limits that
    exclude each other.
    """
    from foldlab.inverse.size import largest

    if n < 1:
        raise InputError(f"n = {n}; ask for at least one design")
    start = time.perf_counter()
    # Where it is known what a unit weighs, it may weigh next to nothing.
    if all(scales_of(wish).values()):
        wish = replace(wish, space=CUT_SPACE if wish.patterned else SPACE)
    else:
        wish = replace(wish, space=PATTERNED if wish.patterned else FULL)
    _feels(wish, source, model, confirmed)
    if isinstance(wish.want, Angle) and wish.want.value >= 2 * np.pi:
        raise InputError(
            f"a fold angle of {wish.want.value:g} rad; a unit turns by less than a full turn; "
            "90 degrees are angle=90deg"
        )
    begun = time.process_time()
    done: list[Proposal] = []
    failed: list[Proposal] = []

    def spent() -> float:
        away = sum(p.core_seconds for p in (*done, *failed)) if executor else 0.0
        return time.process_time() - begun + away

    wish, regions = _handy(wish)
    strict = wish.strain_margin is not None
    for pair, _ in regions if strict else ():
        bearable(wish, pair)
    most = n * (2 * TRIES if strict else TRIES) if confirmed else n
    if wish.least:
        for pair, region in regions:
            Price(wish, pair, region)  # for what it refuses
    found = drafts(wish, regions, most, seed=seed, model=model, walkers=walkers)
    some = list(found.drafts)
    if some and wish.least:
        tell(f"{len(some)} designs by the rod, each given as little {wish.least} as it can do with")
        some = frugal(some, wish, lambda draft, rungs: _worst(draft, rungs, np.inf))
    if some:
        tell(forecast(some, n, source, confirmed))
    while some and len(done) < n:
        batch, some = some[: n - len(done)], some[n - len(done) :]
        works = [Work(wish, draft, source) for draft in batch]
        run = finish if confirmed else by_rod
        results = executor.map(run, works) if executor else map(run, works)
        for proposal in results:
            good = proposal.confirmed is True or not confirmed
            (done if good else failed).append(proposal)
            tell(
                f"{len(done)} of {n} {'confirmed' if confirmed else 'proposed'}, "
                f"{len(failed)} not as wished, {spent():.3g} core-seconds"
            )
    answer = Answer(
        wish, n, tuple(done), f"{n} design{'s' * (n > 1)} found", time.perf_counter() - start,
        source.name if confirmed else "", weightless=False,
        core_seconds=spent(),
        rejected=len(failed),
    )  # fmt: skip
    if len(done) == n:
        return answer
    if done:
        reason = f"only {len(done)} distinct designs within the limits"
        if failed:
            reason += f", and {len(failed)} more that the {source.name} did not confirm"
        return replace(answer, reason=f"{reason}; widen a range")
    if found.margin is not None or failed:
        return replace(answer, reason=_why(wish, found, failed))
    size, reason = largest(wish, seed=seed, source=source if confirmed else None, tell=tell)
    return replace(
        answer, reason=reason, largest=size, seconds=time.perf_counter() - start,
        core_seconds=spent(),
    )  # fmt: skip


def _feels(wish: Wish, source, model, confirmed: bool) -> None:
    """Raises :class:`InputError` where who is asked can't tell what is wished."""
    if wish.touching is not None:
        terms = source.conditions.terms if hasattr(source, "conditions") else ()
        if not confirmed or "contact" not in terms:
            raise InputError(
                "whether panels touch is told by the solver with contact among its effects; let "
                "it confirm, or wish nothing of the panels"
            )
    if wish.patterned and not getattr(source, "patterned", False):
        raise InputError(
            f"the source {source.name} knows solid active layers only, and the wish cuts them in "
            "strips; take --source solver"
        )
    if wish.patterned and model is not None:
        raise InputError(
            "the model knows solid active layers only, and the wish cuts them in strips; leave it "
            "out: a rod proposes"
        )


def forecast(some: list[Draft], n: int, source, confirmed: bool) -> str:
    """What confirming will cost, in a sentence."""
    from foldlab.labels.forecast import forecast as of_label

    if not confirmed:
        return f"{len(some)} designs by the rod; the solver is not asked"
    costs = (
        [of_label(draft.groups, source) for draft in some[:n]] if source.name == "solver" else []
    )
    cost = "nobody knows at what cost"
    if costs and all(costs):
        cost = f"about {ANSWERS * sum(cost.seconds for cost in costs):.2g} core-seconds"
    return (
        f"{len(some)} designs by the rod; the {source.name} is asked of {min(n, len(some))} and "
        f"their boxes, {cost}"
    )


def _why(wish: Wish, found: Found, failed: list[Proposal]) -> str:
    """Why there is no answer where some design does as wished by the rod."""
    if failed:
        label = failed[0].label
        said = label.reason if label is not None else "nothing"
        told = []
        if wish.strain_margin is not None:
            told.append("are strained by more than their materials surely bear with that margin")
        if wish.stands:
            told.append("topple")
        if told and label is not None and label.foldable is not None:
            said = f"some {' or '.join(told)}"
        return f"none of {len(failed)} designs that the rod proposed was confirmed: {said}"
    return (
        f"the behaviour is predicted, but no design was found with a margin of {wish.margin:g}; "
        f"the largest found is {found.margin:.3g}: lower the margin to that"
    )
