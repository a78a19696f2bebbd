"""Equilibrium paths: R(x, e) = 0 followed in e, point by point.

:func:`follow` yields accepted points, :func:`trace` collects them. What goes from one point to the
next is a stepper (:mod:`solver.paths.steppers`). The path ends on its target: a target that two
points bracket is approached between them, not overrun.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from solver.equilibrium.newton import checked, newton
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.given import number, numbers, whole
from solver.paths.arc import NotFollowed, between, tangent
from solver.paths.point import Ended, Point, Uncounted, Unlocated, reason
from solver.paths.stability import Event, locate
from solver.paths.steppers import Stepper
from solver.shown import path_table


@dataclass(frozen=True)
class Load:
    """Signed distance to a load."""

    value: float

    def __call__(self, point: Point) -> float:
        """e − value."""
        return point.e - self.value


def load(value: float) -> Load:
    """Target: the load ``value``, met exactly; ValueError for no finite number."""
    return Load(number("the load to reach", value))


@dataclass(frozen=True)
class Path:
    """Accepted points, why the path ended, and what was located on the way.

    ``detail``: what the last attempt to go on failed at, in words; empty where the outcome says it
    all. ``warnings``: what makes the answer doubtful. :class:`solver.mesh.locking.Locking`:
    elements too stiff for the material, or for the shape that the body begins or ends with;
    :class:`solver.paths.point.Uncounted`: points whose unstable modes are not known;
    :class:`solver.paths.point.Unlocated`: fold or branch points that were passed unseen.
    """

    points: tuple[Point, ...]
    outcome: Outcome
    events: tuple[Event, ...]
    warnings: tuple[UserWarning, ...] = ()
    detail: str = ""

    def __repr__(self) -> str:
        span = f", e {self.points[0].e:.4g} to {self.last.e:.4g}" if self.points else ""
        n, told = len(self.points), "".join(f", {e.kind} at {e.e:.4g}" for e in self.events[:3])
        more = f", {len(self.events) - 3} more events" if len(self.events) > 3 else ""
        return f"Path({n} points{span}{told}{more}; {self.reason})"

    _repr_html_ = path_table

    def plot(self, measure: Callable[[Point], float], label: str = ""):
        """Matplotlib axes of ``measure`` of each point over the load e: points whose unstable modes
        are none are filled, others and those not counted are open. ``label``: of the measure.

        Raises ValueError for a path without points.
        """
        if not self.points:
            raise ValueError(f"the path has no points to plot: {self.reason}")
        from matplotlib.figure import Figure

        values = [measure(p) for p in self.points]
        ax = Figure(figsize=(5, 3.5), layout="constrained").subplots()
        ax.plot(self.loads, values, color="0.6", lw=1)
        for stable, face in ((True, "C0"), (False, "white")):
            some = [k for k, p in enumerate(self.points) if (p.unstable == 0) == stable]
            ax.plot(
                self.loads[some], [values[k] for k in some], "o", ms=4, mec="C0", mfc=face,
                label="stable" if stable else "unstable or not counted",
            )  # fmt: skip
        ax.set(xlabel="load e", ylabel=label)
        ax.legend(frameon=False)
        return ax

    @property
    def last(self) -> Point:
        """The last accepted point; raises ValueError for a path without points."""
        if not self.points:
            raise ValueError(f"the path has no points: {self.reason}")
        return self.points[-1]

    @property
    def reason(self) -> str:
        """Why the path ended, in words: the outcome's sentence and the detail."""
        return reason(self.outcome, self.detail)

    @property
    def reached(self) -> bool:
        """Whether the path ended on its target."""
        return self.outcome is Outcome.REACHED

    @property
    def loads(self) -> np.ndarray:
        """e of all points."""
        return np.array([p.e for p in self.points])

    @property
    def iterations(self) -> int:
        """Factorisations in all, those that located events left out."""
        return sum(p.iterations for p in self.points)


def follow(
    scene: Scene,
    start: np.ndarray | Point,
    stepper: Stepper,
    *,
    e: float = 0.0,
    until: Load | Callable[[Point], float] = Load(1.0),
    max_steps: int,
    events: bool = True,
    bounds: tuple[float, float] = (-np.inf, np.inf),
) -> Generator[Point, None, Outcome]:
    """Yield the accepted points of the path from ``start``; the generator returns its Outcome.

    ``start``: a guess x (size,) for the equilibrium at the load ``e``, which is found and yielded
    first, or a Point, from which the path goes on as if it had never stopped. ``until``:
    :func:`load`, or any function of a point whose sign changes where the path shall end.
    ``max_steps``: points after the start at most. ``events``: locate fold and branch points between
    points where the number of unstable modes or the direction of the load changes. ``bounds``:
    loads at which to give up.

    Raises ValueError for a guess of the wrong shape, for max_steps < 1, for an ``until`` that is no
    function and gives no number, for a body that can be moved rigidly without resistance, and for a
    start at a load where a term has no meaning.
    """
    ended = yield from _walk(
        scene, start, stepper, e=e, until=until, max_steps=max_steps, events=events, bounds=bounds
    )
    return ended.outcome


def _walk(
    scene, start, stepper, *, max_steps, e=0.0, until=Load(1.0), events=True,
    bounds=(-np.inf, np.inf),
) -> Generator[Point, None, Ended]:  # fmt: skip
    """:func:`follow`, which tells what was located beyond the last point too."""
    whole("max_steps", max_steps, 1)
    number("e", e)
    if not callable(until):
        raise ValueError(f"until = {until!r}; expected load({until!r}), or a function of a point")
    if numbers("bounds", bounds).shape != (2,):
        raise ValueError(f"bounds = {bounds!r}; expected the lowest and the highest load")
    target = until.value if isinstance(until, Load) else None
    if isinstance(start, Point):
        checked(scene, start.x, stepper.rtol)
        point = stepper.resume(start, target)
    else:
        if np.shape(start) == (scene.size,):
            scene.refuse_free_motion(start, e)
        sign = -1.0 if target is not None and target < e else 1.0
        point = stepper.begin(scene, start, e, sign)
        if isinstance(point, Ended):
            return point
        yield point
    gap = _gap(until, point)
    if gap == 0 and target is not None:
        return (
            _there(scene, point, stepper.rtol)
            if isinstance(start, Point)
            else Ended(Outcome.REACHED)
        )
    missed = ""
    for _ in range(max_steps):
        after = stepper.advance(scene, point, target)
        if isinstance(after, Ended):
            return (
                replace(after, why=partial(str, missed)) if missed and not after.detail else after
            )
        located = after.events
        if events and not located:
            located = locate(scene, point, after, rtol=stepper.rtol)
        end = _end(scene, point, after, located, until, gap, stepper.rtol)
        if isinstance(end, Outcome):
            # The target is bracketed but was not met: come nearer in smaller steps.
            missed = (
                f"the target, between e = {point.e:.6g} and {after.e:.6g}, was not met: {end.value}"
            )
            point = replace(point, control=tuple(c / np.sqrt(10) for c in point.control))
            continue
        if end is not None:
            passed = tuple(ev for ev in located if _precedes(ev, point, end))
            yield replace(end, events=passed)
            return Ended(Outcome.REACHED)
        if not bounds[0] <= after.e <= bounds[1]:
            return Ended(Outcome.OUT_OF_BOUNDS)
        point = replace(after, events=located)
        gap, missed = _gap(until, point), ""
        yield point
    return Ended(Outcome.MAX_STEPS, why=partial(str, missed))


def _gap(until: Load | Callable[[Point], float], point: Point) -> float:
    """The signed distance to the target."""
    return number("what until gives of a point", until(point))


def _there(scene: Scene, start: Point, rtol: float) -> Ended:
    """The end of a path that starts on its target: whether the start is an equilibrium."""
    result = newton(scene, start.x, start.e, rtol=10 * rtol, max_iterations=1)
    if result.converged:
        return Ended(Outcome.REACHED)

    def why():
        off = f"Newton's first correction is {result.correction:.2g} of the length, not {rtol:g}"
        if result.outcome is not Outcome.NOT_CONVERGED:
            off = scene.obstacle(start.x, start.e) or result.outcome.value
        return f"at e = {start.e:.6g}: {off}"

    return Ended(Outcome.NO_EQUILIBRIUM, why=why)


def trace(
    scene: Scene,
    start: np.ndarray | Point,
    stepper: Stepper,
    **options,
) -> Path:
    """All points of :func:`follow`, with the same options, as a :class:`Path`.

    A path that starts from a Point contains it as its first.
    """
    points = [start] if isinstance(start, Point) else []
    walk = _walk(scene, start, stepper, **options)
    while True:
        try:
            points.append(next(walk))
        except StopIteration as stop:
            own = points[1:] if isinstance(start, Point) else points
            events = (*(ev for p in own for ev in p.events), *stop.value.events)
            warnings = _warnings(scene, points)
            if options.get("events", True):
                warnings += _unlocated(points)
            return Path(tuple(points), stop.value.outcome, events, warnings, stop.value.detail)


def _warnings(scene: Scene, points: list[Point]) -> tuple[UserWarning, ...]:
    """Locking of the shape at rest, or failing that at the end, and by the terms' materials;
    points whose stability is not known."""
    body = scene.body
    ends = [scene.displacement(p.x, p.e) for p in points[-1:]]
    shape = next((w for u in (None, *ends) if (w := body.locking(u))), ())
    material = (w for term in scene.terms for w in getattr(term, "locking", ()))
    return (*shape, *material, *_uncounted(scene, points))


def _uncounted(scene: Scene, points: list[Point]) -> tuple[Uncounted, ...]:
    unknown = [p.e for p in points if p.unstable is None]
    if not unknown:
        return ()
    why = "the linear solver counts no pivots there"
    if not scene.symmetric:
        names = ", ".join(term.name for term in scene.terms if not term.symmetric)
        why = f"the stiffness of {names} isn't symmetric; take a form with a potential"
    return (
        Uncounted(
            f"unstable modes were not counted at {len(unknown)} of {len(points)} points, from "
            f"e = {unknown[0]:.4g} on: {why}"
        ),
    )


def _unlocated(points: list[Point]) -> tuple[Unlocated, ...]:
    passed = [(p.e, q.e) for p, q in pairwise(points) if _unexplained(p, q)]
    if not passed:
        return ()
    steps = ", ".join(f"{a:.6g} and {b:.6g}" for a, b in passed[:3])
    more = f", and in {len(passed) - 3} steps more" if len(passed) > 3 else ""
    return (
        Unlocated(
            "stability or the direction of the load changed, and no fold or branch point was "
            f"located, between e = {steps}{more}: the path between could not be followed; take "
            "smaller steps there"
        ),
    )


def _unexplained(before: Point, after: Point) -> bool:
    """Whether more changed between two points than the events between them say."""
    kinds = [ev.kind for ev in after.events]
    if not {"fold", "branch"}.issuperset(kinds):
        return False  # a fall, to wherever it led
    turned = before.tangent[-1] * after.tangent[-1] < 0
    if turned != (kinds.count("fold") % 2 == 1):
        return True
    counts = [(before.unstable, after.unstable), *(ev.unstable for ev in after.events)]
    if any(None in pair for pair in counts):
        return False
    change, *located = (b - a for a, b in counts)
    return change != sum(located)


def _end(scene, before, after, located, until, gap, rtol) -> Point | Outcome | None:
    """Where ``until`` vanishes between two points; None: nowhere; an Outcome: it was not met."""
    there = _gap(until, after)
    if there == 0:
        return after
    if gap == 0:
        return None
    if gap * there > 0:
        # Past the target and back again within one step: a fold beyond it tells.
        beyond = (
            [ev for ev in located if (ev.e - until.value) * gap < 0]
            if isinstance(until, Load)
            else []
        )
        if not beyond:
            return None
        made = between(scene, before, after, beyond[0].fraction, rtol=rtol)
        if made is None or _gap(until, made[0]) * gap > 0:
            return None
        middle = made[0]
        after = replace(
            middle,
            index=after.index,
            control=after.control,
            iterations=after.iterations + middle.iterations,
        )
    return _land(scene, before, after, until, rtol)


def _land(scene, before, after, until, rtol) -> Point | Outcome:
    """The zero of ``until`` between two points that bracket it."""
    last, spent = after, after.iterations

    def value(fraction):
        nonlocal last, spent
        if fraction in (0.0, 1.0):
            return _gap(until, before if fraction == 0 else after)
        made = between(scene, before, after, fraction, rtol=rtol)
        if made is None:
            raise NotFollowed(f"no equilibrium was found at {fraction:.3g} of the step")
        last = made[0]
        spent += last.iterations
        return _gap(until, last)

    try:
        # A load is met exactly by Newton afterwards.
        near = 1e-3 if isinstance(until, Load) else 1e-12
        value(brentq(value, 0.0, 1.0, xtol=near, rtol=1e-12))
    except (NotFollowed, RuntimeError):
        return Outcome.NOT_CONVERGED
    if isinstance(until, Load):
        exact = newton(scene, last.x, until.value, rtol=rtol, max_iterations=20)
        moved, chord = (
            np.linalg.norm((x - y)[: scene.n_free])
            for x, y in ((exact.x, last.x), (after.x, before.x))
        )
        if not exact.converged or moved > 0.1 * chord:
            return Outcome.NOT_CONVERGED
        system, spent = exact.system, spent + exact.iterations
        way = tangent(scene, exact.x, until.value, system.factorise(), last.tangent, last.metric)
        if way is None:
            return Outcome.SINGULAR
        last = replace(
            last, e=until.value, x=exact.x, tangent=way, unstable=system.unstable,
            energy=system.energy, residual=exact.residual,
        )  # fmt: skip
    return replace(
        last,
        index=after.index,
        iterations=spent,
        step=last.e - before.e,
        control=after.control,
        history=before.past(),
    )


def _precedes(event: Event, before: Point, end: Point) -> bool:
    """Whether an event lies between ``before`` and ``end`` rather than after it."""
    line, dot = end.z - before.z, end.metric.dot
    return dot(np.append(event.x, event.e) - before.z, line) <= dot(line, line)
