"""Lungs longer than wide: the sphere's shell and cage, on an ellipsoid."""

import numpy as np
import pytest

from solver.cases.lung import model as case
from solver.cases.lung.elongated import Elongated
from solver.cases.lung.geometry import Lung, unit
from solver.cases.lung.measures import measure
from solver.cases.lung.model import REST, State, Tissue

SMALL = Lung(n=1)
pytestmark = pytest.mark.filterwarnings("ignore:.*elements are curved in a thin body")


def inflated(shape, *states, steps=1):
    stage = shape.scene(Tissue(), states)
    path = case.run(stage, steps=steps, events=False, over=None)
    assert path.reached
    return stage.displacement(path.last.x, path.last.e)


def test_as_long_as_wide_it_is_the_sphere():
    shape = Elongated.of(SMALL, 1.0, 0)
    np.testing.assert_allclose(shape.body.nodes, shape.round.nodes, atol=1e-12)
    u = inflated(shape, REST, State(0.01))
    ball = case.scene(shape.round, SMALL, Tissue(), REST, State(0.01))
    path = case.run(ball, steps=1, events=False)
    np.testing.assert_allclose(u, ball.displacement(path.last.x, 1.0), atol=1e-9)
    spacing = {c.tile: c.spacing for c in measure(shape.round, SMALL, u).cells}
    cells = shape.cells(u)
    assert {c.tile: c.spacing for c in cells} == pytest.approx(spacing)
    # All twelve are alike.
    depths = [c.depth for c in cells]
    assert depths == pytest.approx([depths[0]] * len(depths), rel=1e-6) and depths[0] > 0
    assert [c.height for c in cells] == sorted(c.height for c in cells)


def test_thicknesses_stay_and_fibres_go_along_the_surface():
    shape = Elongated.of(SMALL, 2.0, 0)
    X, Y = shape.round.nodes, shape.body.nodes
    r, N = np.linalg.norm(X, axis=1), unit(X)
    middle = N * (1, 1, 2)
    assert np.abs((middle**2 / (1, 1, 4)).sum(axis=1) - 1).max() < 1e-12
    np.testing.assert_allclose(np.linalg.norm(Y - middle, axis=1), np.abs(r - 1), atol=1e-12)
    normals = shape.normals(X)
    out = np.einsum("ni,ni->n", Y - middle, normals)
    np.testing.assert_allclose(out, r - 1, atol=1e-12)
    # The normal is across what a move along the sphere becomes.
    move = np.cross(N, [0.3, -0.5, 0.8]) * 1e-6
    there = unit(N + move) * (1, 1, 2) - middle
    assert np.abs(np.einsum("ni,ni->n", there, normals)).max() < 1e-11
    growth = shape.scene(Tissue(), (REST, State(0.0, -0.3))).terms[0].growth
    g = growth.tensor(1.0, shape.body.weights.shape)[case.muscle_of(shape.body)]
    values, vectors = np.linalg.eigh(g)
    assert values[..., 0] == pytest.approx(0.7) and values[..., 1:] == pytest.approx(1.0)
    points = shape.round.points()[case.muscle_of(shape.body)]
    across = np.einsum(
        "mqi,mqi->mq", vectors[..., 0], shape.normals(points.reshape(-1, 3)).reshape(points.shape)
    )
    assert np.abs(across).max() < 0.02


def test_a_thin_shell_answers_as_a_membrane_of_revolution():
    # N_φ = p r₂/2, N_θ = p r₂ (1 − r₂/2 r₁); at the equator r₂ = 1 and r₁ = a².
    a, p, nu, h = 1.5, 1e-5, 0.3, 0.02
    shape = Elongated.of(Lung(n=1, epithelium=h, muscle=0.0), a, 0)
    u = inflated(shape, REST, State(p))
    at = np.argmin(np.linalg.norm(shape.round.nodes - [1, 0, 0], axis=1))
    expected = p / h * ((1 - 1 / (2 * a**2)) - nu / 2)
    # On the inner face the pressure has a smaller surface, by 2 h.
    assert u[at, 0] == pytest.approx(expected, rel=3 * h)
    sphere = inflated(Elongated.of(Lung(n=1, epithelium=h, muscle=0.0), 1.0, 0), REST, State(p))
    assert u[at, 0] > 1.15 * sphere[at, 0]


def test_a_longer_lung_bulges_more_at_its_sides_than_at_its_ends():
    shape = Elongated.of(SMALL, 2.0, 0)
    cells = shape.cells(inflated(shape, REST, State(0.01)))
    assert cells[0].height == pytest.approx(0.0, abs=1e-9) and 0.8 < cells[-1].height < 0.9
    assert cells[0].aspect > 1.3 * cells[-1].aspect > 0
    assert cells[0].aspect == cells[0].depth / cells[0].spacing


@pytest.mark.parametrize(
    "length, told",
    [
        (0.0, "expected length over width > 0"),
        (25.0, "a radius of curvature of 0.04"),
        (0.2, "a radius of curvature of 0.04"),
    ],
)
def test_shapes_that_are_none(length, told):
    with pytest.raises(ValueError, match=told):
        Elongated.of(SMALL, length, 0)


def test_blended_fibres_need_the_sphere():
    shape = Elongated.of(SMALL, 1.5, 0)
    with pytest.raises(ValueError, match="known on the sphere only"):
        shape.scene(Tissue(fibres="blended"), (REST, State(0.0, -0.1)))
