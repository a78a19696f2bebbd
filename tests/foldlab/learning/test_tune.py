"""The search's journal: what a later call takes up, and what it refuses."""

import numpy as np
import pytest
from optuna.trial import TrialState

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.learning import tune as tuning
from foldlab.learning.network import NetworkClassifier
from foldlab.learning.tune import (
    Search,
    can_not_reach_the_front,
    open_study,
    trials_table,
    tune,
)


def with_trials(journal, count):
    study = open_study(journal, 0)
    for _ in range(count):
        trial = study.ask()
        trial.suggest_int("width", 1, 9)
        study.tell(trial, [0.5, 1.0])
    return journal.read_bytes()


@pytest.mark.parametrize("cut", [1, 20, 50])
def test_a_journal_whose_last_line_was_cut_goes_on(cut, tmp_path):
    journal = tmp_path / "j.log"
    whole = with_trials(journal, 2)
    journal.write_bytes(whole[:-cut])
    # The trial whose end was cut off never ended.
    assert len(trials_table(open_study(journal, 0))) == 1
    with_trials(journal, 1)
    assert len(trials_table(open_study(journal, 0))) == 2


def test_a_journal_cut_in_its_first_line_starts_afresh(tmp_path):
    journal = tmp_path / "j.log"
    journal.write_bytes(with_trials(journal, 0)[:30])
    assert len(trials_table(open_study(journal, 0))) == 0


@pytest.mark.parametrize("text", ["my notes", "[1]\n", '{"a": 1}\n', '{"op_code":77}\n', "\x00\n"])
def test_another_file_is_refused_and_left_alone(text, tmp_path):
    journal = tmp_path / "j.log"
    journal.write_text(text)
    with pytest.raises(InputError, match="is no journal of a study"):
        open_study(journal, 0)
    assert journal.read_text() == text


def test_networks_of_the_full_space_are_tuned_on_the_physics_that_they_will_see(
    tmp_path, monkeypatch
):
    tuned = []

    def fit(network, X, y):
        tuned.append(network.inputs)
        return real(network, X, y)

    real = NetworkClassifier.fit
    monkeypatch.setattr(NetworkClassifier, "fit", fit)
    labels = load_dataset("gravity-5k", growth="uniaxial").head(100)
    search = Search(trials=1, epochs=(4, 4), width=(4, 4), depth=(1, 1), members=(1, 1))
    tune(labels, FULL, tmp_path / "j.log", search)
    assert tuned == ["physics"]


@pytest.mark.parametrize(
    ("accuracy", "seconds", "pruned"),
    [(0.79, 3.1, True), (0.8, 3.1, False), (0.79, 3.0, False), (0.9, 9.0, False)],
)
def test_a_trial_stops_where_it_is_slower_and_worse_than_the_median(accuracy, seconds, pruned):
    before = [
        {"early_accuracy": a, "early_seconds": s}
        for a, s in ((0.1, 1.0), (0.8, 3.0), (0.9, 99.0))
    ]  # fmt: skip
    # One that ended before its first quarter says nothing.
    assert can_not_reach_the_front(accuracy, seconds, [{}, *before], 3) == pruned
    assert not can_not_reach_the_front(accuracy, seconds, [{}, *before], 4)


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"trials": 0}, "trials = 0; expected at least 1"),
        ({"workers": 0}, "workers = 0"),
        ({"warm_up": 0}, "warm_up = 0"),
        ({"validation": 1.0}, "validation = 1; expected a fraction"),
        ({"validation": 0.0}, "validation = 0; expected a fraction"),
        ({"width": (0, 4)}, "width = 0 … 4; expected 0 < low ≤ high"),
        ({"width": (5, 4)}, "width = 5 … 4"),
        ({"penalty": (1e-3, float("inf"))}, "penalty = 0.001 … inf"),
    ],
)
def test_a_search_has_its_bounds(bad, says):
    with pytest.raises(InputError, match=says):
        Search(**bad)
    one = Search(trials=1, workers=1, warm_up=1, width=(4, 4), validation=0.01)
    assert one.width == (4, 4)


def test_a_table_of_trials_has_what_was_measured_of_those_that_ended(tmp_path):
    study = open_study(tmp_path / "j.log", 0)
    for values in ([0.9, 2.0], [0.8, 1.0], [0.8, 3.0], None):
        trial = study.ask()
        trial.suggest_int("width", 7, 7)
        trial.set_user_attr("false_positive_rate", 0.25)
        if values is None:
            study.tell(trial, state=TrialState.PRUNED)
        else:
            study.tell(trial, values)
    study.ask()  # still at work
    table = trials_table(study)
    assert table["trial"].tolist() == [0, 1, 2, 3] and set(table["width"]) == {7}
    assert table["state"].tolist() == ["complete"] * 3 + ["pruned"]
    assert table["accuracy"].tolist()[:3] == [0.9, 0.8, 0.8] and table["accuracy"].isna()[3]
    assert table["seconds"].tolist()[:3] == [2.0, 1.0, 3.0] and table["seconds"].isna()[3]
    # Neither slower nor less accurate than another.
    assert table["on_front"].tolist() == [True, True, False, False]
    assert (table["false_positive_rate"] == 0.25).all()


def test_a_trial_trains_what_it_suggests_in_a_quarter_and_the_rest(tmp_path, monkeypatch):
    made, fitted = {}, []

    class Network:
        def fit(self, X, y):
            fitted.append(("first", len(X)))

        def continue_fit(self, X, y, *, epochs):
            fitted.append(("then", epochs))

        def predict(self, X):
            return np.ones(len(X), bool)

        def predict_proba(self, X):
            return np.tile([0.0, 1.0], (len(X), 1))

    def make(name, space, **options):
        made.update(options)
        return Network()

    monkeypatch.setattr(tuning, "make_classifier", make)
    labels = FULL.sample(40, seed=0).assign(foldable=[True, False, False, False] * 10)
    search = Search(
        trials=1, seed=4, epochs=(42, 42), width=(5, 5), depth=(3, 3), members=(2, 2),
        penalty=(1e-4, 1e-4), false_positive_weight=(2.0, 2.0), validation=0.2,
    )  # fmt: skip
    table = tune(labels, FULL, tmp_path / "j.log", search)
    assert made == {
        "hidden": (5, 5, 5), "members": 2, "penalty": 1e-4, "epochs": 10, "seed": 4,
        "false_positive_weight": 2.0,
    }  # fmt: skip
    assert fitted == [("first", 32), ("then", 32)]
    # Eight designs were held back, as often folding as all: two.
    assert table["accuracy"].tolist() == [0.25] and table["false_positive_rate"].tolist() == [1.0]
    assert table["seconds"][0] >= 0 and table["on_front"].tolist() == [True]
    few = labels.assign(foldable=[True] * 3 + [False] * 37)
    with pytest.raises(InputError, match="3 designs fold and 37 do not; a study needs at least 4"):
        tune(few, FULL, tmp_path / "k.log", search)
    tune(labels.assign(foldable=[True] * 4 + [False] * 36), FULL, tmp_path / "k.log", search)
    with pytest.raises(InputError, match=r"no folder .* for the journal; make it first"):
        tune(labels, FULL, tmp_path / "none" / "j.log", search)
