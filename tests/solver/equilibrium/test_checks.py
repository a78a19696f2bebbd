"""What no equilibrium can be found of is refused in one sentence, when the scene is built."""

import numpy as np
import pytest
import skfem

from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.paths.continuation import trace
from solver.paths.steppers import LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, Held, Row, rotation_row, translation_row

X, Y, Z = np.eye(3)


def box(*intervals, n=(2, 2, 2)):
    lines = [np.linspace(a, b, k + 1) for (a, b), k in zip(intervals, n, strict=True)]
    return skfem.MeshHex.init_tensor(*lines)


@pytest.fixture(scope="module")
def body():
    return Body.build(box((0, 1), (0, 1), (0, 1)), "hex8")


def scene(body, fixed=(), rows=(), **options):
    return Scene(body, [Elastic(body, NeoHookean(1.0, 0.3), **options)], fixed=fixed, rows=rows)


def picking(body, node, axis, factor=1.0, value=0.0, name="picked"):
    c = np.zeros_like(body.nodes)
    c[node, axis] = factor
    return Row(c, value, name)


def test_two_values_on_the_same_nodes_contradict_each_other():
    one = Fixed([0, 1], X, 0.1)
    with pytest.raises(ValueError, match=r"node 1 is moved by 0\.1 and by 0\.2 along one"):
        Held(3, [one, Fixed([2, 1], X, 0.2)])
    # Against the axis the same motion has the other sign; per node, order does not matter.
    agreed = Held(3, [one, Fixed([1], -2 * X, -0.1), Fixed([2, 1, 0], X, [0.3, 0.1, 0.1])])
    np.testing.assert_allclose(agreed.values(0.0)[::3], [0.1, 0.1, 0.3])
    with pytest.raises(ValueError, match="contradict"):
        Held(3, [one, Fixed([1], -X, 0.1)])
    # So do two values for one node within a support.
    with pytest.raises(ValueError, match=r"node 2 is moved by 0\.1 and by 0\.4"):
        Held(3, [Fixed([0, 2, 1, 2], X, [0.0, 0.1, 0.2, 0.4])])
    # Contradictions that come with the load are seen there.
    later = Held(3, [Fixed([0], X, lambda e: e), Fixed([0], X, lambda e: 2 * e)])
    with pytest.raises(ValueError, match=r"by 0\.5 and by 1 along one direction at e = 0\.5"):
        later.values(0.5)


def test_values_per_node_go_with_their_nodes_in_any_order():
    held = Held(5, [Fixed([4, 0, 2], [0, 3, 4], [0.4, 0.0, 0.2])])
    u = held.to_global(held.values(0.0).reshape(-1, 3))
    np.testing.assert_allclose(u @ [0, 0.6, 0.8], [0, 0, 0.2, 0, 0.4], atol=1e-15)


def test_directions_at_an_angle_agree_only_at_rest():
    for one, two in ((0.1, 0.0), (0.0, 0.1), (lambda e: 0.0, 0.0), (0.0, [0.0, 0.1])):
        with pytest.raises(ValueError, match="node 1 is moved along directions at an angle"):
            Held(3, [Fixed([0, 1], X, one), Fixed([2, 1], [1, 1, 0], two)])
    assert list(np.flatnonzero(~Held(3, [Fixed([1], X), Fixed([1], [1, 1, 0])]).free)) == [3, 4]


def test_every_support_is_met_whatever_its_direction_and_order():
    rng = np.random.default_rng(3)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    everywhere = np.zeros(12)
    everywhere[[7, 8]] = rng.normal(size=2)
    fixed = [
        Fixed([5, 3, 4], frame[0], lambda e: e * np.array([0.5, 0.3, 0.4])),
        Fixed([2, 3, 4], -2 * frame[1], [0.2, 0.3, 0.4]),
        Fixed([4, 3], frame[2], 0.7),
        Fixed([3, 9, 3], frame[1], [-0.3, 0.9, -0.3]),
        Fixed([8, 7], -Y, everywhere[[8, 7]]),
        Fixed([7, 1], Z, [0.1, 0.6]),
        Fixed([10, 11], [1, 1, 0]),
        Fixed([11], [1, -2, 0]),
        Fixed([11], X),
    ]
    held = Held(12, fixed)
    u = held.to_global((held.values(0.5) + rng.normal(size=36) * held.free).reshape(-1, 3))
    for support in fixed:
        value = support.value(0.5) if callable(support.value) else support.value
        d = np.asarray(support.direction) / np.linalg.norm(support.direction)
        np.testing.assert_allclose(u[support.nodes] @ d, value, atol=1e-14)
    assert np.bincount(np.flatnonzero(~held.free) // 3).tolist() == [
        0,
        1,
        1,
        3,
        3,
        1,
        0,
        2,
        1,
        1,
        1,
        2,
    ]
    assert list(held.turned) == [2, 3, 4, 5, 9, 10, 11]


def test_a_mask_names_nodes():
    mask = np.array([False, True, False, True])
    by_mask = Held(4, [Fixed(mask, X, [0.1, 0.3])])
    np.testing.assert_allclose(by_mask.values(0.0)[::3], [0, 0.1, 0, 0.3])
    assert list(np.flatnonzero(~by_mask.free)) == [3, 9]


@pytest.mark.parametrize(
    "fixed, message",
    [
        (Fixed(np.ones(3, bool), X), r"shape \(3,\) and type bool; expected numbers of nodes or a"),
        (Fixed([], X), "at least one"),
        (Fixed([0.0, 1.0], X), "type float64"),
        (Fixed([[0, 1]], X), r"shape \(1, 2\)"),
        (Fixed([[0], [1, 2]], X), r"nodes is \[\[0\], \[1, 2\]\]; expected numbers"),
        (Fixed([4], X), "nodes 4 … 4; the body has 0 … 3"),
        (Fixed([-1, 2], X), "nodes -1 … 2"),
        (
            Fixed([0, 1], X, [1.0, 2.0, 3.0]),
            r"shape \(3,\); expected one finite number, or one for",
        ),
        (Fixed([0, 1], X, np.nan), "finite"),
        (Fixed([0, 1], X, lambda e: np.inf), "e = 0"),
        (Fixed([0, 1], X, "much"), "value is 'much'; expected numbers"),
        (Fixed([0, 1], X, {}), "value is {}; expected numbers"),
        (Fixed([0], [np.nan, 1, 0]), "expected three numbers, not 0"),
        (Fixed([0], [1, 0]), "expected three numbers, not 0"),
        (Fixed([0], "x"), "direction is 'x'; expected numbers"),
    ],
)
def test_a_support_that_makes_no_sense_is_refused(fixed, message):
    with pytest.raises(ValueError, match=message):
        Held(4, [fixed])


def test_everything_fixed_leaves_nothing_to_solve_for(body):
    everything = np.arange(len(body.nodes))
    with pytest.raises(ValueError, match="every displacement is prescribed"):
        scene(body, [Fixed(everything, d) for d in (X, Y, Z)])


def test_rows_that_see_only_what_is_held_are_refused(body):
    low = body.nodes_where(lambda x: x[:, 2] < 1e-9)
    clamp = [Fixed(low, d) for d in (X, Y, Z)]
    with pytest.raises(ValueError, match="row 'picked' sees only what is held by Fixed"):
        scene(body, clamp, [picking(body, low[0], 0, value=0.1)])
    # A row that also sees what is free has something to do.
    both = picking(body, [low[0], body.nodes[:, 2].argmax()], 0, value=0.1)
    assert scene(body, clamp, [both]).n_rows == 1


def test_rows_that_follow_from_each_other_are_named(body):
    rows = [translation_row(body, k) for k in range(3)]
    for factor, value in ((1.0, 0.0), (-3.0, 0.2)):
        again = Row(factor * rows[1].coefficients, value, "again")
        with pytest.raises(ValueError, match="rows 'translation y', 'again' are not independent"):
            scene(body, rows=[*rows, again])
    # Three of two are dependent without any two being so; the held node adds nothing.
    held = Fixed([5], X)
    third = picking(body, [0, 1, 5], 0, name="sum")
    with pytest.raises(ValueError, match="'a', 'b', 'sum'"):
        scene(
            body, [held], [picking(body, 0, 0, name="a"), picking(body, 1, 0, 2.0, name="b"), third]
        )
    assert scene(body, rows=[*rows, *(rotation_row(body, k) for k in range(3))]).n_rows == 6


@pytest.mark.parametrize("factor", [1e-8, 1e8])
def test_rows_are_as_independent_in_any_unit(body, factor):
    """In nanometres or in metres: rows of small coefficients counted as repeating each other."""
    rows = [
        picking(body, k, axis, factor, 1e-3 * factor, f"row {k}")
        for k, axis in ((0, 0), (5, 1), (9, 2))
    ]
    assert scene(body, rows=[*rows, picking(body, 20, 0, name="one")]).n_rows == 4
    with pytest.raises(ValueError, match="rows 'row 9', 'again' are not independent"):
        scene(body, rows=[*rows, picking(body, 9, 2, name="again")])


@pytest.mark.parametrize(
    "row, message",
    [
        (Row(np.ones((4, 3))), r"coefficients of shape \(4, 3\); expected \(27, 3\), finite"),
        (Row(np.ones(81)), r"shape \(81,\)"),
        (Row(np.zeros((27, 3))), "not all zero"),
        (Row(np.full((27, 3), np.nan)), "finite"),
        (Row("much"), "row 'row' is 'much'; expected numbers"),
        (Row(np.ones((27, 3)), np.nan), "has the value nan at e = 0; expected one finite"),
        (Row(np.ones((27, 3)), [1.0, 2.0]), "expected one finite number"),
        (Row(np.ones((27, 3)), lambda e: 1 / e if e else np.inf), "value inf"),
    ],
)
def test_a_row_that_makes_no_sense_is_refused(body, row, message):
    with pytest.raises(ValueError, match=message):
        scene(body, rows=[row])


def test_a_row_whose_value_is_lost_on_the_way_is_named(body):
    clamp = [Fixed(body.nodes_where(lambda x: x[:, 2] < 1e-9), d) for d in (X, Y, Z)]
    row = picking(body, body.nodes[:, 2].argmax(), 0, value=lambda e: 0.1 * e if e < 0.6 else None)
    held = scene(body, clamp, [row])
    with pytest.raises(ValueError, match=r"row 'picked' has the value nan at e = 0\.[67]\d*; exp"):
        trace(held, np.zeros(held.size), LoadSteps(1e-8, 0.25), max_steps=20)


def test_cells_without_material_are_named_and_no_singular_matrix(body):
    low = body.nodes_where(lambda x: x[:, 2] < 1e-9)
    clamp = [Fixed(low, d) for d in (X, Y, Z)]
    half = scene(body, clamp, cells=body.cells_where(lambda x: x[:, 2] < 0.5))
    with pytest.raises(
        ValueError, match=r"^9 nodes have no stiffness, the first at \(.*, 1\): cells"
    ):
        half.refuse_free_motion(np.zeros(half.size), 0.0)
    # Where the bare nodes are all held, nothing is missing.
    top = body.nodes_where(lambda x: x[:, 2] > 1 - 1e-9)
    all_held = [*clamp, *(Fixed(top, d) for d in (X, Y, Z))]
    whole = scene(body, all_held, cells=body.cells_where(lambda x: x[:, 2] < 0.5))
    whole.refuse_free_motion(np.zeros(whole.size), 0.0)


def test_a_part_that_nothing_holds_is_named():
    one, two = box((0, 1), (0, 1), (0, 1)), box((3, 4), (0, 1), (0, 1))
    body = Body.build(one + two, "hex8", parts=True)
    low = body.nodes_where(lambda x: x[:, 0] < 1e-9)
    clamp = [Fixed(low, d) for d in (X, Y, Z)]
    loose = scene(body, clamp)
    with pytest.raises(ValueError, match=r"^6 of .* of the part around \(3.5, 0.5, 0.5\)"):
        loose.refuse_free_motion(np.zeros(loose.size), 0.0)
    # One pin leaves three rotations; a hinge line one; rows see the parts together.
    right = np.flatnonzero(body.nodes[:, 0] > 2)
    pin = [Fixed(right[:1], d) for d in (X, Y, Z)]
    pinned = scene(body, clamp + pin)
    with pytest.raises(ValueError, match=r"^3 of .* part around \(3.5"):
        pinned.refuse_free_motion(np.zeros(pinned.size), 0.0)
    far = body.nodes_where(lambda x: x[:, 0] > 4 - 1e-9)
    both = scene(body, clamp + [Fixed(far, d) for d in (X, Y, Z)])
    both.refuse_free_motion(np.zeros(both.size), 0.0)


def test_a_motion_that_compression_makes_unstable_is_not_called_free(body):
    edge = body.nodes_where(lambda P: (P[:, 0] < 1e-9) & (P[:, 2] < 1e-9))
    hinged = scene(body, [Fixed(edge, d) for d in (X, Y, Z)])
    with pytest.raises(ValueError, match="1 of the body's rigid motions meet no resistance"):
        hinged.refuse_free_motion(np.zeros(hinged.size), 0.0)
    for stretch in (0.1, -0.1):
        strained = hinged.unknowns(stretch * body.nodes * X)
        hinged.refuse_free_motion(strained, 0.0)
