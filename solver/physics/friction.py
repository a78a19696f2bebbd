"""Friction: Coulomb's law between a body and its ground, step by step.

A path that knows friction remembers where each contact point sticks. Over a step from an accepted
state the normal forces λ of that state are kept (lagged), and with s the distance of a point from
where it sticks

    ψ(s) = μ λ s²/(2 ε)  up to ε,  μ λ (s − ε/2)  beyond,

a potential: force and stiffness are its derivatives. Points slide once they are ε from there, and
where they then stick follows them (:meth:`Friction.moved`). What lags is λ: halve the step to see
what that leaves. Li and others (2020) lag the same, with a smooth ψ of the step's own slip; that
forgets a point's pull after each step, which a quasi-static path must not.
"""

from __future__ import annotations

import numpy as np

from solver.given import number
from solver.physics.ground import Ground
from solver.physics.term import Evaluation


class Friction:
    """Friction of a ground over one step.

    ``coefficient``: μ. ``slip``: ε, how far a point moves before it slides. ``pressing`` (points,):
    λ, and ``stuck`` (points, 2): where the points stick, both from :meth:`at_rest` or
    :meth:`moved`. Raises ValueError for a coefficient or slip that is not above 0.
    """

    symmetric = True

    def __init__(
        self,
        ground: Ground,
        coefficient: float,
        slip: float,
        pressing: np.ndarray,
        stuck: np.ndarray,
        name: str = "friction",
    ):
        self.coefficient = number("the coefficient of friction", coefficient, above=0)
        self.slip = number("the slip of friction", slip, above=0)
        self.ground, self.pressing, self.stuck, self.name = ground, pressing, stuck, name
        self.body, self.graph = ground.body, ground.graph
        self._along = _along(ground)

    @classmethod
    def at_rest(cls, ground: Ground, coefficient: float, slip: float, u: np.ndarray) -> Friction:
        """All points stick where they are at the displacement u (n, 3), without a pull."""
        return cls(ground, coefficient, slip, ground.pressing(u), _places(ground, u))

    def moved(self, u: np.ndarray) -> Friction:
        """For the step from the accepted displacement u (n, 3): pulls stay as they are there, or
        as large as the normal forces at u let them be."""
        places, pressing = _places(self.ground, u), self.ground.pressing(u)
        off, distance = self._off(places)
        allowed = self.coefficient * pressing
        pull = np.minimum(
            self.coefficient * self.pressing * np.minimum(distance / self.slip, 1.0), allowed
        )
        back = self.slip * np.divide(pull, allowed, out=np.zeros_like(pull), where=allowed > 0)
        unit = off / np.maximum(distance, 1e-300)[:, None]
        return Friction(
            self.ground, self.coefficient, self.slip, pressing, places - back[:, None] * unit,
            self.name,
        )  # fmt: skip

    def sliding(self, u: np.ndarray) -> np.ndarray:
        """Which points press and slide at u, (points,)."""
        return (self.pressing > 0) & (self._off(_places(self.ground, u))[1] >= self.slip)

    def _off(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        off = places - self.stuck
        return off, np.linalg.norm(off, axis=1)

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and blocks on the ground's graph."""
        off, s = self._off(_places(self.ground, u))
        most = self.coefficient * self.pressing
        sticks = s < self.slip
        energy = most @ np.where(sticks, s * s / (2 * self.slip), s - self.slip / 2)
        if order < 1:
            return Evaluation(float(energy))
        over = most / np.where(sticks, self.slip, s)  # of ψ′(s)/s
        forces = np.zeros((len(s), 3))
        forces[:, self._along] = over[:, None] * off
        force = self.ground.spread(forces)
        if order < 2:
            return Evaluation(float(energy), force)
        plane = over[:, None, None] * np.eye(2)
        unit = off / np.where(sticks, 1.0, s)[:, None]
        plane -= np.where(sticks, 0.0, over)[:, None, None] * unit[:, :, None] * unit[:, None, :]
        stiffness = np.zeros((len(s), 3, 3))
        stiffness[np.ix_(np.arange(len(s)), self._along, self._along)] = plane
        return Evaluation(float(energy), force, self.ground.blocks(stiffness), own=True)


def _along(ground: Ground) -> list[int]:
    """Axes in the ground's plane."""
    return [k for k in range(3) if k != ground.axis]


def _places(ground: Ground, u: np.ndarray) -> np.ndarray:
    """Where the contact points are along the ground at u, (points, 2)."""
    return ground.at_points((ground.body.nodes + u)[:, _along(ground)])
