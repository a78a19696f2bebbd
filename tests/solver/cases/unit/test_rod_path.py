"""The rod's path and what its history tells, against closed forms and dense matrices."""

import numpy as np
import pytest
from rods import differences, gradient, pressed, strip

from solver.cases.unit import rod_kernel as kernel

TABLE = np.array([
    [0.3, 2.0, 1.0, 0.0], [0.5, 2.5, 0.97, 0.01], [0.4, 2.2, 0.9, 0.03], [0.9, 3.0, 0.95, 0.02],
])  # fmt: skip


@pytest.mark.parametrize("e", [0.0, 1 / 3, 2 / 3, 1.0, 0.2, 0.85])
def test_a_load_between_the_sections_is_cubic_between_them(e):
    lengths, width, end = np.array([0.1, 0.2, 0.3, 0.4]), 0.7, 0.05
    rods = np.zeros((4, 3))
    kernel.set_load(e, lengths, 2, width, TABLE, end, rods)
    at = np.array([0, 1 / 3, 2 / 3, 1])
    curvature, bending, stretch, turn = (
        np.polynomial.Polynomial.fit(at, column, 3)(e) for column in TABLE.T
    )
    inner, last = rods[:2]
    assert inner == pytest.approx([0.1 * stretch, width * bending / 0.1, curvature * 0.1])
    # The end of the active layer gives way, and turns the last interval.
    stiff = width / (0.2 / bending + end)
    assert last == pytest.approx([0.2 * stretch, stiff, curvature * 0.2 + turn])
    assert not rods[2:].any()


def walked(rules, states=300, curvature=10.0, hinge=1.0, gamma=20.0):
    lengths, rods, nodes, ground = strip(gamma, hinge, 1.0, parts=(10, 20))
    table = np.array([[curvature * k / 3, hinge, 1.0, 0.0] for k in range(4)])
    x, history = np.zeros(len(lengths) + 1), np.zeros((states, 8))
    ending, count, iterations = kernel.follow(
        lengths, 10, 1.0, table, 0.0, rods, nodes, ground, rules, x, history
    )
    return ending, history[:count], iterations, (x, rods, nodes, ground)


def test_steps_begin_as_told_double_at_most_and_end_on_the_full_load():
    ending, history, *_ = walked((0.01, 0.15, 1e-4, 1e-8, 0.3))
    loads = history[:, kernel.LOAD]
    steps = np.diff(loads)
    assert ending == kernel.REACHED and (loads[0], loads[-1]) == (0.0, 1.0)
    assert steps[0] == pytest.approx(0.01)
    assert steps[:3] == pytest.approx([0.01, 0.02, 0.04])
    assert (steps[1:-1] <= 2 * steps[:-2] + 1e-12).all()
    # No sliver at the end.
    assert max(steps[:-1]) == pytest.approx(0.15) and max(steps) <= 1.3 * 0.15
    assert steps[-1] >= 0.3 * steps[-2] - 1e-12
    assert not history[:, kernel.SNAP].any()


@pytest.mark.parametrize(
    ("step", "loads"), [(0.24, [0, 0.24, 0.48, 0.72, 1]), (0.3, [0, 0.3, 0.6, 0.9, 1])]
)
def test_a_last_step_is_no_sliver(step, loads):
    # What would remain is less than three tenths of a step, or it is more.
    history = walked((step, step, 1e-4, 1e-8, 3.0), curvature=1.0)[1]
    assert history[:, kernel.LOAD] == pytest.approx(loads)


def test_a_path_ends_where_its_states_or_its_turn_do():
    ending, history, *_ = walked((0.05, 0.1, 1e-4, 1e-8, 0.3), states=4)
    assert ending == kernel.TOO_LONG and len(history) == 4
    ending, history, *_ = walked((0.05, 0.1, 1e-4, 1e-8, 0.3), curvature=60.0, gamma=0.1)
    assert ending == kernel.CLOSED
    turns = np.abs(history[:, kernel.TIP_ANGLE])
    assert (turns[:-1] < np.pi).all() and turns[-1] >= np.pi


def test_a_step_that_turns_too_far_is_halved_and_not_called_a_jump():
    # Steps so long that a node turns by more than was expected.
    gentle = walked((0.01, 0.02, 1e-4, 1e-8, 0.3))[1][-1]
    ending, history, *_ = walked((0.5, 0.5, 1e-3, 1e-8, 0.05))
    assert ending == kernel.REACHED and not history[:, kernel.SNAP].any()
    assert history[1, kernel.LOAD] < 0.5
    for column in (kernel.TIP_ANGLE, kernel.HINGE_ANGLE, kernel.TIP):
        assert history[-1, column] == pytest.approx(gentle[column], abs=1e-6)


@pytest.mark.parametrize("gamma", [20.0, 400.0])
def test_the_history_tells_the_shape_that_the_path_ended_in(gamma):
    rules = (0.05, 0.1, 1e-4, 1e-8, 0.3)
    _, history, iterations, (x, rods, nodes, ground) = walked(rules, gamma=gamma)
    angles = np.concatenate([[0.0], np.cumsum(x[1:])])
    heights = x[0] + np.concatenate(
        [[0.0], np.cumsum(rods[:, kernel.STRETCHED] * np.sin(angles[:-1] + x[1:] / 2))]
    )
    last = history[-1]
    assert last[kernel.TIP_ANGLE] == pytest.approx(angles[-1])
    assert last[kernel.HINGE_ANGLE] == pytest.approx(angles[10])
    assert last[kernel.TIP] == pytest.approx(heights[-1])
    assert last[kernel.LOWEST] == pytest.approx(heights.min(), abs=1e-12)
    # Where much weight lies beside it the middle is not the lowest.
    assert (heights.argmin() > 0) == (gamma > 100)
    assert len(history) < iterations < 15 * len(history)
    # At rest on the ground, which bears all of it: forces balance.
    assert np.abs(gradient(x, rods, nodes, ground)).max() < 1e-5


def dense(x, rods, nodes, ground):
    hessian = differences(lambda y: gradient(y, rods, nodes, ground), x, 1e-6)
    return (hessian + hessian.T) / 2


@pytest.mark.parametrize("gamma", [20.0, 60.0])
def test_softness_is_the_least_stiffness_against_bending(gamma):
    _, history, _, state = walked((0.05, 0.1, 1e-4, 1e-8, 0.3), gamma=gamma)
    rods = state[1]
    hessian = dense(*state)
    # The height follows the turns.
    condensed = hessian[1:, 1:] - np.outer(hessian[1:, 0], hessian[0, 1:]) / hessian[0, 0]
    root = 1 / np.sqrt(rods[:, kernel.STIFF])
    least = np.linalg.eigvalsh(root[:, None] * condensed * root)[0]
    # Few inverse iterations come near to it from above.
    assert least * (1 - 1e-6) <= history[-1, kernel.SOFTNESS] <= 1.06 * least


@pytest.mark.parametrize("gamma", [60.0, 500.0, 1200.0, 2000.0])
@pytest.mark.parametrize("bend", [0.0, 0.35])
def test_rocking_is_one_more_mode_of_a_rod_whose_middle_may_turn(gamma, bend):
    """A first interval of no length and no stiffness lets the middle turn."""
    x, rods, nodes, ground = pressed(gamma, bend)
    shape, scratch = np.zeros((6, len(x))), (np.zeros(len(x)), np.zeros((len(x), 3)))
    kernel.energy(x, rods, nodes, ground, shape)
    _, rocking, _ = kernel.solve(x, rods, nodes, ground, shape, np.zeros(len(x)), False, *scratch)
    held = dense(x, rods, nodes, ground)[1:, 1:]
    hinged = np.insert(x, 1, 0.0), np.insert(rods, 0, 0.0, axis=0), np.insert(nodes, 0, 0.0, axis=0)
    turning = differences(lambda y: hinged_gradient(y, *hinged[1:], ground), hinged[0], 1e-6)
    turning = ((turning + turning.T) / 2)[1:, 1:]
    more = (np.linalg.eigvalsh(turning) < 0).sum() - (np.linalg.eigvalsh(held) < 0).sum()
    assert rocking == more


def hinged_gradient(x, rods, nodes, ground):
    """By differences of the energy: the recursion divides by the stiffness of each interval."""
    shape = np.zeros((6, len(x)))
    return differences(lambda y: kernel.energy(y, rods, nodes, ground, shape), x, 1e-5)


def settled(x, rods, nodes, ground, most=200):
    n = len(x)
    shape, work, gains = np.zeros((6, n)), np.zeros((3, n)), np.zeros((n, 3))
    return kernel.settle(x, rods, nodes, ground, shape, work, gains, 1e-9, most)


def test_what_a_node_has_turned_by_is_told_from_where_it_began():
    _, *parts = strip(20.0, 1.0, 1.0, parts=(10, 20))
    x = np.zeros(31)
    assert settled(x, *parts)[0] > 0
    used, _, moved = settled(x, *parts)
    assert 0 < used <= 3 and moved < 1e-8
    x[15] += 0.2
    assert settled(x, *parts)[2] == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize(("load", "leaves"), [(0.9, False), (1.2, True)])
def test_a_saddle_is_left_for_a_state_that_is_stable(load, leaves):
    """Weight far above the line tips it over beyond v = B (π/2L)² per length; L = ½."""
    _, rods, nodes, ground = strip(1e-3, 1.0, 1.0, parts=(10, 20))
    x = np.zeros(31)
    assert settled(x, rods, nodes, ground)[0] > 0
    nodes[:, kernel.OFFSET] = load * np.pi**2 * nodes[:, kernel.AREA]
    # Of roundoff alone it would take thrice as long.
    used, _, moved = settled(x, rods, nodes, ground, most=30)
    assert used > 0 and (moved > 0.1) is leaves, used
    assert np.abs(gradient(x, rods, nodes, ground)).max() < 1e-6
    assert np.linalg.eigvalsh(dense(x, rods, nodes, ground))[0] > 0
