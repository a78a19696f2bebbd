"""A structure in metres and materials, from its pattern."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from foldlab.errors import InputError

if TYPE_CHECKING:
    from foldlab.structure.files import Drawn
    from foldlab.unit.sized import Sized
    from solver.cases.structure.parts import Structure


def structure_of(
    drawn: Drawn,
    given: Mapping[str, float],
    unit_of: Callable[[Mapping[str, float]], Sized],
    size: float | None = None,
) -> tuple[Sized, Structure]:
    """A unit with the sheet, the layers and the longest hinge of a pattern, which knows what its
    materials bear; and the structure.

    ``given``: SI quantities but for the sheet's length and width, which the pattern has;
    ``unit_of`` makes a unit of them and of materials, as :func:`foldlab.unit.sized.sized` does;
    ``size``: see :meth:`foldlab.structure.files.Drawn.pattern`. Raises :class:`InputError`.
    """
    from solver.cases.structure.hinges import Layer
    from solver.cases.structure.parts import Structure

    for name in ("l_s", "b_s", "b_i"):
        if name in given:
            raise InputError(f"{name} is the pattern's own; say its largest extent: --set size=…")
    pattern = drawn.pattern(given.get("l_i"), size)
    longest = max(hinge.crease.length for hinge in pattern.hinges)
    extent = {"l_s": pattern.extent, "b_s": pattern.extent}
    unit = unit_of({"l_i": longest} | dict(given) | extent)
    p = unit.physical
    try:
        sheet = Layer(p["E_s"], p["rho_s"], p["h_s"])
        layer = Layer(p["E_i"], p["rho_i"], p["h_i"], p["contraction"])
        return unit, Structure.of(pattern, sheet, layer, g=p["g_earth"])
    except ValueError as error:
        raise InputError(str(error)) from None
