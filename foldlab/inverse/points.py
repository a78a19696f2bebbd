"""From points of a region (log10 variables) to groups, SI quantities and a choice of points."""

from __future__ import annotations

import numpy as np
import pandas as pd

from foldlab.design import PATTERNED, RATIOS, to_physical
from foldlab.inverse.region import Region
from foldlab.inverse.wish import SCALES
from foldlab.materials import find_material

MASS_COLUMNS = ("rho_s", "rho_i", "l_s", "l_i", "b_s", "b_i", "h_s", "h_i")


def physical_of(region: Region, groups: pd.DataFrame, x: np.ndarray) -> pd.DataFrame:
    """SI quantities as far as the limits reach; fixed ones to the last digit."""
    wish = region.wish
    scales = {
        name: 10.0 ** x[:, region.names.index(name)]
        for name in (*SCALES, "g_earth")
        if name in region.names
    }
    if not scales:
        return pd.DataFrame(index=groups.index)
    known, columns = set(scales), []
    for quantity, (group, scale) in RATIOS.items():
        if group in groups and scale in known:
            known.add(quantity)
            columns.append(group)
    columns += [name for name in ("contraction",) if name in groups]
    if "stiffness_to_weight" in groups:
        columns.append("stiffness_to_weight")
        scales.pop("E_s")  # follows from Γ, so that the answer is consistent by construction
    out = to_physical(groups[columns], **scales)
    for name in out.columns:
        if name in wish.fixed:
            out[name] = float(wish.fixed[name])
        elif name in wish.ranges:
            out[name] = out[name].clip(*wish.ranges[name])
    return out


def named(table, pair: tuple[str | None, str | None]) -> tuple[str | None, str | None]:
    """The table's own names of a passive and an active material."""
    roles = zip(pair, ("passive", "active"), strict=True)
    passive, active = (name and find_material(table, name, role) for name, role in roles)
    return passive, active


def spread(groups, physical, margin, n: int) -> list[int]:
    """Greedy choice: the most robust first, then far from all chosen and robust."""
    columns = [PATTERNED[name].to_unit(groups[name].to_numpy()) for name in groups]
    columns += [np.log10(physical[name].fillna(1.0)) / 3 for name in SCALES if name in physical]
    points = np.column_stack(columns)
    weight = np.sqrt(margin + 1e-3)
    chosen = [int(np.argmax(margin))]
    away = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < n:
        k = int(np.argmax(away * weight))
        if away[k] <= 1e-12:
            break
        chosen.append(k)
        away = np.minimum(away, np.linalg.norm(points - points[k], axis=1))
    return chosen


def groups_of(region: Region, x: np.ndarray) -> pd.DataFrame:
    """Groups of log10 variables; what the wish states is met to the last digit."""
    return pd.DataFrame(columns_of(region, x))


def columns_of(region: Region, x: np.ndarray) -> dict[str, np.ndarray]:
    """As :func:`groups_of`, by name."""
    wish = region.wish
    columns = {}
    for k, name in enumerate(region.names):
        if name in PATTERNED.names:
            p = wish.space[name] if name in wish.space.names else PATTERNED[name]
            low, high = wish.ranges.get(name, (p.low, p.high))
            values = np.clip(10.0 ** x[:, k], low, high)
            values = np.rint(values) if p.whole else values
            columns[name] = np.full(len(x), wish.fixed[name]) if name in wish.fixed else values
    return columns
