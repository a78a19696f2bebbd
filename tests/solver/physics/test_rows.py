"""Rows on faces and lines, and the reactions of supports and rows: closed forms, resultants."""

import numpy as np
import pytest
from proofs import BODIES, ELEMENTS
from pytest import approx
from reference_scenes import AXES, MidLine, at_end, cantilever, held, modulus, near, strip

from solver.equilibrium.reactions import reaction
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.lines import Line
from solver.mesh.structured import box, polar
from solver.physics.elastic import Elastic
from solver.physics.loads import Gravity, PointLoad, Traction
from solver.physics.materials import NeoHookean, SmallStrain
from solver.physics.rows import flat_rows, mean_displacement_row, mean_rotation_row
from solver.physics.supports import Fixed, translation_row


def side(body):
    return body.surface(lambda X: X[:, 0] > 1 - 1e-9)


def value(row, u):
    return float((row.coefficients * u).sum())


def turned(X, axis, angle, centre):
    a = np.asarray(axis) / np.linalg.norm(axis)
    arm = X - centre
    out = np.cos(angle) * arm + np.sin(angle) * np.cross(a, arm)
    return centre + out + (1 - np.cos(angle)) * np.outer(arm @ a, a)


@pytest.mark.parametrize("element", ELEMENTS)
def test_means_of_rigid_motions(element):
    body = BODIES[element]
    centre, axis, angle = np.array([1.0, 0.75, 0.4]), np.array([2.0, -1, 3]), 0.9
    X = body.nodes
    u = turned(X, axis, angle, centre) - X + np.array([0.1, 0.2, -0.3])
    edge = body.nodes_where(lambda X: (X[:, 0] > 1 - 1e-9) & (X[:, 2] > 0.8 - 1e-9))
    for region, at in ((side(body), centre), (Line.of(body, edge), np.array([1, 0.75, 0.8]))):
        row = mean_rotation_row(body, region, axis)
        assert value(row, u) == approx(np.sin(angle), rel=1e-12)
        assert value(row, np.ones_like(u)) == approx(0, abs=1e-12)
        row = mean_displacement_row(body, region, (3, 0, 4))
        moved = turned(at[None], axis, angle, centre)[0] - at + np.array([0.1, 0.2, -0.3])
        assert value(row, u) == approx(moved @ [0.6, 0, 0.8], rel=1e-12)
        assert not row.coefficients[X[:, 0] < 1 - 1e-9].any()


@pytest.mark.parametrize("side", [(k, v) for k in range(3) for v in (0, (1, 1.5, 0.8)[k])])
@pytest.mark.parametrize("element", ELEMENTS)
def test_a_flat_face_may_move_and_turn_and_nothing_else(element, side):
    body, (k, v) = BODIES[element], side
    surface = body.surface(lambda X: np.abs(X[:, k] - v) < 1e-9)
    rows, face = flat_rows(body, surface), np.unique(surface.nodes)
    assert len(rows) == len(face) - 3
    C = np.stack([row.coefficients.ravel() for row in rows])
    assert np.linalg.matrix_rank(C) == len(rows) and np.abs(C).max() < 1 + 1e-9
    rigid = turned(body.nodes, (1, 2, 3), 1.3, np.zeros(3)) - body.nodes
    assert np.abs(C @ rigid.ravel()).max() < 1e-12
    # Anything that meets the rows is a plane along N; what goes on in the plane is free.
    u = np.random.default_rng(0).standard_normal(body.nodes.shape)
    u -= (np.linalg.pinv(C) @ (C @ u.ravel())).reshape(-1, 3)
    plane = np.column_stack([np.delete(body.nodes[face], k, 1), np.ones(len(face))])
    remaining = u[face, k] - plane @ np.linalg.lstsq(plane, u[face, k], rcond=None)[0]
    assert np.abs(remaining).max() < 1e-12 and np.abs(u[face, k]).max() > 0.1
    assert not np.delete(C.reshape(len(rows), -1, 3), k, 2).any()


def solved(scene, e=1.0):
    """The state of a linear scene."""
    x = np.zeros(scene.size)
    return x - scene.system(x, e).factorise().solve(scene.system(x, e).residual)


def test_a_point_load_off_the_middle_of_a_flat_end_stretches_and_bends_a_bar():
    # u = P L/EA (1 + y y_P A/I) at the end of a bar of ν = 0, whose other end stays flat too.
    L, b, h, E, P = 3.0, 1.0, 0.5, 100.0, 2e-4
    body = Body.build(
        box(np.linspace(0, L, 4), np.linspace(-b / 2, b / 2, 3), [-h / 2, h / 2]), "hex27"
    )
    end, foot = body.surface(near(0, L)), body.nodes_where(lambda X: np.abs(X).max(axis=1) < 1e-9)
    at = body.nodes_where(lambda X: np.linalg.norm(X - (L, b / 2, 0), axis=1) < 1e-9)
    rows = flat_rows(body, end)
    base = held(body, 0, 0.0, 0)
    fixed = [*base, Fixed(foot, AXES[1]), Fixed(foot, AXES[2]), *held(body, 2, 0.0, 2)]
    terms = [Elastic(body, SmallStrain(E, 0.0)), PointLoad(body, at, lambda e: (e * P, 0, 0))]
    scene = Scene(body, terms, fixed=fixed, rows=rows)
    x = solved(scene)
    u = scene.displacement(x, 1.0)
    face = np.unique(end.nodes)
    exact = P * L / (E * b * h) * (1 + body.nodes[face, 1] * (b / 2) * 12 / b**2)
    np.testing.assert_allclose(u[face, 0], exact, atol=1e-10 * exact.max())
    assert scene.system(x, 1.0).unstable == 0
    # The base pulls back, with the moment of the load about its middle.
    back = reaction(scene, x, 1.0, base[0])
    assert back.force == approx([-P, 0, 0], abs=1e-9 * P)
    assert back.moment[2] == approx(P * b / 2, rel=1e-3)
    # Held against turning as well, the end moves by the mean alone.
    still = mean_rotation_row(body, end, AXES[2])
    scene = Scene(body, terms, fixed=fixed, rows=[*rows, still])
    x = solved(scene)
    u = scene.displacement(x, 1.0)
    np.testing.assert_allclose(u[face, 0], P * L / (E * b * h), rtol=1e-10)
    # The row's moment balances that of the load.
    assert reaction(scene, x, 1.0, still).moment[2] == approx(P * b / 2, rel=1e-3)


def test_an_end_that_is_turned_bends_a_strip_to_an_arc():
    # B = 1: moment θ/L, drop (1 − cos θ)/θ, shortening 1 − sin θ/θ; no force.
    theta, h = 0.5, 0.005
    body, fixed = strip(h, 10)
    end = mean_rotation_row(body, body.surface(near(0, 1.0)), AXES[1], lambda e: np.sin(e * theta))
    clamp = body.nodes_where(near(0, 0.0))
    fixed += [Fixed(clamp, axis) for axis in AXES]
    scene = Scene(body, [Elastic(body, NeoHookean(modulus(h), 0.0))], fixed=fixed, rows=[end])
    x, e = at_end(scene)
    drop, shortening, _ = MidLine(scene).tip(x, e)
    assert drop == approx((1 - np.cos(theta)) / theta, rel=5e-3)
    assert shortening == approx(1 - np.sin(theta) / theta, rel=5e-3)
    turn, root = reaction(scene, x, e, end), reaction(scene, x, e, clamp)
    assert turn.moment[1] / h == approx(theta, rel=5e-3)
    assert root.moment == approx(-turn.moment, abs=1e-6 * h)
    assert np.abs([turn.force, root.force]).max() < 1e-6 * h
    # The work that the row does is the energy: ½ M θ.
    assert scene.energy(x, e) / h == approx(theta**2 / 2, rel=5e-3)


def test_a_clamp_carries_the_load_with_its_arm():
    scene = cantilever(tip_load=4.0)
    x, e = at_end(scene)
    h, clamp = 0.01, scene.body.nodes_where(near(0, 0.0))
    inner = np.setdiff1d(clamp, scene.body.nodes_where(lambda X: X[:, 0] > 0.5))
    root = reaction(scene, x, e, clamp)
    assert root.force[[0, 2]] == approx([0, 4 * h], abs=1e-8)
    # references.md §1: the tip stands at 1 − 0.328941242.
    assert root.moment[1] / h == approx(-4 * (1 - 0.328941242), rel=5e-3)
    parts = [reaction(scene, x, e, Fixed(inner, axis)) for axis in AXES]
    assert sum(p.force for p in parts) == approx(root.force, abs=1e-12)
    assert sum(p.moment for p in parts) == approx(root.moment, abs=1e-12)
    moved = reaction(scene, x, e, clamp, about=(1, 0, 0))
    assert moved.moment == approx(root.moment - np.cross((1, 0, 0), root.force), abs=1e-12)
    mask = np.isin(np.arange(scene.n_nodes), clamp)
    assert reaction(scene, x, e, mask).force == approx(root.force, abs=1e-15)


def test_supports_and_rows_together_carry_the_weight():
    # A curved beam on a hinge and a roller at an angle; one row sees the roller's nodes too.
    body = Body.build(box([1, 2], np.linspace(0, 1, 5), [0, 0.5], shape=polar), "hex27")
    radial = np.array([np.cos(1.0), np.sin(1.0), 0])
    ends = [
        body.surface(lambda X, a=a: np.abs(np.arctan2(X[:, 1], X[:, 0]) - a) < 1e-3) for a in (0, 1)
    ]
    rows = [mean_displacement_row(body, ends[0], axis) for axis in AXES[[0, 2]]]
    rows += [translation_row(body, 1), mean_rotation_row(body, ends[0], (1, 0, 0))]
    roller = Fixed(np.unique(ends[1].nodes), radial)
    terms = [
        Elastic(body, NeoHookean(50.0, 0.3)),
        Gravity(body, 1.0, lambda e: (0, -0.2 * e, -0.1 * e)),
    ]
    terms.append(Traction(body, ends[1], lambda e: (0.01 * e, 0, 0)))
    scene = Scene(body, terms, fixed=[roller], rows=rows)
    x, e = at_end(scene)
    u = scene.displacement(x, e)
    loads = -sum(term.evaluate(u, e, 1).force for term in terms[1:])
    carried = [reaction(scene, x, e, at) for at in (roller, *rows)]
    assert sum(r.force for r in carried) == approx(-loads.sum(axis=0), abs=1e-8)
    moment = np.cross(body.nodes + u, loads).sum(axis=0)
    assert sum(r.moment for r in carried) == approx(-moment, abs=1e-8)
    assert min(np.abs(r.force).max() for r in carried[:4]) > 1e-4
    assert np.cross(carried[0].force, radial) == approx(np.zeros(3), abs=1e-12)


BODY = BODIES["hex8"]
SCENE = Scene(BODY, [Elastic(BODY, NeoHookean(1.0, 0.3))], rows=[translation_row(BODY, 0)])
AT_REST = np.zeros(SCENE.size)


@pytest.mark.parametrize("size", [0.5, 3.0])
def test_a_support_carries_the_same_however_long_its_direction_is(size):
    x, d = SCENE.unknowns(0.1 * BODY.nodes[:, ::-1]), np.array([0.6, 0.0, 0.8])
    one, other = (reaction(SCENE, x, 0.0, Fixed([0, 1], k * d)) for k in (1.0, size))
    assert np.linalg.norm(one.force) > 1e-3
    assert other.force == approx(one.force, rel=1e-12)
    assert other.moment == approx(one.moment, rel=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mean_displacement_row(BODY, side(BODY), 0), "direction 0: expected three numbers"),
        (lambda: mean_displacement_row(BODY, [0, 1], AXES[0]), "got list .*Surface .* or a Line"),
        (lambda: mean_rotation_row(BODY, "x+", AXES[0]), "got str .*Surface .* or a Line"),
        (lambda: flat_rows(BODY, side(BODIES["hex27"])), "it belongs to another body"),
        (lambda: mean_rotation_row(BODY, side(BODY), (0, 0, 0)), r"axis \(0, 0, 0\): expected"),
        (
            lambda: mean_rotation_row(
                BODY, Line.of(BODY, np.flatnonzero((BODY.nodes[:, 1:] == 0).all(axis=1))), (2, 0, 0)
            ),
            "the region lies along the axis",
        ),
        (
            lambda: flat_rows(BODY, BODY.surface(lambda X: X[:, 0] * X[:, 2] == 0)),
            "the face isn't plane: a node is .* off",
        ),
        (
            lambda: reaction(SCENE, AT_REST, 0.0, translation_row(BODY, 0)),
            "the row 'translation x' is none of this scene's",
        ),
        (lambda: reaction(SCENE, AT_REST, 0.0, [99]), "nodes 99 … 99; the body has"),
        (
            lambda: reaction(SCENE, SCENE.unknowns(-2 * BODY.nodes), 0.0, [0]),
            "a term does not admit this state",
        ),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=message):
        make()
