"""The heavy strip with a curved hinge on the ground (references.md §2): a solid model against an
ordinary differential equation solved to 1e-12.

The flat strip lies down first; then its hinge curls, and what lifts off or comes down does so on
the stable path.
"""

import numpy as np
import pytest
import reference_structures as case

from solver.paths.continuation import follow, load, trace
from solver.paths.stable import StableSteps
from solver.paths.steppers import LoadSteps

# (κ₀, γ, B_p, h): θ at the hinge's edge, θ at the tip, height of the tip; B_h = 1.
# A thick strip touches the ground with the corner of its tip, half a thickness off its mid-line:
# where the tip turns far the strip is thinner.
CASES = {
    "centre on the ground": ((10, 10, 1, 0.01), (0.932413, 0.864297, 0.351655)),
    "panels sag": ((10, 50, 1, 0.01), (0.510316, -0.017698, 0.068417)),
    "tips on the ground too": ((10, 100, 1, 0.01), (0.345359, -0.092597, 0)),
    "flat panels, flat centre": ((10, 200, 1, 0.01), (0.232538, 0, 0)),
    "stiff panels": ((10, 25, 50, 0.01), (0.816844, 0.813182, 0.328690)),
    "stiff panels, flat centre": ((10, 100, 50, 0.01), (0.048355, 0.027033, 0.013713)),
    "stiff panels, tips down": ((10, 150, 50, 0.01), (0.015007, -0.003947, 0)),
    "bilayer": ((15, 0.5, 1 / 49.5, 0.01), (1.499095, 1.475190, 0.460308)),
    "heavier bilayer": ((15, 2, 1 / 49.5, 0.01), (1.493044, 1.102140, 0.433300)),
    "bilayer, tips down": ((15, 5, 1 / 49.5, 0.005), (1.464527, -0.645672, 0)),
}


def followed(scene, start, until, stepper):
    """Points up to the load ``until`` or to the first event."""
    points = []
    for point in follow(scene, start, stepper, until=load(until), max_steps=200, events=False):
        points.append(point)
        if point.events:
            break
    return points


@pytest.mark.parametrize("name", CASES)
def test_a_heavy_strip_folds_as_far_as_the_elastica(name):
    (curvature, weight, panel, h), (edge, tip, height) = CASES[name]
    scene, ground = case.heavy_strip(curvature=curvature, weight=weight, panel=panel, h=h)
    points = followed(
        scene, np.zeros(scene.size), 1.0, StableSteps(LoadSteps(rtol=1e-8, step=0.1), locate=False)
    )
    x, e = points[-1].x, points[-1].e
    assert e == 1.0 and points[-1].unstable == 0
    assert case.section(scene, x, e, 0.1)[1] == pytest.approx(edge, rel=5e-3, abs=2e-3)
    z, turned = case.section(scene, x, e, 0.5)
    assert turned == pytest.approx(tip, rel=5e-3, abs=2e-3)
    assert z == pytest.approx(height, rel=5e-3, abs=2e-3)
    # Half of the strip, h wide; upward force of the ground against its weight.
    u = scene.displacement(x, e)
    up = -ground.evaluate(u, e, 1).force[:, 2]
    assert up.sum() == pytest.approx(weight * h / 2, rel=1e-6)
    # The reference is about a rigid ground: here it gives way by a hundredth of the thickness.
    assert ground.gaps(u).min() > -0.0101 * h


def test_the_tips_of_a_strip_that_lies_on_three_lines_carry_their_share():
    scene, ground = case.heavy_strip(curvature=10, weight=100)
    points = followed(
        scene, np.zeros(scene.size), 1.0, StableSteps(LoadSteps(rtol=1e-8, step=0.1), locate=False)
    )
    up = -ground.evaluate(scene.displacement(points[-1].x, 1.0), 1.0, 1).force[:, 2]
    tip = scene.body.nodes[:, 0] > 0.3
    assert up[tip].sum() / 0.01 == pytest.approx(7.826352, rel=5e-3)


def turning_point(scene, points):
    """κ₀ l/2 and rotation of the tip where κ₀ = 20 e turns back, from four points before a snap.

    κ₀ is taken as a cubic of the rotation, and its extremum beyond them.
    """
    last = points[-5:-1]
    angles = np.array([case.section(scene, p.x, p.e, 0.5)[1] for p in last])
    cubic = np.polynomial.Polynomial.fit(angles, [20 * p.e * 0.1 for p in last], 3)
    at = min(cubic.deriv().roots(), key=lambda r: abs(r - angles[-1]))
    assert abs(np.imag(at)) == 0
    return cubic(at.real), at.real


def test_weight_makes_folding_snap_over_and_back():
    # B_h/B_p = 0.02, γ = 150; thin, for the limits move with the thickness.
    scene, _ = case.heavy_strip(curvature=20, weight=150, panel=50, h=0.005, n=(6, 8))
    stepper = StableSteps(LoadSteps(rtol=1e-8, step=0.04, cut=4.0), cuts=4, locate=False)
    up = followed(scene, np.zeros(scene.size), 1.0, stepper)
    (snap,) = up[-1].events
    assert snap.kind == "snap" and snap.energy_drop > 0 and up[-1].unstable == 0
    turning, angle = turning_point(scene, up)
    assert turning == pytest.approx(1.931488, rel=2e-3)
    assert angle == pytest.approx(0.806339, rel=5e-3)
    # It has gone over, and stays there far below the load at which it went.
    assert case.section(scene, up[-1].x, up[-1].e, 0.5)[1] % (2 * np.pi) > np.pi / 2
    down = followed(scene, up[-1], 0.5, stepper)
    assert [event.kind for event in down[-1].events] == ["snap"]
    turning, angle = turning_point(scene, down)
    assert turning == pytest.approx(1.503763, rel=2e-3)
    assert angle == pytest.approx(2.424700, rel=5e-3)


@pytest.mark.parametrize(("curvature", "weight"), [(5, 2), (10, 20), (15, 100)])
@pytest.mark.parametrize("step", [0.1, 0.2])
def test_stable_steps_lift_off_wherever_plain_load_steps_do(curvature, weight, step):
    """A sheet at rest whose hinge lifts it: the fall to its rest is all that stable steps add."""
    scene, _ = case.heavy_strip(curvature=curvature, weight=weight, n=(6, 10))
    plain = LoadSteps(1e-8, step)
    ends = []
    for stepper in (plain, StableSteps(plain, locate=False)):
        path = trace(scene, np.zeros(scene.size), stepper, max_steps=300, events=False)
        assert path.reached
        ends.append(path)
    assert ends[1].iterations <= ends[0].iterations + 5
    assert np.abs(ends[1].last.x - ends[0].last.x)[: scene.n_free].max() < 1e-7
