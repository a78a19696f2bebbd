"""Viscous: a step in time of a body of springs and dashpots, as a term of a scene.

Energy is the incremental potential ∫ Jg [Σ ψ + Δt Σ φ] dV₀ with F = F_ve Fg (Eqs. 5.53–5.61), force
its derivative and stiffness its second, condensed at each quadrature point. What lies before enters
by the constructor; :mod:`solver.viscous.evolution` goes from step to step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.equilibrium.scene import Scene
from solver.given import one_of
from solver.mesh.body import Body
from solver.physics.elastic import CHUNK, Elastic
from solver.physics.fields import Points
from solver.physics.growth import Growth
from solver.physics.kernels import deform
from solver.viscous.kernel import BRANCH, HEAD, inverse, nine, six, step
from solver.viscous.rheology import Rheology, Spring, branches
from solver.viscous.tree import Inadmissible, respond
from solver.viscous.tree import Points as TreePoints

ONE = six(np.eye(3))


@dataclass(frozen=True, eq=False)
class Memory:
    """What a term remembers at each point: C of every dashpot, as vectors of six.

    ``strains`` (m, q, dashpots, 6), in the order of ``Rheology.leaves``; ``joints`` (m, q, joints,
    6): stretches U of series, from which the next step's own iteration starts (a Maxwell branch
    has none: its C_v is among the strains). ``growth`` (m, q, modes): log stretches of growth, of
    a :class:`solver.viscous.feedback.Growing` body alone.
    """

    strains: np.ndarray
    joints: np.ndarray
    growth: np.ndarray | None = None

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """What it holds, in the order of its fields."""
        plain = (self.strains, self.joints)
        return plain if self.growth is None else (*plain, self.growth)

    @classmethod
    def rest(cls, body: Body, rheology: Rheology) -> Memory:
        """Undeformed."""
        shape = body.weights.shape
        joints = 0 if branches(rheology) is not None else rheology.joints
        return cls(
            np.tile(ONE, (*shape, len(rheology.dashpots), 1)), np.tile(ONE, (*shape, joints, 1))
        )


@dataclass(frozen=True, eq=False)
class Past:
    """What a step starts from: the memory before it, and for second order the one before that.

    ``dt`` > 0 is the step, ``last_dt`` the one before. Raises ValueError for times that are not
    positive, and half a second order.
    """

    before: Memory
    dt: float
    earlier: Memory | None = None
    last_dt: float | None = None

    def __post_init__(self):
        for name, value in (("dt", self.dt), ("last_dt", self.last_dt)):
            if value is not None and not value > 0:
                raise ValueError(f"{name} = {value}; expected a time > 0")
        if (self.earlier is None) != (self.last_dt is None):
            raise ValueError("second order needs both the earlier memory and its step last_dt")

    def weights(self) -> tuple[float, float]:
        """Shares of the last and the earlier state: (1, 0), or BDF2's (1 + r, −r²/(1 + r))."""
        if self.earlier is None:
            return 1.0, 0.0
        r = self.dt / self.last_dt
        return 1 + r, -r * r / (1 + r)

    def tensors(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Constant 6 (a₁ − a₂) of the potential, P and Q (m, q, dashpots, 6)."""
        a1, a2 = self.weights()
        Q = a1 * self.before.strains
        P = a1 * inverse(self.before.strains)
        if self.earlier is not None:
            Q = Q + a2 * self.earlier.strains
            P = P + a2 * inverse(self.earlier.strains)
        return 6 * (a1 + a2), P, Q

    @property
    def sound(self) -> bool:
        """Whether the potential bounds the strain: not where two states of the past lie too far
        apart for second order."""
        if self.earlier is None:
            return True
        _, P, Q = self.tensors()
        return all(bool((np.linalg.eigvalsh(nine(X)) > 0).all()) for X in (P, Q))


class Increment:
    """The rheology of one step as a material: a kernel over points and a table of numbers."""

    def __init__(self, rheology: Rheology, past: Past):
        self.rheology, self.past = rheology, past
        self._branches = branches(rheology)
        self._tensors = past.tensors()

    @property
    def moving(self) -> bool:
        """Whether a property is a function of e."""
        return self.rheology.moving

    def properties(self, e: float, shape: tuple[int, int], points: Points | None = None):
        """What the kernel needs at each point, (m, q, numbers): moduli, rates, past, guesses."""
        shapes = {
            leaf: np.broadcast_to(_values(leaf, e, shape, points), (*shape, 2))
            for leaf in self.rheology.leaves()
        }
        constant, P, Q = self._tensors
        rates = np.concatenate([np.empty((*P.shape[:3], 2)), P, Q], axis=-1)  # (m, q, dashpots, 14)
        for j, leaf in enumerate(self.rheology.dashpots):
            rates[:, :, j, 0] = shapes[leaf][..., 0] / (8 * self.past.dt)
            rates[:, :, j, 1] = constant
        if self._branches is None:
            moduli = [shapes[leaf] for leaf in self.rheology.springs]
            parts = [np.stack(moduli, 2)] if moduli else []
            parts = [*parts, rates, self.past.before.joints]
            return np.ascontiguousarray(
                np.concatenate([p.reshape(*shape, -1) for p in parts], axis=-1)
            )
        number = {leaf: j for j, leaf in enumerate(self.rheology.dashpots)}
        springs, dashpots, maxwell = self._branches
        table = np.zeros((*shape, HEAD + BRANCH * len(maxwell)))
        _fill(table, springs, dashpots, shapes, rates, number)
        for n, (left, right) in enumerate(maxwell):
            part = table[..., HEAD + BRANCH * n : HEAD + BRANCH * (n + 1)]
            _fill(part, left, right, shapes, rates, number)
            before = self.past.before.strains[:, :, number[right[0]]]
            part[..., HEAD:] = inverse(before)
        return table

    def kernel(self, F, table, order, psi, P, A) -> bool:
        """As a material's kernel; False for a state that is not admissible."""
        if self._branches is not None:
            return step(F, table, order, psi, P, A, np.empty((0, 0, 0, 6)))
        return self._tree(F, table, order, psi, P, A)[0]

    def _tree(self, F, table, order, psi, P, A):
        c, q = F.shape[:2]
        data = self._points(np.broadcast_to(table, (c, q, table.shape[-1])))
        flat = F.reshape(-1, 3, 3)
        if not (np.linalg.det(flat) > 0).all():
            return False, None
        try:
            C = np.swapaxes(flat, 1, 2) @ flat
            w, g, H = respond(self.rheology, C, data)
        except (Inadmissible, np.linalg.LinAlgError):
            return False, None
        psi[:c] = w.reshape(c, q)
        if order >= 1:
            P[:c] = (2 * flat @ nine(g)).reshape(c, q, 3, 3)
        if order >= 2:
            D = nine(np.moveaxis(nine(H), 1, -1))
            t = 4 * np.einsum("niI,nkK,nIJKL->niJkL", flat, flat, D)
            t += 2 * np.einsum("ik,nJL->niJkL", np.eye(3), nine(g))
            A[:c] = t.reshape(c, q, 3, 3, 3, 3)
        return True, data

    def _points(self, table):
        n = table.shape[0] * table.shape[1]
        springs, dashpots = len(self.rheology.springs), len(self.rheology.dashpots)
        flat = np.array(table.reshape(n, -1))
        a, b = 2 * springs, 2 * springs + 14 * dashpots
        return TreePoints(
            flat[:, :a].reshape(n, springs, 2),
            flat[:, a:b].reshape(n, dashpots, 14),
            flat[:, b:].reshape(n, -1, 6),
        )

    def after(self, F: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Strains (c, q, dashpots, 6) and joints at the end of the step; None: not admissible."""
        c, q = F.shape[:2]
        psi, P, A = np.empty((c, q)), np.empty((c, q, 3, 3)), np.empty((1, q, 3, 3, 3, 3))
        if self._branches is None:
            good, data = self._tree(F, table, 0, psi, P, A)
            if not good:
                return None
            return data.strains.reshape(c, q, -1, 6), data.joints.reshape(c, q, -1, 6)
        _, dashpots, maxwell = self._branches
        inner = np.empty((c, q, max(len(maxwell), 1), 6))
        if not step(F, table, 0, psi, P, A, inner):
            return None
        number = {leaf: j for j, leaf in enumerate(self.rheology.dashpots)}
        strains = np.empty((c, q, len(number), 6))
        for leaf in dashpots:
            strains[:, :, number[leaf]] = six(np.swapaxes(F, 2, 3) @ F)
        for n, (_, right) in enumerate(maxwell):
            C = inverse(inner[:, :, n])
            for leaf in right:
                strains[:, :, number[leaf]] = C
        return strains, np.empty((c, q, 0, 6))


def _values(leaf, e, shape, points):
    if isinstance(leaf, Spring):
        return leaf.material.properties(e, shape, points)
    return np.repeat(leaf.viscosity(e, shape, points)[..., None], 2, axis=-1)


def _fill(part, springs, dashpots, shapes, rates, number):
    for leaf in springs:
        part[..., :2] += shapes[leaf]
    for leaf in dashpots:
        part[..., 2] += rates[:, :, number[leaf], 0]
        part[..., 3:HEAD] = rates[:, :, number[leaf], 1:]


class Viscous(Elastic):
    """∫ Jg w(F_ve) dV₀ over one step dt: what :class:`solver.physics.elastic.Elastic` is for a
    rheology.

    ``before``: memory at the start of the step, None: at rest. ``earlier``, ``last_dt``: the one
    before and its step, for second order. A viscosity or a modulus may be of e.
    """

    def __init__(
        self,
        body: Body,
        rheology: Rheology,
        growth: Growth | None = None,
        *,
        dt: float,
        before: Memory | None = None,
        earlier: Memory | None = None,
        last_dt: float | None = None,
        cells: np.ndarray | None = None,
        name: str = "viscous",
    ):
        """Raises ValueError for a memory of another body or rheology, times that are not positive,
        and what :class:`Elastic` refuses."""
        one_of("rheology", Rheology, rheology, "Maxwell(E, nu, eta)")
        rest = self._rest(body, rheology)
        need = [a.shape for a in rest.arrays]
        for memory in (before, earlier):
            shapes = need if memory is None else [a.shape for a in memory.arrays]
            if shapes != need:
                raise ValueError(
                    f"the memory has shapes {' and '.join(map(str, shapes))}; this body and "
                    f"rheology need {' and '.join(map(str, need))}: start from Memory.rest"
                )
        self.rheology = rheology
        past = Past(rest if before is None else before, dt, earlier, last_dt)
        super().__init__(body, self._increment(rheology, past), growth, cells=cells, name=name)

    def rest(self) -> Memory:
        """The memory of the undeformed body."""
        return self._rest(self.body, self.rheology)

    def _rest(self, body: Body, rheology: Rheology) -> Memory:
        return Memory.rest(body, rheology)

    def _increment(self, rheology: Rheology, past: Past) -> Increment:
        return Increment(rheology, past)

    def shortest_time(self, e: float) -> float:
        """Shortest time in which anything relaxes at the load e; inf where nothing does."""
        return self.rheology.shortest_time(e, self.body.weights.shape, self.body.points)

    @property
    def past(self) -> Past:
        """What the step starts from."""
        return self.material.past

    def stepped(self, past: Past) -> Viscous:
        """The same term over another step."""
        return Viscous(
            self.body, self.rheology, self.growth, dt=past.dt, before=past.before,
            earlier=past.earlier, last_dt=past.last_dt, cells=self.mask(), name=self.name,
        )  # fmt: skip

    def mask(self) -> np.ndarray | None:
        """The term's cells as a mask (m,); None where it covers all."""
        if len(self.ids) == len(self.body.cells):
            return None
        mask = np.zeros(len(self.body.cells), bool)
        mask[self.ids] = True
        return mask

    def memory(self, u: np.ndarray, e: float) -> Memory | None:
        """What is remembered at the end of the step, u (n, 3); None: not an admissible state."""
        body, past = self.body, self.past
        table, inverse, _ = self._at(e)
        kept = [a.copy() for a in past.before.arrays]
        q, k = body.gradients.shape[1:3]
        size = max(1, CHUNK // q)
        G, F = np.empty((size, q, 3, k)), np.empty((size, q, 3, 3))
        u = np.ascontiguousarray(u, dtype=float)
        for start in range(0, len(self.ids), size):
            ids = self.ids[start : start + size]
            deform(ids, body.cells, body.gradients, u, inverse, G, F)
            after = self.material.after(F[: len(ids)], table[ids])
            if after is None:
                return None
            for array, part in zip(kept, after, strict=True):
                array[ids] = part
        return Memory(*kept)

    def dissipation(self, after: Memory, e: float) -> tuple[np.ndarray, np.ndarray]:
        """Energy taken by each dashpot over the step per grown volume, and the work done on it.

        Both (m, q, dashpots), in stress. Taken: η Δt D : D with D from end to end of the step,
        exact to second order. Work: the stress at the end, ∂(Δt φ)/∂C, times the change of C; with
        backward Euler it is never negative while every C is positive.
        """
        past, shape = self.past, self.body.weights.shape
        _, P, Q = past.tensors()
        inverses = nine(inverse(after.strains)), nine(inverse(past.before.strains))
        stress = P - six(inverses[0] @ nine(Q) @ inverses[0])
        change = after.strains - past.before.strains
        work = (stress * change).sum(-1)
        change = nine(change)
        taken = 2 * np.einsum(
            "...ij,...ji->...", change @ inverses[0], change @ inverses[1], optimize=True
        )
        for j, leaf in enumerate(self.rheology.dashpots):
            k = leaf.viscosity(e, shape, self.body.points) / (8 * past.dt)
            work[:, :, j] *= k
            taken[:, :, j] *= k
        return taken, work

    def integral(self, density: np.ndarray, e: float) -> float:
        """∫ Jg · density dV₀ over the term's cells; density (m, q)."""
        J = self._at(e)[2]
        weights = self.body.weights * J if len(J) else self.body.weights
        return float((weights * density)[self.ids].sum())


def viscous(scene: Scene) -> list[Viscous]:
    """The viscous terms of a scene; raises ValueError if there is none."""
    viscous = [term for term in scene.terms if isinstance(term, Viscous)]
    if not viscous:
        raise ValueError("the scene has no Viscous term; swap an Elastic one for it")
    return viscous


def marked(scene: Scene) -> list:
    """Terms beside the viscous ones that learn from accepted states, such as
    :class:`solver.viscous.seal.Seal`: with a ``history``, ``after(u)`` and ``with_history``."""
    return [term for term in scene.terms if hasattr(term, "with_history")]


def over_step(scene: Scene, pasts: Sequence[Past], marks: Sequence[np.ndarray] = ()) -> Scene:
    """The scene with its viscous terms over the step that starts from their pasts, and those of
    :func:`marked` from their histories, one each."""
    terms = viscous(scene)
    swap = {id(a): a.stepped(past) for a, past in zip(terms, pasts, strict=True)}
    swap |= {id(a): a.with_history(h) for a, h in zip(marked(scene), marks, strict=True)}
    return scene.with_terms([swap.get(id(term), term) for term in scene.terms])


def softened(
    scene: Scene,
    rheology: Rheology,
    *,
    dt: float,
    cells: np.ndarray | None = None,
    term: str = "elastic",
) -> Scene:
    """The scene with the material of its Elastic term ``term`` swapped for a rheology.

    On all cells of the term, or on a mask (m,) of them; the others stay elastic. Growth, supports
    and all other terms stay as they are, and so does the analysed pattern. Raises ValueError if the
    scene has no such term, or the mask none of its cells.
    """
    elastic = [t for t in scene.terms if isinstance(t, Elastic) and t.name == term]
    if not elastic:
        names = ", ".join(t.name for t in scene.terms if isinstance(t, Elastic)) or "none"
        raise ValueError(f"no Elastic term {term!r}; there are: {names}")
    (old,) = elastic
    mine = np.zeros(len(old.body.cells), bool)
    mine[old.ids] = True
    chosen = mine if cells is None else mine & np.asarray(cells)
    rest = mine & ~chosen
    new: list = [Viscous(old.body, rheology, old.growth, dt=dt, cells=chosen)]
    if rest.any():
        new.append(Elastic(old.body, old.material, old.growth, cells=rest, name=term))
    return scene.with_terms([n for t in scene.terms for n in (new if t is old else [t])])
