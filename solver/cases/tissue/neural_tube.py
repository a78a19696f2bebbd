"""Neural tube (§5.5.4): a half-cylindrical plate whose inner, apical side contracts at the folds.

x runs from the posterior (0) to the anterior end, y upwards, z across; the plate is the lower half
of a cylinder around the x axis: the angle φ from its lowest line runs to ±π/2 at the free edges.
Lengths in units of its mid-surface radius. One half, z ≥ 0: where both halves meet they press
against the mirror plane, which is a frictionless ground. β peaks along a line on each side and on
the inner surface and grows towards the anterior end, which therefore closes first: an analytic
stand-in for the staining intensities of the dissertation, whose images and sizes are not ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import skfem

from solver.cases.levels import sizes_of
from solver.cases.tissue.model import Beta, Model, Tissue, enclosed, meshed
from solver.mesh.structured import box
from solver.physics.ground import Ground
from solver.physics.supports import Fixed

# Gap, and penetration, in thicknesses, at which the mirror plane pushes back.
TOUCHING = 0.05


@dataclass(frozen=True)
class Shape:
    """Length and thickness of the plate, and the pattern: angle φ of its peaks (rad), their half
    width (rad), and the fraction of its strength at the posterior end.

    Raises ValueError for sizes ≤ 0 and a thickness of a radius and more.
    """

    length: float = 4.0
    thickness: float = 0.15
    peak: float = 0.9
    angle: float = 0.6
    posterior: float = 0.2

    def __post_init__(self):
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"{name} = {value}; expected a number > 0")
        if not self.thickness < 1:
            raise ValueError(
                f"thickness = {self.thickness}; expected less than the radius, which is 1"
            )
        if self.posterior > 1:
            raise ValueError(f"posterior = {self.posterior}; expected a fraction of at most 1")

    def beta(self, X: np.ndarray) -> np.ndarray:
        """The pattern at positions (..., 3), in [0, 1]."""
        around = np.abs(np.arctan2(X[..., 2], -X[..., 1]))
        inward = (1 - np.hypot(X[..., 1], X[..., 2])) / self.thickness + 0.5
        along = np.clip(X[..., 0] / self.length, 0, 1)
        strength = self.posterior + (1 - self.posterior) * along**2 * (3 - 2 * along)
        peak = np.exp(-(((around - self.peak) / self.angle) ** 2))
        return peak * strength * np.clip(inward, 0, 1)


@dataclass(frozen=True)
class Counts:
    """Elements along the plate, around a half of it, and through its thickness."""

    along: int = 8
    around: int = 10
    through: int = 1


LEVELS = (Counts(4, 5, 1), Counts(8, 10, 1), Counts(12, 16, 2), Counts(20, 24, 2))


def mesh(shape: Shape, counts: Counts, element: str) -> skfem.Mesh:
    """Half of the plate; boundaries "inner", "outer", "edge", "posterior", "anterior"."""
    h = shape.thickness / 2

    def bend(X):
        x, angle, r = X.T
        return np.stack([x, -r * np.cos(angle), r * np.sin(angle)], axis=-1)

    ends = {"inner": 2, "outer": 2, "edge": 1, "posterior": 0, "anterior": 0}
    values = {"inner": 1 - h, "outer": 1 + h, "edge": np.pi / 2, "posterior": 0.0,
              "anterior": shape.length}  # fmt: skip
    tests = {
        name: (lambda X, k=k, v=values[name]: np.abs(X[:, k] - v) < 1e-9)
        for name, k in ends.items()
    }
    return box(
        np.linspace(0, shape.length, counts.along + 1),
        np.linspace(0, np.pi / 2, counts.around + 1),
        np.linspace(1 + h, 1 - h, counts.through + 1)[::-1],
        shape=bend,
        boundaries=tests,
        tets=element.startswith("tet"),
    )


@dataclass(frozen=True)
class Measures:
    """Least distance between the two edges in the anterior, middle and posterior third, fraction of
    their length that touches, and the tissue's volume; of the whole plate, in radii."""

    closure: float
    closure_middle: float
    closure_posterior: float
    closed: float
    tissue: float


class NeuralTube(Model):
    """A half of the plate, with its measures."""

    @cached_property
    def _edges(self):
        body, X = self.body, self.body.nodes
        edge = body.nodes_of("edge")
        places, at = np.unique(X[edge, 0].round(9), return_inverse=True)
        return edge, at, places, body.surface(body.mesh.boundary_facets())

    def measure(self, u: np.ndarray) -> Measures:
        """Measures of a displacement (n, 3)."""
        edge, at, places, surface = self._edges
        X = self.body.nodes
        gap = np.full(len(places), np.inf)
        np.minimum.at(gap, at, 2 * (X + u)[edge, 2])
        thirds = np.minimum(3 * places / places[-1], 2.999).astype(int)
        contact = self.terms[0]
        return Measures(
            *(float(gap[thirds == k].min()) for k in (2, 1, 0)),
            float((gap < 2 * TOUCHING * contact.thickness).mean()),
            2 * enclosed(surface, X, u),
        )


def build(
    level: int | Counts = 1,
    *,
    element: str = "hex27",
    shape: Shape | None = None,
    tissue: Tissue | None = None,
    contraction: float = 0.4,
    beta: Beta | None = None,
) -> NeuralTube:
    """Model of a half. ``beta``: the pattern of :class:`Shape` (None), a function of positions
    (m, q, 3), or values at the quadrature points or per cell.

    Raises ValueError for a level that is not there, a β outside of [0, 1], and what the mesh
    refuses.
    """
    shape = shape or Shape()
    body, pattern = meshed(mesh, shape, sizes_of(level, LEVELS), element, beta)
    X = body.nodes
    plane = np.flatnonzero(np.abs(X[:, 2]) < 1e-9)
    # Of the mid-line two points hold what the mirror plane leaves free, without any force.
    low = -1.0 - shape.thickness / 2
    feet = [np.argmin(np.linalg.norm(X - (x, low, 0), axis=1)) for x in (0.0, shape.length)]
    fixed = (
        Fixed(plane, [0, 0, 1]),
        Fixed([feet[0]], [1, 0, 0]),
        Fixed(feet, [0, 1, 0]),
    )
    tissue = tissue or Tissue()
    sides = body.surface(lambda X: X[:, 2] > 0.5)
    touch = Ground(
        body, sides, thickness=shape.thickness, pressure=0.02 * tissue.E, depth=TOUCHING,
        reach=TOUCHING, name="contact",
    )  # fmt: skip
    return NeuralTube(body, fixed, pattern, tissue, contraction, (touch,))
