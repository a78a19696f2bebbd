"""Steps in which parts turn about what links them, however long the step is.

As :mod:`solver.equilibrium.sections`, for parts that hang together as a tree, such as panels on
their hinges: a part k turns by its own w_k, and where it hangs on another, at the points a of that
and b of its own,

    x'_b = x'_a + R(w̄) (x_b − x_a + stretch),

so that a turn of one part carries along all that hang on it. Links that close a circle of parts
are left to what the step does beyond that.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import breadth_first_order

from solver.equilibrium.sections import FreeSections, nearest, rise, turned


@dataclass(frozen=True, eq=False)
class Linked(FreeSections):
    """``order``: parts from the first one on, each after the one it hangs on, ``before``;
    ``ends``: weights (parts, n) sparse of the points a and b of each on all nodes."""

    order: np.ndarray = field(default=None, repr=False)
    before: np.ndarray = field(default=None, repr=False)
    ends: tuple[sp.csr_array, sp.csr_array] = field(default=None, repr=False)

    @classmethod
    def of_links(
        cls,
        of: np.ndarray,
        pairs: np.ndarray,
        sides: tuple[sp.csr_array, sp.csr_array],
        first: int,
        *,
        grounded: bool = False,
    ) -> Linked:
        """``of`` (n,): the part of each node; ``pairs`` (l, 2): parts that each link joins;
        ``sides``: weights (l, n) of its two points; ``first``: the part that all others hang on.
        """
        n = int(of.max()) + 1
        i, j = pairs.T
        graph = sp.csr_array((np.arange(1, len(pairs) + 1), (i, j)), shape=(n, n))
        order, before = breadth_first_order(graph, first, directed=False)
        links = {tuple(pair): (k, 0) for k, pair in enumerate(pairs.tolist())}
        links |= {pair[::-1]: (k, 1) for pair, (k, _) in links.items()}
        chosen = [links[int(before[k]), int(k)] for k in order[1:]]
        both = [side.tocsr()[[k for k, _ in chosen]] for side in sides]
        back = sp.diags_array(np.array([way for _, way in chosen], float))
        there = sp.eye_array(len(chosen)) - back
        rows = sp.csr_array(
            (np.ones(len(chosen)), (order[1:], np.arange(len(chosen)))), shape=(n, len(chosen))
        )
        a = rows @ (there @ both[0] + back @ both[1])
        b = rows @ (back @ both[0] + there @ both[1])
        return cls(of, first, grounded, order=order, before=before, ends=(a.tocsr(), b.tocsr()))

    def moved(self, X: np.ndarray, du: np.ndarray) -> np.ndarray:
        """Displacement (n, 3) from the positions X (n, 3) that a step du (n, 3) leads to."""
        c, d = self._centres(X), self._centres(du)
        r, rest = X - c[self.of], du - d[self.of]
        w = self._turns(r, rest)
        (xa, xb), (va, vb) = self._at_ends(X), self._at_ends(du)
        mean, line = (w + w[np.maximum(self.before, 0)]) / 2, xb - xa
        gap = turned(mean, line + vb - va - np.cross(mean, line))
        around = turned(w[self.of], r + rest - np.cross(w[self.of], r))
        out = self._hung(c + d, around, gap) - X
        if self.grounded:
            out[:, 2] += rise(X + out, X + du)
        return out

    def _at_ends(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (n, 3) at the points a and b of each part, (parts, 3)."""
        a, b = self.ends
        return a @ values, b @ values

    def _hung(self, centres: np.ndarray, around: np.ndarray, gap: np.ndarray) -> np.ndarray:
        """Positions (n, 3) of nodes that stand ``around`` (n, 3) their centres: the first part's
        centre is that of ``centres``, and point b of each other one lies ``gap`` from a."""
        a, b = self._at_ends(around)
        off, at = a + gap - b, np.empty_like(centres)
        at[self.middle] = centres[self.middle]
        for k in self.order[1:]:
            at[k] = at[self.before[k]] + off[k]
        return around + at[self.of]

    def step(self, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """The step du (n, 3) that leads from the positions X to the positions Y, (n, 3)."""
        c, d = self._centres(X), self._centres(Y)
        r, q = X - c[self.of], Y - d[self.of]
        w = self._rotations(r, q)
        for k in self.order[1:]:
            w[k] = nearest(w[k], w[self.before[k]])
        (xa, xb), (ya, yb) = self._at_ends(X), self._at_ends(Y)
        mean, line = (w + w[np.maximum(self.before, 0)]) / 2, xb - xa
        gap = np.cross(mean, line) + turned(-mean, yb - ya) - line
        of_node = w[self.of]
        around = np.cross(of_node, r) + turned(-of_node, q) - r
        out = self._hung(d - c, around, gap)
        if self.grounded:
            out[:, 2] += rise(X + out, Y)
        return out
