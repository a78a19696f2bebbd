"""Springs and dashpots: the contract of the term, its limits, and its history."""

import numpy as np
import pytest
from proofs import BODIES, prove, state
from pytest import approx
from viscous_references import TREES

import solver.viscous.term
from solver.output import cell_fields
from solver.physics.elastic import Elastic
from solver.physics.fields import Unphysical
from solver.physics.growth import General, Isotropic, Orthotropic
from solver.physics.materials import NeoHookean
from solver.viscous.kernel import nine, six
from solver.viscous.rheology import (
    SLS,
    Dashpot,
    GeneralisedMaxwell,
    KelvinVoigt,
    Maxwell,
    Parallel,
    Series,
    Spring,
    branches,
    times,
)
from solver.viscous.term import Increment, Memory, Past, Viscous


def growth(body):
    half = body.cells_where(lambda X: X[:, 1] < 0.75)
    return Orthotropic((0.1, lambda e: -0.3 * e, lambda e, X: 0.2 * e * X[..., 0]), cells=half)


def history(body, tree, grown=None):
    """A step of first and one of second order after two steps through rough states."""
    first = Viscous(body, tree, grown, dt=0.08)
    a = first.memory(state(body, seed=4, size=0.1), 0.3)
    second = Viscous(body, tree, grown, dt=0.1, before=a)
    b = second.memory(state(body, seed=5, size=0.1), 0.4)
    third = Viscous(body, tree, grown, dt=0.12, before=b, earlier=a, last_dt=0.1)
    return second, third


@pytest.mark.parametrize("name", TREES)
def test_derivatives(name):
    body = BODIES["hex8"]
    for term in history(body, TREES[name], growth(body)):
        prove(term, state(body), 0.7)


def test_derivatives_on_other_elements_and_in_parts():
    tree = SLS(lambda e: 1 + e, lambda e, X: 1 + X[..., 0], 0.3, lambda e: 0.5 + e)
    for element in ("hex27", "tet10"):
        body = BODIES[element]
        prove(Viscous(body, tree, growth(body), dt=0.1), state(body), 0.7)
    left = body.cells_where(lambda X: X[:, 0] < 0.5)
    u = state(body)
    whole = Viscous(body, tree, dt=0.1).evaluate(u, 0.5)
    parts = [Viscous(body, tree, dt=0.1, cells=mask) for mask in (left, ~left)]
    for part in parts:
        prove(part, u, 0.5)
    found = [part.evaluate(u, 0.5) for part in parts]
    np.testing.assert_allclose(sum(f.force for f in found), whole.force, atol=1e-13)
    # Cells that a term leaves out remember nothing new.
    memory = parts[0].memory(u, 0.5)
    assert (memory.strains[~left] == parts[0].past.before.strains[~left]).all()
    assert (memory.strains[left] != parts[0].past.before.strains[left]).any()


@pytest.mark.parametrize("name", [name for name in TREES if branches(TREES[name])])
def test_compiled_branches_agree_with_the_tree(name, monkeypatch):
    tree, body = TREES[name], BODIES["hex8"]
    fast = history(body, tree, growth(body))
    monkeypatch.setattr(solver.viscous.term, "branches", lambda tree: None)
    slow = history(body, tree, growth(body))
    u = state(body)
    for a, b in zip(fast, slow, strict=True):
        mine, other = a.evaluate(u, 0.7), b.evaluate(u, 0.7)
        assert mine.energy == approx(other.energy, rel=1e-12)
        np.testing.assert_allclose(mine.force, other.force, atol=1e-12 * np.abs(mine.force).max())
        scale = np.abs(mine.stiffness).max()
        np.testing.assert_allclose(mine.stiffness, other.stiffness, atol=1e-8 * scale)
        # Their own choice of branches is made when memories are taken.
        assert a.material._branches is not None and b.material._branches is None


@pytest.mark.parametrize("name", TREES)
def test_rigid_motion_and_growth(name):
    body = BODIES["hex8"]
    term = history(body, TREES[name], growth(body))[1]
    u = state(body)
    x, at = body.nodes + u, term.evaluate(u, 0.7, 1)
    size = np.abs(at.force).max()
    Q, _ = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))
    Q *= np.sign(np.linalg.det(Q))
    turned = term.evaluate(x @ Q.T + np.array([3, -1, 2]) - body.nodes, 0.7, 1)
    assert turned.energy == approx(at.energy, rel=1e-10)
    np.testing.assert_allclose(turned.force, at.force @ Q.T, atol=1e-10 * size)
    # Growth of all of a free body at rest stresses nothing, whatever its rotation.
    Fg = Q @ (np.eye(3) + Q.T @ np.diag((-0.3, 0.2, 0.5)) @ Q)
    free = Viscous(body, TREES[name], General(Fg), dt=0.1)
    assert np.abs(free.evaluate(body.nodes @ (Fg.T - np.eye(3)), 0.0).force).max() < 1e-9
    assert np.abs(free.evaluate(np.zeros_like(body.nodes), 0.0).force).max() > 1e-2


@pytest.mark.parametrize("dt, E", [(1e9, 1.0), (1e-9, 3.0)])
def test_slow_and_fast_steps_are_elastic(dt, E):
    body, u = BODIES["hex8"], state(BODIES["hex8"], noise=0)
    grown = Isotropic(lambda e: -0.2 * e)
    mine = Viscous(body, SLS(1.0, 2.0, 0.3, 0.7), grown, dt=dt).evaluate(u, 0.5)
    elastic = Elastic(body, NeoHookean(E, 0.3), grown).evaluate(u, 0.5)
    np.testing.assert_allclose(mine.force, elastic.force, atol=1e-6)
    np.testing.assert_allclose(mine.stiffness, elastic.stiffness, atol=1e-5)
    assert mine.energy == approx(elastic.energy, rel=1e-6)


def test_stress_is_written_out_as_of_an_elastic_term():
    body, u = BODIES["hex8"], state(BODIES["hex8"], noise=0)
    slow = Viscous(body, SLS(1.0, 2.0, 0.3, 0.7), dt=1e9)
    mine, other = (
        cell_fields(body, u, [term], 0.0)["cauchy"]
        for term in (slow, Elastic(body, NeoHookean(1.0, 0.3)))
    )
    np.testing.assert_allclose(mine, other, atol=1e-6)
    fast = cell_fields(body, u, [slow.stepped(Past(slow.past.before, 1e-9))], 0.0)["cauchy"]
    np.testing.assert_allclose(fast, 3 * other, atol=1e-6)


def test_equal_springs_in_series_are_one_of_half_the_stiffness():
    body = BODIES["hex8"]
    u = 1e-4 * state(body)
    both = Viscous(body, Series(Spring(2.0, 0.3), Spring(2.0, 0.3)), dt=0.1).evaluate(u, 0)
    one = Elastic(body, NeoHookean(1.0, 0.3)).evaluate(u, 0)
    size = np.abs(one.force).max()
    np.testing.assert_allclose(both.force, one.force, atol=1e-4 * size)


def test_memories_stay_positive_and_dashpots_take_energy():
    # Large random strains in a few steps, much longer and much shorter than the relaxation time.
    rng = np.random.default_rng(0)
    for tree in TREES.values():
        memory = None
        shape = (3, 8)
        for dt in (1e-3, 0.1, 10.0, 1e3):
            F = np.eye(3) + 0.35 * rng.uniform(-1, 1, (*shape, 3, 3))
            F *= np.sign(np.linalg.det(F))[..., None, None]
            before = memory or Memory(
                np.tile(six(np.eye(3)), (*shape, len(tree.dashpots), 1)),
                np.tile(six(np.eye(3)), (*shape, 0 if branches(tree) else tree.joints, 1)),
            )
            step = Increment(tree, Past(before, dt))
            table = step.properties(0.0, shape)
            memory = Memory(*step.after(F, table))
            assert np.linalg.eigvalsh(nine(memory.strains)).min() > 1e-3
            body = type("", (), {"weights": np.ones(shape), "points": None})
            fake = type("", (), {"past": step.past, "body": body, "rheology": tree})
            taken, work = Viscous.dissipation(fake, memory, 0.0)
            assert taken.min() >= 0
            assert work.min() >= -1e-12 * work.max() and work.max() > 0


def test_second_order_that_lies_too_far_apart_is_unsound():
    body = BODIES["hex8"]
    rest = Memory.rest(body, TREES["Maxwell"])
    far = Memory(6.0 * rest.strains, rest.joints)
    assert Past(rest, 0.1).sound and Past(rest, 0.1, rest, 0.1).sound
    assert not Past(rest, 0.1, far, 0.1).sound


def test_names_are_compositions():
    assert branches(GeneralisedMaxwell(None, 0.3, (1.0, 1.0)))[0] == []
    assert len(branches(Parallel(Parallel(Spring(1, 0.3)), Maxwell(1, 0.3, 1)))[2]) == 1
    assert branches(Series(Spring(1, 0.3), KelvinVoigt(1, 0.3, 1))) is None
    # Whatever the order, the part without memory comes first: F = Fe Fv.
    spring, dashpot = Spring(1, 0.3), Dashpot(1)
    assert Series(dashpot, spring).parts == (spring, dashpot)
    # Relaxation time η/E_m and retardation time η (E_s + E_m)/(E_s E_m).
    assert times(SLS(100.0, 200.0, 0.3, 2.0), [100.0, 200.0, 2.0]) == approx([0.01, 0.03])
    assert times(TREES["Kelvin-Voigt"], [2.0, 0.7]) == approx([0.35])
    assert times(TREES["Maxwell"], [2.0, 0.7]) == approx([0.35])
    stiff = SLS(1.0, np.array([1.0, 4.0]), 0.3, 2.0)
    assert stiff.shortest_time(0.0, (2, 8)) == approx(0.5)


def test_the_shortest_time_of_a_large_field_is_found_wherever_it_is():
    E = np.linspace(1.0, 2.0, 500)
    for at in (0, 137, 333, 499):
        eta = np.ones(500)
        eta[at] = 1e-3
        assert Maxwell(E, 0.3, eta).shortest_time(0.0, (500, 8)) == approx(1e-3 / E[at])


def test_bad_input():
    body = BODIES["hex8"]
    for eta in (0.0, -1.0, np.array([1.0, -2.0])):
        with pytest.raises(ValueError, match="expected eta > 0"):
            Dashpot(eta)
    with pytest.raises(Unphysical, match="expected eta > 0"):
        Viscous(body, Maxwell(1.0, 0.3, lambda e: e - 1), dt=0.1)
    with pytest.raises(ValueError, match="E > 0"):
        KelvinVoigt(-1.0, 0.3, 1.0)
    with pytest.raises(ValueError, match="has no parts"):
        Parallel()
    with pytest.raises(ValueError, match="expected Spring, Dashpot"):
        Series(Spring(1.0, 0.3), 2.0)
    once = Dashpot(1.0)
    with pytest.raises(ValueError, match="stands twice"):
        Parallel(once, Series(Spring(1.0, 0.3), once))
    with pytest.raises(ValueError, match="expected a time > 0"):
        Viscous(body, TREES["SLS"], dt=0.0)
    rest = Memory.rest(body, TREES["SLS"])
    with pytest.raises(ValueError, match="needs both"):
        Viscous(body, TREES["SLS"], dt=0.1, before=rest, earlier=rest)
    with pytest.raises(ValueError, match=r"start from Memory\.rest"):
        Viscous(body, TREES["generalised Maxwell"], dt=0.1, before=rest)
