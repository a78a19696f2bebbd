"""The stable path of a structure: what it does as its hinges contract."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from solver.cases.structure.model import Model
from solver.equilibrium.clock import OutOfTime
from solver.paths.point import Ended
from solver.paths.stable import StableSteps
from solver.paths.steppers import LoadSteps


class Ending(Enum):
    """Why a path ended where it did."""

    REACHED = "the full contraction was reached on a stable path"
    STOPPED = "the path was stopped at a state that was asked for"
    TIMEOUT = "the time allowed was used up"
    TOO_LONG = "the steps allowed were used up"
    LOST = "no stable equilibrium was found beyond the last point"
    NO_REST = "the flat sheet came to no rest on the ground"


@dataclass(frozen=True)
class Happening:
    """A fall to another state: ``kind`` snap or bifurcation, ``e`` of the state after it, ``size``
    of the jump, max|Δu| over the sheet's extent."""

    kind: str
    e: float
    size: float


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


@dataclass(frozen=True, eq=False)
class Folding:
    """States, what happened, and why the path ended; the model and unknowns it ended in.

    ``detail``: the solver's own sentence where it failed; ``iterations``: factorisations.
    """

    states: tuple[State, ...]
    happenings: tuple[Happening, ...]
    ending: Ending
    detail: str
    model: Model
    x: np.ndarray | None
    iterations: int
    seconds: float

    @property
    def last(self) -> State:
        """The last accepted state; raises ValueError where there is none."""
        if not self.states:
            raise ValueError(f"the path has no states: {self.detail}")
        return self.states[-1]


def fold(
    model: Model,
    *,
    rtol: float = 1e-6,
    turn: float = 0.25,
    stop: Callable[[State], bool] | None = None,
    on_state: Callable[[State], None] | None = None,
    max_states: int = 500,
) -> Folding:
    """Follow the stable path from the flat sheet at e = 0 to e = 1.

    ``turn``: rad that a hinge may fold by in a step, by its law; ``stop``: asked at each state.
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
        rtol=rtol, step=step, first=0.5, cut=4.0, growth=1.5, max_iterations=15, largest=2.0
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
            point = stepper.advance(model.scene, point, target)
            if isinstance(point, Ended):
                return ended(Ending.LOST, point.reason)
    except OutOfTime:
        return ended(Ending.TIMEOUT)


def _state(model: Model, point) -> State:
    x, e = point.x, point.e
    u = model.scene.displacement(x, e)
    mass, where = model.structure.masses
    panels = model.panels(x, e)
    return State(
        e,
        model.angles(x, e),
        tuple(panels),
        model.strips(x, e),
        centre_of_mass(model, u, mass, where),
        None if model.ground is None else float(model.ground.heights(u).min()),
        None if model.contact is None else model.contact.distance(u),
        point.unstable,
        point.energy,
        point.iterations,
    )


def centre_of_mass(model: Model, u: np.ndarray, mass: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Of the structure displaced by u (n, 3), (3,)."""
    Y = (model.body.nodes + u).reshape(-1, 4, 3)
    X = model.body.nodes.reshape(-1, 4, 3)
    k = where[:, 0].astype(int)
    # Nodes stand off along x and y from the first.
    off = (where[:, 1:] - X[k, 0, :2]) / (X[k, 1, 0] - X[k, 0, 0])[:, None]
    places = Y[k, 0] + np.einsum("ka,kai->ki", off, Y[k, 1:3] - Y[k, :1])
    return mass @ places / mass.sum()
