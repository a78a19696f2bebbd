"""Sparse linear systems behind one small interface: factorise, solve, count negative pivots.

PARDISO (through MKL) where it is installed: the pattern is analysed once, each matrix is factorised
anew, and a symmetric indefinite factorisation gives the inertia. SuperLU elsewhere; its inertia
comes from the signs of U's diagonal, which are those of an LDLᵀ only without pivoting, so it counts
only where no row was exchanged. Conjugate gradients, for large positive definite systems:
:mod:`solver.equilibrium.iterative`.
"""

from __future__ import annotations

import ctypes
import os
import weakref
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, files
from typing import TYPE_CHECKING

import numba
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

if TYPE_CHECKING:
    from solver.equilibrium.iterative import Coarse

_INT = ctypes.c_int32
_NONE = np.zeros(1)
_ZERO = (_INT * 1)(0)
# Unknowns below which minimum degree is the better ordering.
SMALL = 20_000


class SingularMatrix(ArithmeticError):
    """The factorisation met a zero pivot or ran out of memory; the message says which."""


class Factor:
    """A factorised matrix: ``solve``, and ``negative`` pivots (None where they can't be trusted).

    It is valid until the solver that made it factorises again.
    """

    def __init__(self, solve, negative: int | None, alive=lambda: True):
        self._solve = solve
        self._alive = alive
        self.negative = negative

    @property
    def alive(self) -> bool:
        """Whether no later factorisation has overwritten this one."""
        return self._alive()

    def solve(self, b: np.ndarray, *, transposed: bool = False) -> np.ndarray:
        """x of A x = b, or of Aᵀ x = b; shape (n,) or (n, k)."""
        return self._solve(b, transposed)


class ScaledFactor(Factor):
    """Factor of A, made of the factor of D A D with a positive diagonal D (same inertia)."""

    def __init__(self, inner: Factor, scale: np.ndarray):
        def solve(b, transposed):
            d = scale if b.ndim == 1 else scale[:, None]
            return d * inner.solve(d * b, transposed=transposed)

        super().__init__(solve, inner.negative, lambda: inner.alive)


class DyadFactor(Factor):
    """Factor of A + Σ c g gᵀ, c > 0, made of that of A; ``vectors`` (n, m): √c g.

    By Sherman, Morrison and Woodbury, and with S = 1 + VᵀA⁻¹V its negative pivots are those of A
    less the negative ones of S (Haynsworth): both are what is left of one bordered matrix.
    """

    def __init__(self, inner: Factor, vectors: np.ndarray):
        forward = inner.solve(vectors)
        small = np.eye(vectors.shape[1]) + vectors.T @ forward
        if not np.isfinite(small).all() or np.linalg.cond(small) > 1e15:
            raise SingularMatrix("the matrix is singular together with its dyads")

        def solve(b, transposed):
            y = inner.solve(b, transposed=transposed)
            back = inner.solve(vectors, transposed=True) if transposed else forward
            return y - back @ np.linalg.solve(small.T if transposed else small, vectors.T @ y)

        negative = inner.negative
        if negative is not None:
            negative -= int((np.linalg.eigvalsh((small + small.T) / 2) < 0).sum())
        super().__init__(solve, negative, lambda: inner.alive)


def make_solver(
    indptr,
    indices,
    *,
    symmetric: bool,
    method: str = "auto",
    bordered: bool = False,
    modes: np.ndarray | None = None,
    coarse: Coarse | None = None,
    block: int = 1,
):
    """A solver for one sparsity pattern.

    ``indptr``, ``indices``: CSR with sorted indices; for a symmetric matrix its upper triangle,
    each diagonal entry present. ``method``: ``pardiso``, ``superlu``, ``auto`` (the first that is
    installed), or ``cg`` (needs a symmetric matrix, and ``modes`` (n, 6): the rigid motions in its
    unknowns; with ``coarse`` it works on two levels). ``bordered``: the matrix has constraint rows
    with a zero diagonal. ``block``: order of the square blocks that the pattern is one of, see
    :class:`Pardiso`, which alone takes them.

    Raises ValueError for an unknown method or one that does not suit the matrix, ImportError if
    PARDISO was asked for and MKL is missing.
    """
    if method not in ("auto", "pardiso", "superlu", "cg"):
        raise ValueError(f"method {method!r}; expected auto, pardiso, superlu or cg")
    if method == "cg":
        if not symmetric or modes is None:
            raise ValueError("conjugate gradients need a symmetric matrix and its rigid modes")
        from solver.equilibrium.iterative import ConjugateGradients

        return ConjugateGradients(indptr, indices, modes, coarse)
    if method == "superlu" or (method == "auto" and mkl_pardiso() is None):
        return SuperLU(indptr, indices, symmetric=symmetric)
    return Pardiso(indptr, indices, symmetric=symmetric, bordered=bordered, block=block)


@lru_cache(maxsize=1)
def mkl_pardiso():
    """MKL's PARDISO, loaded at the first call; None where it is not installed."""
    # pypardiso looks for this library all through the environment, twice, unless told.
    with suppress(PackageNotFoundError):
        mine = [f for f in files("mkl") or () if f.name.startswith("libmkl_rt")]
        if mine and mine[0].locate().exists():
            os.environ.setdefault("PYPARDISO_MKL_RT", str(mine[0].locate()))
    try:
        from pypardiso.pardiso_wrapper import PyPardisoSolver

        return PyPardisoSolver().libmkl.pardiso
    except (ImportError, OSError):
        return None


class Pardiso:
    """One PARDISO handle for one pattern; its memory is freed with the object.

    ``block``: order of dense square blocks that the pattern is one of, whose values then stand
    column by column; those on the diagonal are whole. Such an analysis takes a tenth of the time.
    """

    def __init__(self, indptr, indices, *, symmetric: bool, bordered: bool = False, block: int = 1):
        self._call = mkl_pardiso()
        if self._call is None:
            raise ImportError("PARDISO needs MKL: install pypardiso, or use method='superlu'")
        self.n = len(indptr) - 1
        self._ia = np.asarray(indptr, dtype=np.int32) + 1
        self._ja = np.asarray(indices, dtype=np.int32) + 1
        self._handle = np.zeros(64, dtype=np.int64)
        self._type = -2 if symmetric else 11
        self.iparm = np.zeros(64, dtype=np.int32)
        self.iparm[0] = 1  # no defaults
        self.iparm[36] = block if block > 1 else 0
        # Minimum degree takes a quarter of the time that nested dissection (METIS) takes to order
        # a small matrix, and its factors are no larger.
        self.iparm[1] = 0 if block * self.n < SMALL else 2
        # Below 0 it would refine in higher precision, and at 0 twice where pivots were perturbed.
        self.iparm[7] = 0
        self.iparm[9] = (
            (8 if bordered else 13) if symmetric else 13
        )  # perturb pivots below 10^-this
        self.iparm[10] = self.iparm[12] = 0 if symmetric else 1
        self._bordered = bordered
        # Pivots of 1 × 1 are a quarter faster and do for a stiffness; with constraint rows, or
        # where one of them failed, Bunch–Kaufman's 2 × 2.
        self.iparm[20] = 1 if bordered else 0
        self._analysed = False
        self._values = np.zeros(0)
        self._generation = 0
        # To make a pointer takes longer than a small solve.
        whole = (self._ia, self._ja, self.iparm)
        self._at = _pointer(self._handle, ctypes.c_int64), *(_pointer(a, _INT) for a in whole)
        weakref.finalize(self, _release, self._call, self._handle, self._type, self.n)

    def factorise(self, values: np.ndarray) -> Factor:
        """Factorise the matrix with these values on the pattern; shape (nnz,)."""
        self._values = np.ascontiguousarray(values, dtype=float)
        if not self._analysed:
            self._run(11)
            self._analysed = True
        self._run(22)
        if self._type == -2 and self.iparm[13] > 0 and (self._bordered or self.iparm[20] == 0):
            # Scaling and matching keep a constraint row from being eliminated at its zero diagonal,
            # but hold only for values like those of the analysis: it is repeated when they fail.
            self.iparm[10] = self.iparm[12] = 1 if self._bordered else 0
            self.iparm[20] = 1
            self._analyse_again()
        if self._type == -2 and self.iparm[13] > 0:
            # A small pivot belongs to the order of elimination more often than to the matrix.
            self.iparm[1] = 2 - self.iparm[1]
            self._analyse_again()
        self._generation += 1
        born = self._generation
        negative = None
        if self._type == -2 and self.iparm[13] == 0:
            negative = int(self.iparm[22])

        def solve(b, transposed):
            if born != self._generation:
                raise RuntimeError("this factor was overwritten by a later factorisation")
            columns = 1 if b.ndim == 1 else b.shape[1]
            right = np.array(b, dtype=float, order="F")
            x = np.zeros_like(right, order="F")
            # PARDISO stores rows where its solve expects columns: 2 asks for Aᵀ.
            self.iparm[11] = 2 if transposed else 0
            self._run(33, right, x, columns)
            self.iparm[11] = 0
            return x

        return Factor(solve, negative, lambda: born == self._generation)

    def _analyse_again(self) -> None:
        self._run(-1)
        self._handle[:] = 0
        self._run(12)

    def _run(self, phase: int, b: np.ndarray = _NONE, x: np.ndarray = _NONE, columns: int = 1):
        handle, ia, ja, iparm = self._at
        error = _pardiso(
            self._call, handle, self._type, phase, self.n, _pointer(self._values), ia, ja, columns,
            iparm, _pointer(b), _pointer(x),
        )  # fmt: skip
        if error:
            raise SingularMatrix(_PARDISO_ERRORS.get(error, f"PARDISO failed with error {error}"))


_PARDISO_ERRORS = {
    -2: "not enough memory to factorise the matrix",
    -3: "the matrix could not be reordered",
    -4: "the matrix is singular (zero pivot)",
    -7: "the matrix is singular (zero diagonal)",
}


def _pointer(values: np.ndarray, kind=None):
    if kind is None:
        return values.__array_interface__["data"][0]
    return values.ctypes.data_as(ctypes.POINTER(kind))


def _pardiso(call, handle, kind, phase, n, values, ia, ja, columns, iparm, b, x) -> int:
    """PARDISO's error of one phase; arrays are given by their pointers."""

    def number(value):
        return ctypes.byref(_INT(value))

    error = _INT(0)
    call(
        handle, number(1), number(1), number(kind), number(phase), number(n), values, ia, ja,
        _ZERO, number(columns), iparm, number(0), b, x, ctypes.byref(error),
    )  # fmt: skip
    return error.value


def _release(call, handle, kind, n) -> None:
    empty, one = _pointer(_NONE), _pointer(np.ones(1, np.int32), _INT)
    iparm = _pointer(np.zeros(64, np.int32), _INT)
    handle = _pointer(handle, ctypes.c_int64)
    _pardiso(call, handle, kind, -1, n, empty, one, one, 1, iparm, empty, empty)


class SuperLU:
    """SciPy's SuperLU with the same interface; slower, analyses each time."""

    def __init__(self, indptr, indices, *, symmetric: bool):
        self.n = len(indptr) - 1
        self._pattern = (np.asarray(indices), np.asarray(indptr))
        self._symmetric = symmetric

    def factorise(self, values: np.ndarray) -> Factor:
        """Factorise the matrix with these values on the pattern; shape (nnz,)."""
        matrix = sp.csr_array((values, *self._pattern), shape=(self.n, self.n))
        if self._symmetric:
            matrix = matrix + sp.triu(matrix, 1).T
        try:
            # Diagonal pivots where they can be kept leave the signs of an LDLᵀ factorisation.
            options = {"SymmetricMode": True} if self._symmetric else {}
            lu = splu(
                matrix.tocsc(),
                permc_spec="MMD_AT_PLUS_A" if self._symmetric else "COLAMD",
                diag_pivot_thresh=1e-8 if self._symmetric else 1.0,
                options=options,
            )
        except (RuntimeError, MemoryError) as error:
            raise SingularMatrix(f"SuperLU: {error}") from None
        negative = None
        if self._symmetric and np.array_equal(lu.perm_r, lu.perm_c):
            negative = int(np.sum(lu.U.diagonal() < 0))
        return Factor(lambda b, transposed: lu.solve(b, "T" if transposed else "N"), negative)


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
def galerkin_pattern(starts, columns, p_starts, p_columns, r_starts, r_columns, m):
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
def galerkin(
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
