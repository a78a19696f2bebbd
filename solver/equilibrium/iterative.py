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

What is found of the matrix on the way is said: where it is not positive definite there is no answer
but :class:`Indefinite`. Nothing is counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import scipy.sparse as sp
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from solver.equilibrium.linear import Factor, SingularMatrix, make_solver
from solver.mesh.body import Body
from solver.mesh.corners import aspect, corner_weights, lines
from solver.physics.supports import Held

# Matrix products of one smoothing; the part of the spectrum, from the top, that it damps; how far
# above its estimate the largest eigenvalue may lie; products for the estimate.
DEGREE, DAMPED, MARGIN, POWER = 3, 0.07, 1.15, 12
# Aspect ratio of the cells above which corners turn.
FLAT = 3.0
# Turning all corners alike moves nothing: what holds these motions, beside their diagonal.
NULL = 1e-10


class Indefinite(SingularMatrix):
    """The matrix is not positive definite, as beyond a critical point of an equilibrium path."""


@dataclass(frozen=True, eq=False)
class Coarse:
    """What two levels need beside the matrix.

    ``prolongation`` (n, m): its columns span the smooth functions; ``line`` (n,): unknowns of one
    line are smoothed together, in the order of ``place`` (n,), in which they couple to neighbours.
    """

    prolongation: sp.csr_array
    line: np.ndarray
    place: np.ndarray

    @classmethod
    def of(cls, body: Body, held: Held) -> Coarse | None:
        """That of the free unknowns of a body; None for linear elements."""
        P = prolongation(body, held)
        if P is None:
            return None
        line, place = lines(body)
        return cls(P, line[held.index // 3], place[held.index // 3])


def rigid_modes(body: Body, held: Held) -> np.ndarray:
    """Translations and rotations in the free unknowns, (n_free, 6)."""
    arm = (body.nodes - body.nodes.mean(axis=0)) / body.length
    modes = [np.broadcast_to(axis, arm.shape) for axis in np.eye(3)]
    modes += [np.cross(axis, arm) for axis in np.eye(3)]
    return np.column_stack([held.to_local(m.copy()).ravel()[held.index] for m in modes])


def prolongation(body: Body, held: Held) -> sp.csr_array | None:
    """Free unknowns (n_free, m) of the motions of the cells' corners; None for linear elements.

    A corner that moves takes along what the linear functions say; one that turns, too, about
    itself. What supports prescribe of a corner is left out.
    """
    found = corner_weights(body)
    if found is None:
        return None
    corners, W = found
    W = W.tocoo()
    arm = (body.nodes[W.row] - body.nodes[corners[W.col]]) / body.length * len(corners) ** (1 / 3)
    axes = held.frames[corners][W.col]  # columns are the corner's own axes
    kept = held.free.reshape(-1, 3)[corners] | np.isin(corners, held.tied // 3)[:, None]
    columns = [(axes[:, :, k], kept[:, k]) for k in range(3)]
    if aspect(body) > FLAT:
        # One that can't move across an axis can't turn about it.
        turns = [kept[:, (k + 1) % 3] | kept[:, (k + 2) % 3] for k in range(3)]
        columns += [(np.cross(axes[:, :, k], arm), turns[k]) for k in range(3)]
    number = np.cumsum(np.column_stack([on for _, on in columns]).ravel()) - 1
    number = number.reshape(len(corners), -1)
    parts = []
    for k, (motion, on) in enumerate(columns):
        use = on[W.col]
        at = 3 * W.row[use, None] + np.arange(3)
        to = np.broadcast_to(number[W.col[use], k][:, None], at.shape)
        parts.append(((W.data[:, None] * motion)[use].ravel(), at.ravel(), to.ravel()))
    data, rows, cols = (np.concatenate(part) for part in zip(*parts, strict=True))
    P = sp.csr_array((data, (rows, cols)), (3 * len(body.nodes), number.max() + 1))
    if len(held.turned):
        frames = sp.bsr_array(
            (held.frames.transpose(0, 2, 1), np.arange(len(body.nodes)),
             np.arange(len(body.nodes) + 1)),
        )  # fmt: skip
        P = sp.csr_array(frames @ P)
    P = P[held.index]
    P.eliminate_zeros()
    P = P[:, np.flatnonzero(np.bincount(P.indices, minlength=P.shape[1]))]
    P.sort_indices()
    return P


class ConjugateGradients:
    """See the module; ``iterations`` of the latest solve.

    ``rtol``: of √(rᵀBr), where B is the preconditioner: the error of the solution in the norm of
    the energy, up to how well B does. Newton's corrections are right to so many digits of theirs.
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
        self.n = len(indptr) - 1
        self.iterations = 0
        self._indptr, self._indices = np.asarray(indptr), np.asarray(indices)
        self._modes, self._rtol, self._most = modes, rtol, most
        self._levels = None if coarse is None else TwoLevels(self._indptr, self._indices, coarse)

    def factorise(self, values: np.ndarray) -> Factor:
        """Set up the preconditioner for the matrix with these values; shape (nnz,).

        Raises Indefinite where it shows that the matrix is not positive definite.
        """
        prepare = self._aggregated if self._levels is None else self._levels.of
        precondition = prepare(values)

        def solve(b, transposed=False):
            if b.ndim == 2:
                return np.column_stack([solve(column) for column in b.T])
            return self._solve(values, precondition, b)

        return Factor(solve, None)

    def _aggregated(self, values):
        import pyamg

        upper = sp.csr_array((values, self._indices, self._indptr), shape=(self.n, self.n))
        matrix = sp.csr_matrix(upper + sp.triu(upper, 1).T)
        hierarchy = pyamg.smoothed_aggregation_solver(
            matrix, B=self._modes, strength=("symmetric", {"theta": 0.02}), max_coarse=300
        )
        return hierarchy.aspreconditioner().matvec

    def _solve(self, values, precondition, b):
        self.iterations = 0
        x, r = np.zeros(self.n), np.array(b, dtype=float)
        z = precondition(r)
        p, size = z.copy(), r @ z
        goal = self._rtol**2 * size
        while size > goal:
            if self.iterations == self._most:
                raise SingularMatrix(
                    f"conjugate gradients did not converge in {self._most} iterations: the matrix "
                    "is badly conditioned; use a direct method"
                )
            self.iterations += 1
            q = product(self._indptr, self._indices, values, p, True)
            curvature = p @ q
            if curvature <= 0:
                raise Indefinite(
                    "conjugate gradients met a direction of negative curvature: the matrix is not "
                    "positive definite; use a direct method"
                )
            x += size / curvature * p
            r -= size / curvature * q
            z = precondition(r)
            before, size = size, r @ z
            p = z + size / before * p
        if not np.isfinite(x).all() or not np.isfinite(size) or size < 0:
            raise SingularMatrix(
                "conjugate gradients broke down: the matrix is not positive definite or not "
                "finite; use a direct method"
            )
        return x


class TwoLevels:
    """A symmetric cycle for matrices of one pattern (its upper triangle) and one coarse space
    P (n, m): smooth, solve for the smooth part, smooth."""

    def __init__(self, indptr, indices, coarse: Coarse):
        self._pattern = indptr, indices
        P = coarse.prolongation
        self._P, self._R = P, sp.csr_array(P.T)
        self._R.sort_indices()
        n, m = P.shape
        part = (indptr, indices, P.indptr, P.indices, self._R.indptr, self._R.indices)
        starts, columns = _coarse_pattern(*part, m)
        G = sp.csr_array((np.ones(len(columns), np.int8), columns, starts), shape=(m, m))
        upper = sp.csr_array(sp.triu(G + G.T))
        upper.sort_indices()
        self._coarse = upper.indptr.astype(np.int64), upper.indices
        self._solver = make_solver(upper.indptr, upper.indices, symmetric=True)
        self._blocks = LineBlocks(indptr, indices, coarse.line, coarse.place)
        self._guess = np.random.default_rng(0).standard_normal(n)

    def of(self, values: np.ndarray):
        """The preconditioner r → B r of the matrix with these values, B symmetric and positive."""
        indptr, indices = self._pattern
        P, R = self._P, self._R
        over = self._blocks.of(values)
        starts, columns = self._coarse
        coarse = _galerkin(
            indptr, indices, values, P.indptr, P.indices, P.data, R.indptr, R.indices, R.data,
            starts, columns,
        )  # fmt: skip
        coarse[starts[:-1]] *= 1 + NULL
        factor = self._solver.factorise(coarse)
        if factor.negative:
            raise Indefinite(
                f"the matrix is not positive definite (at least {factor.negative} negative "
                "eigenvalues); use a direct method"
            )

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
            smooth_part = P @ factor.solve(R @ r)
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


@numba.njit(cache=True)
def product(indptr, indices, values, x, symmetric):
    """The matrix times x; of a symmetric one the upper triangle is stored."""
    out = np.zeros(len(x))
    for i in range(len(x)):
        total = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            total += values[k] * x[j]
            if symmetric and j != i:
                out[j] += values[k] * x[i]
        out[i] += total
    return out


@numba.njit(cache=True)
def _coarse_pattern(starts, columns, p_starts, p_columns, r_starts, r_columns, m):
    """Pattern of Pᵀ U P of an upper triangle U, (m, m), columns not sorted."""
    seen_fine, seen = np.full(len(starts) - 1, -1), np.full(m, -1)
    indptr = np.zeros(m + 1, np.int64)
    out = np.empty(64 * m, np.int32)
    at = 0
    for p in range(m):
        if at + m > len(out):
            bigger = np.empty(2 * len(out) + m, np.int32)
            bigger[:at] = out[:at]
            out = bigger
        for k in range(r_starts[p], r_starts[p + 1]):
            i = r_columns[k]
            for e in range(starts[i], starts[i + 1]):
                j = columns[e]
                if seen_fine[j] == p:
                    continue
                seen_fine[j] = p
                for h in range(p_starts[j], p_starts[j + 1]):
                    q = p_columns[h]
                    if seen[q] != p:
                        seen[q] = p
                        out[at] = q
                        at += 1
        indptr[p + 1] = at
    return indptr, out[:at].copy()


@numba.njit(cache=True)
def _galerkin(
    starts, columns, values, p_starts, p_columns, p_values, r_starts, r_columns, r_values,
    c_starts, c_columns,
):  # fmt: skip
    """Upper triangle of PᵀAP, of the upper triangle of A: with A = U + Uᵀ, the diagonal halved."""
    n, m = len(starts) - 1, len(c_starts) - 1
    row, seen_fine, fine = np.zeros(n), np.full(n, -1), np.empty(n, np.int32)
    total, seen, touched = np.zeros(m), np.full(m, -1), np.empty(m, np.int32)
    out = np.zeros(len(c_columns))
    for p in range(m):
        count = 0
        for k in range(r_starts[p], r_starts[p + 1]):
            i, w = r_columns[k], r_values[k]
            for e in range(starts[i], starts[i + 1]):
                j = columns[e]
                if seen_fine[j] != p:
                    seen_fine[j] = p
                    row[j] = 0.0
                    fine[count] = j
                    count += 1
                row[j] += (0.5 if i == j else 1.0) * w * values[e]
        several = 0
        for k in range(count):
            j = fine[k]
            for h in range(p_starts[j], p_starts[j + 1]):
                q = p_columns[h]
                if seen[q] != p:
                    seen[q] = p
                    total[q] = 0.0
                    touched[several] = q
                    several += 1
                total[q] += row[j] * p_values[h]
        for k in range(several):
            q = touched[k]
            a, b = min(p, q), max(p, q)
            low, high = c_starts[a], c_starts[a + 1]
            while high - low > 1:
                middle = (low + high) // 2
                if c_columns[middle] <= b:
                    low = middle
                else:
                    high = middle
            out[low] += total[q] * (2.0 if p == q else 1.0)
    return out
