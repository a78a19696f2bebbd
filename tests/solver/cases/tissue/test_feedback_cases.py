"""A clamped bar and a ring whose growth answers to stress, beside solutions of their own."""

import numpy as np
import pytest
from pytest import approx

from solver.cases.tissue.feedback import INNER, OUTER, Bar, Radial, Ring, cylindrical, uniaxial
from solver.output import cell_fields
from solver.physics.loads import Traction
from solver.physics.supports import Fixed
from solver.viscous.balance import balance
from solver.viscous.evolution import TimeSteps, evolve, start, stepped
from solver.viscous.feedback import Growing
from solver.viscous.rheology import SLS, Maxwell


def growth(path):
    """γ of the first point at all times."""
    return np.array([s.level.memories[0].growth[0, 0, 0] for s in path.states])


BARS = [
    Bar(),
    Bar(along=False, target=0.03),
    Bar(measure="eshelby"),
    Bar(along=False, target=0.03, measure="eshelby"),
    Bar(stretch=0.9, target=-0.02),
]


@pytest.mark.parametrize("bar", BARS, ids=str)
def test_a_clamped_bar_grows_as_the_ode_says_until_its_stress_is_the_target(bar):
    scene = bar.scene(1e-3)
    path = evolve(scene, start(scene), TimeSteps(1e-10, 1e-3, tolerance=1e-6), until=20.0)
    assert path.reached, path.reason
    exact = bar.exact(path.times)
    assert np.abs(growth(path) - exact).max() < 1e-3 * np.abs(exact).max()
    assert np.abs(exact).max() > 0.02
    # At rest: baseline + rate (s − target) = 0, though most of the stress was elsewhere.
    assert bar.stress(growth(path)[-1]) == approx(bar.rest, rel=1e-3)
    assert abs(bar.stress(0.0) / bar.rest - 1) > 0.2
    # That is also the stress that is written out of the bar: σ11 det Fe = M11 of a bar.
    now = stepped(scene, path.states[-2], path.last)
    fields = cell_fields(scene.body, scene.displacement(path.last.x, 0), now.terms, path.last.e)
    Je = np.linalg.det(fields["F"]) / np.linalg.det(fields["growth"])
    mandel = uniaxial(bar.stretch * np.exp(-growth(path)[-1]))[0]
    np.testing.assert_allclose(Je * fields["cauchy"][..., 0, 0], mandel, rtol=1e-6)


@pytest.mark.parametrize(("order", "ratio"), [(1, 2.0), (2, 4.0)])
def test_the_order_in_time(order, ratio):
    bar = Bar(along=False, target=0.03)
    exact, errors = bar.exact(np.array([2.0]))[0], []
    for n in (40, 80):
        scene = bar.scene(2 / n)
        path = evolve(scene, start(scene), TimeSteps(1e-12, 2 / n, order=order), until=2.0)
        errors.append(growth(path)[-1] - exact)
    assert errors[0] / errors[1] == approx(ratio, rel=0.05)


def test_the_error_follows_the_tolerance():
    bar, counts, errors = Bar(), [], []
    for tolerance in (1e-4, 1e-5, 1e-6):
        scene = bar.scene(1e-3)
        path = evolve(scene, start(scene), TimeSteps(1e-11, 1e-3, tolerance=tolerance), until=4.0)
        errors.append(np.abs(growth(path) - bar.exact(path.times)).max())
        counts.append(len(path.states))
    assert counts[0] < counts[1] < counts[2] < 200
    assert errors[0] > 2 * errors[1] > 4 * errors[2] and errors[2] < 3e-5


def compare(ring, cells, tolerance, until=2.0):
    """Largest errors of γ and of σ over their largest values."""
    scene = ring.scene(cells, 1e-2)
    stepper = TimeSteps(1e-10, 1e-2, tolerance=tolerance)
    path = evolve(scene, start(scene), stepper, until=until, breaks=(0.2,))
    assert path.reached, path.reason
    radial, X = Radial(ring), scene.body.points()
    R, want = np.hypot(X[..., 0], X[..., 1]), radial.growth(until)
    now = stepped(scene, path.states[-2], path.last)
    u = scene.displacement(path.last.x, path.last.e)
    sigma = cell_fields(scene.body, u, now.terms, path.last.e)["cauchy"]
    axes = cylindrical(0, X)
    stress = np.einsum("mqai,mqij,mqaj->mqa", axes, sigma, axes)
    off = []
    for found, wanted in (
        (path.last.level.memories[0].growth, want),
        (stress, radial.cauchy(until, want)),
    ):
        off.append(np.abs(found - radial.at(R, wanted)).max() / np.abs(wanted).max())
    return off, radial.cauchy(until, want)


def test_residual_stress_of_a_free_ring():
    (growth, stress), sigma = compare(Ring(), 16, 2e-6)
    assert growth < 1e-3 and stress < 1e-3
    # Nothing pulls at it, and it is under stress: in hoops of both signs.
    assert sigma[1].min() < -0.01 and sigma[1].max() > 0.01
    assert np.abs(sigma[0, [0, -1]]).max() < 1e-10


def test_a_ring_on_a_mandrel_comes_to_its_target_stress():
    ring = Ring(rates=(0.0, 1.5, 0.0), baseline=0.0, widened=0.1)
    (growth, stress), _ = compare(ring, 12, 3e-6)
    assert growth < 1e-3 and stress < 1e-3
    radial = Radial(ring)
    late = radial.growth(12.0)
    M, _ = radial.mandel(radial.radius(12.0, late), late)
    np.testing.assert_allclose(M[1], 0.05, rtol=1e-3)
    scene = ring.scene(2, 1e-2)
    path = evolve(
        scene, start(scene), TimeSteps(1e-9, 1e-2, tolerance=1e-4), until=12.0, breaks=(0.2,)
    )
    term, memory = stepped(scene, path.states[-2], path.last).terms[0], path.last.level.memories[0]
    stored, driving = term.ledger(scene.displacement(path.last.x, 12.0), memory, 12.0)
    J = np.exp(memory.growth.sum(-1))
    np.testing.assert_allclose((driving[..., 1] + stored) / J, 0.05, rtol=1e-3)


def test_the_radial_solution_is_that_of_lame_and_converges():
    ring = Ring(rates=(0.0, 0.0, 0.0), baseline=0.0, widened=1e-4)
    radial = Radial(ring)
    r = radial.radius(1.0, np.zeros((3, 17)))
    # Plane strain: u = A R + B/R, σ_r = 2(λ + μ) A − 2 μ B/R² = 0 outside, μ/(λ + μ) = 1 − 2ν.
    ratio = OUTER**2 / (1 - 2 * 0.3)
    a = 1e-4 / (INNER + ratio / INNER)
    np.testing.assert_allclose(r - radial.R, a * (radial.R + ratio / radial.R), rtol=2e-4)
    fine, coarse = Radial(Ring(), 16), Radial(Ring(), 10)
    np.testing.assert_allclose(fine.at(coarse.R, fine.growth(1.0)), coarse.growth(1.0).T, atol=1e-8)


def stretched(rheology, law):
    """A bar pulled by a dead load that rises."""
    bar = Bar(stretch=1.0)
    scene = bar.scene(1e-2)
    body = scene.body
    fixed = [Fixed(body.nodes[:, k] < 1e-9, np.eye(3)[k]) for k in range(3)]
    pull = Traction(body, body.surface("x+"), lambda e: np.array([0.2 * e, 0, 0]))
    return type(scene)(body, [Growing(body, rheology, law, dt=1e-2), pull], fixed=fixed)


@pytest.mark.parametrize("rheology", [None, Maxwell(1.0, 0.3, 2.0), SLS(1.0, 1.0, 0.3, 1.0)])
def test_energy_goes_into_springs_dashpots_and_growth(rheology):
    law = Bar(along=False, target=0.02, baseline=0.1).law
    if rheology is None:
        scene = Bar(along=False, target=0.03, baseline=0.1).scene(1e-3)
    else:
        scene = stretched(rheology, law)
    path = evolve(scene, start(scene), TimeSteps(1e-11, 1e-3, tolerance=1e-6), until=1.0)
    books = balance(scene, path.states)
    assert books.gap < 1e-4
    assert abs(books.grown[-1]) > 0.05 * books.stored.max()
    assert (rheology is None) == (books.work[-1] == approx(0, abs=1e-12))
    if rheology is None:
        assert not books.dissipated.any()
    else:
        assert books.dissipated[-1] > 1e-2 * books.work[-1] > 0
        assert books.dissipated[-1] == approx(
            path.last.dissipated - path.states[1].dissipated, rel=1e-9
        )
    np.testing.assert_array_equal(books.t, path.times[1:])


def test_the_balance_closes_with_the_square_of_the_step():
    gaps = []
    for n in (40, 80):
        scene = Bar(along=False, target=0.03).scene(2 / n)
        path = evolve(scene, start(scene), TimeSteps(1e-12, 2 / n), until=2.0)
        gaps.append(balance(scene, path.states).gap)
    assert gaps[0] / gaps[1] == approx(4, rel=0.1)


def test_a_balance_is_of_three_states_and_a_term_that_grows():
    scene = Bar().scene(0.02)
    path = evolve(scene, start(scene), TimeSteps(1e-9, 0.02), until=0.04)
    assert len(balance(scene, path.states).t) == 2
    with pytest.raises(ValueError, match="2 states; expected three"):
        balance(scene, path.states[:2])
    with pytest.raises(ValueError, match="do not follow each other"):
        balance(scene, path.states[::2] + path.states[1:])
    from solver.cases.tissue import creep

    other = creep.scene(creep.MODELS["Maxwell"].rheology(), 0.1, 0.1)
    with pytest.raises(ValueError, match="no Growing term"):
        balance(other, path.states)
