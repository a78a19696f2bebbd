"""A path is the same in any unit of length: every size is judged beside the body's own."""

import numpy as np
import pytest
from path_toys import function_scene, truss

from solver.paths.continuation import load, trace
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps


def fork(length):
    """A pitchfork at e = 1/2 in a = q₁/length, beside b = q₂/length that follows the load."""

    def energy(q, e):
        a, b = q / length
        return float(a**4 / 4 + (0.5 - e) * a**2 / 2 + (b - e) ** 2 / 2)

    def gradient(q, e):
        a, b = q / length
        return np.array([a**3 + (0.5 - e) * a, b - e]) / length

    def hessian(q, e):
        a, _ = q / length
        return np.diag([3 * a**2 + 0.5 - e, 1.0]) / length**2

    return function_scene(2, energy, gradient, hessian, length=length)


STEPS = LoadSteps(1e-10, 4e-5)
WIDE = LoadSteps(1e-10, 0.17)
EXACT = {
    "load steps": (truss, STEPS, 1.5e-4),
    "round the limit": (truss, ArcLength(1e-10, a=0.02, b=2e-5), 4e-4),
    "a fall": (truss, StableSteps(STEPS, locate=False), 4e-4),
    "off a saddle": (fork, StableSteps(WIDE, locate=False), 1.0),
}
# Events are located to a fraction of a step, and beyond that it hangs on rounding where.
LOCATED = {
    "a located snap": (truss, StableSteps(STEPS), 4e-4),
    "past a branch point": (fork, ArcLength(1e-10, a=0.2, b=0.2), 1.0),
    "a located branch": (fork, StableSteps(WIDE, side=-1), 1.0),
}


@pytest.mark.parametrize("name", {**EXACT, **LOCATED})
def test_a_path_does_not_depend_on_the_unit_of_length(name):
    make, stepper, target = {**EXACT, **LOCATED}[name]

    def walked(length):
        scene = make(length=length)
        return trace(scene, np.zeros(scene.size), stepper, until=load(target), max_steps=200)

    here = walked(1.0)
    assert here.reached and len(here.points) > 3
    # Powers of two lose no digit.
    for length in (2.0**-14, 2.0**14):
        there = walked(length)
        assert there.reached and there.last.x / length == pytest.approx(here.last.x, rel=1e-6)
        assert [e.kind for e in there.events] == [e.kind for e in here.events]
        for event, other in zip(there.events, here.events, strict=True):
            assert event.e == pytest.approx(other.e, rel=1e-4)
            assert event.size == pytest.approx(other.size, rel=0.02)
        if name in EXACT:
            assert there.loads.tolist() == here.loads.tolist()
            assert [p.iterations for p in there.points] == [p.iterations for p in here.points]
            for p, q in zip(there.points, here.points, strict=True):
                assert (p.x / length).tolist() == q.x.tolist() and p.unstable == q.unstable
