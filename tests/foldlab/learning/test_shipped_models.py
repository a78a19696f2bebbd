"""The models that come with foldlab: small, safe to read, and as good as their cards say."""

import numpy as np
import pytest

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.learning.conformal import Borders
from foldlab.learning.features import probability_of_folding
from foldlab.learning.saving import load_model, shipped, shipped_for


@pytest.fixture(scope="module")
def known():
    table = load_dataset("gravity", growth="uniaxial", space="full", part="test")
    return table[table["foldable"].notna()]


def test_each_is_below_a_megabyte_and_has_a_card():
    assert set(shipped()) >= {"gravity", "gravity-angle"}
    for name, folder in shipped().items():
        files = list(folder.iterdir())
        assert sum(f.stat().st_size for f in files) < 1e6, name
        # JSON, skops and plain arrays load no code; the .pt2 is not read by foldlab.
        assert {f.suffix for f in files} <= {".json", ".skops", ".npz", ".pt2"}
        made = load_model(name)[1]["metadata"]
        assert {"dataset", "growth", "command", "commit", "limits", "bounds", "labels"} <= set(made)
        assert "dirty" not in made["commit"]
        assert set(made["bounds"]) == set(FULL.names)


def test_the_classifier_answers_as_rarely_wrong_as_its_card_says(known):
    assert shipped_for("full") == "gravity"
    model, card = load_model("gravity")
    made = card["metadata"]
    p = probability_of_folding(model, known[FULL.names])
    answers = Borders(**made["borders"]).answers(p)
    truth = known["foldable"].to_numpy(bool)
    told = ~np.asarray(answers.isna())
    assert told.mean() > 0.97 and (np.asarray(answers[told], bool) == truth[told]).mean() > 0.985
    assert made["holdout_accuracy"] > 0.98 and made["holdout_calibration_error"] < 0.02


def test_the_angle_is_within_two_percent_in_the_median(known):
    assert shipped_for("full", task="angle") == "gravity-angle"
    model, card = load_model("gravity-angle")
    some = known[known["foldable"].astype(bool)].sample(300, random_state=0)
    off = np.abs(model.predict(some[FULL.names]) / some["fold_angle"].astype(float) - 1)
    assert np.median(off) < 0.02 and card["metadata"]["holdout_folding_median"] < 0.02
