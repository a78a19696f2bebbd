"""One contract over every term: energy → force → stiffness, proven where the term acts."""

import numpy as np
import pytest
from proofs import BODIES, ELEMENTS, block, matrix, prove, state
from pytest import approx

from solver.physics.elastic import Elastic
from solver.physics.fields import resolve
from solver.physics.ground import CENTRED, Ground, GroundExponential
from solver.physics.growth import Apical, General, Isotropic, Orthotropic
from solver.physics.loads import Gravity, Traction
from solver.physics.materials import (
    Fibre,
    FibreReinforced,
    NeoHookean,
    SmallStrain,
    StVenantKirchhoff,
)
from solver.physics.pressure import Pressure
from solver.physics.rubber import MooneyRivlin
from solver.physics.supports import Fixed

E, NU = 2.0, 0.3
FIBRES = [
    Fibre((1, 1, 0), k1=0.5, k2=2.0, tension_only=False),
    Fibre((0, 1, 2), k1=lambda e: 0.3 + e, k2=0.0, tension_only=True),
]
MATERIALS = {
    "neo-Hookean": NeoHookean(E, NU),
    "St Venant-Kirchhoff": StVenantKirchhoff(E, NU),
    "small strain": SmallStrain(E, NU),
    "fibres": FibreReinforced(E, NU, FIBRES),
    "Mooney-Rivlin": MooneyRivlin(lambda e: 0.2 + e, 0.3, 0.4),
    "moving fields": NeoHookean(lambda e, X: 1 + e * X[..., 0], lambda e: 0.2 * e),
}
OBJECTIVE = ["neo-Hookean", "St Venant-Kirchhoff", "fibres", "Mooney-Rivlin"]


def growth(body):
    half = body.cells_where(lambda X: X[:, 1] < 0.75)
    return Orthotropic((0.1, lambda e: -0.3 * e, lambda e, X: 0.2 * e * X[..., 0]), cells=half)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("material", MATERIALS)
def test_elastic_derivatives(element, material):
    body = BODIES[element]
    prove(Elastic(body, MATERIALS[material], growth(body)), state(body), 0.7)


def test_elastic_derivatives_without_growth_and_in_parts():
    body = BODIES["hex8"]
    left = body.cells_where(lambda X: X[:, 0] < 0.5)
    u = state(body)
    parts = [Elastic(body, MATERIALS["neo-Hookean"], cells=mask) for mask in (left, ~left)]
    for part in parts:
        prove(part, u, 0.0)
    whole = Elastic(body, MATERIALS["neo-Hookean"]).evaluate(u, 0.0)
    a, b = (part.evaluate(u, 0.0) for part in parts)
    assert a.energy + b.energy == approx(whole.energy, rel=1e-12)
    np.testing.assert_allclose(a.stiffness + b.stiffness, whole.stiffness, atol=1e-12)
    # Another way to the same layers: properties per cell.
    soft = Elastic(body, NeoHookean(np.where(left, E, 0.1 * E), NU)).evaluate(u, 0.0)
    np.testing.assert_allclose(soft.force, a.force + 0.1 * b.force, atol=1e-12)


def test_functions_of_e_follow_e(monkeypatch):
    # What a term remembers of the last e is invisible from outside, and so are its chunks of cells.
    body = BODIES["tet10"]
    top = body.surface(lambda X: X[:, 2] > 0.8 - 1e-9)
    X, u = body.points()[..., 0], state(body)
    left = body.cells_where(lambda X: X[:, 0] > 0.5)

    def fibres(direction):
        return Elastic(body, FibreReinforced(E, NU, [Fibre(direction, 0.5, 2.0, False)]))

    pairs = [
        (
            Elastic(body, MATERIALS["moving fields"], Isotropic(lambda e: -e / 2), cells=left),
            lambda e: Elastic(body, NeoHookean(1 + e * X, 0.2 * e), Isotropic(-e / 2), cells=left),
        ),
        (Gravity(body, lambda e: 1 + e, lambda e: 2 * e), lambda e: Gravity(body, 1 + e, 2 * e)),
        (Gravity(body, 1.5, lambda e: (0, e, -2)), lambda e: Gravity(body, 1.5, (0, e, -2))),
        (Traction(body, top, lambda e: (e, 0, 1)), lambda e: Traction(body, top, (e, 0, 1))),
        (Pressure(body, top, lambda e: e), lambda e: Pressure(body, top, e)),
        (fibres(lambda e: (1, e, 0)), lambda e: fibres((1, e, 0))),
    ]
    for e in (0.2, 0.9, 0.2):
        for used, fresh in pairs:
            monkeypatch.setattr("solver.physics.elastic.CHUNK", 16)
            mine = used.evaluate(u, e)
            monkeypatch.undo()
            at = fresh(e).evaluate(u, e)
            np.testing.assert_allclose(mine.force, at.force, rtol=0, atol=1e-14)
            if at.stiffness is not None:
                np.testing.assert_allclose(mine.stiffness, at.stiffness, rtol=0, atol=1e-14)
            assert mine.energy == (None if at.energy is None else approx(at.energy, rel=1e-12))


@pytest.mark.parametrize("material", OBJECTIVE)
def test_rigid_motion_does_no_work(material):
    body = BODIES["hex27"]
    term = Elastic(body, MATERIALS[material], growth(body))
    u = state(body)
    x, at = body.nodes + u, term.evaluate(u, 0.7, 1)
    size = np.abs(at.force).max()
    assert np.abs(at.force.sum(axis=0)).max() < 1e-12 * size * len(x)
    assert np.abs(np.cross(x, at.force).sum(axis=0)).max() < 1e-12 * size * len(x)
    Q, _ = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))
    Q *= np.sign(np.linalg.det(Q))
    turned = term.evaluate(x @ Q.T + np.array([3, -1, 2]) - body.nodes, 0.7, 1)
    assert turned.energy == approx(at.energy, rel=1e-11)
    np.testing.assert_allclose(turned.force, at.force @ Q.T, atol=1e-11 * size)


@pytest.mark.parametrize("element", ELEMENTS)
def test_free_uniform_growth_leaves_no_stress(element):
    body = BODIES[element]
    Q, _ = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))
    term = Elastic(body, NeoHookean(E, NU), Orthotropic((-0.3, 0.2, 0.5), Q))
    Fg = np.eye(3) + Q.T @ np.diag((-0.3, 0.2, 0.5)) @ Q
    free = term.evaluate(body.nodes @ (Fg - np.eye(3)).T, 1.0)
    assert np.abs(free.force).max() < 1e-10 * E
    assert abs(free.energy) < 1e-12 * E
    assert np.abs(term.evaluate(np.zeros_like(body.nodes), 1.0).force).max() > 0.01 * E
    # The same for a tensor that isn't symmetric.
    Fg = Q @ Fg
    free = Elastic(body, NeoHookean(E, NU), General(Fg)).evaluate(
        body.nodes @ (Fg.T - np.eye(3)), 0
    )
    assert np.abs(free.force).max() < 1e-10 * E


def test_the_energy_counts_the_grown_volume():
    body = BODIES["hex27"]
    g, stretch = -0.3, 1.1
    term = Elastic(body, NeoHookean(E, NU), Isotropic(lambda e: g * e))
    psi, _, _ = NeoHookean(E, NU).response(stretch / (1 + g) * np.eye(3))
    energy = term.evaluate((stretch - 1) * body.nodes, 1.0, 0).energy
    assert energy == approx((1 + g) ** 3 * psi * 1.2, rel=1e-12)  # box 1 × 1.5 × 0.8


@pytest.mark.parametrize("element", ELEMENTS)
def test_patch(element):
    body = BODIES[element]
    H = np.random.default_rng(4).uniform(-0.2, 0.2, (3, 3))
    inner = Elastic(body, MATERIALS["neo-Hookean"]).evaluate(body.nodes @ H.T, 0.0, 1).force
    _, P, _ = MATERIALS["neo-Hookean"].response(np.eye(3) + H)
    surface = body.surface(lambda X: np.full(len(X), True))
    outer = Traction(body, surface, np.einsum("ij,fqj->fqi", P, surface.normals))
    np.testing.assert_allclose(
        inner, -outer.evaluate(inner, 0.0, 1).force, atol=1e-12 * np.abs(P).max()
    )
    assert np.abs(inner).max() > 0.01 * E


def test_states_that_are_not_admissible_have_infinite_energy():
    body = BODIES["tet4"]
    for u in (-2 * body.nodes, np.full_like(body.nodes, np.nan)):
        at = Elastic(body, MATERIALS["neo-Hookean"]).evaluate(u, 0.0)
        assert at.energy == np.inf and at.force is None and at.stiffness is None
    assert Elastic(body, SmallStrain(E, NU)).evaluate(u, 0.0).energy == np.inf


# -- loads ---------------------------------------------------------------------------------------


def box_surface(body):
    return body.surface(lambda X: np.full(len(X), True))


@pytest.mark.parametrize("element", ELEMENTS)
def test_loads_derivatives(element):
    body = BODIES[element]
    u = state(body, size=0.4, noise=0.05)
    top = body.surface(lambda X: X[:, 2] > 0.8 - 1e-9)
    prove(Gravity(body, lambda e, X: 1 + e * X[..., 0], 9.81), u, 0.5)
    prove(Traction(body, top, lambda e: np.array([e, 1, 2])), u, 0.5)
    follower = Pressure(body, top, lambda e: 3 * e)
    prove(follower, u, 0.5)
    K = matrix(follower, follower.evaluate(u, 0.5).stiffness)
    assert abs(K - K.T).max() > 0.01 * abs(K).max() and not follower.symmetric
    closed = Pressure(body, box_surface(body), lambda e: 3 * e, potential="volume")
    prove(closed, u, 0.5)
    prove(GroundExponential(body, length=300, modulus=1e3, height=0.1), u, 0.0)


@pytest.mark.parametrize("element", ELEMENTS)
def test_pressure_on_a_closed_surface(element):
    body = BODIES[element]
    u = state(body, size=0.4, noise=0.05)
    surface = box_surface(body)
    closed, follower = (
        Pressure(body, surface, 2.0, potential=potential) for potential in ("volume", None)
    )
    at, plain = closed.evaluate(u, 0.0), follower.evaluate(u, 0.0)
    size = np.abs(at.force).max()
    assert plain.energy is None
    np.testing.assert_allclose(at.force, plain.force, atol=1e-12 * size)
    np.testing.assert_allclose(at.stiffness, plain.stiffness, atol=1e-11 * size)
    assert np.abs(at.force.sum(axis=0)).max() < 1e-12 * size
    assert np.abs(np.cross(body.nodes + u, at.force).sum(axis=0)).max() < 1e-12 * size
    # V = det F V₀ in an affine state.
    H = np.random.default_rng(8).uniform(-0.3, 0.3, (3, 3))
    volume = np.linalg.det(np.eye(3) + H) * 1.2
    assert closed.volume(body.nodes @ H.T) == approx(volume, rel=1e-12)
    assert closed.evaluate(body.nodes @ H.T, 0.0, 0).energy == approx(2 * volume, rel=1e-12)


@pytest.mark.parametrize("element", ELEMENTS)
def test_pressure_follows_nanson(element):
    body = BODIES[element]
    side = body.surface(lambda X: X[:, 1] > 1.5 - 1e-9)
    H = np.random.default_rng(9).uniform(-0.3, 0.3, (3, 3))
    F = np.eye(3) + H
    total = Pressure(body, side, 2.0).evaluate(body.nodes @ H.T, 0.0, 1).force.sum(axis=0)
    area = np.linalg.det(F) * np.linalg.inv(F).T @ [0, 1, 0] * 0.8  # side 1 × 0.8
    np.testing.assert_allclose(total, 2.0 * area, rtol=1e-12)  # force = dE/du = −load
    every = box_surface(body)
    only = 2.0 * np.isclose(every.normals[:, 0, 1], 1)  # one value per facet
    found = Pressure(body, every, only).evaluate(body.nodes @ H.T, 0.0, 1).force.sum(axis=0)
    np.testing.assert_allclose(found, total, rtol=1e-12)
    twice = Pressure(body, side, lambda e, X: 2 * X[..., 1] / 1.5 * (1 + e))
    np.testing.assert_allclose(
        twice.evaluate(body.nodes @ H.T, 1.0, 1).force.sum(axis=0), 4.0 * area, rtol=1e-12
    )


def test_pressure_with_a_held_rim_has_a_potential():
    body = BODIES["hex27"]
    skin = body.surface(lambda X: np.isclose(X, (1, 1.5, 0.8)).any(axis=1))
    planes = [
        Fixed(body.nodes_where(lambda X, k=k: X[:, k] < 1e-9), np.eye(3)[k]) for k in range(3)
    ]
    term = Pressure(body, skin, 1.5, potential="volume", fixed=planes)
    u = state(body)
    for plane in planes:
        u[plane.nodes] -= np.outer(u[plane.nodes] @ plane.direction, plane.direction)
    prove(term, u, 0.0)
    off = term.evaluate(u, 0.0, 1).force - Pressure(body, skin, 1.5).evaluate(u, 0.0, 1).force
    for plane in planes:
        off[plane.nodes] -= np.outer(off[plane.nodes] @ plane.direction, plane.direction)
    assert np.abs(off).max() < 1e-12
    rim = np.unique(np.concatenate([plane.nodes for plane in planes]))
    clamped = [Fixed(rim, axis) for axis in np.eye(3)]
    prove(Pressure(body, skin, 1.5, potential="volume", fixed=clamped, origin=(5, 5, 5)), u, 0.0)
    for wrong in ({}, {"fixed": planes[:2]}, {"fixed": planes, "origin": (0.1, 0.1, 0.1)}):
        with pytest.raises(ValueError, match=r"no potential here: .* free to move"):
            Pressure(body, skin, 1.5, potential="volume", **wrong)


def test_gravity_is_the_weight():
    for element in ELEMENTS:
        body = BODIES[element]
        half = body.cells_where(lambda X: X[:, 1] < 0.75)
        term = Gravity(body, np.where(half, 2.0, 1.0), 9.81)
        mass = 1.2 + body.weights[half].sum()
        u = state(body)
        at = term.evaluate(u, 0.0)
        np.testing.assert_allclose(at.force.sum(axis=0), [0, 0, 9.81 * mass], atol=1e-12)
        lifted = term.evaluate(u + np.array([5.0, 0, 2.0]), 0.0)
        assert lifted.energy - at.energy == approx(9.81 * mass * 2)
        assert term.evaluate(0 * u, 0.0).energy == approx(
            9.81 * (body.weights * (1.0 + half[:, None]) * body.points()[..., 2]).sum()
        )
    tilted = Gravity(body, 1.0, lambda e: e * np.array([0, 3.0, -4.0]))
    np.testing.assert_allclose(tilted.evaluate(u, 2.0).force.sum(axis=0), [0, -7.2, 9.6])


# -- ground --------------------------------------------------------------------------------------


@pytest.mark.parametrize("element", ELEMENTS)
def test_ground(element):
    body = BODIES[element]
    bottom = body.surface(lambda X: X[:, 2] < 1e-9)
    ground = Ground(body, bottom, thickness=0.8, pressure=3.0, height=-0.5)
    lie = np.zeros_like(body.nodes)
    lie[:, 2] = -0.5
    # Under its pressure it rests at the height of the ground, gap 0, on any element.
    at = ground.evaluate(lie, 0.0)
    assert -at.force[:, 2].sum() == approx(3.0 * 1.5, rel=1e-12)
    assert np.abs(ground.gaps(lie)).max() < 1e-15
    prove(ground, lie + 0.01 * state(body), 0.0)
    # No force beyond its reach; an infinite energy at its depth.
    edge = np.array([0, 0, 0.0801])
    above, below = lie + edge, lie - edge
    assert ground.evaluate(above, 0.0).energy == 0 and not ground.evaluate(above, 0.0).force.any()
    assert ground.evaluate(below, 0.0).energy == np.inf
    # A tilted block touches with its edge only, in contact and out of it.
    tilt = lie.copy()
    tilt[:, 2] += 0.3 * body.nodes[:, 0] - 0.03
    prove(ground, tilt, 0.0)
    assert (ground.evaluate(tilt, 0.0).force[body.nodes[:, 0] > 0.9] == 0).all()
    # A step stops short of the floor, whatever its length.
    down = below - above
    share = ground.longest_step(above, 10 * down)
    assert 0 < share < 0.1 and np.isfinite(ground.evaluate(above + share * 10 * down, 0.0).energy)
    assert ground.longest_step(lie, -down) == 1.0
    assert ground.longest_step(lie, 1e-3 * down) == 1.0


@pytest.mark.parametrize(("depth", "reach"), [(0.05, 0.2), (0.3, 0.1)])
def test_a_ground_carries_its_pressure_at_its_height_whatever_depth_and_reach(depth, reach):
    body = BODIES["hex8"]
    bottom = body.surface(lambda X: X[:, 2] < 1e-9)
    ground = Ground(body, bottom, thickness=0.8, pressure=3.0, depth=depth, reach=reach)
    u = np.zeros_like(body.nodes)
    assert -ground.evaluate(u, 0.0).force[:, 2].sum() == approx(3.0 * 1.5, rel=1e-12)
    u[:, 2] = 0.8 * reach * (1 + 1e-9)
    assert not ground.evaluate(u, 0.0).force.any()
    assert ground.evaluate(u - np.array([0, 0, 1e-3]), 0.0).force.any()
    u[:, 2] = -0.8 * depth * (1 + 1e-9)
    assert ground.evaluate(u, 0.0).energy == np.inf
    assert np.isfinite(ground.evaluate(u + np.array([0, 0, 1e-3]), 0.0).energy)


def test_ground_rules_with_facet_centres():
    # On plane rectangles the 20-node rule is the 27-node one: Simpson's.
    energies = []
    for element in ("hex27", "hex20"):
        body = block(element, distort=0)
        bottom = body.surface(lambda X: X[:, 2] < 1e-9)
        ground = Ground(body, bottom, thickness=0.8, pressure=3.0)
        tilt = np.zeros_like(body.nodes)
        tilt[:, 2] = 0.1 * body.nodes[:, 0] - 0.05 * body.nodes[:, 1]
        energies.append(ground.evaluate(tilt, 0.0).energy)
    assert energies[0] == approx(energies[1], rel=1e-12)
    weights, share = CENTRED["tet10"]
    L = np.vstack([np.eye(3), 0.5 * (np.eye(3) + np.roll(np.eye(3), 1, 1)), np.full(3, 1 / 3)])
    np.testing.assert_allclose(weights @ L[:, 0] ** 2, 1 / 6)  # mean of L₁² over a triangle
    np.testing.assert_allclose(weights @ L[:, 0] ** 3, 1 / 10)
    assert share @ L[:6, 0] ** 2 == approx(1 / 9)  # quadratics, at the centre


def test_ground_bounds_gap_and_penetration_for_any_load():
    body = BODIES["hex27"]
    bottom = body.surface(lambda X: X[:, 2] < 1e-9)
    ground = Ground(body, bottom, thickness=0.8, pressure=1.0)
    z = np.linspace(-0.0799, 0.0799, 400)
    u = np.zeros_like(body.nodes)
    load = []
    for height in z:
        u[:, 2] = height
        load.append(-ground.evaluate(u, 0.0, 1).force[:, 2].sum() / 1.5)
    assert (np.diff(load) < 0).all() and load[0] > 500 and 0 < load[-1] < 1e-5


def test_ground_of_the_dissertation():
    body = BODIES["hex27"]
    term = GroundExponential(body, length=500.0, modulus=4.0)  # a = 2, b = 4e-3
    flat = term.evaluate(np.zeros_like(body.nodes), 0.0)
    whole = 4e-3 * 1.5 * (1 - np.exp(-1.6)) / 2
    assert flat.energy == approx(whole, rel=1e-3)  # quadrature of an exponential
    assert -flat.force[:, 2].sum() == approx(2 * flat.energy, rel=1e-12)


# -- bad input -----------------------------------------------------------------------------------

BODY = BODIES["hex8"]
SIDE = BODY.surface(lambda X: X[:, 2] < 1e-9)
M, Q = BODY.weights.shape
SOLID = NeoHookean(E, NU)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: NeoHookean(-1.0, NU), "E = -1; expected E > 0"),
        (lambda: NeoHookean(np.array([1, np.nan]), NU), "expected E > 0"),
        (lambda: SmallStrain(E, 0.5), "nu = 0.5; expected -1 < nu < 0.5"),
        (lambda: StVenantKirchhoff(E, -1.0), "expected -1 < nu < 0.5"),
        (lambda: Elastic(BODY, NeoHookean(lambda e: e - 1, NU)), "expected E > 0"),
        (lambda: Elastic(BODY, NeoHookean(np.ones(M + 1), NU)), r"E gave shape \(5,\); expected"),
        (lambda: FibreReinforced(E, NU, []), "no fibre family"),
        (lambda: MooneyRivlin(-1.0, 2.0, 0.4), "c10 = -1, c01 = 2; expected both >= 0"),
        (lambda: MooneyRivlin(0.0, 0.0, 0.4), "not both 0"),
        (lambda: MooneyRivlin(1.0, 0.0, 0.5), "nu = 0.5; expected -1 < nu < 0.5"),
        (lambda: MooneyRivlin(1.0, 1.0, 0.2), "nu = 0.2; expected nu >= .* = 0.25"),
        (lambda: Elastic(BODY, MooneyRivlin(1.0, lambda e: e - 1, 0.4)), "c01 = -1; expected"),
        (lambda: FibreReinforced(E, NU, [Fibre((1, 0, 0), -1, 0.0, False)]), "expected k1 > 0"),
        (lambda: FibreReinforced(E, NU, [Fibre((1, 0, 0), 1, -1.0, False)]), "expected k2 >= 0"),
        (
            lambda: Elastic(BODY, FibreReinforced(E, NU, [Fibre((0, 0, 0), 1, 0.0, False)])),
            "zero vector",
        ),
        (lambda: Elastic(BODY, SOLID, Isotropic(-1.0)), "det Fg = 0 everywhere at e = 0"),
        (
            lambda: Elastic(BODY, SOLID, Isotropic(lambda e, X: -2 * (X[..., 0] > 0.7))),
            r"det Fg = -1 in cell \d+, point \d+, near \(0\.[789]",
        ),
        (lambda: Elastic(BODY, SOLID, Isotropic(np.nan)), "growth g is not finite"),
        (lambda: Elastic(BODY, SOLID, Orthotropic((-2.0, -2.0, 0))), "inside out"),
        (lambda: Elastic(BODY, SOLID, Orthotropic((0, 0))), "expected three"),
        (lambda: Elastic(BODY, SOLID, Orthotropic((0, 0, 0), np.ones((3, 3)))), "not orthonormal"),
        # Nor one that is off by a thousandth only.
        (
            lambda: Elastic(BODY, SOLID, Orthotropic((0, 0, 0), np.eye(3) * 1.0005)),
            r"not orthonormal in cell 0 \(off by 1\.0e-03\)",
        ),
        (lambda: Elastic(BODY, SOLID, Apical(2.0, lambda X: 2 * X[..., 0])), r"in \[0, 1\]"),
        (lambda: Elastic(BODY, SOLID, Apical(1.0, np.ones(M))), "1 - g beta = 0 at e = 0"),
        (
            lambda: Elastic(BODY, SOLID, General(np.ones((3, 40)))),
            r"growth gave shape \(3, 40\); expected .* \(4, 8, 3, 3\) per point",
        ),
        (lambda: Elastic(BODY, SOLID, Isotropic(0.1, cells=np.ones(M))), "mask"),
        (lambda: Elastic(BODY, SOLID, cells=np.arange(2)), "mask"),
        (lambda: Elastic(BODY, SOLID, cells=np.zeros(M, bool)), "no cell was chosen"),
        (lambda: Gravity(BODY, -1.0, 9.81), "density = -1 .*expected density >= 0"),
        (lambda: Gravity(BODY, 1.0, (0, 9.81)), "magnitude along -z or a vector"),
        (lambda: Traction(BODY, SIDE, (1.0, 2.0)), "traction gave shape"),
        (lambda: Pressure(BODY, SIDE, 1.0, potential="volume"), "no potential here"),
        (lambda: Pressure(BODY, SIDE, 1.0, potential="closed"), "no potential 'closed'"),
        (
            lambda: Pressure(BODY, box_surface(BODY), lambda e, X: X[..., 0], potential="volume"),
            "expected one number",
        ),
        (
            lambda: Ground(BODY, SIDE, thickness=0, pressure=1.0),
            "thickness = 0; expected one finite number > 0",
        ),
        (
            lambda: Ground(BODY, SIDE, thickness=1.0, pressure=-1.0),
            r"pressure = -1\.0; expected one",
        ),
        (lambda: GroundExponential(BODY, length=1.0, modulus=0.0), r"modulus = 0\.0; expected one"),
        (lambda: resolve("g", lambda e, X: X, 0.0, (1, 1)), "positions are not known"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=message):
        make()
