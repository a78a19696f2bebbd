"""Peaks of strain, stress and traction between the layers against composite beam theory."""

from dataclasses import asdict

import numpy as np
import pytest

from solver.cases.unit.choices import Meshing, Physics, Supports
from solver.cases.unit.model import build
from solver.cases.unit.path import fold
from solver.cases.unit.strain import _force_of as force_of
from solver.cases.unit.strain import strain
from solver.cases.unit.unit import Unit

BEAM = Unit(
    E_ratio=0.5, rho_ratio=1.0, hinge_length=0.2, hinge_width=1.0, h_ratio=2.0,
    stiffness_to_weight=1.0, aspect=0.01, slenderness=4e-3, contraction=1e-3, nu=0.0,
)  # fmt: skip
TABLE_4_1 = Unit(
    E_ratio=0.1, rho_ratio=1.0, hinge_length=0.2, hinge_width=1.0, h_ratio=5.0,
    stiffness_to_weight=1.0, aspect=0.2, slenderness=4e-3, contraction=0.3,
)  # fmt: skip


def folded(unit, level=1, effects=()):
    found = fold(build(unit, Meshing(level), Physics(effects), Supports(("x", "y"))))
    return found.model, found.x


@pytest.fixture(scope="module")
def beam():
    return folded(BEAM)


def timoshenko(unit):
    """Strain of the sheet's faces, top and bottom, and the force between layers per width."""
    h, H, n = unit.slenderness, unit.active, unit.E_ratio
    bending = (h**3 + n * H**3) / 12
    force = 2 * unit.curvature * bending / (h + H)
    return -force / h - unit.curvature * h / 2, -force / h + unit.curvature * h / 2, force


def test_a_slender_hinge_is_strained_as_timoshenko_says(beam):
    top, bottom, force = timoshenko(BEAM)
    got = strain(*beam, 1.0, length=0.02)
    # The ends add what beam theory doesn't know: at this length of averaging little.
    assert got.passive.compression == pytest.approx(top, rel=0.02)
    assert got.passive.stress == pytest.approx(-top, rel=0.02)
    H = BEAM.active
    elastic = force / (BEAM.E_ratio * H) + BEAM.curvature * H / 2
    assert got.active.tension == pytest.approx(elastic, rel=0.02)
    outer = elastic - BEAM.curvature * H
    assert got.active.compression == pytest.approx(outer, rel=0.02) and outer < 0
    assert got.active.stress == pytest.approx(BEAM.E_ratio * elastic, rel=0.02)
    assert got.passive.strain == -got.passive.compression > got.passive.tension
    assert bottom < 0.5 * -top  # so that a face taken for the other would show


def test_the_layers_pull_at_each_other_by_the_force_between_them(beam):
    # Averaged over much more than the hinge: all of the force over half of its length.
    got = strain(*beam, 1.0, length=1e3)
    assert got.shear == pytest.approx(timoshenko(BEAM)[2] / (BEAM.hinge_length / 2), rel=0.01)
    # A layer in tension on the inside of an arc pulls away from it.
    assert got.opening == pytest.approx(timoshenko(BEAM)[2] * BEAM.curvature, rel=0.02)
    assert got.length == 1e3


def test_peaks_are_those_of_any_mesh():
    rows = [asdict(strain(*folded(TABLE_4_1, level), 1.0)) for level in (1, 2)]
    for layer in ("passive", "active"):
        for name, value in rows[1][layer].items():
            assert rows[0][layer][name] == pytest.approx(value, rel=0.05), (layer, name)
    assert rows[0]["shear"] == pytest.approx(rows[1]["shear"], rel=0.15)
    # 6.9 % in the middle of the hinge, more at its ends
    assert -rows[1]["passive"]["compression"] == pytest.approx(0.077, rel=0.02)
    assert rows[1]["opening"] > 0.1 * rows[1]["shear"]


def test_bending_takes_nothing_from_an_average():
    model, x = folded(TABLE_4_1)
    near, far = (strain(model, x, 1.0, length=length) for length in (4e-3, 0.08))
    # Over the longer one the hinge turns by 1.5 rad.
    assert 0.85 * near.passive.stress < far.passive.stress < near.passive.stress


def test_a_turned_unit_is_strained_no_more(beam):
    model, x = beam
    u = model.scene.displacement(x, 1.0)
    Q = np.array([[1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]])
    turned = (model.body.nodes + u) @ Q.T - model.body.nodes

    class Scene:
        def displacement(self, x, e):
            return turned

    class Turned:
        unit, body, terms, mirrors, heavy = BEAM, model.body, model.terms, (), False
        scene = Scene()

    before, after = asdict(strain(model, x, 1.0)), asdict(strain(Turned(), x, 1.0))
    for layer in ("passive", "active"):
        assert after[layer] == pytest.approx(before[layer], rel=1e-9)


def test_growth_alone_strains_nothing():
    model = build(TABLE_4_1, Meshing(0), Physics(()), Supports(("x", "y")))
    x = np.zeros(model.scene.size)
    assert strain(model, x, 0.0).passive.strain == pytest.approx(0.0, abs=1e-12)
    # Held flat, the active layer is stretched back by what it contracts.
    held = strain(model, x, 1.0)
    assert held.active.tension == pytest.approx(1 / 0.7 - 1, rel=1e-9)
    assert held.passive.stress == pytest.approx(0.0, abs=1e-12)


def test_nothing_but_the_interface_carries_the_active_layer():
    heavy = Unit(
        E_ratio=0.1, rho_ratio=2.0, hinge_length=0.2, hinge_width=1.0, h_ratio=5.0,
        stiffness_to_weight=1e-2, aspect=0.2, slenderness=4e-3, contraction=1e-6,
    )  # fmt: skip
    model, x = folded(heavy, 0, ("gravity", "ground"))
    force = force_of(model, model.scene.displacement(x, 1.0), 1.0, model.body.cells_of("active"))
    weight = 2.0 * heavy.weight * heavy.active * heavy.width * heavy.hinge_length / 4
    above = model.body.nodes[:, 2] > 1.01 * heavy.slenderness
    assert np.abs(force[above, 2]).max() < 1e-3 * weight
    assert force[:, 2].sum() == pytest.approx(weight, rel=1e-6)
    assert strain(model, x, 1.0, length=1e3).opening == 0.0


@pytest.mark.parametrize("length", [0.0, -1.0, np.nan, np.inf])
def test_lengths_that_average_nothing_are_refused(beam, length):
    with pytest.raises(ValueError, match="expected a length of averaging above 0"):
        strain(*beam, 1.0, length=length)
