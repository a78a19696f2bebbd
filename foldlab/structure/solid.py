"""What the full solid says of a structure that the fast level has folded.

On two meshes: the angles are the finer one's, and the two's difference is stated as their error.
Panels sag, twist and curl here, and touch each other a thickness apart; what a hinge touches is
left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.labels.foldability import Thresholds

if TYPE_CHECKING:
    from solver.cases.structure.parts import Structure
    from solver.cases.structure.path import Folding


@dataclass(frozen=True, eq=False)
class Solid:
    """``foldable``: None where the finer path came to no end, or the error leaves a hinge open.

    ``angles`` (hinges,), rad, at the full contraction, or where panels met on the way and no state
    near by goes on from there, at ``contraction`` of it; ``error`` (hinges,), None where the
    coarser path came to no end; ``unknowns`` of the finer mesh; ``core_seconds`` of both.
    """

    foldable: bool | None
    reason: str
    angles: np.ndarray | None
    error: np.ndarray | None
    contraction: float
    unknowns: int
    core_seconds: float
    folding: Folding = field(repr=False)

    def row(self) -> dict[str, Any]:
        """Plain values for ``--json``."""
        return {
            "foldable": self.foldable,
            "reason": self.reason,
            "angles": None if self.angles is None else self.angles.tolist(),
            "error": None if self.error is None else self.error.tolist(),
            "contraction_reached": self.contraction,
            "unknowns": self.unknowns,
            "core_seconds": self.core_seconds,
        }


def solid(
    structure: Structure,
    effects: Sequence[str] = ("gravity", "ground", "contact"),
    *,
    need: float | None = None,
    upright: bool = False,
    level: int = 1,
    timeout: float = 120.0,
    tell: Callable[[str], None] = lambda text: None,
) -> Solid:
    """Follow the solid's path on the meshes ``level`` − 1 and ``level``, and judge it.

    ``need``, ``upright`` as :func:`foldlab.structure.answer.answer`; ``timeout``: core-seconds of
    each path. Raises ImportError without Gmsh, ValueError for a level with none below it.
    """
    from solver.cases.structure.path import Ending, fold
    from solver.cases.structure.sheet import LEVELS
    from solver.cases.structure.solid import build
    from solver.equilibrium.clock import core_seconds, one_core

    if level not in range(1, len(LEVELS)):
        raise ValueError(f"level {level}; expected 1 to {len(LEVELS) - 1}, one above the coarsest")
    begun, ends, answers = core_seconds(), [], (Ending.REACHED, Ending.STOPPED)
    with one_core():
        for own in (level - 1, level):
            model = build(
                structure, effects, level=own, upright=upright, deadline=core_seconds() + timeout
            )
            tell(f"solid: {model.scene.size} unknowns")
            folding = fold(model, meet=False)
            ends.append(folding.last.angles if folding.ending in answers else None)
    spent = core_seconds() - begun
    coarse, angles = ends
    error = None if coarse is None or angles is None else np.abs(angles - coarse)
    if angles is None:
        foldable, reason = None, f"unknown: {folding.detail}"
    else:
        foldable, reason = _verdict(structure, angles, error, need)
        if folding.ending is Ending.STOPPED:
            reason += f", when panels meet at {100 * folding.last.e:.3g} % of the contraction"
            if foldable is False:
                # They may yet slide on.
                foldable, reason = None, f"unknown: {reason}, and what they do then isn't followed"
    reached = folding.last.e if folding.states else 0.0
    size = folding.model.scene.size
    return Solid(foldable, reason, angles, error, reached, size, spent, folding)


def _verdict(structure: Structure, angles, error, need: float | None) -> tuple[bool | None, str]:
    thresholds, spare = Thresholds(need=need), []
    for k, (hinge, layer) in enumerate(
        zip(structure.pattern.hinges, structure.layers, strict=True)
    ):
        if hinge.crease.fold:
            room = hinge.crease.fold * angles[k] - thresholds.angle(layer.contraction)
            spare.append((float(room), 0.0 if error is None else float(error[k])))
    worst = min(room for room, _ in spare)
    fails = sum(room < -off for room, off in spare)
    unsure = sum(abs(room) <= off for room, off in spare)
    told = f"least room {np.degrees(worst):.3g}°"
    if fails:
        return False, f"{fails} of {len(spare)} hinges don't fold; {told}"
    if unsure or error is None:
        why = "on a coarser mesh the path came to no end" if error is None else (
            f"{unsure} of {len(spare)} hinges are nearer to what is asked than their error"
        )  # fmt: skip
        return None, f"unknown: {why}; {told}"
    return True, f"all {len(spare)} hinges fold; {told}"


def import_gmsh() -> None:
    """Raises ImportError, saying what to install, where solids can't be meshed."""
    from solver.mesh.gmsh_import import load_gmsh

    load_gmsh()


def save_solid(folding: Folding, path: Path) -> None:
    """Writes the last state of a solid's path as .vtu, in the pattern's unit."""
    from solver.mesh.body import Body
    from solver.output import write_vtu

    model, e = folding.model, folding.last.e
    extent = model.structure.pattern.extent
    body = Body.build(model.body.mesh.scaled(extent), model.body.element)
    write_vtu(path, body, extent * model.scene.displacement(folding.x, e), load=e)
