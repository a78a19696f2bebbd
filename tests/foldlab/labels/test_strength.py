"""Peaks of strain and stress as evidence, and what breaks by them."""

import pytest

from foldlab.errors import InputError
from foldlab.labels.strength import Strengths, breaking, peaks
from solver.cases.unit.strain import Layer, Strain

COARSE = Strain(Layer(0.02, -0.05, 0.05), Layer(0.30, -0.10, 0.03), 0.0, 0.02, 4e-3)
FINE = Strain(Layer(0.02, -0.04, 0.04), Layer(0.30, -0.10, 0.03), 0.0, 0.01, 4e-3)


def test_evidence_has_the_larger_strain_and_what_two_meshes_leave_open():
    got = peaks(FINE, COARSE)
    assert got["strain"] == {"passive": 0.04, "active": 0.30}
    assert got["compression"]["passive"] == -0.04 and got["tension"]["passive"] == 0.02
    assert got["stress"] == {"passive": 0.04, "active": 0.03}
    assert got["averaged_over"] == 4e-3
    errors = got["peak_errors"]
    assert errors["strain"]["passive"] == pytest.approx(1.25 * 0.2)
    assert errors["interface"] == pytest.approx({"opening": 0.0, "shear": 1.25 * 0.5})
    assert errors["strain"]["active"] == 0
    assert peaks(FINE)["peak_errors"] is None


@pytest.mark.parametrize(
    "limits, breaks",
    [
        ({}, False),
        ({"passive_strain": 0.06}, False),
        ({"passive_strain": 0.045}, None),  # 0.04 with an error of a quarter
        ({"passive_strain": 0.035}, None),
        ({"passive_strain": 0.029}, True),
        ({"active_strain": 0.29}, True),
        ({"active_strain": 0.31}, False),
        ({"passive_stress": 0.029}, True),
        ({"active_stress": 0.029}, True),
        ({"opening": 1e-9}, False),
        ({"shear": 3e-3}, True),
        ({"shear": 0.012}, None),
        ({"shear": 0.012, "active_strain": 0.2}, True),
    ],
)
def test_what_breaks(limits, breaks):
    got, phrases = breaking(peaks(FINE, COARSE), Strengths(**limits))
    assert got is breaks
    assert bool(phrases) == (breaks is not False)
    assert all("borne" in phrase for phrase in phrases)


def test_peaks_of_one_mesh_are_known_to_30_percent():
    for limit, breaks in ((0.053, False), (0.051, None), (0.029, None), (0.027, True)):
        assert breaking(peaks(FINE), Strengths(passive_strain=limit))[0] is breaks


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_strengths_are_positive(value):
    with pytest.raises(InputError, match=r"shear = .*; expected a finite number above 0"):
        Strengths(shear=value)
