"""Terms: each effect's energy, force = dE/du and stiffness at (u, e).

Elastic with growth (Π = ∫ Jg ψ(Fe) dV₀), gravity (Eq. 4.2) and dead traction. Pressure is in
:mod:`solver.physics.pressure`, the ground in :mod:`solver.physics.ground`.
"""

from __future__ import annotations

import copy
import warnings

import numpy as np

from solver.given import numbers, one_of
from solver.mesh.body import Body
from solver.mesh.locking import of_material
from solver.physics.fields import resolve
from solver.physics.growth import Growth
from solver.physics.kernels import (
    SMALL,
    add_force,
    add_geometric,
    add_stiffness_large,
    add_stiffness_small,
    deform,
    extrapolate,
    total,
)
from solver.physics.materials import Material
from solver.physics.term import Evaluation

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
        """Raises ValueError for a mask of the wrong shape, and what material and growth raise.

        Warns with :class:`solver.mesh.locking.Locking` where the element is too stiff
        for the body's shape, or for a ν near ½.
        """
        m, q = body.weights.shape
        if cells is not None:
            numbers("cells", cells)
            cells = np.asarray(cells)
            if cells.shape != (m,) or cells.dtype != bool:
                raise ValueError(
                    f"cells have shape {cells.shape} and type {cells.dtype}; expected a mask "
                    f"({m},) of booleans: Body.cells_where gives one"
                )
            if not cells.any():
                raise ValueError("no cell was chosen; leave the term out or check the mask")
        if not hasattr(material, "properties"):
            raise ValueError(f"the material is {material!r:.60}; expected one such as NeoHookean")
        if growth is not None:
            one_of("growth", Growth, growth, "such as Isotropic")
        self.name = name
        self.body, self.material, self.growth = body, material, growth
        self.graph = body.graph
        self._ids = np.arange(m) if cells is None else np.flatnonzero(cells)
        small = q * body.cells.shape[1] <= SMALL
        self._add_stiffness = add_stiffness_small if small else add_stiffness_large
        self._memo = None
        self._at(0.0)
        self.locking = ()
        if isinstance(material, Material):
            nu = resolve("nu", material.nu, 0.0, (m, q), body.points)
            self.locking = of_material(body, float((nu if len(nu) == 1 else nu[self._ids]).max()))
            for warning in (*body.locking(), *self.locking):
                warnings.warn(warning, stacklevel=2)

    @property
    def ids(self) -> np.ndarray:
        """Indices of the cells that the term covers."""
        return self._ids

    def with_growth(self, growth: Growth) -> Elastic:
        """The same term with another growth; nothing else is checked again."""
        other = copy.copy(self)
        other.growth, other._memo = one_of("growth", Growth, growth, "such as Isotropic"), None
        return other

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

    def _chunks(self, u: np.ndarray, e: float, order: int):
        """Of a few hundred points at a time: where they stand among the term's cells, the cells,
        ĝ, Fe, ψ, P and A, in arrays that the next chunk overwrites. None, and no more, where the
        material doesn't admit the state."""
        body, (table, inverse, _) = self.body, self._at(e)
        u = np.ascontiguousarray(u, dtype=float)
        q, k = body.gradients.shape[1:3]
        step = max(1, CHUNK // q)
        G, F = np.empty((step, q, 3, k)), np.empty((step, q, 3, 3))
        psi, P = np.empty((step, q)), np.empty((step, q, 3, 3))
        A = np.empty((step if order >= 2 else 1, q, 3, 3, 3, 3))
        for start in range(0, len(self._ids), step):
            at = slice(start, start + step)
            ids = self._ids[at]
            part = table if len(table) == 1 else table[ids]
            deform(ids, body.cells, body.gradients, u, inverse, G, F)
            if not self.material.kernel(F[: len(ids)], part, order, psi, P, A):
                yield None
                return
            yield at, ids, G, F, psi, P, A

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and stiffness blocks on the body's graph; u (n, 3)."""
        body, J = self.body, self._at(e)[2]
        force = np.zeros_like(body.nodes) if order >= 1 else None
        blocks = np.zeros((self.graph.blocks, 3, 3)) if order >= 2 else None
        energy = 0.0
        for chunk in self._chunks(u, e, order):
            if chunk is None:
                return Evaluation(np.inf)
            _, ids, G, _, psi, P, A = chunk
            energy += total(ids, body.weights, J, psi)
            if order >= 1:
                add_force(ids, body.cells, body.weights, J, G, P, force)
            if order >= 2:
                self._add_stiffness(ids, body.positions, body.weights, J, G, A, blocks)
        if not np.isfinite(energy):
            return Evaluation(np.inf)
        return Evaluation(energy, force, blocks, own=True)

    def by_growth(self, u: np.ndarray, e: float, rate: np.ndarray) -> np.ndarray | None:
        """How the stress S = ∂(Jg ψ)/∂F (m, q, 3, 3), force_a = ∫ S ∂N_a/∂X dV₀, changes while
        growth does and nothing moves; None where the material does not admit u.

        ``rate`` (1 | m, 1 | q, 3, 3): L = dFg Fg⁻¹ per change of what drives the growth at each
        point. From Fe = F Fg⁻¹ follow dFe = −Fe L and

            dS = Jg (tr L P − P Lᵀ − A : (Fe L)) Fg⁻ᵀ.

        0 off the term's cells.
        """
        _, inverse, J = self._at(e)
        if not len(J):
            raise ValueError(f"term {self.name!r} does not grow; give it a growth")
        shape = self.body.weights.shape
        rate = np.broadcast_to(rate, (*shape, 3, 3))
        out = np.zeros((*shape, 3, 3))
        for chunk in self._chunks(u, e, 2):
            if chunk is None:
                return None
            _, ids, _, F, _, P, A = chunk
            F, P, A, L = F[: len(ids)], P[: len(ids)], A[: len(ids)], rate[ids]
            dP = np.trace(L, axis1=2, axis2=3)[..., None, None] * P - P @ np.swapaxes(L, 2, 3)
            dP -= np.einsum("cqiJkL,cqkL->cqiJ", A, F @ L)
            volume = J[ids] if len(J) > 1 else J
            out[ids] = (
                volume[..., None, None]
                * dP
                @ np.swapaxes(inverse[ids] if len(inverse) > 1 else inverse, 2, 3)
            )
        return out

    def extrapolated(self, u: np.ndarray, du: np.ndarray, e: float) -> np.ndarray | None:
        """Stresses Fe⁻¹P (cells, points, 3, 3) that a step du (n, 3) from u would lead to if they
        grew in proportion; None where the material does not admit u."""
        du = np.ascontiguousarray(du, dtype=float)
        out = np.empty((len(self._ids), self.body.weights.shape[1], 3, 3))
        for chunk in self._chunks(u, e, 2):
            if chunk is None:
                return None
            at, ids, G, F, _, P, A = chunk
            extrapolate(ids, self.body.cells, du, G, F, P, A, out[at])
        return out

    def under(self, stress: np.ndarray, u: np.ndarray, e: float) -> np.ndarray | None:
        """What the stiffness at u would have more, as blocks, if stresses (cells, points, 3, 3) as
        :meth:`extrapolated` gives them were the state's own; None where u is not admitted."""
        body, J = self.body, self._at(e)[2]
        blocks = np.zeros((self.graph.blocks, 3, 3))
        for chunk in self._chunks(u, e, 1):
            if chunk is None:
                return None
            at, ids, G, F, _, P, _ = chunk
            add_geometric(ids, body.positions, body.weights, J, G, F, P, stress[at], blocks)
        return blocks
