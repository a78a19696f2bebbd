"""What may be chosen about a model of a folding unit, at the bounds of what goes together."""

from types import SimpleNamespace

import pytest

from solver.cases.unit.choices import Changes, Meshing, Physics, Supports
from solver.cases.unit.output import Shape


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"friction": -1e-9}, "friction = -1e-09; expected a number from 0 on"),
        ({"friction": float("inf")}, "friction = inf"),
        ({"friction": 0.1, "barrier": "exponential"}, "friction acts where a sheet presses"),
        ({"friction": 0.1, "effects": ()}, "friction acts where a sheet presses"),
        ({"growth": "both"}, "growth 'both'; expected one of uniaxial"),
        ({"effects": ("gravity", "ground", "wind")}, "effect 'wind'; expected some of"),
        ({"effects": ("gravity",)}, "weight and ground come together"),
        ({"effects": ("ground", "contact")}, "weight and ground come together"),
        ({"barrier": "wall"}, "barrier 'wall'; expected 'surface' or 'exponential'"),
    ],
)
def test_physics_that_do_not_go_together_are_refused(given, says):
    with pytest.raises(ValueError, match=says):
        Physics(**given)


def test_weight_is_there_with_gravity_and_friction_may_be_none():
    assert Physics().heavy and Physics(friction=0.0, barrier="exponential").heavy
    assert not Physics(()).heavy and not Physics(("contact",)).heavy
    assert Physics(friction=0.3).friction == 0.3


def test_a_layer_changes_where_one_of_its_functions_is_given():
    assert not Physics().changes
    for name in ("stiffness", "density", "expansion"):
        change = Changes(**{name: lambda e: 1 + e})
        assert Physics(active=change).changes and Physics(passive=change).changes


def test_a_half_turn_cuts_along_one_plane_and_keeps_the_centre_in_both():
    turned, quarter, half = Supports(("turn",)), Supports(), Supports(("x",))
    assert (turned.cuts, turned.centred) == (("y",), ("x", "y"))
    assert (quarter.cuts, quarter.centred) == (("x", "y"), ("x", "y"))
    assert (half.cuts, half.centred) == (("x",), ("x",)) and quarter.upright


def test_a_mesh_of_ones_own_and_gmshs_are_not_structured():
    assert Meshing().structured and Meshing(2, "hex20").structured
    assert not Meshing(grading=0.5).structured and not Meshing(body="mine").structured


def test_the_load_of_a_release_goes_on_from_the_full_contraction():
    state = SimpleNamespace(e=0.25)
    for growth, load in (("uniaxial", 0.25), ("isotropic", 0.25), ("release", 1.25)):
        assert Shape(SimpleNamespace(growth=growth), None, state).load == load
