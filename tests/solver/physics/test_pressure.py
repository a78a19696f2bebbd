"""Pressure with a potential: planes at the rim, caps, and the modes that it makes unstable."""

import numpy as np
import pytest
from proofs import block, prove, state
from pytest import approx

from solver.equilibrium.newton import newton
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box, polar
from solver.paths.continuation import load, trace
from solver.paths.point import Uncounted
from solver.paths.steppers import LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.materials import NeoHookean
from solver.physics.pressure import Pressure
from solver.physics.rows import flat_rows, mean_rotation_row
from solver.physics.supports import Fixed, Held, rotation_row, translation_row

X, Y, Z = np.eye(3)
BODY = block("hex27")  # 1 × 1.5 × 0.8, a corner at the origin
SIZE = np.array([1, 1.5, 0.8])


def plane(body, axis, at, value=0.0):
    return Fixed(body.nodes_where(lambda P: np.abs(P[:, axis] - at) < 1e-9), np.eye(3)[axis], value)


def faces(body, *which):
    return body.surface(lambda P: np.any([np.abs(P[:, k] - at) < 1e-9 for k, at in which], axis=0))


def held_state(body, fixed, e):
    """A distorted state that keeps the supports, and what of a field may move in it."""
    held = Held(len(body.nodes), fixed)
    local = held.to_local(state(body)).ravel()
    local[~held.free] = held.values(e)[~held.free]
    return held.to_global(local.reshape(-1, 3)), lambda v: held.to_local(v).ravel()[held.index]


# Faces under pressure, planes that their rim slides in, the origin.
RIMS = {
    "planes through one point": (
        [(0, 1), (1, 1.5), (2, 0.8)], [(0, 0), (1, 0), (2, 0)], (0, 0, 0),
    ),
    "planes through another point": (
        [(0, 0), (1, 0), (2, 0)], [(0, 1), (1, 1.5), (2, 0.8)], (1, 1.5, 0.8),
    ),
    "two parallel planes": ([(0, 1), (1, 1.5)], [(0, 0), (1, 0), (2, 0), (2, 0.8)], (0, 0, 7)),
    "two parallel planes alone": (
        [(0, 0), (0, 1), (1, 0), (1, 1.5)], [(2, 0), (2, 0.8)], (3, 4, 7),
    ),
    "one of them moves": (
        [(0, 1), (1, 1.5)], [(0, 0), (1, 0), (2, 0), (2, 0.8, lambda e: e / 5)], (0, 0, 7),
    ),
    "a box's lid": ([(2, 0.8)], [(0, 0), (1, 0), (0, 1), (1, 1.5)], (3, 4, 5)),
}  # fmt: skip


@pytest.mark.parametrize("rim", RIMS)
def test_a_rim_in_planes_leaves_a_potential_that_is_the_follower_force(rim):
    which, planes, origin = RIMS[rim]
    fixed = [plane(BODY, *p) for p in planes]
    surface = faces(BODY, *which)
    term = Pressure(BODY, surface, 1.5, potential="volume", fixed=fixed, origin=origin)
    u, free = held_state(BODY, fixed, 0.5)
    prove(term, u, 0.5)
    follower = Pressure(BODY, surface, 1.5).evaluate(u, 0.5, 1).force
    at = term.evaluate(u, 0.5)
    np.testing.assert_allclose(free(at.force), free(follower), atol=1e-12)
    assert at.energy == approx(1.5 * term.volume(u), rel=1e-14)


@pytest.mark.parametrize(
    "rim", ["two parallel planes", "two parallel planes alone", "one of them moves"]
)
def test_the_volume_between_parallel_planes_is_that_of_the_body(rim):
    which, planes, origin = RIMS[rim]
    fixed = [plane(BODY, *p) for p in planes]
    term = Pressure(BODY, faces(BODY, *which), 1.0, potential="volume", fixed=fixed, origin=origin)
    u = BODY.nodes * [0.2, -0.1, 0.1 / 0.8]
    assert term.volume(u) == approx(1.2 * 0.9 * (0.8 + 0.1) / 0.8 * SIZE.prod(), rel=1e-12)


def test_planes_that_leave_no_potential_are_refused():
    lid = faces(BODY, (2, 0.8))
    sides = [plane(BODY, *p) for p in ((0, 0), (1, 0), (0, 1), (1, 1.5))]
    with pytest.raises(ValueError, match=r"no potential here: \d+ nodes .* take caps=True"):
        Pressure(BODY, lid, 1.0, potential="volume", fixed=sides[:3])
    # A plane through the origin is none once it moves.
    corner = faces(BODY, (0, 1), (1, 1.5), (2, 0.8))
    moving = [plane(BODY, 0, 0, 0.2), plane(BODY, 1, 0, 0.1), plane(BODY, 2, 0, lambda e: e)]
    with pytest.raises(ValueError, match="no potential here"):
        Pressure(BODY, corner, 1.0, potential="volume", fixed=moving)
    with pytest.raises(ValueError, match="take potential='volume'"):
        Pressure(BODY, lid, 1.0, caps=True)
    with pytest.raises(ValueError, match="no rim to cap"):
        every = BODY.surface(lambda P: np.ones(len(P), bool))
        Pressure(BODY, every, 1.0, potential="volume", caps=True)


@pytest.mark.parametrize("element", ["hex27", "hex20", "hex8", "tet10", "tet4"])
def test_caps_close_the_surface(element):
    body = block(element)
    around = faces(body, (0, 0), (0, 1), (1, 0), (1, 1.5))
    tube = Pressure(body, around, 1.5, potential="volume", caps=True, origin=(3, 4, 5))
    u = state(body)
    prove(tube, u, 0.0)
    # Closed: no force and no moment in all, and the volume of the body where the caps are flat.
    force = tube.evaluate(u, 0.0).force
    size = np.abs(force).max()
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * size
    assert np.abs(np.cross(body.nodes + u, force).sum(axis=0)).max() < 1e-12 * size
    H = np.random.default_rng(8).uniform(-0.3, 0.3, (3, 3))
    volume = np.linalg.det(np.eye(3) + H) * SIZE.prod()
    assert tube.volume(body.nodes @ H.T) == approx(volume, rel=1e-12)
    # On each end p times its area pulls, whatever way the wall is turned.
    every = body.surface(lambda P: np.ones(len(P), bool))
    whole = Pressure(body, every, 1.5).evaluate(body.nodes @ H.T, 0.0, 1).force
    top = body.nodes[:, 2] > 0.5
    capped = tube.evaluate(body.nodes @ H.T, 0.0, 1).force
    low = np.flatnonzero(body.nodes[:, 2] < 1e-9)
    wall = Pressure(body, around, 1.5).evaluate(body.nodes @ H.T, 0.0, 1).force
    bottom = Pressure(body, faces(body, (2, 0)), 1.5).evaluate(body.nodes @ H.T, 0.0, 1).force
    np.testing.assert_allclose((capped - wall)[low].sum(0), bottom.sum(0), atol=1e-12 * size)
    np.testing.assert_allclose(capped[top].sum(0), whole[top].sum(0), atol=0.5 * size)


def tube(n, *, quarter, length=1.0):
    angle = np.pi / 2 if quarter else 2 * np.pi
    grid = box([0.8, 1.0], np.linspace(0, angle, n + 1), [0, length / 2, length], shape=polar)
    return Body.build(grid, "hex27")


def test_a_quarter_of_a_tube_has_a_quarter_of_the_closed_tube_s_energy():
    u = lambda P: 0.1 * np.column_stack(  # noqa: E731
        [P[:, 0] ** 3 + P[:, 0] * P[:, 2], P[:, 1] * P[:, 2] ** 2 + P[:, 0] ** 2 * P[:, 1],
         P[:, 0] ** 2 + P[:, 2]]
    )  # fmt: skip
    energies, forces = [], []
    for quarter in (True, False):
        body = tube(2 if quarter else 8, quarter=quarter)
        fixed = [plane(body, 0, 0), plane(body, 1, 0)] if quarter else []
        inner = body.surface(lambda P: np.hypot(P[:, 0], P[:, 1]) < 0.8)
        term = Pressure(body, inner, 1.0, potential="volume", caps=True, fixed=fixed)
        at = term.evaluate(u(body.nodes), 0.0)
        energies.append(at.energy * (4 if quarter else 1))
        node = np.flatnonzero(np.linalg.norm(body.nodes - [0.8, 0, 1], axis=1) < 1e-9)
        forces.append(at.force[node[0], 2] * (2 if quarter else 1))
        prove(term, u(body.nodes), 0.0)
    assert energies[0] == approx(energies[1], rel=1e-12) and energies[0] < 0
    assert forces[0] == approx(forces[1], rel=1e-10)


def test_a_thick_tube_with_closed_ends_lengthens_as_lame_says():
    body = tube(4, quarter=True)
    fixed = [plane(body, k, 0) for k in range(3)]
    inner = body.surface(lambda P: np.hypot(P[:, 0], P[:, 1]) < 0.8)
    p, nu, a, b = 1e-5, 0.3, 0.8, 1.0
    load = Pressure(body, inner, p, potential="volume", caps=True, fixed=fixed)
    rows = flat_rows(body, faces(body, (2, 1.0)))
    rows += [mean_rotation_row(body, faces(body, (2, 1.0)), axis) for axis in (X, Y)]
    scene = Scene(body, [Elastic(body, NeoHookean(1.0, nu)), load], fixed=fixed, rows=rows)
    done = newton(scene, np.zeros(scene.size), 0.0, rtol=1e-10)
    u = scene.displacement(done.x, 0.0)
    end = u[np.abs(body.nodes[:, 2] - 1) < 1e-9, 2]
    stress = p * a**2 / (b**2 - a**2)  # Lamé: also half of σ_r + σ_θ, at every radius
    assert end.mean() == approx(stress * (1 - 2 * nu), rel=2e-3)
    assert np.ptp(end) < 1e-3 * end.mean()


def ring(h, *, potential, wide=True, n=8, nu=0.3, pressure=2.0):
    """A quarter of a ring of radius 1 under e · pressure · Levy's load; a slice of a long tube."""
    half = np.cos(np.pi / 4 / n)
    grid = box([1 - h / 2, 1 + h / 2], np.linspace(0, np.pi / 2, n + 1), [3, 3 + h], shape=polar)
    body = Body.build(grid, "hex27", bent=1)
    fixed = [plane(body, 0, 0), plane(body, 1, 0), plane(body, 2, 3)]
    fixed += [plane(body, 2, 3 + h)] if wide else []
    outside = body.surface(lambda P: np.hypot(P[:, 0], P[:, 1]) > half * (1 + h / 4))
    levy = 3 * h**3 / 12 / (1 - nu**2)
    push = Pressure(body, outside, lambda e: e * pressure * levy, potential=potential, fixed=fixed)
    return Scene(body, [Elastic(body, NeoHookean(1.0, nu)), push], fixed=fixed)


def walked(scene):
    steps = LoadSteps(rtol=1e-8, step=0.1)
    return trace(scene, np.zeros(scene.size), steps, until=load(1.0), max_steps=40)


@pytest.mark.parametrize("potential", ["volume", None])
def test_a_ring_in_plane_strain_buckles_at_levy_s_pressure(potential):
    # Levy 1884 (Timoshenko and Gere, Theory of Elastic Stability, 7.3): p = 3 EI/R³ for a pressure
    # that stays normal, with E/(1 − ν²) in plane strain; a dead radial load would need 4.
    path = walked(ring(0.02, potential=potential))
    (event,) = path.events
    assert event.kind == "branch" and event.unstable == (0, 1)
    assert 2 * event.e == approx(1, rel=2e-3)
    assert path.warnings == () and path.last.unstable == 1


def test_rows_are_no_modes_of_an_unsymmetric_stiffness():
    make = [(row, axis) for row in (translation_row, rotation_row) for axis in range(3)]
    rows = [row(BODY, axis) for row, axis in make]
    terms = [Elastic(BODY, NeoHookean(1.0, 0.3)), Pressure(BODY, faces(BODY, (2, 0.8)), 0.01)]
    scene = Scene(BODY, terms, rows=rows)
    assert not scene.symmetric
    assert scene.system(np.zeros(scene.size), 1.0).unstable == 0


def test_modes_that_an_unsymmetric_stiffness_leaves_open_are_a_warning():
    # With a free edge the ring's own width changes: the pressure there has no potential.
    path = walked(ring(0.05, potential=None, wide=False))
    (warning,) = path.warnings
    assert isinstance(warning, Uncounted)
    assert "modes were not counted at" in str(warning) and "pressure isn't symm" in str(warning)
    known = [p.unstable for p in path.points if p.e * 2 < 0.85]
    assert known and set(known) == {0}  # its symmetric part decides there
    assert path.last.unstable is None
    with pytest.raises(ValueError, match="no potential here"):
        ring(0.05, potential="volume", wide=False)
