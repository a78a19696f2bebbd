"""The furrow that is fitted: its settings, how it is seen, and patterns of other models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foldlab.errors import InputError
from solver.cases.tissue import furrow
from solver.cases.tissue.pattern import POWER, Free, Profile, outside, places
from solver.fitting.elastic import Equilibria, Unreached
from solver.fitting.targets import Cloud


@dataclass(frozen=True)
class Config:
    """``mesh``, ``finer``: element:level of the fit and of one shape that it sees; ``points`` of a
    cloud; ``noise``: standard deviation of each coordinate over the largest displacement;
    ``strength``, ``angle`` (rad), ``reach`` (half lengths): the true pattern; ``bend``: standard
    deviation of second differences of a free field beforehand; ``around`` (rad), ``along`` (half
    lengths): its knots; ``level`` of the bands; ``steps`` of a viscoelastic furrow in the second in
    which it contracts, ``creeping``: its mesh, ``times`` (s) at which it is seen, ``creeps``: draws
    of it. ``shape``: a CSV or VTU with the outer side of a furrow of your own, whole or in part,
    to be fitted instead of all that; ``sigma``: standard deviation of its coordinates in half
    lengths."""

    seed: int = 0
    mesh: str = "hex20:1"
    finer: str = "hex20:2"
    points: int = 1000
    noise: float = 0.01
    draws: int = 20
    strength: float = 0.8
    angle: float = 0.35
    reach: float = 0.7
    bend: float = 0.3
    around: tuple[float, ...] = (0.0, 0.2, 0.4, 0.8)
    along: tuple[float, ...] = (0.0, 0.4, 0.8)
    level: float = 0.95
    steps: int = 20
    creeping: str = "hex20:0"
    times: tuple[float, ...] = (0.5, 1.0, 1.5)
    creeps: int = 5
    shape: str = ""
    sigma: float = 0.0


@dataclass(frozen=True, eq=False)
class Bench:
    """A model, how its outer side is seen, and the true pattern."""

    config: Config
    model: furrow.Furrow

    @classmethod
    def of(cls, config: Config, mesh: str) -> Bench:
        """Raises InputError for a mesh that isn't there, and for numbers that make no sense."""
        for name in ("points", "draws", "creeps", "steps", "noise", "bend"):
            if not getattr(config, name) > 0:
                raise InputError(f"{name} = {getattr(config, name)}; expected more than 0")
        if not 0 < config.level < 1:
            raise InputError(f"level = {config.level}; expected between 0 and 1, such as 0.95")
        element, _, level = mesh.partition(":")
        if not level.isdigit():
            raise InputError(f"mesh {mesh!r}; expected element:level, such as hex20:1")
        try:
            Free(config.around, config.along)
            return cls(config, furrow.build(int(level), element=element))
        except ValueError as error:
            raise InputError(str(error)) from error

    @property
    def true(self) -> np.ndarray:
        """Parameters of the true profile, (3,)."""
        return np.array([self.config.strength, self.config.angle, self.config.reach])

    @property
    def free(self) -> Free:
        """The free field."""
        return Free(self.config.around, self.config.along)

    def seen(self, field, p, material=None) -> np.ndarray:
        """The displacement (n, 3) of an elastic body of a pattern."""
        material = material or self.model.tissue.slow()
        found = Equilibria(self.model.elastic(material), field).solve(p, [1.0])
        if isinstance(found, Unreached):
            raise InputError(f"the true pattern leads to no state: {found.why}")
        (state,) = found.at
        return state.u

    def cloud(self, u: np.ndarray, sigma: float, rng, of: Bench | None = None) -> Cloud:
        """Noisy points on the outer side of a body (of another mesh) displaced by u, as this model
        would be held against them."""
        shown = (of or self).model.body
        points = outside(shown).scattered(shown.nodes + u, self.config.points, rng)
        points += sigma * rng.standard_normal(points.shape)
        return Cloud(outside(self.model.body), points, sigma, mirrors=(0, 1))

    def places(self) -> np.ndarray:
        """Where β is compared: the nodes of the outer side, (p, 3)."""
        X = self.model.body.nodes
        return X[furrow.Shape().depth(X) > 1 - 1e-6]


class Basal(Profile):
    """The same pattern on the inner side of the shell."""

    def values(self, p, X):
        around, along, depth = places(self.shape, X)
        return p[0] * np.exp(-((around / p[1]) ** 2) - (along / p[2]) ** 4) * (1 - depth) ** POWER


class Stripes(Profile):
    """Contraction in two stripes beside the midline."""

    def values(self, p, X):
        around, along, depth = places(self.shape, X)
        form = np.exp(-(((around - 0.4) / 0.2) ** 2) - (along / p[2]) ** 4)
        return p[0] * form * depth**POWER
