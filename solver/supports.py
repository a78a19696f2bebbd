"""What holds a body: prescribed displacements, mirror planes, and rows against rigid motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from solver.body import Body

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


def is_zero(value: Value) -> bool:
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
