"""Small scenes with known paths, for the tests of path following: bars and plain functions."""

from dataclasses import dataclass

import numpy as np

from solver.equilibrium.scene import Scales, Scene
from solver.mesh.body import NodeGraph
from solver.physics.loads import PointLoad
from solver.physics.supports import Fixed
from solver.physics.term import Evaluation


@dataclass(frozen=True, eq=False)
class Nodes:
    """As much of a body as a scene of bars needs."""

    nodes: np.ndarray
    length: float

    def locking(self, u=None):
        return ()


class ToyScene(Scene):
    """A scene of nodes that are no solid: that they move rigidly without resistance is meant."""

    def refuse_free_motion(self, x, e):
        pass

    def obstacle(self, x, e):
        return ""


class Bars:
    """Bars of engineering strain: energy Σ EA L/2 (l/L − 1)²."""

    symmetric = True
    name = "bars"

    def __init__(self, nodes, bars, EA):
        self.X, self.bars = nodes, np.asarray(bars)
        self.L = np.linalg.norm(self.X[self.bars[:, 1]] - self.X[self.bars[:, 0]], axis=1)
        self.EA = np.broadcast_to(EA, len(self.bars))
        self.graph = NodeGraph.of(len(nodes), self.bars.astype(np.int32))
        self.where = self.graph.positions(self.bars)

    def evaluate(self, u, e, order=2):
        x = self.X + u
        d = x[self.bars[:, 1]] - x[self.bars[:, 0]]
        length = np.linalg.norm(d, axis=1)
        strain = length / self.L - 1
        energy = float((self.EA * self.L * strain**2 / 2).sum())
        t = d / length[:, None]
        pull = (self.EA * strain)[:, None] * t
        force = np.zeros_like(u)
        np.add.at(force, self.bars[:, 1], pull)
        np.add.at(force, self.bars[:, 0], -pull)
        tt = t[:, :, None] * t[:, None, :]
        k = (self.EA / self.L)[:, None, None] * tt
        k = k + (self.EA * strain / length)[:, None, None] * (np.eye(3) - tt)
        blocks = np.zeros((self.graph.blocks, 3, 3))
        for a in (0, 1):
            for b in (0, 1):
                np.add.at(blocks, self.where[:, a, b], k if a == b else -k)
        return Evaluation(energy, force, blocks)


class Function:
    """E(q, e), its gradient and Hessian; q the x displacements of all nodes. None: no energy."""

    name = "function"

    def __init__(self, n, energy, gradient, hessian, symmetric=True):
        self.symmetric = symmetric
        self.n, self.f, self.g, self.h = n, energy, gradient, hessian
        self.graph = NodeGraph.of(n, np.arange(n, dtype=np.int32)[None, :])

    def evaluate(self, u, e, order=2):
        q = u[:, 0]
        energy = None if self.f is None else float(self.f(q, e))
        if energy == np.inf:
            return Evaluation(np.inf)
        force = np.zeros_like(u)
        force[:, 0] = self.g(q, e)
        blocks = np.zeros((self.n, self.n, 3, 3))
        blocks[:, :, 0, 0] = self.h(q, e)
        return Evaluation(energy, force, blocks.reshape(-1, 3, 3))


def function_scene(n, energy, gradient, hessian, symmetric=True, length=1.0):
    body = Nodes(np.arange(3.0 * n).reshape(n, 3), 1.0)
    everything = np.arange(n)
    return ToyScene(
        body,
        [Function(n, energy, gradient, hessian, symmetric)],
        fixed=[Fixed(everything, (0, 1, 0)), Fixed(everything, (0, 0, 1))],
        scales=Scales(length, 1 / length, 1.0),
    )


def truss(rise=0.1, length=1.0):
    """Von Mises truss, half span ``length``, EA = 1; e = P / 2EA, downward at the crown (free: y).

    The rise is in lengths.
    """
    X = length * np.array([[-1.0, 0, 0], [0, rise, 0], [1, 0, 0]])
    ends, crown = np.array([0, 2]), np.array([1])
    fixed = [Fixed(ends, d) for d in np.eye(3)] + [Fixed(crown, d) for d in np.eye(3)[[0, 2]]]
    body = Nodes(X, 2.0 * length)
    load = PointLoad(body, crown, lambda e: (0, -2 * e, 0))
    return ToyScene(body, [Bars(X, [[0, 1], [1, 2]], 1.0), load], fixed=fixed)


def truss_load(w, rise=0.1):
    """P / 2EA of the crown's drop w, from the equilibrium of the crown."""
    L, y = np.hypot(1, rise), rise - w
    return (1 / np.hypot(1, y) - 1 / L) * y


def truss_on_spring(stiffness, rise=0.1):
    """The truss driven by the end of a long vertical bar: e = drop of that end."""
    X = np.array([[-1.0, 0, 0], [0, rise, 0], [1, 0, 0], [0, rise - 100.0, 0]])
    EA = np.array([1.0, 1.0, stiffness * 100.0])
    ends, sliders = np.array([0, 2]), np.array([1, 3])
    fixed = [Fixed(ends, d) for d in np.eye(3)] + [Fixed(sliders, d) for d in np.eye(3)[[0, 2]]]
    fixed.append(Fixed(np.array([3]), (0, 1, 0), lambda e: -e))
    return ToyScene(Nodes(X, 2.0), [Bars(X, [[0, 1], [1, 2], [1, 3]], EA)], fixed=fixed)


def column(*stiffness, cubic=0.0, quintic=0.0):
    """Rigid columns on rotational springs of moment k (θ + cubic θ³ + quintic θ⁵) under the load e.

    One more unknown, the last, moves with the load: q = e.
    """
    k = np.array(stiffness)

    def energy(q, e):
        t = q[:-1]
        spring = k @ (t**2 / 2 + cubic * t**4 / 4 + quintic * t**6 / 6)
        return spring - e * (1 - np.cos(t)).sum() + q[-1] ** 2 / 2 - e * q[-1]

    def gradient(q, e):
        t = q[:-1]
        return np.append(k * (t + cubic * t**3 + quintic * t**5) - e * np.sin(t), q[-1] - e)

    def hessian(q, e):
        t = q[:-1]
        stiffness = k * (1 + 3 * cubic * t**2 + 5 * quintic * t**4)
        return np.diag(np.append(stiffness - e * np.cos(t), 1.0))

    return function_scene(len(k) + 1, energy, gradient, hessian)


def carousel(stiffness=10.0):
    """A closed path without energy: q goes round the unit circle while e = (1 − cos 2φ) / 2."""

    def gradient(q, e):
        r, phi = np.hypot(*q), np.arctan2(q[1], q[0])
        out, round_ = q / r, np.array([-q[1], q[0]]) / r
        return stiffness * (r - 1) * out + ((1 - np.cos(2 * phi)) / 2 - e) / r * round_

    def hessian(q, e):
        r, phi = np.hypot(*q), np.arctan2(q[1], q[0])
        out, round_ = q / r, np.array([-q[1], q[0]]) / r
        oo, rr = np.outer(out, out), np.outer(round_, round_)
        mixed = np.outer(out, round_) + np.outer(round_, out)
        f = (1 - np.cos(2 * phi)) / 2 - e
        return (
            stiffness * oo
            + stiffness * (r - 1) / r * rr
            + np.sin(2 * phi) / r**2 * rr
            - f / r**2 * mixed
        )

    return function_scene(2, None, gradient, hessian)
