"""Make it fold: what is near is near, and is offered only where the solver confirms it."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from foldlab.design import FULL, DesignSpace, Parameter
from foldlab.explore import mend
from foldlab.explore.asked import asked
from foldlab.explore.live import FIRST
from foldlab.explore.nearest import FURTHER, Way, ways
from foldlab.labels.label import Label

PLANE = DesignSpace(
    "plane", tuple(Parameter(name, name, 0.0, 1.0, "linear", name) for name in ("a", "b", "c"))
)
MIDDLE = {name: float(FULL[name].from_unit(0.5)) for name in FULL.names}


def test_the_nearest_point_of_a_half_space_is_found():
    # Plane 3a + 4b = 4.7 from (0.2, 0.2, 0.5): at a distance of (4.7 − 1.4) / 5 along (3, 4, 0).
    # Of b alone 1.025 were needed, and of a alone 1.3: beyond the bounds.
    (way,) = ways(PLANE, {"a": 0.2, "b": 0.2, "c": 0.5}, lambda d: 3 * d["a"] + 4 * d["b"] >= 4.7)
    assert 0.66 <= way.length < 0.664 and way.alone is None
    assert way.end == pytest.approx([0.2 + 0.396, 0.2 + 0.528, 0.5], abs=0.06)


def test_where_one_alone_is_nearest_it_is_that_and_comes_first():
    (first, *_) = ways(PLANE, {"a": 0.5, "b": 0.3, "c": 0.9}, lambda d: d["b"] > 0.55)
    assert first.length == pytest.approx(0.25, abs=0.01)
    assert first.end == pytest.approx([0.5, 0.55, 0.9], abs=0.05)


def test_the_same_is_found_again_and_nothing_where_nothing_folds():
    start = {"a": 0.1, "b": 0.1, "c": 0.1}

    def folds(d):
        return d["a"] * d["b"] * d["c"] > 0.2

    first, second = (ways(PLANE, start, folds) for _ in range(2))
    assert (first[0].end == second[0].end).all() and (first[0].end >= 0).all()
    assert ways(PLANE, start, lambda d: d["a"] > 2) == []


def test_further_points_stay_within_the_bounds():
    way = Way(np.array([0.5, 0.5]), np.array([0.5, 0.9]))
    points = list(way.further())
    assert len(points) == len(FURTHER) and (points[0] == way.end).all()
    assert points[-1].tolist() == [0.5, 1.0]


@dataclass
class Judge:
    """A solver that says that what lies beyond a weight folds."""

    folds_from: float
    asked: list = field(default_factory=list)

    def label(self, groups):
        self.asked.append(groups)
        folds = groups["stiffness_to_weight"] >= self.folds_from
        evidence = {"fold_angle": 1.0, "error_m1": 0.01, "core_seconds": 0.5}
        return Label(
            dict(groups), folds, "turns by 1 rad" if folds else "too heavy", evidence, "toy", "1"
        )


HEAVY = MIDDLE | {"stiffness_to_weight": 0.02}


def test_groups_are_mended_by_the_model_and_confirmed_by_the_solver():
    judge, said = Judge(0.03), []
    told = mend.mended(asked({"groups": HEAVY}), judge, said.append)
    assert told["folds"] is False and told["said"] == "as it is: too heavy"
    assert judge.asked[0] == HEAVY and len(told["options"]) == 2
    near, alone = told["options"]
    assert [row["name"] for row in alone["changes"]] == ["stiffness_to_weight"]
    assert alone["changes"][0]["from"] == pytest.approx(0.02)
    for option in told["options"]:
        groups = option["design"]["groups"]
        assert groups["stiffness_to_weight"] >= 0.03 and option["reason"] == "turns by 57.3°"
        assert {r["name"]: r["to"] for r in option["changes"]}.items() <= groups.items()
        asked(option["design"])
    assert len(near["changes"]) > 1 and said[-1].startswith("trying")


def test_what_the_solver_does_not_confirm_is_not_offered():
    told = mend.mended(asked({"groups": HEAVY}), Judge(1e9), lambda text: None)
    assert told["options"] == [] and "nothing near by was confirmed to fold" in told["said"]


def test_what_folds_is_left_alone():
    judge = Judge(0.0)
    told = mend.mended(asked({"groups": HEAVY}), judge, lambda text: None)
    assert told == {"options": [], "folds": True, "said": "it folds as it is: turns by 57.3°"}
    assert len(judge.asked) == 1


def test_a_unit_in_sizes_changes_one_of_them_and_keeps_its_materials(monkeypatch):
    from foldlab.unit.check import Change

    thick = {**FIRST, "quantities": FIRST["quantities"] | {"h_s": 1.6e-4}}
    what, judge = asked(thick), Judge(150.0)
    offered = [Change("h_s", 1e-4, 0.625), Change("l_s", 0.03, 0.75), Change("b_s", 0.02, 2.0)]
    monkeypatch.setattr(mend, "changes", lambda unit, source: offered)
    told = mend.mended(what, judge, lambda text: None)
    # A thinner sheet is heavier for its stiffness, so the judge refuses it; width does nothing.
    (only,) = told["options"]
    assert only["changes"] == [{"name": "l_s", "from": 0.04, "to": 0.03}]
    assert only["design"]["passive"] == "polyester film"
    assert asked(only["design"]).groups == judge.asked[2]
