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


def test_elements_through_a_layer_are_counted_wherever_it_lies():
    mesh = box([10, 11, 12], [-3, -2], [0, 1, 2, 3])
    assert quality(mesh, (0, 0, 1)).through["the mesh"] == pytest.approx((3.0, 3.0))
    assert quality(mesh, (5, 0, 0)).through["the mesh"] == pytest.approx((2.0, 2.0))


def test_a_mesh_says_its_figures_in_words():
    mesh = box([0, 1, 3], [0, 1], [0, 0.5])
    q = quality(mesh, (0, 0, 1))
    assert (q.kind, q.cells, q.parts, q.inverted) == ("hexahedra", 2, 1, 0)
    assert q.nodes == mesh.doflocs.shape[1] and q.sizes == pytest.approx((0.5, 2.0))
    # Of 2 by 1 by 0.5 and of 1 by 1 by 0.5.
    assert q.aspect == pytest.approx((4.0, 3.0)) and q.scaled_jacobian == pytest.approx((1, 1))
    words = str(q).splitlines()
    assert words[0].startswith("2 hexahedra, ") and words[0].endswith(", 1 part")
    assert words[1] == "edges 0.5 to 2" and words[2] == "aspect ratio: largest 4, median 3"
    assert words[-1] == "elements through the mesh: least 1, median 1"
    assert not any("inverted" in line for line in words)


def test_inverted_cells_are_counted_and_told():
    mesh = skfem.MeshHex.init_tensor([0, 1, 2, 3], [0, 1], [0, 1])
    p = mesh.p.copy()
    # One edge of the last cell is pushed through the face before it.
    p[0, (p[0] == 3) & (p[1] == 0)] = 1.0
    q = quality(skfem.MeshHex(p, mesh.t))
    assert q.inverted == 1 and q.scaled_jacobian[0] < 0
    assert "1 cells are inverted" in str(q)
