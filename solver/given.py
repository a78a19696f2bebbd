"""What a caller gives, as arrays: numbers, and numbers of nodes. All raise ValueError else."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


def numbers(name: str, value) -> np.ndarray:
    """``value`` as an array of floats; ValueError for text, ragged lists and the like."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is {value!r:.60}; expected numbers") from None


def number(name: str, value, above: float = -np.inf) -> float:
    """One finite number, greater than ``above``."""
    given = numbers(name, value)
    if given.shape or not np.isfinite(given) or not given > above:
        beyond = "" if above == -np.inf else f" > {above:g}"
        raise ValueError(f"{name} = {value!r:.60}; expected one finite number{beyond}")
    return float(given)


def positive(choices, *names: str) -> None:
    """Raises ValueError for the first of the attributes that is not > 0."""
    for name in names:
        value = numbers(name, getattr(choices, name))
        if value.shape or not value > 0:
            raise ValueError(f"{name} = {getattr(choices, name)}; expected a number > 0")


def whole(name: str, value, low: int, high: float = np.inf) -> int:
    """One whole number from ``low`` to ``high``."""
    kind = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (kind and low <= value <= high):
        upto = "" if high == np.inf else f" to {high}"
        raise ValueError(f"{name} = {value!r:.60}; expected a whole number from {low}{upto}")
    return int(value)


def vector(name: str, value) -> np.ndarray:
    """Three finite numbers, (3,)."""
    given = numbers(name, value)
    if given.shape != (3,) or not np.isfinite(given).all():
        raise ValueError(f"{name} = {value!r:.60}; expected three finite numbers")
    return given


def axis_number(axis) -> int:
    """0, 1 or 2 for x, y or z."""
    if isinstance(axis, bool) or not isinstance(axis, int | np.integer) or axis not in (0, 1, 2):
        raise ValueError(f"axis = {axis!r:.60}; expected 0, 1 or 2 for x, y or z")
    return int(axis)


def mask(name: str, value, n: int) -> np.ndarray:
    """A mask (n,) of booleans."""
    if numbers(name, value).shape != (n,) or np.asarray(value).dtype != bool:
        given = np.asarray(value)
        raise ValueError(
            f"{name} gave shape {given.shape} and type {given.dtype}; expected a mask ({n},) of "
            "booleans: one per position, X[:, 0] is x"
        )
    return np.asarray(value)


def all_of(name: str, kind: type, values) -> tuple:
    """The members of a list, each of one kind."""
    members = tuple(values) if isinstance(values, Iterable) else (values,)
    if not isinstance(values, Iterable) or not all(isinstance(v, kind) for v in members):
        wrong = next((v for v in members if not isinstance(v, kind)), values)
        raise ValueError(f"{name} holds {wrong!r:.60}; expected a list of {kind.__name__}")
    return members


def one_of(name: str, kind: type, value, maker: str):
    """An object of one kind, made by ``maker``."""
    if not isinstance(value, kind):
        raise ValueError(
            f"{name} is {value!r:.60}; expected a {kind.__name__}, which {maker} gives"
        )
    return value


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
    if len(given) == n > 2 and 0 <= given.min() <= given.max() <= 1:
        raise ValueError(
            f"nodes are {n} zeros and ones, one per node of the body: a mask of whole numbers; "
            "give it as booleans, mask.astype(bool)"
        )
    if given.min() < 0 or given.max() >= n:
        raise ValueError(f"nodes {given.min()} … {given.max()}; the body has 0 … {n - 1}")
    return given.astype(int)
