"""Seal: what has touched a ground stays with it, as folds that fuse do.

A contact point that lies within the reach of the ground's barrier at an accepted state is sealed at
its height s₀ there, and from then on carries

    ½ k (s − s₀)²  per reference area,

an adhesive layer of stiffness k that does not tear: under a traction t it opens by t/k. Where the
ground is the mirror plane between two halves of a body, a point and its image have no motion along
the plane relative to each other, so this is all that ties them. At s₀ it has neither energy nor
force: sealing does no work, and the work that opens a seal is its energy.
"""

from __future__ import annotations

import numpy as np

from solver.given import number, one_of
from solver.physics.ground import Ground
from solver.physics.term import Evaluation


class Seal:
    """The seal of a ground's contact points over one step.

    ``stiffness``: k, stress per length. ``history`` (points,): the heights s₀ over the ground's
    floor at which points were sealed, nan for those that are open (None: all). A path in time takes
    :meth:`after` of each accepted state into the next step; see
    :func:`solver.viscous.evolution.march`. Raises ValueError for a stiffness that is not above 0
    and a history of another ground.
    """

    symmetric = True

    def __init__(
        self,
        ground: Ground,
        stiffness: float,
        history: np.ndarray | None = None,
        name: str = "seal",
    ):
        self.ground = one_of("the seal's ground", Ground, ground, "Ground")
        self.stiffness = number("the seal's stiffness", stiffness, above=0)
        self.body, self.graph, self.name = ground.body, ground.graph, name
        points = len(ground.area)
        self.history = np.full(points, np.nan) if history is None else np.asarray(history, float)
        if self.history.shape != (points,):
            raise ValueError(
                f"the history has shape {self.history.shape}; this ground has {points} contact "
                "points: start from Seal(ground, stiffness)"
            )

    @property
    def sealed(self) -> np.ndarray:
        """Which contact points are sealed, (points,)."""
        return ~np.isnan(self.history)

    def after(self, u: np.ndarray) -> np.ndarray:
        """The history after an accepted displacement u (n, 3): points that touch are sealed, too,
        where they are; none opens again."""
        heights = self.ground.distances(u)
        touches = ~self.sealed & (heights < self.ground.range)
        return np.where(touches, heights, self.history)

    def with_history(self, history: np.ndarray) -> Seal:
        """The same seal over another step."""
        return Seal(self.ground, self.stiffness, history, self.name)

    def openings(self, u: np.ndarray) -> np.ndarray:
        """s − s₀ of the sealed points, (points,), 0 at the others; negative where they are pressed
        closer than they were."""
        return np.where(self.sealed, self.ground.distances(u) - self.history, 0.0)

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and blocks on the ground's graph."""
        off, k = self.openings(u), self.stiffness * self.ground.area
        energy = float(k @ off**2) / 2
        if order < 1:
            return Evaluation(energy)
        forces = np.zeros((len(off), 3))
        forces[:, self.ground.axis] = k * off
        force = self.ground.spread(forces)
        if order < 2:
            return Evaluation(energy, force)
        stiffness = np.zeros((len(off), 3, 3))
        stiffness[:, self.ground.axis, self.ground.axis] = k * self.sealed
        return Evaluation(energy, force, self.ground.blocks(stiffness), own=True)
