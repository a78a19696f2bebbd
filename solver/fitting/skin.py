"""The deformed surface of a body, quadratic where its elements are, and the places nearest to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from solver.mesh.body import Body

# Samples of a facet along each direction, candidates of a point, and most iterations of each.
SAMPLES, CANDIDATES, ROUGH, FINE = 4, 4, 4, 40


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
        self._origin, self._along = corners[:, 0], corners[:, 1:] - corners[:, :1]
        self._cells = body.cells[own]
        self._triangles = body.element.startswith("tet")
        inside = body.nodes[body.cells].mean(axis=1)[own]
        x, J = self._at(body.nodes, np.arange(len(facets)), np.full((len(facets), 2), 1 / 3))
        out = np.einsum("fi,fi->f", np.cross(J[..., 0], J[..., 1]), x - inside)
        self._sign = np.sign(out)

    @cached_property
    def _samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Facet and place in it, (s,) and (s, 2), of points all over the skin."""
        line = (np.arange(SAMPLES) + 0.5) / SAMPLES
        st = np.array(np.meshgrid(line, line)).reshape(2, -1).T
        if self._triangles:
            st = st[st.sum(axis=1) <= 1]
        f = len(self.facets)
        return np.repeat(np.arange(f), len(st)), np.tile(st, (f, 1))

    @cached_property
    def _sampled(self) -> np.ndarray:
        """Shapes of the cells' nodes at the samples, (s, k)."""
        return self._shapes(*self._samples)[0]

    def _shapes(self, facet, st):
        """Shape functions (p, k) of the cells' nodes at places (p, 2) in facets (p,), and their
        slopes there (p, k, 2)."""
        along = self._along[facet]
        local = (self._origin[facet] + np.einsum("pt,pti->pi", st, along)).T
        element, k = self.body.reference, self._cells.shape[1]
        both = [element.lbasis(local, a) for a in range(k)]
        p = len(facet)
        values = np.stack([np.broadcast_to(v, p) for v, _ in both], axis=-1)
        slopes = np.stack([np.broadcast_to(d, (3, p)) for _, d in both], axis=-1)
        return values, np.einsum("ipk,pti->pkt", slopes, along)

    def _at(self, x, facet, st):
        """Positions (p, 3) and their derivatives (p, 3, 2) for nodes at x (n, 3)."""
        values, slopes = self._shapes(facet, st)
        mine = x[self._cells[facet]]
        return np.einsum("pk,pki->pi", values, mine), np.einsum("pkt,pki->pit", slopes, mine)

    def nearest(self, x: np.ndarray, points: np.ndarray) -> Feet:
        """The places nearest to points (p, 3) on the skin of the body with its nodes at x (n, 3).

        From the nearest samples by Gauss–Newton steps on |y − x(s, t)|², held to the facet.
        """
        facet, st = self._samples
        tree = cKDTree(np.einsum("sk,ski->si", self._sampled, x[self._cells[facet]]))
        tried = tree.query(points, k=CANDIDATES)[1].ravel()
        at, where = facet[tried], st[tried]
        aims = np.repeat(points, CANDIDATES, axis=0)
        where = self._improved(x, at, where, aims, ROUGH)
        off = np.linalg.norm(aims - self._at(x, at, where)[0], axis=1).reshape(-1, CANDIDATES)
        best = np.arange(len(points)) * CANDIDATES + off.argmin(axis=1)
        at = at[best]
        where = self._improved(x, at, where[best], points, FINE)
        position, J = self._at(x, at, where)
        normal = np.cross(J[..., 0], J[..., 1]) * self._sign[at, None]
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return Feet(self._cells[at], self._shapes(at, where)[0], position, normal)

    def scattered(self, x: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
        """Random places on the skin, (n, 3), about as many on each area, for synthetic shapes."""
        f = len(self.facets)
        at, where = self._samples
        J = self._at(x, at, where)[1]
        areas = np.linalg.norm(np.cross(J[..., 0], J[..., 1]), axis=1).reshape(f, -1).sum(axis=1)
        st = rng.uniform(size=(n, 2))
        if self._triangles:
            st = np.where(st.sum(axis=1, keepdims=True) > 1, 1 - st, st)
        return self._at(x, rng.choice(f, size=n, p=areas / areas.sum()), st)[0]

    def _improved(self, x, facet, st, aims, most):
        for _ in range(most):
            position, J = self._at(x, facet, st)
            pull = np.einsum("pit,pi->pt", J, aims - position)
            H = np.einsum("pit,piu->ptu", J, J)
            # What pushes against an edge of the facet stays there.
            stuck = ((st <= 0) & (pull < 0)) | ((st >= 1) & (pull > 0))
            H[stuck[:, 0], 0, 1] = H[stuck[:, 0], 1, 0] = 0
            H[stuck[:, 1], 0, 1] = H[stuck[:, 1], 1, 0] = 0
            step = np.linalg.solve(H, np.where(stuck, 0, pull)[..., None])[..., 0]
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
