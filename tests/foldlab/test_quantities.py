"""Numbers with units."""

import math

import pytest

from foldlab.errors import InputError
from foldlab.quantities import in_si, numbers


@pytest.mark.parametrize(
    "name, text, value",
    [
        ("l_s", "40mm", 0.04), ("h_s", "0.1 mm", 1e-4), ("h_i", "25µm", 25e-6),
        ("b_s", "1in", 0.0254), ("E_s", "2.5GPa", 2.5e9), ("E_i", "500 kPa", 5e5),
        ("rho_s", "1.4g/cm3", 1400.0), ("rho_s", "1380 kg/m^3", 1380.0),
        ("rho_i", "1100kg/m³", 1100.0), ("g_earth", "1.62 m/s2", 1.62),
        ("contraction", "20%", 0.2), ("contraction", "0.2", 0.2), ("E_ratio", "1e-3", 1e-3),
        ("l_s", "1e-2m", 0.01), ("l_s", 0.04, 0.04), ("l_s", "0.04", 0.04),
    ],
)  # fmt: skip
def test_quantities_come_in_their_own_units(name, text, value):
    assert in_si(name, text) == pytest.approx(value, rel=1e-12)


def test_angles_and_masses_are_asked_for_by_unit():
    assert in_si("need", "90deg", "rad") == pytest.approx(math.pi / 2)
    assert in_si("need", "90°", "rad") == pytest.approx(math.pi / 2)
    assert in_si("need", "1.57", "rad") == 1.57
    assert in_si("max_mass", "5g", "kg") == pytest.approx(0.005)


@pytest.mark.parametrize(
    "name, text, words",
    [
        ("l_s", "40MPa", "a quantity in m, such as 40mm"),
        ("l_s", "40%", "a quantity in m"),
        ("E_s", "2.5", None),
        ("E_s", "2.5GPaa", "not defined"),
        ("E_ratio", "3mm", "a plain number"),
        ("l_s", "long", "such as 40mm"),
        ("l_s", "", "such as 40mm"),
        ("l_s", "nan", "finite"),
        ("l_s", "inf m", "such as 40mm"),
        ("l_s", "4 mm; import os", "such as 40mm"),
        ("l_s", "9**9**9**9 m", "such as 40mm"),
        ("l_s", "__import__('os')", "such as 40mm"),
        ("l_s", True, "such as 40mm"),
        ("l_s", [1], "such as 40mm"),
    ],
)
def test_what_is_no_such_quantity_is_told_with_an_example(name, text, words):
    if words is None:
        assert in_si(name, text) == 2.5
        return
    with pytest.raises(InputError, match=words):
        in_si(name, text)


def test_settings_that_must_be_numbers():
    assert numbers({"E_ratio": 1, "l_s": "40mm"}) == {"E_ratio": 1.0, "l_s": 0.04}
    with pytest.raises(
        InputError, match="no quantity 'lenght' that has a unit; there are E_s, E_i"
    ):
        numbers({"lenght": "40mm"})
    assert numbers({"w_i": "2mm", "strips": "3"}) == {"w_i": 0.002, "strips": 3.0}
    with pytest.raises(InputError, match="E_ratio"):
        numbers({"E_ratio": "thick"})
