"""Loss of stability: fold and branch points located, branches switched, stable paths followed.

An equilibrium is stable if its stiffness, on the states that the rows allow, has no negative
eigenvalue; the factorisation counts them. Between two points whose counts differ an eigenvalue
passes zero. At a fold the load turns back there, ∂R/∂e has a part along the critical vector; at a
branch point it has none, the load goes on and a second path crosses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from solver.equilibrium.descent import critical_mode
from solver.equilibrium.linear import SingularMatrix
from solver.equilibrium.linesearch import largest
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.paths.arc import NotFollowed, Plane, between, correct, tangent
from solver.paths.point import Point, displacement_size

# Width of the final bracket of an event, as a fraction of the step that contains it.
RESOLUTION = 1e-5


@dataclass(frozen=True, eq=False)
class Event:
    """Something that happened between two points.

    ``kind``: ``fold`` or ``branch``, located on the path; ``snap`` or ``bifurcation``: what a
    stable path did at one, the state being the one it came to. ``e``, ``x`` (size,). ``vector``
    (size,): critical mode, 1 in the Euclidean norm; of a snap or bifurcation its displacement.
    ``fraction``: where on the line between the points. ``unstable``: modes before and after.
    ``sees_load``: cosine between the critical vector and ∂R/∂e, 0 at a branch point. ``tangent``
    (size + 1,) of the path. ``size``: max|Δu| / length of a snap; ``energy_drop``: what the energy
    fell by in it.
    """

    kind: str
    e: float
    x: np.ndarray
    vector: np.ndarray
    fraction: float = 0.0
    unstable: tuple[int | None, int | None] = (None, None)
    sees_load: float = 0.0
    tangent: np.ndarray | None = None
    size: float = 0.0
    energy_drop: float = 0.0


@dataclass(eq=False)
class _Probe:
    """A point at a fraction of the step, with its critical mode."""

    fraction: float
    point: Point
    value: float | None
    vector: np.ndarray | None


def locate(scene: Scene, before: Point, after: Point, *, rtol: float) -> tuple[Event, ...]:
    """Fold and branch points between two neighbours of a path, in order.

    Where the direction of the load turns there is a fold. Where the count of unstable modes changes
    otherwise there is a branch point. Changes that undo each other within the step are not seen.
    Empty where nothing changed or the path between could not be followed.
    """
    start, end = (_Probe(s, p, None, None) for s, p in ((0.0, before), (1.0, after)))
    if not _differ(start, end):
        return ()
    return tuple(_search(scene, before, after, start, end, rtol))


def _differ(p: _Probe, q: _Probe) -> bool:
    counts = (p.point.unstable, q.point.unstable)
    return _turns(p, q) or (None not in counts and counts[0] != counts[1])


def _turns(p: _Probe, q: _Probe) -> bool:
    return p.point.tangent[-1] * q.point.tangent[-1] < 0


def _probe(scene, before, after, fraction, rtol) -> _Probe | None:
    made = between(scene, before, after, fraction, rtol=rtol)
    if made is None:
        return None
    point, factor = made
    try:
        return _Probe(fraction, point, *critical_mode(scene, factor, sweeps=30))
    except SingularMatrix:
        return _Probe(fraction, point, None, None)


def _search(scene, before, after, low: _Probe, high: _Probe, rtol) -> list[Event]:
    """Events between two probes that differ: one is bracketed, then each side of it is searched."""
    if high.fraction - low.fraction <= 4 * RESOLUTION or not _differ(low, high):
        return []
    fold = _turns(low, high)
    first = low.point.unstable

    def gap(probe):
        """Changes sign at the event looked for."""
        if fold:
            return probe.point.tangent[-1]
        size = 1.0 if probe.value is None else abs(probe.value)
        return size if probe.point.unstable == first else -size

    seen = {low.fraction: low, high.fraction: high}

    def probed(fraction):
        if fraction not in seen:
            seen[fraction] = _probe(scene, before, after, fraction, rtol)
        return seen[fraction]

    def at(fraction):
        probe = probed(fraction)
        if probe is None:
            raise NotFollowed(f"no equilibrium was found at {fraction:.3g} of the step")
        return probe

    def bounded(fraction):
        probe = at(fraction)
        if probe.value is None and fraction in (low.fraction, high.fraction) and not fold:
            # The ends come without their mode; a size like the neighbour's keeps the secant sane.
            middle = probed(0.5 * (low.fraction + high.fraction))
            size = 1.0 if middle is None or middle.value is None else abs(middle.value)
            return size if probe.point.unstable == first else -size
        return gap(probe)

    left = right = None
    try:
        root = brentq(bounded, low.fraction, high.fraction, xtol=RESOLUTION / 4, rtol=1e-12)
    except (NotFollowed, RuntimeError):
        # Close to a singular point a thin structure's corrections may not settle: then it is where
        # they don't.
        root = next((fraction for fraction, p in reversed(seen.items()) if p is None), None)
        if root is None:
            left, right = _bracket(seen, bounded, low, high)
    half = RESOLUTION / 2
    while half < 0.1 and (left is None or right is None):
        try:
            if left is None:
                probe = at(max(root - half, low.fraction))
                left = probe if gap(probe) * bounded(low.fraction) > 0 else None
            if right is None:
                probe = at(min(root + half, high.fraction))
                right = probe if gap(probe) * bounded(high.fraction) > 0 else None
        except NotFollowed:
            pass
        half *= 3
    if left is None or right is None:
        left, right = _bracket(seen, bounded, low, high)
    if left is None or right is None:
        return []
    event = _event(scene, left, right, fold)
    return [
        *_search(scene, before, after, low, left, rtol),
        *([event] if event is not None else []),
        *_search(scene, before, after, right, high, rtol),
    ]


def _bracket(seen, gap, low: _Probe, high: _Probe) -> tuple[_Probe, _Probe]:
    """The closest pair of probes, of those that were reached, with a change of sign of ``gap``."""
    probes = [p for fraction, p in sorted(seen.items()) if p is not None]
    same = [p for p in probes if gap(p.fraction) * gap(low.fraction) > 0]
    left = max(same, key=lambda p: p.fraction)
    right = min(
        (p for p in probes if p.fraction > left.fraction), key=lambda p: p.fraction, default=high
    )
    return left, right


def _event(scene: Scene, left: _Probe, right: _Probe, fold: bool) -> Event | None:
    """The event between two close probes, by straight lines between them."""
    p, q = left.point, right.point
    ends = (p.tangent[-1], q.tangent[-1]) if fold else (left.value, right.value)
    w = 0.5
    if None not in ends and ends[0] * ends[1] < 0:
        w = ends[0] / (ends[0] - ends[1])
    vector = left.vector if left.vector is not None else right.vector
    if vector is None:
        return None
    z = (1 - w) * p.z + w * q.z
    x, e = z[:-1], float(z[-1])
    rate = scene.load_rate(x, e, 1e-3 * p.metric.b)
    sees = 0.0
    if rate is not None and np.linalg.norm(rate[: scene.n_free]) > 0:
        sees = float(abs(vector @ rate) / np.linalg.norm(rate[: scene.n_free]))
    return Event(
        "fold" if fold else "branch", e, x, vector, (1 - w) * left.fraction + w * right.fraction,
        (p.unstable, q.unstable), sees, p.metric.unit(p.tangent + q.tangent),
    )  # fmt: skip


def switch(
    scene: Scene, event: Event, near: Point, *, rtol: float, amplitude: float = 1e-2, side: int = 1
) -> Point | Outcome:
    """A point on the second path through a branch point, on one of its two sides.

    ``near``: a point of the first path beside the event; it gives sizes and step control.
    ``amplitude``: how far along the critical vector, max|Δu| / length; halved until a point is
    found. Following it leads away from the branch point. Returns Outcome.NO_BRANCH where there is
    none.

    Raises ValueError for an event that is no branch point.
    """
    if event.kind != "branch":
        raise ValueError(f"a {event.kind} has no second path; switch at an event of kind 'branch'")
    mode = np.append(event.vector / largest(event.vector), 0.0) * scene.scales.length * side
    metric, here = near.metric, np.append(event.x, event.e)
    size = displacement_size(scene, mode[:-1])
    for _ in range(8):
        # Across the first path, so that it can't be found again; measured by the mode's own size,
        # beside which a straight column hardly moves along its path.
        own = metric.sized(amplitude * size, metric.b)
        along = own.unit(event.tangent)
        line = amplitude * (mode - own.dot(mode, along) * along)
        result = correct(
            scene,
            here + line,
            Plane(here + line, own.row(line)),
            rtol=rtol,
            load_size=metric.b,
            max_iterations=20,
        )
        if result.converged and own.norm(result.z - here) < 10:
            x, e = result.z[:-1], float(result.z[-1])
            way = tangent(scene, x, e, result.system.factorise(), line, own)
            if way is not None:
                return Point(
                    near.index + 1, e, x, way, metric, result.system.unstable, result.system.energy,
                    result.iterations, e - event.e, result.residual,
                )  # fmt: skip
        amplitude /= 2
    return Outcome.NO_BRANCH
