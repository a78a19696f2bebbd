"""Compiled loops of the elastic term over chunks of cells.

A chunk keeps the tangents of a few hundred points in cache between the material's kernel and the
assembly; no array of element matrices ever exists.
"""

from __future__ import annotations

import numba
import numpy as np

# Below this many pairs (point, node) direct loops beat the matrix product.
SMALL = 64


@numba.njit(cache=True)
def deform(ids, cells, gradients, u, inverse, G, F):
    """Grown gradients ĝ_a = Fg⁻ᵀ g_a into G (c, q, 3, k) and Fe = Fg⁻¹ + Σ u_a ⊗ ĝ_a into F.

    ``inverse`` (0 | 1 | m, 1 | q, 3, 3) is Fg⁻¹; empty without growth.
    """
    q_n, k = gradients.shape[1:3]
    grown, per_cell, per_point = len(inverse) > 0, len(inverse) > 1, inverse.shape[1] > 1
    for c in range(len(ids)):
        e = ids[c]
        for q in range(q_n):
            g = G[c, q]
            f = F[c, q]
            if grown:
                fg = inverse[e if per_cell else 0, q if per_point else 0]
                for a in range(k):
                    x, y, z = gradients[e, q, a]
                    g[0, a] = x * fg[0, 0] + y * fg[1, 0] + z * fg[2, 0]
                    g[1, a] = x * fg[0, 1] + y * fg[1, 1] + z * fg[2, 1]
                    g[2, a] = x * fg[0, 2] + y * fg[1, 2] + z * fg[2, 2]
                f[:] = fg
            else:
                for a in range(k):
                    for j in range(3):
                        g[j, a] = gradients[e, q, a, j]
                f[:] = 0.0
                f[0, 0] = f[1, 1] = f[2, 2] = 1.0
            for a in range(k):
                node = cells[e, a]
                for i in range(3):
                    for j in range(3):
                        f[i, j] += u[node, i] * g[j, a]


@numba.njit(cache=True)
def total(ids, weights, volume, psi):
    """Σ w Jg ψ; ``volume`` (0 | 1 | m, 1 | q) is Jg."""
    grown, per_cell, per_point = len(volume) > 0, len(volume) > 1, volume.shape[1] > 1
    energy = 0.0
    for c in range(len(ids)):
        e = ids[c]
        for q in range(weights.shape[1]):
            w = weights[e, q]
            if grown:
                w *= volume[e if per_cell else 0, q if per_point else 0]
            energy += w * psi[c, q]
    return energy


@numba.njit(cache=True)
def add_force(ids, cells, weights, volume, G, P, force):
    """Adds Σ w Jg P ĝ_a to ``force`` (n, 3)."""
    q_n, k = G.shape[1], G.shape[3]
    grown, per_cell, per_point = len(volume) > 0, len(volume) > 1, volume.shape[1] > 1
    for c in range(len(ids)):
        e = ids[c]
        for q in range(q_n):
            w = weights[e, q]
            if grown:
                w *= volume[e if per_cell else 0, q if per_point else 0]
            g = G[c, q]
            p = P[c, q]
            for i in range(3):
                p0, p1, p2 = w * p[i, 0], w * p[i, 1], w * p[i, 2]
                for a in range(k):
                    force[cells[e, a], i] += p0 * g[0, a] + p1 * g[1, a] + p2 * g[2, a]


@numba.njit(cache=True)
def add_stiffness_small(ids, positions, weights, volume, G, A, blocks):
    """Adds Σ w Jg ĝ_aJ A_iJkL ĝ_bL by direct loops, for few points and nodes."""
    q_n, k = G.shape[1], G.shape[3]
    grown, per_cell, per_point = len(volume) > 0, len(volume) > 1, volume.shape[1] > 1
    K = np.empty((k, k, 3, 3))
    M = np.empty((3, 3, 3))
    for c in range(len(ids)):
        e = ids[c]
        K[:] = 0.0
        for q in range(q_n):
            w = weights[e, q]
            if grown:
                w *= volume[e if per_cell else 0, q if per_point else 0]
            g = G[c, q]
            t = A[c, q]
            for b in range(k):
                x, y, z = w * g[0, b], w * g[1, b], w * g[2, b]
                for i in range(3):
                    for j in range(3):
                        for m in range(3):
                            M[j, i, m] = t[i, j, m, 0] * x + t[i, j, m, 1] * y + t[i, j, m, 2] * z
                for a in range(b + 1):
                    x, y, z = g[0, a], g[1, a], g[2, a]
                    for i in range(3):
                        for m in range(3):
                            K[a, b, i, m] += x * M[0, i, m] + y * M[1, i, m] + z * M[2, i, m]
        for b in range(k):
            for a in range(b + 1):
                upper = blocks[positions[e, a, b]]
                for i in range(3):
                    for m in range(3):
                        upper[i, m] += K[a, b, i, m]
                if a != b:
                    lower = blocks[positions[e, b, a]]
                    for i in range(3):
                        for m in range(3):
                            lower[m, i] += K[a, b, i, m]


@numba.njit(cache=True)
def add_stiffness_large(ids, positions, weights, volume, G, A, blocks):
    """The same as products K^{ik} = Gᵀ M^{ik}, M^{ik} = w Jg A_i·k· G, for i ≤ k only."""
    q_n, k = G.shape[1], G.shape[3]
    grown, per_cell, per_point = len(volume) > 0, len(volume) > 1, volume.shape[1] > 1
    M = np.empty((3 * q_n, k))
    K = np.empty((6, k, k))
    for c in range(len(ids)):
        e = ids[c]
        Gt = G[c].reshape(3 * q_n, k).T
        n = 0
        for i in range(3):
            for m in range(i, 3):
                for q in range(q_n):
                    w = weights[e, q]
                    if grown:
                        w *= volume[e if per_cell else 0, q if per_point else 0]
                    g = G[c, q]
                    for j in range(3):
                        x = w * A[c, q, i, j, m, 0]
                        y = w * A[c, q, i, j, m, 1]
                        z = w * A[c, q, i, j, m, 2]
                        row = M[3 * q + j]
                        for b in range(k):
                            row[b] = x * g[0, b] + y * g[1, b] + z * g[2, b]
                np.dot(Gt, M, K[n])
                n += 1
        for a in range(k):
            for b in range(k):
                block = blocks[positions[e, a, b]]
                block[0, 0] += K[0, a, b]
                block[0, 1] += K[1, a, b]
                block[0, 2] += K[2, a, b]
                block[1, 0] += K[1, b, a]
                block[1, 1] += K[3, a, b]
                block[1, 2] += K[4, a, b]
                block[2, 0] += K[2, b, a]
                block[2, 1] += K[4, b, a]
                block[2, 2] += K[5, a, b]


@numba.njit(cache=True)
def add_stiffness_unsymmetric(ids, positions, weights, volume, G, A, blocks):
    """The same of a tangent A without major symmetry: all nine pairs i, k."""
    q_n, k = G.shape[1], G.shape[3]
    grown, per_cell, per_point = len(volume) > 0, len(volume) > 1, volume.shape[1] > 1
    M, K = np.empty((3 * q_n, k)), np.empty((k, k))
    for c in range(len(ids)):
        e = ids[c]
        Gt = G[c].reshape(3 * q_n, k).T
        for i in range(3):
            for m in range(3):
                for q in range(q_n):
                    w = weights[e, q]
                    if grown:
                        w *= volume[e if per_cell else 0, q if per_point else 0]
                    g = G[c, q]
                    for j in range(3):
                        x = w * A[c, q, i, j, m, 0]
                        y = w * A[c, q, i, j, m, 1]
                        z = w * A[c, q, i, j, m, 2]
                        row = M[3 * q + j]
                        for b in range(k):
                            row[b] = x * g[0, b] + y * g[1, b] + z * g[2, b]
                np.dot(Gt, M, K)
                for a in range(k):
                    for b in range(k):
                        blocks[positions[e, a, b]][i, m] += K[a, b]


@numba.njit(cache=True)
def _stress(F, P, S):
    """S = Fe⁻¹ P into S (3, 3)."""
    c00 = F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1]
    c10 = F[1, 2] * F[2, 0] - F[1, 0] * F[2, 2]
    c20 = F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0]
    r = 1.0 / (F[0, 0] * c00 + F[0, 1] * c10 + F[0, 2] * c20)
    c01 = F[0, 2] * F[2, 1] - F[0, 1] * F[2, 2]
    c11 = F[0, 0] * F[2, 2] - F[0, 2] * F[2, 0]
    c21 = F[0, 1] * F[2, 0] - F[0, 0] * F[2, 1]
    c02 = F[0, 1] * F[1, 2] - F[0, 2] * F[1, 1]
    c12 = F[0, 2] * F[1, 0] - F[0, 0] * F[1, 2]
    c22 = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    for j in range(3):
        x, y, z = r * P[0, j], r * P[1, j], r * P[2, j]
        S[0, j] = c00 * x + c01 * y + c02 * z
        S[1, j] = c10 * x + c11 * y + c12 * z
        S[2, j] = c20 * x + c21 * y + c22 * z


@numba.njit(cache=True)
def extrapolate(ids, cells, du, G, F, P, A, S):
    """S + ∂S/∂F : dF into S (c, q, 3, 3), S = Fe⁻¹ P the second stress, dF = Σ du_a ⊗ ĝ_a."""
    q_n, k = G.shape[1], G.shape[3]
    dF, dP = np.empty((3, 3)), np.empty((3, 3))
    dS = np.empty((3, 3))
    for c in range(len(ids)):
        e = ids[c]
        for q in range(q_n):
            dF[:] = 0.0
            for a in range(k):
                node = cells[e, a]
                for i in range(3):
                    for j in range(3):
                        dF[i, j] += du[node, i] * G[c, q, j, a]
            _stress(F[c, q], P[c, q], S[c, q])
            for i in range(3):
                for j in range(3):
                    p = 0.0
                    for m in range(3):
                        for n in range(3):
                            p += A[c, q, i, j, m, n] * dF[m, n]
                        p -= dF[i, m] * S[c, q, m, j]
                    dP[i, j] = p
            _stress(F[c, q], dP, dS)
            S[c, q] += dS


@numba.njit(cache=True)
def add_geometric(ids, positions, weights, volume, G, F, P, S, blocks):
    """Adds Σ w Jg ĝ_a · (S − Fe⁻¹ P) ĝ_b 1: what the stiffness has more under the stress S."""
    q_n, k = G.shape[1], G.shape[3]
    grown, per_cell, per_point = len(volume) > 0, len(volume) > 1, volume.shape[1] > 1
    M, K, D = np.empty((3 * q_n, k)), np.empty((k, k)), np.empty((3, 3))
    for c in range(len(ids)):
        e = ids[c]
        for q in range(q_n):
            w = weights[e, q]
            if grown:
                w *= volume[e if per_cell else 0, q if per_point else 0]
            _stress(F[c, q], P[c, q], D)
            g = G[c, q]
            for j in range(3):
                x = w * (S[c, q, j, 0] - D[j, 0])
                y = w * (S[c, q, j, 1] - D[j, 1])
                z = w * (S[c, q, j, 2] - D[j, 2])
                row = M[3 * q + j]
                for b in range(k):
                    row[b] = x * g[0, b] + y * g[1, b] + z * g[2, b]
        np.dot(G[c].reshape(3 * q_n, k).T, M, K)
        for a in range(k):
            for b in range(k):
                block = blocks[positions[e, a, b]]
                both = (K[a, b] + K[b, a]) / 2
                block[0, 0] += both
                block[1, 1] += both
                block[2, 2] += both
