"""Steps that turn sections: what they do to positions, and what that spares Newton's method."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver.cases.unit.choices import Meshing, Physics, Supports
from solver.cases.unit.model import build
from solver.cases.unit.unit import Unit
from solver.equilibrium.at_load import AtLoad
from solver.equilibrium.newton import iterate, newton
from solver.equilibrium.scene import Scene
from solver.equilibrium.sections import FreeSections, Sections
from solver.paths.steppers import LoadSteps

UNIT = Unit(
    E_ratio=0.1, h_ratio=5, slenderness=4e-3, hinge_length=0.25, hinge_width=0.8, aspect=0.2,
    stiffness_to_weight=5, rho_ratio=1, contraction=0.3,
)  # fmt: skip


def weightless(level=0):
    return build(UNIT, Meshing(level), Physics(()))


def bent(X, turn=1.0):
    """A step that turns the ends of |y| ≤ ½ by 2.2 rad, with shear, warping and stretch."""
    x, y, z = X.T
    along = -4.5 * turn * y * z + 0.2 * y**2 + y * z**2
    return np.stack([0.1 * x * y, along, 2.2 * turn * y**2 + x * z + z * y], axis=1)


@pytest.mark.parametrize("grounded", [False, True])
def test_the_step_to_a_state_leads_there(grounded):
    X = build(UNIT, Meshing(0), supports=Supports(())).body.nodes
    sections = Sections.across(X, grounded=grounded)
    du = bent(X)
    moved = sections.moved(X, du)
    assert np.abs(moved - du).max() > 0.2
    assert sections.step(X, X + moved) == pytest.approx(du, abs=1e-13)
    # From a bent state as well, and where ends turn by more than π.
    further = sections.moved(X + moved, 0.8 * du)
    assert sections.step(X + moved, X + moved + further) == pytest.approx(0.8 * du, abs=1e-13)
    du = bent(X, turn=2.0)
    assert sections.step(X, X + sections.moved(X, du)) == pytest.approx(du, abs=1e-13)


def test_a_step_sets_out_straight():
    X = build(UNIT, Meshing(0), supports=Supports(())).body.nodes
    sections, du = Sections.across(X, grounded=False), bent(X)
    off = [np.abs(sections.moved(X, h * du) - h * du).max() for h in (1e-2, 1e-3)]
    assert off[0] / off[1] == pytest.approx(100, rel=0.02)


def test_a_rigid_turn_stays_rigid_and_stands_where_it_stood():
    X = build(UNIT, Meshing(0), supports=Supports(())).body.nodes
    angle = 2.0
    Y = X + Sections.across(X, grounded=False).moved(X, np.cross([angle, 0, 0], X))
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    assert Y - Y.mean(axis=0) == pytest.approx((X - X.mean(axis=0)) @ R.T, abs=1e-14)
    # Over a ground the lowest node comes to be as high as by the straight step.
    tilted = X + np.stack([0 * X[:, 0], 0 * X[:, 0], 0.1 * X[:, 1]], axis=1)
    step = np.cross([angle, 0, 0], tilted)
    moved = Sections.across(X, grounded=True).moved(tilted, step)
    low = (tilted + step)[:, 2].min()
    assert (tilted + moved)[:, 2].min() == pytest.approx(low, abs=1e-14)


def test_mirror_planes_hold_what_they_held():
    model = weightless()
    scene, nodes = model.scene, model.body.nodes
    dx = scene.unknowns(bent(nodes))
    x = scene.moved(np.zeros(scene.size), dx, 0.0)
    free = scene.sections.moved(nodes, scene.step_displacement(dx))
    assert scene.displacement(x, 0.0) == pytest.approx(free, abs=1e-14)
    assert scene.way(np.zeros(scene.size), x, 0.0) == pytest.approx(dx, abs=1e-13)


def test_a_thin_sheet_bends_in_a_few_iterations():
    # Straight steps that guess no stresses take 41 for this, and 70 for twice the load.
    scene = weightless().scene
    straight = Scene(scene.body, scene.terms, scales=scene.scales, frame=scene.frame)
    start = np.zeros(scene.size)
    turning, same = (
        iterate(AtLoad(it, 0.1, 0), start, rtol=1e-8, max_iterations=100)
        for it in (scene, straight)
    )
    assert turning.converged and turning.iterations <= 8
    assert same.iterations > 4 * turning.iterations
    assert turning.x == pytest.approx(same.x, abs=1e-8)
    assert newton(scene, start, 0.2, rtol=1e-8, unstable=0).iterations <= 8


def test_predictions_follow_the_turning():
    # A hinge that bends evenly, in the coordinates of turns, is a straight line in the load.
    scene = weightless().scene
    guesses = {}
    for name in ("turning", "straight"):
        used = scene
        if name == "straight":
            used = Scene(scene.body, scene.terms, scales=scene.scales, frame=scene.frame)
        stepper = LoadSteps(rtol=1e-9, step=0.1, first=1.0, order=3)
        point = stepper.begin(scene, np.zeros(scene.size), 0.0, 1.0)
        for _ in range(2):
            point = stepper.advance(scene, point, None)
        guesses[name] = np.abs(used.residual(stepper.guess(used, point, 0.4), 0.4)).max()
    assert guesses["turning"] < 0.1 * guesses["straight"]


def twisted(X, turn=1.0):
    """A step that bends, twists and sways: its ends turn by some 2 rad about three axes."""
    x, y, z = X.T
    w = turn * np.stack([2.0 * y, 3.0 * y**2, 1.0 * y], axis=1)
    sway = np.stack([0.1 * y**2, 0.1 * x * y, 0.2 * y**2 + x * z], axis=1)
    return np.cross(w, X) + sway


FREE = {"any": (0, 1, 2), "about x": (0,)}


@pytest.mark.parametrize("grounded", [False, True])
@pytest.mark.parametrize("about", FREE.values(), ids=FREE)
def test_the_step_to_a_twisted_state_leads_there(grounded, about):
    X = build(UNIT, Meshing(0), supports=Supports(())).body.nodes
    sections = FreeSections.across(X, grounded=grounded, about=about)
    du = twisted(X)
    moved = sections.moved(X, du)
    assert np.abs(moved - du).max() > 0.1
    assert sections.step(X, X + moved) == pytest.approx(du, abs=1e-12)
    further = sections.moved(X + moved, 0.8 * du)
    assert sections.step(X + moved, X + moved + further) == pytest.approx(0.8 * du, abs=1e-12)
    # Ends that turn by more than π.
    du = twisted(X, turn=4.0)
    assert sections.step(X, X + sections.moved(X, du)) == pytest.approx(du, abs=1e-12)


def test_sections_that_may_turn_about_any_axis_set_out_straight():
    X = build(UNIT, Meshing(0), supports=Supports(())).body.nodes
    sections, du = FreeSections.across(X, grounded=False), twisted(X)
    off = [np.abs(sections.moved(X, h * du) - h * du).max() for h in (1e-2, 1e-3)]
    assert off[0] / off[1] == pytest.approx(100, rel=0.02)


@pytest.mark.parametrize("grounded", [False, True])
def test_turns_about_one_axis_are_those_of_sections_in_a_plane(grounded):
    X = build(UNIT, Meshing(0)).body.nodes
    du = bent(X)
    plain = Sections.across(X, grounded=grounded)
    free = FreeSections.across(X, grounded=grounded, about=(0,))
    # Those that stay in their plane keep their x straight, and so do these.
    assert free.moved(X, du) == pytest.approx(plain.moved(X, du), abs=1e-14)
    assert free.step(X, X + du) == pytest.approx(plain.step(X, X + du), abs=1e-14)


def test_any_rigid_turn_stays_rigid_and_stands_where_it_stood():
    X = build(UNIT, Meshing(0), supports=Supports(())).body.nodes
    w = np.array([1.5, -0.8, 0.6])
    moved = FreeSections.across(X, grounded=False).moved(X, np.cross(w, X))
    R = Rotation.from_rotvec(w).as_matrix()
    middle = X[np.abs(X[:, 1]) < 1e-9].mean(axis=0)
    expected = (X - middle) @ R.T + middle + np.cross(w, middle)
    assert X + moved == pytest.approx(expected, abs=1e-13)
    moved = FreeSections.across(X, grounded=True).moved(X, np.cross(w, X))
    low = (X + np.cross(w, X))[:, 2].min()
    assert (X + moved)[:, 2].min() == pytest.approx(low, abs=1e-14)


@pytest.mark.parametrize("mirrors", [("turn",), ("y",), ("x",), ()])
def test_a_thin_sheet_without_both_mirror_planes_bends_in_a_few_iterations(mirrors):
    # Straight steps take 36 for this.
    model = build(UNIT, Meshing(0, curls=True), Physics(()), Supports(mirrors))
    quarter = build(UNIT, Meshing(0, curls=True), Physics(()))
    found = newton(model.scene, np.zeros(model.scene.size), 0.1, rtol=1e-8, unstable=0)
    assert found.converged and found.iterations <= 8
    same = newton(quarter.scene, np.zeros(quarter.scene.size), 0.1, rtol=1e-8, unstable=0)
    share = 4 if mirrors == () else 2
    assert found.system.energy == pytest.approx(share * same.system.energy, rel=1e-8)
