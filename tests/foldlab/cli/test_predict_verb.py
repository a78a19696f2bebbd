"""``foldlab predict``: answers, doubts, where the model learned, and who is asked besides."""

import json

import numpy as np
import pandas as pd
import pytest

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.labels.label import Label
from foldlab.labels.solver import SolverSource
from foldlab.learning import saving
from foldlab.learning.conformal import Borders
from foldlab.learning.features import probability_of_folding
from foldlab.learning.saving import load_model, save_model
from foldlab.learning.train import train_on


@pytest.fixture(scope="module")
def labels():
    table = load_dataset("gravity-5k", growth="uniaxial").head(1500)
    return table[table["slenderness"] < 0.02].reset_index(drop=True)


@pytest.fixture(scope="module")
def model(tmp_path_factory, labels):
    """A folder with a model that may say that it doesn't know."""
    options = {"max_iter": 30, "inputs": "physics"}
    fitted, made = train_on(labels, "boosted", seed=0, holdout=0.5, coverage=0.99, options=options)
    made |= {"dataset": "gravity-5k", "growth": "uniaxial"}
    return save_model(fitted, tmp_path_factory.mktemp("shipped") / "gravity", made)


@pytest.fixture
def designs(tmp_path):
    table = FULL.sample(300, seed=8)
    table.to_csv(tmp_path / "d.csv", index=False)
    return table


def test_each_design_has_probability_verdict_and_whether_it_lies_where_the_model_learned(
    foldlab, model, designs, monkeypatch
):
    monkeypatch.setattr(saving, "SHIPPED", model.parent)
    status, out, err = foldlab("predict d.csv -o p.csv --json")
    assert status == 0, err
    told, table = json.loads(out), pd.read_csv("p.csv")
    fitted, card = load_model(model)
    p = probability_of_folding(fitted, designs)
    np.testing.assert_allclose(table["probability"], p, rtol=1e-9)
    borders = Borders(**card["metadata"]["borders"])
    expected = pd.Series(borders.answers(p))
    assert table["foldable"].astype("boolean").equals(expected.astype("boolean"))
    assert told["does_not_know"] == expected.isna().sum() > 0
    assert told["folds"] == (expected == True).sum()  # noqa: E712
    assert told["folds"] + told["does_not"] + told["does_not_know"] == told["designs"] == 300
    assert told["coverage"] == 0.99 and told["model"] == "boosted"
    # The labels were of thinner sheets only.
    beyond = designs["slenderness"] > 0.02
    assert not table["inside"][beyond].any() and told["outside_of_training"] >= beyond.sum() > 50
    assert table["inside"].sum() > 50 and (table["by"] == "model").all()


def test_the_nearest_label_is_told_with_its_distance(foldlab, model, labels, tmp_path):
    known = labels[labels["foldable"].notna()]
    moved = known.iloc[[3, 7]][FULL.names].copy()
    # A tenth of one group's bounds.
    at = FULL["contraction"].to_unit(moved["contraction"].to_numpy()[1])
    moved.iloc[1, FULL.names.index("contraction")] = FULL["contraction"].from_unit(
        at + (0.1 if at < 0.5 else -0.1)
    )
    moved.to_csv(tmp_path / "d.csv", index=False)
    labels.to_parquet(tmp_path / "l.parquet")
    assert foldlab(f"predict d.csv -o p.parquet --model {model} --labels l.parquet")[0] == 0
    table = pd.read_parquet("p.parquet")
    assert table["nearest"].tolist() == known.index[[3, 7]].tolist()
    assert table["nearest_distance"].tolist() == pytest.approx([0, 0.1 / 3], abs=1e-12)
    same = known["foldable"].iloc[[3, 7]].astype(bool).tolist()
    assert table["nearest_foldable"].tolist() == same


def test_where_the_model_does_not_know_the_solver_is_asked_and_nowhere_else(
    foldlab, model, designs, monkeypatch
):
    from foldlab.campaign import campaign

    asked = []

    def here(table, source, store, *, workers, progress):
        asked.extend(table.index)
        assert isinstance(source, SolverSource) and source.timeout == 7 and workers == 2
        store.add_many(
            Label(
                dict(d), k % 2 == 0, f"why {k}", {"fold_angle": 0.5 + k}, "solver", source.version
            )
            for k, d in enumerate(table.to_dict("records"))
        )

    monkeypatch.setattr(campaign, "run_campaign", here)
    line = f"predict d.csv -o p.csv --model {model} --json"
    before = foldlab(line)
    told = json.loads(foldlab(f"{line} --defer solver --timeout 7 --workers 2")[1])
    table = pd.read_csv("p.csv")
    assert told["asked_the_solver"] == len(asked) == json.loads(before[1])["does_not_know"] > 1
    assert told["does_not_know"] == 0
    rows = table.loc[asked]
    assert (rows["by"] == "solver").all() and (table["by"] == "solver").sum() == len(asked)
    assert rows["foldable"].astype(bool).tolist() == [k % 2 == 0 for k in range(len(asked))]
    assert rows["reason"].tolist() == [f"why {k}" for k in range(len(asked))]
    assert rows["fold_angle"].tolist() == [0.5 + k for k in range(len(asked))]


def test_angles_come_with_what_nine_of_ten_are_off_by_and_many_are_announced(
    foldlab, designs, monkeypatch
):
    from foldlab import predicted

    monkeypatch.setattr(predicted, "MANY", 299)
    status, out, err = foldlab("predict d.csv -o p.csv --json")
    told, card = json.loads(out), load_model("gravity-angle")[1]["metadata"]
    assert status == 0 and told["fold_angle_error_90"] == card["holdout_error_90"] > 0
    assert told["seconds"] > 0 and "fold angles take a rod each: about 0 s" in err
    monkeypatch.setattr(predicted, "MANY", 300)
    assert "a rod each" not in foldlab("predict d.csv -o p.csv --json")[2]


@pytest.mark.parametrize(
    "line, says",
    [
        ("predict d.csv -o p.csv", "no model for the full space is shipped"),
        ("predict r.csv -o p.csv --model MODEL", "the space full, and the designs are of reduced"),
        ("predict d.csv -o p.txt --model MODEL", "expected .parquet or .csv"),
        ("predict d.csv -o p.csv --model MODEL --defer me", "--defer"),
    ],
)
def test_what_cannot_be_predicted_is_one_sentence(foldlab, model, designs, monkeypatch, line, says):
    monkeypatch.setattr(saving, "SHIPPED", model.parent / "none")
    designs[["E_ratio", "h_ratio", "slenderness"]].to_csv("r.csv", index=False)
    status, out, err = foldlab(line.replace("MODEL", str(model)))
    assert status == 2 and says in err and not out
    assert not list(model.parent.glob("p.*"))


def test_a_model_without_borders_always_answers(foldlab, labels, designs, tmp_path):
    fitted, made = train_on(labels.head(300), "tree", seed=0)
    save_model(fitted, tmp_path / "m", made)
    told = json.loads(foldlab("predict d.csv -o p.csv --model m --json")[1])
    assert told["does_not_know"] == 0 and told["coverage"] is None
    table = pd.read_csv("p.csv")
    answers = fitted.predict(designs)
    assert (table["foldable"].astype(bool) == answers).all() and "nearest" not in table
