"""The corners of quadratic cells: which linear functions between them a body can represent.

On cells whose sides are straight, linear functions of the corners are quadratic ones of all nodes,
so that a coarser space for the same mesh is at hand without a second mesh (p-coarsening).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import skfem

from solver.mesh.body import Body


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


def aspect(body: Body) -> float:
    """Median over the cells of the longest extent over the shortest, of their corners."""
    X = np.moveaxis(body.mesh.p[:, body.mesh.t], 0, -1)  # (corners, m, 3)
    sizes = np.linalg.svd((X - X.mean(axis=0)).transpose(1, 0, 2), compute_uv=False)
    return float(np.median(sizes[:, 0] / sizes[:, -1]))
