"""Materials that change as the active layer contracts (§4.8.4), and weights that are uneven.

An elastic state does not remember on what way it was reached: it is that of a unit which has the
last materials from the start.
"""

from dataclasses import replace

import numpy as np
import pytest
from folding_units import HEAVY, P, angle, reached

from foldlab.labels import foldability
from solver.cases.unit.audit import audit
from solver.cases.unit.choices import Changes, Meshing, Physics, Supports
from solver.cases.unit.model import build, uneven
from solver.cases.unit.path import fold
from solver.paths.continuation import trace
from solver.paths.steppers import LoadSteps


def folded(unit, effects=(), **choices):
    return angle(reached(build(unit, Meshing(0), Physics(effects, **choices))))


def test_stiffness_of_either_layer_acts():
    want = folded(replace(P, E_ratio=0.2))
    assert abs(folded(P) - want) > 0.1
    for factor in (lambda e: 2.0, lambda e: 1 + e):
        assert folded(P, active=Changes(factor)) == pytest.approx(want, rel=1e-6)
    # Half of E_s under twice the ratio.
    softer = Changes(lambda e: 1 - e / 2)
    assert folded(P, passive=softer) == pytest.approx(want, rel=1e-6)


def bent(unit, **choices):
    """Fold angle of the quarter, whatever its stability."""
    model = build(unit, Meshing(0, curls=False), Physics((), "isotropic", **choices))
    path = trace(
        model.scene, np.zeros(model.scene.size), LoadSteps(rtol=1e-9, step=0.25), max_steps=50
    )
    assert path.last.e == 1
    return foldability.measure(model.curves(path.last.x, 1.0), unit.hinge_length).m1


def test_a_sheet_that_grows_as_well_is_a_larger_unit_with_more_contraction():
    small, grown = replace(P, contraction=0.02), 0.02
    want = bent(replace(P, contraction=1 - 0.98 / (1 + grown)))
    found = bent(small, passive=Changes(expansion=lambda e: grown * e))
    assert abs(want - bent(small)) > 0.02
    assert found == pytest.approx(want, rel=1e-5)


def test_a_layer_grows_only_where_the_other_contracts():
    physics = Physics((), "uniaxial", passive=Changes(expansion=lambda e: 0.1 * e))
    model = build(P, Meshing(0), physics)
    (elastic,) = model.terms
    inverse, J = elastic.growth.evaluate(1.0, model.body.weights.shape)
    active = model.body.cells_of("active")
    assert np.allclose(J[active], 1 - P.contraction)
    assert np.allclose(J[~active], 1.1)
    assert np.allclose(inverse[~active][:, :, 0, 0], 1)


def test_what_the_active_layer_takes_up_counts_against_its_contraction():
    found = folded(P, active=Changes(expansion=lambda e: 0.1 * e))
    want = folded(replace(P, contraction=P.contraction - 0.1))
    assert found == pytest.approx(want, rel=2e-5)  # on other steps, each to the tolerance


def test_the_ground_bears_the_most_that_the_hinge_weighs_on_the_way():
    def pressing(course):
        """What the flat unit presses with, where it touches."""
        changes = Changes(density=course)
        model = build(HEAVY, Meshing(0), Physics(active=changes, passive=changes), Supports(()))
        return model.ground.pressing(np.zeros_like(model.body.nodes)).sum()

    steady = pressing(None)
    assert pressing(lambda e: 1 - 0.9 * e) == pytest.approx(steady)
    assert pressing(lambda e: 1 + 2 * e) == pytest.approx(3 * steady)


def test_density_of_each_layer_acts_on_its_own_cells():
    heavier = {"active": Changes(density=lambda e: 1 + 2 * e)}
    lighter = {"passive": Changes(density=lambda e: 1 - e / 2)}
    model = build(HEAVY, Meshing(0), Physics(**heavier, **lighter), Supports(()))
    gravity = next(t for t in model.terms if t.name == "gravity")
    u = HEAVY
    hinge = u.hinge_length * u.width
    sheet = u.slenderness * (hinge + (1 - u.hinge_length) * u.aspect)
    for e in (0.0, 0.5, 1.0):
        want = (1 - e / 2) * sheet + (1 + 2 * e) * u.rho_ratio * hinge * u.active
        assert gravity.weights(e).sum() == pytest.approx(-u.weight * want)


def test_weight_that_grows_on_the_way_ends_as_weight_that_was_there():
    heavy = replace(HEAVY, contraction=0.1)
    light = replace(heavy, stiffness_to_weight=2 * HEAVY.stiffness_to_weight)
    mesh = Meshing(body=build(heavy, Meshing(0)).body)
    doubling = Changes(density=lambda e: 1 + e)
    want, still, found = (
        angle(reached(build(unit, mesh, Physics(active=change, passive=change))))
        for unit, change in ((heavy, Changes()), (light, Changes()), (light, doubling))
    )
    assert abs(want - still) > 1
    assert found == pytest.approx(want, rel=1e-4)


def test_an_audit_refuses_materials_that_it_does_not_know():
    model = build(P, Meshing(0), Physics((), passive=Changes(lambda e: 1 + e)))
    with pytest.raises(ValueError, match="materials that last"):
        audit(model, np.zeros(model.scene.size), 0.0)


def test_noise_makes_weights_uneven_by_as_much_as_it_says():
    model = build(HEAVY, Meshing(0), supports=Supports(()))
    noisy = uneven(1e-2, model.watch)(model.scene, np.random.default_rng(3))
    own, other = (next(t for t in s.terms if t.name == "gravity") for s in (model.scene, noisy))
    factors = other.density / own.density
    assert 0.009 < np.abs(factors - 1).max() <= 0.01
    assert abs(factors.mean() - 1) < 2e-3
    assert [t.name for t in noisy.terms] == [t.name for t in model.scene.terms]


def test_a_noisy_path_has_uneven_weights_anew_in_every_step(monkeypatch):
    drawn = []

    def recorded(amplitude, watch):
        draw = uneven(amplitude, watch)
        assert amplitude == 1e-2

        def scene(given, rng):
            drawn.append(draw(given, rng))
            return drawn[-1]

        return scene

    monkeypatch.setattr("solver.cases.unit.path.uneven", recorded)
    whole = build(replace(HEAVY, contraction=0.02), Meshing(0), supports=Supports(()))
    fold(whole, noise=(1e-2, 1), max_states=4)
    weights = [next(t for t in s.terms if t.name == "gravity").density for s in drawn]
    assert len(weights) >= 2 and np.abs(weights[0] - weights[1]).max() > 1e-3
    fold(build(P, Meshing(0), Physics(()), Supports(())), noise=(1e-2, 1), max_states=2)
    assert len(drawn) == len(weights)
