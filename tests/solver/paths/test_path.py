"""Load steps and arc length, on scenes with known answers.

The scenes are bars and plain functions (path_toys), so that what is tested is the path following
and not the elements; the last test takes a real strip that folds itself.
"""

from dataclasses import replace

import numpy as np
import pytest
import skfem
from path_toys import (
    carousel,
    function_scene,
    truss,
    truss_load,
    truss_on_spring,
)

from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene, System
from solver.mesh.body import Body
from solver.paths import arc
from solver.paths.arc import between
from solver.paths.continuation import follow, load, trace
from solver.paths.point import Metric
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps, turned
from solver.physics.elastic import Elastic
from solver.physics.growth import Isotropic, Orthotropic
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, translation_row

# references.md §6: von Mises truss, engineering strain, P/2EA at H/a = 0.1
LIMIT = 1.905435952e-4
TRUSS_ARC = ArcLength(1e-10, a=0.02, b=2e-5)


def rest(scene):
    return np.zeros(scene.size)


def kinds(path):
    return [event.kind for event in path.events]


# -- arc length -------------------------------------------------------------------------------


def test_truss_limit_points_and_the_whole_curve():
    scene = truss()
    path = trace(scene, rest(scene), TRUSS_ARC, until=load(4e-4), max_steps=100)
    assert path.reached
    assert path.last.e == 4e-4
    assert kinds(path) == ["fold", "fold"]
    up, down = path.events
    assert up.e == pytest.approx(LIMIT, rel=1e-9)
    assert down.e == pytest.approx(-LIMIT, rel=1e-9)
    assert (up.unstable, down.unstable) == ((0, 1), (1, 0))
    assert up.sees_load == pytest.approx(1)
    for p in path.points:
        assert truss_load(-p.x[0]) == pytest.approx(p.e, abs=1e-13)
        assert p.unstable == (1 if -up.x[0] < -p.x[0] < -down.x[0] else 0)
    drop = [-p.x[0] for p in path.points]
    assert np.all(np.diff(drop) > 0)  # no doubling back
    assert len(path.points) < 24
    assert path.iterations < 80


@pytest.mark.parametrize("size", [0.5, 2, 4, 8])
def test_large_arcs_keep_to_the_path(size):
    scene = truss()
    arc = ArcLength(1e-10, a=0.05 * size, b=5e-5 * size)
    path = trace(scene, rest(scene), arc, until=load(4e-4), max_steps=100)
    assert path.reached
    assert kinds(path) == ["fold", "fold"]
    assert np.all(np.diff([p.x[0] for p in path.points]) < 0)


def test_snap_back_behind_a_soft_spring():
    stiffness = 1e-3
    scene = truss_on_spring(stiffness)
    stepper = ArcLength(1e-10, a=0.02, b=0.02)
    path = trace(scene, rest(scene), stepper, until=load(0.6), max_steps=100)
    # The spring's end moves by w + P/k; its extremes from the closed form of P(w) on a fine grid
    w = np.linspace(0, 0.25, 400001)
    end = w + 2 * truss_load(w) / stiffness
    turns = np.flatnonzero(np.diff(np.sign(np.diff(end)))) + 1
    assert path.reached
    assert [ev.e for ev in path.events] == pytest.approx(list(end[turns]), rel=1e-8)
    assert len(path.points) < 36
    assert min(path.loads) < -0.2  # driven back beyond where it began


def test_a_stiff_spring_makes_the_path_one_to_one():
    scene = truss_on_spring(1.0)
    path = trace(scene, rest(scene), LoadSteps(1e-10, 0.02), until=load(0.25), max_steps=100)
    assert path.reached
    assert path.events == ()


def test_the_semi_axes_keep_their_ratio_where_nothing_moves():
    scene = function_scene(
        1, lambda q, e: q[0] ** 2 / 2, lambda q, e: q, lambda q, e: np.ones((1, 1))
    )
    path = trace(scene, rest(scene), ArcLength(1e-10, a=0.1, b=0.1), until=load(5), max_steps=99)
    assert path.reached
    for p in path.points:
        assert p.control[0] >= 0.0999 * p.control[1]


def test_folds_of_an_unsymmetric_scene_are_located_without_counts():
    # R = (q₁ − q₀, q₀³ − q₀ − e): e = q₀³ − q₀ turns at q₀ = ∓ 1/√3
    scene = function_scene(
        2,
        None,
        lambda q, e: np.array([q[1] - q[0], q[0] ** 3 - q[0] - e]),
        lambda q, e: np.array([[-1.0, 1.0], [3 * q[0] ** 2 - 1, 0.0]]),
        symmetric=False,
    )
    start = np.array([-1.0, -1.0])
    path = trace(scene, start, ArcLength(1e-10, a=0.1, b=0.1), until=load(1.0), max_steps=99)
    assert path.reached
    assert kinds(path) == ["fold", "fold"]
    turn = 2 / (3 * np.sqrt(3))
    assert [ev.e for ev in path.events] == pytest.approx([turn, -turn], rel=1e-8)
    assert {p.unstable for p in path.points} == {None}
    assert path.last.x == pytest.approx([1.3247179572] * 2, abs=1e-9)


def test_a_closed_path_without_energy_is_walked_round_once():
    scene = carousel()
    phi = 0.7
    start = np.array([np.cos(phi), np.sin(phi)])
    stepper = ArcLength(1e-10, a=0.1, b=0.1)
    steps = follow(scene, start, stepper, e=np.sin(phi) ** 2, max_steps=200, until=lambda p: 1.0)
    points = []
    for p in steps:
        points.append(p)
        angle = np.unwrap([np.arctan2(p.x[1], p.x[0]) for p in points])
        if angle[-1] - angle[0] > 2 * np.pi:
            break
    assert np.all(np.diff(angle) > 0)
    events = [ev for p in points for ev in p.events]
    assert [ev.kind for ev in events] == ["fold"] * 4
    assert [ev.e for ev in events] == pytest.approx([1, 0, 1, 0], abs=1e-8)
    for p in points:
        assert np.hypot(*p.x) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("until", [load(1.5e-4), lambda p: p.x[0] + 0.1])
def test_an_arc_starts_with_falling_load_where_it_is_told_to(until):
    # The snapped truss, free of load, is pushed back up: round its fold at −LIMIT, over the flat
    # state, to a load of 1.5e-4 that it also has on the branch where it sets out.
    scene, snapped = truss(), np.array([-0.2])
    falling = replace(TRUSS_ARC, direction=-1)
    path = trace(scene, snapped, falling, until=until, max_steps=100)
    assert path.reached
    assert path.points[0].x[0] == pytest.approx(-0.2, abs=1e-12)
    assert path.points[1].e < 0 < path.points[1].x[0] + 0.2
    (fold,) = path.events
    assert fold.kind == "fold" and fold.e == pytest.approx(-LIMIT, rel=1e-9)
    assert -path.last.x[0] <= 0.1 + 1e-9
    assert truss_load(-path.last.x[0]) == pytest.approx(path.last.e, abs=1e-13)
    # Towards the target it goes the short way; a restart goes on as the path was walked.
    short = trace(scene, snapped, TRUSS_ARC, until=load(1.5e-4), max_steps=100)
    assert short.reached and -short.last.x[0] > 0.2 and short.events == ()
    half = trace(scene, snapped, falling, until=until, max_steps=len(path.points) - 2)
    again = trace(scene, half.last, falling, until=until, max_steps=100)
    assert half.last.tangent[-1] > 0 and np.array_equal(again.last.x, path.last.x)


def test_a_path_from_a_point_of_another_tells_only_its_own_events():
    scene = truss()
    whole = trace(scene, rest(scene), TRUSS_ARC, until=load(4e-4), max_steps=100)
    beyond = next(p for p in whole.points if p.events)
    more = trace(scene, beyond, TRUSS_ARC, until=load(4e-4), max_steps=100)
    assert more.reached and more.points[0] is beyond
    assert [ev.e for ev in more.events] == pytest.approx([whole.events[1].e], rel=1e-9)


def test_a_custom_target_is_met_exactly():
    scene = truss()
    path = trace(scene, rest(scene), TRUSS_ARC, until=lambda p: -p.x[0] - 0.1, max_steps=100)
    assert path.reached
    assert path.last.x[0] == pytest.approx(-0.1, abs=1e-10)
    assert path.last.e == pytest.approx(0.0, abs=1e-12)  # the flat truss carries nothing


@pytest.mark.parametrize("target", [LIMIT * (1 - 1e-6), 1e-4, 1e-7])
def test_a_target_below_the_limit_is_reached_before_it(target):
    scene = truss()
    path = trace(scene, rest(scene), TRUSS_ARC, until=load(target), max_steps=100)
    assert path.reached
    assert path.last.e == target
    assert -path.last.x[0] < 0.0424  # on the first branch
    assert path.last.unstable == 0
    assert path.events == ()
    assert truss_load(-path.last.x[0]) == pytest.approx(target, abs=1e-13)


def test_the_load_may_fall_to_its_target():
    scene = truss()
    there = trace(scene, rest(scene), LoadSteps(1e-10, 4e-5), until=load(1.5e-4), max_steps=50)
    back = trace(scene, there.last, LoadSteps(1e-10, 4e-5), until=load(-5e-4), max_steps=50)
    assert back.reached
    assert back.events == ()
    assert np.all(np.diff(back.loads) < 0)
    assert truss_load(-back.last.x[0]) == pytest.approx(-5e-4, abs=1e-13)
    arc = trace(scene, turned(there.last), TRUSS_ARC, until=load(-5e-4), max_steps=100)
    assert arc.last.x == pytest.approx(back.last.x, abs=1e-9)


@pytest.mark.parametrize(
    "stepper", [TRUSS_ARC, LoadSteps(1e-10, 2e-5), LoadSteps(1e-10, 2e-5, order=5)]
)
def test_a_restart_is_the_same_path(stepper):
    scene = truss()
    target = load(1.8e-4)
    whole = trace(scene, rest(scene), stepper, until=target, max_steps=50)
    half = trace(scene, rest(scene), stepper, until=target, max_steps=2)
    assert half.outcome is Outcome.MAX_STEPS
    rest_of_it = trace(scene, half.last, stepper, until=target, max_steps=50)
    again = (*half.points, *rest_of_it.points[1:])
    assert len(again) == len(whole.points)
    for p, q in zip(again, whole.points, strict=True):
        assert (p.index, p.e, p.unstable, p.iterations) == (q.index, q.e, q.unstable, q.iterations)
        assert np.array_equal(p.x, q.x)


# -- load steps -------------------------------------------------------------------------------


def test_load_steps_stop_before_a_limit_point_and_say_so():
    scene = truss()
    path = trace(scene, rest(scene), LoadSteps(1e-10, 4e-5), until=load(4e-4), max_steps=100)
    assert path.outcome is Outcome.MIN_STEP
    assert "minimum" in path.outcome.value
    assert LIMIT * (1 - 1e-3) < path.last.e < LIMIT
    assert path.iterations < 250


def test_choices_that_make_no_sense_are_refused():
    for make in (
        lambda: LoadSteps(1e-9, -0.1),
        lambda: LoadSteps(1e-9, 0.1, cut=1),
        lambda: LoadSteps(1e-9, 0.1, order=6),
        lambda: ArcLength(1e-9, a=0, b=1),
        lambda: ArcLength(1e-9, a=1, b=1, order=0),
        lambda: ArcLength(1e-9, a=1, b=1, direction=0),
    ):
        with pytest.raises(ValueError, match="expected"):
            make()


def test_a_jump_between_paths_is_seen_and_nothing_is_located_in_it():
    scene = truss()
    blind = LoadSteps(1e-10, 4e-5, jump=np.inf)
    path = trace(scene, rest(scene), blind, until=load(4e-4), max_steps=100)
    assert path.reached  # it snapped through within a step and took it for a path
    before, after = next(
        (p, q) for p, q in zip(path.points, path.points[1:], strict=False) if q.e > LIMIT
    )
    assert -before.x[0] < 0.05
    assert -after.x[0] > 0.2
    assert between(scene, before, after, 0.5, rtol=1e-10) is None


@pytest.mark.parametrize("height, follows", [(0.2, True), (4.0, False)])
def test_a_point_between_two_lies_near_the_way_between_them(height, follows):
    # q = height · sin²(πe) is level at e = 0 and 1, and nothing there tells of the hill between.
    scene = function_scene(
        1,
        lambda q, e: (q[0] - height * np.sin(np.pi * e) ** 2) ** 2 / 2,
        lambda q, e: q - height * np.sin(np.pi * e) ** 2,
        lambda q, e: np.array([[1.0]]),
    )
    path = trace(scene, rest(scene), LoadSteps(1e-10, 1.0, first=1.0, jump=np.inf), max_steps=3)
    assert path.last.x[0] == pytest.approx(0, abs=1e-12)
    before, after = (replace(p, metric=Metric(1.0, 1.0, 1, 1.0)) for p in path.points)
    made = between(scene, before, after, 0.5, rtol=1e-10)
    assert (made is not None) is follows
    if follows:
        assert made[0].x[0] == pytest.approx(height)


@pytest.mark.parametrize("fraction", [0.3, 0.8])
def test_the_second_guess_between_two_points_lies_at_the_fraction_too(fraction, monkeypatch):
    scene, right, tried = truss(), arc.correct, []

    def correct(scene, z, plane, **options):
        tried.append(z)
        result = right(scene, z, plane, **options)
        return result if len(tried) > 1 else replace(result, outcome=Outcome.NOT_CONVERGED)

    path = trace(scene, rest(scene), TRUSS_ARC, until=load(1e-4), max_steps=9, events=False)
    before, after = path.points[1:3]
    monkeypatch.setattr(arc, "correct", correct)
    point, _ = between(scene, before, after, fraction, rtol=1e-10)
    assert truss_load(-point.x[0]) == pytest.approx(point.e, abs=1e-13)
    line, across = after.z - before.z, after.metric.row(after.z - before.z)
    assert len(tried) == 2
    for z in (tried[1], point.z):
        assert across @ (z - before.z) == pytest.approx(fraction * across @ line, rel=1e-9)


def test_the_work_of_refused_load_steps_is_counted(monkeypatch):
    scene, steps, right, spent = truss(), LoadSteps(1e-10, 4e-5), LoadSteps._solve, []

    def solve(*given):
        result = right(*given)
        spent.append(result.iterations)
        return result if len(spent) > 2 else replace(result, outcome=Outcome.NOT_CONVERGED)

    point = steps.begin(scene, rest(scene), 0.0, 1.0)
    monkeypatch.setattr(LoadSteps, "_solve", solve)
    after = steps.advance(scene, point, None)
    assert len(spent) == 3
    assert after.iterations == sum(spent) > spent[-1]


def test_growth_of_the_step_and_algorithm_3():
    scene = truss()
    options = dict(until=load(1.6e-4), max_steps=60)
    gentle = trace(scene, rest(scene), LoadSteps(1e-10, 2e-5, first=0.1), **options)
    steps = np.diff(gentle.loads)
    assert steps[:4] == pytest.approx([2e-6, 4e-6, 8e-6, 1.6e-5])
    assert max(steps) == pytest.approx(2e-5)
    abrupt = trace(scene, rest(scene), LoadSteps(1e-10, 2e-5, first=0.1, growth=np.inf), **options)
    assert np.diff(abrupt.loads)[1] == pytest.approx(2e-5)
    larger = trace(scene, rest(scene), LoadSteps(1e-10, 1e-6, largest=10), **options)
    assert max(np.diff(larger.loads)) == pytest.approx(1e-5)
    last = trace(
        scene, rest(scene), LoadSteps(1e-10, 2e-5, first=1), until=load(1.01e-4), max_steps=9
    )
    assert np.diff(last.loads) == pytest.approx([2e-5] * 4 + [1.05e-5] * 2)  # no sliver at the end
    for path in (gentle, abrupt, larger):
        assert path.reached
        assert path.last.e == 1.6e-4


@pytest.mark.parametrize(
    "stepper", [TRUSS_ARC, LoadSteps(1e-10, 4e-5), StableSteps(LoadSteps(1e-10, 4e-5))]
)
def test_a_start_without_equilibrium_is_an_outcome(stepper):
    scene = function_scene(
        1, lambda q, e: q[0], lambda q, e: np.ones(1), lambda q, e: np.full((1, 1), 1e-3)
    )
    path = trace(scene, np.zeros(1), stepper, max_steps=5)
    assert path.points == ()
    assert path.outcome in (Outcome.NO_START, Outcome.NO_STABLE_STATE, Outcome.NO_PROGRESS)
    with pytest.raises(ValueError, match="no points"):
        _ = path.last


def test_a_start_far_from_equilibrium_goes_down_the_energy():
    scene = truss()
    path = trace(
        scene, np.array([-0.12]), LoadSteps(1e-10, 1e-4), e=3e-4, max_steps=9, until=load(4e-4)
    )
    assert path.reached
    assert path.points[0].unstable == 0
    assert truss_load(-path.points[0].x[0]) == pytest.approx(3e-4, abs=1e-13)


def test_steps_and_bounds_run_out():
    scene = truss()
    with pytest.raises(ValueError, match="max_steps = 0"):
        trace(scene, rest(scene), TRUSS_ARC, max_steps=0)
    few = trace(scene, rest(scene), TRUSS_ARC, until=load(1.0), max_steps=3)
    assert (few.outcome, len(few.points)) == (Outcome.MAX_STEPS, 4)
    bound = trace(scene, rest(scene), TRUSS_ARC, until=load(1), max_steps=99, bounds=(-1e-4, 1))
    assert bound.outcome is Outcome.OUT_OF_BOUNDS
    assert all(p.e >= -1e-4 for p in bound.points)
    above = trace(scene, rest(scene), TRUSS_ARC, until=load(1), max_steps=99, bounds=(-1, 1e-4))
    assert above.outcome is Outcome.OUT_OF_BOUNDS
    assert all(p.e <= 1e-4 for p in above.points)


# -- a strip that folds itself ----------------------------------------------------------------


def strip(h=0.01, g=-0.1):
    """Half of a bilayer strip of length 1, h thick each, whose upper layer contracts by g e."""
    mesh = skfem.MeshHex.init_tensor(
        np.linspace(0, 0.05, 2), np.linspace(0, 0.5, 13), np.array([0, h, 2 * h])
    )
    body = Body.build(mesh)
    upper = mesh.p[2, mesh.t].mean(axis=0) > h
    growth = Orthotropic((0.0, lambda e: g * e, 0.0), cells=upper)
    planes = [Fixed(body.nodes_where(lambda X, i=i: X[:, i] < 1e-9), np.eye(3)[i]) for i in (0, 1)]
    return Scene(
        body,
        [Elastic(body, NeoHookean(1.0, 0.3), growth)],
        fixed=planes,
        rows=[translation_row(body, 2)],
    )


def test_a_thin_strip_curls_in_few_iterations_whatever_the_stepper():
    scene = strip()
    ends = []
    for stepper, most in (
        (LoadSteps(1e-9, 1 / 12, order=1), 80),
        (LoadSteps(1e-9, 1 / 12), 50),
        (LoadSteps(1e-9, 1 / 12, order=5), 40),
        (ArcLength(1e-9, a=0.05, b=0.05), 400),
    ):
        path = trace(scene, rest(scene), stepper, max_steps=150)
        assert path.reached
        assert path.last.e == 1.0
        assert path.iterations <= most
        assert {p.unstable for p in path.points} == {0}
        ends.append(path.last.x)
    for x in ends[1:]:
        assert np.abs(x - ends[0])[: scene.n_free].max() < 1e-7
    # Timoshenko: κ h_total = 1.5 |g| over half the length; growth strains are finite here
    u = scene.displacement(ends[0], 1.0)
    X = scene.body.nodes
    tip = (np.abs(X[:, 1] - 0.5) < 1e-9) & (X[:, 0] < 1e-9)
    across = (X + u)[tip][np.argsort(X[tip, 2])]
    normal = across[-1] - across[0]
    angle = np.arctan2(-normal[1], normal[2]) % (2 * np.pi)
    assert angle == pytest.approx(1.5 * 0.1 / 0.02 * 0.5, rel=0.05)


def test_the_energy_guides_where_unstable_modes_cannot_be_counted(monkeypatch):
    scene = strip()
    monkeypatch.setattr(System, "unstable", None)
    path = trace(scene, rest(scene), LoadSteps(1e-9, 1 / 6), max_steps=50)
    assert path.reached
    assert path.iterations <= 80


@pytest.mark.parametrize(
    "stepper",
    [LoadSteps(1e-9, 0.3), ArcLength(1e-9, a=0.3, b=0.3), StableSteps(LoadSteps(1e-9, 0.3))],
    ids=["load steps", "arc length", "stable path"],
)
def test_growth_that_a_step_overshoots_shortens_the_step(stepper):
    # At e = 0.8 nothing is left of the body; beyond it det Fg < 0.
    body = Body.build(skfem.MeshHex.init_tensor(*(np.linspace(0, 1, 3),) * 3), "hex8")
    planes = [
        Fixed(body.nodes_where(lambda X, i=i: X[:, i] < 1e-9), np.eye(3)[i]) for i in range(3)
    ]
    growth = Isotropic(lambda e: -1.25 * e)
    scene = Scene(body, [Elastic(body, NeoHookean(1.0, 0.3), growth)], fixed=planes)
    path = trace(scene, rest(scene), stepper, until=load(0.75), max_steps=100)
    assert path.reached
    u = scene.displacement(path.last.x, path.last.e)
    assert u == pytest.approx(-1.25 * 0.75 * body.nodes, abs=1e-7)
    on = trace(scene, path.last, stepper, max_steps=100)
    assert on.outcome in (Outcome.MIN_STEP, Outcome.NO_PROGRESS, Outcome.INADMISSIBLE)
    assert 0.75 <= on.last.e < 0.8
    with pytest.raises(ValueError, match="det Fg"):
        trace(scene, rest(scene), stepper, e=0.9, max_steps=100)
