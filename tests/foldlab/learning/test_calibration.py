"""Calibration: how often designs fold that are given a probability, and the error of that."""

import numpy as np
import pytest

from foldlab.errors import InputError
from foldlab.learning.plots import plot_reliability
from foldlab.learning.scoring import calibration_error, clopper_pearson, reliability


def drawn(n=200_000, seed=0):
    """Probabilities, and labels that follow them."""
    rng = np.random.default_rng(seed)
    p = rng.random(n)
    return p, rng.random(n) < p


def test_bins_hold_what_fell_into_them():
    labels = [False, True, True, True, True, True]
    table = reliability([0.0, 0.05, 0.5, 0.55, 0.9, 1.0], labels, bins=10)
    assert table["n"].tolist() == [2, 2, 2]
    assert table["probability"].tolist() == pytest.approx([0.025, 0.525, 0.95])
    assert table["fraction"].tolist() == [0.5, 1, 1]
    assert tuple(table.loc[0, ["low", "high"]]) == clopper_pearson(1, 2)


def test_the_error_is_the_mean_distance_of_the_bins_by_their_size():
    # Two designs at 0.025 of which half fold, two at 0.525 that both fold, one right at 1.
    error = calibration_error([0.0, 0.05, 0.5, 0.55, 1.0], [False, True, True, True, True])
    assert error == pytest.approx((2 * 0.475 + 2 * 0.475 + 0) / 5)


def test_labels_that_follow_their_probabilities_leave_only_noise():
    p, y = drawn()
    assert calibration_error(p, y) < 0.005
    # A model twice as sure in its log-odds is off by the known integral.
    sure = p**2 / (p**2 + (1 - p) ** 2)
    assert calibration_error(sure, y) == pytest.approx(np.mean(np.abs(sure - p)), abs=0.005)


@pytest.mark.parametrize(
    "probability, y, message",
    [
        ([0.5], [True, False], "1 probabilities and 2 labels"),
        ([], [], "0 probabilities"),
        ([1.2], [True], "outside of 0 to 1"),
        ([np.nan], [True], "outside of 0 to 1"),
    ],
)
def test_what_is_no_probability_is_refused(probability, y, message):
    with pytest.raises(InputError, match=message):
        calibration_error(probability, y)


def test_the_diagram_draws_each_model_with_its_intervals():
    tables = {name: reliability(*drawn(500, seed)) for seed, name in enumerate(("one", "two"))}
    axes = plot_reliability(tables, title="drawn").axes[0]
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert words == ["calibrated", "one", "two"]
    line, (low, _), _ = axes.containers[0]
    np.testing.assert_array_equal(line.get_ydata(), tables["one"]["fraction"])
    drawn_low = np.asarray(low.get_ydata(), dtype=float)
    np.testing.assert_allclose(drawn_low, tables["one"]["low"])
    with pytest.raises(InputError, match="expected rows with"):
        plot_reliability({"empty": tables["one"].head(0)})
