"""Layers and materials at the ends of their ranges, against exact bending of the cross-section."""

from dataclasses import replace

import numpy as np
import pytest
from hard_scenes import P, bilayer, envelope, fold_angle, section_curvature
from reference_scenes import cylinder, inner_stretch, walked

from solver.cases.unit.choices import Meshing, Physics
from solver.cases.unit.model import build
from solver.cases.unit.path import Ending, fold
from solver.paths.steppers import LoadSteps

STEPS = LoadSteps(rtol=1e-8, step=0.25)


def bent(steps=STEPS, **options):
    """Curvature × h_s of a bilayer's middle after its contraction, and that of the section."""
    mesh = {k: options.pop(k) for k in ("length", "elements", "element") if k in options}
    scene, curvature = bilayer(
        options["g"], **{k: v for k, v in options.items() if k != "g"}, **mesh
    )
    last = walked(scene, steps).last
    assert last.unstable == 0
    return curvature(last.x, last.e), section_curvature(**options)


def test_active_layer_a_thousand_times_softer():
    """E_i/E_s = 1e-3: a bilayer of equal layers bends as its cross-section does (exact, 1 %)."""
    found, want = bent(g=-0.3, m=1.0, n=1e-3)
    assert found == pytest.approx(want, rel=1e-2)


def test_active_layer_a_thousand_times_stiffer():
    """E_i/E_s = 1e3: shear lag reaches √1000 thicknesses; far from the end the section's value."""
    found, want = bent(g=-0.3, m=1.0, n=1e3, length=40, elements=20)
    assert found == pytest.approx(want, rel=2e-3)


def test_thin_soft_layer_on_a_stiff_one():
    """h_i/h_s = 0.1 and E_i/E_s = 1e-3 together, turning of 2e-4 rad per thickness (exact, 1 %)."""
    found, want = bent(g=-0.3, m=0.1, n=1e-3, elements=14)
    assert found == pytest.approx(want, rel=1e-2)


def test_thick_stiff_layer_drags_the_sheet_along():
    """h_i/h_s = 10 and E_i/E_s = 1e3 together: the sheet is shortened by the whole contraction."""
    scene, _ = bilayer(-0.3, m=10.0, n=1e3)
    last = walked(scene, STEPS).last
    X = scene.body.nodes
    end = X[:, 0] > X[:, 0].max() - 1e-9
    top = end & (X[:, 2] > 5)
    shortened = -scene.displacement(last.x, last.e)[top, 0] / X[:, 0].max()
    # A sheet of stretch stiffness 1 on one of 1e4 keeps the layer from the last 1e-4 of it.
    assert shortened.mean() == pytest.approx(0.3, rel=5e-3)
    assert last.energy < 0.01 * scene.energy(np.zeros(scene.size), 1.0)


def test_active_layer_a_tenth_as_thick():
    """h_i/h_s = 0.1 at equal stiffness: 4.7 rad over 50 thicknesses (exact, 0.2 %)."""
    found, want = bent(g=-0.2, m=0.1, n=1.0)
    assert found == pytest.approx(want, rel=2e-3)


def test_active_layer_ten_times_as_thick():
    """h_i/h_s = 10 at equal stiffness: 0.43 rad over 50 thicknesses (exact, 0.2 %)."""
    found, want = bent(g=-0.2, m=10.0, n=1.0)
    assert found == pytest.approx(want, rel=2e-3)


def test_contraction_of_sixty_percent_bends_as_the_section():
    """|g| = 0.6, layers of equal stiffness, one radian per two thicknesses (exact, 1 %)."""
    found, want = bent(LoadSteps(rtol=1e-8, step=0.1), g=-0.6, m=1.0, n=1.0, length=5, elements=14)
    assert found == pytest.approx(want, rel=1e-2)


def test_contraction_of_sixty_percent_in_two_directions():
    """|g| = 0.6 along and through the layer: Jg = 0.16 in the section and in the elements."""
    found, want = bent(
        LoadSteps(rtol=1e-8, step=0.1), g=-0.6, m=2.0, n=0.5, growth=(1, 0, 1), length=4,
        elements=12,
    )  # fmt: skip
    assert found == pytest.approx(want, rel=1e-2)


def test_bilayer_of_nearly_incompressible_layers():
    """ν = 0.499: 20-node elements with reduced points bend as the section does (0.5 %)."""
    found, want = bent(g=-0.3, m=5.0, n=0.1, nu=0.499, element="hex20")
    assert found == pytest.approx(want, rel=5e-3)


def test_nearly_incompressible_cylinder_under_pressure():
    """ν = 0.499: p/μ = ln(λ_a/λ_b) + (λ_b⁻² − λ_a⁻²)/2, the closed form at ν = ½ (1 %)."""
    nu, p = 0.499, 0.05
    scene = cylinder(nu=nu, e_to=p)
    last = walked(scene, STEPS).last
    a = inner_stretch(scene, last.x, last.e)
    A, B = 0.9, 1.1
    b = np.sqrt(1 + (A / B) ** 2 * (a * a - 1))
    assert p * 2 * (1 + nu) == pytest.approx(np.log(a / b) + (b**-2 - a**-2) / 2, rel=1e-2)


def test_a_sheet_a_thousandth_as_thick_as_long():
    """h_s/l_s = 1e-3: a unit whose hinge is Problem P's made four times smaller folds by its angle.

    Weightless panels only turn with the hinge, so the angle depends on the hinge's shape alone.
    """
    unit = replace(P, slenderness=1e-3, hinge_length=0.05, aspect=0.05)
    found = fold(build(unit, Meshing(1), Physics(())))
    assert found.ending is Ending.REACHED and found.last.unstable == 0
    assert fold_angle(found) == pytest.approx(3.772, rel=3e-3)


def test_a_sheet_a_tenth_as_thick_as_long():
    """h_s/l_s = 0.1, no sheet any more: energy balance dE/de = ∂E/∂e along the path to 0.1 %."""
    unit = replace(P, slenderness=0.1, hinge_length=0.5, h_ratio=1.0, E_ratio=1.0, aspect=1.0)
    gained, worked = envelope(build(unit, Meshing(0), Physics(())))
    assert gained == pytest.approx(worked, rel=1e-3)


def test_energy_balance_of_a_unit_that_folds_by_more_than_half_a_turn():
    """Problem P: the energy gained equals the work of growth, ∫ ∂E/∂e de, to 0.1 %."""
    gained, worked = envelope(build(P, Meshing(0), Physics(())))
    assert gained == pytest.approx(worked, rel=1e-3)


@pytest.mark.parametrize("h_ratio, E_ratio", [(0.1, 1e3), (10.0, 1e-3), (0.1, 1e-3), (10.0, 1e3)])
def test_corners_of_the_reduced_space(h_ratio, E_ratio):
    """All four corners of (E_i/E_s, h_i/h_s) at once: stable, and energy balance to 0.5 %."""
    unit = replace(P, h_ratio=h_ratio, E_ratio=E_ratio, contraction=0.1)
    gained, worked = envelope(build(unit, Meshing(0), Physics(())))
    assert gained == pytest.approx(worked, rel=5e-3)
