"""Conjugate gradients, for positive definite systems that are too large to factorise.

Preconditioned on two levels where the element is quadratic (p-multigrid): Chebyshev's polynomial of
the matrix over its diagonal blocks smooths, and what is smooth is solved for by a factorisation in
the space of functions that are linear between the corners of the cells, an eighth of the unknowns
of hex27, with the Galerkin matrix PᵀAP. Two things make it work in thin bodies. The blocks are
those of lines of nodes through flat cells, which hold together more than their neighbours; and as
linear functions can't bend flat cells without shearing them, each corner turns there as well as
moves (its hat function times the six rigid motions, a partition of unity after Babuška and Melenk).
Linear elements have no such space: smoothed aggregation (pyamg), the rigid motions as near null
space.

Constraint rows are kept exactly by every iterate (projected conjugate gradients with a constraint
preconditioner: Gould, Hribar and Nocedal, SIAM J. Sci. Comput. 23 (2001), Alg. 2.1), so that a body
may be held by them alone.

What is found of the matrix on the way is said: where it is not positive definite there is no answer
but :class:`Indefinite`. Nothing is counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from solver.equilibrium.linear import (
    Factor,
    SingularMatrix,
    galerkin,
    galerkin_pattern,
    make_solver,
    product,
)
from solver.mesh.body import Body
from solver.mesh.corners import lines, prolongation
from solver.physics.supports import Held

# Matrix products of one smoothing; the part of the spectrum, from the top, that it damps; how far
# above its estimate the largest eigenvalue may lie; products for the estimate.
DEGREE, DAMPED, MARGIN, POWER = 3, 0.07, 1.15, 12
# Turning all corners alike moves nothing: what holds these motions, beside their diagonal.
NULL = 1e-10


class Indefinite(SingularMatrix):
    """The matrix is not positive definite, as beyond a critical point of an equilibrium path."""


@dataclass(frozen=True, eq=False)
class Coarse:
    """What two levels need beside the matrix.

    ``prolongation`` (n, m): its columns span the smooth functions, those of the corners; ``line``
    (n,): unknowns of one line are smoothed together, in the order of ``place`` (n,).
    """

    prolongation: sp.csr_array
    line: np.ndarray
    place: np.ndarray

    @classmethod
    def of(cls, body: Body, held: Held) -> Coarse | None:
        """That of the free unknowns of a body; None for linear elements."""
        moves = held.free.reshape(-1, 3).copy()
        moves[held.tied // 3] = True
        P = prolongation(body, moves, held.frames)
        if P is None:
            return None
        P = P[held.index]
        P = P[:, np.flatnonzero(np.bincount(P.indices, minlength=P.shape[1]))]
        line, place = lines(body)
        return cls(P, line[held.index // 3], place[held.index // 3])


def rigid_modes(body: Body, held: Held) -> np.ndarray:
    """Translations and rotations in the free unknowns, (n_free, 6)."""
    arm = (body.nodes - body.nodes.mean(axis=0)) / body.length
    modes = [np.broadcast_to(axis, arm.shape) for axis in np.eye(3)]
    modes += [np.cross(axis, arm) for axis in np.eye(3)]
    return np.column_stack([held.to_local(m.copy()).ravel()[held.index] for m in modes])


class ConjugateGradients:
    """See the module; ``iterations`` of the latest solve.

    Of the unknowns those beyond the ``modes`` (n, 6) are multipliers of constraint rows. ``rtol``:
    of √(rᵀBr), where B is the preconditioner: the error of the solution in the norm of the energy,
    up to how well B does. Newton's corrections are right to so many digits of theirs.
    """

    def __init__(
        self,
        indptr,
        indices,
        modes: np.ndarray,
        coarse: Coarse | None = None,
        *,
        rtol: float = 1e-8,
        most: int = 500,
    ):
        """Raises ValueError for constraint rows without a coarse space."""
        self.n = len(modes)
        self.iterations = 0
        self._modes, self._rtol, self._most = modes, rtol, most
        self._border = Border(np.asarray(indptr), np.asarray(indices), self.n)
        if self._border.count and coarse is None:
            raise ValueError("conjugate gradients take constraint rows of quadratic elements only")
        pattern = self._border.indptr, self._border.indices
        self._levels = None if coarse is None else TwoLevels(*pattern, coarse, self._border.count)

    def factorise(self, values: np.ndarray) -> Factor:
        """Set up the preconditioner for the matrix with these values; shape (nnz,).

        Raises Indefinite where it shows that the matrix is not positive definite on the motions
        that the rows allow.
        """
        values, C = self._border.split(values)
        if self._levels is None:
            precondition = self._aggregated(values)
        else:
            precondition = self._levels.of(values, C)
        # The rows' forces and what answers to them.
        lifted = np.array([precondition(row) for row in C]).reshape(C.shape)
        gram = np.linalg.inv(C @ lifted.T)

        def projected(r):
            z = precondition(r)
            forces = gram @ (C @ z)
            return z - forces @ lifted, forces

        def solve(b, transposed=False):
            if b.ndim == 2:
                return np.column_stack([solve(column) for column in b.T])
            start = (gram @ b[self.n :]) @ lifted
            return self._solve(values, C, projected, b[: self.n], start)

        return Factor(solve, None)

    def _aggregated(self, values):
        import pyamg

        pattern = self._border.indices, self._border.indptr
        upper = sp.csr_array((values, *pattern), shape=(self.n, self.n))
        matrix = sp.csr_matrix(upper + sp.triu(upper, 1).T)
        hierarchy = pyamg.smoothed_aggregation_solver(
            matrix, B=self._modes, strength=("symmetric", {"theta": 0.02}), max_coarse=300
        )
        return hierarchy.aspreconditioner().matvec

    def _solve(self, values, C, projected, b, x):
        self.iterations = 0
        r = np.array(b, dtype=float)
        if x.any():
            r -= self._times(values, x)
        z, multipliers = projected(r)
        r -= multipliers @ C
        p, size = z.copy(), r @ z
        goal = self._rtol**2 * size
        while size > goal:
            if self.iterations == self._most:
                raise SingularMatrix(
                    f"conjugate gradients did not converge in {self._most} iterations: the matrix "
                    "is badly conditioned; use a direct method"
                )
            self.iterations += 1
            q = self._times(values, p)
            curvature = p @ q
            if curvature <= 0:
                raise Indefinite(
                    "conjugate gradients met a direction of negative curvature: the matrix is not "
                    "positive definite; use a direct method"
                )
            x += size / curvature * p
            r -= size / curvature * q
            z, forces = projected(r)
            # What the rows take up would hide the rest in rounding.
            r -= forces @ C
            multipliers += forces
            before, size = size, r @ z
            p = z + size / before * p
        if not np.isfinite(x).all() or not np.isfinite(size) or size < 0:
            raise SingularMatrix(
                "conjugate gradients broke down: the matrix is not positive definite or not "
                "finite; use a direct method"
            )
        return np.concatenate([x, multipliers])

    def _times(self, values, x):
        return product(self._border.indptr, self._border.indices, values, x, True)


class Border:
    """A stiffness of order n and the ``count`` constraint rows that stand behind it, in one upper
    triangle; ``indptr``, ``indices``: the stiffness's."""

    def __init__(self, indptr, indices, n: int):
        self.count = len(indptr) - 1 - n
        self.indptr, self.indices = indptr, indices
        if not self.count:
            return
        row = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        self._own, self._side = indices < n, np.flatnonzero((indices >= n) & (row < n))
        self._where = indices[self._side] - n, row[self._side]
        self.indices = indices[self._own]
        starts = np.concatenate([[0], np.cumsum(np.bincount(row[self._own], minlength=n))])
        self.indptr = starts.astype(np.int64)

    def split(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The stiffness's values, and the rows (count, n)."""
        C = np.zeros((self.count, len(self.indptr) - 1))
        if not self.count:
            return values, C
        C[self._where] = values[self._side]
        return values[self._own], C


class TwoLevels:
    """A symmetric cycle for matrices of one pattern (its upper triangle) and one coarse space
    P (n, m): smooth, solve for the smooth part, smooth. The smooth part keeps constraint ``rows``,
    so many, which may be all that holds the body."""

    def __init__(self, indptr, indices, coarse: Coarse, rows: int = 0):
        self._pattern = indptr, indices
        P = coarse.prolongation
        self._P, self._R = P, sp.csr_array(P.T)
        self._R.sort_indices()
        n, m = P.shape
        part = (indptr, indices, P.indptr, P.indices, self._R.indptr, self._R.indices)
        starts, columns = galerkin_pattern(*part, m)
        G = sp.csr_array((np.ones(len(columns), np.int8), columns, starts), shape=(m, m))
        upper = sp.csr_array(sp.triu(G + G.T))
        upper.sort_indices()
        self._coarse = upper.indptr.astype(np.int64), upper.indices
        whole = self._with_rows(upper.data, np.zeros((m, rows)))
        self._solver = make_solver(whole.indptr, whole.indices, symmetric=True, bordered=bool(rows))
        self._blocks = LineBlocks(indptr, indices, coarse.line, coarse.place)
        self._guess = np.random.default_rng(0).standard_normal(n)

    def _with_rows(self, values, side):
        """The coarse matrix bordered by what rows say of its functions, ``side`` (m, rows)."""
        starts, columns = self._coarse
        m, rows = side.shape
        coarse = sp.csr_array((values, columns, starts), shape=(m, m))
        if not rows:
            return coarse
        full = (np.tile(np.arange(rows), m), rows * np.arange(m + 1))
        side = sp.csr_array((side.ravel(), *full), shape=(m, rows))
        corner = sp.csr_array((np.zeros(rows), np.arange(rows), np.arange(rows + 1)), (rows, rows))
        whole = sp.csr_array(sp.block_array([[coarse, side], [None, corner]], format="csr"))
        whole.sort_indices()
        return whole

    def of(self, values: np.ndarray, C: np.ndarray):
        """The preconditioner r → B r of the matrix with these values, B symmetric and positive, for
        the constraint rows C (rows, n)."""
        indptr, indices = self._pattern
        P, R = self._P, self._R
        over = self._blocks.of(values)
        starts, columns = self._coarse
        coarse = galerkin(
            indptr, indices, values, P.indptr, P.indices, P.data, R.indptr, R.indices, R.data,
            starts, columns,
        )  # fmt: skip
        coarse[starts[:-1]] *= 1 + NULL
        factor = self._solver.factorise(self._with_rows(coarse, R @ C.T).data)
        if factor.negative is not None and factor.negative > len(C):
            raise Indefinite(
                f"the matrix is not positive definite (at least {factor.negative - len(C)} "
                "negative eigenvalues); use a direct method"
            )
        multipliers = np.zeros(len(C))

        def times(x):
            return product(indptr, indices, values, x, True)

        v = self._guess
        for _ in range(POWER):
            v = over(times(v / np.linalg.norm(v)))
        largest, self._guess = MARGIN * np.linalg.norm(v), v
        middle, half = (1 + DAMPED) * largest / 2, (1 - DAMPED) * largest / 2

        def smooth(r, last):
            """Chebyshev's iteration for A x = r from 0; r becomes what is left, unless it's the
            ``last``."""
            d = over(r) / middle
            x, rho = d.copy(), half / middle
            for _ in range(DEGREE - 1):
                r -= times(d)
                before, rho = rho, 1 / (2 * middle / half - rho)
                d = rho * before * d + 2 * rho / half * over(r)
                x += d
            if not last:
                r -= times(d)
            return x

        def cycle(r):
            r = np.array(r)
            x = smooth(r, False)
            smooth_part = P @ factor.solve(np.append(R @ r, multipliers))[: P.shape[1]]
            r -= times(smooth_part)
            return x + smooth_part + smooth(r, True)

        return cycle


class LineBlocks:
    """The blocks of a symmetric matrix (its upper triangle) that belong to lines of unknowns, in
    the order of their places: a band, which is factorised."""

    def __init__(self, indptr, indices, line, place):
        n = len(line)
        self._order = np.lexsort((place, line))
        rank = np.empty(n, np.int64)
        rank[self._order] = np.arange(n)
        row = np.repeat(np.arange(n, dtype=np.int32), np.diff(indptr))
        self._inside = np.flatnonzero(line[row] == line[indices])
        i, j = rank[row[self._inside]], rank[indices[self._inside]]
        below = np.abs(i - j)
        self._width = int(below.max()) + 1
        self._at = below * n + np.minimum(i, j)

    def of(self, values: np.ndarray):
        """r → the blocks' inverse times r; raises Indefinite where one isn't positive definite."""
        n, order = len(self._order), self._order
        band = np.zeros(self._width * n)
        band[self._at] = values[self._inside]
        try:
            band = cholesky_banded(
                band.reshape(-1, n), lower=True, overwrite_ab=True, check_finite=False
            )
        except LinAlgError:
            raise Indefinite(
                "the matrix is not positive definite on a line of unknowns; use a direct method"
            ) from None

        def solve(r):
            out = np.empty(n)
            out[order] = cho_solve_banded(
                (band, True), r[order], overwrite_b=True, check_finite=False
            )
            return out

        return solve
