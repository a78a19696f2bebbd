"""What panels touch: proofs by differences, gaps that are kept, steps that are cut."""

from dataclasses import replace

import numpy as np
import pytest
from crease_patterns import folded, structure, two_panels
from proofs import prove
from pytest import approx

from solver.cases.structure.model import build, held
from solver.equilibrium.at_load import Mixed

H = 4e-3


@pytest.fixture(scope="module")
def model():
    """Two panels that touch each other, without weight: four nodes each."""
    return build(structure(two_panels()), ("contact",))


@pytest.fixture(scope="module")
def heavy():
    """Two stiff panels on the ground, and the middle line of their hinge."""
    return build(structure(two_panels()))


def above(model, angle, shift, noise=1e-4):
    """The second panel turned over the first one."""
    X, u = model.body.nodes, np.zeros((8, 3))
    c, s = np.cos(angle), np.sin(angle)
    u[4:] = X[4:] @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]).T + shift - X[4:]
    return u + noise * np.random.default_rng(3).standard_normal((8, 3))


def test_contact_has_a_potential(model):
    u = above(model, np.pi - 0.05, (-0.2, 0.013, 0.0015))
    touch = model.contact.moved(u)
    assert 0 < touch.distance(u) < H
    prove(touch, u, 0.0, step=1e-7, rtol=1e-5)


def test_contact_is_the_same_each_time(model):
    import ipctk

    assert model.contact is not None and ipctk.get_num_threads() == 1


def test_ground_has_a_potential(heavy):
    u, up = np.zeros((12, 3)), np.array([0, 0, H])
    u[:, 2] = 0.3e-4 * np.random.default_rng(0).standard_normal(12)
    prove(heavy.ground, u, 0.0, step=1e-7, rtol=1e-6)
    assert heavy.ground.evaluate(u - up, 0.0, 0).energy == np.inf
    assert heavy.ground.evaluate(u + up, 0.0, 0).energy == 0


def test_a_point_rests_at_the_height_under_its_force(heavy):
    weight = heavy.parts.mass.sum() * heavy.structure.g
    force = heavy.ground.evaluate(np.zeros((12, 3)), 0.0, 1).force
    # Eight corners and the ends of the middle line, each with a third.
    assert -force[:, 2].sum() == approx(10 * weight / 3)
    assert heavy.ground.heights(np.full((12, 3), 0.01)) == approx(0.01)


def test_panels_do_not_pass_through_each_other_in_a_step(model):
    over = above(model, np.pi - 0.05, (-0.2, 0.013, 0.05))
    down = np.zeros((8, 3))
    down[4:, 2] = -0.1
    fraction = model.contact.longest_step(over, down)
    assert 0.1 < fraction < 0.5
    assert model.contact.moved(over).distance(over + fraction * down) > 0
    assert model.contact.longest_step(over, -down) == 1.0
    assert model.contact.evaluate(over + 1.3 * fraction * down, 0.0, 0).energy == np.inf


def test_the_ground_is_kept_in_a_step(heavy):
    down = np.zeros((12, 3))
    down[:, 2] = -1.0
    fraction = heavy.ground.longest_step(np.zeros((12, 3)), down)
    assert fraction == approx(0.9 * 0.1 * H)
    assert heavy.ground.longest_step(np.zeros((12, 3)), -down) == 1.0


def test_stiffness_is_kept_ready_for_panels_that_are_near(model):
    far = above(model, 0.0, (5.0, 0, 0))
    near = above(model, np.pi - 0.05, (-0.2, 0.013, 0.0015))
    assert model.contact.moved(far).graph.blocks == 8
    assert model.contact.moved(near).graph.blocks == 64


def test_a_unit_closes_until_its_panels_touch():
    open_, met = (
        folded(two_panels(), 3.6, length=0.2, effects=effects, upright=True)
        for effects in (("gravity", "ground"), ("gravity", "ground", "contact"))
    )
    assert open_.last.angles == approx(3.6, abs=0.02)
    # Tips of panels of 0.4 meet beyond a half-turn, a thickness apart.
    assert 3.3 < met.last.angles[0] < 3.5
    assert 0 < met.last.clearance < H
    assert open_.last.clearance is None


def test_panels_that_are_too_close_already_are_not_told_on_the_standard_output(model, capfd):
    u = above(model, np.pi - 0.05, (-0.2, 0.013, 0.0015))
    into = u.copy()
    into[4:, 2] -= model.contact.distance(u) + 0.5 * model.contact.gap
    assert model.contact.longest_step(into, u - into) == 0.0
    assert capfd.readouterr() == ("", "")


def test_far_from_a_solution_contact_takes_nothing_from_the_tangent(model):
    # Corners of one panel a hair from an edge of the other one push it by far too much.
    u = above(model, np.pi - 0.05, (-0.2, 0.013, 0.0002), noise=0.0)
    near = replace(model, contact=model.contact.moved(u))
    terms = [near.contact if t.name == "contact" else t for t in model.scene.terms]
    scene = held(near, terms, u)
    x = scene.unknowns(u)
    guided = Mixed(scene, 0.0, 1e-8)
    own, other = scene.system(x, 0.0).unstable, guided.linearise(x).system.unstable
    assert own > other and not guided.plain
    # Where nothing touches, nothing is looked at a second time.
    apart = np.zeros(scene.size)
    assert scene.convex(apart, 0.0) is None and scene.convex(x, 0.0) == [None, None, ()]
    guided = Mixed(scene, 0.0, 1e-8)
    guided.linearise(apart)
    assert guided.plain
