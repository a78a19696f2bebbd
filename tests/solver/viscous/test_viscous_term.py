"""The viscous term between steps: what it remembers, dissipates and hands on."""

import numpy as np
import pytest
from proofs import BODIES, state
from pytest import approx
from viscous_references import TREES

import solver.viscous.term
from solver.equilibrium.scene import Scene
from solver.physics.elastic import Elastic
from solver.physics.growth import Isotropic
from solver.physics.materials import NeoHookean
from solver.viscous.kernel import nine, six
from solver.viscous.rheology import SLS, GeneralisedMaxwell, KelvinVoigt, Maxwell, Series, Spring
from solver.viscous.term import Increment, Memory, Past, Viscous, softened

BODY = BODIES["hex8"]


@pytest.mark.parametrize(
    ("ratio", "sound"), [(3.9, True), (4.0, False), (6.0, False), (1 / 3.9, True), (1 / 6, False)]
)
def test_two_states_of_the_past_may_lie_fourfold_apart_either_way(ratio, sound):
    # Of equal steps BDF2 weighs them by 2 and −½.
    rest = Memory.rest(BODY, TREES["Maxwell"])
    far = Memory(ratio * rest.strains, rest.joints)
    assert Past(rest, 0.1, far, 0.1).sound is sound


@pytest.mark.parametrize("name", ["Kelvin-Voigt", "Maxwell", "Burgers"])
def test_a_small_step_takes_what_newtons_dashpot_takes(name):
    """η Δt D : D with D = ε/Δt, by the stress at the end too."""
    tree, dt = TREES[name], 0.3
    term = Viscous(BODY, tree, dt=dt)
    rest = term.past.before
    e = 1e-5 * np.array([[1.0, 0.4, 0.2], [0.4, -0.7, 0.1], [0.2, 0.1, 0.5]])
    after = Memory(rest.strains + six(2 * e), rest.joints)
    for j, leaf in enumerate(tree.dashpots):
        eta = float(np.ravel(leaf.viscosity(0.0, BODY.weights.shape, BODY.points))[0])
        for energy in term.dissipation(after, 0.0):
            assert energy[..., j] == approx(eta * (e * e).sum() / dt, rel=1e-3)


def test_an_earlier_memory_of_another_body_is_refused_too():
    tree = TREES["SLS"]
    rest, other = Memory.rest(BODY, tree), Memory.rest(BODIES["hex27"], tree)
    for wrong in ({"before": other}, {"before": rest, "earlier": other, "last_dt": 0.1}):
        with pytest.raises(ValueError, match=r"start from Memory\.rest"):
            Viscous(BODY, tree, dt=0.1, **wrong)
    for times in ({"dt": 0.0}, {"dt": 0.1, "earlier": rest, "last_dt": 0.0}):
        with pytest.raises(ValueError, match="expected a time > 0"):
            Viscous(BODY, tree, before=rest, **times)


def test_the_next_step_is_of_the_same_cells_growth_and_name():
    left = BODY.cells_where(lambda X: X[:, 0] < 0.5)
    grown = Isotropic(lambda e: -0.2 * e)
    term = Viscous(BODY, TREES["SLS"], grown, dt=0.1, cells=left, name="skin")
    u = state(BODY)
    past = Past(term.memory(u, 0.3), 0.07, term.past.before, 0.1)
    following = term.stepped(past)
    assert following.name == "skin" and following.past is not term.past
    want = Viscous(
        BODY, TREES["SLS"], grown, dt=0.07, cells=left, before=past.before, earlier=past.earlier,
        last_dt=0.1,
    ).evaluate(u, 0.6)  # fmt: skip
    got = following.evaluate(u, 0.6)
    assert got.energy == want.energy
    np.testing.assert_array_equal(got.force, want.force)


@pytest.mark.parametrize("name", ["SLS", "Burgers"])
def test_a_body_of_many_cells_is_remembered_piece_by_piece(name, monkeypatch):
    term, u = Viscous(BODY, TREES[name], dt=0.1), state(BODY)
    whole = term.memory(u, 0.0)
    monkeypatch.setattr(solver.viscous.term, "CHUNK", 1)
    pieces = term.memory(u, 0.0)
    np.testing.assert_array_equal(pieces.strains, whole.strains)
    np.testing.assert_array_equal(pieces.joints, whole.joints)
    assert (np.ptp(whole.strains, axis=0) > 0).any()


@pytest.mark.parametrize("name", TREES)
def test_a_body_turned_inside_out_is_not_admissible(name):
    term = Viscous(BODY, TREES[name], dt=0.1)
    u = state(BODY)
    inside_out = (BODY.nodes + u) * (1, 1, -1) - BODY.nodes
    assert term.memory(u, 0.0) is not None and term.memory(inside_out, 0.0) is None
    assert not np.isfinite(term.evaluate(inside_out, 0.0, 0).energy)


def test_what_is_softened_is_the_chosen_part_and_the_rest_stays_elastic():
    grown = Isotropic(lambda e: 0.1 * e)
    left = BODY.cells_where(lambda X: X[:, 0] < 0.5)
    top = BODY.cells_where(lambda X: X[:, 1] < 0.75)
    material = NeoHookean(2.0, 0.3)
    others = Elastic(BODY, material, cells=~left, name="others")
    scene = Scene(BODY, [Elastic(BODY, material, grown, cells=left, name="skin"), others])
    u = state(BODY)
    # A step of next to no time is elastic, with both springs of a solid that makes 2.
    fast = softened(scene, SLS(0.5, 1.5, 0.3, 1.0), dt=1e-9, cells=top, term="skin")
    soft, skin, same = fast.terms
    assert (soft.name, skin.name, same) == ("viscous", "skin", others)
    assert sorted([*soft.ids, *skin.ids]) == np.flatnonzero(left).tolist()
    assert set(soft.ids) == set(np.flatnonzero(left & top)) and len(skin.ids)
    for part, cells in ((soft, left & top), (skin, left & ~top)):
        want = Elastic(BODY, material, grown, cells=cells).evaluate(u, 0.5, 0).energy
        assert part.evaluate(u, 0.5, 0).energy == approx(want, rel=1e-5)
    slow = softened(scene, SLS(0.5, 1.5, 0.3, 1.0), dt=1e9, term="skin")
    assert [term.name for term in slow.terms] == ["viscous", "others"]
    assert slow.terms[0].past.dt == 1e9


BRANCHES = {
    "stiff and soft": GeneralisedMaxwell(1.0, 0.3, (1e3, 1.0), (1e-3, 1.0)),
    "quick and slow": GeneralisedMaxwell(1.0, 0.3, (1.0, 1e-4), (1.0, 1e4)),
    "without Poisson's ratio": GeneralisedMaxwell(1.0, 0.0, (2.0, 0.5)),
    "hardly compressible": SLS(1.0, 2.0, 0.49, 0.7),
    "no spring": Maxwell(1.0, 0.3, 0.2),
    "no branch": KelvinVoigt(1.0, 0.3, 5.0),
}


@pytest.mark.parametrize("name", BRANCHES)
def test_the_compiled_step_is_the_trees_at_large_strains_and_unlike_parts(name, monkeypatch):
    tree, rng, shape = BRANCHES[name], np.random.default_rng(3), (4, 2)
    ones = np.tile(six(np.eye(3)), (*shape, len(tree.dashpots), 1))
    before = Memory(ones, np.empty((*shape, 0, 6)))
    with monkeypatch.context() as patched:
        patched.setattr(solver.viscous.term, "branches", lambda tree: None)
        slow_before = Memory(ones, np.tile(six(np.eye(3)), (*shape, tree.joints, 1)))
        slow = Increment(tree, Past(slow_before, 0.1))
    fast = Increment(tree, Past(before, 0.1))
    F = np.eye(3) + 0.5 * rng.uniform(-1, 1, (*shape, 3, 3))
    F[0] = np.diag([3.0, 0.5, 0.4])
    F *= np.sign(np.linalg.det(F))[..., None, None]
    answers = []
    for step in (fast, slow):
        psi, P, A = np.empty(shape), np.empty((*shape, 3, 3)), np.empty((*shape, 3, 3, 3, 3))
        table = step.properties(0.0, shape)
        assert step.kernel(F, table, 2, psi, P, A)
        answers.append((psi, P, A, step.after(F, table)[0]))
    # The tangent is condensed, which loses digits where branches are as unlike as these.
    for mine, other, rtol in zip(*answers, (1e-9, 1e-9, 1e-7, 1e-9), strict=True):
        assert np.abs(mine - other).max() < rtol * np.abs(other).max()
    assert (np.linalg.eigvalsh(nine(answers[0][3])) > 0).all()


@pytest.mark.parametrize(("first", "second"), [(0.2, 5.0), (5.0, 0.2), (5.0, 5.0)])
def test_in_a_series_both_springs_carry_the_same_however_unlike(first, second):
    """At small strain a series of springs has the sum of the compliances."""
    u = 1e-5 * state(BODY)
    both = Viscous(BODY, Series(Spring(first, 0.3), Spring(second, 0.3)), dt=0.1).evaluate(u, 0)
    one = Elastic(BODY, NeoHookean(first * second / (first + second), 0.3)).evaluate(u, 0)
    np.testing.assert_allclose(both.force, one.force, atol=1e-4 * np.abs(one.force).max())
    assert both.energy == approx(one.energy, rel=1e-4)
