"""Structures' experiment: agreement with labels, the large sheet, random nets."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from pytest import approx

from experiments import structures
from solver.cases.structure.pattern import area_of


def rows(*units):
    columns = ("ending", "panel_sag", "angle", "label", "natural", "same")
    return pd.DataFrame(units, columns=columns)


def test_agreement_is_told_of_stiff_and_soft_panels_that_ended():
    table = rows(
        ("reached", 0.01, 1.00, 0.98, 1.0, True),
        ("reached", 0.05, 1.00, 0.80, 1.0, True),
        ("reached", 0.06, 2.00, -1.00, 1.0, False),
        ("lost", 0.01, 0.0, 1.0, 1.0, False),
    )
    told = structures.agreement(table)
    assert (told["units"], told["ended"]) == (4, 3)
    stiff, soft = told["stiff"], told["soft"]
    assert stiff["units"] == 2 and stiff["within_5_percent"] == 1 and stiff["same_verdict"] == 2
    assert stiff["off_median"] == approx(0.11) and stiff["off_most"] == approx(0.2)
    assert soft["units"] == 1 and soft["off_most"] == approx(3.0) and soft["same_verdict"] == 0
    assert structures.agreement(table[:2])["soft"]["off_median"] is None


def test_a_unit_becomes_two_panels_of_its_own_groups():
    design = {
        "E_ratio": 0.5, "rho_ratio": 2.0, "hinge_length": 0.3, "h_ratio": 1.5, "aspect": 0.4,
        "stiffness_to_weight": 4.0, "slenderness": 0.01, "contraction": 0.1,
    }  # fmt: skip
    made = structures.unit_of(design)
    assert [area_of(p) for p in made.pattern.panels] == approx([0.35 * 0.4] * 2)
    (layer,) = made.layers
    assert (layer.E, layer.rho, layer.h, layer.contraction) == (0.5, 2.0, approx(0.015), 0.1)
    assert made.sheet.E * made.sheet.h**2 / (made.sheet.rho * made.g) == approx(4.0)


def test_the_large_sheet_folds_as_a_miura_sheet_must():
    alpha = np.radians(70)
    pattern = structures.miura_sheet(4, 3, alpha, 0.02, 0.001)
    assert len(pattern.panels) == 12 and len(pattern.hinges) == 4 * 2 + 3 * 3
    for vertex in range(len(pattern.vertices)):
        around = [c for c in pattern.creases if vertex in c.ends]
        if len(around) == 4:  # Maekawa: mountains and valleys differ by two
            assert abs(sum(c.fold for c in around)) == 2


@pytest.mark.parametrize("seed", range(3))
def test_random_nets_hang_together(seed):
    made = structures.random_net(np.random.default_rng(seed))
    count = len(made.pattern.panels)
    assert 3 <= count <= 12 and len(made.pattern.hinges) >= count - 1
    assert 1e-3 <= made.sheet.h <= 1e-2
    assert 0.1 <= made.sheet.h**2 / made.g <= 1000


def test_the_contraction_closes_a_right_angle():
    from solver.cases.structure.hinges import Law, Layer

    sheet = Layer(1e9, 1000, 1e-4)
    c = structures._closing(sheet, 1e7, 1000, 5e-3)
    law = Law.of_section(sheet, Layer(1e7, 1000, 2e-4, c), 5e-3, 5e-3)
    assert law.angle[-1] == approx(np.pi / 2, rel=1e-6)
    assert structures._closing(sheet, 1e3, 1000, 1e-4) is None


def test_each_net_has_its_own_core_seconds_and_ends(monkeypatch):
    seen = []

    def fold(model):
        seen.append(model)
        return SimpleNamespace(
            ending=SimpleNamespace(name=f"end{len(seen) % 2}"), detail="", happenings=[], states=[]
        )

    ticks = iter(np.arange(0.0, 1000.0, 0.25))
    monkeypatch.setattr(structures, "core_seconds", lambda: next(ticks))
    monkeypatch.setattr(structures, "build", lambda body, *, deadline: deadline)
    monkeypatch.setattr(structures, "fold", fold)
    rows, told = structures.random_nets(structures.Config(nets=3, net_seconds=2.0))
    assert seen == [2.0, 2.5, 3.0] and len(rows) == 3
    assert told["endings"] == {"end1": 2, "end0": 1}
    assert told["core_seconds_most"] == told["core_seconds_mean"] == 0.25


def test_a_net_that_needs_longer_ends_as_timed_out():
    config = structures.Config(nets=1, net_seconds=0.05, seed=7)
    rows, told = structures.random_nets(config)
    assert told["endings"] == {"TIMEOUT": 1} and rows[0]["core_seconds"] < 3


def test_the_largest_cube_lies_between_one_that_closes_and_one_that_does_not(monkeypatch):
    asked = []

    def closes(sheet, E, rho, side, timeout):
        asked.append(side)
        if side < 0.01:
            return False, "too short"
        return (True, "closes") if side < 0.05 else (None if side < 0.3 else False, "sags")

    monkeypatch.setattr(structures, "_closes", closes)
    monkeypatch.setattr(structures, "PAIRS", structures.PAIRS[:1])
    (row,), told = structures.largest(structures.Config())
    assert row["largest_mm"] < 50 <= row["fails_mm"] < 1.07 * row["largest_mm"]
    assert row["why"] == "sags" and list(told.values()) == [row["largest_mm"]]
    monkeypatch.setattr(structures, "_closes", lambda *_: (False, "too heavy"))
    (row,), told = structures.largest(structures.Config())
    assert row["largest_mm"] is None and list(told.values()) == [None]
    assert row["why"].startswith("5 mm: too heavy; ") and row["why"].endswith("2e+03 mm: too heavy")
    monkeypatch.setattr(structures, "_closes", lambda *_: (True, "closes"))
    (row,), _ = structures.largest(structures.Config())
    assert (row["largest_mm"], row["fails_mm"], row["why"]) == (2000.0, None, None)


def test_a_hinge_that_no_contraction_folds_closes_no_cube():
    sheet = structures.Layer(1e9, 1000, 1e-4)
    closes, why = structures._closes(sheet, 1e3, 1000, 6e-4, 5.0)
    assert closes is False and "no contraction folds so short a hinge" in why
