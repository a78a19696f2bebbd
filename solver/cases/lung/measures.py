"""What is measured on a lung: corrugation depth, fibre spacing, aspect ratio, thickness.

Depth: largest less smallest radial displacement u · N of the epithelium (§3.5). Spacing: twice the
distance of a tile's deformed bundles, at the middle of their edges on r = R, from the tile's axis,
in the mean over its edges; of a hexagon's opposite bundles that is their distance. Aspect ratio:
depth over spacing. Of the whole lung: depth over all of the epithelium, mean spacing of the tiles.
Thickness: 1/|F⁻ᵀN| over the undeformed one, the distance of neighbouring layers r = const.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from solver.cases.lung.geometry import Lung, unit
from solver.cases.lung.model import part_of
from solver.mesh.body import Body


@dataclass(frozen=True)
class Cell:
    """One tile, or all that the body's symmetry makes equal: ``number`` on the whole sphere."""

    tile: int
    edges: int
    number: float
    depth: float
    spacing: float

    @property
    def aspect(self) -> float:
        """Depth over spacing."""
        return self.depth / self.spacing


@dataclass(frozen=True)
class Measures:
    """Lowest and highest radial displacement of the epithelium and the spacing in R, the cells, and
    the epithelium's thickness over h_ep.

    ``thinnest``, ``thickest``: quantiles of 1 and 99 % of the reference volume, for corners are
    singular; ``variation``: standard deviation over mean; ``inverted``: fraction of the volume
    that is turned inside out, which only the primitive model allows.
    """

    lowest: float
    highest: float
    spacing: float
    cells: tuple[Cell, ...]
    thinnest: float
    thickest: float
    mean_thickness: float
    variation: float
    inverted: float

    @property
    def depth(self) -> float:
        """Highest less lowest, in R."""
        return self.highest - self.lowest

    @property
    def aspect(self) -> float:
        """Depth over spacing."""
        return self.depth / self.spacing


def radial(body: Body, u: np.ndarray) -> np.ndarray:
    """u · N of every node, (n,)."""
    return np.einsum("ni,ni->n", u, unit(body.nodes))


def measure(body: Body, lung: Lung, u: np.ndarray) -> Measures:
    """Measures of the displacement u (n, 3) of any part of the lung.

    Raises ValueError if the middle of an edge is no node of the body.
    """
    t, part = lung.tiling, part_of(body)
    flags = t.flags_in(part)
    times = len(t.flags) / len(flags)
    shell = np.unique(body.cells[body.cells_of("epithelium")])
    out = radial(body, u)[shell]
    middles = t.middles[flags[:, 2]]
    gap, node = cKDTree(body.nodes).query(middles)
    if gap.max() > 1e-6:
        raise ValueError("the middle of an edge is no node; take a mesh that the builders made")
    at = middles + u[node]
    axis = t.centres[flags[:, 0]]
    away = np.linalg.norm(at - np.einsum("fi,fi->f", at, axis)[:, None] * axis, axis=1)
    inside = t.tiles_of(body.nodes[shell])
    cells = []
    for tile in np.unique(flags[:, 0]):
        mine, edges = flags[:, 0] == tile, int(t.degrees[tile])
        number = times * mine.sum() / (2 * edges)
        depth, spacing = np.ptp(out[inside[tile]]), 2 * away[mine].mean()
        cells.append(Cell(int(tile), edges, float(number), float(depth), float(spacing)))
    spacing = np.average([c.spacing for c in cells], weights=[c.number for c in cells])
    ratio, weights, inverted = thickness(body, u)
    order = np.argsort(ratio)
    volume = np.cumsum(weights[order]) / weights.sum()
    thin, thick = (ratio[order][np.searchsorted(volume, q)] for q in (0.01, 0.99))
    mean = np.average(ratio, weights=weights)
    spread = np.sqrt(np.average((ratio - mean) ** 2, weights=weights))
    return Measures(
        float(out.min()), float(out.max()), float(spacing), tuple(cells), float(thin), float(thick),
        float(mean), float(spread / mean), inverted,
    )  # fmt: skip


def thickness(body: Body, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Thickness ratios of the epithelium's points (p,), their volumes (p,), fraction inverted."""
    ids = np.flatnonzero(body.cells_of("epithelium"))
    F = np.eye(3) + np.einsum("mki,mqkj->mqij", u[body.cells[ids]], body.gradients[ids])
    N, weights = unit(body.points()[ids]), body.weights[ids]
    across = np.linalg.norm(np.einsum("mqji,mqj->mqi", np.linalg.inv(F), N), axis=-1)
    turned = np.linalg.det(F) <= 0
    return (1 / across).ravel(), weights.ravel(), float(weights[turned].sum() / weights.sum())


@dataclass(frozen=True)
class Section:
    """The cut x = 0 from the pentagon's axis over a bundle to the hexagon's, deformed (p, 2): y, z.

    ``lines``: the epithelium's inner and outer face; ``bundle``: the outline of the muscle, closed.
    """

    lines: tuple[np.ndarray, np.ndarray]
    bundle: np.ndarray

    @property
    def sharpest(self) -> float:
        """Largest curvature R κ of the inner face, from circles through three neighbours; at the
        hexagon's axis too, a mirror of the cut."""
        p = self.lines[0]
        p = np.concatenate([p[1:2] * (-1, 1), p])
        a, b, c = p[:-2], p[1:-1], p[2:]
        sides = [np.linalg.norm(d, axis=1) for d in (b - a, c - b, c - a)]
        (x1, y1), (x2, y2) = (b - a).T, (c - a).T
        return float((2 * np.abs(x1 * y2 - x2 * y1) / np.prod(sides, axis=0)).max())

    @property
    def overlaps(self) -> bool:
        """Whether the epithelium's outer face enters the bundle: contact is not modelled."""
        if not len(self.bundle):
            return False
        middle = self.bundle.mean(axis=0)
        # A little smaller, so that the common face is outside.
        a = middle + 0.98 * (self.bundle - middle)
        b, p = np.roll(a, -1, axis=0), self.lines[1][:, None]
        crosses = (a[:, 1] > p[..., 1]) != (b[:, 1] > p[..., 1])
        step = np.where(b[:, 1] == a[:, 1], np.inf, b[:, 1] - a[:, 1])
        at = a[:, 0] + (p[..., 1] - a[:, 1]) / step * (b[:, 0] - a[:, 0])
        return bool(((crosses & (p[..., 0] < at)).sum(axis=1) % 2).any())


def section(body: Body, lung: Lung, u: np.ndarray) -> Section:
    """The cut x = 0 of the wedge; raises ValueError for another part or subdivision n ≠ 2."""
    if part_of(body) != "wedge" or lung.n != 2:
        raise ValueError("the section is one of the wedge with n = 2")
    X = body.nodes
    r, on = np.linalg.norm(X, axis=1), np.abs(X[:, 0]) < 1e-9
    angle = np.arctan2(X[:, 1], X[:, 2])

    def line(nodes):
        nodes = np.flatnonzero(nodes)
        nodes = nodes[np.argsort(angle[nodes])]
        return (X + u)[nodes][:, 1:]

    faces = tuple(line(on & (np.abs(r - s) < 1e-9)) for s in (1 - lung.epithelium, 1.0))
    bundle = np.zeros((0, 2))
    if lung.muscle:
        cage = np.zeros(len(X), bool)
        cage[np.unique(body.cells[body.cells_of("muscle")])] = True
        cage &= on
        low, high = angle[cage].min(), angle[cage].max()
        foot, top = (line(cage & (np.abs(r - s) < 1e-9)) for s in (1.0, 1 + lung.muscle))
        sides = []
        for end in (low, high):
            nodes = np.flatnonzero(cage & (np.abs(angle - end) < 1e-9))
            sides.append((X + u)[nodes[np.argsort(r[nodes])]][:, 1:])
        bundle = np.concatenate([foot, sides[1], top[::-1], sides[0][::-1]])
    return Section(faces, bundle)
