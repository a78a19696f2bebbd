"""Branch points, stable paths and seeded noise, on scenes with known answers (path_toys)."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import skfem
from path_toys import (
    column,
    function_scene,
    truss,
    truss_load,
)

from solver.equilibrium.descent import critical_mode
from solver.equilibrium.newton import newton
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.paths.continuation import load, trace
from solver.paths.noise import Noise
from solver.paths.stability import switch
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps, turned
from solver.physics.elastic import Elastic
from solver.physics.materials import NeoHookean
from solver.physics.supports import rotation_row, translation_row

# references.md §6: von Mises truss, engineering strain, P/2EA at H/a = 0.1
LIMIT = 1.905435952e-4


def rest(scene):
    return np.zeros(scene.size)


def kinds(path):
    return [event.kind for event in path.events]


# -- branch points ----------------------------------------------------------------------------


@pytest.mark.parametrize("stepper", [LoadSteps(1e-11, 0.15), ArcLength(1e-11, a=0.05, b=0.15)])
def test_pitchfork_located_counted_and_switched(stepper):
    scene = column(1.0)  # P_cr = k/L = 1; beyond it P = θ / sin θ
    path = trace(scene, rest(scene), stepper, until=load(1.4), max_steps=50)
    assert path.reached
    assert kinds(path) == ["branch"]
    event = path.events[0]
    assert event.e == pytest.approx(1.0, abs=1e-9)
    assert event.unstable == (0, 1)
    assert event.sees_load < 1e-9
    assert abs(event.vector) == pytest.approx([1, 0], abs=1e-9)
    for p in path.points:
        assert p.unstable == (0 if p.e < 1 else 1)
    for side in (1, -1):
        on = switch(scene, event, path.last, rtol=1e-11, side=side)
        assert on.x[0] / np.sin(on.x[0]) == pytest.approx(on.e, abs=1e-10)
        assert on.unstable == 0
        branch = trace(scene, on, ArcLength(1e-11, a=0.1, b=0.1), until=load(1.4), max_steps=50)
        assert branch.reached
        assert np.sign(branch.last.x[0]) == side * np.sign(event.vector[0])
        for p in branch.points:
            assert p.x[0] / np.sin(p.x[0]) == pytest.approx(p.e, abs=1e-10)
            assert p.unstable == 0
    with pytest.raises(ValueError, match="no second path"):
        switch(scene, replace(event, kind="fold"), path.last, rtol=1e-9)


@pytest.mark.parametrize("stepper", [LoadSteps(1e-11, 0.15), ArcLength(1e-11, a=0.05, b=0.15)])
def test_a_branch_point_is_located_where_stability_returns_too(stepper):
    scene = column(1.0)
    beyond = trace(scene, rest(scene), stepper, until=load(1.4), max_steps=50).last
    back = trace(scene, turned(beyond), stepper, until=load(0.5), max_steps=50)
    assert back.reached and kinds(back) == ["branch"]
    assert back.events[0].e == pytest.approx(1.0, abs=1e-9)
    assert back.events[0].unstable == (1, 0)


@pytest.mark.parametrize("gap", [1e-2, 1e-3])
def test_two_branch_points_within_one_step(gap):
    scene = column(1.0, 1.0 + gap)
    path = trace(scene, rest(scene), LoadSteps(1e-11, 0.3), until=load(1.4), max_steps=50)
    assert [(ev.kind, ev.unstable) for ev in path.events] == [
        ("branch", (0, 1)),
        ("branch", (1, 2)),
    ]
    assert [ev.e for ev in path.events] == pytest.approx([1, 1 + gap], abs=1e-8)
    first, second = (abs(ev.vector) for ev in path.events)
    assert first == pytest.approx([1, 0, 0], abs=1e-6)
    assert second == pytest.approx([0, 1, 0], abs=1e-6)


def test_events_can_be_left_out():
    scene = column(1.0)
    path = trace(
        scene, rest(scene), LoadSteps(1e-11, 0.3), until=load(1.4), max_steps=50, events=False
    )
    assert path.events == ()
    assert path.last.unstable == 1


def test_counts_are_on_the_states_the_rows_allow():
    # A bar free in space: six rows take out the rigid motions, which would count as neutral.
    mesh = skfem.MeshHex.init_tensor(
        *(np.linspace(0, a, n) for a, n in ((1, 5), (0.2, 3), (0.1, 2)))
    )
    body = Body.build(mesh, "hex8")
    rows = [make(body, axis) for make in (translation_row, rotation_row) for axis in range(3)]
    scene = Scene(body, [Elastic(body, NeoHookean(1.0, 0.3))], rows=rows)
    result = newton(scene, rest(scene), 0.0, rtol=1e-12)
    assert result.converged
    assert result.system.unstable == 0
    value, mode = critical_mode(scene, result.system.factorise(), sweeps=50)
    u = scene.step_displacement(mode)
    assert value > 0
    for row in rows:
        assert abs((row.coefficients * u).sum()) < 1e-10


# -- stable paths -----------------------------------------------------------------------------


def test_a_stable_path_snaps_through_to_the_lower_branch():
    scene = truss()
    path = trace(
        scene, rest(scene), StableSteps(LoadSteps(1e-10, 4e-5)), until=load(4e-4), max_steps=60
    )
    assert path.reached
    assert kinds(path) == ["fold", "snap"]
    fold, snap = path.events
    assert fold.e == pytest.approx(LIMIT, rel=1e-8)
    assert LIMIT < snap.e < 1.01 * LIMIT
    assert snap.energy_drop > 0
    # From 0.0424 to where the far branch carries the limit load
    assert 2 * snap.size == pytest.approx(0.1731, abs=2e-4)
    assert all(p.unstable == 0 for p in path.points)
    for p in path.points:
        assert truss_load(-p.x[0]) == pytest.approx(p.e, abs=1e-13)
        assert (-p.x[0] < 0.0424) == (p.e < LIMIT)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("cubic", "size"), [(0.0, 0.095), (-0.5, 0.826)])
def test_a_stable_path_bifurcates_to_the_side_asked_for(cubic, size, side):
    # Supercritical: a small move off the straight column; subcritical: a jump
    scene = column(1.0, cubic=cubic, quintic=-cubic)
    stepper = StableSteps(LoadSteps(1e-11, 0.15), side=side)
    path = trace(scene, rest(scene), stepper, until=load(1.4), max_steps=60)
    assert path.reached
    assert kinds(path) == ["branch", "bifurcation"]
    assert path.events[0].e == pytest.approx(1.0, abs=1e-9)
    assert path.events[1].size == pytest.approx(size, abs=1e-3)
    assert path.events[1].energy_drop > 0
    assert all(p.unstable == 0 for p in path.points)
    t = path.last.x[0]
    assert (t + cubic * t**3 - cubic * t**5) / np.sin(t) == pytest.approx(1.4, abs=1e-9)
    assert np.sign(t) == side * np.sign(path.events[0].vector[0])


def test_a_stable_path_that_falls_for_ever_ends_in_words():
    scene = column(1.0, cubic=-0.5)  # no valley beyond the branch point
    path = trace(
        scene, rest(scene), StableSteps(LoadSteps(1e-10, 0.15)), until=load(1.4), max_steps=60
    )
    assert path.outcome in (Outcome.NO_STABLE_STATE, Outcome.NO_PROGRESS)
    assert 0.8 < path.last.e < 1
    # What it failed at is known all the same.
    assert kinds(path) == ["branch"]
    assert path.events[0].e == pytest.approx(1.0, abs=1e-9)


def test_a_fall_that_is_too_short_is_tried_again_with_a_longer_reach():
    # 300 steps of 1e-3 don't get to the valley at 0.83.
    scene = column(1.0, cubic=-0.5, quintic=0.5)
    stepper = StableSteps(LoadSteps(1e-11, 0.15), reach=1e-3)
    path = trace(scene, rest(scene), stepper, until=load(1.4), max_steps=60)
    assert path.reached
    assert kinds(path) == ["branch", "bifurcation"]
    assert path.events[1].size > 0.8
    assert np.sign(path.last.x[0]) == np.sign(path.events[0].vector[0])  # not the other side's


@pytest.mark.parametrize("side", [1, -1])
def test_where_one_side_falls_for_ever_the_other_one_is_tried(side):
    def wall(q):
        return np.maximum(-q, 0.0)

    scene = function_scene(
        1,
        lambda q, e: ((1 - e) * q**2 / 2 - q**4 / 4 + wall(q) ** 6 / 6)[0],
        lambda q, e: (1 - e) * q - q**3 - wall(q) ** 5,
        lambda q, e: np.diag(1 - e - 3 * q**2 + 5 * wall(q) ** 4),
    )
    stepper = StableSteps(LoadSteps(1e-10, 0.15), side=side)
    path = trace(scene, rest(scene), stepper, until=load(1.4), max_steps=60)
    assert path.reached
    assert kinds(path) == ["branch", "bifurcation"]
    assert path.last.x[0] < -1


@pytest.mark.parametrize(
    "stepper", [partial(LoadSteps, 1e-11, 0.1), partial(ArcLength, 1e-11, 0.1, 0.1)]
)
def test_seeded_noise_leaves_unstable_states_and_can_be_repeated(stepper):
    scene = column(1.0)

    def run(seed, amplitude=1e-2):
        steps = stepper(noise=Noise(amplitude, seed))
        return trace(scene, rest(scene), steps, until=load(1.4), max_steps=60)

    first, again = run(3), run(3)
    assert first.reached
    assert all(np.array_equal(p.x, q.x) for p, q in zip(first.points, again.points, strict=True))
    t = first.last.x[0]
    assert abs(t) / np.sin(abs(t)) == pytest.approx(1.4, abs=1e-9)
    assert first.last.unstable == 0
    assert {np.sign(run(seed).last.x[0]) for seed in range(8)} == {-1.0, 1.0}
    # Without noise both stay on the straight column.
    still = trace(scene, rest(scene), stepper(), until=load(1.4), max_steps=60, events=False)
    assert still.last.unstable == 1 and abs(still.last.x[0]) < 1e-6


def test_arc_length_with_noise_snaps_where_the_arc_alone_turns_back():
    scene, top = truss(), 2e-4
    arc = ArcLength(1e-10, 0.02, 2e-5)
    back = trace(scene, rest(scene), arc, until=load(top), max_steps=400, events=False)
    assert min(p.e for p in back.points) < 0 and min(p.unstable for p in back.points) == 0
    noisy = replace(arc, noise=Noise(1e-3, 1))
    snapped = trace(scene, rest(scene), noisy, until=load(top), max_steps=400, events=False)
    assert snapped.reached and all(p.unstable == 0 for p in snapped.points)
    assert all(q.e > p.e for p, q in zip(snapped.points, snapped.points[1:], strict=False))
    assert snapped.last.x[0] == pytest.approx(back.last.x[0], abs=1e-6)


def test_noise_may_draw_the_scene_too():
    scene = column(1.0)

    def weaker(scene, rng):
        return column(1.0 + 0.1 * rng.standard_normal())

    steps = LoadSteps(1e-11, 0.1, noise=Noise(1e-3, 5, scene=weaker))
    path = trace(scene, rest(scene), steps, until=load(1.4), max_steps=60)
    k = 1.0 + 0.1 * np.random.default_rng([5, path.points[-2].index]).standard_normal()
    t = abs(path.last.x[0])
    assert k * t / np.sin(t) == pytest.approx(1.4, abs=1e-9)
