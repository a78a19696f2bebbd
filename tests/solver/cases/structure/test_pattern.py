"""Crease patterns: what hinges leave of faces, and what is refused."""

import numpy as np
import pytest
from crease_patterns import miura_vertex, squares, two_panels
from pytest import approx

from solver.cases.structure.pattern import Crease, Pattern, area_of, triangles


def test_a_hinge_takes_half_its_length_of_either_face():
    pattern = two_panels(length=0.2)
    areas = [area_of(panel) for panel in pattern.panels]
    assert areas == approx([0.4 * 0.2] * 2)
    (hinge,) = pattern.hinges
    assert hinge.width == approx(0.2)
    np.testing.assert_allclose(hinge.sides, [[-0.1, 0], [0.1, 0]], atol=1e-12)
    across = hinge.sides[1] - hinge.sides[0]
    assert hinge.axis[0] * across[1] - hinge.axis[1] * across[0] > 0  # axis × across is up


@pytest.mark.parametrize("turned", [False, True])
def test_the_axis_points_the_same_way_however_faces_are_listed(turned):
    pattern = two_panels()
    faces = [face[::-1] for face in pattern.faces] if turned else pattern.faces[::-1]
    again = Pattern(pattern.vertices, faces, [Crease((4, 1), 1, 0.2)])
    (hinge,) = again.hinges
    across = hinge.sides[1] - hinge.sides[0]
    assert hinge.axis[0] * across[1] - hinge.axis[1] * across[0] > 0
    middle = [panel.mean(axis=0) for panel in again.panels]
    a, b = hinge.faces
    assert (middle[b] - middle[a]) @ across > 0


def test_strips_around_a_vertex_leave_a_hole():
    pattern = miura_vertex(np.radians(60), 0.1)
    strips = sum(h.width * h.crease.length for h in pattern.hinges)
    assert sum(map(area_of, pattern.panels)) + strips < 4 - 0.1**2 / 2
    assert all(0.8 < h.width < 1.16 for h in pattern.hinges)
    # The crease at 60 degrees: both of its panels reach as far out, and face each other from the
    # hole on. Its end on the border is cut where the panel that leans back ends.
    inner = 0.05 / np.tan(np.radians(30))  # of the acute sector
    outer = 1 / np.sin(np.radians(60)) - 0.05 / np.tan(np.radians(60))
    assert pattern.hinges[1].width == approx(outer - inner)


def test_lengths_may_differ_from_crease_to_crease():
    pattern = squares([(0, 0), (1, 0), (2, 0)])
    creases = [
        Crease(c.ends, 1, length) for c, length in zip(pattern.creases, (0.1, 0.4), strict=True)
    ]
    again = Pattern(pattern.vertices, pattern.faces, creases)
    assert [area_of(p) for p in again.panels] == approx([0.95, 0.75, 0.8])


def test_a_polygon_is_filled_with_triangles_that_turn_left():
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 0.4], [0, 1]], float)
    parts = triangles(outline)
    areas = [area_of(outline[t]) for t in parts]
    assert min(areas) > 0
    assert sum(areas) == approx(area_of(outline))


SQUARE = [[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [0, 1]]
FACES = [[0, 1, 4, 5], [1, 2, 3, 4]]
FOLD = [Crease((1, 4), 1, 0.1)]


@pytest.mark.parametrize(
    "vertices, faces, creases, says",
    [
        (SQUARE, FACES, [Crease((0, 1), 1, 0.1), *FOLD], r"\[0, 1\] borders 1 faces; expected two"),
        (SQUARE, FACES, [Crease((0, 3), 1, 0.1), *FOLD], r"\[0, 3\] borders 0 faces"),
        (SQUARE, FACES, [], r"edge \[1, 4\] lies between two faces and is no crease"),
        (SQUARE, FACES, FOLD * 2, r"crease \[1, 4\] is given twice"),
        (SQUARE, FACES, [Crease((1, 4), 1, 2.5)], "leave no panel of it"),
        (SQUARE, [[0, 1, 4, 5], [1, 2, 3, 4, 4]], FOLD, "face 1 has the vertices"),
        (SQUARE, [[0, 1, 4, 5], [1, 2, 3, 9]], FOLD, "vertex 9; there are 6"),
        (SQUARE, [[0, 1, 4, 5], [1, 2, 5, 3]], FOLD, "outline of face 1 crosses"),
        (SQUARE, [[0, 1, 2], [1, 2, 3, 4]], FOLD, "face 0 has no area"),
        (SQUARE, ["ab", [1, 2, 3, 4]], FOLD, "face 0 is 'ab'; expected vertex numbers"),
        (SQUARE, [], [], "no faces"),
        ([[0, 0, 0]], FACES, FOLD, r"shape \(1, 3\); expected \(n, 2\)"),
        ([[0, 0], [np.nan, 0]], FACES, FOLD, "expected .n, 2., finite"),
        (
            [*SQUARE, [0.5, 0.5], [1.5, 0.5], [1.5, 1.5]],
            [*FACES, [6, 7, 8]], FOLD, "faces 0 and 2 overlap|faces 1 and 2 overlap",
        ),
        (
            [*SQUARE, [2, 0.5]],
            [[0, 1, 4, 5], [1, 2, 3, 4], [1, 6, 4]], FOLD, "two faces lie on the same side",
        ),
    ],
)  # fmt: skip
def test_what_is_no_pattern_is_told(vertices, faces, creases, says):
    with pytest.raises(ValueError, match=says):
        Pattern(vertices, faces, creases)


def test_hinges_of_different_lengths_on_one_straight_edge():
    vertices = [[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [0, 1], [0, -1], [1, -1], [2, -1]]
    faces = [[0, 1, 2, 3, 5], [6, 7, 1, 0], [7, 8, 2, 1]]
    creases = [Crease((0, 1), 1, 0.1), Crease((1, 2), 1, 0.2), Crease((1, 7), 1, 0.1)]
    with pytest.raises(ValueError, match="different lengths meet at vertex 1"):
        Pattern(vertices, faces, creases)


@pytest.mark.parametrize(
    "change, says",
    [
        ({"fold": 2}, "fold = 2"),
        ({"length": 0.0}, "hinge length = 0.0"),
        ({"length": np.inf}, "hinge length = inf"),
        ({"start": 0.5, "end": 0.5}, "active from 0.5 to 0.5"),
        ({"end": 1.5}, "active from 0.0 to 1.5"),
        ({"start": -0.1}, "active from -0.1"),
    ],
)
def test_what_is_no_crease_is_told(change, says):
    with pytest.raises(ValueError, match=says):
        Crease(**({"ends": (0, 1), "fold": 1, "length": 0.1} | change))
