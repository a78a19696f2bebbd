"""Timoshenko's bimetal strip as an oracle (Eqs. 4.14, 4.15, 4.25, 4.26).

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

from typing import Literal

import numpy as np

from foldlab.errors import InputError

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
