"""Growth: the tensor Fg of F = Fe Fg, its inverse and determinant.

Isotropic (Eq. 2.27), orthotropic in any frame (2.29), along a fibre, and apical constriction
(5.62). The dissertation prints the fibre form as (1 + g) f⊗f, which is singular; it is I + g f⊗f.
A body that doesn't grow has no growth object.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from solver.given import numbers
from solver.physics.fields import Points, Quantity, Unphysical, resolve, takes_position, unit


class Growth:
    """Fg as a field of the load e; see :mod:`solver.physics.fields` for the forms of its
    quantities.

    ``cells``: mask (m,) of the cells that grow; None: all of them.
    """

    def __init__(self, cells: np.ndarray | None = None):
        if cells is not None:
            numbers("the growth's cells", cells)
        self.cells = None if cells is None else np.asarray(cells)

    def tensor(self, e: float, shape: tuple[int, int], points: Points | None = None) -> np.ndarray:
        """Fg before the mask, (1 | m, 1 | q, 3, 3); ``shape`` is (m, q)."""
        raise NotImplementedError

    def evaluate(
        self, e: float, shape: tuple[int, int], points: Points | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fg⁻¹ (1 | m, 1 | q, 3, 3) and Jg = det Fg (1 | m, 1 | q) at the load e.

        Raises Unphysical, naming the place, where det Fg is not positive or not finite, and
        ValueError for fields or masks of the wrong shape.
        """
        Fg, mask = self.tensor(e, shape, points), None
        if self.cells is not None:
            if self.cells.shape != shape[:1] or self.cells.dtype != bool:
                raise ValueError(
                    f"the growth's cells have shape {self.cells.shape} and type "
                    f"{self.cells.dtype}; expected a mask ({shape[0]},) of booleans"
                )
            mask = self.cells[:, None, None, None]
            if Fg.shape[:2] != (1, 1) or not self.cells.any():
                Fg, mask = np.where(mask, Fg, np.eye(3)), None
        # Of a growth that is everywhere the same one tensor is inverted, and then masked.
        J = np.linalg.det(Fg)
        if mask is not None:
            J = np.where(mask[..., 0, 0], J, 1.0)
        if not (np.isfinite(J) & (J > 0)).all():
            cell, point = np.argwhere(~(np.isfinite(J) & (J > 0)))[0]
            where = "everywhere"
            if J.size > 1:
                where = f"in cell {cell}, point {point}"
                if points is not None:
                    x, y, z = points()[cell, point]
                    where += f", near ({x:.4g}, {y:.4g}, {z:.4g})"
            raise Unphysical(
                f"growth has det Fg = {J[cell, point]:.4g} {where} at e = {e:g}; expected a "
                "positive, finite determinant: contract less (g > -1) or mend the field"
            )
        inverse = np.linalg.inv(Fg)
        if mask is not None:
            inverse = np.where(mask, inverse, np.eye(3))
        return np.ascontiguousarray(inverse), np.ascontiguousarray(J)


def _dyads(frame: np.ndarray, stretches: np.ndarray) -> np.ndarray:
    """Σ_k s_k e_k ⊗ e_k, e_k the rows of the frame."""
    return np.einsum("...k,...ki,...kj->...ij", stretches, frame, frame)


class Isotropic(Growth):
    """Fg = (1 + g) I (Eq. 2.27)."""

    def __init__(self, g: Quantity, *, cells: np.ndarray | None = None):
        super().__init__(cells)
        self.g = g

    def tensor(self, e, shape, points=None):
        g = resolve("growth g", self.g, e, shape, points)
        return (1 + g)[..., None, None] * np.eye(3)


class Orthotropic(Growth):
    """Fg = I + Σ g_k e_k ⊗ e_k (Eq. 2.29); ``g`` three quantities, one per direction.

    ``frame``: orthonormal rows e_k, (3, 3), per cell (m, 3, 3) or per point (m, q, 3, 3); None: the
    coordinate axes. Raises ValueError where the rows are not orthonormal, Unphysical for g_k ≤ −1.
    """

    def __init__(
        self,
        g: Sequence[Quantity],
        frame: Quantity | None = None,
        *,
        cells: np.ndarray | None = None,
    ):
        super().__init__(cells)
        self.g = tuple(g) if isinstance(g, Iterable) else (g,)
        if len(self.g) != 3:
            raise ValueError(f"{len(self.g)} growth strains; expected three, one per direction")
        self.frame = np.eye(3) if frame is None else frame

    def tensor(self, e, shape, points=None):
        parts = [resolve(f"growth g{k}", g, e, shape, points) for k, g in enumerate(self.g, 1)]
        g = np.stack(np.broadcast_arrays(*parts), axis=-1)
        if (g <= -1).any():
            cell, point, k = np.argwhere(g <= -1)[0]
            raise Unphysical(
                f"growth g{k + 1} = {g[cell, point, k]:.4g} at e = {e:g} (cell {cell}, point "
                f"{point}) turns the body inside out; expected g > -1: contract less"
            )
        frame = resolve("growth frame", self.frame, e, shape, points, (3, 3))
        off = np.abs(frame @ np.swapaxes(frame, -1, -2) - np.eye(3)).max(axis=(-1, -2))
        if (off > 1e-9).any():
            cell = np.argwhere(off > 1e-9)[0][0]
            raise ValueError(
                f"growth frame is not orthonormal in cell {cell} (off by {off.max():.1e}); "
                "normalise its three rows"
            )
        return np.eye(3) + _dyads(frame, g)


class AlongFibre(Growth):
    """Fg = I + g f ⊗ f; f (3,), (m, 3) or (m, q, 3), of any length but zero."""

    def __init__(self, g: Quantity, direction: Quantity, *, cells: np.ndarray | None = None):
        super().__init__(cells)
        self.g, self.direction = g, direction

    def tensor(self, e, shape, points=None):
        g = resolve("growth g", self.g, e, shape, points)
        f = resolve("growth direction", self.direction, e, shape, points, (3,))
        f = unit("growth direction", f)
        return np.eye(3) + g[..., None, None] * f[..., :, None] * f[..., None, :]


class Apical(Growth):
    """Apical constriction, Fg = I / (1 − g β(X)) (Eq. 5.62).

    ``g`` as everywhere; ``beta`` an array or a function β(X) of the points X (m, q, 3), with values
    in [0, 1]. The sign is the dissertation's, so g < 0 contracts. Raises Unphysical where
    1 − g β ≤ 0.
    """

    def __init__(
        self,
        g: Quantity,
        beta: np.ndarray | Callable[[np.ndarray], np.ndarray],
        *,
        cells: np.ndarray | None = None,
    ):
        super().__init__(cells)
        self.g, self.beta = g, beta

    def tensor(self, e, shape, points=None):
        return (1 / self.parts(e, shape, points)[1])[..., None, None] * np.eye(3)

    def by_beta(self, e: float, shape: tuple[int, int], points: Points | None = None) -> np.ndarray:
        """∂Fg/∂β Fg⁻¹ = g/(1 − g β) I at each point, (1 | m, 1 | q, 3, 3), 0 where the mask has no
        growth; raises what :meth:`evaluate` does."""
        g, rest = self.parts(e, shape, points)
        rate = (g / rest)[..., None, None] * np.eye(3)
        return rate if self.cells is None else np.where(self.cells[:, None, None, None], rate, 0.0)

    def parts(
        self, e: float, shape: tuple[int, int], points: Points | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """g and 1 − g β, (1 | m, 1 | q) each; raises what :meth:`evaluate` does."""
        g = resolve("growth g", self.g, e, shape, points)
        beta = self.beta
        if callable(beta) and not takes_position(beta):
            # β is a pattern in space; a function of one argument takes the position.
            def field(_, X, pattern=beta):
                return pattern(X)

            beta = field
        beta = resolve("beta", beta, e, shape, points)
        if not ((beta >= 0) & (beta <= 1)).all():
            raise ValueError(
                f"beta runs from {beta.min():.4g} to {beta.max():.4g}; expected values in [0, 1]: "
                "scale the pattern and put its strength into g"
            )
        rest = 1 - g * beta
        if not (rest > 0).all():
            cell, point = np.argwhere(~(rest > 0))[0]
            raise Unphysical(
                f"1 - g beta = {rest.min():.4g} at e = {e:g} (cell {cell}, point {point}); "
                "expected more than 0: take g < 1 (g < 0 contracts)"
            )
        return g, rest


class General(Growth):
    """Any Fg: (3, 3), per cell (m, 3, 3) or per point (m, q, 3, 3), constant or a function."""

    def __init__(self, Fg: Quantity, *, cells: np.ndarray | None = None):
        super().__init__(cells)
        self.Fg = Fg

    def tensor(self, e, shape, points=None):
        return resolve("growth", self.Fg, e, shape, points, (3, 3))
