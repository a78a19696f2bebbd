"""Neural tube (§5.5.4): a half-cylindrical plate whose inner, apical side contracts at the folds.

x runs from the posterior (0) to the anterior end, y upwards, z across; the plate is the lower half
of a cylinder around the x axis: the angle φ from its lowest line runs to ±π/2 at the free edges.
Lengths in units of its mid-surface radius. One half, z ≥ 0: where both halves meet they press
against the mirror plane, which is a frictionless ground. β peaks along a line on each side and on
the inner surface: an analytic stand-in for the staining intensities of the dissertation, whose
images and sizes are not ours. By default it grows towards the anterior end, which therefore closes
first. With ``posterior=1`` it is the same all along, and what closes first is up to the geometry:
radius, thickness and rise of the plate may vary along it, while the contracting line keeps its
width and its distance from the edge.

What has touched may stay together (``sealing``), as folds that fuse do.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import skfem
from scipy.interpolate import PchipInterpolator

from solver.cases.levels import sizes_of
from solver.cases.tissue.model import Beta, Model, Tissue, enclosed, meshed
from solver.mesh.structured import box
from solver.physics.ground import Ground
from solver.physics.supports import Fixed
from solver.viscous.seal import Seal

# Gap, and penetration, in thicknesses, at which the mirror plane pushes back.
TOUCHING = 0.05


@dataclass(frozen=True)
class Shape:
    """Length and thickness of the plate, and the pattern: angle φ of its peaks (rad), their half
    width (rad), and the fraction of its strength at the posterior end; angles as on the unit
    radius, so that they are arc lengths, the peak's up to the edge π/2.

    ``radii``, ``thicknesses``, ``rises``: multiples of the mid-surface radius 1, of ``thickness``
    and of the edges' angle π/2 at stations that divide the length evenly, from the posterior end to
    the anterior one, with a monotone curve between them; one number: the same all along.

    Raises ValueError for sizes ≤ 0, edges beyond the mirror plane and a thickness of a radius and
    more.
    """

    length: float = 4.0
    thickness: float = 0.15
    peak: float = 0.9
    angle: float = 0.6
    posterior: float = 0.2
    radii: tuple[float, ...] = (1.0,)
    thicknesses: tuple[float, ...] = (1.0,)
    rises: tuple[float, ...] = (1.0,)

    def __post_init__(self):
        for name, value in vars(self).items():
            if not np.size(value) or not np.all(np.asarray(value) > 0):
                what = "a number" if np.ndim(value) == 0 else "numbers"
                raise ValueError(f"{name} = {value}; expected {what} > 0")
        if not max(self.rises) < 2:
            raise ValueError(f"rises = {self.rises}; expected less than 2, where the edges meet")
        x = np.linspace(0, self.length, 101)
        thick, radius = self.thick(x), self.radius(x)
        if not (thick < radius).all():
            raise ValueError(
                f"thickness = {thick.max():g}; expected less than the radius, which is "
                f"{radius.min():g}"
            )
        if self.posterior > 1:
            raise ValueError(f"posterior = {self.posterior}; expected a fraction of at most 1")

    def radius(self, x: np.ndarray) -> np.ndarray:
        """Radius of the mid-surface at positions x along the plate."""
        return self._along(self.radii, x)

    def thick(self, x: np.ndarray) -> np.ndarray:
        """Thickness at x."""
        return self.thickness * self._along(self.thicknesses, x)

    def edge(self, x: np.ndarray) -> np.ndarray:
        """Angle φ of the free edge at x."""
        return np.pi / 2 * self._along(self.rises, x)

    def _along(self, values: tuple[float, ...], x: np.ndarray) -> np.ndarray:
        if len(values) == 1:
            return np.full(np.shape(x), float(values[0]))
        stations = np.linspace(0, self.length, len(values))
        return PchipInterpolator(stations, values)(np.clip(x, 0, self.length))

    def beta(self, X: np.ndarray) -> np.ndarray:
        """The pattern at positions (..., 3), in [0, 1]."""
        x = X[..., 0]
        radius = self.radius(x)
        below = radius * (self.edge(x) - np.abs(np.arctan2(X[..., 2], -X[..., 1])))  # the edge
        inward = (radius - np.hypot(X[..., 1], X[..., 2])) / self.thick(x) + 0.5
        along = np.clip(x / self.length, 0, 1)
        strength = self.posterior + (1 - self.posterior) * along**2 * (3 - 2 * along)
        peak = np.exp(-(((below - (np.pi / 2 - self.peak)) / self.angle) ** 2))
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

    def bend(X):
        x, around, outwards = X.T
        angle, r = around * shape.edge(x), shape.radius(x) + outwards * shape.thick(x)
        return np.stack([x, -r * np.cos(angle), r * np.sin(angle)], axis=-1)

    ends = {"inner": (2, -0.5), "outer": (2, 0.5), "edge": (1, 1.0), "posterior": (0, 0.0),
            "anterior": (0, shape.length)}  # fmt: skip
    tests = {
        name: (lambda X, k=k, value=value: np.abs(X[:, k] - value) < 1e-9)
        for name, (k, value) in ends.items()
    }
    return box(
        np.linspace(0, shape.length, counts.along + 1),
        np.linspace(0, 1, counts.around + 1),
        np.linspace(-0.5, 0.5, counts.through + 1),
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


@dataclass(frozen=True)
class Closure:
    """Where along the plate a section lies, x in radii, and the fraction of the final contraction
    at which its edges meet; None where they do not."""

    x: float
    load: float | None


class NeuralTube(Model):
    """A half of the plate, with its measures."""

    @cached_property
    def _edges(self):
        body, X = self.body, self.body.nodes
        edge = body.nodes_of("edge")
        places, at = np.unique(X[edge, 0].round(9), return_inverse=True)
        return edge, at, places, body.surface(body.mesh.boundary_facets())

    @property
    def touching(self) -> float:
        """Distance of the edges, in radii, below which they touch."""
        return 2 * TOUCHING * self.terms[0].thickness

    def gaps(self, u: np.ndarray) -> np.ndarray:
        """Least distance between both edges in each section, (sections,), of u (n, 3)."""
        edge, at, places, _ = self._edges
        gap = np.full(len(places), np.inf)
        np.minimum.at(gap, at, 2 * (self.body.nodes + u)[edge, 2])
        return gap

    def measure(self, u: np.ndarray) -> Measures:
        """Measures of a displacement (n, 3)."""
        _, _, places, surface = self._edges
        gap = self.gaps(u)
        thirds = np.minimum(3 * places / places[-1], 2.999).astype(int)
        return Measures(
            *(float(gap[thirds == k].min()) for k in (2, 1, 0)),
            float((gap < self.touching).mean()),
            2 * enclosed(surface, self.body.nodes, u),
        )

    def closures(self, path: Iterable[tuple[float, np.ndarray]]) -> list[Closure]:
        """When each section first closes on a path of loads and displacements (n, 3).

        From the posterior end on. The load is that at which the distance, going on as in the step
        before, comes down to that of touching, and at most that of the first state beyond: contact
        holds that state off, so a line to it would be late.
        """
        loads, gaps = zip(*((load, self.gaps(u)) for load, u in path), strict=True)
        gaps, out = np.array(gaps) - self.touching, []
        for x, gap in zip(self._edges[2], gaps.T, strict=True):
            closed = np.flatnonzero(gap < 0)
            load = _crossing(loads, gap, int(closed[0])) if len(closed) else None
            out.append(Closure(float(x), load))
        return out


def _crossing(loads, gap: np.ndarray, k: int) -> float:
    """Load at which a distance (states,) comes to 0; state k is the first beyond."""
    if k == 0:
        return float(loads[0])
    first = max(k - 2, 0)
    fall = gap[first] - gap[first + 1]
    ahead = gap[k - 1] * (loads[first + 1] - loads[first]) / fall if fall > 0 else np.inf
    return float(loads[k - 1] + min(loads[k] - loads[k - 1], ahead))


def build(
    level: int | Counts = 1,
    *,
    element: str = "hex27",
    shape: Shape | None = None,
    tissue: Tissue | None = None,
    contraction: float = 0.4,
    beta: Beta | None = None,
    sealing: float | None = None,
) -> NeuralTube:
    """Model of a half. ``beta``: the pattern of :class:`Shape` (None), a function of positions
    (m, q, 3), or values at the quadrature points or per cell. ``sealing``: modulus over E of a
    layer as thick as contact's reach that keeps together what has touched on a path in time; None:
    it parts again.

    Raises ValueError for a level that is not there, a β outside of [0, 1], a modulus that is not
    above 0, and what the mesh refuses.
    """
    shape = shape or Shape()
    body, pattern = meshed(mesh, shape, sizes_of(level, LEVELS), element, beta)
    X = body.nodes
    plane = np.flatnonzero(np.abs(X[:, 2]) < 1e-9)
    # Of the mid-line two points hold what the mirror plane leaves free, without any force.
    ends = np.array([0.0, shape.length])
    low = np.stack([ends, -shape.radius(ends) - shape.thick(ends) / 2, 0 * ends], axis=1)
    feet = [np.argmin(np.linalg.norm(X - point, axis=1)) for point in low]
    fixed = (
        Fixed(plane, [0, 0, 1]),
        Fixed([feet[0]], [1, 0, 0]),
        Fixed(feet, [0, 1, 0]),
    )
    tissue = tissue or Tissue()
    sides = body.surface(lambda X: X[:, 2] > 0.5 * shape.radius(X[:, 0]))
    E = float(np.mean(tissue.E))
    touch = Ground(
        body, sides, thickness=shape.thickness, pressure=0.02 * E, depth=TOUCHING, reach=TOUCHING,
        name="contact",
    )  # fmt: skip
    terms = (touch,)
    if sealing is not None:
        terms = (touch, Seal(touch, sealing * E / (TOUCHING * shape.thickness)))
    return NeuralTube(body, fixed, pattern, tissue, contraction, terms)
