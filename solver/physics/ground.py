"""Ground: frictionless contact with a plane, z = height by default, as a barrier.

The default acts on a surface, is scaled to the thickness of what lies on it, and vanishes beyond a
short reach, so there is no force where there is no contact. The exponential form over the volume is
the dissertation's (Eq. 4.5), with its constants.
"""

from __future__ import annotations

import numba
import numpy as np

from solver.given import axis_number, number, one_of
from solver.mesh.body import Body, NodeGraph, Surface
from solver.physics.term import Evaluation

# Weights of positive rules on the nodes and, last, the centre of a facet whose own nodes would get
# weights that are negative or zero; then the shape functions of the nodes at that centre.
CENTRED = {
    "hex20": (
        np.array([1, 1, 1, 1, 4, 4, 4, 4, 16]) / 36,
        np.array([-1, -1, -1, -1, 2, 2, 2, 2]) / 4,
    ),
    "tet10": (
        np.array([3, 3, 3, 8, 8, 8, 27]) / 60,
        np.array([-1, -1, -1, 4, 4, 4]) / 9,
    ),
}


class Ground:
    """Barrier κ r b(s/r) per reference area of a surface, s the height above a floor.

    Heights are along ``axis``: 2 for a ground; of a body that a mirror plane halves, the normal of
    that plane, so that its halves touch there.

    b(t) = −(t − 1)² ln t for t < 1 and 0 beyond (the incremental-potential-contact form, twice
    continuously differentiable). The floor, where the energy becomes infinite, lies ``depth``
    thicknesses below the ground, and the barrier ends ``reach`` thicknesses above it; r is their
    sum. κ is such that a surface under ``pressure`` rests exactly at ``height``: give the weight
    per area of what lies there (without weight, a small fraction of its modulus). So no point sinks
    deeper than ``depth``, and nothing hovers higher than ``reach``, whatever the load.

    It acts at the nodes of the surface (and facet centres where the nodes alone make no positive
    rule), so an edge or a corner can't pass between the points of a quadrature.
    """

    symmetric = True

    def __init__(
        self,
        body: Body,
        surface: Surface,
        *,
        thickness: float,
        pressure: float,
        height: float = 0.0,
        depth: float = 0.1,
        reach: float = 0.1,
        axis: int = 2,
        name: str = "ground",
    ):
        """Raises ValueError unless thickness, pressure, depth and reach are positive."""
        given = {"thickness": thickness, "pressure": pressure, "depth": depth, "reach": reach}
        for key, value in given.items():
            number(f"the ground's {key}", value, above=0)
        height, axis = number("the ground's height", height), axis_number(axis)
        one_of("the ground's surface", Surface, surface, "Body.surface")
        self.name = name
        self.body, self.height, self.thickness = body, height, thickness
        self.axis = axis
        self.depth = depth * thickness
        self._floor = height - self.depth
        self._range = (depth + reach) * thickness
        self._kappa = pressure / -barrier(np.array([depth / (depth + reach)]))[1][0]
        n = len(body.nodes)
        area = np.zeros(n)
        centred = CENTRED.get(body.element)
        if centred is None:
            np.add.at(area, surface.nodes, np.einsum("fq,fqk->fk", surface.weights, surface.shapes))
            k = surface.nodes.shape[1]
            self._centres, self._at_centre = np.empty((0, k), int), np.zeros(k)
            self._centre_area = np.empty(0)
            self.graph = NodeGraph.of(n)
            self._diagonal = np.arange(n)
        else:
            rule, self._at_centre = centred
            whole = surface.weights.sum(axis=1)
            np.add.at(area, surface.nodes, whole[:, None] * rule[:-1])
            self._centres, self._centre_area = surface.nodes, whole * rule[-1]
            self.graph = NodeGraph.of(n, surface.nodes)
            self._diagonal = self.graph.positions(np.arange(n)[:, None]).ravel()
            self._where = self.graph.positions(surface.nodes)
        self._nodes = np.flatnonzero(area > 0)
        self._area = np.concatenate([area[self._nodes], self._centre_area])

    def _heights(self, z: np.ndarray) -> np.ndarray:
        return np.concatenate([z[self._nodes], z[self._centres] @ self._at_centre])

    def gaps(self, u: np.ndarray) -> np.ndarray:
        """Height above the ground of each contact point, (points,); negative: penetration."""
        return self._heights(self.body.nodes[:, self.axis] + u[:, self.axis]) - self.height

    def pressing(self, u: np.ndarray) -> np.ndarray:
        """Force with which each contact point presses on the ground, (points,), 0 or more."""
        t = (
            self._heights(self.body.nodes[:, self.axis] + u[:, self.axis]) - self._floor
        ) / self._range
        return -self._kappa * self._area * barrier(t)[1]

    def at_points(self, values: np.ndarray) -> np.ndarray:
        """Values of the nodes (n, k) at the contact points, (points, k)."""
        centres = np.einsum("pnk,n->pk", values[self._centres], self._at_centre)
        return np.concatenate([values[self._nodes], centres])

    def spread(self, forces: np.ndarray) -> np.ndarray:
        """Forces at the contact points (points, 3) on the nodes, (n, 3)."""
        k, out = len(self._nodes), np.zeros_like(self.body.nodes)
        out[self._nodes] = forces[:k]
        np.add.at(out, self._centres, forces[k:, None, :] * self._at_centre[:, None])
        return out

    def blocks(self, stiffness: np.ndarray) -> np.ndarray:
        """Stiffnesses at the contact points (points, 3, 3) as blocks on the graph."""
        k, out = len(self._nodes), np.zeros((self.graph.blocks, 3, 3))
        out[self._diagonal[self._nodes]] = stiffness[:k]
        if len(self._centres):
            weights = np.outer(self._at_centre, self._at_centre)
            np.add.at(out, self._where, stiffness[k:, None, None] * weights[..., None, None])
        return out

    @property
    def range(self) -> float:
        """How far above the floor the barrier acts."""
        return self._range

    @property
    def area(self) -> np.ndarray:
        """Reference area of each contact point, (points,)."""
        return self._area

    def distances(self, u: np.ndarray) -> np.ndarray:
        """Distance of each contact point from the floor, (points,)."""
        return self._heights(self.body.nodes[:, self.axis] + u[:, self.axis]) - self._floor

    def approach(self, du: np.ndarray) -> np.ndarray:
        """Change of the distances, (points,), with a displacement (n, 3)."""
        return self._heights(du[:, self.axis])

    def push(self, point: int) -> np.ndarray:
        """A unit force away from the floor at a contact point, as forces on the nodes (n, 3)."""
        forces = np.zeros((len(self._area), 3))
        forces[point, self.axis] = 1.0
        return self.spread(forces)

    def longest_step(self, u: np.ndarray, du: np.ndarray) -> float:
        """Fraction of du (n, 3), at most 1, that brings no point nearer to the floor than a tenth
        of its distance."""
        s, ds = self.distances(u), self.approach(du)
        down = ds < 0
        if not down.any():
            return 1.0
        return float(min(1.0, max(0.0, (-0.9 * s[down] / ds[down]).min())))

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and blocks; energy inf where a point is at the floor or below."""
        t = (
            self._heights(self.body.nodes[:, self.axis] + u[:, self.axis]) - self._floor
        ) / self._range
        if not (t > 0).all():
            return Evaluation(np.inf)
        b, first, second = barrier(t)
        energy = float(self._kappa * self._range * (self._area @ b))
        if order < 1:
            return Evaluation(energy)
        k, axis = len(self._nodes), self.axis
        force = np.zeros_like(self.body.nodes)
        f = self._kappa * self._area * first
        force[self._nodes, axis] = f[:k]
        np.add.at(force[:, axis], self._centres, f[k:, None] * self._at_centre)
        if order < 2:
            return Evaluation(energy, force)
        blocks = np.zeros((self.graph.blocks, 3, 3))
        c = self._kappa / self._range * self._area * second
        blocks[self._diagonal[self._nodes], axis, axis] = c[:k]
        if len(self._centres):
            part = c[k:, None, None] * np.outer(self._at_centre, self._at_centre)
            np.add.at(blocks[:, axis, axis], self._where, part)
        return Evaluation(energy, force, blocks, own=True)


def barrier(t: np.ndarray):
    """b = −(t − 1)² ln t and its first two derivatives, 0 for t ≥ 1."""
    near = t < 1
    x = np.where(near, t, 1.0)
    ln, d = np.log(x), x - 1
    return -d * d * ln, -2 * d * ln - d * d / x, -2 * ln - 4 * d / x + d * d / x**2


class GroundExponential:
    """The dissertation's barrier ∫ b exp(−a (z − height)) dV₀ (Eq. 4.5).

    Its constants are a = 1000/l_s and b = 1e-3 E_s: give ``length`` l_s and ``modulus`` E_s. Thin
    sheets hover several thicknesses above it; :class:`Ground` is the better default.
    """

    symmetric = True

    def __init__(
        self,
        body: Body,
        *,
        length: float,
        modulus: float,
        height: float = 0.0,
        name: str = "ground",
    ):
        """Raises ValueError unless length and modulus are positive."""
        for key, value in {"length": length, "modulus": modulus}.items():
            number(f"the ground's {key}", value, above=0)
        height = number("the ground's height", height)
        self.name = name
        self.body, self.height = body, height
        self.a, self.b = 1000.0 / length, 1e-3 * modulus
        self.graph = body.graph

    def gaps(self, u: np.ndarray) -> np.ndarray:
        """Height above the ground of each node, (n,)."""
        return self.body.nodes[:, 2] + u[:, 2] - self.height

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and blocks on the body's graph."""
        body = self.body
        force = np.zeros_like(body.nodes)
        blocks = np.zeros((self.graph.blocks if order >= 2 else 0, 3, 3))
        positions = body.positions if order >= 2 else np.empty((0, 0, 0), np.int32)
        z = self.gaps(u)
        energy = _exponential(
            body.cells, body.shapes, body.weights, z, self.a, self.b, positions, order, force,
            blocks,
        )  # fmt: skip
        if not np.isfinite(energy):
            return Evaluation(np.inf)
        return Evaluation(energy, force if order >= 1 else None, blocks if order >= 2 else None)


@numba.njit(cache=True)
def _exponential(cells, shapes, weights, z, a, b, positions, order, force, blocks):
    energy = 0.0
    m, k = cells.shape
    for e in range(m):
        for q in range(weights.shape[1]):
            height = 0.0
            for n in range(k):
                height += shapes[q, n] * z[cells[e, n]]
            if not a * height > -700.0:  # exp would overflow
                return np.inf
            v = weights[e, q] * b * np.exp(-a * height)
            energy += v
            if order >= 1:
                for n in range(k):
                    force[cells[e, n], 2] -= a * v * shapes[q, n]
            if order >= 2:
                for n in range(k):
                    c = a * a * v * shapes[q, n]
                    for j in range(k):
                        blocks[positions[e, n, j], 2, 2] += c * shapes[q, j]
    return energy
