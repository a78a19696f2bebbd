"""Materials and growth at single points: energy → stress → tangent, Fg and its inverse."""

import numpy as np
import pytest
from proofs import slope
from pytest import approx
from scipy.optimize import brentq

from solver.physics.growth import AlongFibre, Apical, General, Isotropic, Orthotropic
from solver.physics.materials import (
    Fibre,
    FibreReinforced,
    NeoHookean,
    SmallStrain,
    StVenantKirchhoff,
    lame,
)
from solver.physics.rubber import MooneyRivlin

E, NU = 2.0, 0.3
FIBRES = [
    Fibre((1, 1, 0), k1=0.5, k2=2.0, tension_only=False),
    Fibre((0, 1, 2), k1=lambda e: 0.3 + e, k2=0.0, tension_only=True),
]
MATERIALS = {
    "neo-Hookean": NeoHookean(E, NU),
    "St Venant-Kirchhoff": StVenantKirchhoff(E, NU),
    "small strain": SmallStrain(E, NU),
    "fibres": FibreReinforced(E, NU, FIBRES),
    "Mooney-Rivlin": MooneyRivlin(lambda e: 0.2 + e, 0.3, 0.4),
}


@pytest.mark.parametrize("material", MATERIALS)
def test_material_derivatives(material):
    material = MATERIALS[material]
    rng = np.random.default_rng(6)
    F = np.eye(3) + rng.uniform(-0.3, 0.3, (7, 3, 3))
    psi, P, A = material.response(F, 0.5)
    assert psi.shape == (7,) and np.abs(P).min(axis=0).max() > 0
    D = rng.standard_normal(F.shape)
    rate = slope(lambda h: material.response(F + h * D, 0.5, order=0)[0], 1e-4)
    np.testing.assert_allclose((P * D).sum(axis=(1, 2)), rate, rtol=1e-8, atol=1e-9)
    rate = slope(lambda h: material.response(F + h * D, 0.5, order=1)[1], 1e-4)
    np.testing.assert_allclose(np.einsum("nijkl,nkl->nij", A, D), rate, rtol=1e-8, atol=1e-8)
    # Energy and stress are zero in the natural state.
    psi, P, _ = material.response(np.eye(3), 0.5)
    assert abs(psi) < 1e-15 and np.abs(P).max() < 1e-15


def test_all_materials_share_the_small_strain_moduli():
    lam, mu = lame(E, NU)
    I = np.eye(3)  # noqa: E741
    C = lam * np.einsum("ij,kl->ijkl", I, I) + mu * np.einsum("ik,jl->ijkl", I, I)
    C += mu * np.einsum("il,jk->ijkl", I, I)
    stress = np.einsum("ijkl,kl", C, np.diag([1, -NU, -NU]))
    np.testing.assert_allclose(stress, np.diag([E, 0, 0]), atol=1e-14)  # a bar in tension
    rubber = MooneyRivlin(0.7 * mu / 2, 0.3 * mu / 2, NU)
    for material in (*(MATERIALS[n] for n in list(MATERIALS)[:3]), rubber):
        np.testing.assert_allclose(material.response(I)[2], C, atol=1e-14)
    a = np.array([1, 1, 0]) / np.sqrt(2)
    one = FibreReinforced(E, NU, FIBRES[:1]).response(I)[2]
    # ψ = k₁/2 (I₄ − 1)² gives 4 k₁ a⊗a⊗a⊗a at F = I
    np.testing.assert_allclose(
        one - C, 4 * 0.5 * np.einsum("i,j,k,l->ijkl", a, a, a, a), atol=1e-14
    )


@pytest.mark.parametrize("nu", [-0.9, -0.3, 0.0])
def test_a_bar_of_an_auxetic_material_widens_under_tension(nu):
    for material in (NeoHookean(E, nu), StVenantKirchhoff(E, lambda e: nu), SmallStrain(E, [nu])):

        def side(b, material=material):
            return material.response(np.diag([1 + 1e-6, b, b]), 0.0)[1][1, 1]

        widened = brentq(side, 1 - 1e-5, 1 + 1e-5, xtol=1e-14) - 1
        assert widened == approx(-nu * 1e-6, abs=1e-10)
    for wrong in (-1.0, -1.2):
        with pytest.raises(ValueError, match=r"expected -1 < nu < 0\.5"):
            NeoHookean(E, wrong)


def test_slack_fibres_carry_no_compression():
    squeezed = np.diag([0.8, 1.0, 1.0])
    plain = NeoHookean(E, NU).response(squeezed)
    for slack in (True, False):
        fibre = Fibre((1, 0, 0), k1=1.0, k2=1.0, tension_only=slack)
        psi, P, _ = FibreReinforced(E, NU, [fibre]).response(squeezed)
        assert (psi == plain[0]) is np.bool_(slack)
        assert np.array_equal(P, plain[1]) == slack
    stretched = np.diag([1.2, 1.0, 1.0])
    x = 1.2**2 - 1
    psi, P, _ = FibreReinforced(E, NU, [fibre]).response(stretched)
    plain = NeoHookean(E, NU).response(stretched)
    assert psi - plain[0] == approx((np.exp(x**2) - 1) / 2)
    assert P[0, 0] - plain[1][0, 0] == approx(2 * x * np.exp(x**2) * 1.2)


def test_a_rubber_without_c01_is_neo_hookean():
    F = np.eye(3) + np.random.default_rng(2).uniform(-0.3, 0.3, (4, 3, 3))
    mu = lame(E, NU)[1]
    pairs = zip(
        MooneyRivlin(mu / 2, 0.0, NU).response(F), NeoHookean(E, NU).response(F), strict=True
    )
    for mine, other in pairs:
        np.testing.assert_allclose(mine, other, atol=1e-14)


@pytest.mark.parametrize("equal", [1, 2], ids=["uniaxial", "equibiaxial"])
def test_rubber_stretched_along_one_and_two_axes(equal):
    # Rivlin (1948): incompressible, P = 2 (1 − λ⁻³)(λ c₁₀ + c₀₁) along one axis and
    # 2 (λ − λ⁻⁵)(c₁₀ + c₀₁ λ²) along two; ν = 0.49999 is off by the order of 1 − 2ν.
    c10, c01 = 0.4, 0.1
    rubber = MooneyRivlin(c10, c01, 0.49999)
    for stretch in (0.6, 1.3, 2.5):

        def state(free, stretch=stretch):
            F = np.diag([stretch] * equal + [free] * (3 - equal))
            return rubber.response(F, order=1)[1]

        free = brentq(lambda b: state(b)[2, 2], 0.9 * stretch ** (-equal / (3 - equal)), 3.0)
        exact = [
            2 * (1 - stretch**-3) * (stretch * c10 + c01),
            2 * (stretch - stretch**-5) * (c10 + c01 * stretch**2),
        ][equal - 1]
        assert state(free)[0, 0] == approx(exact, rel=3e-4)


def test_states_that_are_not_admissible():
    F = np.stack([np.eye(3), np.diag([1, 1, -0.1]), np.diag([1, 1, 0.0]), 1.1 * np.eye(3)])
    for name in ("neo-Hookean", "fibres", "Mooney-Rivlin"):
        psi, P, A = MATERIALS[name].response(F)
        np.testing.assert_array_equal(np.isinf(psi), [False, True, True, False])
        assert np.isfinite(P[[0, 3]]).all() and np.isfinite(A[[0, 3]]).all()


def test_beside_a_state_that_is_not_admissible_each_cell_keeps_its_own_properties():
    material = NeoHookean(np.array([1.0, 5.0, 2.0]), np.array([0.3, 0.1, 0.45]))
    F = np.eye(3) + 0.05 * np.random.default_rng(2).standard_normal((3, 2, 3, 3))
    whole = material.response(F)
    bad = F.copy()
    bad[0, 1] = np.diag([1, 1, -0.1])
    there = np.ones((3, 2), bool)
    there[0, 1] = False
    for order in (1, 2):
        for given, alone in zip(material.response(bad, order=order), whole, strict=True):
            if given is not None:
                np.testing.assert_allclose(given[there], alone[there], rtol=1e-13)
                assert not np.isfinite(given[0, 1]).any()


# -- growth --------------------------------------------------------------------------------------


def test_growth_tensors():
    X = np.random.default_rng(7).uniform(size=(4, 2, 3))
    f = np.array([3.0, 4.0, 0.0])
    Q, _ = np.linalg.qr(X[0, 0][:, None] + np.eye(3))
    cases = [
        (Isotropic(lambda e: -0.4 * e), 0.8 * np.eye(3)),
        (Orthotropic((0, lambda e: -0.4 * e, 0.1)), np.diag([1, 0.8, 1.1])),
        (Orthotropic((0, 0.5, 0.1), Q), Q.T @ np.diag([1, 1.5, 1.1]) @ Q),
        (AlongFibre(-0.5, f), np.eye(3) - 0.5 * np.outer(f, f) / 25),
        (Apical(lambda e: -e, lambda X: X[..., 0]), np.eye(3) / (1 + 0.5 * X[..., :1, None])),
        (Isotropic(lambda e, X: e * X[..., 2]), np.eye(3) * (1 + 0.5 * X[..., 2:, None])),
        (General(np.diag([1, 2.0, 3])), np.diag([1, 2.0, 3])),
    ]
    for case, Fg in cases:
        inverse, J = case.evaluate(0.5, (4, 2), lambda: X)
        full = np.broadcast_to(Fg, (4, 2, 3, 3))
        np.testing.assert_allclose(
            np.broadcast_to(inverse, full.shape) @ full,
            np.broadcast_to(np.eye(3), full.shape),
            atol=1e-14,
        )
        np.testing.assert_allclose(np.broadcast_to(J, (4, 2)), np.linalg.det(full), rtol=1e-14)
        case.cells = np.array([True, False, False, True])
        inverse, J = case.evaluate(0.5, (4, 2), lambda: X)
        assert (inverse[1:3] == np.eye(3)).all() and (J[1:3] == 1).all() and J[0, 0] != 1
    # A frame may turn from cell to cell.
    frames = np.stack([np.eye(3), Q, Q.T, np.eye(3)])
    inverse, _ = Orthotropic((1.0, 0, 0), frames).evaluate(0.0, (4, 2))
    for e1, inv in zip(frames[:, 0], inverse[:, 0], strict=True):
        np.testing.assert_allclose(inv @ e1, e1 / 2, atol=1e-15)
