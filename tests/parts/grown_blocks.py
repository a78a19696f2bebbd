"""A block that contracts by a field with two or three parameters, for the tests of fits."""

from dataclasses import dataclass

import numpy as np
from proofs import BODIES

from solver.equilibrium.scene import Scene
from solver.physics.elastic import Elastic
from solver.physics.growth import Apical
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed


@dataclass(frozen=True)
class Slope:
    """β = a + b x y + c z², c only where ``curved``."""

    curved: bool = False

    @property
    def names(self):
        return ("a", "b", "c")[: 2 + self.curved]

    @property
    def low(self):
        return np.array([0.1, -0.2, -0.2])[: 2 + self.curved]

    @property
    def high(self):
        return np.array([0.9, 0.4, 0.2])[: 2 + self.curved]

    def slopes(self, p, X):
        parts = [np.ones(X.shape[:-1]), X[..., 0] * X[..., 1], X[..., 2] ** 2]
        return np.stack(parts[: len(p)], axis=-1)

    def values(self, p, X):
        return self.slopes(p, X) @ p


def clamped(element="hex8", material=None, contraction=0.6, body=None) -> Scene:
    """The block, or another body, held at z = 0."""
    body = body or BODIES[element]
    below = np.flatnonzero(body.nodes[:, 2] < 1e-9)
    growth = Apical(lambda e: -contraction * e, np.full(body.weights.shape, 0.5))
    term = Elastic(body, material or NeoHookean(1.0, 0.3), growth)
    return Scene(body, [term], fixed=[Fixed(below, axis) for axis in np.eye(3)])
