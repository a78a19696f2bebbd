"""Body: mesh, element and quadrature, gathered once into arrays.

The only file that touches scikit-fem's internals. Everything else sees nodes (n, 3), cells (m, k),
shape gradients with respect to the reference position X, weights w·det(∂X/∂ξ), and the node graph:
the pattern in which all terms write their 3 × 3 stiffness blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numba
import numpy as np
import scipy.sparse as sp
import skfem
from skfem.quadrature import get_quadrature

from solver.given import mask, numbers
from solver.mesh import checks, interpolation, locking
from solver.mesh.surface import Surface

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


def _rule(element: str, bent: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Points (3, q) and weights (q,) of a cell's quadrature."""
    maker, order = ELEMENTS[element]
    return get_quadrature(maker.refdom, order) if bent is None else _bent_rule(bent)


def _shapes(mesh, reference, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shape functions (q, k) at points (3, q) of the reference cell, their gradients (m, q, k, 3)
    with respect to X."""
    q = points.shape[1]
    local = [reference.lbasis(points, a) for a in range(len(reference.doflocs))]
    shapes = np.stack([np.broadcast_to(value, q) for value, _ in local], 1)
    slopes = np.stack([np.broadcast_to(slope, (3, q)) for _, slope in local]).transpose(2, 0, 1)
    gradients = np.empty((mesh.t.shape[1], *slopes.shape))
    for start in range(0, len(gradients), checks.CHUNK):
        part = slice(start, start + checks.CHUNK)
        J = checks.jacobians(mesh, points, part).transpose(0, 3, 1, 2)
        gradients[part] = slopes @ np.linalg.inv(J)
    return shapes, gradients


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
        """Where each block of ``other`` stands in this graph; −1 where it doesn't."""
        return _find(self.indptr, self.indices, other.indptr, other.indices)

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
        if all(g is most or (most.find(g) >= 0).all() for g in graphs):
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
def _find(indptr, indices, rows, columns):
    out = np.full(len(columns), -1)
    for a in range(len(rows) - 1):
        at, end = indptr[a], indptr[a + 1]
        for k in range(rows[a], rows[a + 1]):
            while at < end and indices[at] < columns[k]:
                at += 1
            if at < end and indices[at] == columns[k]:
                out[k] = at
    return out


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
class Body:
    """Mesh and element as arrays; make one with :meth:`build`.

    ``nodes`` (n, 3); ``cells`` (m, k); ``shapes`` (q, k); ``gradients`` (m, q, k, 3) = ∂N/∂X;
    ``weights`` (m, q) = w·det(∂X/∂ξ); ``bent``: axis of the cells with two points, if any.
    """

    mesh: skfem.Mesh
    element: str
    bent: int | None
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
        maker, _ = ELEMENTS[element]
        if bent is not None and (element != "hex27" or bent not in (0, 1, 2)):
            raise ValueError(f"bent = {bent} with {element}; expected 0, 1 or 2, and hex27")
        mesh = _geometry(mesh, element)
        checks.refuse_nodes(mesh)
        rule = _rule(element, bent)
        # The nodes too: curved cells often fail at their corners first.
        reference = maker()
        det, scaled = checks.determinants(mesh, np.hstack([rule[0], reference.doflocs.T]))
        checks.refuse_cells(mesh, scaled)
        checks.refuse_distance(mesh)
        table = checks.facets(mesh)
        checks.refuse_folds(mesh, table, checks.orientation(scaled))
        if not parts:
            checks.refuse_gaps(mesh, table)
        # What scikit-fem would sort out again, more slowly.
        mesh._facets, mesh._t2f, mesh._f2t = table.vertices, table.of_cell, table.cells
        dofs = skfem.Dofs(mesh, reference)
        cells = np.ascontiguousarray(dofs.element_dofs.T, dtype=np.int32)
        nodes = np.empty((dofs.N, 3))
        nodes[cells] = checks.positions(mesh, reference.doflocs.T)
        shapes, gradients = _shapes(mesh, reference, rule[0])
        weights = np.abs(det[:, : len(rule[1])]) * rule[1]
        return cls(mesh, element, bent, nodes, cells, shapes, gradients, weights)

    @cached_property
    def reference(self) -> skfem.Element:
        """scikit-fem's element, which knows the reference cell."""
        return ELEMENTS[self.element][0]()

    @cached_property
    def basis(self) -> skfem.Basis:
        """scikit-fem's own arrays of the same body, for what is asked for rarely."""
        rule = _rule(self.element, self.bent)
        return skfem.Basis(self.mesh, self.reference, quadrature=rule)

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
        return self.shapes @ self.nodes[self.cells]

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
        order = SURFACE_ORDER[self.element]
        return Surface.of(mesh, self.reference, self.cells, chosen, order)
