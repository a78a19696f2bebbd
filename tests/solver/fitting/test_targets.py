"""Residuals of what is known of a shape, and how they change."""

import numpy as np
import pytest
from proofs import BODIES, slope, state
from pytest import approx

from solver.fitting.skin import Skin
from solver.fitting.targets import Cloud, Landmarks, Measured, section

BODY = BODIES["hex27"]
U = state(BODY, size=0.1)
RNG = np.random.default_rng(1)
FIELDS = RNG.standard_normal((*U.shape, 2))


def skin():
    facets = BODY.mesh.boundary_facets()
    centres = BODY.mesh.p[:, BODY.mesh.facets[:, facets]].mean(axis=1)
    return Skin(BODY, facets[centres[2] > 0.79])


def cloud(sigma=0.02):
    points = skin().scattered(BODY.nodes + U, 30, RNG)
    # Away from the rim, to either side.
    points = points.mean(axis=0) + 0.6 * (points - points.mean(axis=0))
    return Cloud(skin(), points + np.array([0, 0, 0.05]), sigma)


TARGETS = {
    "cloud": cloud,
    "landmarks": lambda: Landmarks(
        BODY, BODY.nodes[4:9] * 0.9 + 0.02, BODY.nodes[4:9] + 0.1, np.linspace(0.1, 0.3, 15)
    ),
    "measured": lambda: Measured(
        ("height", "product"),
        lambda u: np.array([u[3, 2] - u[7, 2], u[2, 0] * u[5, 1]]),
        [0.3, 0.2],
        [0.1, 0.5],
    ),
}


@pytest.mark.parametrize("kind", TARGETS)
def test_residuals_change_as_by_differences(kind):
    target = TARGETS[kind]()
    r, dr = target.residual(U), target.slope(U, FIELDS)
    assert r.shape == (target.size,) and dr.shape == (target.size, 2)
    for k in range(2):
        wanted = slope(lambda h, k=k: target.residual(U + h * FIELDS[..., k]), 1e-4)
        assert dr[:, k] == approx(wanted, rel=1e-6, abs=1e-7 * np.abs(wanted).max())
    if hasattr(target, "matrix"):
        assert target.matrix(U) @ FIELDS.reshape(-1, 2) == approx(dr)


def test_a_cloud_is_so_many_deviations_above_the_skin():
    points = skin().scattered(BODY.nodes + U, 50, RNG)
    on = Cloud(skin(), points, 0.02).residual(U)
    assert on == approx(0.0, abs=1e-8)
    normal = Cloud(skin(), points, 0.02).feet(U).normal
    above = Cloud(skin(), points + 0.03 * normal, 0.02).residual(U)
    assert np.median(above) == approx(1.5, rel=1e-6)
    below = Cloud(skin(), points - 0.03 * normal, 0.02).residual(U)
    assert np.median(below) == approx(-1.5, rel=1e-6)


def test_points_beyond_a_mirror_are_their_images():
    points = skin().scattered(BODY.nodes, 20, RNG)
    one = Cloud(skin(), points, 0.1, mirrors=(0, 1))
    other = Cloud(skin(), points * [-1, 1, 1], 0.1, mirrors=(0, 1))
    assert other.points == approx(one.points) and (other.points[:, 0] >= 0).all()
    given = points * [-1, 1, 1]
    Cloud(skin(), given, 0.1, mirrors=(0,))
    assert (given[:, 0] <= 0).all()


def test_landmarks_where_they_were_seen_have_no_misfit():
    start = BODY.nodes[4:9] * 0.9 + 0.02
    end = start + BODY.interpolation(start) @ U
    target = Landmarks(BODY, start, end, 0.1)
    assert target.residual(U) == approx(0.0, abs=1e-9)
    shifted = Landmarks(BODY, start, end + np.array([0, 0.05, 0]), 0.1).residual(U).reshape(-1, 3)
    assert shifted == approx(np.tile([0, 0.5, 0], (5, 1)), abs=1e-9)


def test_a_picture_of_a_section_stands_in_its_plane():
    flat = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert section(flat, 0).tolist() == [[0, 1, 2], [0, 3, 4]]
    assert section(flat, 1).tolist() == [[1, 0, 2], [3, 0, 4]]
    with pytest.raises(ValueError, match=r"expected \(p, 2\)"):
        section(np.zeros((2, 3)), 0)


def test_wrong_targets_are_refused():
    good = skin().scattered(BODY.nodes, 5, RNG)
    for points in (good[:, :2], good[:0], np.full((2, 3), np.nan), "points"):
        with pytest.raises(ValueError, match="points"):
            Cloud(skin(), points, 0.1)
    for sigma in (0.0, -1.0, np.nan, np.inf, [0.1, 0.1], "thin"):
        with pytest.raises(ValueError, match="sigma"):
            Cloud(skin(), good, sigma)
    with pytest.raises(ValueError, match="5 starts and 4 ends"):
        Landmarks(BODY, good, good[:4], 0.1)
    with pytest.raises(ValueError, match="one finite number for each name"):
        Measured(("a", "b"), lambda u: u[0, :2], [1.0], 0.1)
