"""Structures' experiment: agreement with labels, the large sheet, random nets."""

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
