"""The stable path of a folding unit: what it does as its active layer contracts.

The symmetric quarter is followed first. At each accepted point its stability is judged in all four
symmetry classes: even or odd about each mirror plane, on the same mesh under other supports. Where
a class is lost, the path goes on with the remaining mirror planes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cache

import numpy as np

from solver.cases.unit.choices import Meshing, Physics, Watch
from solver.cases.unit.model import Model, build, foot, uneven
from solver.cases.unit.symmetry import CLASSES, Check, Symmetries, own_check
from solver.equilibrium.clock import OutOfTime
from solver.equilibrium.descent import descend
from solver.equilibrium.newton import newton
from solver.paths.noise import Noise
from solver.paths.point import Ended, Point
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps
from solver.physics.ground import Ground

LONGEST = 0.2  # step of e, however little Timoshenko expects the hinge to turn
EASY = 2.0  # usual steps that one may grow to where Newton's method has an easy time
BISECTIONS = 5  # of a step in which several classes are lost
PATIENCE = 2  # steps on in an unstable symmetry from which the fall out of it is tried again
SWAY = 0.05  # root mean square of |Δu| in l_s that an arc-length step may move the unit by


class Ending(Enum):
    """Why a path ended where it did."""

    REACHED = "the full contraction was reached on a stable path"
    STOPPED = "the path was stopped at a state that was asked for"
    TIMEOUT = "the time allowed was used up"
    TOO_LONG = "the steps allowed were used up"
    LOST = "no stable equilibrium was found beyond the last point"
    APART = (
        "the panels' contact is known in the mirror plane between them, and the unit lost that "
        "symmetry"
    )
    NO_REST = "the flat unit came to no rest on the ground"


@dataclass(frozen=True, eq=False)
class State:
    """An accepted point: ``e``, curves (4, 1000, 3), checks, heights in l_s, energy.

    ``clearance``: of the panels from each other's mirror plane, None where they may not touch.
    """

    e: float
    curves: np.ndarray = field(repr=False)
    checks: tuple[Check, ...]
    lowest: float | None
    tip: float | None
    energy: float | None
    iterations: int
    unknowns: int
    clearance: float | None = None

    @property
    def unstable(self) -> int | None:
        """Elastically unstable modes in all classes; None if they could not be counted."""
        counts = [c.held for c in self.checks]
        return None if None in counts else sum(counts)

    @property
    def topples(self) -> bool:
        """Whether the unit, elastically stable or not, would tip over if let go."""
        return any((c.free or 0) > (c.held or 0) for c in self.checks)


@dataclass(frozen=True)
class Happening:
    """``kind``: snap, toppling, the class of a loss of symmetry, or bifurcation where no class can
    be told; ``e`` of the state after it; ``size`` of a jump, max|Δu| in l_s."""

    kind: str
    e: float
    size: float = 0.0


@dataclass(frozen=True, eq=False)
class Folding:
    """States along the path, what happened, and why it ended; the model and unknowns it ended in.

    ``detail``: the solver's own sentence where it failed.
    """

    states: tuple[State, ...]
    happenings: tuple[Happening, ...]
    ending: Ending
    detail: str
    model: Model
    x: np.ndarray | None
    iterations: int
    seconds: float
    before: tuple[Model, np.ndarray] | None = None  # of the last state but one

    @property
    def last(self) -> State:
        """The last accepted state; raises ValueError where there is none."""
        if not self.states:
            raise ValueError(f"the path has no states: {self.detail}")
        return self.states[-1]


def fold(
    model: Model,
    start: np.ndarray | None = None,
    *,
    rtol: float = 1e-6,
    turn: float = 0.5,
    stop: Callable[[State], bool] | None = None,
    noise: tuple[float, int] | None = None,
    arc: bool = False,
    on_state: Callable[[Model, np.ndarray, State], None] | None = None,
    max_states: int = 400,
) -> Folding:
    """Follow the stable path from e = 0, at rest, to e = 1.

    ``start``: unknowns to begin with, zeros if None. ``rtol``: see
    :func:`solver.equilibrium.newton.newton`. ``turn``: rad that the fold should turn by in a step,
    by Timoshenko. ``stop``: asked at each state. ``noise``: amplitude and seed of §4.3.3, of the
    guesses and of each cell's density, anew in each step, on a whole model instead of the tests of
    symmetry; on load steps or, with ``arc``, on arc length, which takes longer. ``on_state`` sees
    each state as it is accepted, with its model and unknowns.

    Raises ValueError for ``arc`` without noise.
    """
    if arc and noise is None:
        raise ValueError(
            "arc=True without noise; arc length is for noisy paths: give "
            "noise=(amplitude, seed), or leave arc out"
        )
    walk = _Walk(model, rtol, turn, stop, noise, arc, on_state, max_states)
    return walk.run(np.zeros(model.scene.size) if start is None else start)


def carried(
    model: Model,
    x: np.ndarray,
    e: float,
    *,
    meshing: Meshing | None = None,
    physics: Physics | None = None,
    watch: Watch | None = None,
) -> tuple[Model, np.ndarray]:
    """Another model of the same unit, and a state of this one on it as its unknowns.

    What is None is this model's own, as its supports are.
    """
    u = model.scene.displacement(x, e)

    @cache
    def mapped(body):
        return model.body.interpolation(body.nodes) @ u

    other = build(
        model.unit,
        meshing or model.meshing,
        physics or model.physics,
        model.supports,
        watch=watch or model.watch,
        about=mapped,
    )
    start = mapped(other.body).copy()
    if isinstance(other.ground, Ground):
        # Between this mesh's contact points the sheet may lie below the floor.
        low = other.ground.gaps(start).min() + 0.9 * other.ground.depth
        start[:, 2] += max(0.0, -low)
    if other.contact is not None:
        gaps = other.body.nodes[:, 1] + start[:, 1]
        panels = other.body.nodes[:, 1] > other.unit.hinge_length / 2
        low = panels & (gaps < -0.9 * other.contact.depth)
        start[low, 1] -= gaps[low] + 0.9 * other.contact.depth
    return other, other.scene.unknowns(start)


def refined(
    folding: Folding,
    level: int,
    *,
    earlier: bool = False,
    rtol: float = 1e-6,
    deadline: float | None = None,
    thorough: bool = True,
) -> Folding | None:
    """The last state (``earlier``: the one before it) on another mesh: one equilibrium, no path.

    None where the body went elsewhere (a curve by more than a tenth of the sheet), or reached no
    stable state nearby: then the path itself must be followed there. ``deadline``: as in
    :class:`solver.cases.unit.choices.Watch`. ``thorough``: whether the energy falls to a stable
    state where half as many iterations of Newton's method don't lead to one.
    """
    begun = time.monotonic()
    model, x, last = folding.model, folding.x, folding.last
    if earlier:
        (model, x), last = folding.before, folding.states[-2]
    meshing = replace(model.meshing, body=None, level=level)
    watch = replace(model.watch, deadline=deadline)
    try:
        fine, x = carried(model, x, last.e, meshing=meshing, watch=watch)
        most = 25 if thorough else 12
        result = newton(fine.scene, x, last.e, rtol=rtol, max_iterations=most, unstable=0)
        spent = result.iterations
        stable = result.converged and result.system.unstable == 0
        if not stable and not thorough:
            return None
        if not stable:
            result = descend(fine.scene, x, last.e, rtol=rtol, reach=0.02, max_iterations=100)
            spent += result.iterations
        if not result.converged:
            return None
        checks = Symmetries(fine).check(result.x, last.e)
    except OutOfTime:
        return None
    state = _state(
        fine, result.x, last.e, result.system.unstable, result.system.energy, spent, checks
    )
    if np.abs(state.curves - last.curves).max() > 0.1 or state.unstable != last.unstable:
        return None
    return replace(
        folding, states=(state,), happenings=(), model=fine, x=result.x, iterations=spent,
        seconds=time.monotonic() - begun,
    )  # fmt: skip


def _state(model: Model, x, e, unstable, energy, iterations, checks) -> State:
    lowest = tip = None
    if model.ground is not None:
        lowest = float(model.gaps(x, e).min())
        u = model.scene.displacement(x, e)
        tip = float((model.body.nodes + u)[foot(model.body, (0.0, 0.5, 0.0)), 2].item())
    own = own_check(model, x, e, unstable)
    return State(
        e, model.curves(x, e), (own, *checks), lowest, tip, energy, iterations, model.scene.size,
        None if model.contact is None else model.clearance(x, e),
    )  # fmt: skip


class _Walk:
    def __init__(self, model, rtol, turn, stop, noise, arc, on_state, max_states):
        self.begun = time.monotonic()
        self.model, self.stop = model, stop
        self.on_state, self.max_states = on_state, max_states
        angle = max(model.unit.fold_angle, model.unit.curvature * model.unit.width)
        if model.growth == "uniaxial":
            angle = model.unit.fold_angle
        step = min(LONGEST, turn / max(angle, 1e-9))
        self.steps = LoadSteps(
            rtol=rtol, step=step, first=0.5, cut=4.0, growth=1.5, max_iterations=12,
            largest=max(1.0, min(EASY, LONGEST / step)),
        )  # fmt: skip
        self.stepper = StableSteps(self.steps, locate=False)
        if noise is not None:
            weights = uneven(noise[0], model.watch) if model.heavy else None
            noisy = Noise(*noise, scene=weights)
            self.stepper = self.landing = replace(self.steps, noise=noisy)
            if arc:
                self.stepper = ArcLength(rtol, SWAY, step, noise=noisy)
        self.states: list[State] = []
        self.happenings: list[Happening] = []
        self.iterations = 0
        self.toppled = False
        self.symmetries = Symmetries(model)
        # The last accepted point; the model and unknowns of it and of the one before.
        self.last: Point | None = None
        self.at: tuple[Model, np.ndarray] | None = None
        self.before: tuple[Model, np.ndarray] | None = None

    def run(self, x: np.ndarray) -> Folding:
        try:
            return self._walk(x)
        except OutOfTime:
            return self._end(Ending.TIMEOUT, Ending.TIMEOUT.value, self.last)

    def _walk(self, x: np.ndarray) -> Folding:
        point = self.stepper.begin(self.model.scene, x, 0.0, 1.0)
        if isinstance(point, Ended):
            return self._end(Ending.NO_REST, point.reason, None)
        while True:
            point = self._patiently(point)
            if isinstance(point, Ending):
                return self._end(point, point.value, self.last)
            if isinstance(point, Ended):
                return self._end(Ending.LOST, point.reason, self.last)
            self.last, self.before, self.at = point, self.at, (self.model, point.x)
            if self.stop is not None and self.stop(self.states[-1]):
                return self._end(Ending.STOPPED, Ending.STOPPED.value, point)
            if point.e >= 1.0:
                return self._end(Ending.REACHED, Ending.REACHED.value, point)
            if len(self.states) >= self.max_states:
                return self._end(Ending.TOO_LONG, Ending.TOO_LONG.value, point)
            self.model = self.model.anchored(point.x, point.e)
            if self.model.physics.friction:
                # What is remembered is part of every class's terms.
                self.symmetries = Symmetries(self.model)
            point = self.stepper.advance(self.model.scene, point, 1.0)
            if isinstance(point, Point) and point.e > 1.0:
                # An arc passes its target; load steps land on it.
                self.stepper, point = self.landing, self.landing.resume(self.last, 1.0)
                point = self.stepper.advance(self.model.scene, point, 1.0)
            if isinstance(point, Ended):
                return self._end(Ending.LOST, point.reason, self.last)
            point = self._first_lost(point)

    def _first_lost(self, point: Point) -> Point:
        """The point; of a step in which stability is lost in more than one class, or in the model's
        own and so unseen in the others, one within it where the first class is lost.

        Which one a body leaves by decides where it falls to, and must not hang on the step's size.
        """
        if not (isinstance(self.stepper, StableSteps) and self.model.mirrors):
            return point
        fell = any(event.kind in ("snap", "bifurcation") for event in point.events)
        if not fell and len(self._lost(self.symmetries.check(point.x, point.e))) < 2:
            return point
        low, end, spent = self.last, point.e, point.iterations
        for _ in range(BISECTIONS):
            half = (end - low.e) / 2
            steps = replace(self.steps, smallest=0.9 * half / self.steps.step)
            middle = steps.advance(self.model.scene, replace(low, control=(half,)), 1.0)
            if isinstance(middle, Ended):
                break
            spent += middle.iterations
            lost = self._lost(self.symmetries.check(middle.x, middle.e))
            count = len(lost) + (middle.unstable != 0)
            if count == 0:
                low = middle
            elif count > 1:
                end = middle.e
            elif lost:
                return replace(middle, control=point.control, iterations=spent)
            else:
                break  # the model's own class is the first, and there it has fallen
        return replace(point, iterations=spent)

    def _end(self, ending: Ending, detail: str, point: Point | None) -> Folding:
        # The model may have been widened since, in an attempt to go on from there.
        model, x = (self.model, None) if point is None else self.at
        return Folding(
            tuple(self.states), tuple(self.happenings), ending, detail, model, x, self.iterations,
            time.monotonic() - self.begun, self.before,
        )  # fmt: skip

    def _patiently(self, point: Point) -> Point | Ended | Ending:
        """As :meth:`_accept`; where the fall out of a symmetry finds no end, from a step further.

        Close beyond a branch point little energy drives the fall, and it creeps.
        """
        whole = self.stepper
        for _ in range(PATIENCE if isinstance(whole, StableSteps) else 0):
            kept = self.model, self.symmetries, len(self.happenings)
            self.stepper = replace(whole, most=whole.most // 4)
            accepted = self._accept(point)
            self.stepper = whole
            if not isinstance(accepted, Ended) or self.model is kept[0] or point.e >= 1.0:
                return accepted
            self.model, self.symmetries = kept[:2]
            del self.happenings[kept[2] :]
            further = self.stepper.advance(self.model.scene, point, 1.0)
            if isinstance(further, Ended):
                return accepted
            # What happened in the step to the point that was given up happened.
            point = replace(further, events=(*point.events, *further.events))
        return self._accept(point)

    def _accept(self, point: Point) -> Point | Ended | Ending:
        """The point, or the one that the unit goes to where a symmetry is lost."""
        self.iterations += point.iterations
        for event in point.events:
            if event.kind in ("snap", "bifurcation"):
                # With fewer mirror planes a mode may have more symmetry than the model: no class.
                whole = len(self.model.mirrors) == 2
                kind = "symmetric" if whole and event.kind == "bifurcation" else event.kind
                self.happenings.append(Happening(kind, event.e, event.size))
        checks = self.symmetries.check(point.x, point.e)
        lost = self._lost(checks)
        while lost and self.model.mirrors and isinstance(self.stepper, StableSteps):
            # Of classes lost in the same step the one that keeps most.
            first = max(lost, key=lambda c: len(c.kept))
            kept = first.kept
            if self.model.contact is not None and "y" not in kept:
                return Ending.APART
            self.model, x = self.model.widened(kept, point.x, point.e)
            before = self.model.scene.displacement(x, point.e)
            self.symmetries = Symmetries(self.model)
            fallen = self.stepper.begin(self.model.scene, x, point.e, 1.0)
            if isinstance(fallen, Ended):
                return fallen
            self.iterations += fallen.iterations
            size = float(np.abs(self.model.scene.displacement(fallen.x, fallen.e) - before).max())
            kind = CLASSES.get(kept, "bifurcation") if first.held else "toppling"
            self.happenings.append(Happening(kind, point.e, size))
            point = replace(fallen, index=point.index)
            checks = self.symmetries.check(point.x, point.e)
            lost = self._lost(checks)
        state = _state(
            self.model, point.x, point.e, point.unstable, point.energy, point.iterations, checks
        )
        if state.topples and not self.toppled:
            self.happenings.append(Happening("toppling", point.e))
            self.toppled = True
        self.states.append(state)
        if self.on_state is not None:
            self.on_state(self.model, point.x, state)
        return point

    def _lost(self, checks) -> list[Check]:
        """The classes in which the unit cannot stay as it is; tipping counts where it may tip."""
        return [c for c in checks if (c.held if self.model.upright else c.free)]
