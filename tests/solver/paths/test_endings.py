"""What a path says where something could not be had: events, steps, starts."""

import re
from dataclasses import replace

import numpy as np
import pytest
from path_toys import column, function_scene, truss
from reference_scenes import AXES, MidLine, cantilever, near

from solver.equilibrium.newton import newton
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body, NodeGraph
from solver.mesh.structured import box
from solver.paths import continuation
from solver.paths.continuation import load, trace
from solver.paths.point import Unlocated
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.growth import Isotropic
from solver.physics.loads import PointLoad, Traction
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed
from solver.physics.term import Evaluation


def rest(scene):
    return np.zeros(scene.size)


def walled(low, high):
    """A rigid column that buckles at e = 1, and no state at all at loads within the bounds."""
    term = column(1.0).terms[0]

    def energy(q, e):
        return np.inf if low < e < high else term.f(q, e)

    return function_scene(2, energy, term.g, term.h)


@pytest.mark.parametrize("events", [True, False])
def test_an_event_that_cannot_be_located_is_said_and_the_path_goes_on(events):
    scene = walled(0.95, 1.15)
    steps = LoadSteps(1e-11, 0.3, first=1.0)
    path = trace(scene, rest(scene), steps, until=load(1.5), max_steps=9, events=events)
    assert path.reached and path.events == ()
    assert [p.unstable for p in path.points] == [0, 0, 0, 0, 1, 1]
    if events:
        (warning,) = path.warnings
        assert isinstance(warning, Unlocated)
        assert "between e = 0.9 and 1.2" in str(warning)
    else:
        assert path.warnings == ()


def test_an_event_that_is_located_leaves_no_warning():
    scene = column(1.0, 1.02)
    for stepper in (LoadSteps(1e-11, 0.3), ArcLength(1e-11, a=0.05, b=0.3)):
        path = trace(scene, rest(scene), stepper, until=load(1.5), max_steps=50)
        assert path.reached and len(path.events) == 2 and path.warnings == ()


def block(term, **options):
    """A cube of two cells, one on the other, on mirror planes; ``term(body, cells)``."""
    body = Body.build(box([0, 1], [0, 1], [0, 0.5, 1]), "hex8")
    planes = [Fixed(body.nodes_where(near(i, 0.0)), AXES[i]) for i in range(3)]
    return Scene(body, term(body, body.cells_where(near_top)), fixed=planes, **options)


def near_top(X):
    return X[:, 2] > 0.5


def inside_out(body, upper):
    # At e = 0.8 nothing is left of the body.
    return [Elastic(body, NeoHookean(1.0, 0.3), Isotropic(lambda e: -1.25 * e))]


def melting(body, upper):
    """The upper cell's stiffness goes to nothing at e = 0.5, and below it beyond."""
    return [Elastic(body, NeoHookean(lambda e, X: np.where(X[..., 2] > 0.5, 0.5 - e, 1.0), 0.3))]


def torn(body, upper):
    """The upper cell has no material, and what held it under its load gives way at e = 0.5."""
    top = body.nodes_where(near(2, 1.0))
    load = PointLoad(body, top, lambda e: (0, 0, -1e-3 * e))
    return [Elastic(body, NeoHookean(1.0, 0.3), cells=~upper), Springs(body), load]


class Springs:
    """On all nodes; gone from e = 0.5 on."""

    symmetric, name = True, "springs"

    def __init__(self, body):
        self.n = len(body.nodes)
        self.graph = NodeGraph.of(self.n, np.arange(self.n, dtype=np.int32)[:, None])

    def evaluate(self, u, e, order=2):
        k = 1.0 if e < 0.5 else 0.0
        return Evaluation(k * (u**2).sum() / 2, k * u, k * np.tile(np.eye(3), (self.n, 1, 1)))


STEPPERS = {
    "load steps": LoadSteps(1e-9, 0.3),
    "arc length": ArcLength(1e-9, a=0.3, b=0.3),
    "stable path": StableSteps(LoadSteps(1e-9, 0.3)),
    "stable path, not located": StableSteps(LoadSteps(1e-9, 0.3), locate=False),
}


@pytest.mark.parametrize("stepper", STEPPERS.values(), ids=STEPPERS)
def test_a_path_that_ends_says_what_its_last_attempt_failed_at(stepper):
    scene = block(inside_out)
    path = trace(scene, rest(scene), stepper, max_steps=60)
    assert not path.reached and 0.75 < path.last.e < 0.8
    says = r"growth has det Fg = -[\d.e-]+ everywhere at e = 0\.[89]\d*; expected"
    assert re.search(says, path.detail)
    assert path.reason == f"{path.outcome.value}; {path.detail}"


@pytest.mark.parametrize(
    ("terms", "says"),
    [
        (melting, r"to e = 0\.5\d*, failed: E = -[\d.e-]+; expected E > 0"),
        (torn, r"4 nodes have no stiffness, the first at \(0, 0, 1\): cells without material"),
    ],
)
def test_a_part_that_is_lost_on_the_way_is_named(terms, says):
    scene = block(terms)
    path = trace(scene, rest(scene), STEPPERS["load steps"], max_steps=60)
    assert not path.reached and 0.4 < path.last.e < 0.5
    assert re.search(says, path.detail), path.reason


def test_a_step_that_only_led_elsewhere_is_called_that():
    scene = truss()
    path = trace(scene, rest(scene), LoadSteps(1e-10, 4e-5), until=load(4e-4), max_steps=99)
    assert path.outcome is Outcome.MIN_STEP
    assert re.search(r"the last try, to e = 0\.0001905\d*, failed: ", path.detail)
    whole = LoadSteps(1e-10, 2e-4, first=1.0, smallest=0.9)
    path = trace(scene, rest(scene), whole, until=load(4e-4), max_steps=99)
    jumped = "the last try, to e = 0.0002, failed: it came to an equilibrium that the path does not"
    assert path.detail.startswith(jumped)


def test_a_start_without_equilibrium_says_why():
    scene = block(melting)
    for stepper in STEPPERS.values():
        path = trace(scene, np.full(scene.size, -3.0), stepper, max_steps=5)
        assert path.points == () and path.detail.startswith("at e = 0")
        assert "an element is turned inside out of the term 'elastic'" in path.reason
        with pytest.raises(ValueError, match="turned inside out"):
            _ = path.last


@pytest.mark.parametrize(("wide", "most"), [(0.1, 4), (1e-7, 60)])
def test_a_target_that_is_passed_and_not_met_is_said(wide, most):
    scene = walled(1.05 - wide, 1.05 + wide)
    options = {"until": lambda p: p.e - 1.05, "max_steps": most, "events": False}
    path = trace(scene, rest(scene), LoadSteps(1e-9, 0.3, first=1.0), **options)
    assert path.outcome is (Outcome.MAX_STEPS if most == 4 else Outcome.MIN_STEP)
    assert re.search(r"the target, between e = \S+ and \S+, was not met", path.reason)


# -- restarts at the target ------------------------------------------------------------------------


@pytest.mark.parametrize("stepper", STEPPERS.values(), ids=STEPPERS)
def test_a_restart_on_its_target_is_checked(stepper):
    """The state of a cube at e = 1 is none of one that grows twice as much."""
    grown = [
        block(
            lambda body, _, g=g: [Elastic(body, NeoHookean(1.0, 0.3), Isotropic(lambda e: g * e))]
        )
        for g in (0.1, 0.2)
    ]
    path = trace(grown[0], rest(grown[0]), stepper, max_steps=50)
    again = trace(grown[0], path.last, stepper, max_steps=50)
    assert path.reached and again.reached and again.points == (path.last,)
    other = trace(grown[1], path.last, stepper, max_steps=50)
    assert other.outcome is Outcome.NO_EQUILIBRIUM
    assert "Newton's first correction is 0.09 of the length" in other.reason
    apart = replace(path.last, x=path.last.x - 5)
    assert "turned inside out" in trace(grown[0], apart, stepper, max_steps=50).reason
    with pytest.raises(ValueError, match=r"the guess has shape \(2,\); expected"):
        trace(grown[0], replace(path.last, x=np.zeros(2)), stepper, max_steps=50)


# -- roundoff --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("element", "h"), [("hex20", 1e-4), ("hex27", 1e-5), ("hex20", 1e-6), ("hex27", 1e-6)]
)
def test_a_body_too_thin_for_floating_point_numbers_is_called_that(element, h):
    """An end load of α = 1 makes the tip drop by 0.30 (references.md §1). The condition number of
    a solid cantilever is about (L/h)⁴; where that is 1e16 or more linear solves are roundoff."""
    scene = cantilever(tip_load=1.0, h=h, element=element)
    for stepper in (LoadSteps(1e-8, 0.1), StableSteps(LoadSteps(1e-8, 0.1), most=100)):
        path = trace(scene, rest(scene), stepper, max_steps=30, events=False)
        assert path.outcome is Outcome.ILL_CONDITIONED
        assert "far too thin" in path.reason
    assert newton(scene, rest(scene), 0.1, rtol=1e-8).outcome is not Outcome.CONVERGED


@pytest.mark.parametrize("h", [1e-5, 1e-6])
def test_a_fall_that_roundoff_leads_out_of_what_is_admissible_is_no_crash(h):
    """A wider strip whose line searches are roundoff: states that they took were not admissible,
    and the fall went on from None."""
    body = Body.build(box(np.linspace(0, 1, 17), [0, 5 * h], [0, h]), "hex27")
    stiffness = 5 * h * h**3 / 12
    end = body.surface("x+")
    pull = Traction(body, end, lambda e: np.array([0, 0, e * 0.9 * stiffness / (5 * h * h)]))
    fixed = [Fixed(np.flatnonzero(body.nodes[:, 0] < 1e-12), axis) for axis in AXES]
    scene = Scene(body, [Elastic(body, NeoHookean(1.0, 0.3)), pull], fixed=fixed)
    path = trace(scene, rest(scene), StableSteps(LoadSteps(1e-6, 0.25), locate=False), max_steps=9)
    assert path.outcome is Outcome.ILL_CONDITIONED and not path.points


def test_a_thin_body_that_floating_point_numbers_can_solve_is_solved():
    scene = cantilever(tip_load=1.0, h=1e-3)
    path = trace(scene, rest(scene), LoadSteps(1e-8, 0.1), max_steps=30, events=False)
    assert path.reached
    assert MidLine(scene).tip(path.last.x, 1.0)[0] == pytest.approx(0.301720774, rel=1e-3)


# -- targets ---------------------------------------------------------------------------------------


def test_a_target_function_that_vanishes_at_the_start_ends_the_path_where_it_vanishes_again():
    scene = column(3.0)
    path = trace(
        scene, rest(scene), LoadSteps(1e-10, 0.2), until=lambda p: p.e * (p.e - 0.55), max_steps=20
    )
    assert path.reached and len(path.points) > 2
    assert path.last.e == pytest.approx(0.55, abs=1e-6)


@pytest.mark.parametrize(("off", "reached"), [(0.0, True), (0.05, True), (0.3, False)])
def test_a_target_met_far_from_where_the_path_is_counts_as_not_met(off, reached, monkeypatch):
    """Newton's method at the target may come to another branch: further than a tenth of the step
    from the point of the path that is nearest."""
    scene = column(3.0)
    stepper = ArcLength(1e-10, a=0.2, b=0.2)
    right, chords = continuation.newton, []

    def elsewhere(scene, x, e, **options):
        result = right(scene, x, e, **options)
        if e == 0.5 and off:
            chord = 0.2 / np.sqrt(2)  # of a point of column(3), whose load and last unknown are one
            shifted = result.x.copy()
            shifted[-1] += off * chord
            chords.append(chord)
            return replace(result, x=shifted)
        return result

    monkeypatch.setattr(continuation, "newton", elsewhere)
    path = trace(scene, rest(scene), stepper, until=load(0.5), max_steps=30, events=False)
    assert path.reached is reached
    if not reached:
        assert chords and "was not met" in path.detail
