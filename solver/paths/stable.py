"""Stable paths: where one loses stability it falls to the next stable state.

:class:`StablePath` follows the arc to each loss of stability and locates it. :class:`Settle` is
cheap enough for thousands of paths: a load step that fails, or ends in an unstable state, is
shortened a few times; then the energy falls from there to the next stable equilibrium. The loss of
stability is known to one step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from solver.equilibrium.descent import descend
from solver.equilibrium.newton import Outcome, largest
from solver.equilibrium.scene import Scene
from solver.paths.point import Point
from solver.paths.stability import Ended, Event, locate, switch
from solver.paths.steppers import ArcLength, LoadSteps


@dataclass(frozen=True)
class Settle:
    """Load steps on a stable path, and the fall to the next one where it ends.

    ``steps``: the load steps. ``cuts``: how often a step is divided (by their ``cut``) before the
    energy falls. ``reach``: see :func:`solver.equilibrium.descent.descend`; ``most``: iterations of
    the fall at a path's beginning. A fall is a ``snap`` where it moves the body by more than
    ``far``, max|Δu| over length, and the tangents at its ends don't explain that; else it is a
    ``bifurcation`` if it left an unstable state, and nothing if Newton's method had only failed.
    Needs a scene with an energy.
    """

    steps: LoadSteps
    cuts: int = 2
    reach: float = 0.1
    far: float = 0.05
    most: int = 600
    _quick: LoadSteps = field(init=False, repr=False)

    def __post_init__(self):
        smallest = 0.9 * self.steps.cut ** -float(self.cuts)
        object.__setattr__(self, "_quick", replace(self.steps, smallest=smallest))

    @property
    def rtol(self) -> float:
        """That of the steps."""
        return self.steps.rtol

    def begin(self, scene: Scene, x: np.ndarray, e: float, sign: float) -> Point | Outcome:
        """First point: the stable equilibrium down the energy from the guess."""
        found = descend(scene, x, e, rtol=self.rtol, reach=self.reach, max_iterations=self.most)
        if not found.converged:
            return found.outcome
        point = self.steps.begin(scene, found.x, e, sign)
        if isinstance(point, Outcome):
            return point
        return replace(point, iterations=point.iterations + found.iterations)

    def resume(self, point: Point, target: float | None) -> Point:
        """The point, set to walk towards the target."""
        return self.steps.resume(point, target)

    def advance(self, scene: Scene, point: Point, target: float | None) -> Point | Outcome:
        """The next stable point."""
        found = self._quick.advance(scene, point, target)
        if isinstance(found, Point) and found.unstable == 0:
            return found
        unstable = isinstance(found, Point)
        spent = found.iterations if unstable else 0
        sign = float(np.sign(target - point.e if target is not None else point.tangent[-1]))
        x, e = (found.x, found.e) if unstable else (point.x, point.e)
        on = self.steps.step / self.steps.cut
        fallen = None
        for share, reach in ((0.0, 1.0), (1.0, 1.0), (2.0, 3.0), (4.0, 10.0)):
            if share == 0.0 and not unstable:
                continue
            load = e + sign * share * on
            if target is not None and (load - target) * sign > 0:
                load = target
            fallen = descend(scene, x, load, rtol=self.rtol, reach=reach * self.reach)
            spent += fallen.iterations
            if fallen.converged:
                break
        if not fallen.converged:
            return fallen.outcome
        begin = scene.energy(point.x, fallen.e)
        after = self.steps._point(scene, point, fallen, spent, self.steps.step / 8)
        if after is None:
            return Outcome.SINGULAR
        shift = np.append(fallen.x - point.x, 0.0)
        size = largest(shift[: scene.n_free]) / scene.scales.length
        events = ()
        snapped = size > self.far and not self.steps._smooth(scene, point, after)
        if unstable or snapped:
            kind = "snap" if snapped else "bifurcation"
            count = found.unstable if unstable else None
            drop = 0.0 if begin is None else float(begin - after.energy)
            events = (
                Event(
                    kind, fallen.e, fallen.x, shift[:-1], 1.0, (count, after.unstable),
                    size=size, energy_drop=drop,
                ),
            )  # fmt: skip
        return replace(after, events=events, history=())


@dataclass(frozen=True)
class StablePath:
    """What a real body does as the load grows: it stays on a stable path while there is one.

    ``steps``: the load steps on it. Where a step fails or ends in an unstable state, the loss of
    stability is located by following the arc; beyond it the energy falls to the next stable
    equilibrium, from which the path goes on. ``side`` ±1 chooses the way at a branch point. Where a
    stable second path goes on with the load the fall starts beside it, elsewhere from the critical
    state moved along the critical vector (``nudge``, max|Δu| / length). ``beyond``: how far past
    the critical load that is, as a share of the step. ``reach``: see
    :func:`solver.equilibrium.descent.descend`. Where the fall doesn't end the three grow fivefold,
    twice; at a branch point the other side is tried last. Needs a scene with an energy.
    """

    steps: LoadSteps
    nudge: float = 1e-3
    side: int = 1
    beyond: float = 1e-2
    reach: float = 0.1
    max_arc_steps: int = 60

    @property
    def rtol(self) -> float:
        """That of the steps."""
        return self.steps.rtol

    def begin(self, scene: Scene, x: np.ndarray, e: float, sign: float) -> Point | Outcome:
        """First point: the stable equilibrium down the energy from the guess."""
        found = descend(scene, x, e, rtol=self.rtol, reach=self.reach)
        if not found.converged:
            return found.outcome
        return self.steps.begin(scene, found.x, e, sign)

    def resume(self, point: Point, target: float | None) -> Point:
        """The point, set to walk towards the target."""
        return self.steps.resume(point, target)

    def advance(self, scene: Scene, point: Point, target: float | None) -> Point | Outcome:
        """The next stable point."""
        found = self.attempt(scene, point, target)
        return found.outcome if isinstance(found, Ended) else found

    def attempt(self, scene: Scene, point: Point, target: float | None) -> Point | Ended:
        """The next stable point, or why there is none and the events on the way to that."""
        # A step that fails once may be hard; one that fails at a tenth is at a critical point.
        now = point.control[0] if len(point.control) == 1 else self.steps.first * self.steps.step
        tenth = 0.9 * min(now / self.steps.step, 1.0) / self.steps.cut
        quick = replace(self.steps, smallest=max(self.steps.smallest, tenth))
        found = quick.advance(scene, point, target)
        if isinstance(found, Point) and found.unstable == 0:
            return found
        events = ()
        if isinstance(found, Point):
            events = locate(scene, point, found, rtol=self.rtol)
        if not events:
            met = self._arc_to_event(scene, point, target)
            if isinstance(met, Point):
                return met
            events = met
        sign = float(np.sign(target - point.e if target is not None else point.tangent[-1]))
        return self._fall(scene, point, events[0] if events else None, sign, target)

    def _arc_to_event(self, scene, point, target) -> tuple[Event, ...] | Point:
        """Follow the arc until stability is lost; a Point if it stays stable for a load step, or
        as far as the arc goes."""
        arc = ArcLength(
            self.rtol, max(0.3 * point.metric.a, 1e-9), 0.3 * point.metric.b, largest=3.0
        )
        here, sign = point, np.sign(point.tangent[-1])
        for _ in range(self.max_arc_steps):
            found = arc.advance(scene, here)
            if isinstance(found, Outcome):
                break
            if found.unstable != 0 or found.tangent[-1] * sign < 0:
                return locate(scene, here, found, rtol=self.rtol)[:1]
            passed = target is not None and (found.e - target) * sign >= 0
            if passed or (found.e - point.e) * sign >= self.steps.step:
                break
            here = found
        if here is point:
            return ()
        return replace(here, index=point.index + 1, control=point.control)

    def _fall(self, scene, point, event, sign, target) -> Point | Ended:
        """Beyond the critical load, down the energy to a stable state."""
        located = () if event is None else (event,)
        x, e = (point.x, point.e) if event is None else (event.x, event.e)
        kind = "snap" if event is None or event.kind == "fold" else "bifurcation"
        tries = [(1.0, 1), (5.0, 1), (25.0, 1), *([(5.0, -1)] if kind == "bifurcation" else [])]
        first, spent = None, 0
        for grown, side in tries:
            on = e + sign * min(self.beyond * grown, 1.0) * self.steps.step
            if target is not None and (on - target) * sign > 0:
                on = target
            start = self._start(scene, point, event, on, grown, side)
            found = descend(scene, start, on, rtol=self.rtol, reach=self.reach * grown)
            spent += found.iterations
            if found.converged:
                break
            first = first or found.outcome
        else:
            return Ended(first, located)
        begin = scene.energy(x, on)
        # Beside a branch point the state moves like a root of the load: small steps at first.
        control = min(self.steps.step / 8, max(abs(on - e), self.steps.smallest * self.steps.step))
        after = self.steps._point(scene, point, found, spent, control)
        if after is None:
            return Ended(Outcome.SINGULAR, located)
        shift = np.append(found.x - x, 0.0)
        snap = Event(
            kind, on, found.x, shift[:-1], 1.0, (event.unstable[1] if event else None, 0),
            size=largest(shift[: scene.n_free]) / scene.scales.length,
            energy_drop=float(begin - after.energy),
        )  # fmt: skip
        return replace(after, events=(*located, snap), history=())

    def _start(self, scene, point, event, on, grown, side) -> np.ndarray:
        """Where the fall to the load ``on`` starts."""
        if event is None:
            return point.x
        if event.kind == "branch":
            beside = self._beside(scene, point, event, on, self.side * side)
            if beside is not None:
                return beside
        mode = event.vector * scene.scales.length / largest(event.vector)
        if event.kind == "fold":
            side = 1 if point.metric.dot(event.tangent, np.append(mode, 0.0)) > 0 else -1
        else:
            side = self.side * side
        return event.x + min(self.nudge * grown, 0.1) * side * mode

    def _beside(self, scene, point, event, on, side) -> np.ndarray | None:
        """A state of the second path near the load ``on``; None if that path leads elsewhere.

        A fall of a thin body from the critical state creeps: each step along the straight critical
        vector stretches it.
        """
        amplitude, made = 1e-2, None
        for _ in range(4):
            found = switch(scene, event, point, rtol=self.rtol, amplitude=amplitude, side=side)
            stays = isinstance(found, Outcome) or found.unstable != 0
            gone = 0.0 if stays else (found.e - event.e) / (on - event.e)
            if gone <= 0:
                if made is not None:
                    break
                # Roundoff beside the critical state decides at one distance, not at another.
                amplitude *= 2
                continue
            made = found
            if abs(gone - 1) < 0.1:
                break
            # The second path's load grows with the square of the amplitude.
            amplitude = largest((found.x - event.x)[: scene.n_free]) / scene.scales.length
            amplitude = min(amplitude * np.sqrt(1 / gone), 0.3)
        return None if made is None else made.x
