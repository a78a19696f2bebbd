"""Loads without stiffness: gravity (Eq. 4.2) and dead traction."""

from __future__ import annotations

import numpy as np

from solver.mesh.body import Body, Surface
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
        if self._memo is None or (self._memo[0] != e and varies(self.density)):
            shape = self.body.weights.shape
            rho = resolve("density", self.density, e, shape, self.body.points)
            if not (rho >= 0).all():
                raise Unphysical(
                    f"density = {rho.min():g} at e = {e:g}; expected density >= 0: turn g around "
                    "to pull the other way"
                )
            self._memo = (e, self.body.node_volumes(rho))
        g = np.asarray(self.g(e) if callable(self.g) else self.g, dtype=float)
        if g.shape not in ((), (3,)) or not np.isfinite(g).all():
            raise ValueError(f"g = {g}; expected a magnitude along -z or a vector of three")
        return self._memo[1][:, None] * (g if g.ndim else np.array([0.0, 0.0, -g]))

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy and force = −weight; u (n, 3)."""
        weights = self.weights(e)
        energy = -float((weights * (self.body.nodes + u)).sum())
        return Evaluation(energy, -weights if order >= 1 else None)


class Traction:
    """Dead traction t per reference area: energy −∫ t·u dA₀, no stiffness.

    ``vector``: (3,), per facet (f, 3) or per point (f, q, 3), or a function (see
    :mod:`solver.physics.fields`). Raises ValueError for another shape.
    """

    graph = None
    symmetric = True

    def __init__(self, body: Body, surface: Surface, vector: Quantity, *, name: str = "traction"):
        self.name = name
        self.body, self.surface, self.vector = body, surface, vector
        self._memo = None
        self.loads(0.0)

    def loads(self, e: float) -> np.ndarray:
        """∫ N_a t dA₀ of each node, (n, 3)."""
        if self._memo is None or (self._memo[0] != e and varies(self.vector)):
            s = self.surface
            t = resolve("traction", self.vector, e, s.weights.shape, self._points, (3,))
            share = np.einsum(
                "fq,fqk,fqi->fki", s.weights, s.shapes, np.broadcast_to(t, (*s.weights.shape, 3))
            )
            loads = np.zeros_like(self.body.nodes)
            np.add.at(loads, s.nodes, share)
            self._memo = (e, loads)
        return self._memo[1]

    def _points(self) -> np.ndarray:
        return np.einsum("fqk,fki->fqi", self.surface.shapes, self.body.nodes[self.surface.nodes])

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy and force; u (n, 3)."""
        loads = self.loads(e)
        return Evaluation(-float((loads * u).sum()), -loads if order >= 1 else None)
