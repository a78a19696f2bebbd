"""The lung's flat model (Fig. 3.8): a hexagonal mesh that contracts on a film that floats on water.

One mirror wedge of the pattern, a twelfth of a hexagon: the triangle between the hexagon's centre
O = (0, 0), the middle of an edge M = (½ spacing, 0) and the corner there. Bundles lie on the film
along the edges; the film's lower side z = 0 is on the water, whose pressure is that of the current
height. The sheet is one of many alike and free to shrink: the planes through O stay, the plane of
the edge moves as a whole. Lengths in units of the caller's, stresses in E of the film.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import skfem

from solver.equilibrium.scene import Scene
from solver.given import number, whole
from solver.mesh.body import Body
from solver.mesh.structured import box, weld
from solver.physics.elastic import Elastic
from solver.physics.growth import AlongFibre
from solver.physics.loads import Floating
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, Row

COS, SIN = np.cos(np.pi / 6), np.sin(np.pi / 6)
NEAR = 1e-6  # of the spacing: nodes on a plane
OVER = np.array([-SIN, COS, 0.0])  # normal of the mirror plane through O and the corner


@dataclass(frozen=True)
class Film:
    """``spacing`` of opposite bundles of a hexagon, ``width`` and ``height`` of a bundle,
    ``thickness`` of the film, ``stiffness`` of the bundles over the film's, ``weight`` of the
    liquid: its specific weight over E and per length; Poisson's ratio ``nu`` of both.

    Raises ValueError for sizes that are not above 0 and bundles that fill their cells.
    """

    spacing: float = 1.0
    width: float = 0.1
    height: float = 0.1
    thickness: float = 0.05
    stiffness: float = 75.0
    weight: float = 1e-3
    nu: float = 0.3

    def __post_init__(self):
        for name in ("spacing", "width", "height", "thickness", "stiffness", "weight"):
            number(name, getattr(self, name), above=0)
        if not self.width < self.spacing:
            raise ValueError(
                f"width = {self.width:g}; expected less than the spacing {self.spacing:g}, where "
                "bundles would fill their cells"
            )

    def body(self, cells: int = 2, element: str = "hex27") -> Body:
        """The wedge with ``cells`` along each half of the hole's rim; sub-domains "film" and
        "muscle". Raises ValueError for cells below 1."""
        whole("cells", cells, 1)
        M = np.array([self.spacing / 2, 0.0])
        V = np.array([M[0], M[0] * SIN / COS])
        f = 1 - self.width / self.spacing
        centre, m, v = 0 * M, f * M, f * V
        g, sides = (m + v) / 3, (m / 2, (m + v) / 2, v / 2)
        hole = [
            (centre, sides[0], g, sides[2]), (sides[0], m, sides[1], g), (sides[2], g, sides[1], v),
        ]  # fmt: skip
        strip = [(m, M, (M + V) / 2, sides[1]), (sides[1], (M + V) / 2, V, v)]
        low, high = [0.0, self.thickness], [self.thickness, self.thickness + self.height]
        pieces = [_patch(quad, cells, cells, low) for quad in hole]
        pieces += [_patch(quad, 1, cells, low) for quad in strip]
        pieces += [_patch(quad, 1, cells, high) for quad in strip]
        mesh = pieces[0]
        for piece in pieces[1:]:
            mesh = mesh + piece
        mesh = weld(skfem.MeshHex(mesh.p, mesh.t))
        top = mesh.p[2, mesh.t].mean(axis=0) > self.thickness
        names = {"film": np.flatnonzero(~top), "muscle": np.flatnonzero(top)}
        return Body.build(mesh.with_subdomains(names), element)


def _patch(corners, along: int, across: int, z) -> skfem.MeshHex:
    """A quadrilateral of the plane over an interval of z: cells along its first side and across."""
    a, b, c, d = (np.asarray(p) for p in corners)

    def bilinear(X):
        s, t = X[:, :1], X[:, 1:2]
        flat = (1 - s) * (1 - t) * a + s * (1 - t) * b + s * t * c + (1 - s) * t * d
        return np.hstack([flat, X[:, 2:]])

    s, t = (np.linspace(0, 1, n + 1) for n in (along, across))
    return box(s, t, z, shape=bilinear, quadratic=False)


def scene(film: Film, body: Body, contraction: float) -> Scene:
    """The film on the water; the muscle contracts along its bundles by e · ``contraction`` (below
    0). Raises ValueError for a contraction of -1 and below."""
    if not number("contraction", contraction) > -1:
        raise ValueError(f"contraction = {contraction:g}; expected more than -1")
    X = body.nodes
    muscle = body.cells_of("muscle")
    along = np.broadcast_to([0.0, 1.0, 0.0], (*body.weights.shape, 3))
    growth = AlongFibre(lambda e: e * contraction, along, cells=muscle)
    E = np.where(muscle, film.stiffness, 1.0)
    terms = [
        Elastic(body, NeoHookean(E, film.nu), growth),
        Floating(body, body.surface(lambda X: X[:, 2] < NEAR * film.spacing), film.weight),
    ]
    fixed = [
        Fixed(body.nodes_where(lambda X: np.abs(X[:, 1]) < NEAR * film.spacing), [0, 1, 0]),
        Fixed(body.nodes_where(lambda X: np.abs(X @ OVER) < NEAR * film.spacing), OVER),
    ]
    edge = np.flatnonzero(np.abs(X[:, 0] - film.spacing / 2) < NEAR * film.spacing)
    rows = []
    for node in edge[1:]:
        c = np.zeros_like(X)
        c[node, 0], c[edge[0], 0] = 1.0, -1.0
        rows.append(Row(c, name="edge's plane"))
    return Scene(body, terms, fixed=fixed, rows=rows)


@dataclass(frozen=True)
class Measures:
    """Depth of the corrugation, highest less lowest of the film's lower side; the deformed spacing;
    the height of the hexagon's centre and of the edge's middle."""

    depth: float
    spacing: float
    centre: float
    edge: float

    @property
    def aspect(self) -> float:
        """Depth over spacing."""
        return self.depth / self.spacing


def measure(film: Film, body: Body, u: np.ndarray) -> Measures:
    """Measures of a displacement u (n, 3)."""
    X = body.nodes
    low = np.flatnonzero(X[:, 2] < NEAR * film.spacing)
    z = (X + u)[low, 2]
    r = np.linalg.norm(X[low, :2], axis=1)
    middle = np.linalg.norm(X[low, :2] - [film.spacing / 2, 0], axis=1).argmin()
    return Measures(
        float(np.ptp(z)), float(2 * (X + u)[low[middle], 0]), float(z[r.argmin()]),
        float(z[middle]),
    )  # fmt: skip
