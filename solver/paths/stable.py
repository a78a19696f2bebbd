"""Stable paths: where one loses stability the body falls to the next stable state."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.equilibrium.descent import descend
from solver.equilibrium.linesearch import largest
from solver.equilibrium.newton import NewtonResult
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.given import one_of, positive, whole
from solver.paths.point import Ended, Point
from solver.paths.reasons import no_result
from solver.paths.stability import Event, locate, switch
from solver.paths.steppers import ArcLength, LoadSteps, heading


@dataclass(frozen=True)
class StableSteps:
    """What a real body does as the load grows: it stays on a stable path while there is one.

    ``steps``: the load steps on it. Where a step fails or ends in an unstable state it is shortened
    a few times; then the energy falls to the next stable equilibrium, from which the path goes on.
    ``locate``: whether the loss of stability is located first, by following the arc; without, it is
    known to one step, and the path is cheap enough for thousands. ``reach``: see
    :func:`solver.equilibrium.descent.descend`; ``most``: iterations of the fall at a path's
    beginning. Needs a scene with an energy.

    Located. ``side`` ±1 chooses the way at a branch point. Where a stable second path goes on with
    the load the fall starts beside it, elsewhere from the critical state moved along the critical
    vector (``nudge``, max|Δu| / length). ``beyond``: how far past the critical load that is, as a
    fraction of the step. Where the fall doesn't end, these two and ``reach`` grow fivefold, twice;
    at a branch point the other side is tried last. ``max_arc_steps``: to the critical state at
    most.

    Not located. ``cuts``: how often a step is divided (by the steps' ``cut``) before the energy
    falls. A fall is a ``snap`` where it moves the body by more than ``far``, max|Δu| over length,
    and the tangents at its ends don't explain that; else it is a ``bifurcation`` if it left an
    unstable state, and nothing if Newton's method had only failed.

    Raises ValueError for sizes that are not positive, and sides that don't exist.
    """

    steps: LoadSteps
    locate: bool = True
    reach: float = 0.1
    most: int = 600
    side: int = 1
    nudge: float = 1e-3
    beyond: float = 1e-2
    max_arc_steps: int = 60
    cuts: int = 2
    far: float = 0.05

    def __post_init__(self):
        one_of("steps", LoadSteps, self.steps, "LoadSteps(rtol, step)")
        positive(self, "reach", "nudge", "beyond", "far")
        whole("most", self.most, 1)
        whole("max_arc_steps", self.max_arc_steps, 1)
        whole("cuts", self.cuts, 0)
        if self.side not in (1, -1):
            raise ValueError(f"side = {self.side!r}; expected 1 or -1, the two ways at a branch")

    @property
    def rtol(self) -> float:
        """That of the steps."""
        return self.steps.rtol

    def begin(self, scene: Scene, x: np.ndarray, e: float, sign: float) -> Point | Ended:
        """First point: the stable equilibrium down the energy from the guess."""
        fallen = descend(scene, x, e, rtol=self.rtol, reach=self.reach, max_iterations=self.most)
        if not fallen.converged:
            return no_result(scene, fallen)
        point = self.steps.begin(scene, fallen.x, e, sign)
        if isinstance(point, Ended):
            return point
        return replace(point, iterations=point.iterations + fallen.iterations)

    def resume(self, point: Point, target: float | None) -> Point:
        """The point, set to walk towards the target."""
        return self.steps.resume(point, target)

    def advance(self, scene: Scene, point: Point, target: float | None) -> Point | Ended:
        """The next stable point, or why there is none and the events on the way to that."""
        pace = self.steps.pace
        if self.locate:
            # A step that fails once may be hard; one that fails at a tenth is at a critical point.
            now = min(pace.now(point.control) / self.steps.step, 1.0)
            smallest = max(self.steps.smallest, 0.9 * now / self.steps.cut)
        else:
            smallest = 0.9 * self.steps.cut ** -float(self.cuts)
        after = replace(self.steps, smallest=smallest).advance(scene, point, target)
        if isinstance(after, Point) and after.unstable == 0:
            return after
        lost = after if isinstance(after, Point) else None
        if self.locate:
            return self._locate_and_fall(scene, point, lost, target)
        return self._fall(scene, point, lost, target)

    # -- from the state itself -----------------------------------------------------------------

    def _fall(self, scene, point, lost: Point | None, target) -> Point | Ended:
        """Down the energy from the unstable state, or from the point at a somewhat higher load."""
        spent = 0 if lost is None else lost.iterations
        start = point if lost is None else lost
        sign, ahead = heading(point, target), self.steps.step / self.steps.cut
        tries = [(1.0, 1.0), (2.0, 3.0), (4.0, 10.0)]
        for further, reach in tries if lost is None else [(0.0, 1.0), *tries]:
            e = _short_of(target, start.e + sign * further * ahead, sign)
            fallen = descend(scene, start.x, e, rtol=self.rtol, reach=reach * self.reach)
            spent += fallen.iterations
            if fallen.converged:
                break
        else:
            return no_result(scene, fallen)
        after = self.steps.point(scene, point, fallen, spent, self.steps.step / 8)
        if after is None:
            return Ended(Outcome.SINGULAR)
        size = largest((fallen.x - point.x)[: scene.n_free]) / scene.scales.length
        snapped = size > self.far and not self.steps.explains(scene, point, after)
        events = ()
        if lost is not None or snapped:
            kind = "snap" if snapped else "bifurcation"
            count = None if lost is None else lost.unstable
            events = (_fallen(scene, kind, point.x, fallen, count),)
        return replace(after, events=events, history=())

    # -- from where stability is lost ------------------------------------------------------------

    def _locate_and_fall(self, scene, point, lost: Point | None, target) -> Point | Ended:
        events = () if lost is None else locate(scene, point, lost, rtol=self.rtol)
        if not events:
            met = self._arc_to_event(scene, point, target)
            if isinstance(met, Point):
                return met
            events = met
        event = events[0] if events else None
        return self._fall_beyond(scene, point, event, heading(point, target), target)

    def _arc_to_event(self, scene, point, target) -> tuple[Event, ...] | Point:
        """Follow the arc until stability is lost; a Point if it stays stable for a load step, or
        as far as the arc goes."""
        arc = ArcLength(
            self.rtol, max(0.3 * point.metric.a, 1e-9), 0.3 * point.metric.b, largest=3.0
        )
        here, sign = point, np.sign(point.tangent[-1])
        for _ in range(self.max_arc_steps):
            after = arc.advance(scene, here)
            if isinstance(after, Ended):
                break
            if after.unstable != 0 or after.tangent[-1] * sign < 0:
                return locate(scene, here, after, rtol=self.rtol)[:1]
            passed = target is not None and (after.e - target) * sign >= 0
            if passed or (after.e - point.e) * sign >= self.steps.step:
                break
            here = after
        if here is point:
            return ()
        return replace(here, index=point.index + 1, control=point.control)

    def _fall_beyond(self, scene, point, event: Event | None, sign, target) -> Point | Ended:
        """Beyond the critical load, down the energy to a stable state."""
        located = () if event is None else (event,)
        x, e = (point.x, point.e) if event is None else (event.x, event.e)
        kind = "snap" if event is None or event.kind == "fold" else "bifurcation"
        tries = [(1.0, 1), (5.0, 1), (25.0, 1), *([(5.0, -1)] if kind == "bifurcation" else [])]
        first, spent = None, 0
        for grown, side in tries:
            ahead = min(self.beyond * grown, 1.0) * self.steps.step
            on = _short_of(target, e + sign * ahead, sign)
            start = self._start(scene, point, event, on, grown, side)
            fallen = descend(scene, start, on, rtol=self.rtol, reach=self.reach * grown)
            spent += fallen.iterations
            if fallen.converged:
                break
            first = first or fallen
        else:
            return replace(no_result(scene, first), events=located)
        # Beside a branch point the state moves like a root of the load: small steps at first.
        control = min(self.steps.step / 8, max(abs(on - e), self.steps.pace.least))
        after = self.steps.point(scene, point, fallen, spent, control)
        if after is None:
            return Ended(Outcome.SINGULAR, located)
        fall = _fallen(scene, kind, x, fallen, event.unstable[1] if event else None)
        return replace(after, events=(*located, fall), history=())

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
        amplitude, beside = 1e-2, None
        for _ in range(4):
            tried = switch(scene, event, point, rtol=self.rtol, amplitude=amplitude, side=side)
            stays = isinstance(tried, Outcome) or tried.unstable != 0
            gone = 0.0 if stays else (tried.e - event.e) / (on - event.e)
            if gone <= 0:
                if beside is not None:
                    break
                # Roundoff beside the critical state decides at one distance, not at another.
                amplitude *= 2
                continue
            beside = tried
            if abs(gone - 1) < 0.1:
                break
            # The second path's load grows with the square of the amplitude.
            amplitude = largest((tried.x - event.x)[: scene.n_free]) / scene.scales.length
            amplitude = min(amplitude * np.sqrt(1 / gone), 0.3)
        return None if beside is None else beside.x


def _short_of(target: float | None, e: float, sign: float) -> float:
    """The load, or the target where it would be passed."""
    return target if target is not None and (e - target) * sign > 0 else e


def _fallen(scene: Scene, kind: str, x: np.ndarray, fallen: NewtonResult, count) -> Event:
    """The fall from x to a stable state at its load, as an event."""
    before = scene.energy(x, fallen.e)
    shift = fallen.x - x
    return Event(
        kind,
        fallen.e,
        fallen.x,
        shift,
        1.0,
        (count, fallen.system.unstable),
        size=largest(shift[: scene.n_free]) / scene.scales.length,
        energy_drop=0.0 if before is None else float(before - fallen.system.energy),
    )
