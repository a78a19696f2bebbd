"""Figures of a mesh's quality against cells whose figures are known by hand."""

import numpy as np
import pytest
import skfem

from solver.mesh.quality import quality
from solver.mesh.structured import box


def one_tetrahedron(*corners) -> skfem.MeshTet:
    return skfem.MeshTet(np.array(corners, dtype=float).T, np.array([[0, 1, 2, 3]]).T)


def test_a_regular_tetrahedron_is_one_in_every_figure():
    q = quality(one_tetrahedron((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)))
    assert q.aspect == pytest.approx((1.0, 1.0)) and q.scaled_jacobian == pytest.approx((1.0, 1.0))
    assert q.bending == pytest.approx(1.0)
    assert q.sizes == pytest.approx((np.sqrt(8), np.sqrt(8)))


def test_aspect_of_a_flat_tetrahedron_is_by_its_shortest_height():
    h = 0.1
    q = quality(one_tetrahedron((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, h)))
    # Volume h/6; the largest face is the base or the sloping one, whose area is sqrt(1 + 2h²)/2:
    # height h/sqrt(1 + 2h²) to it; longest edge sqrt(2).
    height = h / np.sqrt(1 + 2 * h * h)
    assert q.aspect[0] == pytest.approx(np.sqrt(2 / 3) * np.sqrt(2) / height)
    # Corner with the largest product of edges: at (1, 0, 0): 1 · sqrt(2) · sqrt(1 + h²).
    product = np.sqrt(2) * np.sqrt(1 + h * h)
    assert q.scaled_jacobian[0] == pytest.approx(np.sqrt(2) * h / product)


def test_a_bent_cell_says_the_smallest_over_the_largest_determinant():
    # A prism tapering along x from an edge of 1 to one of 0.5: det falls linearly to a half.
    mesh = skfem.MeshHex.init_tensor([0, 1], [0, 1], [0, 1])
    p = mesh.p.copy()
    p[1] *= 1 - 0.5 * p[0]
    q = quality(skfem.MeshHex(p, mesh.t))
    assert q.bending == pytest.approx(0.5)
    assert q.inverted == 0


def test_elements_through_a_layer_count_by_the_length_that_they_fill():
    # A cell of 1 and one of 0.1: their mean extent along the line is (1² + 0.1²)/1.1.
    layers = {"low": lambda X: X[:, 2] < 1.1, "top": lambda X: X[:, 2] > 1.1}
    mesh = box([0, 1, 2], [0, 1], [0, 1, 1.1, 1.2], layers=layers)
    through = quality(mesh, (0, 0, -2)).through
    assert list(through) == ["low", "top"]
    assert through["low"] == pytest.approx([1.1**2 / (1 + 0.1**2)] * 2)
    assert through["top"] == pytest.approx([1.0, 1.0])
