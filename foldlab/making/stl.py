"""Closed surfaces as binary STL, lengths in mm, one file per layer: a print takes a material each.

STL has no units; the header says mm, and numbers have 24 binary digits.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from foldlab.making.geometry import Geometry

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def stl(points: np.ndarray, triangles: np.ndarray, name: str) -> bytes:
    """The content of a file: ``points`` (n, 3), ``triangles`` (m, 3), outward, counterclockwise."""
    corners = np.asarray(points, float)[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    rows = np.zeros(len(corners), RECORD)
    rows["normal"] = np.divide(normals, size, out=np.zeros_like(normals), where=size > 0)
    rows["corners"] = corners
    header = f"foldlab {name}, mm".encode("ascii", "replace")[:80].ljust(80)
    return header + np.uint32(len(rows)).astype("<u4").tobytes() + rows.tobytes()


def flat(unit: Geometry, layer: str) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a layer of the flat unit; strips are closed surfaces each."""
    if layer == "passive":
        vertices, faces = unit.facets()
        return _prism(vertices, faces, 0.0, unit.thickness)
    low, high = unit.thickness, unit.thickness + unit.active_thickness
    points, triangles, count = [], [], 0
    for patch in unit.patches:
        p, t = _prism(patch, [[0, 1, 2, 3]], low, high)
        points.append(p)
        triangles.append(t + count)
        count += len(p)
    return np.vstack(points), np.vstack(triangles)


def _prism(vertices: np.ndarray, faces: list[list[int]], low: float, high: float):
    """Over polygons side by side, between two heights."""
    n = len(vertices)
    points = np.vstack([np.column_stack([vertices, np.full(n, z)]) for z in (low, high)])
    tops = np.vstack([_fan(vertices, face) for face in faces])
    edges = [(a, b) for f in faces for a, b in zip(f, [*f[1:], f[0]], strict=True)]
    border = np.array([e for e in edges if e[::-1] not in set(edges)])
    a, b = border.T
    walls = np.vstack([np.column_stack([a, b, b + n]), np.column_stack([a, b + n, a + n])])
    return points, np.vstack([tops[:, ::-1], tops + n, walls])


def _fan(vertices: np.ndarray, face: list[int]) -> np.ndarray:
    """Triangles of a convex polygon, around the corner that makes none of them flat."""
    fans = []
    for k in range(len(face)):
        first, *rest = [*face[k:], *face[:k]]
        fan = np.array([(first, a, b) for a, b in pairwise(rest)])
        x, y = (vertices[fan[:, c]] - vertices[fan[:, 0]] for c in (1, 2))
        fans.append((float(np.min(x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0])), k, fan))
    return max(fans, key=lambda f: f[:2])[2]
