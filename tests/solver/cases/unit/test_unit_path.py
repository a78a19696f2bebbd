"""How the path of a folding unit is followed: refined states, deadlines, losses of symmetry."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from folding_units import COARSE, COARSEST, HEAVY, NARROW, P, angle, reached

from foldlab.labels import foldability
from solver.cases.unit import mesh as unit_mesh
from solver.cases.unit import path
from solver.cases.unit.choices import Meshing, Physics, Supports, Watch
from solver.cases.unit.model import build
from solver.cases.unit.output import Shape, write_path
from solver.cases.unit.path import Ending, carried, fold, refined
from solver.cases.unit.symmetry import Check, Symmetries
from solver.cases.unit.unit import EFFECTS, Unit
from solver.equilibrium import clock
from solver.equilibrium.outcome import Outcome
from solver.paths.continuation import trace
from solver.paths.point import Ended
from solver.paths.stability import Event
from solver.paths.stable import StableSteps
from solver.paths.steppers import LoadSteps


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


def test_a_deadline_ends_the_path_with_what_it_has(monkeypatch):
    # A clock that goes on by one at each look: as many evaluations are allowed.
    ticks = itertools.count()
    monkeypatch.setattr(clock, "core_seconds", lambda: next(ticks))
    unit = replace(HEAVY, stiffness_to_weight=1.0)
    plain = fold(build(unit, Meshing(COARSE), watch=Watch(deadline=np.inf)))
    start = next(ticks)
    deadline = start + start // 2
    found = fold(build(unit, Meshing(COARSE), watch=Watch(deadline=deadline)))
    assert found.ending is Ending.TIMEOUT and found.detail == Ending.TIMEOUT.value
    # The first look after the deadline ends it.
    assert next(ticks) == deadline + 2
    loads = [s.e for s in found.states]
    assert 1 < len(loads) < len(plain.states)
    assert loads == [s.e for s in plain.states][: len(loads)]
    assert found.model.curves(found.x, loads[-1]) == pytest.approx(found.last.curves)
    # A refined state has a limit of its own.
    assert refined(plain, 1, deadline=deadline) is None
    assert refined(found, 1) is not None


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

    def whole():
        # Anew for each path: pivots depend on which matrices a scene's solver has met before.
        return build(unit, Meshing(COARSEST), Physics(()), Supports(()))

    steps, arcs = (reached(whole(), noise=(1e-3, 1), arc=arc) for arc in (False, True))
    for found in (steps, arcs):
        assert found.last.e == 1.0 and angle(found) == pytest.approx(want, rel=1e-6)
    assert [s.e for s in arcs.states] != [s.e for s in steps.states]
    again = reached(whole(), noise=(1e-3, 1), arc=True)
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


def test_a_snap_is_told_where_the_fall_after_it_is_tried_again(monkeypatch):
    def check(self, x, e):
        return [Check(("x",), int(e > 0.2), 0)] if len(self.model.mirrors) == 2 else []

    begin, advance, failed = StableSteps.begin, StableSteps.advance, []

    def creeps(self, scene, x, e, sign):
        if e > 0 and not failed:
            failed.append(e)
            return Ended(Outcome.NO_STABLE_STATE)
        return begin(self, scene, x, e, sign)

    def snaps(self, scene, point, target):
        after = advance(self, scene, point, target)
        if not point.e <= 0.2 < after.e:
            return after
        snap = Event("snap", after.e, after.x, after.x - point.x, size=0.1)
        return replace(after, events=(snap,))

    monkeypatch.setattr(Symmetries, "check", check)
    monkeypatch.setattr(StableSteps, "begin", creeps)
    monkeypatch.setattr(StableSteps, "advance", snaps)
    # Of the two losses in this step the model's own is the first.
    monkeypatch.setattr(path._Walk, "_first_lost", lambda self, point: point)
    found = fold(build(P, Meshing(0), Physics(())))
    assert found.ending is Ending.REACHED
    snap, lost = found.happenings
    assert (snap.kind, snap.e, snap.size) == ("snap", failed[0], 0.1)
    assert lost.kind == "rocking" and lost.e > snap.e


def test_a_path_of_as_many_states_as_are_allowed_is_too_long():
    found = fold(build(P, Meshing(COARSEST), Physics(())), max_states=3)
    assert found.ending is Ending.TOO_LONG and found.detail == Ending.TOO_LONG.value
    assert len(found.states) == 3 and found.last.e < 1


def test_a_flat_unit_without_rest_has_no_path(monkeypatch):
    failed = Ended(Outcome.NO_STABLE_STATE)
    monkeypatch.setattr(StableSteps, "begin", lambda self, scene, x, e, sign: failed)
    found = fold(build(HEAVY, Meshing(COARSEST)))
    assert found.ending is Ending.NO_REST and found.detail == Outcome.NO_STABLE_STATE.value
    assert found.states == () and found.x is None
    with pytest.raises(ValueError, match="the path has no states"):
        _ = found.last


def test_arc_length_without_noise_is_refused():
    # It was silently ignored.
    model = build(P, Meshing(0))
    with pytest.raises(ValueError, match="arc=True without noise"):
        fold(model, arc=True)


@pytest.mark.parametrize("turn", [0.3, 0.5, 1.0])
def test_a_symmetry_is_left_by_the_class_that_is_lost_first_whatever_the_step(turn):
    # Twisting, sideways and, in the quarter itself, a symmetric mode are lost one soon after the
    # other: between 0.196 and 0.28 of the contraction.
    unit = Unit(
        E_ratio=747.0, rho_ratio=0.318, hinge_length=0.0528, hinge_width=0.972, h_ratio=6.15,
        stiffness_to_weight=0.504, aspect=0.529, slenderness=0.0072, contraction=0.0763,
    )  # fmt: skip
    model = build(unit, Meshing(COARSEST, curls=True), Physics(growth="isotropic"))
    folding = fold(model, turn=turn, stop=lambda state: state.e > 0.25)
    assert [h.kind for h in folding.happenings] == ["twisting"]
    assert 0.19 < folding.happenings[0].e < 0.22
    assert folding.last.unstable == 0


def test_a_release_is_written_after_the_contraction_that_it_follows(tmp_path):
    first = fold(build(NARROW, Meshing(level=0, curls=True), Physics(effects=())))
    later = replace(first.model, physics=replace(first.model.physics, growth="release"))
    half = replace(first.last, e=0.5)
    shapes = [Shape(first.model, first.x, first.last), Shape(later, first.x, half)]
    assert [shape.load for shape in shapes] == [1.0, 1.5]
    assert write_path(tmp_path / "unit.pvd", shapes) == [1.0, 1.5]
    # A path that is written anew leaves none of the states that were there.
    assert write_path(tmp_path / "unit.pvd", shapes[:1]) == [1.0]
