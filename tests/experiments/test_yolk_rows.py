"""Rows of the experiment on furrows over a yolk."""

from dataclasses import replace

import pytest
from pytest import approx

from experiments import yolk
from experiments.yolk import TINY
from foldlab.errors import InputError


def test_rows_and_curves_are_of_each_bulk_modulus(tracker):
    config = replace(TINY, bulks=(0.0, 1.0), checked=1.0, finer=("hex20:0",))
    result = yolk.run(config, tracker)
    empty, full = result["table"]
    (again,) = result["finer"]
    assert empty["pressure"] == 0 < full["pressure"]
    assert empty["cavity"] < full["cavity"] < 1
    assert full["pressure"] == approx(1.0 * (1 - full["cavity"]), rel=1e-6)
    assert full["indentation"] < empty["indentation"]
    for name in ("depth", "indentation", "cavity", "pressure", "unknowns"):
        assert again[name] == full[name]
    curves = tracker.tables["curves"]
    part = curves[(curves["bulk"] == 1.0)].head(51)
    assert part["contraction"].iloc[[0, -1]].tolist() == approx([0, 0.1])
    assert part["cavity"].iloc[0] == approx(1) and part["pressure"].is_monotonic_increasing
    for ax, name in zip(tracker.figures["yolk"].axes, ("depth", "cavity", "pressure"), strict=True):
        lines = {line.get_label(): line.get_ydata() for line in ax.lines}
        assert lines["$K/E = 1$"][-1] == full[name] and lines["empty"][-1] == empty[name]


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"bulks": ()}, "expected moduli of at least 0"),
        ({"bulks": (-1.0,)}, "expected moduli of at least 0"),
        ({"steps": 0}, "and a step"),
        ({"mesh": "hex20"}, "expected element:level"),
        ({"finer": ("hex20:7",)}, "level 7; there are 0 to 3"),
    ],
)
def test_wrong_settings_are_refused(wrong, says, tracker):
    with pytest.raises(InputError, match=says):
        yolk.run(replace(TINY, **wrong), tracker)
