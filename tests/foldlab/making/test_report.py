"""The report's words and chart, by hand and without a solver."""

from types import SimpleNamespace

import numpy as np
import pytest

from foldlab.making import report
from foldlab.making.geometry import Geometry


def a_dossier(**changed):
    unit = SimpleNamespace(materials={}, stimulus="", physical={"contraction": 0.2})
    conditions = SimpleNamespace(heavy=True, growth="uniaxial")
    run = SimpleNamespace(
        history=[{"contraction": 0.0, "m1": 0.0}, {"contraction": 0.1, "m1": 1.2}]
    )
    given = {
        "unit": unit, "told": {}, "answer": {"foldable": True, "need": 0.5}, "run": run,
        "source": SimpleNamespace(conditions=conditions, version="7"), "cost": None,
        "masses": {"passive": 1.5, "active": 0.25}, "reached": None, "crossed": False,
        "geometry": Geometry(100.0, 25.0, 0.1, 20.0, 25.0, 0.2),
    }  # fmt: skip
    return SimpleNamespace(**(given | changed))


@pytest.mark.parametrize(
    ("words", "html"),
    [
        ("turns by 1 rad", "turns by 57.3°"),
        ("0.5 rad and 3.14 radii", "28.6° and 3.14 radii"),
        ("h_s < rho_i", "<i>h</i><sub>s</sub> &lt; <i>ρ</i><sub>i</sub>"),
        ("E_s, E_ratio", "<i>E</i><sub>s</sub>, E_ratio"),
    ],
)
def test_words_have_degrees_and_symbols(words, html):
    assert report.as_html(words) == html


def test_sizes_tell_a_narrower_hinge_and_strips():
    whole = "sheet 100 × 25 × 0.1 mm (l_s × b_s × h_s)"
    assert report.sizes(Geometry(100.0, 25.0, 0.1, 20.0, 25.0, 0.2)) == (
        f"{whole}; active layer 20 × 25 × 0.2 mm (l_i × b_i × h_i)"
    )
    cut = Geometry(100.0, 25.0, 0.1, 20.0, 15.0, 0.2, strips=3, strip_share=0.6)
    # Three strips, each 60 % of 5 mm.
    assert report.sizes(cut) == (
        f"{whole}, its hinge 15 mm wide; active layer 20 × 3 × 0.2 mm (l_i × b_i × h_i), 3 strips"
    )


def test_facts_are_told_with_their_units():
    told = report._facts(a_dossier())
    assert told["weight"] == "1.75 kg (sheet 1.5 kg, active layer 250 g)"
    assert told["material cost"].startswith("needs price_low and price_high per kg")
    assert told["confirmed"] == (
        "by the finite-strain solver, with weight on a ground, 2 states of uniaxial contraction "
        "(version 7)"
    )
    assert "folded shape" not in told and "stimulus" not in told
    crossed = report._facts(a_dossier(reached=0.123, crossed=True, cost=(2.0, 3.5)))
    assert crossed["folded shape"] == (
        "that at 12.3 % contraction, where the path ended, not at 20 %; its panels pass through "
        "each other, for contact was left out"
    )
    assert crossed["material cost"].startswith("2 to 3.5, by your prices per kg")
    assert report._facts(a_dossier(cost=(2.0, 2.0)))["material cost"].startswith("2, by your")
    light = SimpleNamespace(heavy=False, growth="isotropic")
    answer = {"foldable": True, "core_seconds": 2.345, "holds": {}}
    source = SimpleNamespace(conditions=light, version="7")
    assert report._facts(a_dossier(source=source, answer=answer))["confirmed"] == (
        "by the finite-strain solver, without weight, 2 states of isotropic contraction, 2.3 "
        "core-seconds (version 7); margins by a planar rod"
    )
    assert report._facts(a_dossier(run=None))["confirmed"] == "no"


def test_the_chart_has_degrees_over_per_cent_and_what_counts_as_folded(monkeypatch):
    seen = []
    monkeypatch.setattr(report, "_png", lambda figure: seen.append(figure) or b"")
    report._chart(a_dossier())
    (ax,) = seen[0].axes
    path, need = ax.lines
    assert path.get_xydata() == pytest.approx(np.array([[0, 0], [10, np.degrees(1.2)]]))
    assert need.get_ydata() == pytest.approx(np.degrees([0.5, 0.5]))
    report._chart(a_dossier(answer={"foldable": None}))
    assert len(seen[1].axes[0].lines) == 1
    assert report._chart(a_dossier(run=None)) == "<p>–</p>" and len(seen) == 2
