"""What holds a body: prescribed displacements, mirror planes, and rows against rigid motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from solver.given import axis_number, node_numbers, numbers
from solver.mesh.body import Body

Value = float | np.ndarray | Callable[[float], float | np.ndarray]


@dataclass(frozen=True)
class Fixed:
    """Displacement of ``nodes`` along ``direction`` (3,) prescribed as ``value``, maybe of e.

    ``nodes``: numbers, or a mask (n,) of all nodes of the body; ``value``: one number (m) or one
    per node. A mirror plane with normal n is ``Fixed(nodes_on_it, n)``. Directions at one node may
    be at any angle where all of them are held at 0, and must be orthogonal or repeat each other,
    with the same value, otherwise.
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


@dataclass(frozen=True)
class Tied:
    """Each of ``nodes`` moves as its image of ``images`` (pairs,): u(node) = signs · u(image).

    ``signs`` (3,) of ±1 along x, y, z. So a part of a body is closed that a half-turn about z makes
    whole, which no support of single components can do: (−1, −1, 1) ties what lies opposite on the
    cut. Nodes on the axis are held by :class:`Fixed` instead.
    """

    nodes: np.ndarray
    images: np.ndarray
    signs: Sequence[float]


class Held:
    """Prescribed components: each in the frame of its node; and nodes that are tied to others.

    ``free``: mask (3 n,) of the free components; ``index``: their numbers; ``frames`` (n, 3, 3):
    columns are the axes of each node; ``turned``: nodes whose frame is not the common one;
    ``tied``, ``masters`` (3 pairs,) components and ``signs``: local[tied] = signs · local[masters].
    """

    def __init__(self, n: int, fixed: Sequence[Fixed], tied: Sequence[Tied] = ()):
        """Raises ValueError for nodes that don't exist, directions that are zero, values that are
        not one number or one per node, supports that contradict each other at e = 0, and ties of
        nodes that are held, tied twice or turned."""
        self._chosen = [node_numbers(support.nodes, n) for support in fixed]
        self._given = [support.value for support in fixed]
        directions = [unit_vector(support.direction) for support in fixed]
        at_rest = np.array([_is_zero(value) for value in self._given])
        # Of each node up to three orthonormal directions: the support that holds it along each,
        # and the node's place among the nodes of that support.
        basis, count = np.zeros((n, 3, 3)), np.zeros(n, int)
        holder, places = np.full((n, 3), -1), np.zeros((n, 3), int)
        # Who holds a node along a direction again: both supports, node, both places, sense.
        repeats = []
        for k, (chosen, d) in enumerate(zip(self._chosen, directions, strict=True)):
            nodes, place, back = np.unique(chosen, return_index=True, return_inverse=True)
            twice = np.flatnonzero(place[back] != np.arange(len(chosen)))
            if len(twice):
                repeats.append((k, k, chosen[twice], place[back[twice]], twice, 1.0))
            along = basis[nodes] @ d
            known = np.abs(along) > 1 - 1e-9
            for slot in np.flatnonzero(known.any(axis=0)):
                for first in np.unique(holder[nodes[known[:, slot]], slot]):
                    i = np.flatnonzero(known[:, slot] & (holder[nodes, slot] == first))
                    sense = np.sign(along[i, slot])
                    repeats.append((first, k, nodes[i], places[nodes[i], slot], place[i], sense))
            slanted = (np.abs(along) > 1e-9).any(axis=1) & ~known.any(axis=1)
            free = slanted & ((holder[nodes] >= 0) & ~at_rest[holder[nodes]]).any(axis=1)
            free |= slanted & ~at_rest[k]
            if free.any():
                raise ValueError(
                    f"node {nodes[free][0]} is moved along directions at an angle to each other; "
                    "give orthogonal directions, or hold all of them at 0"
                )
            # At rest only the space that the directions span matters.
            new = d - np.einsum("ns,nsi->ni", along, basis[nodes])
            size = np.linalg.norm(new, axis=1)
            add = np.flatnonzero(~known.any(axis=1) & (size > 1e-9))
            nodes, slot = nodes[add], count[nodes[add]]
            basis[nodes, slot] = new[add] / size[add, None]
            holder[nodes, slot], places[nodes, slot] = k, place[add]
            count[nodes] += 1
        axes = np.argmax(np.abs(basis), axis=2)
        aligned = np.abs(basis).max(axis=2) > 1 - 1e-12
        used = holder >= 0
        turned = (used & ~aligned).any(axis=1)
        axes[turned] = np.arange(3)
        frames = np.zeros((n, 3, 3))
        frames[:] = np.eye(3)
        for c in (1, 2, 3):
            at = np.flatnonzero(turned & (count == c))
            given = basis[at, :c]
            rest = np.linalg.svd(given)[2][:, c:]
            # Columns: held directions first.
            frames[at] = np.concatenate([given, rest], axis=1).transpose(0, 2, 1)
        self.frames, self.turned = frames, np.flatnonzero(turned)
        node, slot = np.nonzero(used)
        axis = axes[node, slot]
        self.free = np.ones(3 * n, bool)
        self.free[3 * node + axis] = False
        self.tied, self.masters, self.signs = self._ties(n, tied, count)
        self.free[self.tied] = False
        self.index = np.flatnonzero(self.free)
        # Where each support's values go: component, sign of its axis, place among the nodes.
        self._places = []
        for k, d in enumerate(directions):
            mine = np.flatnonzero(holder[node, slot] == k)
            i, j = node[mine], axis[mine]
            self._places.append((3 * i + j, frames[i, :, j] @ d, places[i, slot[mine]]))
        self._repeats = repeats
        self._moving = any(callable(value) for value in self._given)
        self._start = self._at(0.0)

    def _ties(self, n: int, tied: Sequence[Tied], count: np.ndarray) -> tuple[np.ndarray, ...]:
        """Tied components, their masters and signs; ``count`` (n,): directions along which each
        node is held."""
        nodes, images, signs = np.empty(0, int), np.empty(0, int), np.empty((0, 3))
        for tie in tied:
            ends = [node_numbers(which, n) for which in (tie.nodes, tie.images)]
            sign = numbers("a tie's signs", tie.signs)
            if ends[0].shape != ends[1].shape or sign.shape != (3,) or (np.abs(sign) != 1).any():
                raise ValueError(
                    f"a tie of {len(ends[0])} nodes to {len(ends[1])} with the signs {sign}; "
                    "expected as many images as nodes, and three signs of ±1"
                )
            nodes, images = np.append(nodes, ends[0]), np.append(images, ends[1])
            signs = np.vstack([signs, np.tile(sign, (len(ends[0]), 1))])
        bad = np.isin(nodes, images) | (count[nodes] > 0) | np.isin(images, self.turned)
        bad |= np.bincount(nodes, minlength=n)[nodes] > 1
        if bad.any():
            raise ValueError(
                f"node {nodes[bad][0]} is tied, and also held, an image or tied again, or its "
                "image is held at an angle; tie each node once, to one that is free"
            )
        ends = [(3 * k[:, None] + np.arange(3)).ravel() for k in (nodes, images)]
        return *ends, signs.ravel()

    def spread(self, local: np.ndarray) -> np.ndarray:
        """Components (3 n,) with those of tied nodes from their images; changed in place."""
        if len(self.tied):
            local[self.tied] = self.signs * local[self.masters]
        return local

    def collect(self, local: np.ndarray) -> np.ndarray:
        """Forces (…, 3 n) with those on tied nodes handed to their images: the transpose."""
        if len(self.tied):
            local = local.copy()
            np.add.at(local.T, self.masters, (self.signs * local[..., self.tied]).T)
            local[..., self.tied] = 0.0
        return local

    def values(self, e: float) -> np.ndarray:
        """Prescribed components at the load e, 0 at the free ones, (3 n,).

        Raises ValueError where a node is given two values along one direction.
        """
        return self._at(e) if self._moving else self._start.copy()

    def _at(self, e: float) -> np.ndarray:
        local = np.zeros(len(self.free))
        given = [self._value(k, e) for k in range(len(self._given))]
        for v, (where, sign, place) in zip(given, self._places, strict=True):
            local[where] = sign * v[place]
        for first, k, nodes, there, place, sense in self._repeats:
            a, b = given[first][there], sense * given[k][place]
            off = np.flatnonzero(np.abs(a - b) > 1e-12 * max(np.abs(a).max(), np.abs(b).max()))
            if len(off):
                i = off[0]
                raise ValueError(
                    f"node {nodes[i]} is moved by {a[i]:g} and by {b[i]:g} along one direction "
                    f"at e = {e:g}; two supports contradict each other, drop one"
                )
        return local

    def _value(self, k: int, e: float) -> np.ndarray:
        """The value of support k at each of its nodes."""
        value, shape = self._given[k], self._chosen[k].shape
        v = numbers("a support's value", value(e) if callable(value) else value)
        if v.shape not in ((), (1,), shape) or not np.isfinite(v).all():
            raise ValueError(
                f"a support's value at e = {e:g} has shape {v.shape}; expected one finite number, "
                f"or one for each of its {shape[0]} nodes"
            )
        return np.broadcast_to(v, shape)

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


def unit_vector(direction, what: str = "direction") -> np.ndarray:
    """The unit vector along ``direction`` (3,); ValueError for anything else."""
    d = numbers(what, direction)
    if d.shape != (3,) or not (np.isfinite(d).all() and np.linalg.norm(d) > 0):
        raise ValueError(f"{what} {direction!r}: expected three numbers, not 0")
    return d / np.linalg.norm(d)


def _is_zero(value: Value) -> bool:
    """Whether a prescribed value is 0 at every load."""
    return not callable(value) and not np.any(value)


def translation_row(body: Body, axis: int) -> Row:
    """No mean displacement along an axis: ∫ u_k dV / V = 0 (Eq. 2.13)."""
    volume = body.node_volumes()
    c = np.zeros((len(volume), 3))
    c[:, axis_number(axis)] = volume / volume.sum()
    return Row(c, name=f"translation {'xyz'[axis]}")


def rotation_row(
    body: Body, axis: int, u: np.ndarray | None = None, mirrors: Sequence[str] = ()
) -> Row:
    """No mean rotation about an axis: ∫ (X − X̄) × u dV = 0 (Eq. 2.17), scaled to unit arm.

    With a displacement ``u`` (nodes, 3): no further rotation beyond it, seen with the arms of that
    state, from the centroid of the whole that ``mirrors`` make of the body: the arms of the flat
    sheet see no rotation of a unit whose panels point back.
    """
    axis_number(axis)
    if any(m not in ("x", "y") for m in mirrors):
        raise ValueError(f"mirrors {mirrors!r}; expected some of 'x' and 'y'")
    if u is not None:
        u = numbers("u", u)
        if u.shape != body.nodes.shape or not np.isfinite(u).all():
            raise ValueError(f"u has shape {u.shape}; expected finite numbers {body.nodes.shape}")
    volume = body.node_volumes()
    arm = body.nodes if u is None else body.nodes + u
    centre = volume @ arm / volume.sum()
    centre[["xy".index(m) for m in mirrors]] = 0.0
    arm = arm - centre
    c = np.zeros_like(arm)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    # ((X − X̄) × u)_axis = arm_i u_j − arm_j u_i
    c[:, j], c[:, i] = volume * arm[:, i], -volume * arm[:, j]
    c /= volume @ (arm[:, i] ** 2 + arm[:, j] ** 2) / body.length
    value = 0.0 if u is None else float((c * u).sum())
    return Row(c, value, f"rotation {'xyz'[axis]}")


def _sight(row: Row, positions: np.ndarray, mirrors: Sequence[str] = ()) -> float:
    """Fraction of a rotation of a body at ``positions`` (nodes, 3) that a row sees, up to 1."""
    axis = "xyz".index(row.name[-1])
    centre = positions.mean(axis=0)
    centre[["xy".index(m) for m in mirrors]] = 0.0
    turn = np.cross(np.eye(3)[axis], positions - centre)
    c = row.coefficients
    return float((c * turn).sum() / (np.linalg.norm(c, axis=1) @ np.linalg.norm(turn, axis=1)))
