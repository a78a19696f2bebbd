"""What the page may ask about: a design by its groups, or a unit by materials and sizes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from foldlab.design import FULL, PHYSICAL, STANDARD_GRAVITY, DesignSpace, Parameter, to_physical
from foldlab.errors import InputError
from foldlab.materials import read_materials
from foldlab.quantities import numbers
from foldlab.unit.sized import Sized, sized

# Quantities that have a slider, in SI units, with the ends of it; others may be typed.
SIZES = DesignSpace(
    "sizes",
    (
        Parameter("l_s", "l_s", 5e-3, 0.2, "log", "length of the sheet"),
        Parameter("b_s", "b_s", 1e-3, 0.1, "log", "width of the sheet"),
        Parameter("h_s", "h_s", 1e-5, 2e-3, "log", "thickness of the sheet"),
        Parameter("l_i", "l_i", 1e-3, 0.1, "log", "length of the active layer, along the sheet"),
        Parameter("b_i", "b_i", 1e-3, 0.1, "log", "width of the hinge"),
        Parameter("h_i", "h_i", 1e-5, 5e-3, "log", "thickness of the active layer"),
        Parameter("contraction", "|g_i|", 0.02, 0.4, "linear", "contraction of the active layer"),
        Parameter("E_s", "E_s", 1e5, 3e11, "log", "Young's modulus of the sheet"),
        Parameter("rho_s", "rho_s", 500, 8000, "log", "density of the sheet"),
        Parameter("E_i", "E_i", 1e3, 1e10, "log", "Young's modulus of the active layer"),
        Parameter("rho_i", "rho_i", 500, 8000, "log", "density of the active layer"),
    ),
)
FARTHEST = 1e9  # or one over it: groups that no formula was made for
LONGEST = 60  # characters of a name or a number


@dataclass(frozen=True)
class Asked:
    """``groups``: the full space's; ``unit``: in SI units, None where no size is known;
    ``by_groups``: whether it was given by them."""

    groups: Mapping[str, float]
    unit: Sized | None = None
    by_groups: bool = False


@cache
def materials() -> pd.DataFrame:
    """The shipped table, by name."""
    return read_materials()


def asked(request: Any) -> Asked:
    """The design of a request: {"groups": {...}}, by whose "passive" material its sizes follow if
    there is one; or {"quantities": {...}, "passive": name, "active": name}, as numbers in SI units
    or as text with a unit.

    Raises :class:`InputError` for anything else, for groups out of their bounds and for what is no
    unit.
    """
    request = only(request, ("groups", "quantities", "passive", "active"), "a design")
    if ("groups" in request) == ("quantities" in request):
        raise InputError("a design is given by its groups or by its quantities; give one of them")
    names = {role: _name(role, request.get(role)) for role in ("passive", "active")}
    if "quantities" in request:
        allowed = [name for name in PHYSICAL if name != "g_earth"]
        given = _numbers(only(request["quantities"], allowed, "quantities"))
        with np.errstate(all="ignore"):
            unit = sized(given, materials(), **names)
        if unit.groups["hinge_length"] >= 1:
            raise InputError("the hinge is as long as its sheet, which leaves no panels to lift")
        for name, value in unit.groups.items():
            if not 1 / FARTHEST <= value <= FARTHEST:
                raise InputError(f"{name} = {value:.3g}; no unit is like that, look at its sizes")
        return Asked(FULL.validate_one(unit.groups, bounds=False), unit)
    given = _numbers(only(request["groups"], FULL.names, "groups"))
    groups = FULL.validate_one(given)
    if names["passive"] is None:
        return Asked(groups, by_groups=True)
    return Asked(groups, _made_of(groups, names["passive"]), by_groups=True)


def _made_of(groups: Mapping[str, float], passive: str) -> Sized:
    """The unit of these groups on earth whose sheet is of a material: its weight decides how long
    it is."""
    row = materials().loc[sized_name(passive, "passive")]
    scales = {"E_s": (row["E_low"] * row["E_high"]) ** 0.5}
    scales |= {"rho_s": (row["rho_low"] + row["rho_high"]) / 2, "g_earth": STANDARD_GRAVITY}
    physical = to_physical(pd.DataFrame([groups]), **scales).iloc[0]
    return sized({name: float(value) for name, value in physical.items()}, materials(), passive)


def sized_name(name: str, role: str) -> str:
    """A material's name in the table; :class:`InputError` where there is none of this role."""
    from foldlab.materials import find_material

    return find_material(materials(), name, role)


def only(value: Any, names: Collection[str], what: str) -> dict[str, Any]:
    """A JSON object with no other names than these; :class:`InputError` for what is none."""
    if not isinstance(value, dict):
        raise InputError(f"{what}: expected names with values, got {type(value).__name__}")
    if unknown := [name for name in value if name not in names]:
        raise InputError(f"{what}: no {unknown[0][:LONGEST]!r}; there are {', '.join(names)}")
    return value


def number(request: Mapping[str, Any], name: str, default: float, ends: tuple[float, float]):
    """A number of a request between two ends; :class:`InputError` for another value."""
    value = request.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} = {str(value)[:LONGEST]!r}; expected a number")
    if not ends[0] <= value <= ends[1]:
        told = f"{value:g}" if abs(value) < 1e300 else "too large"
        raise InputError(f"{name} = {told}; expected {ends[0]:g} to {ends[1]:g}")
    return value


def switch(request: Mapping[str, Any], name: str, default: bool) -> bool:
    """True or false; :class:`InputError` for another value."""
    value = request.get(name, default)
    if not isinstance(value, bool):
        raise InputError(f"{name} = {str(value)[:LONGEST]!r}; expected true or false")
    return value


def choice(request: Mapping[str, Any], name: str, names: Collection[str]) -> str:
    """One of some names; :class:`InputError` for another value."""
    value = request.get(name)
    if not isinstance(value, str) or value not in names:
        raise InputError(f"{name} = {str(value)[:LONGEST]!r}; expected one of {', '.join(names)}")
    return value


def _name(role: str, value: Any) -> str | None:
    if value is not None and not (isinstance(value, str) and 0 < len(value) <= LONGEST):
        raise InputError(f"{role}: expected the name of a material")
    return value


def _numbers(given: Mapping[str, Any]) -> dict[str, float]:
    for name, value in given.items():
        if len(str(value)) > LONGEST:
            raise InputError(f"{name}: expected a number, such as 40mm, of at most {LONGEST} signs")
    return numbers(given)
