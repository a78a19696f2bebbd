"""What a path counts and what it warns of, on points made by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from path_toys import column, function_scene, truss

from solver.equilibrium.outcome import Outcome
from solver.paths import continuation
from solver.paths.continuation import Path, load, trace
from solver.paths.steppers import ArcLength, LoadSteps


def point(e, unstable=0, way=1.0, events=()):
    return SimpleNamespace(e=e, unstable=unstable, tangent=np.array([0.0, way]), events=events)


def event(kind, before=0, after=0):
    return SimpleNamespace(kind=kind, unstable=(before, after))


FOLD, BRANCH, BACK = event("fold", 0, 1), event("branch", 0, 1), event("branch", 1, 0)


@pytest.mark.parametrize(
    ("before", "after", "unexplained"),
    [
        (point(0), point(1), False),
        (point(0), point(1, way=-1), True),  # the load turned, and no fold was located
        (point(0), point(1, 1, -1, [FOLD]), False),
        (point(0), point(1, 1, 1, [FOLD]), True),  # a fold, and the load did not turn
        (point(0), point(1, 2, 1, [FOLD, FOLD]), False),
        (point(0), point(1, 1), True),
        (point(0), point(1, 1, 1, [BRANCH]), False),
        (point(0), point(1, 2, 1, [BRANCH]), True),
        (point(0), point(1, 0, 1, [BRANCH, BACK]), False),
        (point(0), point(1, 0, 1, [BRANCH]), True),
        (point(0, None), point(1, 1), False),  # nobody knows
        (point(0, None), point(1, None, -1), True),
        (point(0), point(1, 1, 1, [event("branch", None, 1)]), False),
        (point(0), point(1, 0, -1, [event("snap", 0, 0)]), False),  # a fall, wherever it led
    ],
)
def test_changes_that_no_event_explains_are_told(before, after, unexplained):
    assert continuation._unexplained(before, after) is unexplained
    warned = continuation._unlocated([before, after])
    assert len(warned) == unexplained
    assert all("between e = 0 and 1:" in str(w) for w in warned)


def test_of_many_steps_three_are_named():
    points = [point(k, k) for k in range(6)]
    (warning,) = continuation._unlocated(points)
    assert "e = 0 and 1, 1 and 2, 2 and 3, and in 2 steps more: " in str(warning)
    (warning,) = continuation._unlocated(points[:4])
    assert "2 and 3: " in str(warning) and "more" not in str(warning)


@pytest.mark.parametrize("symmetric", [True, False])
def test_points_that_were_not_counted_are(symmetric):
    term = SimpleNamespace(name="wind", symmetric=symmetric)
    scene = SimpleNamespace(symmetric=symmetric, terms=[term])
    points = [point(0.0), point(0.25, None), point(0.5), point(0.75, None)]
    (warning,) = continuation._uncounted(scene, points)
    assert "not counted at 2 of 4 points, from e = 0.25 on: " in str(warning)
    assert ("stiffness of wind isn't symmetric" in str(warning)) is not symmetric
    assert continuation._uncounted(scene, [points[0], points[2]]) == ()


@pytest.mark.parametrize(
    ("bounds", "loads"),
    [
        ((-np.inf, 0.5), [0, 0.25, 0.5]),
        ((-np.inf, 0.49), [0, 0.25]),
        ((0.0, 1.0), [0, 0.25, 0.5, 0.75, 1.0]),
    ],
)
def test_a_load_on_its_bound_is_within_it(bounds, loads):
    scene = column(3.0)
    steps = LoadSteps(1e-10, 0.25, first=1.0)
    until = load(2.0)
    path = trace(scene, np.zeros(scene.size), steps, until=until, max_steps=20, bounds=bounds)
    assert path.outcome is Outcome.OUT_OF_BOUNDS and path.loads.tolist() == loads


def test_the_work_that_met_a_target_is_counted(monkeypatch):
    scene, made = truss(), []
    right = continuation.between

    def between(*given, **options):
        found = right(*given, **options)
        made.append(found[0].iterations)
        return found

    monkeypatch.setattr(continuation, "between", between)
    stepper = ArcLength(1e-10, a=0.02, b=2e-5)
    options = {"max_steps": 100, "events": False}
    path = trace(scene, np.zeros(1), stepper, until=lambda p: -p.x[0] - 0.1, **options)
    free = trace(
        scene,
        np.zeros(1),
        stepper,
        until=lambda p: 1.0,
        **options | {"max_steps": len(path.points) - 1},
    )
    assert path.reached and len(made) > 1
    assert path.last.iterations == free.last.iterations + sum(made)
    assert path.last.index == free.last.index == len(path.points) - 1
    assert path.last.step == path.last.e - path.points[-2].e
    assert path.iterations == sum(p.iterations for p in path.points)
    # The restart knows what lay before.
    assert path.last.control == free.last.control and path.last.history


def test_the_work_that_met_a_target_passed_and_passed_again_within_a_step_is_counted(monkeypatch):
    scene, spent = truss(), []

    def counted(name):
        right = getattr(continuation, name)

        def call(*given, **options):
            found = right(*given, **options)
            spent.append((found[0] if name == "between" else found).iterations)
            return found

        monkeypatch.setattr(continuation, name, call)

    # The truss's largest load is a millionth above: both ends of that step lie below the target.
    target = 1.905435952e-4 * (1 - 1e-6)
    stepper = ArcLength(1e-10, a=0.02, b=2e-5)
    steps = len(trace(scene, np.zeros(1), stepper, until=load(target), max_steps=100).points) - 1
    free = trace(scene, np.zeros(1), stepper, until=load(1.0), max_steps=steps)
    assert free.points[-2].e < target > free.last.e and [e.kind for e in free.events] == ["fold"]
    counted("between"), counted("newton")
    path = trace(scene, np.zeros(1), stepper, until=load(target), max_steps=100)
    assert path.reached and path.last.e == target and len(spent) > 3
    assert path.last.iterations == free.last.iterations + sum(spent)
    assert path.last.index == steps and path.last.control == free.last.control


def test_a_target_that_is_met_by_a_step_needs_nothing_more(monkeypatch):
    scene = column(3.0)
    monkeypatch.setattr(continuation, "between", None)
    steps = LoadSteps(1e-10, 0.25, first=1.0)
    path = trace(scene, np.zeros(scene.size), steps, until=lambda p: p.e - 0.5, max_steps=9)
    assert path.reached and path.loads.tolist() == [0, 0.25, 0.5]


@pytest.mark.parametrize("events", [True, False])
def test_an_event_beyond_the_target_is_none_of_the_path(events):
    # It buckles at 1, between two steps; the path ends at 0.9.
    scene = column(1.0)
    steps = LoadSteps(1e-10, 0.6, first=1.0)
    path = trace(
        scene, np.zeros(scene.size), steps, until=lambda p: p.e - 0.9, max_steps=9, events=events
    )
    assert path.reached and path.last.e == pytest.approx(0.9, abs=1e-9) and path.events == ()
    beyond = trace(
        scene, np.zeros(scene.size), steps, until=lambda p: p.e - 1.1, max_steps=9, events=events
    )
    assert [round(ev.e, 6) for ev in beyond.events] == ([1.0] if events else [])


def test_a_start_on_its_target_is_held_to_ten_times_the_tolerance():
    scene = function_scene(
        1, lambda q, e: 0.5 * (q[0] - e) ** 2, lambda q, e: q - e, lambda q, e: np.eye(1)
    )
    path = trace(scene, np.zeros(1), LoadSteps(1e-6, 0.5), max_steps=9)
    for off, outcome in ((0.9e-5, Outcome.REACHED), (1.1e-5, Outcome.NO_EQUILIBRIUM)):
        length = scene.scales.length
        start = replace(path.last, x=path.last.x + off * length)
        assert trace(scene, start, LoadSteps(1e-6, 0.5), max_steps=9).outcome is outcome


def test_what_a_path_can_not_be_asked_is_told():
    scene = column(3.0)
    steps = LoadSteps(1e-10, 0.25)
    for options, words in (
        ({"until": 1.0}, r"until = 1.0; expected load\(1.0\)"),
        ({"bounds": (0.0, 1.0, 2.0)}, "expected the lowest and the highest load"),
        ({"e": np.nan}, "e"),
    ):
        with pytest.raises(ValueError, match=words):
            trace(scene, np.zeros(scene.size), steps, max_steps=3, **options)
    with pytest.raises(ValueError, match="the load to reach"):
        load(np.inf)
    bare = Path((), Outcome.NO_START, (), detail="so")
    assert bare.reason == f"{Outcome.NO_START.value}; so" and not bare.reached
    assert bare.iterations == 0 and len(bare.loads) == 0


def test_outcomes_are_sentences_of_their_own():
    texts = [outcome.value for outcome in Outcome]
    assert len(set(texts)) == len(texts) and all(len(text.split()) > 4 for text in texts)
