"""Timoshenko's bimetal strip (Eqs. 4.14, 4.15, 4.25, 4.26): the oracle and its label source.

With m = h_i/h_s and n = E_i/E_s,

    κ h_s / g = 6 (1 + m) / [3 (1 + m)² + (1 + m n) (m² + 1/(m n))],

small strain, no shear lag, no weight. What n and g mean depends on what holds the width:

``strip``
    Narrow strip, plane stress across the width: n = E_i/E_s. The dissertation's form.
``plane_strain``
    Wide strip held flat across the width, active layer contracting along y only:
    both moduli become E/(1 − ν²).
``plane_strain_isotropic``
    As before, but the layer also contracts across the width and is held there, so that the
    mismatch along y is (1 + ν_i) g.
``plate``
    Isotropic mismatch in a free plate at small deflection: both curvatures are equal (a spherical
    cap) and both moduli become E/(1 − ν). It holds before the plate bifurcates into a cylinder.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np

from foldlab.design import REDUCED, DesignSpace
from foldlab.errors import InputError
from foldlab.labels.foldability import Thresholds
from foldlab.labels.label import Label
from foldlab.shown import Shown

if TYPE_CHECKING:
    import pandas as pd

Assumption = Literal["strip", "plane_strain", "plane_strain_isotropic", "plate"]
ASSUMPTIONS = ("strip", "plane_strain", "plane_strain_isotropic", "plate")
FULL_TURN = 2 * np.pi  # Eq. 4.26: the sheet's own length closes a ring at unit strain


def normalised_curvature(
    E_ratio, h_ratio, *, assumption: Assumption = "strip", nu_i: float = 0.3, nu_s: float = 0.3
):
    """κ h_s / g (Eq. 4.14), nondimensional; arguments broadcast.

    The Poisson ratios matter only where the assumption uses them (see the module's text); with
    equal ratios the first, second and fourth assumption agree. Raises :class:`InputError` for an
    unknown assumption or a ratio outside (−1, 0.5).
    """
    for name, nu in (("nu_i", nu_i), ("nu_s", nu_s)):
        if not -1 < nu < 0.5:
            raise InputError(f"{name} = {nu:g}; a Poisson ratio lies between −1 and 0.5")
    m, n = np.asarray(h_ratio, dtype=float), np.asarray(E_ratio, dtype=float)
    strain = 1.0
    match assumption:
        case "strip":
            pass
        case "plane_strain":
            n = n * (1 - nu_s**2) / (1 - nu_i**2)
        case "plane_strain_isotropic":
            n = n * (1 - nu_s**2) / (1 - nu_i**2)
            strain = 1 + nu_i
        case "plate":
            n = n * (1 - nu_s) / (1 - nu_i)
        case _:
            raise InputError(f"no assumption {assumption!r}; there are: {', '.join(ASSUMPTIONS)}")
    mn = m * n
    return strain * 6 * (1 + m) / (3 * (1 + m) ** 2 + (1 + mn) * (m**2 + 1 / mn))


def normalised_angle(E_ratio, h_ratio, slenderness, **options):
    """κ l_s / g (Eq. 4.25): angle per unit strain over the whole length; nondimensional."""
    return normalised_curvature(E_ratio, h_ratio, **options) / np.asarray(slenderness, dtype=float)


def fold_angle(E_ratio, h_ratio, slenderness, hinge_length, contraction, **options):
    """Fold angle κ l_i of the hinge (Eq. 4.15), rad; grows linearly with the contraction."""
    per_length = normalised_angle(E_ratio, h_ratio, slenderness, **options)
    return per_length * np.asarray(hinge_length, dtype=float) * np.abs(contraction)


def folds(E_ratio, h_ratio, slenderness, **options):
    """Label of the reduced space (Eq. 4.26): κ l_s / g ≥ 2π."""
    return normalised_angle(E_ratio, h_ratio, slenderness, **options) >= FULL_TURN


class TimoshenkoSource(Shown):
    """Labels from the bimetal strip: no weight, small strain, no edges.

    In the reduced space Eq. 4.26 *defines* the label, so its error is 0. In the full space a design
    folds if the hinge alone turns by more than |g|π (F1 of Eq. 4.21); weight is not seen there and
    the error is unknown (None). In the patterned space strips count as a solid layer of E_i times
    the fraction of the width that they cover, as in a beam whose sections stay plane.
    """

    name = "timoshenko"
    version = "1"

    def __init__(self, space: DesignSpace = REDUCED, assumption: Assumption = "strip"):
        if assumption not in ASSUMPTIONS:
            raise InputError(f"no assumption {assumption!r}; there are: {', '.join(ASSUMPTIONS)}")
        self.space = space
        self.assumption = assumption
        if assumption != "strip":
            self.version = f"1-{assumption}"

    def label(self, design: Mapping[str, float]) -> Label:
        import pandas as pd

        return self.label_many(pd.DataFrame([dict(design)]))[0]

    def label_many(self, designs: pd.DataFrame) -> list[Label]:
        start = time.perf_counter()
        table = self.evaluate(designs)
        seconds = (time.perf_counter() - start) / len(table)
        groups = table[self.space.names].to_dict("records")
        evidence = table.drop(columns=[*self.space.names, "foldable"]).to_dict("records")
        exact = 0.0 if "contraction" not in table else None
        return [
            Label(
                design=design,
                foldable=bool(foldable),
                reason=_reason(foldable, values),
                evidence={**values, "error_estimate": exact, "seconds": seconds},
                source=self.name,
                version=self.version,
            )
            for design, foldable, values in zip(groups, table["foldable"], evidence, strict=True)
        ]

    def evaluate(self, designs: pd.DataFrame) -> pd.DataFrame:
        """Vectorised: groups with ``normalised_angle``, ``threshold``, ``margin``, ``foldable``.

        ``margin`` = ln(angle / threshold): 0.1 means that the angle clears the threshold by 10 %.
        """
        table = self.space.validate(designs)
        angle = normalised_angle(
            smeared(table), table["h_ratio"], table["slenderness"], assumption=self.assumption
        )
        threshold = FULL_TURN
        if "contraction" in table:
            table["fold_angle"] = angle * table["hinge_length"] * table["contraction"]
            angle, threshold = angle * table["hinge_length"], Thresholds().turning
        table["normalised_angle"] = angle
        table["threshold"] = threshold
        table["margin"] = np.log(angle / threshold)
        table["foldable"] = angle >= threshold
        return table


def smeared(design):
    """E_i/E_s of a solid layer as stiff as the strips of a design, or of a table of them; of a
    design without strips its own."""
    if "strip_share" not in design:
        return design["E_ratio"]
    return design["E_ratio"] * design["strip_share"]


def _reason(foldable: bool, values: Mapping[str, float]) -> str:
    verdict = "reaches" if foldable else "stays below"
    return (
        f"the angle per unit strain, {values['normalised_angle']:.4g}, {verdict} the threshold "
        f"{values['threshold']:.4g}"
    )


def bilayer_stiffness(h_ratio, E_ratio):
    """Bending stiffness of both layers about their neutral axis, in E_s h_s³ per width."""
    m, n = h_ratio, E_ratio
    return (1 + m**3 * n) / 12 + m * n * (1 + m) ** 2 / (4 * (1 + m * n))


def lift_off_stiffness(design: Mapping[str, float]) -> float:
    """Γ above which rigid panels on a short hinge would leave the ground.

    Θ₀ = κ l_i / 2 and β = w L_p² l_i / (4 B), w the weight of a panel per length and B the
    bilayer's bending stiffness: lift-off at β = Θ₀ (heavy strip, closed form). β is proportional
    to 1/Γ. Flexible panels lift earlier at their tips' cost, so this is an estimate.
    """
    groups = ("h_ratio", "slenderness", "hinge_length", "contraction")
    turning = fold_angle(smeared(design), *(design[name] for name in groups)) / 2
    return float(hinge_turning(design) / turning) if turning > 0 else np.inf


def hinge_turning(design: Mapping[str, float]) -> float:
    """β Γ: by what the weight of a level panel turns its half of the hinge, times Γ, in rad."""
    length = (1 - design["hinge_length"]) / 2
    bending = bilayer_stiffness(design["h_ratio"], smeared(design))
    # w = h_s · h_s²/Γ per width of panel; B = E_s h_s³ · bending per width of hinge.
    return length**2 * design["hinge_length"] / (4 * bending * design["hinge_width"])


def weight_turning(design: Mapping[str, float]) -> float:
    """What weight takes at most from m1, times Γ, in rad: both panels level, small deflections.

    Each half of the hinge turns by β, and the end of each panel, a cantilever of bending stiffness
    E_s h_s³/12 under its own weight, by w L_p³ / (6 B) = 2 L_p³/Γ.
    """
    length = (1 - design["hinge_length"]) / 2
    return 2 * (hinge_turning(design) + 2 * length**3)
