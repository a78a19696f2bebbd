"""Don't know as an answer: borders by count, coverage on fresh draws, and in training."""

import numpy as np
import pandas as pd
import pytest

from foldlab.datasets import load_dataset
from foldlab.errors import InputError
from foldlab.learning import train
from foldlab.learning.conformal import Borders, borders_of, labels_needed, measured
from foldlab.learning.scoring import upper_bound
from foldlab.learning.train import train_on


class Told:
    """The first column is the probability."""

    classes_ = np.array([False, True])

    def predict_proba(self, X):
        p = X["p"].to_numpy()
        return np.column_stack([1 - p, p])


def test_borders_are_order_statistics_of_each_class():
    stays, folds = np.arange(1, 100) / 200, 1 - np.arange(1, 10) / 20
    p, y = np.concatenate([stays, folds]), np.repeat([False, True], [99, 9])
    borders = borders_of(p, y, coverage=0.9)
    # ⌈100 · 0.9⌉ = 90th of 99 from below, ⌈10 · 0.9⌉ = 9th of 9 from above.
    assert (borders.not_up_to, borders.folds_from) == (90 / 200, folds[8])
    assert borders.labels == 108 and borders.coverage == 0.9


def test_answers_are_silent_where_both_or_none_is_plausible():
    both = Borders(not_up_to=0.6, folds_from=0.4, coverage=0.9, labels=1)
    assert both.answers([0.39, 0.4, 0.6, 0.61]).tolist() == [False, pd.NA, pd.NA, True]
    none = Borders(not_up_to=0.4, folds_from=0.6, coverage=0.9, labels=1)
    assert none.answers([0.4, 0.41, 0.59, 0.6]).tolist() == [False, pd.NA, pd.NA, True]


def test_fresh_designs_are_told_the_other_class_as_rarely_as_stated():
    # Mean over many calibrations, each of few labels: the statement is about that mean.
    rng = np.random.default_rng(0)
    wrong = {True: [], False: []}
    for _ in range(400):
        y = rng.random(240) < 0.4
        p = 1 / (1 + np.exp(-rng.normal(2 * y - 1, 1)))
        borders = borders_of(p[:120], y[:120], coverage=0.9)
        answers = borders.answers(p[120:])
        for kind in wrong:
            of = y[120:] == kind
            wrong[kind].append(np.mean(answers[of].fillna(kind).to_numpy(bool) != kind))
    for kind, rates in wrong.items():
        assert 0.05 < np.mean(rates) < 0.1 + 3 * np.std(rates) / 20, kind


def test_what_was_measured_counts_by_class():
    borders = Borders(not_up_to=0.3, folds_from=0.7, coverage=0.9, labels=1)
    X = pd.DataFrame({"p": [0.1, 0.2, 0.5, 0.9, 0.1, 0.8, 0.9, 0.2, 0.5]})
    y = [False, False, False, False, False, True, True, True, True]
    result = measured(Told(), borders, X, y)
    assert result["n"] == 9 and result["wrong"] == 2
    assert (result["decided"], result["covered"]) == (7 / 9, 7 / 9)
    assert (result["covered_folding"], result["covered_not_folding"]) == (3 / 4, 4 / 5)
    assert result["wrong_upper"] == upper_bound(2, 9)


@pytest.mark.parametrize("coverage, needed", [(0.9, 9), (0.99, 99), (0.5, 1)])
def test_just_enough_labels_of_a_class_are_enough(coverage, needed):
    assert labels_needed(coverage) == needed
    y = np.repeat([False, True], needed)
    borders_of(np.linspace(0, 1, len(y)), y, coverage=coverage)
    if needed > 1:
        with pytest.raises(InputError, match=f"needs at least {needed} of each"):
            borders_of(np.linspace(0, 1, len(y) - 1), y[1:], coverage=coverage)


@pytest.mark.parametrize("coverage", [0, 1, -0.1, 1.5])
def test_what_is_no_coverage_is_refused(coverage):
    with pytest.raises(InputError, match="expected between 0 and 1"):
        labels_needed(coverage)


def test_training_states_a_coverage_and_measures_it_on_labels_that_nobody_saw(monkeypatch):
    table = load_dataset("gravity-5k")
    table = table[(table["growth"] == "uniaxial") & table["foldable"].notna()]
    _, card = train_on(table, "tree", seed=0, holdout=0.4, coverage=0.98, rate=0.01)
    assert card["calibration_labels"] + card["holdout_n"] + card["labels"] == len(table)
    borders = Borders(**card["borders"])
    assert borders.labels == card["calibration_labels"]
    assert 0.9 < card["holdout_decided"] <= 1
    assert card["holdout_covered"] > 0.97
    assert card["holdout_false_positive_rate"] < 0.02 < card["holdout_recall"]
    monkeypatch.setattr(train, "fit", None)  # what is too little is told before any training
    with pytest.raises(InputError, match="needs at least 999 of each"):
        train_on(table, "tree", seed=0, coverage=0.999)


@pytest.mark.parametrize(("folding", "total"), [(3, 90), (1, 270), (0, 270)])
def test_too_few_labels_of_a_class_say_how_many_it_takes_in_all(folding, total):
    # Nine of each class for a coverage of 0.9; a class that none is of counts as one.
    with pytest.raises(InputError, match=rf"at least 9 of each \(here about {total} labels"):
        borders_of(np.linspace(0, 1, 30), np.arange(30) < folding, coverage=0.9)
