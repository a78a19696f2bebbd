"""Derivatives of a state by the groups of its unit, against states of changed units."""

from dataclasses import replace

import numpy as np
import pytest
from folding_units import COARSEST, HEAVY, P

from foldlab.labels.foldability import measure
from solver.cases.unit.choices import Meshing, Physics
from solver.cases.unit.model import build
from solver.cases.unit.path import fold
from solver.cases.unit.sensitivity import GROUPS, MATERIAL, neighbours
from solver.equilibrium.newton import newton


def solved(model, x, e):
    result = newton(model.scene, x, e, rtol=1e-11, max_iterations=30, unstable=0)
    assert result.converged
    return result.x


def turnings(model, x, e):
    m = measure(model.curves(x, e), model.unit.hinge_length)
    return np.array([m.m1, m.m2])


def tip(model, x, e):
    y = model.body.nodes + model.scene.displacement(x, e)
    return y[np.argmax(model.body.nodes[:, 1]), 2]


SLIM = replace(P, hinge_width=0.7)
CASES = {
    "on the ground": (replace(HEAVY, hinge_width=0.7), Physics(), ("x", "y"), 1.0),
    "isotropic, without weight": (SLIM, Physics((), growth="isotropic"), ("x", "y"), 0.3),
    "contact of the panels": (SLIM, Physics(("contact",)), ("x", "y"), 1.0),
}


@pytest.fixture(scope="module", params=CASES.values(), ids=CASES.keys())
def state(request):
    """A model, an equilibrium of it to roundoff, and its load."""
    unit, physics, mirrors, e = request.param
    found = fold(build(unit, Meshing(COARSEST), physics), stop=lambda s: s.e >= e)
    model, e = found.model, found.last.e
    assert model.mirrors == mirrors
    return model, solved(model, found.x, e), e


@pytest.mark.parametrize("group", GROUPS)
def test_they_are_those_of_units_that_were_solved_anew(state, group):
    model, x, e = state
    (side,) = neighbours(model, x, e, (group,))
    value = getattr(model.unit, group)
    assert side.apart == pytest.approx(value * (2e-4 if group in MATERIAL else 2e-5), rel=1e-6)
    for quantity in (turnings, tip):
        rate = (quantity(*side.above, e) - quantity(*side.below, e)) / side.apart
        coarse, fine = (_by_solving(model, x, e, group, h, quantity) for h in (2e-3, 1e-3))
        # Richardson: what is off falls with the square of the step.
        expected = fine + (fine - coarse) / 3
        # What a derivative must be right to: of what the quantity is per value of the group.
        scale = 0.1 * np.abs(quantity(model, x, e)) / value
        assert np.all(np.abs(rate - expected) <= 1e-5 * np.abs(expected) + 1e-5 * scale), group


def _by_solving(model, x, e, group, h, quantity):
    ends = []
    for sign in (-1, 1):
        unit = replace(model.unit, **{group: getattr(model.unit, group) * (1 + sign * h)})
        other = build(unit, model.meshing, model.physics, model.supports)
        ends.append(quantity(other, solved(other, x, e), e))
    return (ends[1] - ends[0]) / (2 * h * getattr(model.unit, group))


@pytest.mark.parametrize("group", ["E_ratio", "slenderness", "contraction"])
def test_a_twisted_unit_has_them_too(twisted, group):
    model, x, e = twisted
    (side,) = neighbours(model, x, e, (group,))
    rate = (turnings(*side.above, e) - turnings(*side.below, e)) / side.apart
    coarse, fine = (_by_solving(model, x, e, group, h, turnings) for h in (1e-3, 5e-4))
    expected = fine + (fine - coarse) / 3
    assert rate == pytest.approx(expected, rel=1e-4)


@pytest.fixture(scope="module")
def twisted():
    found = fold(
        build(P, Meshing(COARSEST), Physics((), growth="isotropic")),
        stop=lambda s: s.e > 0.4 and len(s.checks) == 2,
    )
    assert found.model.mirrors == ("turn",)
    return found.model, solved(found.model, found.x, found.last.e), found.last.e


def test_a_group_that_takes_other_elements_is_left_out():
    # A hinge narrower than its panels by a hair has a column of cells beside it.
    assert P.hinge_width == 1.0
    found = fold(build(P, Meshing(COARSEST), Physics(())))
    sides = list(neighbours(found.model, found.x, 1.0))
    assert [side.group for side in sides] == [g for g in GROUPS if g != "hinge_width"]


def test_states_without_derivatives_say_why():
    rough = build(HEAVY, Meshing(COARSEST), Physics(friction=0.3))
    with pytest.raises(ValueError, match="friction hangs on its whole path"):
        next(neighbours(rough, np.zeros(rough.scene.size), 0.0))
    plain = build(P, Meshing(COARSEST), Physics(()))
    own = build(P, Meshing(body=plain.body), Physics(()))
    with pytest.raises(ValueError, match="mesh of one's own does not follow"):
        next(neighbours(own, np.zeros(own.scene.size), 0.0))
