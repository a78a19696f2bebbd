"""The search's journal: what a later call takes up, and what it refuses."""

import pytest

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.learning.network import NetworkClassifier
from foldlab.learning.tune import Search, open_study, trials_table, tune


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
