"""Reactions of supports and rows against forces and moments by hand."""

import numpy as np
import pytest
from pytest import approx

from solver.equilibrium.newton import newton
from solver.equilibrium.reactions import reaction
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics.elastic import Elastic
from solver.physics.loads import Traction
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed

PULL = np.array([0.002, 0.001, -0.003])


@pytest.fixture(scope="module")
def bar():
    """A bar 0 ≤ x ≤ 2 of a section 1 by 0.5, built in at x = 0 and pulled at x = 2."""
    body = Body.build(box([0, 1, 2], [0, 1], [0, 0.5]), "hex8")
    end = np.flatnonzero(body.nodes[:, 0] < 1e-9)
    fixed = [Fixed(end, np.eye(3)[k]) for k in range(3)]
    terms = [Elastic(body, NeoHookean(1.0, 0.3)), Traction(body, body.surface("x+"), PULL)]
    scene = Scene(body, terms, fixed=fixed)
    result = newton(scene, np.zeros(scene.size), 1.0, rtol=1e-11)
    assert result.converged
    return scene, result.x, end


def pulled(scene, x, about=(0.0, 0.0, 0.0)):
    """Force of the load on the body, and its moment with the arms of the deformed state."""
    u = scene.displacement(x, 1.0)
    forces = -scene.terms[1].evaluate(u, 1.0, 1).force
    arms = scene.body.nodes + u - np.asarray(about)
    return forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)


@pytest.mark.parametrize("about", [(0.0, 0.0, 0.0), (1.0, -2.0, 0.5)])
def test_what_holds_a_body_balances_what_pulls_it(bar, about):
    scene, x, end = bar
    force, moment = pulled(scene, x, about)
    assert force == approx(0.5 * PULL)
    held = reaction(scene, x, 1.0, end, about=about)
    assert held.force == approx(-force, abs=1e-9)
    assert held.moment == approx(-moment, abs=1e-9) and np.abs(moment).max() > 1e-3
    mask = np.zeros(scene.n_nodes, bool)
    mask[end] = True
    again = reaction(scene, x, 1.0, mask, about=about)
    assert again.force == approx(held.force) and again.moment == approx(held.moment)


@pytest.mark.parametrize("direction", [[1, 0, 0], [0, 3, 0], [1, 1, 0]])
def test_of_a_support_the_part_along_its_direction_counts(bar, direction):
    scene, x, end = bar
    d = np.array(direction, float) / np.linalg.norm(direction)
    held = reaction(scene, x, 1.0, Fixed(end, direction))
    assert held.force == approx(-(0.5 * PULL @ d) * d, abs=1e-9)


def test_where_nothing_is_held_nothing_reacts(bar):
    scene, x, _ = bar
    free = np.flatnonzero(scene.body.nodes[:, 0] > 0.5)
    held = reaction(scene, x, 1.0, free)
    assert held.force == approx(np.zeros(3), abs=1e-9)
    assert held.moment == approx(np.zeros(3), abs=1e-9)
