"""From a table of labels to a model: what is kept aside, and what is too little."""

import numpy as np
import pytest

from foldlab.design import PATTERNED, REDUCED
from foldlab.errors import InputError
from foldlab.labels import timoshenko
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning import train
from foldlab.learning.saving import load_model, save_model
from foldlab.learning.train import train_on


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
