"""Steppers: how a path goes from one point to the next.

``LoadSteps`` prescribes the load (Algorithms 2 and 3, Eq. 2.63), ``ArcLength`` a distance in
displacement and load (Algorithm 4, Eqs. 2.64–2.76); :mod:`solver.paths.stable` adds one that keeps
to stable states. Each is a frozen set of choices; what changes along a path is in its points, so
that a rejected step leaves nothing behind. How long steps are: :mod:`solver.paths.pace`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from solver.equilibrium.descent import descend
from solver.equilibrium.linear import Factor
from solver.equilibrium.linesearch import largest
from solver.equilibrium.newton import NewtonResult, newton
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.given import number, one_of, positive, whole
from solver.paths.arc import Ellipsoid, correct, tangent
from solver.paths.noise import Noise
from solver.paths.pace import ArcPace, LoadPace, towards
from solver.paths.point import Ended, Metric, Point, displacement_size
from solver.paths.predictor import choose, extrapolate, guesses, misfit
from solver.paths.reasons import JUMPED, NO_TANGENT, no_result, no_step


class Stepper(Protocol):
    """What :func:`solver.paths.continuation.follow` asks of a stepper.

    ``begin``: the first point, an equilibrium near the guess x (size,) at the load e; ``sign`` ±1:
    whether the load shall rise or fall from there. ``advance``: the next point on the way to the
    load ``target``, on in the direction of travel where that is None. ``resume``: a point of any
    stepper, set to walk towards the target. ``rtol``: what corrections count as converged.
    """

    @property
    def rtol(self) -> float: ...

    def begin(self, scene: Scene, x: np.ndarray, e: float, sign: float) -> Point | Ended: ...

    def advance(self, scene: Scene, point: Point, target: float | None) -> Point | Ended: ...

    def resume(self, point: Point, target: float | None) -> Point: ...


@dataclass(frozen=True)
class LoadSteps:
    """Steps of the load with Newton at each (Algorithms 2 and 3).

    ``rtol``: see :func:`solver.equilibrium.newton.newton`. ``step``: usual change of e, > 0; its
    sign comes from the target. ``first``: fraction of it taken first, where there is nothing to
    extrapolate. ``smallest``: fraction below which the path stops. ``cut``: divisor after a
    failure. ``growth``: factor after a success, up to ``step`` (inf restores it at once, as
    Algorithm 3 does), and up to ``largest`` · ``step`` where Newton took three iterations or fewer.
    ``order`` of the predictor: 0 the last displacement, 1 the tangent (Eq. 2.63), 2 through the
    point before, 3 its tangent too, 4 and 5 one point more; the best one up to it is taken.
    ``jump``: a step is refused if the tangents at its ends leave more than this fraction of it
    unexplained, for then its end lies on another path; inf allows it. ``noise``: with an energy,
    each step then goes down to a stable state.

    Raises ValueError for sizes that are not positive and orders that don't exist.
    """

    rtol: float
    step: float
    first: float = 0.25
    smallest: float = 1e-4
    cut: float = 10.0
    growth: float = 2.0
    largest: float = 1.0
    order: int = 3
    jump: float = 0.5
    max_iterations: int = 20
    noise: Noise | None = None

    def __post_init__(self):
        positive(self, "rtol", "jump")
        whole("order", self.order, 0, 5)
        whole("max_iterations", self.max_iterations, 1)
        _noisy(self.noise)
        _ = self.pace

    @property
    def pace(self) -> LoadPace:
        """The rule for the size of steps."""
        return LoadPace(self.step, self.first, self.smallest, self.cut, self.growth, self.largest)

    def begin(self, scene: Scene, x: np.ndarray, e: float, sign: float) -> Point | Ended:
        """First point of a path."""
        along = np.zeros(scene.size + 1)
        along[-1] = sign * self.step
        metric = Metric(1.0, self.step, scene.n_free, scene.scales.length)
        return _first(scene, x, e, self.rtol, along, metric, (self.first * self.step,))

    def advance(self, scene: Scene, point: Point, target: float | None) -> Point | Ended:
        """The next point, at most at the load ``target``; None: on in the direction of travel."""
        pace = self.pace
        step = pace.now(point.control)
        sign = heading(point, target)
        remaining = np.inf if target is None else abs(target - point.e)
        noisy, field = scene, None
        if self.noise is not None:
            noisy, field = self.noise.draw(scene, point)
        spent, result, met = 0, None, ""
        while step >= pace.least:
            de = towards(step, remaining)
            e = target if de == remaining else point.e + sign * de
            result = self._solve(noisy, point, e, field)
            spent += result.iterations
            if result.converged:
                after = self.point(noisy, point, result, spent, step)
                if after is not None and (field is not None or self.explains(scene, point, after)):
                    return after
                met = NO_TANGENT if after is None else JUMPED
            step = de / self.cut
        return no_step(scene, result, met)

    def resume(self, point: Point, target: float | None) -> Point:
        """The point, set to walk towards the target."""
        away = target is not None and (target - point.e) * point.tangent[-1] < 0
        return turned(point) if away else point

    def point(
        self, scene: Scene, before: Point, result: NewtonResult, spent: int, step: float
    ) -> Point | None:
        """The point after ``before`` at an equilibrium; None where it has no tangent.

        ``spent``: factorisations since ``before``; ``step``: the one that led there.
        """
        a = displacement_size(scene, result.x - before.x)
        b = max(abs(result.e - before.e), 1e-2 * self.step)
        metric = Metric(max(a, 1e-6), b, scene.n_free, scene.scales.length)
        along = np.zeros(scene.size + 1)
        along[-1] = result.e - before.e
        factor = result.system.factorise()
        way = tangent(scene, result.x, result.e, factor, along, metric)
        if way is None:
            return None
        return Point(
            index=before.index + 1,
            e=result.e,
            x=result.x,
            tangent=way,
            metric=metric,
            unstable=result.system.unstable,
            energy=result.system.energy,
            iterations=spent,
            step=result.e - before.e,
            residual=result.residual,
            control=(self.pace.following(step, result.iterations),),
            history=before.past(),
        )

    def explains(self, scene: Scene, before: Point, after: Point) -> bool:
        """Whether the tangents at both ends explain the step; a jump to another path they don't."""
        rates = [p.tangent[:-1] / p.tangent[-1] for p in (before, after)]
        line = after.x - before.x
        odd = line - after.step * (rates[0] + rates[1]) / 2
        n, slack = scene.n_free, 1e-3 * scene.scales.length
        return largest(odd[:n]) <= self.jump * largest(line[:n]) + slack

    def guess(self, scene: Scene, point: Point, e: float) -> np.ndarray:
        """Where the path is expected at the load ``e``, shortened where a barrier bars the way."""
        options = [np.zeros_like(point.x)]
        if self.order > 0 and abs(point.tangent[-1]) > 0:
            # Pieces of the past that the load has left behind in the other direction don't help.
            nodes = [
                (at, x, way[:-1] / way[-1])
                for at, x, way in ((point.e, point.x, point.tangent), *point.history)
                if way[-1] * point.tangent[-1] > 0
            ]
            nodes = nodes[: (self.order + 2) // 2 if self.order > 1 else 1]
            nodes = [p for i, p in enumerate(nodes) if all(p[0] != q[0] for q in nodes[:i])]
            options = extrapolate(_as_steps(scene, nodes), e)[: self.order]
        step = options[0]
        if len(options) > 1:
            step = min(options, key=lambda dx: misfit(scene, scene.moved(point.x, dx, e), e))
        # An extrapolation may end beyond a barrier.
        admitted = scene.longest_step(point.x, step, e)
        return scene.moved(point.x, admitted * step, e)

    def _solve(self, scene, point, e, field) -> NewtonResult:
        guess = self.guess(scene, point, e)
        start = guess
        if field is not None:
            scale = largest(guess[: scene.n_free])
            start = guess + self.noise.amplitude * scale * field
        if field is not None and scene.energy(start, e) is not None:
            return descend(scene, start, e, rtol=self.rtol)
        return newton(
            scene,
            start,
            e,
            rtol=self.rtol,
            max_iterations=self.max_iterations,
            unstable=0 if point.unstable == 0 else None,
        )


@dataclass(frozen=True)
class ArcLength:
    """Steps on an ellipsoid in displacement and load (Algorithm 4 with its enhancements).

    ``rtol``: see :func:`solver.paths.arc.correct`. ``a``, ``b`` > 0: first semi-axes, root mean
    square of the displacement over length, and load. ``smallest``, ``largest``: bounds of both as
    fractions of those; below, the path stops. ``order``: of the best predictor (see ``LoadSteps``).
    ``forward``: least cosine between a step and the sum of the tangents at its ends; with a smaller
    one it doubles back, cuts a corner or ends on another path. ``easy``: iterations per step to aim
    at. ``direction``: +1 or −1, whether the load rises or falls at first where a path starts from a
    guess; None: towards its target. A path that starts from a point goes on as it was walked, or
    back from there if :func:`turned`. ``noise``: on each guess; a step that would end in an
    unstable state is a noisy load step instead, which goes down to a stable one.

    Guesses (2.74) are those of :mod:`solver.paths.predictor`: the smallest residual wins unless it
    buckles the body. Two of the dissertation's are not among them. Load forward with the
    displacement kept always has a small residual in a thin body and never is near the path; keeping
    everything is the tangent's guess, as the ellipsoid's gradient vanishes at its centre.

    Raises ValueError for sizes that are not positive, orders and directions that don't exist.
    """

    rtol: float
    a: float
    b: float
    smallest: float = 1e-4
    largest: float = 4.0
    order: int = 3
    forward: float = 0.95
    easy: int = 4
    max_iterations: int = 12
    direction: int | None = None
    noise: Noise | None = None

    def __post_init__(self):
        positive(self, "rtol")
        whole("order", self.order, 1, 5)
        whole("max_iterations", self.max_iterations, 1)
        _noisy(self.noise)
        if not number("forward", self.forward) < 1:
            raise ValueError(f"forward = {self.forward}; expected a cosine, less than 1")
        if self.direction not in (None, 1, -1):
            raise ValueError(
                f"direction = {self.direction!r}; expected 1 (the load rises at first), -1 (it "
                "falls) or None (towards the target)"
            )
        _ = self.pace

    @property
    def pace(self) -> ArcPace:
        """The rule for the semi-axes."""
        # What the noise costs to take back is no reason for shorter steps.
        easy = self.easy if self.noise is None else 2 * self.easy
        return ArcPace(self.a, self.b, self.smallest, self.largest, easy)

    def begin(self, scene: Scene, x: np.ndarray, e: float, sign: float) -> Point | Ended:
        """First point of a path, which sets out with the load rising (sign 1) or falling (−1),
        unless ``direction`` says otherwise."""
        along = np.zeros(scene.size + 1)
        along[-1] = (self.direction or sign) * self.b
        metric = Metric(self.a, self.b, scene.n_free, scene.scales.length)
        return _first(scene, x, e, self.rtol, along, metric, (self.a, self.b))

    def advance(self, scene: Scene, point: Point, target: float | None = None) -> Point | Ended:
        """The next point; it may pass the target."""
        pace = self.pace
        a, b = pace.now(point.control)
        noisy, field, spent, result = scene, None, 0, None
        if self.noise is not None:
            noisy, field = self.noise.draw(scene, point)
        while pace.allows(a, b):
            metric = point.metric.sized(a, b)
            options = guesses(point, metric, self.order)
            expected = point.unstable if field is None else None
            guess, system, refused = choose(noisy, options, expected)
            if field is not None:
                size = self.noise.amplitude * largest(guess[: scene.n_free])
                guess[:-1] += noisy.longest_step(guess[:-1], size * field, guess[-1]) * size * field
            result = correct(
                noisy,
                guess,
                Ellipsoid(point.z, metric),
                rtol=self.rtol,
                load_size=self.b,
                max_iterations=self.max_iterations,
                system=system,
            )
            spent += refused + result.iterations
            if result.converged:
                unstable = result.system.unstable and result.system.energy is not None
                if field is not None and unstable:
                    # The corrector takes any noise back, so an unstable path is left downhill.
                    steps = LoadSteps(self.rtol, metric.b, noise=self.noise)
                    return steps.advance(scene, point, None)
                after = self._point(noisy, point, result, metric, spent)
                if after is not None:
                    return after
            a, b = pace.shorter(a, b)
        return no_step(scene, result, JUMPED)

    def resume(self, point: Point, target: float | None) -> Point:
        """The point: the arc keeps its direction; see :func:`turned`."""
        return point

    def _point(self, scene, point, result: NewtonResult, metric, spent) -> Point | None:
        x, e = result.x, result.e
        line = result.z - point.z
        before = metric.unit(point.tangent)
        way = tangent(scene, x, e, result.system.factorise(), line, metric)
        if way is None:
            return None
        # A chord of a smooth path runs along the sum of the tangents at its ends, round a fold too.
        both, size = before + way, metric.norm(line)
        back = min(metric.dot(line, before), metric.dot(line, way)) <= 0
        if back or metric.dot(line, both) < self.forward * size * metric.norm(both):
            return None
        moved = (displacement_size(scene, line[:-1]), abs(line[-1]))
        return Point(
            index=point.index + 1,
            e=e,
            x=x,
            tangent=way,
            metric=metric,
            unstable=result.system.unstable,
            energy=result.system.energy,
            iterations=spent,
            step=e - point.e,
            residual=result.residual,
            control=self.pace.following(metric, moved, result.iterations),
            history=point.past(),
        )


def _noisy(noise: Noise | None) -> None:
    if noise is not None:
        one_of("noise", Noise, noise, "Noise(amplitude, seed)")


def heading(point: Point, target: float | None) -> float:
    """±1: whether the load rises or falls on the way to the target."""
    return float(np.sign(point.tangent[-1] if target is None else target - point.e))


def turned(point: Point) -> Point:
    """The same point, set to walk its path the other way."""
    return replace(point, tangent=-point.tangent, history=())


def _as_steps(scene: Scene, nodes: list) -> list:
    """Values and slopes (e, x, dx/de), the newest first, as steps from its x."""
    (e, start, rate), *past = nodes
    steps = [(e, np.zeros_like(start), rate)]
    for e, x, rate in past:
        there = scene.way(start, x, e)
        if scene.sections is not None:
            small = 1e-6 * scene.scales.length / max(largest(rate[: scene.n_free]), 1e-300)
            rate = (scene.way(start, x + small * rate, e) - there) / small
        steps.append((e, there, rate))
    return steps


def _start(scene: Scene, x: np.ndarray, e: float, rtol: float) -> NewtonResult:
    """An equilibrium near the guess; where Newton finds none, down the energy if there is one."""
    result = newton(scene, x, e, rtol=rtol, max_iterations=50, unstable=0)
    if result.converged or result.outcome is Outcome.INADMISSIBLE or not scene.symmetric:
        return result
    return result if scene.energy(x, e) is None else descend(scene, x, e, rtol=rtol)


def _first(scene: Scene, x, e, rtol, along, metric, control) -> Point | Ended:
    result = _start(scene, x, e, rtol)
    if not result.converged:
        return no_result(scene, result, Outcome.NO_START)
    factor: Factor = result.system.factorise()
    way = tangent(scene, result.x, result.e, factor, along, metric)
    if way is None:
        return Ended(Outcome.SINGULAR)
    return Point(
        index=0,
        e=result.e,
        x=result.x,
        tangent=way,
        metric=metric,
        unstable=result.system.unstable,
        energy=result.system.energy,
        iterations=result.iterations,
        step=0.0,
        residual=result.residual,
        control=control,
    )
