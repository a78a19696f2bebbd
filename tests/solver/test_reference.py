"""Verification cases of states and materials: closed forms, ODEs, spectral elements.

Where a case follows a path it starts unloaded and the load comes with e in [0, 1].
"""

import numpy as np
import pytest
import reference_scenes as case
from reference_scenes import at_end, walked
from scipy.interpolate import CubicSpline

from solver.cases.unit import problem_p
from solver.mesh.body import Body
from solver.paths.continuation import load
from solver.paths.steppers import ArcLength, LoadSteps
from solver.physics.materials import NeoHookean, SmallStrain

# -- 0. growth -----------------------------------------------------------------------------------


def test_stress_free_curling_closes_a_ring():
    scene = case.ring(n=16)
    x, e = at_end(scene)
    unrelaxed = scene.energy(np.zeros(scene.size), 1.0)
    assert scene.energy(x, e) < 1e-3 * unrelaxed
    assert case.MidLine(scene).tip(x, e)[2] == pytest.approx(2 * np.pi, rel=1e-3)


# -- 1. elastica ---------------------------------------------------------------------------------

END_LOAD = {
    1: (0.461351950, 0.301720774, 0.056433236),
    4: (1.121239347, 0.669964181, 0.328941242),
    10: (1.430285539, 0.810609025, 0.554995598),
    50: (1.567981902, 0.917155447, 0.800000396),
}
OWN_WEIGHT = {
    1: (0.165115561, 0.123471402, 0.008753605),
    10: (1.052643117, 0.700199716, 0.343646239),
    100: (1.564107321, 0.937523935, 0.840776617),
    1000: (1.570796322, 0.981141273, 0.954013549),
}


@pytest.mark.parametrize("alpha", END_LOAD)
def test_elastica_under_an_end_load(alpha):
    scene = case.cantilever(tip_load=alpha, h=0.005, n=20)
    drop, shortening, angle = case.MidLine(scene).tip(*at_end(scene))
    want = END_LOAD[alpha]
    assert -angle == pytest.approx(want[0], rel=5e-3)
    assert drop == pytest.approx(want[1], rel=5e-3)
    assert shortening == pytest.approx(want[2], rel=5e-3)


@pytest.mark.parametrize("gamma", OWN_WEIGHT)
def test_heavy_cantilever(gamma):
    scene = case.cantilever(weight=gamma, h=0.005, n=20)
    drop, shortening, angle = case.MidLine(scene).tip(*at_end(scene))
    want = OWN_WEIGHT[gamma]
    assert -angle == pytest.approx(want[0], rel=5e-3)
    assert drop == pytest.approx(want[1], rel=5e-3)
    assert shortening == pytest.approx(want[2], rel=5e-3)


@pytest.mark.parametrize("n, rel", [(10, 0.01), (20, 0.005)])
@pytest.mark.parametrize("alpha", [1, 10])
def test_elements_a_hundred_times_longer_than_thick_do_not_lock(alpha, n, rel):
    scene = case.cantilever(tip_load=alpha, h=1e-3, n=n)
    drop, _, angle = case.MidLine(scene).tip(*at_end(scene))
    assert drop == pytest.approx(END_LOAD[alpha][1], rel=rel)
    assert -angle == pytest.approx(END_LOAD[alpha][0], rel=rel)


def test_full_integration_locks_where_two_points_do_not():
    scene = case.cantilever(tip_load=1, h=1e-3, n=10, bent=None)
    drop, _, _ = case.MidLine(scene).tip(*at_end(scene))
    assert drop < 0.8 * END_LOAD[1][1]


# -- 3. bilayers ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options, want",
    [
        ({"g": -0.1}, 1.206097),
        ({"g": -0.2}, 2.399492),
        ({"g": -0.3}, 3.580054),
        ({"g": -0.1, "plane": "stress"}, 1.203789),
        ({"g": -0.3, "plane": "stress"}, 3.549908),
        # The reference's "isotropic" contracts in the plane only; thickness kept.
        ({"g": -0.1, "growth": "in-plane"}, 1.605560),
    ],
)
def test_bilayer_in_pure_bending(options, want):
    scene = case.bilayer(**options)
    angle = 50 * case.bilayer_curvature(scene, *at_end(scene))
    assert angle == pytest.approx(want, rel=5e-3)


def section_angle(g, stretches, m=5.0, n=0.1, nu=0.3, points=30):
    """Pure bending of the cross-section alone, one-dimensional: no σ_zz, sections stay plane."""
    from scipy.optimize import minimize

    z = (np.arange(points) + 0.5) / points
    Z = np.concatenate([z, 1 + m * z])
    w = np.concatenate([np.full(points, 1 / points), np.full(points, m / points)])
    active = Z > 1
    Gy, Gx, Gz = (np.where(active, 1 + g * s, 1.0) for s in stretches)
    E = np.where(active, n, 1.0)
    lam, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))

    def energy(p):
        stretch = np.full_like(Z, p[0])
        for _ in range(25):
            thick = np.ones_like(Z)
            for _ in range(8):  # Newton on σ_zz = 0
                J = stretch / Gy / Gx * thick
                thick -= (mu * (thick**2 - 1) + lam * np.log(J)) / (2 * mu * thick + lam / thick)
            t = thick * Gz
            stretch = p[0] + p[1] * (np.cumsum(t * w) - t * w / 2)
        a, b = stretch / Gy, 1 / Gx
        ln = np.log(a * b * thick)
        psi = mu / 2 * (a**2 + b**2 + thick**2 - 3 - 2 * ln) + lam / 2 * ln**2
        return (w * Gx * Gy * Gz * psi).sum()

    options = {"xatol": 1e-8, "fatol": 1e-14, "maxiter": 2000}
    found = minimize(energy, [1 + g / 2, -0.24 * g], method="Nelder-Mead", options=options)
    return abs(found.x[1]) * 50


@pytest.mark.parametrize("growth, stretches", [("isotropic", (1, 1, 1)), ("uniaxial", (1, 0, 0))])
def test_bilayer_against_its_own_cross_section(growth, stretches):
    scene = case.bilayer(-0.1, growth=growth)
    angle = 50 * case.bilayer_curvature(scene, *at_end(scene))
    assert angle == pytest.approx(section_angle(-0.1, stretches), rel=1e-3)


@pytest.mark.parametrize(
    "g, n, m, want",
    [(-0.3, 1e-3, 10.0, 0.411075), (-0.3, 1e3, 0.1, 0.356071), (-0.2, 10.0, 0.2, 0.294046)],
)
def test_bilayers_of_high_contrast(g, n, m, want):
    scene = case.bilayer(g, n=n, m=m)
    assert (1 + m) * case.bilayer_curvature(scene, *at_end(scene)) == pytest.approx(want, rel=5e-3)


# -- Problem P -----------------------------------------------------------------------------------


@pytest.mark.parametrize("element, level, rel", [("hex27", 1, 2e-3), ("hex20", 2, 2e-3)])
def test_problem_p(element, level, rel):
    scene = problem_p.scene(problem_p.mesh(level, element))
    path = walked(scene, LoadSteps(rtol=1e-7, step=1 / 6))
    for want, g in ((1.2393, 0.1), (2.4913, 0.2), (3.772, 0.3)):
        stop = path.last
        if g < 0.3:
            stop = walked(scene, LoadSteps(rtol=1e-7, step=1 / 6), until=load(g / 0.3)).last
        assert problem_p.fold_angle(scene, stop.x, stop.e) == pytest.approx(want, rel=rel)
    assert all(p.unstable in (0, None) for p in path.points)


def test_the_whole_unit_folds_like_its_quarter():
    angles = []
    for quarter in (True, False):
        scene = problem_p.scene(problem_p.mesh(0, "hex20", quarter=quarter), g=-0.1)
        x, e = at_end(scene, LoadSteps(rtol=1e-8, step=0.25))
        angles.append(problem_p.fold_angle(scene, x, e))
    assert angles[0] == pytest.approx(angles[1], rel=1e-6)


@pytest.mark.parametrize("element, level", [("hex20", 0), ("tet10", 0)])
def test_isotropic_contraction_from_flat_comes_out_alike_on_all_elements(element, level):
    body = problem_p.mesh(problem_p.LEVELS_ISOTROPIC[level], element, bent=False)
    scene = problem_p.scene(body, growth="isotropic")
    angle = problem_p.fold_angle(scene, *at_end(scene, LoadSteps(rtol=1e-7, step=1 / 12)))
    assert angle == pytest.approx(problem_p.ANGLE_ISOTROPIC, rel=0.015)


def test_linear_tetrahedra_lock():
    angles = []
    for element in ("tet4", "tet10"):
        scene = problem_p.scene(problem_p.mesh(1, element))
        angles.append(problem_p.fold_angle(scene, *at_end(scene)))
    assert angles[0] < 0.7 * problem_p.ANGLE
    assert angles[1] == pytest.approx(problem_p.ANGLE, rel=5e-3)


# -- 5. pressure ---------------------------------------------------------------------------------

SPHERE = {1.05: 0.0060399, 1.2: 0.0161545, 1.4: 0.0204693, 1.75: 0.0202319, 2.5: 0.0154945}


def pressure_at(path, scene, stretch):
    """e where the inner stretch passes a value, by interpolation between the path's points."""
    a = [case.inner_stretch(scene, p.x, p.e) for p in path.points]
    k = int(np.argmax(np.array(a) >= stretch))
    lo, hi = max(0, k - 3), min(len(a), k + 3)
    order = np.argsort(a[lo:hi])
    return float(CubicSpline(np.array(a[lo:hi])[order], path.loads[lo:hi][order])(stretch))


@pytest.mark.parametrize("closed", [True, False], ids=["energy", "follower"])
def test_thick_sphere_through_its_limit_point(closed):
    scene = case.sphere(closed=closed)
    path = walked(
        scene,
        ArcLength(rtol=1e-8, a=0.02, b=0.05),
        until=lambda p: case.inner_stretch(scene, p.x, p.e) - 2.6,
        events=closed,
    )
    for stretch, p in SPHERE.items():
        assert pressure_at(path, scene, stretch) * 0.03 == pytest.approx(p, rel=5e-3)
    if closed:
        (fold,) = [event for event in path.events if event.kind == "fold"]
        assert fold.e * 0.03 == pytest.approx(0.020954238, rel=5e-3)
        assert case.inner_stretch(scene, fold.x, fold.e) == pytest.approx(1.53123, rel=5e-3)


def test_nearly_incompressible_sphere():
    scene = case.sphere(nu=0.49, n=4)
    path = walked(
        scene,
        ArcLength(rtol=1e-8, a=0.02, b=0.05),
        until=lambda p: case.inner_stretch(scene, p.x, p.e) - 1.6,
        events=True,
    )
    (fold,) = [event for event in path.events if event.kind == "fold"]
    assert fold.e * 0.03 == pytest.approx(0.020697050, rel=5e-3)
    assert case.inner_stretch(scene, fold.x, fold.e) == pytest.approx(1.41030, rel=1e-2)


@pytest.mark.parametrize("p, stretch", [(0.0171131, 1.1), (0.0517117, 1.5), (0.0663562, 2.0)])
def test_thick_cylinder_has_no_limit_point(p, stretch):
    scene = case.cylinder(e_to=p)
    assert case.inner_stretch(scene, *at_end(scene)) == pytest.approx(stretch, rel=5e-3)


# -- 10. locking ---------------------------------------------------------------------------------


@pytest.mark.parametrize("element, n", [("hex27", 16), ("hex20", 16), ("tet10", 16)])
def test_cooks_membrane(element, n):
    scene, _ = case.cook(element=element, n=n)
    x, e = at_end(scene, LoadSteps(rtol=1e-8, step=1.0, first=1.0))
    X = scene.body.nodes
    middle = np.flatnonzero(
        (np.abs(X[:, 0] - 48) < 1e-6) & (np.abs(X[:, 1] - 52) < 1e-6) & (X[:, 2] < 1e-9)
    )
    assert scene.displacement(x, e)[middle, 1].mean() == pytest.approx(23.9677, rel=3e-3)


@pytest.mark.parametrize("nu, want", [(0.3, 7.8776), (0.49, 7.019), (0.4999, 6.955)])
def test_nearly_incompressible_slab(nu, want):
    # On a uniform mesh the stress at the clamped corner, not locking, costs 1 %.
    scene, right = case.cook(
        element="hex20", n=20, nu=nu, E=240.565, load=100, material=NeoHookean, plane="strain",
        ratio=100,
    )  # fmt: skip
    u = scene.displacement(*at_end(scene, LoadSteps(rtol=1e-8, step=0.25)))[right.nodes][..., 1]
    mean = np.einsum("fq,fqk,fk->", right.weights, right.shapes, u) / right.weights.sum()
    assert mean == pytest.approx(want, abs=0.01)


def test_full_quadratic_elements_lock_near_incompressibility_where_reduced_ones_do_not():
    def drop(element):
        scene, right = case.cook(
            element=element, n=8, nu=0.4999, E=240.565, load=100, material=NeoHookean,
            plane="strain", ratio=100,
        )  # fmt: skip
        x, e = at_end(scene, LoadSteps(rtol=1e-8, step=0.25))
        return scene.displacement(x, e)[right.nodes][..., 1].mean()

    assert drop("hex27") < 0.96 * 6.955 < 0.98 * 6.955 < drop("hex20")


# -- convergence ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "element, order", [("hex8", 2), ("tet4", 2), ("hex27", 3), ("hex20", 3), ("tet10", 3)]
)
def test_convergence_slopes(element, order):
    errors = [manufactured_error(element, n) for n in (2, 4, 8)]
    slope = np.log2(errors[1] / errors[2])
    assert slope > order - 0.3, errors


def manufactured_error(element, n):
    """L2 error of u for small strain with u* = sin(π x) sin(π y) sin(π z) (1, 2, −1) held at 0."""
    from solver.equilibrium.scene import Scene
    from solver.mesh.structured import box
    from solver.physics.elastic import Elastic
    from solver.physics.supports import Fixed
    from solver.physics.term import Evaluation

    s = np.linspace(0, 1, n + 1)
    body = Body.build(box(s, s, s, tets=element.startswith("tet")), element)
    E, nu = 1.0, 0.3
    lam, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    a = np.array([1.0, 2.0, -1.0])
    P = np.pi * body.points()
    S, C = np.sin(P), np.cos(P)
    product = S[..., 0] * S[..., 1] * S[..., 2]
    # −div σ = μ 3π² u* − (λ + μ) ∇ div u*
    grad_div = np.empty_like(P)
    for i in range(3):
        total = 0.0
        for j in range(3):
            if i == j:
                term = -product
            else:
                k = 3 - i - j
                term = C[..., i] * C[..., j] * S[..., k]
            total = total + a[j] * np.pi**2 * term
        grad_div[..., i] = total
    load = mu * 3 * np.pi**2 * product[..., None] * a - (lam + mu) * grad_div

    class BodyForce:
        name, graph, symmetric = "body force", None, True

        def evaluate(self, u, e, order=2):
            share = np.einsum("mq,qk,mqi->mki", body.weights, body.shapes, load)
            force = np.zeros_like(u)
            np.add.at(force, body.cells, -share)
            return Evaluation(float((force * u).sum()), force)

    outside = np.flatnonzero((np.abs(body.nodes * (1 - body.nodes)) < 1e-9).any(axis=1))
    fixed = [Fixed(outside, axis) for axis in np.eye(3)]
    scene = Scene(body, [Elastic(body, SmallStrain(E, nu)), BodyForce()], fixed=fixed)
    system = scene.system(np.zeros(scene.size), 1.0)
    u = scene.displacement(-system.factorise().solve(system.residual), 1.0)
    at_points = np.einsum("qk,mki->mqi", body.shapes, u[body.cells])
    off = at_points - product[..., None] * a
    return float(np.sqrt((body.weights[..., None] * off**2).sum()))
