"""Loads that turn round, paths that are taken up again, noise that repeats."""

import pickle
from itertools import pairwise

import numpy as np
import pytest
from hard_scenes import half_strip
from path_toys import truss, truss_load
from reference_scenes import AXES, held, modulus, near
from reference_structures import arch

from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.paths.continuation import load, trace
from solver.paths.noise import Noise
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps, turned
from solver.physics.elastic import Elastic
from solver.physics.loads import Traction
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed


def rest(scene):
    return np.zeros(scene.size)


# -- loads that turn round -----------------------------------------------------------------------


def curler(h=0.01):
    """Half a strip, free curvature 4 e over its length: no stress, the state known at each e."""
    body, term, fixed = half_strip(h, 6, lambda e, x: 4 * e + 0 * x)
    foot = body.nodes_where(lambda X: np.linalg.norm(X, axis=1) < 1e-9)
    return Scene(body, [term], fixed=[*fixed, Fixed(foot, AXES[2])])


@pytest.mark.parametrize("stepper", [LoadSteps(1e-9, 0.2), ArcLength(1e-9, a=0.2, b=0.4)])
def test_a_load_that_reverses_retraces_its_path(stepper):
    """Up to 1, back to −1, up to 0.5: elastic states don't remember, so states at equal loads agree
    to 1e-8 of the length, on load steps and on the arc turned round."""
    scene = curler()
    up = trace(scene, rest(scene), stepper, until=load(1.0), max_steps=60)
    start = turned(up.last) if isinstance(stepper, ArcLength) else up.last
    down = trace(scene, start, stepper, until=load(-1.0), max_steps=60)
    start = turned(down.last) if isinstance(stepper, ArcLength) else down.last
    back = trace(scene, start, stepper, until=load(0.5), max_steps=60)
    assert up.reached and down.reached and back.reached
    direct = trace(scene, rest(scene), stepper, until=load(0.5), max_steps=60)
    assert np.abs(back.last.x - direct.last.x).max() < 1e-8
    # e and −e are mirror images: heights change sign.
    X = scene.body.nodes
    flip = np.array([np.argmin(np.abs(X - p * (1, 1, -1)).sum(axis=1)) for p in X])
    u, v = (scene.displacement(p.last.x, p.last.e) for p in (up, down))
    assert np.abs(v[flip] * (1, 1, -1) - u).max() < 1e-8


# -- paths taken up again ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "stepper",
    [
        LoadSteps(1e-9, 0.1),
        ArcLength(1e-9, a=0.05, b=0.1),
        StableSteps(LoadSteps(1e-9, 0.1), locate=False),
    ],
    ids=["load steps", "arc", "settle"],
)
def test_a_restart_from_a_file_in_a_new_scene_is_the_same_path(stepper):
    """A solid's path stopped half-way, its last point pickled, taken up in a scene built anew:
    loads, iterations and displacements equal those of the whole path to the last digit."""
    whole = trace(curler(), rest(curler()), stepper, max_steps=60)
    half = trace(curler(), rest(curler()), stepper, max_steps=3)
    assert half.outcome is Outcome.MAX_STEPS
    point = pickle.loads(pickle.dumps(half.last))
    again = trace(curler(), point, stepper, max_steps=60)
    points = (*half.points, *again.points[1:])
    assert len(points) == len(whole.points) and again.reached
    for p, q in zip(points, whole.points, strict=True):
        assert (p.index, p.e, p.iterations, p.unstable) == (q.index, q.e, q.iterations, q.unstable)
        assert np.array_equal(p.x, q.x)


def test_a_restart_just_before_a_snap_snaps_alike():
    """The arch's path taken up at the last point before its snap ends in the same state with the
    same events."""
    scene, _ = arch(hinged=False, n=6, e_to=40.0)
    stepper = StableSteps(LoadSteps(rtol=1e-9, step=0.1, cut=4.0), locate=False)
    whole = trace(scene, rest(scene), stepper, max_steps=60, events=False)
    at = next(k for k, p in enumerate(whole.points) if p.events)
    point = pickle.loads(pickle.dumps(whole.points[at - 1]))
    again = trace(arch(hinged=False, n=6, e_to=40.0)[0], point, stepper, max_steps=60, events=False)
    assert [ev.kind for ev in again.events] == [ev.kind for ev in whole.events]
    assert np.array_equal(again.last.x, whole.last.x)


# -- noise ---------------------------------------------------------------------------------------


def test_noise_of_one_seed_buckles_a_solid_column_the_same_way_each_time():
    """A solid column past its Euler load with seeded noise on its load steps: two runs of a seed
    agree to the last digit, every seed ends in one of the two mirror-image states (1e-6)."""
    h = 0.05

    def run(seed):
        body = Body.build(box(np.linspace(0, 1, 5), [0, h], [-h / 2, h / 2]), "hex20")
        fixed = [*held(body, 0, 0.0, 0, 1, 2), *held(body, 1, 0.0, 1), *held(body, 1, h, 1)]
        push = lambda e: np.array([-e * 1.3 * np.pi**2 / 4 / h, 0, 0])  # noqa: E731
        terms = [
            Elastic(body, NeoHookean(modulus(h), 0.0)),
            Traction(body, body.surface(near(0, 1.0)), push),
        ]
        scene = Scene(body, terms, fixed=fixed)
        steps = LoadSteps(1e-9, 0.2, noise=Noise(1e-2, seed))
        path = trace(scene, rest(scene), steps, max_steps=60, events=False)
        assert path.reached and path.last.unstable == 0
        tip = body.nodes_where(near(0, 1.0))
        return path, scene.displacement(path.last.x, 1.0)[tip, 2].mean()

    first, again = run(3)[0], run(3)[0]
    assert all(np.array_equal(p.x, q.x) for p, q in zip(first.points, again.points, strict=True))
    ends = [run(seed)[1] for seed in range(5)]
    assert np.abs(ends) == pytest.approx(abs(ends[0]), rel=1e-6)
    assert abs(ends[0]) > 0.1


def test_noisy_load_steps_go_over_a_limit_point_too():
    """Noise is on load steps, and each of them falls to a stable state: past the truss's limit load
    the path goes on hanging below its supports, on the closed form."""
    scene = truss()
    steps = LoadSteps(1e-11, 4e-5, noise=Noise(1e-3, 1))
    path = trace(scene, rest(scene), steps, until=load(4e-4), max_steps=60, events=False)
    assert path.reached
    jumps = [q.x[0] - p.x[0] for p, q in pairwise(path.points)]
    assert min(jumps) < -0.1
    for p in path.points:
        assert truss_load(-p.x[0]) == pytest.approx(p.e, abs=1e-12) and p.unstable == 0
