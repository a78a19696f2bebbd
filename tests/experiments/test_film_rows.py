"""Rows of the experiment on a film that floats."""

from dataclasses import replace

import pytest
from pytest import approx

from experiments import film
from experiments.film import TINY
from foldlab.errors import InputError


def test_rows_and_curves_are_of_each_liquid_stiffness_and_mesh(tracker):
    config = replace(TINY, stiffnesses=(75.0, 5.0), cells=(1, 2))
    rows = film.run(config, tracker)["table"]
    assert [(r["weight"], r["stiffness"], r["cells"]) for r in rows] == [
        (1e-3, 75.0, 1), (1.0, 75.0, 1), (1e-3, 5.0, 1), (1e-3, 75.0, 2),
    ]  # fmt: skip
    light, heavy, soft, fine = rows
    assert all(r["reached"] and r["unstable"] == 0 for r in rows)
    assert all(r["contraction"] == approx(-0.1) for r in rows)
    assert heavy["aspect"] < light["aspect"] and soft["spacing"] > light["spacing"]
    assert fine["aspect"] == approx(light["aspect"], rel=0.1)
    assert light["aspect"] == approx(light["depth"] / light["spacing"])
    for ax, key, others in zip(
        tracker.figures["film"].axes, ("weight", "stiffness"), ((1e-3, 1.0), (5.0, 75.0)),
        strict=True,
    ):  # fmt: skip
        drawn = [line.get_ydata()[-1] for line in ax.lines]
        mine = {r[key]: r["aspect"] for r in reversed(rows) if r["cells"] == 1}
        mine = mine | {light[key]: light["aspect"]}
        assert drawn == approx([mine[value] for value in others])


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"weights": ()}, "expected at least one of each"),
        ({"width": 1.5}, "would fill their cells"),
        ({"cells": (0,)}, "cells = 0"),
        ({"contraction": -2.0}, "expected more than -1"),
    ],
)
def test_wrong_settings_are_refused(wrong, says, tracker):
    with pytest.raises(InputError, match=says):
        film.run(replace(TINY, **wrong), tracker)
