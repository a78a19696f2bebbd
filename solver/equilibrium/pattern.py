"""Where the entries of a scene's matrix stand and come from, found once per scene.

The matrix is the stiffness of the free components bordered by the constraint rows,

    [ K  Cᵀ ]
    [ C  0  ]

its upper triangle only if it is symmetric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
import scipy.sparse as sp

from solver.equilibrium import checks
from solver.equilibrium.iterative import Coarse, rigid_modes
from solver.equilibrium.linear import (
    Factor,
    ScaledFactor,
    SingularMatrix,
    make_solver,
    mkl_pardiso,
    product,
)
from solver.given import all_of
from solver.mesh.body import Body, NodeGraph
from solver.physics.supports import Fixed, Held, Row, Tied
from solver.physics.term import Term


@dataclass(frozen=True, eq=False)
class Pattern:
    """Compressed rows of the matrix, and how block values get there.

    ``graph``: blocks of the stiffness; ``indptr`` (size + 1,), ``indices`` (entries,); ``diagonal``
    (n_free,): entries that stand on it; ``held``: supports, whose turned nodes turn their blocks.
    ``index`` (entries,): for each entry its place in the blocks (flat), followed by those of
    ``merged`` and by ``tail``, the values of the rows.
    """

    graph: NodeGraph
    held: Held
    indptr: np.ndarray
    indices: np.ndarray
    diagonal: np.ndarray
    index: np.ndarray
    tail: np.ndarray
    merged: Merged | None = None

    @classmethod
    def of(cls, graph: NodeGraph, held: Held, C: sp.csr_array, symmetric: bool) -> Pattern:
        """The pattern for blocks on a graph and rows C (rows, 3 nodes) in the nodes' frames."""
        merged = Merged.of(graph, held) if len(held.tied) else None
        own = graph if merged is None else merged.graph
        places = np.arange(graph.blocks) if merged is None else merged.places
        blocks = graph.blocks + (0 if merged is None else merged.count)
        n_free, n_rows = len(held.index), C.shape[0]
        number = np.full(C.shape[1], -1)
        number[held.index] = np.arange(n_free)
        free = sp.csr_array(C[:, held.index])
        along = sp.csr_array(free.T)
        along.sort_indices()
        tail = np.concatenate([along.data, free.data, [0.0]]) if n_rows else np.zeros(0)
        indptr, indices, index, diagonal = _entries(
            own.indptr, own.indices, places, blocks, number, n_free, n_rows, symmetric,
            along.indptr.astype(np.int64), along.indices.astype(np.int64),
            free.indptr.astype(np.int64), free.indices.astype(np.int64),
        )  # fmt: skip
        return cls(graph, held, indptr, indices, diagonal, index, tail, merged)

    def hold(self, values: np.ndarray, held: np.ndarray, diagonal: float) -> None:
        """Makes rows and columns of a mask ``held`` (size,) those of a diagonal matrix."""
        _hold(self.indptr, self.indices, held, diagonal, values)

    def gather(self, blocks: np.ndarray) -> np.ndarray:
        """The matrix's entries (entries,) from blocks (blocks, 3, 3) in the common frame."""
        if len(self.held.turned):
            blocks = self._turn(blocks)
        parts = [blocks.reshape(-1)]
        if self.merged is not None:
            parts.append(self.merged.sums(blocks).reshape(-1))
        if len(self.tail):
            parts.append(self.tail)
        flat = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return flat[self.index]

    def _turn(self, blocks: np.ndarray) -> np.ndarray:
        g, held = self.graph, self.held
        a = np.repeat(np.arange(g.n), np.diff(g.indptr))
        turned = np.zeros(g.n, bool)
        turned[held.turned] = True
        hit = np.flatnonzero(turned[a] | turned[g.indices])
        out = blocks.copy()
        out[hit] = np.einsum(
            "nji,njk,nkl->nil", held.frames[a[hit]], blocks[hit], held.frames[g.indices[hit]]
        )
        return out


@dataclass(frozen=True, eq=False)
class Merged:
    """Where nodes are tied to others: Tᵀ K T, block by block.

    ``graph``: of what is left, with no blocks of tied nodes but their diagonal; ``places``: where
    each of its blocks stands among those of the terms followed by the ``count`` sums; ``sources``
    of the sums among the terms', with the ``signs`` (sources, 3, 3), and the sum that each
    belongs ``to``.
    """

    graph: NodeGraph
    places: np.ndarray
    count: int
    sources: np.ndarray
    signs: np.ndarray
    to: np.ndarray

    @classmethod
    def of(cls, graph: NodeGraph, held: Held) -> Merged:
        """For blocks on a graph and the ties of supports."""
        n = graph.n
        image, sign = np.arange(n), np.ones((n, 3))
        image[held.tied[::3] // 3] = held.masters[::3] // 3
        sign[held.tied[::3] // 3] = held.signs.reshape(-1, 3)
        a, b = np.repeat(np.arange(n), np.diff(graph.indptr)), graph.indices
        own = NodeGraph.of(n, np.stack([image[a], image[b]], axis=1))
        where = own.positions(np.stack([image[a], image[b]], axis=1))[:, 0, 1]
        moved = (image[a] != a) | (image[b] != b)
        summed = np.zeros(own.blocks, bool)
        summed[where[moved]] = True
        number = np.cumsum(summed) - 1
        sources = np.flatnonzero(summed[where])
        places = np.zeros(own.blocks, int)
        plain = ~summed[where]
        places[where[plain]] = np.flatnonzero(plain)
        places[summed] = graph.blocks + number[summed]
        signs = sign[a[sources], :, None] * sign[b[sources], None, :]
        return cls(own, places, int(summed.sum()), sources, signs, number[where[sources]])

    def sums(self, blocks: np.ndarray) -> np.ndarray:
        """The summed blocks (count, 3, 3)."""
        out = np.zeros((self.count, 3, 3))
        np.add.at(out, self.to, self.signs * blocks[self.sources])
        return out


@numba.njit(cache=True)
def _entries(
    starts, nodes, places, blocks, number, n_free, n_rows, symmetric,
    along, along_rows, free, free_columns,
):  # fmt: skip
    """Row by row: the free entries of the blocks, then those of the rows, which stand behind.

    ``places``: of each block of nodes among all ``blocks``.
    """
    most = 9 * len(nodes) + 2 * len(along_rows) + n_rows
    indptr = np.zeros(n_free + n_rows + 1, np.int64)
    indices, index = np.empty(most, np.int32), np.empty(most, np.int64)
    diagonal = np.empty(n_free, np.int64)
    at = row = 0
    for a in range(len(starts) - 1):
        for i in range(3):
            if number[3 * a + i] < 0:
                continue
            for block in range(starts[a], starts[a + 1]):
                for j in range(3):
                    column = number[3 * nodes[block] + j]
                    if column < 0 or (symmetric and column < row):
                        continue
                    if column == row:
                        diagonal[row] = at
                    indices[at], index[at] = column, 9 * places[block] + 3 * i + j
                    at += 1
            for k in range(along[row], along[row + 1]):
                indices[at], index[at] = n_free + along_rows[k], 9 * blocks + k
                at += 1
            row += 1
            indptr[row] = at
    values = 9 * blocks + len(along_rows)
    for r in range(n_rows):
        if not symmetric:
            for k in range(free[r], free[r + 1]):
                indices[at], index[at] = free_columns[k], values + k
                at += 1
        # The zero block needs its diagonal: PARDISO wants every diagonal entry to be there.
        indices[at], index[at] = n_free + r, values + len(free_columns)
        at += 1
        indptr[n_free + r + 1] = at
    return indptr, indices[:at].copy(), index[:at].copy(), diagonal


@numba.njit(cache=True)
def _hold(indptr, indices, held, diagonal, values):
    for i in range(len(indptr) - 1):
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if held[i] or held[j]:
                values[k] = diagonal if i == j else 0.0


@numba.njit(cache=True)
def _put(values, where, out):
    for k in range(len(values)):
        out[where[k]] = values[k]


class ByBlocks:
    """Factors of a symmetric pattern in which all components are free, from its blocks of 3 × 3:
    they are analysed in a tenth of the time that entries take."""

    def __init__(self, pattern: Pattern):
        graph = pattern.graph
        node = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        upper = graph.indices >= node
        starts = np.concatenate([[0], np.cumsum(upper)])[graph.indptr]
        self._inner = make_solver(starts, graph.indices[upper], symmetric=True, block=3)
        place, entry = np.divmod(pattern.index, 9)
        first = 9 * (np.cumsum(upper) - 1)[place]
        i, j = np.divmod(entry, 3)
        self._where = (first + 3 * j + i).astype(np.int32)
        # Of blocks on the diagonal the pattern has the upper triangle.
        self._above = np.flatnonzero((node == graph.indices)[place] & (i != j))
        self._below = (first + 3 * i + j)[self._above]
        self._blocks = np.zeros(9 * int(upper.sum()))

    def factorise(self, values: np.ndarray) -> Factor:
        """Factorise the matrix with these values on the pattern; shape (entries,)."""
        _put(values, self._where, self._blocks)
        self._blocks[self._below] = values[self._above]
        return self._inner.factorise(self._blocks)


class Frame:
    """What scenes on one body share that differ in their terms: supports, pattern and solver.

    ``held``, ``rows``; ``C`` (rows, 3 nodes): their coefficients in the nodes' frames, ``C_free``
    (rows, n_free): those of free components; ``symmetric``; ``pattern``; ``solver``: of one
    sparsity pattern, with one analysis.
    """

    def __init__(
        self,
        body: Body,
        terms: Sequence[Term],
        fixed: Sequence[Fixed],
        rows: Sequence[Row],
        linear: str,
        tied: Sequence[Tied] = (),
    ):
        """Raises ValueError for supports and rows that contradict or repeat each other, for a body
        that is held all over, and for rows of linear elements with conjugate gradients."""
        fixed, rows = all_of("fixed", Fixed, fixed), all_of("rows", Row, rows)
        n = len(body.nodes)
        self.rows = rows
        self.held = held = Held(n, fixed, all_of("tied", Tied, tied))
        if not len(self.held.index):
            raise ValueError("every displacement is prescribed, so there is nothing to solve for")
        self.C = checks.row_matrix(self.rows, n, lambda c: held.collect(held.to_local(c).ravel()))
        self.C_free = self.C[:, self.held.index]
        checks.refuse_rows(self.rows, self.C, self.C_free)
        self.symmetric = all(term.symmetric for term in terms)
        graphs = [term.graph for term in terms if term.graph is not None]
        graph = NodeGraph.union(graphs)
        self.pattern = Pattern.of(graph, self.held, self.C, self.symmetric)
        direct = linear == "pardiso" or (linear == "auto" and mkl_pardiso() is not None)
        if direct and self.symmetric and not self.rows and self.held.free.all():
            self.solver = ByBlocks(self.pattern)
        else:
            self.solver = make_solver(
                self.pattern.indptr,
                self.pattern.indices,
                symmetric=self.symmetric,
                method=linear,
                bordered=bool(self.rows),
                modes=rigid_modes(body, held) if linear == "cg" else None,
                coarse=Coarse.of(body, held) if linear == "cg" else None,
            )
        self._places: dict[int, tuple[NodeGraph, np.ndarray]] = {}
        self._row_scale: np.ndarray | None = None
        self._entry_scale: np.ndarray | None = None
        self._part: tuple | None = None  # solver of the symmetric part, where its entries stand

    def places(self, graph: NodeGraph | None) -> np.ndarray | None:
        """Where a term's blocks stand among the scene's; None: they are the scene's, or none."""
        if graph is None or graph is self.pattern.graph:
            return None
        # The graph is kept, so that no other one can get its number.
        if id(graph) not in self._places:
            self._places[id(graph)] = graph, self.pattern.graph.find(graph)
        return self._places[id(graph)][1]

    def factorise(self, values: np.ndarray) -> Factor:
        """The factor of the matrix with these entries."""
        if not self.rows:
            return self.solver.factorise(values)
        return ScaledFactor(self.solver.factorise(self._scaled(values)), self._row_scale)

    def times(self, values: np.ndarray, x: np.ndarray) -> np.ndarray:
        """The product of the matrix with these entries and x (size,)."""
        return product(self.pattern.indptr, self.pattern.indices, values, x, self.symmetric)

    def modes_of_symmetric_part(self, values: np.ndarray) -> int | None:
        """Unstable modes of an unsymmetric matrix, if its symmetric part decides; None if not.

        It does where it has none itself (then Re λ > 0 for all eigenvalues, by Bendixson), and
        where it is the matrix to within roundoff, as the supports have taken up the rest.
        """
        p, size = self.pattern, len(self.pattern.indptr) - 1
        if self._part is None:
            at = sp.csr_array((np.arange(1, len(values) + 1), p.indices, p.indptr), (size, size))
            upper, lower = sp.triu(at, format="csr"), sp.tril(at).T.tocsr()
            upper.sort_indices()
            lower.sort_indices()
            solver = make_solver(
                upper.indptr, upper.indices, symmetric=True, bordered=bool(self.rows)
            )
            self._part = solver, upper.data - 1, lower.data - 1
        solver, above, below = self._part
        values = self._scaled(values) if self.rows else values
        symmetric, rest = values[above] + values[below], values[above] - values[below]
        try:
            negative = solver.factorise(symmetric / 2).negative
        except SingularMatrix:
            return None
        if negative is None:
            return None
        modes = negative - len(self.rows)
        decides = modes == 0 or np.abs(rest).max() <= 1e-12 * np.abs(symmetric).max()
        return modes if decides else None

    def _scaled(self, values: np.ndarray) -> np.ndarray:
        # Rows of size 1 beside a stiffness of 1e7 leave pivots that PARDISO takes for zero.
        if self._row_scale is None:
            p, size = self.pattern, len(self.pattern.indptr) - 1
            typical = np.median(np.abs(values[p.diagonal]))
            self._row_scale = np.ones(size)
            largest = abs(self.C).max(axis=1).toarray().ravel()
            self._row_scale[size - len(self.rows) :] = typical / largest
            a = np.repeat(np.arange(size), np.diff(p.indptr))
            self._entry_scale = self._row_scale[a] * self._row_scale[p.indices]
        return values * self._entry_scale
