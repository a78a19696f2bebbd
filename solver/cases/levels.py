"""Meshes by number: each case has a tuple of sizes from coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

Sizes = TypeVar("Sizes")


def sizes_of(level: int | Sizes, levels: Sequence[Sizes]) -> Sizes:
    """The sizes of a level, or those that are given instead of one.

    Raises ValueError for a level that is not there.
    """
    kind = type(levels[0])
    if isinstance(level, kind):
        return level
    if level not in range(len(levels)):
        raise ValueError(
            f"level {level}; there are 0 to {len(levels) - 1}, or give {kind.__name__}"
        )
    return levels[level]
