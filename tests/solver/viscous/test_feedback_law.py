"""Growth that answers to stress: the law at a point, its tangent, what it remembers and refuses."""

import numpy as np
import pytest
from proofs import BODIES, prove, state

import solver.viscous.feedback
import solver.viscous.term
from solver.equilibrium.scene import Scene
from solver.output import cell_fields
from solver.physics.elastic import Elastic
from solver.physics.growth import AlongFibre, Isotropic
from solver.physics.materials import NeoHookean
from solver.viscous.evolution import State, TimeSteps, evolve, start, warn_unresolved
from solver.viscous.feedback import Feedback, Growing
from solver.viscous.rheology import SLS, Dashpot, Maxwell, Parallel, Series, Spring
from solver.viscous.term import Memory, Past, Viscous

BODY = BODIES["hex8"]
ELASTIC, VISCOUS = Spring(1.0, 0.3), SLS(1.0, 2.0, 0.3, 0.5)
FRAME = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
LAWS = {
    "volume": Feedback(0.8, 0.05, 0.1),
    "fibre": Feedback(0.8, lambda e: 0.05 * e, lambda e, X: 0.1 * X[..., 0], fibre=(1, 2, -1)),
    "frame": Feedback((0.8, 0.3, -0.2), (0.05, 0.0, 0.1), (0.1, -0.1, 0.2), frame=FRAME),
    "eshelby": Feedback((0.8, 0.3, -0.2), 0.1, 0.1, frame=FRAME, measure="eshelby"),
    "volume, eshelby": Feedback(0.8, 0.1, 0.1, measure="eshelby"),
}


def steps(body, tree, law):
    """A step of first and one of second order after two steps through rough states."""
    first = Growing(body, tree, law, dt=0.3)
    a = first.memory(state(body, seed=4, size=0.1), 0.3)
    second = Growing(body, tree, law, dt=0.35, before=a)
    b = second.memory(state(body, seed=5, size=0.1), 0.4)
    return second, Growing(body, tree, law, dt=0.4, before=b, earlier=a, last_dt=0.35)


@pytest.mark.parametrize("element", ["hex8", "tet10"])
@pytest.mark.parametrize(
    ("name", "tree"),
    [(name, ELASTIC) for name in LAWS]
    + [(name, VISCOUS) for name in LAWS if "eshelby" not in name],
)
def test_the_tangent_is_that_of_the_force_with_growth_solved_for(name, tree, element):
    body = BODIES[element]
    for term in steps(body, tree, LAWS[name]):
        u = state(body)
        assert np.abs(term.memory(u, 0.7).growth - term.past.before.growth).max() > 3e-3
        prove(term, u, 0.7)
        stiffness = term.evaluate(u, 0.7).stiffness
        # Growth takes part in it: without the answer to stress it is another one.
        deaf = Growing(body, tree, Feedback(0.0, 0.0), dt=term.past.dt)
        assert np.abs(stiffness - deaf.evaluate(u, 0.7).stiffness).max() > 1e-3


def test_any_tree_of_springs_and_dashpots_may_grow():
    tree = Series(Spring(1.0, 0.3), Parallel(Spring(1.0, 0.3), Dashpot(0.4)))
    prove(steps(BODY, tree, LAWS["fibre"])[1], state(BODY), 0.7)


def test_growth_without_an_answer_is_growth_that_was_prescribed():
    # Of a baseline alone γ = b Δt, and the body is an elastic one grown by exp(b Δt).
    u, material = state(BODY), NeoHookean(1.0, 0.3)
    for law, grown in (
        (Feedback(0.0, 0.0, 0.7), Isotropic(np.expm1(0.14))),
        (Feedback(0.0, 0.0, 0.7, fibre=(1, 2, 0)), AlongFibre(np.expm1(0.14), (1, 2, 0))),
    ):
        term, want = Growing(BODY, ELASTIC, law, dt=0.2), Elastic(BODY, material, grown)
        at, wanted = term.evaluate(u, 0.0), want.evaluate(u, 0.0)
        np.testing.assert_allclose(at.force, wanted.force, atol=1e-12)
        np.testing.assert_allclose(at.stiffness, wanted.stiffness, atol=1e-12)
        assert at.energy is None
        fields, wanted = (cell_fields(BODY, u, [t], 0.0) for t in (term, want))
        for name, field in fields.items():
            np.testing.assert_allclose(field, wanted[name], atol=1e-12, err_msg=name)


@pytest.mark.parametrize("name", LAWS)
def test_the_step_keeps_the_law(name):
    """γ's difference is the law's rate at the end, its stress read off the written fields."""
    law, u = LAWS[name], state(BODY)
    for term in steps(BODY, ELASTIC, law):
        after = term.memory(u, 0.7).growth
        fields = cell_fields(BODY, u, [term], 0.7)
        F, growth = fields["F"], fields["growth"]
        Fe, J = F @ np.linalg.inv(growth), np.linalg.det(F)[..., None, None]
        # Mandel's stress is Je Feᵀ σ Fe⁻ᵀ.
        Je = J / np.linalg.det(growth)[..., None, None]
        M = Je * np.swapaxes(Fe, 2, 3) @ fields["cauchy"] @ np.linalg.inv(np.swapaxes(Fe, 2, 3))
        shape = BODY.weights.shape
        B = law.projectors(0.7, shape, BODY.points)
        s = np.einsum("mqij,mqaij->mqa", M, np.broadcast_to(B, (*shape, *B.shape[2:])))
        s /= law.sizes
        if law.measure == "eshelby":
            s -= (fields["energy density"] / np.linalg.det(growth))[..., None]
        rate, target, base = law.quantities(0.7, shape, BODY.points)
        past, (a1, a2) = term.past, term.past.weights()
        rise = (a1 + a2) * after - a1 * past.before.growth
        if past.earlier is not None:
            rise = rise - a2 * past.earlier.growth
        np.testing.assert_allclose(rise / past.dt, base + rate * (s - target), atol=1e-9)


def test_a_turned_body_feels_the_same():
    turn = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    u = state(BODY)
    turned = (BODY.nodes + u) @ turn.T - BODY.nodes
    for name in ("frame", "fibre"):
        term = steps(BODY, VISCOUS, LAWS[name])[1]
        np.testing.assert_allclose(
            term.memory(turned, 0.5).growth, term.memory(u, 0.5).growth, atol=1e-10
        )
        np.testing.assert_allclose(
            term.evaluate(turned, 0.5, 1).force, term.evaluate(u, 0.5, 1).force @ turn.T, atol=1e-10
        )


def test_only_chosen_cells_grow_and_a_large_body_is_remembered_piece_by_piece(monkeypatch):
    left, u = BODY.cells_where(lambda X: X[:, 0] < 0.5), state(BODY)
    law = LAWS["frame"]
    part = Growing(BODY, VISCOUS, law, dt=0.3, cells=left, name="skin")
    whole = Growing(BODY, VISCOUS, law, dt=0.3)
    kept, all_ = part.memory(u, 0.0), whole.memory(u, 0.0)
    np.testing.assert_array_equal(kept.growth[left], all_.growth[left])
    assert not kept.growth[~left].any() and np.abs(all_.growth[~left]).max() > 1e-3
    monkeypatch.setattr(solver.viscous.term, "CHUNK", 1)
    for name in ("strains", "growth"):
        np.testing.assert_allclose(
            getattr(whole.memory(u, 0.0), name), getattr(all_, name), atol=1e-12
        )
    following = part.stepped(Past(kept, 0.2))
    assert (following.name, list(following.ids)) == ("skin", list(part.ids))
    assert following.past.before is kept


def test_a_state_turned_inside_out_is_not_admissible():
    term, u = Growing(BODY, ELASTIC, LAWS["frame"], dt=0.3), state(BODY)
    inside_out = (BODY.nodes + u) * (1, 1, -1) - BODY.nodes
    assert term.memory(inside_out, 0.0) is None
    assert term.evaluate(inside_out, 0.0).energy == np.inf
    with pytest.raises(ValueError, match="give a converged one"):
        term.grown(inside_out, 0.0)


def test_a_step_in_which_growth_runs_away_is_not_admissible():
    # Explosive: growth that the stretch feeds, over a step far longer than it takes.
    law = Feedback(-50.0, 0.0, fibre=(1, 0, 0))
    stretched = BODY.nodes * (0.3, 0, 0)
    assert Growing(BODY, ELASTIC, law, dt=1e-3).memory(stretched, 0.0) is not None
    assert Growing(BODY, ELASTIC, law, dt=1.0).memory(stretched, 0.0) is None


def test_the_shortest_time_is_of_growth_or_of_the_dashpots():
    assert Growing(BODY, Spring(4.0, 0.3), Feedback(0.5, 0.0), dt=1.0).shortest_time(0) == 0.5
    assert Growing(BODY, ELASTIC, Feedback(0.0, 0.0), dt=1.0).shortest_time(0) == np.inf
    fast = Growing(BODY, Maxwell(1.0, 0.3, 1e-3), Feedback(0.5, 0.0), dt=1.0)
    assert fast.shortest_time(0) == Viscous(BODY, fast.rheology, dt=1.0).shortest_time(0) < 2
    term = Growing(BODY, Spring(4.0, 0.3), Feedback(0.5, 0.0), dt=1.0)
    with pytest.warns(UserWarning, match=r"shortest relaxation time of term 'growing', 0\.5; take"):
        warn_unresolved([term], 0.06, lambda t: t, 0.0, 1.0)
    warn_unresolved([term], 0.05, lambda t: t, 0.0, 1.0)


def test_a_saved_state_continues_to_the_identical_path(tmp_path):
    from solver.cases.tissue.feedback import Bar

    stepper = TimeSteps(1e-10, 0.02, tolerance=1e-4)
    scene = Bar().scene(0.02)
    whole = evolve(scene, start(scene), stepper, until=1.0)
    middle = whole.states[4]
    again = State.load(middle.save(tmp_path / "state.npz"))
    assert again.level.memories[0].growth.any()
    rest = evolve(scene, again, stepper, until=1.0)
    np.testing.assert_array_equal(rest.last.x, whole.last.x)
    np.testing.assert_array_equal(
        rest.last.level.memories[0].growth, whole.last.level.memories[0].growth
    )


def test_bad_input():
    for given, says in (
        ({"fibre": (1, 0, 0), "frame": np.eye(3)}, "one of them"),
        ({"measure": "cauchy"}, "expected 'mandel' or 'eshelby'"),
    ):
        with pytest.raises(ValueError, match=says):
            Feedback(1.0, 0.0, **given)
    with pytest.raises(ValueError, match="2 values of rate; expected 3"):
        Feedback((1.0, 2.0), 0.0, frame=np.eye(3))
    for law, says in (
        (Feedback(1.0, 0.0, frame=2 * np.eye(3)), "not orthonormal"),
        (Feedback(1.0, 0.0, fibre=(0, 0, 0)), "fibre is the zero vector"),
        (Feedback(np.zeros(3), 0.0), "rate gave shape"),
    ):
        with pytest.raises(ValueError, match=says):
            Growing(BODY, ELASTIC, law, dt=0.1)
    with pytest.raises(ValueError, match=r"expected a Feedback, which Feedback\(rate, target\)"):
        Growing(BODY, ELASTIC, 1.0, dt=0.1)
    with pytest.raises(ValueError, match="has dashpots; take"):
        Growing(BODY, VISCOUS, LAWS["eshelby"], dt=0.1)
    other = Growing(BODY, ELASTIC, LAWS["frame"], dt=0.1).rest()
    for wrong in (other, Memory.rest(BODY, ELASTIC)):
        with pytest.raises(ValueError, match=r"start from Memory\.rest"):
            Growing(BODY, ELASTIC, LAWS["fibre"], dt=0.1, before=wrong)
    with pytest.raises(ValueError, match=r"start from Memory\.rest"):
        Viscous(BODY, ELASTIC, dt=0.1, before=other)


def test_a_scene_without_feedback_runs_nothing_of_it(monkeypatch):
    """Every function of the module is a trap: elastic and viscous scenes go through none."""
    from solver.cases.tissue import creep

    def trap(*_, **__):
        raise AssertionError("the code of growth that answers to stress ran")

    module = solver.viscous.feedback
    for owner in (Feedback, Growing, module.Grown, module.Response):
        for name, value in list(vars(owner).items()):
            if callable(value) or isinstance(value, property):
                monkeypatch.setattr(owner, name, trap)
    monkeypatch.setattr(module, "add_stiffness_unsymmetric", trap)
    monkeypatch.setattr(module, "shrunk", trap)
    scene = creep.scene(creep.MODELS["SLS 2"].rheology(), 0.01, 0.05)
    assert evolve(scene, start(scene), TimeSteps(1e-9, 0.05, tolerance=1e-3), until=0.1).reached
    assert all(m.growth is None for m in start(scene).level.memories)
    elastic = Scene(BODY, [Elastic(BODY, NeoHookean(1.0, 0.3))])
    assert elastic.evaluate(state(BODY), 0.0).energy > 0
    with pytest.raises(AssertionError, match="ran"):
        Growing(BODY, ELASTIC, LAWS["fibre"], dt=0.1)
