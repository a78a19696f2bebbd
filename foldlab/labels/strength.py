"""What breaks: peak strains, stresses and tractions of a state against what its materials bear
(§4.2.3, §4.8.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from foldlab.errors import InputError

# Per limit: where its peak stands in the evidence, and what a reason calls it.
PEAKS = {
    "passive_strain": (("strain", "passive"), "the passive layer's strain"),
    "active_strain": (("strain", "active"), "the active layer's elastic strain"),
    "passive_stress": (("stress", "passive"), "the passive layer's stress over E_s"),
    "active_stress": (("stress", "active"), "the active layer's stress over E_s"),
    "opening": (("interface", "opening"), "the pull between the layers over E_s"),
    "shear": (("interface", "shear"), "the shear between the layers over E_s"),
}

# Stated error over what two meshes differ by, and the error where only one mesh is known.
MARGIN = 1.25
UNKNOWN_ERROR = 0.3


@dataclass(frozen=True)
class Strengths:
    """What the materials bear; None: not asked.

    Strains are principal elastic ones, tensile or compressive; stresses von Mises's, and pull and
    shear between the layers, over E_s. All are linearised through a layer's thickness and averaged
    over h_s along the sheet, see :mod:`solver.cases.unit.strain`. Raises :class:`InputError` for
    values that are not above 0.
    """

    passive_strain: float | None = None
    active_strain: float | None = None
    passive_stress: float | None = None
    active_stress: float | None = None
    opening: float | None = None
    shear: float | None = None

    def __post_init__(self):
        for name, value in vars(self).items():
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} = {value!r}; expected a finite number above 0")

    @property
    def given(self) -> dict[str, float]:
        """Those that were asked for."""
        return {name: value for name, value in vars(self).items() if value is not None}


def peaks(fine, coarse=None) -> dict[str, Any]:
    """Evidence of a state from its :class:`solver.cases.unit.strain.Strain`.

    ``strain`` of each layer is its larger principal value by size, ``tension`` and ``compression``
    stand beside it; ``stress`` and ``interface`` are over E_s. ``coarse``: of the same state on the
    mesh before, whose difference gives the relative ``peak_errors``; None where there is none.
    """
    rows, errors = _rows(fine), None
    if coarse is not None:
        other = _rows(coarse)
        errors = {
            name: {part: MARGIN * _apart(value, other[name][part]) for part, value in row.items()}
            for name, row in rows.items()
        }
    layers = {"passive": fine.passive, "active": fine.active}
    return {
        **rows,
        "tension": {name: layer.tension for name, layer in layers.items()},
        "compression": {name: layer.compression for name, layer in layers.items()},
        "peak_errors": errors,
        "averaged_over": fine.length,
    }


def _rows(peak) -> dict[str, dict[str, float]]:
    layers = {"passive": peak.passive, "active": peak.active}
    return {
        "strain": {name: layer.strain for name, layer in layers.items()},
        "stress": {name: layer.stress for name, layer in layers.items()},
        "interface": {"opening": peak.opening, "shear": peak.shear},
    }


def _apart(a: float, b: float) -> float:
    size = max(abs(a), abs(b))
    return abs(a - b) / size if size > 0 else 0.0


def breaking(evidence: Mapping[str, Any], strengths: Strengths) -> tuple[bool | None, list[str]]:
    """Whether a state breaks (None: within the error), and what does so, a phrase each.

    Where no second mesh tells the error, it counts as :data:`UNKNOWN_ERROR`.
    """
    sure, near = [], []
    for name, limit in strengths.given.items():
        (group, part), words = PEAKS[name]
        value = evidence[group][part]
        errors = evidence["peak_errors"]
        error = UNKNOWN_ERROR if errors is None else errors[group][part]
        phrase = f"{words} is {value:.3g}, {limit:.3g} borne"
        if value * (1 - error) > limit:
            sure.append(phrase)
        elif value * (1 + error) > limit:
            near.append(f"{phrase}, and its error is {100 * error:.2g} %")
    if sure:
        return True, sure
    return (None, near) if near else (False, [])
