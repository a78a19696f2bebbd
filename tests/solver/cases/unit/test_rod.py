"""The planar rod: its section, its energy's derivatives, the heavy strip of references.md §2."""

from dataclasses import replace

import numpy as np
import pytest
from rods import differences, gradient, pressed, strip

from solver.cases.unit import rod_kernel as kernel
from solver.cases.unit.rod import ERROR, STEADY, Ending, _parts, bend, ends
from solver.cases.unit.section import natural
from solver.cases.unit.unit import Unit

TABLE_4_1 = Unit(
    E_ratio=0.1, rho_ratio=1.0, hinge_length=0.2, hinge_width=1.0, h_ratio=5.0,
    stiffness_to_weight=1.0, aspect=0.2, slenderness=4e-3, contraction=0.3,
)  # fmt: skip


def section(m, n, c):
    """κ h_s, B and λ₀ at e = 1."""
    table = np.zeros((4, 3))
    assert natural(m, n, c, 0.3, table)
    return table[-1]


@pytest.mark.parametrize(
    "m, n, c, angle",  # κ (h_i + h_s), references.md §3; the first over 50 h_s
    [(5, 0.1, 0.3, 3.580054 * 6 / 50), (10, 1e-3, 0.3, 0.411075), (0.1, 1e3, 0.3, 0.356071)],
)
def test_a_section_bends_as_exact_pure_bending(m, n, c, angle):
    assert section(m, n, c)[0] * (1 + m) == pytest.approx(angle, rel=2e-3)


def test_a_section_is_timoshenkos_at_small_contraction():
    m, n, c = 2.0, 0.3, 1e-4
    curvature, stiffness, stretch = section(m, n, c)
    mn = m * n
    factor = 6 * (1 + m) / (3 * (1 + m) ** 2 + (1 + mn) * (m**2 + 1 / mn))
    assert curvature / c == pytest.approx(factor, rel=1e-3)
    composite = (1 + m**3 * n) / 12 + mn * (1 + m) ** 2 / (4 * (1 + mn))
    assert stiffness == pytest.approx(composite / (1 - 0.3**2), rel=1e-3)
    # No force: the strains of the two mid-planes share the mismatch, κ apart.
    low, high = stretch - 1, stretch - 1 - curvature * (1 + m) / 2
    assert low + mn * (high + c) == pytest.approx(0, abs=1e-3 * c)


def folded(gamma, hinge, panel, curvature):
    """(θ at the hinge's edge, θ at the tip, z of the tip), and the history."""
    lengths, rods, nodes, ground = strip(gamma, hinge, panel)
    table = np.array([[curvature * k / 3, hinge, 1.0, 0.0] for k in range(4)])
    x, history = np.zeros(len(lengths) + 1), np.zeros((300, 8))
    rules = (0.05, 0.2, 1e-4, 1e-8, 0.3)
    ending, count, _ = kernel.follow(
        lengths, 40, 1.0, table, 0.0, rods, nodes, ground, rules, x, history
    )
    assert ending in (kernel.REACHED, kernel.CLOSED)
    last = history[count - 1]
    found = last[kernel.HINGE_ANGLE], last[kernel.TIP_ANGLE], last[kernel.TIP]
    return found, history[:count]


@pytest.mark.parametrize(
    "gamma, hinge, panel, curvature, known",
    [
        (20, 1, 1, 10, (0.846996, 0.686590, 0.304894)),
        (50, 1, 1, 10, (0.510316, -0.017698, 0.068417)),
        (100, 1, 1, 10, (0.345359, -0.092597, 0)),
        (200, 1, 1, 10, (0.232538, 0, 0)),
        (100, 1, 50, 10, (0.048355, 0.027033, 0.013713)),
        (2, 1, 1 / 49.5, 15, (1.493044, 1.102140, 0.433300)),
        (5, 1, 1 / 49.5, 15, (1.464527, -0.645672, 0)),
    ],
)
def test_the_heavy_strip(gamma, hinge, panel, curvature, known):
    found, history = folded(gamma, hinge, panel, curvature)
    assert found == pytest.approx(known, abs=2e-3, rel=5e-3)
    assert not history[:, kernel.SNAP].any()


def test_the_heavy_strip_snaps_over_where_it_should():
    at = 1.931488 / 0.1  # natural curvature at the limit point, B_h/B_p = 0.02, γ = 150
    _, before = folded(150, 1, 50, 0.995 * at)
    assert not before[:, kernel.SNAP].any() and 0 < before[-1, kernel.SOFTNESS] < 0.2
    assert before[-1, kernel.TIP_ANGLE] < 0.806339
    _, beyond = folded(150, 1, 50, 1.01 * at)
    jumps = beyond[beyond[:, kernel.SNAP] > 0]
    assert len(jumps) == 1 and jumps[0, kernel.LOAD] * 1.01 == pytest.approx(1, abs=3e-3)
    assert jumps[0, kernel.TIP_ANGLE] > 2.4


@pytest.mark.parametrize("bend", [0.0, 0.4])
def test_gradient_and_step_are_those_of_the_energy(bend):
    x, *parts = pressed(bend=bend)
    shape, load, step = np.zeros((6, 8)), np.zeros(8), np.zeros(8)
    assert np.isfinite(kernel.energy(x, *parts, shape))
    # The ground acts where the sheet is low.
    ground = parts[2]
    assert shape[kernel.HEIGHT, 0] < ground[kernel.RANGE] - ground[kernel.DEPTH]
    negative, _, work = kernel.solve(x, *parts, shape, load, False, step, np.zeros((8, 3)))
    slopes = differences(lambda y: kernel.energy(y, *parts, np.zeros((6, 8))), x, 1e-6)
    assert load == pytest.approx(-slopes, rel=1e-6, abs=1e-5)
    hessian = differences(lambda y: gradient(y, *parts), x, 1e-6)
    assert negative == 0 and hessian == pytest.approx(hessian.T, rel=1e-5, abs=1e-4)
    assert hessian @ step == pytest.approx(load, rel=1e-5, abs=1e-4)
    assert work == pytest.approx(load @ step)


@pytest.mark.parametrize("gamma, count", [(60.0, 0), (500.0, 1), (2000.0, 2)])
def test_pivots_count_the_unstable_modes(gamma, count):
    # Upright panels that are heavy would fall over.
    x, *parts = pressed(gamma, bend=0.35)
    shape, scratch = np.zeros((6, 8)), (np.zeros(8), np.zeros((8, 3)))
    kernel.energy(x, *parts, shape)
    negative, _, _ = kernel.solve(x, *parts, shape, np.zeros(8), False, *scratch)
    hessian = differences(lambda y: gradient(y, *parts), x, 1e-6)
    assert (np.linalg.eigvalsh(hessian + hessian.T) < 0).sum() == count
    assert negative == count


@pytest.mark.parametrize("c, angle", [(0.1, 1.2393), (0.2, 2.4913), (0.3, 3.7722)])
def test_a_free_hinge_turns_as_the_solid_does(c, angle):
    # references.md §3, with free ends
    bent = bend(replace(TABLE_4_1, contraction=c), heavy=False)
    assert bent.angle == pytest.approx(angle, rel=5e-3)
    assert bent.angle == pytest.approx(bent.natural) and bent.steady


def test_a_stiff_thick_layer_turns_the_sheet_by_its_ends():
    unit = replace(TABLE_4_1, E_ratio=1e3, contraction=0.05)
    assert section(5, 1e3, 0.05)[0] / unit.slenderness * unit.hinge_length < 1e-2
    assert bend(unit, heavy=False).angle > np.pi * 0.05
    with pytest.raises(ValueError, match=r"E_ratio = 5000; .* from 0.001 to 1000"):
        ends(5, 5e3)


def test_weight_holds_a_unit_down_and_lets_it_lift():
    light, heavy = bend(TABLE_4_1), bend(replace(TABLE_4_1, stiffness_to_weight=0.01))
    assert light.ending is Ending.REACHED and light.steady
    assert light.states[-1, kernel.TIP] > 0.1 > heavy.states[-1, kernel.TIP]
    for bent in (light, heavy):
        # Nothing is deeper than the floor, a tenth of the thickness.
        assert bent.states[:, kernel.LOWEST].min() > -0.1 * TABLE_4_1.slenderness
        assert bent.discretisation < 0.01
        assert 2 * bent.turns.sum() == pytest.approx(bent.angle)
        assert bent.s[-1] == pytest.approx(0.5) and len(bent.s) == len(bent.turns) + 1
    # Weight holds down what lies, and turns over what stands beyond upright.
    assert heavy.angle < heavy.natural and light.angle > light.natural > np.pi
    assert heavy.error > light.error


def test_a_path_near_a_limit_point_is_not_steady_though_it_never_jumped():
    bent = bend(TABLE_4_1)
    for softness, steady in ((2 * STEADY, True), (STEADY / 2, False), (0.0, False)):
        states = bent.states.copy()
        # One state of the path is enough.
        states[len(states) // 2, kernel.SOFTNESS] = softness
        near = replace(bent, states=states)
        assert near.settled and not near.snaps
        assert near.steady is steady


def test_what_is_nearly_unstable_multiplies_the_error_of_what_the_weight_takes():
    bent = bend(replace(TABLE_4_1, stiffness_to_weight=0.1))
    errors = {}
    for softness in (1.2, 1.0, 0.5, 0.05, 0.0):
        states = bent.states.copy()
        states[:, kernel.SOFTNESS] = softness
        errors[softness] = replace(bent, states=states).error
    taken = ERROR[2] * abs(bent.natural - bent.angle)
    assert taken > 0.01
    assert errors[0.5] - errors[1.0] == pytest.approx(taken)
    assert errors[0.05] - errors[1.0] == pytest.approx(19 * taken)
    # At a limit point it stays finite.
    assert errors[0.0] - errors[1.0] == pytest.approx(99 * taken)
    # What is stiffer than the hinge's bending takes nothing off.
    assert errors[1.2] == errors[1.0]


def test_the_discretisation_s_error_is_a_third_of_what_halving_the_intervals_changes():
    bent = bend(replace(TABLE_4_1, stiffness_to_weight=0.1))
    coarse = 2 * bent.states[-1, kernel.TIP_ANGLE]
    assert bent.discretisation == pytest.approx(abs(bent.angle - coarse) / 3, rel=1e-9)
    assert bent.discretisation > 1e-6


def test_a_heavy_unit_with_a_soft_thick_layer_bends_as_the_solid_does():
    """Its active layer ends early: the hinge is weak there, and would turn by 1.48 rad if not."""
    unit = Unit(
        E_ratio=3.823e-3, rho_ratio=0.5489, hinge_length=0.291, hinge_width=0.4585, h_ratio=6.111,
        stiffness_to_weight=0.09009, aspect=0.1466, slenderness=3.514e-3, contraction=0.1921,
    )  # fmt: skip
    assert bend(unit).hinge == pytest.approx(1.114, rel=0.05)  # a label of the solver, ± 4 %


def test_the_nodes_bear_the_units_weight():
    unit = replace(TABLE_4_1, hinge_width=0.5, rho_ratio=2.0, stiffness_to_weight=0.3)
    lengths = np.repeat([0.1 / 6, 0.4 / 8], [6, 8])
    _, nodes, ground = _parts(unit, True, lengths, 6)
    # Half of the panels and of the hinge, whose active layer is five times as thick, in h_s² b_s/Γ.
    weight = 0.4 + 0.1 * 0.5 * (1 + 2.0 * 5.0)
    assert nodes[:, kernel.WEIGHT].sum() == pytest.approx(weight / 0.3)
    assert nodes[:, kernel.AREA].sum() == pytest.approx(0.4 + 0.1 * 0.5)
    # The active layer's centre lies (h_i + h_s)/2 above the sheet's middle.
    lever = (5 + 1) / 2 * unit.slenderness
    assert nodes[:, kernel.OFFSET].sum() == pytest.approx(0.1 * 0.5 * 10.0 * lever / 0.3)
    assert ground[kernel.DEPTH] == pytest.approx(0.1 * unit.slenderness)
    _, weightless, free = _parts(unit, False, lengths, 6)
    assert not weightless.any() and free[kernel.KAPPA] == 0


def test_a_rod_refuses_what_it_does_not_know():
    for unit in (replace(TABLE_4_1, strips=3), replace(TABLE_4_1, nu=0.4)):
        with pytest.raises(ValueError, match=r"solid layers with nu = 0\.3"):
            bend(unit)


@pytest.mark.parametrize("length", [40.0, 8e3])
def test_a_sheet_very_long_against_its_thickness_is_given_up_soon(length, monkeypatch):
    """A sheet of 0.1 mm, metres or kilometres long: on the finer intervals it began deep in the
    ground and was lifted by a hundredth of its thickness at a time, without an end; what then did
    not settle was told as its angle."""
    lifted, energy = [], kernel.energy
    monkeypatch.setattr(kernel, "energy", lambda *given: lifted.append(0) or energy(*given))
    long = Unit(
        E_ratio=0.01, rho_ratio=0.8, hinge_length=0.01 / length, hinge_width=1.0, h_ratio=2.0,
        stiffness_to_weight=4e9 * 1e-8 / (1390 * 9.81 * length**3), aspect=0.01 / length,
        slenderness=1e-4 / length, contraction=0.2,
    )  # fmt: skip
    bent = bend(long)
    assert 10 < len(lifted) < 60
    assert bent.ending is Ending.LOST and not bent.settled and bent.error == np.inf
    assert bent.angle == 2 * bent.states[-1, kernel.TIP_ANGLE]
    assert len(bent.s) == len(bent.turns) + 1
