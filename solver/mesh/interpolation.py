"""Values at any position of a body, from those at its nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from solver.given import numbers

if TYPE_CHECKING:
    from solver.mesh.body import Body

# Pairs of a point and a cell that are looked at together.
CHUNK = 2_000_000


def matrix(body: Body, points: np.ndarray) -> sp.csr_array:
    """See :meth:`solver.mesh.body.Body.interpolation`."""
    points = numbers("points", points)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"points of shape {points.shape}; expected finite positions (p, 3)")
    # Of straight cells the map to the reference cell is affine. scikit-fem's own search loses
    # points in cells a thousand times longer than thick, and in quadratic meshes.
    corners = np.moveaxis(body.mesh.p[:, body.mesh.t], -1, 0)  # (m, 3, corners)
    tets = body.element.startswith("tet")
    if tets:
        origin = corners[:, :, 0]
        axes = corners[:, :, 1:] - origin[:, :, None]
        volume = np.abs(np.linalg.det(axes)) / 6
    else:
        origin = corners.min(axis=2)
        size = corners.max(axis=2) - origin
        volume = size.prod(axis=1)
    if not np.allclose(body.weights.sum(axis=1), volume, rtol=1e-6):
        return sp.csr_array(body.basis.probes(points.T))
    if tets:
        cell, local = _in_tetrahedra(points, origin, np.linalg.inv(axes))
    else:
        cell = _in_boxes(points, origin, size)
        local = (points - origin[cell]) / size[cell]
    off = np.maximum(-local.min(axis=1), (local.sum(axis=1) if tets else local.max(axis=1)) - 1)
    if (off > 1e-6).any():
        raise ValueError(f"the point {tuple(points[off.argmax()])} is outside of the body")
    local = np.clip(local, 0, 1).T
    element = body.reference
    values = np.stack([element.lbasis(local, a)[0] for a in range(body.cells.shape[1])], 1)
    # A sum that takes each node once per point, so that no duplicates have to be looked for.
    indptr = values.shape[1] * np.arange(len(points) + 1)
    shape = (len(points), len(body.nodes))
    return sp.csr_array((values.ravel(), body.cells[cell].ravel(), indptr), shape=shape)


def _in_tetrahedra(points, origin, inverse) -> tuple[np.ndarray, np.ndarray]:
    """The cell that each point is in, or least out of, and where it is there (p, 3)."""
    cell, local = np.empty(len(points), int), np.empty(points.shape)
    step = max(1, CHUNK // (3 * len(origin)))
    for start in range(0, len(points), step):
        part = slice(start, start + step)
        X = np.einsum("mij,pmj->pmi", inverse, points[part, None] - origin)
        out = np.maximum(-X.min(axis=2), X.sum(axis=2) - 1)
        cell[part] = out.argmin(axis=1)
        local[part] = X[np.arange(len(X)), cell[part]]
    return cell, local


def _in_boxes(points, origin, size) -> np.ndarray:
    """The box that each point is in, to 1e-6 of its size; 0 for points in none."""
    # Points of curves and meshes have few different coordinates.
    lines = [np.unique(points[:, axis], return_inverse=True) for axis in range(3)]
    cell = np.zeros(len(points), int)
    open_ = np.arange(len(points))
    # Rounding may take a point out of every box, but no point is taken for one of a neighbour.
    for slack in (0.0, 1e-6):
        within = []
        for axis, (x, _) in enumerate(lines):
            local = (x[:, None] - origin[:, axis]) / size[:, axis]
            within.append((local >= -slack) & (local <= 1 + slack))
        step = max(1, CHUNK // len(origin))
        rest = []
        for start in range(0, len(open_), step):
            part = open_[start : start + step]
            x, y, z = (within[axis][lines[axis][1].ravel()[part]] for axis in range(3))
            x &= y
            x &= z
            cell[part] = x.argmax(axis=1)
            rest.append(part[~x[np.arange(len(part)), cell[part]]])
        open_ = np.concatenate(rest) if rest else open_
    return cell
