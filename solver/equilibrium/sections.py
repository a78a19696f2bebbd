"""Steps that bend a slender body in a plane: its sections turn, whatever the step's length.

A correction of Newton's method is a velocity: it says how fast each section turns. Taken straight,
u + du, a turn by θ lengthens a body by θ²/2, whose membrane forces drown its bending, and a line
search leaves next to nothing of the step. Taken as a motion the sections k turn by their angles
w_k, and the line of their centres c_k follows:

    x' = c'_k + R(w_k) (x − c_k + rest),    c'_(k+1) − c'_k = R(w̄) (c_(k+1) − c_k + stretch),

with w_k the turn that fits du in the section best, w̄ the mean of two neighbours; rest and stretch
are what du does beyond. Both ways agree to first order, so nothing changes close to the solution.
They are the coordinates in which rods are solved (Simo and Vu-Quoc 1986).
A body that twists turns its sections about any axis: w_k is a rotation vector then.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numba
import numpy as np


@dataclass(frozen=True, eq=False)
class Sections:
    """Sections y = const of a body that bends in the plane of y and z, by turns about x.

    ``of`` (nodes,): the section of each node, numbered along y; ``middle``: the one whose centre
    moves as the step says. Where the body stands on a ground (``grounded``) its lowest node comes
    to stand as high as if the step went straight: what the ground admits of a straight step it
    admits of the turning one too.
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
        out = _moved(self.of, X, du, self.middle)
        if self.grounded:
            out[:, 2] += rise(X + out, X + du)
        return out

    def step(self, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """The step du (n, 3) that leads from the positions X to the positions Y, (n, 3)."""
        out = _step(self.of, X, Y, self.middle)
        if self.grounded:
            out[:, 2] += rise(X + out, Y)
        return out


@dataclass(frozen=True, eq=False)
class FreeSections:
    """As :class:`Sections`, by turns about any axis, or about a single one of x, y, z (``about``).

    A mirror plane that the body is cut at leaves its sections fewer axes than a fit would give.
    """

    of: np.ndarray = field(repr=False)
    middle: int
    grounded: bool
    about: tuple[int, ...] = (0, 1, 2)

    @classmethod
    def across(
        cls, nodes: np.ndarray, *, grounded: bool, about: tuple[int, ...] = (0, 1, 2)
    ) -> FreeSections:
        """Of a body whose nodes (n, 3) lie in planes y = const, some in each."""
        plain = Sections.across(nodes, grounded=grounded)
        return cls(plain.of.ravel(), plain.middle, grounded, about)

    def moved(self, X: np.ndarray, du: np.ndarray) -> np.ndarray:
        """Displacement (n, 3) from the positions X (n, 3) that a step du (n, 3) leads to."""
        c, d = self._centres(X), self._centres(du)
        r, rest = X - c[self.of], du - d[self.of]
        w = self._turns(r, rest)
        mean, line = (w[1:] + w[:-1]) / 2, np.diff(c, axis=0)
        lines = turned(mean, line + np.diff(d, axis=0) - np.cross(mean, line))
        new = self._chained(c + d, lines)
        of_node = w[self.of]
        out = new[self.of] - X + turned(of_node, r + rest - np.cross(of_node, r))
        if self.grounded:
            out[:, 2] += rise(X + out, X + du)
        return out

    def step(self, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """The step du (n, 3) that leads from the positions X to the positions Y, (n, 3)."""
        c, d = self._centres(X), self._centres(Y)
        r, q = X - c[self.of], Y - d[self.of]
        w = self._rotations(r, q)
        for direction in (1, -1):
            # No section turns by more than π against its neighbour.
            s = self.middle + direction
            while 0 <= s < len(w):
                w[s] = nearest(w[s], w[s - direction])
                s += direction
        mean, line = (w[1:] + w[:-1]) / 2, np.diff(c, axis=0)
        lines = np.cross(mean, line) + turned(-mean, np.diff(d, axis=0)) - line
        shift = self._chained(d - c, lines)
        of_node = w[self.of]
        out = shift[self.of] + np.cross(of_node, r) + turned(-of_node, q) - r
        if self.grounded:
            out[:, 2] += rise(X + out, Y)
        return out

    def _sums(self, values: np.ndarray) -> np.ndarray:
        """Over the nodes (n, …) of each section."""
        flat = values.reshape(len(values), -1)
        sums = [np.bincount(self.of, column) for column in flat.T]
        return np.stack(sums, axis=1).reshape(-1, *values.shape[1:])

    def _centres(self, X: np.ndarray) -> np.ndarray:
        return self._sums(X) / np.bincount(self.of)[:, None]

    def _turns(self, r: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """The rotation vectors that fit displacements of the sections best: Σ r × (rest − w × r)
        vanishes."""
        k = list(self.about)
        moments = self._sums(np.cross(r, rest))
        square = (r * r).sum(axis=1)[:, None, None] * np.eye(3)
        inertia = self._sums(square - r[:, :, None] * r[:, None, :])
        w = np.zeros_like(moments)
        w[:, k] = np.linalg.solve(inertia[:, k][:, :, k], moments[:, k, None])[:, :, 0]
        return w

    def _rotations(self, r: np.ndarray, q: np.ndarray) -> np.ndarray:
        """The rotation vectors w with no turn left: Σ r × R(−w) q vanishes in the axes allowed."""
        if len(self.about) == 1:
            (k,) = self.about
            i, j = (k + 1) % 3, (k + 2) % 3
            sine = self._sums(r[:, i] * q[:, j] - r[:, j] * q[:, i])
            cosine = self._sums(r[:, i] * q[:, i] + r[:, j] * q[:, j])
            w = np.zeros((len(sine), 3))
            w[:, k] = np.arctan2(sine, cosine)
            return w
        # The polar factor (Kabsch 1976); a flat section leaves the sign of its normal open.
        U, _, V = np.linalg.svd(self._sums(q[:, :, None] * r[:, None, :]))
        U[:, :, 2] *= np.sign(np.linalg.det(U @ V))[:, None]
        return _vectors(U @ V)

    def _chained(self, ends: np.ndarray, lines: np.ndarray) -> np.ndarray:
        """Centres from one to the next; the middle one is that of ``ends``."""
        new = np.concatenate([np.zeros((1, 3)), np.cumsum(lines, axis=0)])
        return new + (ends - new)[self.middle]


def rise(X: np.ndarray, Y: np.ndarray) -> float:
    """By how much the lowest of the positions Y lies above that of X."""
    return float(Y[:, 2].min() - X[:, 2].min())


def turned(w: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors v (n, 3) turned by rotation vectors w (n, 3): Rodrigues' formula."""
    angle = np.linalg.norm(w, axis=1)[:, None]
    across = np.cross(w, v)
    half = np.sinc(angle / (2 * np.pi))
    return v + np.sinc(angle / np.pi) * across + half**2 / 2 * np.cross(w, across)


def _vectors(R: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) of rotations (n, 3, 3), no longer than π."""
    axis = np.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1
    )
    sine = np.linalg.norm(axis, axis=1) / 2
    angle = np.arctan2(sine, (np.trace(R, axis1=1, axis2=2) - 1) / 2)
    return axis * np.where(sine < 1e-9, 0.5, angle / np.maximum(2 * sine, 1e-300))[:, None]


def nearest(w: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Of the vectors (3,) of one rotation the one nearest to another vector."""
    angle = np.linalg.norm(w)
    if angle == 0:
        return w
    axis = w / angle
    return w + 2 * np.pi * np.round((other @ axis - angle) / (2 * np.pi)) * axis


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
def _moved(of, X, du, middle):
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
    new[:, 1] += c[middle, 1] + d[middle, 1] - new[middle, 1]
    out = du.copy()
    for k in range(len(of)):
        s = of[k]
        y, z = X[k, 1] - c[s, 0], X[k, 2] - c[s, 1]
        y, z = y + du[k, 1] - d[s, 0] + w[s] * z, z + du[k, 2] - d[s, 1] - w[s] * y
        out[k, 1] = new[s, 0] + np.cos(w[s]) * y - np.sin(w[s]) * z - X[k, 1]
        out[k, 2] = new[s, 1] + np.sin(w[s]) * y + np.cos(w[s]) * z - X[k, 2]
    return out


@numba.njit(cache=True)
def _step(of, X, Y, middle):
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
    along[:, 1] += d[middle, 1] - c[middle, 1] - along[middle, 1]
    out = Y - X
    for k in range(len(of)):
        s = of[k]
        y, z = X[k, 1] - c[s, 0], X[k, 2] - c[s, 1]
        p, q = Y[k, 1] - d[s, 0], Y[k, 2] - d[s, 1]
        out[k, 1] = along[s, 0] - w[s] * z + np.cos(w[s]) * p + np.sin(w[s]) * q - y
        out[k, 2] = along[s, 1] + w[s] * y - np.sin(w[s]) * p + np.cos(w[s]) * q - z
    return out
