"""The folding unit: weight, symmetries and stability, and what it does.

Problem P is a unit without weight, on whose angles two independent codes agree within 0.1 %.
"""

from dataclasses import replace

import numpy as np
import pytest
from folding_units import COARSE, COARSEST, HEAVY, NARROW, P, angle, reached

from foldlab.labels import foldability
from foldlab.labels.timoshenko import lift_off_stiffness
from solver.cases.unit import mesh as unit_mesh
from solver.cases.unit.choices import Meshing, Physics, Supports
from solver.cases.unit.model import build
from solver.cases.unit.path import Ending, fold
from solver.cases.unit.symmetry import Symmetries
from solver.cases.unit.unit import Unit
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.paths.continuation import load, trace
from solver.paths.steppers import LoadSteps


def test_weight_is_what_the_groups_say():
    unit = replace(NARROW, stiffness_to_weight=0.05)
    # Γ = E_s h_s²/(ρ_s g l_s³)
    assert unit.slenderness**2 / unit.weight == pytest.approx(0.05)
    model = build(unit, Meshing(0), supports=Supports(()))
    gravity = next(term for term in model.terms if term.name == "gravity")
    down = gravity.weights(0.0).sum(axis=0)
    hinge = unit.hinge_length * unit.width
    sheet = unit.slenderness * (hinge + (1 - unit.hinge_length) * unit.aspect)
    volume = sheet + unit.rho_ratio * hinge * unit.active
    assert down == pytest.approx([0, 0, -unit.weight * volume])


def test_absent_effects_are_absent():
    assert build(P, Meshing(0), Physics(())).effects == ("elastic",)
    assert build(P, Meshing(0)).effects == ("elastic", "gravity", "ground")
    with pytest.raises(ValueError, match="come together"):
        build(P, Meshing(0), Physics(("gravity",)))


# -- without weight ------------------------------------------------------------------------------


@pytest.mark.parametrize("g, want", [(0.1, 1.239), (0.2, 2.491), (0.3, 3.772)])
def test_problem_p_folds_by_the_converged_angle(g, want):
    found = reached(build(replace(P, contraction=g), Meshing(1), Physics(())))
    assert angle(found) == pytest.approx(want, rel=2e-3)
    assert found.happenings == ()


def test_angles_of_a_path_are_those_of_less_contraction():
    half = reached(build(replace(P, contraction=0.15), Meshing(0), Physics(())))
    found = fold(build(P, Meshing(0), Physics(())), stop=lambda state: state.e >= 0.5)
    m1 = [foldability.measure(s.curves, P.hinge_length).m1 for s in found.states]
    e = [s.e for s in found.states]
    between = np.polynomial.Polynomial.fit(e, m1, 3)(0.5)
    assert between == pytest.approx(angle(half), rel=1e-4)


@pytest.mark.parametrize("mirrors", [(), ("x",), ("y",), ("turn",)])
def test_mirror_planes_change_nothing(mirrors):
    models = [build(P, Meshing(COARSE), Physics(()), Supports(m)) for m in (("x", "y"), mirrors)]
    quarter, other = (reached(m) for m in models)
    assert angle(other) == pytest.approx(angle(quarter), rel=1e-6)
    assert np.abs(shapes(other) - shapes(quarter)).max() < 1e-6
    # A mirror plane halves energy and unknowns alike.
    share = 2.0 ** (2 - len(mirrors))
    assert other.last.energy == pytest.approx(share * quarter.last.energy, rel=1e-6)


def shapes(folding):
    """Curves about the middle of C1, where the rest of a rigid motion has no part."""
    curves = folding.last.curves
    middle = curves[0, 499:501].mean(axis=0)
    return curves - middle


# -- symmetry and stability ----------------------------------------------------------------------


def counted(model, x, e, *, free=False):
    """Unstable modes of the whole unit in the state; ``free``: with no rows about x and y."""
    whole, there = model.widened((), x, e)
    scene = whole.scene
    if free:
        rows = [row for row in scene.rows if row.name not in ("rotation x", "rotation y")]
        assert len(rows) == len(scene.rows) - 2
        scene = Scene(whole.body, whole.terms, rows=rows)
    u = whole.scene.displacement(there, e)
    return scene.system_of(scene.evaluate(u, e, 2).stiffness).unstable


def test_four_classes_have_all_modes_of_the_whole_when_it_topples():
    model = build(HEAVY, Meshing(0))
    found = fold(model, stop=lambda state: state.topples)
    assert found.ending is Ending.STOPPED
    last = found.last
    assert {c.kept: (c.held, c.free) for c in last.checks} == {
        ("x", "y"): (0, 0),
        ("y",): (0, 0),
        ("x",): (0, 1),
        ("turn",): (0, 0),
    }
    assert counted(model, found.x, last.e) == 0
    assert counted(model, found.x, last.e, free=True) == 1
    assert [h.kind for h in found.happenings] == ["toppling"]


def test_rows_hold_a_unit_upright_however_far_it_has_folded():
    # Folded by half a turn its panels stand side by side, far from the arms of the flat sheet.
    model = build(replace(HEAVY, stiffness_to_weight=1.0, contraction=0.22), Meshing(COARSE))
    found = reached(model)
    assert angle(found) > np.pi and found.last.topples
    assert counted(model, found.x, 1.0) == 0
    assert counted(model, found.x, 1.0, free=True) == 1


def test_four_classes_have_all_modes_of_the_whole_past_a_twist():
    model = build(P, Meshing(COARSE), Physics((), growth="isotropic"))
    steps = LoadSteps(rtol=1e-6, step=0.1)
    counts = []
    for e in (0.2, 0.45):
        point = trace(
            model.scene,
            np.zeros(model.scene.size),
            steps,
            until=load(e),
            max_steps=50,
            events=False,
        ).last
        assert point.e == e
        checks = Symmetries(model).check(point.x, e)
        assert all(c.held == c.free for c in checks)  # without weight nothing topples
        total = point.unstable + sum(c.held for c in checks)
        assert total == counted(model, point.x, e)
        counts.append({c.kept: c.held for c in checks})
    assert counts[0] == {("turn",): 0, ("x",): 0, ("y",): 0}
    assert counts[1][("turn",)] == 1


def test_a_lost_symmetry_is_named_and_what_comes_after_is_stable():
    model = build(P, Meshing(COARSEST), Physics((), growth="isotropic"))
    found = fold(model, stop=lambda state: len(state.checks) < 4)
    assert found.ending is Ending.STOPPED
    first = found.happenings[0]
    assert first.kind == "twisting" and 0.2 < first.e < 0.4
    assert found.model.mirrors == ("turn",)
    assert all(state.unstable == 0 for state in found.states)
    # The edges of a unit that twists turn against each other.
    edges = found.last.curves[2:]
    assert first.size > 5e-3
    assert np.abs(edges[0][:, 2] - edges[1][:, 2]).max() > 5e-3
    assert edges[0][:, 2] == pytest.approx(edges[1][::-1, 2], abs=1e-12)


@pytest.mark.parametrize("mirrors", [(), ("x",), ("y",), ("turn",)])
def test_a_widened_state_is_the_same_state(mirrors):
    model = build(HEAVY, Meshing(COARSE))
    found = fold(model, stop=lambda state: state.e > 0.3)
    e = found.last.e
    wide, x = model.widened(mirrors, found.x, e)
    share = 2.0 ** (2 - len(mirrors))
    assert wide.scene.energy(x, e) == pytest.approx(share * model.scene.energy(found.x, e))
    R = wide.scene.residual(x, e)
    before = np.abs(model.scene.residual(found.x, e)).max()
    # On a mirror plane the forces of both sides add up.
    assert np.abs(R[: wide.scene.n_free]).max() <= 4 * before + 1e-12 * wide.scene.scales.force
    assert np.abs(R[wide.scene.n_free :]).max(initial=0) < 1e-12
    assert np.abs(wide.curves(x, e) - found.last.curves).max() < 1e-12


def test_a_mesh_of_ones_own_is_not_widened():
    own = unit_mesh.mesh(P, 0, mirrors=("x", "y"))
    model = build(P, Meshing(body=own), Physics(()))
    with pytest.raises(ValueError, match="whole unit"):
        model.widened((), np.zeros(model.scene.size), 0.0)


# -- on the ground -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "unit", [HEAVY, replace(NARROW, stiffness_to_weight=10.0), replace(P, h_ratio=0.3)]
)
def test_at_rest_the_ground_carries_the_weight(unit):
    model = build(unit, Meshing(0))
    found = fold(model, stop=lambda state: True)
    assert found.last.e == 0 and found.last.unstable == 0
    u = model.scene.displacement(found.x, 0.0)
    gravity = next(term for term in model.terms if term.name == "gravity")
    weight = -gravity.weights(0.0)[:, 2].sum()
    up = -model.ground.evaluate(u, 0.0, 1).force[:, 2].sum()
    assert up == pytest.approx(weight, rel=1e-6)
    gaps = model.gaps(found.x, 0.0)
    assert gaps.max() <= 0.25 * unit.slenderness
    assert gaps.min() >= -0.1 * unit.slenderness
    assert gaps.min() == found.last.lowest


def test_a_unit_that_does_not_topple_need_not_be_held():
    unit = replace(HEAVY, stiffness_to_weight=0.02, contraction=0.11)
    quarter = reached(build(unit, Meshing(COARSE)))
    assert not quarter.last.topples
    free = reached(build(unit, Meshing(COARSE), supports=Supports((), upright=False)))
    own = unit.hinge_length
    a, b = (foldability.measure(f.last.curves, own) for f in (quarter, free))
    assert a.hinge > 1
    # Sides of the sheet may touch the ground too: its edge is stiffer there.
    assert list(vars(b).values()) == pytest.approx(list(vars(a).values()), rel=5e-3, abs=1e-3)


def thick_panels(unit, times):
    """A quarter whose panels are ``times`` as thick as its hinge's sheet: all but rigid."""
    h, half = unit.slenderness, unit.hinge_length / 2
    y = [*np.linspace(0, half, 5), *(half + (0.5 - half) * np.array([0.03, 0.1, 0.3, 0.6, 1]))]
    top = h + unit.active
    grid = box(
        [0, unit.aspect / 2],
        y,
        [0, h, top, times * h],
        keep=lambda X: (X[:, 2] < top) | (X[:, 1] > half),
        layers={
            "passive": lambda X: (X[:, 1] > half) | (X[:, 2] < h),
            "active": lambda X: (X[:, 1] < half) & (X[:, 2] > h),
        },
    )
    return Body.build(grid, "hex27", bent=1)


def test_rigid_panels_lift_off_where_the_closed_form_says():
    groups = {
        "E_ratio": 0.1, "rho_ratio": 1e-3, "hinge_length": 0.05, "h_ratio": 1.0, "aspect": 0.02,
        "slenderness": 4e-3, "hinge_width": 1.0, "contraction": 0.15,
    }  # fmt: skip
    times = 5  # as heavy as thick
    least = times * lift_off_stiffness(groups)
    tips = {}
    for share in (0.85, 1.15, 2.0):
        unit = Unit(**groups, stiffness_to_weight=share * least)
        found = reached(build(unit, Meshing(body=thick_panels(unit, times))))
        tips[share] = found.last.tip
        hinge = foldability.measure(found.last.curves, unit.hinge_length).hinge / 2
    assert tips[0.85] < 0.1 * unit.slenderness < unit.slenderness < tips[1.15]
    # Θ₀ − θ = β cos θ with β = Θ₀/2 (references.md §2)
    start = unit.fold_angle / 2
    assert start - hinge == pytest.approx(start / 2 * np.cos(hinge), rel=0.06)
