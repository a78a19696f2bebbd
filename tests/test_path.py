"""Newton, descent, load steps, arc length, events and stable paths, on scenes with known answers.

The scenes are bars and plain functions (path_toys), so that what is tested is the path following
and not the elements; two tests at the end take a real strip that folds itself.
"""

from dataclasses import replace

import numpy as np
import pytest
import skfem
from path_toys import (
    carousel,
    column,
    function_scene,
    truss,
    truss_load,
    truss_on_spring,
)

from solver.arc import Bordered
from solver.body import Body
from solver.continuation import (
    ArcLength,
    LoadSteps,
    Noise,
    Outcome,
    StablePath,
    follow,
    load,
    trace,
    turned,
)
from solver.descent import critical_mode, descend
from solver.growth import Orthotropic
from solver.linear import make_solver
from solver.materials import NeoHookean
from solver.newton import newton
from solver.scene import Fixed, Scene, rotation_row, translation_row
from solver.stability import switch
from solver.terms import Elastic

# references.md §6: von Mises truss, engineering strain, P/2EA at H/a = 0.1
LIMIT = 1.905435952e-4
TRUSS_ARC = ArcLength(1e-10, a=0.02, b=2e-5)


def rest(scene):
    return np.zeros(scene.size)


def kinds(path):
    return [event.kind for event in path.events]


# -- Newton -----------------------------------------------------------------------------------


def test_newton_converges_where_the_plain_iteration_diverges():
    # E = √(1 + q²) − e q: the plain step from |q| > 1 runs away, q ← −q³ at e = 0
    scene = function_scene(
        1,
        lambda q, e: np.sqrt(1 + q[0] ** 2) - e * q[0],
        lambda q, e: q / np.sqrt(1 + q**2) - e,
        lambda q, e: np.array([[(1 + q[0] ** 2) ** -1.5]]),
    )
    found = newton(scene, np.array([5.0]), 0.5, rtol=1e-12)
    assert found.converged
    assert found.x[0] == pytest.approx(1 / np.sqrt(3), abs=1e-12)
    # The same without an energy: the natural test alone has to hold it back.
    blind = function_scene(
        1,
        None,
        lambda q, e: q / np.sqrt(1 + q**2) - e,
        lambda q, e: np.array([[(1 + q[0] ** 2) ** -1.5]]),
    )
    found = newton(blind, np.array([5.0]), 0.5, rtol=1e-12)
    assert found.converged
    assert found.x[0] == pytest.approx(1 / np.sqrt(3), abs=1e-12)


def test_newton_keeps_to_admissible_states_and_says_when_there_are_none():
    # E = −log q + q: q > 0 only; from 3.9 the plain step goes to −7.4
    def energy(q, e):
        return q[0] - np.log(q[0]) if q[0] > 0 else np.inf

    scene = function_scene(
        1, energy, lambda q, e: 1 - 1 / q, lambda q, e: np.array([[1 / q[0] ** 2]])
    )
    found = newton(scene, np.array([3.9]), 0.0, rtol=1e-12)
    assert found.converged
    assert found.x[0] == pytest.approx(1.0, abs=1e-12)
    assert newton(scene, np.array([-1.0]), 0.0, rtol=1e-9).outcome is Outcome.INADMISSIBLE


def test_newton_goes_to_a_saddle_and_descent_does_not():
    scene = truss()
    saddle = newton(scene, np.array([-0.1]), 0.0, rtol=1e-12)
    assert saddle.converged
    assert (saddle.x[0], saddle.system.unstable) == (pytest.approx(-0.1, abs=1e-14), 1)
    down = descend(scene, np.array([-0.1]), 0.0, rtol=1e-12)
    assert down.converged
    assert down.system.unstable == 0
    assert abs(down.x[0]) == pytest.approx(0.0, abs=1e-12) or down.x[0] == pytest.approx(-0.2)


def test_newton_stagnation_is_told_from_convergence():
    noise = np.random.default_rng(0)
    scene = function_scene(
        1, None,
        lambda q, e: q - 1 + 1e-6 * noise.standard_normal(1),
        lambda q, e: np.array([[1.0]]),
    )  # fmt: skip
    found = newton(scene, np.zeros(1), 0.0, rtol=1e-9, max_iterations=50)
    assert found.outcome is Outcome.STAGNATED or found.outcome is Outcome.NO_PROGRESS
    assert newton(scene, np.zeros(1), 0.0, rtol=1e-4).converged


def test_barriers_shorten_the_step():
    class Wall:
        symmetric, graph, name = True, None, "wall"

        def evaluate(self, u, e, order=2):
            from solver.scene import Evaluation

            return Evaluation(np.inf) if u[0, 0] >= 2 else Evaluation(0.0, np.zeros_like(u))

        def longest_step(self, u, du):
            return 0.9 * (2 - u[0, 0]) / du[0, 0] if du[0, 0] > 0 else 1.0

    scene = function_scene(
        1,
        lambda q, e: q[0] ** 4 / 4 - q[0],
        lambda q, e: q**3 - 1,
        lambda q, e: np.array([[3 * q[0] ** 2]]),
    )
    scene.terms = (*scene.terms, Wall())
    scene._where = [*scene._where, None]
    tried = []
    old = scene.evaluate
    scene.evaluate = lambda u, e, order=2: (tried.append(u[0, 0]), old(u, e, order))[1]
    found = newton(scene, np.array([0.2]), 0.0, rtol=1e-12)
    assert found.converged
    assert found.x[0] == pytest.approx(1.0, abs=1e-12)
    assert max(tried) < 2  # the plain first step ends at 8.5


def test_bad_input_is_refused_in_words():
    scene = truss()
    with pytest.raises(ValueError, match=r"shape \(2,\); expected \(1,\)"):
        newton(scene, np.zeros(2), 0.0, rtol=1e-9)
    with pytest.raises(ValueError, match="rtol = 0"):
        newton(scene, np.zeros(1), 0.0, rtol=0)
    with pytest.raises(ValueError, match="needs an energy"):
        descend(carousel(), np.array([1.0, 0.0]), 0.0, rtol=1e-9)
    with pytest.raises(ValueError, match="max_steps = 0"):
        trace(scene, rest(scene), TRUSS_ARC, max_steps=0)


# -- bordered systems -------------------------------------------------------------------------


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("smallest", [1.0, 1e-9, 1e-14])
def test_bordering_is_accurate_for_singular_stiffness(symmetric, smallest):
    rng = np.random.default_rng(1)
    n = 30
    Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    P = Q if symmetric else np.linalg.qr(rng.standard_normal((n, n)))[0]
    K = Q @ np.diag(np.append(np.linspace(1, 3, n - 1), smallest)) @ P.T
    c, row, b = (rng.standard_normal(k) for k in (n, n + 1, n + 1))
    upper = np.triu(np.ones((n, n), bool)) if symmetric else np.ones((n, n), bool)
    i, j = np.nonzero(upper)
    indptr = np.concatenate([[0], np.cumsum(upper.sum(axis=1))])
    factor = make_solver(indptr, j, symmetric=symmetric, method="superlu").factorise(K[i, j])
    z = Bordered(factor, c, row).solve(b)
    full = np.block([[K, c[:, None]], [row[None, :]]])
    assert np.abs(full @ z - b).max() < 1e-11 * np.abs(z).max()
    assert np.abs(z - np.linalg.solve(full, b)).max() < 1e-9 * np.abs(z).max()


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
    assert len(path.points) < 40
    assert path.iterations < 120


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
    assert min(path.loads) < -0.2  # driven back beyond where it began


def test_a_stiff_spring_makes_the_path_one_to_one():
    scene = truss_on_spring(1.0)
    path = trace(scene, rest(scene), LoadSteps(1e-10, 0.02), until=load(0.25), max_steps=100)
    assert path.reached
    assert path.events == ()


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


def test_a_custom_target_is_met_exactly():
    scene = truss()
    path = trace(
        scene, rest(scene), TRUSS_ARC, until=lambda p: -p.x[0] - 0.1, max_steps=100
    )  # fmt: skip
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
    for path in (gentle, abrupt, larger):
        assert path.reached
        assert path.last.e == 1.6e-4


@pytest.mark.parametrize(
    "stepper", [TRUSS_ARC, LoadSteps(1e-10, 4e-5), StablePath(LoadSteps(1e-10, 4e-5))]
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


def test_steps_and_bounds_run_out():
    scene = truss()
    few = trace(scene, rest(scene), TRUSS_ARC, until=load(1.0), max_steps=3)
    assert (few.outcome, len(few.points)) == (Outcome.MAX_STEPS, 4)
    bound = trace(scene, rest(scene), TRUSS_ARC, until=load(1), max_steps=99, bounds=(-1e-4, 1))
    assert bound.outcome is Outcome.OUT_OF_BOUNDS
    assert all(p.e >= -1e-4 for p in bound.points)


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
    )  # fmt: skip
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
    found = newton(scene, rest(scene), 0.0, rtol=1e-12)
    assert found.converged
    assert found.system.unstable == 0
    value, mode = critical_mode(scene, found.system.factorise(), sweeps=50)
    u = scene.step_displacement(mode)
    assert value > 0
    for row in rows:
        assert abs((row.coefficients * u).sum()) < 1e-10


# -- stable paths -----------------------------------------------------------------------------


def test_a_stable_path_snaps_through_to_the_lower_branch():
    scene = truss()
    path = trace(
        scene, rest(scene), StablePath(LoadSteps(1e-10, 4e-5)), until=load(4e-4), max_steps=60
    )  # fmt: skip
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
    stepper = StablePath(LoadSteps(1e-11, 0.15), side=side)
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
        scene, rest(scene), StablePath(LoadSteps(1e-10, 0.15)), until=load(1.4), max_steps=60
    )  # fmt: skip
    assert path.outcome in (Outcome.NO_STABLE_STATE, Outcome.NO_PROGRESS)
    assert 0.8 < path.last.e < 1


def test_seeded_noise_leaves_unstable_states_and_can_be_repeated():
    scene = column(1.0)

    def run(seed, amplitude=1e-2):
        steps = LoadSteps(1e-11, 0.1, noise=Noise(amplitude, seed))
        return trace(scene, rest(scene), steps, until=load(1.4), max_steps=60)

    first, again = run(3), run(3)
    assert first.reached
    assert all(np.array_equal(p.x, q.x) for p, q in zip(first.points, again.points, strict=True))
    t = first.last.x[0]
    assert abs(t) / np.sin(abs(t)) == pytest.approx(1.4, abs=1e-9)
    assert first.last.unstable == 0
    assert {np.sign(run(seed).last.x[0]) for seed in range(8)} == {-1.0, 1.0}


def test_noise_may_draw_the_scene_too():
    scene = column(1.0)

    def weaker(scene, rng):
        return column(1.0 + 0.1 * rng.standard_normal())

    steps = LoadSteps(1e-11, 0.1, noise=Noise(1e-3, 5, scene=weaker))
    path = trace(scene, rest(scene), steps, until=load(1.4), max_steps=60)
    k = 1.0 + 0.1 * np.random.default_rng([5, path.points[-2].index]).standard_normal()
    t = abs(path.last.x[0])
    assert k * t / np.sin(t) == pytest.approx(1.4, abs=1e-9)


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
        body, [Elastic(body, NeoHookean(1.0, 0.3), growth)], fixed=planes,
        rows=[translation_row(body, 2)],
    )  # fmt: skip


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
