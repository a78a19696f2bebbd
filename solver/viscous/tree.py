"""One step of any tree of springs and dashpots, on arrays of points.

Every part answers with its incremental potential w(C), gradient and Hessian; a series solves for
its U (see :mod:`solver.viscous.rheology`) and hands on the condensed tangent. Slower than the
compiled kernel of Maxwell branches (:mod:`solver.viscous.kernel`), which it agrees with where both
apply.
"""

from __future__ import annotations

import numpy as np

from solver.viscous.kernel import nine, six
from solver.viscous.rheology import Dashpot, Parallel, Rheology, Spring

BASIS = nine(np.eye(6))
ITERATIONS = 60


class Inadmissible(ArithmeticError):
    """A point has no answer: its determinant or its own Newton failed."""


class Points:
    """What the parts need at each of n points, in the order of leaves and joints.

    ``moduli`` (n, springs, 2): λ, μ; ``rates`` (n, dashpots, 14): k, its constant, P, Q;
    ``guess`` (n, joints, 6): U to start from. ``joints`` takes U, ``strains`` C of each dashpot.
    """

    def __init__(self, moduli, rates, guess):
        self.moduli, self.rates, self.guess = moduli, rates, guess
        self.joints, self.strains = guess.copy(), np.empty((*rates.shape[:2], 6))

    def part(self, rows: np.ndarray) -> Points:
        """Some of the points."""
        return Points(self.moduli[rows], self.rates[rows], self.joints[rows])


def respond(tree: Rheology, C: np.ndarray, data: Points):
    """w (n,), dw/dC (n, 6) and d²w/dC² (n, 6, 6) of C (n, 3, 3); fills what ``data`` collects.

    Raises Inadmissible where a point has no answer.
    """
    return _visit(tree, C, data, [0, 0, 0])


def _visit(part, C, data, at):
    if isinstance(part, Spring):
        at[0] += 1
        return spring(C, *data.moduli[:, at[0] - 1].T)
    if isinstance(part, Dashpot):
        at[1] += 1
        data.strains[:, at[1] - 1] = six(C)
        return _dashpot(C, data.rates[:, at[1] - 1])
    if isinstance(part, Parallel):
        parts = [_visit(p, C, data, at) for p in part.parts]
        return tuple(sum(values) for values in zip(*parts, strict=True))
    return _series(part.parts, C, data, at)


def pair(X, Z):
    """The operator B → ½ (X B Z + Z B X) on symmetric tensors as (n, 6, 6)."""
    half = X[:, None] @ BASIS @ Z[:, None]
    return six(half + np.swapaxes(half, -1, -2)) / 2


def spring(C, lam, mu):
    """ψ, dψ/dC (n, 6) and d²ψ/dC² (n, 6, 6) of a neo-Hookean spring; C (n, 3, 3)."""
    det = np.linalg.det(C)
    if not (np.isfinite(det) & (det > 0)).all():
        raise Inadmissible
    x, Ci = np.log(det) / 2, np.linalg.inv(C)
    s, c = (lam * x - mu) / 2, six(Ci)
    w = mu / 2 * (np.trace(C, axis1=1, axis2=2) - 3 - 2 * x) + lam / 2 * x * x
    g = mu[:, None] / 2 * six(np.eye(3)) + s[:, None] * c
    H = lam[:, None, None] / 4 * c[:, :, None] * c[:, None, :] - s[:, None, None] * pair(Ci, Ci)
    return w, g, H


def _dashpot(C, rates):
    k, constant, P, Q = rates[:, 0], rates[:, 1], rates[:, 2:8], nine(rates[:, 8:14])
    Ci = np.linalg.inv(C)
    R = Ci @ Q @ Ci
    w = k * ((six(C) * P).sum(1) + (six(Ci) * six(Q)).sum(1) - constant)
    g = k[:, None] * (P - six(R))
    return w, g, 2 * k[:, None, None] * pair(Ci, R)


def _series(parts, C, data, at):
    """The first part against the rest of a series, with the stretch U of the rest solved for."""
    at[2] += 1
    joint = at[2] - 1
    U, begin = data.joints[:, joint].copy(), list(at)
    for _ in range(ITERATIONS):
        at[:] = begin
        _, gU, HU, _ = _split(parts, C, nine(U), data, at)
        values, vectors = np.linalg.eigh(HU)
        size = np.abs(values).max(axis=1, keepdims=True)
        safe = np.maximum(np.abs(values), 1e-10 * size)
        d = -np.einsum("nab,nb,ncb,nc->na", vectors, 1 / safe, vectors, gU)
        # |U^-1/2 d U^-1/2|
        ratio = np.linalg.solve(nine(U), nine(d))
        length = np.sqrt(np.maximum(np.einsum("nij,nji->n", ratio, ratio), 0))
        U = U + np.minimum(1, 0.4 / np.maximum(length, 1e-300))[:, None] * d
        if not np.isfinite(length).all():
            raise Inadmissible
        if length.max() < 1e-9:
            break
    else:
        raise Inadmissible
    data.joints[:, joint] = U
    at[:] = begin
    w, _, HU, (gC, HC, HUC) = _split(parts, C, nine(U), data, at)
    return w, gC, HC - np.swapaxes(HUC, 1, 2) @ np.linalg.solve(HU, HUC)


def _split(parts, C, U, data, at):
    """w with its derivatives in U, and in C at fixed U, of F = F_left U."""
    Z = np.linalg.inv(U)
    left = Z @ C @ Z
    left = (left + np.swapaxes(left, 1, 2)) / 2
    right = U @ U
    wl, gl, Hl = _visit(parts[0], left, data, at)
    if len(parts) == 2:
        wr, gr, Hr = _visit(parts[1], right, data, at)
    else:
        wr, gr, Hr = _series(parts[1:], right, data, at)
    Gl, Gr = nine(gl)[:, None, None], nine(gr)[:, None, None]
    B, Zn, Ln, Un = BASIS, Z[:, None], left[:, None], U[:, None]

    def both(X):
        return X + np.swapaxes(X, -1, -2)

    # d left = −(Z B left + left B Z), d right = U B + B U, along each basis tensor B of dU.
    dl = -both(Zn @ B @ Ln)
    Jl, Jr = np.swapaxes(six(dl), 1, 2), np.swapaxes(six(both(Un @ B)), 1, 2)
    Kl = np.swapaxes(six(Zn @ B @ Zn), 1, 2)
    ZB = Zn @ B
    gU = np.einsum("na,nab->nb", gl, Jl) + np.einsum("na,nab->nb", gr, Jr)
    # d² left (a, b) = Z B_b Z B_a left − Z B_a dl_b, and transposed.
    second = both(ZB[:, None] @ (ZB @ Ln)[:, :, None] - ZB[:, :, None] @ dl[:, None])
    HU = np.einsum("nabij,nabij->nab", np.broadcast_to(Gl, second.shape), second)
    HU += np.einsum("nabij,abij->nab", np.broadcast_to(Gr, second.shape), both(B[:, None] @ B))
    HU = (HU + np.swapaxes(HU, 1, 2)) / 2
    HU += np.swapaxes(Jl, 1, 2) @ Hl @ Jl + np.swapaxes(Jr, 1, 2) @ Hr @ Jr
    gC = np.einsum("na,nab->nb", gl, Kl)
    HC = np.swapaxes(Kl, 1, 2) @ Hl @ Kl
    # d² left (dU_b, dC_c) = −(Z B_b Z B_c Z + Z B_c Z B_b Z)
    mixed = -both(ZB[:, :, None] @ (ZB @ Zn)[:, None])
    HUC = np.einsum("nbcij,nbcij->nbc", np.broadcast_to(Gl, mixed.shape), mixed)
    HUC += np.swapaxes(Jl, 1, 2) @ Hl @ Kl
    return wl + wr, gU, HU, (gC, HC, HUC)
