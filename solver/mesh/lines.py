"""Lines of nodes through the cells of a body, with shape functions along them.

A segment runs along an edge of a cell; in the 27-node hexahedron, whose nodes stand there too, also
along a mid-line of one of its faces or of the cell itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from solver.given import node_numbers
from solver.mesh.body import ELEMENTS, Body, Surface

_X, _W = (np.polynomial.legendre.leggauss(3) + np.array([[1.0], [0.0]])) / 2
# Linear and quadratic shapes on [0, 1] and their slopes at the points, by nodes of a segment.
_SHAPES = {
    2: np.stack([1 - _X, _X], -1),
    3: np.stack([(1 - _X) * (1 - 2 * _X), 4 * _X * (1 - _X), _X * (2 * _X - 1)], -1),
}
_SLOPES = {
    2: np.tile([-1.0, 1.0], (3, 1)),
    3: np.stack([4 * _X - 3, 4 - 8 * _X, 4 * _X - 1], -1),
}


@dataclass(frozen=True, eq=False)
class Line:
    """Segments of a line, as :class:`solver.mesh.body.Surface` holds facets.

    ``nodes`` (l, k): end, middle (of quadratic elements), end; ``shapes`` (l, q, k); ``weights``
    (l, q): reference length.
    """

    nodes: np.ndarray
    shapes: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, body: Body, nodes: np.ndarray) -> Line:
        """The line through ``nodes``: numbers, or a mask (n,); mid-edge nodes included.

        Raises ValueError for nodes that form no line: one that no segment among them reaches, or
        at which more than two meet.
        """
        chosen = np.zeros(len(body.nodes), bool)
        chosen[node_numbers(nodes, len(body.nodes))] = True
        local = _segments(body.element)
        near = body.cells[chosen[body.cells].any(axis=1)]
        every = near[:, local].reshape(-1, local.shape[1])
        every = every[chosen[every].all(axis=1)]
        back = every[:, 0] > every[:, -1]
        every[back] = every[back, ::-1]
        every = np.unique(every, axis=0)
        meeting = np.bincount(every.ravel(), minlength=len(chosen))
        for bad, why in ((chosen & (meeting == 0), "none"), (meeting > 2, "more than two")):
            if bad.any():
                place = ", ".join(f"{c:.4g}" for c in body.nodes[np.flatnonzero(bad)[0]])
                raise ValueError(
                    f"the nodes form no line: of the segments between them {why} meet at "
                    f"({place}); give all nodes of one line of cell edges, mid-edge nodes included"
                )
        k = every.shape[1]
        along = np.einsum("qk,lki->lqi", _SLOPES[k], body.nodes[every])
        weights = _W * np.linalg.norm(along, axis=-1)
        return cls(every, np.broadcast_to(_SHAPES[k], (*weights.shape, k)), weights)


def refuse_region(body: Body, region, *kinds: type) -> None:
    """Raises ValueError for what is none of ``kinds`` (Surface, Line), or is not of the body."""
    if not isinstance(region, kinds):
        makers = {Surface: "a Surface (Body.surface)", Line: "a Line (Line.of)"}
        expected = " or ".join(makers[kind] for kind in kinds)
        raise ValueError(f"got {type(region).__name__} {region!r:.40}; expected {expected}")
    if region.nodes.max() >= len(body.nodes):
        raise ValueError(
            f"the {type(region).__name__} has node {region.nodes.max()}, the body "
            f"{len(body.nodes)} nodes; it belongs to another body"
        )


def _segments(element: str) -> np.ndarray:
    """Local nodes of each straight line of nodes in a cell, (segments, 2 | 3)."""
    X = ELEMENTS[element][0]().doflocs
    corner = np.isin(X, (0, 1)).all(axis=1)
    lines = []
    for a, b in combinations(range(len(X)), 2):
        across = np.abs(X[a] - X[b])
        straight = corner[[a, b]].all()
        if element.startswith("hex"):
            straight = sorted(across) == [0, 0, 1]
        middle = np.flatnonzero(np.abs(X - (X[a] + X[b]) / 2).max(axis=1) < 1e-9)
        if straight and (corner.all() or len(middle)):
            lines.append([a, *middle, b])
    return np.array(lines)
