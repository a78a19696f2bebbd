"""VTU files and PVD series that ParaView and PyVista open; second-order cells stay second-order.

Positions are those of the reference state; the point field "displacement" warps them. Every
sub-domain's number is in the cell field "layer", their names in the field data "layer_names". A
state of a series has its load e in the field data "load".
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from solver.given import number
from solver.mesh.body import ELEMENTS, Body
from solver.mesh.checks import determinants, orientation
from solver.mesh.vtk import vtk_silenced
from solver.physics.elastic import Elastic

if TYPE_CHECKING:
    from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid

# VTK is imported where it is used: fields are also computed where nothing is written, and it
# holds 40 MB.
CELLS = {
    "hex27": "vtkTriQuadraticHexahedron",
    "hex20": "vtkQuadraticHexahedron",
    "hex8": "vtkHexahedron",
    "tet10": "vtkQuadraticTetra",
    "tet4": "vtkTetra",
}


def cell_fields(
    body: Body, u: np.ndarray, terms: Iterable[object], e: float
) -> dict[str, np.ndarray]:
    """Fields at the quadrature points from the Elastic terms among ``terms``, for ``write_vtu``.

    "F" (m, q, 3, 3); "cauchy" = J⁻¹ P Fᵀ (m, q, 3, 3) and "P" = ∂(Jg ψ)/∂F (m, q, 3, 3), in the
    material's stress; "growth" = Fg (m, q, 3, 3); "energy density" = Jg ψ(Fe) per reference volume
    (m, q). Stress and energy of terms on the same cells add; growth is the last such term's. Of
    viscous terms take those of the step (:func:`solver.viscous.evolution.stepped`). Raises
    ValueError if there is no Elastic term, for a u of another shape, and for a state that a
    material does not admit.
    """
    elastic = [t for t in terms if isinstance(t, Elastic)]
    if not elastic:
        raise ValueError("no Elastic term, so there is no stress to write; leave the fields out")
    m, q = shape = body.weights.shape
    F = np.eye(3) + np.einsum("mki,mqkj->mqij", _displacement(body, u)[body.cells], body.gradients)
    stress, nominal, density = np.zeros_like(F), np.zeros_like(F), np.zeros(shape)
    growth = np.tile(np.eye(3), (m, q, 1, 1))
    for term in elastic:
        ids = term.ids
        Fe, inverse, volume = F[ids], np.eye(3), np.ones((1, 1))
        if term.growth is not None:
            inverse, volume = term.growth.evaluate(e, shape, body.points)
            inverse = inverse[ids] if len(inverse) > 1 else inverse
            volume = volume[ids] if len(volume) > 1 else volume
            Fe = Fe @ inverse
            growth[ids] = np.linalg.inv(inverse)
        elif hasattr(term, "grown"):
            growth[ids] = term.grown(u, e)[ids]
        table = term.material.properties(e, shape, body.points)
        table = table[ids] if len(table) > 1 else table
        psi, P = np.empty((len(ids), q)), np.empty((len(ids), q, 3, 3))
        Fe = np.ascontiguousarray(Fe)
        none = np.empty((1, q, 3, 3, 3, 3))
        if not term.material.kernel(Fe, table, 1, psi, P, none):
            raise ValueError(
                f"term {term.name!r} does not admit this state (a point is turned inside out); "
                "write a converged one"
            )
        # J⁻¹ P Fᵀ with P = Jg Pe Fg⁻ᵀ is Je⁻¹ Pe Feᵀ.
        stress[ids] += P @ np.swapaxes(Fe, 2, 3) / np.linalg.det(Fe)[..., None, None]
        nominal[ids] += volume[..., None, None] * P @ np.swapaxes(inverse, -1, -2)
        density[ids] += volume * psi
    return {"F": F, "cauchy": stress, "P": nominal, "growth": growth, "energy density": density}


def grid(
    body: Body,
    u: np.ndarray | None = None,
    *,
    point_data: Mapping[str, np.ndarray] | None = None,
    cell_data: Mapping[str, np.ndarray] | None = None,
    load: float | None = None,
) -> vtkUnstructuredGrid:
    """VTK grid of a body in its reference state; ``pyvista.wrap`` makes a PyVista grid of it.

    ``u`` (n, 3): the point field "displacement", the unit of length of the nodes. ``point_data``
    (n, ...) at the nodes; ``cell_data`` (m, ...) per cell, or (m, q, ...) at the quadrature points,
    of which the mean by volume is taken; ``load``: the field data of this name. Raises ValueError
    for fields of other shapes.
    """
    from vtkmodules import vtkCommonDataModel
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints, vtkStringArray

    out = vtkCommonDataModel.vtkUnstructuredGrid()
    points = vtkPoints()
    points.SetData(numpy_to_vtk(body.nodes, deep=True))
    out.SetPoints(points)
    cell = getattr(vtkCommonDataModel, CELLS[body.element])()
    cells = vtkCommonDataModel.vtkCellArray()
    m, k = body.cells.shape
    cells.SetData(
        numpy_to_vtkIdTypeArray(np.arange(0, k * m + 1, k, dtype=np.int64), deep=True),
        numpy_to_vtkIdTypeArray(_ordered(body, cell).astype(np.int64).ravel(), deep=True),
    )
    out.SetCells(cell.GetCellType(), cells)
    n = len(body.nodes)
    at_points = dict(point_data or {})
    if u is not None:
        at_points = {"displacement": _displacement(body, u), **at_points}
    for name, values in at_points.items():
        values = _field(name, values)
        if values.shape[:1] != (n,):
            raise ValueError(
                f"point field {name!r} has shape {values.shape}; expected ({n}, …): one per node"
            )
        _add(out.GetPointData(), name, values)
    number, names = _layers(body)
    at_cells = {**number, **(cell_data or {})}
    for name, values in at_cells.items():
        _add(out.GetCellData(), name, _per_cell(body, name, _field(name, values)))
    if names:
        table = vtkStringArray()
        table.SetName("layer_names")
        for name in names:
            table.InsertNextValue(name)
        out.GetFieldData().AddArray(table)
    if load is not None:
        _add(out.GetFieldData(), "load", np.array([float(load)]))
    return out


def write_vtu(
    path: str | Path,
    body: Body,
    u: np.ndarray | None = None,
    *,
    point_data: Mapping[str, np.ndarray] | None = None,
    cell_data: Mapping[str, np.ndarray] | None = None,
    load: float | None = None,
) -> Path:
    """Writes what :func:`grid` makes as a compressed .vtu, all of it or nothing.

    Raises ValueError for another suffix, a missing folder, or fields that don't fit, and OSError
    if the file can't be written.
    """
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    path = Path(path)
    if path.suffix != ".vtu":
        raise ValueError(f"{path.name}: expected a name that ends in .vtu")
    if not path.parent.is_dir():
        raise ValueError(f"there is no folder {path.parent}; make it first")
    data = grid(body, u, point_data=point_data, cell_data=cell_data, load=load)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(draft))
    writer.SetInputData(data)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetCompressorTypeToZLib()
    try:
        with vtk_silenced() as complaint:
            written = writer.Write() == 1 and not complaint()
        if not written:
            raise OSError(f"VTK could not write {path}; is there space and leave to write?")
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)
    return path


class Series:
    """A PVD series: states in the order of a path, one .vtu each, beside the .pvd.

    Its times grow from state to state, steps or lengths along the path, since the load may return
    or stay where the state snaps; each state's load is in its field data and in the .pvd. Whatever
    dies, the .pvd names only files that are whole. With ``resume`` the states in an
    existing .pvd stay, and writing goes on after them; without it they are replaced.
    """

    def __init__(self, path: str | Path, body: Body, *, resume: bool = False):
        """Raises ValueError for another suffix, a missing folder, or a .pvd that can't be read."""
        self.path, self.body = Path(path), body
        if self.path.suffix != ".pvd":
            raise ValueError(f"{self.path.name}: expected a name that ends in .pvd")
        if not self.path.parent.is_dir():
            raise ValueError(f"there is no folder {self.path.parent}; make it first")
        # (time, load, file) of each state
        self._states: list[tuple[float, float, str]] = []
        if resume and self.path.exists():
            try:
                entries = [d.attrib for d in ET.parse(self.path).getroot().iter("DataSet")]
                # Series of earlier versions have no loads: their times were loads.
                self._states = [
                    (float(a["timestep"]), float(a.get("load", a["timestep"])), a["file"])
                    for a in entries
                ]
                if not all(a < b for a, b in pairwise([-np.inf, *self.times, np.inf])):
                    raise ValueError("its times do not grow")
            except (ET.ParseError, KeyError, ValueError) as error:
                raise ValueError(f"{self.path} is no PVD series: {error}; move it away") from error

    @property
    def loads(self) -> list[float]:
        """The loads e written so far, in the order of the path."""
        return [e for _, e, _ in self._states]

    @property
    def times(self) -> list[float]:
        """The times of the states, growing."""
        return [time for time, _, _ in self._states]

    def write(
        self,
        e: float,
        u: np.ndarray,
        *,
        time: float | None = None,
        point_data: Mapping[str, np.ndarray] | None = None,
        cell_data: Mapping[str, np.ndarray] | None = None,
    ) -> Path:
        """Adds the state at the load e after those that are there.

        ``time``: the length along the path, or seconds; by default the next whole number, a step. A
        state that is there at this time is replaced. Returns the .vtu's path; raises what
        :func:`write_vtu` raises, and ValueError for a time before the last.
        """
        e, last = number("e", e), self._states[-1][0] if self._states else -np.inf
        if time is None:
            time = max(np.floor(last) + 1, 0.0)
        time = number("time", time)
        known = {t: name for t, _, name in self._states}
        if not (time > last or time in known):
            raise ValueError(f"time {time:g} after {last:g}; give steps or lengths that grow")
        taken = set(known.values())
        count = len(self._states)
        name = known.get(time)
        while name is None:
            name = f"{self.path.stem}_{count:05d}.vtu"
            if name in taken:
                name, count = None, count + 1
        path = self.path.with_name(name)
        write_vtu(path, self.body, u, point_data=point_data, cell_data=cell_data, load=e)
        kept = [state for state in self._states if state[0] != time]
        self._states = sorted([*kept, (float(time), float(e), name)])
        self._index()
        return path

    def _index(self) -> None:
        root = ET.Element("VTKFile", type="Collection", version="0.1")
        collection = ET.SubElement(root, "Collection")
        for time, e, name in self._states:
            ET.SubElement(
                collection, "DataSet", timestep=repr(time), part="0", load=repr(e), file=name
            )
        ET.indent(root)
        draft = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        try:
            ET.ElementTree(root).write(draft, encoding="utf-8", xml_declaration=True)
            os.replace(draft, self.path)
        finally:
            draft.unlink(missing_ok=True)


def _ordered(body: Body, cell) -> np.ndarray:
    """Cells with their nodes in VTK's order, mirrored ones turned right side out."""
    k = body.cells.shape[1]
    places = np.array(cell.GetParametricCoords()).reshape(-1, 3)[:k]
    mine = ELEMENTS[body.element][0]().doflocs
    # Mirrored: x turned round in hexahedra, x and y swapped in tetrahedra.
    hexes = body.element.startswith("hex")
    turned = np.abs(places - (1, 0, 0)) if hexes else places[:, [1, 0, 2]]
    orders = []
    for wanted in (places, turned):
        gap = np.linalg.norm(wanted[:, None] - mine, axis=2)
        orders.append(np.argmin(gap, axis=1))
    centre = body.mesh.elem.refdom.p.mean(axis=1)[:, None]
    mirrored = orientation(determinants(body.mesh, centre)[1]) < 0
    return np.where(mirrored[:, None], body.cells[:, orders[1]], body.cells[:, orders[0]])


def _displacement(body: Body, u: np.ndarray) -> np.ndarray:
    u = np.asarray(u, dtype=float)
    if u.shape != body.nodes.shape:
        raise ValueError(
            f"displacement has shape {u.shape}; expected {body.nodes.shape}: one row per node"
        )
    return u


def _per_cell(body: Body, name: str, values: np.ndarray) -> np.ndarray:
    m, q = body.weights.shape
    if values.shape[:1] != (m,):
        raise ValueError(
            f"cell field {name!r} has shape {values.shape}; expected ({m}, …) per cell or "
            f"({m}, {q}, …) per point"
        )
    if values.ndim == 1 or values.shape[1] != q:
        return values
    return np.einsum("mq,mq...->m...", body.weights / body.weights.sum(1, keepdims=True), values)


def _layers(body: Body) -> tuple[dict[str, np.ndarray], list[str]]:
    """Number of the first sub-domain that holds each cell, and names ("none" is number 0)."""
    named = body.mesh.subdomains or {}
    if not named:
        return {}, []
    number = np.zeros(len(body.cells), np.int32)
    for i, cells in reversed(list(enumerate(named.values(), start=1))):
        number[np.asarray(cells)] = i
    return {"layer": number}, ["none", *named]


def _field(name: str, values) -> np.ndarray:
    """Real numbers or booleans; ValueError for all else, which VTK can't write."""
    try:
        values = np.asarray(values)
    except ValueError:
        raise ValueError(f"field {name!r} is {values!r:.60}; expected an array") from None
    if values.dtype.kind not in "biuf":
        raise ValueError(f"field {name!r} is of type {values.dtype}; expected real numbers")
    return values


def _add(data, name: str, values: np.ndarray) -> None:
    from vtkmodules.util.numpy_support import numpy_to_vtk

    if values.dtype == bool:
        values = values.astype(np.uint8)
    array = numpy_to_vtk(np.ascontiguousarray(values.reshape(len(values), -1)), deep=True)
    array.SetName(name)
    data.AddArray(array)
