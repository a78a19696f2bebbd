"""Mooney–Rivlin rubber, compressible with the volume's part of the neo-Hookean (Eq. 2.25).

ψ = c₁₀ (I₁ − 3) + c₀₁ (I₂ − 3) − 2 (c₁₀ + 2 c₀₁) ln J + Λ/2 (ln J)². At small strain I₂ adds 4 c₀₁
to λ, so Λ = λ − 4 c₀₁ makes ν Poisson's ratio, with μ = 2 (c₁₀ + c₀₁) and λ = 2 μ ν/(1 − 2ν).
"""

from __future__ import annotations

import numba
import numpy as np

from solver.given import numbers
from solver.physics.fields import Points, Quantity, Unphysical, resolve, varies
from solver.physics.materials import Material, _check_ratio, _inverse, neo_hookean


@numba.njit(cache=True)
def mooney_rivlin(F, properties, order, psi, P, A):
    """Neo-Hookean of (Λ, 2 c₁₀) and c₀₁ (I₂ − 3 − 4 ln J); False if J ≤ 0 anywhere."""
    if not neo_hookean(F, properties, order, psi, P, A):
        return False
    C, B, inv = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    per_cell, per_point = properties.shape[0] > 1, properties.shape[1] > 1
    for c in range(F.shape[0]):
        for q in range(F.shape[1]):
            c2 = properties[c if per_cell else 0, q if per_point else 0, 2]
            f = F[c, q]
            J = _inverse(f, inv)
            I1, square = 0.0, 0.0
            for i in range(3):
                for j in range(3):
                    x, y = 0.0, 0.0
                    for k in range(3):
                        x += f[k, i] * f[k, j]
                        y += f[i, k] * f[j, k]
                    C[i, j], B[i, j] = x, y
                    square += x * x
                I1 += C[i, i]
            psi[c, q] += c2 * (0.5 * (I1 * I1 - square) - 3.0 - 4.0 * np.log(J))
            if order < 1:
                continue
            for i in range(3):
                for j in range(3):
                    x = f[i, 0] * C[0, j] + f[i, 1] * C[1, j] + f[i, 2] * C[2, j]
                    P[c, q, i, j] += c2 * (2.0 * (I1 * f[i, j] - x) - 4.0 * inv[j, i])
            if order < 2:
                continue
            a = A[c, q]
            for i in range(3):
                for j in range(3):
                    for k in range(3):
                        for m in range(3):
                            v = 4.0 * f[i, j] * f[k, m] - 2.0 * f[i, m] * f[k, j]
                            if i == k:
                                v -= 2.0 * C[m, j]
                            if j == m:
                                v -= 2.0 * B[i, k]
                            a[i, j, k, m] += c2 * (v + 4.0 * inv[j, k] * inv[m, i])
                    a[i, j, i, j] += 2.0 * c2 * I1
    return True


class MooneyRivlin(Material):
    """Mooney–Rivlin rubber of c₁₀, c₀₁ (stress) and ν; c₀₁ = 0 is the neo-Hookean material.

    The shear modulus is μ = 2 (c₁₀ + c₀₁), the bulk modulus 2 μ (1 + ν)/(3 (1 − 2ν)). Forms of
    the quantities as in :mod:`solver.physics.fields`. Raises ValueError for c₁₀ or c₀₁ < 0, both
    of them 0, ν ≥ 0.5, and Λ < 0 where c₀₁ > 0: such a ν lets the energy fall without bound as
    J → 0. Source: Rivlin, Phil. Trans. R. Soc. A 241 (1948) 379.
    """

    kernel = staticmethod(mooney_rivlin)

    def __init__(self, c10: Quantity, c01: Quantity, nu: Quantity):
        self.c10, self.c01, self.nu = c10, c01, nu
        if not self.moving:
            _moduli(*(numbers(n, v) for n, v in (("c10", c10), ("c01", c01), ("nu", nu))))

    @property
    def moving(self) -> bool:
        """Whether a property is a function of e."""
        return any(varies(v) for v in (self.c10, self.c01, self.nu))

    def properties(self, e: float, shape: tuple[int, int], points: Points | None = None):
        """The kernel's table at the load e, (1 | m, 1 | q, 3): Λ, 2 c₁₀, c₀₁."""
        names = ("c10", "c01", "nu")
        values = (resolve(n, getattr(self, n), e, shape, points) for n in names)
        return np.ascontiguousarray(np.stack(np.broadcast_arrays(*_moduli(*values)), axis=-1))


def _moduli(c10: np.ndarray, c01: np.ndarray, nu: np.ndarray):
    """Λ, 2 c₁₀ and c₀₁."""
    if not ((c10 >= 0).all() and (c01 >= 0).all() and (c10 + c01 > 0).all()):
        raise Unphysical(
            f"c10 = {np.min(c10):g}, c01 = {np.min(c01):g}; expected both >= 0 and not both 0: "
            "with a negative one the energy falls without bound"
        )
    _check_ratio(nu)
    least = c01 / (c10 + 3 * c01)
    if ((c01 > 0) & (nu < least)).any():
        raise Unphysical(
            f"nu = {np.min(nu):g}; expected nu >= c01/(c10 + 3 c01) = {np.max(least):g}: below "
            "it the energy falls without bound in compression; take a larger nu"
        )
    return 4 * (c10 + c01) * nu / (1 - 2 * nu) - 4 * c01, 2 * c10, c01
