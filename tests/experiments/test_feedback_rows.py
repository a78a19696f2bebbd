"""Rows of the experiment on growth that answers to stress."""

import numpy as np
import pandas as pd
import pytest
from pytest import approx

from experiments import feedback
from experiments.feedback import BARS, RINGS, TINY, bar, order_study, ring, slope, stability
from solver.cases.tissue.feedback import Radial


def test_a_bar_is_told_beside_its_equation_and_what_it_seeks():
    row, curve = bar(TINY, "of the volume")
    case = BARS["of the volume"]
    assert row["sought"] == case.rest == approx(0.03 - 0.05 / 2)
    assert curve["t"].iloc[-1] == TINY.until and row["steps"] == len(curve) - 1
    exact = case.exact(curve["t"].to_numpy())
    assert row["off"] == approx(np.abs(curve["gamma"] - exact).max() / exact.max())
    assert 0 < row["off"] < 0.01 and row["gap"] < 0.01
    assert row["from_target"] == approx(row["at_last"] / row["sought"] - 1)
    assert row["at_first"] > row["at_last"] > row["sought"]


def test_a_ring_is_told_beside_its_radial_solution():
    radial = Radial(RINGS["free"])
    wanted = radial.growth(TINY.ring_until)
    row, profile = ring(TINY, "free", 2, radial, wanted)
    assert 0 < row["growth_off"] < 0.02 and 0 < row["stress_off"] < 0.05
    assert row["inside"] < 0 < row["outside"] and row["cells"] == 2
    assert profile["R"].is_monotonic_increasing and len(profile) == 54
    largest = np.abs(radial.cauchy(TINY.ring_until, wanted)).max()
    assert np.abs(profile["hoop"] - profile["exact"]).max() <= row["stress_off"] * largest
    # Another wanted growth is farther off.
    assert ring(TINY, "free", 2, radial, 1.5 * wanted)[0]["growth_off"] > 0.2


def test_orders_are_of_the_two_smallest_steps():
    rows = [{"steps": n, "off": 7.0 / n**3} for n in (40, 10, 20)]
    rows[1]["off"] = 1.0
    assert slope(rows) == approx(3.0)
    study = order_study(TINY)
    assert [(row["order"], row["steps"]) for row in study] == [(1, 40), (1, 80), (2, 40), (2, 80)]
    for order in (1, 2):
        assert slope([r for r in study if r["order"] == order]) == approx(order, abs=0.1)


def test_what_holds_a_body_decides_and_a_reversed_rate_turns_it():
    rows = {row["state"]: row for row in stability(TINY)}
    verdicts = {name: row["verdict"] for name, row in rows.items()}
    assert verdicts == {
        "bar, clamped": "stable",
        "bar, clamped, rate reversed": "unstable",
        "ring, hoops, on a mandrel": "stable",
        "ring, hoops, pressure": "unstable",
        "ring, hoops, pressure, rate reversed": "unstable",
    }
    for row in rows.values():
        assert row["rate"] == approx(row["exact"], rel=1e-4) and abs(row["exact"]) > 0.1
    assert rows["ring, hoops, pressure, rate reversed"]["rate"] < 0


def test_the_worst_of_each_is_told(tracker, monkeypatch):
    def one_bar(config, name):
        n = list(BARS).index(name) + 1
        curve = {"growth": name, "t": [0.0, 1.0], "stress": 1.0, "sought": 1.0}
        return {"growth": name, "off": n / 100, "gap": (9 - n) / 1000}, pd.DataFrame(curve)

    def one_ring(config, name, cells, radial, wanted):
        n = cells + list(RINGS).index(name)
        profile = {"ring": name, "cells": cells, "R": [1.0], "exact": 0.1, "hoop": 0.1}
        return {"ring": name, "cells": cells, "growth_off": 1 / n, "stress_off": 2 / n}, (
            pd.DataFrame(profile)
        )

    orders = [{"order": k, "steps": n, "off": n**-k} for k in (1.0, 2.0) for n in (2, 4)]
    rests = [{"state": "a", "rate": -1.0, "exact": -2.0}, {"state": "b", "rate": 1.1, "exact": 1.0}]
    for name, value in (("bar", one_bar), ("ring", one_ring)):
        monkeypatch.setattr(feedback, name, value)
    monkeypatch.setattr(feedback, "order_study", lambda config: orders)
    monkeypatch.setattr(feedback, "stability", lambda config: rests)
    monkeypatch.setattr(Radial, "growth", lambda self, until: until)
    result = feedback.run(feedback.Config(cells=(4, 2)), tracker)
    assert result["worst_bar"] == len(BARS) / 100 and result["worst_gap"] == 0.008
    # Of rings the finest alone count, the worse of the two.
    assert (result["worst_ring_growth"], result["worst_ring_stress"]) == (1 / 4, 2 / 4)
    assert result["worst_rate"] == approx(0.5)
    assert (result["order_1"], result["order_2"]) == (approx(1.0), approx(2.0))
    assert set(tracker.tables) == {"bars", "rings", "orders", "rests", "curves", "profiles"}
    assert len(tracker.tables["rings"]) == 4 and "feedback" in tracker.figures


def test_a_state_that_is_not_reached_is_said(monkeypatch):
    class Path:
        reached, reason = False, "it would not"

    monkeypatch.setattr(feedback, "evolve", lambda *_, **__: Path())
    with pytest.raises(ArithmeticError, match="was not reached: it would not"):
        feedback.settled(BARS["compressed"].scene(0.1))
