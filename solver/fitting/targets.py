"""What is known of a shape, as residuals r = (given − found)/σ of a displacement u (n, 3).

A target has ``size``, the number of its residuals, ``residual(u)`` (size,) and ``slope(u, du)``
(size, k), dr of fields du (n, 3, k). Those that are linear in the nodes' positions to first order
also have ``matrix(u)`` (size, 3n) = ∂r/∂u, for adjoints. σ > 0 is the standard deviation of the
noise, in the unit of what is given: a number, or one per residual.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from solver.fitting.skin import Feet, Skin
from solver.given import numbers
from solver.mesh.body import Body


class Target(Protocol):
    """See the module."""

    size: int

    def residual(self, u: np.ndarray) -> np.ndarray: ...

    def slope(self, u: np.ndarray, du: np.ndarray) -> np.ndarray: ...


def _cloud(name: str, value) -> np.ndarray:
    given = numbers(name, value)
    if given.ndim != 2 or given.shape[1] != 3 or not len(given) or not np.isfinite(given).all():
        raise ValueError(f"{name} have shape {given.shape}; expected finite positions (p, 3)")
    return given


def _sigma(value, size: int) -> np.ndarray:
    given = numbers("sigma", value)
    if given.shape not in ((), (size,)) or not ((given > 0) & np.isfinite(given)).all():
        raise ValueError(f"sigma = {value!r:.60}; expected a number > 0, or {size} of them")
    return np.broadcast_to(given, size)


class _Linear:
    """Targets with a matrix."""

    def slope(self, u: np.ndarray, du: np.ndarray) -> np.ndarray:
        """dr (size, k) of fields du (n, 3, k)."""
        return self.matrix(u) @ du.reshape(-1, du.shape[-1])


class Cloud(_Linear):
    """Points (p, 3) that were seen on a surface, nobody knows where on it: their distances to the
    deformed skin, outward positive.

    ``mirrors``: axes of the planes through the origin in which the body is a part of the whole;
    points beyond them count as their images. To first order a distance changes by the motion of
    the skin along the way from the nearest place, for that place moves within the skin. Points
    beyond a rim of the skin are as far as the rim is.
    """

    def __init__(self, skin: Skin, points: np.ndarray, sigma, *, mirrors: Sequence[int] = ()):
        self.skin, self.points = skin, _cloud("points", points).copy()
        for axis in mirrors:
            self.points[:, axis] = np.abs(self.points[:, axis])
        self.size = len(self.points)
        self.sigma = _sigma(sigma, self.size)
        self._last: tuple[np.ndarray, Feet] | None = None

    def feet(self, u: np.ndarray) -> Feet:
        """The nearest places."""
        if self._last is None or self._last[0] is not u:
            self._last = u, self.skin.nearest(self.skin.body.nodes + u, self.points)
        return self._last[1]

    def residual(self, u: np.ndarray) -> np.ndarray:
        """r (p,)."""
        feet = self.feet(u)
        return np.einsum("pi,pi->p", self._way(feet), self.points - feet.position) / self.sigma

    def _way(self, feet: Feet) -> np.ndarray:
        """Unit vectors (p, 3) from the skin to the points, outward: the normal but on edges."""
        way = self.points - feet.position
        size = np.linalg.norm(way, axis=1)[:, None]
        side = np.where(np.einsum("pi,pi->p", way, feet.normal) < 0, -1.0, 1.0)[:, None]
        far = size > 1e-7 * self.skin.body.length
        return np.where(far, side * way / np.where(far, size, 1.0), feet.normal)

    def matrix(self, u: np.ndarray) -> sp.csr_array:
        """∂r/∂u, (p, 3n)."""
        feet = self.feet(u)
        values = -feet.shapes[:, :, None] * (self._way(feet) / self.sigma[:, None])[:, None]
        columns = 3 * feet.nodes[..., None] + np.arange(3)
        rows = np.broadcast_to(np.arange(self.size)[:, None, None], columns.shape)
        shape = (self.size, u.size)
        return sp.csr_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape)


def section(points: np.ndarray, axis: int) -> np.ndarray:
    """Points (p, 2) of a picture of the section through the origin across an axis, as (p, 3).

    The other two axes keep their order. Where the section is a mirror plane its outline is that of
    the skin, so :class:`Cloud` takes them.
    """
    given = numbers("points", points)
    if given.ndim != 2 or given.shape[1] != 2:
        raise ValueError(f"points have shape {given.shape}; expected (p, 2), a plane picture")
    return np.insert(given, axis, 0.0, axis=1)


class Landmarks(_Linear):
    """Points of the body that were followed: where those at ``start`` (p, 3) of the reference state
    came to, ``end`` (p, 3)."""

    def __init__(self, body: Body, start: np.ndarray, end: np.ndarray, sigma):
        start, self.end = _cloud("start", start), _cloud("end", end)
        if start.shape != self.end.shape:
            raise ValueError(f"{len(start)} starts and {len(self.end)} ends; expected as many")
        self.size = self.end.size
        self.sigma = _sigma(sigma, self.size)
        self._start = start
        weights = sp.kron(sp.csr_array(body.interpolation(start)), sp.eye_array(3))
        self._matrix = sp.csr_array(-weights.multiply(1 / self.sigma[:, None]))

    def residual(self, u: np.ndarray) -> np.ndarray:
        """r (3p,), point by point."""
        return (self.end - self._start).ravel() / self.sigma + self._matrix @ u.ravel()

    def matrix(self, u: np.ndarray) -> sp.csr_array:
        """∂r/∂u, (3p, 3n)."""
        return self._matrix


class Measured:
    """Named lengths of any kind: ``measure(u)`` gives their (size,) values, such as a depth.

    Their derivatives are central differences along the fields that are asked for.
    """

    def __init__(
        self,
        names: Sequence[str],
        measure: Callable[[np.ndarray], np.ndarray],
        values: np.ndarray,
        sigma,
    ):
        self.names, self._measure = tuple(names), measure
        self.values = np.atleast_1d(numbers("values", values))
        self.size = len(self.names)
        if self.values.shape != (self.size,) or not np.isfinite(self.values).all():
            raise ValueError(f"values {self.values}; expected one finite number for each name")
        self.sigma = _sigma(sigma, self.size)

    def residual(self, u: np.ndarray) -> np.ndarray:
        """r (size,)."""
        return (self.values - np.atleast_1d(self._measure(u))) / self.sigma

    def slope(self, u: np.ndarray, du: np.ndarray) -> np.ndarray:
        """dr (size, k) of fields du (n, 3, k)."""
        columns = []
        for field in np.moveaxis(du, -1, 0):
            h = 1e-5 * max(np.abs(u).max(), 1e-3) / max(np.abs(field).max(), 1e-300)
            columns.append((self.residual(u + h * field) - self.residual(u - h * field)) / (2 * h))
        return np.stack(columns, axis=-1)
