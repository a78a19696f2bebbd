"""What a path says where something could not be had: events, steps, starts."""

import numpy as np
import pytest
from path_toys import column, function_scene

from solver.paths.continuation import load, trace
from solver.paths.point import Unlocated
from solver.paths.steppers import ArcLength, LoadSteps


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
