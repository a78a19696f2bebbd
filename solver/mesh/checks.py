"""Checks of a mesh before it becomes a body: what can't be solved is refused at once.

Refused are inverted, flat and folded cells, cells that share no facet with the rest, touching faces
that don't share their nodes, hanging nodes, and nodes without a cell. All of it is vectorised: the
cost is a few seconds at a million tetrahedra, most of it the sort that pairs the facets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import scipy.sparse as sp
import skfem
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

# det(∂X/∂ξ) over the product of its columns' lengths below which a cell counts as flat.
FLAT = 1e-12
# Nodes closer than this fraction of the mesh's extent coincide.
TOUCH = 1e-7
# Roundoff of positions over the shortest edge above which results are off by more than 1e-4.
ROUNDOFF = 1e-5
CHUNK = 4096


@dataclass(frozen=True, eq=False)
class Facets:
    """Facets of a mesh: ``vertices`` (v, f), ``of_cell`` (local facets, m), ``cells`` (2, f).

    ``cells[1]`` is −1 on the boundary. ``shared`` (f,): number of cells at the facet. ``side``
    (2, f): +1 or −1, the sense in which each cell's corners run around the facet seen from the
    facet's smallest corner, by the cell's reference orientation.
    """

    vertices: np.ndarray
    of_cell: np.ndarray
    cells: np.ndarray
    shared: np.ndarray
    side: np.ndarray

    @property
    def boundary(self) -> np.ndarray:
        """Indices of the facets with one cell."""
        return np.flatnonzero(self.shared == 1)


def facets(mesh: skfem.Mesh) -> Facets:
    """Pairs the facets of the cells by their corners, in scikit-fem's own order."""
    ref, t = mesh.elem.refdom, mesh.t
    m = t.shape[1]
    corners = np.hstack([t[local] for local in ref.facets])
    key = np.sort(corners, axis=0).astype(np.int64)
    if len(key) == 3 and mesh.nvertices < 1 << 21:
        codes = [key[0] << 42 | key[1] << 21 | key[2]]
    else:
        codes = [key[0] << 32 | key[1], key[2] << 32 | key[-1]]
    order = np.lexsort(codes[::-1])
    new = np.zeros(len(order), bool)
    new[0] = True
    for code in codes:
        code = code[order]
        new[1:] |= code[1:] != code[:-1]
    start = np.flatnonzero(new)
    number = np.empty(len(order), np.int32)
    number[order] = np.cumsum(new) - 1
    shared = np.diff(np.append(start, len(order)))
    slots = np.full((2, len(start)), -1)
    slots[0] = order[start]
    pair = shared >= 2
    slots[1, pair] = order[start[pair] + 1]
    sense = _sense(ref, corners, m)
    simplex = len(ref.facets) == 4
    return Facets(
        # Facets of simplices carry their corners in ascending order, as in scikit-fem.
        np.ascontiguousarray((key if simplex else corners)[:, slots[0]].astype(np.int32)),
        number.reshape(-1, m),
        np.where(slots < 0, -1, slots % m).astype(np.int32),
        shared,
        np.where(slots < 0, 0, sense[slots]),
    )


def _sense(ref, corners: np.ndarray, m: int) -> np.ndarray:
    """±1 per facet of a cell: do its corners run outward-positive from the smallest one?"""
    v = len(corners)
    at = np.argmin(corners, axis=0)
    every = np.arange(corners.shape[1])
    turn = np.where(corners[(at + 1) % v, every] < corners[(at - 1) % v, every], 1, -1)
    centre = ref.p.mean(axis=1)
    outward = []
    for local in ref.facets:
        a, b, c = (ref.p[:, i] for i in local[:3])
        outward.append(np.sign(np.cross(b - a, c - b) @ (a - centre)))
    return (turn * np.repeat(outward, m)).astype(np.int8)


def jacobians(mesh: skfem.Mesh, points: np.ndarray, cells: slice | np.ndarray = slice(None)):
    """∂X/∂ξ at reference points (3, q): (m, 3, 3, q), the last but one index along ξ."""
    dofs = mesh.dofs.element_dofs[:, cells]
    gradients = np.stack([mesh.elem().lbasis(points, a)[1] for a in range(len(dofs))])
    gradients = np.broadcast_to(gradients, (len(dofs), 3, points.shape[1]))
    X = np.ascontiguousarray(mesh.doflocs[:, dofs].transpose(2, 0, 1))  # (m, 3, k)
    X -= X[:, :, :1]  # far from the origin roundoff is large
    return (X @ gradients.reshape(len(dofs), -1)).reshape(-1, 3, 3, points.shape[1])


def positions(mesh: skfem.Mesh, points: np.ndarray) -> np.ndarray:
    """Positions (m, q, 3) of reference points (3, q) in all cells."""
    dofs, element = mesh.dofs.element_dofs, mesh.elem()
    values = np.stack([element.lbasis(points, a)[0] for a in range(len(dofs))], axis=-1)
    return values @ mesh.doflocs[:, dofs].T


def determinants(mesh: skfem.Mesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """det(∂X/∂ξ) at reference points (3, q), and the same over its columns' lengths; (m, q)."""
    if mesh.affine:
        points = points[:, :1]
    m = mesh.t.shape[1]
    det, scaled = np.empty((m, points.shape[1])), np.empty((m, points.shape[1]))
    for start in range(0, m, CHUNK):
        part = slice(start, start + CHUNK)
        J = jacobians(mesh, points, part)
        a, b, c = J[:, :, 0], J[:, :, 1], J[:, :, 2]
        det[part] = np.einsum("miq,miq->mq", a, np.cross(b, c, axis=1))
        lengths = np.sqrt(
            np.einsum("miq,miq->mq", a, a)
            * np.einsum("miq,miq->mq", b, b)
            * np.einsum("miq,miq->mq", c, c)
        )
        scaled[part] = det[part] / np.where(lengths > 0, lengths, 1)
    return det, scaled


def orientation(scaled: np.ndarray) -> np.ndarray:
    """±1 per cell: −1 where the order of the nodes mirrors it, which is no fault."""
    return np.where(scaled.sum(axis=1) < 0, -1, 1).astype(np.int8)


def refuse_cells(mesh: skfem.Mesh, scaled: np.ndarray) -> None:
    """Raises ValueError for cells whose determinant vanishes or changes its sign."""
    bad = ~(scaled * orientation(scaled)[:, None] > FLAT).all(axis=1)
    if bad.any():
        raise ValueError(
            f"{bad.sum()} of {len(bad)} cells are inverted or flat, the first near "
            f"{place(mesh, np.flatnonzero(bad)[0])}; mend the mesh"
        )


def place(mesh: skfem.Mesh, cell: int) -> str:
    """Centre of a cell as text."""
    return point_text(mesh.p[:, mesh.t[:, cell]].mean(axis=1))


def point_text(x: np.ndarray) -> str:
    """A position as text."""
    return f"({x[0]:.4g}, {x[1]:.4g}, {x[2]:.4g})"


def refuse_nodes(mesh: skfem.Mesh) -> None:
    """Raises ValueError for positions that aren't finite and for corners without a cell."""
    if not np.isfinite(mesh.doflocs).all():
        bad = np.flatnonzero(~np.isfinite(mesh.doflocs).all(axis=0))
        raise ValueError(f"{len(bad)} nodes have no finite position, the first is node {bad[0]}")
    idle = np.flatnonzero(np.bincount(mesh.t.ravel(), minlength=mesh.nvertices) == 0)
    if len(idle):
        raise ValueError(
            f"{len(idle)} nodes belong to no cell, the first near "
            f"{point_text(mesh.p[:, idle[0]])}; remove them from the mesh"
        )


def refuse_distance(mesh: skfem.Mesh) -> None:
    """Raises ValueError for a mesh so far from the origin that roundoff shapes its cells."""
    ends = mesh.elem.refdom.edges
    shortest = min(
        np.linalg.norm(mesh.p[:, mesh.t[a]] - mesh.p[:, mesh.t[b]], axis=0).min() for a, b in ends
    )
    far = np.abs(mesh.p).max()
    if np.finfo(float).eps * far > ROUNDOFF * shortest:
        raise ValueError(
            f"the mesh reaches {far:.3g} from the origin and its shortest edge is {shortest:.3g}: "
            "its positions are roundoff; move it to the origin"
        )


def refuse_folds(mesh: skfem.Mesh, table: Facets, signs: np.ndarray) -> None:
    """Raises ValueError where cells lie on the same side of a facet, or more than two share it."""
    many = np.flatnonzero(table.shared > 2)
    if len(many):
        where = mesh.p[:, table.vertices[:, many[0]]].mean(axis=1)
        raise ValueError(
            f"{len(many)} facets belong to more than two cells, the first near "
            f"{point_text(where)}; remove the cells that are there twice"
        )
    inner = table.shared == 2
    side = table.side[:, inner] * signs[table.cells[:, inner]]
    folded = np.flatnonzero(inner)[side[0] == side[1]]
    if len(folded):
        where = mesh.p[:, table.vertices[:, folded[0]]].mean(axis=1)
        raise ValueError(
            f"the cells at {len(folded)} facets lie on the same side of them, the first near "
            f"{point_text(where)}: a cell is folded over its neighbour; mend the mesh"
        )


def parts(table: Facets) -> tuple[int, np.ndarray]:
    """Number of parts joined through facets, and the part of each cell (m,)."""
    m = table.of_cell.shape[1]
    a, b = table.cells[:, table.shared >= 2]
    return connected_components(sp.coo_array((np.ones(len(a), bool), (a, b)), shape=(m, m)), False)


def touching(mesh: skfem.Mesh, table: Facets) -> np.ndarray:
    """Pairs of corners on the boundary that coincide without being one, (pairs, 2)."""
    corners = np.unique(table.vertices[:, table.boundary])
    tree = cKDTree(mesh.p[:, corners].T)
    return corners[tree.query_pairs(TOUCH * np.ptp(mesh.p, axis=1).max(), output_type="ndarray")]


def hanging(mesh: skfem.Mesh, table: Facets) -> np.ndarray:
    """Corners that lie on a straight boundary facet, or its edge, without being its corner.

    Warped facets (of curved shells) are seen as two triangles, so a node that hangs on such a one
    may go unseen; unconnected faces there still show as parts or touching nodes.
    """
    quads = table.vertices[:, table.boundary]
    corners = np.unique(quads)
    X = np.ascontiguousarray(mesh.p[:, corners].T)
    triangles = quads[:3] if len(quads) == 3 else np.hstack([quads[:3], quads[[0, 2, 3]]])
    owner = np.tile(quads, (1, 1 if len(quads) == 3 else 2)).T
    P = np.ascontiguousarray(mesh.p[:, triangles].transpose(2, 1, 0))
    # Bins by quantiles hold about as many nodes each, however the mesh is graded.
    n = int(np.clip(len(X) ** (1 / 3), 1, 64))
    slack = TOUCH * np.ptp(X, axis=0).max()
    edges = np.quantile(X, np.linspace(0, 1, n + 1)[1:-1], axis=0).T
    at = [np.searchsorted(edges[i], X[:, i]) for i in range(3)]
    lo = np.stack([np.searchsorted(edges[i], P[:, :, i].min(axis=1) - slack) for i in range(3)], 1)
    hi = np.stack([np.searchsorted(edges[i], P[:, :, i].max(axis=1) + slack) for i in range(3)], 1)
    bins = (at[0] * n + at[1]) * n + at[2]
    order = np.argsort(bins, kind="stable")
    starts = np.searchsorted(bins[order], np.arange(n**3 + 1))
    inside = _on_triangles(
        P, owner.astype(np.int64), X, corners.astype(np.int64), lo, hi, order, starts, n, slack
    )
    return corners[inside]


@numba.njit(cache=True)
def _on_triangles(P, owner, X, corners, lo, hi, order, starts, n, slack):
    inside = np.zeros(len(X), np.bool_)
    for f in range(len(P)):
        a, e1, e2 = P[f, 0], P[f, 1] - P[f, 0], P[f, 2] - P[f, 0]
        g11, g12, g22 = (e1 * e1).sum(), (e1 * e2).sum(), (e2 * e2).sum()
        det = g11 * g22 - g12 * g12
        if det <= 0:
            continue
        for i in range(lo[f, 0], hi[f, 0] + 1):
            for j in range(lo[f, 1], hi[f, 1] + 1):
                row = (i * n + j) * n
                for s in range(starts[row + lo[f, 2]], starts[row + hi[f, 2] + 1]):
                    v = order[s]
                    mine = False
                    for c in range(owner.shape[1]):
                        mine = mine or owner[f, c] == corners[v]
                    if mine:
                        continue
                    d = X[v] - a
                    b1, b2 = (d * e1).sum(), (d * e2).sum()
                    r = (g22 * b1 - g12 * b2) / det
                    t = (g11 * b2 - g12 * b1) / det
                    if r < -1e-6 or t < -1e-6 or r + t > 1 + 1e-6:
                        continue
                    gap = d - r * e1 - t * e2
                    if np.sqrt((gap * gap).sum()) <= slack:
                        inside[v] = True
    return inside


def refuse_gaps(mesh: skfem.Mesh, table: Facets) -> None:
    """Raises ValueError for unconnected parts, touching faces without shared nodes, hanging nodes.

    All three leave faces free that look joined, or parts that nothing holds.
    """
    n, part = parts(table)
    pairs = touching(mesh, table)
    remedy = "join them, or pass parts=True if they are meant to be separate"
    touch = f"{len(pairs)} pairs of nodes coincide without being one"
    if n > 1:
        sizes = np.bincount(part)
        other = int(np.flatnonzero(part != np.argmax(sizes))[0])
        also = f"; {touch}, so parts touch without being joined" if len(pairs) else ""
        raise ValueError(
            f"the mesh is {n} parts that share no facet (cells: "
            f"{', '.join(str(s) for s in np.sort(sizes)[::-1][:6])}"
            f"{', …' if n > 6 else ''}), one of the smaller near {place(mesh, other)}{also}; "
            f"{remedy}"
        )
    if len(pairs):
        where = point_text(mesh.p[:, pairs[0, 0]])
        raise ValueError(f"{touch}, the first near {where}; {remedy}")
    loose = hanging(mesh, table)
    if len(loose):
        raise ValueError(
            f"{len(loose)} nodes hang on facets of other cells, the first near "
            f"{point_text(mesh.p[:, loose[0]])}; make the cells match, or pass parts=True if "
            "the faces are meant to be separate"
        )
