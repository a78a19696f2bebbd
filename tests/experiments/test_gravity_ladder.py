"""What rungs and their mixtures answer, and at what price."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments import gravity_ladder
from experiments.gravity_ladder import Config, _mixed, _row, _unless, picture
from foldlab.datasets import of_space
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.features import probability_of_folding
from foldlab.learning.models import make_classifier

NAN = np.nan


def test_what_a_rung_leaves_open_goes_to_the_next_at_its_price_on_top():
    first = np.array([1.0, NAN, NAN, 0.0]), np.full(4, 0.1)
    second = np.array([0.0, 1.0, NAN, 1.0]), np.array([1.0, 2.0, 3.0, 4.0])
    third = np.array([0.0, 0.0, 1.0, 1.0]), np.full(4, 10.0)
    answers, costs = _mixed([first, second, third])
    assert answers.tolist() == [1.0, 1.0, 1.0, 0.0]
    assert costs.tolist() == pytest.approx([0.1, 2.1, 13.1, 0.1])
    # The rungs are not changed.
    assert np.isnan(first[0]).sum() == 2 and first[1].tolist() == [0.1] * 4


def test_wrong_answers_are_counted_among_those_given():
    answers = np.array([1.0, 0.0, NAN, 1.0])
    row = _row("one", answers, np.array([1.0, 2.0, 3.0, 6.0]), np.array([True, True, True, True]))
    assert row["answered"] == 0.75 and row["wrong"] == pytest.approx(1 / 3)
    assert row["wrong"] < row["wrong_most"] < 1 and row["core_seconds"] == 3.0
    none = _row("none", np.full(2, NAN), np.ones(2), np.array([True, False]))
    assert none["wrong"] is None and none["answered"] == 0.0


def test_a_rung_that_is_unsure_gives_no_answer():
    answers, costs = _unless((np.array([1.0, 0.0]), np.ones(2)), np.array([False, True]))
    assert answers[0] == 1.0 and np.isnan(answers[1]) and costs.tolist() == [1.0, 1.0]


def test_a_coarse_label_is_paid_for_after_the_first_which_compiles(monkeypatch):
    asked = []

    class Source:
        def __init__(self, *, effort):
            assert effort.refine == "never"

        def label(self, design):
            asked.append(design["h_ratio"])
            folds = None if len(asked) == 2 else True
            return SimpleNamespace(foldable=folds, evidence={"core_seconds": float(len(asked))})

    monkeypatch.setattr(gravity_ladder, "SolverSource", Source)
    designs = FULL.sample(3, seed=0)
    row = gravity_ladder._coarse(designs, np.array([True, True, False]))
    assert asked == [designs["h_ratio"].iloc[0], *designs["h_ratio"]]
    assert row["answered"] == pytest.approx(2 / 3) and row["wrong"] == 0.5
    assert row["core_seconds"] == 3.0


@pytest.fixture(scope="module")
def dataset():
    """Labels of the beam formulas and some noise; some unknown, some of strips."""
    table = FULL.sample(400, seed=0)
    noise = 0.3 * np.random.default_rng(0).normal(size=400)
    table["foldable"] = pd.array(beam.formulas(table)["net"] + noise > 1, dtype="boolean")
    table["core_seconds"] = 1.0 + np.arange(400) / 100
    table["strips"] = 0.0
    table.loc[::50, "strips"] = 2.0
    table.loc[1::50, "foldable"] = None
    return table


CONFIG = Config(test=80, few=100, coarse=5, sure=0.9, room=0.5, seed=1)


@pytest.fixture
def rungs(dataset, tracker, monkeypatch):
    """Rows of the experiment by rung, its result, and the labels tested on and learned from."""
    coarse = []
    monkeypatch.setattr(
        gravity_ladder, "load_dataset", lambda name, growth, space: of_space(dataset, name, space)
    )
    monkeypatch.setattr(
        gravity_ladder, "_coarse",
        lambda designs, truth: coarse.append((len(designs), len(truth))) or {
            "rung": "solver, coarsest mesh", "answered": 1.0, "wrong": 0.0, "wrong_most": 0.5,
            "core_seconds": 0.5,
        },
    )  # fmt: skip
    result = gravity_ladder.run(CONFIG, tracker)
    assert coarse == [(5, 5)]
    plain = dataset[(dataset["strips"] == 0) & dataset["foldable"].notna()]
    shuffled = plain.sample(frac=1.0, random_state=1)
    return {r["rung"]: r for r in result["table"]}, result, shuffled.head(80), shuffled.iloc[80:]


def test_rungs_answer_designs_that_no_model_has_seen(rungs):
    rows, result, test, rest = rungs
    truth, designs = test["foldable"].to_numpy(bool), test[FULL.names]
    assert (result["test_labels"], result["labels_of_models"]) == (80, [len(rest), 100])
    assert result["core_seconds_of_few_labels"] == pytest.approx(rest["core_seconds"][:100].sum())
    plain = TimoshenkoSource(space=FULL).evaluate(designs)["foldable"].to_numpy(bool)
    assert rows["Timoshenko, no weight"]["wrong"] == np.mean(plain != truth)
    net = beam.formulas(designs)["net"].to_numpy()
    assert rows["beam formulas"]["wrong"] == np.mean((net > 1) != truth)
    sure = np.abs(net - 1) >= 0.5
    assert rows["beam formulas, sure"]["answered"] == sure.mean() < 1
    assert rows["beam formulas, sure"]["wrong"] == np.mean(((net > 1) != truth)[sure])
    for name, labels in (("many", rest), ("few", rest.head(100))):
        model = make_classifier("boosted", FULL, seed=1)
        model.fit(labels[FULL.names], labels["foldable"].astype(bool))
        p = probability_of_folding(model, designs)
        folds, sure = p >= 0.5, (p >= 0.9) | (p <= 0.1)
        assert rows[f"model of {len(labels)} labels"]["wrong"] == np.mean(folds != truth)
        row = rows[f"model, {name}, sure"]
        assert row["answered"] == sure.mean() and row["wrong"] == np.mean((folds != truth)[sure])
    assert rows["rod"]["answered"] == 1.0 > rows["rod, sure"]["answered"] > 0


def test_what_a_mixture_leaves_to_the_solver_costs_its_labels_and_is_right(rungs):
    rows, _, test, _ = rungs
    cost = test["core_seconds"].mean()
    solver = rows["solver, 2 %"]
    assert solver["core_seconds"] == pytest.approx(cost) and solver["answered"] == 1.0
    assert solver["wrong"] is solver["wrong_most"] is None
    first = {
        "rod → solver": "rod, sure", "formulas → rod → solver": "beam formulas, sure",
        "model (few) → solver": "model, few, sure", "model (few) → rod → solver":
        "model, few, sure", "model → rod → solver": "model, many, sure",
    }  # fmt: skip
    for name, step in first.items():
        row, open_ = rows[name], 1 - rows[step]["answered"]
        assert row["answered"] == 1.0
        # Wrong is what was wrong before, of all now, and what the rod says wrongly between.
        before = rows[step]["wrong"] * rows[step]["answered"]
        if "→ rod" in name:
            assert row["wrong"] >= before - 1e-12
            assert (
                row["core_seconds"] < rows[name.replace("rod → ", "")]["core_seconds"]
                if ("few" in name)
                else row["core_seconds"] < cost
            )
        else:
            assert row["wrong"] == pytest.approx(before)
            assert row["core_seconds"] == pytest.approx(cost * open_, rel=0.35)


def test_what_lies_near_the_boundary_is_learned_from_and_not_tested_on(
    dataset, tracker, monkeypatch
):
    drawn = dataset.assign(drawn=np.where(np.arange(400) % 4 == 0, "hypercube", "boundary"))
    monkeypatch.setattr(
        gravity_ladder, "load_dataset", lambda name, growth, space: of_space(drawn, name, space)
    )
    seen = {}

    def coarse(designs, truth):
        seen["designs"] = designs
        return {"rung": "solver, coarsest mesh", "answered": 1.0, "wrong": 0.0, "wrong_most": 0.5,
                "core_seconds": 0.5}  # fmt: skip

    monkeypatch.setattr(gravity_ladder, "_coarse", coarse)
    gravity_ladder.run(Config(test=80, few=100, coarse=80, sure=0.9), tracker)
    cube = drawn.loc[drawn["drawn"] == "hypercube", "h_ratio"]
    assert len(seen["designs"]) == 80 and set(seen["designs"]["h_ratio"]) <= set(cube)
    with pytest.raises(InputError, match="known labels; test and few ask for more"):
        gravity_ladder.run(Config(test=101, few=100), tracker)


def test_more_labels_than_there_are_are_refused(dataset, tracker, monkeypatch):
    monkeypatch.setattr(
        gravity_ladder, "load_dataset", lambda name, growth, space: of_space(dataset, name, space)
    )
    with pytest.raises(InputError, match="384 known labels; test and few ask for more"):
        gravity_ladder.run(Config(test=284, few=101), tracker)


def test_the_picture_numbers_what_is_wrong_by_its_price_up_to_its_bound():
    frame = pd.DataFrame({
        "rung": ["rod", "rod → solver", "solver, 2 %"],
        "answered": [0.9, 1.0, 1.0],
        "wrong": [0.02, 0.0, None],
        "wrong_most": [0.05, 0.01, None],
        "core_seconds": [1e-3, 0.1, 0.7],
    })  # fmt: skip
    (ax,) = picture(frame).axes
    rod, mixture = ax.containers
    (ends,), (most,) = (bar.lines[2][0].get_segments() for bar in (rod, mixture))
    assert ends == pytest.approx(np.array([[1e-3, 0.02], [1e-3, 0.05]]))
    assert most[1] == pytest.approx([0.1, 0.01]) and most[0][1] == 3e-4
    key = ax.texts[-1].get_text()
    assert "1  rod, answers 90 %" in key and "2  rod → solver, none wrong" in key
    assert "solver, 2 %: the reference" in key and "3  " not in key
    assert ax.lines[-1].get_xdata() == pytest.approx([0.7, 0.7])
