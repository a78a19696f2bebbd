"""Structured meshes: boxes of hexahedra or tetrahedra, graded, cut out, layered, and bent.

A mesh is built on a box, where its layers and boundaries are named by tests of centres, and then
bent by a function of position. Body.build makes a body of it:

    y = joined(graded(0, 0.1, 4, toward="b"), graded(0.1, 0.5, 6, toward="a"))
    mesh = box([0, 0.1], y, [0, 1e-3, 6e-3], keep=lambda X: (X[:, 2] < 1e-3) | (X[:, 1] < 0.1),
               layers={"active": lambda X: X[:, 2] > 1e-3})
    ring = box([1, 1.1], np.linspace(0, 2 * np.pi, 25), [0, 0.5], shape=polar)

Lengths are in whatever unit the scene uses, angles in radians.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import skfem
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from solver.given import mask
from solver.mesh.checks import TOUCH, facets

Test = Callable[[np.ndarray], np.ndarray]

SIDES = ("x-", "x+", "y-", "y+", "z-", "z+")
# Six tetrahedra of a hexahedron, all along the diagonal from corner 0 to corner 7 of (x, y, z) in
# {0, 1}³ counted x fastest; shifted copies match on their common faces.
PATHS = ((1, 3), (1, 5), (2, 3), (2, 6), (4, 5), (4, 6))


def graded(a: float, b: float, n: int, *, toward: str = "both", ratio: float = 10.0) -> np.ndarray:
    """n + 1 coordinates from a to b whose steps shrink geometrically toward one or both ends.

    ``toward``: "a", "b", "both", or "middle". ``ratio``: longest over shortest step, ≥ 1; 1 is
    uniform. Raises ValueError for n < 1, a = b, ratio < 1 or another ``toward``.
    """
    if n < 1 or int(n) != n:
        raise ValueError(f"n = {n}; expected a whole number of elements, at least 1")
    if not (np.isfinite([a, b]).all() and a != b):
        raise ValueError(f"from {a} to {b} there is no length; give two different numbers")
    if not (np.isfinite(ratio) and ratio >= 1):
        raise ValueError(f"ratio = {ratio}; expected longest over shortest step, at least 1")
    k = np.arange(n)
    rank = {
        "a": k,
        "b": k[::-1],
        "both": np.minimum(k, k[::-1]),
        "middle": -np.minimum(k, k[::-1]),
    }.get(toward)
    if rank is None:
        raise ValueError(f"toward = {toward!r}; expected 'a', 'b', 'both' or 'middle'")
    rank = rank - rank.min()
    steps = ratio ** (rank / max(rank.max(), 1))
    out = a + (b - a) * np.concatenate([[0], np.cumsum(steps)]) / steps.sum()
    out[-1] = b
    return out


def growing(length: float, first: float, factor: float, longest: float = np.inf) -> np.ndarray:
    """Coordinates from 0 to ``length`` whose steps grow from ``first`` by ``factor`` up to
    ``longest``; they are then scaled to fit."""
    taken, step = [], first
    while sum(taken) < length * (1 - 1e-9):
        taken.append(min(step, longest))
        step *= factor
    return np.concatenate([[0.0], np.cumsum(np.array(taken) * length / sum(taken))])


def joined(*pieces: Sequence[float]) -> np.ndarray:
    """Coordinates of pieces that follow each other, each starting where the last one ends.

    Raises ValueError where a piece starts elsewhere.
    """
    out = np.asarray(pieces[0], dtype=float)
    for piece in pieces[1:]:
        piece = np.asarray(piece, dtype=float)
        if abs(piece[0] - out[-1]) > 1e-12 * max(np.ptp(out), np.ptp(piece)):
            raise ValueError(f"a piece starts at {piece[0]:g} but the last one ends at {out[-1]:g}")
        out = np.concatenate([out, piece[1:]])
    return out


def box(
    x: Sequence[float],
    y: Sequence[float],
    z: Sequence[float],
    *,
    keep: Test | None = None,
    layers: Mapping[str, Test] | None = None,
    boundaries: Mapping[str, Test] | None = None,
    tets: bool = False,
    shape: Callable[[np.ndarray], np.ndarray] | None = None,
    quadratic: bool | None = None,
) -> skfem.Mesh:
    """Tensor mesh with corners at x × y × z, in part removed, named, and bent.

    Tests are functions of positions X (n, 3) in the box that return masks (n,): ``keep`` and
    ``layers`` (sub-domains) of cell centres, ``boundaries`` of the centres of boundary facets, cut
    faces included. The planes of the box's extremes are named "x-", "x+" … "z+", where cells
    reach them. ``tets`` splits each hexahedron into six tetrahedra. ``shape`` maps box positions
    (n, 3) to space (n, 3); nodes that meet there become one, so a ring closes. ``quadratic`` (by
    default: where there is a shape) maps mid-edge, mid-face and centre nodes too: a MeshHex2 or
    MeshTet2, whose curved geometry quadratic elements follow.

    Raises ValueError for coordinates that don't increase, and for tests that choose nothing or
    return another shape. Body.build refuses a mesh that its shape folds.
    """
    axes = [_axis(name, c) for name, c in zip("xyz", (x, y, z), strict=True)]
    counts = [len(c) - 1 for c in axes]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    number = np.arange(len(grid)).reshape([len(c) for c in axes])
    # Corner (i, j, k) of each cell, k fastest among the cells.
    corner = {
        (i, j, k): number[i : i + counts[0], j : j + counts[1], k : k + counts[2]].ravel()
        for i in (0, 1)
        for j in (0, 1)
        for k in (0, 1)
    }
    centres = (grid[corner[0, 0, 0]] + grid[corner[1, 1, 1]]) / 2
    kept = np.ones(len(centres), bool) if keep is None else _test("keep", keep, centres)
    if not kept.any():
        raise ValueError("keep leaves no cell; check the test of the cell centres")
    ref = skfem.ElementHex1.refdom.p.T.astype(int)
    cells = np.stack([corner[tuple(c)][kept] for c in ref])
    centres = centres[kept]
    subdomains = {
        name: _chosen(f"layer {name!r}", _test(f"layer {name!r}", test, centres))
        for name, test in (layers or {}).items()
    }
    if tets:
        m = cells.shape[1]
        at = {int(c @ (1, 2, 4)): a for a, c in enumerate(ref)}
        cells = np.hstack([cells[[at[0], at[i], at[j], at[7]]] for i, j in PATHS])
        subdomains = {
            name: np.concatenate([chosen + s * m for s in range(6)])
            for name, chosen in subdomains.items()
        }
    used, flat = np.unique(cells, return_inverse=True)
    straight, t = grid[used], flat.reshape(cells.shape)
    placed = straight if shape is None else _shaped(shape, straight)
    corners = placed
    if shape is not None:
        merged = _merge(placed)
        first = np.unique(merged, return_index=True)[1]
        corners, t = placed[first], merged[t]
    if quadratic is None:
        quadratic = shape is not None
    linear = (skfem.MeshTet1 if tets else skfem.MeshHex1)(
        np.ascontiguousarray(corners.T), np.ascontiguousarray(t.astype(np.int32))
    )
    table = facets(linear)
    # Facet centres in the box, where the tests are made: through the first cell at each facet.
    local = np.empty((len(table.of_cell), *table.of_cell.shape[1:], 3))
    for i, facet in enumerate(linear.elem.refdom.facets):
        local[i] = grid[cells[facet]].mean(axis=0)
    where = np.empty((table.vertices.shape[1], 3))
    where[table.of_cell] = local
    edge = table.boundary
    named = _sides(axes, where, edge)
    for name, test in (boundaries or {}).items():
        mask = _test(f"boundary {name!r}", test, where[edge])
        named[name] = edge[_chosen(f"boundary {name!r}", mask)]
    mesh = linear
    if quadratic:
        element, box_corners = linear.elem(), grid[cells]  # (k, m, 3)

        def positions(at: np.ndarray) -> np.ndarray:
            weights = [element.lbasis(at[:, None], a)[0].item() for a in range(len(box_corners))]
            points = np.einsum("a,amj->mj", weights, box_corners)
            return points if shape is None else _shaped(shape, points)

        mesh = curved(linear, positions)
    return mesh.with_subdomains(subdomains).with_boundaries(named)


def curved(mesh: skfem.Mesh, positions: Callable[[np.ndarray], np.ndarray]) -> skfem.Mesh:
    """MeshHex2 or MeshTet2 over a linear mesh, without its names.

    ``positions(at)`` gives where the element's node at the reference position ``at`` (3,) lies in
    every cell, (m, 3).
    """
    kind = skfem.MeshTet2 if isinstance(mesh, skfem.MeshTet1) else skfem.MeshHex2
    out = kind.from_mesh(mesh)
    dofs, X = out.dofs.element_dofs, out.doflocs.copy()
    for a, at in enumerate(out.elem().doflocs):
        X[:, dofs[a]] = positions(at).T
    return kind(X, mesh.t)


def polar(X: np.ndarray) -> np.ndarray:
    """Box (r, θ, z) to space: arches, rings and cylinders around the z axis; θ in radians."""
    r, angle, z = X.T
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1)


def spherical(X: np.ndarray) -> np.ndarray:
    """Box (r, a, b) to a patch of a sphere around the x axis, |a|, |b| < π/2, in radians.

    The direction is (1, tan a, tan b), so the patch's sides are planes through the centre: mirror
    planes of the sphere for a, b from 0 to π/4 (a 24th of it).
    """
    r, a, b = X.T
    d = np.stack([np.ones_like(r), np.tan(a), np.tan(b)], axis=-1)
    return r[:, None] * d / np.linalg.norm(d, axis=1, keepdims=True)


def weld(mesh: skfem.Mesh, tolerance: float = TOUCH) -> skfem.Mesh:
    """The mesh with corners that coincide (within ``tolerance`` · its extent) made one.

    Sub-domains keep their names, boundaries too (those inside the body afterwards are facets
    between cells). Raises ValueError for a quadratic mesh: weld before it is made quadratic.
    """
    if mesh.doflocs.shape[1] != mesh.nvertices:
        raise ValueError("only linear meshes can be welded; weld before making it quadratic")
    merged = _merge(np.ascontiguousarray(mesh.p.T), tolerance)
    first = np.unique(merged, return_index=True)[1]
    t = merged[mesh.t].astype(np.int32)
    before, names = mesh.t2f, mesh.boundaries or {}
    out = type(mesh)(np.ascontiguousarray(mesh.p[:, first]), t)
    after = np.empty(before.max() + 1, int)
    after[before] = out.t2f
    return out.with_subdomains(mesh.subdomains or {}).with_boundaries(
        {name: np.unique(after[np.asarray(chosen)]) for name, chosen in names.items()}
    )


def _merge(points: np.ndarray, tolerance: float = TOUCH) -> np.ndarray:
    """New number of each point; points within the tolerance share theirs."""
    pairs = cKDTree(points).query_pairs(
        tolerance * np.ptp(points, axis=0).max(), output_type="ndarray"
    )
    n = len(points)
    if not len(pairs):
        return np.arange(n)
    label = connected_components(coo_array((np.ones(len(pairs), bool), pairs.T), shape=(n, n)))[1]
    # Numbered by the first of each, so that an unwelded mesh keeps its order.
    first = np.full(label.max() + 1, n)
    np.minimum.at(first, label, np.arange(n))
    rank = np.empty_like(first)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[label]


def _axis(name: str, values: Sequence[float]) -> np.ndarray:
    c = np.asarray(values, dtype=float)
    if c.ndim != 1 or len(c) < 2 or not np.isfinite(c).all() or not (np.diff(c) > 0).all():
        raise ValueError(f"{name} coordinates: expected at least two finite, increasing numbers")
    return c


def _test(name: str, test: Test, X: np.ndarray) -> np.ndarray:
    return mask(name, test(X), len(X))


def _chosen(name: str, mask: np.ndarray) -> np.ndarray:
    if not mask.any():
        raise ValueError(f"{name} is empty; check its test of the centres")
    return np.flatnonzero(mask)


def _shaped(shape, X: np.ndarray) -> np.ndarray:
    out = np.asarray(shape(X), dtype=float)
    if out.shape != X.shape or not np.isfinite(out).all():
        raise ValueError(
            f"shape gave {out.shape} (finite: {bool(np.isfinite(out).all())}); expected finite "
            f"positions {X.shape}"
        )
    return out


def _sides(axes, where: np.ndarray, edge: np.ndarray) -> dict[str, np.ndarray]:
    named = {}
    for i, axis in enumerate(axes):
        slack = 1e-9 * np.diff(axis).min()
        for name, value in zip(SIDES[2 * i : 2 * i + 2], (axis[0], axis[-1]), strict=True):
            hit = edge[np.abs(where[edge, i] - value) < slack]
            if len(hit):
                named[name] = hit
    return named
