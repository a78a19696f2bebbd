"""What rungs and their mixtures answer, and at what price."""

import numpy as np
import pytest

from experiments.gravity_ladder import _mixed, _row, _unless

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
