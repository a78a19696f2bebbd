"""Nearest places on a deformed skin."""

import numpy as np
import pytest
from proofs import BODIES, state
from pytest import approx

from solver.cases.tissue import furrow
from solver.cases.tissue.pattern import outside
from solver.fitting.skin import Skin
from solver.mesh.body import Body
from solver.mesh.structured import box

RNG = np.random.default_rng(4)


@pytest.fixture(scope="module")
def shell():
    """The ellipsoid's outer side, by elements."""
    shape = furrow.Shape(long=1.0, across=1.0, thickness=0.2)
    made = {}
    for element in ("hex27", "hex20", "tet10"):
        counts = furrow.Counts(3, 3, 3, 1)
        made[element] = Body.build(furrow.mesh(shape, counts, element), element)
    return {element: (body, outside(body, shape)) for element, body in made.items()}


@pytest.mark.parametrize("element", ["hex27", "hex20", "tet10"])
def test_of_a_sphere_it_is_along_the_radius(shell, element):
    body, skin = shell[element]
    directions = RNG.standard_normal((60, 3))
    directions[:, :2] = np.abs(directions[:, :2])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for radius in (0.85, 1.0, 1.15):
        feet = skin.nearest(body.nodes, radius * directions)
        # What is off are the elements, which aren't quite a sphere.
        assert np.linalg.norm(feet.position, axis=1) == approx(1.0, abs=5e-3)
        assert feet.position == approx(directions, abs=2e-2)
        assert np.einsum("pi,pi->p", feet.normal, directions) == approx(1.0, abs=5e-3)
        assert np.einsum("pk,pki->pi", feet.shapes, body.nodes[feet.nodes]) == approx(feet.position)


@pytest.mark.parametrize("element", ["hex27", "tet10", "hex8", "tet4"])
def test_nothing_on_the_skin_is_nearer_and_the_way_there_is_normal(element):
    body = BODIES[element]
    x = body.nodes + state(body, size=0.1)
    skin = Skin(body, _top(body))
    dense = skin.scattered(x, 20_000, RNG)
    low, high = dense.min(axis=0), dense.max(axis=0)
    points = low + (high - low) * RNG.uniform(0.2, 0.8, (40, 3)) + [0, 0, 0.1]
    feet = skin.nearest(x, points)
    off = np.linalg.norm(points - feet.position, axis=1)
    least = np.linalg.norm(points[:, None] - dense, axis=2).min(axis=1)
    assert (off <= least + 1e-9).all() and off == approx(least, abs=0.03)
    assert (feet.normal[:, 2] > 0).all()
    # At a foot within its facet, the distance is along the normal.
    along = np.abs(np.einsum("pi,pi->p", feet.normal, points - feet.position))
    smooth = element in ("hex27", "tet10")
    assert np.median(np.abs(along - off)) < (1e-9 if smooth else 1e-2)


@pytest.mark.parametrize("element", ["hex27", "tet10"])
def test_of_one_facet_edges_and_corners_are_the_nearest_too(element):
    body = BODIES[element]
    x = body.nodes + state(body, size=0.1)
    skin = Skin(body, _top(body)[:1])
    dense = skin.scattered(x, 20_000, RNG)
    points = dense[:60] + RNG.standard_normal((60, 3)) * 0.3
    off = np.linalg.norm(points - skin.nearest(x, points).position, axis=1)
    least = np.linalg.norm(points[:, None] - dense, axis=2).min(axis=1)
    assert off == approx(least, abs=0.01) and (off <= least + 1e-7).all()


def _top(body):
    facets = body.mesh.boundary_facets()
    centres = body.mesh.p[:, body.mesh.facets[:, facets]].mean(axis=1)
    return facets[centres[2] > 0.79]


def test_it_is_the_outer_side_alone_of_a_furrow(shell):
    body, skin = shell["hex20"]
    sample = skin.scattered(body.nodes, 500, RNG)
    assert np.linalg.norm(sample, axis=1) == approx(1.0, abs=5e-3)
    # About as many on each area: x, y and |z| of a sphere's points are evenly spread.
    for axis in range(3):
        values = np.abs(sample[:, axis])
        assert np.mean(values) == approx(0.5, abs=0.04)
        assert np.mean(values**2) == approx(1 / 3, abs=0.04)


def test_facets_inside_and_none_are_refused():
    body = Body.build(box([0, 1, 2], [0, 1], [0, 1]), "hex8")
    inside = np.flatnonzero(body.mesh.f2t[1] >= 0)
    for facets in (inside, np.zeros(0, int)):
        with pytest.raises(ValueError, match="expected at least one, all on the boundary"):
            Skin(body, facets)
