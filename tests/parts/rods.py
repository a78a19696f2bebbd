"""Coarse heavy rods and their derivatives, for the tests of the planar rod."""

import numpy as np

from solver.cases.unit import rod_kernel as kernel


def strip(gamma, hinge, panel, *, h=1e-3, parts=(40, 80)):
    """Lengths, intervals, nodes and ground of the heavy strip of references.md §2."""
    s = np.r_[np.linspace(0, 0.1, parts[0] + 1), np.linspace(0.1, 0.5, parts[1] + 1)[1:]]
    lengths = np.diff(s)
    share = np.r_[lengths / 2, 0] + np.r_[0, lengths / 2]
    rods = np.stack([lengths, np.full(len(lengths), panel) / lengths, 0 * lengths], axis=1)
    rods[: parts[0], kernel.STIFF] = hinge / lengths[: parts[0]]
    nodes = np.stack([gamma * share, 0 * share, share], axis=1)
    ground = np.array([gamma / -kernel._barrier(0.5)[1], 0.2 * h, 0.1 * h, 0.0])
    return lengths, rods, nodes, ground


def gradient(x, rods, nodes, ground):
    """As the recursion gives it."""
    shape, load = np.zeros((6, len(x))), np.zeros(len(x))
    kernel.energy(x, rods, nodes, ground, shape)
    scratch = np.zeros(len(x)), np.zeros((len(x), 3))
    kernel.solve(x, rods, nodes, ground, shape, load, False, *scratch)
    return -load


def differences(f, x, step):
    """∂f/∂x by central differences, in the first axis."""
    return np.array([(f(x + d) - f(x - d)) / (2 * step) for d in step * np.eye(len(x))])


def pressed(gamma=60.0, bend=0.0):
    """A coarse strip that bends, lies on the ground and is pressed into it."""
    _, rods, nodes, ground = strip(gamma, 1.0, 1.0, h=0.1, parts=(3, 4))
    nodes[:3, kernel.OFFSET] = 0.3
    ground[kernel.BELOW] = 0.05
    rods[:3, kernel.TURN] = 0.2
    x = np.concatenate([[-4e-3], 0.1 + bend + 0.05 * np.sin(np.arange(7))])
    return x, rods, nodes, ground
