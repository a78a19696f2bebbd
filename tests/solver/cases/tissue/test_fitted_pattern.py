"""Patterns of the furrow with parameters, and what a fit of them finds."""

import numpy as np
import pytest
from pytest import approx

from solver.cases.tissue import furrow
from solver.cases.tissue.pattern import Free, Profile, outside, places
from solver.fitting.elastic import Equilibria
from solver.fitting.fit import Prior, fit
from solver.fitting.targets import Cloud, Measured, section

RNG = np.random.default_rng(0)
SHAPE = furrow.Shape()
WAYS = RNG.standard_normal((200, 3))
SPOTS = SHAPE.place(
    RNG.uniform(0.05, 0.95, 200), WAYS / np.linalg.norm(WAYS, axis=1, keepdims=True)
)


def test_the_profile_is_the_shape_s_pattern():
    wide = furrow.Shape(angle=0.4, reach=0.8)
    found = Profile().values(np.array([1.0, 0.4, 0.8]), SPOTS)
    assert found == approx(wide.beta(SPOTS)) and found.max() > 0.1
    both = Profile(contraction=True)
    assert both.values(np.array([0.5, 0.4, 0.8, 0.6]), SPOTS) == approx(0.3 * found)
    assert both.names == ("strength", "angle", "reach", "contraction")
    assert len(both.low) == len(both.high) == 4 and len(Profile().low) == 3


@pytest.mark.parametrize("field", [Profile(), Profile(contraction=True), Free()], ids=str)
def test_slopes_are_those_of_the_values(field):
    p = field.low + RNG.uniform(0.3, 0.7, len(field.low)) * (field.high - field.low)
    slopes, h = field.slopes(p, SPOTS), 1e-6
    assert slopes.shape == (200, len(p)) and np.abs(slopes).max(axis=0).min() > 1e-3
    for k, d in enumerate(h * np.eye(len(p))):
        change = (field.values(p + d, SPOTS) - field.values(p - d, SPOTS)) / (2 * h)
        assert slopes[:, k] == approx(change, abs=1e-8)


def test_a_free_field_is_what_stands_at_its_knots():
    field = Free(around=(0.0, 0.2, 0.6), along=(0.0, 0.5))
    assert field.grid == (2, 2)
    assert field.names == ("b(0 rad, 0)", "b(0 rad, 0.5)", "b(0.2 rad, 0)", "b(0.2 rad, 0.5)")

    def at(angle, x, depth=1.0):
        # An ellipsoid's places, by what is asked of them: angle and x, not direction.
        outer = np.array([SHAPE.long, SHAPE.across]) - SHAPE.thickness * (1 - depth)
        r = outer[1] * np.sqrt(1 - (x / outer[0]) ** 2)
        return np.array([[x, r * np.sin(angle), -r * np.cos(angle)]])

    p = np.array([0.8, 0.4, 0.6, 0.2])
    for angle, x, wanted in (
        (0.0, 0.0, 0.8), (0.0, 0.5, 0.4), (0.2, 0.0, 0.6), (0.2, 0.5, 0.2), (0.1, 0.25, 0.5),
        (0.4, 0.0, 0.3), (0.6, 0.0, 0.0), (1.5, 0.0, 0.0), (0.0, 0.9, 0.4), (0.0, -0.5, 0.4),
        (-0.2, 0.5, 0.2),
    ):  # fmt: skip
        assert field.values(p, at(angle, x)) == approx(wanted, abs=1e-6)
    assert field.values(p, at(0.0, 0.0, 0.5)) == approx(0.2, abs=1e-6)


def test_a_field_without_bends_has_none():
    field = Free(around=(0.0, 0.1, 0.2, 0.3, 0.4), along=(0.0, 0.5, 1.0))
    a, b = np.meshgrid(np.arange(4), np.arange(3), indexing="ij")
    assert field.bends().shape == (2 * 3 + 4, 12)
    assert field.bends() @ (1 + 2 * a - b).ravel() == approx(0.0)
    assert np.sort(field.bends() @ (a**2).ravel()) == approx([0] * 4 + [2] * 6)


@pytest.mark.parametrize("knots", [(0.1, 0.2), (0.0, 0.0), (0.0,), (0.0, 0.3, 0.2)])
def test_knots_that_do_not_increase_from_0_are_refused(knots):
    with pytest.raises(ValueError, match="knots that increase from 0"):
        Free(around=knots)
    with pytest.raises(ValueError, match="knots that increase from 0"):
        Free(along=knots)


@pytest.fixture(scope="module")
def model():
    return furrow.build(furrow.Counts(3, 4, 4, 1), element="hex20")


TRUE = np.array([0.8, 0.35, 0.7])


@pytest.fixture(scope="module")
def seen(model):
    """What leads to states, the displacement, and a hundredth of it."""
    equilibria = Equilibria(model.elastic(model.tissue.slow()), Profile())
    (state,) = equilibria.solve(TRUE, [1.0]).at
    return equilibria, state.u, 0.01 * np.abs(state.u).max()


def test_a_profile_is_found_in_the_outer_side_of_a_furrow(model, seen):
    equilibria, u, sigma = seen
    skin = outside(model.body)
    points = skin.scattered(model.body.nodes + u, 150, RNG)
    assert SHAPE.depth(skin.scattered(model.body.nodes, 150, RNG)) == approx(1.0, abs=0.02)
    points = points * RNG.choice([-1, 1], (150, 1)) ** [1, 0, 0]
    points += sigma * RNG.standard_normal(points.shape)
    found = fit(equilibria, [(1.0, Cloud(skin, points, sigma, mirrors=(0, 1)))])
    assert found.fitted and found.explained and not found.unfixed
    assert found.distance(TRUE) < 0.999
    beta, _ = found.band(equilibria.points)
    assert np.abs(beta - Profile().values(TRUE, equilibria.points)).max() < 0.05


def test_a_picture_of_the_middle_section_does_not_show_the_reach(model, seen):
    equilibria, u, sigma = seen
    skin = outside(model.body)
    x = (model.body.nodes + u)[model.body.nodes[:, 0] < 1e-9]
    rim = x[SHAPE.depth(model.body.nodes[model.body.nodes[:, 0] < 1e-9]) > 1 - 1e-6]
    flat = rim[:, 1:] + sigma * RNG.standard_normal((len(rim), 2))
    cloud = Cloud(skin, section(flat, 0), sigma, mirrors=(0, 1))
    found = fit(equilibria, [(1.0, cloud)])
    points = skin.scattered(model.body.nodes + u, 150, RNG)
    whole = fit(equilibria, [(1.0, Cloud(skin, points, sigma))], start=TRUE)
    assert found.fitted and found.sd[2] > 3 * whole.sd[2]


def test_strength_and_contraction_are_one(model, seen):
    _, u, sigma = seen
    equilibria = Equilibria(model.elastic(model.tissue.slow()), Profile(contraction=True))
    skin = outside(model.body)
    points = skin.scattered(model.body.nodes + u, 150, RNG)
    start = np.array([0.9, 0.35, 0.7, 0.9])
    found = fit(equilibria, [(1.0, Cloud(skin, points, sigma))], start=start)
    (lost,) = found.unfixed
    assert lost.sd == np.inf
    p = dict(zip(found.field.names, found.p, strict=True))
    assert p["strength"] * p["contraction"] == approx(0.8, abs=0.05)
    # One may rise as the other falls, in ranges of 0.9 each.
    ratio = lost.weights["strength"] / lost.weights["contraction"]
    assert ratio == approx(-p["strength"] / p["contraction"], rel=1e-4)
    assert abs(lost.weights["angle"]) < 1e-6


class Basal(Profile):
    """The same on the inner side of the shell."""

    def values(self, p, X):
        around, along, depth = places(SHAPE, X)
        return p[0] * np.exp(-((around / p[1]) ** 2) - (along / p[2]) ** 4) * (1 - depth) ** 2


def test_a_pattern_on_the_wrong_side_is_not_explained(model, seen):
    equilibria, _, sigma = seen
    (state,) = Equilibria(equilibria.scene, Basal()).solve(TRUE, [1.0]).at
    skin = outside(model.body)
    points = skin.scattered(model.body.nodes + state.u, 150, RNG)
    found = fit(equilibria, [(1.0, Cloud(skin, points, sigma))])
    assert not found.explained and found.chi_square > 3 * found.freedom


def test_depth_and_indentation_over_the_contraction_fix_two_of_three(model, seen):
    equilibria, _, _ = seen
    data = []
    for state in equilibria.solve(TRUE, [0.5, 1.0]).at:
        names = ("depth", "indentation")

        def measured(u, names=names):
            at = model.measure(u)
            return np.array([getattr(at, name) for name in names])

        data.append((state.e, Measured(names, measured, measured(state.u), 1e-3)))
    prior = Prior.gaussian([0.6, 0.4, 0.8], [0.3, 0.2, 0.3])
    found = fit(equilibria, data, prior=prior)
    assert found.fitted and found.distance(TRUE) < 0.95
    assert found.sd[1] < 0.1
