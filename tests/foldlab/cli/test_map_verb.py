"""``foldlab map`` over units with weight: what is held, compared and verified."""

import json

import pandas as pd
import pytest

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.learning import saving
from foldlab.learning.saving import load_model, save_model, shipped, shipped_for
from foldlab.learning.train import fit


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A folder with a tree of gravity labels."""
    table = load_dataset("gravity-5k")
    table = table[table["growth"] == "uniaxial"].head(400)
    folder = tmp_path_factory.mktemp("shipped") / "gravity"
    return save_model(fit("tree", FULL, table, seed=0), folder)


def test_one_command_draws_a_map_under_weight_and_the_solver_verifies_it(
    foldlab, model, monkeypatch, tmp_path
):
    monkeypatch.setattr(saving, "SHIPPED", model.parent)
    line = "map --space full --slice stiffness_to_weight --panels 2 --points 200 -o a.png --json"
    status, out, err = foldlab(f"{line} --verify 2 --timeout 20 --set contraction=0.1")
    result = json.loads(out)
    assert status == 0 and result["slices"] == pytest.approx([1e-2, 1e2])
    assert result["verified"] == 2 >= result["verified_known"] >= result["verified_agree"]
    assert result["verified_core_seconds"] > 0
    assert set(result["fixed"]) == set(FULL.names) - {"E_ratio", "h_ratio", "stiffness_to_weight"}
    assert result["fixed"]["contraction"] == 0.1
    assert "held in the middle of their bounds: rho_ratio = 1, " in err
    assert "contraction" not in err.splitlines()[0]
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"


def test_unknown_labels_count_neither_for_nor_against_the_model(foldlab, model, monkeypatch):
    def labelled(designs, source, **options):
        answers = pd.array([None, True, False, True] * 3, dtype="boolean")
        assert options["workers"] == 2 and source.timeout == 9
        return designs.assign(foldable=answers, predicted=True, core_seconds=0.5)

    monkeypatch.setattr("foldlab.campaign.campaign.labelled", labelled)
    line = f"map {model} --panels 1 --points 100 --verify 12 --timeout 9 --workers 2 -o a.png"
    result = json.loads(foldlab(f"{line} --json")[1])
    told = [result[f"verified{name}"] for name in ("", "_known", "_agree", "_core_seconds")]
    assert told == [12, 9, 6, 6.0]


def test_a_single_panel_lies_in_the_middle(foldlab, model):
    line = f"map {model} --slice contraction --panels 1 --points 4 -o a.png --json"
    assert json.loads(foldlab(line)[1])["slices"] == pytest.approx(
        [FULL["contraction"].from_unit(0.5)]
    )


@pytest.mark.parametrize(
    "line, says",
    [
        ("map -o a.png", "no model: give the folder of one, or --space full"),
        ("map --space patterned -o a.png", "no model for the patterned space is shipped"),
        ("map MODEL --space reduced -o a.png", "is of the space full, not reduced"),
        ("map MODEL --verify 500 --points 100 --panels 1 -o a.png", "500 points to verify"),
    ],
)
def test_what_no_map_can_be_drawn_of_is_one_sentence(foldlab, model, monkeypatch, line, says):
    monkeypatch.setattr(saving, "SHIPPED", model.parent)
    status, out, err = foldlab(line.replace("MODEL", str(model)))
    assert status == 2 and says in err and out == ""


def test_models_that_come_along_are_known_by_name(model, monkeypatch):
    monkeypatch.setattr(saving, "SHIPPED", model.parent)
    assert shipped() == {"gravity": model} and shipped_for("full") == "gravity"
    assert load_model("gravity")[1] == load_model(model)[1]
