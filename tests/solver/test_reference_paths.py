"""Verification cases that snap, buckle and branch; values computed independently or published.

The load comes with e and starts from nothing.
"""

import numpy as np
import pytest
import reference_structures as case
from reference_scenes import MidLine, cantilever, walked
from scipy.interpolate import CubicHermiteSpline

from solver.equilibrium.newton import newton
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.reactions import reaction
from solver.paths.continuation import trace
from solver.paths.stability import switch
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps

# -- 4. bistable plates --------------------------------------------------------------------------


@pytest.mark.parametrize("share, want", [(2, 1.535911), (4, 2.159891)])
def test_a_disc_that_wants_to_be_a_sphere_becomes_a_cap(share, want):
    scene = case.disc(h=0.02, e_to=share)
    last = walked(scene, LoadSteps(rtol=1e-8, step=0.25)).last
    for axis in (0, 1):
        # in units of h/a²
        curvature = case.centre_curvature(scene, last.x, last.e, axis) / 0.02
        assert curvature == pytest.approx(want, rel=5e-3)


def test_the_cap_loses_its_stability_to_two_saddles_at_once():
    scene = case.disc(h=0.02, e_to=6.0)
    path = walked(scene, LoadSteps(rtol=1e-8, step=1 / 6), events=True)
    (branch,) = path.events
    assert branch.kind == "branch"
    # Föppl–von Kármán plates
    assert branch.e * 6 == pytest.approx(5.619216, rel=1e-2)
    # cos 2φ is even about both mirror planes, so the quarter sees it; sin 2φ, its twin, is odd.
    for point in path.points:
        expected = int(point.e > branch.e)
        assert point.unstable == case.twisted(scene, point.x, point.e) == expected


# -- 6. snap-through -----------------------------------------------------------------------------


def crown_path(scene, crown, until, **options):
    def sink(p):
        return -scene.displacement(p.x, p.e)[crown, 1].mean()

    stepper = options.pop("stepper", ArcLength(rtol=1e-7, a=0.02, b=0.05))
    path = walked(scene, stepper, until=lambda p: sink(p) - until, **options)
    return path, np.array([sink(p) for p in path.points])


def test_clamped_arch_snaps_through():
    scene, crown = case.arch(hinged=False, n=8, e_to=40.0)
    path, _ = crown_path(scene, crown, 1.8, events=True)
    folds = [event for event in path.events if event.kind == "fold"]
    assert len(folds) == 2
    for fold, (P, w) in zip(folds, ((34.090009, 0.384537), (14.253024, 1.350383)), strict=True):
        assert fold.e * 40 == pytest.approx(P, rel=1e-2)
        sink = -scene.displacement(fold.x, fold.e)[crown, 1].mean()
        assert sink == pytest.approx(w, rel=2e-2)


def test_hinged_arch_branches_before_its_limit_point():
    scene, crown = case.arch(hinged=True, whole=True, n=8, e_to=40.0)
    # So long a step round the fold that the cubic between its ends buckles the arch.
    stepper = ArcLength(rtol=1e-7, a=0.02, b=0.05, forward=0.9)
    path, _ = crown_path(scene, crown, 0.6, stepper=stepper, events=True)
    branch = next(event for event in path.events if event.kind == "branch")
    assert branch.e * 40 == pytest.approx(27.778923, rel=1e-2)
    sink = -scene.displacement(branch.x, branch.e)[crown, 1].mean()
    assert sink == pytest.approx(0.267101, rel=2e-2)
    fold = next(event for event in path.events if event.kind == "fold")
    assert fold.e * 40 == pytest.approx(31.798471, rel=1e-2)


def test_hinged_roof_snaps_through_and_back():
    scene, crown = case.roof()
    # Longer steps would do for the path, not for reading it between its points.
    stepper = ArcLength(rtol=1e-6, a=0.008, b=0.1, largest=2.0)
    path, sinks = crown_path(scene, crown, 27.0, stepper=stepper)
    # Steps are long beside the bend at the limit point: lines between points cut it off by 1.7 %.
    speeds = [-scene.step_displacement(p.tangent[:-1])[crown, 1].mean() for p in path.points]
    slopes = [p.tangent[-1] / v for p, v in zip(path.points, speeds, strict=True)]
    P = CubicHermiteSpline(sinks, path.loads, slopes)
    # Published for shells (Sze, Liu and Lo 2004), P/3000 : sink in mm, along the path.
    for share, sink in (
        (0.4686, 4.477),
        (0.7246, 9.339),
        (0.7421, 11.293),
        (0.5643, 14.728),
        (0.1729, 19.852),
        (0.6644, 26.601),
    ):
        assert P(sink) == pytest.approx(share, rel=0.01), sink


def test_lees_frame_through_its_limit_and_turning_points():
    scene, at = case.frame()

    def moved(p):
        return scene.displacement(p.x, p.e)[at].mean(axis=0) * (1, -1, 1)

    def sinking(p):
        return -scene.step_displacement(p.tangent[:-1])[at, 1].mean()

    def rising(p):
        return p.tangent[-1]

    # Each leg ends on its point exactly, and the next one sets out from there.
    legs, here = [], np.zeros(scene.size)
    stepper = ArcLength(rtol=1e-6, a=0.05, b=0.3, order=4, easy=8)
    for until in (rising, sinking, rising):
        leg = trace(scene, here, stepper, until=until, max_steps=100, events=False)
        assert leg.reached, leg.outcome.value
        legs.append(leg)
        here = leg.last
    limit, turn, lowest = (leg.last for leg in legs)
    assert limit.e == pytest.approx(1.855673, rel=5e-3)
    assert moved(limit)[:2] == pytest.approx([26.8806, 48.7352], rel=5e-3)
    assert turn.e == pytest.approx(1.194410, rel=5e-3)
    assert moved(turn)[1] == pytest.approx(61.00295, rel=5e-3)
    assert lowest.e == pytest.approx(-0.941443, rel=5e-3)
    assert moved(lowest)[1] == pytest.approx(58.2167, rel=5e-3)
    up = legs[0].points
    P = CubicHermiteSpline(
        [moved(p)[1] for p in up], legs[0].loads, [rising(p) / sinking(p) for p in up]
    )
    for v, want in ((10, 0.963551), (30, 1.595295), (45, 1.839331)):
        assert P(v) == pytest.approx(want, rel=5e-3)


# -- 7. buckling ---------------------------------------------------------------------------------


def first_branch(scene, **options):
    path = trace(
        scene,
        np.zeros(scene.size),
        LoadSteps(rtol=1e-9, step=0.1),
        max_steps=100,
        events=True,
        **options,
    )
    return next(event for event in path.events if event.kind == "branch")


def test_euler_clamped_free():
    scene = case.column(end_load=1.2 * np.pi**2 / 4, h=0.01)
    assert first_branch(scene).e * 1.2 == pytest.approx(1, rel=1e-2)


def test_euler_clamped_clamped():
    # The end comes down without turning: the load is its reaction.
    scene, top = case.squeezed_column(h=0.01, shortening=1.2 * 4 * np.pi**2 * 0.01**2 / 12)
    event = first_branch(scene)
    force = reaction(scene, event.x, event.e, top).force
    assert -force[0] / 0.01 == pytest.approx(4 * np.pi**2, rel=1e-2)


def test_a_cantilever_beyond_its_euler_load():
    # At P/P_cr = 1.151720 the tip stands at 60°, 0.741020 high; the straight column goes on too.
    critical, share = np.pi**2 / 4, 1.151720
    scene = case.column(end_load=share * critical, h=0.01)
    steps = LoadSteps(rtol=1e-9, step=0.05)
    straight = walked(scene, steps, events=True)
    (branch,) = straight.events
    bent = switch(scene, branch, straight.last, rtol=1e-9, amplitude=0.1)
    path = trace(scene, bent, steps, max_steps=50, events=False)
    assert path.reached and path.last.unstable == 0 and straight.last.unstable == 1
    _, shortening, turned = MidLine(scene).tip(path.last.x, path.last.e)
    assert abs(turned) == pytest.approx(np.pi / 3, rel=1e-3)
    assert 1 - shortening == pytest.approx(0.741020, rel=1e-3)


def test_where_no_second_path_is_near_the_switch_says_so():
    # A tenth of the load buckles the column at ten times the e, far from the event.
    heavy, light = (case.column(end_load=p * np.pi**2 / 4, h=0.01) for p in (1.2, 0.12))
    steps = LoadSteps(rtol=1e-9, step=0.05)
    straight = walked(heavy, steps, events=True)
    (branch,) = straight.events
    assert switch(light, branch, straight.last, rtol=1e-9, amplitude=0.1) is Outcome.NO_BRANCH
    assert "no second branch" in Outcome.NO_BRANCH.value


def test_iterations_that_are_used_up_are_told_with_how_near_they_came():
    scene = cantilever(tip_load=1.0)
    short = newton(scene, np.zeros(scene.size), 0.2, rtol=1e-9, max_iterations=2)
    assert short.outcome is Outcome.NOT_CONVERGED and short.iterations == 2
    assert not short.converged and short.correction > 1e-9
    long = newton(scene, np.zeros(scene.size), 0.2, rtol=1e-9, max_iterations=200)
    assert long.converged and long.iterations > 2


def test_self_weight_buckling():
    scene = case.column(weight=9.0, h=0.01)
    assert first_branch(scene).e * 9.0 == pytest.approx(7.837347439, rel=1e-2)


@pytest.mark.parametrize(
    "gamma, angle, height",
    [
        (8.5, 0.836796, 0.796216),
        # Here the switch's first try beside the branch point went back to the straight column.
        (8.5 * (1 + 3e-11 * 784), 0.836796, 0.796216),
        (12.0, 1.835560, 0.162135),
    ],
)
def test_the_heavy_column_bends_over_on_its_stable_path(gamma, angle, height):
    scene = case.column(weight=gamma, h=0.01, n=12)
    path = walked(scene, StableSteps(LoadSteps(rtol=1e-8, step=0.05)), events=True)
    assert path.last.unstable == 0
    assert [event.kind for event in path.events] == ["branch", "bifurcation"]
    # It goes over where it can, not a step later, and doesn't creep there.
    assert path.events[1].e - path.events[0].e == pytest.approx(0.01 * 0.05, rel=1e-6)
    assert path.iterations < 300
    _, shortening, turned = MidLine(scene).tip(path.last.x, path.last.e)
    assert abs(turned) == pytest.approx(angle, rel=1e-2)
    assert 1 - shortening == pytest.approx(height, rel=1e-2, abs=2e-3)
