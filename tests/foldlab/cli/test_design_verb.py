"""``foldlab design`` under weight: what it takes, what it says, what it refuses."""

import json

import numpy as np
import pandas as pd
import pytest

from foldlab.cli.design import Aim, Limits
from foldlab.cli.proposed import _apart
from foldlab.design import REDUCED, to_groups
from foldlab.errors import InputError
from foldlab.inverse import size, weighted
from foldlab.labels.solver import SolverSource
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.models import make_classifier
from foldlab.learning.saving import save_model

SHEET = "design --passive PET --active SMP --set l_s=40mm --set b_s=10mm"


@pytest.fixture
def quick(monkeypatch):
    """Searches that see fewer designs."""
    monkeypatch.setattr(weighted, "WALKERS", 512)
    monkeypatch.setattr(weighted, "CLIMBERS", 16)
    monkeypatch.setattr(weighted, "ROUNDS", 3)
    monkeypatch.setattr(size, "WALKERS", 256)
    monkeypatch.setattr(size, "STARTS", 3)


@pytest.fixture
def no_solver(monkeypatch):
    def asked(*_, **__):
        raise AssertionError("the solver was asked")

    monkeypatch.setattr(SolverSource, "follow", asked)


def test_an_angle_of_a_sheet_of_known_size_is_confirmed_under_its_weight(foldlab, quick):
    status, out, err = foldlab(f"{SHEET} --want angle=90deg -n 1 --json")
    answer = json.loads(out)
    assert status == 0 and answer["weightless"] is False and answer["source"] == "solver"
    (made,) = answer["proposals"]
    assert made["confirmed"] is True and made["confirmed_by"] == "solver"
    assert abs(made["fold_angle"] - np.pi / 2) <= 0.05
    assert "more than the 1.52 rad that count as folded" in made["reason"]
    assert (made["physical"]["l_s"], made["physical"]["b_s"]) == (0.04, 0.01)
    groups = to_groups(pd.DataFrame([made["physical"]])).iloc[0]
    again = SolverSource().label(groups.to_dict()).evidence["m1"]
    assert abs(again - np.pi / 2) <= 0.05
    low, high = made["box"]["h_s"]
    assert low < made["physical"]["h_s"] < high and made["box_held"] == made["box_checked"] == 4
    assert made["strain"]["passive"]["says"] and made["over_materials"]["draws"] > 100
    assert made["topples"] in (True, False) and "curves" not in made["evidence"]
    assert 0 < made["core_seconds"] < answer["core_seconds"]
    # Progress and forecast are on stderr.
    assert "core-seconds" in err and "1 of 1 confirmed" in err


def test_people_read_millimetres_degrees_and_tolerances(foldlab, quick, no_solver):
    status, out, _ = foldlab(f"{SHEET} --want angle --angle 1.2 -n 2 --no-confirm")
    assert status == 0 and "68.75" in out
    assert "1 holds for: h_s 0." in out and " mm (" in out and "contraction" in out
    assert "confirmed by: nobody; the rod says so" in out and "2: by the rod, unconfirmed" in out


def test_the_full_space_without_a_scale_feels_weight_and_answers_in_groups(
    foldlab, quick, no_solver
):
    status, out, _ = foldlab("design --space full --set stiffness_to_weight=1 -n 2 --no-confirm")
    assert status == 0 and "hinge_length" in out and " mm" not in out
    status, out, _ = foldlab("design --set stiffness_to_weight=1 -n 1 --no-confirm --json")
    (made,) = json.loads(out)["proposals"]
    assert made["groups"]["stiffness_to_weight"] == 1.0 and made["physical"] == {}
    assert set(made["box"]) >= {"slenderness", "h_ratio"}


def test_weightless_is_said_where_nothing_weighs(foldlab):
    line = f"{SHEET} --weightless --space full --want angle=90deg -n 1 --json"
    status, out, _ = foldlab(line)
    assert status == 0 and json.loads(out)["weightless"] is True
    status, out, _ = foldlab("design --space full --source timoshenko --want angle=1 -n 1")
    assert status == 0 and "weightless: True" in out


def test_a_size_that_is_too_large_is_answered_with_one_that_is_not(foldlab, quick):
    line = "design --passive silicone --active hydrogel --set l_s=10cm --max-thickness 2mm"
    status, out, err = foldlab(f"{line} --want angle=90deg -n 1 --json")
    answer = json.loads(out)
    assert status == 3 and answer["proposals"] == []
    assert "not reached: not at this size: at most l_s = " in err
    told = answer["largest"]
    assert 0.03 < told["l_s"] < 0.1 and told["confirmed"] is True
    again = SolverSource().label(told["groups"]).evidence["m1"]
    assert abs(again - np.pi / 2) <= 0.05


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"{SHEET} --source timoshenko", "--source timoshenko knows no weight, and the wish says"),
        (f"{SHEET} --space reduced", "--space reduced knows no weight, and the wish says material"),
        (
            "design --range stiffness_to_weight=1:2 --source timoshenko",
            "knows no weight, and the wish limits stiffness_to_weight",
        ),
        (f"{SHEET} --model m", "trained on the reduced space and can't feel weight"),
        (f"{SHEET} --model m --want angle=1", "--model m says no angle"),
        (f"{SHEET} --weightless --space full --source solver", "gives one at a time; give a --mo"),
        ("design --stands", "give materials and a size, and no --weightless"),
        (f"{SHEET} --max-mass 5mm", "--max-mass = '5mm': expected a quantity in kg, such as 5g"),
        (f"{SHEET} --want angle=90furlongs", "expected an angle"),
        (f"{SHEET} --want 90deg", "--want 90deg: expected foldable, flat or angle=90deg"),
        (f"{SHEET} --want angle=90", "90 degrees are angle=90deg"),
        (f"{SHEET} --want flat=1", "expected foldable, flat or angle=90deg"),
        (f"{SHEET} --want angle=1 --angle 1", "once"),
        (f"{SHEET} --range h_s=1mm", "expected NAME=LOW:HIGH"),
        (f"{SHEET} --want angle=400deg", "less than a full turn"),
        (f"{SHEET} --panels-touch --no-confirm", "told by the solver with contact"),
        (f"{SHEET} --panels-touch --want angle=90deg", "panels that touch set the angle"),
        (f"{SHEET} --panels-apart --source rod", "take --source solver"),
        (f"{SHEET} --panels-apart --weightless", "--panels-apart, --least and strips are for"),
        (f"{SHEET} --set strips=5 --source rod", "take --source solver"),
        (f"{SHEET} --set strips=2.5", "give whole numbers"),
    ],
)
def test_what_cannot_be_felt_or_read_is_refused_in_one_sentence(
    foldlab, tmp_path, no_solver, line, words
):
    if "--model" in line:
        labels = TimoshenkoSource().evaluate(REDUCED.sample(100, seed=0))
        tree = make_classifier("tree", REDUCED).fit(labels[REDUCED.names], labels["foldable"])
        save_model(tree, tmp_path / "m")
    status, out, err = foldlab(line)
    assert (status, out) == (2, "") and words in err, err
    assert err.count("error: ") == 1 and "Traceback" not in err


@pytest.mark.parametrize(
    ("low", "high", "told"),
    [
        (16.478, 16.549, ("16.48", "16.55")),
        (0.0851, 0.0967, ("0.0851", "0.0967")),
        (99.98, 100.02, ("99.98", "100.02")),
        (5.0, 5.0, ("5", "5")),
    ],
)
def test_ends_of_a_box_have_as_many_digits_as_tell_them_apart(low, high, told):
    assert _apart(low, high) == told


def test_limits_and_angles_come_with_units_or_in_si():
    limits = Limits(ranges=["h_s=50um:0.2mm", "contraction=10%:20%", "E_ratio=0.1:1"]).read()
    assert limits["ranges"]["h_s"] == pytest.approx((5e-5, 2e-4))
    assert limits["ranges"]["contraction"] == pytest.approx((0.1, 0.2))
    assert limits["ranges"]["E_ratio"] == (0.1, 1.0)
    assert Aim("angle=90deg").read().value == pytest.approx(np.pi / 2)
    assert Aim("angle", 1.2, 0.1).read().tolerance == 0.1
    with pytest.raises(InputError, match="such as 40mm"):
        Limits(ranges=["l_s=1:2kg"]).read()
