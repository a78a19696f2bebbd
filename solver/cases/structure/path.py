"""The stable path of a structure: what it does as its hinges contract."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from solver.cases.structure.model import Model
from solver.cases.unit.path import Ending, Folding, Happening
from solver.equilibrium.clock import OutOfTime
from solver.equilibrium.outcome import Outcome
from solver.paths.point import Ended, Point
from solver.paths.stability import Event
from solver.paths.stable import StableSteps
from solver.paths.steppers import LoadSteps

MET = "panels met, and no state near by goes on from there"
LEAST = 0.05  # of a step, below which panels are asked whether it is they
SLIDE = 3000  # iterations of a fall in which panels slide on each other


@dataclass(frozen=True, eq=False)
class State:
    """An accepted point at the load ``e``.

    ``angles`` (hinges,): rad; ``panels``: outline (k, 3) of each; ``strips``
    (hinges, 4, 3): corners of the hinges; ``lowest``: of the underside's
    corners above the ground, None without; ``clearance``: of panels from each other, inf where none
    are near, None where they may not touch; ``centre`` (3,): of mass; ``unstable``: modes.
    """

    e: float
    angles: np.ndarray
    panels: tuple[np.ndarray, ...] = field(repr=False)
    strips: np.ndarray = field(repr=False)
    centre: np.ndarray
    lowest: float | None
    clearance: float | None
    unstable: int | None
    energy: float | None
    iterations: int


def fold(
    model: Model,
    *,
    rtol: float = 1e-6,
    turn: float = 0.25,
    stop: Callable[[State], bool] | None = None,
    on_state: Callable[[State], None] | None = None,
    meet: bool = True,
    max_states: int = 500,
) -> Folding:
    """Follow the stable path from the flat sheet at e = 0 to e = 1.

    ``turn``: rad that a hinge may fold by in a step, by its law; ``stop``: asked at each state;
    ``meet``: whether to go on, however long that takes, where panels bar each other's way and no
    state is near; else the path stops there.
    """
    begun = time.monotonic()
    creases = [h.crease for h in model.structure.pattern.hinges]
    rates = [
        abs(law.angle[-1]) / (c.end - c.start)
        for law, c in zip(model.structure.laws, creases, strict=True)
        if c.fold
    ]
    step = min(0.2, turn / max([*rates, 1e-9]))
    # The load's rate changes where a hinge begins or ends.
    marks = sorted({t for c in creases for t in (c.start, c.end)} | {1.0})
    steps = LoadSteps(
        rtol=rtol, step=step, first=0.5, cut=4.0, growth=1.5, max_iterations=24, largest=2.0
    )
    stepper = StableSteps(steps, locate=False)
    states: list[State] = []
    happenings: list[Happening] = []
    iterations, x = 0, None

    def ended(ending: Ending, detail: str = "") -> Folding:
        return Folding(
            tuple(states), tuple(happenings), ending, detail or ending.value, model, x, iterations,
            time.monotonic() - begun,
        )  # fmt: skip

    try:
        point = stepper.begin(model.scene, np.zeros(model.scene.size), 0.0, 1.0)
        if isinstance(point, Ended):
            return ended(Ending.NO_REST, point.reason)
        while True:
            iterations += point.iterations
            x = point.x
            happenings += [
                Happening(ev.kind, ev.e, ev.size)
                for ev in point.events
                if ev.kind in ("snap", "bifurcation")
            ]
            states.append(_state(model, point))
            if on_state is not None:
                on_state(states[-1])
            if stop is not None and stop(states[-1]):
                return ended(Ending.STOPPED)
            if point.e >= 1.0:
                return ended(Ending.REACHED)
            if len(states) >= max_states:
                return ended(Ending.TOO_LONG)
            model = model.anchored(point.x, point.e)
            target = next(t for t in marks if t > point.e)
            after = None
            if not meet and model.contact is not None:
                after = _straight(stepper.steps, model, point, target)
                if isinstance(after, Ended):
                    return ended(Ending.STOPPED, MET)
            if after is None:
                after = stepper.advance(model.scene, point, target)
            if isinstance(after, Ended):
                after, reason = _slowly(stepper, model, point, target), after.reason
            if isinstance(after, Ended):
                return ended(Ending.LOST, reason)
            point = after
    except OutOfTime:
        return ended(Ending.TIMEOUT)


def _straight(steps: LoadSteps, model: Model, point: Point, target: float) -> Point | Ended | None:
    """The next point by steps of the load, without a fall; Ended where there is none and panels bar
    the way, None where it is not they that do."""
    after = replace(steps, smallest=LEAST).advance(model.scene, point, target)
    if isinstance(after, Point) and after.unstable == 0:
        return after
    ahead = min(steps.pace.now(point.control), target - point.e)
    change = point.tangent[:-1] / point.tangent[-1] * ahead
    u = model.scene.displacement(point.x, point.e)
    v = model.scene.displacement(model.scene.moved(point.x, change, point.e), point.e + ahead)
    touch = model.contact
    if touch.longest_step(u, v - u) >= 1 and not np.isfinite(touch.distance(v)):
        return None
    return after if isinstance(after, Ended) else Ended(Outcome.NO_STABLE_STATE)


def _slowly(stepper: StableSteps, model: Model, point: Point, target: float) -> Point | Ended:
    """Down the energy from half a step and a step ahead, however long it takes.

    Edges that meet may slide along each other by far before one finds its way past the other.
    """
    for ahead in (0.5, 1.0):
        e = min(point.e + ahead * stepper.steps.step, target)
        fallen = replace(stepper, most=SLIDE).begin(model.scene, point.x, e, 1.0)
        if not isinstance(fallen, Ended):
            size = np.abs((fallen.x - point.x)[: model.scene.n_free]).max()
            length = model.scene.scales.length
            event = Event("snap", e, fallen.x, fallen.x - point.x, size=float(size / length))
            return replace(fallen, index=point.index + 1, events=(event,))
    return fallen


def _state(model: Model, point) -> State:
    x, e = point.x, point.e
    u = model.scene.displacement(x, e)
    panels = model.panels(x, e)
    return State(
        e,
        model.angles(x, e),
        tuple(panels),
        model.strips(x, e),
        model.centre_of_mass(u),
        None if model.ground is None else model.lowest(u),
        None if model.contact is None else model.clearance(u),
        point.unstable,
        point.energy,
        point.iterations,
    )
