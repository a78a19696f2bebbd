"""Does a structure fold: each hinge, why not, and how sure that is.

A hinge folds where it turns to its own side by more than π times its contraction, or by ``need``.
Why one does not is told by what happens without weight and without contact: the same path with
effects left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.labels.foldability import Thresholds

if TYPE_CHECKING:
    from solver.cases.structure.parts import Structure
    from solver.cases.structure.path import Folding

SAG = 0.05  # rad that a panel's far edge may sag by, clamped at its hinge, and still pass as rigid
AGAIN = 0.05  # of the natural angle, by which a hinge must turn further without an effect


@dataclass(frozen=True, eq=False)
class Answer:
    """``foldable``: None where the path came to no end; ``hinges``: of each its ends, angle (rad),
    natural angle, whether it folds and why not; ``evidence``: numbers of the whole."""

    foldable: bool | None
    reason: str
    hinges: list[dict[str, Any]]
    folding: Folding = field(repr=False)
    evidence: dict[str, Any] = field(default_factory=dict)


def answer(
    structure: Structure,
    effects: Sequence[str] = ("gravity", "ground", "contact"),
    *,
    need: float | None = None,
    upright: bool = False,
    timeout: float = 60.0,
    turn: float = 0.25,
    tell: Callable[[str], None] = lambda text: None,
) -> Answer:
    """Follow a structure's path and judge it.

    ``need``: rad that count as folded; ``upright``: held against toppling; ``timeout``:
    core-seconds of each path. Raises ValueError for effects that are none, and a structure that
    hangs together with nothing.
    """
    from solver.cases.structure.model import build
    from solver.cases.structure.path import Ending, fold
    from solver.equilibrium.clock import core_seconds, one_core

    def path(effects):
        start = core_seconds()
        model = build(structure, effects, upright=upright, deadline=start + timeout)
        tell(f"{len(structure.pattern.panels)} panels, {model.scene.size} unknowns")
        return fold(model, turn=turn), core_seconds() - start

    with one_core():
        folding, spent = path(effects)
        angles = folding.last.angles if folding.states else np.zeros(len(structure.laws))
        hinges = _hinges(structure, angles, need)
        ended = folding.ending is Ending.REACHED
        fails = [h for h in hinges if h["folds"] is False]
        if ended and fails:
            spent += _explain(structure, effects, hinges, path)
    evidence = _evidence(structure, folding, spent)
    foldable, reason = _verdict(folding, ended, hinges, fails, evidence)
    return Answer(foldable, reason, hinges, folding, evidence)


def _hinges(structure: Structure, angles: np.ndarray, need: float | None) -> list[dict[str, Any]]:
    out = []
    thresholds = Thresholds(need=need)
    for k, (hinge, layer, law) in enumerate(
        zip(structure.pattern.hinges, structure.layers, structure.laws, strict=True)
    ):
        fold = hinge.crease.fold
        row = {
            "ends": list(hinge.crease.ends),
            "fold": {1: "valley", -1: "mountain", 0: "free"}[fold],
            "angle": float(angles[k]),
            "natural": fold * float(law.angle[-1]),
            "error": None if layer is None else law.error,
            "folds": None,
            "why": "",
        }
        if fold:
            row["need"] = float(thresholds.angle(layer.contraction))
            row["folds"] = bool(fold * angles[k] > row["need"])
        out.append(row)
    return out


def _explain(structure: Structure, effects, hinges: list[dict[str, Any]], path) -> float:
    """Why hinges don't fold, by the same path with effects left out; core-seconds."""
    spent, left = 0.0, list(effects)
    known: list[tuple[str, np.ndarray]] = []
    ladder = [("contact", "panels touch before it has folded")] if "contact" in left else []
    if "gravity" in left:
        ladder.append(("gravity", "its panels are too heavy for it"))
    for effect, why in ladder:
        left = [name for name in left if name != effect and (effect, name) != ("gravity", "ground")]
        other, more = path(tuple(left))
        spent += more
        if other.states and other.last.e >= 1.0:
            known.append((why, other.last.angles))
    for k, row in enumerate(hinges):
        if row["folds"] is not False:
            continue
        sign = 1 if row["natural"] >= 0 else -1
        if sign * row["natural"] <= row["need"]:
            row["why"] = "its layer would not bend it far enough even if it were alone"
            continue
        before = row["angle"]
        row["why"] = "the other hinges around its panels hold it back"
        for why, angles in known:
            if sign * (angles[k] - before) > AGAIN * abs(row["natural"]):
                row["why"] = why
                break
            before = angles[k]
    return spent


def _evidence(structure: Structure, folding: Folding, spent: float) -> dict[str, Any]:
    panels, heavy = len(structure.pattern.panels), folding.model.ground is not None
    out: dict[str, Any] = {
        "outcome": folding.ending.name.lower(),
        "core_seconds": spent,
        "panels": panels,
        "unknowns": folding.model.scene.size,
        "states": len(folding.states),
        "iterations": folding.iterations,
        "effects": list(folding.model.effects),
        "mass": float(folding.model.parts.mass.sum()),
        "panel_sag": max(map(structure.sag, range(panels))) if heavy else 0.0,
        "events": [vars(h) | {"e": float(h.e)} for h in folding.happenings],
    }
    if folding.states:
        last = folding.last
        out |= {
            "contraction_reached": float(last.e),
            "stable": None if last.unstable is None else last.unstable == 0,
            "unstable_modes": last.unstable,
            "clearance": last.clearance,
            "touching": bool(last.clearance is not None and np.isfinite(last.clearance)),
            "lowest": last.lowest,
            "centre_of_mass": last.centre.tolist(),
            "strain": strain(structure, last.angles),
        }
    return out


def strain(structure: Structure, angles: np.ndarray) -> dict[str, float]:
    """Largest strain of the sheet and largest elastic strain of active layers, as fractions, with
    each hinge bent evenly to its angle (hinges,): at the layers' faces, by magnitude."""
    sheet, passive, active = structure.sheet, 0.0, 0.0
    for hinge, layer, law, angle in zip(
        structure.pattern.hinges, structure.layers, structure.laws, angles, strict=True
    ):
        fold = hinge.crease.fold
        curvature = abs(angle) if not fold else fold * angle
        curvature /= hinge.crease.length
        middle = float(law.stretch[-1])
        z = np.array([-sheet.h / 2, sheet.h / 2])
        passive = max(passive, float(np.abs(middle - curvature * z - 1).max()))
        if layer is not None:
            z = np.array([sheet.h / 2, sheet.h / 2 + layer.h])
            stretch = (middle - curvature * z) / (1 - layer.contraction)
            active = max(active, float(np.abs(stretch - 1).max()))
    return {"passive": passive, "active": active}


def _verdict(folding: Folding, ended: bool, hinges, fails, evidence) -> tuple[bool | None, str]:
    if not ended:
        reached = f" (reached e = {evidence['contraction_reached']:.3f})" if folding.states else ""
        return None, f"unknown: {folding.detail}{reached}"
    driven = [h for h in hinges if h["folds"] is not None]
    errors = [h["error"] for h in driven]
    sure = ", by sections alone, whose error is not known"
    if None not in errors:
        sure = f", angles of single hinges to {100 * max(errors):.2g} %"
    sag = evidence["panel_sag"]
    told = f"panels would sag by {sag:.2g} rad under their weight, which rigid ones don't"
    if not fails and sag > SAG:
        return None, f"unknown: rigid panels fold at all {len(driven)} hinges, but {told}"
    if not fails:
        return True, f"all {len(driven)} hinges fold{sure}"
    sure += f"; {told}" if sag > SAG else ""
    causes: dict[str, int] = {}
    for h in fails:
        causes[h["why"]] = causes.get(h["why"], 0) + 1
    told = "; ".join(f"{n} as {why}" for why, n in causes.items())
    return False, f"{len(fails)} of {len(driven)} hinges don't fold: {told}{sure}"
