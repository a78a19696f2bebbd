"""Fields: a quantity as a constant, an array, or a function of the load e (and of position X).

A quantity on m cells (or facets) with q points each may be given as

- a number, or a constant array of the quantity's own shape, such as (3,) for a vector;
- an array per cell (m, ...) or per point (m, q, ...);
- a function of the load, ``f(e)``, or of load and position, ``f(e, X)`` with X (m, q, 3), that
  returns any of these.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable

import numpy as np

from solver.given import numbers

Quantity = float | np.ndarray | Callable
Points = Callable[[], np.ndarray]


class Unphysical(ValueError):
    """A quantity without physical meaning at some load, such as growth that turns a body inside
    out. An error where a scene is built or a path sets out; a load that a step tries is refused
    for it, as for an inverted element.
    """


def takes_position(value) -> bool:
    """Whether a function is one of load and position, f(e, X)."""
    try:
        parameters = inspect.signature(value).parameters.values()
    except (TypeError, ValueError):
        return False
    needed = [p for p in parameters if p.default is p.empty and p.kind <= p.POSITIONAL_OR_KEYWORD]
    return len(needed) == 2


def varies(value) -> bool:
    """Whether a quantity is a function."""
    return callable(value)


def resolve(
    name: str,
    value: Quantity,
    e: float,
    shape: tuple[int, int],
    points: Points | None = None,
    tail: tuple[int, ...] = (),
) -> np.ndarray:
    """The quantity at the load e, (1 | m, 1 | q, *tail), stored no larger than it was given.

    ``shape`` is (m, q), ``points`` gives X (m, q, 3) where a function asks for it. Raises
    ValueError for a shape that fits none of the forms above, Unphysical for values not finite.
    """
    if callable(value):
        if takes_position(value):
            if points is None:
                raise ValueError(f"{name} is a function of position; positions are not known here")
            value = value(e, points())
        else:
            value = value(e)
    a = numbers(name, value)
    m, q = shape
    if a.shape == tail:
        a = a.reshape(1, 1, *tail)
    elif a.shape == (m, *tail):
        a = a.reshape(m, 1, *tail)
    elif a.shape != (m, q, *tail):
        one = f"{tail}" if tail else "a number"
        per = ", ".join(str(s) for s in tail)
        comma = ", " if per else ""
        raise ValueError(
            f"{name} gave shape {a.shape}; expected {one}, ({m}{comma or ','}{per}) per cell or "
            f"({m}, {q}{comma}{per}) per point: return one value per quadrature point"
        )
    if not np.isfinite(a).all():
        cell, point = np.argwhere(~np.isfinite(a))[0][:2]
        raise Unphysical(
            f"{name} is not finite at e = {e:g} (cell {cell}, point {point}); mend the field"
        )
    return a


def unit(name: str, a: np.ndarray) -> np.ndarray:
    """Unit vectors along the last axis; ValueError for a zero vector."""
    size = np.linalg.norm(a, axis=-1, keepdims=True)
    if not (size > 0).all():
        cell = np.argwhere(~(size > 0))[0][0]
        raise ValueError(f"{name} is the zero vector in cell {cell}; give a direction")
    return a / size
