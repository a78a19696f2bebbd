"""What fills a cavity and resists: derivatives, spheres, cylinders, and no compression at all."""

import numpy as np
import pytest
import reference_scenes as case
from proofs import BODIES, prove, state
from pytest import approx
from scipy.optimize import brentq

from solver.equilibrium.newton import newton
from solver.equilibrium.scene import Scene
from solver.paths.continuation import trace
from solver.paths.steppers import LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.growth import Apical
from solver.physics.materials import NeoHookean
from solver.physics.pressure import Enclosed, Pressure
from solver.physics.supports import Fixed, rotation_row, translation_row

# Thick neo-Hookean sphere, ν = 0.3, h = 0.05 of the mid radius: p/E at inner stretches on both
# sides of its limit of 0.020954 at 1.531 (an ordinary differential equation, 1e-12).
RADIAL = {1.2: 0.0161545, 1.4: 0.0204693, 1.75: 0.0202319, 2.5: 0.0154945}


def filled(scene, bulk, content=1.0):
    """A sphere's or cylinder's scene with a filling in place of its pressure."""
    elastic, load = scene.terms
    fixed = case_fixed(scene)
    full = Enclosed(scene.body, load.surface, bulk, content=content, fixed=fixed)
    return Scene(scene.body, [elastic, full], fixed=fixed), full


def case_fixed(scene):
    X = scene.body.nodes
    normals = (case.AXES[1], case.AXES[2], np.array([1.0, -1, 0]), np.array([1.0, 0, -1]))
    return [Fixed(np.flatnonzero(np.abs(X @ n) < 1e-9), n) for n in normals]


@pytest.mark.parametrize("element", ["hex27", "hex8", "tet10"])
@pytest.mark.parametrize("size", [0.15, -0.15])
def test_derivatives_around_a_whole_body(element, size):
    body = BODIES[element]
    term = Enclosed(body, body.surface(lambda X: X[:, 0] > -1), 3.0, content=lambda e: 1 + e)
    u = state(body, size=abs(size)) + size * body.nodes
    assert (term.volume(u) > 1.2) == (size > 0)
    prove(term, u, 0.2)


def test_a_cavity_of_which_planes_leave_a_part():
    scene, term = filled(case.sphere(), 0.7, 1.1)
    u = 0.05 * scene.body.nodes + 0.01 * np.random.default_rng(0).normal(
        size=scene.body.nodes.shape
    )
    prove(term, u, 0.0, rtol=1e-5)
    grown = 0.1 * scene.body.nodes
    assert term.volume(grown) == approx(1.1**3)
    assert term.pressure(grown, 0.0) == approx(0.7 * (1.1 - 1.1**3))
    # A 24th of ½ K v₀ (V/v₀ − c)² of the whole ball.
    whole = 4 / 3 * np.pi * 0.975**3 * 0.7 * (1.1**3 - 1.1) ** 2 / 2
    assert term.evaluate(grown, 0.0, 0).energy == approx(whole / 24, rel=2e-4)
    # What is squeezed presses outwards.
    force = term.evaluate(-0.1 * scene.body.nodes, 0.0, 1).force
    assert (force * scene.body.nodes).sum() < 0


@pytest.mark.parametrize("bulk", [0.05, 1e3])
def test_a_sphere_that_is_filled_passes_its_limit_point_without_an_unstable_mode(bulk):
    """Content c = s³ + p/K brings it to the stretch s, where p falls while it swells, too: a given
    pressure has no stable state there."""
    for s, p in RADIAL.items():
        content = s**3 + p / bulk
        scene, term = filled(case.sphere(), bulk, lambda e, c=content: 1 + e * (c - 1))
        path = trace(scene, np.zeros(scene.size), LoadSteps(1e-9, 0.2), max_steps=30, events=False)
        assert path.reached and {point.unstable for point in path.points} == {0}
        u = scene.displacement(path.last.x, 1.0)
        assert term.pressure(u, 1.0) == approx(p, rel=1e-3)
        assert case.inner_stretch(scene, path.last.x, 1.0) == approx(s, rel=1e-3)
        # Newton's own order: the dyad is in the tangent.
        assert path.iterations < 9 * len(path.points)
        # Without it the mode is there.
        held = Pressure(scene.body, term.surface, p, potential="volume", fixed=case_fixed(scene))
        bare = Scene(scene.body, [scene.terms[0], held], fixed=case_fixed(scene))
        assert bare.system(path.last.x, 1.0).unstable == (1 if s > 1.53 else 0)


def test_a_soft_filling_of_a_sphere_past_its_limit_leaves_the_mode():
    """dp/ds of the shell is about −0.005 at s = 1.75; a filling of K gives 3 s² K to it."""
    s, p = 1.75, RADIAL[1.75]
    base = case.sphere()
    scene, _ = filled(base, 1e3, lambda e: 1 + e * (s**3 + p / 1e3 - 1))
    there = trace(scene, np.zeros(scene.size), LoadSteps(1e-9, 0.2), max_steps=30, events=False)
    for bulk, modes in ((2e-4, 1), (5e-3, 0)):
        scene, _ = filled(base, bulk, s**3 + p / bulk)
        # In its state already; a saddle is one, too.
        result = newton(scene, there.last.x, 1.0, rtol=1e-9)
        assert result.converged and result.iterations <= 4
        assert case.inner_stretch(scene, result.x, 1.0) == approx(s, rel=5e-3)
        assert result.system.unstable == modes


def test_a_filled_cylinder_answers_as_lame_says():
    """Plane strain, small: u(a) = p a (1 + ν) [(1 − 2ν) a² + b²] / (E (b² − a²)), V/v₀ = 1 + 2 u/a,
    p = K (c − V/v₀)."""
    base = case.cylinder(nu=0.3)
    body, (elastic, load) = base.body, base.terms
    fixed = [*case.held(body, 0, 0.0, 0), *case.held(body, 1, 0.0, 1)]
    fixed += [*case.held(body, 2, 0.0, 2), *case.held(body, 2, 0.3, 2)]
    a, b, nu, K, c = 0.9, 1.1, 0.3, 0.4, 1 + 1e-4
    term = Enclosed(body, load.surface, K, content=c, fixed=fixed)
    scene = Scene(body, [elastic, term], fixed=fixed)
    result = newton(scene, np.zeros(scene.size), 1.0, rtol=1e-11)
    soft = (1 + nu) * ((1 - 2 * nu) * a * a + b * b) / (b * b - a * a)
    p = K * (c - 1) / (1 + 2 * K * soft)
    u = scene.displacement(result.x, 1.0)
    assert term.pressure(u, 1.0) == approx(p, rel=1e-3)
    assert case.inner_stretch(scene, result.x, 1.0) - 1 == approx(soft * p, rel=1e-3)


def dented(load_or_bulk, kind):
    """A sphere one of whose sides contracts outside, under a pressure or around a filling."""
    base = case.sphere()
    body, fixed = base.body, case_fixed(base)
    X = body.points()
    r = np.linalg.norm(X, axis=-1)
    pattern = np.exp(-8 * (1 - X[..., 0] / r)) * np.clip((r - 0.975) / 0.05, 0, 1)
    elastic = Elastic(body, NeoHookean(1.0, 0.3), Apical(lambda e: -0.05 * e, pattern))
    wall = base.terms[1].surface
    if kind == "pressure":
        term = Pressure(body, wall, load_or_bulk, potential="volume", fixed=fixed)
    else:
        term = Enclosed(body, wall, load_or_bulk, fixed=fixed)
    scene = Scene(body, [elastic, term], fixed=fixed)
    path = trace(scene, np.zeros(scene.size), LoadSteps(1e-10, 0.5), max_steps=20, events=False)
    assert path.reached
    return scene.displacement(path.last.x, 1.0), Enclosed(body, wall, 1.0, fixed=fixed)


def test_without_compression_it_is_the_state_of_lagranges_multiplier():
    """V = v₀ with a multiplier p: stationary E − p (V − v₀), found by root-finding on p."""

    def excess(p):
        u, volume = dented(p, "pressure")
        return volume.volume(u) - 1

    p = brentq(excess, 5e-4, 2e-3, xtol=1e-12)
    exact, volume = dented(p, "pressure")
    assert abs(volume.volume(exact) - 1) < 1e-9
    size, off = np.abs(exact).max(), []
    free, _ = dented(0.0, "pressure")
    assert np.abs(free - exact).max() > 0.2 * size
    for bulk in (1.0, 10.0, 1e4):
        u, volume = dented(bulk, "filling")
        off.append(np.abs(u - exact).max() / size)
        assert bulk * (1 - volume.volume(u)) == approx(p, rel=0.1 / bulk)
    assert off[0] / off[1] == approx(10, rel=0.2) and off[2] < 1e-5


def test_modes_are_those_of_the_whole_stiffness():
    """Blocks and dyad as one dense matrix, rows included."""
    body = BODIES["hex8"]
    term = Enclosed(body, body.surface(lambda X: X[:, 0] > -1), 0.4)
    rows = [translation_row(body, k) for k in range(3)] + [rotation_row(body, k) for k in range(3)]
    scene = Scene(body, [Elastic(body, NeoHookean(1.0, 0.3)), term], rows=rows)
    u = 0.8 * body.nodes + 0.05 * state(body)
    x = scene.unknowns(u)
    system = scene.system(x, 0.0)
    n = scene.size
    columns = [system.pushed(np.zeros(n)).linear_residual(d)[0] for d in np.eye(n)]
    A = np.array(columns)
    assert approx(A.T, abs=1e-9 * np.abs(A).max()) == A
    b = np.random.default_rng(0).normal(size=(n, 2))
    assert A @ system.factorise().solve(b) == approx(b, abs=1e-7)
    values = np.linalg.eigvalsh(A)
    assert system.unstable == (values < 0).sum() - 6
    # The bulk's own pull makes some, and the dyad takes one away.
    bare = scene.system_of(scene.evaluate(u, 0.0).stiffness)
    assert bare.unstable >= system.unstable
    # What is held or pushed keeps the dyad; what is held does not move.
    held = np.zeros(n, bool)
    held[:5] = True
    d = np.random.default_rng(1).normal(size=n)
    d[held] = 0.0
    for one in (system.shifted(0.1), system.holding(held)):
        f = one.pushed(np.zeros(n)).linear_residual(d)[0]
        extra = 0.1 * d if one.dyads is system.dyads else 0 * d
        extra[scene.n_free :] = 0.0
        assert f[~held] == approx((A @ d + extra)[~held], abs=1e-9)
        assert one.factorise().solve(f) == approx(d, abs=1e-8)


def test_a_scene_without_a_filling_has_no_dyads():
    scene = case.sphere()
    assert scene.evaluate(np.zeros_like(scene.body.nodes), 0.5).dyads == ()
    assert scene.system(np.zeros(scene.size), 0.5).dyads is None


def test_what_fills_nothing_is_refused():
    body = BODIES["hex27"]
    whole = body.surface(lambda X: X[:, 0] > -1)
    with pytest.raises(ValueError, match="the bulk modulus = 0; expected one finite number > 0"):
        Enclosed(body, whole, 0)
    with pytest.raises(ValueError, match="nodes of the surface's rim are free"):
        Enclosed(body, body.surface(lambda X: X[:, 2] < 1e-9), 1.0)
    flat = Fixed(body.nodes_where(lambda X: X[:, 2] < 1e-9), [0, 0, 1])
    with pytest.raises(ValueError, match="the surface encloses a volume of"):
        Enclosed(body, body.surface(lambda X: X[:, 2] < 1e-9), 1.0, fixed=[flat, *(
            Fixed(flat.nodes, d) for d in ([1, 0, 0], [0, 1, 0]))])  # fmt: skip
    with pytest.raises(ValueError, match="the content = nan"):
        Enclosed(body, whole, 1.0, content=lambda e: np.nan).evaluate(0 * body.nodes, 0.0)
