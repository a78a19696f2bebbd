"""Verdict and orders of the study of rates, on made-up shapes and on the smallest furrow."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments import viscous_rates
from experiments.viscous_rates import TINY, Config, measured, plot, slope, tissues, verdict


def shapes(grown, rested, slow=-0.2, fast=-0.25):
    rows = [("slow", None, slow), ("fast", None, fast)]
    rows += [("grown", r, v) for r, v in zip((0.1, 1.0, 10.0), grown, strict=True)]
    rows += [("rested", r, v) for r, v in zip((0.1, 1.0, 10.0), rested, strict=True)]
    table = pd.DataFrame(rows, columns=["when", "ratio", "indentation"])
    return table.assign(tissue="soft tissue")


def test_spreads_and_errors_are_fractions_of_the_slow_limits_indentation():
    said = verdict(shapes((-0.24, -0.22, -0.21), (-0.2, -0.202, -0.201)))
    key = "soft_tissue"
    assert said[f"limits_differ_{key}"] == pytest.approx(0.25)
    assert said[f"grown_spread_{key}"] == pytest.approx(0.15)
    assert said[f"rested_spread_{key}"] == pytest.approx(0.01)
    # The fastest contraction beside the fast limit, the slowest beside the slow one.
    assert said[f"fast_limit_error_{key}"] == pytest.approx(0.05)
    assert said[f"slow_limit_error_{key}"] == pytest.approx(0.05)
    sentence = said[f"verdict_{key}"]
    assert sentence.startswith("soft tissue: the ratio decides the shape at the end")
    assert "indentations differ by 15.0%, the elastic limits by 25.0%" in sentence
    assert sentence.endswith("after a rest they differ by 1.0%")


def test_less_than_a_twentieth_decides_nothing():
    said = verdict(shapes((-0.2, -0.201, -0.2095), (-0.2,) * 3))
    assert "does not decide the shape" in said["verdict_soft_tissue"]
    said = verdict(shapes((-0.2, -0.201, -0.2105), (-0.2,) * 3))
    assert "ratio decides the shape" in said["verdict_soft_tissue"]


def test_the_order_is_that_of_the_last_halving():
    part = pd.DataFrame({"n": [10, 20, 40], "error": [0.9, 0.04, 0.01]})
    assert slope(part) == pytest.approx(2.0)


def test_a_row_has_the_measures_of_the_fully_contracted_state():
    seen = []
    scene = SimpleNamespace(displacement=lambda x, e: seen.append((x, e)) or "u")
    model = SimpleNamespace(
        measure=lambda u: SimpleNamespace(depth=1.0, indentation=2.0, cavity=3.0)
    )
    path = SimpleNamespace(points=[0] * 4, outcome=SimpleNamespace(value="done"))
    row = measured(model, scene, "x", "soft", "slow", np.nan, path)
    assert row == {
        "tissue": "soft", "when": "slow", "ratio": None, "depth": 1.0, "indentation": 2.0,
        "cavity": 3.0, "steps": 3, "outcome": "done",
    }  # fmt: skip
    path = SimpleNamespace(states=[0] * 6, outcome=SimpleNamespace(value="done"))
    row = measured(model, scene, "x", "soft", "grown", 0.3, path)
    assert (row["steps"], row["ratio"], seen) == (5, 0.3, [("x", 1.0)] * 2)


def test_only_the_passive_part_of_the_second_tissue_has_a_branch_of_the_same_time():
    same, passive = tissues(TINY).values()
    beta = viscous_rates.built(TINY, TINY.mesh).beta
    E_m = np.broadcast_to(passive.E_m, beta.shape)
    # E_s is 5: four times that where nothing contracts, a thousandth where all does.
    assert E_m[beta == beta.max()] == pytest.approx(0.02)
    assert E_m[beta < 1e-3 * beta.max()] == pytest.approx(20.0, rel=2e-3)
    assert passive.tau == pytest.approx(same.tau) == pytest.approx(0.2)


def test_errors_over_the_steps_have_the_orders_of_the_schemes():
    orders = pd.DataFrame(
        viscous_rates.order_study(Config(mesh="hex8:0", contraction=0.1, divisions=(4, 8, 16)))
    )
    assert orders["order"].tolist() == [1] * 3 + [2] * 3
    assert orders["n"].tolist() == [4, 8, 16] * 2
    assert slope(orders[orders["order"] == 1]) == pytest.approx(1.0, abs=0.15)
    assert slope(orders[orders["order"] == 2]) == pytest.approx(2.0, abs=0.25)
    assert orders["error"].max() < 0.2


def test_local_and_global_unknowns_make_the_same_step():
    row = viscous_rates.cost(TINY, "hex8:0")
    model = viscous_rates.built(TINY, "hex8:0")
    assert row["difference"] < 1e-7
    # Six components at each quadrature point.
    assert row["global_unknowns"] - row["local_unknowns"] == 6 * model.body.weights.size
    assert 1 <= row["local_iterations"] < 10 and 1 <= row["global_iterations"] < 15
    assert row["mesh"] == "hex8:0" and 0 < row["local_solve_seconds"] < row["local_seconds"]
    assert 0 < row["global_solve_seconds"] < row["global_seconds"]


def test_the_picture_has_a_curve_for_each_tissue_and_its_limits():
    table = pd.concat([shapes((-0.24, -0.22, -0.21), (-0.2, -0.21, -0.22))] * 2)
    orders = pd.DataFrame(
        {"order": [1, 1, 2, 2], "n": [10, 20] * 2, "error": [0.2, 0.1, 0.04, 0.01]}
    )
    left, right = plot(Config(divisions=(10, 20)), table, orders).axes
    grown, rested, slow, fast = left.lines
    assert grown.get_ydata()[:3] == pytest.approx([-0.24, -0.22, -0.21])
    assert rested.get_ydata()[:3] == pytest.approx([-0.2, -0.21, -0.22])
    assert (slow.get_ydata()[0], fast.get_ydata()[0]) == (-0.2, -0.25)
    assert [line.get_label() for line in right.lines] == [
        "order 1: slope 1.00", "order 2: slope 2.00",
    ]  # fmt: skip
