"""Corners that carry linear functions, and lines of nodes through flat cells."""

import numpy as np
import pytest

from solver.mesh.body import Body
from solver.mesh.corners import aspect, corner_weights, lines
from solver.mesh.structured import box, polar


def body_of(element, size, counts=(3, 2, 2), **more):
    axes = [np.linspace(0, length, n + 1) for n, length in zip(counts, size, strict=True)]
    return Body.build(box(*axes, tets=element.startswith("tet"), **more), element)


@pytest.mark.parametrize("element", ["hex27", "hex20", "tet10"])
def test_linear_functions_of_the_corners_are_those_of_the_nodes(element):
    body = body_of(element, (1.0, 2.0, 0.1))
    corners, W = corner_weights(body)
    assert len(corners) == 4 * 3 * 3
    np.testing.assert_allclose(W @ body.nodes[corners], body.nodes, atol=1e-14)
    np.testing.assert_allclose(W @ np.ones(len(corners)), 1.0)
    np.testing.assert_array_equal(W[corners].toarray(), np.eye(len(corners)))
    assert W.toarray().min() >= 0


@pytest.mark.parametrize("element", ["hex8", "tet4"])
def test_linear_elements_have_corners_only(element):
    assert corner_weights(body_of(element, (1.0, 1.0, 1.0))) is None


def test_the_aspect_ratio_is_that_of_most_cells():
    assert aspect(body_of("hex27", (3.0, 2.0, 2.0))) == pytest.approx(1.0)
    assert aspect(body_of("hex8", (3.0, 8.0, 1.0))) == pytest.approx(8.0)


@pytest.mark.parametrize("element", ["hex27", "hex20", "tet10"])
def test_lines_go_through_flat_cells_the_short_way(element):
    body = body_of(element, (3.0, 2.0, 0.4))
    line, place = lines(body)
    columns = np.unique(body.nodes[:, :2].round(9), axis=0, return_inverse=True)[1].ravel()
    # Two nodes share a line where they share a column.
    assert len(np.unique(line)) == len(np.unique(columns))
    assert len(np.unique(np.column_stack([line, columns]), axis=0)) == len(np.unique(line))
    for k in np.unique(line):
        on = line == k
        steps = np.abs(np.diff(place[on][np.argsort(body.nodes[on, 2])]))
        np.testing.assert_allclose(steps, np.diff(np.sort(body.nodes[on, 2])), rtol=0.02)


def test_lines_follow_a_curved_sheet():
    one = np.array([1.0, 0.0, 0.0])
    arch = body_of("hex27", (0.04, 3.0, 1.0), (2, 8, 3), shape=lambda X: polar(X + one))
    line, _ = lines(arch)
    angle = np.arctan2(arch.nodes[:, 1], arch.nodes[:, 0])
    for k in np.unique(line):
        assert (line == k).sum() == 5
        assert np.ptp(angle[line == k]) < 0.02 and np.ptp(arch.nodes[line == k, 2]) < 1e-9


@pytest.mark.parametrize("size", [(3.0, 2.0, 2.0), (30.0, 2.0, 2.0)])
def test_thick_cells_and_needles_have_no_short_way(size):
    body = body_of("hex27", size)
    line, place = lines(body)
    assert len(np.unique(line)) == len(body.nodes)
    assert (place == 0).all()


def test_lines_do_not_turn_where_cells_are_flat_another_way():
    graded = [0.0, 0.1, 1.0, 2.0]
    body = Body.build(box([0.0, 1.0, 2.0], graded, graded), "hex27")
    line, _ = lines(body)
    extents = np.array([np.ptp(body.nodes[line == k], axis=0) for k in np.unique(line)])
    assert ((extents > 1e-9).sum(axis=1) <= 1).all()
    for axis in (1, 2):
        assert (extents[:, axis] > 0).any()
