"""Follower pressure on a surface: −p J F⁻ᵀN dA₀ (Eq. 2.10, Nanson), exact, with exact stiffness.

With tangents t₁ × t₂ = N of the reference surface and x,α = t_α + Σ u_a ∂N_a/∂t_α the current area
vector is J F⁻ᵀN = x,₁ × x,₂. In general that force has no potential and its stiffness isn't
symmetric. Where the surface is closed, or its rim can't move or slides in planes through one
origin, the energy is p V with V = ⅓ ∫ (x − x₀)·(x,₁ × x,₂) dA₀: the volume within an outer surface,
minus that of a cavity. So pressure in a cavity gives −p V_cavity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from solver.mesh.body import Body, NodeGraph, Surface
from solver.mesh.given import all_of, node_numbers, one_of, vector
from solver.physics.fields import Quantity, resolve
from solver.physics.supports import Fixed
from solver.physics.term import Evaluation


@numba.njit(cache=True, inline="always")
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True, inline="always")
def _add_skew(block, s, v):
    """block += s [v]×, with [v]× w = v × w."""
    block[0, 1] -= s * v[2]
    block[0, 2] += s * v[1]
    block[1, 0] += s * v[2]
    block[1, 2] -= s * v[0]
    block[2, 0] -= s * v[1]
    block[2, 1] += s * v[0]


@numba.njit(cache=True)
def _assemble(
    nodes, shapes, tangents, frames, weights, X, u, p, volume, positions, order, force, blocks
):
    """Adds force and blocks; returns p V. ``volume``: the gradient of p V, else the follower."""
    energy = 0.0
    x, x1, x2, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    n1, n2 = np.empty(3), np.empty(3)
    per_facet, per_point = p.shape[0] > 1, p.shape[1] > 1
    k = nodes.shape[1]
    for f in range(nodes.shape[0]):
        for q in range(weights.shape[1]):
            N, T = shapes[f, q], tangents[f, q]
            x[:] = 0.0
            x1[:], x2[:] = frames[f, q, 0], frames[f, q, 1]
            for a in range(k):
                node = nodes[f, a]
                for i in range(3):
                    x[i] += N[a] * (X[node, i] + u[node, i])
                    x1[i] += u[node, i] * T[a, 0]
                    x2[i] += u[node, i] * T[a, 1]
            _cross(x1, x2, n)
            s = weights[f, q] * p[f if per_facet else 0, q if per_point else 0]
            energy += s * (x[0] * n[0] + x[1] * n[1] + x[2] * n[2]) / 3.0
            if order < 1:
                continue
            if volume:
                s /= 3.0
                _cross(x2, x, n1)
                _cross(x, x1, n2)
            for a in range(k):
                for i in range(3):
                    force[nodes[f, a], i] += s * N[a] * n[i]
                    if volume:
                        force[nodes[f, a], i] += s * (T[a, 0] * n1[i] + T[a, 1] * n2[i])
            if order < 2:
                continue
            for a in range(k):
                for b in range(k):
                    block = blocks[positions[f, a, b]]
                    if volume:
                        _add_skew(block, s * (T[a, 0] * N[b] - N[a] * T[b, 0]), x2)
                        _add_skew(block, s * (N[a] * T[b, 1] - T[a, 1] * N[b]), x1)
                        _add_skew(block, s * (T[a, 1] * T[b, 0] - T[a, 0] * T[b, 1]), x)
                    else:
                        _add_skew(block, -s * N[a] * T[b, 0], x2)
                        _add_skew(block, s * N[a] * T[b, 1], x1)
    return energy


class Pressure:
    """Pressure p pushing against the outward normal of a surface of the body.

    ``p``: constant, per facet (f,) or per point (f, q), or a function (see
    :mod:`solver.physics.fields`).

    ``potential=None``: the exact follower force; no energy, stiffness not symmetric.
    ``potential="volume"``: the gradient of p V, with energy and symmetric stiffness. It equals the
    follower force on everything that may move if the surface is closed, or if each node of its rim
    is held by one of ``fixed`` (the scene's own supports): clamped, or sliding in a plane through
    ``origin``. The two forms are compared at construction, and p must then be uniform.

    Raises ValueError where that comparison fails, or p depends on position.
    """

    def __init__(
        self,
        body: Body,
        surface: Surface,
        p: Quantity,
        *,
        potential: str | None = None,
        fixed: Sequence[Fixed] = (),
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        name: str = "pressure",
    ):
        one_of("the pressure's surface", Surface, surface, "Body.surface")
        fixed = all_of("fixed", Fixed, fixed)
        if potential is not None and (not isinstance(potential, str) or potential != "volume"):
            raise ValueError(f"no potential {potential!r}; there are: None, 'volume'")
        self.name = name
        self.body, self.surface, self.p = body, surface, p
        self.symmetric = potential == "volume"
        self.graph = NodeGraph.of(len(body.nodes), surface.nodes)
        self._positions = self.graph.positions(surface.nodes)
        self._X = np.ascontiguousarray(body.nodes - vector("origin", origin))
        self._pressure(0.0)
        if self.symmetric:
            self._verify(fixed)

    def _points(self) -> np.ndarray:
        s = self.surface
        return np.einsum("fqk,fki->fqi", s.shapes, self.body.nodes[s.nodes])

    def _pressure(self, e: float) -> np.ndarray:
        p = resolve("pressure", self.p, e, self.surface.weights.shape, self._points)
        if self.symmetric and p.size > 1:
            if np.ptp(p) > 1e-12 * np.abs(p).max():
                raise ValueError(
                    f"pressure runs from {p.min():g} to {p.max():g} over the surface; expected one "
                    "number for potential='volume': leave potential out"
                )
            p = p[:1, :1]
        return p

    def _verify(self, fixed: Sequence[Fixed]) -> None:
        """The follower force and the gradient of V must agree on all that may move."""
        n = len(self.body.nodes)
        held = np.zeros((n, 3, 3))  # Σ d ⊗ d of the directions held
        for support in fixed:
            d = np.asarray(support.direction, dtype=float)
            held[node_numbers(support.nodes, n)] += np.outer(d, d) / (d @ d)
        size, vectors = np.linalg.eigh(held)
        kept = np.where(size > 1e-9, 0.0, 1.0)
        free = np.einsum("nik,nk,njk->nij", vectors, kept, vectors)
        rng = np.random.default_rng(0)
        u = 0.05 * self.body.length * rng.standard_normal((n, 3))
        u = np.einsum("nij,nj->ni", free, u)
        one = np.ones((1, 1))
        follower = self._run(u, one, 1, volume=False)[1]
        gradient = self._run(u, one, 1, volume=True)[1]
        off = np.linalg.norm(np.einsum("nij,nj->ni", free, gradient - follower), axis=1)
        bad = np.flatnonzero(off > 1e-9 * np.abs(follower).max())
        if len(bad):
            x, y, z = self.body.nodes[bad[0]]
            raise ValueError(
                f"pressure has no potential here: {len(bad)} nodes of the surface's rim are free "
                f"to move, the first at ({x:.4g}, {y:.4g}, {z:.4g}); close the surface, pass the "
                "supports of the rim as fixed (planes through origin), or leave potential out"
            )

    def _run(self, u: np.ndarray, p: np.ndarray, order: int, volume: bool):
        s = self.surface
        force = np.zeros_like(self.body.nodes)
        blocks = np.zeros((self.graph.blocks if order >= 2 else 0, 3, 3))
        u = np.ascontiguousarray(u, dtype=float)
        energy = _assemble(
            s.nodes, s.shapes, s.tangents, s.frames, s.weights, self._X, u, p, volume,
            self._positions, order, force, blocks,
        )  # fmt: skip
        return energy, force, blocks

    def volume(self, u: np.ndarray) -> float:
        """⅓ ∫ (x − origin)·n da: the volume within a closed surface, negative for a cavity."""
        return self._run(u, np.ones((1, 1)), 0, volume=True)[0]

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy (None without a potential), force (n, 3) and blocks on the surface's graph."""
        energy, force, blocks = self._run(u, self._pressure(e), order, self.symmetric)
        return Evaluation(
            energy if self.symmetric else None,
            force if order >= 1 else None,
            blocks if order >= 2 else None,
        )
