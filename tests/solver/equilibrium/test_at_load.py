"""Newton's method that guesses stresses beside displacements, for thin bodies."""

from types import SimpleNamespace

import numpy as np
import pytest

from solver.cases.unit.choices import Meshing, Physics
from solver.cases.unit.model import build
from solver.cases.unit.unit import Unit
from solver.equilibrium import at_load
from solver.equilibrium.at_load import Mixed
from solver.equilibrium.linesearch import Step
from solver.equilibrium.newton import iterate, newton
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene

UNIT = Unit(
    E_ratio=0.1, h_ratio=5, slenderness=4e-3, hinge_length=0.25, hinge_width=0.8, aspect=0.2,
    stiffness_to_weight=5, rho_ratio=1, contraction=0.3,
)  # fmt: skip


def hinge():
    """A weightless hinge of h_s/l_s = 1/250, whose steps go straight."""
    scene = build(UNIT, Meshing(0), Physics(())).scene
    return Scene(scene.body, scene.terms, scales=scene.scales, frame=scene.frame)


def test_a_thin_hinge_bends_in_a_few_iterations_that_guess_stresses():
    scene = hinge()
    start = np.zeros(scene.size)
    mixed = newton(scene, start, 0.1, rtol=1e-8, unstable=0)
    assert mixed.converged and mixed.iterations <= 8
    plain = iterate(at_load.AtLoad(scene, 0.1, 0), start, rtol=1e-8, max_iterations=100)
    assert plain.converged and plain.iterations > 4 * mixed.iterations
    assert mixed.x == pytest.approx(plain.x, abs=1e-8)


def test_the_stiffness_of_a_result_is_the_states_own(monkeypatch):
    scene = hinge()
    monkeypatch.setattr(at_load, "CLOSE", 0.0)  # all tangents are under guessed stresses
    result = newton(scene, np.zeros(scene.size), 0.02, rtol=1e-2, unstable=0, fresh=True)
    assert result.converged
    own = scene.system(result.x, 0.02).values
    assert result.system.values == pytest.approx(own, abs=1e-12 * np.abs(own).max())


def test_what_comes_no_nearer_is_given_up_and_a_body_without_sections_is_solved_as_ever(
    monkeypatch,
):
    scene = hinge()
    monkeypatch.setattr(at_load.Mixed, "step", lambda *_: Outcome.NO_PROGRESS)
    result = newton(scene, np.zeros(scene.size), 0.01, rtol=1e-8, unstable=0, max_iterations=60)
    assert result.converged and result.iterations > 1
    none = newton(scene, np.zeros(scene.size), 0.01, rtol=1e-8, unstable=0, max_iterations=1)
    assert (none.outcome, none.iterations) == (Outcome.NO_PROGRESS, 1)


def test_iterations_that_guess_stresses_are_among_those_allowed(monkeypatch):
    scene, step, some = hinge(), at_load.Mixed.step, iter(range(2))

    def short(*given):
        return Outcome.NO_PROGRESS if next(some, None) is None else step(*given)

    monkeypatch.setattr(at_load.Mixed, "step", short)
    result = newton(scene, np.zeros(scene.size), 0.1, rtol=1e-8, unstable=0, max_iterations=7)
    assert (result.outcome, result.iterations) == (Outcome.NOT_CONVERGED, 7)


def test_a_slender_body_asks_for_a_shorter_load_step_instead(monkeypatch):
    monkeypatch.setattr(at_load.Mixed, "step", lambda *_: Outcome.NO_PROGRESS)
    scene = build(UNIT, Meshing(0), Physics(())).scene
    result = newton(scene, np.zeros(scene.size), 0.01, rtol=1e-8, unstable=0)
    assert (result.outcome, result.iterations) == (Outcome.NO_PROGRESS, 1)


def stepped(unstable, size, longest=1.0, rtol=1e-8, times=1):
    """What a step of this size (lengths) comes to, and whether the next tangent is plain."""
    scene = hinge()
    mixed, z = Mixed(scene, 0.1, rtol), np.zeros(scene.size)
    dz = scene.unknowns(np.outer(scene.body.nodes[:, 1] ** 2, [0.0, 0.0, 1.0]))
    dz *= size / mixed.size(dz)
    system = SimpleNamespace(unstable=unstable)
    for _ in range(times):
        step = mixed.step(system, None, z, dz, longest)
    if isinstance(step, Step):
        mixed.linearise(step.z)
    return step, mixed.plain


def test_tangents_may_have_unstable_modes_in_the_first_steps_only():
    assert stepped(3, 1e-3, times=at_load.UNSTABLE)[0].fraction == 1.0
    assert stepped(3, 1e-3, times=at_load.UNSTABLE + 1)[0] is Outcome.NO_PROGRESS
    assert stepped(0, 1e-3, times=at_load.UNSTABLE + 1)[0].fraction == 1.0


def test_no_step_is_longer_than_the_body():
    assert stepped(0, 1.01)[0] is Outcome.NO_PROGRESS
    assert stepped(0, 0.99)[0].fraction == 1.0
    # What a barrier admits of a step counts.
    assert stepped(1, 1.5, longest=0.6)[0].fraction == 0.6


def test_close_to_the_solution_tangents_are_the_states_own():
    assert not stepped(0, 1.01e-5, rtol=1e-7)[1]
    assert stepped(0, 0.99e-5, rtol=1e-7)[1]


def test_a_tangent_with_unstable_modes_leads_around_no_barrier(monkeypatch):
    asked = []
    monkeypatch.setattr(at_load, "around", lambda scene, solve, x, dx, e: asked.append(1) or dx)
    stepped(1, 1e-3, longest=0.5)
    assert not asked
    stepped(0, 1e-3, longest=0.5)
    assert asked


def test_a_step_that_turns_the_body_inside_out_is_halved_until_it_does_not(monkeypatch):
    scene, stressed = hinge(), []
    monkeypatch.setattr(Scene, "extrapolated", lambda self, z, dz, e: stressed.append(dz))
    z = np.zeros(scene.size)
    dz = scene.unknowns(scene.body.nodes * [0.0, 0.0, -1.9])
    step = Mixed(scene, 0.0, 1e-8).step(SimpleNamespace(unstable=0), None, z, dz, 1.0)
    assert step.fraction == 0.5
    assert step.z == pytest.approx(dz / 2)
    # Stresses are guessed of what was taken.
    (taken,) = stressed
    assert taken == pytest.approx(dz / 2)


def test_where_only_the_turning_step_is_not_admitted_the_straight_one_is_taken(monkeypatch):
    scene = build(UNIT, Meshing(0), Physics(())).scene
    assert scene.sections is not None
    mixed, z = Mixed(scene, 0.0, 1e-8), np.zeros(scene.size)
    dz = np.full(scene.size, 1e-9)
    monkeypatch.setattr(mixed, "moved", lambda z, dz: z + 1e9)
    residual = mixed.residual
    monkeypatch.setattr(mixed, "residual", lambda z: None if z.max() > 1 else residual(z))
    step = mixed.step(SimpleNamespace(unstable=0), None, z, dz, 1.0)
    assert isinstance(step, Step) and step.fraction == 1.0
    assert np.array_equal(step.z, z + dz)


@pytest.mark.parametrize(("halvings", "taken"), [(7, True), (8, False)])
def test_a_step_is_halved_seven_times_at_most(halvings, taken):
    scene = hinge()
    mixed, z = Mixed(scene, 0.0, 1e-8), np.zeros(scene.size)
    dz = scene.unknowns(np.outer(scene.body.nodes[:, 1], [0.0, 0.0, 0.5]))
    most = mixed.size(dz) * 0.5**halvings * (1 + 1e-9)
    mixed.residual = lambda there: there if mixed.size(there) <= most else None
    step = mixed.step(SimpleNamespace(unstable=0), None, z, dz, 1.0)
    assert step.fraction == 0.5**halvings if taken else step is Outcome.INADMISSIBLE
