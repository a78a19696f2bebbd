"""A unit in millimetres and materials: its groups, and what of it is known roughly only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from foldlab.design import FULL, PATTERNED, PHYSICAL, RATIOS, STANDARD_GRAVITY, STRIPS, to_groups
from foldlab.errors import InputError
from foldlab.materials import find_material

# What a group follows from, for messages.
NEEDS = {group: (quantity, scale) for quantity, (group, scale) in RATIOS.items()}
NEEDS |= {"contraction": ("contraction",), "stiffness_to_weight": ("E_s", "rho_s", "l_s", "h_s")}
OF_MATERIAL = {
    "passive": {"E_s": "E", "rho_s": "rho"},
    "active": {"E_i": "E", "rho_i": "rho", "contraction": "contraction"},
}
LOGARITHMIC = ("E_s", "E_i")


@dataclass(frozen=True)
class Sized:
    """``physical``: SI quantities by name (:data:`foldlab.design.PHYSICAL`); ``groups``: the full
    space's, of strips the patterned one's; ``ranges``: SI quantities that were not given, of which
    a material says low and high; ``materials``: their names by role; ``strain`` and ``price``: low
    and high strain that they bear and price per kg, by layer; ``stimulus``: what drives the active
    layer, as its material says."""

    physical: Mapping[str, float]
    groups: Mapping[str, float]
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    materials: Mapping[str, str] = field(default_factory=dict)
    strain: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    price: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    stimulus: str = ""

    def changed(self, **quantities: float) -> Sized:
        """With other SI quantities, all else the same; a hinge that was as wide as its panels stays
        so. Raises :class:`InputError` where no unit comes of it."""
        physical = dict(self.physical) | quantities
        if "b_s" in quantities and self.physical["b_i"] == self.physical["b_s"]:
            physical["b_i"] = physical["b_s"]
        pattern = {name: self.groups[name] for name in STRIPS if name in self.groups}
        return replace(self, physical=physical, groups=_groups(physical) | pattern)

    def cost(self, masses: Mapping[str, float]) -> tuple[float, float] | None:
        """Low and high price of the layers' material, of ``masses`` in kg; None unless each layer
        has a price per kg."""
        if set(self.price) != set(masses):
            return None
        low, high = (
            sum(float(mass) * self.price[layer][end] for layer, mass in masses.items())
            for end in (0, 1)
        )
        return low, high

    def drawn(self, n: int, seed: int = 0) -> pd.DataFrame:
        """Groups (n rows) of units whose materials lie anywhere in their ranges, moduli evenly on a
        logarithmic scale; a Latin hypercube."""
        from scipy.stats import qmc

        physical = pd.DataFrame([self.physical] * n)
        if self.ranges:
            units = qmc.LatinHypercube(len(self.ranges), rng=seed).random(n)
            for k, (name, (low, high)) in enumerate(self.ranges.items()):
                log = name in LOGARITHMIC
                a, b = (np.log(low), np.log(high)) if log else (low, high)
                values = a + units[:, k] * (b - a)
                physical[name] = np.exp(values) if log else values
        return to_groups(physical)[FULL.names]


def sized(
    given: Mapping[str, float],
    table: pd.DataFrame,
    passive: str | None = None,
    active: str | None = None,
) -> Sized:
    """A unit from SI quantities or groups and from materials of a table.

    What is given wins over a material, of whose ranges the middle is taken otherwise (geometric of
    moduli). A hinge is as wide as its panels unless b_i says otherwise, and weighs as on earth.
    ``strips`` and ``strip_share`` cut the active layer, together. Raises :class:`InputError` for
    names that are neither, for what is missing and for what contradicts.
    """
    if unknown := [n for n in given if n not in PHYSICAL and n not in PATTERNED.names]:
        raise InputError(
            f"no quantity {unknown[0]!r}; there are {', '.join(PHYSICAL)} (SI or with units) and "
            f"the groups {', '.join(PATTERNED.names)}"
        )
    for name, value in given.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} = {value:g}; expected a finite number above 0")
    physical = {name: float(value) for name, value in given.items() if name in PHYSICAL}
    groups = {name: float(value) for name, value in given.items() if name not in PHYSICAL}
    pattern = {name: groups.pop(name) for name in STRIPS if name in groups}
    if len(pattern) == 1:
        (absent,) = set(STRIPS) - set(pattern)
        raise InputError(
            f"strips need their number and how much of the hinge they cover; add --set {absent}=…"
        )
    ranges, names, strain, price = {}, {}, {}, {}
    for role, name in (("passive", passive), ("active", active)):
        if name is None:
            continue
        names[role] = find_material(table, name, role)
        row = table.loc[names[role]]
        for known, column in ((strain, "strain"), (price, "price")):
            if np.isfinite(row[f"{column}_low"]):
                known[role] = (float(row[f"{column}_low"]), float(row[f"{column}_high"]))
        for quantity, column in OF_MATERIAL[role].items():
            if quantity in physical or _group_of(quantity) in groups:
                continue
            low, high = float(row[f"{column}_low"]), float(row[f"{column}_high"])
            log = quantity in LOGARITHMIC
            physical[quantity] = (low * high) ** 0.5 if log else (low + high) / 2
            if low < high:
                ranges[quantity] = (low, high)
    physical.setdefault("g_earth", STANDARD_GRAVITY)
    # A group that is given is its quantity over its scale.
    for quantity, (group, scale) in RATIOS.items():
        if group not in groups or scale not in physical:
            continue
        implied = groups.pop(group) * physical[scale]
        if abs(physical.setdefault(quantity, implied) / implied - 1) > 1e-6:
            raise InputError(
                f"{group} and {quantity} contradict each other: {quantity} = "
                f"{physical[quantity]:.4g} {PHYSICAL[quantity]}, and by {group} {implied:.4g}; "
                "give one of them"
            )
    if "b_s" in physical:
        physical.setdefault("b_i", physical["b_s"])
    if groups:
        raise InputError(
            f"{', '.join(groups)}: a unit in SI units needs its scales beside its groups; give "
            f"{' and '.join(missing(physical)) or 'SI quantities instead'}"
        )
    stimulus = str(table.loc[names["active"], "stimulus"]) if "active" in names else ""
    everything = _groups(physical) | pattern
    return Sized(physical, everything, ranges, names, strain, price, stimulus)


def _group_of(quantity: str) -> str | None:
    return RATIOS[quantity][0] if quantity in RATIOS else None


def missing(physical: Mapping[str, float]) -> list[str]:
    """SI quantities that a unit needs and that are not there."""
    needed = ("l_s", "b_s", "h_s", "l_i", "h_i", "E_s", "rho_s", "E_i", "rho_i", "contraction")
    return [name for name in needed if name not in physical]


def _groups(physical: Mapping[str, float]) -> dict[str, float]:
    if absent := missing(physical):
        materials = [
            f"--{role} MATERIAL"
            for role, quantities in OF_MATERIAL.items()
            if any(name in absent for name in quantities)
        ]
        raise InputError(
            f"the unit lacks {', '.join(absent)}; add --set {absent[0]}=…"
            + (f" or {' and '.join(materials)}" if materials else "")
        )
    for part, whole in (("l_i", "l_s"), ("b_i", "b_s")):
        if physical[part] > physical[whole]:
            raise InputError(
                f"{part} = {physical[part]:.4g} m is more than {whole} = {physical[whole]:.4g} m; "
                "the hinge lies within its sheet"
            )
    groups = to_groups(pd.DataFrame([physical])).iloc[0]
    return {name: float(groups[name]) for name in FULL.names}
