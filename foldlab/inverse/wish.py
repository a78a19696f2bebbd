"""What a designer asks for, as limits on groups and physical quantities (§4.2.3).

Every limited quantity is a product of powers of the groups and of four scales (E_s, rho_s, l_s,
g_earth), so in logarithms every limit is linear and all limits together are a polytope, which
:class:`Region` samples. Mass and total thickness are sums of such products and come on top:

    mass = rho_s h_s [b_s (l_s − l_i) + b_i l_i] + rho_i h_i b_i l_i f,   thickness = h_s + h_i,

where f is the fraction of the hinge that strips cover, 1 of a solid layer.

Groups outside the searched space (in the reduced space: widths, hinge length, densities,
contraction) are *carried* where a limit touches them: they matter for mass, size and angle only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from foldlab.design import (
    PATTERNED,
    PHYSICAL,
    RATIOS,
    REDUCED,
    STANDARD_GRAVITY,
    STRIPS,
    DesignSpace,
    Parameter,
    groups_from_settings,
)
from foldlab.errors import InputError
from foldlab.materials import find_material

# Where a wish leaves a scale open: from tissue to diamond, foam to tungsten, cells to furniture.
SCALES = {"E_s": (1e2, 1e12), "rho_s": (1.0, 2.5e4), "l_s": (1e-6, 10.0)}
DEFAULT_MARGIN = 0.02
MASS_NEEDS = (
    "rho_s",
    "l_s",
    "slenderness",
    "h_ratio",
    "aspect",
    "hinge_length",
    "hinge_width",
    "rho_ratio",
)


@dataclass(frozen=True)
class Angle:
    """A wanted fold angle κ l_i = (κ l_s/g) (l_i/l_s) |g|, and how far off it may be; rad."""

    value: float
    tolerance: float

    def __post_init__(self):
        if not (0 < self.value < np.inf and 0 < self.tolerance < np.inf):
            raise InputError(
                f"fold angle {self.value:g} ± {self.tolerance:g} rad; both must be above 0"
            )


@dataclass(frozen=True)
class Wish:
    """A wanted behaviour and what limits the design.

    ``want``: 'foldable', 'flat' (does not fold) or an :class:`Angle`. ``fixed`` and ``ranges``:
    groups (``design.PATTERNED``) and physical quantities (SI, ``design.PHYSICAL``) by name.
    ``passive``, ``active``: names from the shipped table and that of ``materials`` (a CSV path, see
    :mod:`foldlab.materials`), whose ranges of E, rho and contraction hold; several names are
    alternatives. ``max_mass`` in kg; the
    sizes of the flat unit in m, the thickness including the active layer.

    ``margin``: half-width, as a fraction of each group's bounds on its own scale (max norm in the
    unit cube), of the box around a design in which it must still do what is wanted, by prediction;
    0.02 by default, which is 0.12 decades of E_i/E_s, and 0 for an angle or panels that touch.
    ``min_probability`` that the predicted label is the wanted one. Under weight, ``stands``: let
    go, it doesn't topple;
    ``strain_margin``: fraction by which its peak strains stay below what its materials surely bear;
    ``touching``: whether its panels touch each other at the end, None where either will do;
    ``least``: of what the unit shall have as little as it may, its mass, the cost of its materials
    by the table's prices, or its length l_s.
    Where strips are limited (``strips``, ``strip_share``) the active layer is cut in strips.

    Raises :class:`InputError` for unknown names, values out of bounds, quantities limited twice.
    """

    space: DesignSpace = REDUCED
    want: Literal["foldable", "flat"] | Angle = "foldable"
    fixed: Mapping[str, float] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    passive: tuple[str, ...] = ()
    active: tuple[str, ...] = ()
    materials: str | Path | None = None
    max_mass: float | None = None
    max_length: float | None = None
    max_width: float | None = None
    max_thickness: float | None = None
    margin: float | None = None
    min_probability: float = 0.5
    stands: bool = False
    strain_margin: float | None = None
    touching: bool | None = None
    least: Literal["mass", "cost", "size"] | None = None

    def __post_init__(self):
        if not (isinstance(self.want, Angle) or self.want in ("foldable", "flat")):
            raise InputError(f"want = {self.want!r}; expected 'foldable', 'flat' or an Angle")
        for name in (*self.fixed, *self.ranges):
            if name not in PATTERNED.names and name not in PHYSICAL:
                raise InputError(
                    f"no quantity {name!r}; groups: {', '.join(PATTERNED.names)}; "
                    f"physical: {', '.join(PHYSICAL)}"
                )
        twice = [name for name in self.ranges if name in self.fixed]
        if twice:
            raise InputError(f"{', '.join(twice)}: both fixed and in a range; give one of them")
        for name, value in self.fixed.items():
            _check_value(self.space, name, value)
        for name, limits in self.ranges.items():
            if len(limits) != 2:
                raise InputError(f"{name}: range {limits!r}; expected two numbers, low and high")
            _check_value(self.space, name, limits[0])
            _check_value(self.space, name, limits[1])
            if not limits[0] < limits[1]:
                raise InputError(
                    f"{name}: range {limits[0]:g} … {limits[1]:g}; give the lower end first"
                )
        for name in ("max_mass", "max_length", "max_width", "max_thickness"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"{name} = {value:g}; expected a number above 0 (kg, m)")
        if self.margin is None:
            narrow = isinstance(self.want, Angle) or self.touching
            object.__setattr__(self, "margin", 0.0 if narrow else DEFAULT_MARGIN)
        if not 0 <= self.margin < 0.5:
            raise InputError(
                f"margin = {self.margin:g}; expected a fraction of the bounds, 0 … below 0.5"
            )
        if self.strain_margin is not None and not 0 <= self.strain_margin < 1:
            raise InputError(
                f"strain_margin = {self.strain_margin:g}; expected a fraction from 0 to below 1"
            )
        if not 0.5 <= self.min_probability < 1:
            raise InputError(f"min_probability = {self.min_probability:g}; expected 0.5 … below 1")

        if self.least not in (None, "mass", "cost", "size"):
            raise InputError(f"least {self.least!r}; expected mass, cost or size")
        if self.touching and self.want != "foldable":
            aim = "stay flat never touch" if self.want == "flat" else "touch set the angle"
            raise InputError(f"panels that {aim}: wish for panels that touch with 'foldable' only")

    @property
    def patterned(self) -> bool:
        """Whether the active layer is cut in strips."""
        return any(name in {*self.fixed, *self.ranges, *self.space.names} for name in STRIPS)

    @property
    def pairs(self) -> list[tuple[str | None, str | None]]:
        """Every combination of a passive and an active material; None where none is named."""
        return [(p, a) for p in self.passive or (None,) for a in self.active or (None,)]


def _check_value(space: DesignSpace, name: str, value: float) -> None:
    if name in PATTERNED.names:
        groups_from_settings({name: value}, space if name in space.names else PATTERNED)
    elif not 0 < value < np.inf:
        raise InputError(f"{name} = {value:g}; expected a number above 0 in {PHYSICAL[name]}")


@dataclass(frozen=True)
class Limit:
    """One limit low ≤ Σ powers·log10(variable) ≤ high; ``text`` says it in the user's terms."""

    quantity: str
    powers: Mapping[str, float]
    low: float
    high: float
    text: str
    soft: bool = True  # False: a law or a bound of the design space, never the one to relax first


def powers_of(quantity: str) -> dict[str, float]:
    """A quantity as powers of groups and scales, such as h_i = h_ratio · slenderness · l_s."""
    if quantity in RATIOS:
        group, scale = RATIOS[quantity]
        return {group: 1.0, **powers_of(scale)}
    return {quantity: 1.0}


def limits_of(wish: Wish, pair: tuple[str | None, str | None], table=None) -> list[Limit]:
    """All linear limits of a wish with one pair of materials, with bounds and Γ's definition."""

    def limit(quantity, low, high, why=""):
        unit = PHYSICAL.get(quantity, "1")
        unit = "" if unit == "1" else f" {unit}"
        if low == high:
            text = f"{quantity} = {low:.4g}{unit}"
        elif low == 0:
            text = f"{quantity} ≤ {high:.4g}{unit}"
        else:
            text = f"{quantity} in {low:.4g} … {high:.4g}{unit}"
        low = np.log10(low) if low > 0 else -np.inf
        return Limit(quantity, powers_of(quantity), low, np.log10(high), text + why)

    limits = [limit(name, value, value) for name, value in wish.fixed.items()]
    limits += [limit(name, low, high) for name, (low, high) in wish.ranges.items()]
    for role, name, quantities in (
        ("passive", pair[0], {"E_s": "E", "rho_s": "rho"}),
        ("active", pair[1], {"E_i": "E", "rho_i": "rho", "contraction": "contraction"}),
    ):
        if name is None:
            continue
        name = find_material(table, name, role)
        for quantity, column in quantities.items():
            low, high = (float(table.loc[name, f"{column}_{end}"]) for end in ("low", "high"))
            limits.append(limit(quantity, low, high, f" ({name})"))
    for quantity, high in (("l_s", wish.max_length), ("b_s", wish.max_width)):
        if high is not None:
            limits.append(limit(quantity, 0, high))

    variables = set(wish.space.names)
    for one in limits:
        variables |= set(one.powers)
    if wish.max_thickness is not None:
        variables |= {*powers_of("h_i")}
    if wish.max_mass is not None:
        absent = [name for name in MASS_NEEDS if name not in variables]
        if absent:
            raise InputError(
                f"the mass also depends on {', '.join(absent)}: give each a value, a range or a "
                "material (b_s, l_i, b_i and rho_i in SI units serve for their ratios)"
            )
    if isinstance(wish.want, Angle):
        absent = [name for name in ("hinge_length", "contraction") if name not in variables]
        if absent:
            raise InputError(
                f"the fold angle also depends on {', '.join(absent)}: limit each "
                f"(--range {absent[0]}=0.1:0.3), or say materials and a size"
            )
    if "stiffness_to_weight" in wish.space.names and variables & {*SCALES, "g_earth"}:
        # Γ ties the scales together (Eq. of §4.2.2), so that all of them are at stake.
        variables |= {*SCALES, "g_earth"}
        if "g_earth" not in {one.quantity for one in limits}:
            earth = limit("g_earth", STANDARD_GRAVITY, STANDARD_GRAVITY)
            limits.append(replace(earth, soft=False))
        law = {"E_s": 1.0, "slenderness": 2.0, "rho_s": -1.0, "g_earth": -1.0, "l_s": -1.0}
        law["stiffness_to_weight"] = -1.0
        limits.append(Limit("Gamma", law, 0.0, 0.0, "the definition of Γ", soft=False))
    for name in PATTERNED.names + list(SCALES):
        if name in variables:
            p = _parameter(wish, name) if name in PATTERNED.names else None
            low, high = (p.low, p.high) if p else SCALES[name]
            bound = limit(name, low, high, " (the bounds)")
            limits.append(replace(bound, soft=False))
    return limits


def _parameter(wish: Wish, name: str) -> Parameter:
    return wish.space[name] if name in wish.space.names else PATTERNED[name]


def box_parameters(wish: Wish) -> list[Parameter]:
    """The groups along which margin and box extend: those that the wanted behaviour depends on."""
    extra = ("hinge_length", "contraction") if isinstance(wish.want, Angle) else ()
    return [
        *wish.space.parameters,
        *(PATTERNED[name] for name in extra if name not in wish.space.names),
    ]


def scales_of(wish: Wish) -> dict[str, bool]:
    """Whether a wish limits each of the scales l_s, E_s and rho_s; all of them fix the weight."""
    limited = {*wish.fixed, *wish.ranges}
    sizes = (wish.max_length, wish.max_width, wish.max_thickness, wish.max_mass)
    lengths = {quantity for quantity in RATIOS if PHYSICAL[quantity] == "m"} | {"l_s"}
    materials = bool(wish.passive or wish.active)
    return {
        "l_s": bool(limited & lengths) or any(size is not None for size in sizes),
        "E_s": bool(limited & {"E_s", "E_i"}) or materials,
        "rho_s": bool(limited & {"rho_s", "rho_i"}) or materials,
    }


def mass_of(quantities: pd.DataFrame) -> np.ndarray:
    """Mass of the unit in kg, shape (n,), from SI columns rho, l, b, h of both layers and, of
    strips, ``strip_share``."""
    return sum(masses_of(quantities).values())


def masses_of(quantities: pd.DataFrame) -> dict[str, np.ndarray]:
    """As :func:`mass_of`, of the passive and of the active layer."""
    q = quantities
    sheet = q["b_s"] * (q["l_s"] - q["l_i"]) + q["b_i"] * q["l_i"]
    covered = q["b_i"] * q["l_i"] * q.get("strip_share", 1.0)
    return {
        "passive": (q["rho_s"] * q["h_s"] * sheet).to_numpy(),
        "active": (q["rho_i"] * q["h_i"] * covered).to_numpy(),
    }


def quantities_of(logs: np.ndarray, names: list[str]) -> pd.DataFrame:
    """All groups and SI quantities that follow from log10 variables, shape (n, len(names))."""
    known = {name: logs[:, k] for k, name in enumerate(names)}
    out = dict(known)
    for quantity in RATIOS:
        powers = powers_of(quantity)
        if all(name in known for name in powers):
            out[quantity] = sum(power * known[name] for name, power in powers.items())
    return pd.DataFrame({name: 10.0**value for name, value in out.items()})
