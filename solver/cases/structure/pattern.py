"""A crease pattern with hinges of finite length: panels, and the strips that fold between them.

Faces meet at creases. A hinge of length l lies on its crease and takes l/2 of either face; what the
hinges leave of a face is its panel. A hinge is as wide as its crease where both panels still face
each other, so that around an inner vertex, where strips would overlap, the sheet has a hole.
x and y lie in the flat sheet, z up; lengths in one unit, m by default.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from scipy.spatial import cKDTree

from solver.given import numbers

TOLERANCE = 1e-9  # of the pattern's extent, below which lengths are nothing


@dataclass(frozen=True)
class Crease:
    """A fold between two faces.

    ``ends``: its two vertices; ``fold``: +1 for a valley (the active layer lies above and panels
    rise), −1 for a mountain, 0 for one that only bends; ``length``: of its hinge, along the sheet;
    ``start``, ``end``: loads e between which its layer contracts, so that folding has an order.
    """

    ends: tuple[int, int]
    fold: int
    length: float
    start: float = 0.0
    end: float = 1.0

    def __post_init__(self):
        if self.fold not in (-1, 0, 1):
            raise ValueError(
                f"crease {self.ends}: fold = {self.fold!r}; expected 1 (valley), -1 (mountain), 0"
            )
        if not (np.isfinite(self.length) and self.length > 0):
            raise ValueError(
                f"crease {self.ends}: hinge length = {self.length!r}; expected a number above 0"
            )
        if not 0 <= self.start < self.end <= 1:
            raise ValueError(
                f"crease {self.ends}: active from {self.start!r} to {self.end!r}; expected "
                "0 <= start < end <= 1"
            )


@dataclass(frozen=True, eq=False)
class Hinge:
    """Where a crease's strip is. ``faces``: a and b; ``sides``
    (2, 2): middle of the strip's edge on a and on b; ``axis`` (2,): unit vector along the fold,
    with a on its right hand, so that axis × (from a to b) points up; ``width``: along the axis."""

    crease: Crease
    faces: tuple[int, int]
    sides: np.ndarray
    axis: np.ndarray
    width: float


@dataclass(frozen=True, eq=False)
class Pattern:
    """``vertices`` (n, 2), ``faces``: vertex numbers of each, in order around it, ``creases``.

    ``panels``: outline (k, 2) of what hinges leave of each face, counter-clockwise; ``hinges``: one
    per crease. Raises ValueError, saying where, for faces that are open, overlap or cross
    themselves, creases that don't part two faces, and hinges that leave no panel or no width.
    """

    vertices: np.ndarray
    faces: Sequence[Sequence[int]]
    creases: Sequence[Crease]
    panels: tuple[np.ndarray, ...] = field(init=False)
    hinges: tuple[Hinge, ...] = field(init=False)

    def __post_init__(self):
        set_ = object.__setattr__
        vertices = numbers("vertices", self.vertices)
        if vertices.ndim != 2 or vertices.shape[1] != 2 or not np.isfinite(vertices).all():
            raise ValueError(f"vertices of shape {vertices.shape}; expected (n, 2), finite")
        set_(self, "vertices", vertices)
        set_(self, "faces", tuple(_face(face, k, vertices) for k, face in enumerate(self.faces)))
        set_(self, "creases", tuple(self.creases))
        if not self.faces:
            raise ValueError("the pattern has no faces")
        borders = self._borders()
        parts = {frozenset(c.ends): c for c in self.creases}
        if len(parts) < len(self.creases):
            twice = Counter(frozenset(c.ends) for c in self.creases).most_common(1)[0][0]
            raise ValueError(f"the crease {sorted(twice)} is given twice")
        for ends in parts:
            if len(borders.get(ends, ())) != 2:
                raise ValueError(
                    f"the crease {sorted(ends)} borders {len(borders.get(ends, ()))} faces; "
                    "expected two"
                )
        loose = [sorted(e) for e, sides in borders.items() if len(sides) == 2 and e not in parts]
        if loose:
            raise ValueError(
                f"the edge {loose[0]} lies between two faces and is no crease; give it a fold, or "
                "join the faces"
            )
        set_(self, "panels", tuple(self._panel(k, parts) for k in range(len(self.faces))))
        set_(self, "hinges", tuple(self._hinge(c, borders) for c in self.creases))
        self._refuse_overlaps()

    @property
    def extent(self) -> float:
        """Largest extent of the flat sheet."""
        return float(np.ptp(self.vertices, axis=0).max())

    def _borders(self) -> dict[frozenset, list[int]]:
        """The faces on each edge."""
        borders: dict[frozenset, list[int]] = {}
        directed: set[tuple[int, int]] = set()
        for k, face in enumerate(self.faces):
            for a, b in zip(face, np.roll(face, -1).tolist(), strict=True):
                if (a, b) in directed:
                    raise ValueError(f"two faces lie on the same side of the edge [{a}, {b}]")
                directed.add((a, b))
                borders.setdefault(frozenset((a, b)), []).append(k)
        return borders

    def _panel(self, k: int, parts: dict) -> np.ndarray:
        """The face with each crease's edge moved inwards by half of its hinge."""
        face = self.faces[k]
        X = self.vertices[list(face)]
        along = np.roll(X, -1, axis=0) - X
        inward = np.stack([-along[:, 1], along[:, 0]], axis=1)
        inward /= np.linalg.norm(along, axis=1)[:, None]
        edges = [frozenset((a, b)) for a, b in zip(face, np.roll(face, -1).tolist(), strict=True)]
        by = np.array([parts[e].length / 2 if e in parts else 0.0 for e in edges])
        out = np.empty_like(X)
        for i in range(len(X)):
            # The corner at which edge i − 1 and edge i meet, moved inwards by their distances.
            before, after = inward[i - 1], inward[i]
            turn = before[0] * after[1] - before[1] * after[0]
            if abs(turn) > 1e-6:
                out[i] = X[i] + np.linalg.solve(
                    np.array([before, after]), np.array([by[i - 1], by[i]])
                )
            elif abs(by[i - 1] - by[i]) < TOLERANCE * self.extent:
                out[i] = X[i] + by[i] * after
            else:
                raise ValueError(
                    f"face {k}: hinges of different lengths meet at vertex {face[i]} on a straight "
                    "edge; give them one length, or a corner"
                )
        kept = np.roll(out, -1, axis=0) - out
        if ((kept * along).sum(axis=1) <= 0).any() or not shapely.Polygon(out).is_valid:
            wide = max((parts[e] for e in edges if e in parts), key=lambda c: c.length)
            raise ValueError(
                f"face {k}: its hinges leave no panel of it; the longest, on the crease "
                f"{sorted(wide.ends)}, takes {wide.length / 2:.4g} of it"
            )
        return out

    def _hinge(self, crease: Crease, borders) -> Hinge:
        i, j = crease.ends
        a, b = borders[frozenset(crease.ends)]
        # Face a has its crease's edge in the sense (i, j) with the face on its left: turned about,
        # a lies on the right of the axis.
        around = self.faces[a]
        if (i, j) in zip(around, np.roll(around, -1).tolist(), strict=True):
            i, j = j, i
        axis = self.vertices[j] - self.vertices[i]
        axis = axis / np.linalg.norm(axis)
        middle = (self.vertices[i] + self.vertices[j]) / 2
        spans = []
        for face, ends in ((a, (j, i)), (b, (i, j))):
            k = self.faces[face].index(ends[0])
            X = self.panels[face][[k, (k + 1) % len(self.faces[face])]]
            spans.append(np.sort((X - middle) @ axis))
        low, high = max(s[0] for s in spans), min(s[1] for s in spans)
        if high - low <= TOLERANCE * self.extent:
            raise ValueError(
                f"the hinge on the crease {sorted(crease.ends)} is left no width between its "
                f"panels; its length {crease.length:.4g} is too long"
            )
        across = np.array([-axis[1], axis[0]])  # from a to b: axis × across is up
        centre = middle + (low + high) / 2 * axis
        half = crease.length / 2 * across
        return Hinge(crease, (a, b), np.stack([centre - half, centre + half]), axis, high - low)

    def _refuse_overlaps(self) -> None:
        """Raises ValueError for faces that cover each other: creases that cross, say."""
        areas = [shapely.Polygon(self.vertices[list(face)]) for face in self.faces]
        tree = shapely.STRtree(areas)
        for i, j in tree.query(areas, predicate="intersects").T:
            common = areas[i].intersection(areas[j]).area if i < j else 0.0
            if common > TOLERANCE * self.extent**2:
                raise ValueError(
                    f"the faces {i} and {j} overlap; put a vertex where creases cross, and give "
                    "each face its own outline"
                )


def _face(face, k: int, vertices: np.ndarray) -> tuple[int, ...]:
    """Its vertices counter-clockwise; raises ValueError for what is no simple polygon."""
    try:
        corners = tuple(int(v) for v in face)
    except (TypeError, ValueError) as error:
        raise ValueError(f"face {k} is {face!r:.60}; expected vertex numbers") from error
    n = len(vertices)
    if len(corners) < 3 or len(set(corners)) < len(corners):
        raise ValueError(f"face {k} has the vertices {corners}; expected three or more, each once")
    if min(corners) < 0 or max(corners) >= n:
        raise ValueError(f"face {k} names a vertex {max(corners)}; there are {n}, from 0 on")
    X = vertices[list(corners)]
    area = area_of(X)
    if abs(area) <= TOLERANCE * np.ptp(vertices, axis=0).max() ** 2:
        raise ValueError(f"face {k} has no area")
    if not shapely.Polygon(X).is_valid:
        raise ValueError(f"the outline of face {k} crosses or touches itself")
    return corners if area > 0 else corners[::-1]


def area_of(X: np.ndarray) -> float:
    """Signed area of a polygon (k, 2), positive counter-clockwise."""
    Y = np.roll(X, -1, axis=0)
    return float((X[:, 0] * Y[:, 1] - X[:, 1] * Y[:, 0]).sum() / 2)


def triangles(X: np.ndarray) -> np.ndarray:
    """Corners (t, 3) of triangles that fill a simple polygon (k, 2), counter-clockwise."""
    parts = shapely.constrained_delaunay_triangles(shapely.Polygon(X)).geoms
    corners = np.array([np.array(part.exterior.coords)[:3] for part in parts])
    at = cKDTree(X).query(corners)[1]
    return np.where((np.array([area_of(X[t]) for t in at]) > 0)[:, None], at, at[:, ::-1])
