"""Mesh quality: how long, skewed and many the cells are, before anything is solved on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import skfem
from skfem.quadrature import get_quadrature

from solver.mesh.body import Body
from solver.mesh.checks import determinants, facets, orientation, parts
from solver.mesh.structured import PATHS

SAMPLES = 24


@dataclass(frozen=True)
class Quality:
    """Figures of a mesh; see :func:`quality`.

    ``aspect``: largest and median; 1 is a cube or a regular tetrahedron. ``scaled_jacobian``:
    smallest and median over the cells of the smallest at their corners; 1 is right-angled, or a
    regular tetrahedron, ≤ 0 inverted. ``bending``: smallest over largest det(∂X/∂ξ) within a
    cell, the least over the cells; 1 is straight. ``sizes``: shortest and longest edge, in the
    mesh's unit of length. ``through``: elements through the thickness of each sub-domain, least
    and median; empty unless a direction was given.
    """

    kind: str
    cells: int
    nodes: int
    parts: int
    inverted: int
    aspect: tuple[float, float]
    scaled_jacobian: tuple[float, float]
    bending: float
    sizes: tuple[float, float]
    through: dict[str, tuple[float, float]]

    def __str__(self) -> str:
        lines = [
            f"{self.cells} {self.kind}, {self.nodes} nodes, "
            f"{self.parts} part{'s' if self.parts > 1 else ''}",
            f"edges {self.sizes[0]:.3g} to {self.sizes[1]:.3g}",
            f"aspect ratio: largest {self.aspect[0]:.3g}, median {self.aspect[1]:.3g}",
            f"scaled Jacobian: smallest {self.scaled_jacobian[0]:.3g}, "
            f"median {self.scaled_jacobian[1]:.3g}; within a cell it falls to {self.bending:.3g}",
        ]
        if self.inverted:
            lines.append(f"{self.inverted} cells are inverted")
        lines += [
            f"elements through {name}: least {least:.2g}, median {median:.2g}"
            for name, (least, median) in self.through.items()
        ]
        return "\n".join(lines)


def quality(mesh: skfem.Mesh | Body, direction=None) -> Quality:
    """Quality of a mesh or a body's mesh.

    ``direction`` (3,) asks for the elements through the thickness: along lines in that direction
    through the centres of a sample of cells, the length inside each sub-domain (the whole mesh
    where none is named) over the mean extent of the cells crossed, weighted by the length crossed.
    Raises ValueError for a mesh that is not of hexahedra or tetrahedra, or a zero direction.
    """
    mesh = mesh.mesh if isinstance(mesh, Body) else mesh
    if not isinstance(mesh, skfem.MeshHex1 | skfem.MeshTet1):
        raise ValueError(f"{type(mesh).__name__}: expected a mesh of hexahedra or tetrahedra")
    hexes = isinstance(mesh, skfem.MeshHex1)
    ref = mesh.elem.refdom
    X = mesh.p[:, mesh.t]  # (3, corners, m)
    edges = np.stack([np.linalg.norm(X[:, a] - X[:, b], axis=0) for a, b in ref.edges])
    points = np.hstack([ref.p, mesh.elem().doflocs.T, get_quadrature(ref, 3)[0]])
    det, scaled = determinants(mesh, points)
    sign = orientation(scaled)[:, None]
    det = det * sign
    with np.errstate(divide="ignore", invalid="ignore"):
        if hexes:
            corner = (scaled * sign)[:, : mesh.nnodes].min(axis=1)
            along = ref.p[:, [b for _, b in ref.edges]] != ref.p[:, [a for a, _ in ref.edges]]
            mean = np.stack([edges[axis].mean(axis=0) for axis in along])
            aspect = mean.max(axis=0) / mean.min(axis=0)
        else:
            corner, aspect = _tetrahedra(X, edges)
        bending = det.min(axis=1) / det.max(axis=1)
    n, _ = parts(facets(mesh))
    through = {} if direction is None else _through(mesh, np.asarray(direction, dtype=float))
    return Quality(
        kind=("quadratic " if mesh.doflocs.shape[1] > mesh.nvertices else "")
        + ("hexahedra" if hexes else "tetrahedra"),
        cells=mesh.t.shape[1],
        nodes=mesh.doflocs.shape[1],
        parts=int(n),
        inverted=int((det <= 0).any(axis=1).sum()),
        aspect=(float(aspect.max()), float(np.median(aspect))),
        scaled_jacobian=(float(corner.min()), float(np.median(corner))),
        bending=float(bending.min()),
        sizes=(float(edges.min()), float(edges.max())),
        through=through,
    )


def _tetrahedra(X: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scaled Jacobian, and longest edge over shortest height; both 1 if regular."""
    volume = np.abs(
        np.einsum(
            "im,im->m", np.cross(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0], axis=0), X[:, 3] - X[:, 0]
        )
    )
    at = {frozenset(e): i for i, e in enumerate(skfem.ElementTetP1.refdom.edges)}
    product = np.stack(
        [
            np.prod([edges[at[frozenset((a, b))]] for b in range(4) if b != a], axis=0)
            for a in range(4)
        ]
    )
    faces = np.stack(
        [
            np.linalg.norm(np.cross(X[:, b] - X[:, a], X[:, c] - X[:, a], axis=0), axis=0)
            for a, b, c in skfem.ElementTetP1.refdom.facets
        ]
    )
    height = volume / faces.max(axis=0)
    return np.sqrt(2) * volume / product.max(axis=0), np.sqrt(2 / 3) * edges.max(axis=0) / height


def _through(mesh: skfem.Mesh, d: np.ndarray) -> dict[str, tuple[float, float]]:
    if d.shape != (3,) or not np.linalg.norm(d) > 0:
        raise ValueError(f"direction {d}: expected three numbers, not all 0")
    d = d / np.linalg.norm(d)
    frame = np.linalg.svd(d[None])[2][1:]  # two directions across
    X = mesh.p[:, mesh.t]
    across, height = np.einsum("di,ikm->dkm", frame, X), np.einsum("i,ikm->km", d, X)
    low, high = across.min(axis=1), across.max(axis=1)
    extent = np.ptp(height, axis=0)
    tetrahedra = [list(range(4))]
    if mesh.nnodes == 8:
        at = {round(c @ (1, 2, 4)): a for a, c in enumerate(mesh.elem.refdom.p.T)}
        tetrahedra = [[at[0], at[i], at[j], at[7]] for i, j in PATHS]
    named = mesh.subdomains or {"the mesh": np.arange(mesh.t.shape[1])}
    counted = {}
    for name, chosen in named.items():
        chosen = np.asarray(chosen)
        counts = []
        for cell in chosen[np.linspace(0, len(chosen) - 1, min(SAMPLES, len(chosen))).astype(int)]:
            p = across[:, :, cell].mean(axis=1)
            # Off the centre by odd fractions of the cell, so that the line meets no edge.
            p = p + (high - low)[:, cell] * (0.0137, 0.0071)
            hit = ((low[:, chosen] <= p[:, None]) & (p[:, None] <= high[:, chosen])).all(axis=0)
            crossed = chosen[hit]
            chord = sum(
                _chord(across[:, t][:, :, crossed] - p[:, None, None], height[t][:, crossed])
                for t in tetrahedra
            )
            if chord.sum() > 0:
                counts.append(chord.sum() ** 2 / (chord @ extent[crossed]))
        counted[name] = (float(np.min(counts)), float(np.median(counts)))
    return counted


def _chord(a: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Length along the line a = 0 inside tetrahedra with corners at (a, h): (2, 4, m), (4, m)."""
    lo, hi = np.full(a.shape[2], np.inf), np.full(a.shape[2], -np.inf)
    for i, j, k in skfem.ElementTetP1.refdom.facets:
        # Barycentric coordinates of the line in the facet's projection.
        area = _cross(a[:, j] - a[:, i], a[:, k] - a[:, i])
        with np.errstate(divide="ignore", invalid="ignore"):
            weights = (
                np.stack(
                    [_cross(a[:, j], a[:, k]), _cross(a[:, k], a[:, i]), _cross(a[:, i], a[:, j])]
                )
                / area
            )
            inside = (area != 0) & (weights >= 0).all(axis=0)
            at = (weights * h[[i, j, k]]).sum(axis=0)
        lo = np.where(inside, np.minimum(lo, at), lo)
        hi = np.where(inside, np.maximum(hi, at), hi)
    return np.maximum(hi - lo, 0)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[1] - a[1] * b[0]
