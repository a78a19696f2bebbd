"""States of a viscoelastic body in time for the parameters of its contraction, and their slopes.

A step R(x, β, C) = 0 sees the memory C of those before it, and leaves one of its own, C' = M(x, β,
C). Derivatives go along with the steps (tangent-linear model):

    dx/dp = −K⁻¹ (∂R/∂β β' + ∂R/∂C dC/dp),    dC'/dp = ∂M/∂x dx/dp + ∂M/∂β β' + ∂M/∂C dC/dp,

with the partial ones as central differences of the step beside itself, as of the folding unit
(:mod:`solver.cases.unit.sensitivity`): the dashpots' inner iteration is differentiated with them.
They are those of the scheme with the steps that it took. The cost is that of a few evaluations per
step and parameter; an adjoint, which has to run through the steps backwards, is not here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from solver.equilibrium.scene import Scene
from solver.fitting.elastic import States, Unreached, increasing
from solver.fitting.field import Field, contracted, contracting, refused
from solver.given import numbers
from solver.paths.sensitivity import Sensitivity
from solver.physics.fields import Unphysical
from solver.physics.growth import General
from solver.viscous.evolution import State, TimeSteps, march, start, stepped
from solver.viscous.term import Memory, Past, Viscous, viscous

CHANGE = 1e-5  # of β and of the dashpots' C between a step and those beside it


@dataclass(frozen=True, eq=False)
class Course:
    """A path in time, all its steps, and how β changes with p at the points (m, q, k)."""

    scene: Scene
    states: tuple[State, ...]
    slopes: np.ndarray

    @cached_property
    def rates(self) -> tuple[np.ndarray, ...]:
        """du/dp (n, 3, k) of each state."""
        first = self.states[0]
        k, (memory,) = self.slopes.shape[-1], first.level.memories
        rates = [np.zeros((*self.scene.body.nodes.shape, k))]
        still = [np.zeros((k, *a.shape)) for a in memory.arrays]
        changes = [still, still]  # dC/dp of the latest memories, the last one first
        for before, after in pairwise(self.states):
            du, change = self._step(before, after, changes)
            rates.append(du)
            changes = [change, changes[0]]
        return tuple(rates)

    def _step(self, before: State, after: State, changes):
        now, e = stepped(self.scene, before, after), after.e
        term, u = contracting(now.terms), now.displacement(after.x, after.e)
        beside = [self._beside(term, e, j, changes) for j in range(self.slopes.shape[-1])]
        force = np.stack([
            (high.evaluate(u, e, 1).force - low.evaluate(u, e, 1).force) / (2 * h)
            for low, high, h in beside
        ], axis=-1)  # fmt: skip
        rates = Sensitivity(now, now.system(after.x, e)).rate(force)
        du = np.stack([now.step_displacement(dx) for dx in rates.T], axis=-1)
        change = []
        for (low, high, h), d in zip(beside, np.moveaxis(du, -1, 0), strict=True):
            pair = high.memory(u + h * d, e).arrays, low.memory(u - h * d, e).arrays
            change.append([(a - b) / (2 * h) for a, b in zip(*pair, strict=True)])
        return du, [np.stack(arrays) for arrays in zip(*change, strict=True)]

    def _beside(self, term: Viscous, e: float, j: int, changes) -> tuple[Viscous, Viscous, float]:
        """The step with parameter j changed by h to either side, and h."""
        past, growth, slope = term.past, term.growth, self.slopes[..., j]
        sizes = [np.abs(slope).max(), *(np.abs(d[j]).max(initial=0.0) for d in changes[0])]
        h = CHANGE / max(*sizes, 1e-300)
        g, rest = growth.parts(e, term.body.weights.shape, term.body.points)
        both = []
        for s in (-h, h):
            # General takes values of β a little beyond its bounds.
            Fg = (1 / (rest - g * s * slope))[..., None, None] * np.eye(3)
            memory = _moved(past.before, changes[0], s, j)
            earlier = None if past.earlier is None else _moved(past.earlier, changes[1], s, j)
            one = term.stepped(Past(memory, past.dt, earlier, past.last_dt))
            both.append(one.with_growth(General(Fg, cells=growth.cells)))
        return *both, h


def _moved(memory: Memory, change, s: float, j: int) -> Memory:
    return Memory(*(a + s * d[j] for a, d in zip(memory.arrays, change, strict=True)))


@dataclass(frozen=True, eq=False)
class Instant:
    """A state at the time ``e``: its displacement u (n, 3) and du/dp."""

    e: float
    u: np.ndarray
    course: Course
    index: int

    @property
    def rates(self) -> np.ndarray:
        """du/dp, (n, 3, k)."""
        return self.course.rates[self.index]


class Creep:
    """States of a body at times, for the parameters of its β.

    ``scene``: its one viscous term grows by Apical(g, beta); β is taken from ``field`` instead.
    ``stepper``: of fixed steps, so that the same ones lead to all parameters. ``load``: e of time.

    Raises ValueError for a scene with another growth or more that remembers, and for a stepper with
    a tolerance.
    """

    def __init__(
        self, scene: Scene, field: Field, stepper: TimeSteps, load: Callable[[float], float]
    ):
        self._term = contracting(scene.terms)
        if viscous(scene) != [self._term]:
            raise ValueError("more than what contracts remembers; give a scene with one such term")
        if stepper.tolerance is not None:
            raise ValueError(
                f"tolerance = {stepper.tolerance:g}: steps that change with the parameters make a "
                "shape jump; give a step and no tolerance"
            )
        self.scene, self.field, self.stepper, self.load = scene, field, stepper, load
        self.points = scene.body.points()

    def solve(
        self, p: np.ndarray, at: Sequence[float], near: States | None = None
    ) -> States | Unreached:
        """The states at the times ``at`` (increasing, > 0) for parameters p (k,), from rest; a step
        ends on each. ``near`` is no help here."""
        p, times = numbers("parameters", p), increasing("times", at)
        beta = self.field.values(p, self.points)
        if why := refused(beta):
            return Unreached(why, 0.0)
        scene = contracted(self.scene, self._term, beta)
        states, ends = [start(scene, e=self.load(0.0))], []
        for t in times:
            walk = march(scene, states[-1], self.stepper, until=t, load=self.load)
            try:
                while states[-1].t < t:
                    states.append(next(walk))
            except StopIteration as stop:
                outcome, detail = stop.value
                why = f"{outcome.value}; {detail}" if detail else outcome.value
                return Unreached(why, states[-1].t)
            except Unphysical as error:
                return Unreached(str(error), states[-1].t)
            ends.append(len(states) - 1)
        course = Course(scene, tuple(states), self.field.slopes(p, self.points))
        found = []
        for t, index in zip(times, ends, strict=True):
            u = scene.displacement(states[index].x, states[index].e)
            found.append(Instant(t, u, course, index))
        return States(p, tuple(found))
