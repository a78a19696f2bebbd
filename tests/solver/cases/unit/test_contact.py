"""Panels that stop at each other: an optional effect, in the mirror plane between them."""

from dataclasses import replace

import numpy as np
import pytest
from folding_units import P
from proofs import BODIES, ELEMENTS, prove, state
from scipy.optimize import brentq

from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource
from solver.cases.unit.choices import Meshing, Physics, Supports
from solver.cases.unit.model import build
from solver.cases.unit.path import Ending, carried, fold, refined
from solver.cases.unit.symmetry import CLASSES, Check, Symmetries
from solver.physics.ground import Ground


@pytest.fixture(scope="module")
def closed():
    return fold(build(P, Meshing(0), Physics(("contact",))))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("element", ELEMENTS)
def test_a_wall_is_a_ground_along_another_axis(element, axis):
    body = BODIES[element]
    side = body.surface(lambda X: X[:, axis] < 1e-9)
    wall = Ground(body, side, thickness=0.8, pressure=3.0, height=-0.5, axis=axis)
    u = state(body, size=0.05)
    u[:, axis] -= wall.gaps(u).min()
    prove(wall, u, 0.0, step=1e-5)
    others = [k for k in range(3) if k != axis]
    assert not wall.evaluate(u, 0.0).force[:, others].any()


@pytest.mark.parametrize("contraction", [0.3, 1e-3])
def test_flush_panels_press_with_the_moment_of_the_hinge(contraction):
    # On the panels' ends B κ, B = E_s h_s³/12, over the arm: h_s² κ/12 per area for an arm of h_s;
    # κ not less than 1.
    unit = replace(P, contraction=contraction)
    contact = build(unit, Meshing(0), Physics(("contact",))).contact
    u = np.zeros_like(contact.body.nodes)
    u[:, 1] = -contact.body.nodes[:, 1]  # every point of a panel is at the plane
    # A quarter of the panels, and the ends of the active layer, which face them.
    area = (0.5 - unit.hinge_length / 2) * unit.aspect / 2
    area += unit.h_ratio * unit.slenderness * unit.hinge_width * unit.aspect / 2
    m, n = unit.h_ratio, unit.E_ratio
    curvature = 6 * (1 + m) / (3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n)))
    curvature *= contraction / unit.slenderness
    pressure = unit.slenderness**2 * max(curvature, 1.0) / 12
    assert -contact.evaluate(u, 0.0).force[:, 1].sum() == pytest.approx(pressure * area, rel=1e-9)


def test_panels_stop_where_rigid_ones_on_an_arc_would_meet(closed):
    # Hinge an arc of length l_i turned by θ, panels straight: their ends meet where
    # (l_i/θ) sin(θ/2) + L cos(θ/2) = 0; the faces do, half a thickness above the middle.
    assert closed.ending is Ending.REACHED
    length = 0.5 - P.hinge_length / 2
    meet = brentq(
        lambda t: (P.hinge_length / t - P.slenderness / 2) * np.sin(t / 2) + length * np.cos(t / 2),
        3.0,
        3.6,
    )
    touching = [s.clearance < 0.1 * P.slenderness for s in closed.states]
    first = touching.index(True)
    turned = [_turning(s) for s in closed.states]
    # Contact set in within this step. The turning between the ends falls once they press.
    assert turned[first - 1] < meet * 1.002
    assert turned[first] == pytest.approx(meet, rel=0.02)
    assert all(touching[first:])
    free = fold(build(P, Meshing(0), Physics(())))
    assert _turning(free.last) > 1.1 * meet > 1.05 * _turning(closed.last)
    # No panel is deeper in the other than a tenth of its thickness.
    assert min(s.clearance for s in closed.states) > -0.1 * P.slenderness
    assert closed.last.unstable == 0


def _turning(state):
    t = np.diff(state.curves[0], axis=0)
    return 2 * np.arctan2(t[-1, 2], t[-1, 1]) % (2 * np.pi)


def test_a_closed_state_is_found_again_on_a_finer_mesh(closed):
    fine = refined(closed, 1)
    assert fine is not None
    # Of the thickness: the panels' faces touch on either mesh.
    assert abs(fine.last.clearance - closed.last.clearance) < 0.05 * P.slenderness
    model, x = carried(closed.model, closed.x, 1.0, meshing=Meshing(1))
    assert np.isfinite(model.scene.energy(x, 1.0))


def test_panels_that_move_alike_do_not_feel_each_other(closed):
    # Odd about the plane between them both ends move the same way and keep their distance: the
    # count is that of the same state without contact, while the even class feels it.
    model, x = closed.model, closed.x
    assert not [c for c in closed.last.checks if c.held]
    bare = build(P, Meshing(0), Physics(()))
    stiffness = {
        kept: scene.evaluate(model.scene.displacement(x, 1.0), 1.0).stiffness
        for kept, scene in Symmetries(model)._scenes.items()
    }
    without = {
        kept: scene.evaluate(model.scene.displacement(x, 1.0), 1.0).stiffness
        for kept, scene in Symmetries(bare)._scenes.items()
    }
    for kept, blocks in stiffness.items():
        same = np.array_equal(blocks, without[kept])
        assert same == ("y" not in kept), CLASSES[kept]


def test_a_panel_that_a_mesh_carries_too_deep_is_drawn_back(closed):
    # Both panels pushed 0.2 thicknesses through the plane between them: deeper than the barrier's
    # floor. Each point is drawn back by itself, for panels lean.
    u = closed.model.scene.displacement(closed.x, 1.0)
    depth = closed.model.contact.depth
    panel = closed.model.body.nodes[:, 1] > P.hinge_length / 2
    u[panel, 1] -= 2 * depth
    model, x = carried(closed.model, closed.model.scene.unknowns(u), 1.0, meshing=Meshing(1))
    assert model.clearance(x, 1.0) == pytest.approx(-0.9 * depth)
    assert np.isfinite(model.scene.energy(x, 1.0))
    hinge = model.body.nodes[:, 1] < 0.4 * P.hinge_length
    unmoved = carried(closed.model, closed.x, 1.0, meshing=Meshing(1))[1]
    moved = model.scene.displacement(x, 1.0) - model.scene.displacement(unmoved, 1.0)
    assert np.abs(moved[hinge]).max() < 1e-3 * depth


@pytest.mark.parametrize("contraction", [0.3, 1e-4])
def test_panels_that_just_touch_press_with_the_hinge_s_moment(contraction):
    unit = replace(P, contraction=contraction)
    model = build(unit, Meshing(0), Physics(("contact",)))
    u = np.zeros_like(model.body.nodes)
    u[:, 1] = -model.body.nodes[:, 1]  # every point at the plane
    force = model.contact.evaluate(u, 1.0).force
    # Timoshenko's curvature, or that of a radius l_s where it is less; B = E_s h_s³/12 per width,
    # pressure B κ/h_s; a quarter's panel is (l_s − l_i)/2 long, and the active layer's
    # end, which may touch its image too, h_i high.
    m, n, h = unit.h_ratio, unit.E_ratio, unit.slenderness
    kappa = contraction * 6 * (1 + m) / h
    kappa /= 3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n))
    area = ((1 - unit.hinge_length) / 2 + unit.h_ratio * h) * unit.aspect / 2
    assert -force[:, 1].sum() == pytest.approx(h**2 / 12 * max(kappa, 1.0) * area, rel=1e-6)
    assert not force[:, [0, 2]].any()


def test_contact_is_absent_unless_asked_for(monkeypatch):
    model = build(P, Meshing(0), Physics(()))
    assert model.contact is None and model.effects == ("elastic",)
    assert build(P, Meshing(0), Physics(("contact",))).effects == ("elastic", "contact")
    heavy = build(P, Meshing(0), Physics(("gravity", "ground", "contact")))
    assert heavy.effects == ("elastic", "gravity", "ground", "contact")
    monkeypatch.setattr(Ground, "__init__", lambda *a, **k: pytest.fail("a wall was built"))
    fold(build(replace(P, contraction=0.01), Meshing(0), Physics(())))


def test_contact_needs_the_plane_between_the_panels():
    with pytest.raises(ValueError, match="keep 'y' among the mirrors"):
        build(P, Meshing(0), Physics(("contact",)), Supports(("x",)))


def test_a_unit_that_loses_the_plane_ends_with_that_reason(monkeypatch):
    monkeypatch.setattr(Symmetries, "check", lambda self, x, e: [Check(("x",), int(e > 0.2), 0)])
    found = fold(build(P, Meshing(0), Physics(("contact",))))
    assert found.ending is Ending.APART and found.states
    assert found.last.e < 0.5


def test_the_label_names_the_event():
    design = {name: getattr(P, name) for name in SolverSource().space.names}
    label = SolverSource(Conditions(effects="contact"), Effort(timeout=30)).label(design)
    at = [e["contraction"] for e in label.evidence["events"] if e["kind"] == "contact"]
    assert label.foldable and len(at) == 1 and 0.25 < at[0] < 0.29
    assert label.evidence["m1"] < 3.4 and label.evidence["error_estimate"] < 0.02
