"""What holds a model, what it grows by and what a state says, without following a path."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from folding_units import COARSE, COARSEST, HEAVY, NARROW, P

from solver.cases.unit import path
from solver.cases.unit.audit import whole
from solver.cases.unit.choices import Changes, Meshing, Physics, Supports, Watch
from solver.cases.unit.model import SLIP, _held, build, fewer, foot, images, uneven
from solver.cases.unit.path import Ending, Folding, State
from solver.cases.unit.symmetry import Check
from solver.physics.elastic import Elastic


def a_state(*checks, **changed):
    given = {
        "e": 0.5, "curves": np.zeros((4, 10, 3)), "checks": checks, "lowest": None, "tip": None,
        "energy": 1.0, "iterations": 3, "unknowns": 9,
    }  # fmt: skip
    return State(**(given | changed))


@pytest.mark.parametrize(
    ("counts", "unstable", "topples"),
    [
        ([(0, 0), (0, 0)], 0, False),
        ([(1, 1), (2, 2)], 3, False),
        ([(0, 0), (0, 1)], 0, True),
        ([(1, 2), (0, 0)], 1, True),
        ([(2, 1)], 2, False),
        ([(0, 0), (None, None)], None, False),
        ([(0, None), (None, 1)], None, True),
    ],
)
def test_a_state_tells_its_unstable_modes_and_whether_it_would_tip_over(counts, unstable, topples):
    state = a_state(*(Check((), held, free) for held, free in counts))
    assert state.unstable == unstable and state.topples is topples


def test_the_last_state_is_the_last():
    states = tuple(a_state(e=e) for e in (0.0, 0.5))
    folding = Folding(states, (), Ending.LOST, "so", None, None, 0, 0.0)
    assert folding.last is states[1]
    with pytest.raises(ValueError, match="the path has no states: so"):
        _ = replace(folding, states=()).last


# -- steps -----------------------------------------------------------------------------------------


def walk(unit, growth="uniaxial", turn=0.5, **supports):
    """The steps of a model's path, which is not followed."""
    model = build(unit, Meshing(COARSEST), Physics((), growth=growth), Supports(**supports))
    return path._Walk(model, 1e-6, turn, None, None, False, None, 400)


def test_the_fold_turns_by_as_much_in_a_step_as_it_was_told():
    for turn in (0.3, 0.6):
        steps = walk(P, turn=turn).steps
        assert steps.step * P.fold_angle == pytest.approx(turn)
        assert steps.largest == pytest.approx(min(path.EASY, path.LONGEST / steps.step))
    # Isotropic contraction turns a wide hinge further about the other axis.
    wide = replace(P, aspect=2.0)
    assert wide.curvature * wide.width > wide.fold_angle
    assert walk(wide).steps.step * wide.fold_angle == pytest.approx(0.5)
    steps = walk(wide, "isotropic").steps
    assert steps.step * wide.curvature * wide.width == pytest.approx(0.5)
    # However little it turns a step is no more than a fifth of the contraction.
    stiff = walk(replace(P, contraction=0.01)).steps
    assert (stiff.step, stiff.largest) == (0.2, 1.0)


@pytest.mark.parametrize("upright", [True, False])
def test_a_class_is_lost_where_it_is_unstable_as_it_is_held(upright):
    walking = walk(P, upright=upright)
    steady, tips, bends = Check(("x",), 0, 0), Check(("y",), 0, 1), Check(("turn",), 1, 1)
    lost = walking._lost([steady, tips, bends, Check((), None, None)])
    assert lost == ([bends] if upright else [tips, bends])


@pytest.mark.parametrize("mirrors, kind", [(("x", "y"), "symmetric"), (("x",), "bifurcation")])
def test_toppling_is_told_once_where_it_sets_in_and_events_where_they_happened(
    mirrors, kind, monkeypatch
):
    walking, tips = walk(P, mirrors=mirrors), iter([False, True, True, False, True])
    walking.symmetries = SimpleNamespace(check=lambda x, e: [])
    monkeypatch.setattr(path, "_state", lambda *given: SimpleNamespace(topples=next(tips)))
    snap = SimpleNamespace(kind="snap", e=0.45, size=0.2)
    branch = SimpleNamespace(kind="bifurcation", e=0.47, size=0.3)
    fold = SimpleNamespace(kind="fold", e=0.48, size=0.4)
    for e in (0.1, 0.2, 0.3, 0.4, 0.5):
        events = (snap, branch, fold) if e == 0.5 else ()
        point = SimpleNamespace(x=None, e=e, events=events, iterations=3, unstable=0, energy=0.0)
        assert walking._accept(point) is point
    told = [(h.kind, h.e, h.size) for h in walking.happenings]
    assert told[0][:2] == ("toppling", 0.2)
    assert told[1:] == [("snap", 0.45, 0.2), (kind, 0.47, 0.3)]
    assert walking.iterations == 15 and len(walking.states) == 5


# -- supports --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mirrors", "tips"), [(("x", "y"), 0), (("x",), 1), (("y",), 1), ((), 2), (("turn",), 0)]
)
@pytest.mark.parametrize("heavy", [True, False])
@pytest.mark.parametrize("upright", [True, False])
def test_rigid_motions_are_held_but_for_those_that_the_ground_resists(
    mirrors, tips, heavy, upright
):
    """``tips``: rotations about x and y that the symmetries of a model leave."""
    supports = Supports(mirrors, upright)
    body = build(P, Meshing(COARSEST), Physics(()), Supports(mirrors)).body
    held = _held(body, supports, heavy, np.zeros_like(body.nodes))
    modes = [np.broadcast_to(k, body.nodes.shape) for k in np.eye(3)]
    modes += [np.cross(k, body.nodes) for k in np.eye(3)]
    kept, bare = [], []
    for mode in modes:
        bare.append(
            np.concatenate(
                [mode[s.nodes] @ np.asarray(s.direction, float) for s in held["fixed"]] or [[0.0]]
            )
        )
        kept.append(
            np.concatenate([
                *((mode[s.nodes] @ np.asarray(s.direction, float)) for s in held["fixed"]),
                [(row.coefficients * mode).sum() for row in held["rows"]],
                *(
                    (mode[t.nodes] - np.asarray(t.signs) * mode[t.images]).ravel()
                    for t in held.get("tied", ())
                ),
            ])
        )  # fmt: skip
    rank = np.linalg.matrix_rank(np.array(kept), tol=1e-9)
    # On the ground it may rise, and tip over unless it is held upright.
    assert rank == 6 - heavy * (1 + (not upright) * tips)
    # A row holds what nothing else does.
    rows = len(held["rows"])
    assert np.linalg.matrix_rank(np.array(bare), tol=1e-9) + rows == rank
    if heavy:
        up = np.array(kept)[2]
        assert np.abs(up).max() < 1e-12


def test_symmetries_that_may_be_left_are_fewer():
    assert fewer(("x", "y")) == [{"x"}, {"y"}, {"turn"}, set()]
    assert fewer(("x",)) == fewer(("turn",)) == [set()] and fewer(()) == []
    model = build(P, Meshing(COARSEST), Physics(()), Supports(("x",)))
    with pytest.raises(ValueError, match="expected fewer of"):
        model.widened(("y",), np.zeros(model.scene.size), 0.0)


@pytest.mark.parametrize("mirrors", [("x", "y"), ("x",), ("y",), ("turn",)])
def test_the_image_of_a_node_moves_as_the_symmetry_says(mirrors):
    part = build(P, Meshing(COARSEST), Physics(()), Supports(mirrors)).body
    whole = build(P, Meshing(COARSEST), Physics(()), Supports(())).body
    near, signs = images(part, whole, mirrors)
    np.testing.assert_allclose(signs * part.nodes[near], whole.nodes, atol=1e-9)
    # A half-turn takes both components along, where y < 0; a mirror plane its own.
    x, y = (whole.nodes[:, :2] < -1e-9).T
    flips = {"turn": (y, y), "x": (x, 0 * x), "y": (0 * y, y)}
    flipped = np.any([np.column_stack(flips[name]) for name in mirrors], axis=0)
    np.testing.assert_array_equal(signs, np.column_stack([1 - 2 * flipped, np.ones(len(x))]))
    other = build(P, Meshing(COARSE), Physics(()), Supports(())).body
    with pytest.raises(ValueError, match="no image"):
        images(part, other, mirrors)


def test_the_foot_is_the_nearest_node():
    body = build(P, Meshing(COARSEST), Physics(())).body
    for at in ((0.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.1, 0.5, 0.004)):
        assert body.nodes[foot(body, at)[0]] == pytest.approx(at, abs=1e-9)


# -- what acts -------------------------------------------------------------------------------------


@pytest.mark.parametrize("growth", ["uniaxial", "isotropic", "release"])
@pytest.mark.parametrize("swelling", [False, True])
def test_the_active_layer_contracts_and_either_layer_swells_where_it_does(growth, swelling):
    changes = Changes(expansion=lambda e: 0.02 * e), Changes(expansion=lambda e: -0.01 * e)
    active, passive = changes if swelling else (Changes(), Changes())
    physics = Physics((), growth=growth, active=active, passive=passive)
    model = build(P, Meshing(COARSEST), physics)
    on = model.body.cells_of("active")
    term, X = model.terms[0], model.body.nodes
    for e in (0.25, 1.0):
        # Along the sheet; the others follow, or follow in the release.
        fractions = {"uniaxial": (None, e, None), "isotropic": (e,) * 3, "release": (e, 1.0, e)}
        for cells, shrinks, expansion in ((on, 1, 0.02), (~on, 0, -0.01)):
            swells = expansion * e * swelling
            strain = [
                0.0 if a is None else swells - shrinks * a * P.contraction
                for a in fractions[growth]
            ]
            # Cells displaced as they grow are without stress.
            part = Elastic(model.body, term.material, term.growth, cells=cells)
            grown = part.evaluate(X * strain, e, 1)
            assert grown.energy == pytest.approx(0, abs=1e-15)
            assert np.abs(grown.force).max() < 1e-12


def test_weights_are_uneven_by_up_to_the_amplitude_and_the_rest_stays():
    model = build(NARROW, Meshing(COARSEST))
    noisy = uneven(0.01, Watch())(model.scene, np.random.default_rng(0))
    assert [t.name for t in noisy.terms] == [t.name for t in model.scene.terms]
    own, other = (next(t for t in s.terms if t.name == "gravity") for s in (model.scene, noisy))
    factors = np.asarray(other.density) / np.asarray(own.density)
    assert 0.005 < np.abs(factors - 1).max() <= 0.01 and factors.min() < 1 < factors.max()
    assert noisy.terms[0] is model.scene.terms[0]


def test_friction_slides_after_a_hundredth_of_the_thickness():
    model = build(HEAVY, Meshing(COARSEST), Physics(friction=0.3))
    friction = next(t for t in model.terms if t.name == "friction")
    assert SLIP == 0.01 and friction.slip == pytest.approx(SLIP * HEAVY.slenderness)


def test_rows_turn_with_the_unit_once_they_see_less_than_most_of_a_rotation():
    model = build(HEAVY, Meshing(COARSEST), supports=Supports(()))
    x = np.zeros(model.scene.size)
    assert model.anchored(x, 0.0) is model

    def folded(angle):
        """Panels that stand at an angle, as unknowns."""
        y = model.body.nodes[:, 1]
        return model.scene.unknowns(
            np.column_stack([0 * y, y * (np.cos(angle) - 1), np.abs(y) * np.sin(angle)])
        )

    assert model.anchored(folded(0.3), 0.0) is model
    turned = model.anchored(folded(1.5), 0.0)
    assert turned is not model and turned.scene.size == model.scene.size
    assert turned.terms == model.terms


def test_the_clearance_is_that_of_the_nearest_point_of_a_panel():
    physics = Physics(("contact",))
    model = build(P, Meshing(COARSEST), physics)
    for shift in (0.0, -0.03):
        u = np.zeros_like(model.body.nodes)
        u[model.body.nodes[:, 1] > P.hinge_length / 2 - 1e-9, 1] = shift
        x = model.scene.unknowns(u)
        assert model.clearance(x, 0.0) == pytest.approx(P.hinge_length / 2 + shift, abs=1e-9)
    assert model.effects == ("elastic", "contact")
    late = build(P, Meshing(COARSEST), physics, watch=Watch(deadline=np.inf))
    assert late.effects == model.effects


@pytest.mark.parametrize("mirrors", [(), ("y",)])
def test_what_may_tip_over_is_borne_on_all_sides_but_those_that_it_was_cut_along(mirrors):
    # Laid flat, upside down, on its end at y = 0 or the whole unit's, and on the other end.
    flat, over, start, end = np.array(
        [
            np.eye(3),
            np.diag([1, -1, -1]),
            [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
            [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        ]
    )

    def borne(turn, upright):
        model = build(P, Meshing(0), supports=Supports(mirrors, upright=upright))
        Y = model.body.nodes @ turn.T
        Y[:, 2] -= Y[:, 2].min()
        return -model.ground.evaluate(Y - model.body.nodes, 0.0, 1).force[:, 2].sum()

    whole = borne(flat, True)
    assert whole > 0 and borne(over, True) == 0
    # Free, its active layer bears it, which covers the hinge; sides beside it count a little too.
    assert borne(over, False) == pytest.approx(P.hinge_length * P.hinge_width * whole, rel=0.1)
    assert borne(end, False) > 2 * borne(end, True) > 0
    if mirrors:
        assert borne(start, False) < 0.3 * borne(end, False)
    else:
        assert borne(start, False) == pytest.approx(borne(end, False))


def test_a_half_is_made_whole_about_its_cut():
    nodes = np.array([[1.0, 0, 0], [-1, 0, 0], [0.5, 1, 2]])
    u, cells, turn = np.zeros((3, 3)), np.array([[0, 1, 2]]), [0, 1]
    u[:2] = [[0.1, 0.2, 0.3], [-0.1, -0.2, 0.3]]
    all_nodes, moved, all_cells = whole(nodes, u, cells, [turn])
    # Under the half-turn about z the two on the cut are each other's images.
    assert all_nodes.tolist() == [*nodes.tolist(), [-0.5, -1, 2]]
    assert moved.tolist() == [*u.tolist(), [0, 0, 0]]
    assert all_cells.tolist() == [[0, 1, 2], [1, 0, 3]]
    # Forces of both halves add on the cut: there each has its own and the other's, turned.
    force = np.array([[1.0, 0, 0], [0, 2, 0], [5, 6, 7]])
    _, summed, _ = whole(nodes, force, cells, [turn], sums=True)
    assert summed.tolist() == [[1, -2, 0], [-1, 2, 0], [5, 6, 7], [-5, -6, 7]]
    # A mirror plane: what lies in it is its own image.
    _, summed, all_cells = whole(nodes, force, cells, [[1]], sums=True)
    assert summed[:2].tolist() == [[2, 0, 0], [0, 0, 0]] and all_cells.tolist()[1] == [0, 1, 3]
    with pytest.raises(ValueError, match="the state leaves its symmetry about y = 0"):
        whole(nodes, u + np.array([0.01, 0, 0]), cells, [turn])
    other = nodes + np.array([[0, 0, 0], [0.1, 0, 0], [0, 0, 0]])
    with pytest.raises(ValueError, match="the mesh on the cut is not that of the other side"):
        whole(other, 0 * u, cells, [turn])
