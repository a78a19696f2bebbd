"""What is said of a unit in millimetres: plain values, and a maker's words and units."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.design import PHYSICAL

if TYPE_CHECKING:
    from foldlab.labels.label import Label
    from foldlab.labels.run import Run
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.check import Change
    from foldlab.unit.sized import Sized

# SI units as a maker reads them, and how many of them make one.
SHOWN = {"m": ("mm", 1e3), "Pa": ("MPa", 1e-6), "kg/m³": ("kg/m³", 1.0), "1": ("", 1.0)}
DEGREES = 57.29577951308232


def beforehand(unit: Sized, source: SolverSource, first: Label | None) -> dict[str, Any]:
    """What is known of a unit before the solver is asked; ``first``: the rod's answer."""
    from foldlab.unit.check import holds, uncertainty

    return {
        "materials": dict(unit.materials),
        "physical": dict(unit.physical),
        "design": dict(unit.groups),
        "rod": None if first is None else {"foldable": first.foldable, "reason": first.reason},
        "over_materials": uncertainty(unit, source),
        "holds": holds(unit, source),
    }


def afterwards(unit: Sized, source: SolverSource, run: Run, label: Label) -> dict[str, Any]:
    """What the solver says of a unit."""
    from foldlab.unit.check import strained
    from foldlab.unit.record import summary

    result = summary(label, run, source)
    kept = (
        "foldable", "fold_angle", "need", "error_m1", "reason", "outcome", "stable", "topples",
        "events", "core_seconds",
    )  # fmt: skip
    return {
        **{name: result[name] for name in kept},
        "confirmed": True,
        "strain": strained(unit, label.evidence),
        "change": None,
    }


def changed(change: Change | None, unit: Sized) -> dict[str, Any] | None:
    """A change of one quantity (SI) that the solver confirmed, and what then comes of the unit."""
    if change is None or change.label is None:
        return None
    return {
        "quantity": change.quantity,
        "from": unit.physical[change.quantity],
        "to": change.value,
        "fold_angle": change.label.evidence["m1"],
        "reason": change.label.reason,
    }


def readable(answer: Mapping[str, Any], unit: Sized) -> dict[str, Any]:
    """The answer in a maker's words and units."""
    error = answer["error_m1"]
    sure = "" if error is None else f" ± {number(float(f'{error * DEGREES:.1g}'))}°"
    angle = f"{degrees(answer['fold_angle'])}{sure}"
    if abs(answer["fold_angle"] or 0.0) > np.pi:
        angle += " (panels meet at about 180° and pass through each other here)"
    held = answer["stable"] and answer["topples"]
    change = answer["change"]
    if change is not None:
        change = (
            f"{change['quantity']} from {shown(change['quantity'], change['from'])} to "
            f"{shown(change['quantity'], change['to'])}: it then folds by "
            f"{degrees(change['fold_angle'])}, by the solver"
        )
    elif answer["foldable"] is False:
        change = "no change of one quantity was confirmed to help"
    else:
        change = "nothing"
    return {
        "folds": yes(answer["foldable"]),
        "angle": f"{angle}, {degrees(answer['need'])} count as folded",
        "why": in_degrees(answer["reason"]),
        "stable": yes(answer["stable"]) + (", held upright" if held else ""),
        "tips over": yes(answer["topples"]),
        "strain": strained_by(answer["strain"]),
        "over the materials": over(answer["over_materials"]),
        "it stays so for": holding(answer["holds"]),
        "to change": change,
        "core_seconds": answer["core_seconds"],
        "files": ", ".join(answer["files"]),
        **({"to make it": answer["made"]["folder"]} if "made" in answer else {}),
    }


def yes(value: bool | None) -> str:
    """Yes, no or unknown."""
    return {True: "yes", False: "no", None: "unknown"}[value]


def degrees(angle: float | None) -> str:
    """An angle (rad) in degrees."""
    # Below a twentieth of a degree lies what no sheet shows.
    return "–" if angle is None else f"{0.0 if abs(angle) < 9e-4 else angle * DEGREES:.3g}°"


def in_degrees(text: str) -> str:
    """A sentence whose angles in rad are told in degrees."""
    return re.sub(r"(-?\d[\d.]*(?:e[-+]?\d+)?) rad\b", lambda a: degrees(float(a[1])), text)


def strained_by(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Peak strains by layer, and what the materials bear: :func:`foldlab.unit.check.strained`."""
    told = []
    for layer, row in rows.items():
        text = f"{layer} {100 * row['peak']:.2g} %"
        if row["says"] is not None:
            low, high = number(100 * row["low"]), number(100 * row["high"])
            text += f" ({row['says']}: its limit is {low} to {high} %)"
        told.append(text)
    return ", ".join(told) or "–"


def over(answer: Mapping[str, Any] | None) -> str:
    """What the ranges of materials leave open: :func:`foldlab.unit.check.uncertainty`."""
    if answer is None:
        return "–"
    names = ", ".join(
        f"{name} {shown(name, low)} to {shown(name, high)}"
        for name, (low, high) in answer["ranges"].items()
    )
    formula = f" ({answer['by_formula']} of them by beam formulas)" if answer["by_formula"] else ""
    return (
        f"{100 * answer['folds']:.0f} % of {answer['draws']} units fold by the rod{formula}, "
        f"90 % of all turn by {degrees(answer['angle_low'])} to "
        f"{degrees(answer['angle_high'])} ({names})"
    )


def holding(answer: Mapping[str, Any] | None) -> str:
    """Within which sizes the verdict stays: :func:`foldlab.unit.check.holds`."""
    if answer is None:
        return "–"
    told = []
    for name, (low, high) in answer.items():
        if low is not None and high is not None:
            told.append(f"{name} {shown(name, low)} to {shown(name, high)}")
        elif low is not None:
            told.append(f"{name} above {shown(name, low)}")
        elif high is not None:
            told.append(f"{name} below {shown(name, high)}")
    return f"{', '.join(told) or 'any change of one quantity'} (each alone, by the rod)"


def shown(name: str, value: float) -> str:
    """A quantity (SI) in the unit of a maker."""
    unit, factor = SHOWN[PHYSICAL[name]]
    if name == "contraction":
        return f"{number(100 * value)} %"
    return f"{number(value * factor)} {unit}"


def number(value: float) -> str:
    """Three digits, and no power of ten where it can be helped."""
    return f"{float(f'{value:.3g}'):g}"
