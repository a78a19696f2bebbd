"""What panels touch: the ground, at their corners, and each other, anywhere.

Contact of panels is the incremental potential of Li et al. (2020) between their middle surfaces,
kept one thickness apart, by the IPC Toolkit. Without friction.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from solver.mesh.body import Body, NodeGraph
from solver.physics.ground import barrier
from solver.physics.term import Evaluation

MARGIN = 0.1  # of the panels' size: how near panels come whose stiffness is kept ready


class PointGround:
    """Barrier between points of panels and the plane z = ``height``, as of
    :class:`solver.physics.ground.Ground`.

    ``points`` (p, n) sparse: weights of the nodes at each point. ``force``: under which a point
    rests exactly at ``height``; ``depth``: how far below that the floor lies, and above it the
    barrier ends.
    """

    name = "ground"
    symmetric = True

    def __init__(
        self, body: Body, points: sp.csr_array, *, force: float, depth: float, height: float = 0.0
    ):
        self.body, self.points, self.height, self.depth = body, sp.csr_array(points), height, depth
        self.range = 2 * depth
        self._rest = self.points @ body.nodes[:, 2]
        self._kappa = force / -barrier(np.array([0.5]))[1][0]
        panels = np.unique(np.arange(len(body.nodes)) // 4)
        self.graph = NodeGraph.of(len(body.nodes), 4 * panels[:, None] + np.arange(4))
        coo = sp.coo_array(self.points.T @ self.points)
        rows = NodeGraph.of(len(body.nodes), np.stack([coo.row, coo.col], axis=1))
        if (self.graph.find(rows) < 0).any():
            raise ValueError("a point lies on more than one panel")

    def heights(self, u: np.ndarray) -> np.ndarray:
        """Of each point above the ground, (p,)."""
        return self._rest + self.points @ u[:, 2] - self.height

    def distances(self, u: np.ndarray) -> np.ndarray:
        """Of each point from the floor, (p,)."""
        return self.heights(u) + self.depth

    def approach(self, du: np.ndarray) -> np.ndarray:
        """Change of the distances, (p,), with a displacement (n, 3)."""
        return self.points @ du[:, 2]

    def push(self, point: int) -> np.ndarray:
        """A unit force away from the floor at a point, as forces on the nodes (n, 3)."""
        force = np.zeros_like(self.body.nodes)
        force[:, 2] = self.points[[point]].toarray()[0]
        return force

    def longest_step(self, u: np.ndarray, du: np.ndarray) -> float:
        """Fraction of du (n, 3), at most 1, that brings no point nearer to the floor than a tenth
        of its distance."""
        s, ds = self.distances(u), self.approach(du)
        down = ds < 0
        return float(min(1.0, (-0.9 * s[down] / ds[down]).min(initial=1.0)))

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and blocks; energy inf where a point is at the floor or below."""
        t = self.distances(u) / self.range
        if not (t > 0).all():
            return Evaluation(np.inf)
        b, first, second = barrier(t)
        energy = self._kappa * self.range * float(b.sum())
        if order < 1:
            return Evaluation(energy)
        force = np.zeros_like(self.body.nodes)
        force[:, 2] = self._kappa * (self.points.T @ first)
        if order < 2:
            return Evaluation(energy, force)
        near = np.flatnonzero(second)
        P = self.points[near]
        K = sp.csr_array(P.T @ sp.diags_array(self._kappa / self.range * second[near]) @ P)
        return Evaluation(energy, force, on_graph(self.graph, K, axis=2), own=True)


def on_graph(graph: NodeGraph, K: sp.csr_array, axis: int | None = None) -> np.ndarray:
    """Blocks (blocks, 3, 3) of a matrix of nodes along one axis, or of all components (3 n, 3 n)
    where that is None; what the graph has no block for is dropped."""
    blocks = np.zeros((graph.blocks, 3, 3))
    K = K.tocsr() if axis is not None else sp.bsr_array(K, blocksize=(3, 3))
    K.sort_indices()
    own = NodeGraph(K.indptr.astype(np.int64), K.indices.astype(np.int32))
    where = graph.find(own)
    there = where >= 0
    if axis is None:
        blocks[where[there]] = K.data[there]
    else:
        blocks[where[there], axis, axis] = K.data[there]
    return blocks


class Touch:
    """Contact of panels with each other.

    ``corners`` (v, n) sparse: weights of the nodes at each corner of a panel; ``panels``: of which
    panel each is, (v,); ``faces`` (t, 3): triangles of corners. Middle surfaces stay ``gap`` apart;
    the barrier ends at twice that. ``energy``: its scale. ``about`` (n, 3): the displacement near
    which stiffness is kept ready: of panels that are close there, as a whole where they are parts
    of four nodes, else of what lies within ``reach`` of each other; there every corner must be of
    equally many nodes.
    """

    name = "contact"
    symmetric = True
    convex = ()

    def __init__(self, body, corners, panels, faces, *, gap, energy, about=None, reach=None):
        import ipctk

        # Its warnings go to the standard output, in which others read answers; its threads would
        # add up in another order each time, and take cores that nobody counts.
        ipctk.set_logger_level(ipctk.LoggerLevel.error)
        ipctk.set_num_threads(1)
        self.body, self.gap, self._reach = body, gap, reach
        self._map = sp.csr_array(sp.kron(corners, sp.eye_array(3)))
        self._corners, self._panels = sp.csr_array(corners), panels
        rest = np.asfortranarray(self._corners @ body.nodes)
        edges = np.unique(
            np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1),
            axis=0,
        )
        self._mesh = ipctk.CollisionMesh(
            rest, np.asfortranarray(edges, np.int32), np.asfortranarray(faces, np.int32)
        )
        self._mesh.can_collide = ipctk.make_vertex_patches_filter(panels.astype(np.int32))
        # In the toolkit's barrier distances come squared: (d² − d̂²)² ln …
        self._potential = ipctk.BarrierPotential(gap, energy / gap**4)
        self._near = None
        self.graph = self._ready(np.zeros_like(body.nodes) if about is None else about)

    def moved(self, u: np.ndarray) -> Touch:
        """The term with stiffness ready near u (n, 3)."""
        new = object.__new__(Touch)
        new.__dict__ = dict(self.__dict__)
        new.graph = new._ready(u)
        return new

    def _vertices(self, u: np.ndarray) -> np.ndarray:
        return np.asfortranarray(self._corners @ (self.body.nodes + u))

    def _ready(self, u: np.ndarray) -> NodeGraph:
        """Pairs of nodes of panels whose boxes, with a margin, meet, or of faces whose do."""
        X = self._vertices(u)
        if self._reach is not None:
            near = self._within(X)
            if self._near is not None and np.array_equal(near, self._near):
                return self.graph
            self._near = near
            nodes = self._corners.indices.reshape(len(X), -1)
            return NodeGraph.of(
                len(self.body.nodes), nodes[near].reshape(len(near), 4 * nodes.shape[1])
            )
        count = self._panels.max() + 1
        low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
        np.minimum.at(low, self._panels, X)
        np.maximum.at(high, self._panels, X)
        margin = MARGIN * np.linalg.norm(high - low, axis=1).max()
        i, j = np.triu_indices(count, 1)
        meet = ((low[i] <= high[j] + margin) & (low[j] <= high[i] + margin)).all(axis=1)
        pairs = np.stack([i[meet], j[meet]], axis=1)
        nodes = (4 * pairs[:, :, None] + np.arange(4)).reshape(-1, 8)
        return NodeGraph.of(len(self.body.nodes), nodes)

    def _within(self, X: np.ndarray) -> np.ndarray:
        """Corners (c, 4) of which some may come near each other in a step."""
        import ipctk

        found = ipctk.Candidates()
        found.build(self._mesh, X, self._reach / 2)
        edges, faces = self._mesh.edges, self._mesh.faces
        on_face = np.array([(c.face_id, c.vertex_id) for c in found.fv_candidates], int)
        crossed = np.array([(c.edge0_id, c.edge1_id) for c in found.ee_candidates], int)
        on_face, crossed = on_face.reshape(-1, 2), crossed.reshape(-1, 2)
        rows = [
            np.column_stack([faces[on_face[:, 0]], on_face[:, 1]]),
            np.column_stack([edges[crossed[:, 0]], edges[crossed[:, 1]]]),
        ]
        return np.unique(np.concatenate(rows), axis=0)

    def _collisions(self, X):
        import ipctk

        kinds = ipctk.NormalCollisions.CollisionSetType
        found = ipctk.NormalCollisions()
        # Offsets of whole panels know no edges within them; on a mesh their forces jump from face
        # to face, which the plain potential's don't.
        found.collision_set_type = kinds.OGC if self._reach is None else kinds.IPC
        found.build(self._mesh, X, self.gap, self.gap)
        return found

    def distance(self, u: np.ndarray) -> float:
        """Least distance between the surfaces of two panels, inf where none are near."""
        X = self._vertices(u)
        squared = self._collisions(X).compute_minimum_distance(self._mesh, X)
        return float(np.sqrt(squared)) - self.gap if np.isfinite(squared) else np.inf

    def longest_step(self, u: np.ndarray, du: np.ndarray) -> float:
        """Fraction of du (n, 3), at most 1, in which no panels pass through each other."""
        import ipctk

        X, Y = self._vertices(u), self._vertices(u + du)
        free = ipctk.compute_collision_free_stepsize(
            self._mesh, X, Y, self.gap, narrow_phase_ccd=ipctk.AdditiveCCD()
        )
        return 1.0 if free >= 1.0 else 0.9 * free

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and blocks; inf where two panels are closer than the gap."""
        X = self._vertices(u)
        close = self._collisions(X)
        if len(close) and close.compute_minimum_distance(self._mesh, X) <= self.gap**2:
            return Evaluation(np.inf)
        energy = float(self._potential(close, self._mesh, X)) if len(close) else 0.0
        if order < 1:
            return Evaluation(energy)
        if not len(close):
            empty = np.zeros((self.graph.blocks, 3, 3)) if order > 1 else None
            return Evaluation(energy, np.zeros_like(self.body.nodes), empty, own=True)
        force = self._map.T @ self._potential.gradient(close, self._mesh, X)
        force = force.reshape(-1, 3)
        if order < 2:
            return Evaluation(energy, force)
        H = self._potential.hessian(close, self._mesh, X)
        return Evaluation(energy, force, self._blocks(H), own=True)

    def acts(self, u: np.ndarray) -> bool:
        """Whether panels feel each other at u (n, 3)."""
        return len(self._collisions(self._vertices(u))) > 0

    def extrapolated(self, u: np.ndarray, du: np.ndarray, e: float) -> tuple[()]:
        """Far from a solution a tangent does better without what contact takes from it."""
        return self.convex

    def under(self, convex: tuple[()], u: np.ndarray, e: float) -> np.ndarray:
        """What the stiffness at u would have more, as blocks, if no pair's part of it were negative
        in any direction: its force over its distance softens what moves aside, by far too much
        where a step went deep into the barrier."""
        import ipctk

        X = self._vertices(u)
        close = self._collisions(X)
        if not len(close):
            return np.zeros((self.graph.blocks, 3, 3))
        clamped = self._potential.hessian(
            close, self._mesh, X, project_hessian_to_psd=ipctk.PSDProjectionMethod.CLAMP
        )
        return self._blocks(clamped - self._potential.hessian(close, self._mesh, X))

    def _blocks(self, H) -> np.ndarray:
        """A matrix of the corners (3 v, 3 v) on the graph of the nodes."""
        return on_graph(self.graph, sp.csr_array(self._map.T @ sp.csr_array(H) @ self._map))
