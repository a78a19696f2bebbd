"""Geometry of the lung: the dual of a geodesic sphere, bundles along its edges, a shell beneath.

Each face of an icosahedron is divided into n² triangles, their vertices are projected onto the
sphere, and the centroids of neighbours are joined by great-circle arcs (§3.3.1): 12 pentagons and
10 (n² − 1) hexagons for every n. Tiling and lung have the full icosahedral group, of order 120. The
coordinate planes are mirror planes; the wedge between the axes of a pentagon A, of an icosahedron's
edge B = z and of its face C is the 120th that all of it is made of.

Everything here is directions and angles; lengths are in units of the sphere's radius R. A flag is a
tile, one of its corners and one of its edges there: the triangle of the tile's centre, the edge's
middle and the corner. The sphere has 120 n² of them, the wedge n²; no mirror plane cuts one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

PHI = (1 + np.sqrt(5)) / 2
# Inward normals of the wedge's mirror planes, through A and B, B and C, C and A.
_A, _B, _C = np.array([0, 1, PHI]), np.array([0, 0, 1.0]), np.array([PHI, 0, 2 * PHI + 1])
MIRRORS = np.array([[1.0, 0, 0], [0, 1.0, 0], np.cross(_C, _A) / np.linalg.norm(np.cross(_C, _A))])
PARTS = {"wedge": MIRRORS, "octant": np.eye(3), "sphere": np.zeros((0, 3))}


def unit(v: np.ndarray) -> np.ndarray:
    """Vectors along the last axis, of length 1."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def fold(X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (p, 3) mirrored into the wedge, and the orthogonal Q (p, 3, 3) that did it: Q X."""
    Q = np.broadcast_to(np.eye(3), (len(X), 3, 3)).copy()
    Y = np.array(X, dtype=float)
    slack = 1e-12 * np.abs(Y).max()
    for _ in range(60):  # the longest element of the group is 15 reflections
        moved = False
        for n in MIRRORS:
            out = Y @ n < -slack
            if out.any():
                moved = True
                Y[out] -= 2 * (Y[out] @ n)[:, None] * n
                Q[out] -= 2 * n[:, None] * (n @ Q[out])[:, None, :]
        if not moved:
            return Y, Q
    raise AssertionError("reflections don't end")


@dataclass(frozen=True, eq=False)
class Tiling:
    """The tiling of the unit sphere for a subdivision n.

    ``centres`` (t, 3) of the tiles; ``corners`` (v, 3); ``edges`` (k, 2): their corners; ``sides``
    (k, 2): the tiles on both sides; ``normals`` (k, 3): of the edge's plane, towards the first of
    them; ``flags`` (f, 3): tile, corner, edge.
    """

    n: int
    centres: np.ndarray
    corners: np.ndarray
    edges: np.ndarray
    sides: np.ndarray
    normals: np.ndarray
    flags: np.ndarray

    @classmethod
    def build(cls, n: int) -> Tiling:
        """The tiling; raises ValueError unless n is a whole number from 1 on."""
        if isinstance(n, bool) or int(n) != n or n < 1:
            raise ValueError(f"subdivision n = {n}; expected a whole number of at least 1")
        n = int(n)
        ico = np.array(
            [np.roll([0, a, b * PHI], k) for k in range(3) for a in (1, -1) for b in (1, -1)]
        )
        near = np.isclose(np.linalg.norm(ico[:, None] - ico, axis=2), 2)
        faces = [f for f in combinations(range(12), 3) if all(near[p] for p in combinations(f, 2))]
        # A vertex is known by its whole-numbered weights at the icosahedron's.
        weights, triangles = [], []
        for face in faces:
            at = {}
            for i in range(n + 1):
                for j in range(n + 1 - i):
                    at[i, j] = len(weights)
                    row = np.zeros(12, int)
                    row[list(face)] = i, j, n - i - j
                    weights.append(row)
            for i, j in list(at):
                if i + j < n:
                    triangles.append((at[i, j], at[i + 1, j], at[i, j + 1]))
                if i + j < n - 1:
                    triangles.append((at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]))
        rows, number = np.unique(np.array(weights), axis=0, return_inverse=True)
        centres = unit(rows @ ico)
        triangles = number.ravel()[np.array(triangles)]
        corners = unit(centres[triangles].sum(axis=1))
        pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        order = np.lexsort(pairs.T[::-1])
        sides = pairs[order[::2]]
        edges = np.stack([order[::2] // 3, order[1::2] // 3], axis=1)
        normals = unit(np.cross(corners[edges[:, 0]], corners[edges[:, 1]]))
        normals *= np.sign(np.einsum("ki,ki->k", normals, centres[sides[:, 0]]))[:, None]
        k = np.arange(len(edges))
        flags = np.concatenate(
            [np.stack([sides[:, a], edges[:, b], k], axis=1) for a in (0, 1) for b in (0, 1)]
        )
        return cls(n, centres, corners, edges, sides, normals, flags)

    @cached_property
    def degrees(self) -> np.ndarray:
        """Number of edges of each tile, (t,)."""
        return np.bincount(self.sides.ravel(), minlength=len(self.centres))

    @cached_property
    def middles(self) -> np.ndarray:
        """Middle of each edge, (k, 3)."""
        return unit(self.corners[self.edges].sum(axis=1))

    @cached_property
    def lengths(self) -> np.ndarray:
        """Straight length of each edge, in R, (k,)."""
        return np.linalg.norm(np.diff(self.corners[self.edges], axis=1)[:, 0], axis=1)

    def flags_in(self, part: str) -> np.ndarray:
        """The flags of the wedge, of the octant x, y, z ≥ 0, or of the whole sphere, (f, 3)."""
        tile, corner, edge = self.flags.T
        middle = self.centres[tile] + self.corners[corner] + self.middles[edge]
        return self.flags[(middle @ PARTS[part].T > 0).all(axis=1)]

    def inward(self, tile: np.ndarray, edge: np.ndarray) -> np.ndarray:
        """Normals of the edges' planes towards the tiles, (p, 3)."""
        sign = np.where(self.sides[edge, 0] == tile, 1.0, -1.0)
        return sign[:, None] * self.normals[edge]

    def angles(self, X: np.ndarray) -> np.ndarray:
        """Angle in radians from each direction of X (p, 3) to the arc of each edge, (p, k)."""
        x = unit(np.asarray(X, dtype=float))
        off = x @ self.normals.T
        beside = x @ self.middles.T / np.sqrt(np.maximum(1 - off**2, 1e-300))
        first, second = (x @ self.corners[self.edges[:, k]].T for k in (0, 1))
        return np.where(
            beside >= np.sqrt(1 - (self.lengths / 2) ** 2),
            np.abs(np.arcsin(np.clip(off, -1, 1))),
            np.arccos(np.clip(np.maximum(first, second), -1, 1)),
        )

    def nearest_edge(self, X: np.ndarray) -> np.ndarray:
        """Number of the edge whose arc is nearest to each direction of X (p, 3).

        The planes that halve the angles at a corner divide its three edges.
        """
        parts = [self.angles(X[k : k + 20000]).argmin(axis=1) for k in range(0, len(X), 20000)]
        return np.concatenate(parts)

    def tiles_of(self, X: np.ndarray, slack: float = 1e-9) -> list[np.ndarray]:
        """For each tile, which of the positions X (p, 3) lie in it, its rim included."""
        d = unit(np.asarray(X, dtype=float))
        out = []
        for tile in range(len(self.centres)):
            edge = np.flatnonzero((self.sides == tile).any(axis=1))
            normals = self.inward(np.full(len(edge), tile), edge)
            out.append(np.flatnonzero((d @ normals.T > -slack).all(axis=1)))
        return out


@dataclass(frozen=True)
class Lung:
    """Sizes in units of the epithelium's outer radius R (§3.3.1).

    ``n``: subdivision; ``epithelium``: thickness h_ep of the shell, inside R; ``muscle``: thickness
    h_sm of the cage, outside R, 0 for a bare shell; ``width`` w_sm of a bundle, on the sphere r = R
    (its sides are radial); None: 0.1 √3 l_sm with the tiling's own mean edge l_sm. The printed
    l_sm/R = 0.304, width 0.0527, belongs to no tiling with n = 2, whose edges are 0.346 and 0.353.

    Raises ValueError for sizes that are no lung: a shell thicker than its radius, bundles that
    fill their cells.
    """

    n: int = 2
    epithelium: float = 0.05
    muscle: float = 0.075
    width: float | None = None

    def __post_init__(self):
        if not 0 < self.epithelium < 1:
            raise ValueError(
                f"epithelium = {self.epithelium:g} R; expected a thickness between 0 and the "
                "radius, 1: the shell lies inside it"
            )
        if not (self.muscle >= 0 and np.isfinite(self.muscle)):
            raise ValueError(f"muscle = {self.muscle:g} R; expected a thickness, or 0 for no cage")
        widest = self.widest
        if not 0 < self.bundle < widest:
            raise ValueError(
                f"bundles {self.bundle:g} R wide; expected a width between 0 and {widest:.4g} R, "
                f"where they would fill the cells of the tiling n = {self.n}"
            )

    @cached_property
    def tiling(self) -> Tiling:
        """The tiling that the bundles follow."""
        return Tiling.build(self.n)

    @property
    def bundle(self) -> float:
        """Width of a bundle over R."""
        if self.width is not None:
            return self.width
        return float(0.1 * np.sqrt(3) * self.tiling.lengths.mean())

    @property
    def widest(self) -> float:
        """Width over R at which the first hole has lost an edge or its middle."""
        t = self.tiling
        tile, _, edge = t.flags.T
        apothem = np.einsum("fi,fi->f", t.inward(tile, edge), t.centres[tile]).min()
        low, high = 0.0, 2 * np.arcsin(apothem)
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (middle, high) if _open(t, middle) else (low, middle)
        return float(low)

    @property
    def spacing(self) -> float:
        """√3 l_sm, the distance between opposite bundles of a hexagon, over R."""
        return float(np.sqrt(3) * self.tiling.lengths.mean())


@dataclass(frozen=True, eq=False)
class Holes:
    """Where the rim of a hole meets the flags, unit vectors (f, 3).

    ``centre`` O, ``middle`` M and ``corner`` V of each flag; ``normal`` of its edge's plane towards
    the tile; ``at_middle`` M' on the arc from O to M and ``at_corner`` V', where two rims meet.
    """

    centre: np.ndarray
    middle: np.ndarray
    corner: np.ndarray
    normal: np.ndarray
    at_middle: np.ndarray
    at_corner: np.ndarray
    sine: float

    @classmethod
    def of(cls, t: Tiling, flags: np.ndarray, width: float) -> Holes:
        """The rims x · n = sin(w/2R) of bundles of that width."""
        tile, corner, edge = flags.T
        s = np.sin(width / 2)
        centre, M, V = t.centres[tile], t.middles[edge], t.corners[corner]
        n = t.inward(tile, edge)
        side = unit(centre - np.einsum("fi,fi->f", centre, M)[:, None] * M)
        sine = s / np.einsum("fi,fi->f", side, n)[:, None]
        at_middle = np.sqrt(np.maximum(1 - sine**2, 0)) * M + sine * side
        # The tile's other edge at this corner.
        key = t.flags[:, 0] * len(t.corners) + t.flags[:, 1]
        total = np.bincount(key, t.flags[:, 2], minlength=len(t.centres) * len(t.corners))
        other = total[tile * len(t.corners) + corner].astype(int) - edge
        m = t.inward(tile, other)
        a = s / (1 + np.einsum("fi,fi->f", n, m))[:, None]
        across = unit(np.cross(n, m))
        across *= np.sign(np.einsum("fi,fi->f", across, V))[:, None]
        rest = 1 - np.einsum("fi,fi->f", a * (n + m), a * (n + m))
        at_corner = a * (n + m) + np.sqrt(np.maximum(rest, 0))[:, None] * across
        return cls(centre, M, V, n, at_middle, at_corner, float(s))


def _open(t: Tiling, width: float) -> bool:
    """Whether bundles of this width leave every flag a piece of its hole."""
    holes = Holes.of(t, t.flags, width)
    turn = [
        np.einsum("fi,fi->f", np.cross(a, b), c)
        for a, b, c in (
            (holes.centre, holes.middle, holes.corner),
            (holes.centre, holes.at_middle, holes.at_corner),
        )
    ]
    return bool((turn[0] * turn[1] > 0).all())
