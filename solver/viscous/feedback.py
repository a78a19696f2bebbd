"""Growth that answers to stress: an internal variable beside those of the dashpots.

F = Fe Fg with ln Fg = Σ γ_a B_a, B_a orthogonal projectors of the reference configuration: 1
(isotropic volume growth), f⊗f (along a fibre), or e_k⊗e_k (orthotropic). Then Ḟg Fg⁻¹ = Σ γ̇_a B_a,
and the law, Eq. 2.32 with §6.3.1's baseline and feedback, is

    γ̇_a = baseline_a + rate_a (s_a − target_a),      s_a = M : B_a / tr B_a,

with the Mandel stress M = Feᵀ Pe of the intermediate configuration, Pe = ∂ψ/∂Fe; with the Eshelby
measure M − ψ 1 stands in its place, what growth is power-conjugate to. A rate of growth in
proportion to the difference of stress and target is Taber's (Towards a unified theory for
morphomechanics, Phil. Trans. R. Soc. A 367, 2009). With rate > 0 tension beyond the target lets the
body grow; that is stable where growth relieves it, as between clamps, and not where it feeds it, as
under a pressure that stays.

Backward Euler and BDF2 for γ, as for the dashpots, solved at each point on its own, with the
tangent condensed. No potential exists for the Mandel measure, so the stiffness isn't symmetric.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver.given import one_of
from solver.mesh.body import Body
from solver.physics.fields import Points, Quantity, resolve, unit, varies
from solver.physics.kernels import add_stiffness_unsymmetric, deform
from solver.physics.term import Evaluation
from solver.viscous.rheology import Rheology
from solver.viscous.term import Increment, Memory, Past, Viscous

MEASURES = ("mandel", "eshelby")
ITERATIONS = 40
# Farthest that the log stretch of growth moves in one of them.
LONGEST = 0.3


class Feedback:
    """The law. Quantities as in :mod:`solver.physics.fields`, of the load e too where functions.

    ``rate``: growth per time and stress; ``target``: stress; ``baseline``: growth per time, all of
    the logarithm of the stretch. One each, or for orthotropic growth one or three. ``measure``:
    "mandel", or "eshelby" of a rheology without dashpots.
    """

    def __init__(
        self,
        rate: Quantity | Sequence[Quantity],
        target: Quantity | Sequence[Quantity],
        baseline: Quantity | Sequence[Quantity] = 0.0,
        *,
        fibre: Quantity | None = None,
        frame: Quantity | None = None,
        measure: str = "mandel",
    ):
        """``fibre`` (3,), per cell or per point: growth along it alone; ``frame``: orthonormal rows
        (3, 3), per cell or per point: a growth of its own along each; neither: of the volume.

        Raises ValueError for both, another measure, and numbers of quantities that don't fit;
        fields of a wrong shape and frames that are not orthonormal are refused by the term.
        """
        if fibre is not None and frame is not None:
            raise ValueError("fibre and frame were given; growth is along one of them")
        if measure not in MEASURES:
            raise ValueError(f"measure = {measure!r}; expected 'mandel' or 'eshelby'")
        self.fibre, self.frame, self.measure = fibre, frame, measure
        self.modes = 1 if frame is None else 3
        self.rate, self.target, self.baseline = (
            self._each(name, value)
            for name, value in (("rate", rate), ("target", target), ("baseline", baseline))
        )

    def _each(self, name: str, value) -> tuple[Quantity, ...]:
        """One quantity per mode."""
        several = tuple(value) if isinstance(value, list | tuple) else (value,) * self.modes
        if len(several) != self.modes:
            raise ValueError(
                f"{len(several)} values of {name}; expected {self.modes}: one for each direction "
                "in which growth has a law of its own"
            )
        return several

    @property
    def moving(self) -> bool:
        """Whether a quantity is a function."""
        given = (*self.rate, *self.target, *self.baseline, self.fibre, self.frame)
        return any(varies(value) for value in given)

    @property
    def sizes(self) -> np.ndarray:
        """tr B_a, (modes,): 3 for growth of the volume, 1 along a direction."""
        return np.full(self.modes, 3.0 if self.fibre is None and self.frame is None else 1.0)

    def projectors(self, e: float, shape: tuple[int, int], points: Points | None = None):
        """B_a, (1 | m, 1 | q, modes, 3, 3)."""
        if self.frame is not None:
            rows = resolve("the growth's frame", self.frame, e, shape, points, (3, 3))
            off = np.abs(rows @ np.swapaxes(rows, -1, -2) - np.eye(3)).max()
            if off > 1e-9:
                raise ValueError(
                    f"the growth's frame is not orthonormal (off by {off:.1e}); normalise its rows"
                )
        elif self.fibre is not None:
            rows = resolve("the growth's fibre", self.fibre, e, shape, points, (3,))
            rows = unit("the growth's fibre", rows)[..., None, :]
        else:
            return np.eye(3)[None, None, None]
        return rows[..., :, None] * rows[..., None, :]

    def quantities(self, e: float, shape: tuple[int, int], points: Points | None = None):
        """rate, target and baseline at the points, (1 | m, 1 | q, modes) each."""
        return tuple(
            np.stack(
                np.broadcast_arrays(*(resolve(name, v, e, shape, points) for v in values)), axis=-1
            )
            for name, values in (
                ("the growth's rate", self.rate),
                ("its target", self.target),
                ("its baseline", self.baseline),
            )
        )


def shrunk(gamma: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Fg⁻¹ = 1 + Σ (exp(−γ_a) − 1) B_a, (..., 3, 3), of γ (..., modes)."""
    return np.eye(3) + np.einsum("...a,...aij->...ij", np.expm1(-gamma), B)


class Response:
    """What a material answers at growth γ: arrays over n points flat."""

    def __init__(self, F, B, gamma, psi, P, A):
        self.G = shrunk(gamma, B)
        self.Fe, self.psi, self.P = F @ self.G, psi, P
        self.A = A.reshape(len(F), 9, 9)
        # Along each mode dFe/dγ_a = −Fe B_a.
        self.FB, self.PB = self.Fe[:, None] @ B, P[:, None] @ B
        flat = self.FB.reshape(len(F), -1, 9)
        self.AFB = (flat @ self.A).reshape(self.FB.shape)

    def stress(self, sizes: np.ndarray, eshelby: bool) -> tuple[np.ndarray, np.ndarray]:
        """s_a (n, modes) and ∂s_a/∂Fe (n, modes, 3, 3)."""
        s = np.einsum("naij,nij->na", self.FB, self.P) / sizes
        slope = (self.PB + self.AFB) / sizes[:, None, None]
        if eshelby:
            s = s - self.psi[:, None]
            slope = slope - self.P[:, None]
        return s, slope

    def pull(self, sizes: np.ndarray) -> np.ndarray:
        """∂P̂/∂γ_a (n, modes, 3, 3) of the nominal stress P̂ = Jg P Fg⁻ᵀ, over Jg."""
        return (sizes[:, None, None] * self.P[:, None] - self.AFB - self.PB) @ self.G[:, None]


class Grown:
    """A step of a material that grows by the law, as a material of F: kernel and table.

    ψ̂ = Jg ψ(F Fg⁻¹) per reference volume; P̂ = Jg Pe Fg⁻ᵀ and its derivative with γ(F) solved for.
    """

    def __init__(self, inner: Increment, law: Feedback, past: Past):
        self.inner, self.law, self.past = inner, law, past

    @property
    def moving(self) -> bool:
        """Whether anything is a function of e."""
        return self.inner.moving or self.law.moving

    def properties(self, e: float, shape: tuple[int, int], points: Points | None = None):
        """(m, q, numbers): the law's rate, its γ̇ without stress, what γ starts from, B; and the
        inner material's own."""
        rate, target, baseline = self.law.quantities(e, shape, points)
        a1, a2 = self.past.weights()
        before = a1 * self.past.before.growth
        if self.past.earlier is not None:
            before = before + a2 * self.past.earlier.growth
        B = self.law.projectors(e, shape, points)
        parts = [rate, baseline - rate * target, before / (a1 + a2), B.reshape(*B.shape[:2], -1)]
        parts.append(self.inner.properties(e, shape, points))
        whole = [np.broadcast_to(p, (*shape, p.shape[-1])) for p in parts]
        return np.ascontiguousarray(np.concatenate(whole, axis=-1))

    def split(self, table: np.ndarray):
        """rate, free rate and start (n, modes) each, B (n, modes, 3, 3), the inner table."""
        n = self.law.modes
        flat = table.reshape(-1, table.shape[-1])
        rate, free, start = (flat[:, k * n : (k + 1) * n] for k in range(3))
        B = flat[:, 3 * n : 12 * n].reshape(-1, n, 3, 3)
        return rate, free, start, B, np.ascontiguousarray(table[..., 12 * n :])

    def respond(self, F, gamma, B, table, order=2) -> Response | None:
        """The inner material at F (c, q, 3, 3) and γ (c q, modes); None: not admissible."""
        c, q = F.shape[:2]
        psi, P, A = np.empty((c, q)), np.empty((c, q, 3, 3)), np.zeros((c, q, 3, 3, 3, 3))
        flat = np.reshape(F, (-1, 3, 3))
        Fe = np.ascontiguousarray((flat @ shrunk(gamma, B)).reshape(F.shape))
        if not (np.isfinite(Fe).all() and self.inner.kernel(Fe, table, order, psi, P, A)):
            return None
        return Response(flat, B, gamma, psi.ravel(), P.reshape(-1, 3, 3), A)

    def solve(self, F, table) -> tuple[np.ndarray, Response, np.ndarray] | None:
        """γ at the end of the step (c q, modes), the response there and ∂γ/∂F (c q, modes, 3, 3).

        None for a state that is not admissible, or a point whose own Newton did not end.
        """
        table = np.broadcast_to(table, (*F.shape[:2], table.shape[-1]))
        rate, free, gamma, B, inner = self.split(table)
        start, sizes, eshelby = gamma, self.law.sizes, self.law.measure == "eshelby"
        speed = sum(self.past.weights()) / self.past.dt
        near = False
        for _ in range(ITERATIONS):
            at = self.respond(F, gamma, B, inner)
            if at is None:
                return None
            s, slope = at.stress(sizes, eshelby)
            left = speed * (gamma - start) - free - rate * s
            J = rate[:, :, None] * np.einsum("naij,nbij->nab", slope, at.FB)
            J[:, range(len(sizes)), range(len(sizes))] += speed
            # The derivative is that of the last iterate, and the step to it is quadratic.
            if near:
                if not (np.linalg.eigvals(J).real > 0).all():
                    # Growth that feeds itself, over too long a step: another root.
                    return None
                slopes = rate[:, :, None, None] * (slope @ at.G[:, None])
                dF = np.linalg.solve(J, slopes.reshape(*slopes.shape[:2], 9))
                return gamma, at, dF.reshape(slopes.shape)
            try:
                d = -np.linalg.solve(J, left[..., None])[..., 0]
            except np.linalg.LinAlgError:
                return None
            size = np.abs(d).max()
            if not np.isfinite(size):
                return None
            most = np.abs(d).max(axis=1, keepdims=True)
            gamma = gamma + d * np.minimum(1.0, LONGEST / np.maximum(most, 1e-300))
            near = size < 1e-9
        return None

    def kernel(self, F, table, order, psi, P, A) -> bool:
        """As a material's kernel; False for a state that is not admissible."""
        solved = self.solve(F, table)
        if solved is None:
            return False
        gamma, at, dF = solved
        c, sizes = len(F), self.law.sizes
        Jg = np.exp(gamma @ sizes)
        psi[:c] = (Jg * at.psi).reshape(F.shape[:2])
        if order >= 1:
            P[:c] = (Jg[:, None, None] * at.P @ at.G).reshape(F.shape)
        if order >= 2:
            D = at.A.reshape(-1, 3, 3, 3, 3) @ at.G[:, None, None]
            D = np.einsum("niMkL,nMJ->niJkL", D, at.G, optimize=True)
            D += np.einsum("naiJ,nakL->niJkL", at.pull(sizes), dF, optimize=True)
            A[:c] = (Jg[:, None, None, None, None] * D).reshape(*F.shape, 3, 3)
        return True

    def after(self, F: np.ndarray, table: np.ndarray):
        """Strains and joints of the dashpots as the inner material has them, and γ (c, q, modes);
        None: not admissible."""
        solved = self.solve(F, table)
        if solved is None:
            return None
        gamma, at, _ = solved
        inner = np.broadcast_to(table, (*F.shape[:2], table.shape[-1]))[..., 12 * self.law.modes :]
        kept = self.inner.after(
            np.ascontiguousarray(at.Fe.reshape(F.shape)), np.ascontiguousarray(inner)
        )
        return None if kept is None else (*kept, gamma.reshape(*F.shape[:2], -1))


class Growing(Viscous):
    """A body that grows by the law while it deforms: ``Spring(E, nu)`` for an elastic one, or any
    rheology, whose F is then Fe = F Fg⁻¹.

    As :class:`solver.viscous.term.Viscous` over one step, in the same evolution; its memory holds
    γ too. It has no energy that a line search could follow (``Evaluation.energy`` is None).
    """

    symmetric = False

    def __init__(
        self,
        body: Body,
        rheology: Rheology,
        feedback: Feedback,
        *,
        dt: float,
        before: Memory | None = None,
        earlier: Memory | None = None,
        last_dt: float | None = None,
        cells: np.ndarray | None = None,
        name: str = "growing",
    ):
        """Raises ValueError as :class:`Viscous` does, and for Eshelby's measure of a rheology with
        dashpots, whose stored energy a step does not tell."""
        self.feedback = one_of("feedback", Feedback, feedback, "Feedback(rate, target)")
        one_of("rheology", Rheology, rheology, "Spring(E, nu)")
        if feedback.measure == "eshelby" and rheology.dashpots:
            raise ValueError(
                "Eshelby's measure is of the stored energy, and the rheology has dashpots; take "
                "measure='mandel'"
            )
        super().__init__(
            body, rheology, dt=dt, before=before, earlier=earlier, last_dt=last_dt, cells=cells,
            name=name,
        )  # fmt: skip
        self._add_stiffness = add_stiffness_unsymmetric

    def _rest(self, body: Body, rheology: Rheology) -> Memory:
        plain = super()._rest(body, rheology)
        growth = np.zeros((*body.weights.shape, self.feedback.modes))
        return Memory(plain.strains, plain.joints, growth)

    def _increment(self, rheology: Rheology, past: Past) -> Grown:
        return Grown(Increment(rheology, past), self.feedback, past)

    def stepped(self, past: Past) -> Growing:
        """The same term over another step."""
        return Growing(
            self.body, self.rheology, self.feedback, dt=past.dt, before=past.before,
            earlier=past.earlier, last_dt=past.last_dt, cells=self.mask(), name=self.name,
        )  # fmt: skip

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Force and stiffness as of an Elastic term; no energy, but inf where not admissible."""
        at = super().evaluate(u, e, order)
        if at.energy == np.inf:
            return at
        return Evaluation(None, at.force, at.stiffness, own=at.own)

    def grown(self, u: np.ndarray, e: float) -> np.ndarray:
        """Fg (m, q, 3, 3) at the end of the step, 1 off the term's cells; ValueError for a state
        that is not admissible."""
        after = self.memory(u, e)
        if after is None:
            raise ValueError(f"term {self.name!r} does not admit this state; give a converged one")
        shape = self.body.weights.shape
        B = self.feedback.projectors(e, shape, self.body.points)
        return shrunk(-after.growth, np.broadcast_to(B, (*shape, *B.shape[2:])))

    def shortest_time(self, e: float) -> float:
        """Shortest time of the rheology, and of growth that relieves a stretch, 1/(rate E)."""
        shape, points = self.body.weights.shape, self.body.points
        rate = np.abs(self.feedback.quantities(e, shape, points)[0])
        E = sum(resolve("E", leaf.E, e, shape, points) for leaf in self.rheology.springs)
        most = float((rate * np.asarray(E)[..., None]).max())
        return min(super().shortest_time(e), 1 / most if most > 0 else np.inf)

    def dissipation(self, after: Memory, e: float) -> tuple[np.ndarray, np.ndarray]:
        """Of the dashpots, as :class:`Viscous` tells it, but per reference volume: the volume that
        they fill is the mean of that before the step and after it."""
        J = [np.exp(m.growth @ self.feedback.sizes) for m in (self.past.before, after)]
        mean = ((J[0] + J[1]) / 2)[..., None]
        taken, work = super().dissipation(after, e)
        return mean * taken, mean * work

    def ledger(self, u: np.ndarray, after: Memory, e: float) -> tuple[np.ndarray, np.ndarray]:
        """At the end of the step: stored energy Jg ψ (m, q) and the stress Jg (M − ψ 1) : B_a
        (m, q, modes) that growth is power-conjugate to, per reference volume; 0 off the term.

        What growth takes is ∫ Jg (M − ψ 1) : Ḟg Fg⁻¹ dV₀; it is negative where growth drives.
        """
        shape = self.body.weights.shape
        at, _, _ = self.response(u, after, e)
        psi = at.psi.reshape(-1, shape[1])
        if self.rheology.dashpots:
            # A step too short for the dashpots tells what the springs hold; a shorter one roundoff.
            frozen = Increment(self.rheology, Past(after, 1e-7 * super().shortest_time(e)))
            held = frozen.properties(e, shape, self.body.points)[self.ids]
            Fe = np.ascontiguousarray(at.Fe.reshape(*psi.shape, 3, 3))
            none = np.empty((1, shape[1], 3, 3, 3, 3))
            frozen.kernel(Fe, held, 0, psi, np.empty(Fe.shape), none)
        J = np.exp(after.growth[self.ids] @ self.feedback.sizes)
        M = np.einsum("naij,nij->na", at.FB, at.P).reshape(*psi.shape, -1)
        stored, driving = np.zeros(shape), np.zeros((*shape, self.feedback.modes))
        stored[self.ids] = J * psi
        driving[self.ids] = J[..., None] * (M - psi[..., None] * self.feedback.sizes)
        return stored, driving

    def response(self, u: np.ndarray, memory: Memory, e: float):
        """At u with the growth of a memory: what the material answers at all the term's points in
        turn, and the law's rate and γ̇ without stress there, (points, modes).

        Raises ValueError for a state that is not admissible.
        """
        body, (c, q) = self.body, (len(self.ids), self.body.weights.shape[1])
        G, F = np.empty((c, q, 3, body.cells.shape[1])), np.empty((c, q, 3, 3))
        none = np.empty((0, 1, 3, 3))
        deform(self.ids, body.cells, body.gradients, np.ascontiguousarray(u, float), none, G, F)
        rate, free, _, B, inner = self.material.split(self._at(e)[0][self.ids])
        gamma = memory.growth[self.ids].reshape(-1, self.feedback.modes)
        at = self.material.respond(F, gamma, B, inner)
        if at is None:
            raise ValueError(f"term {self.name!r} does not admit this state; give a converged one")
        return at, rate, free
