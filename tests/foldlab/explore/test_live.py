"""What the explorer answers at once is what models and rod say, and a map agrees with it."""

import base64
import json
import math
import time

import numpy as np
import pandas as pd
import pytest

from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.explore.asked import LONGEST, SIZES, asked
from foldlab.explore.live import FIRST, Live, _grid
from foldlab.learning.saving import shipped_for
from foldlab.materials import read_materials
from foldlab.predicted import Predictor
from foldlab.terminal import plain
from foldlab.unit.sized import sized
from foldlab.unit.told import degrees

MIDDLE = {name: float(FULL[name].from_unit(0.5)) for name in FULL.names}


@pytest.fixture(scope="module")
def live():
    return Live()


def field(told, name):
    return np.frombuffer(base64.b64decode(told[name]), "<f4").reshape(told["side"], told["side"])


def test_an_answer_is_that_of_the_shipped_models(live):
    told = live.answer({"groups": MIDDLE})
    said, frame = Predictor.of(shipped_for("full")), pd.DataFrame([MIDDLE])
    assert told["probability"] == pytest.approx(said.answers(frame)["probability"][0], abs=1e-6)
    angles, off = said.angles(frame)
    assert told["fold_angle"] == pytest.approx(angles[0])
    assert told["need"] == pytest.approx(math.pi * MIDDLE["contraction"])
    assert told["fold_angle_error"] == pytest.approx(off * max(angles[0], told["need"]))
    assert told["nearest_distance"] == said.nearest(frame)["nearest_distance"][0]
    assert told["physical"] is None and told["outside"] == [] and told["coverage"] == 0.99
    assert told["rod"]["reason"].startswith(f"folds by {degrees(told['rod']['fold_angle'])}")
    assert " rad" not in told["rod"]["reason"]
    json.dumps(plain(told), allow_nan=False)


def test_the_three_verdicts_occur(live):
    borders = Predictor.of(shipped_for("full")).borders
    weights = np.geomspace(0.01, 0.1, 20)
    told = [live.answer({"groups": MIDDLE | {"stiffness_to_weight": w}}) for w in weights]
    ends = sorted([borders.not_up_to, borders.folds_from])
    for row in told:
        p = row["probability"]
        expected = None if ends[0] <= p <= ends[1] else p > ends[1]
        assert row["foldable"] is expected
    assert {True, False} <= {row["foldable"] for row in told}


def test_a_unit_in_millimetres_is_that_of_check(live):
    told = live.answer(FIRST)
    unit = sized(FIRST["quantities"], read_materials(), "PET", "SMP")
    assert told["groups"] == pytest.approx(unit.groups)
    assert told["physical"] == pytest.approx(unit.physical)
    with_units = {**FIRST, "quantities": {**FIRST["quantities"], "h_s": "0.1 mm", "E_i": "20MPa"}}
    assert live.answer(with_units)["physical"]["E_i"] == 20e6
    assert live.answer(with_units)["physical"]["h_s"] == pytest.approx(1e-4)


def test_what_the_materials_leave_open_is_what_check_says_of_it(live):
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.check import uncertainty

    said = live.ranges(FIRST)["said"]
    left = uncertainty(asked(FIRST).unit, SolverSource())
    assert said.startswith(f"{100 * left['folds']:.0f} % of 200 units fold by the rod")
    assert "E_i 0.5 MPa to 30 MPa" in said
    given = {"E_s": 4e9, "rho_s": 1400, "E_i": 4e6, "rho_i": 1100}
    known = {**FIRST, "quantities": FIRST["quantities"] | given}
    assert live.ranges(known)["said"] is live.ranges({"groups": MIDDLE})["said"] is None


def test_groups_with_a_material_have_sizes_and_come_back(live):
    groups = live.answer(FIRST)["groups"]
    back = live.answer({"groups": groups, "passive": "PET"})
    assert back["physical"]["l_s"] == pytest.approx(0.04)
    assert back["groups"] == pytest.approx(groups)
    again = {k: v for k, v in back["physical"].items() if k != "g_earth"}
    assert live.answer({"quantities": again})["groups"] == pytest.approx(groups)


def test_a_unit_beyond_the_bounds_says_so(live):
    huge = {**FIRST, "quantities": FIRST["quantities"] | {"l_s": 2.0, "l_i": 1.0}}
    assert "stiffness_to_weight" in live.answer(huge)["outside"]
    assert live.answer(FIRST)["outside"] == []
    thick = live.answer({**FIRST, "quantities": FIRST["quantities"] | {"h_i": 3e-3}})
    assert thick["fold_angle"] is thick["rod"] is None and "h_ratio" in thick["outside"]
    assert 0 <= thick["probability"] <= 1


@pytest.mark.parametrize("x, y", [("h_ratio", "E_ratio"), ("contraction", "hinge_length")])
def test_a_map_of_groups_has_the_answers_of_its_designs(live, x, y):
    told = live.map({"design": {"groups": MIDDLE}, "x": x, "y": y, "side": 5})
    p = field(told, "probability")
    for row, column in ((0, 0), (1, 4), (4, 2)):
        at = {x: FULL[x].from_unit((column + 0.5) / 5), y: FULL[y].from_unit((row + 0.5) / 5)}
        alone = live.answer({"groups": MIDDLE | {k: float(v) for k, v in at.items()}})
        assert p[row, column] == pytest.approx(alone["probability"], abs=1e-5)


def test_a_map_of_sizes_has_the_answers_of_its_units_and_none_where_there_is_no_unit(live):
    told = live.map({"design": FIRST, "x": "l_s", "y": "l_i", "side": 6})
    p = field(told, "probability")
    at = [SIZES[name].from_unit((np.arange(6) + 0.5) / 6) for name in ("l_i", "l_s")]
    l_i, l_s = np.meshgrid(*at, indexing="ij")
    assert (np.isnan(p) == (l_i > l_s)).all() and np.isnan(p).any()
    row, column = np.argwhere(~np.isnan(p))[3]
    changed = {"l_i": float(at[0][row]), "l_s": float(at[1][column])}
    alone = live.answer({**FIRST, "quantities": FIRST["quantities"] | changed})
    assert p[row, column] == pytest.approx(alone["probability"], abs=1e-5)


def test_a_hinge_as_wide_as_its_panels_stays_so_on_a_map_and_another_keeps_its_width():
    designs, there = _grid(asked(FIRST), SIZES, "b_s", "h_i", 4)
    assert there.all() and designs["hinge_width"].to_numpy() == pytest.approx(1.0)
    narrow = {**FIRST, "quantities": FIRST["quantities"] | {"b_i": 0.006}}
    designs, there = _grid(asked(narrow), SIZES, "b_s", "h_i", 4)
    widths = np.tile(SIZES["b_s"].from_unit((np.arange(4) + 0.5) / 4), 4)
    assert designs["hinge_width"].to_numpy() == pytest.approx(0.006 / widths)
    assert (there == (widths >= 0.006)).all() and not there.all()


def test_the_boundary_without_weight_is_timoshenkos(live):
    from foldlab.labels.timoshenko import TimoshenkoSource

    told = live.map({"design": {"groups": MIDDLE}, "x": "h_ratio", "y": "E_ratio", "side": 3})
    middle = TimoshenkoSource(space=FULL).label(MIDDLE)
    assert field(told, "light")[1, 1] == pytest.approx(middle.evidence["margin"], abs=1e-6)


def test_while_the_models_are_being_loaded_the_rod_answers(monkeypatch):
    live = Live()
    monkeypatch.setattr(Live, "_model", property(lambda self: pytest.fail("not loaded yet")))
    live._loading = True
    told = live.answer(FIRST)
    assert told["probability"] is None and told["foldable"] is True
    assert told["fold_angle"] == told["rod"]["fold_angle"] > told["need"]


def test_facts_need_no_model(monkeypatch):
    monkeypatch.setattr(Live, "_model", property(lambda self: pytest.fail("not asked")))
    facts = Live().facts({})
    assert [p["name"] for p in facts["groups"]] == FULL.names
    assert {m["name"] for m in facts["materials"]["active"]} >= {"shape-memory polymer"}
    asked(facts["first"])
    json.dumps(plain(facts), allow_nan=False)


def test_an_answer_takes_less_than_a_tenth_of_a_second_of_a_core(live):
    live.answer(FIRST)
    seconds = []
    for h in np.geomspace(5e-5, 2e-4, 9):
        start = time.thread_time()
        live.answer({**FIRST, "quantities": FIRST["quantities"] | {"h_s": float(h)}})
        seconds.append(time.thread_time() - start)
    assert np.median(seconds) < 0.1


@pytest.mark.parametrize(
    "request_, says",
    [
        (None, "a design: expected names with values, got NoneType"),
        ([], "a design: expected names with values"),
        ({}, "by its groups or by its quantities; give one"),
        ({"groups": MIDDLE, "quantities": {}}, "give one of them"),
        ({"groups": MIDDLE, "path": "/etc/passwd"}, "a design: no 'path'"),
        ({"groups": [1]}, "groups: expected names with values"),
        ({"groups": MIDDLE | {"height": 1}}, "groups: no 'height'"),
        ({"groups": MIDDLE | {"aspect": "wide"}}, "aspect = 'wide': expected a plain number"),
        ({"groups": MIDDLE | {"aspect": True}}, "aspect = True; expected a number"),
        ({"groups": MIDDLE | {"aspect": None}}, "aspect = None; expected a number"),
        ({"groups": MIDDLE | {"aspect": [1]}}, "expected a number"),
        ({"groups": MIDDLE | {"aspect": 1e999}}, "expected a finite number"),
        ({"groups": MIDDLE | {"aspect": 7.0}}, "aspect = 7 in row 0 .* lies outside 0.05 … 1"),
        ({"groups": MIDDLE, "passive": "cheese"}, "no passive material 'cheese'"),
        ({"groups": MIDDLE, "passive": 3}, "passive: expected the name of a material"),
        ({**FIRST, "passive": "x" * 99}, "passive: expected the name of a material"),
        ({**FIRST, "passive": "../materials.csv"}, "no passive material '../materials.csv'"),
        ({"quantities": {"l_s": 0.04}}, "the unit lacks b_s"),
        ({"quantities": {"l_s": "4" * (LONGEST + 1)}}, "l_s: expected a number, such as 40mm"),
        ({"quantities": {"l_s": "40 s"}}, "expected a quantity in m"),
        ({"quantities": {"g_earth": 1.6}}, "quantities: no 'g_earth'"),
        ({**FIRST, "quantities": FIRST["quantities"] | {"l_i": 0.05}}, "l_i = 0.05 m is more than"),
        ({**FIRST, "quantities": FIRST["quantities"] | {"l_i": 0.04}}, "leaves no panels to lift"),
        (
            {**FIRST, "quantities": FIRST["quantities"] | {"h_s": 1e308}},
            "h_ratio = 2e-312; no unit is",
        ),
        ({**FIRST, "quantities": FIRST["quantities"] | {"h_s": -1}}, "h_s = -1; expected a finite"),
    ],
)
def test_bad_designs_are_one_sentence(live, request_, says):
    with pytest.raises(InputError, match=says) as told:
        live.answer(request_)
    assert "\n" not in str(told.value) and len(str(told.value)) < 400


@pytest.mark.parametrize(
    "change, says",
    [
        ({"x": "cheese"}, "x = 'cheese'; expected one of l_s, b_s"),
        ({"x": "h_ratio"}, "x = 'h_ratio'; expected one of l_s"),
        ({"x": ["h_s"]}, "expected one of"),
        ({"x": "h_i"}, "both axes are h_i; take two"),
        ({"side": 10**6}, "side = 1e.06; expected 2 to 128"),
        ({"side": "48"}, "side = '48'; expected a number"),
        ({"side": True}, "side = 'True'; expected a number"),
        ({"design": None}, "a design: expected"),
        ({"out": "x.png"}, "a map: no 'out'"),
    ],
)
def test_bad_maps_are_one_sentence(live, change, says):
    with pytest.raises(InputError, match=says):
        live.map({"design": FIRST, "x": "h_s", "y": "h_i", **change})
