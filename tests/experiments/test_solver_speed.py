"""Exponents, sizes and clocks of the study of the solver's cost."""

import os
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments import _solver_methods, solver_speed
from experiments.solver_speed import Config, _clocked, _slope, path_cost, plot_cost, sized
from foldlab.errors import InputError
from solver.cases.unit import problem_p


def test_an_exponent_is_the_slope_of_logs():
    n = np.array([1e3, 1e4, 1e5])
    assert _slope(n, 3 * n**1.5) == pytest.approx(1.5)
    assert _slope([1e3], [2.0]) is None


@pytest.mark.parametrize(("element", "unknowns"), [("hex27", 3000), ("tet4", 1000), ("tet4", 9000)])
def test_a_mesh_has_about_as_many_unknowns_as_asked_for(element, unknowns):
    body = sized(element, unknowns)
    assert 0.6 * unknowns < 3 * len(body.nodes) < 1.6 * unknowns
    # The whole unit, its layers at most an eighth as thick as a cell is long.
    low, high = body.nodes.min(axis=0), body.nodes.max(axis=0)
    assert low[1] == pytest.approx(-high[1]) and low[0] == pytest.approx(-high[0])


def test_a_clock_counts_factorisations_and_their_solves(monkeypatch):
    now = [100.0]

    def passing(seconds, value):
        now[0] += seconds
        return value

    monkeypatch.setattr(solver_speed.time, "perf_counter", lambda: now[0])
    factor = SimpleNamespace(_solve=lambda b: passing(2.0, b))
    solver = SimpleNamespace(factorise=lambda values: passing(3.0, factor))
    spent = _clocked(SimpleNamespace(solver=solver))
    passing(50.0, None)
    assert solver.factorise(1) is factor and spent == [3.0]
    passing(50.0, None)
    assert factor._solve(5) == 5 and spent == [5.0]


def test_a_path_states_the_error_of_its_angle_and_what_is_no_linear_algebra():
    row = path_cost("hex20", 0)
    error = abs(row["angle"] / problem_p.ANGLE - 1)
    assert row["error"] == pytest.approx(error) and error < 0.1
    assert 0 < row["overhead"] < 1 and row["seconds"] > 0 and row["build_s"] > 0
    assert row["iterations"] >= row["steps"] >= 8
    assert (row["element"], row["level"], row["across"]) == ("hex20", 0, 1)
    wider = path_cost("hex20", 0, 2)
    assert wider["across"] == 2 and wider["unknowns"] > 1.5 * row["unknowns"]


def test_an_iteration_is_the_sum_of_its_parts():
    row = solver_speed.iteration_cost("tet4", 1000, 1)
    whole = row["assembly_s"] + row["factor_s"] + row["solve_s"]
    assert row["iteration_s"] == pytest.approx(whole, rel=1e-6)
    assert row["overhead"] == row["assembly_s"] / row["iteration_s"]
    assert row["with_analysis_s"] > 0 and row["build_s"] > 0 and row["peak_mb"] > 50
    assert row["unknowns"] > 500 and row["cells"] > 500


def test_jobs_get_threads_of_their_own_and_their_repeats(tracker, monkeypatch):
    asked = []

    def alone(threads, job, *args):
        asked.append((threads, job.__name__, args))
        if job is solver_speed.path_cost:
            return {"element": args[0]}
        if job is _solver_methods.solve_cost:
            return solved(*args)
        element, n, _ = args
        times = {"iteration_s": n**1.5, "assembly_s": float(n), "factor_s": float(n) ** 2}
        return {"element": element, "unknowns": n, **times}

    monkeypatch.setattr(solver_speed, "_alone", alone)
    config = Config(
        path_levels=(0, 2), path_elements=("hex20",), path_sizes=((3, 12),), hex27=(1000, 10_000),
        tet4=(1000, 299_999, 300_000), repeats=4, threads=3, path_threads=2,
        shapes=("slab",), solves_hex27=(1000,), solves_tet4=(),
    )  # fmt: skip
    result = solver_speed.run(config, tracker)
    assert asked == [
        (2, "path_cost", ("hex20", 0)), (2, "path_cost", ("hex20", 2)),
        (2, "path_cost", ("hex27", 3, 12)),
        (3, "iteration_cost", ("hex27", 1000, 4)), (3, "iteration_cost", ("hex27", 10_000, 4)),
        (3, "iteration_cost", ("tet4", 1000, 4)), (3, "iteration_cost", ("tet4", 299_999, 4)),
        (3, "iteration_cost", ("tet4", 300_000, 1)),
        (3, "solve_cost", ("slab", "hex27", 1000, "none", 4)),
        (3, "solve_cost", ("slab", "hex27", 1000, "direct", 4)),
        (3, "solve_cost", ("slab", "hex27", 1000, "iterative", 4)),
    ]  # fmt: skip
    assert len(result["methods"]) == 1 and list(result["crossings"]) == ["slab_hex27"]
    assert len(result["problem_p"]) == 3 and len(result["table"]) == 5
    for element in ("hex27", "tet4"):
        for what, exponent in (("iteration_s", 1.5), ("assembly_s", 1.0), ("factor_s", 2.0)):
            assert result["exponents"][f"{element}_{what}"] == pytest.approx(exponent)


def solved(shape, element, unknowns, method, repeats):
    """What a solve might give."""
    size = {"none": 0.0, "direct": 4.0, "iterative": 1.0}[method]
    return {
        "shape": shape, "element": element, "unknowns": unknowns, "cells": 5, "build_s": 1.0,
        "first_s": 2 * size, "again_s": size, "iterations": 9, "residual": 1e-9,
        "peak_mb": 100.0 + 10 * size,
    }  # fmt: skip


def test_parts_are_chosen(tracker, monkeypatch):
    monkeypatch.setattr(solver_speed, "_alone", lambda threads, job, *args: solved(*args))
    config = Config(parts=("methods",), shapes=("block",), solves_hex27=(9,), solves_tet4=(90,))
    result = solver_speed.run(config, tracker)
    assert set(result) == {"methods", "crossings", "table"}
    assert [row["element"] for row in result["table"]] == ["hex27", "tet4"]
    for parts in (("metods",), ()):
        with pytest.raises(InputError, match="there are: paths, iterations, methods"):
            solver_speed.run(Config(parts=parts), tracker)


def environment():
    return {"value": os.environ["OMP_NUM_THREADS"], "pid": os.getpid()}


def test_a_process_of_its_own_has_its_threads_and_leaves_none_behind(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    row = solver_speed._alone(2, environment)
    assert row["value"] == "2" and row["threads"] == 2 and row["pid"] != os.getpid()
    assert os.environ["OMP_NUM_THREADS"] == "7" and "MKL_NUM_THREADS" not in os.environ


def test_the_picture_states_the_fitted_exponents():
    table = pd.DataFrame({"element": "tet4", "unknowns": [10, 100], "iteration_s": [1.0, 2.0],
                          "assembly_s": [0.5, 1.0], "factor_s": [0.1, 0.2]})  # fmt: skip
    exponents = {"tet4_iteration_s": 1.234, "tet4_assembly_s": None, "tet4_factor_s": 2.0}
    (ax,) = plot_cost(table, exponents).axes
    labels = [line.get_label() for line in ax.lines]
    assert labels == ["tet4, iteration (∝ N^1.23)", "tet4, assembly", "tet4, factor (∝ N^2.00)"]
    assert ax.lines[2].get_xydata().tolist() == [[10, 0.1], [100, 0.2]]
