"""A structure in metres: which of what was given goes where."""

from types import SimpleNamespace

import pytest
from crease_patterns import squares

from foldlab.errors import InputError
from foldlab.structure.made import structure_of

PHYSICAL = {
    "E_s": 2e9, "rho_s": 1400.0, "h_s": 1e-4, "E_i": 5e6, "rho_i": 1100.0, "h_i": 2e-4,
    "contraction": 0.12, "g_earth": 9.8,
}  # fmt: skip


def test_a_structure_has_the_layers_of_its_unit_which_has_the_longest_hinge_and_the_extent():
    asked, made = [], []
    pattern = squares([(0, 0), (1, 0), (2, 0)], length=0.1)

    class Drawn:
        def pattern(self, length, size):
            asked.append((length, size))
            return pattern

    def unit_of(given):
        made.append(given)
        return SimpleNamespace(physical=PHYSICAL)

    unit, structure = structure_of(Drawn(), {"l_i": 0.05, "h_s": 1e-4}, unit_of, 0.3)
    assert asked == [(0.05, 0.3)] and unit.physical is PHYSICAL
    # What was given wins over the pattern's longest hinge; length and width are its extent.
    assert made == [{"l_i": 0.05, "h_s": 1e-4, "l_s": pattern.extent, "b_s": pattern.extent}]
    sheet, (first, second) = structure.sheet, structure.layers
    assert (sheet.E, sheet.rho, sheet.h, sheet.contraction) == (2e9, 1400.0, 1e-4, 0.0)
    assert (first.E, first.rho, first.h, first.contraction) == (5e6, 1100.0, 2e-4, 0.12)
    assert second == first and structure.g == 9.8 and structure.pattern is pattern

    structure_of(Drawn(), {}, unit_of)
    assert asked[-1] == (None, None) and made[-1]["l_i"] == 0.1
    for name in ("l_s", "b_s", "b_i"):
        with pytest.raises(InputError, match=f"{name} is the pattern's own; say its largest"):
            structure_of(Drawn(), {name: 0.1}, unit_of)
    with pytest.raises(InputError, match="contraction = "):
        structure_of(
            Drawn(), {}, lambda given: SimpleNamespace(physical=PHYSICAL | {"contraction": 0.99})
        )
