"""Steps in which panels turn about their hinges, however long the step is.

As :mod:`solver.equilibrium.sections`, for panels that hang together as a tree of hinges: a panel k
turns by its own w_k, and where it hangs on another, at the points a of that and b of its own,

    x'_b = x'_a + R(w̄) (x_b − x_a + stretch),

so that a turn of one panel carries along all that hang on it. Hinges that close a circle of panels
are left to what the step does beyond that.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order

from solver.equilibrium.sections import FreeSections, nearest, turned


@dataclass(frozen=True, eq=False)
class Linked(FreeSections):
    """``ends`` (panels, 2, 8): weights of a and b on the nodes of the panel before and of the panel
    itself; ``order``: panels from the first one on, each after the one it hangs on, ``before``."""

    order: np.ndarray = field(default=None, repr=False)
    before: np.ndarray = field(default=None, repr=False)
    ends: np.ndarray = field(default=None, repr=False)

    @classmethod
    def of_hinges(cls, n: int, pairs: np.ndarray, sides: np.ndarray, first: int) -> Linked:
        """``pairs`` (h, 2): panels that each hinge joins; ``sides`` (h, 2, 4): weights of its two
        points on the four nodes of each; ``first``: the panel that all others hang on."""
        i, j = pairs.T
        graph = csr_array((np.arange(1, len(pairs) + 1), (i, j)), shape=(n, n))
        order, before = breadth_first_order(graph, first, directed=False)
        ends = np.zeros((n, 2, 8))
        by_pair = {tuple(pair): k for k, pair in enumerate(pairs.tolist())}
        for panel in order[1:]:
            own, other = int(panel), int(before[panel])
            hinge, back = by_pair.get((other, own)), by_pair.get((own, other))
            a, b = (0, 1) if hinge is not None else (1, 0)
            hinge = back if hinge is None else hinge
            ends[own, 0, :4], ends[own, 1, 4:] = sides[hinge, a], sides[hinge, b]
        return cls(np.repeat(np.arange(n), 4), first, False, order=order, before=before, ends=ends)

    def _hangs(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (n, 3) at the points a and b of each panel, (panels, 3)."""
        own = np.arange(len(self.before))
        nodes = 4 * np.stack([np.maximum(self.before, 0), own], axis=1)[..., None] + np.arange(4)
        at = values[nodes.reshape(len(own), 8)]
        return np.einsum("kn,kni->ki", self.ends[:, 0], at), np.einsum(
            "kn,kni->ki", self.ends[:, 1], at
        )

    def moved(self, X: np.ndarray, du: np.ndarray) -> np.ndarray:
        """Displacement (n, 3) from the positions X (n, 3) that a step du (n, 3) leads to."""
        c, d = self._centres(X), self._centres(du)
        r, rest = X - c[self.of], du - d[self.of]
        w = self._turns(r, rest)
        (xa, xb), (va, vb) = self._hangs(X), self._hangs(du)
        mean, line = (w + w[np.maximum(self.before, 0)]) / 2, xb - xa
        gap = turned(mean, line + vb - va - np.cross(mean, line))
        around = turned(w[self.of], r + rest - np.cross(w[self.of], r))
        return self._hung(c + d, around, gap) - X

    def _hung(self, centres: np.ndarray, around: np.ndarray, gap: np.ndarray) -> np.ndarray:
        """Positions (n, 3) of nodes that stand ``around`` (n, 3) their centres: the first panel's
        centre is that of ``centres``, and point b of each other one lies ``gap`` from a."""
        out = around + centres[self.of]
        for k in self.order[1:]:
            p, own = int(self.before[k]), slice(4 * k, 4 * k + 4)
            other = slice(4 * p, 4 * p + 4)
            a, b = self.ends[k, 0, :4] @ out[other], self.ends[k, 1, 4:] @ out[own]
            out[own] += a + gap[k] - b
        return out

    def step(self, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """The step du (n, 3) that leads from the positions X to the positions Y, (n, 3)."""
        c, d = self._centres(X), self._centres(Y)
        r, q = X - c[self.of], Y - d[self.of]
        w = self._rotations(r, q)
        for k in self.order[1:]:
            w[k] = nearest(w[k], w[self.before[k]])
        (xa, xb), (ya, yb) = self._hangs(X), self._hangs(Y)
        mean, line = (w + w[np.maximum(self.before, 0)]) / 2, xb - xa
        gap = np.cross(mean, line) + turned(-mean, yb - ya) - line
        of_node = w[self.of]
        around = np.cross(of_node, r) + turned(-of_node, q) - r
        return self._hung(d - c, around, gap)
