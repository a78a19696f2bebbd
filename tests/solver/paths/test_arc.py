"""The extended system: converged where displacement and load have both settled."""

import numpy as np
import pytest
from path_toys import function_scene

from solver.paths.arc import Ellipsoid, Plane, correct
from solver.paths.point import Metric


def spring(stiffness, cubic=0.0):
    """stiffness · (q + cubic · q³) = e"""
    return function_scene(
        1,
        lambda q, e: stiffness * (q[0] ** 2 / 2 + cubic * q[0] ** 4 / 4) - e * q[0],
        lambda q, e: stiffness * (q + cubic * q**3) - e,
        lambda q, e: np.array([[stiffness * (1 + 3 * cubic * q[0] ** 2)]]),
    )


@pytest.mark.parametrize("load_size", [1.0, 1e4])
def test_a_rigid_scene_has_settled_only_where_the_load_has(load_size):
    # It moves by 1e-12 at most, and the ellipsoid is met at e = load_size.
    scene, metric = spring(1e12 * load_size), Metric(1.0, load_size, 1, 1.0)
    found = correct(
        scene, np.array([0.0, 1.5 * load_size]), Ellipsoid(np.zeros(2), metric),
        rtol=1e-9, load_size=load_size, max_iterations=20,
    )  # fmt: skip
    assert found.converged and found.e == pytest.approx(load_size, rel=1e-12)
    assert found.x[0] == pytest.approx(1e-12)


def test_at_a_load_that_is_held_it_has_settled_only_where_the_displacement_has():
    # q + q³ = 2 at q = 1
    plane = Plane(np.array([0.0, 2.0]), np.array([0.0, 1.0]))
    found = correct(
        spring(1.0, cubic=1.0), np.array([1.6, 2.0]), plane,
        rtol=1e-9, load_size=1.0, max_iterations=20,
    )  # fmt: skip
    assert found.converged and found.z == pytest.approx([1.0, 2.0], abs=1e-12)
