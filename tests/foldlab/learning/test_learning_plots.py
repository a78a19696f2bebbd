"""Figures of learning: what their lines, bands and marks show."""

import numpy as np
import pandas as pd
import pytest

from foldlab.errors import InputError
from foldlab.learning.compare import readable
from foldlab.learning.plots import (
    pareto_mask,
    plot_learning_curves,
    plot_pareto,
    plot_reliability,
    plot_study,
    plot_trade_off,
)


def test_errors_of_learning_are_drawn_as_median_and_ends():
    curves = pd.DataFrame({
        "strategy": ["a"] * 6 + ["b"], "seed": [0, 0, 1, 1, 2, 2, 0],
        "labels": [20, 10, 20, 10, 20, 10, 10],
        "accuracy": [0.9, 0.6, 0.95, 0.7, 0.99, 0.9, 0.5],
    })  # fmt: skip
    (ax,) = plot_learning_curves(curves, target=0.98, as_error=True, title="so").axes
    a, b, level = ax.lines
    assert a.get_xydata() == pytest.approx(np.array([[10, 0.3], [20, 0.05]]))
    assert a.get_label() == "a (3 seeds)" and b.get_label() == "b (1 seed)"
    assert level.get_ydata() == pytest.approx([0.02, 0.02])
    band = ax.collections[0].get_paths()[0].vertices
    at_10 = band[band[:, 0] == 10][:, 1]
    assert (at_10.min(), at_10.max()) == (pytest.approx(0.1), pytest.approx(0.4))
    assert ax.get_yscale() == "log" and ax.get_ylabel() == "1 − accuracy"
    assert ax.texts[0].get_text() == "0.98" and ax.get_title() == "so"
    (plain,) = plot_learning_curves(curves, target=0.98).axes
    assert plain.lines[0].get_ydata() == pytest.approx([0.7, 0.95])
    assert plain.lines[2].get_ydata() == pytest.approx([0.98, 0.98])
    assert plain.get_yscale() == "linear" and plain.get_ylabel() == "accuracy"


@pytest.mark.parametrize(
    ("maximise", "front"),
    [((False, True), [0, 1]), ((True, True), [1, 2]), ((False, False), [0]), ((True, False), [2])],
)
def test_a_front_is_of_what_is_wanted(maximise, front):
    x, y = [1.0, 2.0, 3.0, np.nan], [0.5, 0.9, 0.4, 1.0]
    if maximise == (False, False):
        y[2] = 0.6
    assert np.flatnonzero(pareto_mask(x, y, maximise=maximise)).tolist() == front


def test_equal_points_are_all_on_the_front_and_ties_are_beaten():
    assert pareto_mask([1, 1, 1, 2], [0.5, 0.5, 0.4, 0.5]).tolist() == [True, True, False, False]


def test_a_study_is_drawn_as_error_over_seconds():
    table = pd.DataFrame({"accuracy": [0.9, 0.8, 0.7], "seconds": [2.0, 1.0, 3.0]})
    (ax,) = plot_study(table).axes
    dominated, stair, front = ax.lines
    assert dominated.get_xydata() == pytest.approx(np.array([[3.0, 0.3]]))
    assert front.get_xydata() == pytest.approx(np.array([[1.0, 0.2], [2.0, 0.1]]))
    assert stair.get_drawstyle() == "steps-post" and ax.get_xscale() == "log"
    assert ax.get_xlabel() == "training, processor seconds" and ax.get_yscale() == "linear"
    (other,) = plot_pareto(table, "seconds", "accuracy", maximise=(True, True)).axes
    assert other.lines[1].get_drawstyle() == "steps-pre"
    with pytest.raises(InputError, match="no row has finite seconds and accuracy"):
        plot_pareto(table.assign(accuracy=np.nan), "seconds", "accuracy")


def test_a_trade_off_leaves_out_what_has_no_place_on_a_log_axis():
    curve = pd.DataFrame({
        "false_positive_rate": [0.0, 0.1, 0.2, 0.3], "recall": [0.5, 0.8, 0.9, 1.0],
        "false_positive_rate_low": [0.0, 0.05, 0.15, 0.2],
        "false_positive_rate_high": [0.1, 0.2, 0.3, 0.4],
    })  # fmt: skip
    weights = pd.DataFrame(
        {"false_positive_rate": [0.1, 0.05], "recall": [0.9, 0.7], "weight": [1.0, 10.0]}
    )
    point = {"false_positive_rate": 0.02, "recall": 0.6}
    (ax,) = plot_trade_off(curve, weights, point=point, rate=0.015).axes
    line, biased, rate, chosen = ax.lines
    assert line.get_xydata() == pytest.approx(np.array([[0.1, 0.2], [0.2, 0.1]]))
    assert biased.get_xydata() == pytest.approx(np.array([[0.1, 0.1], [0.05, 0.3]]))
    assert rate.get_xdata() == [0.015, 0.015] and rate.get_label() == "stated rate 1.5%"
    assert chosen.get_xydata() == pytest.approx(np.array([[0.02, 0.4]]))
    assert [text.get_text() for text in ax.texts] == ["1", "10"]
    band = ax.collections[0].get_paths()[0].vertices
    assert (band[:, 0].min(), band[:, 0].max()) == (pytest.approx(0.05), pytest.approx(0.3))
    assert ax.get_xscale() == ax.get_yscale() == "log"


def test_reliability_is_drawn_with_its_intervals():
    table = pd.DataFrame(
        {"probability": [0.2, 0.8], "fraction": [0.3, 0.7], "low": [0.1, 0.6], "high": [0.6, 0.9]}
    )
    (ax,) = plot_reliability({"tree": table}).axes
    assert ax.lines[0].get_xydata().tolist() == [[0, 0], [1, 1]]
    (bar,) = ax.containers
    low, high = np.array(bar.lines[2][0].get_segments())[:, :, 1].T
    assert low == pytest.approx([0.1, 0.6]) and high == pytest.approx([0.6, 0.9])


def test_a_row_of_a_comparison_is_readable():
    row = {
        "model": "tree", "accuracy": 0.9625, "accuracy_low": 0.9494, "accuracy_high": 0.9731,
        "accuracy_fresh": 0.96111, "false_positive_rate": 0.02222, "train_seconds": 1.26,
        "seconds_per_million": 0.456, "labels": 6000, "size": 87, "size_unit": "nodes",
        "dissertation": None,
    }  # fmt: skip
    assert readable([row]) == [
        {
            "model": "tree", "1000 test": "0.963", "95 % interval": "0.949–0.973",
            "fresh": "0.9611", "false pos.": "0.0222", "train s": "1.3", "s / 10⁶": "0.46",
            "labels": "6000", "size": "87 nodes", "dissertation": "–",
        }
    ]  # fmt: skip
