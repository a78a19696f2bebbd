"""The deformed surface of a body, curved where its elements are, and the places nearest on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from solver.mesh.body import Body

# Samples of a facet along each direction, candidates of a point, and most iterations of each.
SAMPLES, CANDIDATES, ROUGH, FINE = 4, 12, 2, 40


@dataclass(frozen=True, eq=False)
class Feet:
    """Places on the skin: ``nodes`` (p, k) and ``shapes`` (p, k) there, ``position`` and outward
    ``normal`` (p, 3)."""

    nodes: np.ndarray
    shapes: np.ndarray
    position: np.ndarray
    normal: np.ndarray


class Skin:
    """Boundary facets of a body, by scikit-fem index (f,); ValueError for facets inside."""

    def __init__(self, body: Body, facets: np.ndarray):
        mesh, self.body = body.mesh, body
        facets = np.asarray(facets)
        if not len(facets) or (mesh.f2t[1, facets] >= 0).any():
            raise ValueError(f"{len(facets)} facets; expected at least one, all on the boundary")
        self.facets = facets
        own = mesh.f2t[0, facets]
        side = (mesh.t2f[:, own] == facets).argmax(axis=0)
        ref = mesh.elem.refdom
        corners = np.array([[ref.p[:, c[i]] for i in (0, 1, -1)] for c in ref.facets], float)[side]
        self._triangles = body.element.startswith("tet")
        most = 2 if self._triangles else 4
        self._powers = np.array([(i, j) for i in range(3) for j in range(3) if i + j <= most]).T
        self._nodes = body.cells[own]
        self._shapes = self._polynomials(corners)
        inside = body.nodes[self._nodes].mean(axis=1)
        middle = np.full((len(facets), 2), 1 / 3)
        x, J = self._at(self._patches(body.nodes), middle)
        self._sign = np.sign(np.einsum("fi,fi->f", np.cross(J[..., 0], J[..., 1]), x - inside))

    def _polynomials(self, corners):
        """Shape functions of the cells' nodes on the facets, as coefficients of s^i t^j (f, c, k),
        from the facets' corners in the reference cell (f, 3, 3)."""
        st = self._powers.T / 2
        monomials = self._monomials(st)[0]
        kinds, which = np.unique(corners, axis=0, return_inverse=True)
        element, k = self.body.reference, self._nodes.shape[1]
        coefficients = []
        for a, b, d in kinds:
            local = (a + st[:, :1] * (b - a) + st[:, 1:] * (d - a)).T
            N = [np.broadcast_to(element.lbasis(local, n)[0], len(st)) for n in range(k)]
            coefficients.append(np.linalg.solve(monomials, np.stack(N, axis=1)))
        return np.array(coefficients)[which.ravel()]

    def _monomials(self, st):
        """s^i t^j (p, c) at places (p, 2), and their slopes (p, c, 2)."""
        i, j = self._powers
        s, t = st[:, :1], st[:, 1:]
        ds, dt = i * s ** np.maximum(i - 1, 0) * t**j, j * s**i * t ** np.maximum(j - 1, 0)
        return s**i * t**j, np.stack([ds, dt], axis=-1)

    def _patches(self, x):
        """The facets with nodes at x (n, 3), as coefficients (f, c, 3)."""
        return self._shapes @ x[self._nodes]

    def _at(self, patches, st):
        """Positions (p, 3) and their slopes (p, 3, 2) at places (p, 2) in patches (p, c, 3)."""
        value, slopes = self._monomials(st)
        position = np.einsum("pc,pci->pi", value, patches)
        return position, np.einsum("pct,pci->pit", slopes, patches)

    @cached_property
    def _samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Facet and place in it, (s,) and (s, 2), of points all over the skin."""
        line = (np.arange(SAMPLES) + 0.5) / SAMPLES
        st = np.array(np.meshgrid(line, line)).reshape(2, -1).T
        if self._triangles:
            st = st[st.sum(axis=1) <= 1]
        f = len(self.facets)
        return np.repeat(np.arange(f), len(st)), np.tile(st, (f, 1))

    def nearest(self, x: np.ndarray, points: np.ndarray) -> Feet:
        """The places nearest to points (p, 3) on the skin of the body with its nodes at x (n, 3).

        From the nearest samples by Gauss–Newton steps on |y − x(s, t)|², held to the facet.
        """
        facet, st = self._samples
        patches = self._patches(x)
        tree = cKDTree(self._at(patches[facet], st)[0])
        tried = tree.query(points, k=min(CANDIDATES, len(st)))[1].reshape(len(points), -1)
        each = tried.shape[1]
        at, aims = facet[tried.ravel()], np.repeat(points, each, axis=0)
        where = self._improved(patches[at], st[tried.ravel()], aims, ROUGH)
        off = np.linalg.norm(aims - self._at(patches[at], where)[0], axis=1).reshape(-1, each)
        best = np.arange(len(points)) * each + off.argmin(axis=1)
        at = at[best]
        where = self._improved(patches[at], where[best], points, FINE)
        position, J = self._at(patches[at], where)
        normal = np.cross(J[..., 0], J[..., 1]) * self._sign[at, None]
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        shapes = np.einsum("pc,pck->pk", self._monomials(where)[0], self._shapes[at])
        return Feet(self._nodes[at], shapes, position, normal)

    def scattered(self, x: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
        """Random places on the skin, (n, 3), about as many on each area, for synthetic shapes."""
        f = len(self.facets)
        (at, where), patches = self._samples, self._patches(x)
        J = self._at(patches[at], where)[1]
        areas = np.linalg.norm(np.cross(J[..., 0], J[..., 1]), axis=1).reshape(f, -1).sum(axis=1)
        st = rng.uniform(size=(n, 2))
        if self._triangles:
            st = np.where(st.sum(axis=1, keepdims=True) > 1, 1 - st, st)
        return self._at(patches[rng.choice(f, size=n, p=areas / areas.sum())], st)[0]

    def _improved(self, patches, st, aims, most):
        for _ in range(most):
            position, J = self._at(patches, st)
            pull = np.einsum("pit,pi->pt", J, aims - position)
            H = np.einsum("pit,piu->ptu", J, J)
            slant = H[:, 0, 0] + H[:, 1, 1] - 2 * H[:, 0, 1]
            # What pushes against an edge of the facet stays there.
            stuck = ((st <= 0) & (pull < 0)) | ((st >= 1) & (pull > 0))
            H[stuck[:, 0], 0, 1] = H[stuck[:, 0], 1, 0] = 0
            H[stuck[:, 1], 0, 1] = H[stuck[:, 1], 1, 0] = 0
            step = np.linalg.solve(H, np.where(stuck, 0, pull)[..., None])[..., 0]
            if self._triangles:
                # So does what pushes against the slanted edge, but for its way along it.
                at = (st.sum(axis=1) >= 1 - 1e-14) & (step.sum(axis=1) > 0)
                along = (pull[:, 0] - pull[:, 1]) / slant
                step = np.where(at[:, None], along[:, None] * [1, -1], step)
            after = self._held(st + step)
            if np.abs(after - st).max(initial=0.0) < 1e-13:
                return after
            st = after
        return st

    def _held(self, st):
        st = np.clip(st, 0, 1)
        if self._triangles:
            over = np.maximum(st.sum(axis=1) - 1, 0) / 2
            st = np.clip(st - over[:, None], 0, 1)
        return st
