"""Figures of the lung: what their lines and marks show."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments._lung import plots


def test_pressures_that_are_not_reached_are_told():
    rows = [{"case": "p +0%", "pressure": 0.1, "reached": True},
            {"case": "p +5%", "pressure": 0.105, "reached": False}]  # fmt: skip
    loads = np.array([0.0, 0.1, 0.102])
    (ax,) = plots.plot_pressure(loads, {"all": [0, 1, 2], "hexagons": [0, 2, 4]}, rows, True).axes
    lines = {line.get_label(): line for line in ax.lines}
    assert list(lines["all"].get_ydata()) == [0, 1, 2] and lines["hexagons"].get_linestyle() == "--"
    assert list(lines["p +5%: not reached"].get_xdata()) == [0.105, 0.105]
    assert lines["limit point"].get_xydata() == pytest.approx(np.array([[0.102, 2]]))
    (without,) = plots.plot_pressure(loads, {"all": [0, 1, 2]}, rows, False).axes
    assert "limit point" not in [line.get_label() for line in without.lines]


def test_meshes_stand_beside_the_finest_by_unknowns_per_wedge():
    sphere = [{"stretch": 1.1, "pressure": 0.01, "error": -0.02},
              {"stretch": 1.2, "pressure": 0.02, "error": 0.01}]  # fmt: skip
    rows = [
        {"mesh": "hex27, level 0", "part": "wedge", "unknowns": 240, "beside_finest": -0.01},
        {"mesh": "tet4", "part": "sphere", "unknowns": 2400, "beside_finest": 0.05},
    ]
    curves = {"hex27, level 0": [(0.0, 0.0), (0.1, 0.5)], "tet4": [(0.0, 0.0), (0.1, 0.4)]}
    left, middle, right = plots.plot_inflation(sphere, {1.1: 0.01}, rows, curves, 0.1).axes
    assert left.get_title() == "thick sphere: at most 2 % apart"
    assert left.lines[1].get_xydata().tolist() == [[1.1, 0.01], [1.2, 0.02]]
    assert [line.get_linestyle() for line in middle.lines] == ["-", "--", "-"]
    assert middle.lines[1].get_xydata().tolist() == [[0, 0], [0.1, 0.4]]
    wedge, whole = right.lines
    assert wedge.get_xydata() == pytest.approx(np.array([[240, -1.0]]))
    assert whole.get_xydata() == pytest.approx(np.array([[20, 5.0]]))
    assert whole.get_label() == "tet4, whole sphere"


def test_stiffness_has_a_line_for_each_mesh_state_and_limit():
    table = pd.DataFrame({
        "mesh": "hex27", "stiffness": [25.0, 75.0], "aspect": [None, 0.5], "at_limit": [0.9, 0.6],
        "low": [0.2, 0.1], "limit": [0.09, 0.12],
    })  # fmt: skip
    left, right = plots.plot_stiffness(table, 0.11, 0.03).axes
    shown = {line.get_label(): line.get_ydata().tolist() for line in left.lines}
    assert shown["hex27, p = 0.11"][1] == 0.5 and np.isnan(shown["hex27, p = 0.11"][0])
    assert shown["hex27, at the limit point"] == [0.9, 0.6]
    assert shown["hex27, p = 0.03"] == [0.2, 0.1]
    assert right.lines[0].get_ydata().tolist() == [0.09, 0.12]
    assert list(right.lines[1].get_ydata()) == [0.11, 0.11]


def test_modes_are_drawn_over_what_changes():
    table = pd.DataFrame({
        "case": ["inflation", "inflation", "puncture"], "pressure": [0.0, 0.1, 0.09],
        "g": [0.0, 0.0, -0.4], "even": [0, 1, 0], "odd in one": [0, 3, 0], "odd in two": [0, 0, 3],
        "odd in three": 0, "unstable": [0, 4, 3],
    })  # fmt: skip
    inflation, puncture = plots.plot_stability(table).axes
    assert inflation.lines[-1].get_xydata().tolist() == [[0.0, 0.0], [0.1, 4.0]]
    assert inflation.lines[1].get_ydata().tolist() == [0, 3]
    assert puncture.lines[-1].get_xydata().tolist() == [[-0.4, 3.0]]
    assert puncture.lines[2].get_label() == "odd in two" and puncture.xaxis_inverted()


def test_models_without_sections_are_bars_and_with_them_pictures():
    rows = [{"case": "a", "aspect": 0.3}, {"case": "b", "aspect": 0.5}]
    (ax,) = plots.plot_models({}, rows).axes
    assert [bar.get_height() for bar in ax.patches] == [0.3, 0.5]
    line = np.array([[0.0, 1.0], [0.5, 0.8]])
    cut = SimpleNamespace(lines=(line, 1.1 * line), bundle=np.array([[0, 1], [0.1, 1], [0.1, 1.2]]))
    (section,) = plots.plot_models({"inflated": {"advanced": cut}}, rows).axes
    inner, outer = section.lines
    assert inner.get_xydata() == pytest.approx(line) and inner.get_label() == "advanced"
    assert outer.get_xydata() == pytest.approx(1.1 * line) and len(section.patches) == 2


def test_curves_are_drawn_over_their_contraction():
    (ax,) = plots.plot_curves({"g = 0": ([0, 1], [2, 3])}, "contraction |g|").axes
    assert ax.lines[0].get_xydata().tolist() == [[0, 2], [1, 3]]
    assert ax.get_xlabel() == "contraction |g|"
    figure = plots.signed(ax.figure, "a", "b", "c")
    assert figure.texts[0].get_text() == "Dissertation: a\nHere: b\nVerdict: c."
