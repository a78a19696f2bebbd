"""Rows for faces and lines of a body: hinges, prescribed rotations, and faces that stay flat.

A row is linear in u. Means are taken over the reference measure dA₀ of the face, or the length of
the line, with arms X − X̄ from its centroid X̄.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver.mesh.body import Body, Surface
from solver.mesh.lines import Line, refuse_region
from solver.physics.supports import Row, Value, unit_vector


def mean_displacement_row(
    body: Body, region: Surface | Line, direction: Sequence[float], value: Value = 0.0
) -> Row:
    """∫ u·d dA₀ / A₀ = value (length) along the unit vector of ``direction`` (3,).

    A face held so in the mean can still turn: the hinge of a beam or shell, which on a single line
    of a solid would let that line sink into it. Raises ValueError for a direction that is none.
    """
    refuse_region(body, region, Surface, Line)
    d = unit_vector(direction)
    coefficients = np.einsum("fq,fqk->fk", region.weights, region.shapes)
    return _row(
        body, region, coefficients[..., None] * d / region.weights.sum(), value, "displacement"
    )


def mean_rotation_row(
    body: Body, region: Surface | Line, axis: Sequence[float], value: Value = 0.0
) -> Row:
    """∫ a · ((X − X̄) × u) dA₀ / ∫ |a × (X − X̄)|² dA₀ = value about the unit vector a of ``axis``.

    A face that moves rigidly and turns by θ about the axis has the value sin θ, so a face is
    turned by ``lambda e: np.sin(e * theta)``, to less than 90°. It may deform as long as its mean
    keeps to that, and the row's forces, which keep their directions, deform it a little: bent
    strips are turned less than θ by about twice their surface's strain times tan θ (measured:
    1.6 % at 1 rad and h/L = 0.01). Raises ValueError for an axis that is none, or along which the
    region lies.
    """
    refuse_region(body, region, Surface, Line)
    a = unit_vector(axis, "axis")
    X = np.einsum("fqk,fki->fqi", region.shapes, body.nodes[region.nodes])
    centre = np.einsum("fq,fqi->i", region.weights, X) / region.weights.sum()
    turn = np.cross(a, X - centre)
    inertia = np.einsum("fq,fqi,fqi->", region.weights, turn, turn)
    if not inertia > 1e-18 * body.length**2 * region.weights.sum():
        raise ValueError(f"the region lies along the axis {tuple(a)}; nothing turns about it")
    coefficients = np.einsum("fq,fqk,fqi->fki", region.weights, region.shapes, turn) / inertia
    return _row(body, region, coefficients, value, "rotation")


def flat_rows(body: Body, surface: Surface) -> list[Row]:
    """A plane face stays flat, free to move along its normal N and to turn; one row a node but 3.

    At each node u·N is that of the plane through three of the face's nodes, at the node's
    reference position. Exact as long as the face turns little, or keeps straight lines in its
    plane straight and evenly divided; beyond that it is flat to first order in the rotation. With
    :func:`mean_rotation_row` about two axes it doesn't turn either. Raises ValueError for a face
    that isn't plane.
    """
    refuse_region(body, surface, Surface)
    nodes = np.unique(surface.nodes)
    arm = body.nodes[nodes] - body.nodes[nodes].mean(axis=0)
    _, _, axes = np.linalg.svd(arm, full_matrices=False)
    off = np.abs(arm @ axes[2]).max()
    if off > 1e-9 * np.linalg.norm(arm, axis=1).max():
        raise ValueError(
            f"the face isn't plane: a node is {off:.3g} off its mean plane; choose facets in one "
            "plane"
        )
    # Roundoff would make entries of the matrix.
    normal = np.where(np.abs(axes[2]) < 1e-12, 0.0, axes[2])
    # Three nodes far apart: the outermost, the one farthest from it, and that off their line.
    first = np.linalg.norm(arm, axis=1).argmax()
    second = np.linalg.norm(arm - arm[first], axis=1).argmax()
    along = arm[second] - arm[first]
    third = np.linalg.norm(np.cross(arm - arm[first], along), axis=1).argmax()
    masters = [first, second, third]
    in_plane = np.hstack([arm @ axes[:2].T, np.ones((len(nodes), 1))])
    weights = np.linalg.solve(in_plane[masters].T, in_plane.T).T
    rows = []
    for k in np.setdiff1d(np.arange(len(nodes)), masters):
        c = np.zeros_like(body.nodes)
        c[nodes[k]] = normal
        c[nodes[masters]] -= weights[k][:, None] * normal
        rows.append(Row(c, name="flat face"))
    return rows


def _row(body: Body, region, coefficients: np.ndarray, value: Value, what: str) -> Row:
    c = np.zeros_like(body.nodes)
    np.add.at(c, region.nodes, coefficients)
    return Row(c, value, f"mean {what}")
