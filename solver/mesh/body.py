"""Body: mesh, element and quadrature, gathered once into arrays.

The only file that touches scikit-fem's internals. Everything else sees nodes (n, 3), cells (m, k),
shape gradients with respect to the reference position X, weights w·det(∂X/∂ξ), and the node graph:
the pattern in which all terms write their 3 × 3 stiffness blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numba
import numpy as np
import scipy.sparse as sp
import skfem
from skfem.quadrature import get_quadrature

from solver.mesh import checks, interpolation, locking
from solver.mesh.given import mask, numbers

# name: (scikit-fem element, quadrature order). hex20 is the reduced one, with 2 × 2 × 2 points.
ELEMENTS = {
    "hex27": (skfem.ElementHex2, 5),
    "hex20": (skfem.ElementHexS2, 3),
    "hex8": (skfem.ElementHex1, 3),
    "tet10": (skfem.ElementTetP2, 2),
    "tet4": (skfem.ElementTetP1, 1),
}

# Exact for x · (∂x/∂ξ × ∂x/∂η), so that pressure on a closed surface has a potential to rounding.
SURFACE_ORDER = {"hex27": 5, "hex20": 5, "hex8": 3, "tet10": 4, "tet4": 2}


def _bent_rule(axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points of the unit cube, two along one axis and three along the others."""
    lines = [np.polynomial.legendre.leggauss(2 if k == axis else 3) for k in range(3)]
    points = np.meshgrid(*[(x + 1) / 2 for x, _ in lines], indexing="ij")
    weights = np.meshgrid(*[w / 2 for _, w in lines], indexing="ij")
    return np.array([x.ravel() for x in points]), np.prod([w.ravel() for w in weights], axis=0)


def _geometry(mesh: skfem.Mesh, element: str) -> skfem.Mesh:
    """The mesh with no more geometry than the element can represent."""
    hexes = isinstance(mesh, skfem.MeshHex1)
    if element.startswith("hex") != hexes or not (hexes or isinstance(mesh, skfem.MeshTet1)):
        raise ValueError(
            f"element {element!r} on a {type(mesh).__name__}; expected a mesh of "
            f"{'hexahedra' if element.startswith('hex') else 'tetrahedra'}"
        )
    quadratic = isinstance(mesh, skfem.MeshHex2 | skfem.MeshTet2)
    if not quadratic or element in ("hex27", "tet10"):
        return mesh
    if element == "hex20":
        dofs, X = mesh.dofs.element_dofs, mesh.doflocs.copy()
        at = mesh.elem().doflocs
        serendipity = skfem.ElementHexS2()
        for a in range(20, 27):
            values = [serendipity.lbasis(at[a][:, None], b)[0].item() for b in range(20)]
            X[:, dofs[a]] = np.einsum("b,ibm->im", values, mesh.doflocs[:, dofs[:20]])
        return replace(mesh, doflocs=X)
    kind = skfem.MeshHex1 if hexes else skfem.MeshTet1
    corners = np.ascontiguousarray(mesh.doflocs[:, : mesh.nvertices])
    return kind(corners, mesh.t, mesh.boundaries, mesh.subdomains)


@dataclass(frozen=True, eq=False)
class NodeGraph:
    """Which pairs of nodes share a stiffness block: CSR of a symmetric node adjacency."""

    indptr: np.ndarray
    indices: np.ndarray

    @property
    def n(self) -> int:
        """Number of nodes."""
        return len(self.indptr) - 1

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self.indices)

    def positions(self, connectivity: np.ndarray) -> np.ndarray:
        """Where block (a, b) of each row of ``connectivity`` (m, k) stands: (m, k, k) int32."""
        return _positions(
            self.indptr, self.indices, np.ascontiguousarray(connectivity, dtype=np.int32)
        )

    def find(self, other: NodeGraph) -> np.ndarray:
        """Where each block of ``other``, a part of this graph, stands in this one."""
        return np.searchsorted(self._keys, other._keys)

    @cached_property
    def _keys(self) -> np.ndarray:
        """One rising number per block."""
        return np.repeat(np.arange(self.n), np.diff(self.indptr)) * self.n + self.indices

    @classmethod
    def of(cls, n: int, *connectivities: np.ndarray) -> NodeGraph:
        """All pairs of nodes within each row of the given connectivities, and the diagonal."""
        rows, cols = [np.arange(n)], [np.arange(n)]
        for c in connectivities:
            k = c.shape[1]
            rows.append(np.repeat(c, k, axis=1).ravel())
            cols.append(np.tile(c, (1, k)).ravel())
        return cls._from_pairs(n, np.concatenate(rows), np.concatenate(cols))

    @classmethod
    def union(cls, graphs) -> NodeGraph:
        """The blocks of all of them; one of them itself where it has all."""
        most = max(graphs, key=lambda g: g.blocks)
        if all(g is most or np.isin(g._keys, most._keys).all() for g in graphs):
            return most
        rows = [np.repeat(np.arange(g.n), np.diff(g.indptr)) for g in graphs]
        cols = [g.indices for g in graphs]
        return cls._from_pairs(graphs[0].n, np.concatenate(rows), np.concatenate(cols))

    @classmethod
    def _from_pairs(cls, n, rows, cols) -> NodeGraph:
        graph = sp.csr_array((np.ones(len(rows), bool), (rows, cols)), shape=(n, n))
        graph.sum_duplicates()
        graph.sort_indices()
        return cls(graph.indptr.astype(np.int64), graph.indices.astype(np.int32))


@numba.njit(cache=True)
def _positions(indptr, indices, cells):
    m, k = cells.shape
    out = np.empty((m, k, k), np.int32)
    for e in range(m):
        for a in range(k):
            row = cells[e, a]
            for b in range(k):
                col, lo, hi = cells[e, b], indptr[row], indptr[row + 1]
                while hi - lo > 1:
                    mid = (lo + hi) // 2
                    if indices[mid] <= col:
                        lo = mid
                    else:
                        hi = mid
                out[e, a, b] = lo
    return out


@dataclass(frozen=True, eq=False)
class Surface:
    """Facets of a body with their own shape functions, for loads on surfaces.

    ``nodes`` (f, k): nodes of each facet; ``shapes`` (f, q, k); ``tangents`` (f, q, k, 2):
    gradients of the shapes along two orthonormal reference tangents t₁, t₂ with t₁ × t₂ = outward
    normal; ``weights`` (f, q): reference area; ``normals`` (f, q, 3), outward, reference.
    """

    nodes: np.ndarray
    shapes: np.ndarray
    tangents: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    frames: np.ndarray = field(repr=False)  # (f, q, 2, 3): t₁, t₂


@dataclass(frozen=True, eq=False)
class Body:
    """Mesh and element as arrays; make one with :meth:`build`.

    ``nodes`` (n, 3); ``cells`` (m, k); ``shapes`` (q, k); ``gradients`` (m, q, k, 3) = ∂N/∂X;
    ``weights`` (m, q) = w·det(∂X/∂ξ); ``bent``: axis of the cells with two points, if any.
    """

    mesh: skfem.Mesh
    element: str
    bent: int | None
    basis: skfem.Basis = field(repr=False)
    nodes: np.ndarray = field(repr=False)
    cells: np.ndarray = field(repr=False)
    shapes: np.ndarray = field(repr=False)
    gradients: np.ndarray = field(repr=False)
    weights: np.ndarray = field(repr=False)

    @classmethod
    def build(
        cls,
        mesh: skfem.Mesh,
        element: str | None = None,
        *,
        bent: int | None = None,
        parts: bool = False,
    ) -> Body:
        """Body of a mesh; its sub-domains and boundaries keep their names.

        ``element``: by default hex27, or hex20 where hex27 would lock by more than 1 %: in thin
        curved bodies without a ``bent`` axis (see :mod:`solver.mesh.locking`).
        ``bent``: the axis of the cells (0, 1, 2; of a box: x, y, z) along which they are long and
        will curve. There hex27 takes two points instead of three: curved elements a hundred times
        longer than thick then do not lock, and no spurious mode appears. Two such axes would bring
        spurious modes.

        The geometry is never richer than the element: of a quadratic mesh hex8 and tet4 take the
        corners, hex20 the corners and mid-edge nodes, so that linear fields stay exact.
        ``parts=True`` admits unconnected parts and touching faces that share no nodes.

        Raises ValueError for an unknown element or one of another shape than the cells; for cells
        that are inverted, flat, or folded over a neighbour; for unconnected parts, touching faces
        that don't share their nodes, hanging nodes, and nodes without a cell or a finite position.
        """
        if element is None:
            body = cls.build(mesh, "hex27", bent=bent, parts=parts)
            if bent is not None or locking.excess(body) < locking.NEGLIGIBLE:
                return body
            return cls.build(body.mesh, "hex20", parts=parts)
        if not isinstance(element, str) or element not in ELEMENTS:
            raise ValueError(f"no element {element!r}; there are: {', '.join(ELEMENTS)}")
        maker, order = ELEMENTS[element]
        if bent is not None and (element != "hex27" or bent not in (0, 1, 2)):
            raise ValueError(f"bent = {bent} with {element}; expected 0, 1 or 2, and hex27")
        mesh = _geometry(mesh, element)
        checks.refuse_nodes(mesh)
        rule = get_quadrature(mesh.elem.refdom, order) if bent is None else _bent_rule(bent)
        # The nodes too: curved cells often fail at their corners first.
        points = np.hstack([rule[0], maker().doflocs.T])
        scaled = checks.determinants(mesh, points)[1]
        checks.refuse_cells(mesh, scaled)
        checks.refuse_distance(mesh)
        table = checks.facets(mesh)
        checks.refuse_folds(mesh, table, checks.orientation(scaled))
        if not parts:
            checks.refuse_gaps(mesh, table)
        # What scikit-fem would sort out again, more slowly.
        mesh._facets, mesh._t2f, mesh._f2t = table.vertices, table.of_cell, table.cells
        basis = skfem.Basis(mesh, maker(), quadrature=rule)
        cells = np.ascontiguousarray(basis.element_dofs.T, dtype=np.int32)
        k = cells.shape[1]
        gradients = np.empty((*basis.dx.shape, k, 3))
        shapes = np.empty((basis.dx.shape[1], k))
        for a in range(k):
            gradients[:, :, a, :] = np.moveaxis(np.asarray(basis.basis[a][0].grad), 0, -1)
            shapes[:, a] = np.asarray(basis.basis[a][0])[0]
        weights = np.ascontiguousarray(np.asarray(basis.dx))
        nodes = np.ascontiguousarray(basis.doflocs.T)
        return cls(mesh, element, bent, basis, nodes, cells, shapes, gradients, weights)

    def locking(self, u: np.ndarray | None = None) -> tuple[locking.Locking, ...]:
        """What the shape of the elements costs, displaced by u (n, 3) if given; () if nothing."""
        return locking.of_shape(self, u)

    @cached_property
    def graph(self) -> NodeGraph:
        """Node pairs that share a cell."""
        return NodeGraph.of(len(self.nodes), self.cells)

    @cached_property
    def positions(self) -> np.ndarray:
        """Where the blocks of each cell stand in :attr:`graph`, (m, k, k)."""
        return self.graph.positions(self.cells)

    @cached_property
    def length(self) -> float:
        """Largest extent: the scene's scale of length."""
        return float(np.ptp(self.nodes, axis=0).max())

    @property
    def unknowns(self) -> int:
        """Displacement components in all."""
        return 3 * len(self.nodes)

    def points(self) -> np.ndarray:
        """Reference positions of the quadrature points, (m, q, 3)."""
        return np.moveaxis(np.asarray(self.basis.global_coordinates()), 0, -1)

    def node_volumes(self, density: np.ndarray | float = 1.0) -> np.ndarray:
        """∫ ρ N_a dV for every node, (n,); ``density`` broadcasts to (m, q)."""
        parts = np.einsum(
            "mq,qk->mk", np.broadcast_to(density, self.weights.shape) * self.weights, self.shapes
        )
        return np.bincount(self.cells.ravel(), parts.ravel(), minlength=len(self.nodes))

    def nodes_of(self, boundary: str) -> np.ndarray:
        """Nodes on a named boundary, mid-edge and mid-face nodes included.

        Raises ValueError for a name that the mesh doesn't have.
        """
        return self.basis.get_dofs(self._named(boundary)).all()

    def cells_of(self, layer: str) -> np.ndarray:
        """Mask (m,) of the cells of a named sub-domain.

        Raises ValueError for a name that the mesh doesn't have.
        """
        names = self.mesh.subdomains or {}
        if not isinstance(layer, str) or layer not in names:
            raise ValueError(f"no sub-domain {layer!r}; there are: {', '.join(names) or 'none'}")
        mask = np.zeros(len(self.cells), bool)
        mask[np.asarray(names[layer])] = True
        return mask

    def interpolation(self, points: np.ndarray) -> sp.csr_array:
        """Matrix (p, n) that takes values at the nodes to reference positions ``points`` (p, 3).

        Raises ValueError for a position outside of the body.
        """
        return interpolation.matrix(self, points)

    def _named(self, boundary: str) -> np.ndarray:
        names = self.mesh.boundaries or {}
        if not isinstance(boundary, str) or boundary not in names:
            raise ValueError(f"no boundary {boundary!r}; there are: {', '.join(names) or 'none'}")
        return np.asarray(names[boundary])

    def nodes_where(self, test: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Nodes whose position satisfies ``test(X)``, X (n, 3)."""
        return np.flatnonzero(mask("the test of the nodes", test(self.nodes), len(self.nodes)))

    def cells_where(self, test: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Mask (m,) of the cells whose centre satisfies ``test(X)``, X (m, 3)."""
        centres = self.mesh.p[:, self.mesh.t].mean(axis=1).T
        return mask("the test of the cells", test(centres), len(centres))

    def surface(self, facets: str | Callable[[np.ndarray], np.ndarray] | np.ndarray) -> Surface:
        """Boundary facets by name, by a test of their centres X (n, 3), or by scikit-fem index.

        Raises ValueError if there are none.
        """
        mesh = self.mesh
        if isinstance(facets, str):
            chosen = self._named(facets)
        elif callable(facets):
            boundary = mesh.boundary_facets()
            centres = mesh.p[:, mesh.facets[:, boundary]].mean(axis=1).T
            chosen = boundary[mask("the test of the facets", facets(centres), len(boundary))]
        else:
            numbers("facets", facets)
            chosen = np.atleast_1d(facets)
            n = mesh.nfacets
            ok = chosen.ndim == 1 and chosen.dtype.kind in "iu"
            if chosen.size and not (ok and chosen.min() >= 0 and chosen.max() < n):
                raise ValueError(
                    f"facets of shape {chosen.shape} and type {chosen.dtype}; expected a name, a "
                    f"test of their centres, or numbers from 0 to {n - 1}"
                )
        if not len(chosen):
            raise ValueError("no facet was chosen; check the name or the test of the centres")
        maker, _ = ELEMENTS[self.element]
        order = SURFACE_ORDER[self.element]
        # Nothing here depends on where the body is, and far from the origin roundoff is large.
        centre = mesh.doflocs.mean(axis=1, keepdims=True)
        near = replace(mesh, doflocs=mesh.doflocs - centre)
        near._facets, near._t2f, near._f2t = mesh.facets, mesh.t2f, mesh.f2t
        mapping = near.mapping()
        if hasattr(mapping, "J"):
            # In cells thinner than 1e-4 of their distance from the centre roundoff is above 1e-12.
            mapping.invF = partial(mapping.invF, newton_tol=1e-9)
        try:
            basis = skfem.FacetBasis(near, maker(), mapping, facets=chosen, intorder=order)
        except Exception as error:
            if "Newton iteration" not in str(error):
                raise
            raise ValueError(
                "the cells at the facets are too thin, too distorted or too far from the rest of "
                "the body for double precision; mend the mesh, or take larger cells"
            ) from None
        value = np.stack([np.asarray(basis.basis[a][0]) for a in range(basis.Nbfun)], -1)
        grad = np.stack([np.asarray(basis.basis[a][0].grad) for a in range(basis.Nbfun)], -1)
        # Only the shapes that live on the facet: the others vanish there.
        live = np.abs(value).max(axis=1) > 1e-7
        k = int(live[0].sum())
        pick = np.argsort(~live, axis=1, kind="stable")[:, :k]
        dofs = basis.element_dofs.T if len(basis.element_dofs.T) == len(chosen) else None
        if dofs is None:
            dofs = self.cells[basis.tind]
        nodes = np.take_along_axis(np.asarray(dofs), pick, axis=1).astype(np.int32)
        shapes = np.take_along_axis(value, pick[:, None, :], axis=2)
        grads = np.take_along_axis(np.moveaxis(grad, 0, -2), pick[:, None, None, :], axis=3)
        normals = np.moveaxis(np.asarray(basis.normals), 0, -1)
        least = np.eye(3)[np.argmin(np.abs(normals), axis=-1)]
        t1 = np.cross(least, normals)
        t1 /= np.linalg.norm(t1, axis=-1, keepdims=True)
        t2 = np.cross(normals, t1)
        frames = np.stack([t1, t2], axis=-2)
        tangents = np.einsum("fqik,fqti->fqkt", grads, frames)
        weights = np.ascontiguousarray(np.asarray(basis.dx))
        return Surface(
            nodes,
            np.ascontiguousarray(shapes),
            np.ascontiguousarray(tangents),
            weights,
            normals,
            frames,
        )
