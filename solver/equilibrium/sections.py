"""Steps that bend a slender body in a plane: its sections turn, whatever the step's length.

A correction of Newton's method is a velocity: it says how fast each section turns. Taken straight,
u + du, a turn by θ lengthens a body by θ²/2, whose membrane forces drown its bending, and a line
search leaves next to nothing of the step. Taken as a motion the sections k turn by their angles
w_k, and the line of their centres c_k follows:

    x' = c'_k + R(w_k) (x − c_k + rest),    c'_(k+1) − c'_k = R(w̄) (c_(k+1) − c_k + stretch),

with w_k the turn that fits du in the section best, w̄ the mean of two neighbours; rest and stretch
are what du does beyond. Both ways agree to first order, so nothing changes close to the solution.
They are the coordinates in which rods are solved (Simo and Vu-Quoc 1986).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numba
import numpy as np


@dataclass(frozen=True, eq=False)
class Sections:
    """Sections y = const of a body that bends in the plane of y and z, by turns about x.

    ``of`` (nodes,): the section of each node, numbered along y; ``middle``: the one whose centre
    moves along y as the step says. In z the lowest one does, where the body stands on a ground
    (``grounded``).
    """

    of: np.ndarray = field(repr=False)
    middle: int
    grounded: bool

    @classmethod
    def across(cls, nodes: np.ndarray, *, grounded: bool) -> Sections:
        """Of a body whose nodes (n, 3) lie in planes y = const, a few in each."""
        y, of = np.unique(np.round(nodes[:, 1], 9), return_inverse=True)
        return cls(of, int(np.argmin(np.abs(y))), grounded)

    def moved(self, X: np.ndarray, du: np.ndarray) -> np.ndarray:
        """Displacement (n, 3) from the positions X (n, 3) that a step du (n, 3) leads to."""
        return _moved(self.of, X, du, self.middle, self._lowest(X))

    def step(self, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """The step du (n, 3) that leads from the positions X to the positions Y, (n, 3)."""
        return _step(self.of, X, Y, self.middle, self._lowest(X))

    def _lowest(self, X: np.ndarray) -> int:
        return int(self.of[np.argmin(X[:, 2])]) if self.grounded else self.middle


@numba.njit(cache=True)
def _centres(of, X):
    """Of each section y and z of its centre, (sections, 2)."""
    n = of.max() + 1
    centres, count = np.zeros((n, 2)), np.zeros(n)
    for k in range(len(of)):
        count[of[k]] += 1
        centres[of[k], 0] += X[k, 1]
        centres[of[k], 1] += X[k, 2]
    for s in range(n):
        centres[s] /= count[s]
    return centres


@numba.njit(cache=True)
def _moved(of, X, du, middle, lowest):
    c, d = _centres(of, X), _centres(of, du)
    n = len(c)
    top, low = np.zeros(n), np.zeros(n)
    for k in range(len(of)):
        s = of[k]
        y, z = X[k, 1] - c[s, 0], X[k, 2] - c[s, 1]
        top[s] += y * (du[k, 2] - d[s, 1]) - z * (du[k, 1] - d[s, 0])
        low[s] += y * y + z * z
    w, new = top / low, np.zeros((n, 2))
    for s in range(1, n):
        mean = (w[s] + w[s - 1]) / 2
        y, z = c[s, 0] - c[s - 1, 0], c[s, 1] - c[s - 1, 1]
        y, z = y + d[s, 0] - d[s - 1, 0] + mean * z, z + d[s, 1] - d[s - 1, 1] - mean * y
        new[s, 0] = new[s - 1, 0] + np.cos(mean) * y - np.sin(mean) * z
        new[s, 1] = new[s - 1, 1] + np.sin(mean) * y + np.cos(mean) * z
    new[:, 0] += c[middle, 0] + d[middle, 0] - new[middle, 0]
    new[:, 1] += c[lowest, 1] + d[lowest, 1] - new[lowest, 1]
    out = du.copy()
    for k in range(len(of)):
        s = of[k]
        y, z = X[k, 1] - c[s, 0], X[k, 2] - c[s, 1]
        y, z = y + du[k, 1] - d[s, 0] + w[s] * z, z + du[k, 2] - d[s, 1] - w[s] * y
        out[k, 1] = new[s, 0] + np.cos(w[s]) * y - np.sin(w[s]) * z - X[k, 1]
        out[k, 2] = new[s, 1] + np.sin(w[s]) * y + np.cos(w[s]) * z - X[k, 2]
    return out


@numba.njit(cache=True)
def _step(of, X, Y, middle, lowest):
    c, d = _centres(of, X), _centres(of, Y)
    n = len(c)
    sine, cosine = np.zeros(n), np.zeros(n)
    for k in range(len(of)):
        s = of[k]
        y, z = X[k, 1] - c[s, 0], X[k, 2] - c[s, 1]
        p, q = Y[k, 1] - d[s, 0], Y[k, 2] - d[s, 1]
        sine[s] += y * q - z * p
        cosine[s] += y * p + z * q
    w, along = np.arctan2(sine, cosine), np.zeros((n, 2))
    for direction in (1, -1):
        # No section turns by more than π against its neighbour.
        s = middle + direction
        while 0 <= s < n:
            w[s] += 2 * np.pi * np.round((w[s - direction] - w[s]) / (2 * np.pi))
            s += direction
    for s in range(1, n):
        mean = (w[s] + w[s - 1]) / 2
        y, z = c[s, 0] - c[s - 1, 0], c[s, 1] - c[s - 1, 1]
        p, q = d[s, 0] - d[s - 1, 0], d[s, 1] - d[s - 1, 1]
        along[s, 0] = along[s - 1, 0] + np.cos(mean) * p + np.sin(mean) * q - y - mean * z
        along[s, 1] = along[s - 1, 1] - np.sin(mean) * p + np.cos(mean) * q - z + mean * y
    along[:, 0] += d[middle, 0] - c[middle, 0] - along[middle, 0]
    along[:, 1] += d[lowest, 1] - c[lowest, 1] - along[lowest, 1]
    out = Y - X
    for k in range(len(of)):
        s = of[k]
        y, z = X[k, 1] - c[s, 0], X[k, 2] - c[s, 1]
        p, q = Y[k, 1] - d[s, 0], Y[k, 2] - d[s, 1]
        out[k, 1] = along[s, 0] - w[s] * z + np.cos(w[s]) * p + np.sin(w[s]) * q - y
        out[k, 2] = along[s, 1] + w[s] * y - np.sin(w[s]) * p + np.cos(w[s]) * q - z
    return out
