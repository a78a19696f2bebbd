"""A lung whose tissues relax, between its two elastic limits."""

import warnings
from functools import lru_cache

import numpy as np
import pytest
from pytest import approx

from solver.cases.lung.geometry import Lung
from solver.cases.lung.measures import measure
from solver.cases.lung.mesh import hexahedra
from solver.cases.lung.model import REST, State, Tissue, between, muscle_of, run, scene, staged
from solver.cases.lung.viscous import Relaxing, at_once, course, viscous
from solver.physics.elastic import Elastic
from solver.viscous.evolution import TimeSteps, Unresolved, evolve, start
from solver.viscous.term import Viscous

LUNG = Lung(n=1)
FULL, LOW = State(0.05), State(0.045, -0.1)


@lru_cache
def wedge():
    return hexahedra(LUNG, 0)


def in_time(rate, relaxing, states=(REST, FULL), n=8, rest=0.0):
    """Path through the states, each in ``rate``, and a rest."""
    times = [rate] * (len(states) - 1) + ([rest] if rest else [])
    states = (*states, states[-1]) if rest else states
    stage = viscous(wedge(), LUNG, Tissue(), relaxing, states, dt=rate / n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Unresolved)
        path = evolve(
            stage, start(stage), TimeSteps(1e-8, rate / n), until=sum(times), load=course(*times),
            breaks=tuple(np.cumsum(times)[:-1]),
        )  # fmt: skip
    assert path.reached
    return stage, path


def elastic(stages):
    x = None
    for stage in stages:
        path = run(stage, x, steps=8, events=False)
        assert path.reached
        x = path.last.x
    return stages[-1].displacement(x, 1.0)


@pytest.mark.parametrize(
    "relaxing",
    [Relaxing(), Relaxing(3.0, 0.5), Relaxing(0.0, 2.0), Relaxing(1.0, 0.0)],
    ids=["both", "unlike", "muscle", "epithelium"],
)
def test_fast_it_is_springs_and_branches_and_slow_the_springs_alone(relaxing):
    body = wedge()
    slow = elastic([scene(body, LUNG, Tissue(), REST, FULL)])
    fast = elastic([at_once(body, LUNG, Tissue(), relaxing, (REST, FULL))])
    size = np.abs(slow).max()
    assert np.abs(slow - fast).max() > 0.03 * size
    for rate, limit in ((1e-4, fast), (1e5, slow)):
        stage, path = in_time(rate, relaxing)
        u = stage.displacement(path.last.x, 1.0)
        assert np.abs(u - limit).max() < 2e-3 * size
    # In between it lies in between, and only there much is lost.
    stage, path = in_time(1.0, relaxing, n=20)
    ends = [np.linalg.norm(stage.displacement(path.last.x, 1.0) - u) for u in (fast, slow)]
    apart = np.linalg.norm(fast - slow)
    assert 0.05 * apart < min(ends) and max(ends) < apart
    lost = [in_time(rate, relaxing)[1].last.dissipated for rate in (1e-4, 1.0, 1e5)]
    assert lost[1] > 20 * max(lost[0], lost[2]) > 0


def test_a_punctured_lung_that_rests_comes_to_the_elastic_one():
    body = wedge()
    slow = elastic([scene(body, LUNG, Tissue(), *s) for s in ((REST, FULL), (FULL, LOW))])
    off = []
    for rest in (0.5, 40.0):
        stage, path = in_time(0.5, Relaxing(), (REST, FULL, LOW), n=5, rest=rest)
        off.append(np.abs(stage.displacement(path.last.x, 2.0) - slow).max())
    assert off[1] < 0.02 * off[0] and off[1] < 1e-3 * np.abs(slow).max()


def test_steps_converge_in_second_order():
    ends = []
    for n in (5, 10, 20, 40):
        stage, path = in_time(1.0, Relaxing(), n=n)
        ends.append(measure(wedge(), LUNG, stage.displacement(path.last.x, 1.0)).aspect)
    first, second, third = np.abs(np.diff(ends))
    assert first / second > 2.5 and second / third > 2.5


def test_what_does_not_relax_stays_elastic():
    body = wedge()
    muscle = muscle_of(body)
    assert 0 < muscle.sum() < len(muscle)
    for relaxing, cells in ((Relaxing(1, 0), ~muscle), (Relaxing(0, 1), muscle)):
        terms = viscous(body, LUNG, Tissue(), relaxing, (REST, FULL), dt=0.1).terms
        (one,) = (t for t in terms if isinstance(t, Viscous))
        (other,) = (t for t in terms if isinstance(t, Elastic) and not isinstance(t, Viscous))
        np.testing.assert_array_equal(np.flatnonzero(cells), one.ids)
        np.testing.assert_array_equal(np.flatnonzero(~cells), other.ids)
    terms = viscous(body, LUNG, Tissue(), Relaxing(), (REST, FULL), dt=0.1).terms
    assert [type(t).__name__ for t in terms] == ["Viscous", "Pressure"]


def test_times_and_moduli_are_each_tissue_s_own():
    body = wedge()
    relaxing = Relaxing(2.0, 3.0, epithelium_time=5.0, muscle_time=7.0)
    (term, *_) = viscous(body, LUNG, Tissue(stiffness=50.0), relaxing, (REST, FULL), dt=0.1).terms
    spring, branch = term.rheology.parts
    maxwell, dashpot = branch.parts
    table = spring.material.properties(0.0, body.weights.shape)[..., 1]
    muscle = muscle_of(body)
    mu = np.where(muscle, 50.0, 1.0) / 2.6
    assert np.broadcast_to(table, body.weights.shape)[:, 0] == approx(mu)
    more = np.broadcast_to(
        maxwell.material.properties(0.0, body.weights.shape)[..., 1], body.weights.shape
    )[:, 0]
    assert more == approx(np.where(muscle, 3.0, 2.0) * mu)
    eta = np.broadcast_to(dashpot.viscosity(0.0, body.weights.shape, None).T, (1, len(muscle)))[0]
    assert eta == approx(np.where(muscle, 50 * 3.0 * 7.0, 2.0 * 5.0))
    (term, *_) = at_once(body, LUNG, Tissue(stiffness=50.0), relaxing, (REST, FULL)).terms
    table = term.material.properties(0.0, body.weights.shape)[..., 1]
    assert np.broadcast_to(table, body.weights.shape)[:, 0] == approx(
        np.where(muscle, 4.0, 3.0) * mu
    )


def test_stages_go_straight_from_state_to_state():
    assert [between((1.0, 3.0, 2.0), e) for e in (0, 0.5, 1, 1.25, 2)] == [1, 2, 3, 2.75, 2]
    assert between((1.0, 3.0), 1.5) == 4.0 and between((1.0, 3.0), -0.5) == 0.0
    e = course(2.0, 4.0)
    assert [e(t) for t in (0, 1, 2, 4, 6, 9)] == [0, 0.5, 1, 1.5, 2, 2]
    body, u = wedge(), 0.05 * wedge().nodes
    three = staged(body, LUNG, Tissue(), (REST, FULL, LOW))
    two = scene(body, LUNG, Tissue(), FULL, LOW)
    for part in (0.0, 0.3, 1.0):
        a, b = three.evaluate(u, 1 + part, 1), two.evaluate(u, part, 1)
        assert a.force == approx(b.force, abs=1e-12) and a.energy == approx(b.energy)


def test_bad_relaxations_are_refused():
    for bad, says in (
        ({"epithelium": -1.0}, "expected none below 0"),
        ({"epithelium": 0.0, "muscle": 0.0}, "one above, or take the elastic lung"),
        ({"muscle_time": 0.0}, "muscle_time = 0"),
        ({"epithelium": "soft"}, "expected numbers"),
    ):
        with pytest.raises(ValueError, match=says):
            Relaxing(**bad)
    with pytest.raises(ValueError, match="take model='advanced'"):
        viscous(wedge(), LUNG, Tissue(model="primitive"), Relaxing(), (REST, FULL), dt=0.1)
    with pytest.raises(ValueError, match="1 states; expected two at least"):
        staged(wedge(), LUNG, Tissue(), (REST,))
    with pytest.raises(ValueError, match="the time of a stage = 0"):
        course(1.0, 0.0)
