"""Solids as STEP, lengths in mm, by Gmsh's OpenCASCADE; bodies are named by their layer.

The folded solids are the solver's own: on its structured mesh of 27-node cells every side of a
block is a B-spline surface of degree two, control points from the nodes without any fit.
"""

from __future__ import annotations

import os
import re
import sys
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np

from foldlab.making.folded import Folded
from foldlab.making.geometry import Geometry

SAME = 1e-7  # of the sheet's length: grid lines and sizes that are the same


def write_flat(path: Path, unit: Geometry) -> None:
    """Writes the flat sheet and the active layer or its strips, a solid each.

    Raises ImportError where Gmsh can't be loaded.
    """
    with _cad(path) as (cad, name):

        def block(corners, low: float, up: float, layer: str) -> None:
            points = [cad.addPoint(x, y, low) for x, y in corners]
            ends = zip(points, [*points[1:], points[0]], strict=True)
            loop = cad.addCurveLoop([cad.addLine(a, b) for a, b in ends])
            made = cad.extrude([(2, cad.addPlaneSurface([loop]))], 0, 0, up)
            name(next(tag for dim, tag in made if dim == 3), layer)

        block(unit.outline, 0.0, unit.thickness, "passive")
        for patch in unit.patches:
            block(patch, unit.thickness, unit.active_thickness, "active")


def write_folded(path: Path, unit: Geometry, folded: Folded) -> None:
    """Writes the same solids as the solver bent them.

    Raises ImportError where Gmsh can't be loaded, ValueError for a mesh of other cells and where
    OpenCASCADE makes no solid of it.
    """
    nodes = _Grid(folded)
    with _cad(path) as (cad, name):
        for layer, sides in _shells(unit):
            surfaces = [_surface(cad, *nodes.side(*ends)) for ends in sides]
            shell = cad.addSurfaceLoop(surfaces, -1, True)
            name(cad.addVolume([shell]), layer)
            # Sewing made copies; what it was given would be written beside them.
            cad.remove([(2, tag) for tag in surfaces], recursive=True)


@contextmanager
def _cad(path: Path):
    """Gmsh's OpenCASCADE and a function that names volumes; writes the file in the end."""
    try:
        import gmsh
    except OSError as error:
        # On a machine without a desktop it lacks X libraries.
        raise ImportError(f"Gmsh can't be loaded ({error}; Debian: libglu1-mesa)") from error

    owner = not gmsh.isInitialized()
    if owner:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.model.add("unit")
    names: dict[int, str] = {}
    try:
        yield gmsh.model.occ, names.__setitem__
        gmsh.model.occ.synchronize()
        with _silent():
            gmsh.write(str(path))
        _name(path, [names[tag] for _, tag in gmsh.model.getEntities(3)])
    except Exception as error:
        # Gmsh has no finer type.
        if type(error) is not Exception:
            raise
        raise ValueError(f"Gmsh made no solids: {error}") from error
    finally:
        if owner:
            gmsh.finalize()
        else:
            gmsh.model.remove()


@contextmanager
def _silent():
    """OpenCASCADE reports on the process's own output, past Gmsh's options and Python's."""
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def _name(path: Path, names: list[str]) -> None:
    """Names the products in a file by their solids, which Gmsh does not."""
    several = {layer for layer in names if names.count(layer) > 1}
    named = [f"{n} {names[: k + 1].count(n)}" if n in several else n for k, n in enumerate(names)]
    text = re.sub(
        r"'Open CASCADE STEP translator [\d.]+ \d+(?:\.(\d+))?'",
        lambda m: f"'{named[int(m[1]) - 1] if m[1] else 'unit'}'",
        path.read_text(encoding="ascii"),
    )
    path.write_text(text, encoding="ascii")


class _Grid:
    """Nodes of a structured mesh of 27-node hexahedra, found by their place in the flat unit."""

    def __init__(self, folded: Folded):
        if {int(kind) for kind in np.unique(folded.mesh.celltypes)} != {29}:
            raise ValueError("the mesh is not of 27-node hexahedra")
        flat = np.asarray(folded.mesh.points)
        tolerance = SAME * np.ptp(flat[:, 0])
        self.lines, places = [], []
        for values in flat.T:
            order = np.sort(values)
            kept = order[np.concatenate([[True], np.diff(order) > tolerance])]
            self.lines.append(kept)
            places.append(np.searchsorted(kept, values - tolerance))
        self._at = np.full([len(line) for line in self.lines], -1)
        self._at[tuple(places)] = np.arange(len(flat))
        self._nodes, self._tolerance = folded.nodes, tolerance

    def side(self, *ends: tuple[float, float]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Nodes (nu, nv, 3) of a rectangle of the flat unit, and its two grid lines.

        ``ends``: low and high x, y, z in mm, of one of which both are the same.
        """
        cut = []
        for line, (low, high) in zip(self.lines, ends, strict=True):
            a, b = (int(np.abs(line - end).argmin()) for end in (low, high))
            if max(abs(line[a] - low), abs(line[b] - high)) > self._tolerance:
                raise ValueError(f"the mesh has no line at {low:g} or {high:g} mm")
            cut.append(slice(a, b + 1))
        at = self._at[tuple(cut)]
        if (at < 0).any():
            raise ValueError("the mesh has holes where the unit has none")
        lines = [line[c] for line, c in zip(self.lines, cut, strict=True)]
        return self._nodes[at.squeeze()], [line for line in lines if len(line) > 1]


def _shells(unit: Geometry):
    """Layer and sides of each solid, as low and high x, y, z in mm."""
    L, li = unit.length / 2, unit.hinge_length / 2
    b, bi = unit.width / 2, unit.hinge_width / 2
    x = [-L, -li, li, L]
    y = [-b, -bi, bi, b] if unit.waisted else [-b, b]
    cells = {(i, j) for i in range(3) for j in range(len(y) - 1) if i != 1 or len(y) == 2 or j == 1}
    yield "passive", _skin(x, y, (0.0, unit.thickness), cells)
    z = unit.thickness, unit.thickness + unit.active_thickness
    for patch in unit.patches:
        (x0, y0), (x1, y1) = patch.min(axis=0), patch.max(axis=0)
        yield "active", _skin([x0, x1], [y0, y1], z, {(0, 0)})


def _skin(x, y, z, cells):
    """Sides of columns between lines at x and y, without those that two columns share."""
    xs, ys = list(pairwise(x)), list(pairwise(y))
    for i, j in sorted(cells):
        yield from ((xs[i], ys[j], (end, end)) for end in z)
        for k, (ends, other) in enumerate(((xs[i], i), (ys[j], j))):
            for end, step in zip(ends, (-1, 1), strict=True):
                beside = (other + step, j) if k == 0 else (i, other + step)
                if beside not in cells:
                    at = (end, end)
                    yield (at, ys[j], z) if k == 0 else (xs[i], at, z)


def _surface(cad, nodes: np.ndarray, lines: list[np.ndarray]) -> int:
    """B-spline surface of degree two through the nodes (nu, nv, 3) of quadratic cells.

    Its parameters are the flat unit's lengths: cells' sizes grade, and with a knot each at equal
    steps OpenCASCADE's own integrals of volume are off by percents.
    """
    points = _controls(np.moveaxis(_controls(nodes), 1, 0))
    # (nv, nu, 3): Gmsh has u fastest.
    tags = [cad.addPoint(*p) for p in points.reshape(-1, 3)]
    knots = [line[::2].tolist() for line in lines]
    times = [[3, *[2] * (len(k) - 2), 3] for k in knots]
    surface = cad.addBSplineSurface(
        tags, points.shape[1], degreeU=2, degreeV=2, knotsU=knots[0], knotsV=knots[1],
        multiplicitiesU=times[0], multiplicitiesV=times[1],
    )  # fmt: skip
    cad.remove([(0, tag) for tag in tags])
    return surface


def _controls(nodes: np.ndarray) -> np.ndarray:
    """Bézier points along the first axis: a parabola through P₀, P₁, P₂ has 2P₁ − (P₀ + P₂)/2."""
    out = nodes.copy()
    out[1::2] = 2 * nodes[1::2] - (nodes[:-2:2] + nodes[2::2]) / 2
    return out
