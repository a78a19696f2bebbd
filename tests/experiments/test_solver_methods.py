"""Where an iterative solve becomes cheaper than a direct one, and what is put into the table."""

import numpy as np
import pandas as pd
import pytest

from experiments import _solver_methods as methods
from experiments.solver_speed import _slope


def test_a_crossing_is_where_the_ratio_falls_below_one_for_good():
    n = np.array([1e3, 1e4, 1e5])
    assert methods.crossing(n, (n / 5000) ** -0.5) == pytest.approx(5000)
    assert methods.crossing(n, [0.5, 0.4, 0.9]) == pytest.approx(1000)
    assert methods.crossing(n, [0.5, 0.4, 1.1]) is None
    # Twice: the last one, between 1e5 and 1e6, halfway in logarithms.
    found = methods.crossing([1e3, 1e4, 1e5, 1e6], [2.0, 0.5, 2.0, 0.5])
    assert found == pytest.approx(10**5.5)


@pytest.mark.parametrize(
    ("shape", "element", "unknowns"),
    [("block", "hex27", 3000), ("slab", "hex27", 3000), ("block", "tet4", 5000)],
)
def test_a_scene_has_about_as_many_unknowns_as_asked_for(shape, element, unknowns):
    scene = methods.scene_of(shape, element, unknowns, "auto")
    assert 0.6 * unknowns < scene.size < 1.6 * unknowns
    assert np.abs(scene.system(np.zeros(scene.size), 1.0).residual).max() > 0


def test_a_solve_tells_what_it_cost_and_how_well_it_solved():
    none, direct, iterative = (
        methods.solve_cost("block", "hex27", 1500, method, 1) for method in methods.METHODS
    )
    assert none["unknowns"] == direct["unknowns"] == iterative["unknowns"] > 800
    assert "again_s" not in none and none["peak_mb"] > 50
    assert direct["residual"] < 1e-10 and direct["iterations"] is None
    assert direct["residual"] < iterative["residual"] < 1e-5 and 2 < iterative["iterations"] < 12
    assert min(iterative[k] for k in ("build_s", "first_s", "again_s")) > 0


def job(shape, element, unknowns, method, repeats):
    """Peaks of 100, 160 and 120 MB; building an iterative solver takes 3 s more."""
    return {
        "shape": shape, "element": element, "unknowns": unknowns, "cells": 8,
        "build_s": {"none": 1.0, "direct": 1.0, "iterative": 4.0}[method],
        "peak_mb": {"none": 100.0, "direct": 160.0, "iterative": 120.0}[method],
        "first_s": {"none": 0.0, "direct": 8.0, "iterative": 1.0}[method],
        "again_s": {"none": 0.0, "direct": 5.0, "iterative": 1.0}[method],
        "iterations": 7 if method == "iterative" else None, "residual": 1e-9,
    }  # fmt: skip


def test_a_row_is_what_stands_above_the_assembled_matrix():
    asked = []

    def alone(work, *args):
        asked.append((work, args))
        return job(*args)

    (row,) = methods.compare({"hex27": (500,)}, ("block",), 3, alone)
    assert asked == [
        (methods.solve_cost, ("block", "hex27", 500, method, 3)) for method in methods.METHODS
    ]
    assert (row["direct_s"], row["iterative_s"], row["ratio_s"]) == (8.0, 4.0, 0.5)
    assert (row["direct_mb"], row["iterative_mb"]) == (60.0, 20.0)
    assert row["ratio_mb"] == pytest.approx(1 / 3) and row["ratio_again_s"] == 0.2
    assert row["ratio_peak_mb"] == 0.75 and row["assembled_mb"] == 100.0
    assert row["iterations"] == 7


def test_exponents_and_crossings_stand_beside_the_curves():
    n = np.array([1e3, 1e4, 1e5])
    part = {"shape": "block", "element": "hex27", "unknowns": n}
    for method, p in (("direct", 2.0), ("iterative", 1.0)):
        scale = 1e-8 if method == "direct" else 2e-4
        part |= {f"{method}_{what}": scale * n**p for what in ("s", "again_s", "mb", "peak_mb")}
    for what in ("s", "again_s", "mb", "peak_mb"):
        part[f"ratio_{what}"] = part[f"iterative_{what}"] / part[f"direct_{what}"]
    table = pd.DataFrame(part)
    found = methods.summary(table, _slope)
    assert list(found) == ["block_hex27"]
    of = found["block_hex27"]
    assert of["crossing_again_s"] == pytest.approx(2e4)
    assert of["direct_exponent_s"] == pytest.approx(2) == of["direct_exponent_mb"]
    assert of["iterative_exponent_s"] == pytest.approx(1)
    axes = methods.plot_methods(table, found).axes
    for ax in axes:
        assert [line.get_label() for line in ax.lines] == [
            "hex27 block, direct (∝ N^2.00)", "hex27 block, iterative (∝ N^1.00)",
        ]  # fmt: skip
        np.testing.assert_allclose(ax.lines[1].get_ydata(), 2e-4 * n)
