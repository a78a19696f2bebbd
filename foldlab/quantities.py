"""Numbers with units, as people write them: 40mm, 2.5GPa, 20%, 90deg, 1.2 g/cm3."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import cache
from typing import Any

from foldlab.design import PATTERN, PATTERNED, PHYSICAL
from foldlab.errors import InputError

# What units to offer where those given make no sense.
EXAMPLES = {
    "Pa": "2.5GPa", "kg/m³": "1380kg/m3 or 1.4g/cm3", "m": "40mm", "m/s²": "9.81m/s2",
    "1": "0.2 or 20%", "rad": "90deg or 1.57", "kg": "5g",
}  # fmt: skip

KNOWN = (*PHYSICAL, *PATTERN, *(name for name in PATTERNED.names if name not in PHYSICAL))

# A number, and units with one-digit powers: nothing else reaches the parser of units, which is one
# of arithmetic.
_UNIT = r"[A-Za-zµμ°%]+(?:(?:\^|\*\*)?-?[1-9]|[²³])?"
_NUMBER = re.compile(
    r"\s*(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*"
    rf"(?P<unit>{_UNIT}(?:\s*[*/·]\s*{_UNIT})*)\s*"
)


def in_si(name: str, value: Any, unit: str | None = None) -> float:
    """The number that a quantity has in SI units.

    ``value``: a number, taken as it is, or text with or without a unit. ``unit``: the SI unit of
    what is asked ("m", "Pa", "rad", "1", …), that of :data:`foldlab.design.PHYSICAL` where None; a
    group has none. Raises :class:`InputError` for text that is no number with a unit, for a unit of
    another dimension and for numbers that are not finite.
    """
    if unit is None:
        unit = {**PATTERN, **PHYSICAL}.get(name, "1")
        if name not in KNOWN and isinstance(value, str) and _NUMBER.fullmatch(value):
            raise InputError(f"no quantity {name!r} that has a unit; there are {', '.join(KNOWN)}")
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(f"{name} = {value!r}; expected a number, such as {EXAMPLES[unit]}")
    number = _parsed(name, value, unit) if isinstance(value, str) else float(value)
    if not math.isfinite(number):
        raise InputError(f"{name} = {value}; expected a finite number, such as {EXAMPLES[unit]}")
    return number


def numbers(settings: Mapping[str, Any]) -> dict[str, float]:
    """Settings whose every value must be a number, in SI units or with a unit: :func:`in_si`."""
    return {name: in_si(name, value) for name, value in settings.items()}


def _parsed(name: str, text: str, unit: str) -> float:
    try:
        return float(text)
    except ValueError:
        pass
    import pint

    wrong = f"{name} = {text!r}: expected {_what(unit)}, such as {EXAMPLES[unit]}"
    parts = _NUMBER.fullmatch(text)
    if parts is None:
        raise InputError(wrong)
    try:
        given = _units().Unit(parts["unit"].strip())
    except pint.UndefinedUnitError as error:
        raise InputError(f"{wrong} ({error})") from None
    except (ValueError, TypeError):
        # What Pint's parser raises for powers and offsets that make no unit.
        raise InputError(wrong) from None
    try:
        factor = _units().Quantity(1.0, given).to("" if unit == "1" else _ascii(unit)).magnitude
    except (pint.DimensionalityError, pint.OffsetUnitCalculusError):
        raise InputError(f"{wrong}; {given} is none") from None
    return float(parts["number"]) * float(factor)


def _what(unit: str) -> str:
    return {"1": "a plain number or a percentage", "rad": "an angle"}.get(
        unit, f"a quantity in {unit}"
    )


def _ascii(text: str) -> str:
    """With powers as Pint reads them: g/cm3, kg/m³ and m/s2 are what people write."""
    text = text.replace("³", "3").replace("²", "2")
    return re.sub(r"(?<=[A-Za-zµμ])(-?[1-9])", r"**\1", text.replace("·", "*"))


@cache
def _units():
    from pint import UnitRegistry

    return UnitRegistry(preprocessors=[_ascii])
