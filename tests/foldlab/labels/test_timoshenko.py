"""The analytic oracle against hand values, an independent derivation and its own assumptions."""

import time

import numpy as np
import pytest

from foldlab.design import FULL, PATTERNED, REDUCED
from foldlab.errors import InputError
from foldlab.labels import timoshenko
from foldlab.labels.asked import Conditions
from foldlab.labels.solver import SolverSource
from foldlab.labels.sources import make_source
from foldlab.labels.timoshenko import TimoshenkoSource


def test_reference_fold_angle():
    # references.md §3: m = 5, n = 0.1, l_i = 50 h_s
    assert timoshenko.fold_angle(0.1, 5, 4e-3, 0.2, 0.3) == pytest.approx(40 / 11, rel=1e-12)
    assert timoshenko.fold_angle(0.1, 5, 4e-3, 0.2, -0.1) == pytest.approx(1.212121, abs=1e-6)


def test_equal_layers_give_three_halves():
    # Timoshenko 1925: κ (h_i + h_s) = 3/2 Δε for equal layers
    assert timoshenko.normalised_curvature(1.0, 1.0) * 2 == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("E_ratio", "h_ratio"), [(0.1, 5.0), (30.0, 0.2), (1e-3, 10.0), (1e3, 0.1)]
)
def test_curvature_from_force_and_moment_balance(E_ratio, h_ratio):
    # Linear strain a + κ z over both layers, solved from ∫σ = 0 and ∫σ z = 0 without the formula.
    def moments(E, lo, hi):
        return [E * (hi**k - lo**k) / k for k in (1, 2, 3)]

    passive, active = moments(1.0, 0.0, 1.0), moments(E_ratio, 1.0, 1.0 + h_ratio)
    A, B, D = (p + a for p, a in zip(passive, active, strict=True))
    a_kappa = np.linalg.solve([[A, B], [B, D]], [active[0], active[1]])
    assert timoshenko.normalised_curvature(E_ratio, h_ratio) == pytest.approx(a_kappa[1], rel=1e-9)


def test_assumptions_agree_where_they_must_and_differ_where_they_must():
    args = (0.1, 5.0)
    strip = timoshenko.normalised_curvature(*args)
    for assumption in ("plane_strain", "plate"):
        same = timoshenko.normalised_curvature(*args, assumption=assumption)
        assert same == pytest.approx(strip, rel=1e-12)
    isotropic = timoshenko.normalised_curvature(*args, assumption="plane_strain_isotropic")
    assert isotropic == pytest.approx(1.3 * strip, rel=1e-12)
    # Unlike Poisson ratios change the modulus ratio: (1 − ν_s²)/(1 − ν_i²) and (1 − ν_s)/(1 − ν_i)
    unlike = {"nu_i": 0.45, "nu_s": 0.1}
    wide = timoshenko.normalised_curvature(*args, assumption="plane_strain", **unlike)
    assert wide == pytest.approx(
        timoshenko.normalised_curvature(0.1 * (1 - 0.1**2) / (1 - 0.45**2), 5.0), rel=1e-12
    )
    plate = timoshenko.normalised_curvature(*args, assumption="plate", **unlike)
    assert plate == pytest.approx(timoshenko.normalised_curvature(0.1 * 0.9 / 0.55, 5.0), rel=1e-12)


def test_isotropic_growth_in_plane_strain_is_near_the_finite_strain_value():
    # references.md §3: 1.605560 at g = −0.1 with finite strain; small strain lies 2 % below
    angle = timoshenko.fold_angle(0.1, 5, 4e-3, 0.2, 0.1, assumption="plane_strain_isotropic")
    assert angle == pytest.approx(1.605560, rel=0.025)


def test_bad_arguments():
    with pytest.raises(InputError, match="no assumption 'wide'"):
        timoshenko.normalised_curvature(1, 1, assumption="wide")
    with pytest.raises(InputError, match=r"nu_s = 0\.5"):
        timoshenko.normalised_curvature(1, 1, nu_s=0.5)


def test_a_million_designs_in_one_call():
    designs = REDUCED.sample(1_000_000, seed=0)
    start = time.process_time()
    fraction = timoshenko.folds(*(designs[name] for name in REDUCED.names)).mean()
    assert 0.63 < fraction < 0.65
    # Vectorised takes about 0.1 s; a Python loop a hundred times as long.
    assert time.process_time() - start < 5


def test_source_labels_match_the_formula_and_carry_evidence():
    designs = REDUCED.sample(200, seed=1)
    labels = TimoshenkoSource().label_many(designs)
    expected = timoshenko.folds(*(designs[name] for name in REDUCED.names))
    assert [label.foldable for label in labels] == list(expected)
    label = labels[0]
    assert (label.source, label.version) == ("timoshenko", "1")
    assert label.evidence["error_estimate"] == 0.0
    assert label.evidence["seconds"] > 0
    assert (label.evidence["margin"] >= 0) == label.foldable
    assert ("reaches" in label.reason) == label.foldable
    assert TimoshenkoSource().label(dict(designs.iloc[0])).foldable == label.foldable


def test_full_space_compares_the_hinge_with_f1():
    designs = FULL.sample(500, seed=1)
    table = TimoshenkoSource(FULL).evaluate(designs)
    # F1 (Eq. 4.21): fold angle above |g| π
    np.testing.assert_array_equal(
        table["foldable"], table["fold_angle"] >= designs["contraction"] * np.pi
    )
    assert TimoshenkoSource(FULL).label_many(designs)[0].evidence["error_estimate"] is None


def test_versions_tell_assumptions_apart():
    assert TimoshenkoSource(assumption="plate").version == "1-plate"
    with pytest.raises(InputError, match="no label source 'abaqus'"):
        make_source("abaqus")


def test_strips_bend_as_a_softer_solid_layer():
    design = {
        "E_ratio": 1.0, "rho_ratio": 1.0, "hinge_length": 0.2, "hinge_width": 1.0, "h_ratio": 1.0,
        "stiffness_to_weight": 1.0, "aspect": 0.1, "slenderness": 4e-3, "contraction": 0.1,
    }  # fmt: skip
    solid = TimoshenkoSource(FULL).label(design).evidence["fold_angle"]
    cut = design | {"strips": 4, "strip_share": 0.3}
    angle = TimoshenkoSource(PATTERNED).label(cut).evidence["fold_angle"]
    softer = design | {"E_ratio": 0.3}
    assert angle == TimoshenkoSource(FULL).label(softer).evidence["fold_angle"]
    # The solid model of the strips agrees, and the solid layer's angle is another one.
    run = SolverSource(Conditions(effects="none"), space=PATTERNED).run(cut, 0)
    assert run.measures["m1"] == pytest.approx(angle, rel=0.04)
    assert abs(solid - angle) > 0.09 * angle
    # Weight needs a stiffer sheet to lift where the active layer is softer.
    assert timoshenko.lift_off_stiffness(cut) == timoshenko.lift_off_stiffness(softer)
