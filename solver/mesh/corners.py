"""What an iterative solver has to know of a mesh: the corners of its cells, and where it is thin.

On cells whose sides are straight, linear functions of the corners are quadratic ones of all nodes,
so that a coarser space for the same mesh is at hand without a second mesh (p-coarsening). In flat
cells the nodes above each other hold together more than others.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.sparse.csgraph import connected_components

from solver.mesh.body import Body

# Aspect ratio of most cells above which corners turn: linear functions can't bend flat cells unless
# they shear them.
TURNING = 3.0
# How much shorter than across a flat cell is, how well a line follows its short way (a cosine), and
# cells that are looked at together.
FLAT, ALONG, CHUNK = 2.0, 0.9, 2000


def corner_weights(body: Body) -> tuple[np.ndarray, sp.csr_array] | None:
    """The corner nodes (c,), and the matrix W (n, c) that interpolates linearly between them.

    Row a of W holds the (tri)linear shape functions of a cell at the reference position of its node
    a, which all cells at the node agree on. None for elements that have nodes at corners only.
    """
    linear = skfem.ElementHex1() if body.element.startswith("hex") else skfem.ElementTetP1()
    at, ends = body.reference.doflocs, linear.doflocs
    if len(at) == len(ends):
        return None
    values = np.stack(
        [np.broadcast_to(linear.lbasis(at.T, a)[0], len(at)) for a in range(len(ends))], axis=1
    )
    values[np.abs(values) < 1e-12] = 0.0
    corner = body.cells[:, [int(np.abs(at - end).sum(axis=1).argmin()) for end in ends]]
    corners = np.unique(corner)
    # One cell of each node, as they agree.
    cell, place = np.empty(len(body.nodes), int), np.empty(len(body.nodes), int)
    cell[body.cells] = np.arange(len(body.cells))[:, None]
    place[body.cells] = np.arange(len(at))
    # Which cell was written last is the same in both, for numpy writes in order.
    rows = np.repeat(np.arange(len(cell)), len(ends))
    columns = np.searchsorted(corners, corner[cell])
    W = sp.csr_array((values[place].ravel(), (rows, columns.ravel())), (len(cell), len(corners)))
    W.eliminate_zeros()
    W.sort_indices()
    return corners, W


def prolongation(body: Body, moves: np.ndarray, frames: np.ndarray) -> sp.csr_array | None:
    """Components (3 n,) of the nodes, in their ``frames`` (n, 3, 3; columns are axes), of the
    motions of the cells' corners: a matrix (3 n, m); None for linear elements.

    A corner that moves takes along what the linear functions say; in flat cells one that turns,
    too, about itself: its function times the rigid motions. ``moves`` (n, 3): components of the
    corners that nothing holds; a corner that can't move across an axis doesn't turn about it.
    """
    found = corner_weights(body)
    if found is None:
        return None
    corners, W = found
    W, kept = W.tocoo(), moves[corners]
    arm = (body.nodes[W.row] - body.nodes[corners[W.col]]) / body.length * len(corners) ** (1 / 3)
    axes = frames[corners][W.col]
    columns = [(axes[:, :, k], kept[:, k]) for k in range(3)]
    if aspect(body) > TURNING:
        turns = [kept[:, (k + 1) % 3] | kept[:, (k + 2) % 3] for k in range(3)]
        columns += [(np.cross(axes[:, :, k], arm), turns[k]) for k in range(3)]
    number = np.cumsum(np.column_stack([on for _, on in columns]).ravel()) - 1
    number = number.reshape(len(corners), -1)
    parts = []
    for k, (motion, on) in enumerate(columns):
        use = on[W.col]
        motion = np.einsum("pji,pj->pi", frames[W.row[use]], motion[use])
        at = 3 * W.row[use, None] + np.arange(3)
        to = np.broadcast_to(number[W.col[use], k][:, None], at.shape)
        parts.append(((W.data[use, None] * motion).ravel(), at.ravel(), to.ravel()))
    data, rows, cols = (np.concatenate(part) for part in zip(*parts, strict=True))
    P = sp.csr_array((data, (rows, cols)), (3 * len(body.nodes), number.max() + 1))
    P.eliminate_zeros()
    P.sort_indices()
    return P


def aspect(body: Body) -> float:
    """Median over the cells of the longest extent over the shortest, of their corners."""
    sizes, _ = _extents(body)
    return float(np.median(sizes[:, 0] / sizes[:, 2]))


def lines(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Lines of nodes through flat cells, the short way; a node without others is a line.

    The number of each node's line (n,), and its place along it (n,), a length. Cells are flat whose
    corners' extents differ by more than :data:`FLAT` between the shortest way and the next.
    """
    sizes, ways = _extents(body)
    ratio = sizes[:, 1] / sizes[:, 2]
    # Of each node the short way of its flattest cell: the last that is written stays.
    ranked = np.argsort(ratio, kind="stable")
    ranked = ranked[ratio[ranked] > FLAT]
    way = np.zeros(body.nodes.shape)
    way[body.cells[ranked]] = ways[ranked, None]
    a, b = np.triu_indices(body.cells.shape[1], 1)
    pairs = [np.empty((0, 2), np.int32)]
    for start in range(0, len(ranked), CHUNK):
        cells = body.cells[ranked[start : start + CHUNK]]
        i, j = cells[:, a].ravel(), cells[:, b].ravel()
        d = body.nodes[j] - body.nodes[i]
        least = ALONG * np.linalg.norm(d, axis=1)
        on = np.abs(np.einsum("pi,pi->p", d, way[i])) > least
        on &= np.abs(np.einsum("pi,pi->p", d, way[j])) > least
        pairs.append(np.column_stack([i[on], j[on]]))
    joined = np.concatenate(pairs)
    n = len(body.nodes)
    graph = sp.coo_array((np.ones(len(joined), bool), joined.T), shape=(n, n))
    line = connected_components(graph, directed=False)[1]
    first = np.unique(line, return_index=True)[1][line]
    return line, np.einsum("ni,ni->n", body.nodes - body.nodes[first], way[first])


def _extents(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Extents (m, 3) of the cells' corners, falling, and the directions (m, 3) of the shortest."""
    X = body.mesh.p[:, body.mesh.t].transpose(2, 1, 0)  # (m, corners, 3)
    _, sizes, ways = np.linalg.svd(X - X.mean(axis=1, keepdims=True), full_matrices=False)
    return sizes, ways[:, 2]
