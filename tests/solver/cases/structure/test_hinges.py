"""Hinges: proofs by differences, beams as closed forms, and laws of sections."""

import numpy as np
import pytest
import scipy.sparse as sp
import skfem
from crease_patterns import two_panels
from proofs import prove
from pytest import approx

from solver.cases.structure.hinges import Hinges, Law, Layer, point_weights
from solver.cases.structure.linked import Linked
from solver.mesh.body import Body

LENGTH, WIDTH = 0.2, 0.2
SHEET, LAYER = Layer(1e6, 1, 0.01), Layer(0.5e6, 1, 0.01, 0.1)


@pytest.fixture(scope="module")
def hinge():
    """One hinge between two panels, each a tetrahedron of nodes."""
    pattern = two_panels(LENGTH, width=WIDTH)
    centres = np.array([[-0.3, 0, 0], [0.3, 0, 0]])
    nodes = np.concatenate([c + np.vstack([np.zeros(3), 0.1 * np.eye(3)]) for c in centres])
    mesh = skfem.MeshTet1(nodes.T, np.arange(8).reshape(2, 4).T)
    body = Body.build(mesh, "tet4", parts=True)
    law = Law.of_section(SHEET, LAYER, LENGTH, WIDTH)
    return Hinges(body, pattern.hinges, [law])


def about_y(angle):
    """Rotation that lifts what lies on +x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


def turned(hinge, angle, shift=(0, 0, 0)):
    """Displacement of the second panel turned by an angle about the first one's side."""
    X, u = hinge.body.nodes, np.zeros((8, 3))
    side = np.array([LENGTH / 2, 0, 0])
    u[4:] = side + (X[4:] - side) @ about_y(angle).T + shift - X[4:]
    return u


@pytest.mark.parametrize("angle", [0.0, 2.0, -2.5])
def test_energy_force_and_stiffness_belong_together(hinge, angle):
    rng = np.random.default_rng(0)
    u = turned(hinge, angle) + 0.01 * rng.standard_normal((8, 3))
    prove(hinge, u, 0.7, rtol=1e-6)


def test_angles_are_positive_where_panels_rise_and_go_on_beyond_a_half_turn(hinge):
    assert hinge.angles(turned(hinge, 0.3)) == approx(0.3)
    near = hinge.moved(turned(hinge, 3.0))
    assert near.angles(turned(hinge, 3.4)) == approx(3.4)
    assert hinge.angles(turned(hinge, 3.4)) == approx(3.4 - 2 * np.pi)


def test_an_arc_has_the_energy_of_its_bending_alone(hinge):
    law = hinge.laws[0]
    for angle in (0.5, 2.8):
        # End of an arc of length l: its chord stands at half of the angle.
        chord = LENGTH * np.sin(angle / 2) / (angle / 2)
        at = chord * np.array([np.cos(angle / 2), 0, np.sin(angle / 2)])
        u = turned(hinge, angle, at - [LENGTH, 0, 0])
        energy = hinge.evaluate(u, 0.0, 0).energy
        assert energy == approx(law.stiffness[0] * angle**2 / 2, rel=1e-9)


def test_an_end_that_is_sheared_off_bears_as_a_clamped_beam(hinge):
    law, w = hinge.laws[0], 1e-5
    energy = hinge.evaluate(turned(hinge, 0.0, (0, 0, w)), 0.0, 0).energy
    # 12 B w/l³ with k = B w/l
    assert energy == approx(12 * law.stiffness[0] / LENGTH**2 * w**2 / 2, rel=1e-6)


def test_twist_shears_the_fibres_of_a_strip_as_far_as_they_lie_off_its_middle(hinge):
    # About x: a plate's torsion 2 (1 − ν) B w/l, and Σ 12 B y²/l³ over the width.
    law, t = hinge.laws[0], 1e-5
    X, u = hinge.body.nodes, np.zeros((8, 3))
    u[4:] = t * np.cross([1.0, 0, 0], X[4:])
    energy = hinge.evaluate(u, 0.0, 0).energy
    expected = law.stiffness[0] * (1.4 + 12 * WIDTH**2 / 12 / LENGTH**2)
    assert energy == approx(expected * t**2 / 2, rel=1e-5)


def test_stiffness_in_the_plane(hinge):
    law, d = hinge.laws[0], 1e-6
    stretching = 1e6 * (0.01 + 0.5 * 0.01) * WIDTH / 0.91
    pulled = hinge.evaluate(turned(hinge, 0.0, (d, 0, 0)), 0.0, 0).energy
    assert pulled == approx(stretching / LENGTH * d**2 / 2, rel=1e-6)
    slid = hinge.evaluate(turned(hinge, 0.0, (0, d, 0)), 0.0, 0).energy
    bending = stretching * WIDTH**2 / 12
    shearing = 5 / 6 * stretching * 0.35
    beam = 1 / (LENGTH**3 / (12 * bending) + LENGTH / shearing)
    assert slid == approx(beam * d**2 / 2, rel=1e-6)
    X, u = hinge.body.nodes, np.zeros((8, 3))
    u[4:] = d * np.cross([0, 0, 1.0], X[4:])
    assert hinge.evaluate(u, 0.0, 0).energy == approx(bending / LENGTH * d**2 / 2, rel=1e-5)
    assert law.length == LENGTH


def test_a_law_is_timoshenkos_for_small_contractions():
    m, n, c, h = 0.7, 0.3, 1e-4, 0.01
    law = Law.of_section(Layer(1, 1, h), Layer(n, 1, m * h, c), LENGTH, WIDTH)
    factor = 6 * (1 + m) / (3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n)))
    assert law.angle[-1] == approx(factor * c / h * LENGTH, rel=1e-3)
    assert law.at(0.5)[0] == approx(law.angle[-1] / 2, rel=1e-3)
    # Of equal layers: a plate of twice the thickness.
    plain = Law.of_section(Layer(1, 1, h), Layer(1, 1, h, 0.0), LENGTH, WIDTH)
    assert plain.stiffness[0] == approx((2 * h) ** 3 / 12 / 0.91 * WIDTH / LENGTH, rel=1e-6)
    assert plain.angle[-1] == 0


def test_two_halves_in_a_row_give_way_as_the_whole_does():
    whole = Law.of_section(SHEET, LAYER, LENGTH, WIDTH)
    half = whole.half
    np.testing.assert_allclose(2 * half.angle, whole.angle)
    np.testing.assert_allclose(half.stretch * half.length * 2, whole.stretch * whole.length)
    bend, in_plane, twist, _, pull, _ = range(6)
    each, all_ = (np.array(law.stiffnesses(law.stiffness[0])) for law in (half, whole))
    for k in (bend, in_plane, twist, pull):
        assert each[k] == approx(2 * all_[k])
    # Sheared across, the line between is free to turn: half of the way each, and the moment's turn.
    F, l_half = 1.0, LENGTH / 2
    shift = 2 * F / each[5] + 2 * (F * l_half / 2) / each[bend] * l_half / 2
    assert shift == approx(F / all_[5])


def test_creases_contract_between_their_loads_and_to_their_side():
    for fold, start, end in ((1, 0.0, 1.0), (-1, 0.25, 0.75), (0, 0.0, 1.0)):
        pattern = two_panels(LENGTH, width=WIDTH, fold=fold, start=start, end=end)
        centres = [[-0.3, 0, 0], [0.3, 0, 0]]
        nodes = np.concatenate([c + np.vstack([np.zeros(3), 0.1 * np.eye(3)]) for c in centres])
        mesh = skfem.MeshTet1(nodes.T, np.arange(8).reshape(2, 4).T)
        law = Law.of_section(SHEET, LAYER, LENGTH, WIDTH)
        term = Hinges(Body.build(mesh, "tet4", parts=True), pattern.hinges, [law])
        for e in (0.0, 0.25, 0.5, 1.0):
            on = min(max((e - start) / (end - start), 0), 1)
            expected = fold * law.at(on)[0]
            flat = term.evaluate(np.zeros((8, 3)), e, 0).energy
            stretch = LENGTH * (1 - law.at(on if fold else 0)[2])
            stiff = law.at(on if fold else 0)[1]
            membrane = law.stretching / LENGTH * stretch**2 / 2
            assert flat == approx(stiff * expected**2 / 2 + membrane, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("change", [{"E": 0.0}, {"rho": -1.0}, {"h": 0.0}, {"contraction": 0.95}])
def test_what_is_no_layer_is_told(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        Layer(**({"E": 1.0, "rho": 1.0, "h": 1.0} | change))


def test_a_layer_that_is_crushed_is_told():
    with pytest.raises(ValueError, match="no natural state"):
        Law.of_section(Layer(1, 1, 0.01), Layer(1, 1, 0.01, 0.9), LENGTH, WIDTH)


def test_steps_turn_panels_about_their_hinges_and_back(hinge):
    (own,) = hinge.hinges
    places = [np.array([*side, 0]) for side in own.sides]
    sides = []
    for k in own.faces:
        weights = np.zeros((1, 8))
        weights[0, 4 * k : 4 * k + 4] = point_weights(hinge.body, k, places[k])
        sides.append(sp.csr_array(weights))
    for pairs in ([[0, 1]], [[1, 0]]):
        ends = tuple(sides if pairs == [[0, 1]] else sides[::-1])
        linked = Linked.of_links(np.repeat([0, 1], 4), np.array(pairs), ends, 0)
        X = hinge.body.nodes + 0.01 * np.random.default_rng(1).standard_normal((8, 3))
        du = 0.003 * np.random.default_rng(2).standard_normal((8, 3))
        du[:4] += np.cross([-0.4, 0.3, 0.8], X[:4])
        du[4:] += np.cross([0.3, 0.9, 0.5], X[4:] - X[5])
        moved = linked.moved(X, du)
        np.testing.assert_allclose(linked.step(X, X + moved), du, atol=1e-12)
        np.testing.assert_allclose(linked.moved(X, 1e-6 * du) / 1e-6, du, atol=1e-5)
        # A turn of the first panel alone carries the other along, without stretching anything.
        only = np.zeros((8, 3))
        only[:4] = np.cross([0.3, 0.9, -0.5], X[:4])
        only[4:] = np.cross([0.3, 0.9, -0.5], X[4:])
        Y = X + linked.moved(X, only)
        lengths = [np.linalg.norm(Z[:, None] - Z[None], axis=-1) for Z in (X, Y)]
        np.testing.assert_allclose(*lengths, atol=1e-12)
