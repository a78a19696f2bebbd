"""The nearest design that folds, by a model, in the unit cube of its groups."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from foldlab.design import DesignSpace

DIRECTIONS, RADII = 512, 40
# Of refinement: rounds, by how much directions shrink in each, and the least part of the way tried.
ROUNDS, SPREAD, NEARER = 12, 0.6, 0.85
FURTHER = (1.0, 1.15, 1.4, 1.8)  # times the way, where what is nearest does not fold after all


@dataclass(frozen=True, eq=False)
class Way:
    """From a design straight to one that folds by the model: points of the unit cube (d,).

    ``alone``: the one group that changes, None where several do.
    """

    start: np.ndarray
    end: np.ndarray
    alone: str | None = None

    @property
    def length(self) -> float:
        """Root of the summed squares of changes, each a fraction of its group's bounds."""
        return float(np.linalg.norm(self.end - self.start))

    def further(self) -> Iterator[np.ndarray]:
        """Its end, and points beyond it within the bounds."""
        for factor in FURTHER:
            yield np.clip(self.start + factor * (self.end - self.start), 0, 1)


def ways(
    space: DesignSpace,
    design: dict[str, float],
    folds: Callable[[pd.DataFrame], np.ndarray],
    *,
    seed: int = 0,
) -> list[Way]:
    """The shortest way found with all groups, and the shortest with one alone; the shorter first.

    ``design``: within the bounds. ``folds``: which designs of a table fold, (n,) bool. Empty where
    nothing that folds was seen. What lies on the way between may fold or not.
    """
    rng = np.random.default_rng(seed)
    start = space.to_unit(pd.DataFrame([design]))[0].clip(0, 1)
    axes = np.vstack([np.eye(len(space)), -np.eye(len(space))])
    radii = np.linspace(0, 1, RADII + 1)[1:]
    alone = _shortest(space, start, axes, radii, folds)
    random = rng.standard_normal((DIRECTIONS, len(space)))
    # Farther than along an axis nothing is nearest.
    reach = np.sqrt(len(space)) if alone is None else np.linalg.norm(alone - start)
    best = _shortest(space, start, random, radii * reach, folds)
    if best is None or (alone is not None and _off(alone, start) < _off(best, start)):
        best = alone
    if best is None:
        return []
    spread = SPREAD
    for _ in range(ROUNDS):
        near = (best - start) / _off(best, start) + spread * rng.standard_normal(random.shape)
        nearer = np.linspace(NEARER, 1, RADII, endpoint=False) * _off(best, start)
        found = _shortest(space, start, near, nearer, folds)
        if found is not None and _off(found, start) < _off(best, start):
            best = found
        spread *= SPREAD
    out = [Way(start, best)]
    if alone is not None:
        changed = int(np.argmax(np.abs(alone - start)))
        single = Way(start, _closer(space, start, alone, folds), space.names[changed])
        out = [single] if single.length <= out[0].length else [*out, single]
    return out


def _off(end: np.ndarray, start: np.ndarray) -> float:
    return float(np.linalg.norm(end - start))


def _shortest(space, start, directions, radii, folds) -> np.ndarray | None:
    """The nearest point that folds among those at ``radii`` in each direction, as the bounds cut
    them; None without any."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    points = np.clip(start + radii[:, None, None] * unit, 0, 1).reshape(-1, len(space))
    good = points[np.asarray(folds(space.from_unit(points)), dtype=bool)]
    if len(good) == 0:
        return None
    return good[np.argmin(np.linalg.norm(good - start, axis=1))]


def _closer(space, start, end, folds, steps: int = 20) -> np.ndarray:
    """The first of finer steps towards a point from which on it folds."""
    parts = np.linspace(0, 1, steps + 1)[1:]
    good = np.asarray(folds(space.from_unit(start + parts[:, None] * (end - start))), dtype=bool)
    last = steps - 1 if good.all() else int(np.flatnonzero(~good).max()) + 1
    return start + parts[0 if good.all() else last] * (end - start)
