"""A hexagonal mesh that contracts on a film that floats: mesh, balance, scaling, limits."""

from functools import lru_cache

import numpy as np
import pytest
from pytest import approx

from solver.cases.lung.film import OVER, Film, measure, scene
from solver.equilibrium.newton import newton


@lru_cache
def solved(film, cells, contraction):
    body = film.body(cells)
    stage = scene(film, body, contraction)
    result = newton(stage, np.zeros(stage.size), 1.0, rtol=1e-10)
    assert result.converged and result.system.unstable == 0
    u = stage.displacement(result.x, 1.0)
    return stage, u, measure(film, body, u)


@pytest.mark.parametrize("cells", [1, 2, 3])
def test_the_wedge_is_a_twelfth_of_a_hexagon_with_half_a_bundle_along_its_edge(cells):
    film = Film(spacing=2.0, width=0.3, height=0.2, thickness=0.1)
    body = film.body(cells)
    triangle = 0.5 * 1.0 * np.tan(np.pi / 6)
    inner = triangle * (1 - 0.15) ** 2
    volumes = body.weights.sum(axis=1)
    muscle = body.cells_of("muscle")
    assert volumes[~muscle].sum() == approx(0.1 * triangle)
    assert volumes[muscle].sum() == approx(0.2 * (triangle - inner))
    X = body.nodes
    assert X[:, 1].min() == approx(0, abs=1e-8) and (X @ OVER).max() == approx(0, abs=1e-7)
    assert X[:, 0].max() == approx(1.0) and X[:, 2].max() == approx(0.3)


def test_a_small_contraction_bends_it_alike_on_all_meshes():
    """Nodes of joined pieces lie on their planes to 1e-8 only; some were not held, and what a mesh
    gave depended on whether its number of cells was even."""
    found = [solved(Film(), cells, -1e-3)[2] for cells in (1, 2, 3, 4)]
    for one in found[:3]:
        assert one.depth == approx(found[3].depth, rel=5e-3)
        assert 1 - one.spacing == approx(1 - found[3].spacing, rel=5e-3)
    assert found[3].centre < 0 < found[3].edge


def test_the_liquid_lifts_nothing_and_planes_stay_planes():
    film = Film(weight=0.1)
    stage, u, found = solved(film, 2, -0.02)
    X, water = stage.body.nodes, stage.terms[1]
    force = water.evaluate(u, 1.0, 1).force
    assert abs(force[:, 2].sum()) < 1e-9 * np.abs(force[:, 2]).sum()
    assert np.abs(u[np.abs(X[:, 1]) < 1e-7, 1]).max() == 0
    assert np.abs((u @ OVER)[np.abs(X @ OVER) < 1e-7]).max() < 1e-14
    edge = np.abs(X[:, 0] - 0.5) < 1e-7
    assert np.ptp(u[edge, 0]) < 1e-10 and found.spacing == approx(1 + 2 * u[edge, 0].mean())
    # A mesh that contracts by 2 % draws the film in, by no more than that.
    assert 0.98 < found.spacing < 0.985
    low = X[:, 2] < 1e-7
    assert found.depth == approx(np.ptp(u[low, 2])) and found.aspect == found.depth / found.spacing


def test_sizes_twice_as_large_on_half_the_weight_have_the_same_shape():
    one = solved(Film(weight=0.1), 1, -0.03)[2]
    large = Film(spacing=2.0, width=0.2, height=0.2, thickness=0.1, weight=0.05)
    two = solved(large, 1, -0.03)[2]
    assert two.aspect == approx(one.aspect, rel=1e-7) and two.centre == approx(2 * one.centre)


def test_a_heavy_liquid_keeps_it_flat_and_no_contraction_does_nothing():
    depths = [solved(Film(weight=w), 1, -1e-3)[2].depth for w in (1e-4, 0.1, 10.0, 1e3)]
    assert (np.diff(depths) < 0).all() and depths[-1] < 0.05 * depths[0]
    _, u, found = solved(Film(), 1, 0.0)
    assert not u.any() and found.depth == 0 and found.spacing == approx(1.0)


def test_what_makes_no_film_is_refused():
    for bad, says in (
        ({"width": 1.0}, "expected less than the spacing 1, where bundles would fill"),
        ({"weight": 0.0}, "weight = 0"),
        ({"thickness": -1.0}, "thickness = -1"),
    ):
        with pytest.raises(ValueError, match=says):
            Film(**bad)
    with pytest.raises(ValueError, match="cells = 0"):
        Film().body(0)
    with pytest.raises(ValueError, match="expected more than -1"):
        scene(Film(), Film().body(1), -1.0)
