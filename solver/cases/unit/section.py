"""The section of a bilayer hinge in pure bending: what the active layer's contraction makes of it.

Lengths in h_s, moduli in E_s, per width. ζ is the height above the passive layer's underside, z(ζ)
that in the deformed state above its mid-plane. Fibres stretch by λ(ζ) = λ₀ − κ z, κ the turning per
reference length, positive where the active layer is on the inside; dz/dζ = λ_z; of the active
layer's stretch λ/(1 − c) is elastic. Across the width there is no strain, and across the thickness
the nominal stress P_z that holds a bent fibre, dP_z/dζ = −κ P. With the neo-Hookean ψ of physics.md
§3, J = λ λ_z,

    P_z = μ (λ_z − 1/λ_z) + Λ ln J / λ_z,    P = μ (λ − 1/λ) + Λ ln J / λ.

The natural state is that of no force and no moment, N = ∫P dζ = 0 and M = −∫P z dζ = 0; its
stiffness is ∂M/∂κ at N = 0. For small c it is Timoshenko's (physics.md §2), with both moduli over
1 − ν².
"""

from __future__ import annotations

import numba
import numpy as np

STEPS = 3  # of Runge and Kutta's fourth order through each layer


@numba.njit(cache=True)
def _fibre(stretch, across, mu, lam, thick):
    """λ_z, P and ∂P/∂λ at P_z = ``across``, from a guess of λ_z."""
    for _ in range(30):
        log = np.log(stretch * thick)
        rest = mu * (thick - 1 / thick) + lam * log / thick - across
        stiff = mu * (1 + thick**-2) + lam * (1 - log) / thick**2
        step = rest / stiff
        thick = max(thick - step, 0.1 * thick)
        if abs(step) < 1e-10:
            break
    P = mu * (stretch - 1 / stretch) + lam * log / stretch
    own = mu * (1 + stretch**-2) + lam * (1 - log) / stretch**2
    return thick, P, own - (lam / (stretch * thick)) ** 2 / stiff


@numba.njit(cache=True)
def _resultants(length, curvature, h_ratio, E_ratio, c, nu, out):
    """(N, M, K₀, K₁, K₂) of a section into ``out``, K_j = ∫ ∂P/∂λ zʲ dζ; False where crushed."""
    z = N = M = K0 = K1 = K2 = 0.0
    # z = 0 is the mid-plane: first the lower half of the passive layer alone, downwards.
    for part in range(3):
        E = E_ratio if part == 2 else 1.0
        mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
        grown = 1 - c if part == 2 else 1.0
        steps = 1 if part == 0 else STEPS
        d = (-0.5 if part == 0 else (1.0 if part == 1 else h_ratio)) / steps
        thick = 1.0
        for _ in range(steps):
            dz = dN = dM = d0 = d1 = d2 = 0.0
            rz = rN = 0.0
            for stage in range(4):
                ahead = 0.0 if stage == 0 else (d if stage == 3 else 0.5 * d)
                here = z + ahead * rz
                stretch = (length - curvature * here) / grown
                if not stretch > 1e-2:
                    return False
                across = -curvature * (N + ahead * rN) / grown
                thick, P, slope = _fibre(stretch, across, mu, lam, thick)
                slope /= grown
                weight = d / 6 * (1 if stage in (0, 3) else 2)
                rz, rN = thick, P
                dz += weight * thick
                dN += weight * P
                dM -= weight * P * here
                d0 += weight * slope
                d1 += weight * slope * here
                d2 += weight * slope * here * here
            z += dz
            N, M = N + dN, M + dM
            K0, K1, K2 = K0 + d0, K1 + d1, K2 + d2
        if part == 0:
            N = M = K0 = K1 = K2 = 0.0
    out[0], out[1], out[2], out[3], out[4] = N, M, K0, K1, K2
    return True


@numba.njit(cache=True)
def natural(h_ratio, E_ratio, contraction, nu, table):
    """Rows (κ h_s, B/(E_s h_s³), λ₀) of ``table`` (k, 3): the natural state at e = 0 … 1, evenly.

    False where it was not found.
    """
    length, curvature, out = 1.0, 0.0, np.zeros(5)
    for row in range(len(table)):
        c = contraction * row / (len(table) - 1)
        if row > 1:
            length = 2 * table[row - 1, 2] - table[row - 2, 2]
            curvature = 2 * table[row - 1, 0] - table[row - 2, 0]
        step, tries = 1.0, 0
        while step > 1e-7:
            tries += 1
            if tries > 100:
                return False
            if not _resultants(length, curvature, h_ratio, E_ratio, c, nu, out):
                length, curvature, step = 0.5 * (length + 1), 0.5 * curvature, 1.0
                continue
            N, M, K0, K1, K2 = out
            # dN = K₀ dλ₀ − K₁ dκ and dM = −K₁ dλ₀ + K₂ dκ, were thickness and P_z to stay.
            det = K0 * K2 - K1**2
            first, second = -(K2 * N + K1 * M) / det, -(K1 * N + K0 * M) / det
            length += first
            curvature += second
            step = abs(first) + abs(second) * (1 + h_ratio)
        table[row, 0], table[row, 2] = curvature, length
        table[row, 1] = out[4] - out[3] ** 2 / out[2]
    return True
