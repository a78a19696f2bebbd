"""Meshes of crease patterns as solids: quadrilaterals of the flat sheet, pushed up layer by layer.

Panels and strips are plane regions that share what they border on; Gmsh fills each strip with rows
across its hinge, finer towards its ends, and the panels with what fits. Lengths are in units of
the pattern's extent.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.spatial import cKDTree

from solver.cases.levels import sizes_of
from solver.cases.structure.parts import Structure
from solver.cases.structure.pattern import Pattern
from solver.mesh.body import Body
from solver.mesh.gmsh_import import refused, session
from solver.mesh.structured import growing, joined


@dataclass(frozen=True)
class Sizes:
    """What fixes a mesh, as :class:`solver.cases.unit.mesh.Sizes`.

    ``corner``: shortest step at a hinge's ends, over the thinner layer's thickness; ``factor``:
    from step to step; ``turn``: rad that an element of a hinge turns by at most; ``layered``: the
    step at the layers' interface, over the thinner layer's thickness, 0 for one element each;
    ``along``: least number of elements over a hinge's width; ``panel``: longest side of a panel's
    elements, over that of the largest panel.
    """

    corner: float
    factor: float
    turn: float
    layered: float
    along: int
    panel: float


LEVELS = (
    Sizes(1.0, 5, 0.8, 0.0, 2, 1.0),
    Sizes(0.5, 5, 0.5, 0.5, 2, 1.0),
    Sizes(0.25, 4, 0.5, 0.25, 2, 0.5),
)


@dataclass(frozen=True, eq=False)
class Sheet:
    """``body``: hex27, in units of the pattern's extent, z = 0 in the middle of the sheet.

    ``panel`` and ``hinge`` (cells,): which of them a cell belongs to, −1 for none of that kind;
    ``active`` (cells,): whether it contracts.
    """

    body: Body
    panel: np.ndarray = field(repr=False)
    hinge: np.ndarray = field(repr=False)
    active: np.ndarray = field(repr=False)

    def at(self, panel: int, places: np.ndarray) -> sp.csr_array:
        """Weights (p, nodes) at places (p, 2) of a panel's middle surface.

        Raises ValueError for a place outside of it.
        """
        grid, body = self.body.mesh, self.body
        ref = skfem.MeshHex1.elem.refdom.p.T
        below = np.flatnonzero(ref[:, 2] == 0)
        low, high = (grid.p[2, grid.t].take(k, axis=0) for k in (below[0], np.argmax(ref[:, 2])))
        cells = np.flatnonzero((self.panel == panel) & (low < 0) & (high >= 0))
        corners, sign = grid.p[:2, grid.t[below][:, cells]].transpose(2, 1, 0), ref[below, :2]
        rows, columns, weights = [], [], []
        for k, X in enumerate(places):
            xi = _inside(corners, sign, X)
            best = int(np.argmin(np.abs(xi - 0.5).max(axis=1)))
            if np.abs(xi[best] - 0.5).max() > 0.5 + 1e-6:
                raise ValueError(f"the place {X.tolist()} lies outside of panel {panel}")
            own = cells[best]
            point = np.array([[*xi[best], low[own] / (low[own] - high[own])]]).T
            rows += [k] * body.cells.shape[1]
            columns += body.cells[own].tolist()
            weights += [
                float(skfem.ElementHex2().lbasis(point, a)[0].item())
                for a in range(body.cells.shape[1])
            ]
        shape = len(places), len(body.nodes)
        return sp.csr_array(sp.coo_array((weights, (rows, columns)), shape=shape))

    def middle(self) -> tuple[sp.csr_array, np.ndarray, np.ndarray]:
        """The panels' middle surface as triangles: weights (v, nodes) of its corners, halfway
        between the sheet's faces; of which panel each is, (v,); triangles (t, 3) of corners."""
        body, z = self.body, self.body.nodes[:, 2]
        own = self.panel >= 0
        nodes = np.unique(body.cells[own])
        low, high = (nodes[np.abs(z[nodes] - end(z[nodes])) < 1e-12] for end in (np.min, np.max))
        above = high[cKDTree(body.nodes[high, :2]).query(body.nodes[low, :2])[1]]
        number = np.full(len(z), -1)
        number[low] = np.arange(len(low))
        ref = skfem.ElementHex2().doflocs
        floor = np.flatnonzero(ref[:, 2] == 0)
        grid = floor[np.lexsort(ref[floor, :2].T)].reshape(3, 3)
        cells = own & (number[body.cells[:, floor]] >= 0).all(axis=1)
        squares = [grid[i : i + 2, j : j + 2].ravel()[[0, 1, 3, 2]] for i in (0, 1) for j in (0, 1)]
        halves = [square[half] for square in squares for half in ([0, 1, 2], [0, 2, 3])]
        faces = np.concatenate([number[body.cells[cells][:, half]] for half in halves])
        panels = np.empty(len(low), int)
        panels[number[body.cells[cells][:, floor]]] = self.panel[cells][:, None]
        at = np.arange(len(low))
        entries = (np.full(2 * len(low), 0.5), (np.tile(at, 2), np.concatenate([low, above])))
        return sp.csr_array(entries, shape=(len(low), len(z))), panels, faces


def _inside(corners: np.ndarray, sign: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Where a place (2,) lies in bilinear cells with corners (m, 4, 2), whose reference is sign
    (4, 2): (m, 2), 0 to 1 within, far beyond that where there is no such place; by Newton's
    method."""
    xi = np.full((len(corners), 2), 0.5)
    slope, size = 2 * sign - 1, np.abs(np.ptp(corners, axis=1)).max(axis=1)
    for _ in range(30):
        one = np.where(sign == 1, xi[:, None], 1 - xi[:, None])  # (m, 4, 2)
        off = np.einsum("mk,mki->mi", one.prod(axis=2), corners) - X
        J = np.einsum("mka,mki->mia", slope * one[..., ::-1], corners)
        # Beyond a cell its map may turn over.
        det = np.linalg.det(J)
        sound = np.abs(det) > 1e-12 * size**2
        J[~sound] = np.eye(2)
        xi = np.clip(xi - np.linalg.solve(J, off[..., None])[..., 0], -1.0, 2.0)
    near = np.abs(off).max(axis=1) < 1e-9 * size
    return np.where(near[:, None], xi, 9.0)


def mesh(structure: Structure, level: int | Sizes) -> Sheet:
    """The sheet of a structure; ``level`` picks from :data:`LEVELS`.

    Raises ImportError where Gmsh can't be loaded, ValueError for a level that is not there.
    """
    size = sizes_of(level, LEVELS)
    flat, quads, region = _quadrilaterals(structure, size)
    count, plan = len(structure.pattern.panels), len(flat)
    cells, where, active, heights = [], [], [], {}

    def push(chosen: np.ndarray, z: np.ndarray, on: bool) -> None:
        levels = [heights.setdefault(round(float(at), 12), len(heights)) * plan for at in z]
        q = quads[chosen]
        for low, high in pairwise(levels):
            cells.append(np.concatenate([q + low, q + high], axis=1))
            where.append(region[chosen])
            active.append(np.full(len(q), on))

    passive, layers = _heights(structure, size)
    push(np.ones(len(quads), bool), passive, False)
    for k, z in enumerate(layers):
        if z is not None:
            push(region == count + k, z, True)
    nodes = np.concatenate([np.column_stack([flat, np.full(plan, z)]) for z in heights])
    t = np.concatenate(cells)
    used, t = np.unique(t, return_inverse=True)
    t = t.reshape(-1, 8)
    # Corners 0 … 3 around the bottom and 4 … 7 above them, in scikit-fem's order.
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    around = np.concatenate([np.column_stack([square, np.full(4, z)]) for z in (0, 1)])
    order = [
        int(np.flatnonzero((around == p).all(axis=1))[0]) for p in skfem.MeshHex1.elem.refdom.p.T
    ]
    grid = skfem.MeshHex1(
        np.ascontiguousarray(nodes[used].T), np.ascontiguousarray(t[:, order].T.astype(np.int32))
    )
    where, active = np.concatenate(where), np.concatenate(active)
    layers = {"passive": np.flatnonzero(~active), "active": np.flatnonzero(active)}
    return Sheet(
        Body.build(grid.with_subdomains(layers), "hex27", bent=1),
        np.where(where < count, where, -1), np.where(where < count, -1, where - count), active,
    )  # fmt: skip


def _heights(structure: Structure, size: Sizes):
    """z of the sheet's nodes and of each hinge's layer, None where it has none: finer towards the
    faces where sheet and layers meet."""
    extent = structure.pattern.extent
    h = structure.sheet.h / extent
    tops = [None if own is None else own.h / extent for own in structure.layers]
    folds = [hinge.crease.fold for hinge in structure.pattern.hinges]
    start = size.layered * _thinnest(structure) / extent

    def steps(thickness: float) -> np.ndarray:
        return growing(thickness, start, size.factor) if start else np.array([0.0, thickness])

    faces = {fold for fold, top in zip(folds, tops, strict=True) if top is not None}
    if len(faces) == 2 and start:
        half = steps(h / 2)
        passive = joined(half - h / 2, h / 2 - half[::-1])
    else:
        passive = steps(h) - h / 2 if faces == {-1} else h / 2 - steps(h)[::-1]
    layers = [
        None if top is None else np.sort(fold * (h / 2 + steps(top)))
        for fold, top in zip(folds, tops, strict=True)
    ]
    return passive, layers


def _quadrilaterals(structure: Structure, size: Sizes):
    """Nodes (n, 2), corners (q, 4) counter-clockwise, and regions (q,): panels, then strips."""
    pattern, extent = structure.pattern, structure.pattern.extent
    outlines, count = [outline / extent for outline in pattern.panels], len(pattern.panels)
    longest = size.panel * max(np.ptp(o, axis=0).max() for o in outlines)
    for hinge in pattern.hinges:
        off = hinge.width / 2 * hinge.axis
        a, b = hinge.sides
        outlines.append(np.stack([a - off, a + off, b + off, b - off]) / extent)
    along = [
        max(size.along // 2, int(np.ceil(own.width / extent / (2 * longest))))
        for own in pattern.hinges
    ]
    deep, least = apron(structure), _thinnest(structure)
    aprons = [(own, _beside(pattern, own, side, deep)) for own in pattern.hinges for side in (0, 1)]
    below = len(growing(deep, 2 * size.corner * least, size.factor)) - 1
    rows = [_rows(structure, k, size) for k in range(len(pattern.hinges))]
    with session("sheet") as gmsh:
        faces = [
            (2, _polygon(gmsh.model.occ, X)) for X in [*outlines, *(X / extent for _, X in aprons)]
        ]
        children = refused(gmsh.model.occ.fragment, faces, [])[1]
        gmsh.model.occ.synchronize()
        tags = [[tag for _, tag in made] for made in children]
        for k, hinge in enumerate(pattern.hinges):
            (strip,) = tags[count + k]
            _mapped(gmsh.model, strip, hinge, extent, along[k], (len(rows[k]) - 1) // 2)
        for k, ((own, _), (face,)) in enumerate(zip(aprons, tags[len(outlines) :], strict=True)):
            _mapped(gmsh.model, face, own, extent, along[k // 2], below, size.factor)
        for option, value in (
            ("MeshSizeMax", 2 * longest), ("RecombineAll", 1), ("SubdivisionAlgorithm", 1),
            ("Algorithm", 8), ("ElementOrder", 1),
        ):  # fmt: skip
            gmsh.option.setNumber(f"Mesh.{option}", value)
        refused(gmsh.model.mesh.generate, 2)
        numbers, X, _ = gmsh.model.mesh.getNodes()
        place = np.empty(int(numbers.max()) + 1, int)
        place[numbers] = np.arange(len(numbers))
        quads, region = [], []
        for k, own in enumerate(tags[: len(outlines)]):
            for tag in own:
                kinds, _, corners = gmsh.model.mesh.getElements(2, tag)
                if list(kinds) != [3]:
                    raise ValueError("Gmsh left triangles in the sheet; take another level")
                quads.append(place[corners[0]].reshape(-1, 4))
                region.append(np.full(len(quads[-1]), k))
    quads, flat = np.concatenate(quads), np.reshape(X, (-1, 3))[:, :2]
    corners = flat[quads]
    area = ((corners[:, 2] - corners[:, 0])[:, ::-1] * (corners[:, 3] - corners[:, 1])) @ [-1, 1]
    quads, region = np.where(area[:, None] > 0, quads, quads[:, ::-1]), np.concatenate(region)
    for k, hinge in enumerate(pattern.hinges):
        own = quads[region == count + k]
        # The first side of a strip's cells lies along its axis: they bend about that.
        first = flat[own[:, 1]] - flat[own[:, 0]]
        off = np.abs(first @ hinge.axis) < 0.5 * np.linalg.norm(first, axis=1)
        quads[region == count + k] = np.where(off[:, None], np.roll(own, 1, axis=1), own)
        # Rows are finer towards the hinge's ends.
        nodes, length = np.unique(own), hinge.crease.length / extent
        across = np.array([-hinge.axis[1], hinge.axis[0]])
        even = (flat[nodes] - hinge.sides[0] / extent) @ across / length
        shift = np.interp(even, np.linspace(0, 1, len(rows[k])), rows[k]) - even
        flat[nodes] += length * shift[:, None] * across
    return flat, quads, region


def _polygon(cad, outline: np.ndarray) -> int:
    points = [cad.addPoint(*X, 0.0) for X in outline]
    lines = [cad.addLine(p, q) for p, q in zip(points, points[1:] + points[:1], strict=True)]
    return cad.addPlaneSurface([cad.addCurveLoop(lines)])


def apron(structure: Structure) -> float:
    """How deep panels have rows of their own beside hinges, in the pattern's unit: what a hinge's
    ends do to a panel dies away over its thickness. One for all, as they meet at corners."""
    pattern, sheet = structure.pattern, structure.sheet
    limits = [4 * max([sheet.h, *(layer.h for layer in structure.layers if layer is not None)])]
    for hinge in pattern.hinges:
        limits.append(0.1 * hinge.width)
        for face, side, inward in zip(hinge.faces, hinge.sides, _inward(hinge), strict=True):
            limits.append(0.2 * ((pattern.panels[face] - side) @ inward).max())
    return min(limits)


def _inward(hinge) -> tuple[np.ndarray, np.ndarray]:
    """Into the panels on either side."""
    across = np.array([-hinge.axis[1], hinge.axis[0]])
    return -across, across


def _beside(pattern: Pattern, hinge, side: int, deep: float) -> np.ndarray:
    """Corners (4, 2) of a panel's rows beside a hinge."""
    outline, inward = pattern.panels[hinge.faces[side]], _inward(hinge)[side]
    near, far = [], []
    for way in (-1, 1):
        end = hinge.sides[side] + way * hinge.width / 2 * hinge.axis
        # The panel's corner beyond this end: rows that meet there meet on its bisector.
        on = np.abs((outline - end) @ inward) < 1e-9 * pattern.extent
        at = np.flatnonzero(on)[np.argmax(way * (outline[on] - end) @ hinge.axis)]
        before, after = (outline[(at + d) % len(outline)] - outline[at] for d in (-1, 1))
        cosine = before @ after / np.linalg.norm(before) / np.linalg.norm(after)
        inset = deep / np.tan(np.arccos(np.clip(cosine, -1, 1)) / 2)
        beyond = way * (outline[at] - end) @ hinge.axis
        if beyond > 1e-9 * pattern.extent:
            inset = max(inset - beyond, 0.0) + 0.2 * deep
        near.append(end)
        far.append(end + deep * inward - way * inset * hinge.axis)
    return np.stack([*near, *far[::-1]])


def _thinnest(structure: Structure) -> float:
    return min([structure.sheet.h, *(own.h for own in structure.layers if own is not None)])


def _rows(structure: Structure, k: int, size: Sizes) -> np.ndarray:
    """Where the rows of a hinge's elements end, from 0 to 1 across it; an even number of them."""
    extent = structure.pattern.extent
    half = structure.pattern.hinges[k].crease.length / extent / 2
    thin = _thinnest(structure) / extent
    turning = min(float(np.abs(structure.laws[k].angle).max()) / 2, np.pi)
    longest = half / max(np.ceil(turning / size.turn), 2)
    side = growing(half, size.corner * thin, size.factor, longest)
    return joined(side, 2 * half - side[::-1]) / (2 * half)


def _mapped(model, tag: int, hinge, extent, along: int, rows: int, factor: float = 1.0):
    """A grid on a surface of four sides along and across a hinge; its rows grow by ``factor`` away
    from it. Half as many as wanted, as each element is cut in four."""
    middle = hinge.sides.mean(axis=0) / extent
    across = np.array([-hinge.axis[1], hinge.axis[0]])
    for _, curve in model.getBoundary([(2, tag)], oriented=False):
        low, high = (bound[0] for bound in model.getParametrizationBounds(1, curve))
        start, end = np.reshape(model.getValue(1, curve, [low, high]), (2, 3))[:, :2]
        depth = [abs((X - middle) @ across) for X in (start, end)]
        if abs(depth[1] - depth[0]) < 1e-9 and abs((end - start) @ across) < 1e-9:
            model.mesh.setTransfiniteCurve(curve, along + 1)
        else:
            growth = factor if depth[1] > depth[0] else 1 / factor
            model.mesh.setTransfiniteCurve(curve, rows + 1, "Progression", growth)
    model.mesh.setTransfiniteSurface(tag)
