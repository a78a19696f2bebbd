"""Paths in time: creep and relaxation against closed forms, discrete schemes and ODEs."""

import warnings
from itertools import pairwise

import numpy as np
import pytest
from pytest import approx
from viscous_references import TREES, kelvin_voigt_path, sls_path

import solver.viscous.evolution as evolution
from solver.cases.tissue import creep
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.reactions import reaction
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.output import cell_fields
from solver.physics.growth import Isotropic
from solver.physics.supports import Fixed
from solver.viscous.evolution import (
    State,
    TimeSteps,
    Unresolved,
    evolve,
    march,
    start,
    stepped,
    viscous,
)
from solver.viscous.rheology import SLS, KelvinVoigt, Maxwell, Series
from solver.viscous.term import Viscous

SMALL = 2e-7  # σ, with moduli of 1: at which the strain is as good as small


def followed(scene, stepper, until=2.0, breaks=(1.0,), state=None):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Unresolved)
        path = evolve(scene, state or start(scene), stepper, until=until, breaks=breaks)
    assert path.reached
    return path


def curve(scene, path):
    return np.array([creep.strains(scene, s.x) for s in path.states])


# References §8: (t, axial, lateral) per σ.
EXACT = {
    "Kelvin-Voigt": [
        (0.05, 3.7184862e-3, -4.3225267e-4), (0.1, 5.8746855e-3, -1.1015127e-3),
        (0.5, 9.8148600e-3, -2.9074374e-3), (1.0, 9.9960452e-3, -2.9980226e-3),
        (1.5, 1.8505556e-4, -9.2520327e-5),
    ],
    "Maxwell": [(0.05, 5.25e-3, -1.5e-3), (0.5, 7.5e-3, None), (1.0, 1e-2, None), (1.5, 5e-3, 0)],
    "SLS 2": [
        (0.05, 8.3830729e-3, -2.2122083e-3), (0.1, 9.5549654e-3, -2.7778032e-3),
        (0.5, 9.9999844e-3, -2.9999922e-3), (1.0, 1e-2, -3e-3), (1.5, 1.56273e-8, -7.81363e-9),
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", EXACT)
def test_closed_form_is_the_published_one(name):
    for t, axial, lateral in EXACT[name]:
        mine = creep.MODELS[name].exact(t)
        assert mine[0] == approx(axial, rel=1e-6)
        # Of a Maxwell body the lateral strain of deviator and volume flow apart.
        if lateral is not None and name != "Maxwell":
            assert mine[1] == approx(lateral, rel=1e-5)
    one = {"Kelvin-Voigt": 3.9346934e-3, "SLS 2": 8.7408293e-3}
    if name in one:
        assert creep.MODELS[name].response(0.05) == approx(one[name], rel=1e-7)


def test_lateral_strain_of_a_maxwell_bar_stays():
    model = creep.MODELS["Maxwell"]
    axial, lateral = model.exact(np.array([0.01, 0.5, 1.0]))
    assert axial == approx(1 / 200 + np.array([0.01, 0.5, 1.0]) / 200)
    assert lateral == approx(-0.3 / 200, rel=1e-12)


@pytest.mark.parametrize("name", creep.MODELS)
def test_creep_within_half_a_percent_of_the_exact_solution(name):
    model, stress = creep.MODELS[name], 1e-2
    scene = creep.scene(model.rheology(), stress, 1e-4)
    path = followed(scene, TimeSteps(1e-10, 1e-4, tolerance=1e-7))
    axial, lateral = model.exact(path.times[1:])
    peak = np.abs(model.exact(np.linspace(0, 2, 2001))[0]).max()
    found = curve(scene, path)[1:] / stress
    assert np.abs(found[:, 0] - axial).max() < 5e-3 * peak
    assert np.abs(found[:, 1] - lateral).max() < 5e-3 * peak
    assert len(path.states) < 90  # the tolerance is not met by brute force


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", TREES)
def test_small_strain_scheme(name, order):
    tree = TREES[name]
    dts = np.array([0.05, 0.05, 0.05, 0.03, 0.06, 0.05])
    t = np.cumsum(dts)
    loads = SMALL * np.array([1, 1, 1, -0.5, -0.5, 0])
    at = dict(zip(t.tolist(), loads, strict=True))
    scene = creep.scene(tree, lambda e: at.get(e, 0.0), 0.05)
    found, now = [], start(scene)
    for dt, until in zip(dts, t, strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Unresolved)
            now = evolution.replace(now, step=float(dt))
            (now,) = march(scene, now, TimeSteps(1e-14, 0.1, order=order), until=float(until))
        assert now.order == (1 if now.index == 1 else order)
        found.append(creep.strains(scene, now.x))
    exact = creep.stepped(tree, 0.3, dts, loads, order)
    # What is left is the difference of finite and small strain, in the order of the strain.
    np.testing.assert_allclose(found, exact, atol=1e-6 * np.abs(exact).max())
    assert np.abs(exact).max() > SMALL / 10


FINITE = {"E": 1.0, "E_m": 2.0, "nu": 0.3, "eta": 0.6}


def errors(order, dts, error):
    found = [error(TimeSteps(1e-11, dt, order=order)) for dt in dts]
    rates = np.diff(np.log(found)) / np.diff(np.log(dts))
    return found, rates


@pytest.mark.parametrize("order, dts", [(1, (0.01, 0.005)), (2, (0.02, 0.01))])
def test_finite_creep_against_an_ode(order, dts):
    stress, ends = 0.6, np.array([0.1, 0.5, 1.0])
    exact = sls_path(**FINITE, times=ends, stress=stress)[0]
    assert exact[-1] > 1.4  # that is finite

    def error(stepper):
        scene = creep.scene(SLS(1.0, 2.0, 0.3, 0.6), lambda t: stress, stepper.step)
        path = followed(scene, stepper, until=1.0, breaks=())
        mine = 1 + np.interp(ends, path.times, curve(scene, path)[:, 0])
        return np.abs(mine - exact).max() / (exact[-1] - 1)

    found, rates = errors(order, dts, error)
    assert rates == approx(order, abs=0.25)
    assert found[-1] < (1e-3 if order == 2 else 1e-2)


def pulled(rheology, dt, stretch):
    """The bar with its end moved to a stretch at once, and the sum of forces there."""
    bar = creep.scene(rheology, 0.0, dt)
    body, planes = bar.body, []
    for k in range(3):
        planes.append(Fixed(np.flatnonzero(np.abs(body.nodes[:, k]) < 1e-12), np.eye(3)[k]))
    end = np.flatnonzero(np.abs(body.nodes[:, 0] - 4) < 1e-12)
    planes.append(Fixed(end, [1, 0, 0], lambda t: 4 * (stretch - 1)))
    return Scene(body, [viscous(bar)[0]], fixed=planes), end


@pytest.mark.parametrize("order, dts", [(1, (0.01, 0.005)), (2, (0.02, 0.01))])
def test_relaxation_against_an_ode(order, dts):
    stretch, ends = 1.4, np.array([0.1, 0.5, 1.0])
    exact = sls_path(**FINITE, times=ends, stretch=stretch)[1]
    peak = sls_path(**FINITE, times=np.array([0.0, 1e-6]), stretch=stretch)[1][0]
    assert exact[-1] < 0.6 * peak

    def error(stepper):
        scene, end = pulled(SLS(1.0, 2.0, 0.3, 0.6), stepper.step, stretch)
        # The jump at t = 0 is a short step of its own, so that order is seen.
        path = followed(scene, TimeSteps(1e-11, 1e-7), until=1e-7, breaks=())
        now = evolution.replace(path.last, past=(), step=0.0)
        path = followed(scene, stepper, until=1.0, breaks=(), state=now)
        pull = []
        for before, after in pairwise(path.states):
            now = stepped(scene, before, after)
            pull.append(reaction(now, after.x, after.e, end).force[0])
        return np.abs(np.interp(ends, path.times[1:], pull) - exact).max() / peak

    found, rates = errors(order, dts, error)
    assert rates == approx(order, abs=0.3)
    assert found[-1] < (1e-3 if order == 2 else 1e-2)


@pytest.mark.parametrize("order", [1, 2])
def test_stress_of_a_state_is_what_the_ends_carry(order):
    # One wide and high, so P is the pull; under a traction it is the traction, at every instant.
    stretch, stepper = 1.4, TimeSteps(1e-11, 0.05, order=order)
    scene, end = pulled(SLS(1.0, 2.0, 0.3, 0.6), 0.05, stretch)
    loaded = creep.scene(KelvinVoigt(1.0, 0.3, 0.6), lambda t: 0.3, 0.05)
    for case in (scene, loaded):
        path = followed(case, stepper, until=0.5, breaks=(0.3,))
        seen = []
        for before, after in pairwise(path.states):
            now, u = stepped(case, before, after), case.displacement(after.x, after.e)
            fields = cell_fields(case.body, u, now.terms, after.e)
            want = 0.3 if case is loaded else reaction(now, after.x, after.e, end).force[0]
            axial = np.zeros((3, 3))
            axial[0, 0] = want
            assert fields["P"] == approx(np.broadcast_to(axial, fields["P"].shape), abs=1e-7)
            width = fields["F"][..., 1, 1] * fields["F"][..., 2, 2]
            assert fields["cauchy"][..., 0, 0] == approx(want / width, rel=1e-6)
            seen.append(want)
        assert case is loaded or seen[-1] < 0.7 * seen[0]
    # The scene's own term knows its first step alone.
    own = cell_fields(loaded.body, u, loaded.terms, after.e)["P"][..., 0, 0]
    assert np.abs(own - 0.3).max() > 0.1


def test_a_fixed_step_that_failed_once_comes_back_to_its_size(monkeypatch):
    attempt, failed = evolution._attempt, []

    def once(scene, state, stepper, t, dt, e):
        if state.index == 2 and not failed:
            failed.append(dt)
            return evolution._Failed(Outcome.NOT_CONVERGED, 0, scene, state.x, e)
        return attempt(scene, state, stepper, t, dt, e)

    monkeypatch.setattr(evolution, "_attempt", once)
    scene = creep.scene(Maxwell(1.0, 0.3, 1.0), 1e-2, 0.1)
    path = followed(scene, TimeSteps(1e-10, 0.1), until=0.725, breaks=())
    assert path.reached and failed == approx([0.1])
    assert np.diff(path.times) == approx([0.1, 0.1, 0.025, 0.1, 0.1, 0.1, 0.1, 0.1])


def test_a_step_lies_between_two_states_in_turn():
    scene = creep.scene(Maxwell(1.0, 0.3, 1.0), 1e-2, 0.1)
    path = followed(scene, TimeSteps(1e-10, 0.05), until=0.2, breaks=())
    for pair in ((0, 2), (2, 1), (1, 1)):
        with pytest.raises(ValueError, match="do not follow each other"):
            stepped(scene, *(path.states[k] for k in pair))
    other = creep.scene(Maxwell(1.0, 0.3, 1.0), 1e-2, 0.1, element="hex27")
    with pytest.raises(ValueError, match="belongs to another scene"):
        stepped(other, *path.states[:2])


def test_finite_kelvin_voigt_against_an_ode():
    ends = np.array([0.2, 0.6, 1.0])
    exact = kelvin_voigt_path(1.0, 0.3, 0.6, ends, 0.5)
    scene = creep.scene(KelvinVoigt(1.0, 0.3, 0.6), lambda t: 0.5, 1e-3)
    path = followed(scene, TimeSteps(1e-10, 1e-4, tolerance=3e-5), until=1.0, breaks=(0.2, 0.6))
    at = [int(np.flatnonzero(path.times == t)[0]) for t in ends]
    assert 1 + curve(scene, path)[at, 0] == approx(exact, abs=1e-3 * (exact[-1] - 1))


def test_energy_goes_into_springs_and_dashpots():
    # Work of the load = energy of the springs + energy taken by the dashpots.
    def pull(t):
        return 0.3 * min(2 * t, 1.0)

    scene = creep.scene(Maxwell(1.0, 0.3, 1.0), pull, 1e-3)
    path = followed(scene, TimeSteps(1e-10, 1e-4, tolerance=1e-5), until=1.0, breaks=(0.5,))
    length = 4 * curve(scene, path)[:, 0]
    forces = np.array([pull(t) for t in path.times])
    work = float(((forces[1:] + forces[:-1]) / 2 * np.diff(length)).sum())
    term = viscous(scene)[0]
    last = path.last
    # Stored: the branch's spring alone, F_v frozen, is what an instant step from here would hold.
    frozen = term.stepped(evolution.Past(last.level.memories[0], 1e-9))
    stored = frozen.evaluate(scene.displacement(last.x, 0), 0, 0).energy
    assert work == approx(stored + last.dissipated, rel=5e-3)
    assert last.dissipated > 0.3 * work


def test_a_saved_state_continues_to_the_identical_path(tmp_path):
    model = creep.MODELS["SLS 2"]
    for stepper in (TimeSteps(1e-10, 0.02), TimeSteps(1e-10, 1e-4, tolerance=1e-6)):
        scene = creep.scene(model.rheology(), 1e-2, stepper.step)
        whole = followed(scene, stepper, until=1.2)
        for k in (1, 4, len(whole.states) - 3):
            file = whole.states[k].save(tmp_path / "state.npz")
            anew = creep.scene(model.rheology(), 1e-2, stepper.step)
            rest = followed(anew, stepper, until=1.2, state=State.load(file))
            assert len(rest.states) == len(whole.states) - k
            for mine, other in zip(rest.states, whole.states[k:], strict=True):
                assert mine.t == other.t and mine.dissipated == other.dissipated
                np.testing.assert_array_equal(mine.x, other.x)
    other = tmp_path / "other.npz"
    np.savez(other, a=np.zeros(3))
    with pytest.raises(ValueError, match="holds no saved state"):
        State.load(other)


def test_the_largest_step_is_a_fraction_of_the_first():
    scene = creep.scene(creep.MODELS["SLS 10"].rheology(), 1e-2, 1e-2)
    stepper = TimeSteps(1e-10, 0.02, tolerance=1e-4, largest=1.5)
    steps = np.diff(followed(scene, stepper, until=0.9).times)
    assert max(steps) == approx(0.03) and len(steps) > 20


def test_second_order_needs_fewer_steps_and_errors_follow_the_tolerance():
    model, count, off = creep.MODELS["SLS 10"], {}, {}
    for order in (1, 2):
        for tolerance in (1e-6, 1e-7):
            scene = creep.scene(model.rheology(), 1e-2, 1e-4)
            path = followed(scene, TimeSteps(1e-10, 1e-4, tolerance=tolerance, order=order))
            exact = model.exact(path.times[1:])[0]
            off[order, tolerance] = np.abs(curve(scene, path)[1:, 0] / 1e-2 - exact).max()
            count[order, tolerance] = len(path.states)
    assert count[2, 1e-7] < 0.6 * count[1, 1e-7]
    for order in (1, 2):
        assert off[order, 1e-7] < 0.5 * off[order, 1e-6]
        assert count[order, 1e-7] > count[order, 1e-6]
    assert off[2, 1e-7] < 0.5 * off[1, 1e-7]


def test_steps_end_on_breaks_and_on_the_time_asked_for():
    scene = creep.scene(Maxwell(200.0, 0.3, 200.0), 1e-2, 0.03)
    path = followed(scene, TimeSteps(1e-9, 0.03), until=0.5, breaks=(0.1, 0.2, 3.0))
    assert {0.1, 0.2} <= set(path.times) and path.times[-1] == 0.5
    assert all(s.past == () for s in path.states if s.t in (0.1, 0.2))
    # A break at which the load jumps sees what was before: the bar is still stretched.
    path = followed(scene, TimeSteps(1e-9, 0.1), until=1.1)
    strain = dict(zip(path.times.round(9), curve(scene, path)[:, 0], strict=True))
    assert strain[1.0] == approx(1e-2 * 1e-2, rel=1e-2)
    assert strain[1.1] == approx(5e-3 * 1e-2, rel=1e-2)


def test_steps_too_long_are_warned_of():
    scene = creep.scene(SLS(100.0, 200.0, 0.3, 2.0), 1e-2, 0.01)
    with pytest.warns(Unresolved, match=r"relaxation time of term 'viscous', 0\.01; take dt <= 0"):
        evolve(scene, start(scene), TimeSteps(1e-9, 0.01), until=0.02)
    # With a tolerance the step is found, not warned of.
    evolve(scene, start(scene), TimeSteps(1e-9, 0.01, tolerance=1e-5), until=0.02)


def test_a_dashpot_that_gives_energy_ends_the_path(monkeypatch):
    scene = creep.scene(SLS(100.0, 200.0, 0.3, 2.0), 1e-2, 1e-3)
    now = start(scene)
    assert evolve(scene, now, TimeSteps(1e-9, 1e-3), until=2e-3).reached
    # A state that was tampered with: C_v far from equilibrium and not positive.
    memory = now.level.memories[0]
    strains = memory.strains.copy()
    strains[..., 0] = -0.5
    level = evolution.replace(now.level, memories=(evolution.Memory(strains, memory.joints),))
    path = evolve(scene, evolution.replace(now, level=level), TimeSteps(1e-9, 1e-3), until=2e-3)
    assert not path.reached and len(path.states) == 1
    # A dashpot that pushes: its work has the other sign.
    right = Viscous.dissipation
    monkeypatch.setattr(Viscous, "dissipation", lambda *given: tuple(-v for v in right(*given)))
    path = evolve(scene, now, TimeSteps(1e-9, 1e-3), until=2e-3)
    assert path.outcome is Outcome.DISSIPATION and len(path.states) == 1
    assert "gave energy" in path.outcome.value
    assert path.detail == "at t = 0" and path.reason == f"{path.outcome.value}; at t = 0"


def test_a_path_in_time_says_what_its_last_try_failed_at():
    # Growth that leaves nothing of the body at t = 0.5.
    body = Body.build(box([0, 1], [0, 1], [0, 1]), "hex8")
    term = Viscous(body, SLS(1.0, 1.0, 0.3, 1.0), dt=0.1, growth=Isotropic(lambda e: -2 * e))
    planes = [Fixed(np.flatnonzero(body.nodes[:, k] < 1e-12), np.eye(3)[k]) for k in range(3)]
    scene = Scene(body, [term], fixed=planes)
    path = evolve(scene, start(scene), TimeSteps(1e-9, 0.1, tolerance=1e-2), until=1.0)
    assert path.outcome is Outcome.MIN_STEP and 0.4 < path.last.t < 0.5
    assert path.detail.startswith("the last try, to t = 0.") and "failed: " in path.detail
    assert "viscous" in path.detail or "growth" in path.detail
    assert path.reason == f"{path.outcome.value}; {path.detail}"
    short = evolve(scene, start(scene), TimeSteps(1e-9, 0.01, 0.1), until=0.3, max_steps=3)
    assert short.outcome is Outcome.MAX_STEPS and short.detail.endswith(" of 0.3")


def test_too_large_a_load_step_is_shortened():
    # A jump that turns cells inside out in the first guess is taken in smaller steps.
    scene = creep.scene(KelvinVoigt(1.0, 0.3, 0.5), lambda t: -3.0 * min(t / 0.3, 1), 0.3)
    path = followed(scene, TimeSteps(1e-9, 0.3), until=0.9, breaks=())
    assert path.last.t == 0.9
    assert curve(scene, path)[-1, 0] < -0.3


def test_bad_input():
    scene = creep.scene(Maxwell(200.0, 0.3, 200.0), 1e-2, 0.01)
    with pytest.raises(ValueError, match="expected a number > 0"):
        TimeSteps(1e-9, 0.0)
    with pytest.raises(ValueError, match="order = 3"):
        TimeSteps(1e-9, 0.1, order=3)
    now = start(scene)
    with pytest.raises(ValueError, match="after the state's"):
        evolve(scene, now, TimeSteps(1e-9, 0.01), until=0.0)
    other = creep.scene(Series(Maxwell(200.0, 0.3, 200.0)), 1e-2, 0.01, element="hex20")
    with pytest.raises(ValueError, match="belongs to another scene"):
        evolve(other, now, TimeSteps(1e-9, 0.01), until=1.0)
    elastic = Scene(scene.body, [scene.terms[1], pulled_elastic(scene.body)])
    with pytest.raises(ValueError, match="no Viscous term"):
        start(elastic)


def pulled_elastic(body):
    from solver.physics.elastic import Elastic
    from solver.physics.materials import NeoHookean

    return Elastic(body, NeoHookean(1.0, 0.3))
