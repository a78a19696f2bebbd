"""Stable steps that don't locate, and descend, on functions whose wells and saddles are known."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from path_toys import column, function_scene, truss, truss_load

from solver.equilibrium.descent import descend
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.paths import stable
from solver.paths.continuation import follow, load, trace
from solver.paths.point import Ended
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps

LIMIT = 1.905435952e-4  # references.md §6: von Mises truss, P/2EA at H/a = 0.1


def settled(scene, until, step):
    stepper = StableSteps(LoadSteps(1e-10, step, cut=4.0), locate=False)
    start = np.zeros(scene.size)
    return trace(scene, start, stepper, until=load(until), max_steps=100, events=False)


def test_beyond_a_fold_the_path_falls_into_the_well_on_the_other_side():
    scene = truss()
    path = settled(scene, 4e-4, 4e-5)
    assert path.reached
    (snap,) = path.events
    assert snap.kind == "snap"
    at = next(k for k, p in enumerate(path.points) if p.events)
    before, after = path.points[at - 1], path.points[at]
    # The loss of stability is known to one load step.
    assert before.e < LIMIT < after.e < before.e + 4e-5
    # The crown hangs below its supports, where the same load is carried on a rising branch.
    assert -after.x[0] > 0.2
    assert truss_load(-after.x[0]) == pytest.approx(after.e, abs=1e-13)
    assert snap.size == pytest.approx((before.x[0] - after.x[0]) / 2)
    # What fell is the energy at the load of the fall.
    drop = scene.energy(before.x, after.e) - scene.energy(after.x, after.e)
    assert snap.energy_drop == pytest.approx(drop) and drop > 0
    assert {p.unstable for p in path.points} == {0}


@pytest.mark.parametrize("locate", [False, True])
def test_a_fall_ends_at_the_target_and_not_beyond_it(locate):
    scene, target = truss(), 1.001 * LIMIT
    stepper = StableSteps(LoadSteps(1e-10, 4e-5, cut=4.0), locate=locate)
    seen = []
    for point in follow(scene, np.zeros(scene.size), stepper, until=load(target), max_steps=30):
        seen.append(point)
    assert max(p.e for p in seen) == seen[-1].e == target
    assert -seen[-1].x[0] > 0.2 and seen[-1].events[-1].kind == "snap"


def test_the_work_of_the_first_descent_is_counted():
    scene, x, steps = truss(), np.array([-0.02]), LoadSteps(1e-10, 4e-5)
    fallen = descend(scene, x, 0.0, rtol=1e-10, reach=0.1, max_iterations=600)
    after = steps.begin(scene, fallen.x, 0.0, 1.0)
    point = StableSteps(steps).begin(scene, x, 0.0, 1.0)
    assert point.iterations == fallen.iterations + after.iterations > after.iterations


def test_a_step_that_fails_is_cut_once_before_the_arc_is_followed(monkeypatch):
    right, tried = LoadSteps._solve, []

    def solve(steps, scene, point, e, field):
        tried.append(e - point.e)
        return replace(right(steps, scene, point, e, field), outcome=Outcome.NOT_CONVERGED)

    stepper = StableSteps(LoadSteps(1e-10, 4e-5, first=1.0, cut=10.0))
    scene = truss()
    point = stepper.begin(scene, np.zeros(1), 0.0, 1.0)
    monkeypatch.setattr(LoadSteps, "_solve", solve)
    stepper.advance(scene, point, 1e-3)
    assert tried == pytest.approx([4e-5, 4e-6])


def test_a_fall_of_which_no_event_was_located_is_a_snap(monkeypatch):
    monkeypatch.setattr(ArcLength, "advance", lambda *_: Ended(Outcome.MIN_STEP))
    monkeypatch.setattr(stable, "locate", lambda *_, **__: ())
    stepper = StableSteps(LoadSteps(1e-10, 4e-5, cut=4.0))
    path = trace(truss(), np.zeros(1), stepper, until=load(4e-4), max_steps=60, events=False)
    assert path.reached and -path.last.x[0] > 0.2
    assert {event.kind for event in path.events} == {"snap"}


def test_a_step_that_newton_could_not_take_is_no_snap():
    # One iteration never is enough on e = q⁵ + q, so the energy has to fall at each step.
    scene = function_scene(
        1,
        lambda q, e: q[0] ** 6 / 6 + q[0] ** 2 / 2 - e * q[0],
        lambda q, e: q**5 + q - e,
        lambda q, e: np.array([[5 * q[0] ** 4 + 1]]),
    )
    stepper = StableSteps(
        LoadSteps(1e-10, 0.1, max_iterations=1, cut=4.0), cuts=0, far=0.01, locate=False
    )
    points = list(follow(scene, np.zeros(1), stepper, until=load(2.0), max_steps=99, events=False))
    assert points[-1].e == 2.0
    assert max(p.iterations for p in points) > 2  # the energy did fall on the way
    assert any(abs(q.x[0] - p.x[0]) > stepper.far for p, q in pairwise(points))
    for p in points:
        assert p.events == ()
        assert p.x[0] ** 5 + p.x[0] == pytest.approx(p.e, abs=1e-8)


def test_a_column_goes_over_where_its_straight_state_is_no_longer_stable():
    scene = column(1.0, cubic=1.0)
    path = settled(scene, 1.5, 0.04)
    assert path.reached and {p.unstable for p in path.points} == {0}
    (event,) = path.events
    at = next(k for k, p in enumerate(path.points) if p.events)
    assert path.points[at - 1].e <= 1.0 < path.points[at].e < 1.05
    assert event.unstable[1] == 0
    t = path.last.x[0]
    assert abs(t) > 0.3
    assert t + t**3 == pytest.approx(1.5 * np.sin(t), abs=1e-9)


def test_a_hard_column_bends_over_without_a_snap():
    # Beyond e = k its angle is √((e − k)/cubic): a step leads to a neighbour, not far away.
    path = settled(column(1.0, cubic=1e3), 1.2, 0.04)
    assert [event.kind for event in path.events] == ["bifurcation"]


def valley(depth=1.0, bend=5.0):
    """Two wells q₀ = ±1 joined by a bent narrow valley; a saddle at the origin."""
    k = 1e4

    def parts(q):
        return q[1] - bend * (q[0] ** 2 - 1), -2 * bend * q[0]

    def energy(q, e):
        return depth * (q[0] ** 2 - 1) ** 2 / 4 + k * parts(q)[0] ** 2 / 2

    def gradient(q, e):
        off, slope = parts(q)
        return np.array([depth * q[0] * (q[0] ** 2 - 1) + k * off * slope, k * off])

    def hessian(q, e):
        off, slope = parts(q)
        first = depth * (3 * q[0] ** 2 - 1) + k * slope**2 - 2 * bend * k * off
        return np.array([[first, k * slope], [k * slope, k]])

    return function_scene(2, energy, gradient, hessian)


@pytest.mark.parametrize("start", [[0.0, -5.0], [0.2, -4.8], [-0.2, -4.8], [0.3, 5.0]])
@pytest.mark.parametrize("reach", [0.02, 0.1])
def test_the_bottom_of_a_narrow_bent_valley_is_found_downhill(start, reach):
    scene = valley()
    start = np.array(start)
    result = descend(scene, start, 0.0, rtol=1e-9, reach=reach, max_iterations=5000)
    assert result.outcome is Outcome.CONVERGED
    assert result.system.unstable == 0
    assert np.abs(result.x[0]) == pytest.approx(1, abs=1e-6)
    assert result.x[1] == pytest.approx(0, abs=1e-6)
    if start[0]:
        assert np.sign(result.x[0]) == np.sign(start[0])


def test_the_energy_never_rises_on_the_way_down():
    scene, seen = valley(), []
    start = np.array([0.2, -4.8])
    for most in range(1, 300, 5):
        result = descend(scene, start, 0.0, rtol=1e-9, reach=0.2, max_iterations=most)
        seen.append(scene.energy(result.x, 0.0))
        if result.converged:
            break
    assert result.converged and most > 30  # the body flowed, beyond damped Newton steps
    assert np.all(np.diff(seen) <= 1e-12 * seen[0])


@pytest.mark.parametrize("reach", [0.02, 0.1])
def test_the_work_of_a_flow_is_counted(reach, monkeypatch):
    factorised, spent = Scene.factorised, []

    def counted(scene, values):
        spent.append(1)
        return factorised(scene, values)

    monkeypatch.setattr(Scene, "factorised", counted)
    start = np.array([0.2, -4.8])
    result = descend(valley(), start, 0.0, rtol=1e-9, reach=reach, max_iterations=5000)
    assert result.converged and len(spent) > 60  # far beyond damped Newton steps
    assert result.iterations == pytest.approx(len(spent), rel=0.1)


def test_a_saddle_is_left_and_a_flat_top_is_too():
    scene = truss()
    # The flat truss carries nothing: an equilibrium with one unstable mode.
    result = descend(scene, np.array([-0.1]), 0.0, rtol=1e-10)
    assert result.converged and result.system.unstable == 0
    assert min(abs(result.x[0]), abs(result.x[0] + 0.2)) < 1e-9


@pytest.mark.parametrize("tilt", [-0.5, 0.5])
def test_a_saddle_is_left_to_the_side_where_the_energy_is_lower(tilt):
    scene = function_scene(
        1,
        lambda q, e: -(q[0] ** 2) / 2 + tilt * q[0] ** 3 / 3 + q[0] ** 4 / 4,
        lambda q, e: -q + tilt * q**2 + q**3,
        lambda q, e: np.array([[-1 + 2 * tilt * q[0] + 3 * q[0] ** 2]]),
    )
    result = descend(scene, np.zeros(1), 0.0, rtol=1e-10)
    assert result.converged and result.system.unstable == 0
    # The deeper one of the roots of q² + tilt q = 1.
    deeper = -np.sign(tilt) * (abs(tilt) + np.sqrt(tilt**2 + 4)) / 2
    assert result.x[0] == pytest.approx(deeper, abs=1e-8)


def test_an_energy_without_a_floor_is_an_outcome():
    def bottomless(power):
        return function_scene(
            1,
            lambda q, e: q[0] ** 2 / 2 - e * q[0] ** power,
            lambda q, e: q - e * power * q ** (power - 1),
            lambda q, e: np.array([[1 - e * power * (power - 1) * q[0] ** (power - 2)]]),
        )

    endings = (Outcome.NO_STABLE_STATE, Outcome.NO_PROGRESS)
    for power in (2, 4):
        result = descend(bottomless(power), np.array([0.7]), 1.0, rtol=1e-9, max_iterations=200)
        assert result.outcome in endings
    # With the square the only equilibrium turns unstable at e = ½: there the path ends.
    path = settled(bottomless(2), 1.0, 0.1)
    assert path.outcome in endings
    assert path.last.e < 0.5 and path.last.unstable == 0


def test_a_saddle_is_left_along_its_lowest_mode_not_the_one_nearest_to_zero():
    # Curvatures −1e-2 along q₀, whose wells are at ±0.1, and 1e-4 along q₁.
    scene = function_scene(
        2,
        lambda q, e: -1e-2 * q[0] ** 2 / 2 + q[0] ** 4 / 4 + 1e-4 * q[1] ** 2 / 2,
        lambda q, e: np.array([-1e-2 * q[0] + q[0] ** 3, 1e-4 * q[1]]),
        lambda q, e: np.diag([-1e-2 + 3 * q[0] ** 2, 1e-4]),
    )
    result = descend(scene, np.zeros(2), 0.0, rtol=1e-10)
    assert result.converged and result.system.unstable == 0
    assert np.abs(result.x) == pytest.approx([0.1, 0.0], abs=1e-8)
