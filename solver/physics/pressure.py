"""Follower pressure on a surface: −p J F⁻ᵀN dA₀ (Eq. 2.10, Nanson), exact, with exact stiffness.

With tangents t₁ × t₂ = N of the reference surface and x,α = t_α + Σ u_a ∂N_a/∂t_α the current area
vector is J F⁻ᵀN = x,₁ × x,₂. In general that force has no potential and its stiffness isn't
symmetric. It has one, p V, where the surface encloses a volume V, alone or with planes on which its
rim can only slide, or with caps that move with its rim. V is the flux of a field M x with tr M = 1
that is tangential to those planes: M = I/3 if they go through one origin, (I − d⊗d)/2 if they are
any planes normal to d and others that contain one axis along d, d⊗d if they are any planes along d
and one normal to it. It is the volume within an outer surface, minus that of a cavity, so pressure
in a cavity gives −p V_cavity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numba
import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from solver.given import all_of, node_numbers, number, one_of, vector
from solver.mesh.body import Body, NodeGraph, Surface
from solver.physics.fields import Quantity, resolve
from solver.physics.supports import Fixed, Held, unit_vector
from solver.physics.term import Evaluation


@numba.njit(cache=True, inline="always")
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True)
def _skew(v, out):
    """[v]×, with [v]× w = v × w."""
    out[0, 0], out[0, 1], out[0, 2] = 0.0, -v[2], v[1]
    out[1, 0], out[1, 1], out[1, 2] = v[2], 0.0, -v[0]
    out[2, 0], out[2, 1], out[2, 2] = -v[1], v[0], 0.0


@numba.njit(cache=True)
def _assemble(
    nodes, shapes, tangents, frames, weights, X, u, p, M, volume, positions, order, force, blocks
):
    """Adds force and blocks; returns p ∫ M x · n da. ``volume``: its gradient, else the follower.

    M (3, 3) symmetric.
    """
    energy = 0.0
    x, x1, x2, n, y = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    n1, n2, Mn = np.empty(3), np.empty(3), np.empty(3)
    S1, S2, Sy = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
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
            for i in range(3):
                y[i] = M[i, 0] * x[0] + M[i, 1] * x[1] + M[i, 2] * x[2]
            s = weights[f, q] * p[f if per_facet else 0, q if per_point else 0]
            energy += s * (y[0] * n[0] + y[1] * n[1] + y[2] * n[2])
            if order < 1:
                continue
            if volume:
                _cross(x2, y, n1)
                _cross(y, x1, n2)
                for i in range(3):
                    Mn[i] = M[i, 0] * n[0] + M[i, 1] * n[1] + M[i, 2] * n[2]
            for a in range(k):
                for i in range(3):
                    if volume:
                        part = N[a] * Mn[i] + T[a, 0] * n1[i] + T[a, 1] * n2[i]
                    else:
                        part = N[a] * n[i]
                    force[nodes[f, a], i] += s * part
            if order < 2:
                continue
            _skew(x1, S1)
            _skew(x2, S2)
            if volume:
                _skew(y, Sy)
                M1, M2 = M @ S1, M @ S2
            for a in range(k):
                for b in range(k):
                    block = blocks[positions[f, a, b]]
                    first, second = s * N[a] * T[b, 0], s * N[a] * T[b, 1]
                    if not volume:
                        for i in range(3):
                            for j in range(3):
                                block[i, j] += second * S1[i, j] - first * S2[i, j]
                        continue
                    third, fourth = s * T[a, 0] * N[b], s * T[a, 1] * N[b]
                    fifth = s * (T[a, 1] * T[b, 0] - T[a, 0] * T[b, 1])
                    for i in range(3):
                        for j in range(3):
                            # (M S)ᵀ = −S M.
                            block[i, j] += (
                                second * M1[i, j]
                                - first * M2[i, j]
                                - third * M2[j, i]
                                + fourth * M1[j, i]
                                + fifth * Sy[i, j]
                            )
    return energy


class _Cap:
    """Volume between the origin, the wall's rim and a cone over the rim: c·b / 3.

    c = mean along the rim, b = −½ ∮ x × dx the cap's area vector. ``nodes`` (k,) of the rim, at
    ``X`` (k, 3); ``W`` (k, k) skew: b = −Σ W_ab x_a × x_b; ``P`` (3, 3): the directions in which c
    may move, as an arc between mirror planes is part of a rim whose centre lies in all of them.
    """

    def __init__(self, nodes: np.ndarray, X: np.ndarray, W: np.ndarray, P: np.ndarray):
        self.nodes, self._W, self._P = nodes, W, P
        # A sum over edges, so that the ends of an arc weigh half.
        size = (np.abs(W) * np.linalg.norm(X[:, None] - X, axis=-1)).sum(axis=1)
        self._mean = size / size.sum()

    def evaluate(self, x: np.ndarray):
        """Volume, its gradient (k, 3) and second derivative (k, k, 3, 3); x (k, 3)."""
        w = self._mean
        c = self._P @ (w @ x)
        y = -2 * self._W @ x
        b = np.cross(x, y).sum(axis=0) / 2
        Y = np.cross(np.eye(3), y[:, None, :]).transpose(0, 2, 1) * -1.0
        C = np.cross(np.eye(3), c).T * -1.0
        gradient = (np.outer(w, self._P @ b) + np.cross(y, c)) / 3
        mixed = (Y @ self._P)[:, None] * w[:, None, None]
        second = mixed + mixed.transpose(1, 0, 3, 2)
        second = second + 2 * self._W[:, :, None, None] * C
        return float(c @ b) / 3, gradient, second / 3


class Pressure:
    """Pressure p pushing against the outward normal of a surface of the body.

    ``p``: constant, per facet (f,) or per point (f, q), or a function (see
    :mod:`solver.physics.fields`).

    ``potential=None``: the exact follower force; no energy, stiffness not symmetric.
    ``potential="volume"``: the gradient of p V, with energy and symmetric stiffness, so that
    unstable modes are counted. It equals the follower force on everything that may move if the
    surface is closed, or if ``fixed`` (the scene's own supports) keeps each node of its rim: fixed,
    or sliding in planes through ``origin``; in any planes normal to one direction (plane strain),
    and others that contain the axis along it through ``origin``; or in any planes along one
    direction, and one normal to it through ``origin``. The two forms are compared at construction,
    and p must then be uniform.
    ``caps=True``, with ``potential="volume"``: each rim that is not in a held plane through
    ``origin`` is closed by a cap, a cone over the rim's mean without a stiffness of its own; p on
    it pulls at the rim, as in a tube with closed ends. A flat rim (see
    :func:`solver.physics.rows.flat_rows`) has a flat cap.

    Raises ValueError where that comparison fails, p depends on position, or there is nothing to
    cap.
    """

    def __init__(
        self,
        body: Body,
        surface: Surface,
        p: Quantity,
        *,
        potential: str | None = None,
        caps: bool = False,
        fixed: Sequence[Fixed] = (),
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        name: str = "pressure",
    ):
        one_of("the pressure's surface", Surface, surface, "Body.surface")
        fixed = all_of("fixed", Fixed, fixed)
        if potential is not None and (not isinstance(potential, str) or potential != "volume"):
            raise ValueError(f"no potential {potential!r}; there are: None, 'volume'")
        if caps and potential is None:
            raise ValueError("caps make a closed volume; take potential='volume' with them")
        self.name = name
        self.body, self.surface, self.p = body, surface, p
        self.symmetric = potential == "volume"
        self._X = np.ascontiguousarray(body.nodes - vector("origin", origin))
        self._caps = self._find_caps(fixed) if caps else ()
        self.graph = NodeGraph.of(
            len(body.nodes), surface.nodes, *(cap.nodes[None] for cap in self._caps)
        )
        self._positions = self.graph.positions(surface.nodes)
        self._cap_positions = [self.graph.positions(cap.nodes[None])[0] for cap in self._caps]
        self._M = np.eye(3) / 3
        self._pressure(0.0)
        if self.symmetric and not caps:
            self._M = self._flux(fixed)

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

    def _flux(self, fixed: Sequence[Fixed]) -> np.ndarray:
        """M with which the gradient of V is the follower force on all that may move."""
        n = len(self.body.nodes)
        held = Held(n, fixed)
        # At a load at which moving supports are elsewhere.
        local = held.values(0.7)
        rng = np.random.default_rng(0)
        local[held.index] = 0.05 * self.body.length * rng.standard_normal(len(held.index))
        u, one = held.to_global(local.reshape(-1, 3)), np.ones((1, 1))
        follower = self._run(u, one, 1, None)[1]

        def off(M):
            gap = held.to_local(self._run(u, one, 1, M)[1] - follower).ravel()
            gap[~held.free] = 0.0
            return np.linalg.norm(gap.reshape(-1, 3), axis=1)

        planes = np.array([unit_vector(support.direction) for support in fixed]).reshape(-1, 3)
        planes = np.unique(np.round(planes * _sign(planes), 12), axis=0)
        across = np.cross(planes[:, None], planes).reshape(-1, 3)
        across = across[np.linalg.norm(across, axis=1) > 1e-6]
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        along = [np.outer(d, d) for d in np.vstack([planes, across])]
        bad = None
        for M in (np.eye(3) / 3, *((np.eye(3) - dd) / 2 for dd in along), *along):
            wrong = np.flatnonzero(off(M) > 1e-9 * np.abs(follower).max())
            if not len(wrong):
                return M
            bad = wrong if bad is None or len(wrong) < len(bad) else bad
        x, y, z = self.body.nodes[bad[0]]
        raise ValueError(
            f"pressure has no potential here: {len(bad)} nodes of the surface's rim are free "
            f"to move, the first at ({x:.4g}, {y:.4g}, {z:.4g}); close the surface, pass the "
            "supports of the rim as fixed (in planes as the class says), take caps=True, or leave "
            "potential out"
        )

    def _find_caps(self, fixed: Sequence[Fixed]) -> tuple[_Cap, ...]:
        s, n = self.surface, len(self.body.nodes)
        # ∫ n da = Σ W_ab x_a × x_b; inside the surface the parts of neighbours cancel.
        T1, T2 = s.tangents[..., 0], s.tangents[..., 1]
        part = np.einsum("fq,fqa,fqb->fab", s.weights, T1, T2)
        part = (part - part.transpose(0, 2, 1)) / 2
        a, b = np.broadcast_arrays(s.nodes[:, :, None], s.nodes[:, None, :])
        W = sp.coo_array((part.ravel(), (a.ravel(), b.ravel())), shape=(n, n)).tocsr().tocoo()
        keep = np.abs(W.data) > 1e-9 * np.abs(part).max()
        mirrors = []
        for support in fixed:
            on, d = np.zeros(n, bool), unit_vector(support.direction)
            nodes = node_numbers(support.nodes, n)
            on[nodes[np.abs(self._X[nodes] @ d) < 1e-9 * self.body.length]] = True
            mirrors.append((on, d))
            keep &= ~(on[W.row] & on[W.col])
        W = sp.csr_array((W.data[keep], (W.row[keep], W.col[keep])), shape=(n, n))
        rim = np.flatnonzero(np.diff(W.indptr))
        if not len(rim):
            raise ValueError("the surface has no rim to cap; leave caps out")
        count, part = connected_components(W[rim][:, rim])
        caps = []
        for k in range(count):
            nodes = rim[part == k]
            normals = [d for on, d in mirrors if on[nodes].any()]
            P = np.eye(3)
            if normals:
                A = np.array(normals)
                P = P - np.linalg.pinv(A) @ A
            caps.append(_Cap(nodes, self._X[nodes], W[nodes][:, nodes].toarray(), P))
        return tuple(caps)

    def _run(self, u: np.ndarray, p: np.ndarray, order: int, M: np.ndarray | None):
        s = self.surface
        force = np.zeros_like(self.body.nodes)
        blocks = np.zeros((self.graph.blocks if order >= 2 else 0, 3, 3))
        u = np.ascontiguousarray(u, dtype=float)
        energy = _assemble(
            s.nodes, s.shapes, s.tangents, s.frames, s.weights, self._X, u, p,
            np.eye(3) / 3 if M is None else M, M is not None, self._positions, order, force, blocks,
        )  # fmt: skip
        for cap, where in zip(self._caps, self._cap_positions, strict=True):
            V, gradient, second = cap.evaluate(self._X[cap.nodes] + u[cap.nodes])
            energy += p[0, 0] * V
            force[cap.nodes] += p[0, 0] * gradient
            if order >= 2:
                blocks[where] += p[0, 0] * second
        return energy, force, blocks

    def volume(self, u: np.ndarray) -> float:
        """∫ M (x − origin)·n da and the caps' part: the volume within a closed surface, negative
        for a cavity."""
        return self._run(u, np.ones((1, 1)), 0, self._M)[0]

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy (None without a potential), force (n, 3) and blocks on the surface's graph."""
        M = self._M if self.symmetric else None
        energy, force, blocks = self._run(u, self._pressure(e), order, M)
        return Evaluation(
            energy if self.symmetric else None,
            force if order >= 1 else None,
            blocks if order >= 2 else None,
        )


class Enclosed:
    """What fills the volume V within a surface and resists its change: ½ K v₀ (V/v₀ − c)².

    v₀ is the volume at rest (of the part of the whole that the body is), c = ``content`` what the
    filling would take of it by itself, 1 or a function of e, and K = ``bulk`` its bulk modulus: it
    presses with p = K (c − V/v₀) on the surface, the same everywhere. So an embryo's yolk or a
    cell's fluid; K → ∞ keeps V at c v₀. All nodes of the surface feel each other through V, which
    is a dyad beside the stiffness of that pressure.

    ``surface``, ``fixed``, ``origin`` and ``caps`` as of :class:`Pressure` with its potential, and
    what that refuses is refused. Raises ValueError for a modulus that is not above 0, and a surface
    that encloses nothing.
    """

    symmetric = True

    def __init__(
        self,
        body: Body,
        surface: Surface,
        bulk: float,
        *,
        content: float | Callable[[float], float] = 1.0,
        fixed: Sequence[Fixed] = (),
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        caps: bool = False,
        name: str = "enclosed",
    ):
        self.bulk = number("the bulk modulus", bulk, above=0)
        self._wall = Pressure(
            body, surface, 1.0, potential="volume", caps=caps, fixed=fixed, origin=origin
        )
        self.body, self.surface, self.graph, self.name = body, surface, self._wall.graph, name
        self.content = content
        self._rest = self._wall.volume(np.zeros_like(body.nodes))
        if not abs(self._rest) > 1e-12 * surface.weights.sum() ** 1.5:
            raise ValueError(f"the surface encloses a volume of {self._rest:.3g}; close it")

    def volume(self, u: np.ndarray) -> float:
        """V/v₀ at a displacement u (n, 3)."""
        return self._wall.volume(u) / self._rest

    def pressure(self, u: np.ndarray, e: float) -> float:
        """p of the filling; negative where it pulls."""
        return self.bulk * (self._content(e) - self.volume(u))

    def _content(self, e: float) -> float:
        return number("the content", self.content(e) if callable(self.content) else self.content)

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3), blocks on the surface's graph, and the dyad."""
        # V of a cavity is negative, and so is v₀.
        at = self._wall.evaluate(u, e, order)
        over, sense = at.energy / self._rest - self._content(e), np.sign(self._rest)
        energy = self.bulk * abs(self._rest) * over**2 / 2
        if order < 1:
            return Evaluation(energy)
        force = self.bulk * over * sense * at.force
        if order < 2:
            return Evaluation(energy, force)
        blocks = self.bulk * over * sense * at.stiffness
        dyad = (self.bulk / abs(self._rest), at.force)
        return Evaluation(energy, force, blocks, own=True, dyads=(dyad,))


def _sign(vectors: np.ndarray) -> np.ndarray:
    """±1 (n, 1) by which the largest component of each becomes positive."""
    large = np.abs(vectors).argmax(axis=1)
    return np.where(vectors[np.arange(len(vectors)), large] < 0, -1.0, 1.0)[:, None]
