"""What a caller gives, as arrays: numbers, and numbers of nodes."""

from __future__ import annotations

import numpy as np


def numbers(name: str, value) -> np.ndarray:
    """``value`` as an array of floats; ValueError for text, ragged lists and the like."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is {value!r:.60}; expected numbers") from None


def node_numbers(nodes, n: int) -> np.ndarray:
    """Numbers of nodes given as such or as a mask (n,).

    Raises ValueError where there are none, or they are no nodes of a body of n.
    """
    given = np.atleast_1d(nodes) if numbers("nodes", nodes).size else np.zeros(0, int)
    if given.dtype == bool and given.shape == (n,):
        given = np.flatnonzero(given)
    if given.ndim != 1 or not len(given) or given.dtype.kind not in "iu":
        raise ValueError(
            f"nodes of shape {given.shape} and type {given.dtype}; expected numbers of nodes or a "
            f"mask ({n},), and at least one: Body.nodes_where gives them"
        )
    if given.min() < 0 or given.max() >= n:
        raise ValueError(f"nodes {given.min()} … {given.max()}; the body has 0 … {n - 1}")
    return given.astype(int)
