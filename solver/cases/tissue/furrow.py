"""Ventral furrow (§5.5.4): an ellipsoidal shell whose outer, apical side contracts ventrally.

x runs along the embryo, z from ventral (−) to dorsal; lengths in units of its half length. A
quarter, x ≥ 0 and y ≥ 0, between two mirror planes. The mesh is that of a cube's surface blown up,
so that there are no poles; hexahedra are shortest across the ventral midline. β is 1 on the
midline's outer side and falls off around the embryo, towards the ends and inwards: an analytic
stand-in for the staining intensities of the dissertation, whose images and sizes are not ours.

The cavity may be full of ``yolk`` that resists a change of its volume; empty by default.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import skfem

from solver.cases.levels import sizes_of
from solver.cases.tissue.model import Beta, Model, Tissue, enclosed, meshed
from solver.mesh.body import Body, Surface
from solver.mesh.structured import box, curved, graded, weld
from solver.physics.pressure import Enclosed
from solver.physics.supports import Fixed


@dataclass(frozen=True)
class Shape:
    """Outer semi-axes along x and across, and the shell's thickness.

    ``angle``: half width of the furrow's pattern around the embryo in rad; ``reach``: half length
    of it along x. Raises ValueError for a thickness that leaves no cavity and sizes ≤ 0.
    """

    long: float = 1.0
    across: float = 0.4
    thickness: float = 0.05
    angle: float = 0.3
    reach: float = 0.65

    def __post_init__(self):
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"{name} = {value}; expected a number > 0")
        if not self.thickness < min(self.long, self.across):
            raise ValueError(
                f"thickness = {self.thickness}; expected less than the semi-axes {self.long} and "
                f"{self.across}, so that there is a cavity"
            )

    def place(self, depth: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Position of a fraction of the thickness (0 inside, 1 outside) in a direction (n, 3)."""
        outer = np.array([self.long, self.across, self.across])
        return direction * (outer - self.thickness * (1 - depth[:, None]))

    def depth(self, X: np.ndarray) -> np.ndarray:
        """The fraction of the thickness at positions (..., 3)."""
        outer = np.array([self.long, self.across, self.across])
        depth = np.full(X.shape[:-1], 0.5)
        for _ in range(30):
            axes = outer - self.thickness * (1 - depth[..., None])
            value = (X**2 / axes**2).sum(-1) - 1
            depth = depth + value / (2 * self.thickness * (X**2 / axes**3).sum(-1))
        return depth

    def beta(self, X: np.ndarray) -> np.ndarray:
        """The pattern at positions (..., 3), in [0, 1]."""
        around = np.arctan2(np.abs(X[..., 1]), -X[..., 2])
        inward = np.clip(self.depth(X), 0, 1)
        along = np.exp(-((X[..., 0] / self.reach) ** 4))
        return np.exp(-((around / self.angle) ** 2)) * along * inward**2


@dataclass(frozen=True)
class Counts:
    """Elements along the half length, from midline to side, from ventral to dorsal, and through
    the thickness; ``ratio``: longest over shortest step from the midline to the side."""

    along: int = 6
    side: int = 6
    round: int = 8
    through: int = 2
    ratio: float = 2.0


LEVELS = (
    Counts(4, 5, 5, 1),
    Counts(6, 8, 8, 2),
    Counts(8, 12, 12, 2),
    Counts(12, 16, 16, 3),
)


def mesh(shape: Shape, counts: Counts, element: str) -> skfem.Mesh:
    """Quarter of the shell, quadratic; tetrahedra where the element has them."""
    x = graded(0, 1, counts.along, toward="a", ratio=1)
    y = graded(0, 1, counts.side, toward="a", ratio=counts.ratio)
    z = graded(-1, 1, counts.round, ratio=1)
    s = np.linspace(1, 2, counts.through + 1)
    # Patches of the cube max|x| = s, each box (s, p, q) with a right-handed order of axes.
    patches = [
        box(s, y, z, shape=lambda X: X[:, :1] * _at(1, X[:, 1], X[:, 2]), quadratic=False),
        box(s, z, x, shape=lambda X: X[:, :1] * _at(X[:, 2], 1, X[:, 1]), quadratic=False),
        box(s, x, y, shape=lambda X: X[:, :1] * _at(X[:, 1], X[:, 2], 1), quadratic=False),
        box(s, y, x, shape=lambda X: X[:, :1] * _at(X[:, 2], X[:, 1], -1), quadratic=False),
    ]
    whole = patches[0]
    for patch in patches[1:]:
        whole = whole + patch
    whole = weld(skfem.MeshHex(whole.p, whole.t))
    if element.startswith("tet"):
        whole = split(whole)
    corners = np.moveaxis(whole.p[:, whole.t], 0, -1)  # (k, m, 3)
    local = whole.elem()

    def positions(at):
        weights = [local.lbasis(at[:, None], a)[0].item() for a in range(len(corners))]
        P = np.einsum("a,amj->mj", weights, corners)
        return blown_up(shape, P)

    return curved(whole, positions)


def split(mesh: skfem.MeshHex) -> skfem.MeshTet:
    """Each hexahedron as 24 tetrahedra around its centre and those of its faces, which match."""
    n, f = mesh.nvertices, mesh.facets.shape[1]
    X = np.hstack([mesh.p, mesh.p[:, mesh.facets].mean(1), mesh.p[:, mesh.t].mean(1)])
    cells = n + f + np.arange(mesh.t.shape[1])
    tets = []
    for k, face in enumerate(mesh.elem.refdom.facets):
        corners = mesh.t[face]
        for a in range(4):
            tets.append(np.stack([corners[a], corners[(a + 1) % 4], n + mesh.t2f[k], cells]))
    return skfem.MeshTet(np.ascontiguousarray(X), np.ascontiguousarray(np.hstack(tets)))


def _at(x, y, z) -> np.ndarray:
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(float)


def blown_up(shape: Shape, P: np.ndarray) -> np.ndarray:
    """The cube shell 1 ≤ max|x| ≤ 2 to the ellipsoidal one; equal angles along its faces."""
    s = np.abs(P).max(axis=1)
    d = np.tan(np.pi / 4 * P / s[:, None])
    return shape.place(s - 1, d / np.linalg.norm(d, axis=1, keepdims=True))


@dataclass(frozen=True)
class Measures:
    """Furrow depth: how far the ventral midline lies inside of the ridges beside it, at x = 0;
    indentation of the midline there against its place before; volume of the cavity (whole embryo)
    and of the tissue; lengths in half lengths."""

    depth: float
    indentation: float
    cavity: float
    tissue: float


def sides(body: Body) -> tuple[Surface, Surface]:
    """Both sides of a quarter of the shell, and the cavity's."""
    boundary = body.mesh.boundary_facets()
    corners = body.mesh.p[:, body.mesh.facets[:, boundary]]
    free = boundary[(np.abs(corners[:2]) > 1e-6).any(axis=1).all(axis=0)]
    both = body.surface(free)
    # Normals of the body point into the cavity on its inner side.
    at = np.einsum("fqk,fki->fqi", both.shapes, body.nodes[both.nodes])
    inner = np.einsum("fqi,fqi->fq", both.normals, at).mean(axis=1) < 0
    return both, body.surface(free[inner])


class Furrow(Model):
    """A quarter of the embryo, with its measures."""

    @cached_property
    def _sides(self) -> tuple[Surface, Surface, np.ndarray]:
        """Both sides of the shell, the cavity's, and the outer nodes of the ventral half at x = 0
        from the midline on."""
        body, X = self.body, self.body.nodes
        section = (np.abs(X[:, 0]) < 1e-9) & (X[:, 2] < 0)
        radius = np.hypot(X[:, 1], X[:, 2])
        rim = np.flatnonzero(section & (radius > radius[section].max() - 1e-6))
        return *sides(body), rim[np.argsort(X[rim, 1])]

    def measure(self, u: np.ndarray) -> Measures:
        """Measures of a displacement (n, 3)."""
        both, cavity, rim = self._sides
        X = self.body.nodes
        z = (X + u)[rim, 2]
        return Measures(
            float(z[0] - z.min()),
            float(u[rim[0], 2]),
            -4 * enclosed(cavity, X, u),
            4 * enclosed(both, X, u),
        )


def build(
    level: int | Counts = 1,
    *,
    element: str = "hex27",
    shape: Shape | None = None,
    tissue: Tissue | None = None,
    contraction: float = 0.5,
    beta: Beta | None = None,
    yolk: float | None = None,
) -> Furrow:
    """Model of a quarter. ``beta``: the pattern of :class:`Shape` (None), a function of positions
    (m, q, 3), or values at the quadrature points or per cell. ``yolk``: bulk modulus over E of what
    fills the cavity; None: it is empty.

    Raises ValueError for a level that is not there, a β outside of [0, 1], a bulk modulus that is
    not above 0, and what the mesh refuses.
    """
    shape = shape or Shape()
    body, pattern = meshed(mesh, shape, sizes_of(level, LEVELS), element, beta)
    X = body.nodes
    planes = [np.flatnonzero(np.abs(X[:, k]) < 1e-9) for k in (0, 1)]
    # The dorsal end of the midline stays where it is.
    dorsal = np.argmax(X[:, 2] - np.abs(X[:, 0]) - np.abs(X[:, 1]))
    fixed = (
        Fixed(planes[0], [1, 0, 0]),
        Fixed(planes[1], [0, 1, 0]),
        Fixed([dorsal], [0, 0, 1]),
    )
    tissue = tissue or Tissue()
    terms = ()
    if yolk is not None:
        bulk = yolk * float(np.mean(tissue.E))
        terms = (Enclosed(body, sides(body)[1], bulk, fixed=fixed, name="yolk"),)
    return Furrow(body, fixed, pattern, tissue, contraction, terms)
