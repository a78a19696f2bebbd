"""Parts (a) to (c) of accuracy_vs_time: elements and meshes, steppers, quarter and whole model.

Errors are of the fold angle at the full contraction, relative to the angle or to the |g|π that
counts as folded, whichever is larger; seconds are core-seconds of the path alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from foldlab.labels import foldability
from solver.cases.unit import mesh as unit_mesh
from solver.cases.unit import model as folding_unit
from solver.cases.unit import path as unit_path
from solver.cases.unit import problem_p
from solver.cases.unit.choices import Meshing, Supports, Watch
from solver.cases.unit.unit import Unit
from solver.equilibrium.clock import core_seconds
from solver.paths.continuation import trace
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps

COUNTS = foldability.Thresholds()
P = "problem P"
_UNIT = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0, "h_ratio": 5.0,
    "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.2,
}  # fmt: skip
UNITS = {
    "folds": _UNIT | {"stiffness_to_weight": 1.0},
    "near lift-off": _UNIT | {"stiffness_to_weight": 0.05},
    "grounded": _UNIT | {"stiffness_to_weight": 0.02},
}

# One more than the cases have: the reference, and what elements of first order need.
P_LEVELS = (
    *problem_p.LEVELS,
    problem_p.Counts(
        1.25e-4,
        2,
        0.00625,
        (0, 0.25, 0.5, 0.8, 0.95, 0.99, 1),
        (0, 0.005, 0.02, 0.06, 0.2, 0.5, 0.75, 1),
    ),
)
UNIT_LEVELS = (*unit_mesh.LEVELS, unit_mesh.Sizes(0.03125, 2, 0.125, 0.0625, 0.35, 4))
FINEST = len(UNIT_LEVELS) - 1
G = -0.3  # contraction of Problem P


@dataclass(frozen=True, eq=False)
class Solved:
    """One path: its last angle (None if it did not reach the full contraction) and what it cost."""

    angle: float | None
    scale: float
    row: dict[str, Any]
    folding: unit_path.Folding | None = None


def solved(
    scene: str, element: str, level: int, *, whole: bool = False, limit: float = 60.0
) -> Solved:
    """The path of a scene, Problem P or one of :data:`UNITS`, in at most ``limit`` core-seconds."""
    if scene == P:
        return _problem_p(element, level, whole)
    design = UNITS[scene]
    start = time.process_time()
    model = folding_unit.build(
        Unit(**design),
        Meshing(UNIT_LEVELS[level], element),
        supports=Supports(() if whole else ("x", "y")),
        watch=Watch(core_seconds() + limit),
    )
    built = time.process_time()
    folding = unit_path.fold(model)
    seconds = time.process_time() - built
    reached = folding.ending is unit_path.Ending.REACHED
    row = {
        "unknowns": folding.model.scene.size,
        "core_seconds": seconds,
        "build_core_seconds": built - start,
        "iterations": folding.iterations,
        "steps": max(len(folding.states) - 1, 0),
        "outcome": folding.ending.name.lower(),
    }
    angle = _angle(folding, design) if reached else None
    return Solved(angle, COUNTS.angle(design["contraction"]), row, folding)


def _problem_p(element: str, level: int, whole: bool) -> Solved:
    start = time.process_time()
    body = problem_p.mesh(P_LEVELS[level], element, quarter=not whole)
    scene = problem_p.scene(body, G)
    built = time.process_time()
    stepper = LoadSteps(rtol=1e-7, step=1 / 12)
    path = trace(scene, np.zeros(scene.size), stepper, max_steps=400, events=False)
    seconds = time.process_time() - built
    row = {
        "unknowns": scene.size,
        "core_seconds": seconds,
        "build_core_seconds": built - start,
        "iterations": path.iterations,
        "steps": len(path.points) - 1,
        "outcome": path.outcome.name.lower(),
    }
    angle = None
    if path.reached:
        angle = problem_p.fold_angle(scene, path.last.x, path.last.e)
    return Solved(angle, COUNTS.angle(abs(G)), row)


def _angle(folding: unit_path.Folding, design) -> float:
    return foldability.measure(folding.last.curves, design["hinge_length"]).m1


def reference(scene: str, limit: float, level: int = FINEST) -> tuple[float, float]:
    """The angle by hex27 on the finest mesh, and how far the next coarser one is from it.

    Of a unit only the last state is computed there, from the path on the coarser mesh; the path is
    followed where that state lies elsewhere. Raises RuntimeError where there is none.
    """
    coarser = solved(scene, "hex27", level - 1, limit=limit)
    fine = None
    if coarser.folding is not None and coarser.angle is not None:
        refined = unit_path.refined(coarser.folding, UNIT_LEVELS[level])
        fine = None if refined is None else _angle(refined, UNITS[scene])
    if fine is None:
        fine = solved(scene, "hex27", level, limit=4 * limit).angle
    if fine is None or coarser.angle is None:
        raise RuntimeError(f"{scene}: no reference on level {level}; give it more time")
    return fine, abs(fine - coarser.angle) / max(abs(fine), coarser.scale)


def elements(config, say: Callable[[dict], None]) -> tuple[list[dict], list[dict]]:
    """(a): a row per scene, element and mesh, and the references."""
    rows, references = [], []
    for element in config.elements:
        solved(P, element, 0)  # compiles, or loads what was compiled
    for scene in config.scenes:
        exact, doubt = reference(scene, config.limit, config.reference)
        references.append({"scene": scene, "angle": exact, "changed_from_coarser": doubt})
        for element in config.elements:
            first_order = element in ("tet4", "hex8")
            for level in config.first_order_levels if first_order else config.levels:
                made = solved(scene, element, level, limit=config.limit)
                row = {"scene": scene, "element": element, "level": level, "angle": made.angle}
                row["error"] = _error(made.angle, exact, made.scale)
                say(row | made.row)
                rows.append(row | made.row)
    return rows, references


def _error(angle: float | None, exact: float, scale: float) -> float | None:
    return None if angle is None else abs(angle - exact) / max(abs(exact), scale)


def steppers(config, say: Callable[[dict], None]) -> list[dict]:
    """(b): load steps and arc length by step and tolerance, on one mesh of each scene.

    ``end_error``: of the last angle, against rtol 1e-12 on the same mesh. ``error``: of the angle
    between the points, drawn as straight lines over the load: the largest one, against steps half
    as long as the shortest. Both are what the stepper adds to the mesh's error.
    """
    rows = []
    loads = np.linspace(0, 1, 401)
    for name in config.stepper_scenes:
        scene, start, angle, size = _stepping(name, config.stepper_level)

        def curve(path, angle=angle):
            return np.interp(loads, path.loads, [angle(p.x, p.e) for p in path.points])

        finest = LoadSteps(rtol=1e-12, step=0.5 / max(config.steps))
        path = trace(scene, start, finest, max_steps=2000, events=False)
        if not path.reached:
            raise RuntimeError(f"{name}: {path.outcome.value}; take another scene for part b")
        exact, scale = curve(path), abs(angle(path.last.x, 1.0))
        for kind in ("load steps", "load steps, no predictor", "arc length"):
            for steps in config.steps:
                for rtol in config.rtols:
                    if kind == "arc length":
                        stepper = ArcLength(rtol=rtol, a=size / steps, b=1 / steps, largest=1.0)
                    else:
                        order = 0 if kind.endswith("no predictor") else 3
                        stepper = LoadSteps(rtol=rtol, step=1 / steps, order=order)
                    begun = time.process_time()
                    path = trace(scene, start, stepper, max_steps=300, events=False)
                    seconds = time.process_time() - begun
                    off = np.abs(curve(path) - exact) / scale if path.reached else None
                    row = {
                        "scene": name, "stepper": kind, "steps_asked": steps, "rtol": rtol,
                        "error": None if off is None else float(off.max()),
                        "end_error": None if off is None else float(off[-1]),
                        "core_seconds": seconds, "iterations": path.iterations,
                        "steps": len(path.points) - 1, "outcome": path.outcome.name.lower(),
                    }  # fmt: skip
                    say(row)
                    rows.append(row)
    return rows


def _stepping(name: str, level: int):
    """A scene, a start at rest, the angle of a state, and about how far the body moves (rms)."""
    if name == P:
        scene = problem_p.scene(problem_p.mesh(P_LEVELS[level]), G)
        return scene, np.zeros(scene.size), _turning(scene), 0.3
    design = UNITS[name]
    model = folding_unit.build(Unit(**design), Meshing(UNIT_LEVELS[level]))
    scene = model.scene
    rest = StableSteps(LoadSteps(rtol=1e-8, step=0.1), locate=False).begin(
        scene, np.zeros(scene.size), 0.0, 1.0
    )

    def angle(x, e):
        return foldability.measure(model.curves(x, e), design["hinge_length"]).m1

    return scene, rest.x, angle, 0.3


def _turning(scene) -> Callable[[np.ndarray, float], float]:
    def angle(x, e):
        # The angle is known up to full turns; the flat sheet's may be a hair below 0.
        angle = problem_p.fold_angle(scene, x, e)
        return angle - 2 * np.pi if angle > 6.2 and e < 0.5 else angle

    return angle


def wholes(config, say: Callable[[dict], None]) -> list[dict]:
    """(c): a quarter against the whole on the same elements: seconds and agreement."""
    rows = []
    for scene in config.scenes:
        for level in config.whole_levels:
            parts = [solved(scene, "hex27", level, whole=w, limit=config.limit) for w in (0, 1)]
            for kind, made in zip(("quarter", "whole"), parts, strict=True):
                row = {"scene": scene, "level": level, "model": kind, "angle": made.angle}
                row |= made.row
                row["apart"] = row["ratio"] = None
                if kind == "whole":
                    row["ratio"] = row["core_seconds"] / parts[0].row["core_seconds"]
                    if parts[0].angle is not None:
                        row["apart"] = _error(made.angle, parts[0].angle, made.scale)
                say(row)
                rows.append(row)
    return rows
