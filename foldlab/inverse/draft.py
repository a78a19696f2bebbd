"""Drafts: designs by the rod, on their way to the solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from foldlab.inverse.points import columns_of, groups_of, physical_of
from foldlab.inverse.region import Region
from foldlab.inverse.wish import Wish


@dataclass(frozen=True)
class Draft:
    """A design by the rod: log10 variables ``x`` (see :class:`Region`);
    ``driver``: the group along which an angle is reached, or None."""

    pair: tuple[str | None, str | None]
    region: Region
    x: np.ndarray
    driver: str | None = None

    @property
    def groups(self) -> dict[str, float]:
        columns = columns_of(self.region, self.x[None])
        return {name: float(value[0]) for name, value in columns.items()}

    @property
    def physical(self) -> dict[str, float]:
        groups = groups_of(self.region, self.x[None])
        return physical_of(self.region, groups, self.x[None]).iloc[0].dropna().to_dict()


@dataclass(frozen=True)
class Work:
    """What :func:`foldlab.inverse.finish.finish` is asked for; it travels to workers."""

    wish: Wish
    draft: Draft
    source: Any
    box: bool = True
