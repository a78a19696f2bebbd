"""Beam formulas against closed forms, the solid's ends, the rod, and the solver's labels."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

from foldlab.datasets import load_dataset
from foldlab.design import FULL, PATTERNED
from foldlab.labels import beam
from foldlab.labels.rod import rod_of
from foldlab.labels.timoshenko import bilayer_stiffness, fold_angle, lift_off_stiffness
from solver.cases.unit.rod import bend, ends
from solver.cases.unit.unit import Unit

DESIGNS = FULL.sample(40, seed=5)


def only(**groups):
    """One unit in a table."""
    unit = {
        "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0,
        "h_ratio": 5.0, "stiffness_to_weight": 20.0, "aspect": 0.2, "slenderness": 4e-3,
        "contraction": 0.02,
    }  # fmt: skip
    return pd.DataFrame([unit | groups])


def test_turning_is_timoshenkos_angle_over_what_is_needed():
    d = DESIGNS
    angle = fold_angle(
        d["E_ratio"], d["h_ratio"], d["slenderness"], d["hinge_length"], d["contraction"]
    )
    np.testing.assert_allclose(beam.turning(d), angle / (np.pi * d["contraction"]))


@pytest.mark.parametrize("design", DESIGNS.head(6).to_dict("records"))
def test_weight_and_sag_are_the_integrated_moments_of_cantilevers(design):
    a, length = design["hinge_length"] / 2, (1 - design["hinge_length"]) / 2
    w = 1 / design["stiffness_to_weight"]  # of a panel, in E_s h_s³ b_s/l_s²
    width = design["hinge_width"]
    own = w * width * (1 + design["rho_ratio"] * design["h_ratio"])
    stiffness = width * bilayer_stiffness(design["h_ratio"], design["E_ratio"])

    def in_hinge(y):
        return w * length * (a - y + length / 2) + own * (a - y) ** 2 / 2

    need, table = np.pi * design["contraction"], pd.DataFrame([design])
    bent = 2 * quad(in_hinge, 0, a)[0] / stiffness
    assert beam.weight(table)[0] == pytest.approx(bent / need)
    sagged = 2 * quad(lambda y: w * (length - y) ** 2 / 2, 0, length)[0] * 12
    assert beam.sag(table)[0] == pytest.approx(sagged / need)


def test_lift_off_is_one_at_the_stiffness_at_which_rigid_panels_lift():
    lifting = DESIGNS.assign(
        stiffness_to_weight=[lift_off_stiffness(d) for d in DESIGNS.to_dict("records")]
    )
    np.testing.assert_allclose(beam.lift_off(lifting), 1)


@pytest.mark.parametrize(
    "h_ratio, E_ratio, within",
    [(10, 1e3, 0.03), (1, 1e3, 0.03), (3, 100, 0.03), (1, 100, 0.03), (3, 10, 0.03),
     (0.3, 1e3, 0.03), (1, 1, 0.13), (1, 0.1, 0.03), (3, 0.01, 0.04), (10, 1e-3, 0.14)],
)  # fmt: skip
def test_ends_of_a_long_hinge_turn_as_those_of_the_solid(h_ratio, E_ratio, within):
    unit = only(h_ratio=h_ratio, E_ratio=E_ratio, hinge_length=0.5, slenderness=1e-4)
    both = 2 * ends(h_ratio, E_ratio)[0] / np.pi
    assert beam.edge(unit)[0] == pytest.approx(both, abs=within)


def test_a_short_hinge_loses_no_more_at_its_ends_than_it_has():
    # A soft thick layer, whose ends reach each other: there remains the stiffness of shear alone.
    short = only(h_ratio=10.0, E_ratio=1e-2, hinge_length=0.05, slenderness=3e-2)
    left = (beam.turning(short) + beam.edge(short))[0]
    assert 0 < left < 0.2 * beam.turning(short)[0]


# A narrow hinge gives way at its ends too, by the moment that it carries there.
@pytest.mark.parametrize(
    "change, within",
    [({}, 0.03), ({"stiffness_to_weight": 5.0}, 0.03), ({"E_ratio": 1e3, "h_ratio": 1.0}, 0.03),
     ({"hinge_width": 0.4}, 0.1), ({"hinge_length": 0.5}, 0.03),
     ({"rho_ratio": 10.0, "hinge_length": 0.5}, 0.03)],
)  # fmt: skip
def test_weight_takes_from_a_rod_that_hardly_bends_what_it_takes_from_beams(change, within):
    unit = only(**change)
    parts, need = beam.formulas(unit).iloc[0], np.pi * unit["contraction"][0]
    light, heavy = (bend(Unit(**unit.iloc[0]), heavy=heavy).angle / need for heavy in (False, True))
    assert parts["weight"] + parts["sag"] == pytest.approx(light - heavy, rel=within)
    assert rod_of(unit)["rod"][0] == pytest.approx(heavy)
    # The rod has its ends from the solid.
    solid = 2 * ends(unit["h_ratio"][0], unit["E_ratio"][0])[0] / np.pi
    assert parts["net"] - parts["edge"] + solid == pytest.approx(heavy, rel=0.02)


def test_net_and_ratio_pass_one_together():
    parts = beam.formulas(FULL.sample(2000, seed=1))
    assert ((parts["net"] > 1) == (parts["ratio"] > 1)).all()
    assert 0.1 < (parts["net"] > 1).mean() < 0.9


def test_strips_count_as_a_softer_layer():
    strips = PATTERNED.sample(20, seed=0)
    solid = strips.assign(E_ratio=strips["E_ratio"] * strips["strip_share"])
    solid = solid.drop(columns=["strips", "strip_share"])
    pd.testing.assert_frame_equal(beam.formulas(strips), beam.formulas(solid))


def test_without_any_fit_the_sum_of_beams_is_right_on_95_percent_of_the_solvers_labels():
    labels = load_dataset("gravity-5k")
    known = labels[(labels["growth"] == "uniaxial") & labels["foldable"].notna()]
    folds = beam.formulas(known)["net"].to_numpy() > 1
    assert (folds == known["foldable"].astype(bool)).mean() > 0.95


def test_a_rod_without_an_answer_is_at_a_loss_by_the_whole_threshold(monkeypatch):
    from foldlab.labels import rod

    monkeypatch.setattr(rod.RodSource, "_label", lambda *_: type("", (), {"evidence": {}}))
    unit = only(contraction=0.0213)
    assert rod_of(unit).iloc[0].tolist() == [0.0, 1.0]
    rod._turned.cache_clear()


@pytest.mark.parametrize("design", DESIGNS.tail(4).to_dict("records"))
def test_ends_turn_by_suhirs_lag_and_by_the_couple_at_the_interface(design):
    # In units of its own, as the docstring has it.
    E_s, h_s, nu = 7.0, 0.3, 0.3
    E_i, h_i = design["E_ratio"] * E_s, design["h_ratio"] * h_s
    B_s, B_i = E_s * h_s**3 / 12, E_i * h_i**3 / 12
    l_i = design["hinge_length"] * h_s / design["slenderness"]
    groups = (design["E_ratio"], design["h_ratio"], 1.0, 1.0, 1.0)
    kappa = fold_angle(*groups) / h_s  # at |g| = 1
    G_s, G_i = E_s / (2 * (1 + nu)), E_i / (2 * (1 + nu))
    K = 1 / (h_s / (3 * G_s) + h_i / (3 * G_i))
    lag = np.sqrt(K * (1 / (E_s * h_s) + 1 / (E_i * h_i) + (h_s + h_i) ** 2 / (4 * (B_s + B_i))))
    force = kappa * (B_s + B_i) / ((h_s + h_i) / 2)
    couple = kappa * B_i - force * h_i / 2
    # Without a moment from outside both couples are one.
    assert couple == pytest.approx(force * h_s / 2 - kappa * B_s)
    beta = (1 / (h_s / E_s + h_i / E_i) * (1 / B_s + 1 / B_i) / 4) ** 0.25
    over = quad(lambda a: lag * np.exp(-(lag + beta) * a) * np.cos(beta * a), 0, 60 / beta)[0]
    turned = 2 * (couple / (B_s * beta) * over - kappa * np.tanh(lag * l_i / 2) / lag)
    assert beam.edge(pd.DataFrame([design]))[0] == pytest.approx(turned / np.pi, rel=1e-6)
