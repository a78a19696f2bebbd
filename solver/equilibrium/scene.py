"""A scene: a body, a list of terms, what is held. The sum of the terms is the whole physics.

Unknowns. Each node may be turned into a frame of its own (for mirror planes and supports at an
angle) in which single components are prescribed; the rest are the free components q. Linear rows
C u = c(e), such as "no mean rotation", come with Lagrange multipliers λ. The vector of unknowns is
x = (q, λ), and with the total energy E(u, e)

    R(x, e) = (Tᵀ dE/du + (C T)ᵀ λ,  C u − c(e)),        u = T q + u₀(e).

Continuation sees x, e and R, and never learns what e drives.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from solver.equilibrium import checks
from solver.equilibrium.linear import DyadFactor, Factor
from solver.equilibrium.pattern import Frame
from solver.equilibrium.sections import FreeSections, Sections
from solver.given import number, numbers, one_of
from solver.mesh.body import Body, NodeGraph
from solver.physics.fields import Unphysical
from solver.physics.supports import Fixed, Row, Tied
from solver.physics.term import Evaluation, Term
from solver.shown import scene_table


@dataclass(frozen=True)
class Scales:
    """Sizes that make tolerances ratios: m (or l_s), force and energy in the scene's own units."""

    length: float
    force: float
    energy: float

    def __post_init__(self):
        for name in ("length", "force", "energy"):
            number(f"the scale of {name}", getattr(self, name), above=0)


class System:
    """Energy, residual and tangent at one (x, e); factorised when first needed.

    ``dyads`` (size, m): vectors v whose v vᵀ add to the matrix of ``values``; None: there are none.
    """

    def __init__(
        self, scene: Scene, residual: np.ndarray, values: np.ndarray, energy=None, dyads=None
    ):
        self.residual, self.values = residual, values
        self.energy: float | None = energy
        self.dyads: np.ndarray | None = dyads
        self._scene = scene
        self._factor: Factor | None = None
        self._counted: tuple[int | None] | None = None

    def factorise(self) -> Factor:
        """The factorised tangent; raises :class:`solver.equilibrium.linear.SingularMatrix`."""
        if self._factor is None or not self._factor.alive:
            self._factor = self._scene.factorised(self.values)
            if self.dyads is not None:
                self._factor = DyadFactor(self._factor, self.dyads)
        return self._factor

    @property
    def unstable(self) -> int | None:
        """Unstable modes: negative pivots less the constraint rows; None if they can't be counted.

        With m independent rows the bordered matrix has exactly m negative eigenvalues more than the
        stiffness has on the states that the rows allow. Of a stiffness that isn't symmetric they
        are those of its symmetric part where that decides: where it has none, or where the rest is
        roundoff, as the supports take up what isn't symmetric.
        """
        if not self._scene.symmetric:
            if self._counted is None:
                self._counted = (self._scene.frame.modes_of_symmetric_part(self.values),)
            # Dyads take modes away and add none.
            return self._counted[0] if self.dyads is None or self._counted[0] == 0 else None
        negative = self.factorise().negative
        return None if negative is None else negative - self._scene.n_rows

    def linear_residual(
        self, dx: np.ndarray, load: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, float]:
        """R + K dx + load (size,) after a solve for dx (size,), and how large it is against what
        the solve had to balance: by its work, or by its size where that is more.

        It grows like roundoff times the condition number, for the work weighs soft motions as they
        count; at 1 the factorisation took K for another matrix and dx is nothing. ``load``:
        ∂R/∂e de where the load moves too.
        """
        n = self._scene.n_free
        over = self._scene.frame.times(self.values, dx) + self.residual + load
        if self.dyads is not None:
            over += self.dyads @ (self.dyads.T @ dx)
        parts = [self.residual[:n], load[:n] if np.ndim(load) else np.zeros(n)]
        if self._scene.n_rows:
            parts.append(self._scene.frame.C_free.T @ dx[n:])
        work = sum(abs(float(dx[:n] @ part)) for part in parts)
        size = sum(float(np.linalg.norm(part)) for part in parts)
        doubts = [
            abs(float(dx[:n] @ over[:n])) / work if work > 0 else 0.0,
            float(np.linalg.norm(over[:n])) / size if size > 0 else 0.0,
        ]
        return over, max(doubts)

    def holding(self, held: np.ndarray) -> System:
        """The same state with more unknowns held, those of a mask ``held`` (size,): their rows are
        those of a diagonal matrix. They leave no unstable mode, and nothing is analysed again."""
        values = self.values.copy()
        typical = float(np.median(np.abs(self.values[self._scene.diagonal])))
        self._scene.frame.pattern.hold(values, held, typical)
        dyads = None if self.dyads is None else np.where(held[:, None], 0.0, self.dyads)
        return System(self._scene, np.where(held, 0.0, self.residual), values, self.energy, dyads)

    def pushed(self, residual: np.ndarray) -> System:
        """The same tangent with another residual (size,) and no energy."""
        return System(self._scene, residual, self.values, None, self.dyads)

    def shifted(self, shift: float) -> System:
        """The same state with ``shift`` added to the stiffness of every free component."""
        return self.plus(shift, 0.0, 0.0)

    def plus(self, shift: float, force: np.ndarray | float, energy: float) -> System:
        """With more: ``shift`` on the stiffness of free components, a residual and an energy."""
        values = self.values.copy()
        values[self._scene.diagonal] += shift
        total = None if self.energy is None else self.energy + energy
        return System(self._scene, self.residual + force, values, total, self.dyads)


class Scene:
    """Terms on the nodes of a body, with prescribed displacements and constraint rows."""

    def __init__(
        self,
        body: Body,
        terms: Sequence[Term],
        *,
        fixed: Sequence[Fixed] = (),
        tied: Sequence[Tied] = (),
        rows: Sequence[Row] = (),
        scales: Scales | None = None,
        linear: str = "auto",
        frame: Frame | None = None,
        sections: Sections | FreeSections | None = None,
    ):
        """``frame``: instead of ``fixed``, ``tied``, ``rows`` and ``linear``, another scene's.
        ``sections`` of a slender body, which turn in a step instead of moving straight on; rows
        that a straight step would keep are then left by as much as it turns, squared.

        Raises ValueError for terms of another body or none with stiffness, and for supports and
        rows that contradict or repeat each other or leave nothing free.
        """
        self.body, self.sections = body, sections
        self.terms = checks.checked_terms(terms, body)
        if not any(term.graph is not None for term in self.terms):
            raise ValueError("no term has a stiffness; add an Elastic term to the scene")
        self.frame = frame or Frame(body, self.terms, fixed, rows, linear, tied)
        self.rows, self.symmetric = self.frame.rows, self.frame.symmetric
        self.graph, self.diagonal = self.frame.pattern.graph, self.frame.pattern.diagonal
        self.solver = self.frame.solver
        self.n_nodes = len(body.nodes)
        self._held = self.frame.held
        self.n_free = len(self._held.index)
        self.n_rows = len(self.rows)
        self.size = self.n_free + self.n_rows
        self._where = [self.frame.places(term.graph) for term in self.terms]
        if scales is not None:
            one_of("scales", Scales, scales, "Scales(length, force, energy)")
        self.scales = scales or Scales(body.length, *self._natural_scales())

    def __repr__(self) -> str:
        terms = ", ".join(type(term).__name__ for term in self.terms)
        return f"Scene({terms}; {self.n_nodes} nodes, {self.n_free} unknowns, {self.n_rows} rows)"

    _repr_html_ = scene_table

    def with_terms(self, terms: Sequence[Term]) -> Scene:
        """The same body, supports, solver and scales with other terms: nothing is analysed again.

        So a step in time swaps a term for its successor. Raises ValueError where they bring pairs
        of nodes that share no block here, or a stiffness that is not symmetric into one that is.
        """
        terms = checks.checked_terms(terms, self.body)
        if self.symmetric and not all(term.symmetric for term in terms):
            raise ValueError("a term's stiffness is not symmetric and this scene's is; build anew")
        known = {id(term.graph) for term in self.terms}
        new = [t.graph for t in terms if t.graph is not None and id(t.graph) not in known]
        if any(NodeGraph.union([self.graph, g]).blocks > self.graph.blocks for g in new):
            raise ValueError("a term couples nodes that share no block here; build the scene anew")
        return Scene(self.body, terms, scales=self.scales, frame=self.frame, sections=self.sections)

    # -- what is held ----------------------------------------------------------------------------

    def displacement(self, x: np.ndarray, e: float) -> np.ndarray:
        """u (nodes, 3) of the unknowns x (size,) at the load e; ValueError for another shape."""
        x = numbers("x", x)
        if x.shape != (self.size,):
            raise ValueError(f"x has shape {x.shape}; expected ({self.size},)")
        local = self._held.values(e)
        local[self._held.index] = x[: self.n_free]
        return self._held.to_global(self._held.spread(local).reshape(-1, 3))

    def unknowns(self, u: np.ndarray, multipliers: np.ndarray | None = None) -> np.ndarray:
        """x of a displacement (nodes, 3); prescribed components are dropped.

        Raises ValueError for another shape.
        """
        u = numbers("displacement", u)
        if u.shape != (self.n_nodes, 3):
            raise ValueError(
                f"displacement has shape {u.shape}; expected ({self.n_nodes}, 3): one row per node"
            )
        x = np.zeros(self.size)
        x[: self.n_free] = self._held.to_local(u).ravel()[self._held.index]
        if multipliers is not None:
            x[self.n_free :] = multipliers
        return x

    def step_displacement(self, dx: np.ndarray) -> np.ndarray:
        """du (nodes, 3) of a change of the unknowns at fixed load."""
        local = np.zeros(3 * self.n_nodes)
        local[self._held.index] = dx[: self.n_free]
        return self._held.to_global(self._held.spread(local).reshape(-1, 3))

    def pulls(self, force: np.ndarray) -> np.ndarray:
        """Forces (nodes, 3) on the unknowns (size,), 0 for the multipliers: dE/dq of dE/du."""
        out = np.zeros(self.size)
        local = self._held.collect(self._held.to_local(force).ravel())
        out[: self.n_free] = local[self._held.index]
        return out

    def moved(self, x: np.ndarray, dx: np.ndarray, e: float) -> np.ndarray:
        """The unknowns that a step dx from x leads to: x + dx, or where sections turn the end of a
        motion that sets out that way."""
        if self.sections is None:
            return x + dx
        u, du = self.displacement(x, e), self.step_displacement(dx)
        u += self.sections.moved(self.body.nodes + u, du)
        return self.unknowns(u, x[self.n_free :] + dx[self.n_free :])

    def way(self, x: np.ndarray, y: np.ndarray, e: float) -> np.ndarray:
        """The step that leads from the unknowns x to y, see :meth:`moved`."""
        dx = y - x
        if self.sections is not None:
            X, Y = (self.body.nodes + self.displacement(z, e) for z in (x, y))
            dx[: self.n_free] = self.unknowns(self.sections.step(X, Y))[: self.n_free]
        return dx

    def refuse_free_motion(self, x: np.ndarray, e: float) -> None:
        """Raises ValueError if nodes have no stiffness at (x, e), or the body or a part of it can
        be moved rigidly without any resistance; see :mod:`solver.equilibrium.checks`."""
        checks.refuse_free_motion(self, x, e)

    def obstacle(self, x: np.ndarray, e: float) -> str:
        """What keeps an iteration from an equilibrium at (x, e), in words, where the state tells: a
        term that doesn't admit it, nodes without stiffness, parts that move freely; else empty."""
        return checks.inadmissible(self, x, e) or checks.loose(self, x, e)

    # -- the sum of the terms --------------------------------------------------------------------

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Sum of all terms in the nodes' common frame.

        Raises :class:`solver.physics.fields.Unphysical` for a load at which a term has no meaning.
        """
        energy: float | None = 0.0
        force = np.zeros((self.n_nodes, 3)) if order >= 1 else None
        blocks, own, dyads = None, False, ()
        for term, where in zip(self.terms, self._where, strict=True):
            part = term.evaluate(u, e, order)
            energy = None if energy is None or part.energy is None else energy + part.energy
            if part.energy == np.inf:
                return Evaluation(np.inf)
            if order >= 1:
                force += part.force
            dyads += part.dyads
            if order < 2 or part.stiffness is None:
                continue
            if blocks is None and where is None:
                # Most scenes have one stiff term: its array is the sum.
                blocks, own = part.stiffness, part.own
                continue
            if not own:
                empty = np.zeros((self.graph.blocks, 3, 3))
                blocks, own = empty if blocks is None else blocks.copy(), True
            if where is None:
                blocks += part.stiffness
            else:
                blocks[where] += part.stiffness  # each block stands once
        return Evaluation(energy, force, blocks, own, dyads)

    def _tried(self, u: np.ndarray, e: float, order: int) -> Evaluation:
        """The sum of the terms at a state that an iteration tries, which may make no sense."""
        try:
            return self.evaluate(u, e, order)
        except Unphysical:
            return Evaluation(np.inf)

    def energy(self, x: np.ndarray, e: float) -> float | None:
        """Total energy with the multipliers' part left out; inf where not admissible."""
        return self._tried(self.displacement(x, e), e, 0).energy

    def residual(self, x: np.ndarray, e: float) -> np.ndarray | None:
        """R(x, e), shape (size,); None where the state is not admissible."""
        u = self.displacement(x, e)
        part = self._tried(u, e, 1)
        return None if part.force is None else self._residual(part.force, u, x, e)

    def gradient(self, x: np.ndarray, e: float) -> tuple[float | None, np.ndarray] | None:
        """Energy (None where there is none) and residual; None where not admissible."""
        u = self.displacement(x, e)
        part = self._tried(u, e, 1)
        return None if part.force is None else (part.energy, self._residual(part.force, u, x, e))

    def system(self, x: np.ndarray, e: float, stresses: Sequence | None = None) -> System | None:
        """Residual and tangent; None where the state is not admissible.

        ``stresses``: of each term, as :meth:`extrapolated` gives them; the tangent is then that of
        a body under those instead of its own.
        """
        u = self.displacement(x, e)
        part = self._tried(u, e, 2)
        if part.force is None:
            return None
        R = self._residual(part.force, u, x, e)
        blocks = part.stiffness
        if stresses is not None:
            blocks = blocks if part.own else blocks.copy()
            for term, where, stress in zip(self.terms, self._where, stresses, strict=True):
                if stress is not None:
                    # Each block stands once.
                    blocks[slice(None) if where is None else where] += term.under(stress, u, e)
        dyads = None
        if part.dyads:
            dyads = np.stack([np.sqrt(c) * self.pulls(g) for c, g in part.dyads], axis=1)
        return System(self, R, self.frame.pattern.gather(blocks), part.energy, dyads)

    def convex(self, x: np.ndarray, e: float) -> list | None:
        """What :meth:`system` takes as stresses where terms that act at x and can are to add
        nothing negative to the tangent; None where there is no such term."""
        able = [hasattr(term, "convex") for term in self.terms]
        if not any(able):
            return None
        u = self.displacement(x, e)
        kept = [
            term.convex if can and term.acts(u) else None
            for term, can in zip(self.terms, able, strict=True)
        ]
        return None if all(own is None for own in kept) else kept

    def extrapolated(self, x: np.ndarray, dx: np.ndarray, e: float) -> list[np.ndarray | None]:
        """Of each term the stresses that a step dx from x would lead to if they grew in proportion
        to it; None for terms without, and where x or the load is not admissible."""
        u, du = self.displacement(x, e), self.step_displacement(dx)
        stresses = []
        for term in self.terms:
            stress = None
            if hasattr(term, "extrapolated"):
                with suppress(Unphysical):
                    stress = term.extrapolated(u, du, e)
            stresses.append(stress)
        return stresses

    def system_of(self, stiffness: np.ndarray) -> System:
        """A tangent given by its blocks on this scene's graph, such as that of a state which these
        supports don't hold: so the stability of a symmetric state is judged under others. Its
        residual is 0, and it has no dyads: of blocks alone."""
        return System(self, np.zeros(self.size), self.frame.pattern.gather(stiffness))

    def load_rate(self, x: np.ndarray, e: float, step: float = 1e-6) -> np.ndarray | None:
        """∂R/∂e by central differences of the force; None where not admissible."""
        lo, hi = self.residual(x, e - step), self.residual(x, e + step)
        return None if lo is None or hi is None else (hi - lo) / (2 * step)

    def longest_step(self, x: np.ndarray, dx: np.ndarray, e: float) -> float:
        """Fraction of dx (at most 1) that every barrier admits."""
        steps = [
            term.longest_step(self.displacement(x, e), self.step_displacement(dx))
            for term in self.terms
            if hasattr(term, "longest_step")
        ]
        return min([1.0, *steps])

    def _residual(self, force, u, x, e) -> np.ndarray:
        R = self.pulls(force)
        if self.n_rows:
            R[: self.n_free] += self.frame.C_free.T @ x[self.n_free :]
            targets = [checks.row_value(row, e) for row in self.rows]
            R[self.n_free :] = self.frame.C @ self._held.to_local(u).ravel() - targets
        return R

    def factorised(self, values: np.ndarray) -> Factor:
        """The factor of a matrix on this scene's pattern."""
        return self.frame.factorise(values)

    def _natural_scales(self) -> tuple[float, float]:
        """Force and energy of a unit mean stretch: from the stiffness of the undeformed state."""
        u = np.zeros((self.n_nodes, 3))
        blocks = self.evaluate(u, 0.0, 2).stiffness
        if blocks is None:
            raise ValueError("the undeformed state is not admissible at e = 0; give scales")
        g = self.graph
        a = np.repeat(np.arange(g.n), np.diff(g.indptr))
        trace = np.einsum("nii->n", blocks[a == g.indices]) / 3
        force = float(np.linalg.norm(trace)) * self.body.length
        return force, force * self.body.length
