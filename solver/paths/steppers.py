"""Steppers: how a path goes from one point to the next.

``LoadSteps`` prescribes the load (Algorithms 2 and 3, Eq. 2.63), ``ArcLength`` a distance in
displacement and load (Algorithm 4, Eqs. 2.64–2.76). Each is a frozen set of choices; what changes
along a path is in its points, so that a rejected step leaves nothing behind.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from solver.equilibrium.descent import descend
from solver.equilibrium.linear import Factor, SingularMatrix
from solver.equilibrium.newton import NewtonResult, Outcome, largest, newton
from solver.equilibrium.scene import Scene
from solver.paths.arc import Ellipsoid, correct, extrapolate, tangent
from solver.paths.point import Metric, Point, displacement_size


@dataclass(frozen=True)
class Noise:
    """Seeded noise on the guess of every step (§4.3.3), so that unstable states are left.

    ``amplitude``: largest noise over the largest displacement of the guess; the dissertation takes
    1e-3 … 1e-2. The field is the body's answer to random forces: independent noise on each node
    would strain a thin body more than it bends it. ``scene``: the scene to solve in a step, drawn
    from the given scene and a generator, for noise on densities and other fields; it must have the
    same unknowns. The numbers depend on ``seed`` and the index of the point only.
    """

    amplitude: float
    seed: int
    scene: Callable[[Scene, np.random.Generator], Scene] | None = None

    def draw(self, scene: Scene, point: Point) -> tuple[Scene, np.ndarray]:
        """The scene of the step after ``point`` and a field (size,), largest component 1."""
        rng = np.random.default_rng([self.seed, point.index])
        if self.scene is not None:
            scene = self.scene(scene, rng)
        force = np.zeros(scene.size)
        force[: scene.n_free] = rng.standard_normal(scene.n_free)
        field = np.zeros(scene.size)
        system = scene.system(point.x, point.e)
        answer = force
        if system is not None:
            with suppress(SingularMatrix):
                answer = system.factorise().solve(force)
        n = scene.n_free
        field[:n] = answer[:n] / largest(answer[:n])
        return scene, field


@dataclass(frozen=True)
class LoadSteps:
    """Steps of the load with Newton at each (Algorithms 2 and 3).

    ``rtol``: see :func:`solver.equilibrium.newton.newton`. ``step``: usual change of e, > 0; its
    sign comes from the target. ``first``: share of it taken first, where there is nothing to
    extrapolate. ``smallest``: share below which the path stops. ``cut``: divisor after a failure.
    ``growth``: factor after a success, up to ``step`` (inf restores it at once, as Algorithm 3
    does), and up to ``largest`` · ``step`` where Newton took three iterations or fewer. ``order``
    of the predictor: 0 the last displacement, 1 the tangent (Eq. 2.63), 2 through the point before,
    3 its tangent too, 4 and 5 one point more; the best one up to it is taken. ``jump``: a step is
    refused if the tangents at its ends leave more than this share of it unexplained, for then its
    end lies on another path; inf allows it. ``noise``: with an energy, each step then goes down to
    a stable state.

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
        _positive(self, "rtol", "step", "first", "smallest", "growth", "largest", "jump")
        if not (self.cut > 1 and self.growth >= 1 and 0 <= self.order <= 5):
            raise ValueError(
                f"cut = {self.cut}, growth = {self.growth}, order = {self.order}; "
                "expected cut > 1, growth >= 1 and an order from 0 to 5"
            )

    def begin(self, scene: Scene, x: np.ndarray, e: float, sign: float) -> Point | Outcome:
        """First point of a path."""
        found = _start(scene, x, e, self.rtol)
        if not found.converged:
            return Outcome.NO_START
        along = np.zeros(scene.size + 1)
        along[-1] = sign * self.step
        metric = Metric(1.0, self.step, scene.n_free, scene.scales.length)
        return _first(scene, found, along, metric, (self.first * self.step,))

    def advance(self, scene: Scene, point: Point, target: float | None) -> Point | Outcome:
        """The next point, at most at the load ``target``; None: on in the direction of travel."""
        step = point.control[0] if len(point.control) == 1 else self.first * self.step
        sign = np.sign(target - point.e if target is not None else point.tangent[-1])
        noisy, field = scene, None
        if self.noise is not None:
            noisy, field = self.noise.draw(scene, point)
        spent = 0
        while step >= self.smallest * self.step:
            de = step
            if target is not None:
                # The last two steps share what is left: no sliver before the target.
                left = abs(target - point.e)
                de = left / np.ceil(left / step - 1e-9) if left < 2 * step else step
                de = left if de > left * (1 - 1e-12) else de
            e = target if target is not None and de == left else point.e + sign * de
            found = self._solve(noisy, point, e, field)
            spent += found.iterations
            if found.converged:
                made = self._point(noisy, point, found, spent, step)
                if made is not None and (field is not None or self._smooth(scene, point, made)):
                    return made
            step = de / self.cut
        return Outcome.MIN_STEP

    def resume(self, point: Point, target: float | None) -> Point:
        """The point, set to walk towards the target."""
        away = target is not None and (target - point.e) * point.tangent[-1] < 0
        return turned(point) if away else point

    def _solve(self, scene, point, e, field) -> NewtonResult:
        options = [point.x]
        if self.order > 0 and abs(point.tangent[-1]) > 0:
            # Pieces of the past that the load has left behind in the other direction don't help.
            past = [(p[0], p[1], p[2][:-1] / p[2][-1]) for p in (
                (point.e, point.x, point.tangent), *point.history
            ) if p[2][-1] * point.tangent[-1] > 0]  # fmt: skip
            nodes = past[: (self.order + 2) // 2 if self.order > 1 else 1]
            nodes = [p for i, p in enumerate(nodes) if all(p[0] != q[0] for q in nodes[:i])]
            options = extrapolate(nodes, e)[: self.order]
        guess = options[0]
        if len(options) > 1:
            guess = min(options, key=lambda x: _misfit(scene, x, e))
        # An extrapolation may end beyond a barrier.
        guess = point.x + scene.longest_step(point.x, guess - point.x, e) * (guess - point.x)
        start = guess
        if field is not None:
            scale = largest(guess[: scene.n_free])
            start = guess + self.noise.amplitude * scale * field
        if field is not None and scene.energy(start, e) is not None:
            return descend(scene, start, e, rtol=self.rtol)
        return newton(
            scene, start, e, rtol=self.rtol, max_iterations=self.max_iterations,
            unstable=0 if point.unstable == 0 else None,
        )  # fmt: skip

    def _smooth(self, scene, before, after) -> bool:
        """Whether the tangents at both ends explain the step; a jump to another path they don't."""
        rates = [p.tangent[:-1] / p.tangent[-1] for p in (before, after)]
        line = after.x - before.x
        odd = line - after.step * (rates[0] + rates[1]) / 2
        n, slack = scene.n_free, 1e-3 * scene.scales.length
        return largest(odd[:n]) <= self.jump * largest(line[:n]) + slack

    def _point(self, scene, point, found, spent, step) -> Point | None:
        a = displacement_size(scene, found.x - point.x)
        b = max(abs(found.e - point.e), 1e-2 * self.step)
        metric = Metric(max(a, 1e-6), b, scene.n_free, scene.scales.length)
        along = np.zeros(scene.size + 1)
        along[-1] = found.e - point.e
        factor = found.system.factorise()
        way = tangent(scene, found.x, found.e, factor, along, metric)
        if way is None:
            return None
        most = self.largest * self.step if found.iterations <= 3 else max(self.step, step)
        grown = max(step, min(self.growth * step, most))
        return Point(
            point.index + 1, found.e, found.x, way, metric, found.system.unstable,
            found.system.energy, spent, found.e - point.e, found.residual, (grown,), (),
            point.past(),
        )  # fmt: skip


@dataclass(frozen=True)
class ArcLength:
    """Steps on an ellipsoid in displacement and load (Algorithm 4 with its enhancements).

    ``rtol``: see :func:`solver.paths.arc.correct`. ``a``, ``b`` > 0: first semi-axes, root mean
    square of the displacement over length, and load. ``smallest``, ``largest``: bounds of both as
    shares of those; below, the path stops. ``order``: of the best predictor (see ``LoadSteps``).
    ``forward``: least cosine between a step and the sum of the tangents at its ends; with a smaller
    one it doubles back, cuts a corner or ends on another path. ``easy``: iterations per step to aim
    at. ``noise``: on each guess; a step that would end in an unstable state is a noisy load step
    instead, which goes down to a stable one.

    Guesses (2.74): load forward with the displacement kept, extrapolation through the last two
    points, and the polynomials with tangents; the smallest residual wins. Keeping everything is not
    among them: the ellipsoid's gradient vanishes at its centre, and the step from there along the
    path is the tangent guess.

    Raises ValueError for sizes that are not positive and orders that don't exist.
    """

    rtol: float
    a: float
    b: float
    smallest: float = 1e-4
    largest: float = 4.0
    order: int = 3
    forward: float = 0.9
    easy: int = 4
    max_iterations: int = 12
    noise: Noise | None = None

    def __post_init__(self):
        _positive(self, "rtol", "a", "b", "smallest", "largest", "easy")
        if not (self.forward < 1 and 1 <= self.order <= 5):
            raise ValueError(
                f"forward = {self.forward}, order = {self.order}; "
                "expected forward < 1 and an order from 1 to 5"
            )

    def begin(self, scene: Scene, x: np.ndarray, e: float, sign: float) -> Point | Outcome:
        """First point of a path, which sets out with the load rising (sign 1) or falling (−1)."""
        found = _start(scene, x, e, self.rtol)
        if not found.converged:
            return Outcome.NO_START
        along = np.zeros(scene.size + 1)
        along[-1] = sign * self.b
        metric = Metric(self.a, self.b, scene.n_free, scene.scales.length)
        return _first(scene, found, along, metric, (self.a, self.b))

    def advance(self, scene: Scene, point: Point, target: float | None = None) -> Point | Outcome:
        """The next point; it may pass the target."""
        a, b = point.control if len(point.control) == 2 else (self.a, self.b)
        noisy, field, spent = scene, None, 0
        if self.noise is not None:
            noisy, field = self.noise.draw(scene, point)
        while max(a / self.a, b / self.b) >= self.smallest:
            metric = point.metric.sized(a, b)
            guess = self._guess(noisy, point, metric, biased=spent == 0)
            if field is not None:
                size = self.noise.amplitude * largest(guess[: scene.n_free])
                guess[:-1] += noisy.longest_step(guess[:-1], size * field, guess[-1]) * size * field
            found = correct(
                noisy, guess, Ellipsoid(point.z, metric),
                rtol=self.rtol, load_size=self.b, max_iterations=self.max_iterations,
            )  # fmt: skip
            spent += found.iterations
            if found.converged:
                if field is not None and found.system.unstable and found.system.energy is not None:
                    # The corrector takes any noise back, so an unstable path is left downhill.
                    steps = LoadSteps(self.rtol, metric.b, noise=self.noise)
                    return steps.advance(scene, point, None)
                made = self._point(noisy, point, found, metric, spent)
                if made is not None:
                    return made
            a, b = a / np.sqrt(10), b / np.sqrt(10)  # (2.76)
        return Outcome.MIN_STEP

    def resume(self, point: Point, target: float | None) -> Point:
        """The point: the arc keeps its direction; see :func:`turned`."""
        return point

    def _guess(self, scene: Scene, point: Point, metric: Metric, biased: bool) -> np.ndarray:
        here, way = point.z, metric.unit(point.tangent)
        guesses = [here + way]
        # Close before a fold the load alone leads where the path doesn't go: a failure says so.
        if biased:
            ahead = here.copy()
            ahead[-1] += np.sign(way[-1]) * metric.b
            guesses.append(ahead)
        if point.history:
            nodes, s, last = [(0.0, here, way)], 0.0, here
            for e, x, t in point.history[: max(self.order // 2, 1)]:
                z = np.append(x, e)
                s -= metric.norm(z - last)
                nodes.append((s, z, metric.unit(t)))
                last = z
            guesses.append(here + metric.unit(here - nodes[1][1]))
            for k in range(1, self.order):
                t = 1.0
                for _ in range(3):
                    made = extrapolate(nodes, t)
                    if k >= len(made):
                        break
                    t /= max(metric.norm(made[k] - here), 0.5)
                else:
                    guesses.append(here + metric.unit(extrapolate(nodes, t)[k] - here))
        return min(guesses, key=lambda z: _misfit(scene, z[:-1], z[-1]))

    def _point(self, scene, point, found, metric, spent) -> Point | None:
        x, e = found.z[:-1], float(found.z[-1])
        line = found.z - point.z
        before = metric.unit(point.tangent)
        way = tangent(scene, x, e, found.system.factorise(), line, metric)
        if way is None:
            return None
        # A chord of a smooth path runs along the sum of the tangents at its ends, round a fold too.
        both, size = before + way, metric.norm(line)
        back = min(metric.dot(line, before), metric.dot(line, way)) <= 0
        if back or metric.dot(line, both) < self.forward * size * metric.norm(both):
            return None
        # (2.75), with a gentle growth. Where the path runs along one axis (at a fold Δe is almost
        # nothing) the other semi-axis would vanish and have to grow again step by step, so their
        # ratio stays within a factor of ten of the first.
        # What the noise costs to take back is no reason for shorter steps.
        easy = self.easy if self.noise is None else 2 * self.easy
        pace = np.clip(np.sqrt(easy / found.iterations), 0.5, np.sqrt(2))
        moved = np.array([displacement_size(scene, line[:-1]), abs(line[-1])])
        now, first = np.array([metric.a, metric.b]), np.array([self.a, self.b])
        share = np.clip(np.sqrt(2) * moved * pace, 0.5 * now, 2 * now) / first
        share = np.minimum(np.maximum(share, share.max() / 10), self.largest)
        control = tuple(float(c) for c in share * first)
        return Point(
            point.index + 1, e, x, way, metric, found.system.unstable, found.system.energy,
            spent, e - point.e, found.residual, control, (), point.past(),
        )  # fmt: skip


def _positive(stepper, *names: str) -> None:
    for name in names:
        if not getattr(stepper, name) > 0:
            raise ValueError(f"{name} = {getattr(stepper, name)}; expected a number > 0")


def _misfit(scene: Scene, x: np.ndarray, e: float) -> float:
    """‖R‖, inf where not admissible: what guesses are judged by (Eq. 2.74)."""
    R = scene.residual(x, e)
    return np.inf if R is None else float(np.linalg.norm(R))


def _start(scene: Scene, x: np.ndarray, e: float, rtol: float) -> NewtonResult:
    """An equilibrium near the guess; where Newton finds none, down the energy if there is one."""
    found = newton(scene, x, e, rtol=rtol, max_iterations=50, unstable=0)
    if found.converged or found.outcome is Outcome.INADMISSIBLE or not scene.symmetric:
        return found
    return found if scene.energy(x, e) is None else descend(scene, x, e, rtol=rtol)


def _first(scene, found: NewtonResult, along, metric, control) -> Point | Outcome:
    factor: Factor = found.system.factorise()
    way = tangent(scene, found.x, found.e, factor, along, metric)
    if way is None:
        return Outcome.SINGULAR
    return Point(
        0, found.e, found.x, way, metric, found.system.unstable, found.system.energy,
        found.iterations, 0.0, found.residual, control,
    )  # fmt: skip


def turned(point: Point) -> Point:
    """The same point, set to walk its path the other way."""
    return replace(point, tangent=-point.tangent, history=())
