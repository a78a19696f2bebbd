"""The words in which ``foldlab check`` answers: each number in a maker's units."""

import numpy as np
import pandas as pd
import pytest

from foldlab.cli import check
from foldlab.design import PHYSICAL
from foldlab.labels.label import Label
from foldlab.materials import read_materials
from foldlab.unit import told as unit_told
from foldlab.unit.check import Change
from foldlab.unit.sized import sized

RIGHT_ANGLE = 1.5707963267948966
UNIT = sized(
    {
        "l_s": 0.04, "b_s": 0.01, "h_s": 1e-4, "h_i": 2e-4, "l_i": 0.01, "contraction": 0.2,
        "E_s": 3e9, "rho_s": 1380.0, "E_i": 3e7, "rho_i": 1100.0,
    },
    read_materials(),
)  # fmt: skip
ANSWER = {
    "foldable": True, "fold_angle": RIGHT_ANGLE, "need": RIGHT_ANGLE / 2, "error_m1": 0.02,
    "reason": "it folds", "stable": True, "topples": False, "strain": {}, "change": None,
    "over_materials": None, "holds": None, "core_seconds": 1.5, "files": ["c/a", "c/b"],
}  # fmt: skip


def readable(**changed):
    return unit_told.readable(ANSWER | changed, UNIT)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("l_s", 0.04, "40 mm"), ("h_s", 1.234e-4, "0.123 mm"), ("E_s", 2.5e9, "2500 MPa"),
        ("E_i", 5e5, "0.5 MPa"), ("rho_s", 1380.0, "1380 kg/m³"), ("contraction", 0.2, "20 %"),
    ],
)  # fmt: skip
def test_quantities_are_shown_in_the_units_of_a_maker(name, value, text):
    assert unit_told.shown(name, value) == text
    assert {PHYSICAL[n] for n in ("l_s", "E_s", "rho_s", "contraction")} == set(unit_told.SHOWN)


def test_yes_and_no_stand_where_they_are_asked_for():
    told = readable(stable=True, topples=False, foldable=None)
    assert (told["folds"], told["stable"], told["tips over"]) == ("unknown", "yes", "no")
    told = readable(stable=False, topples=True, foldable=False)
    assert (told["folds"], told["stable"], told["tips over"]) == ("no", "no", "yes")
    told = readable()
    assert told["why"] == "it folds" and told["files"] == "c/a, c/b"
    assert told["core_seconds"] == 1.5


def test_a_state_that_is_stable_only_while_it_is_held_says_so():
    assert readable(stable=True, topples=True)["stable"] == "yes, held upright"
    assert readable(stable=False, topples=True)["stable"] == "no"


def test_angles_of_a_reason_are_degrees_and_other_numbers_stay():
    reason = "turns by -0.7854 rad, short of the 1.57 rad needed; Γ is 0.041, by 2e-1 rad, 3 radii"
    told = readable(reason=reason)["why"]
    assert told == "turns by -45°, short of the 90° needed; Γ is 0.041, by 11.5°, 3 radii"


def test_angles_and_their_errors_are_degrees():
    assert readable()["angle"] == "90° ± 1°, 45° count as folded"
    assert readable(error_m1=1.8)["angle"].startswith("90° ± 100°,")
    assert readable(error_m1=None)["angle"] == "90°, 45° count as folded"
    assert readable(fold_angle=None, error_m1=None)["angle"].startswith("–, 45°")
    label = Label({}, True, "it folds", {"m1": RIGHT_ANGLE})
    assert check._first(label, False) == "first answer, of a rod: it folds (90°)"
    assert "the solver is asked" in check._first(None, False)
    assert "asked" not in check._first(None, True)


def test_a_change_is_told_from_what_it_is_to_what_it_has_to_be():
    label = Label({}, True, "it folds then", {"m1": RIGHT_ANGLE})
    told = unit_told.changed(Change("h_i", 3e-4, 1.5, label), UNIT)
    assert told == {
        "quantity": "h_i", "from": 2e-4, "to": 3e-4, "fold_angle": RIGHT_ANGLE,
        "reason": "it folds then",
    }  # fmt: skip
    says = readable(foldable=False, change=told)["to change"]
    assert says == "h_i from 0.2 mm to 0.3 mm: it then folds by 90°, by the solver"
    for nothing in (None, Change("h_i", 3e-4, 1.5)):
        assert unit_told.changed(nothing, UNIT) is None
    assert (
        readable(foldable=False)["to change"] == "no change of one quantity was confirmed to help"
    )
    assert readable(foldable=True)["to change"] == readable(foldable=None)["to change"] == "nothing"


def test_strains_are_told_in_per_cent_with_the_limit_that_is_known():
    known = {"peak": 0.0123, "says": "bears it", "low": 0.02, "high": 0.04}
    rows = {"passive": known, "active": known | {"says": None}}
    told = readable(strain=rows)["strain"]
    assert told == "passive 1.2 % (bears it: its limit is 2 to 4 %), active 1.2 %"
    assert readable()["strain"] == "–"


def test_how_far_it_stays_so_is_told_on_either_side():
    ends = {"h_i": [1e-4, 4e-4], "l_s": [0.02, None], "l_i": [None, 0.03], "h_s": [None, None]}
    told = "h_i 0.1 mm to 0.4 mm, l_s above 20 mm, l_i below 30 mm (each alone, by the rod)"
    assert readable(holds=ends)["it stays so for"] == told
    nothing = readable(holds={"h_s": [None, None]})["it stays so for"]
    assert nothing.startswith("any change of one quantity (")


@pytest.mark.parametrize("half_turns, told", [(0.99, False), (1.01, True), (2.0, True)])
def test_panels_that_would_have_met_are_told_of(half_turns, told):
    angle = readable(fold_angle=half_turns * np.pi)["angle"]
    assert ("pass through each other" in angle) is told
    assert "pass through" not in readable(fold_angle=None)["angle"]


def test_what_the_materials_leave_open_is_told_with_their_ranges():
    over = {
        "draws": 200, "by_formula": 0, "folds": 0.25, "angle_low": RIGHT_ANGLE / 3,
        "angle_high": RIGHT_ANGLE,
        "ranges": {"E_i": [5e5, 3e7]},
    }  # fmt: skip
    told = readable(over_materials=over)["over the materials"]
    assert told == (
        "25 % of 200 units fold by the rod, 90 % of all turn by 30° to 90° (E_i 0.5 MPa to 30 MPa)"
    )
    some = readable(over_materials=over | {"by_formula": 7})["over the materials"]
    assert "fold by the rod (7 of them by beam formulas), 90 %" in some
    quick = {"foldable": False, "fold_angle": RIGHT_ANGLE, "over_materials": over, "holds": None}
    assert check._quickly(quick) == {
        "folds": "no", "angle": "90°", "over the materials": told, "it stays so for": "–",
        "confirmed": "no, the rod's answer only",
    }  # fmt: skip


def test_materials_are_listed_in_mpa_and_per_cent(monkeypatch):
    seen = []
    monkeypatch.setattr(check, "emit", lambda all_of_it, as_json, rows: seen.extend(rows))
    check.materials()
    (pet,) = (row for row in seen if row["name"] == "polyester film")
    assert pet["also"] == "PET, polyester, Mylar" and pet["role"] == "passive"
    assert (pet["E, MPa"], pet["contraction, %"], pet["bears, %"]) == (
        "2500 to 5000",
        "–",
        "2 to 4",
    )
    (smp,) = (row for row in seen if row["name"] == "shape-memory polymer")
    assert (smp["E, MPa"], smp["rho, kg/m³"]) == ("0.5 to 30", "1000 to 1250")
    assert smp["contraction, %"] == "2 to 50"
    row = pd.Series({"E_low": 3e6, "E_high": 3e6})
    assert check._range(row, "E", 1e-6) == "3"
