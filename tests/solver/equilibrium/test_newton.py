"""Newton, descent and bordered systems on functions with known equilibria."""

import numpy as np
import pytest
from path_toys import carousel, function_scene, truss

from solver.equilibrium.descent import descend
from solver.equilibrium.linear import make_solver
from solver.equilibrium.linesearch import Step, damped, downhill
from solver.equilibrium.newton import Stagnation, newton
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.paths.arc import Bordered
from solver.physics.elastic import Elastic
from solver.physics.ground import Ground
from solver.physics.loads import Gravity
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, Row
from solver.physics.term import Evaluation

# -- Newton -----------------------------------------------------------------------------------


def test_a_full_step_must_reduce_the_correction_by_a_quarter():
    def residual(z):  # a correction of 0.9 follows the full step, of 0.8 the half
        return np.where(z > 0.75, -0.9, -0.8)

    step = damped(residual, lambda R: R, np.zeros(1), np.ones(1), lambda dz: abs(dz[0]))
    assert (step.fraction, step.z[0]) == (0.5, 0.5)


def test_newton_converges_where_the_plain_iteration_diverges():
    # E = √(1 + q²) − e q: the plain step from |q| > 1 runs away, q ← −q³ at e = 0
    scene = function_scene(
        1,
        lambda q, e: np.sqrt(1 + q[0] ** 2) - e * q[0],
        lambda q, e: q / np.sqrt(1 + q**2) - e,
        lambda q, e: np.array([[(1 + q[0] ** 2) ** -1.5]]),
    )
    found = newton(scene, np.array([5.0]), 0.5, rtol=1e-12)
    assert found.converged
    assert found.x[0] == pytest.approx(1 / np.sqrt(3), abs=1e-12)
    # The same without an energy: the natural test alone has to hold it back.
    blind = function_scene(
        1,
        None,
        lambda q, e: q / np.sqrt(1 + q**2) - e,
        lambda q, e: np.array([[(1 + q[0] ** 2) ** -1.5]]),
    )
    found = newton(blind, np.array([5.0]), 0.5, rtol=1e-12)
    assert found.converged
    assert found.x[0] == pytest.approx(1 / np.sqrt(3), abs=1e-12)


def test_newton_keeps_to_admissible_states_and_says_when_there_are_none():
    # E = −log q + q: q > 0 only; from 3.9 the plain step goes to −7.4
    def energy(q, e):
        return q[0] - np.log(q[0]) if q[0] > 0 else np.inf

    scene = function_scene(
        1, energy, lambda q, e: 1 - 1 / q, lambda q, e: np.array([[1 / q[0] ** 2]])
    )
    found = newton(scene, np.array([3.9]), 0.0, rtol=1e-12)
    assert found.converged
    assert found.x[0] == pytest.approx(1.0, abs=1e-12)
    assert newton(scene, np.array([-1.0]), 0.0, rtol=1e-9).outcome is Outcome.INADMISSIBLE


def test_newton_goes_to_a_saddle_and_descent_does_not():
    scene = truss()
    saddle = newton(scene, np.array([-0.1]), 0.0, rtol=1e-12)
    assert saddle.converged
    assert (saddle.x[0], saddle.system.unstable) == (pytest.approx(-0.1, abs=1e-14), 1)
    down = descend(scene, np.array([-0.1]), 0.0, rtol=1e-12)
    assert down.converged
    assert down.system.unstable == 0
    assert abs(down.x[0]) == pytest.approx(0.0, abs=1e-12) or down.x[0] == pytest.approx(-0.2)


def test_a_saddle_is_left_to_its_lower_side_in_any_unit_of_length():
    # E = a⁴/4 + a³/30 − a²/2 + (b − 1)²/2 with a and b in lengths: a saddle at a = 0, b = 1
    lower = -0.05 - np.sqrt(0.05**2 + 1)

    def left(length):
        scene = function_scene(
            2,
            lambda q, e: float(well(*q / length)),
            lambda q, e: np.array([q[0] ** 3 / length**3 + 0.1 * q[0] ** 2 / length**2
                                   - q[0] / length, q[1] / length - 1]) / length,
            lambda q, e: np.diag([3 * q[0] ** 2 / length**2 + 0.2 * q[0] / length - 1, 1.0])
            / length**2,
            length=length,
        )  # fmt: skip
        found = descend(scene, np.array([0.0, length]), 0.0, rtol=1e-10)
        assert found.converged and found.system.unstable == 0
        return found.x / length, found.iterations

    def well(a, b):
        return a**4 / 4 + a**3 / 30 - a**2 / 2 + (b - 1) ** 2 / 2

    # Powers of two lose no digit.
    (x, iterations), *others = [left(2.0**k) for k in (0, -16, -8, 8, 16)]
    assert x == pytest.approx([lower, 1.0], abs=1e-9)
    for other, count in others:
        assert other.tolist() == x.tolist() and count == iterations


def test_descent_ends_in_the_next_valley():
    # E = −cos q: from near the inflection the plain step is 100 long, over sixteen valleys
    scene = function_scene(
        1, lambda q, e: -np.cos(q[0]), lambda q, e: np.sin(q), lambda q, e: np.cos(q)[:, None]
    )
    for start in (*(np.pi / 2 + np.linspace(-0.08, 0.08, 40)), 3.0):
        assert descend(scene, np.array([start]), 0.0, rtol=1e-12).x[0] == pytest.approx(0, abs=1e-9)


def test_newton_stagnation_is_told_from_convergence():
    noise = np.random.default_rng(0)
    scene = function_scene(
        1,
        None,
        lambda q, e: q - 1 + 1e-6 * noise.standard_normal(1),
        lambda q, e: np.array([[1.0]]),
    )
    found = newton(scene, np.zeros(1), 0.0, rtol=1e-9, max_iterations=50)
    assert found.outcome is Outcome.STAGNATED or found.outcome is Outcome.NO_PROGRESS
    assert newton(scene, np.zeros(1), 0.0, rtol=1e-4).converged


def test_barriers_shorten_the_step():
    class Wall:
        symmetric, graph, name = True, None, "wall"

        def evaluate(self, u, e, order=2):
            return Evaluation(np.inf) if u[0, 0] >= 2 else Evaluation(0.0, np.zeros_like(u))

        def longest_step(self, u, du):
            return 0.9 * (2 - u[0, 0]) / du[0, 0] if du[0, 0] > 0 else 1.0

    scene = function_scene(
        1,
        lambda q, e: q[0] ** 4 / 4 - q[0],
        lambda q, e: q**3 - 1,
        lambda q, e: np.array([[3 * q[0] ** 2]]),
    )
    scene = scene.with_terms((*scene.terms, Wall()))
    tried = []
    old = scene.evaluate
    scene.evaluate = lambda u, e, order=2: (tried.append(u[0, 0]), old(u, e, order))[1]
    found = newton(scene, np.array([0.2]), 0.0, rtol=1e-12)
    assert found.converged
    assert found.x[0] == pytest.approx(1.0, abs=1e-12)
    assert max(tried) < 2  # the plain first step ends at 8.5


def test_bad_input_is_refused_in_words():
    scene = truss()
    with pytest.raises(ValueError, match=r"shape \(2,\); expected \(1,\)"):
        newton(scene, np.zeros(2), 0.0, rtol=1e-9)
    with pytest.raises(ValueError, match="rtol = 0"):
        newton(scene, np.zeros(1), 0.0, rtol=0)
    blind = truss()
    blind.frame.solver = make_solver(np.array([0, 1]), np.array([0]), symmetric=False)
    with pytest.raises(ValueError, match="count negative pivots"):
        descend(blind, np.zeros(1), 1e-4, rtol=1e-9)
    with pytest.raises(ValueError, match="needs an energy"):
        descend(carousel(), np.array([1.0, 0.0]), 0.0, rtol=1e-9)


# -- bordered systems -------------------------------------------------------------------------


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("smallest", [1.0, 1e-9, 1e-14])
def test_bordering_is_accurate_for_singular_stiffness(symmetric, smallest):
    rng = np.random.default_rng(1)
    n = 30
    Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    P = Q if symmetric else np.linalg.qr(rng.standard_normal((n, n)))[0]
    K = Q @ np.diag(np.append(np.linspace(1, 3, n - 1), smallest)) @ P.T
    c, row, b = (rng.standard_normal(k) for k in (n, n + 1, n + 1))
    upper = np.triu(np.ones((n, n), bool)) if symmetric else np.ones((n, n), bool)
    i, j = np.nonzero(upper)
    indptr = np.concatenate([[0], np.cumsum(upper.sum(axis=1))])
    factor = make_solver(indptr, j, symmetric=symmetric, method="superlu").factorise(K[i, j])
    z = Bordered(factor, c, row).solve(b)
    full = np.block([[K, c[:, None]], [row[None, :]]])
    assert np.abs(full @ z - b).max() < 1e-11 * np.abs(z).max()
    assert np.abs(z - np.linalg.solve(full, b)).max() < 1e-9 * np.abs(z).max()


def test_no_result_lies_beyond_a_barrier_thinner_than_the_tolerance():
    # A heavy block on a ground whose floor is 1e-4 of its size below: with a tolerance of 1e-2 the
    # last correction alone could pass through it.
    body = Body.build(box([0, 1], [0, 1], np.linspace(0, 1, 3)), "hex27")
    bottom = body.surface(lambda X: X[:, 2] < 1e-9)
    ground = Ground(body, bottom, thickness=1e-3, pressure=0.01)
    fixed = [Fixed(np.flatnonzero(body.nodes[:, k] < 1e-9), np.eye(3)[k]) for k in (0, 1)]
    scene = Scene(
        body, [Elastic(body, NeoHookean(1.0, 0.3)), Gravity(body, 1.0, 0.1), ground], fixed=fixed
    )
    for solver in (newton, descend):
        for rtol in (1e-1, 1e-2, 1e-3):
            found = solver(scene, np.zeros(scene.size), 0.0, rtol=rtol)
            assert found.converged, found.outcome
            assert np.isfinite(scene.energy(found.x, 0.0)), (solver, rtol)


def test_a_guess_that_violates_a_row_may_climb_to_it():
    """A block at rest whose end shall lie 0.05 further: its energy can only rise on the way there,
    and the multiplier's work on what remains of the row is what falls."""
    body = Body.build(box([0, 1], [0, 1], [0, 1]), "hex8")
    fixed = [Fixed(np.flatnonzero(body.nodes[:, k] < 1e-12), np.eye(3)[k]) for k in range(3)]
    mean = np.zeros((8, 3))
    mean[body.nodes[:, 0] > 0.5, 0] = 0.25
    scene = Scene(body, [Elastic(body, NeoHookean(1.0, 0.3))], fixed=fixed, rows=[Row(mean, 0.05)])
    x = np.zeros(scene.size)
    system = scene.system(x, 1.0)
    dx = -system.factorise().solve(system.residual)
    step = downhill(scene, system, x, 1.0, dx, 1.0)
    assert isinstance(step, Step) and step.fraction == 1.0
    assert scene.energy(step.z, 1.0) > scene.energy(x, 1.0)
    # Back from beyond the row it falls, and the step is as long.
    assert descend(scene, step.z, 1.0, rtol=1e-9).converged


def test_corrections_have_stopped_shrinking_after_four_that_are_no_half_of_the_best():
    watch = Stagnation(1e-9)
    assert [watch.stuck(c) for c in (1e-8, 9e-9, 1e-8, 6e-9, 1e-8)] == [False] * 4 + [True]
    watch = Stagnation(1e-9)
    # A half counts, and one that lies far from the tolerance is damping.
    assert not any(watch.stuck(c) for c in (1e-8, 9e-9, 9e-9, 9e-9, 4e-9, 4e-9, 4e-9, 4e-9))
    watch = Stagnation(1e-9)
    assert not any(watch.stuck(1e-3) for _ in range(9))
