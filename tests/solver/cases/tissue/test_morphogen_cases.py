"""A bar that grows where its morphogen is, in the reference and in the deformed configuration."""

import numpy as np
import pytest
from pytest import approx
from scipy.integrate import quad

from solver.cases.tissue.morphogen import WIDTH, Gradient

CASE = Gradient()


def test_lengths_by_an_integrator_are_those_of_closed_forms():
    # With c at rest in the reference bar the stretch is exp(α c t).
    want = quad(lambda x: np.exp(CASE.rate * 1.5 * CASE.steady(x)), 0, CASE.length, epsabs=1e-12)
    assert CASE.exact(1.5, deformed=False) == approx(want[0], rel=1e-9)
    assert CASE.exact(1.5, deformed=True) == approx(CASE.exact(1.5, deformed=True, n=16), rel=1e-6)
    # Short of diffusion and decay c is diluted as c = c₀/(1 + α c₀ t) = c₀ exp(−γ).
    slow = Gradient(diffusivity=1e-9, decay=1e-9)
    want = quad(lambda x: 1 + slow.rate * slow.steady(x), 0, slow.length)[0]
    assert slow.exact(1.0, deformed=True) == approx(want, rel=2e-3)


def test_a_bar_grows_to_its_length_where_the_gradient_rests():
    body = CASE.body(12, "hex27")
    path, scene, lengths = CASE.grown(body, 1.5, 30)
    want = CASE.exact(1.5, deformed=False)
    assert lengths == [approx(want, rel=5e-5)] and want > 3.4
    # It is free of stress, and so as wide as before.
    u = scene.displacement(path.last.x, 1.5)
    assert np.abs(u[:, 1:]).max() < 1e-2 * WIDTH


def test_a_gradient_that_the_growth_carries_along_makes_it_slower():
    body = CASE.body(12, "hex27")
    _, _, lengths = CASE.grown(body, 1.5, 30, sweeps=3)
    want, other = (CASE.exact(1.5, deformed=which) for which in (True, False))
    assert lengths[-1] == approx(want, rel=1e-3) and other - want > 0.05
    # Sweep for sweep it comes nearer to its limit.
    steps = np.abs(np.diff(lengths))
    assert steps[1] < 0.1 * steps[0] and steps[2] < 0.1 * steps[1]


def test_a_path_that_ends_early_is_said(monkeypatch):
    class Short:
        reached, reason = False, "too far"

    monkeypatch.setattr("solver.cases.tissue.morphogen.evolve", lambda *_, **__: Short())
    with pytest.raises(ArithmeticError, match="did not grow to its end: too far"):
        CASE.grown(CASE.body(2, "hex8"), 1.0, 2)
