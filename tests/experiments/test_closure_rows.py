"""Rows of the experiment on the order of closure."""

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from experiments import closure
from experiments.closure import TINY, follow
from foldlab.errors import InputError

SHORT = replace(TINY, finer=())


def test_a_row_is_of_the_sections_that_close(tracker):
    row, sections = follow(SHORT, "wide posterior", "hex20:0:12", 1.0)
    closed = {s["x"]: s["contraction"] for s in sections if s["contraction"] is not None}
    assert [s["x"] for s in sections] == approx(np.linspace(0, 4, 9), abs=1e-8)
    first = min(closed, key=closed.get)
    assert row["first_at"] == approx(first / 4) and first > 2
    assert row["first_contraction"] == closed[first] < row["last_contraction"]
    assert (row["from"], row["to"]) == (min(closed), max(closed))
    assert 0.1 < row["first_contraction"] < row["last_contraction"] <= 0.35
    assert row["closed"] == row["closed_most"] > 0 and row["fuses"] and row["steps"] == 12


def test_what_is_unloaded_tells_of_the_way_there_alone(tracker):
    there, _ = follow(SHORT, "wide posterior", "hex20:0:12", None)
    back, _ = follow(SHORT, "wide posterior", "hex20:0:12", None, back=True)
    assert back["steps"] == 24 and back["closed"] == 0 < back["closed_most"]
    for name in ("first_at", "first_contraction", "last_contraction", "from", "to"):
        assert back[name] == there[name]


def test_the_figure_has_a_curve_for_folds_that_touch_and_that_fuse(tracker):
    result = closure.run(SHORT, tracker)
    assert [row["fuses"] for row in result["table"]] == [False, True]
    assert set(tracker.tables) == {"closure", "finer", "unloaded", "sections"}
    (ax,) = tracker.figures["closure"].axes
    drawn = {line.get_label(): line.get_xydata() for line in ax.lines}
    assert set(drawn) == {"folds touch", "folds fuse"}
    mine = [s for s in result["sections"] if s["fuses"] and s["contraction"] is not None]
    data = drawn["folds fuse"]
    assert data[~np.isnan(data[:, 1])] == approx(
        np.array([[s["x"], s["contraction"]] for s in mine])
    )
    assert result["finer"][0]["first_at"] == result["table"][1]["first_at"]


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"geometries": ("cone",)}, "no geometry 'cone'; there are: uniform, wide posterior"),
        ({"checked": "cone"}, "no geometry 'cone'"),
        ({"steps": 2}, "expected at least 4 steps"),
        ({"sealing": 0.0}, "a modulus > 0"),
        ({"mesh": "hex20"}, "expected element:level:steps"),
        ({"mesh": "hex20:9"}, "level 9; there are 0 to 3"),
        ({"finer": ("hex20:0:2",)}, "expected element:level:steps"),
    ],
)
def test_wrong_settings_are_refused(wrong, says, tracker):
    with pytest.raises(InputError, match=says):
        closure.run(replace(SHORT, **wrong), tracker)
