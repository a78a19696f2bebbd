"""Friction of the ground: derivatives, a block that is dragged, a strip pulled at its end."""

from functools import partial

import numpy as np
import pytest
from proofs import BODIES, ELEMENTS, prove, state

from solver.equilibrium.newton import newton
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics.elastic import Elastic
from solver.physics.friction import Friction
from solver.physics.ground import Ground
from solver.physics.loads import Gravity, Traction
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed

X, Y, Z = np.eye(3)


def floor(body, pressure=3.0):
    return Ground(body, body.surface(lambda X: X[:, 2] < 1e-9), thickness=0.8, pressure=pressure)


@pytest.mark.parametrize("element", ELEMENTS)
def test_derivatives_where_points_stick_and_where_they_slide(element):
    body = BODIES[element]
    rest = Friction.at_rest(floor(body), 0.3, 1e-2, np.zeros_like(body.nodes))
    u = 1e-2 * state(body)
    assert not rest.sliding(u).any()
    prove(rest, u, 0.0, step=1e-6)
    u = u + np.array([0.05, -0.03, 0.0])
    assert rest.sliding(u).all()
    prove(rest, u, 0.0, step=1e-4)
    # All of them slide: the whole weight times μ, against the way.
    pull = rest.evaluate(u, 0.0, 1).force.sum(axis=0)
    assert pull[2] == 0 and np.hypot(*pull[:2]) == pytest.approx(0.3 * 3.0 * 1.5, rel=0.02)
    assert pull[0] > 0 > pull[1]


def test_pulls_are_kept_from_step_to_step_and_never_exceed_what_presses():
    body = BODIES["hex27"]
    ground = floor(body)
    first = Friction.at_rest(ground, 0.3, 1e-2, np.zeros_like(body.nodes))
    half = np.tile([5e-3, 0.0, 0.0], (len(body.nodes), 1))
    far = np.tile([0.2, 0.0, 0.0], (len(body.nodes), 1))
    for u in (half, far):
        now, then = first.evaluate(u, 0.0, 1).force, first.moved(u).evaluate(u, 0.0, 1).force
        assert then == pytest.approx(now, abs=1e-12)
    # Lifted half out of the barrier, less presses, and no more than μ of that is left of the pull.
    lifted = far + np.array([0, 0, 0.03])
    pull = first.moved(lifted).evaluate(lifted, 0.0, 1).force[:, 0].sum()
    assert pull == pytest.approx(0.3 * ground.pressing(lifted).sum(), rel=1e-12)
    assert 0 < pull < 0.3 * 3.0 * 1.5
    # In the air nothing holds; where it comes down it sticks anew.
    up = far + np.array([0, 0, 1.0])
    air = first.moved(up)
    assert not air.evaluate(up, 0.0, 1).force.any()
    down = air.moved(far)
    assert not down.evaluate(far, 0.0, 1).force.any()
    assert down.evaluate(far + 0.1 * (half > 0), 0.0, 1).force[:, 0].sum() > 1.0


def test_a_pull_cut_down_by_less_weight_is_gone_after_a_slip_back():
    """Else it would pull on until the points had come back by what it was before."""
    body, slip = BODIES["hex27"], 1e-2
    first = Friction.at_rest(floor(body), 0.3, slip, np.zeros_like(body.nodes))
    lifted = np.tile([0.2, 0.0, 0.03], (len(body.nodes), 1))
    now = first.moved(lifted)
    pulls = [
        now.evaluate(lifted - [back * slip, 0, 0], 0.0, 1).force[:, 0].sum() for back in (0, 0.5, 1)
    ]
    assert pulls[0] > 0.1
    assert pulls[1:] == pytest.approx([pulls[0] / 2, 0], abs=1e-10)


def followed(make, friction, loads):
    """States of a scene made from its friction, at loads in turn, and the friction of each."""
    scene = make(friction)
    x, path = np.zeros(scene.size), []
    for e in loads:
        scene = make(friction)
        result = newton(scene, x, e, rtol=1e-9, max_iterations=80)
        assert result.converged
        x, u = result.x, scene.displacement(result.x, e)
        path.append((friction, u))
        friction = friction.moved(u)
    return path


def test_a_block_sticks_until_mu_times_its_weight_and_then_slides():
    """Its back face is moved by 0.1 e: what is needed rises until μ W, whatever the way then."""
    mu, weight = 0.4, 2.0
    body = Body.build(box(np.linspace(0, 1, 3), [0, 1], np.linspace(0, 0.5, 2)), "hex27")
    ground = floor(body, pressure=weight)
    back = np.flatnonzero(body.nodes[:, 0] < 1e-9)

    def make(friction):
        terms = [Elastic(body, NeoHookean(1e5, 0.3)), Gravity(body, 1.0, weight / 0.5), ground]
        pushed = Fixed(back, X, lambda e: 0.1 * e)
        return Scene(body, [*terms, friction], fixed=[pushed, Fixed(back, Y)])

    rest = Friction.at_rest(ground, mu, 2e-3, np.zeros_like(body.nodes))
    loads = [0.0, 0.005, 0.01, *np.linspace(0.05, 1.0, 8)]
    pulls = [f.evaluate(u, 0.0, 1).force[:, 0].sum() for f, u in followed(make, rest, loads)]
    assert pulls[1] == pytest.approx(pulls[2] / 2, rel=0.05) and pulls[2] < 0.7 * mu * weight
    assert pulls[-5:] == pytest.approx([mu * weight] * 5, rel=1e-3)


@pytest.mark.parametrize("steps", [10, 40])
def test_a_strip_pulled_at_its_end_slides_as_far_as_its_friction_is_needed(steps):
    """A heavy strip pulled along by F: friction μ w per length holds it over F/(μ w), where its
    tension falls to 0, so its end moves by F²/(2 EA μ w). Where the pull returns by ΔF, the strip
    slides back over ΔF/(2 μ w) only, and its end by ΔF²/(4 EA μ w)."""
    mu, w, h, E = 0.5, 1.0, 0.004, 5e5
    body = Body.build(box(np.linspace(0, 1, 41), [0, 0.1], [0, h]), "hex20")
    weight = w / 0.1  # per area
    ground = Ground(
        body, body.surface(lambda X: X[:, 2] < 1e-9), thickness=h, pressure=weight, depth=0.01,
        reach=0.01,
    )  # fmt: skip
    end = body.surface(lambda X: X[:, 0] > 1 - 1e-9)
    most = 0.6 * mu * w  # so that 0.4 of the strip never moves

    def make(friction, load):
        terms = [Elastic(body, NeoHookean(E, 0.0)), Gravity(body, 1.0, weight / h), ground]
        pull = Traction(body, end, lambda e: np.array([load(e) / (0.1 * h), 0, 0]))
        side = np.flatnonzero(np.abs(body.nodes[:, 1]) < 1e-9)
        return Scene(body, [*terms, pull, friction], fixed=[Fixed(side, Y)])

    way = most**2 / (2 * E * 0.1 * h * mu * w)
    rest = Friction.at_rest(ground, mu, way / 200, np.zeros_like(body.nodes))
    there = np.linspace(0, 1, steps + 1)
    up_and_half_back = lambda e: most * (e if e <= 1 else 2 - e)  # noqa: E731
    path = followed(
        partial(make, load=up_and_half_back), rest, [*there, *(1 + there[1 : steps // 2 + 1])]
    )
    tip = np.argmax(body.nodes[:, 0])
    ends = np.array([u[tip, 0] for _, u in path])
    assert ends[steps] == pytest.approx(way, rel=0.02)
    assert ends[-1] == pytest.approx(way * (1 - 0.25 / 2), rel=0.02)
    # At rest only where the pull has not come.
    sliding = path[steps][0].sliding(path[steps][1])
    places = rest.stuck[:, 0]
    assert not sliding[places < 0.38].any() and sliding[places > 0.45].all()


@pytest.mark.parametrize("given", [{"coefficient": 0.0}, {"coefficient": -0.1}, {"slip": 0.0}])
def test_what_is_no_friction_is_refused(given):
    body = BODIES["hex8"]
    values = {"coefficient": 0.3, "slip": 1e-3} | given
    with pytest.raises(ValueError, match="expected one finite number > 0"):
        Friction.at_rest(floor(body), values["coefficient"], values["slip"], 0 * body.nodes)
