"""Laws of hinges from labels: what the solver says of a weightless unit with the same hinge."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource

if TYPE_CHECKING:
    from solver.cases.structure.parts import Structure

PANELS = 3.0  # l_s of the unit, in lengths of its hinge


def from_labels(
    structure: Structure, *, accuracy: float = 0.02, timeout: float = 60.0
) -> tuple[Structure, list[dict[str, float]]]:
    """The structure with the solver's angle over contraction for each kind of hinge, and what each
    took: ``length`` and ``width`` (m), ``section`` and ``angle`` (rad, at full contraction, by the
    section alone and by the solver), ``error`` (a ratio) and ``core_seconds``.

    The unit has the hinge's layers, length and width between two panels as long as the hinge. Where
    it comes to no end the section's law stays, with the error None.
    """
    source = SolverSource(Conditions(effects="none"), Effort(accuracy, timeout, whole=True))
    known: dict = {}
    laws, told = [], []
    for law, layer, hinge in zip(
        structure.laws, structure.layers, structure.pattern.hinges, strict=True
    ):
        if layer is None:
            laws.append(law)
            continue
        key = id(law)
        if key not in known:
            known[key], row = _labelled(structure, law, layer, hinge, source)
            told.append(row)
        laws.append(known[key])
    return replace(structure, laws=tuple(laws)), told


def _labelled(structure: Structure, law, layer, hinge, source: SolverSource):
    sheet, length = structure.sheet, PANELS * hinge.crease.length
    design = {
        "E_ratio": layer.E / sheet.E,
        "rho_ratio": layer.rho / sheet.rho,
        "hinge_length": 1 / PANELS,
        "hinge_width": 1.0,
        "h_ratio": layer.h / sheet.h,
        "stiffness_to_weight": 1.0,
        "aspect": hinge.width / length,
        "slenderness": sheet.h / length,
        "contraction": layer.contraction,
    }
    run, label = source.follow(design)
    row = {
        "length": hinge.crease.length,
        "width": hinge.width,
        "section": float(law.angle[-1]),
        "angle": None,
        "error": None,
        "core_seconds": label.evidence["core_seconds"],
    }
    e = np.array([r["contraction"] for r in run.history]) / layer.contraction
    error = label.evidence.get("error_estimate")
    if not len(e) or e[-1] < 1 - 1e-9 or error is None:
        return law, row
    m1 = np.array([r["m1"] for r in run.history])
    at = np.linspace(0, 1, len(law.angle))
    angle = np.interp(at, e, m1 - _law_at(law, e)) + law.angle
    angle[0] = 0.0
    return law.with_angle(angle, float(error)), row | {
        "angle": float(m1[-1]),
        "error": float(error),
    }


def _law_at(law, e: np.ndarray) -> np.ndarray:
    """θ₀ of a law at the fractions e (k,) of the contraction, rad."""
    return np.interp(e, np.linspace(0, 1, len(law.angle)), law.angle)
