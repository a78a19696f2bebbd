"""A lung longer than wide: shell and cage of the sphere on an ellipsoid of revolution about z.

What lies at r N on the sphere's ray N goes to A N + (r − 1) M, where A = diag(1, 1, a) takes the
sphere to the ellipsoid and M is its normal at A N: thicknesses stay what they are, bundles and
their fibres go along. An axis z of the tiling is a twofold one, so the octant x, y, z ≥ 0 is a
mirror part as before (the wedge is not).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from solver.cases.lung.geometry import Lung, unit
from solver.cases.lung.mesh import hexahedra
from solver.cases.lung.model import State, Tissue, staged
from solver.equilibrium.scene import Scene
from solver.given import number
from solver.mesh.body import Body


@dataclass(frozen=True)
class Corrugation:
    """A tile, ``height`` above the equator on the sphere, in R as the others.

    ``depth``: how much farther its middle moves along the undeformed normal than the middles of its
    bundles in the mean; what an ellipsoid does as a whole, from the equator to the ends, is not in
    it. ``spacing`` of its bundles: as of :mod:`solver.cases.lung.measures`.
    """

    tile: int
    edges: int
    height: float
    depth: float
    spacing: float

    @property
    def aspect(self) -> float:
        """Depth over spacing."""
        return self.depth / self.spacing


@dataclass(frozen=True, eq=False)
class Elongated:
    """The octant of a ``lung`` whose length is ``length`` widths: ``body``, and the same mesh on
    the sphere, ``round``."""

    lung: Lung
    length: float
    round: Body
    body: Body

    @classmethod
    def of(cls, lung: Lung, length: float, counts=1, *, element: str = "hex27") -> Elongated:
        """``counts``: as of :func:`solver.cases.lung.mesh.hexahedra`.

        Raises ValueError for a length that is not positive, and for one at which the shell is
        thicker than the ellipsoid is curved.
        """
        if not number("length", length) > 0:
            raise ValueError(f"length = {length}; expected length over width > 0, 1 for a sphere")
        # Least radius of curvature: at the ends of a long one, around the rim of a flat one.
        least = min(1 / length, length**2)
        if lung.epithelium >= least:
            raise ValueError(
                f"length = {length:g}: the shell, {lung.epithelium:g} thick, lies within a radius "
                f"of curvature of {least:.3g}; take a thinner shell or a rounder lung"
            )
        ball = hexahedra(lung, counts, part="octant", element=element)
        places = cls._place(ball.mesh.doflocs.T, length).T
        mesh = replace(ball.mesh, doflocs=np.ascontiguousarray(places))
        return cls(lung, length, ball, Body.build(mesh, element))

    @staticmethod
    def _place(X: np.ndarray, length: float) -> np.ndarray:
        N, axes = unit(X), np.array([1.0, 1.0, length])
        return axes * N + (np.linalg.norm(X, axis=1, keepdims=True) - 1) * unit(N / axes)

    def normals(self, X: np.ndarray) -> np.ndarray:
        """M where positions X (n, 3) on the round one went, (n, 3)."""
        return unit(unit(X) / np.array([1.0, 1.0, self.length]))

    def scene(self, tissue: Tissue, states: Sequence[State], *, linear: str = "auto") -> Scene:
        """As :func:`solver.cases.lung.model.staged`."""
        return staged(self.body, self.lung, tissue, states, linear=linear, ball=self.round)

    def cells(self, u: np.ndarray) -> list[Corrugation]:
        """What a displacement u (n, 3) makes of each tile in the octant, from the equator up."""
        t, X, Y = self.lung.tiling, self.round.nodes, self.body.nodes + u
        tiles, _, edges = t.flags_in("octant").T
        out = np.einsum("ni,ni->n", u, self.normals(X))
        rims, middles = _nodes(X, t.middles[edges]), _nodes(X, t.centres)
        found = []
        for tile in np.unique(tiles):
            rim, middle = rims[tiles == tile], middles[tile]
            axis, off = self.normals(X[[middle]])[0], Y[rim] - Y[middle]
            away = np.linalg.norm(off - (off @ axis)[:, None] * axis, axis=1)
            depth, height = out[middle] - out[rim].mean(), X[middle, 2]
            found.append(
                Corrugation(
                    int(tile), int(t.degrees[tile]), float(height), float(depth),
                    float(2 * away.mean()),
                )
            )  # fmt: skip
        return sorted(found, key=lambda cell: cell.height)


def _nodes(X: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Nodes of X (n, 3) at the directions ``at`` (p, 3) on r = 1, (p,); −1 where there is none."""
    gap, node = cKDTree(X).query(unit(at))
    return np.where(gap < 1e-6, node, -1)
