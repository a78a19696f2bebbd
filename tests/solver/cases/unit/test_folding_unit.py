"""The folding unit: its geometry, weight, symmetries, and the path it takes.

Problem P is a unit without weight, on whose angles two independent codes agree within 0.1 %.
"""

import time
from dataclasses import replace

import numpy as np
import pytest

from foldlab.labels import foldability
from foldlab.labels.timoshenko import lift_off_stiffness
from solver.cases.unit import mesh as unit_mesh
from solver.cases.unit.choices import Meshing, Physics, Supports, Watch
from solver.cases.unit.model import build
from solver.cases.unit.path import Ending, carried, fold, refined
from solver.cases.unit.symmetry import Check, Symmetries
from solver.cases.unit.unit import EFFECTS, Unit
from solver.equilibrium.newton import Outcome
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.paths.continuation import load, trace
from solver.paths.point import Ended
from solver.paths.stable import StableSteps
from solver.paths.steppers import LoadSteps

P = Unit(
    E_ratio=0.1, rho_ratio=1.0, hinge_length=0.2, hinge_width=1.0, h_ratio=5.0,
    stiffness_to_weight=1.0, aspect=0.2, slenderness=4e-3, contraction=0.3,
)  # fmt: skip
HEAVY = replace(P, hinge_length=0.25, stiffness_to_weight=0.1)
NARROW = replace(P, hinge_width=0.4, h_ratio=0.7, aspect=0.3, rho_ratio=2.0)
STRIPED = replace(P, hinge_width=0.8, strips=3, strip_share=0.6)
PLANES = ((), ("x",), ("y",), ("x", "y"))
COARSE = unit_mesh.Sizes(0.5, 3, 1.6, 0.0, 3.0, 1)
COARSEST = unit_mesh.Sizes(2.5, 6, 2.0, 0.0, 6.0, 1)


def angle(folding):
    last = folding.last
    return foldability.measure(last.curves, folding.model.unit.hinge_length).m1


def reached(model, **options):
    found = fold(model, **options)
    assert found.ending is Ending.REACHED, found.detail
    assert found.last.unstable == 0
    return found


# -- geometry ------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [P, NARROW, STRIPED, replace(STRIPED, strips=2)])
@pytest.mark.parametrize("mirrors", PLANES)
@pytest.mark.parametrize("level", [0, 2])
def test_layers_have_the_volumes_of_the_groups(unit, mirrors, level):
    body = unit_mesh.mesh(unit, level, mirrors=mirrors)
    share = 0.5 ** len(mirrors)
    hinge = unit.hinge_length * unit.hinge_width * unit.aspect
    covered = unit.strip_share if unit.strips else 1.0
    active, passive = body.cells_of("active"), body.cells_of("passive")
    assert not (active & passive).any() and (active | passive).all()
    assert body.weights[active].sum() == pytest.approx(
        share * hinge * covered * unit.h_ratio * unit.slenderness
    )
    assert body.weights[passive].sum() == pytest.approx(
        share * unit.slenderness * (hinge + (1 - unit.hinge_length) * unit.aspect)
    )
    low, high = body.nodes.min(axis=0), body.nodes.max(axis=0)
    assert high == pytest.approx([unit.aspect / 2, 0.5, (1 + unit.h_ratio) * unit.slenderness])
    assert low == pytest.approx(
        [0 if "x" in mirrors else -unit.aspect / 2, 0 if "y" in mirrors else -0.5, 0]
    )


@pytest.mark.parametrize("unit", [P, NARROW])
def test_meshes_conform(unit):
    # Faces that do not match would be boundary inside of the body.
    body = unit_mesh.mesh(unit, 1, mirrors=())
    area = body.surface(body.mesh.boundary_facets()).weights.sum()
    b_s, b_i, l_i = unit.aspect, unit.width, unit.hinge_length
    h, top = unit.slenderness, unit.active
    flat = 2 * (b_s * (1 - l_i) + b_i * l_i)
    panels = 2 * (2 * (b_s + (1 - l_i) / 2) - b_i) * h
    assert area == pytest.approx(flat + panels + 2 * l_i * h + 2 * (l_i + b_i) * top)


def test_strips_have_free_sides():
    solid = unit_mesh.mesh(replace(STRIPED, strips=0), 1, mirrors=())
    body = unit_mesh.mesh(STRIPED, 1, mirrors=())
    area, before = (b.surface(b.mesh.boundary_facets()).weights.sum() for b in (body, solid))
    n, l_i, top = STRIPED.strips, STRIPED.hinge_length, STRIPED.active
    # n strips have 2n long sides in place of 2; of the ends only the covered share is left.
    ends = 2 * (1 - STRIPED.strip_share) * STRIPED.width * top
    assert area - before == pytest.approx((2 * n - 2) * l_i * top - ends)


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


@pytest.mark.parametrize("mirrors", PLANES[:3])
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


def test_stiffening_acts():
    want = angle(reached(build(replace(P, E_ratio=0.2), Meshing(0), Physics(()))))
    plain = angle(reached(build(P, Meshing(0), Physics(()))))
    assert abs(plain - want) > 0.1
    for factor in (lambda e: 2.0, lambda e: 1 + e):
        # An elastic state does not remember on what way it was reached.
        found = reached(build(P, Meshing(0), Physics((), stiffening=factor)))
        assert angle(found) == pytest.approx(want, rel=1e-6)


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
        ("x", "y"): (0, 0), ("y",): (0, 0), ("x",): (0, 1), (): (0, 0),
    }  # fmt: skip
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
            model.scene, np.zeros(model.scene.size), steps, until=load(e), max_steps=50,
            events=False,
        ).last  # fmt: skip
        assert point.e == e
        checks = Symmetries(model).check(point.x, e)
        assert all(c.held == c.free for c in checks)  # without weight nothing topples
        total = point.unstable + sum(c.held for c in checks)
        assert total == counted(model, point.x, e)
        counts.append({c.kept: c.held for c in checks})
    assert counts[0] == {(): 0, ("x",): 0, ("y",): 0}
    assert counts[1][()] == 1


def test_a_lost_symmetry_is_named_and_what_comes_after_is_stable():
    model = build(P, Meshing(COARSEST), Physics((), growth="isotropic"))
    found = fold(model, stop=lambda state: len(state.checks) < 4)
    assert found.ending is Ending.STOPPED
    first = found.happenings[0]
    assert first.kind == "twisting" and 0.2 < first.e < 0.4
    assert found.model.mirrors == ()
    assert all(state.unstable == 0 for state in found.states)
    # The edges of a unit that twists turn against each other.
    edges = found.last.curves[2:]
    assert first.size > 5e-3
    assert np.abs(edges[0][:, 2] - edges[1][:, 2]).max() > 5e-3
    assert edges[0][:, 2] == pytest.approx(edges[1][::-1, 2], abs=1e-4)


@pytest.mark.parametrize("mirrors", PLANES[:3])
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
        [0, unit.aspect / 2], y, [0, h, top, times * h],
        keep=lambda X: (X[:, 2] < top) | (X[:, 1] > half),
        layers={
            "passive": lambda X: (X[:, 1] > half) | (X[:, 2] < h),
            "active": lambda X: (X[:, 1] < half) & (X[:, 2] > h),
        },
    )  # fmt: skip
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


# -- how it is followed --------------------------------------------------------------------------


@pytest.mark.parametrize("effects", [(), EFFECTS])
def test_a_refined_state_is_the_end_of_the_path_on_that_mesh(effects):
    unit = replace(HEAVY, stiffness_to_weight=1.0, contraction=0.2)
    coarse = reached(build(unit, Meshing(0), Physics(effects)))
    fine = refined(coarse, 1)
    path = reached(build(unit, Meshing(1), Physics(effects)))
    assert abs(angle(coarse) - angle(path)) > 1e-4
    assert angle(fine) == pytest.approx(angle(path), rel=1e-5)
    assert fine.model.scene.size == path.model.scene.size
    assert fine.iterations < 0.7 * path.iterations


def test_a_state_that_went_elsewhere_is_not_taken_for_the_refined_one():
    coarse = reached(build(replace(P, contraction=0.02), Meshing(0), Physics(())))
    last = coarse.last

    def claimed(**changes):
        return replace(coarse, states=(*coarse.states[:-1], replace(last, **changes)))

    aside = np.array([0.0, 0.0, 1.0])
    assert refined(claimed(curves=last.curves + 0.09 * aside), 1) is not None
    assert refined(claimed(curves=last.curves + 0.11 * aside), 1) is None
    assert refined(claimed(checks=(Check((), 1, 1),)), 1) is None


def test_a_carried_state_is_lifted_off_the_floor_as_a_whole():
    model = build(HEAVY, Meshing(0))
    depth = model.ground.depth
    sag = np.zeros_like(model.body.nodes)
    sag[:, 2] = -0.5 * depth * np.cos(np.pi * model.body.nodes[:, 1])
    for sunk, lift in ((0.0, 0.0), (0.3 * depth, 0.0), (2.0 * depth, 1.6 * depth)):
        x = model.scene.unknowns(sag - [0, 0, sunk])
        fine, start = carried(model, x, 0.0, meshing=Meshing(1))
        u = fine.scene.displacement(start, 0.0)
        want = -0.5 * depth * np.cos(np.pi * fine.body.nodes[:, 1]) - sunk + lift
        assert u[:, 2] == pytest.approx(want, abs=0.02 * depth)
        assert fine.gaps(start, 0.0).min() > -0.91 * depth
        assert np.isfinite(fine.scene.energy(start, 0.0))


def test_a_mesh_of_ones_own_is_refined_to_the_level_that_is_asked_for():
    own = unit_mesh.mesh(P, 0, mirrors=("x", "y"))
    found = reached(build(replace(P, contraction=0.1), Meshing(body=own), Physics(())))
    assert len(refined(found, 1).model.body.nodes) > len(own.nodes)


def test_a_deadline_ends_the_path_with_what_it_has():
    begun = time.monotonic()
    model = build(HEAVY, Meshing(1), supports=Supports(()), watch=Watch(deadline=begun + 1.0))
    found = fold(model)
    assert time.monotonic() - begun < 2.5
    assert found.ending is Ending.TIMEOUT
    assert refined(found, 2, deadline=begun) is None if found.states else found.x is None


def test_a_fold_stays_when_it_is_released_to_contract_in_all_directions():
    # Within quarter symmetry: about 3.3 rad at g = −0.2, by another code; from flat 0.5.
    unit = replace(P, contraction=0.2)
    first = reached(build(unit, Meshing(COARSE, curls=True), Physics(())))
    release = build(unit, Meshing(COARSE), Physics((), growth="release"))
    steps = LoadSteps(rtol=1e-6, step=0.1)
    path = trace(release.scene, first.x, steps, max_steps=60, events=False)
    assert path.reached and path.last.unstable == 0
    m = foldability.measure(release.curves(path.last.x, 1.0), unit.hinge_length)
    assert m.m1 == pytest.approx(3.3, rel=0.05)


def test_a_path_that_ends_while_it_loses_a_symmetry_ends_in_its_last_state(monkeypatch):
    begin = StableSteps.begin

    def lost(self, scene, x, e, sign):
        return begin(self, scene, x, e, sign) if e == 0 else Ended(Outcome.NO_STABLE_STATE)

    monkeypatch.setattr(StableSteps, "begin", lost)
    found = fold(build(P, Meshing(COARSEST), Physics((), growth="isotropic")))
    assert found.ending is Ending.LOST and found.detail == Outcome.NO_STABLE_STATE.value
    assert found.model.mirrors == ("x", "y")
    assert found.model.curves(found.x, found.last.e) == pytest.approx(found.last.curves)


def test_a_noisy_path_on_arc_length_lands_on_the_contraction():
    unit = replace(P, contraction=0.06)
    want = angle(reached(build(unit, Meshing(COARSEST), Physics(()))))
    whole = build(unit, Meshing(COARSEST), Physics(()), Supports(()))
    steps, arcs = (reached(whole, noise=(1e-3, 1), arc=arc) for arc in (False, True))
    for found in (steps, arcs):
        assert found.last.e == 1.0 and angle(found) == pytest.approx(want, rel=1e-6)
    assert [s.e for s in arcs.states] != [s.e for s in steps.states]
    again = reached(whole, noise=(1e-3, 1), arc=True)
    assert np.array_equal(again.x, arcs.x)


@pytest.mark.parametrize("failures", [1, 3])
def test_a_fall_that_finds_no_end_is_tried_again_a_step_on(monkeypatch, failures):
    """Close beyond the loss of a symmetry the fall creeps; the unit was called lost there."""

    def check(self, x, e):
        return [Check(("x",), int(e > 0.2), 0)] if len(self.model.mirrors) == 2 else []

    monkeypatch.setattr(Symmetries, "check", check)
    plain = reached(build(P, Meshing(0), Physics(())))
    begin, failed = StableSteps.begin, []

    def creeps(self, scene, x, e, sign):
        if e > 0 and len(failed) < failures:
            failed.append(e)
            return Ended(Outcome.NO_STABLE_STATE)
        return begin(self, scene, x, e, sign)

    monkeypatch.setattr(StableSteps, "begin", creeps)
    found = fold(build(P, Meshing(0), Physics(())))
    loads = [s.e for s in found.states]
    assert not set(failed) & set(loads) and sorted(failed) == failed
    if failures > 2:
        # Patience ends; what was reached before is kept, and the quarter that it was reached on.
        assert found.ending is Ending.LOST and loads[-1] < failed[0]
        assert found.model.mirrors == ("x", "y")
        return
    assert found.ending is Ending.REACHED
    (lost,) = found.happenings
    assert lost.kind == "rocking" and lost.e > failed[0] > plain.happenings[0].e - 1e-12
    assert angle(found) == pytest.approx(angle(plain), rel=1e-6)


def test_arc_length_without_noise_is_refused():
    # It was silently ignored.
    model = build(P, Meshing(0))
    with pytest.raises(ValueError, match="arc=True without noise"):
        fold(model, arc=True)
