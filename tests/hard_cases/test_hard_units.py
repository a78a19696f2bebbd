"""Folding units: axes that change, held upright past the vertical, threads, seeds, endings."""

from dataclasses import replace

import numpy as np
import pytest
from hard_scenes import COARSE, P, fold_angle, reached
from threadpoolctl import threadpool_info, threadpool_limits

from solver.cases.unit import path as unit_path
from solver.cases.unit.audit import audit
from solver.cases.unit.choices import Meshing, Physics, Supports
from solver.cases.unit.model import build, images
from solver.cases.unit.path import Ending, fold
from solver.equilibrium.clock import OutOfTime
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.paths.continuation import trace
from solver.paths.point import Ended
from solver.paths.stable import StableSteps
from solver.paths.steppers import LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.growth import General
from solver.physics.materials import NeoHookean
from solver.physics.supports import rotation_row, translation_row

# -- axes ----------------------------------------------------------------------------------------


def test_curling_that_turns_its_axis_by_a_right_angle():
    """A free square plate whose natural cylinder turns from one axis to the other: free of stress
    at every load (1e-3 of the unrelaxed energy), and the end is the start turned by 90°."""
    h, n, kappa = 0.05, 5, 0.3
    s = np.linspace(-0.5, 0.5, n + 1)
    body = Body.build(box(s, s, [-h / 2, h / 2]), "hex27")
    z = body.points()[..., 2]

    def tensor(e):
        axis = np.array([np.cos(e * np.pi / 2), np.sin(e * np.pi / 2), 0])
        return np.eye(3) - kappa * z[..., None, None] * np.outer(axis, axis)

    rows = [make(body, k) for make in (translation_row, rotation_row) for k in range(3)]
    scene = Scene(body, [Elastic(body, NeoHookean(1.0, 0.3), General(tensor))], rows=rows)
    flat = np.zeros(scene.size)
    unrelaxed = scene.energy(flat, 0.0)
    stepper = StableSteps(LoadSteps(rtol=1e-8, step=0.125), locate=False)
    path = trace(scene, flat, stepper, max_steps=60, events=False)
    assert path.reached and {p.unstable for p in path.points} == {0}
    assert max(p.energy for p in path.points) < 1e-3 * unrelaxed
    start, end = (scene.displacement(path.points[k].x, path.points[k].e) for k in (0, -1))
    turn = np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]])
    X = body.nodes
    there = np.array([np.argmin(np.abs(X - p).sum(axis=1)) for p in X @ turn.T])
    assert np.abs(start[:, 2]).max() > 0.02
    assert np.abs(end[there] - start @ turn.T).max() < 1e-6


# -- held upright --------------------------------------------------------------------------------


def test_rows_of_the_flat_sheet_are_blind_where_panels_stand_up_and_anchored_ones_are_not():
    """Folded by 3.7 rad, a whole unit held by rows with the flat sheet's arms has an unstable mode
    that it does not have: tipping over. Rows anchored in the state hold it."""
    unit, e = replace(P, contraction=0.288), 1.0
    quarter = build(unit, Meshing(COARSE))
    found = reached(quarter)
    assert 3.7 < fold_angle(found) < 3.8 and found.last.topples
    model = build(unit, Meshing(COARSE), supports=Supports(()))
    near, signs = images(quarter.body, model.body, ("x", "y"))
    x = model.scene.unknowns(signs * quarter.scene.displacement(found.x, e)[near])
    assert model.scene.system(x, e).unstable == 1
    held = model.anchored(x, e)
    assert held is not model and held.anchored(x, e) is held
    assert held.scene.system(x, e).unstable == 0
    assert np.abs(held.scene.residual(x, e)[held.scene.n_free :]).max() < 1e-12


def test_a_unit_without_its_mirror_planes_folds_past_the_vertical_like_its_quarter():
    """Half a unit with rows on its rotation, in steps of 0.15 rad past the place where flat arms
    are blind: no snap, and the quarter's angle and energy (1e-6). It used to fall over there."""
    unit = replace(P, contraction=0.31)
    quarter = reached(build(unit, Meshing(COARSE)))
    found = reached(build(unit, Meshing(COARSE), supports=Supports(("x",))), turn=0.15)
    assert fold_angle(quarter) > 3.85
    assert fold_angle(found) == pytest.approx(fold_angle(quarter), rel=1e-6)
    assert 2 * found.last.energy == pytest.approx(4 * quarter.last.energy, rel=1e-6)
    assert [h.kind for h in found.happenings] == ["toppling"]


@pytest.mark.parametrize("mirrors", [("x", "y"), ("x",), ("y",), ()])
def test_toppling_is_told_whatever_the_model_has_left_of_its_symmetry(mirrors):
    """Quarter, halves and whole say alike that the folded unit would tip over, and the second code
    path counts the same mode."""
    unit = replace(P, hinge_length=0.25, stiffness_to_weight=0.1, contraction=0.12)
    found = reached(build(unit, Meshing(COARSE), supports=Supports(mirrors)))
    seen = audit(found.model, found.x, 1.0)
    assert (seen.held, seen.free) == (0, 1)
    assert found.last.topples and found.last.unstable == 0


# -- reproducibility -----------------------------------------------------------------------------


def test_one_and_two_threads_fold_alike():
    """The same heavy unit on one thread and on two: curves agree to 1e-8 of the sheet's length, and
    so do the loads of all states."""
    curves = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            used = {i["num_threads"] for i in threadpool_info() if i["internal_api"] == "mkl"}
            assert used <= {threads}
            curves.append([(s.e, s.curves) for s in reached(build(P, Meshing(COARSE))).states])
    assert len(curves[0]) == len(curves[1])
    for (e, one), (f, two) in zip(*curves, strict=True):
        assert e == pytest.approx(f, abs=1e-12)
        assert np.abs(one - two).max() < 1e-8


def test_noise_of_a_seed_reproduces_and_its_answer_does_not_depend_on_it():
    """A whole weightless unit with noise: one seed twice is the same to the last digit, another
    seed takes other states to the same fold angle (1e-6), that of the quarter without noise."""
    unit = replace(P, contraction=0.06)
    want = fold_angle(reached(build(unit, Meshing(COARSE), Physics(()))))
    runs = []
    for seed in (1, 1, 2):
        found = fold(build(unit, Meshing(COARSE), Physics(()), Supports(())), noise=(1e-3, seed))
        assert found.ending is Ending.REACHED and found.last.unstable == 0
        assert fold_angle(found) == pytest.approx(want, rel=1e-6)
        runs.append(found)
    one, again, other = runs
    assert np.array_equal(one.x, again.x)
    assert [s.energy for s in one.states] == [s.energy for s in again.states]
    assert not np.array_equal(one.x, other.x)


# -- endings -------------------------------------------------------------------------------------


class _Ends:
    """A stepper's ``advance`` that fails at its n-th call."""

    def __init__(self, n, how):
        self.n, self.how, self.own = n, how, StableSteps.advance

    def __call__(self, stepper, *args):
        self.n -= 1
        if self.n:
            return self.own(stepper, *args)
        if isinstance(self.how, Outcome):
            return Ended(self.how)
        raise self.how


@pytest.mark.parametrize(
    "how, ending",
    [(Outcome.NO_PROGRESS, Ending.LOST), (OutOfTime(), Ending.TIMEOUT), (None, Ending.REACHED)],
)
def test_before_is_the_state_before_the_last_however_a_path_ends(how, ending, monkeypatch):
    """After LOST, TIMEOUT and REACHED alike ``Folding.x`` belongs to the last state and
    ``Folding.before`` to the one before it. After a failure both used to be the last."""
    if how is not None:
        ends = _Ends(4, how)
        monkeypatch.setattr(unit_path.StableSteps, "advance", lambda *args: ends(*args))
    found = fold(build(replace(P, contraction=0.1), Meshing(COARSE), Physics(())))
    assert found.ending is ending and len(found.states) >= 4
    assert found.model.curves(found.x, found.last.e) == pytest.approx(found.last.curves)
    model, x = found.before
    earlier = found.states[-2]
    assert model.curves(x, earlier.e) == pytest.approx(earlier.curves)
    assert np.abs(found.last.curves - earlier.curves).max() > 1e-3


def test_a_path_that_ends_at_its_first_state_has_nothing_before(monkeypatch):
    """A path that fails at its first step: one state, its unknowns, and no state before."""
    monkeypatch.setattr(unit_path.StableSteps, "advance", lambda *_: Ended(Outcome.NO_PROGRESS))
    found = fold(build(P, Meshing(COARSE), Physics(())))
    assert found.ending is Ending.LOST and len(found.states) == 1
    assert found.x is not None and found.before is None
