"""The folder of files to make a unit by: what is written, in which order, and what could not be."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import foldlab
from foldlab.design import PHYSICAL
from foldlab.making.drawing import draw, millimetres
from foldlab.making.fold import fold
from foldlab.making.folded import Folded
from foldlab.making.geometry import Geometry
from foldlab.making.vector import pdf, svg
from foldlab.terminal import plain

if TYPE_CHECKING:
    from foldlab.labels.run import Run
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.sized import Sized

# What a reader is told of each file.
FILES = {
    "report.html": "the answer on a page",
    "folded.png": "the unit, flat to folded",
    "drawing.svg": "dimensioned drawing, in layers",
    "drawing.pdf": "the same to print, to scale",
    "cut.dxf": "for the cutter, 1:1 in mm; layers outline, active, strips",
    "flat.step": "flat solids, mm",
    "folded.step": "the solids as the solver bent them, mm",
    "flat-passive.stl": "flat sheet, mm",
    "flat-active.stl": "flat active layer, mm",
    "folded-passive.stl": "folded sheet, mm",
    "folded-active.stl": "folded active layer, mm",
    "unit.fold": "creases, flat and folded (FOLD 1.2)",
    "unit.json": "all quantities in SI units, and the answer",
}
LAYERS = ("passive", "active")
DENSITIES = ("rho_s", "rho_i")
# Kept out of the JSON's answer: it stands beside it, or is of this machine.
ELSEWHERE = ("materials", "physical", "design", "files", "label", "made")


@dataclass(frozen=True, eq=False)
class Dossier:
    """What the files tell of a unit.

    ``answer``: what the solver and the rod said, plain values; ``told``: the same in words, by
    heading; ``run``: the path to the folded shape, None where there is none; ``source``: the solver
    as it was asked; ``picture``: PNG of the folding unit.
    """

    unit: Sized
    answer: Mapping[str, Any]
    told: Mapping[str, str]
    source: SolverSource
    run: Run | None = None
    picture: Path | None = None
    missing: dict[str, str] = field(default_factory=dict)

    @property
    def geometry(self) -> Geometry:
        """The sizes in mm."""
        return Geometry.of(self.unit.physical, self.unit.groups)

    @property
    def masses(self) -> dict[str, float]:
        """Of each layer, kg."""
        volumes = self.geometry.volumes
        density = {"passive": "rho_s", "active": "rho_i"}
        return {
            layer: 1e-9 * volumes[layer] * self.unit.physical[density[layer]] for layer in LAYERS
        }

    @property
    def cost(self) -> tuple[float, float] | None:
        """Low and high price of the material in the unit, where each layer has a price per kg."""
        return self.unit.cost(self.masses)

    @property
    def reached(self) -> float | None:
        """Contraction at which the folded shape is, where that is less than was asked for."""
        if self.run is None or not self.run.history:
            return None
        last = self.run.history[-1]["contraction"]
        return last if last < self.unit.physical["contraction"] * (1 - 1e-6) else None

    @property
    def crossed(self) -> bool:
        """Whether the folded shape's panels pass through each other."""
        if self.run is None or not self.run.shapes or "contact" in self.source.conditions.terms:
            return False
        # The solver's y: along the sheet, from its middle.
        return bool(self.run.shapes[-1].state.curves[0][-1, 1] < 0)

    @property
    def title(self) -> str:
        """Its size in a few words."""
        g = self.geometry
        return f"Self-folding unit, {millimetres(g.length)} mm × {millimetres(g.width)} mm"


def write(folder: Path, dossier: Dossier) -> dict[str, str]:
    """Writes the files of :data:`FILES` into a folder; why each that is missing could not be."""
    from foldlab.making import step, stl
    from foldlab.making.report import folded, html

    unit, missing = dossier.geometry, dossier.missing
    drawing = draw(unit, dossier.title, _notes(dossier))
    (folder / "drawing.svg").write_text(svg(drawing), encoding="utf-8")
    (folder / "drawing.pdf").write_bytes(pdf(drawing))
    _try(folder / "cut.dxf", lambda path: path.write_text(_dxf(unit), encoding="utf-8"), missing)
    for layer in LAYERS:
        content = stl.stl(*stl.flat(unit, layer), layer)
        (folder / f"flat-{layer}.stl").write_bytes(content)
    _try(folder / "flat.step", lambda path: step.write_flat(path, unit), missing)
    middle = None
    if dossier.run is not None and dossier.run.shapes:
        bent = Folded.of(dossier.run, unit.length)
        middle = bent.middle
        for layer in LAYERS:
            content = stl.stl(*bent.surface(layer), layer)
            (folder / f"folded-{layer}.stl").write_bytes(content)
        _try(folder / "folded.step", lambda path: step.write_folded(path, unit, bent), missing)
    else:
        for name in ("folded.step", *(f"folded-{layer}.stl" for layer in LAYERS)):
            missing[name] = "the solver gave no shape"
    picture = folded(dossier)
    if picture is None:
        missing["folded.png"] = "the solver gave no shape"
    else:
        (folder / "folded.png").write_bytes(picture)
    creases = fold(unit, middle, dossier.title)
    (folder / "unit.fold").write_text(json.dumps(creases), encoding="utf-8")
    (folder / "report.html").write_text(html(dossier, drawing, picture), encoding="utf-8")
    text = json.dumps(plain(_facts(dossier)), allow_nan=False, indent=1)
    (folder / "unit.json").write_text(text, encoding="utf-8")
    return missing


def _try(path: Path, write: Callable[[Path], object], missing: dict[str, str]) -> None:
    """Writes a file by a library that may be absent or refuse; what it says is kept."""
    try:
        write(path)
    except ImportError as error:
        missing[path.name] = f"{error}; pip install 'foldlab[make]'"
    except ValueError as error:
        missing[path.name] = str(error)
    if path.name in missing:
        path.unlink(missing_ok=True)


def _dxf(unit: Geometry) -> str:
    from foldlab.making.dxf import dxf

    return dxf(unit)


def _notes(dossier: Dossier) -> list[str]:
    """Two lines for the drawing's title block."""
    names = dossier.unit.materials
    made = [f"{layer}: {names[layer]}" for layer in LAYERS if layer in names]
    contraction = 100 * dossier.unit.physical["contraction"]
    along = "along it" if dossier.source.conditions.growth == "uniaxial" else "in every direction"
    acts = f"The active layer lies on the sheet and contracts by {contraction:.3g} % {along}."
    return [*(["; ".join(made)] if made else []), acts]


def _facts(dossier: Dossier) -> dict[str, Any]:
    """What unit.json holds."""
    unit, geometry = dossier.unit, dossier.geometry
    return {
        "format": "foldlab unit 1",
        "foldlab": foldlab.__version__,
        "units": {**PHYSICAL, "mass": "kg", "angles": "rad", "strains": "1"},
        "physical": dict(unit.physical),
        "strips": geometry.strips,
        "strip_share": geometry.strip_share if geometry.strips else None,
        "groups": dict(unit.groups),
        "materials": dict(unit.materials),
        "ranges": {name: list(ends) for name, ends in unit.ranges.items()},
        "mass": {**dossier.masses, "total": sum(dossier.masses.values())},
        "cost": dossier.cost,
        "contraction_reached": dossier.reached,
        "panels_cross": dossier.crossed,
        "answer": {k: v for k, v in dossier.answer.items() if k not in ELSEWHERE},
        "files": [name for name in FILES if name not in dossier.missing],
        "missing": dict(dossier.missing),
    }
