"""Bad elements, bad first steps, growth that jumps: exact solutions, or endings in words."""

import numpy as np
import pytest
import skfem
from hard_scenes import half_strip
from reference_scenes import AXES, MidLine, held, modulus, near, strip

from solver.equilibrium.descent import descend
from solver.equilibrium.newton import newton
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.quality import quality
from solver.mesh.structured import box
from solver.paths.continuation import load, trace
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.growth import General, Isotropic, Orthotropic
from solver.physics.loads import Traction
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed


def symmetric_corner(body):
    """The three planes through the origin held, each along its normal."""
    return [support for axis in range(3) for support in held(body, axis, 0.0, axis)]


# -- slivers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("thin", [1e-3, 1e-6])
def test_slivers_of_hexahedra_carry_uniform_growth_without_stress(thin):
    """Layers a millionth as thick as their neighbours: free growth of −30 % leaves no stress
    (1e-8 E) and moves each node by exactly its share."""
    axis = np.array([0, 0.5, 0.5 + thin, 1.0])
    body = Body.build(box(axis, axis, axis), "hex27")
    term = Elastic(body, NeoHookean(1.0, 0.3), Isotropic(lambda e: -0.3 * e))
    scene = Scene(body, [term], fixed=symmetric_corner(body))
    assert quality(body).aspect[0] > 0.4 / thin
    path = trace(scene, np.zeros(scene.size), LoadSteps(1e-9, 0.5), max_steps=20)
    assert path.reached and path.last.unstable == 0
    u = scene.displacement(path.last.x, 1.0)
    assert np.abs(u + 0.3 * body.nodes).max() < 1e-8
    assert abs(path.last.energy) < 1e-12


@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_slivers_of_tetrahedra_carry_a_homogeneous_strain(element):
    """Tetrahedra squeezed nearly flat (scaled Jacobian below 1e-2): a block sheared and stretched
    by its boundary takes the homogeneous state inside, to 1e-8."""
    mesh = skfem.MeshTet.init_tensor(*(np.linspace(0, 1, 4),) * 3)
    p = mesh.p.copy()
    inner = ((p > 0.1) & (p < 0.9)).all(axis=0)
    # Inner nodes of the two middle layers nearly meet.
    p[2, inner] = 0.5 + (p[2, inner] - 0.5) * 3e-3
    body = Body.build(type(mesh)(p, mesh.t), element)
    assert quality(body).scaled_jacobian[0] < 1e-2
    H = np.array([[0.2, 0.3, 0], [0, -0.1, 0], [0.1, 0, 0.15]])
    outside = body.nodes_where(lambda X: ((X < 1e-9) | (X > 1 - 1e-9)).any(axis=1))
    want = body.nodes @ H.T
    fixed = [Fixed(outside, AXES[k], value=lambda e, k=k: e * want[outside, k]) for k in range(3)]
    scene = Scene(body, [Elastic(body, NeoHookean(1.0, 0.3))], fixed=fixed)
    path = trace(scene, np.zeros(scene.size), LoadSteps(1e-9, 0.25), max_steps=40)
    assert path.reached and path.last.unstable == 0
    assert np.abs(scene.displacement(path.last.x, 1.0) - want).max() < 1e-8


def test_a_sliver_in_a_cantilever_changes_nothing():
    """A column of elements 1e-5 long in a thin cantilever (end load 4, references.md §1): the tip's
    angle is the elastica's to 0.5 % and that without the sliver to 1e-4."""
    angles, h = [], 0.01
    for s in (np.linspace(0, 1, 11), np.sort(np.append(np.linspace(0, 1, 11), 0.4 + 1e-5))):
        z = np.array([-h / 2, h / 2])
        body = Body.build(box(s, [0, h], z), "hex27", bent=0)
        sides = [*held(body, 1, 0.0, 1), *held(body, 1, h, 1), *held(body, 0, 0.0, 0, 1, 2)]
        end = body.surface(near(0, 1.0))
        terms = [
            Elastic(body, NeoHookean(modulus(h), 0.0)),
            Traction(body, end, lambda e: np.array([0, 0, -4 * e / h])),
        ]
        scene = Scene(body, terms, fixed=sides)
        path = trace(scene, np.zeros(scene.size), LoadSteps(1e-8, 0.2), max_steps=60)
        assert path.reached and path.last.unstable == 0
        X = body.nodes
        end = np.flatnonzero((X[:, 0] > 1 - 1e-9) & (X[:, 1] < 1e-9))
        end = end[np.argsort(X[end, 2])]
        d = (X + scene.displacement(path.last.x, 1.0))[end]
        angles.append(-np.arctan2(-(d[-1] - d[0])[0], (d[-1] - d[0])[2]))
    assert angles[1] == pytest.approx(1.121239347, rel=5e-3)
    assert angles[1] == pytest.approx(angles[0], rel=1e-4)


# -- first steps that turn elements inside out ----------------------------------------------------


def pressed(by):
    """A confined block of 2 × 2 × 4 elements whose top comes down by e·by; height 1."""
    body = Body.build(box([0, 0.5, 1], [0, 0.5, 1], np.linspace(0, 1, 5)), "hex8")
    top = body.nodes_where(near(2, 1.0))
    walls = [*held(body, 0, 0.0, 0), *held(body, 0, 1.0, 0), *held(body, 1, 0.0, 1)]
    walls += [*held(body, 1, 1.0, 1), *held(body, 2, 0.0, 2)]
    fixed = [*walls, Fixed(top, AXES[2], value=lambda e: -e * by)]
    return Scene(body, [Elastic(body, NeoHookean(1.0, 0.3))], fixed=fixed)


@pytest.mark.parametrize(
    "stepper",
    [
        LoadSteps(1e-10, 1.0, first=1.0),
        StableSteps(LoadSteps(1e-10, 1.0, first=1.0), locate=False),
        ArcLength(1e-10, a=1.0, b=1.0),
    ],
    ids=["load steps", "settle", "arc"],
)
def test_a_first_step_that_inverts_elements_is_shortened(stepper):
    """The top of a block comes down by 80 % in one step, three elements deep: the step is cut, and
    the end is the homogeneous state to 1e-8."""
    scene = pressed(0.8)
    straight = scene.displacement(np.zeros(scene.size), 1.0)
    assert scene.energy(np.zeros(scene.size), 1.0) == np.inf  # as it stands, it is inside out
    path = trace(scene, np.zeros(scene.size), stepper, max_steps=200)
    assert path.reached and path.last.unstable == 0
    want = np.zeros_like(straight)
    want[:, 2] = -0.8 * scene.body.nodes[:, 2]
    assert np.abs(scene.displacement(path.last.x, 1.0) - want).max() < 1e-8


def test_a_body_pressed_through_itself_ends_in_words():
    """The top is asked to pass the bottom: the path stops below the load at which nothing is left
    of the body, with an outcome, finite states and falling steps; a guess that is inside out is
    called inadmissible."""
    scene = pressed(1.25)
    path = trace(scene, np.zeros(scene.size), LoadSteps(1e-10, 0.5), max_steps=300)
    assert path.outcome is Outcome.MIN_STEP
    assert 0.6 < path.last.e < 0.8 and np.isfinite(path.last.x).all()
    for method in (newton, descend):
        found = method(scene, np.zeros(scene.size), 1.0, rtol=1e-9)
        assert found.outcome is Outcome.INADMISSIBLE


# -- growth that jumps ---------------------------------------------------------------------------


def test_growth_that_jumps_along_the_axis_it_acts_on_leaves_no_stress():
    """g = −0.4 on one side of a plane and +0.7 on the other, acting across it: compatible, so the
    energy is 0 (1e-14) and each half is stretched by its own factor, exactly."""
    body = Body.build(box(np.linspace(0, 1, 5), [0, 0.3], [0, 0.2]), "hex27")
    g = lambda e, X: e * np.where(X[..., 0] < 0.5, -0.4, 0.7)  # noqa: E731
    term = Elastic(body, NeoHookean(1.0, 0.3), Orthotropic([g, 0.0, 0.0]))
    scene = Scene(body, [term], fixed=symmetric_corner(body))
    path = trace(scene, np.zeros(scene.size), LoadSteps(1e-10, 0.5), max_steps=20)
    assert path.reached and abs(path.last.energy) < 1e-14
    x = body.nodes[:, 0]
    want = np.where(x < 0.5, -0.4 * x, -0.2 + 0.7 * (x - 0.5))
    assert scene.displacement(path.last.x, 1.0)[:, 0] == pytest.approx(want, abs=1e-10)


@pytest.mark.parametrize("end", [0.23, 0.25, 0.26])
def test_curvature_that_jumps_inside_an_element(end):
    """A natural curvature of 4 that ends at s = 0.23, 0.25 (an element's edge) or 0.26: the tip
    turns by 4 times that, off by no more than half an element's turning."""
    h, n = 0.01, 10
    body, term, fixed = half_strip(h, n, lambda e, x: 4 * e * (x < end))
    foot = body.nodes_where(lambda X: np.linalg.norm(X, axis=1) < 1e-9)
    scene = Scene(body, [term], fixed=[*fixed, Fixed(foot, AXES[2])])
    path = trace(scene, np.zeros(scene.size), LoadSteps(1e-9, 0.25), max_steps=30)
    assert path.reached and path.last.unstable == 0
    turned = MidLine(scene).tip(path.last.x, 1.0)[2]
    slack = 1e-4 if end == 0.25 else 4 * 0.05 / 2
    assert turned == pytest.approx(4 * end, abs=slack)


def test_growth_that_jumps_in_time_is_followed_to_the_same_end():
    """Contraction that comes all at once at e = ½: load steps fall to the state that a smooth rise
    leads to (1e-7), and none of the steps before it feels anything."""
    ends = []
    for rise in (lambda e: e, lambda e: float(e >= 0.5)):
        h = 0.02
        body, fixed = strip(h, 8)
        z = body.points()[..., 2]

        def tensor(e, rise=rise, z=z):
            Fg = np.broadcast_to(np.eye(3), (*z.shape, 3, 3)).copy()
            Fg[..., 0, 0] = 1 - rise(e) * 2 * z
            return Fg

        term = Elastic(body, NeoHookean(modulus(h), 0.0), General(tensor))
        scene = Scene(body, [term], fixed=[*fixed, *held(body, 0, 0.0, 0, 1, 2)])
        path = trace(
            scene,
            np.zeros(scene.size),
            StableSteps(LoadSteps(1e-9, 0.1), locate=False),
            max_steps=90,
            events=False,
        )
        assert path.reached and path.last.unstable == 0
        ends.append(scene.displacement(path.last.x, 1.0))
        if len(ends) == 2:
            before = [p for p in path.points if p.e < 0.5]
            assert before and all(np.abs(p.x).max() < 1e-12 for p in before)
    assert np.abs(ends[1] - ends[0]).max() < 1e-7
    assert np.abs(ends[0][:, 2]).max() > 0.3


def test_a_load_that_no_step_can_cross_is_named():
    """Growth whose determinant vanishes at e = ½ and is sound beyond: the path stops before it."""
    body = Body.build(box([0, 1], [0, 1], [0, 1]), "hex8")
    term = Elastic(body, NeoHookean(1.0, 0.3), Isotropic(lambda e: -2 * e if e < 0.5 else e - 1.5))
    scene = Scene(body, [term], fixed=symmetric_corner(body))
    path = trace(scene, np.zeros(scene.size), LoadSteps(1e-9, 0.1), until=load(0.7), max_steps=300)
    assert path.outcome is Outcome.MIN_STEP and 0.45 < path.last.e < 0.5
