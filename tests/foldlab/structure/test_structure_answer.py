"""Answers about structures: hinges that fold, why others don't, and laws from labels."""

from types import SimpleNamespace

import numpy as np
import pytest
from crease_patterns import for_angle, squares, structure, two_panels
from pytest import approx

from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource
from foldlab.structure import laws
from foldlab.structure.answer import answer, strain
from foldlab.structure.laws import from_labels
from solver.cases.structure.hinges import Layer
from solver.cases.structure.parts import Structure
from solver.cases.structure.pattern import Crease, Pattern

ROW = [(0, 0), (1, 0), (2, 0)]


def made(pattern, angle, gamma, length=0.1):
    return structure(pattern, contraction=for_angle(angle, length), gamma=gamma)


def test_all_hinges_fold():
    result = answer(made(squares(ROW), 1.0, 100.0))
    assert result.foldable is True
    assert result.reason == "all 2 hinges fold, by sections alone, whose error is not known"
    assert [h["fold"] for h in result.hinges] == ["valley", "valley"]
    for hinge in result.hinges:
        assert hinge["folds"] and hinge["why"] == ""
        assert hinge["angle"] == approx(1.0, abs=0.05) and hinge["natural"] == approx(1.0)
        assert hinge["need"] == approx(np.pi * for_angle(1.0, 0.1))
    e = result.evidence
    assert e["outcome"] == "reached" and e["stable"] is True and e["contraction_reached"] == 1.0
    assert e["effects"] == ["gravity", "ground", "contact"]
    assert e["panels"] == 3 and e["core_seconds"] > 0 and e["touching"] is False


def test_weight_is_named_where_it_holds_a_hinge_down():
    result = answer(made(squares(ROW), 0.6, 0.02))
    assert result.foldable is False
    assert {h["why"] for h in result.hinges} == {"its panels are too heavy for it"}
    assert result.reason.startswith(
        "2 of 2 hinges don't fold: 2 as its panels are too heavy for it"
    )
    assert "panels would sag by" in result.reason and result.evidence["panel_sag"] > 0.05


def test_contact_is_named_where_panels_meet_first():
    result = answer(made(two_panels(0.2), 3.6, 100.0, 0.2), need=3.5, upright=True)
    assert result.foldable is False
    assert result.hinges[0]["why"] == "panels touch before it has folded"
    assert result.evidence["touching"] is True
    free = answer(
        made(two_panels(0.2), 3.6, 100.0, 0.2), ("gravity", "ground"), need=3.5, upright=True
    )
    assert free.foldable is True and free.evidence["clearance"] is None


def test_a_layer_that_bends_too_little_is_named():
    result = answer(made(squares(ROW), 0.5, 100.0), need=0.6)
    assert {h["why"] for h in result.hinges} == {
        "its layer would not bend it far enough even if it were alone"
    }


def test_hinges_that_hold_each_other_are_named():
    # Around an inner vertex two parallel pairs of valleys can't both fold.
    pattern = squares([(0, 0), (1, 0), (0, 1), (1, 1)])
    result = answer(made(pattern, 1.0, 1.0), (), need=0.9)
    assert result.foldable is False
    assert "the other hinges around its panels hold it back" in {h["why"] for h in result.hinges}


def test_mountains_count_to_their_side_and_free_creases_not_at_all():
    plain = squares([(0, 0), (1, 0), (2, 0), (3, 0)])
    creases = [
        Crease(c.ends, fold, c.length) for c, fold in zip(plain.creases, (1, -1, 0), strict=True)
    ]
    pattern = Pattern(plain.vertices, plain.faces, creases)
    result = answer(made(pattern, 1.0, 100.0), ())
    assert result.foldable is True and result.reason.startswith("all 2 hinges fold")
    valley, mountain, free = result.hinges
    assert valley["angle"] == approx(1.0, abs=1e-3) and mountain["angle"] == approx(-1.0, abs=1e-3)
    assert mountain["natural"] == approx(-1.0) and mountain["folds"] is True
    assert free["fold"] == "free" and free["folds"] is None and free["error"] is None
    assert free["angle"] == approx(0.0, abs=1e-3)


def test_panels_that_sag_leave_a_fold_unknown_and_labels_give_it_an_error():
    soft = answer(made(squares(ROW), 1.0, 5.0))
    assert soft.evidence["panel_sag"] > 0.05 and all(h["folds"] for h in soft.hinges)
    assert soft.foldable is None
    assert soft.reason.startswith(
        "unknown: rigid panels fold at all 2 hinges, but panels would sag"
    )
    stiff = answer(from_labels(made(squares(ROW), 1.0, 200.0))[0])
    assert stiff.foldable is True
    error = stiff.hinges[0]["error"]
    assert stiff.reason == f"all 2 hinges fold, angles of single hinges to {100 * error:.2g} %"


def test_a_path_without_end_is_unknown():
    result = answer(made(squares(ROW), 1.0, 1.0), timeout=0.0)
    assert result.foldable is None
    assert result.reason.startswith("unknown: the time allowed was used up")
    assert result.evidence["outcome"] == "timeout"


def test_strain_is_that_of_the_bent_section():
    h, angle, length = 4e-3, 1.0, 0.1
    body = made(squares(ROW), angle, 1.0)
    k, law = angle / length, body.laws[0]
    told = strain(body, np.array([angle, angle]))
    middle, c = law.stretch[-1], body.layers[0].contraction
    faces = [middle - k * z - 1 for z in (-h / 2, h / 2)]
    assert told["passive"] == approx(np.abs(faces).max())
    faces = [(middle - k * z) / (1 - c) - 1 for z in (h / 2, 3 * h / 2)]
    assert told["active"] == approx(np.abs(faces).max())


def test_laws_are_those_of_labels():
    body = structure(two_panels(0.2), contraction=0.08)
    new, (row,) = from_labels(body)
    source = SolverSource(Conditions(effects="none"), Effort(0.02, whole=True))
    label = source.label(
        {
            "E_ratio": 1.0, "rho_ratio": 1.0, "hinge_length": 1 / 3, "hinge_width": 1.0,
            "h_ratio": 1.0, "stiffness_to_weight": 1.0, "aspect": 1 / 3,
            "slenderness": 4e-3 / 0.6, "contraction": 0.08,
        }
    )  # fmt: skip
    assert row["angle"] == approx(label.evidence["m1"])
    assert row["error"] == approx(label.evidence["error_estimate"])
    assert row["section"] == approx(body.laws[0].angle[-1])
    assert new.laws[0].angle[-1] == approx(row["angle"]) and new.laws[0].angle[0] == 0.0
    assert new.laws[0].error == row["error"]
    assert new.laws[0].stiffness is body.laws[0].stiffness
    assert row["length"] == 0.2 and row["width"] == approx(0.2) and row["core_seconds"] > 0
    # Halfway the section's course is kept, corrected as the label says.
    assert 0 < abs(new.laws[0].at(0.5)[0] / body.laws[0].at(0.5)[0] - 1) < 0.1


def test_a_label_is_asked_for_with_the_hinges_own_groups(monkeypatch):
    asked = []

    def follow(design):
        asked.append(design)
        return SimpleNamespace(history=[]), SimpleNamespace(evidence={"core_seconds": 2.0})

    monkeypatch.setattr(laws, "SolverSource", lambda *a: SimpleNamespace(follow=follow))
    sheet, layer = Layer(2e6, 800.0, 4e-3), Layer(6e6, 400.0, 1e-3, 0.08)
    body = Structure.of(two_panels(length=0.2, width=0.3), sheet, layer)
    from_labels(body)
    # Beside a hinge of 0.2 m two panels as long as it is.
    assert asked == [
        approx(
            {
                "E_ratio": 3.0, "rho_ratio": 0.5, "hinge_length": 1 / 3, "hinge_width": 1.0,
                "h_ratio": 0.25, "stiffness_to_weight": 1.0, "aspect": 0.3 / 0.6,
                "slenderness": 4e-3 / 0.6, "contraction": 0.08,
            }
        )
    ]  # fmt: skip


def test_hinges_of_one_kind_are_asked_for_once_and_lost_labels_leave_the_section():
    body = structure(squares(ROW), contraction=0.05)
    new, told = from_labels(body)
    assert len(told) == 1 and new.laws[0] is new.laws[1]
    late, (row,) = from_labels(body, timeout=1e-6)
    assert row["angle"] is None and row["error"] is None
    assert late.laws[0] is body.laws[0]


def test_two_panels_are_a_unit():
    # A light unit of stiff panels: the label's own angle, within its error.
    design = {
        "E_ratio": 0.5, "rho_ratio": 1.0, "hinge_length": 0.2, "hinge_width": 1.0, "h_ratio": 1.0,
        "stiffness_to_weight": 50.0, "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.04,
    }  # fmt: skip
    label = SolverSource().label(design)
    body = structure(two_panels(0.2), contraction=0.04, gamma=50.0, E=0.5e6)
    result = answer(from_labels(body)[0])
    error = label.evidence["error_estimate"]
    assert result.hinges[0]["angle"] == approx(label.evidence["m1"], rel=2 * error)


@pytest.mark.parametrize("effects, says", [(("wind",), "effect 'wind'"), (("ground",), "together")])
def test_effects_that_are_none_are_told(effects, says):
    with pytest.raises(ValueError, match=says):
        answer(structure(two_panels()), effects)
