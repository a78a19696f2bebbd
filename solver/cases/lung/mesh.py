"""Meshes of the lung: structured hexahedra of any part of it, and Gmsh's tetrahedra.

Each flag of the tiling (see :mod:`solver.cases.lung.geometry`) carries the same blocks: a strip of
half a bundle along the edge, and three blocks of the hole around a point in its middle, all of
quadrilaterals on the sphere that are extruded radially. Neighbours share what lies between
them, so wedge, octant and whole sphere are the same elements. Sub-domains "epithelium" and "muscle"
share the nodes of their contact; the boundary "inner" is the lumen's wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import skfem

from solver.cases.levels import sizes_of
from solver.cases.lung.geometry import PARTS, Holes, Lung, unit
from solver.mesh.body import Body
from solver.mesh.checks import facets
from solver.mesh.gmsh_import import from_model, refused, session
from solver.mesh.structured import curved, graded, weld


@dataclass(frozen=True)
class Counts:
    """Elements of a flag.

    ``rim``: along each half of the hole's rim; ``hole``: from the rim inwards, graded towards it;
    ``strip``: across half a bundle; ``epithelium``, ``muscle``: through the thickness.
    """

    rim: int = 1
    hole: int = 1
    strip: int = 1
    epithelium: int = 1
    muscle: int = 1


LEVELS = (
    Counts(),
    Counts(rim=1, hole=2, epithelium=2),
    Counts(rim=2, hole=3, strip=2, epithelium=2),
    Counts(rim=3, hole=5, strip=3, epithelium=3, muscle=2),
    Counts(rim=4, hole=7, strip=4, epithelium=4, muscle=3),
)
RATIO = 3.0  # longest over shortest step away from the rim, where the stress is singular


def slerp(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Arcs (f, t, 3) from a to b, unit vectors (f, 3)."""
    angle = np.arccos(np.clip(np.einsum("fi,fi->f", a, b), -1, 1))[:, None, None]
    t = t[None, :, None]
    return (np.sin((1 - t) * angle) * a[:, None] + np.sin(t * angle) * b[:, None]) / np.sin(angle)


def _halves(steps: np.ndarray) -> np.ndarray:
    """Coordinates with the middle of each step between them."""
    out = np.empty(2 * len(steps) - 1)
    out[::2], out[1::2] = steps, (steps[1:] + steps[:-1]) / 2
    return out


def _coons(along: tuple[np.ndarray, np.ndarray], across: tuple[np.ndarray, np.ndarray], a, b):
    """Points (f, a, b, 3) on the sphere within four arcs; ``a``, ``b`` are their parameters."""
    c0, c1 = (c[:, :, None] for c in along)
    d0, d1 = (d[:, None, :] for d in across)
    a, b = a[None, :, None, None], b[None, None, :, None]
    corners = (
        (1 - a) * (1 - b) * c0[:, :1]
        + a * (1 - b) * c0[:, -1:]
        + (1 - a) * b * c1[:, :1]
        + a * b * c1[:, -1:]
    )
    return unit((1 - b) * c0 + b * c1 + (1 - a) * d0 + a * d1 - corners)


def _quads(grid: np.ndarray) -> np.ndarray:
    """Quadrilaterals (f · i · j, 3, 3, 3) with their nine points, from points at half steps."""
    f, p, q = grid.shape[:3]
    i, j = np.arange(0, p - 1, 2), np.arange(0, q - 1, 2)
    rows, cols = i[:, None] + np.arange(3), j[:, None] + np.arange(3)
    out = grid[:, rows[:, None, :, None], cols[None, :, None, :]]  # (f, i, j, 3, 3, 3)
    return out.reshape(f * len(i) * len(j), 3, 3, 3)


def _blocks(h: Holes, c: Counts) -> tuple[np.ndarray, np.ndarray]:
    """Quadrilaterals of the holes and of the strips, each (q, 3, 3, 3)."""
    half = _halves(np.linspace(0, 1, c.rim + 1))
    inward = _halves(graded(0, 1, c.hole, toward="a", ratio=RATIO if c.hole > 1 else 1.0))
    full = np.concatenate([half / 2, 0.5 + half[1:] / 2])
    # The rim is a small circle about the normal of the edge's plane.
    s, n = h.sine, h.normal[:, None]
    level = np.sqrt(1 - s * s)

    def rim(t):
        ends = [unit(p - s * h.normal) for p in (h.at_middle, h.at_corner)]
        return s * n + level * slerp(*ends, t)

    t = _halves(graded(0, 1, c.strip, toward="b", ratio=RATIO if c.strip > 1 else 1.0))
    edge, inner = slerp(h.middle, h.corner, full), rim(full)
    strip = unit(
        (1 - t)[None, None, :, None] * edge[:, :, None] + t[None, None, :, None] * inner[:, :, None]
    )
    one = np.array([0.5])
    d1 = slerp(h.centre, h.at_middle, one)[:, 0]
    d2 = slerp(h.centre, h.at_corner, one)[:, 0]
    d3 = rim(one)[:, 0]
    g = unit(h.centre + h.at_middle + h.at_corner)
    hole = [
        _coons((slerp(h.centre, d1, half), slerp(d2, g, half)),
               (slerp(h.centre, d2, half), slerp(d1, g, half)), half, half),
        _coons((rim(half / 2), slerp(d1, g, half)),
               (slerp(h.at_middle, d1, inward), slerp(d3, g, inward)), half, inward),
        _coons((rim(1 - half / 2), slerp(d2, g, half)),
               (slerp(h.at_corner, d2, inward), slerp(d3, g, inward)), half, inward),
    ]  # fmt: skip
    return np.concatenate([_quads(b) for b in hole]), _quads(strip)


def hexahedra(
    lung: Lung, counts: int | Counts = 2, *, part: str = "wedge", element: str = "hex27"
) -> Body:
    """Body of hexahedra of the ``wedge``, the ``octant`` or the whole ``sphere``.

    ``counts`` picks the sizes from :data:`LEVELS`, or gives them. Raises ValueError for a part or a
    level that is not there, and for what Body.build refuses.
    """
    if part not in PARTS:
        raise ValueError(f"no part {part!r}; there are: {', '.join(PARTS)}")
    counts = sizes_of(counts, LEVELS)
    flags = lung.tiling.flags_in(part)
    hole, strip = _blocks(Holes.of(lung.tiling, flags, lung.bundle), counts)
    inside = np.linspace(1 - lung.epithelium, 1, counts.epithelium + 1)
    outside = np.linspace(1, 1 + lung.muscle, counts.muscle + 1)
    layers = [(np.concatenate([hole, strip]), inside)]
    if lung.muscle:
        layers.append((strip, outside))
    faces, low, high = [], [], []
    for quads, r in layers:
        for a, b in pairwise(r):
            faces.append(quads)
            low.append(np.full(len(quads), a))
            high.append(np.full(len(quads), b))
    faces, low, high = np.concatenate(faces), np.concatenate(low), np.concatenate(high)

    def positions(at: np.ndarray) -> np.ndarray:
        i, j = np.rint(2 * at[:2]).astype(int)
        return (low + (high - low) * at[2])[:, None] * faces[:, i, j]

    corners = np.stack([positions(p) for p in skfem.ElementHex1.refdom.p.T])  # (8, m, 3)
    m = len(faces)
    loose = skfem.MeshHex1(
        np.ascontiguousarray(corners.reshape(-1, 3).T), np.arange(8 * m).reshape(8, m)
    )
    linear = weld(loose)
    mesh = curved(linear, positions)
    muscle = np.arange(m) >= len(layers[0][0]) * counts.epithelium
    return Body.build(_named(mesh, linear, lung, muscle), element)


def _named(mesh, linear, lung: Lung, muscle: np.ndarray) -> skfem.Mesh:
    """The mesh with its sub-domains and the boundary "inner"."""
    table = facets(linear)
    radius = np.linalg.norm(linear.p[:, table.vertices[:, table.boundary]], axis=0)
    wall = table.boundary[(np.abs(radius - (1 - lung.epithelium)) < 1e-9).all(axis=0)]
    names = {"epithelium": np.flatnonzero(~muscle)}
    if muscle.any():
        names["muscle"] = np.flatnonzero(muscle)
    return mesh.with_subdomains(names).with_boundaries({"inner": wall})


def tetrahedra(
    lung: Lung, size: float, *, part: str = "sphere", order: int = 1, muscle: float | None = None
) -> Body:
    """Body of Gmsh's unstructured tetrahedra, of edges about ``size`` (R); §3.3.2 by order 1.

    ``muscle``: size in the cage; None: the same. Curved edges are followed at order 2. Raises
    ValueError for a size that is not positive, a part that is not there and what Gmsh refuses,
    ImportError where Gmsh can't be loaded.
    """
    if part not in PARTS:
        raise ValueError(f"no part {part!r}; there are: {', '.join(PARTS)}")
    if not size > 0 or order not in (1, 2):
        raise ValueError(f"size = {size}, order = {order}; expected size > 0 and order 1 or 2")
    with session("lung") as gmsh:
        _Builder(gmsh.model.geo, lung, size, muscle or size).build(part)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 1)
        gmsh.option.setNumber("Mesh.ElementOrder", order)
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0)
        gmsh.option.setNumber("Mesh.Optimize", 1)
        refused(gmsh.model.mesh.generate, 3)
        mesh = from_model()
    return Body.build(mesh, "tet4" if order == 1 else "tet10")


class _Builder:
    """Gmsh's built-in geometry of the flags, each entity once."""

    def __init__(self, geo, lung: Lung, size: float, muscle: float):
        self.geo, self.lung, self.size, self.muscle = geo, lung, size, muscle
        self.radii = [1 - lung.epithelium, 1.0] + ([1 + lung.muscle] if lung.muscle else [])
        self.known: dict[tuple, int] = {}
        self.origin = geo.addPoint(0, 0, 0)

    def once(self, key: tuple, make, *given) -> int:
        """The tag under this key, made when first asked for."""
        if key not in self.known:
            self.known[key] = refused(make, *given)
        return self.known[key]

    def build(self, part: str) -> None:
        """All flags of the part; volumes and the inner wall as physical groups."""
        t, geo = self.lung.tiling, self.geo
        flags = t.flags_in(part)
        h = Holes.of(t, flags, self.lung.bundle)
        volumes = {"epithelium": [], "muscle": []}
        wall = []
        for k, (tile, corner, edge) in enumerate(flags.tolist()):
            at = {
                "O": (("O", tile), h.centre[k]),
                "M": (("M", edge), h.middle[k]),
                "V": (("V", corner), h.corner[k]),
                "m": (("m", tile, edge), h.at_middle[k]),
                "v": (("v", tile, corner), h.at_corner[k]),
                "c": (("c", corner), h.sine * h.normal[k]),  # centre of the hole's circle
            }
            for piece in ("Omv", "mMVv"):
                last = len(self.radii) - 1 if piece == "mMVv" else 1
                sheets = [self.sheet(at, piece, r) for r in range(last + 1)]
                wall.append(sheets[0])
                for r in range(last):
                    sides = [
                        self.side(at, a + b, r)
                        for a, b in zip(piece, piece[1:] + piece[:1], strict=True)
                    ]
                    shell = geo.addSurfaceLoop([sheets[r], sheets[r + 1], *sides])
                    volumes["muscle" if r else "epithelium"].append(geo.addVolume([shell]))
        geo.synchronize()
        import gmsh

        for name, tags in volumes.items():
            if tags:
                gmsh.model.addPhysicalGroup(3, tags, name=name)
        gmsh.model.addPhysicalGroup(2, wall, name="inner")

    def point(self, at, r: int) -> int:
        key, direction = at
        size = self.muscle if r == 2 else self.size
        return self.once((*key, r), self.geo.addPoint, *(self.radii[r] * direction), size)

    def arc(self, at, ends: str, r: int) -> int:
        """The arc between two points of a flag; its sign says which way it runs."""
        keys = [at[e][0] for e in ends]
        first = min(keys)
        centre = self.origin
        if set(ends) == {"m", "v"}:
            x = self.radii[r] * at["c"][1]
            centre = self.once(("c", *sorted(keys), r), self.geo.addPoint, *x)
        a, b = (self.point(at[e], r) for e in (ends if keys[0] == first else ends[::-1]))
        tag = self.once((*sorted(keys), r), self.geo.addCircleArc, a, centre, b)
        return tag if keys[0] == first else -tag

    def rise(self, at, end: str, r: int) -> int:
        a, b = self.point(at[end], r), self.point(at[end], r + 1)
        return self.once((at[end][0], "up", r), self.geo.addLine, a, b)

    def sheet(self, at, piece: str, r: int) -> int:
        """A piece of the sphere of radius r."""
        pairs = zip(piece, piece[1:] + piece[:1], strict=True)
        loop = self.geo.addCurveLoop([self.arc(at, a + b, r) for a, b in pairs])
        return refused(self.geo.addSurfaceFilling, [loop], -1, self.origin)

    def side(self, at, ends: str, r: int) -> int:
        """The radial face over an arc."""
        key = (*sorted(at[e][0] for e in ends), "side", r)
        if key in self.known:
            return self.known[key]
        around = [
            self.arc(at, ends, r),
            self.rise(at, ends[1], r),
            -self.arc(at, ends, r + 1),
            -self.rise(at, ends[0], r),
        ]
        return self.once(key, self.geo.addSurfaceFilling, [self.geo.addCurveLoop(around)])
