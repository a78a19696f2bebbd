"""Loads without stiffness (gravity, Eq. 4.2; dead loads on faces, lines and nodes), the springs of
an elastic foundation, and the liquid on which a film floats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from solver.given import node_numbers, number, numbers
from solver.mesh.body import Body, NodeGraph, Surface
from solver.mesh.lines import Line, refuse_region
from solver.physics.fields import Quantity, Unphysical, resolve, varies
from solver.physics.term import Evaluation


class Gravity:
    """Weight: energy ∫ ρ g z dV₀ (Eq. 4.2), z the current height; no stiffness.

    ``density`` ρ ≥ 0 per reference volume, so growth changes no mass; ``g`` the magnitude of an
    acceleration along −z or its vector (3,), either of them maybe of e. Raises ValueError for a
    negative density.
    """

    graph = None
    symmetric = True

    def __init__(self, body: Body, density: Quantity, g: Quantity, *, name: str = "gravity"):
        self.name = name
        self.body, self.density, self.g = body, density, g
        self._memo = None
        self.weights(0.0)

    def weights(self, e: float) -> np.ndarray:
        """Weight of each node as a vector, (n, 3); it sums to the body's weight."""
        still = not (varies(self.density) or callable(self.g))
        if self._memo is None or (self._memo[0] != e and not still):
            shape = self.body.weights.shape
            rho = resolve("density", self.density, e, shape, self.body.points)
            if not (rho >= 0).all():
                raise Unphysical(
                    f"density = {rho.min():g} at e = {e:g}; expected density >= 0: turn g around "
                    "to pull the other way"
                )
            g = numbers("g", self.g(e) if callable(self.g) else self.g)
            if g.shape not in ((), (3,)) or not np.isfinite(g).all():
                raise ValueError(f"g = {g}; expected a magnitude along -z or a vector of three")
            vector = g if g.ndim else np.array([0.0, 0.0, -g])
            self._memo = (e, self.body.node_volumes(rho)[:, None] * vector)
        return self._memo[1]

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy and force = −weight; u (n, 3)."""
        weights = self.weights(e)
        energy = -float((weights * (self.body.nodes + u)).sum())
        return Evaluation(energy, -weights if order >= 1 else None)


class DeadLoad:
    """A load per reference measure of facets, segments or nodes: energy −∫ t·u, no stiffness.

    Made by :class:`Traction`, :class:`LineLoad` and :class:`PointLoad`. ``vector`` t: (3,), per
    facet (f, 3) or per point (f, q, 3), or a function (see :mod:`solver.physics.fields`), such as
    ``lambda e: e * t`` of a load that grows with e. Raises ValueError for another shape.
    """

    graph = None
    symmetric = True

    def __init__(self, body: Body, region: Surface | Line | Nodes, vector: Quantity, name: str):
        self.name = name
        self.body, self.region, self.vector = body, region, vector
        self._memo = None
        self.loads(0.0)

    def loads(self, e: float) -> np.ndarray:
        """∫ N_a t of each node, (n, 3)."""
        if self._memo is None or (self._memo[0] != e and varies(self.vector)):
            r, shape = self.region, self.region.weights.shape
            t = resolve(self.name, self.vector, e, shape, self._points, (3,))
            per_facet = np.einsum(
                "fq,fqk,fqi->fki", r.weights, r.shapes, np.broadcast_to(t, (*shape, 3))
            )
            loads = np.zeros_like(self.body.nodes)
            np.add.at(loads, r.nodes, per_facet)
            self._memo = (e, loads)
        return self._memo[1]

    def _points(self) -> np.ndarray:
        return _positions(self.region, self.body)

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy and force; u (n, 3)."""
        loads = self.loads(e)
        return Evaluation(-float((loads * u).sum()), -loads if order >= 1 else None)


class Floating:
    """Liquid under a surface: the pressure γ (z₀ − z) of the current height z on it (Fig. 3.8).

    ``weight`` γ, the liquid's specific weight ρ g, maybe of e; ``level`` z₀ of its surface. A thin
    film neither sinks nor lets go of it, so above the level the liquid pulls. Its potential is that
    of the liquid moved, −½ γ ∫ (z − z₀)² n_z da with the area vector n da of the deformed surface:
    its gradient is the follower force wherever no free rim is, and there the push γ (z − z₀)²/2 per
    length of a wall down to the level beside it. Raises ValueError for a weight that is not above
    0, and a level that is no number.
    """

    symmetric = True

    def __init__(
        self,
        body: Body,
        surface: Surface,
        weight: float | Callable[[float], float],
        *,
        level: float = 0.0,
        name: str = "floating",
    ):
        refuse_region(body, surface, Surface)
        self.body, self.surface, self.weight, self.name = body, surface, weight, name
        self.level = number("the liquid's level", level)
        self.graph = NodeGraph.of(len(body.nodes), surface.nodes)
        self._positions = self.graph.positions(surface.nodes)
        self._gamma(0.0)

    def _gamma(self, e: float) -> float:
        weight = self.weight(e) if callable(self.weight) else self.weight
        return number("the liquid's specific weight", weight, above=0)

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and blocks on the surface's graph."""
        s = self.surface
        N, T = s.shapes, s.tangents
        h = np.einsum("fqk,fk->fq", N, (self.body.nodes + u)[s.nodes, 2]) - self.level
        t = s.frames + np.einsum("fqkt,fki->fqti", T, u[s.nodes])
        # n_z = t₁ₓ t₂ᵧ − t₁ᵧ t₂ₓ and its slopes by t₁ and t₂.
        n_z = t[..., 0, 0] * t[..., 1, 1] - t[..., 0, 1] * t[..., 1, 0]
        c = -self._gamma(e) * s.weights
        energy = float((c * h * h * n_z).sum() / 2)
        if order < 1:
            return Evaluation(energy)
        slopes = np.zeros((*h.shape, N.shape[-1], 3))
        slopes[..., 0] = T[..., 0] * t[..., None, 1, 1] - T[..., 1] * t[..., None, 0, 1]
        slopes[..., 1] = T[..., 1] * t[..., None, 0, 0] - T[..., 0] * t[..., None, 1, 0]
        at_nodes = np.einsum("fq,fqki->fki", c * h * h / 2, slopes)
        at_nodes[..., 2] += np.einsum("fq,fqk->fk", c * h * n_z, N)
        force = np.zeros_like(self.body.nodes)
        np.add.at(force, s.nodes, at_nodes)
        if order < 2:
            return Evaluation(energy, force)
        k = N.shape[-1]
        local = np.zeros((len(h), k, k, 3, 3))
        local[..., 2, 2] = np.einsum("fq,fqa,fqb->fab", c * n_z, N, N)
        mixed = np.einsum("fq,fqa,fqbi->fabi", c * h, N, slopes)
        local[..., 2, :] += mixed
        local[..., :, 2] += mixed.transpose(0, 2, 1, 3)
        turn = np.einsum("fq,fqa,fqb->fab", c * h * h / 2, T[..., 0], T[..., 1])
        turn = turn - turn.transpose(0, 2, 1)
        local[..., 0, 1] += turn
        local[..., 1, 0] -= turn
        blocks = np.zeros((self.graph.blocks, 3, 3))
        np.add.at(blocks, self._positions, local)
        return Evaluation(energy, force, blocks, own=True)


class Traction(DeadLoad):
    """Dead traction on a face, force per reference area; see :class:`DeadLoad`."""

    def __init__(self, body: Body, surface: Surface, vector: Quantity, *, name: str = "traction"):
        refuse_region(body, surface, Surface)
        super().__init__(body, surface, vector, name)


class LineLoad(DeadLoad):
    """Dead load on a line, force per reference length; see :class:`DeadLoad`.

    ``vector`` may also be per segment (l, 3) or per point (l, q, 3).
    """

    def __init__(self, body: Body, line: Line, vector: Quantity, *, name: str = "line load"):
        refuse_region(body, line, Line)
        super().__init__(body, line, vector, name)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes as a region of points: ``nodes`` (p, 1), ``shapes`` (p, 1, 1), ``weights`` (p, 1)."""

    nodes: np.ndarray
    shapes: np.ndarray
    weights: np.ndarray


class PointLoad(DeadLoad):
    """Dead forces at nodes; see :class:`DeadLoad`.

    ``nodes``: numbers, or a mask (n,). ``vector``: a force (3,) that each of them bears, or forces
    (nodes, 3). A solid gives way without bound under it on ever finer meshes: where its own sink
    matters, spread the load over a line or a face. Raises ValueError for nodes that don't exist and
    for one that is named twice.
    """

    def __init__(
        self, body: Body, nodes: np.ndarray, vector: Quantity, *, name: str = "point load"
    ):
        at = node_numbers(nodes, len(body.nodes))[:, None]
        named, times = np.unique(at, return_counts=True)
        if (times > 1).any():
            raise ValueError(
                f"node {named[times > 1][0]} is named {times[times > 1][0]} times and would bear "
                "as many loads; name each node once, or give a mask of booleans"
            )
        super().__init__(body, Nodes(at, np.ones((*at.shape, 1)), np.ones(at.shape)), vector, name)


class Foundation:
    """Elastic (Winkler) foundation: springs from a face to where it stood, per reference area.

    Energy ∫ ½ k_n (u·N)² + ½ k_t |u − (u·N) N|² dA₀ with the reference normal N; ``normal`` k_n and
    ``tangential`` k_t ≥ 0 in stress per length, constant, per facet (f,) or per point (f, q), or a
    function (see :mod:`solver.physics.fields`). The springs keep their directions. They pull as
    they push: for a ground that a body leaves take :class:`solver.physics.ground.Ground`.

    Raises ValueError for another shape and a negative stiffness.
    """

    symmetric = True

    def __init__(
        self,
        body: Body,
        surface: Surface,
        normal: Quantity,
        tangential: Quantity = 0.0,
        *,
        name: str = "foundation",
    ):
        self.name = name
        refuse_region(body, surface, Surface)
        self.body, self.surface = body, surface
        self.normal, self.tangential = normal, tangential
        self.graph = NodeGraph.of(len(body.nodes), surface.nodes)
        self._memo = None
        self._matrix(0.0)

    def _matrix(self, e: float) -> sp.bsr_array:
        """The stiffness at the load e: the same at any displacement."""
        still = not (varies(self.normal) or varies(self.tangential))
        if self._memo is None or (self._memo[0] != e and not still):
            s, g = self.surface, self.graph
            k = []
            for side, value in (("normal", self.normal), ("tangential", self.tangential)):
                what = f"{side} stiffness"
                given = resolve(what, value, e, s.weights.shape, lambda: _positions(s, self.body))
                if not (given >= 0).all():
                    raise Unphysical(
                        f"{what} = {given.min():g} at e = {e:g}; expected >= 0: a "
                        "foundation pulls back"
                    )
                k.append(given[..., None, None])
            NN = s.normals[..., :, None] * s.normals[..., None, :]
            D = s.weights[..., None, None] * (k[0] * NN + k[1] * (np.eye(3) - NN))
            blocks = np.zeros((g.blocks, 3, 3))
            pairs = np.einsum("fqa,fqb,fqij->fabij", s.shapes, s.shapes, D, optimize=True)
            np.add.at(blocks, g.positions(s.nodes), pairs)
            matrix = sp.bsr_array((blocks, g.indices, g.indptr), shape=(3 * g.n, 3 * g.n))
            self._memo = (e, matrix)
        return self._memo[1]

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and blocks on the surface's graph; u (n, 3)."""
        K = self._matrix(e)
        force = (K @ u.ravel()).reshape(-1, 3)
        energy = 0.5 * float((force * u).sum())
        return Evaluation(energy, force if order >= 1 else None, K.data if order >= 2 else None)


def _positions(region, body: Body) -> np.ndarray:
    """Reference positions of a region's points, (f, q, 3)."""
    return np.einsum("fqk,fki->fqi", region.shapes, body.nodes[region.nodes])
