"""The half of a unit that a half-turn about z makes whole: a twisted unit keeps no mirror plane."""

from dataclasses import replace

import numpy as np
import pytest
from folding_units import COARSEST, HEAVY, P

from foldlab.labels import foldability
from solver.cases.unit.audit import faults
from solver.cases.unit.choices import Meshing, Physics, Supports
from solver.cases.unit.model import build
from solver.cases.unit.output import Shape, write_path
from solver.cases.unit.path import Ending, fold, refined
from solver.cases.unit.strain import strain
from solver.cases.unit.symmetry import Symmetries
from solver.equilibrium.descent import descend
from solver.equilibrium.linear import Factor
from solver.equilibrium.newton import newton
from solver.equilibrium.scene import Scene
from solver.paths.continuation import load, trace
from solver.paths.steppers import LoadSteps

FREE, GROUND = Physics((), growth="isotropic"), Physics(growth="isotropic")


@pytest.fixture(scope="module", params=[FREE, GROUND], ids=["free", "on the ground"])
def twisted(request):
    """A path that twisted, in its first state past e = 0.4."""
    found = fold(
        build(P, Meshing(COARSEST), request.param),
        stop=lambda s: s.e > 0.4 and len(s.checks) == 2,
    )
    assert found.ending is Ending.STOPPED and found.model.mirrors == ("turn",)
    return found


def test_a_twisted_half_is_half_of_the_twisted_whole(twisted):
    half, e = twisted.model, twisted.last.e
    whole, x = half.widened((), twisted.x, e)
    assert whole.scene.size / half.scene.size == pytest.approx(2, rel=0.01)
    found = newton(whole.scene, x, e, rtol=1e-10, max_iterations=5)
    assert found.converged and found.system.unstable == 0
    assert found.system.energy == pytest.approx(2 * twisted.last.energy, rel=1e-9)
    half = newton(half.scene, twisted.x, e, rtol=1e-10, max_iterations=5).x
    curves = [m.curves(y, e) for m, y in ((twisted.model, half), (whole, found.x))]
    one, two = (vars(foldability.measure(c, P.hinge_length)) for c in curves)
    assert one == pytest.approx(two, rel=1e-9)
    assert abs(one["m3"] - 1) > 1e-4  # it is twisted
    assert faults(twisted) == ()


def test_a_state_is_judged_once(monkeypatch):
    model, counted = build(P, Meshing(COARSEST), FREE), []
    symmetries, factorised = Symmetries(model), Scene.factorised

    def counting(self, values):
        counted.append(self)
        return factorised(self, values)

    monkeypatch.setattr(Scene, "factorised", counting)
    x = np.zeros(model.scene.size)
    first = symmetries.check(x, 0.0)
    assert symmetries.check(x, 0.0) == first and len(counted) == 3
    # Another load or other unknowns are another state.
    symmetries.check(x, 0.1)
    symmetries.check(x.copy(), 0.1)
    assert len(counted) == 9
    # And one analysis does for all classes.
    assert len({id(scene.solver) for scene in counted}) == 1


def test_the_rows_of_rotations_do_not_pull_at_what_a_class_holds(monkeypatch):
    model, pulled = build(HEAVY, Meshing(COARSEST), Physics()), []
    start = descend(model.scene, np.zeros(model.scene.size), 0.0, rtol=1e-6)
    symmetries, solve = Symmetries(model), Factor.solve

    def seen(self, b, **options):
        pulled.append(b)
        return solve(self, b, **options)

    monkeypatch.setattr(Factor, "solve", seen)
    symmetries.check(start.x, 0.0)
    held = [symmetries._held[kept] for kept in (("x",), ("y",))]
    assert len(pulled) == 2  # the twist is no rotation that tips it over
    for rows, out in zip(pulled, held, strict=True):
        assert out.any() and not rows[out].any() and rows[~out].any()


def test_its_strain_is_that_of_the_whole(twisted):
    e = twisted.last.e
    whole, x = twisted.model.widened((), twisted.x, e)
    one, two = strain(twisted.model, twisted.x, e), strain(whole, x, e)
    for layer in ("passive", "active"):
        assert vars(getattr(one, layer)) == pytest.approx(vars(getattr(two, layer)), rel=1e-6)
    assert (one.opening, one.shear) == pytest.approx((two.opening, two.shear), rel=1e-6)


@pytest.mark.parametrize("physics", [FREE, GROUND], ids=["free", "on the ground"])
def test_its_two_classes_have_all_modes_of_the_whole(physics):
    """Three of them past the loss of all symmetries; on the ground it may tip besides."""
    model = build(P, Meshing(COARSEST), physics)
    steps = LoadSteps(rtol=1e-6, step=0.1)
    start = np.zeros(model.scene.size)
    seen = []
    for e in (0.3, 0.5, 0.564):
        start = trace(model.scene, start, steps, until=load(e), max_steps=50, events=False).last
        half, x = model.widened(("turn",), start.x, e)
        own = half.scene.system(x, e).unstable
        (odd,) = Symmetries(half).check(x, e)
        whole, there = half.widened((), x, e)
        blocks = whole.scene.evaluate(whole.scene.displacement(there, e), e, 2).stiffness
        assert own + odd.held == whole.scene.system_of(blocks).unstable
        rows = [row for row in whole.scene.rows if row.name[-1] == "z" or row.name[0] == "t"]
        free = whole.scene
        if physics is GROUND:
            free = Scene(whole.body, whole.terms, rows=rows)
        assert own + odd.free == free.system_of(blocks).unstable
        seen.append((own, odd.held, odd.free))
    assert seen[0][:2] == (0, 0) and seen[1][:2] == (1, 0) and min(seen[2]) >= 1
    assert (physics is FREE) == all(held == free for _, held, free in seen)


def test_a_unit_with_its_half_turn_alone_folds_and_topples_like_its_quarter():
    unit = replace(HEAVY, stiffness_to_weight=1.0, contraction=0.22)
    model = build(unit, Meshing(COARSEST), supports=Supports(("turn",)))
    found = fold(model)
    quarter = fold(build(unit, Meshing(COARSEST)))
    assert found.ending is quarter.ending is Ending.REACHED
    assert found.last.topples and found.last.unstable == 0
    ends = [foldability.measure(f.last.curves, unit.hinge_length).m1 for f in (found, quarter)]
    assert ends[0] == pytest.approx(ends[1], rel=1e-6) and ends[0] > np.pi


def test_it_is_refined_and_written_as_a_whole(twisted, tmp_path):
    fine = refined(twisted, 0)
    assert fine is not None and fine.model.mirrors == ("turn",)
    assert np.abs(fine.last.curves - twisted.last.curves).max() < 0.1
    shape = Shape(twisted.model, twisted.x, twisted.last)
    assert write_path(tmp_path / "twisted.pvd", [shape]) == [twisted.last.e]
