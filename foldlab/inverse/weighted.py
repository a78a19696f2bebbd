"""Inverse design under weight: drafts from formulas and a rod, finished and confirmed by the solver.

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
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from foldlab.errors import InputError
from foldlab.inverse.answer import Answer, Proposal
from foldlab.inverse.points import groups_of, named, physical_of, spread
from foldlab.inverse.propose import climb
from foldlab.inverse.region import Region
from foldlab.inverse.rungs import NEAR, SPACE, Rungs
from foldlab.inverse.wish import Angle, Wish, limits_of
from foldlab.materials import read_materials

WALKERS = 4096
RODS = 512
# Walkers and rounds of a climb by the rod, where the formulas see no design that does.
CLIMBERS, ROUNDS = 64, 8
# What is changed to reach an angle, in this order: the first that the wish leaves free.
DRIVERS = ("contraction", "hinge_length", "h_ratio", "slenderness", "E_ratio", "l_s")
OF_MATERIAL = {
    "E_s": ("passive", "E", {"E_s", "stiffness_to_weight"}),
    "rho_s": ("passive", "rho", {"rho_s"}),
    "E_i": ("active", "E", {"E_i", "E_ratio"}),
    "rho_i": ("active", "rho", {"rho_i", "rho_ratio"}),
}


@dataclass(frozen=True)
class Draft:
    """A design by the rod: log10 variables ``x`` (see :class:`Region`), rod's ``angle`` in rad;
    ``driver``: the group along which an angle is reached, or None."""

    pair: tuple[str | None, str | None]
    region: Region
    x: np.ndarray
    angle: float
    driver: str | None = None

    @property
    def groups(self) -> dict[str, float]:
        return groups_of(self.region, self.x[None]).iloc[0].to_dict()

    @property
    def physical(self) -> dict[str, float]:
        groups = groups_of(self.region, self.x[None])
        return physical_of(self.region, groups, self.x[None]).iloc[0].dropna().to_dict()


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


def drafts(
    wish: Wish, regions, n: int, *, seed: int, model: Any = None, walkers: int = WALKERS
) -> tuple[list[Draft], float]:
    """At most ``n`` diverse designs that do as wished by the rod, the best first; and the best room
    that was seen, rad (< 0 where there is none)."""
    best = -np.inf
    for meet in (False, True):
        rungs = Rungs(wish, model, meet)
        tries = [
            _search(rungs, region, pair, n, np.random.default_rng(seed), walkers)
            for pair, region in regions
        ]
        best = max(best, *(reached for _, _, reached in tries))
        every = [draft for some, _, _ in tries for draft in some]
        if every or wish.want != "foldable":
            break
    if not every:
        return [], best
    rooms = np.concatenate([rooms for _, rooms, _ in tries])
    groups = pd.DataFrame([draft.groups for draft in every])
    physical = pd.DataFrame([draft.physical for draft in every])
    chosen = spread(groups, physical, np.maximum(rooms, 0), min(n, len(every)))
    return [every[k] for k in chosen], best


def _search(rungs: Rungs, region: Region, pair, n: int, rng, walkers: int):
    """Drafts in one region, their room for :func:`spread`, and the best room seen."""
    angle = isinstance(rungs.wish.want, Angle)
    slack = NEAR if angle else 0.0
    rods = max(RODS * walkers // WALKERS, 8 * n)
    x, worth = climb(
        lambda y: rungs.first(groups_of(region, y)),
        region, region.sample(walkers, rng), rng, need=rods,
    )  # fmt: skip
    order = rng.permutation(len(x))
    order = order[np.argsort(-np.minimum(worth[order], 0), kind="stable")][:rods]
    x = x[order]

    def by_rod(y):
        return rungs.second(groups_of(region, y), slack)

    value = by_rod(x)
    enough = max(2 * n, 8)
    if (value >= 0).sum() < enough and walkers >= CLIMBERS:
        top = x[np.argsort(-value)[:CLIMBERS]]
        more, worth = climb(by_rod, region, top, rng, need=enough, rounds=ROUNDS, steps=2)
        x, value = np.vstack([x, more]), np.concatenate([value, worth])
    best = float(value.max(initial=-np.inf)) - slack
    x, value = x[value >= 0], value[value >= 0]
    keep = rng.permutation(len(x))[: max(4 * n, 24)] if angle else np.arange(len(x))
    rod = rungs.rod(groups_of(region, x[keep]))
    out, rooms = [], []
    for k, (turned, error) in zip(keep, rod.to_numpy(), strict=True):
        draft = Draft(pair, region, x[k], turned)
        if angle:
            draft = driven(draft, rungs)
            if draft is None:
                continue
            best = max(best, 0.0)
        out.append(draft)
        # An angle is as good as its rod is sure; a label as far as it is beyond its threshold.
        rooms.append(1 / (1 + 20 * error) if angle else min(value[k] / (error + 1e-3), 5.0))
    return out, np.array(rooms), best


def driven(draft: Draft, rungs: Rungs) -> Draft | None:
    """The design nearest to a draft, along the first free driver, whose rod has the wished angle;
    None where there is none."""
    wanted = rungs.wish.want.value
    for name in DRIVERS:
        line = draft.region.line(draft.x, name)
        if line is None:
            continue
        direction, low, high = line
        low, high = max(low, -1.0), min(high, 1.0)
        if high - low < 1e-6:
            continue

        def off(t, direction=direction):
            groups = groups_of(draft.region, (draft.x + t * direction)[None])
            return float(rungs.rod(groups)["angle"].iloc[0]) - wanted

        grid = np.unique(np.r_[np.linspace(low, high, 9), 0.0])
        values = np.array([off(t) for t in grid])
        change = np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) <= 0)
        ends = sorted(change, key=lambda k: min(abs(grid[k]), abs(grid[k + 1])))
        for k in ends:
            if not np.isfinite(values[k : k + 2]).all():
                continue
            t = _root(off, grid[k], grid[k + 1])
            if t is not None:
                return replace(draft, x=draft.x + t * direction, angle=wanted, driver=name)
    return None


def _root(off: Callable[[float], float], low: float, high: float) -> float | None:
    """Where a function is 0; None at a jump or where it is nowhere known."""
    try:
        t = brentq(off, low, high, xtol=1e-5, maxiter=30)
    except (ValueError, RuntimeError):
        return None
    return t if abs(off(t)) < 0.01 else None


@dataclass(frozen=True)
class Work:
    """What :func:`foldlab.inverse.finish.finish` is asked for; it travels to workers."""

    wish: Wish
    draft: Draft
    source: Any
    box: bool = True


def weighted(
    wish: Wish,
    n: int = 5,
    *,
    seed: int,
    source,
    model: Any = None,
    confirmed: bool = True,
    executor: Executor | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Answer:
    """``n`` diverse designs that do as wished under their weight, confirmed by ``source``.

    ``wish``: of the full space. ``source``: a :class:`foldlab.labels.solver.SolverSource`; without
    ``confirmed`` it isn't asked, and the rod's word stands. ``model``: a classifier of the full
    space that screens beside the formulas. ``executor``: finishes several at a time. ``tell`` hears
    what happens. Raises :class:`InputError` for limits that exclude each other.
    """
    from foldlab.inverse.finish import by_rod, finish
    from foldlab.inverse.size import largest

    if n < 1:
        raise InputError(f"n = {n}; ask for at least one design")
    start, wish = time.perf_counter(), replace(wish, space=SPACE)
    if isinstance(wish.want, Angle) and wish.want.value >= 2 * np.pi:
        raise InputError(
            f"a fold angle of {wish.want.value:g} rad; a unit turns by less than a full turn"
        )
    spent = time.process_time()
    regions = regions_of(wish)
    tries = 3 * n if confirmed else n
    some, _ = drafts(wish, regions, tries, seed=seed, model=model)
    searched = time.process_time() - spent
    done: list[Proposal] = []
    failed: list[Proposal] = []
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
            spent = searched + sum(p.core_seconds for p in (*done, *failed))
            tell(
                f"{len(done)} of {n} {'confirmed' if confirmed else 'proposed'}, "
                f"{len(failed)} not as wished, {spent:.3g} core-seconds"
            )
    answer = Answer(
        wish, n, tuple(done), f"{n} designs found", time.perf_counter() - start,
        source.name if confirmed else "", weightless=False,
        core_seconds=searched + sum(p.core_seconds for p in (*done, *failed)),
        rejected=len(failed),
    )  # fmt: skip
    if len(done) == n:
        return answer
    if done:
        reason = f"only {len(done)} of {n} designs within the limits; widen a range"
        return replace(answer, reason=reason)
    size, reason = largest(wish, seed=seed, source=source if confirmed else None, tell=tell)
    return replace(answer, reason=reason, largest=size, seconds=time.perf_counter() - start)


def forecast(some: list[Draft], n: int, source, confirmed: bool) -> str:
    """What confirming will cost, in a sentence."""
    from foldlab.inverse.finish import ANSWERS
    from foldlab.labels.forecast import forecast as of_label

    if not confirmed:
        return f"{len(some)} designs by the rod; the solver is not asked"
    costs = [of_label(draft.groups, source) for draft in some[:n]]
    seconds = ANSWERS * sum(cost.seconds for cost in costs if cost is not None)
    return (
        f"{len(some)} designs by the rod; the solver confirms {min(n, len(some))} with their boxes: "
        f"about {seconds:.2g} core-seconds"
    )
