"""From a table of labels to a model: what is kept aside, and what is too little."""

import numpy as np
import pandas as pd
import pytest

from foldlab.design import FULL, PATTERNED, REDUCED
from foldlab.errors import InputError
from foldlab.labels import timoshenko
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning import train
from foldlab.learning.saving import load_model, save_model
from foldlab.learning.train import known_angles, train_on


def table(folding, not_folding):
    """So many labels of each kind."""
    X = REDUCED.sample(4000, seed=0)
    X["foldable"] = np.asarray(timoshenko.folds(**X))
    return X[
        X.groupby("foldable").cumcount() < X["foldable"].map({True: folding, False: not_folding})
    ]


@pytest.fixture
def untrained(monkeypatch):
    """What is too little is told before any training."""

    def begun(*_, **__):
        raise AssertionError("training began")

    monkeypatch.setattr(train, "fit", begun)


@pytest.mark.parametrize(
    "folding, not_folding, options, message",
    [
        (200, 6, {"rate": 0.1}, "too few of a kind for choosing the threshold"),
        (6, 200, {"rate": 0.1}, "too few of a kind for choosing the threshold"),
        (200, 60, {"rate": 0.1}, "needs at least 29 of them (here about 126 labels"),
        (200, 200, {"holdout": 0.001}, "too few of a kind for training and a holdout of 0.001"),
        (95, 5, {"holdout": 0.01}, "5 of"),
        (50, 50, {"holdout": 0.01}, "too few of a kind"),
        (50, 50, {"holdout": 0.99}, "too few of a kind"),
        (400, 5, {"holdout": 0.01}, "too few of a kind"),
        (400, 5, {"holdout": 0.99}, "too few of a kind"),
    ],
)
def test_too_few_labels_are_told_before_training(untrained, folding, not_folding, options, message):
    with pytest.raises(InputError) as told:
        train_on(table(folding, not_folding), "tree", seed=0, **options)
    assert message in str(told.value)


@pytest.mark.parametrize("holdout", [0.01, 0.99])
def test_a_small_and_a_large_holdout_hold_both_kinds(holdout):
    _, card = train_on(table(300, 300), "tree", seed=0, holdout=holdout)
    assert (
        card["labels"] == round(600 * (1 - holdout)) and card["holdout_n"] == 600 - card["labels"]
    )
    assert card["holdout_recall"] is not None and card["holdout_false_positive_rate"] is not None


def test_strips_are_learnt_and_saved(tmp_path):
    source = TimoshenkoSource(PATTERNED)
    labels = source.evaluate(PATTERNED.sample(2000, seed=0))
    model, card = train_on(labels, "tree", seed=0)
    assert card["space"] == "patterned"
    features = list(model[0].get_feature_names_out())
    assert {"log10(strips)", "strip_share"} <= set(features)
    again, card = load_model(save_model(model, tmp_path / "m"))
    assert card["space"] == "patterned"
    fresh = PATTERNED.sample(200, seed=1)
    probability = again.predict_proba(fresh)
    np.testing.assert_array_equal(probability, model.predict_proba(fresh))
    solid = fresh.drop(columns=["strips", "strip_share"])
    with pytest.raises(InputError, match="lacks strips, strip_share"):
        again.predict_proba(solid)


@pytest.mark.parametrize("holdout", [0.0, 1.0])
def test_a_holdout_is_a_fraction(untrained, holdout):
    with pytest.raises(InputError, match=f"holdout = {holdout:g}; expected a fraction"):
        train_on(table(50, 50), "tree", seed=0, holdout=holdout)


def test_five_of_a_kind_are_the_least(untrained):
    with pytest.raises(InputError, match="4 of 54 designs fold; training needs at least 5 of each"):
        train_on(table(4, 50), "tree", seed=0)
    with pytest.raises(InputError, match="50 of 50 designs fold"):
        train_on(table(50, 0), "tree", seed=0)
    with pytest.raises(AssertionError, match="training began"):
        train_on(table(5, 50), "tree", seed=0)


def test_what_is_held_out_is_halved_where_a_threshold_or_doubts_are_chosen():
    labels = table(300, 300)
    labels["foldable"] = labels["foldable"].astype("boolean")
    labels.loc[labels.index[:7], "foldable"] = None
    _, plain = train_on(labels, "tree", seed=0, holdout=0.4)
    assert (plain["labels"], plain["unknown"], plain["calibration_labels"]) == (356, 7, 0)
    assert plain["holdout_n"] == 237 and plain["threshold"] is plain["borders"] is None
    options = {"max_depth": 3, "min_samples_leaf": 30}
    for more in ({"rate": 0.3}, {"coverage": 0.8}, {"rate": 0.3, "coverage": 0.8}):
        _, card = train_on(labels, "tree", seed=0, holdout=0.4, options=options, **more)
        assert (card["labels"], card["calibration_labels"], card["holdout_n"]) == (356, 119, 118)
        assert (card["threshold"] is not None) == ("rate" in more)
        assert (card["borders"] is not None) == ("coverage" in more)
        assert ("holdout_decided" in card) == ("coverage" in more)
    assert card["borders"]["coverage"] == 0.8 and card["borders"]["labels"] == 119
    known = labels[labels["foldable"].notna()]
    for name, (low, high) in card["bounds"].items():
        assert known[name].min() <= low < high <= known[name].max()
    assert (card["model"], card["space"], card["inputs"], card["seed"]) == (
        "tree", "reduced", "groups", 0,
    )  # fmt: skip


def test_an_angle_of_a_path_that_did_not_end_is_left_out():
    labels = FULL.sample(60, seed=0).assign(fold_angle=np.linspace(0.1, 2.0, 60))
    labels["foldable"] = pd.array([True, False] * 30, dtype="boolean")
    labels.loc[[0, 1], "foldable"] = None
    labels.loc[5, "fold_angle"] = np.nan
    known, missing = known_angles(labels, FULL)
    assert missing == 3 and not {0, 1, 5} & set(known.index) and len(known) == 57
    assert known["fold_angle"].tolist() == labels["fold_angle"].drop([0, 1, 5]).tolist()
    _, card = train_on(labels, "angle", seed=0, holdout=0.5)
    assert (card["labels"], card["holdout_n"], card["without_angle"]) == (29, 28, 3)
    assert card["task"] == card["model"] == "angle" and card["train_seconds"] > 0
    for few, enough in ((22, True), (21, False)):
        some = known.head(few)
        if enough:
            assert train_on(some, "angle", seed=0, holdout=0.1)[1]["labels"] == 20
        else:
            with pytest.raises(
                InputError, match=r"21 designs have a fold angle; a holdout of 0\.1"
            ):
                train_on(some, "angle", seed=0, holdout=0.1)
    with pytest.raises(InputError, match="no design in the table has a fold angle"):
        known_angles(labels.assign(fold_angle=np.nan), FULL)
    with pytest.raises(InputError, match="has no column fold_angle"):
        known_angles(labels.drop(columns="fold_angle"), FULL)
    for more in ({"rate": 0.1}, {"coverage": 0.9}):
        with pytest.raises(InputError, match="says an angle and no probability"):
            train_on(labels, "angle", seed=0, **more)


def test_the_symbolic_model_gets_the_threshold_and_the_sign_of_its_labels(monkeypatch):
    made = {}

    class Model:
        def set_params(self, **given):
            made.update(given)

        def fit(self, X, y):
            made.update(X=len(X), y=list(y))
            return self

    monkeypatch.setattr(train, "make_classifier", lambda *_, **__: Model())
    labels = REDUCED.sample(4, seed=0).assign(
        foldable=pd.array([True, None, False, True], dtype="boolean"),
        normalised_angle=[3.0, 9.0, np.nan, 2.0], threshold=2.5,
    )  # fmt: skip
    train.fit("symbolic", REDUCED, labels, seed=0)
    assert made == {"threshold": 2.5, "margin": False, "X": 2, "y": [3.0, 2.0]}
    train.fit("symbolic", REDUCED, labels.assign(normalised_angle=[3.0, 1.0, 1.0, 0.0]), seed=0)
    assert made["margin"] is True and made["y"] == [3.0, 1.0, 0.0]


def parted(n=300):
    """Labels that name their parts; those of the test are all turned round."""
    labels = table(n, n).reset_index(drop=True)
    labels["part"] = np.resize(["train", "validation", "train", "test", "train"], len(labels))
    test = labels["part"] == "test"
    labels.loc[test, "foldable"] = ~labels.loc[test, "foldable"]
    return labels


def test_a_table_that_names_its_parts_trains_chooses_and_scores_by_them():
    labels = parted()
    counts = labels["part"].value_counts()
    _, card = train_on(labels, "tree", seed=0)
    assert (card["split"], card["labels"], card["holdout_n"]) == (
        "parts", counts["train"], counts["test"],
    )  # fmt: skip
    assert card["holdout_accuracy"] < 0.2 and card["calibration_labels"] == 0
    _, card = train_on(labels, "boosted", seed=0, coverage=0.9, rate=0.1)
    assert card["labels"] == counts["train"] and card["holdout_n"] == counts["test"]
    assert card["calibration_labels"] == counts["validation"]
    # Who asks for a fraction gets one, and so does a table that lacks a part.
    _, card = train_on(labels, "tree", seed=0, holdout=0.5)
    assert (card["split"], card["labels"]) == ("random", len(labels) // 2)
    _, card = train_on(labels[labels["part"] != "test"], "tree", seed=0)
    assert card["split"] == "random"
    alike = labels[(labels["part"] != "test") | labels["foldable"]]
    with pytest.raises(InputError, match="all labels of the part test say the same"):
        train_on(alike, "tree", seed=0)


def test_angles_are_scored_on_the_part_named_test():
    labels = FULL.sample(100, seed=0).assign(fold_angle=1.0, foldable=True)
    labels["part"] = np.resize(["train", "train", "train", "validation", "test"], 100)
    labels.loc[labels["part"] == "test", "fold_angle"] = 2.0
    _, card = train_on(labels, "angle", seed=0, options={"inputs": "groups"})
    assert (card["split"], card["labels"], card["holdout_n"]) == ("parts", 60, 20)
    assert card["holdout_error_median"] == pytest.approx(0.5, rel=0.01)


def test_solid_layers_and_ones_cut_in_strips_are_not_mixed():
    both = PATTERNED.sample(40, seed=0).assign(foldable=[True, False] * 20)
    both.loc[:9, "strips"] = 0.0
    with pytest.raises(InputError, match=r"10 of 40 designs are solid.*patterned.*space='full'"):
        train_on(both, "tree", seed=0)
    with pytest.raises(InputError, match=r"30 of 40 designs are cut in strips.*full space doesn't"):
        train.known_labels(both, FULL)
    solid, unknown = train.known_labels(both.head(10), FULL)
    assert len(solid) == 10 and unknown == 0
