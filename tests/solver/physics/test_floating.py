"""A liquid under a film: derivatives, Archimedes, the follower force, and wrinkles."""

import numpy as np
import pytest
from proofs import BODIES, prove, state
from pytest import approx

from solver.equilibrium.newton import newton
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics.elastic import Elastic
from solver.physics.loads import Floating, Gravity
from solver.physics.materials import NeoHookean
from solver.physics.pressure import Pressure
from solver.physics.supports import Fixed


def below(body):
    return body.surface(lambda X: X[:, 2] < 1e-9)


@pytest.mark.parametrize("element", ["hex27", "hex20", "hex8", "tet10"])
def test_derivatives_in_a_crooked_state(element):
    body = BODIES[element]
    term = Floating(body, below(body), lambda e: 2.0 + e, level=0.3)
    prove(term, state(body) + np.array([0, 0, 0.2]), 0.5)


@pytest.mark.parametrize("element", ["hex27", "tet10"])
def test_around_a_whole_body_it_lifts_by_the_weight_of_the_liquid_in_its_place(element):
    """On a closed surface it is the buoyancy of any shape, wherever the level is."""
    body = BODIES[element]
    whole = body.surface(lambda X: X[:, 0] > -1)
    u = state(body)
    volume = Pressure(body, whole, 1.0, potential="volume").volume(u)
    for level in (0.0, 2.0):
        force = Floating(body, whole, 3.0, level=level).evaluate(u, 0.0, 1).force
        # dE/du is minus the lift.
        assert force.sum(axis=0) == approx([0, 0, -3.0 * volume], abs=1e-9)


def test_it_is_the_follower_pressure_of_the_height_where_no_rim_is_free():
    body = BODIES["hex27"]
    u, gamma, level = state(body, noise=0.0), 2.5, 0.4
    whole = body.surface(lambda X: X[:, 0] > -1)
    mine = Floating(body, whole, gamma, level=level).evaluate(u, 0.0, 1).force
    z = np.einsum("fqk,fk->fq", whole.shapes, (body.nodes + u)[whole.nodes, 2])
    follower = Pressure(body, whole, gamma * (level - z)).evaluate(u, 0.0, 1).force
    assert mine == approx(follower, abs=1e-9 * np.abs(follower).max())


def film(length, h, counts=24):
    body = Body.build(box(np.linspace(0, length, counts + 1), [0, 1.0], [0, h]), "hex20")
    sides = [Fixed(body.nodes_where(lambda X, y=y: np.abs(X[:, 1] - y) < 1e-9), [0, 1, 0])
             for y in (0.0, 1.0)]  # fmt: skip
    ends = [Fixed(body.nodes_where(lambda X: X[:, 0] < 1e-9), [1, 0, 0])]
    return body, sides, ends


def test_a_film_sinks_by_its_weight_over_the_liquid_s():
    h, rho, gamma = 0.01, 2.0, 5.0
    body, sides, ends = film(1.0, h, 4)
    water = Floating(body, below(body), gamma)
    terms = [Elastic(body, NeoHookean(1e3, 0.3)), Gravity(body, rho, 1.0), water]
    other = Fixed(body.nodes_where(lambda X: X[:, 0] > 1 - 1e-9), [1, 0, 0])
    scene = Scene(body, terms, fixed=[*sides, *ends, other])
    u = scene.displacement(newton(scene, np.zeros(scene.size), 0.0, rtol=1e-10).x, 0.0)
    bottom = body.nodes_where(lambda X: X[:, 2] < 1e-9)
    assert u[bottom, 2] == approx(-rho * h / gamma, rel=1e-3)


@pytest.mark.parametrize("halves", [2, 3])
def test_a_film_that_is_pushed_together_wrinkles_as_the_closed_form_says(halves):
    """Plane strain: P(k) = B k² + γ/k², least 2 √(B γ) at k = (γ/B)^¼; ends that slide hold the
    wave numbers n π/L, here n = ``halves`` at the least one."""
    h, E, nu, k = 0.01, 1.0, 0.3, 2 * np.pi
    B = E * h**3 / (12 * (1 - nu**2))
    gamma, length = B * k**4, halves * 0.5
    critical = 2 * np.sqrt(B * gamma) * (1 - nu**2) / (E * h)  # as a strain
    assert critical < 1e-3
    body, sides, ends = film(length, h)
    other = body.nodes_where(lambda X: X[:, 0] > length - 1e-9)
    terms = [Elastic(body, NeoHookean(E, nu)), Floating(body, below(body), gamma)]
    fixed = [*sides, *ends, Fixed(other, [1, 0, 0], lambda e: -e * critical * length)]
    scene = Scene(body, terms, fixed=fixed)
    for fraction, modes in ((0.96, 0), (1.04, 1)):
        result = newton(scene, np.zeros(scene.size), fraction, rtol=1e-10)
        assert result.converged and result.system.unstable == modes


def test_what_is_no_liquid_is_refused():
    body = BODIES["hex27"]
    with pytest.raises(ValueError, match=r"the liquid's specific weight = 0\.0; expected"):
        Floating(body, below(body), 0.0)
    with pytest.raises(ValueError, match="the liquid's level is 'high'"):
        Floating(body, below(body), 1.0, level="high")
