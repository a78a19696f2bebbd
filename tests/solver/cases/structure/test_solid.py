"""Structures as solids: their mesh, and that two panels do what a unit does."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from proofs import prove

from solver.cases.structure import path, sheet, solid
from solver.cases.structure.hinges import Layer
from solver.cases.structure.parts import Structure
from solver.cases.structure.path import Ending, fold
from solver.cases.structure.pattern import Crease, Pattern
from solver.cases.unit.choices import Meshing, Physics, Supports
from solver.cases.unit.model import build as unit_model
from solver.cases.unit.path import fold as unit_fold
from solver.cases.unit.unit import Unit

pytest.importorskip("gmsh")

UNIT = Unit(
    E_ratio=0.1, rho_ratio=1.0, hinge_length=0.3, hinge_width=1.0, h_ratio=1.5,
    stiffness_to_weight=2.0, aspect=0.3, slenderness=0.02, contraction=0.1,
)  # fmt: skip
SHEET = Layer(1.0, 1.0, UNIT.slenderness)
LAYER = Layer(UNIT.E_ratio, UNIT.rho_ratio, UNIT.active, UNIT.contraction)
# Γ = E h² / (ρ g l³) of a sheet one long.
G = UNIT.slenderness**2 / UNIT.stiffness_to_weight


def strip(*creases, long=1.0, wide=UNIT.aspect):
    """Panels in a row, parted by creases (place, fold, start, end)."""
    places = [0.0, *(c[0] for c in creases), long]
    X = [(x, y) for x in places for y in (0.0, wide)]
    faces = [(2 * k, 2 * k + 2, 2 * k + 3, 2 * k + 1) for k in range(len(places) - 1)]
    folds = [
        Crease((2 * k, 2 * k + 1), fold, UNIT.hinge_length / len(creases), *when)
        for k, (_, fold, *when) in enumerate(creases, 1)
    ]
    return Pattern(np.array(X), faces, folds)


def made(pattern, layer=LAYER):
    return Structure.of(pattern, SHEET, layer, g=G)


def vertex():
    """Four unequal panels about a point."""
    X = [(0, 0), (1, 0), (0.4, 0.9), (-0.8, 0.5), (0.3, -0.9)]
    faces = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1)]
    creases = [Crease((0, k), -1 if k == 3 else 1, 0.06) for k in (1, 2, 3, 4)]
    return Pattern(np.array(X), faces, creases)


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("pattern", [strip((0.5, 1)), strip((0.3, 1), (0.7, -1)), vertex()])
def test_a_mesh_fills_what_is_drawn(pattern, level):
    structure = made(pattern, [LAYER, None, LAYER, LAYER][: len(pattern.creases)])
    grid = sheet.mesh(structure, level)
    X = grid.body.nodes
    volume, extent = grid.body.weights.sum(axis=1), pattern.extent
    for k, outline in enumerate(pattern.panels):
        a, b = outline, np.roll(outline, -1, axis=0)
        area = ((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()) / 2
        assert volume[grid.panel == k].sum() == pytest.approx(area * SHEET.h / extent**3)
        centre = outline.mean(axis=0) / extent
        (there,) = grid.at(k, centre[None]) @ X
        assert there == pytest.approx([*centre, 0.0], abs=1e-12)
        with pytest.raises(ValueError, match=f"outside of panel {k}"):
            grid.at(k, centre[None] + 3)
    for k, (hinge, own) in enumerate(zip(pattern.hinges, structure.layers, strict=True)):
        area = hinge.width * hinge.crease.length / extent**3
        strip_ = grid.hinge == k
        assert volume[strip_ & ~grid.active].sum() == pytest.approx(area * SHEET.h)
        layer = strip_ & grid.active
        assert volume[layer].sum() == pytest.approx(0 if own is None else area * own.h)
        if own is not None:
            assert (np.sign(X[grid.body.cells[layer]][..., 2].mean()) == hinge.crease.fold).all()


def test_rows_are_finer_where_layers_end():
    structure = made(strip((0.5, 1)))
    grid = sheet.mesh(structure, 1)
    x = np.unique(np.round(grid.body.nodes[grid.body.cells[grid.active]][..., 0], 9))
    steps = 2 * np.diff(x)[::2]  # hex27 has a node in the middle
    assert [steps[0], steps[-1]] == pytest.approx([steps.min()] * 2)
    assert steps[0] < 0.5 * UNIT.slenderness and steps.max() > 3 * steps[0]


def test_a_level_that_is_not_there():
    with pytest.raises(ValueError, match="level 7"):
        sheet.mesh(made(strip((0.5, 1))), 7)


def turning(model, folding):
    """Net turning of the middle line of a row of two panels, rad."""
    u = folding.model.scene.displacement(folding.x, folding.last.e)
    ends = []
    for panel, (low, high) in enumerate([(0.0, 0.01), (0.99, 1.0)]):
        places = np.array([[low, UNIT.aspect / 2], [high, UNIT.aspect / 2]])
        a, b = model.sheet.at(panel, places) @ (model.body.nodes + u)
        ends.append(np.arctan2(b[2] - a[2], b[0] - a[0]))
    return ends[1] - ends[0]


@pytest.mark.parametrize("effects", [(), ("gravity", "ground")])
def test_two_panels_turn_as_a_unit(effects):
    model = solid.build(made(strip((0.5, 1))), effects, level=1, upright=True)
    folding = fold(model)
    assert folding.ending is Ending.REACHED and folding.last.unstable == 0
    unit = unit_model(UNIT, Meshing(level=1), Physics(effects=effects), Supports())
    t = np.diff(unit_fold(unit).last.curves[0], axis=0)
    angle = np.arctan2(t[-1, 2], t[-1, 1]) - np.arctan2(t[0, 2], t[0, 1])
    # Panels that weigh bend on other meshes than the unit's.
    assert turning(model, folding) == pytest.approx(angle, rel=6e-3 if effects else 2e-3)
    assert angle > 0.3
    if effects:
        # Near the hinge the panels are steeper than at their ends, which hang down.
        assert folding.last.angles[0] > angle + 0.01
        assert -0.1 * SHEET.h <= folding.last.lowest < 0
    else:
        assert folding.last.angles[0] == pytest.approx(angle, rel=3e-3)
        assert folding.last.lowest is None


def test_mountains_and_valleys_fold_in_their_order():
    pattern = strip((0.3, 1, 0.0, 0.5), (0.7, -1, 0.5, 1.0))
    folding = fold(solid.build(made(pattern), (), level=0))
    half = min(folding.states, key=lambda s: abs(s.e - 0.5))
    assert half.e == 0.5
    first, second = half.angles
    assert first > 0.1 and abs(second) < 1e-3
    assert folding.last.angles == pytest.approx([first, -first], rel=1e-3)
    lengths = [np.linalg.norm(np.diff(p[:2], axis=0)) for p in folding.last.panels]
    flat = [np.linalg.norm(np.diff(p[:2], axis=0)) for p in pattern.panels]
    assert lengths == pytest.approx(flat, rel=1e-3)
    a = folding.last.strips[:, 0] - folding.last.strips[:, 1]
    assert np.linalg.norm(a, axis=1) == pytest.approx(pattern.hinges[0].width, rel=1e-3)


def test_a_vertex_folds_with_its_panels_bending():
    structure = made(vertex())
    folding = fold(solid.build(structure, (), level=0, growth="isotropic"))
    assert folding.ending is Ending.REACHED
    assert (np.array([1, 1, -1, 1]) * folding.last.angles > 0).all()


def test_the_centre_of_mass_of_a_flat_sheet():
    model = solid.build(made(strip((0.4, 1))), ())
    centre = model.centre_of_mass(np.zeros_like(model.body.nodes))
    area, own = 1.0 * SHEET.h, LAYER.rho * UNIT.hinge_length * LAYER.h
    z = own * (SHEET.h + LAYER.h) / 2 / (area + own)
    x = (area * 0.5 + own * 0.4) / (area + own)
    assert centre == pytest.approx([x, UNIT.aspect / 2, z])


def test_steps_turn_panels_and_rows_and_come_back():
    model = solid.build(made(strip((0.3, 1), (0.7, -1))), ("gravity", "ground"), level=0)
    rng = np.random.default_rng(0)
    X = model.body.nodes + 1e-3 * rng.standard_normal(model.body.nodes.shape)
    du = 0.02 * rng.standard_normal(X.shape) + np.cross([0.3, -0.5, 0.2], X)
    sections = model.scene.sections
    np.testing.assert_allclose(sections.step(X, X + sections.moved(X, du)), du, atol=1e-10)


@pytest.mark.parametrize(
    "options, told",
    [
        ({"effects": ("gravity",)}, "weight and ground come together"),
        ({"effects": ("friction",)}, "expected some of gravity, ground, contact"),
        ({"growth": "odd"}, "uniaxial or isotropic"),
    ],
)
def test_what_a_solid_does_not_know(options, told):
    with pytest.raises(ValueError, match=told):
        solid.build(made(strip((0.5, 1))), **options)


def test_a_sheet_without_creases_is_told():
    bare = Pattern(np.array([(0, 0), (1, 0), (1, 1), (0, 1)]), [(0, 1, 2, 3)], [])
    with pytest.raises(ValueError, match="no creases"):
        Structure.of(bare, SHEET, LAYER)


def test_cells_of_a_hinge_are_softened_along_what_bends():
    grid = sheet.mesh(made(strip((0.5, 1))), 0)
    for points in grid.body.points()[grid.hinge == 0]:
        counts = [len(np.unique(np.round(points[:, k], 9))) for k in range(3)]
        assert counts == [2, 3, 3]


@pytest.mark.parametrize("level", [0, 1])
def test_places_are_where_they_are_said_to_be(level):
    structure = made(vertex())
    model = solid.build(structure, (), level=level)
    assert np.abs(model.angles(np.zeros(model.scene.size), 0.0)).max() < 1e-9
    rng = np.random.default_rng(0)
    for k, outline in enumerate(structure.pattern.panels):
        weights = rng.dirichlet(np.ones(len(outline)), 60)
        places = weights @ outline / structure.pattern.extent
        there = model.sheet.at(k, places) @ model.body.nodes
        np.testing.assert_allclose(there[:, :2], places, atol=1e-9)
        np.testing.assert_allclose(there[:, 2], 0, atol=1e-12)


def closing(model, shift):
    """The second of two panels turned over the first, in units of the pattern's extent."""
    X, u = model.body.nodes, np.zeros_like(model.body.nodes)
    own = np.unique(model.body.cells[model.sheet.panel == 1])
    c, s = np.cos(np.pi - 0.05), np.sin(np.pi - 0.05)
    askew = np.array([[0.99, -0.141, 0], [0.141, 0.99, 0], [0, 0, 1]])
    u[own] = X[own] @ (askew @ [[c, 0, -s], [0, 1, 0], [s, 0, c]]).T + shift - X[own]
    return u + 1e-4 * np.random.default_rng(3).standard_normal(u.shape)


def test_the_middle_surface_is_the_panels():
    structure = made(vertex())
    grid = sheet.mesh(structure, 1)
    corners, panels, faces = grid.middle()
    X = corners @ grid.body.nodes
    assert np.abs(X[:, 2]).max() < 1e-12 and len(np.unique(faces)) == len(X)
    assert (panels[faces] == panels[faces[:, :1]]).all()
    a, b = X[faces[:, 1]] - X[faces[:, 0]], X[faces[:, 2]] - X[faces[:, 0]]
    area = np.abs(np.cross(a, b)[:, 2]) / 2
    for k, outline in enumerate(structure.pattern.panels):
        p, q = outline, np.roll(outline, -1, axis=0)
        drawn = (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum() / 2
        own = panels[faces[:, 0]] == k
        assert area[own].sum() == pytest.approx(drawn / structure.pattern.extent**2)


def test_contact_of_a_solid_has_a_potential_and_a_tangent_without_what_it_takes_away():
    model = solid.build(made(strip((0.5, 1))), ("contact",), level=0)
    u = closing(model, (0.72, 0.004, -0.004))
    touch = model.contact.moved(u)
    assert 0 < touch.distance(u) < touch.gap and touch.moved(u).graph is touch.graph
    assert model.contact.distance(0 * u) == np.inf and model.contact.moved(0 * u) is not touch
    prove(touch, u, 0.0, step=1e-8, rtol=1e-5)
    own = touch.evaluate(u, 0.0).stiffness
    nodes = np.flatnonzero(np.abs(touch.evaluate(u, 0.0, 1).force).sum(axis=1))
    lowest = []
    for blocks in (own, own + touch.under((), u, 0.0)):
        rows = [
            sp.csr_array((blocks[:, i, j], touch.graph.indices, touch.graph.indptr))[nodes][
                :, nodes
            ]
            for i in range(3)
            for j in range(3)
        ]
        K = np.block([[rows[3 * i + j].toarray() for j in range(3)] for i in range(3)])
        values = np.linalg.eigvalsh((K + K.T) / 2)
        lowest.append(values[0] / values[-1])
    assert lowest[0] < -1e-6 and lowest[1] > -1e-12


def strong():
    """A strip whose layer would turn it by 222° if its panels passed through each other."""
    layer = replace(LAYER, E=1.0, h=0.02, contraction=0.35)
    return solid.build(replace(made(strip((0.5, 1)), layer), g=0.0), ("contact",), level=0)


def test_panels_press_on_each_other_and_bend():
    folding = fold(strong(), meet=False)
    assert folding.ending is Ending.REACHED and folding.last.unstable == 0
    met = next(s.angles[0] for s in folding.states if np.isfinite(s.clearance))
    assert np.radians(196) < met < np.radians(203)
    # Near the hinge they turn on, as they bend.
    assert folding.last.angles[0] == pytest.approx(np.radians(211.6), abs=0.02)
    assert 0 < folding.last.clearance < 0.02


def test_a_sheet_that_closes_stops_where_its_panels_meet(monkeypatch):
    steps = path.LoadSteps
    monkeypatch.setattr(path, "LoadSteps", lambda **k: steps(**k | {"max_iterations": 4}))
    folding = fold(strong(), meet=False)
    assert folding.ending is Ending.STOPPED and "panels met" in folding.detail
    assert np.radians(190) < folding.last.angles[0] < np.radians(202) and 0.85 < folding.last.e < 1


def test_without_contact_a_path_asks_no_panels(monkeypatch):
    monkeypatch.setattr(path, "_straight", None)
    model = solid.build(made(strip((0.5, 1))), (), level=0)
    assert fold(model, meet=False).ending is Ending.REACHED
