"""Derivatives of grown equilibria by the pattern, against differences of states solved anew."""

from dataclasses import replace

import numpy as np
import pytest
from grown_blocks import Slope, clamped
from proofs import BODIES, slope, state
from pytest import approx

from solver.equilibrium.newton import newton
from solver.equilibrium.scene import Scene
from solver.fitting import elastic
from solver.fitting.elastic import Equilibria, States, Unreached, increasing
from solver.fitting.field import contracting, gathered, spread
from solver.physics.elastic import Elastic
from solver.physics.growth import AlongFibre, Apical, General, Isotropic
from solver.physics.materials import Fibre, FibreReinforced, NeoHookean, StVenantKirchhoff
from solver.physics.supports import Fixed

P = np.array([0.4, 0.2, 0.1])
MATERIALS = {
    "neo-Hookean": NeoHookean(1.0, 0.3),
    "St Venant": StVenantKirchhoff(np.linspace(1, 3, 4), 0.2),
    "fibres": FibreReinforced(1.0, 0.3, [Fibre((1, 0.4, 0.2), 0.7, 0.5, False)]),
}


@pytest.fixture(scope="module")
def block():
    return clamped()


@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("element", ["hex8", "tet10"])
def test_stress_changes_with_any_growth_as_by_differences(material, element):
    body, rng = BODIES[element], np.random.default_rng(2)
    law = MATERIALS[material]
    if material == "St Venant":
        law = StVenantKirchhoff(np.linspace(1, 3, len(body.cells)), 0.2)
    Fg = np.eye(3) + 0.2 * rng.uniform(-1, 1, (*body.weights.shape, 3, 3))
    dFg = rng.uniform(-1, 1, Fg.shape)
    u, cells = state(body), np.arange(len(body.cells)) > 0
    term = Elastic(body, law, General(Fg), cells=cells)
    found = term.by_growth(u, 0.0, dFg @ np.linalg.inv(Fg))
    assert not found[0].any() and found[1:].any(axis=(2, 3)).all()
    force = spread(body, found, np.ones((*body.weights.shape, 1)))[..., 0]

    def moved(h):
        return term.with_growth(General(Fg + h * dFg)).evaluate(u, 0.0, 1).force

    assert force == approx(slope(moved, 1e-3), rel=1e-7, abs=1e-9 * np.abs(force).max())


def test_a_term_that_does_not_grow_has_no_such_change():
    body = BODIES["hex8"]
    with pytest.raises(ValueError, match="'elastic' does not grow"):
        Elastic(body, MATERIALS["neo-Hookean"]).by_growth(state(body), 0.0, np.eye(3))
    inverted = Elastic(body, MATERIALS["neo-Hookean"], Isotropic(0.1))
    assert inverted.by_growth(-2 * body.nodes, 0.0, np.eye(3)) is None


def test_apical_growth_changes_with_beta_where_it_grows():
    X, shape = BODIES["hex8"].points, BODIES["hex8"].weights.shape
    cells = np.arange(shape[0]) % 2 == 0
    beta = np.random.default_rng(0).uniform(0.1, 0.9, shape)
    rate = Apical(-0.7, beta, cells=cells).by_beta(1.0, shape, X)

    def tensor(h):
        return np.linalg.inv(Apical(-0.7, beta + h, cells=cells).evaluate(1.0, shape, X)[0])

    assert rate @ tensor(0.0) == approx(slope(tensor, 1e-3), rel=1e-8, abs=1e-12)
    assert not rate[~cells].any() and (rate[cells][..., 0, 0] < 0).all()


def differences(equilibria, p, loads, near, h=1e-3):
    columns = []
    for d in h * np.eye(len(p)):
        ends = [equilibria.solve(p + k * d, loads, near) for k in (-2, -1, 1, 2)]
        u = [np.stack([state.u for state in end.at]) for end in ends]
        columns.append((8 * (u[2] - u[1]) - (u[3] - u[0])) / (12 * h))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("material", MATERIALS)
def test_rates_are_those_of_states_that_were_solved_anew(material):
    equilibria = Equilibria(clamped(material=MATERIALS[material]), Slope(True))
    loads = [0.5, 1.0]
    found = equilibria.solve(P, loads)
    assert [s.e for s in found.at] == loads
    # Growth is finite there.
    assert np.abs(found.at[1].u).max() > 0.05
    expected = differences(equilibria, P, loads, found)
    for state_, wanted in zip(found.at, expected, strict=True):
        assert np.abs(state_.rates - wanted).max() < 1e-7 * np.abs(wanted).max()


def test_the_adjoint_is_the_direct_derivative_and_that_of_a_free_field():
    scene, field = clamped("tet10"), Slope(True)
    equilibria = Equilibria(scene, field)
    (at,) = equilibria.solve(P, [1.0]).at
    weights = np.random.default_rng(5).standard_normal(at.u.shape)
    direct = np.einsum("nik,ni->k", at.rates, weights)
    assert at.gradient(weights) == approx(direct, rel=1e-9)
    # Of β at one point.
    beta = field.values(P, equilibria.points)

    class Free(Slope):
        def values(self, p, X):
            return beta + self.slopes(p, X)[..., 0] * (p[0] - P[0])

        def slopes(self, p, X):
            one = np.zeros((*beta.shape, 3))
            one[1, 2, 0] = 1.0
            return one

    wanted = differences(Equilibria(scene, Free(True)), P, [1.0], None)[0]
    mine = at.by_beta(weights)[1, 2]
    assert mine == approx(np.einsum("ni,ni", wanted[..., 0], weights), rel=1e-6)


def test_forces_of_a_changed_pattern_work_as_gathered():
    body, rng = BODIES["hex20"], np.random.default_rng(7)
    stress = rng.standard_normal((*body.weights.shape, 3, 3))
    slopes = rng.standard_normal((*body.weights.shape, 2))
    v = rng.standard_normal(body.nodes.shape)
    forward = np.einsum("nik,ni->k", spread(body, stress, slopes), v)
    assert np.einsum("mq,mqk->k", gathered(body, stress, v), slopes) == approx(forward)


def test_states_nearby_and_the_path_from_rest_are_the_same(block):
    equilibria = Equilibria(block, Slope())
    near = equilibria.solve(P[:2], [0.4, 1.0])
    p = P[:2] + np.array([0.05, -0.03])
    short, long = equilibria.solve(p, [0.4, 1.0], near), equilibria.solve(p, [0.4, 1.0])
    for a, b in zip(short.at, long.at, strict=True):
        assert np.abs(a.u - b.u).max() < 1e-9
    # Others than were asked for don't serve.
    assert isinstance(equilibria.solve(p, [1.0], near), States)


def test_the_guess_follows_the_derivatives(block, monkeypatch):
    equilibria = Equilibria(block, Slope())
    near = equilibria.solve(P[:2], [1.0])
    solve, guesses = elastic.newton, []

    def recorded(scene, x, *args, **options):
        guesses.append(x)
        return solve(scene, x, *args, **options)

    monkeypatch.setattr(elastic, "newton", recorded)
    (found,) = equilibria.solve(P[:2] + np.array([0.05, -0.03]), [1.0], near).at
    assert len(guesses) == 1
    off, before = np.abs(guesses[0] - found.x).max(), np.abs(near.at[0].x - found.x).max()
    assert off < 0.1 * before


def test_from_states_that_lead_nowhere_the_path_is_followed_from_rest(block):
    equilibria = Equilibria(block, Slope())
    good = equilibria.solve(P[:2], [1.0])
    junk = replace(good.at[0], x=40 * np.random.default_rng(0).standard_normal(len(good.at[0].x)))
    again = equilibria.solve(P[:2], [1.0], States(good.p, (junk,)))
    assert np.abs(again.at[0].u - good.at[0].u).max() < 1e-9


def test_cells_that_do_not_grow_still_do_not(block):
    body, field = block.body, Slope()
    cells = np.arange(len(body.cells)) == 1
    beta = field.values(P[:2], body.points())
    grown = [Apical(lambda e: -0.6 * e, b, cells=cells) for b in (np.full_like(beta, 0.3), beta)]
    law = NeoHookean(1.0, 0.3)
    some, wanted = (block.with_terms([Elastic(body, law, g)]) for g in grown)
    (found,) = Equilibria(some, field).solve(P[:2], [1.0]).at
    exact = newton(wanted, np.zeros(wanted.size), 1.0, rtol=1e-12)
    assert np.abs(found.x - exact.x).max() < 1e-9 and np.abs(found.x).max() > 0.01


def test_what_leads_to_no_state_is_told_in_words(block):
    beyond = Equilibria(block, Slope()).solve(np.array([0.9, 0.4]), [1.0])
    assert isinstance(beyond, Unreached) and "outside of [0, 1]" in beyond.why
    empty = Equilibria(block, Slope()).solve(np.array([np.nan, 0.4]), [1.0])
    assert isinstance(empty, Unreached) and "not be finite" in empty.why

    def swollen(e):
        return 3.0 * e

    body = block.body
    growth = Apical(swollen, np.full(body.weights.shape, 0.5))
    scene = block.with_terms([Elastic(body, NeoHookean(1.0, 0.3), growth)])
    found = Equilibria(scene, Slope()).solve(np.array([0.5, 0.0]), [0.5, 1.0])
    assert isinstance(found, Unreached) and found.at < 1.0 and found.why
    # At rest already.
    growth = Apical(lambda e: 3.0 + e, np.full(body.weights.shape, 0.1))
    scene = block.with_terms([Elastic(body, NeoHookean(1.0, 0.3), growth)])
    found = Equilibria(scene, Slope()).solve(np.array([0.5, 0.0]), [1.0])
    assert isinstance(found, Unreached) and "1 - g beta" in found.why


def test_wrong_scenes_and_loads_are_refused(block):
    body = block.body
    for growth in (None, AlongFibre(0.1, (1, 0, 0))):
        scene = Scene(
            body, [Elastic(body, NeoHookean(1.0, 0.3), growth)], fixed=[Fixed([0], (1, 0, 0))]
        )
        with pytest.raises(ValueError, match="0 terms of the scene grow by Apical"):
            Equilibria(scene, Slope())
    with pytest.raises(ValueError, match="2 terms"):
        contracting(2 * block.terms)
    for loads in ([1.0, 0.5], [0.0], [], [[1.0]], [np.nan]):
        with pytest.raises(ValueError, match="expected increasing numbers > 0"):
            increasing("loads", loads)
