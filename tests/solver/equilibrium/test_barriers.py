"""The step of a body that comes down on a barrier: least energy among those that stay above."""

import sys

import numpy as np
import pytest

from solver.equilibrium import at_load
from solver.equilibrium.barriers import KEPT, LOWEST, around
from solver.equilibrium.newton import newton
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics.elastic import Elastic
from solver.physics.ground import Ground
from solver.physics.loads import Gravity
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed
from solver.physics.term import Evaluation

THICKNESS, WEIGHT = 0.05, 1e-4


def beam(*, height=-0.2, element="hex20", wall=False, more=()):
    """A cantilever along y over a floor so near that its weight lays it down; h/L = 1/20."""
    y = np.linspace(0, 1, 13)
    body = Body.build(box([0, 0.1, 0.2], y, [0, THICKNESS]), element)
    bottom = body.surface(lambda X: X[:, 2] < 1e-9)
    terms = [
        Elastic(body, NeoHookean(1.0, 0.3)),
        Gravity(body, WEIGHT / THICKNESS, 1.0),
        Ground(body, bottom, thickness=THICKNESS, pressure=WEIGHT, height=height),
    ]
    if wall:
        # Its end meets a wall where the beam swings down and away.
        end = body.surface(lambda X: X[:, 1] > 1 - 1e-9)
        terms.append(
            Ground(
                body, end, thickness=THICKNESS, pressure=WEIGHT, height=0.95, axis=1, name="wall"
            )
        )
    return Scene(
        body,
        [*terms, *more],
        fixed=[Fixed(body.nodes_where(lambda X: X[:, 1] < 1e-9), axis) for axis in np.eye(3)],
    )


def fall(scene):
    """Newton's step from rest, the system and the terms' distances before and after ``around``."""
    x = np.zeros(scene.size)
    system = scene.system(x, 1.0)
    solve = system.factorise().solve
    dx = -solve(system.residual)
    return x, system, solve, dx


def points(scene, x, dx):
    """Distances at x and their changes along dx, of all barriers."""
    barriers = [t for t in scene.terms if isinstance(t, Ground)]
    u, du = scene.displacement(x, 1.0), scene.step_displacement(dx)
    s = np.concatenate([t.distances(u) for t in barriers])
    needed = np.concatenate(
        [
            np.maximum(KEPT * np.minimum(d, t.range), LOWEST * d)
            for t in barriers
            for d in [t.distances(u)]
        ]
    )
    pushes = [scene.pulls(t.push(k)) for t in barriers for k in range(len(t.distances(u)))]
    return s, np.concatenate([t.approach(du) for t in barriers]), needed, np.column_stack(pushes)


@pytest.mark.parametrize("element", ["hex20", "hex27"])
def test_of_the_steps_above_the_floor_it_is_the_one_of_least_energy(element):
    scene = beam(element=element)
    x, system, solve, dx = fall(scene)
    assert scene.longest_step(x, dx, 1.0) < 0.2
    step = around(scene, solve, x, dx, 1.0)
    assert scene.longest_step(x, step, 1.0) > 0.999
    s, change, needed, pushes = points(scene, x, step)
    assert (s + change >= (LOWEST - 1e-6) * s).all()
    # K d + g is made of pushes of points that came down, none of which pulls.
    over = system.linear_residual(step)[0]
    down = np.flatnonzero(np.abs(s + change - needed) < 1e-6 * s)
    assert 1 <= len(down) < 30
    forces = np.linalg.lstsq(pushes[:, down], over, rcond=None)[0]
    assert pushes[:, down] @ forces == pytest.approx(over, abs=1e-8 * np.abs(over).max())
    assert (forces > -1e-9 * np.abs(forces).max()).all() and forces.max() > 0
    assert system.residual @ step < 0


def test_a_step_that_stays_above_is_kept_as_it_is():
    scene = beam(height=-50.0)
    x, _, solve, dx = fall(scene)
    assert around(scene, solve, x, dx, 1.0) is dx


def test_it_minds_a_wall_beside_the_floor():
    scene = beam(wall=True)
    x, system, solve, _ = fall(scene)
    dx = scene.unknowns(np.outer(scene.body.nodes[:, 1], [0.0, -0.08, -0.25]))
    step = around(scene, solve, x, dx, 1.0)
    s, change, needed, pushes = points(scene, x, step)
    assert (s + change >= (LOWEST - 1e-6) * s).all()
    # What was added to dx, seen through K, are pushes of the floor and of the wall.
    added = scene.frame.times(system.values, step - dx)
    down = np.flatnonzero(np.abs(s + change - needed) < 1e-6 * s)
    forces = np.linalg.lstsq(pushes[:, down], added, rcond=None)[0]
    assert pushes[:, down] @ forces == pytest.approx(added, abs=1e-8 * np.abs(added).max())
    floor = len(scene.terms[2].distances(scene.displacement(x, 1.0)))
    assert (down < floor).any() and (down >= floor).any()


@pytest.mark.parametrize("admits", [0.5, 1.0])
def test_a_barrier_of_another_kind_leaves_the_step_to_the_line_search_if_it_bars_it(admits):
    class Other:
        name, graph, symmetric = "other", None, True

        def evaluate(self, u, e, order=2):
            return Evaluation(0.0, np.zeros(()))

        def longest_step(self, u, du):
            assert u.shape == du.shape == scene.body.nodes.shape
            return admits

    scene = beam(more=[Other()])
    x, _, solve, dx = fall(scene)
    step = around(scene, solve, x, dx, 1.0)
    assert (step is dx) is (admits < 1)
    if admits == 1:
        assert (step == around(beam(), solve, x, dx, 1.0)).all()


def test_a_thin_beam_lies_down_in_a_few_iterations(monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "THICKNESS", 0.02)
    monkeypatch.setattr(sys.modules[__name__], "WEIGHT", 6.4e-6)
    # Without a floor its end would sink by ten lengths.
    scene = beam()
    start = np.zeros(scene.size)
    result = newton(scene, start, 1.0, rtol=1e-8, unstable=0)
    assert result.converged and result.system.unstable == 0
    assert result.iterations <= 10
    monkeypatch.setattr(at_load, "around", lambda scene, solve, x, dx, e: dx)
    plain = newton(scene, start, 1.0, rtol=1e-8, unstable=0, max_iterations=100)
    assert plain.iterations > 2 * result.iterations
    assert plain.x == pytest.approx(result.x, abs=1e-7)
