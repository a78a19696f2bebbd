"""Morphogens beside closed forms and series: at rest, in time, in curved and in moving bodies."""

import numpy as np
import pytest
from proofs import BODIES, state
from pytest import approx
from scipy.special import iv, kv

from solver.cases.tissue.morphogen import Gradient
from solver.mesh.body import Body
from solver.mesh.structured import box, polar
from solver.physics.fields import Unphysical
from solver.transport.morphogen import Course, Influx, Kept, Morphogen

CASE = Gradient()


@pytest.mark.parametrize(
    ("element", "order"), [("hex8", 2), ("hex20", 3), ("hex27", 3), ("tet4", 2), ("tet10", 3)]
)
def test_a_gradient_at_rest_converges_with_the_order_of_the_element(element, order):
    errors = []
    for cells in (8, 16):
        morphogen = CASE.morphogen(CASE.body(cells, element))
        c = morphogen.steady()
        errors.append(morphogen.error(c, lambda X: CASE.steady(X[..., 0])))
    assert np.log2(errors[0] / errors[1]) == approx(order, abs=0.12)
    assert errors[1] < (0.02 if order == 2 else 2e-3)


def test_in_a_long_bar_it_falls_by_e_over_a_length():
    long = Gradient(length=10.0)
    body = long.body(80, "hex27")
    c, x = long.morphogen(body).steady(), body.nodes[:, 0]
    near = x < 5
    np.testing.assert_allclose(c[near], np.exp(-x[near] / 0.5), atol=2e-5)


@pytest.mark.parametrize(("t", "most"), [(0.05, 5e-3), (0.5, 2e-4), (3.0, 2e-4)])
def test_a_gradient_that_was_set_in_at_once_follows_the_series(t, most):
    # Early the front, √(D t) wide, is as narrow as an element.
    body = CASE.body(24, "hex27")
    morphogen = CASE.morphogen(body)
    c = morphogen.march(t, t / 100).last
    assert morphogen.error(c, lambda X: CASE.series(X[..., 0], t)) < most
    if t < 1:
        assert morphogen.error(c, lambda X: CASE.steady(X[..., 0])) > 0.1


def test_the_series_starts_at_nothing_and_ends_at_rest():
    x = np.linspace(0.1, 3.0, 30)
    assert np.abs(CASE.series(x, 1e-6, terms=20_000)).max() < 1e-3
    np.testing.assert_allclose(CASE.series(x, 30.0), CASE.steady(x), atol=1e-10)


def test_the_order_in_time_is_two():
    body = CASE.body(16, "hex27")
    morphogen, errors = Morphogen(body, 0.25, 1.0), []
    k = 2 * np.pi / CASE.length

    def exact(X):
        return (1 + np.cos(k * X[..., 0]) * np.exp(-0.25 * k * k)) * np.exp(-1.0)

    start = 1 + np.cos(k * body.nodes[:, 0])
    for steps in (10, 20, 40):
        errors.append(morphogen.error(morphogen.march(1.0, 1 / steps, c=start).last, exact))
    ratios = np.array(errors[:-1]) / errors[1:]
    np.testing.assert_allclose(ratios, 4, rtol=0.07)


def test_coefficients_of_the_time_keep_the_order():
    # Alike everywhere, c′ = t − t c has the solution 1 − exp(−t²/2).
    body = BODIES["hex8"]
    morphogen = Morphogen(body, lambda t: 1 + t, lambda t: t, lambda t, X: t + 0 * X[..., 0])
    off = [
        np.abs(morphogen.march(1.5, 1.5 / n).last - (1 - np.exp(-1.125))).max() for n in (20, 40)
    ]
    assert off[0] / off[1] == approx(4, rel=0.15) and off[1] < 1e-3


def test_what_flows_in_is_what_decays():
    body = CASE.body(16, "hex27")
    inlet = body.surface("x-")
    morphogen = Morphogen(body, 0.25, 1.0, influx=[Influx(inlet, lambda t: 2 * t)])
    c = morphogen.steady(t=0.15)
    # −D c′ = j: c = j λ/D cosh((L − x)/λ)/sinh(L/λ), and ∫ k c = j times the section.
    scale = 0.3 * 0.5 / 0.25 / np.tanh(3 / 0.5)
    assert morphogen.error(c, lambda X: scale * CASE.steady(X[..., 0])) < 1e-3
    assert morphogen.amount(c) == approx(0.3 * inlet.weights.sum(), rel=1e-12)
    # In time, without decay, all that came in is there.
    open_ = Morphogen(body, 0.25, influx=[Influx(inlet, 0.3)])
    course = open_.march(2.0, 0.1)
    amounts = [open_.amount(c) for c in course.c]
    np.testing.assert_allclose(amounts, 0.3 * inlet.weights.sum() * course.t, atol=1e-12)


def test_an_influx_may_change_while_all_else_rests():
    body = CASE.body(4, "hex8")
    inlet = body.surface("x-")
    morphogen = Morphogen(body, 1.0, influx=[Influx(inlet, lambda t: 3 * t)])
    area = inlet.weights.sum()
    assert morphogen.amount(morphogen.march(2.0, 0.02).last) == approx(6 * area, rel=1e-3)


@pytest.mark.parametrize("element", ["tet10", "tet4", "hex8", "hex27"])
def test_products_of_shapes_are_integrated_exactly(element):
    # Of the amount of c², c as rich as the element.
    power = 2 if element in ("tet10", "hex27") else 1
    body = CASE.body(3, element)
    c = body.nodes[:, 0] ** power
    mass, _, _ = CASE.morphogen(body)._matrices(0.0, None)
    n = 2 * power + 1
    assert c @ (mass @ c) == approx(0.04 * 3.0**n / n, rel=1e-12)


def test_in_a_curved_body_it_is_a_bessel_function():
    mesh = box(np.linspace(1, 2, 9), np.linspace(0, 0.5, 3), [0, 0.2], shape=polar)
    body = Body.build(mesh, "hex27")
    r = np.hypot(*body.nodes.T[:2])
    kept = [Kept(np.abs(r - 1) < 1e-9, 1.0), Kept(np.abs(r - 2) < 1e-9, 0.4)]
    morphogen = Morphogen(body, 0.09, 1.0, kept=kept)
    a, b = np.linalg.solve([[iv(0, R / 0.3), kv(0, R / 0.3)] for R in (1.0, 2.0)], [1.0, 0.4])

    def exact(X):
        s = np.hypot(X[..., 0], X[..., 1]) / 0.3
        return a * iv(0, s) + b * kv(0, s)

    assert morphogen.error(morphogen.steady(), exact) < 5e-4


def test_cells_of_their_own_make_what_they_make():
    body = BODIES["hex27"]
    left = body.cells_where(lambda X: X[:, 0] < 0.5)
    source = np.where(left, 3.0, 1.0)
    morphogen = Morphogen(body, np.where(left, 1e3, 2e3), 0.5, source)
    c = morphogen.steady()
    # Mixed through, it is the mean of what is made over the decay.
    mean = (body.weights.sum(1) * source).sum() / body.weights.sum()
    np.testing.assert_allclose(c, mean / 0.5, rtol=2e-3)
    assert np.ptp(c) > 1e-6


def stretched(body, a, b=0.8):
    return body.nodes * (a - 1, b - 1, b - 1)


def test_in_the_deformed_body_it_reaches_as_far_as_there():
    body = CASE.body(24, "hex27")
    morphogen = CASE.morphogen(body)
    for a in (0.7, 1.5):
        c = morphogen.steady(u=stretched(body, a))
        wanted = Gradient(length=a * CASE.length)
        assert morphogen.error(c, lambda X, a=a, w=wanted: w.steady(a * X[..., 0])) < 1e-3
        assert morphogen.error(c, lambda X: CASE.steady(X[..., 0])) > 0.1
        assert (
            morphogen.error(
                morphogen.march(6.0, 0.1, u=lambda t, a=a: stretched(body, a)).last,
                lambda X, a=a, w=wanted: w.steady(a * X[..., 0]),
            )
            < 2e-3
        )


def test_a_body_that_swells_dilutes_and_keeps_the_amount():
    body, rng = BODIES["hex27"], np.random.default_rng(2)
    morphogen = Morphogen(body, 1.0)
    course = morphogen.march(1.0, 0.1, c=2.0, u=lambda t: stretched(body, 1 + t))
    np.testing.assert_allclose(course.last, 2.0 / 2, rtol=1e-9)
    start, u = rng.uniform(0.5, 1.5, len(body.nodes)), state(body)
    course = morphogen.march(1.0, 0.1, c=start, u=lambda t: t * u)
    assert morphogen.amount(course.last, u) == approx(morphogen.amount(start), rel=1e-10)
    assert morphogen.amount(course.last) != approx(morphogen.amount(start), rel=1e-2)


def test_a_kept_value_may_change_and_holds_from_the_start():
    body = CASE.body(4, "hex8")
    inside = body.nodes[:, 0] < 1e-9
    morphogen = Morphogen(body, 1.0, 1.0, kept=[Kept(inside, lambda t: 1 + t)])
    course = morphogen.march(2.0, 0.3, c=0.5, t=1.0)
    assert course.t == approx(np.linspace(1, 2, 5))  # equal steps of 0.3 at most
    np.testing.assert_allclose(course.c[:, inside], 1 + course.t[:, None] * np.ones(inside.sum()))
    np.testing.assert_array_equal(course.c[0, ~inside], 0.5)


def test_a_course_is_linear_in_between_and_kept_beyond():
    body = BODIES["hex8"]
    t, c = np.array([0.0, 1.0, 3.0]), np.outer([1.0, 2.0, 6.0], np.ones(len(body.nodes)))
    course = Course(body, t, c)
    for at, value in ((-1, 1.0), (0.5, 1.5), (1.0, 2.0), (2.0, 4.0), (9.0, 6.0)):
        np.testing.assert_allclose(course.at(at), value)
        field = course.drives(lambda c: 10 * c)(at)
        assert field.shape == body.weights.shape and field == approx(10 * value)


def test_bad_input():
    body = BODIES["hex8"]
    for given, kind, says in (
        ({"diffusivity": 0.0}, Unphysical, "diffusivity = 0 at t = 0; expected more than 0"),
        ({"diffusivity": 1.0, "decay": -1.0}, Unphysical, "decay = -1 at t = 0; expected 0 or"),
        ({"diffusivity": np.ones(3)}, ValueError, "the diffusivity gave shape"),
        ({"diffusivity": 1.0, "kept": [1.0]}, ValueError, "list of Kept"),
        ({"diffusivity": 1.0, "kept": [Kept([0, 1], 1.0), Kept([1], 2.0)]}, ValueError, "node 1"),
        ({"diffusivity": 1.0, "kept": [Kept(body.nodes[:, 0] > -1, 1.0)]}, ValueError, "all nodes"),
    ):
        with pytest.raises(kind, match=says):
            Morphogen(body, **given)
    morphogen = Morphogen(body, 1.0)
    with pytest.raises(ValueError, match="nothing decays and no node is kept"):
        morphogen.steady()
    with pytest.raises(ValueError, match="expected a time after t = 1"):
        morphogen.march(1.0, 0.1, t=1.0)
    with pytest.raises(ValueError, match="dt = 0"):
        morphogen.march(1.0, 0.0)
    with pytest.raises(ValueError, match="expected a finite number or"):
        morphogen.march(1.0, 0.1, c=np.zeros(3))
    with pytest.raises(ValueError, match="u has shape"):
        morphogen.march(1.0, 0.1, u=lambda t: np.zeros(3))
    with pytest.raises(Unphysical, match="inside out"):
        morphogen.march(1.0, 0.1, u=lambda t: -2 * body.nodes * (1, 0, 0))
