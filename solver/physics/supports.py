"""What holds a body: prescribed displacements, mirror planes, and rows against rigid motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from solver.mesh.body import Body

Value = float | np.ndarray | Callable[[float], float | np.ndarray]


@dataclass(frozen=True)
class Fixed:
    """Displacement of ``nodes`` along ``direction`` (3,) prescribed as ``value``, maybe of e.

    A mirror plane with normal n is ``Fixed(nodes_on_it, n)``. Directions at one node may be at any
    angle where all of them are held at 0, and must be orthogonal or repeat each other otherwise.
    """

    nodes: np.ndarray
    direction: np.ndarray | Sequence[float]
    value: Value = 0.0


@dataclass(frozen=True)
class Row:
    """Linear constraint Σ coefficients · u = value; coefficients (nodes, 3)."""

    coefficients: np.ndarray
    value: Value = 0.0
    name: str = "row"


class Held:
    """Prescribed components: each in the frame of its node.

    ``free``: mask (3 n,) of the free components; ``index``: their numbers; ``frames`` (n, 3, 3):
    columns are the axes of each node; ``turned``: nodes whose frame is not the common one.
    """

    def __init__(self, n: int, fixed: Sequence[Fixed]):
        """Raises ValueError for directions that are zero or contradict each other."""
        directions: dict[int, list[tuple[np.ndarray, int]]] = {}
        for k, support in enumerate(fixed):
            d = np.asarray(support.direction, dtype=float)
            if d.shape != (3,) or not np.linalg.norm(d) > 0:
                raise ValueError(f"direction {support.direction!r}: expected three numbers, not 0")
            d = d / np.linalg.norm(d)
            for node in np.atleast_1d(support.nodes):
                known = directions.setdefault(int(node), [])
                along = [abs(d @ other) for other, _ in known]
                if any(c > 1 - 1e-9 for c in along):
                    continue
                new = d
                if any(c > 1e-9 for c in along):
                    if any(not _is_zero(fixed[i].value) for i in (k, *(i for _, i in known))):
                        raise ValueError(
                            f"node {node} is moved along directions at an angle to each other; "
                            "give orthogonal directions, or hold all of them at 0"
                        )
                    # At rest only the space that the directions span matters.
                    for other, _ in known:
                        new = new - (new @ other) * other
                    if np.linalg.norm(new) < 1e-9:
                        continue
                    new = new / np.linalg.norm(new)
                known.append((new, k))
        frames = np.zeros((n, 3, 3))
        frames[:] = np.eye(3)
        held = np.full((n, 3), -1)
        turned = []
        for node, given in directions.items():
            axes = [int(np.argmax(np.abs(d))) for d, _ in given]
            aligned = all(abs(abs(d[a]) - 1) < 1e-12 for (d, _), a in zip(given, axes, strict=True))
            if aligned:
                for (_, k), a in zip(given, axes, strict=True):
                    held[node, a] = k
                continue
            basis = np.array([d for d, _ in given])
            rest = np.linalg.svd(basis)[2][len(given) :]
            frames[node] = np.vstack([basis, rest]).T  # columns: held directions first
            held[node, : len(given)] = [k for _, k in given]
            turned.append(node)
        self.frames, self.turned = frames, np.array(sorted(turned), dtype=int)
        self.free = held.ravel() < 0
        self.index = np.flatnonzero(self.free)
        # Values per prescribed component, in its own frame; the sign of an axis counts.
        self._values = []
        for k, support in enumerate(fixed):
            nodes, axes = np.nonzero(held == k)
            d = np.asarray(support.direction, dtype=float)
            d = d / np.linalg.norm(d)
            sign = np.einsum("ij,ij->i", frames[nodes][:, :, :].transpose(0, 2, 1)[
                np.arange(len(nodes)), axes], np.broadcast_to(d, (len(nodes), 3)))  # fmt: skip
            at = np.searchsorted(np.sort(np.atleast_1d(support.nodes)), nodes)
            order = np.argsort(np.atleast_1d(support.nodes))
            self._values.append((support.value, 3 * nodes + axes, sign, order[at]))

    def values(self, e: float) -> np.ndarray:
        """Prescribed components at the load e, 0 at the free ones, (3 n,)."""
        local = np.zeros(len(self.free))
        for value, where, sign, order in self._values:
            v = value(e) if callable(value) else value
            v = np.asarray(v, dtype=float)
            local[where] = sign * (v[order] if v.ndim else v)
        return local

    def to_local(self, v: np.ndarray) -> np.ndarray:
        """A field (n, 3) from the common frame into the nodes' own."""
        if not len(self.turned):
            return v
        out = v.copy()
        t = self.turned
        out[t] = np.einsum("nji,nj->ni", self.frames[t], v[t])
        return out

    def to_global(self, v: np.ndarray) -> np.ndarray:
        """And back."""
        if not len(self.turned):
            return v
        out = v.copy()
        t = self.turned
        out[t] = np.einsum("nij,nj->ni", self.frames[t], v[t])
        return out


def _is_zero(value: Value) -> bool:
    """Whether a prescribed value is 0 at every load."""
    return not callable(value) and not np.any(value)


def translation_row(body: Body, axis: int) -> Row:
    """No mean displacement along an axis: ∫ u_k dV / V = 0 (Eq. 2.13)."""
    volume = body.node_volumes()
    c = np.zeros((len(volume), 3))
    c[:, axis] = volume / volume.sum()
    return Row(c, name=f"translation {'xyz'[axis]}")


def rotation_row(body: Body, axis: int) -> Row:
    """No mean rotation about an axis: ∫ (X − X̄) × u dV = 0 (Eq. 2.17), scaled to unit arm."""
    volume = body.node_volumes()
    arm = body.nodes - volume @ body.nodes / volume.sum()
    c = np.zeros_like(arm)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    # ((X − X̄) × u)_axis = arm_i u_j − arm_j u_i
    c[:, j], c[:, i] = volume * arm[:, i], -volume * arm[:, j]
    c /= volume @ (arm[:, i] ** 2 + arm[:, j] ** 2) / body.length
    return Row(c, name=f"rotation {'xyz'[axis]}")


def turning_row(body: Body, axis: int, u: np.ndarray, mirrors: Sequence[str] = ()) -> Row:
    """No further mean rotation about an axis beyond the displacement u (nodes, 3).

    The arms are those of the deformed state, from the centroid of the whole that ``mirrors`` makes
    of the body: those of the flat sheet see no rotation of a unit whose panels point back.
    """
    volume = body.node_volumes()
    arm = body.nodes + u
    centre = volume @ arm / volume.sum()
    centre[["xy".index(m) for m in mirrors]] = 0.0
    arm = arm - centre
    c = np.zeros_like(arm)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c[:, j], c[:, i] = volume * arm[:, i], -volume * arm[:, j]
    c /= volume @ (arm[:, i] ** 2 + arm[:, j] ** 2) / body.length
    return Row(c, value=float((c * u).sum()), name=f"rotation {'xyz'[axis]}")


def _sight(row: Row, positions: np.ndarray) -> float:
    """Share of a rotation of a body at ``positions`` (nodes, 3) that a row sees, up to 1."""
    axis = "xyz".index(row.name[-1])
    turn = np.cross(np.eye(3)[axis], positions - positions.mean(axis=0))
    c = row.coefficients
    return float((c * turn).sum() / (np.linalg.norm(c, axis=1) @ np.linalg.norm(turn, axis=1)))
