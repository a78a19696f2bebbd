"""Evolution in time: states of a scene with viscous terms, step by step (Algorithms 6 and 7).

:func:`march` yields accepted states, :func:`evolve` collects them. Loads and growth are functions
of e = load(t); what remembers are the :class:`solver.viscous.term.Viscous` terms of the scene, each
of which is replaced by its successor at every step, and terms that learn from accepted states, such
as seals. A state holds all that the next step needs, so one that was saved continues to the
identical path. States, steps and their errors use each other's levels and stay in one file.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, fields, replace
from math import ceil
from pathlib import Path

import numpy as np

from solver.equilibrium.newton import newton
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.given import number, one_of, positive, whole
from solver.viscous.term import Memory, Past, marked, over_step, viscous

# Names of a memory's arrays in a file, in the order in which it gives them.
KEPT = tuple(field.name for field in fields(Memory))


class Unresolved(UserWarning):
    """A fixed step too long for what relaxes or grows (§5.4.3); the message has one that is not."""


@dataclass(frozen=True)
class TimeSteps:
    """How time is stepped.

    ``rtol``: Newton's, see :func:`solver.equilibrium.newton.newton`. ``step`` > 0: the fixed step,
    or where ``tolerance`` is given the first one, also after each break. ``tolerance``: largest
    error of a step, as a strain of the dashpots; the step then follows from it. ``order``: 1
    backward Euler, 2 BDF2 (first steps and those after a break are backward Euler's). ``smallest``,
    ``largest``: bounds of the step as fractions of ``step``.

    Raises ValueError for sizes that are not positive and orders that don't exist.
    """

    rtol: float
    step: float
    tolerance: float | None = None
    order: int = 2
    smallest: float = 1e-6
    largest: float = np.inf
    max_iterations: int = 25

    def __post_init__(self):
        positive(self, "rtol", "step", "smallest", "largest")
        if self.tolerance is not None:
            positive(self, "tolerance")
        whole("max_iterations", self.max_iterations, 1)
        if self.order not in (1, 2):
            raise ValueError(f"order = {self.order}; expected 1 (backward Euler) or 2 (BDF2)")


@dataclass(frozen=True, eq=False)
class Level:
    """An accepted instant: time, unknowns x (size,), a memory per viscous term, and a history per
    term that learns from accepted states (:func:`solver.viscous.term.marked`)."""

    t: float
    x: np.ndarray
    memories: tuple[Memory, ...]
    marks: tuple[np.ndarray, ...] = ()


@dataclass(frozen=True, eq=False)
class State:
    """A point of a path in time, with all that the next step needs.

    ``level``: this instant; ``past``: those before it since the last break, latest first, three at
    most. ``e``: the load seen at this instant. ``step``: what the next step will try. ``dt``,
    ``order``, ``iterations``, ``error`` (strain): of the step that ended here; ``dissipated``:
    energy taken by the dashpots in all; ``least``: smallest work on a dashpot in that step, per
    volume.
    """

    level: Level
    past: tuple[Level, ...] = ()
    e: float = 0.0
    index: int = 0
    step: float = 0.0
    dt: float = 0.0
    order: int = 0
    iterations: int = 0
    error: float = 0.0
    dissipated: float = 0.0
    least: float = 0.0

    @property
    def t(self) -> float:
        """Time."""
        return self.level.t

    @property
    def x(self) -> np.ndarray:
        """Unknowns of the scene, (size,)."""
        return self.level.x

    def save(self, path: str | Path) -> Path:
        """Writes the state as .npz, all of it or nothing."""
        path = Path(path)
        arrays = {}
        for k, level in enumerate((self.level, *self.past)):
            arrays[f"x{k}"], arrays[f"t{k}"] = level.x, np.array(level.t)
            for j, memory in enumerate(level.memories):
                names = [f"{name}{k}_{j}" for name in KEPT]
                arrays.update(zip(names, memory.arrays, strict=False))
            arrays |= {f"mark{k}_{j}": mark for j, mark in enumerate(level.marks)}
        rest = {f.name: getattr(self, f.name) for f in fields(self)[2:]}
        draft = path.with_name(f".{path.name}.part.npz")
        np.savez_compressed(draft, facts=np.array(json.dumps(rest)), **arrays)
        return draft.replace(path)

    @classmethod
    def load(cls, path: str | Path) -> State:
        """Reads what :meth:`save` wrote; raises ValueError for another file."""
        try:
            with np.load(path, allow_pickle=False) as file:
                facts = json.loads(str(file["facts"]))
                levels = []
                while f"t{len(levels)}" in file:
                    k = len(levels)
                    n = sum(name.startswith(f"strains{k}_") for name in file.files)
                    names = [[f"{name}{k}_{j}" for name in KEPT] for j in range(n)]
                    memories = tuple(
                        Memory(*(file[name] for name in row if name in file)) for row in names
                    )
                    n = sum(name.startswith(f"mark{k}_") for name in file.files)
                    marks = tuple(file[f"mark{k}_{j}"] for j in range(n))
                    levels.append(Level(float(file[f"t{k}"]), file[f"x{k}"], memories, marks))
        except (KeyError, ValueError, EOFError) as error:
            raise ValueError(f"{path} holds no saved state ({error}); give a State.save") from error
        return cls(levels[0], tuple(levels[1:]), **facts)


@dataclass(frozen=True)
class History:
    """Accepted states and why the path in time ended.

    ``detail``: what the last attempt to go on failed at, in words; empty where it ended on its
    time.
    """

    states: tuple[State, ...]
    outcome: Outcome
    detail: str = ""

    @property
    def last(self) -> State:
        """The last accepted state."""
        return self.states[-1]

    @property
    def reason(self) -> str:
        """Why the path ended, in words: the outcome's sentence and the detail."""
        return f"{self.outcome.value}; {self.detail}" if self.detail else self.outcome.value

    @property
    def reached(self) -> bool:
        """Whether the path ended at its time."""
        return self.outcome is Outcome.REACHED

    @property
    def times(self) -> np.ndarray:
        """t of all states."""
        return np.array([s.t for s in self.states])


def start(scene: Scene, t: float = 0.0, e: float = 0.0) -> State:
    """The undeformed state at rest."""
    memories = tuple(v.rest() for v in viscous(scene))
    marks = tuple(term.history for term in marked(scene))
    return State(Level(t, np.zeros(scene.size), memories, marks), e=e)


def march(
    scene: Scene,
    state: State,
    stepper: TimeSteps,
    *,
    until: float,
    load: Callable[[float], float] = lambda t: t,
    breaks: Sequence[float] = (),
    max_steps: int = 100_000,
) -> Generator[State, None, tuple[Outcome, str]]:
    """Yield the accepted states after ``state`` up to the time ``until``; returns the Outcome and
    what the last attempt failed at, in words.

    ``load``: e of the time, which loads and growth see. ``breaks``: times at which a load jumps;
    a step ends on each of them and still sees what was before the jump, and the next one starts
    anew from there. Of fixed steps that are too long for the shortest relaxation time (a tenth of
    it) or for the growth (0.01 of strain per step) an :class:`Unresolved` warning says so.

    Raises ValueError for a time that is not ahead, a state of another scene, and max_steps < 1.
    """
    terms = viscous(scene)
    one_of("state", State, state, "start(scene)")
    if not number("until", until) > state.t:
        raise ValueError(f"until = {until:g}; expected a time after the state's, {state.t:g}")
    whole("max_steps", max_steps, 1)
    _refuse_other(scene, state)
    if stepper.tolerance is None:
        warn_unresolved(terms, stepper.step, load, state.t, until)
    stops = sorted({b for b in breaks if state.t < b < until} | {until})
    jumps = set(breaks)
    scene.refuse_free_motion(state.x, load(state.t))
    for _ in range(max_steps):
        target = next(s for s in stops if s > state.t)
        following = _advance(scene, state, stepper, target, load, jumps)
        if not isinstance(following, State):
            return following
        state = following
        yield state
        if state.t == until:
            return Outcome.REACHED, ""
    return Outcome.MAX_STEPS, f"at t = {state.t:.6g} of {until:.6g}"


def evolve(scene: Scene, state: State, stepper: TimeSteps, **options) -> History:
    """All states of :func:`march`, with the same options; the given one is the first."""
    states = [state]
    walk = march(scene, state, stepper, **options)
    while True:
        try:
            states.append(next(walk))
        except StopIteration as stop:
            return History(tuple(states), *stop.value)


def stepped(scene: Scene, before: State, after: State) -> Scene:
    """The scene over the step from ``before`` to ``after``, two states in turn of one path.

    Its terms give the forces and energies of ``after``, :func:`solver.output.cell_fields` of its
    terms the stress, :func:`solver.equilibrium.reactions.reaction` what its supports carry; the
    terms of ``scene`` itself know only their own first step. Raises ValueError for states that do
    not follow each other, or of another scene.
    """
    if after.index != before.index + 1 or not np.isclose(after.t - before.t, after.dt):
        raise ValueError(
            f"states {before.index} at t = {before.t:g} and {after.index} at t = {after.t:g} do "
            "not follow each other; give a state of a path and the one after it"
        )
    _refuse_other(scene, before)
    return over_step(scene, _pasts(before, after.dt, after.order), before.level.marks)


def warn_unresolved(terms, dt: float, load, t: float, until: float) -> None:
    """Warns where dt is more than the guidelines of §5.4.3 allow, and says what would do."""
    e = load(t)
    for term in terms:
        shape, points = term.body.weights.shape, term.body.points
        tau = term.shortest_time(e)
        if dt > 0.1 * tau * (1 + 1e-9):
            warnings.warn(
                f"dt = {dt:.3g} does not resolve the shortest relaxation time of term "
                f"{term.name!r}, {tau:.3g}; take dt <= {0.1 * tau:.3g}, or give a tolerance",
                Unresolved,
                stacklevel=3,
            )
        if term.growth is None:
            continue
        most = min(dt, until - t)
        times = np.linspace(t, until - most, 11)
        rate = 0.0
        for a in times:
            before, after = (
                np.linalg.inv(term.growth.evaluate(load(s), shape, points)[0])
                for s in (a, a + most)
            )
            rate = max(rate, float(np.abs(after - before).max()) / most)
        if rate * dt > 0.01 * (1 + 1e-9):
            warnings.warn(
                f"dt = {dt:.3g} lets term {term.name!r} grow by {rate * dt:.2g} in a step; take "
                f"dt <= {0.01 / rate:.3g}, or give a tolerance",
                Unresolved,
                stacklevel=3,
            )


def _refuse_other(scene: Scene, state: State) -> None:
    level = state.level
    has = len(state.x), len(level.memories), len(level.marks)
    needs = scene.size, len(viscous(scene)), len(marked(scene))
    if has != needs:
        raise ValueError(
            f"the state has {has[0]} unknowns, {has[1]} memories and {has[2]} histories of others, "
            f"the scene {needs[0]}, {needs[1]} and {needs[2]}; it belongs to another scene"
        )


def _pasts(state: State, dt: float, order: int) -> list[Past]:
    """What a step of dt from a state starts from, of each viscous term."""
    if order == 1:
        return [Past(memory, dt) for memory in state.level.memories]
    last = state.past[0]
    pairs = zip(state.level.memories, last.memories, strict=True)
    return [Past(memory, dt, earlier, state.t - last.t) for memory, earlier in pairs]


def _advance(scene, state, stepper, target, load, jumps) -> State | tuple[Outcome, str]:
    step = state.step if state.step > 0 else stepper.step
    spent, failed, t = 0, None, state.t
    while step >= stepper.smallest * stepper.step:
        remaining = target - state.t
        # The last two steps are equal; fixed steps keep to their size.
        if stepper.tolerance is None:
            dt = remaining if remaining < step * (1 + 1e-6) else step
        else:
            dt = remaining / ceil(remaining / step - 1e-9) if remaining < 2 * step else step
        t = target if dt >= remaining * (1 - 1e-12) else state.t + dt
        e = load(np.nextafter(t, -np.inf) if t in jumps else t)
        attempt = _attempt(scene, state, stepper, t, dt, e)
        if isinstance(attempt, State):
            error = attempt.error
            if stepper.tolerance is not None:
                power = 1 / (attempt.order + 1)
                factor = 0.9 * (stepper.tolerance / max(error, 1e-300)) ** power
                if error > stepper.tolerance * 1.2 and state.past:
                    spent += attempt.iterations
                    step = dt * max(0.2, factor)
                    continue
                following = dt * min(2.0, max(0.2, factor))
                following = min(following, stepper.largest * stepper.step)
            else:
                following = min(stepper.step, 4 * step)
            landed = t in jumps
            return replace(
                attempt,
                step=stepper.step if landed else following,
                past=() if landed else attempt.past,
                iterations=attempt.iterations + spent,
            )
        failed = attempt
        spent += failed.iterations
        step = dt / 4
    if failed is None:
        return Outcome.MIN_STEP, f"no step from t = {state.t:.6g} keeps to the tolerance"
    if failed.outcome is Outcome.DISSIPATION:
        return failed.outcome, f"at t = {state.t:.6g}"
    return Outcome.MIN_STEP, f"the last try, to t = {t:.6g}, failed: {failed.why()}"


@dataclass(frozen=True, eq=False)
class _Failed:
    """An attempt that came to no state: where it ended, x at e of the scene over the step."""

    outcome: Outcome
    iterations: int
    scene: Scene
    x: np.ndarray
    e: float

    def why(self) -> str:
        """In words, as far as the state tells."""
        return self.scene.obstacle(self.x, self.e) or self.outcome.value


def _attempt(scene, state, stepper, t, dt, e) -> State | _Failed:
    """The step to t, with second order where that is possible."""
    spent = 0
    failed = _Failed(Outcome.NOT_CONVERGED, 0, scene, state.x, e)
    for order in range(min(stepper.order, 1 + len(state.past)), 0, -1):
        pasts = _pasts(state, dt, order)
        if not all(past.sound for past in pasts):
            continue
        now = over_step(scene, pasts, state.level.marks)
        following = viscous(now)
        for guess in _guesses(state, t):
            result = newton(
                now, guess, e, rtol=stepper.rtol, max_iterations=stepper.max_iterations,
                unstable=0, fresh=False,
            )  # fmt: skip
            spent += result.iterations
            failed = _Failed(result.outcome, spent, now, result.x, e)
            if result.converged:
                break
        else:
            return failed
        u = scene.displacement(result.x, e)
        memories = tuple(term.memory(u, e) for term in following)
        if any(memory is None for memory in memories):
            return replace(failed, outcome=Outcome.INADMISSIBLE)
        marks = tuple(term.after(u) for term in marked(now))
        level = Level(t, result.x, memories, marks)
        losses = [term.dissipation(m, e) for term, m in zip(following, memories, strict=True)]
        works = [work for _, work in losses]
        taken, worked = (
            sum(term.integral(v[k].sum(-1), e) for term, v in zip(following, losses, strict=True))
            for k in (0, 1)
        )
        least = min(
            (float(w[term.ids].min()) for term, w in zip(following, works, strict=True) if w.size),
            default=0.0,
        )
        if not _dissipates(works, worked, order):
            failed = replace(failed, outcome=Outcome.DISSIPATION)
            continue
        past = (state.level, *state.past)[:3]
        return State(
            level, past, e, state.index + 1, 0.0, dt, order, spent,
            _error(level, past, order), state.dissipated + taken, least,
        )  # fmt: skip
    return failed


def _dissipates(works, total, order) -> bool:
    """Whether the dashpots took energy: in all, and each at every point with backward Euler."""
    largest = max((float(np.abs(w).max(initial=0.0)) for w in works), default=0.0)
    scale = sum(float(np.abs(w).sum()) for w in works)
    if not np.isfinite(scale) or (total < 0 and -total > 1e-9 * max(abs(scale), 1e-300)):
        return False
    return order == 2 or all(w.min(initial=0.0) >= -1e-9 * largest for w in works)


def _guesses(state: State, t: float) -> list[np.ndarray]:
    """Unknowns extrapolated through the past, and those of the state itself."""
    levels = (state.level, *state.past)[:3]
    guess = np.zeros_like(state.x)
    for a in levels:
        weight = np.prod([(t - b.t) / (a.t - b.t) for b in levels if b is not a])
        guess += weight * a.x
    return [guess, state.x] if len(levels) > 1 else [state.x]


def _error(level: Level, past: tuple[Level, ...], order: int) -> float:
    """Estimated error of a step as a strain ½ ΔC of the dashpots, and as a log stretch of growth
    that answers to stress, from divided differences.

    Backward Euler: ½ dt² C″. BDF2: dt³ (1 + r)²/(6 r (1 + 2r)) C‴, r the ratio of the steps; where
    the past is too short for C‴, backward Euler's. 0 where it is too short for that.
    """
    levels = (level, *past)
    need = min(order + 2, len(levels))
    if need < 3:
        return 0.0
    levels = levels[:need]
    dt = levels[0].t - levels[1].t
    weights = [np.prod([1 / (a.t - b.t) for b in levels if b is not a]) for a in levels]
    if need == 3:
        factor = dt * dt
    else:
        r = dt / (levels[1].t - levels[2].t)
        factor = dt**3 * (1 + r) ** 2 / (r * (1 + 2 * r))
    most = 0.0
    for j, memory in enumerate(level.memories):
        strains = sum(w * a.memories[j].strains for w, a in zip(weights, levels, strict=True))
        most = max(most, float(np.abs(strains).max(initial=0.0)))
        if memory.growth is not None:
            growth = sum(w * a.memories[j].growth for w, a in zip(weights, levels, strict=True))
            most = max(most, 2 * float(np.abs(growth).max(initial=0.0)))
    return factor * most / 2
