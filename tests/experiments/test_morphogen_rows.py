"""Rows of the experiment on morphogens."""

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from experiments import morphogen
from experiments.morphogen import TINY, growth_study, order, series_study, space_study, time_study
from foldlab.errors import InputError
from solver.cases.tissue.morphogen import Gradient


def test_orders_in_space_and_time_are_those_of_the_two_finest():
    space = space_study(TINY)
    assert [(row["element"], row["cells"]) for row in space] == [
        ("hex8", 4), ("hex8", 8), ("hex27", 4), ("hex27", 8),
    ]  # fmt: skip
    assert order(space, "cells", "hex8") == approx(2, abs=0.3)
    assert order(space, "cells", "hex27") == approx(3, abs=0.3)
    assert [row["unknowns"] for row in space] == [20, 36, 81, 153]
    assert order(time_study(TINY), "steps") == approx(2, abs=0.15)
    rows = [{"n": n, "off": n**-4.0, "element": "a"} for n in (8, 2, 4)]
    rows += [{"n": 16, "off": 9.0, "element": "b"}]
    rows[1]["off"] = 9.0
    assert order(rows, "n", "a") == approx(4)


def test_profiles_are_compared_with_the_series():
    rows, curves = series_study(TINY)
    assert [row["t"] for row in rows] == [0.3, 1.0]
    assert all(0 < row["off"] < 5e-3 for row in rows)
    last = curves[curves["t"] == 1.0]
    np.testing.assert_allclose(last["exact"], Gradient().series(last["x"].to_numpy(), 1.0))
    np.testing.assert_allclose(last["c"], last["exact"], atol=5e-3)
    assert last["c"].iloc[0] == approx(1.0) and len(last) == 61


def test_growth_is_told_of_both_configurations():
    reference, deformed = growth_study(TINY)
    assert reference["configuration"] == "reference" and deformed["sweeps"] == 1
    for row in (reference, deformed):
        assert row["off"] == approx(abs(row["length"] - row["exact"]) / (row["exact"] - 3))
        assert row["off"] < 0.02 and row["length"] > 3.3
    assert deformed["length"] < reference["length"] - 0.05
    assert reference["last_change"] == 0 < deformed["last_change"]
    faster = growth_study(replace(TINY, rate=0.6))[0]
    assert faster["length"] > reference["length"] + 0.05


def test_the_worst_are_told(tracker, monkeypatch):
    space = [
        {"element": e, "cells": n, "off": n**-p} for e, p in (("hex8", 2.0), ("hex27", 3.0))
        for n in (4, 8)
    ]  # fmt: skip
    growth = [
        {"configuration": name, "length": 3.3, "exact": 3.4, "off": off}
        for name, off in (("reference", 0.2), ("deformed", 0.1))
    ]
    curves = series_study(replace(TINY, instants=(0.3,), per_instant=2))[1]
    for name, value in (
        ("space_study", space),
        ("time_study", [{"steps": n, "off": n**-2.0} for n in (2, 4)]),
        ("series_study", ([{"t": 1.0, "off": 0.3}, {"t": 2.0, "off": 0.2}], curves)),
        ("growth_study", growth),
    ):
        monkeypatch.setattr(morphogen, name, lambda config, value=value: value)
    result = morphogen.run(TINY, tracker)
    assert (result["order_hex8"], result["order_hex27"]) == (approx(2), approx(3))
    assert result["order_in_time"] == approx(2)
    assert (result["worst_transient"], result["worst_length"]) == (0.3, 0.2)
    assert set(tracker.tables) == {"space", "time", "transient", "growth", "curves"}
    assert "morphogen" in tracker.figures


def test_wrong_settings_are_refused(tracker):
    for wrong, says in (
        ({"elements": ("hex9",)}, "no element 'hex9'; there are: hex27"),
        ({"cells": (4,)}, "cells has fewer than two"),
        ({"steps": (4,)}, "steps has fewer than two"),
    ):
        with pytest.raises(InputError, match=says):
            morphogen.run(replace(TINY, **wrong), tracker)
