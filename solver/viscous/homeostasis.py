"""Homeostatic states, in which growth that answers to stress rests, and whether they are stable.

With the displacement in equilibrium at every growth, R(u, γ) = 0, the law is γ̇ = G(u(γ), γ), and a
disturbance of a state obeys

    d(δγ)/dt = (∂G/∂γ − ∂G/∂u K⁻¹ ∂R/∂γ) δγ,      K = ∂R/∂u at fixed γ.

Its eigenvalues say whether the disturbance dies out. That this depends on which way the growth goes
is what Erlich, Moulton and Goriely found of tubes (Are homeostatic states stable? Dynamical
stability in morphoelasticity, Bull. Math. Biol. 81, 2019).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from solver.equilibrium.scene import Scene
from solver.given import number, numbers, one_of
from solver.viscous.evolution import State
from solver.viscous.feedback import Feedback, Growing
from solver.viscous.term import Memory, Past, viscous

# Log stretches of growth, of which a dense matrix is made.
MOST = 3000


class Verdict(Enum):
    """Whether a homeostatic state is stable; the value is a sentence for people."""

    STABLE = "every disturbance of the growth dies out"
    NEUTRAL = "no disturbance of the growth grows, and some stay: such as leave the stress as it is"
    UNSTABLE = "some disturbance of the growth grows"


@dataclass(frozen=True, eq=False)
class Homeostasis:
    """How growth goes on near a state.

    ``rates`` (k,): of its disturbances, 1/time, complex, the fastest growing first; ``modes``
    (k, m, q, directions): their log stretches, complex, the largest 1, and 0 where growth does not
    answer to stress (a rate of 0 in the law), which is left out. ``speed``: largest |γ̇| of the
    state itself, 1/time: it is homeostatic where that is small beside the rates. ``zero``: rates
    below it, 1/time, count as 0.
    """

    rates: np.ndarray
    modes: np.ndarray
    speed: float
    zero: float

    @property
    def verdict(self) -> Verdict:
        """Whether the state is stable."""
        first = self.rates[0].real
        if first > self.zero:
            return Verdict.UNSTABLE
        return Verdict.NEUTRAL if first >= -self.zero else Verdict.STABLE

    def rate(self, field: np.ndarray) -> complex:
        """The rate of that disturbance which is most like a field of log stretches (m, q,
        directions), by the angle between them."""
        flat = self.modes.reshape(len(self.rates), -1)
        field = numbers("the field", field)
        if field.shape != self.modes.shape[1:] or not field.any():
            raise ValueError(
                f"the field has shape {field.shape}; expected {self.modes.shape[1:]}, and not 0"
            )
        alike = np.abs(flat.conj() @ field.ravel()) / np.linalg.norm(flat, axis=1)
        return complex(self.rates[np.argmax(alike)])

    @property
    def neutral(self) -> int:
        """How many disturbances neither grow nor die out."""
        return int((np.abs(self.rates.real) <= self.zero).sum())


def homeostasis(scene: Scene, state: State, *, tolerance: float = 1e-6) -> Homeostasis:
    """The disturbances of the growth at a state of the scene, as best one in which it rests.

    Loads stay what they are at the state's e. Rates within ``tolerance`` of the largest one are 0.
    Raises ValueError unless what remembers in the scene is one Growing term of springs, of whose
    log stretches 1 to 3000 answer to stress (the dense matrix of them is made), and
    :class:`solver.equilibrium.linear.SingularMatrix` where the body itself is unstable in between.
    """
    one_of("state", State, state, "start(scene)")
    terms = viscous(scene)
    if len(terms) > 1 or not isinstance(terms[0], Growing) or terms[0].rheology.dashpots:
        raise ValueError(
            "the rates are those of growth alone; give a scene in which one Growing term of "
            "springs is all that remembers"
        )
    if not number("tolerance", tolerance) > 0:
        raise ValueError(f"tolerance = {tolerance}; expected a ratio > 0, such as 1e-6")
    (term,), (memory,), e = terms, state.level.memories, state.e
    law, (m, q) = term.feedback, term.body.weights.shape
    u, sizes = scene.displacement(state.x, e), law.sizes
    at, rate, free = term.stepped(Past(memory, 1.0)).response(u, memory, e)
    acts = rate != 0
    n = int(acts.sum())
    if not 1 <= n <= MOST:
        raise ValueError(
            f"{n} log stretches of growth answer to stress; expected 1 to {MOST}: take a coarser "
            "mesh, or a rate that is not 0"
        )
    s, slope = at.stress(sizes, law.measure == "eshelby")
    felt = rate[:, :, None, None] * (slope @ at.G[:, None])
    J = np.exp(memory.growth[term.ids] @ sizes).ravel()
    pulled = J[:, None, None, None] * at.pull(sizes)
    pulled *= term.body.weights[term.ids].reshape(-1, 1, 1, 1)
    factor = _resting(scene, term, memory).system(state.x, e).factorise()
    gives = np.stack([factor.solve(v) for v in _along(scene, term, pulled, acts)], axis=1)
    matrix = -_along(scene, term, felt, acts) @ gives
    # At its own point growth also changes the stress at a given deformation.
    local = -rate[:, :, None] * np.einsum("naij,nbij->nab", slope, at.FB)
    point, along = np.nonzero(acts)
    same = point[:, None] == point
    matrix[same] += local[point[:, None], along[:, None], along][same]
    rates, vectors = np.linalg.eig(matrix)
    order = np.argsort(-rates.real, kind="stable")
    vectors = vectors[:, order].T
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=1)[:, None], axis=1)
    modes = np.zeros((n, m * q, law.modes), complex)
    modes[:, term.ids[point // q] * q + point % q, along] = vectors / largest
    zero = tolerance * float(np.abs(rates).max())
    speed = float(np.abs(free + rate * s)[acts].max())
    return Homeostasis(rates[order], modes.reshape(n, m, q, law.modes), speed, zero)


def _resting(scene: Scene, term: Growing, memory: Memory) -> Scene:
    """The scene with its growth held at what is remembered."""
    law = term.feedback
    held = Feedback(0.0, 0.0, fibre=law.fibre, frame=law.frame)
    still = Growing(
        term.body, term.rheology, held, dt=1.0, before=memory, cells=term.mask(), name=term.name
    )
    return scene.with_terms([still if t is term else t for t in scene.terms])


def _along(scene: Scene, term: Growing, stress: np.ndarray, acts: np.ndarray) -> np.ndarray:
    """Those tensors (points, directions, 3, 3) that act as forces T ∂N/∂X on the unknowns, a row
    each."""
    body, q = term.body, term.body.weights.shape[1]
    rows = np.empty((int(acts.sum()), scene.size))
    for row, point, tensor in zip(rows, np.nonzero(acts)[0], stress[acts], strict=True):
        cell = term.ids[point // q]
        force = np.zeros_like(body.nodes)
        force[body.cells[cell]] = body.gradients[cell, point % q] @ tensor.T
        row[:] = scene.pulls(force)
    return rows
