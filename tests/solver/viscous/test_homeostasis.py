"""Stability of states in which growth rests: closed forms of a bar, a ring's radial solution."""

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from solver.cases.tissue.feedback import NU, Bar, E, Radial, Ring, uniaxial
from solver.equilibrium.scene import Scene
from solver.physics.elastic import Elastic
from solver.physics.loads import Traction
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed
from solver.viscous import homeostasis as module
from solver.viscous.evolution import TimeSteps, evolve, start
from solver.viscous.feedback import Feedback, Growing
from solver.viscous.homeostasis import Verdict, homeostasis
from solver.viscous.rheology import Maxwell, Spring
from solver.viscous.term import Viscous


def reached(scene, dt, until, tolerance=None):
    path = evolve(scene, start(scene), TimeSteps(1e-11, dt, tolerance), until=until)
    assert path.reached, path.reason
    return path.last


def uniform(scene):
    term = scene.terms[0]
    return np.ones((*term.body.weights.shape, term.feedback.modes))


STRETCHED = uniaxial(1.2)[0]


@pytest.mark.parametrize(
    "bar",
    [
        Bar(),
        Bar(along=False, target=0.03),
        Bar(measure="eshelby"),
        Bar(along=False, target=0.03, measure="eshelby"),
        Bar(rate=-2.0, target=STRETCHED, baseline=0.0),
        Bar(rate=-2.0, target=STRETCHED / 3, baseline=0.0, along=False),
    ],
    ids=str,
)
def test_uniform_growth_of_a_clamped_bar_dies_out_as_the_closed_form_says(bar):
    scene = bar.scene(1e-2)
    rests = bar.rate < 0
    state = reached(scene, 0.01, 0.01 if rests else 15.0, 1e-4)
    gamma = state.level.memories[0].growth.mean()
    found = homeostasis(scene, state)
    want = bar.eigenvalue(gamma)
    # The closed form is the slope of the law itself.
    speeds = [bar.rate * bar.stress(gamma + h) for h in (1e-5, -1e-5)]
    assert want == approx((speeds[0] - speeds[1]) / 2e-5, rel=1e-6)
    assert found.rate(uniform(scene)) == approx(want, rel=1e-8)
    assert found.verdict is (Verdict.UNSTABLE if rests else Verdict.STABLE)
    assert found.speed < 1e-3 * abs(want) and found.neutral == 0
    assert np.abs(found.modes).max(axis=(1, 2, 3)) == approx(1.0)
    assert (np.diff(found.rates.real) <= 1e-12).all() and len(found.rates) == 8


def test_growth_here_and_shrinkage_there_along_a_fibre_stay():
    # Three points along each fibre: what sums to 0 along it changes no stress, alike in all fibres.
    scene = Bar().scene(0.05, "hex27")
    state = reached(scene, 0.04, 2.0)
    found = homeostasis(scene, state)
    assert found.verdict is Verdict.NEUTRAL and found.neutral == 1
    x = scene.body.points()[..., 0]
    field = found.modes[0, 0, :, 0].real
    for k in np.unique(x.round(9)):
        assert np.ptp(field[np.isclose(x[0], k)]) < 1e-9
    assert (scene.body.weights[0] * field).sum() == approx(0.0, abs=1e-12)
    # Whatever grows is told from what rests by the tolerance.
    assert homeostasis(scene, state, tolerance=10.0).neutral == len(found.rates)


@pytest.mark.parametrize("along", [True, False])
def test_under_a_dead_load_growth_of_the_volume_relieves_and_along_the_bar_does_not(along):
    bar, pull = Bar(along=along, target=0.03), 0.15
    body = bar.scene(0.1).body
    fixed = [Fixed(body.nodes[:, k] < 1e-9, np.eye(3)[k]) for k in range(3)]
    load = Traction(body, body.surface("x+"), np.array([pull, 0, 0]))
    scene = Scene(body, [Growing(body, Spring(E, NU), bar.law, dt=1e-3), load], fixed=fixed)
    state = reached(scene, 1e-2, 1e-2)
    gamma = state.level.memories[0].growth.mean()
    stretch = 1 + scene.displacement(state.x, 0)[:, 0].max()
    elastic = stretch * np.exp(-gamma)
    mandel, slope, _ = uniaxial(elastic)
    nominal = mandel / elastic
    # Of the volume the section grows by exp(2γ), so that P exp(2γ) = pull.
    assert nominal * (1.0 if along else np.exp(2 * gamma)) == approx(pull, rel=1e-8)
    change = 0.0 if along else -2 * nominal / (slope / elastic - mandel / elastic**2)
    want = bar.rate * slope * change / (1 if along else 3)
    found = homeostasis(scene, state)
    assert found.rate(uniform(scene)) == approx(want, rel=1e-8, abs=1e-10)
    assert found.verdict is (Verdict.NEUTRAL if along else Verdict.STABLE)


HOOP = Ring(rates=(0.0, 1.0, 0.0), baseline=0.0, settled=True)


@pytest.mark.parametrize(
    ("ring", "verdict"),
    [
        (replace(HOOP, pressure=0.05), Verdict.UNSTABLE),
        (replace(HOOP, widened=0.1), Verdict.STABLE),
        (replace(HOOP, pressure=0.05, rates=(1.0, 1.0, 0.0)), Verdict.UNSTABLE),
    ],
    ids=["hoop under pressure", "hoop on a mandrel", "both under pressure"],
)
def test_what_holds_a_ring_decides_its_stability(ring, verdict):
    scene = ring.scene(4, 1e-3)
    state = reached(scene, 1e-2, 0.2 if ring.widened else 1e-2)
    found = homeostasis(scene, state)
    assert found.verdict is verdict and found.speed < 0.02
    want = Radial(ring).rates(np.zeros((3, 17)))[0].real
    if verdict is Verdict.UNSTABLE:
        assert found.rates[0] == approx(want, rel=1e-3) and want > 0.2
    # Directions whose law has no rate are no disturbances.
    assert len(found.rates) == 4 * 27 * np.count_nonzero(ring.rates)
    assert not found.modes[..., 2].any()


def test_a_disturbance_grows_at_its_rate():
    ring = replace(HOOP, pressure=0.05)
    scene = ring.scene(2, 1e-2)
    before = reached(scene, 1e-2, 1e-2)
    found = homeostasis(scene, before)
    rest, ends = before.level.memories[0], []
    for size in (0.0, 1e-4):
        memory = replace(rest, growth=rest.growth + size * found.modes[0].real)
        level = replace(before.level, memories=(memory,))
        state = replace(before, level=level, past=(), step=0.02)
        path = evolve(scene, state, TimeSteps(1e-12, 0.02), until=before.t + 1.0)
        ends.append(path.last.level.memories[0].growth)
    factor = (ends[1] - ends[0]) / 1e-4
    np.testing.assert_allclose(
        factor[..., 1], np.exp(found.rates[0].real) * found.modes[0, ..., 1].real, rtol=5e-3
    )


def test_part_of_a_body_may_grow_beside_what_does_not():
    body = Ring().scene(4, 0.1).body
    outer = np.arange(len(body.cells)) >= 2
    soft = Growing(body, Spring(E, NU), Feedback(1.0, 0.0), dt=0.1, cells=outer)
    rest = Elastic(body, NeoHookean(E, NU), cells=~outer)
    held = [Fixed(body.nodes[:, 0] < 1.2, np.eye(3)[k]) for k in range(3)]
    scene = Scene(body, [soft, rest], fixed=held)
    found = homeostasis(scene, start(scene))
    assert not found.modes[:, ~outer].any() and found.modes[:, outer].any()
    assert found.verdict is Verdict.STABLE and found.speed == 0.0
    # As where all may grow, and the law has a rate there alone.
    law = Feedback(np.where(outer, 1.0, 0.0), 0.0)
    scene = Scene(body, [Growing(body, Spring(E, NU), law, dt=0.1)], fixed=held)
    np.testing.assert_allclose(homeostasis(scene, start(scene)).rates, found.rates, atol=1e-12)


def test_bad_input(monkeypatch):
    bar = Bar()
    scene = bar.scene(0.1)
    state = start(scene)
    body = scene.body
    for terms in (
        [Viscous(body, Maxwell(1.0, 0.3, 1.0), dt=0.1)],
        [Growing(body, Maxwell(1.0, 0.3, 1.0), bar.law, dt=0.1)],
        [scene.terms[0], scene.terms[0]],
    ):
        other = scene.with_terms(terms)
        with pytest.raises(ValueError, match="one Growing term of springs is all that remembers"):
            homeostasis(other, start(other))
    deaf = scene.with_terms([Growing(body, Spring(E, NU), Feedback(0.0, 0.0), dt=0.1)])
    with pytest.raises(ValueError, match="0 log stretches of growth answer to stress"):
        homeostasis(deaf, start(deaf))
    with pytest.raises(ValueError, match="expected a State"):
        homeostasis(scene, 0.0)
    with pytest.raises(ValueError, match="expected a ratio > 0"):
        homeostasis(scene, state, tolerance=0.0)
    found = homeostasis(scene, state)
    for field in (np.ones((8, 1)), np.zeros((1, 8, 1))):
        with pytest.raises(ValueError, match=r"expected \(1, 8, 1\), and not 0"):
            found.rate(field)
    monkeypatch.setattr(module, "MOST", 7)
    with pytest.raises(ValueError, match="8 log stretches of growth answer to stress; expected 1"):
        homeostasis(scene, state)
