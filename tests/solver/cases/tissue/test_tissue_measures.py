"""Patterns, measures and supports of furrow and neural tube, on displacements made by hand."""

from itertools import pairwise

import numpy as np
import pytest
import skfem
from pytest import approx

from solver.cases.tissue import furrow, neural_tube
from solver.cases.tissue.model import Tissue, evaluated, ramp
from solver.mesh.structured import box


@pytest.fixture(scope="module")
def shell():
    return furrow.build(furrow.Counts(3, 4, 4, 1), element="hex20", contraction=0.5)


@pytest.fixture(scope="module")
def plate():
    return neural_tube.build(neural_tube.Counts(12, 4, 1), element="hex20", contraction=0.4)


# -- furrow --------------------------------------------------------------------------------------


@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.5, 1.0])
def test_the_furrows_pattern_falls_off_around_along_and_inwards(fraction):
    shape = furrow.Shape(long=1.2, across=0.5, thickness=0.1, angle=0.4, reach=0.7)
    d = np.array([[0.0, 0.0, -1.0], [0.3, 0.2, -0.8], [0.3, -0.2, -0.8], [0.0, 0.6, 0.8]])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    X = shape.place(np.full(4, fraction), d)
    assert shape.depth(X) == approx(np.full(4, fraction), abs=1e-9)
    around = np.arctan2(np.abs(X[:, 1]), -X[:, 2])
    wanted = np.exp(-((around / 0.4) ** 2) - (X[:, 0] / 0.7) ** 4) * fraction**2
    assert shape.beta(X) == approx(wanted, rel=1e-7, abs=1e-12)
    assert shape.beta(X)[1] == approx(shape.beta(X)[2]) and around[3] > np.pi / 2
    # Semi-axes less what lies outside of the fraction.
    assert X[0, 2] == approx(-(0.5 - 0.1 * (1 - fraction)))
    on_x = shape.place(np.array([fraction]), np.array([[1.0, 0.0, 0.0]]))
    assert on_x[0, 0] == approx(1.2 - 0.1 * (1 - fraction))


def test_beyond_the_shell_the_pattern_is_that_of_its_surfaces():
    shape = furrow.Shape()
    assert shape.beta(np.array([0.0, 0.0, -0.5])) == approx(1.0)
    assert shape.beta(np.array([0.0, 0.0, -0.3])) == approx(0.0, abs=1e-12)


def test_a_furrow_is_as_deep_as_its_midline_lies_inside_of_the_ridges(shell):
    X = shell.body.nodes
    rim = shell._sides[2]
    # From the midline on, on the outer side of the ventral half.
    assert X[rim[0]] == approx([0, 0, -0.4], abs=1e-9)
    assert np.hypot(X[rim, 1], X[rim, 2]) == approx(np.full(len(rim), 0.4), abs=1e-6)
    assert (np.diff(X[rim, 1]) > 0).all() and (X[rim, 2] < 0).all()
    u = np.zeros_like(X)
    u[rim[0], 2] = 0.1
    found = shell.measure(u)
    assert found.indentation == approx(0.1)
    assert found.depth == approx(-0.3 - X[rim[1], 2])
    # What bulges out is no furrow.
    assert shell.measure(-u).depth == 0 and shell.measure(-u).indentation == approx(-0.1)


def test_volumes_are_of_the_whole_embryo(shell):
    X = shell.body.nodes
    still, larger = shell.measure(0 * X), shell.measure(0.1 * X)
    assert larger.cavity == approx(1.1**3 * still.cavity)
    assert larger.tissue == approx(1.1**3 * still.tissue)
    assert larger.depth == approx(0, abs=1e-12) and larger.indentation == approx(-0.04)
    assert still.cavity > still.tissue > 0


def test_a_quarter_embryo_is_held_by_its_mirrors_and_one_point_alone(shell):
    X = shell.body.nodes
    along, across, dorsal = shell.fixed
    assert np.abs(X[along.nodes, 0]).max() < 1e-9 and np.allclose(along.direction, [1, 0, 0])
    assert np.abs(X[across.nodes, 1]).max() < 1e-9 and np.allclose(across.direction, [0, 1, 0])
    assert len(along.nodes) == (np.abs(X[:, 0]) < 1e-9).sum()
    assert X[dorsal.nodes] == approx(np.array([[0, 0, 0.4]]), abs=1e-9)
    assert np.allclose(dorsal.direction, [0, 0, 1])


def test_growth_contracts_by_the_pattern_and_the_load(shell):
    body = shell.body
    inverse, volume = shell.growth().evaluate(0.5, body.weights.shape, body.points)
    stretch = 1 / (1 + 0.5 * 0.5 * np.broadcast_to(shell.beta, body.weights.shape))
    assert inverse == approx(np.eye(3) / stretch[..., None, None])
    assert volume == approx(stretch**3)


def test_levels_are_finer_and_finer():
    for case in (furrow, neural_tube):
        counts = [np.array(list(vars(level).values())) for level in case.LEVELS]
        for coarse, fine in pairwise(counts):
            assert (fine >= coarse).all() and (fine > coarse).any()


# -- neural tube ---------------------------------------------------------------------------------


def at(x, angle, r):
    return np.array([x, -r * np.cos(angle), r * np.sin(angle)])


@pytest.mark.parametrize(
    ("X", "beta"),
    [
        (at(4.0, 0.9, 0.925), 1.0),
        (at(4.0, -0.9, 0.925), 1.0),
        (at(0.0, 0.9, 0.925), 0.2),
        (at(2.0, 0.9, 0.925), 0.6),
        (at(1.0, 0.9, 0.925), 0.2 + 0.8 * 0.15625),
        (at(4.0, 1.5, 0.925), np.exp(-1)),
        (at(4.0, 0.3, 0.925), np.exp(-1)),
        (at(4.0, 0.9, 1.0), 0.5),
        (at(4.0, 0.9, 1.075), 0.0),
        (at(4.0, 0.9, 1.2), 0.0),
        (at(5.0, 0.9, 0.9), 1.0),
    ],
)
def test_the_tubes_pattern_peaks_along_a_line_on_each_side_and_grows_forwards(X, beta):
    assert neural_tube.Shape().beta(X) == approx(beta, abs=1e-12)


def test_closure_is_the_least_distance_of_the_edges_in_each_third(plate):
    X = plate.body.nodes
    edge = plate.body.nodes_of("edge")
    assert X[edge, 1] == approx(np.zeros(len(edge)), abs=1e-9)
    u = np.zeros_like(X)
    for third, (x, moved) in enumerate(((0.5, 0.1), (2.0, 0.3), (3.5, 0.5))):
        near = edge[np.abs(X[edge, 0] - x) < 0.1]
        assert len(near), third
        u[near, 2] = -moved
    found = plate.measure(u)
    inner = 2 * (1 - 0.075)
    assert found.closure == approx(inner - 1.0) and found.closure_middle == approx(inner - 0.6)
    assert found.closure_posterior == approx(inner - 0.2) and found.closed == 0


def test_edges_are_closed_where_they_are_within_twice_the_gap_of_contact(plate):
    X = plate.body.nodes
    edge = plate.body.nodes_of("edge")
    places = np.unique(X[edge, 0].round(9))
    touching = 2 * neural_tube.TOUCHING * 0.15
    for gap, closed in ((0.99 * touching, True), (1.01 * touching, False)):
        u = np.zeros_like(X)
        front = edge[X[edge, 0] > 3.0 - 1e-9]
        u[front, 2] = gap / 2 - X[front, 2]
        fraction = (places > 3.0 - 1e-9).mean() if closed else 0.0
        assert plate.measure(u).closed == approx(fraction)


def test_the_plates_volume_is_of_both_halves(plate):
    still = plate.measure(np.zeros_like(plate.body.nodes))
    assert still.tissue == approx(2 * plate.body.weights.sum(), rel=1e-6)
    larger = plate.measure(0.1 * plate.body.nodes)
    assert larger.tissue == approx(1.1**3 * still.tissue)


def test_the_plates_contact_is_that_of_its_thickness(plate):
    (touch,) = plate.terms
    assert touch.thickness == 0.15 and touch.name == "contact"
    assert touch.depth == approx(0.05 * 0.15) and touch.axis == 2
    X = plate.body.nodes
    across, foot, feet = plate.fixed
    assert np.abs(X[across.nodes, 2]).max() < 1e-9 and np.allclose(across.direction, [0, 0, 1])
    assert X[foot.nodes] == approx(np.array([[0, -1.075, 0]]), abs=1e-9)
    assert X[feet.nodes] == approx(np.array([[0, -1.075, 0], [4, -1.075, 0]]), abs=1e-9)
    assert np.allclose(foot.direction, [1, 0, 0]) and np.allclose(feet.direction, [0, 1, 0])


# -- both ----------------------------------------------------------------------------------------


def test_a_ramp_is_linear_and_then_held():
    load = ramp(0.5)
    assert [load(t) for t in (0.0, 0.25, 0.5, 2.0)] == [0.0, 0.5, 1.0, 1.0]


def test_slow_tissue_is_its_spring_and_fast_tissue_both():
    tissue = Tissue(E=3.0, E_m=7.0, nu=0.2)
    for material, E in ((tissue.slow(), 3.0), (tissue.fast(), 10.0)):
        lam, mu = material.properties(0.0, (1, 1))[0, 0]
        assert mu == approx(E / 2.4) and lam == approx(E * 0.2 / (1.2 * 0.6))


def test_a_pattern_may_be_nothing_and_all(shell):
    cells, points = shell.body.weights.shape
    for values in (np.zeros(cells), np.ones((cells, points))):
        np.testing.assert_array_equal(evaluated(shell.body, values), values)
    for values in (np.full(cells, -1e-9), np.full(cells, 1 + 1e-9)):
        with pytest.raises(ValueError, match=r"expected values in \[0, 1\]"):
            evaluated(shell.body, values)


@pytest.mark.parametrize(
    ("case", "bad"),
    [
        (furrow, {"thickness": 0.4}), (furrow, {"angle": 0.0}), (furrow, {"long": 0.05}),
        (neural_tube, {"thickness": 1.0}), (neural_tube, {"posterior": 1.01}),
        (neural_tube, {"peak": 0.0}),
    ],
)  # fmt: skip
def test_shapes_at_their_bounds_are_refused(case, bad):
    with pytest.raises(ValueError, match="expected"):
        case.Shape(**bad)
    assert neural_tube.Shape(posterior=1.0).posterior == 1.0


def test_hexahedra_are_split_into_24_tetrahedra_that_fill_them():
    mesh = box([0, 1, 3], [0, 1], [0, 2], quadratic=False)
    tets = furrow.split(skfem.MeshHex(mesh.p, mesh.t))
    X = tets.p[:, tets.t]
    volumes = np.abs(np.linalg.det(np.moveaxis(X[:, 1:] - X[:, :1], -1, 0))) / 6
    assert tets.t.shape[1] == 48 and volumes.sum() == approx(6.0)
    assert sorted(set(volumes.round(9))) == approx([2 / 24, 4 / 24])
