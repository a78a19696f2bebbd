"""Inverse design: from a wish to designs (§4.2.3, §4.8.2).

The limits of the wish leave a region (``region``); a classifier says where in it the wanted label
is predicted; of these designs those are proposed that keep a distance from the predicted boundary
and from each other; a label source confirms them. What margin and box mean: ``robust``.
Search, choice and confirmation are one sequence on one record, and stay in one file.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pandas as pd

from foldlab.design import FULL, RATIOS, to_physical
from foldlab.errors import InputError
from foldlab.inverse.region import Region
from foldlab.inverse.robust import Score
from foldlab.inverse.wish import (
    SCALES,
    Angle,
    Wish,
    box_parameters,
    limits_of,
    mass_of,
)
from foldlab.labels.label import Label, ask
from foldlab.materials import find_material, read_materials

WALKERS = 4096
_CLIMBS = 12


@dataclass(frozen=True)
class Proposal:
    """One design that is predicted to do what was wished.

    ``groups``: value by group. ``physical``: SI values by name as far as the limits reach
    (``design.PHYSICAL``). ``mass`` in kg, or None. ``probability``: predicted P(foldable), None
    without a classifier. ``angle``: predicted fold angle, rad, None unless wished. ``margin``:
    half-width (fraction of the bounds) of the largest cube predicted to do as wished. ``box``:
    (low, high) by group; predicted to hold, with half the wished margin to spare on every side.
    After :func:`confirm`: the source's ``label`` of the design, and how many of ``box_checked``
    points of the box the source labels as wished (``box_held``) or could not tell
    (``box_unknown``).
    """

    groups: Mapping[str, float]
    physical: Mapping[str, float]
    materials: tuple[str | None, str | None]
    mass: float | None
    probability: float | None
    angle: float | None
    margin: float
    box: Mapping[str, tuple[float, float]]
    label: Label | None = None
    confirmed: bool | None = None
    box_checked: int = 0
    box_held: int = 0
    box_unknown: int = 0

    @property
    def box_confirmed(self) -> bool | None:
        """True if the source agrees at every checked point; None if unchecked or partly unknown."""
        if self.box_held + self.box_unknown < self.box_checked:
            return False
        return True if self.box_checked and not self.box_unknown else None

    def as_dict(self) -> dict:
        """Plain values for JSON; the label as its reason and evidence."""
        out = {k: v for k, v in self.__dict__.items() if k != "label"}
        out["groups"], out["physical"] = dict(self.groups), dict(self.physical)
        out["box"] = {name: list(ends) for name, ends in self.box.items()}
        out["materials"] = list(self.materials)
        out["box_confirmed"] = self.box_confirmed
        if self.label is not None:
            out |= {"reason": self.label.reason, "evidence": dict(self.label.evidence)}
        return out


@dataclass(frozen=True)
class Answer:
    """Proposals for a wish, most robust first; fewer than ``asked`` where ``reason`` says why."""

    wish: Wish
    asked: int
    proposals: tuple[Proposal, ...]
    reason: str
    seconds: float
    source: str = ""

    @property
    def complete(self) -> bool:
        return len(self.proposals) == self.asked

    @property
    def confirmed_fraction(self) -> float | None:
        """Confirmed over all proposals (unknown counts as not); None before :func:`confirm`."""
        if not self.proposals or any(p.label is None for p in self.proposals):
            return None
        return sum(p.confirmed is True for p in self.proposals) / len(self.proposals)

    def as_dict(self) -> dict:
        """Plain values for JSON."""
        return {
            "asked": self.asked,
            "proposed": len(self.proposals),
            "reason": self.reason,
            "seconds": self.seconds,
            "source": self.source,
            "confirmed_fraction": self.confirmed_fraction,
            "proposals": [p.as_dict() for p in self.proposals],
        }


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
    start = time.perf_counter()
    score = Score(wish, classifier, angle_model)
    table = read_materials(wish.materials) if wish.passive or wish.active else None
    pairs = [_named(table, pair) for pair in wish.pairs]
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


def _groups(region: Region, x: np.ndarray) -> pd.DataFrame:
    """Groups of log10 variables; what the wish states is met to the last digit."""
    wish = region.wish
    columns = {}
    for k, name in enumerate(region.names):
        if name in FULL.names:
            p = wish.space[name] if name in wish.space.names else FULL[name]
            low, high = wish.ranges.get(name, (p.low, p.high))
            values = np.clip(10.0 ** x[:, k], low, high)
            columns[name] = np.full(len(x), wish.fixed[name]) if name in wish.fixed else values
    return pd.DataFrame(columns)


def _climb(score, region, x, rng, *, need: int):
    """Walkers driven towards higher scores until ``need`` are ≥ 0 (levels of the best tenth)."""
    worth = score(x)
    for _ in range(_CLIMBS):
        if (worth >= 0).sum() >= need:
            break
        level = min(np.quantile(worth, 0.9), 0.0)
        seeds = x[worth >= level]
        x = seeds[rng.integers(len(seeds), size=len(x))]
        x = region.walk(x, 6, rng, accept=lambda y, level=level: score(y) >= level)
        worth = score(x)
    return x, worth


def _search(score: Score, region: Region, n: int, seed: int, walkers: int):
    """Designs reached, which of them are as wished with the margin, and the best score."""
    rng = np.random.default_rng(seed)

    def nominal(x):
        return score(_groups(region, x))

    def worst(x):
        unit = score.unit(_groups(region, x))
        return score.everywhere(unit - score.wish.margin, unit + score.wish.margin)

    x, worth = _climb(nominal, region, region.sample(walkers, rng), rng, need=max(4 * n, 64))
    best = float(worth.max())
    good = x[worth >= 0]
    if len(good) == 0 or score.wish.margin == 0:
        return x, worth >= 0, best
    kept = worst(good) >= 0
    if kept.sum() >= 2 * n:
        return good, kept, best
    few = good[rng.integers(len(good), size=max(walkers // 8, 4 * n))]
    more, worth = _climb(worst, region, few, rng, need=2 * n)
    return np.vstack([good, more]), np.concatenate([kept, worth >= 0]), best


def _why_none(score: Score, regions, tries, seed: int) -> str:
    """One sentence: how close the search came, which limit binds and where it would let go."""
    wish = score.wish
    angle = isinstance(wish.want, Angle)
    what = f"a fold angle of {wish.want.value:g} rad" if angle else f"{wish.want!r}"
    best = int(np.argmax([best for *_, best in tries]))
    region, (x, _, reached) = regions[best][1], tries[best]
    groups = _groups(region, x)
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
        groups.append(_groups(region, x))
        physical.append(_physical(region, groups[-1], x))
        owner += [k] * len(x)
    groups, physical = (pd.concat(t, ignore_index=True) for t in (groups, physical))
    margin = score.margin(score.unit(groups))
    chosen = _spread(groups, physical, margin, n)
    groups, physical = (t.iloc[chosen].reset_index(drop=True) for t in (groups, physical))
    margin, unit = margin[chosen], score.unit(groups)
    low, high = (score.frame(side) for side in score.box(unit, margin))
    mass = mass_of(physical) if {*_MASS_COLUMNS} <= {*physical.columns} else None
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


_MASS_COLUMNS = ("rho_s", "rho_i", "l_s", "l_i", "b_s", "b_i", "h_s", "h_i")


def _physical(region: Region, groups: pd.DataFrame, x: np.ndarray) -> pd.DataFrame:
    """SI quantities as far as the limits reach; fixed ones to the last digit."""
    wish = region.wish
    scales = {
        name: 10.0 ** x[:, region.names.index(name)]
        for name in (*SCALES, "g_earth")
        if name in region.names
    }
    if not scales:
        return pd.DataFrame(index=groups.index)
    known, columns = set(scales), []
    for quantity, (group, scale) in RATIOS.items():
        if group in groups and scale in known:
            known.add(quantity)
            columns.append(group)
    columns += [name for name in ("contraction",) if name in groups]
    if "stiffness_to_weight" in groups:
        columns.append("stiffness_to_weight")
        scales.pop("E_s")  # follows from Γ, so that the answer is consistent by construction
    out = to_physical(groups[columns], **scales)
    for name in out.columns:
        if name in wish.fixed:
            out[name] = float(wish.fixed[name])
        elif name in wish.ranges:
            out[name] = out[name].clip(*wish.ranges[name])
    return out


def _named(table, pair: tuple[str | None, str | None]) -> tuple[str | None, str | None]:
    """The table's own names of a passive and an active material."""
    roles = zip(pair, ("passive", "active"), strict=True)
    passive, active = (name and find_material(table, name, role) for name, role in roles)
    return passive, active


def _spread(groups, physical, margin, n: int) -> list[int]:
    """Greedy choice: the most robust first, then far from all chosen and robust."""
    columns = [FULL[name].to_unit(groups[name].to_numpy()) for name in groups]
    columns += [np.log10(physical[name].fillna(1.0)) / 3 for name in SCALES if name in physical]
    points = np.column_stack(columns)
    weight = np.sqrt(margin + 1e-3)
    chosen = [int(np.argmax(margin))]
    away = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < n:
        k = int(np.argmax(away * weight))
        if away[k] <= 1e-12:
            break
        chosen.append(k)
        away = np.minimum(away, np.linalg.norm(points - points[k], axis=1))
    return chosen


def confirm(
    answer: Answer, source, *, corners: int = 8, inside: int = 8, seed: int = 0, executor=None
) -> Answer:
    """The answer with every proposal, and points of its box, labelled by a source.

    At most ``corners`` corners of each box (all where it has no more) and ``inside`` random points
    within; 0 and 0 label the designs alone. ``executor`` serves sources that label one at a time.
    """
    wish, rng = answer.wish, np.random.default_rng(seed)
    if not answer.proposals:
        return replace(answer, source=source.name)
    parameters = box_parameters(wish)
    rows = []
    for p in answer.proposals:
        ends = np.array([[q.to_unit(e) for e in p.box[q.name]] for q in parameters])
        corner = np.array(list(product((0.0, 1.0), repeat=len(parameters))))
        if len(corner) > corners:
            corner = corner[rng.choice(len(corner), corners, replace=False)]
        at = np.vstack([corner, rng.random((inside, len(parameters)))])
        points = ends[:, 0] + at * (ends[:, 1] - ends[:, 0])
        rows.append(pd.DataFrame([{q.name: p.groups[q.name] for q in parameters}]))
        rows.append(
            pd.DataFrame({q.name: q.from_unit(points[:, k]) for k, q in enumerate(parameters)})
        )
    designs = pd.concat(rows, ignore_index=True)
    labels = ask(source, designs[wish.space.names], executor=executor)
    verdicts = [
        _as_wished(wish, label, row)
        for label, row in zip(labels, designs.to_dict("records"), strict=True)
    ]
    each = len(rows[1]) + 1
    out = []
    for i, p in enumerate(answer.proposals):
        box = verdicts[i * each + 1 : (i + 1) * each]
        out.append(
            replace(
                p,
                label=labels[i * each],
                confirmed=verdicts[i * each],
                box_checked=len(box),
                box_held=sum(v is True for v in box),
                box_unknown=sum(v is None for v in box),
            )
        )
    return replace(answer, proposals=tuple(out), source=source.name)


def _as_wished(wish: Wish, label: Label, groups: Mapping[str, float]) -> bool | None:
    if not isinstance(wish.want, Angle):
        return None if label.foldable is None else label.foldable == (wish.want == "foldable")
    angle = label.evidence.get("fold_angle")
    if angle is None and label.evidence.get("normalised_angle") is not None:
        angle = label.evidence["normalised_angle"] * groups["hinge_length"] * groups["contraction"]
    return None if angle is None else bool(abs(angle - wish.want.value) <= wish.want.tolerance)


def rows(answer: Answer) -> list[dict]:
    """The proposals as flat rows for a printed table: groups, probability, margin, verdicts."""
    out = []
    for p in answer.proposals:
        row = {**p.groups, "margin": p.margin}
        if p.probability is not None:
            row["probability"] = p.probability
        if p.angle is not None:
            row["fold_angle"] = p.angle
        if p.mass is not None:
            row["mass_kg"] = p.mass
        if p.label is not None:
            row |= {"confirmed": p.confirmed, "box": f"{p.box_held}/{p.box_checked}"}
        out.append(row)
    return out
