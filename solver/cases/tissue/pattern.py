"""Patterns β of the furrow with parameters, for a fit: its formula, and a free field.

Places are told by the angle around the embryo from the ventral midline, |atan2(y, −z)| in rad, by
|x| in half lengths and by the depth, 0 on the inner and 1 on the outer side of the shell.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solver.cases.tissue.furrow import Shape
from solver.fitting.skin import Skin
from solver.mesh.body import Body

POWER = 2  # of the depth, as in Shape.beta


def places(shape: Shape, X: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle, |x| and depth in [0, 1] of positions (..., 3)."""
    around = np.arctan2(np.abs(X[..., 1]), -X[..., 2])
    return around, np.abs(X[..., 0]), np.clip(shape.depth(X), 0, 1)


def outside(body: Body, shape: Shape | None = None) -> Skin:
    """The outer side of a furrow's shell, which is what pictures show."""
    facets = body.mesh.boundary_facets()
    corners = np.moveaxis(body.mesh.p[:, body.mesh.facets[:, facets]], 0, -1)
    outer = (shape or Shape()).depth(corners) > 1 - 1e-6
    return Skin(body, facets[outer.all(axis=0)])


@dataclass(frozen=True, eq=False)
class Profile:
    """β = strength · exp(−(around/angle)²) exp(−(x/reach)⁴) depth², the pattern of
    :class:`solver.cases.tissue.furrow.Shape` with its strength, angle (rad) and reach (half
    lengths) unknown.

    ``contraction``: whether a factor on the whole contraction is one more parameter, as it is where
    neither it nor the strength is known: their product alone acts.
    """

    shape: Shape = field(default_factory=Shape)
    contraction: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Its parameters."""
        return ("strength", "angle", "reach", *(("contraction",) if self.contraction else ()))

    @property
    def low(self) -> np.ndarray:
        """The least of each."""
        return np.array([0.1, 0.1, 0.3, 0.1])[: len(self.names)]

    @property
    def high(self) -> np.ndarray:
        """The most of each."""
        return np.array([1.0, 0.8, 1.2, 1.0])[: len(self.names)]

    def values(self, p: np.ndarray, X: np.ndarray) -> np.ndarray:
        """β at positions (..., 3)."""
        return np.prod([p[0], *p[3:]]) * self._shaped(p, X)[0]

    def slopes(self, p: np.ndarray, X: np.ndarray) -> np.ndarray:
        """∂β/∂p, (..., k)."""
        shaped, around, along = self._shaped(p, X)
        beta = np.prod([p[0], *p[3:]]) * shaped
        parts = [beta / p[0], beta * 2 * around**2 / p[1] ** 3, beta * 4 * along**4 / p[2] ** 5]
        return np.stack([*parts, *(beta / factor for factor in p[3:])], axis=-1)

    def _shaped(self, p, X):
        around, along, depth = places(self.shape, X)
        form = np.exp(-((around / p[1]) ** 2) - (along / p[2]) ** 4) * depth**POWER
        return form, around, along


@dataclass(frozen=True, eq=False)
class Free:
    """β = Σ p_ij h_i(around) h_j(|x|) · depth²: any field around and along, linear between knots.

    ``around`` (rad), ``along`` (half lengths): knots, increasing, the first 0. β is 0 beyond the
    last angle, where the last hat has fallen to 0, and stays along beyond the last knot. Parameters
    are β on the outer side at the knots, 0 to 1, the first knot of ``around`` first.

    Raises ValueError for knots that don't increase from 0.
    """

    around: tuple[float, ...] = (0.0, 0.15, 0.3, 0.5, 0.8)
    along: tuple[float, ...] = (0.0, 0.35, 0.7, 1.0)
    shape: Shape = field(default_factory=Shape)

    def __post_init__(self):
        for name in ("around", "along"):
            knots = getattr(self, name)
            if len(knots) < 2 or knots[0] != 0 or not (np.diff(knots) > 0).all():
                raise ValueError(f"{name} = {knots}; expected knots that increase from 0")

    @property
    def grid(self) -> tuple[int, int]:
        """Parameters around and along."""
        return len(self.around) - 1, len(self.along)

    @property
    def names(self) -> tuple[str, ...]:
        """Each by its knot."""
        return tuple(f"b({a:g} rad, {x:g})" for a in self.around[:-1] for x in self.along)

    @property
    def low(self) -> np.ndarray:
        """0."""
        return np.zeros(len(self.names))

    @property
    def high(self) -> np.ndarray:
        """1."""
        return np.ones(len(self.names))

    def values(self, p: np.ndarray, X: np.ndarray) -> np.ndarray:
        """β at positions (..., 3)."""
        return self.slopes(p, X) @ p

    def slopes(self, p: np.ndarray, X: np.ndarray) -> np.ndarray:
        """∂β/∂p, (..., k), the same for all p."""
        around, along, depth = places(self.shape, X)
        a = np.stack([np.interp(around, self.around, row) for row in np.eye(len(self.around))[:-1]])
        b = np.stack([np.interp(along, self.along, row) for row in np.eye(len(self.along))])
        hats = a[:, None] * b * depth**POWER
        return np.moveaxis(hats.reshape(-1, *around.shape), 0, -1)

    def bends(self) -> np.ndarray:
        """Rows (r, k) that are 0 for a field without bends: second differences around and along, of
        evenly numbered knots, and slopes across the midline, where the field is even."""
        n, m = self.grid
        index = np.arange(n * m).reshape(n, m)
        rows = []
        for lines in (index.T, index):
            for line in lines:
                for a, b, c in zip(line, line[1:], line[2:], strict=False):
                    row = np.zeros(n * m)
                    row[[a, b, c]] = 1, -2, 1
                    rows.append(row)
        return np.array(rows).reshape(-1, n * m)
