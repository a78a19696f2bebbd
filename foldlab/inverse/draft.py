"""Drafts: designs by the rod, on their way to the solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from foldlab.errors import InputError
from foldlab.inverse.points import columns_of, groups_of, physical_of
from foldlab.inverse.region import Region
from foldlab.inverse.wish import Wish
from foldlab.materials import read_materials


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


def bearable(wish: Wish, pair: tuple[str | None, str | None]) -> dict[str, float]:
    """Strain that each layer surely bears; raises :class:`InputError` where nothing is known."""
    table, out = read_materials(wish.materials), {}
    for layer, name in zip(("passive", "active"), pair, strict=True):
        low = np.nan if name is None else float(table.loc[name, "strain_low"])
        if not np.isfinite(low):
            whom = name or f"the {layer} layer, which has no material"
            raise InputError(
                f"strain_margin = {wish.strain_margin:g} asks for the strain that {whom} bears, "
                "and none is known; name a material whose table has strain_low"
            )
        out[layer] = low
    return out


@dataclass(frozen=True)
class Work:
    """What :func:`foldlab.inverse.finish.finish` is asked for; it travels to workers."""

    wish: Wish
    draft: Draft
    source: Any
    box: bool = True
