"""What the verb design says of its proposals: sizes in mm, angles in degrees, by hand."""

import pytest

from foldlab.cli.proposed import SIZES, told
from foldlab.inverse.answer import Answer, Proposal
from foldlab.inverse.wish import Wish
from foldlab.labels.label import Label

PHYSICAL = {
    "l_s": 0.1, "b_s": 0.05, "h_s": 4e-4, "l_i": 0.02, "b_i": 0.03, "h_i": 2e-4,
    "contraction": 0.12,
}  # fmt: skip
GROUPS = {"h_ratio": 0.5, "slenderness": 4e-3, "contraction": 0.12}


def said(wish=None, answer=(), row=(), **proposal):
    """The row and the words of one proposal, and of an answer that holds it alone."""
    given = {
        "groups": GROUPS, "physical": PHYSICAL, "materials": ("paper", "hydrogel"), "mass": 2e-3,
        "probability": None, "angle": 1.5, "margin": 0.1, "box": {},
    } | proposal  # fmt: skip
    one = Proposal(**given)
    given = {"source": "solver", "core_seconds": 3.0} | dict(answer)
    whole = Answer(wish or Wish(), 1, (one,), "as wished", 1.0, **given)
    known = dict.fromkeys(("topples", "strain", "over_materials", "material_cost")) | dict(row)
    result = {"conditions": "gravity, ground", "proposals": [known]}
    (row,), words = told(whole, result)
    return row, words


def test_a_row_has_sizes_in_millimetres_grams_degrees_and_per_cent():
    row, words = said()
    assert row == {
        "": "1", "l_s": 100.0, "b_s": 50.0, "h_s": pytest.approx(0.4), "l_i": 20.0, "b_i": 30.0,
        "h_i": pytest.approx(0.2), "contraction, %": 12.0, "angle, °": pytest.approx(85.9437),
        "mass, g": 2.0,
    }  # fmt: skip
    assert words == {
        "1": "by the rod, unconfirmed", "1 holds for": "nothing else", "reason": "as wished",
        "confirmed by": "solver (gravity, ground)", "core_seconds": 3.0,
    }  # fmt: skip
    two = Wish(passive=("paper", "polyester film"), active=("hydrogel",))
    row, _ = said(two, mass=None, angle=None)
    assert row["materials"] == "paper + hydrogel" and row["angle, °"] is None
    assert "mass, g" not in row


def test_what_the_material_costs_is_told_where_it_has_a_price():
    assert said(row={"material_cost": (0.104, 0.128)})[1]["1 material cost"] == (
        "0.104 to 0.128, by your prices per kg"
    )
    assert said(row={"material_cost": (2.0, 2.0)})[1]["1 material cost"].startswith("2, by")
    assert "1 material cost" not in said()[1]


def test_strips_are_told_with_their_width_and_the_gaps_between_them():
    # Four strips on 30 mm: one every 7.5 mm, of which they cover 60 %.
    strips = {**GROUPS, "strips": 4.0, "strip_share": 0.6}
    _, words = said(groups=strips)
    assert words["1 strips"] == "4, which cover 60 % of the hinge: 4.5 mm wide, gaps of 3 mm"
    _, words = said(groups=strips, physical={"h_s": 4e-4})
    assert words["1 strips"] == "4, which cover 60 % of the hinge"


def test_a_box_is_told_by_its_ends_and_how_far_they_lie_from_the_design():
    box = {"l_i": (0.018, 0.022), "contraction": (0.114, 0.132), "h_ratio": (0.4, 0.7)}
    _, words = said(box=box)
    assert words["1 holds for"] == (
        "l_i 18 to 22 mm (±10 %), contraction 11.4 to 13.2 % (−5 +10 %), h_ratio 0.4 to 0.7 "
        "(−20 +40 %)"
    )


def test_what_the_solver_said_stands_behind_the_number():
    full = Label({}, True, "the unit makes a full turn")
    _, words = said(
        Wish(touching=False), label=full, box_checked=16, box_held=12, row={"topples": True}
    )
    assert words["1"] == (
        "confirmed by the solver, and 12 of 16 of its box's worst corners; tips over: yes; it "
        "turns fully, as if panels could pass through each other; panels stay apart"
    )
    _, words = said(Wish(touching=True), label=Label({}, True, "so"), row={"topples": False})
    assert words["1"].endswith("corners; tips over: no; panels touch")


def test_the_largest_that_does_as_wished_is_told_in_full():
    sizes = {name: PHYSICAL[name] for name in SIZES} | {"contraction": 0.125}
    largest = {"physical": sizes, "fold_angle": 1.0}
    _, words = said(answer={"largest": largest, "source": ""})
    assert words["largest"] == (
        "l_s 100 mm, b_s 50 mm, h_s 0.4 mm, l_i 20 mm, b_i 30 mm, h_i 0.2 mm, contraction 12.5 %: "
        "57.3°"
    )
    assert words["confirmed by"] == "nobody; the rod says so (gravity, ground)"
