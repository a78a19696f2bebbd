"""Rows of the experiment on lungs longer than wide."""

from dataclasses import replace

import pytest

from experiments import lung_shape
from experiments.lung_shape import TINY
from foldlab.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:.*elements are curved in a thin body")


def test_rows_are_of_each_length_and_cells_of_each_state(tracker):
    config = replace(TINY, pressure=0.12, steps=4)
    answer = lung_shape.run(config, tracker)
    ball, long = answer["table"]
    assert ball["low_equator"] == pytest.approx(ball["low_end"], rel=1e-6)
    assert long["low_end"] < ball["low_end"] < long["low_equator"]
    assert ball["punctured_end"] > ball["low_end"]
    # A longer one carries less.
    assert not ball["reached"] and not long["reached"]
    assert 0.05 < long["limit"] < ball["limit"] < 0.12
    assert long["top_equator"] > long["low_equator"]
    cells = answer["cells"]
    assert {c["state"] for c in cells} == {"low", "punctured", "top"}
    for c in cells:
        assert c["aspect"] == pytest.approx(c["depth"] / c["spacing"])
    left, right = tracker.figures["lung_shape"].axes
    assert list(left.lines[0].get_ydata()) == [ball["limit"], long["limit"]]
    ends = [line.get_ydata()[-1] for line in right.lines]
    assert ends == pytest.approx([ball["low_end"], long["low_end"]])


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"lengths": ()}, "at least one length"),
        ({"low": 0.5}, "0 < low < pressure"),
        ({"lengths": (-1.0,)}, "expected length over width > 0"),
    ],
)
def test_wrong_settings_are_refused(wrong, says, tracker):
    with pytest.raises(InputError, match=says):
        lung_shape.run(replace(TINY, **wrong), tracker)
