"""Derivatives of viscoelastic states through time, against differences of paths followed anew."""

import warnings

import numpy as np
import pytest
from grown_blocks import Slope, clamped
from pytest import approx

from solver.equilibrium.scene import Scene
from solver.fitting.creeping import Creep
from solver.fitting.elastic import Equilibria, Unreached
from solver.fitting.fit import fit
from solver.fitting.targets import Landmarks
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics.growth import Apical
from solver.viscous.evolution import TimeSteps, Unresolved
from solver.viscous.rheology import SLS, Dashpot, KelvinVoigt, Maxwell, Series, Spring
from solver.viscous.term import Viscous

P = np.array([0.4, 0.2])
TREES = {
    "standard linear solid": SLS(1.0, 2.0, 0.3, 0.5),
    "Kelvin–Voigt": KelvinVoigt(1.0, 0.3, 0.5),
    "Burgers": Series(Spring(2.0, 0.3), Dashpot(3.0), KelvinVoigt(1.0, 0.3, 0.5)),
}


def creeping(
    rheology=TREES["standard linear solid"], order=2, step=0.25, cells=None, rtol=1e-12, body=None
):
    elastic = clamped(body=body)
    (term,) = elastic.terms
    growth = Apical(lambda e: -0.6 * e, np.full(term.body.weights.shape, 0.5), cells=cells)
    scene = elastic.with_terms([Viscous(term.body, rheology, growth, dt=step)])
    return Creep(scene, Slope(), TimeSteps(rtol, step, order=order), lambda t: min(t, 1.0))


def solved(creep, p, times):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Unresolved)
        return creep.solve(p, times)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", TREES)
def test_rates_are_those_of_paths_that_were_followed_anew(name, order):
    # The last steps are shorter, and after t = 1 growth rests while the dashpots relax. A tree is
    # slow: of it one cell has to do.
    tree = name == "Burgers"
    body = Body.build(box([0, 1], [0, 1], [0, 0.8]), "hex8") if tree else None
    creep, times = creeping(TREES[name], order, body=body), [0.6] if tree else [0.6, 1.3]
    found = solved(creep, P, times)
    assert len(found.at[0].course.states) == (1 + 3 if tree else 1 + 3 + 3)
    h = 1e-4
    for j, d in enumerate(h * np.eye(2)[: 1 if tree else 2]):
        low, high = (solved(creep, P + s * d, times) for s in (-1, 1))
        for a, state, b in zip(low.at, found.at, high.at, strict=True):
            wanted = (b.u - a.u) / (2 * h)
            assert np.abs(wanted).max() > 0.01
            assert np.abs(state.rates[..., j] - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_what_is_remembered_counts():
    # Rates that forget the memory's own are far off: of a fluid most is memory.
    creep = creeping(Maxwell(1.0, 0.3, 0.5))
    found = solved(creep, P, [1.0])
    (state,) = found.at
    d = np.array([1e-4, 0.0])
    change = (solved(creep, P + d, [1.0]).at[0].u - solved(creep, P - d, [1.0]).at[0].u) / 2e-4
    assert np.abs(state.rates[..., 0] - change).max() < 1e-5 * np.abs(change).max()


def test_cells_that_do_not_grow_still_do_not():
    cells = np.arange(len(clamped().body.cells)) == 1
    creep, d = creeping(cells=cells), np.array([1e-4, 0.0])
    (state,) = solved(creep, P, [1.0]).at
    everywhere = solved(creeping(), P, [1.0]).at[0]
    assert np.abs(state.u - everywhere.u).max() > 0.01
    change = (solved(creep, P + d, [1.0]).at[0].u - solved(creep, P - d, [1.0]).at[0].u) / 2e-4
    assert np.abs(state.rates[..., 0] - change).max() < 1e-5 * np.abs(change).max()


def test_parameters_on_their_bounds_have_rates_too():
    class Bare(Slope):
        def slopes(self, p, X):
            parts = [np.ones(X.shape[:-1]), np.clip(X[..., 0] - 0.5, 0, None)]
            return np.stack(parts, axis=-1)

    creep = creeping()
    creep.field = Bare()
    (state,) = solved(creep, np.array([0.0, 0.3]), [1.0]).at
    after = solved(creep, np.array([1e-4, 0.3]), [1.0]).at[0].u
    assert state.rates[..., 0] == approx((after - state.u) / 1e-4, abs=1e-3)


def test_a_contraction_is_found_in_points_followed_over_time():
    creep, rng = creeping(rtol=1e-10), np.random.default_rng(1)
    body = creep.scene.body
    X, sigma = body.nodes[8:], 2e-3
    data = []
    for state in solved(creep, P, [0.5, 1.0, 2.0]).at:
        seen = X + state.u[8:] + sigma * rng.standard_normal(X.shape)
        data.append((state.e, Landmarks(body, X, seen, sigma)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Unresolved)
        found = fit(creep, data)
    assert found.fitted and found.explained and not found.unfixed
    assert found.distance(P) < 0.999 and found.p == approx(P, abs=0.03)
    # Elastic tissue would have come there at once and stayed: that does not explain them.
    other = fit(Equilibria(clamped(), Slope()), data[:1])
    assert other.p[0] < P[0] - 3 * other.sd[0] or not other.explained


def test_what_leads_to_no_state_is_told_in_words():
    creep = creeping()
    beyond = creep.solve(np.array([0.9, 0.4]), [1.0])
    assert isinstance(beyond, Unreached) and "outside of [0, 1]" in beyond.why
    creep.scene = creep.scene.with_terms([
        t.with_growth(Apical(lambda e: 3.0 * e, t.growth.beta)) for t in creep.scene.terms
    ])  # fmt: skip
    (creep._term,) = creep.scene.terms
    swollen = solved(creep, np.array([0.5, 0.0]), [0.25, 1.0])
    assert isinstance(swollen, Unreached) and 0 < swollen.at < 1 and swollen.why


def test_wrong_scenes_and_steps_are_refused():
    creep = creeping()
    with pytest.raises(ValueError, match="give a step and no tolerance"):
        Creep(creep.scene, Slope(), TimeSteps(1e-8, 0.1, tolerance=1e-3), lambda t: t)
    with pytest.raises(ValueError, match="no Viscous term"):
        Creep(clamped(), Slope(), creep.stepper, lambda t: t)
    (term,) = creep.scene.terms
    still = Viscous(term.body, term.rheology, dt=0.1)
    both = Scene(term.body, [term, still], frame=creep.scene.frame)
    with pytest.raises(ValueError, match="more than what contracts remembers"):
        Creep(both, Slope(), creep.stepper, lambda t: t)
    with pytest.raises(ValueError, match="expected increasing numbers > 0"):
        creep.solve(P, [1.0, 0.5])
