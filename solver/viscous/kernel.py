"""One step of Maxwell branches beside a spring and a dashpot at every point, compiled.

The incremental potential of :mod:`solver.viscous.rheology` in C, with Y = C_v⁻¹ per branch as
unknown:

    w = ψ₀(C) + k₀ [tr CP₀ + tr C⁻¹Q₀] + Σ_b min over Y of ψ_b(CY) + k_b [tr Y⁻¹P_b + tr YQ_b],

k = η/(8 Δt); P and Q hold the past (P = C₁⁻¹, Q = C₁ for backward Euler). Newton in Y with steps
shortened in the metric of Y keeps Y positive; the tangent is condensed, H_CC − H_CY H_YY⁻¹ H_YC.
Symmetric tensors are vectors of six, (11, 22, 33, 23, 13, 12) with √2 on the last three, so that
products of vectors are contractions.
"""

from __future__ import annotations

from math import isfinite, log, sqrt

import numba
import numpy as np

I6, J6 = np.array([0, 1, 2, 1, 0, 0]), np.array([0, 1, 2, 2, 2, 1])
S6 = np.array([1, 1, 1, np.sqrt(2), np.sqrt(2), np.sqrt(2)])
V9 = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
# Numbers per point: λ, μ, k, the constant of its term, P, Q; and of a branch the last Y.
HEAD, BRANCH = 16, 22
ITERATIONS = 60


def six(X: np.ndarray) -> np.ndarray:
    """Vectors (..., 6) of symmetric tensors (..., 3, 3)."""
    return X[..., I6, J6] * S6


def nine(x: np.ndarray) -> np.ndarray:
    """Symmetric tensors (..., 3, 3) of vectors (..., 6)."""
    return (x / S6)[..., V9]


def inverse(x: np.ndarray) -> np.ndarray:
    """Inverses of symmetric tensors, all as vectors (..., 6)."""
    flat = np.ascontiguousarray(x, dtype=float).reshape(-1, 6)
    out = np.empty_like(flat)
    _inverses(flat, out)
    return out.reshape(x.shape)


@numba.njit(cache=True)
def _inverses(x, out):
    for n in range(len(x)):
        _inverse(x[n], out[n])


@numba.njit(cache=True, inline="always")
def _inverse(x, out):
    """Inverse of a symmetric tensor, vectors of six; returns the determinant."""
    r = 0.7071067811865476
    a, b, c, d, e, f = x[0], x[1], x[2], r * x[3], r * x[4], r * x[5]
    A, B, C = b * c - d * d, d * e - c * f, d * f - b * e
    det = a * A + f * B + e * C
    s = 1.0 / det if det != 0.0 else 0.0
    t = s / r
    out[0], out[1], out[2] = A * s, (a * c - e * e) * s, (a * b - f * f) * s
    out[3], out[4], out[5] = (e * f - a * d) * t, C * t, B * t
    return det


@numba.njit(cache=True, inline="always")
def _full(x, out):
    r = 0.7071067811865476
    out[0, 0], out[1, 1], out[2, 2] = x[0], x[1], x[2]
    out[1, 2] = out[2, 1] = r * x[3]
    out[0, 2] = out[2, 0] = r * x[4]
    out[0, 1] = out[1, 0] = r * x[5]


@numba.njit(cache=True, inline="always")
def _product(A, B, out):
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@numba.njit(cache=True, inline="always")
def _sandwich(a, p, out, A, B, T):
    """a p a of symmetric tensors; leaves a in A and the result in B."""
    _full(a, A)
    _full(p, B)
    _product(A, B, T)
    for i in range(3):
        for j in range(i, 3):
            v = T[i, 0] * A[0, j] + T[i, 1] * A[1, j] + T[i, 2] * A[2, j]
            B[i, j] = B[j, i] = v
    r = 1.4142135623730951
    out[0], out[1], out[2] = B[0, 0], B[1, 1], B[2, 2]
    out[3], out[4], out[5] = r * B[1, 2], r * B[0, 2], r * B[0, 1]


@numba.njit(cache=True, inline="always")
def _add_pair(H, s, X, Z):
    """H += s · the operator B → sym(½ (X B Z + Z B X))."""
    r = 1.4142135623730951
    for a in range(6):
        i, j = (a, a) if a < 3 else ((1, 2) if a == 3 else ((0, 2) if a == 4 else (0, 1)))
        for b in range(a, 6):
            k, m = (b, b) if b < 3 else ((1, 2) if b == 3 else ((0, 2) if b == 4 else (0, 1)))
            v = X[i, k] * Z[j, m] + X[i, m] * Z[j, k] + Z[i, k] * X[j, m] + Z[i, m] * X[j, k]
            v *= 0.25 * s
            if a > 2:
                v *= r
            if b > 2:
                v *= r
            H[a, b] += v
            if a != b:
                H[b, a] += v


@numba.njit(cache=True, inline="always")
def _cholesky(H, L):
    """Lower factor of H (6, 6); False where H is not positive definite."""
    for i in range(6):
        for j in range(i + 1):
            v = H[i, j]
            for k in range(j):
                v -= L[i, k] * L[j, k]
            if i == j:
                if not v > 0.0:
                    return False
                L[i, i] = sqrt(v)
            else:
                L[i, j] = v / L[j, j]
    return True


@numba.njit(cache=True, inline="always")
def _forward(L, b):
    for i in range(6):
        v = b[i]
        for k in range(i):
            v -= L[i, k] * b[k]
        b[i] = v / L[i, i]


@numba.njit(cache=True, inline="always")
def _backward(L, b):
    for i in range(5, -1, -1):
        v = b[i]
        for k in range(i + 1, 6):
            v -= L[k, i] * b[k]
        b[i] = v / L[i, i]


@numba.njit(cache=True)
def step(F, table, order, w, P, A, inner):
    """Fills w (c, q), P and A as a material's kernel does, and C_v⁻¹ (c, q, branches, 6).

    F (c, q, 3, 3) is F_ve; ``table`` (1 | c, 1 | q, HEAD + BRANCH · branches), k = 0 and μ = 0
    where a part is absent. ``inner`` of no length is not filled. False for a state that is not
    admissible: det F ≤ 0, or a point whose own Newton did not end.
    """
    n_branches = (table.shape[2] - HEAD) // BRANCH
    per_cell, per_point = table.shape[0] > 1, table.shape[1] > 1
    keep = inner.shape[0] > 0
    C, Ci, R = np.empty(6), np.empty(6), np.empty(6)
    Y, Yi, YPY = np.empty(6), np.empty(6), np.empty(6)
    g, gY, d, col = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    H, HY, L, W = np.empty((6, 6)), np.empty((6, 6)), np.zeros((6, 6)), np.empty((6, 6))
    M1, M2, T, D3 = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    D = np.empty((3, 3, 3, 3))
    B = np.empty((3, 3, 3, 3))
    r = 1.4142135623730951
    for c in range(F.shape[0]):
        for q in range(F.shape[1]):
            p = table[c if per_cell else 0, q if per_point else 0]
            f = F[c, q]
            for a in range(6):
                i, j = (a, a) if a < 3 else ((1, 2) if a == 3 else ((0, 2) if a == 4 else (0, 1)))
                C[a] = f[0, i] * f[0, j] + f[1, i] * f[1, j] + f[2, i] * f[2, j]
                if a > 2:
                    C[a] *= r
            J = (
                f[0, 0] * (f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1])
                - f[0, 1] * (f[1, 0] * f[2, 2] - f[1, 2] * f[2, 0])
                + f[0, 2] * (f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0])
            )
            if not (J > 0.0 and isfinite(J)):
                w[c, q] = np.inf
                return False
            _inverse(C, Ci)
            lnJ = log(J)
            g[:] = 0.0
            H[:] = 0.0
            lam, mu, k = p[0], p[1], p[2]
            energy = 0.5 * mu * (C[0] + C[1] + C[2] - 3.0 - 2.0 * lnJ) + 0.5 * lam * lnJ * lnJ
            s = 0.5 * (lam * lnJ - mu)
            for a in range(6):
                g[a] += s * Ci[a]
            for a in range(3):
                g[a] += 0.5 * mu
            square, pair = 0.25 * lam, -s
            if k > 0.0:
                Pk, Qk = p[4:10], p[10:16]
                _sandwich(Ci, Qk, R, M1, M2, T)
                energy -= k * p[3]
                for a in range(6):
                    energy += k * (C[a] * Pk[a] + Ci[a] * Qk[a])
                    g[a] += k * (Pk[a] - R[a])
                if order >= 2:
                    _add_pair(H, 2.0 * k, M1, M2)
            for n in range(n_branches):
                b = p[HEAD + BRANCH * n : HEAD + BRANCH * (n + 1)]
                lam, mu, k = b[0], b[1], b[2]
                Pk, Qk = b[4:10], b[10:16]
                for a in range(6):
                    Y[a] = b[16 + a]
                done = False
                x, s = 0.0, 0.0
                for _ in range(ITERATIONS):
                    det = _inverse(Y, Yi)
                    if not (det > 0.0 and isfinite(det)):
                        break
                    x = lnJ + 0.5 * log(det)
                    s = 0.5 * (lam * x - mu)
                    _sandwich(Yi, Pk, YPY, M1, M2, T)
                    for a in range(6):
                        gY[a] = 0.5 * mu * C[a] + s * Yi[a] + k * (Qk[a] - YPY[a])
                        d[a] = -gY[a]
                    for i in range(6):
                        for j in range(6):
                            HY[i, j] = 0.25 * lam * Yi[i] * Yi[j]
                    _add_pair(HY, 2.0 * k, M1, M2)
                    _add_pair(HY, -s, M1, M1)
                    convex = _cholesky(HY, L)
                    if not convex:
                        # Far from the solution: without the part that lost convexity.
                        HY[:] = 0.0
                        _add_pair(HY, 2.0 * k, M1, M2)
                        _add_pair(HY, 0.5 * mu + 1e-3 * k, M1, M1)
                        if not _cholesky(HY, L):
                            break
                    _forward(L, d)
                    _backward(L, d)
                    # |Y^-1/2 d Y^-1/2|, below 1 where Y + d is positive.
                    _full(d, D3)
                    size = 0.0
                    _product(M1, D3, T)
                    for i in range(3):
                        for j in range(3):
                            size += T[i, j] * T[j, i]
                    size = sqrt(max(size, 0.0))
                    t = 1.0 if size < 0.6 else 0.6 / size
                    for a in range(6):
                        Y[a] += t * d[a]
                    # The step is quadratic: after one of 1e-9 nothing remains.
                    if size < 1e-9 and convex:
                        done = True
                        break
                if not done:
                    w[c, q] = np.inf
                    return False
                x = lnJ + 0.5 * log(_inverse(Y, Yi))
                s = 0.5 * (lam * x - mu)
                trace = 0.0
                for a in range(6):
                    trace += C[a] * Y[a]
                    energy += k * (Yi[a] * Pk[a] + Y[a] * Qk[a])
                    g[a] += 0.5 * mu * Y[a] + s * Ci[a]
                energy += 0.5 * mu * (trace - 3.0 - 2.0 * x) + 0.5 * lam * x * x - k * b[3]
                if keep:
                    for a in range(6):
                        inner[c, q, n, a] = Y[a]
                if order < 2:
                    continue
                square += 0.25 * lam
                pair -= s
                # H_YY at the last Newton point is that at Y to its tolerance.
                for i in range(6):
                    for j in range(6):
                        W[i, j] = 0.25 * lam * Yi[i] * Ci[j]
                    W[i, i] += 0.5 * mu
                for j in range(6):
                    for i in range(6):
                        col[i] = W[i, j]
                    _forward(L, col)
                    for i in range(6):
                        W[i, j] = col[i]
                for i in range(6):
                    for j in range(i, 6):
                        v = 0.0
                        for m in range(6):
                            v += W[m, i] * W[m, j]
                        H[i, j] -= v
                        if i != j:
                            H[j, i] -= v
            w[c, q] = energy
            if not isfinite(energy):
                return False
            if order < 1:
                continue
            _full(g, T)
            _product(f, T, P[c, q])
            for i in range(3):
                for j in range(3):
                    P[c, q, i, j] *= 2.0
            if order < 2:
                continue
            _full(Ci, M1)
            _add_pair(H, pair, M1, M1)
            for i in range(6):
                for j in range(6):
                    H[i, j] += square * Ci[i] * Ci[j]
            # A_iJkL = 2 δ_ik w_JL + 4 F_iI w_IJKL F_kK
            for i in range(3):
                for j in range(i, 3):
                    a = i if i == j else (3 if i == 1 else (4 if j == 2 else 5))
                    for m in range(3):
                        for n in range(m, 3):
                            b2 = m if m == n else (3 if m == 1 else (4 if n == 2 else 5))
                            v = 4.0 * H[a, b2]
                            if a > 2:
                                v /= r
                            if b2 > 2:
                                v /= r
                            D[i, j, m, n] = D[j, i, m, n] = D[i, j, n, m] = D[j, i, n, m] = v
            for i in range(3):
                for j in range(3):
                    for m in range(3):
                        for n in range(3):
                            B[i, j, m, n] = (
                                f[i, 0] * D[0, j, m, n]
                                + f[i, 1] * D[1, j, m, n]
                                + f[i, 2] * D[2, j, m, n]
                            )
            t4 = A[c, q]
            for i in range(3):
                for j in range(3):
                    for m in range(3):
                        for n in range(3):
                            t4[i, j, m, n] = (
                                f[m, 0] * B[i, j, 0, n]
                                + f[m, 1] * B[i, j, 1, n]
                                + f[m, 2] * B[i, j, 2, n]
                            )
                    for n in range(3):
                        t4[i, j, i, n] += 2.0 * T[j, n]
    return True
