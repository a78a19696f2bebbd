"""Materials: ψ, stress P = ∂ψ/∂F and tangent A = ∂²ψ/∂F∂F from F on arrays. They know no mesh.

Neo-Hookean (Eq. 2.25), St Venant–Kirchhoff (2.22), small strain (2.24) and fibre-reinforced (2.26).
A material is a compiled kernel over points and a table of properties per cell or point; whatever
has ``properties`` and ``kernel`` may stand in an ``Elastic`` term.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, isfinite, log

import numba
import numpy as np

from solver.given import all_of, number, numbers
from solver.physics.fields import Points, Quantity, Unphysical, resolve, unit, varies


def lame(E, nu):
    """λ and μ of Young's modulus and Poisson's ratio (Eq. 2.23)."""
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


class Material:
    """An elastic material given by E (stress) and ν; see :mod:`solver.physics.fields` for their
    forms.

    Raises ValueError unless E > 0 and −1 < ν < 0.5: for constants and arrays at once, for functions
    of e when they are evaluated. ``kernel(F, properties, order, psi, P, A)`` fills psi (c, q),
    P (c, q, 3, 3) from order 1 and A (c, q, 3, 3, 3, 3) at order 2 of F (c, q, 3, 3) and
    properties (1 | c, 1 | q, n); it returns False once a state is not admissible.
    """

    kernel = None

    def __init__(self, E: Quantity, nu: Quantity):
        self.E, self.nu = E, nu
        for name, value, check in (("E", E, _check_modulus), ("nu", nu, _check_ratio)):
            if not varies(value):
                check(numbers(name, value))

    @property
    def moving(self) -> bool:
        """Whether a property is a function of e."""
        return varies(self.E) or varies(self.nu)

    def properties(self, e: float, shape: tuple[int, int], points: Points | None = None):
        """The kernel's table at the load e, (1 | m, 1 | q, n): λ, μ and what else it needs."""
        E = resolve("E", self.E, e, shape, points)
        nu = resolve("nu", self.nu, e, shape, points)
        _check_modulus(E)
        _check_ratio(nu)
        return np.ascontiguousarray(np.stack(np.broadcast_arrays(*lame(E, nu)), axis=-1))

    def response(self, F: np.ndarray, e: float = 0.0, order: int = 2):
        """(psi, stress, tangent) of F (..., 3, 3) at the load e.

        Shapes (...), (..., 3, 3) and (..., 3, 3, 3, 3), tangent[i, J, k, L] = ∂P_iJ/∂F_kL; units of
        stress. Parts beyond ``order`` are None. psi is inf where a state is not admissible, and the
        rest is then NaN there. With properties per cell, F is (m, q, 3, 3).
        """
        F = np.asarray(F, dtype=float)
        lead = F.shape[:-2]
        flat = F.reshape(*(lead if len(lead) == 2 else (int(np.prod(lead)), 1)), 3, 3)
        c, q = flat.shape[:2]
        table = self.properties(e, (c, q))
        flat = np.ascontiguousarray(flat)
        psi, P = np.empty((c, q)), np.empty((c, q, 3, 3))
        A = np.empty((c, q, 3, 3, 3, 3) if order >= 2 else (1, 1, 3, 3, 3, 3))
        if not self.kernel(flat, table, order, psi, P, A):
            # A kernel stops at the first state that is not admissible: go one point at a time.
            table = np.broadcast_to(table, (c, q, table.shape[-1]))
            one = np.empty((1, 1)), np.empty((1, 1, 3, 3)), np.empty((1, 1, 3, 3, 3, 3))
            psi[:], P[:], A[:] = np.inf, np.nan, np.nan
            for i, j in np.ndindex(c, q):
                at = slice(i, i + 1), slice(j, j + 1)
                part = np.ascontiguousarray(flat[at]), np.ascontiguousarray(table[at])
                if self.kernel(*part, order, *one):
                    psi[at], P[at] = one[:2]
                    if order >= 2:
                        A[at] = one[2]
        return (
            psi.reshape(lead),
            P.reshape(*lead, 3, 3) if order >= 1 else None,
            A.reshape(*lead, 3, 3, 3, 3) if order >= 2 else None,
        )


def _check_modulus(E: np.ndarray) -> None:
    if not (E > 0).all():
        raise Unphysical(f"E = {np.min(E):g}; expected E > 0: give a positive Young's modulus")


def _check_ratio(nu: np.ndarray) -> None:
    bad = ~((nu > -1) & (nu < 0.5))
    if bad.any():
        raise Unphysical(
            f"nu = {nu[bad].flat[0]:g}; expected -1 < nu < 0.5: for a nearly incompressible "
            "material take 0.49 to 0.499"
        )


@numba.njit(cache=True, inline="always")
def _inverse(f, inv):
    """Inverse of a 3 × 3 matrix into ``inv``; returns the determinant."""
    c00 = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
    c10 = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
    c20 = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
    det = f[0, 0] * c00 + f[0, 1] * c10 + f[0, 2] * c20
    r = 1.0 / det if det != 0.0 else 0.0
    inv[0, 0] = c00 * r
    inv[1, 0] = c10 * r
    inv[2, 0] = c20 * r
    inv[0, 1] = (f[0, 2] * f[2, 1] - f[0, 1] * f[2, 2]) * r
    inv[1, 1] = (f[0, 0] * f[2, 2] - f[0, 2] * f[2, 0]) * r
    inv[2, 1] = (f[0, 1] * f[2, 0] - f[0, 0] * f[2, 1]) * r
    inv[0, 2] = (f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]) * r
    inv[1, 2] = (f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]) * r
    inv[2, 2] = (f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]) * r
    return det


@numba.njit(cache=True)
def neo_hookean(F, properties, order, psi, P, A):
    """ψ = μ/2 (I₁ − 3 − 2 ln J) + λ/2 (ln J)² (Eq. 2.25); False if J ≤ 0 anywhere."""
    inv = np.empty((3, 3))
    per_cell, per_point = properties.shape[0] > 1, properties.shape[1] > 1
    for c in range(F.shape[0]):
        for q in range(F.shape[1]):
            lam, mu = properties[c if per_cell else 0, q if per_point else 0, :2]
            f = F[c, q]
            J = _inverse(f, inv)
            if not (J > 0.0 and isfinite(J)):
                psi[c, q] = np.inf
                return False
            ln = log(J)
            I1 = 0.0
            for i in range(3):
                for j in range(3):
                    I1 += f[i, j] * f[i, j]
            psi[c, q] = 0.5 * mu * (I1 - 3.0 - 2.0 * ln) + 0.5 * lam * ln * ln
            if order < 1:
                continue
            s = mu - lam * ln
            for i in range(3):
                for j in range(3):
                    P[c, q, i, j] = mu * f[i, j] - s * inv[j, i]
            if order < 2:
                continue
            a = A[c, q]
            for i in range(3):
                for j in range(3):
                    for k in range(3):
                        for m in range(3):
                            a[i, j, k, m] = lam * inv[j, i] * inv[m, k] + s * inv[m, i] * inv[j, k]
                    a[i, j, i, j] += mu
    return True


@numba.njit(cache=True)
def st_venant_kirchhoff(F, properties, order, psi, P, A):
    """ψ = λ/2 (tr E)² + μ tr E², E = (FᵀF − I)/2 (Eq. 2.22)."""
    S = np.empty((3, 3))
    B = np.empty((3, 3))
    per_cell, per_point = properties.shape[0] > 1, properties.shape[1] > 1
    for c in range(F.shape[0]):
        for q in range(F.shape[1]):
            lam, mu = properties[c if per_cell else 0, q if per_point else 0, :2]
            f = F[c, q]
            trace, square = 0.0, 0.0
            for i in range(3):
                for j in range(3):
                    x, y = 0.0, 0.0
                    for k in range(3):
                        x += f[k, i] * f[k, j]
                        y += f[i, k] * f[j, k]
                    x = 0.5 * (x - (1.0 if i == j else 0.0))
                    S[i, j], B[i, j] = 2.0 * mu * x, y
                    square += x * x
                    if i == j:
                        trace += x
            psi[c, q] = 0.5 * lam * trace * trace + mu * square
            for i in range(3):
                S[i, i] += lam * trace
            if order < 1:
                continue
            for i in range(3):
                for j in range(3):
                    P[c, q, i, j] = f[i, 0] * S[0, j] + f[i, 1] * S[1, j] + f[i, 2] * S[2, j]
            if order < 2:
                continue
            a = A[c, q]
            for i in range(3):
                for j in range(3):
                    for k in range(3):
                        for m in range(3):
                            v = lam * f[i, j] * f[k, m] + mu * f[i, m] * f[k, j]
                            if i == k:
                                v += S[j, m]
                            if j == m:
                                v += mu * B[i, k]
                            a[i, j, k, m] = v
    return True


@numba.njit(cache=True)
def small_strain(F, properties, order, psi, P, A):
    """ψ = λ/2 (tr ε)² + μ tr ε², ε = sym(F − I) (Eq. 2.24); not invariant under rotation."""
    per_cell, per_point = properties.shape[0] > 1, properties.shape[1] > 1
    for c in range(F.shape[0]):
        for q in range(F.shape[1]):
            lam, mu = properties[c if per_cell else 0, q if per_point else 0, :2]
            f = F[c, q]
            trace, square = f[0, 0] + f[1, 1] + f[2, 2] - 3.0, 0.0
            for i in range(3):
                for j in range(3):
                    x = 0.5 * (f[i, j] + f[j, i]) - (1.0 if i == j else 0.0)
                    square += x * x
                    if order >= 1:
                        P[c, q, i, j] = 2.0 * mu * x + (lam * trace if i == j else 0.0)
            psi[c, q] = 0.5 * lam * trace * trace + mu * square
            if order < 2:
                continue
            a = A[c, q]
            a[:] = 0.0
            for i in range(3):
                for j in range(3):
                    a[i, i, j, j] += lam
                    a[i, j, i, j] += mu
                    a[i, j, j, i] += mu
    return True


@numba.njit(cache=True)
def fibre_reinforced(F, properties, order, psi, P, A):
    """Neo-Hookean and, per family, k₁/(2k₂) (exp(k₂(I₄ − 1)²) − 1) (Eq. 2.26)."""
    if not neo_hookean(F, properties, order, psi, P, A):
        return False
    per_cell, per_point = properties.shape[0] > 1, properties.shape[1] > 1
    Fa = np.empty(3)
    for c in range(F.shape[0]):
        for q in range(F.shape[1]):
            p = properties[c if per_cell else 0, q if per_point else 0]
            f = F[c, q]
            for n in range(2, p.shape[0], 6):
                k1, k2, slack = p[n], p[n + 1], p[n + 2]
                d = p[n + 3 : n + 6]
                I4 = 0.0
                for i in range(3):
                    Fa[i] = f[i, 0] * d[0] + f[i, 1] * d[1] + f[i, 2] * d[2]
                    I4 += Fa[i] * Fa[i]
                x = I4 - 1.0
                if slack > 0.0 and x < 0.0:
                    continue
                power = k2 * x * x
                if not power < 700.0:  # exp would overflow
                    psi[c, q] = np.inf
                    return False
                grown = exp(power)
                if power < 1e-8:
                    psi[c, q] += 0.5 * k1 * x * x * (1.0 + 0.5 * power)
                else:
                    psi[c, q] += 0.5 * k1 / k2 * (grown - 1.0)
                if order < 1:
                    continue
                first = 2.0 * k1 * x * grown
                for i in range(3):
                    for j in range(3):
                        P[c, q, i, j] += first * Fa[i] * d[j]
                if order < 2:
                    continue
                second = 4.0 * k1 * (1.0 + 2.0 * power) * grown
                for i in range(3):
                    for j in range(3):
                        for m in range(3):
                            A[c, q, i, j, i, m] += first * d[j] * d[m]
                            for k in range(3):
                                A[c, q, i, j, k, m] += second * Fa[i] * d[j] * Fa[k] * d[m]
    return True


class NeoHookean(Material):
    """Compressible neo-Hookean: ψ = μ/2 (I₁ − 3 − 2 ln J) + λ/2 (ln J)² (Eq. 2.25)."""

    kernel = staticmethod(neo_hookean)


class StVenantKirchhoff(Material):
    """ψ = λ/2 (tr E)² + μ tr E² with the Green–Lagrange strain (Eq. 2.22)."""

    kernel = staticmethod(st_venant_kirchhoff)


class SmallStrain(Material):
    """ψ = λ/2 (tr ε)² + μ tr ε² with the small strain (Eq. 2.24): for comparison only."""

    kernel = staticmethod(small_strain)


@dataclass(frozen=True)
class Fibre:
    """One family: direction (3,), (m, 3) or (m, q, 3), stiffness k₁ > 0 (stress), hardening k₂ ≥ 0.

    ``tension_only``: slack under compression; the stiffness then jumps at I₄ = 1.
    """

    direction: Quantity
    k1: Quantity
    k2: float
    tension_only: bool


class FibreReinforced(Material):
    """Neo-Hookean matrix with fibre families (Eq. 2.26).

    Each family along a adds k₁/(2k₂) (exp(k₂(I₄ − 1)²) − 1), I₄ = |F a|², which is k₁/2 (I₄ − 1)²
    at k₂ = 0. Raises ValueError for no family, k₁ ≤ 0 or k₂ < 0.
    """

    kernel = staticmethod(fibre_reinforced)

    def __init__(self, E: Quantity, nu: Quantity, fibres: Sequence[Fibre]):
        super().__init__(E, nu)
        self.fibres = all_of("fibres", Fibre, fibres)
        if not self.fibres:
            raise ValueError("no fibre family; give at least one Fibre or take NeoHookean")
        for f in self.fibres:
            if number("k2", f.k2) < 0:
                raise ValueError(f"k2 = {f.k2:g}; expected k2 >= 0 (0: no hardening)")
            if not varies(f.k1):
                _check_fibre(numbers("k1", f.k1))

    @property
    def moving(self) -> bool:
        """Whether a property is a function of e."""
        return super().moving or any(varies(f.k1) or varies(f.direction) for f in self.fibres)

    def properties(self, e: float, shape: tuple[int, int], points: Points | None = None):
        """λ, μ and per family k₁, k₂, slack, direction; (1 | m, 1 | q, 2 + 6 families)."""
        parts = [super().properties(e, shape, points)]
        for f in self.fibres:
            k1 = resolve("k1", f.k1, e, shape, points)[..., None]
            _check_fibre(k1)
            rest = np.array([[[f.k2, float(f.tension_only)]]])
            parts += [k1, rest]
            along = resolve("fibre direction", f.direction, e, shape, points, (3,))
            parts.append(unit("fibre direction", along))
        lead = np.broadcast_shapes(*(p.shape[:2] for p in parts))
        wide = [np.broadcast_to(p, (*lead, p.shape[-1])) for p in parts]
        return np.ascontiguousarray(np.concatenate(wide, axis=-1))


def _check_fibre(k1: np.ndarray) -> None:
    if not (k1 > 0).all():
        raise Unphysical(f"k1 = {np.min(k1):g}; expected k1 > 0: give a positive fibre stiffness")
