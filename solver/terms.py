"""Terms: each effect's energy, force = dE/du and stiffness at (u, e).

Elastic with growth (Π = ∫ Jg ψ(Fe) dV₀), gravity (Eq. 4.2) and dead traction. Pressure is in
:mod:`solver.pressure`, the ground in :mod:`solver.ground`.
"""

from __future__ import annotations

import time

import numpy as np

from solver.body import Body, Surface
from solver.fields import Quantity, Unphysical, resolve, varies
from solver.growth import Growth
from solver.kernels import (
    SMALL,
    add_force,
    add_stiffness_large,
    add_stiffness_small,
    deform,
    total,
)
from solver.materials import Material
from solver.scene import Evaluation

# Points whose tangents stay in cache between the material and the assembly.
CHUNK = 1024


class Elastic:
    """∫ Jg ψ(Fe) dV₀ with Fe = F Fg⁻¹, Jg = det Fg, over all cells or a mask of them.

    The growth enters through ĝ_a = Fg⁻ᵀ ∂N_a/∂X: with Fe = Fg⁻¹ + Σ u_a ⊗ ĝ_a and the volume Jg dV₀
    force and stiffness keep the form they have without growth. Energy is inf, and force and
    stiffness None, where the material does not admit the state.
    """

    symmetric = True

    def __init__(
        self,
        body: Body,
        material: Material,
        growth: Growth | None = None,
        *,
        cells: np.ndarray | None = None,
        name: str = "elastic",
    ):
        """Raises ValueError for a mask of the wrong shape, and what material and growth raise."""
        m, q = body.weights.shape
        if cells is not None:
            cells = np.asarray(cells)
            if cells.shape != (m,) or cells.dtype != bool:
                raise ValueError(
                    f"cells have shape {cells.shape} and type {cells.dtype}; expected a mask "
                    f"({m},) of booleans: Body.cells_where gives one"
                )
            if not cells.any():
                raise ValueError("no cell was chosen; leave the term out or check the mask")
        self.name = name
        self.body, self.material, self.growth = body, material, growth
        self.graph = body.graph
        self._ids = np.arange(m) if cells is None else np.flatnonzero(cells)
        self._small = q * body.cells.shape[1] <= SMALL
        self._memo = None
        self._at(0.0)

    @property
    def ids(self) -> np.ndarray:
        """Indices of the cells that the term covers."""
        return self._ids

    def _at(self, e: float):
        """Properties, Fg⁻¹ and Jg at e. The memo holds one load and is invisible from outside."""
        memo = self._memo
        if memo is None or memo[0] != e:
            shape, points = self.body.weights.shape, self.body.points
            if memo is None or self.material.moving:
                table = self.material.properties(e, shape, points)
            else:
                table = memo[1]
            inverse, J = np.empty((0, 1, 3, 3)), np.empty((0, 1))
            if self.growth is not None:
                inverse, J = self.growth.evaluate(e, shape, points)
            memo = self._memo = (e, table, inverse, J)
        return memo[1:]

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and stiffness blocks on the body's graph; u (n, 3)."""
        body = self.body
        table, inverse, J = self._at(e)
        u = np.ascontiguousarray(u, dtype=float)
        q, k = body.gradients.shape[1:3]
        step = max(1, CHUNK // q)
        G, F = np.empty((step, q, 3, k)), np.empty((step, q, 3, 3))
        psi, P = np.empty((step, q)), np.empty((step, q, 3, 3))
        A = np.empty((step if order >= 2 else 1, q, 3, 3, 3, 3))
        force = np.zeros_like(body.nodes) if order >= 1 else None
        blocks = np.zeros((self.graph.blocks, 3, 3)) if order >= 2 else None
        add_stiffness = add_stiffness_small if self._small else add_stiffness_large
        energy = 0.0
        for start in range(0, len(self._ids), step):
            ids = self._ids[start : start + step]
            part = table if len(table) == 1 else table[ids]
            c = len(ids)
            deform(ids, body.cells, body.gradients, u, inverse, G, F)
            if not self.material.kernel(F[:c], part, order, psi, P, A):
                return Evaluation(np.inf)
            energy += total(ids, body.weights, J, psi)
            if order >= 1:
                add_force(ids, body.cells, body.weights, J, G, P, force)
            if order >= 2:
                add_stiffness(ids, body.positions, body.weights, J, G, A, blocks)
        if not np.isfinite(energy):
            return Evaluation(np.inf)
        return Evaluation(energy, force, blocks)


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
    :mod:`solver.fields`). Raises ValueError for another shape.
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
            share = np.einsum("fq,fqk,fqi->fki", s.weights, s.shapes, np.broadcast_to(
                t, (*s.weights.shape, 3)))  # fmt: skip
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


class Timed:
    """A term that keeps the time it takes, in ``clock[name]``: evaluations and seconds."""

    def __init__(self, term, clock: dict[str, list[float]]):
        self._term, self._spent = term, clock.setdefault(term.name, [0, 0.0])

    def __getattr__(self, name):
        return getattr(self._term, name)

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """The term's own."""
        start = time.perf_counter()
        found = self._term.evaluate(u, e, order)
        self._spent[0] += 1
        self._spent[1] += time.perf_counter() - start
        return found


class OutOfTime(Exception):
    """The deadline of a path has passed."""


class Deadline:
    """A term that adds nothing and raises :class:`OutOfTime` once ``time.monotonic()`` is past
    ``at``: any iteration, however deep, then ends. Part of a scene only where there is a limit."""

    name, graph, symmetric = "deadline", None, True

    def __init__(self, at: float):
        self.at = at

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Nothing."""
        if time.monotonic() > self.at:
            raise OutOfTime
        return Evaluation(0.0, np.zeros(()))
