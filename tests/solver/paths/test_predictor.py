"""Which guess a step of arc length starts from: by what it costs in thin bodies, and by itself."""

import numpy as np
import pytest
import reference_structures as case
from path_toys import truss
from reference_scenes import MidLine, cantilever

from solver.paths.continuation import load, trace
from solver.paths.predictor import choose, extrapolate, guesses
from solver.paths.steppers import ArcLength, LoadSteps


def walked(scene, until, max_steps):
    stepper = ArcLength(1e-8, a=0.02, b=0.05)
    path = trace(
        scene, np.zeros(scene.size), stepper, until=until, max_steps=max_steps, events=False
    )
    assert path.reached, path.outcome.value
    return path


def sink(scene, nodes):
    return lambda p: -scene.displacement(p.x, p.e)[nodes, 1].mean()


# Bounds: 1.3 times the iterations of the best of the guesses, taken at every step: the cubic's 62
# and 391, the tangent's 303, the chord's 840. The least residual of all, with "load forward, shape
# kept" among them, took 471, more than 794 in 150 steps, and came to e = 0.011 and 0.0033.


def test_williams_toggle_in_few_iterations():
    scene, crown = case.toggle()
    down = sink(scene, crown)
    path = walked(scene, lambda p: p.e - 1 if down(p) > 0.5 else -1.0, 60)
    assert path.iterations <= 80
    assert down(path.last) > 0.386 and path.last.unstable == 0


def test_a_deep_arch_passes_its_limit_point_in_few_iterations():
    scene, crown = case.deep_arch()
    down = sink(scene, crown)
    path = walked(scene, lambda p: down(p) - 112.0, 150)
    assert path.iterations <= 508
    # 897 for an inextensible arch
    assert max(path.loads) * 1000 == pytest.approx(897, rel=0.02)


@pytest.mark.parametrize("h, most", [(1e-3, 394), (3e-4, 1092)])
def test_a_thin_cantilever_in_few_iterations(h, most):
    scene = cantilever(tip_load=10.0, h=h)
    path = walked(scene, load(1.0), 300)
    assert path.iterations <= most
    drop, shortening, _ = MidLine(scene).tip(path.last.x, path.last.e)
    assert (drop, shortening) == pytest.approx((0.810609025, 0.554995598), rel=2e-2)


def test_a_guess_that_buckles_the_body_gives_way_to_one_that_stretches_it():
    # Axial strain −1e-5 of a clamped strip, fifty times Euler's; +2e-5 has twice the residual.
    scene = cantilever(tip_load=1.0, h=1e-3)
    along = np.outer(scene.body.nodes[:, 0], (1, 0, 0))
    squeezed, stretched = (np.append(scene.unknowns(s * along), 0.0) for s in (-1e-5, 2e-5))
    z, system, refused = choose(scene, [stretched, squeezed], 0)
    assert z is stretched and refused == 1 and system.unstable == 0
    many = scene.system(squeezed[:-1], 0.0).unstable
    assert many > 1
    for expected in (many, None):
        z, _, refused = choose(scene, [stretched, squeezed], expected)
        assert z is squeezed and refused == 0


def test_polynomials_through_points_with_and_without_slopes():
    def z(s):
        return np.array([s**3 - 2 * s, 4 - s**2])

    def slope(s):
        return np.array([3 * s**2 - 2, -2 * s])

    with_slopes = extrapolate([(s, z(s), slope(s)) for s in (0.0, -0.7)], 1.5)
    assert with_slopes[0] == pytest.approx(z(0) + 1.5 * slope(0))
    assert with_slopes[2] == pytest.approx(z(1.5))
    chord, parabola, cubic = extrapolate([(s, z(s), None) for s in (0.0, -0.7, -1, -2)], 1.5)
    assert chord == pytest.approx(z(0) + 1.5 * (z(0) - z(-0.7)) / 0.7)
    assert parabola[1] == pytest.approx(z(1.5)[1]) and parabola[0] != pytest.approx(z(1.5)[0])
    assert cubic == pytest.approx(z(1.5))


def test_guesses_lie_on_the_ellipsoid_and_without_a_past_the_tangent_is_the_only_one():
    scene = truss()
    stepper = LoadSteps(1e-10, 2e-5)
    path = trace(scene, np.zeros(1), stepper, until=load(1.4e-4), max_steps=9)
    first, last = path.points[0], path.points[-1]
    (only,) = guesses(first, first.metric, 3)
    assert only == pytest.approx(first.z + first.metric.unit(first.tangent))
    options = guesses(last, last.metric, 3)
    # The tangent, parabola and cubic with tangents, chord, parabola and cubic through points.
    assert len(options) == 6
    for z in options:
        assert last.metric.norm(z - last.z) == pytest.approx(1, rel=1e-12)
