"""Will my unit fold, how sure is that, and what is the least that I must change?

A rod answers first, in milliseconds; the solver confirms. What the ranges of materials leave open,
how far each quantity may go and which change would help is scanned with the rod, and of the changes
the smallest that the solver confirms is told.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.label import Label
from foldlab.labels.rod import RodSource
from foldlab.labels.solver import SolverSource
from foldlab.unit.sized import Sized

DRAWS = 200  # units that the ranges of materials are drawn for
# What a maker can change in the unit without another material, and factors that are tried.
CHANGEABLE = ("h_i", "h_s", "l_i", "l_s", "contraction")
FACTORS = np.geomspace(1.05, 10.0, 48)
# A change that the rod is to find must pass the threshold by this, in which its own error lies.
ROOM = 0.1
ATTEMPTS = 4  # labels that confirming a change may cost
LARGEST_CONTRACTION = 0.5


@dataclass(frozen=True)
class Change:
    """One quantity to ``value`` (SI), ``factor`` times what it is; ``label``: the solver's."""

    quantity: str
    value: float
    factor: float
    label: Label | None = None


def by_rod(unit: Sized, source: SolverSource) -> Label | None:
    """The rod's answer; None where the rod can't feel what the source is asked for."""
    rod = _rod(source)
    return None if rod is None else _labels(rod, [unit.groups])[0]


def uncertainty(unit: Sized, source: SolverSource, draws: int = DRAWS) -> dict[str, Any] | None:
    """What the materials' ranges leave open: fraction of units that fold by the rod, and the angle
    (rad) that 5 and 95 % of them stay below. None without ranges or without a rod.

    Units that the rod does not know, as with an active layer a thousand times softer than the
    sheet, are judged by beam formulas (:mod:`foldlab.labels.beam`); ``by_formula``: how many.
    """
    rod = _rod(source)
    if not unit.ranges or rod is None:
        return None
    drawn = unit.drawn(draws)
    labels = _labels(replace(rod, sure=False), drawn.to_dict("records"))
    known = np.array([bool(label and label.foldable is not None) for label in labels])
    folds = np.array([bool(label and label.foldable) for label in labels])
    angles = np.array(
        [label.evidence["m1"] if ok else 0.0 for label, ok in zip(labels, known, strict=True)]
    )
    if not known.all():
        rest = drawn[~known]
        c = rest["contraction"].to_numpy()
        angles[~known] = beam.formulas(rest)["net"].to_numpy() * np.pi * c
        folds[~known] = angles[~known] > source.thresholds.angle(c)
    # Formulas know no ground, and a rod's last step may pass the full turn at which a fold ends.
    low, high = np.quantile(angles.clip(-np.pi, 2 * np.pi), [0.05, 0.95])
    return {
        "draws": draws,
        "by_formula": int((~known).sum()),
        "folds": float(folds.mean()),
        "angle_low": float(low),
        "angle_high": float(high),
        "ranges": {name: list(ends) for name, ends in unit.ranges.items()},
    }


def holds(unit: Sized, source: SolverSource) -> dict[str, list[float | None]] | None:
    """Per quantity, alone, the SI values between which the rod's verdict stays; None: no end within
    a factor of 10. None where there is no rod."""
    first = by_rod(unit, source)
    if first is None or first.foldable is None:
        return None
    out = {}
    for name in CHANGEABLE:
        ends: list[float | None] = []
        for factors in (1 / FACTORS, FACTORS):
            rows = _scanned(unit, source, name, factors)
            other = [f for f, label in rows if label.foldable is not first.foldable]
            ends.append(float(unit.physical[name] * other[0]) if other else None)
        out[name] = ends
    return out


def changes(unit: Sized, source: SolverSource) -> list[Change]:
    """Of each quantity alone the smallest change with which the rod folds; smallest first."""
    out = []
    for name in CHANGEABLE:
        for factors in (1 / FACTORS, FACTORS):
            for factor, label in _scanned(unit, source, name, factors):
                if label.foldable and label.evidence["margin"] > ROOM:
                    out.append(Change(name, unit.physical[name] * factor, float(factor)))
                    break
    return sorted(out, key=lambda c: abs(np.log(c.factor)))


def confirmed(unit: Sized, source: SolverSource, attempts: int = ATTEMPTS) -> Change | None:
    """The smallest change that folds by the solver; None where none of ``attempts`` labels did."""
    for change in changes(unit, source)[:attempts]:
        label = source.label(unit.changed(**{change.quantity: change.value}).groups)
        if label.foldable:
            return replace(change, label=label)
    return None


def _rod(source: SolverSource) -> RodSource | None:
    if source.patterned:
        return None  # it knows a solid layer only
    try:
        return RodSource(source.conditions, thresholds=source.thresholds)
    except InputError:
        return None


def _labels(rod: RodSource, designs: Sequence[Mapping[str, float]]) -> list[Label | None]:
    """The rod's labels; None for designs beyond what it knows."""
    out: list[Label | None] = []
    for design in designs:
        try:
            out.append(rod.label(design))
        except InputError:
            out.append(None)
    return out


def _scanned(unit: Sized, source: SolverSource, name: str, factors) -> list[tuple[float, Label]]:
    """The rod's labels of units with ``name`` multiplied, as far as there are units."""
    rod, kept, groups = _rod(source), [], []
    if rod is None:
        return []
    for factor in factors:
        value = unit.physical[name] * factor
        if name == "contraction" and value > LARGEST_CONTRACTION:
            break
        try:
            groups.append(unit.changed(**{name: value}).groups)
        except InputError:
            break
        kept.append(float(factor))
    rows = zip(kept, _labels(rod, groups), strict=True)
    return [(factor, label) for factor, label in rows if label is not None]


def strained(unit: Sized, evidence: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Per layer its peak strain, the range that its material bears, and whether it does: "bears
    it", "may break" or "breaks"; None where nothing is known of the material."""
    errors = evidence.get("peak_errors") or {}
    out = {}
    for layer, peak in (evidence.get("strain") or {}).items():
        error = (errors.get("strain") or {}).get(layer, 0.3)
        low, high = unit.strain.get(layer, (None, None))
        says = None
        if low is not None and high is not None:
            says = "bears it" if peak * (1 + error) < low else "may break"
            says = "breaks" if peak * (1 - error) > high else says
        out[layer] = {"peak": peak, "error": error, "low": low, "high": high, "says": says}
    return out
