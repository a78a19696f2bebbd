"""Factors: what they solve, when they are stale, and when their count is to be believed."""

from dataclasses import replace

import numpy as np
import pytest
from path_toys import function_scene

from solver.equilibrium.linear import (
    DyadFactor,
    Pardiso,
    SingularMatrix,
    make_solver,
    mkl_pardiso,
)
from solver.equilibrium.newton import newton
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics.elastic import Elastic
from solver.physics.ground import Ground
from solver.physics.loads import Gravity
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, Row, rotation_row, translation_row

DIRECT = ["superlu"] + (["pardiso"] if mkl_pardiso() else [])


def full(A, method, symmetric=True):
    """The factor of a dense matrix."""
    A = np.asarray(A, dtype=float)
    n = len(A)
    kept = np.triu(np.ones((n, n), bool)) if symmetric else np.ones((n, n), bool)
    i, j = np.nonzero(kept)
    indptr = np.concatenate([[0], np.cumsum(kept.sum(axis=1))])
    return make_solver(indptr, j, symmetric=symmetric, method=method), A[i, j]


@pytest.mark.parametrize("method", DIRECT)
def test_a_transposed_solve_takes_the_transpose(method):
    A = np.random.default_rng(0).normal(size=(6, 6)) + np.diag(np.arange(1.0, 7))
    b = np.random.default_rng(1).normal(size=(6, 2))
    solver, values = full(A, method, symmetric=False)
    factor = solver.factorise(values)
    np.testing.assert_allclose(A.T @ factor.solve(b, transposed=True), b, atol=1e-12)
    np.testing.assert_allclose(A @ factor.solve(b), b, atol=1e-12)


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("method", DIRECT)
def test_dyads_beside_a_matrix_are_solved_and_counted(method, symmetric):
    rng = np.random.default_rng(3)
    taken = set()
    for _ in range(6):
        A = rng.normal(size=(8, 8))
        A = A + A.T + 6 * np.diag(rng.normal(size=8)) if symmetric else A + 4 * np.eye(8)
        V, b = 1.5 * rng.normal(size=(8, 2)), rng.normal(size=(8, 3))
        solver, values = full(A, method, symmetric)
        inner = solver.factorise(values)
        factor = DyadFactor(inner, V)
        whole = A + V @ V.T
        np.testing.assert_allclose(whole @ factor.solve(b), b, atol=1e-9)
        np.testing.assert_allclose(whole @ factor.solve(b[:, 0]), b[:, 0], atol=1e-9)
        np.testing.assert_allclose(whole.T @ factor.solve(b, transposed=True), b, atol=1e-9)
        if symmetric and inner.negative is not None:
            assert factor.negative == (np.linalg.eigvalsh(whole) < 0).sum()
            taken.add(inner.negative - factor.negative)
    if symmetric and method == "pardiso":
        assert {0, 1} <= taken or {1, 2} <= taken
    solver.factorise(values)
    assert factor.alive == inner.alive


def test_a_dyad_that_makes_the_matrix_singular_is_told():
    solver, values = full([[-1, 0], [0, 1]], "superlu")
    with pytest.raises(SingularMatrix, match="together with its dyads"):
        DyadFactor(solver.factorise(values), np.array([[1.0], [0.0]]))


@pytest.mark.skipif("pardiso" not in DIRECT, reason="MKL is not installed")
def test_an_overwritten_factor_refuses_to_solve():
    solver, values = full([[2, 1], [1, 3]], "pardiso")
    first = solver.factorise(values)
    second = solver.factorise(2 * values)
    assert second.alive and not first.alive
    with pytest.raises(RuntimeError, match="overwritten"):
        first.solve(np.ones(2))
    np.testing.assert_allclose(second.solve(np.array([6.0, 8.0])), [1, 1])


@pytest.mark.parametrize("method", DIRECT)
def test_a_count_with_exchanged_or_perturbed_pivots_is_not_believed(method):
    # Eigenvalues −1 and 1: with its rows exchanged U's diagonal is (1, 1).
    solver, values = full([[0, 1], [1, 0]], method)
    assert solver.factorise(values).negative in (1, None)
    # Eigenvalues 0 and 2: what stands for the zero has any sign.
    solver, values = full([[1, 1], [1, 1]], method)
    try:
        assert solver.factorise(values).negative is None
    except SingularMatrix:
        assert method == "superlu"


@pytest.mark.skipif("pardiso" not in DIRECT, reason="MKL is not installed")
def test_pivots_perturbed_in_one_order_of_elimination_are_counted_in_another(monkeypatch):
    # Which order meets a small pivot hangs on the machine's roundoff; here minimum degree does.
    run = Pardiso._run

    def perturbed(solver, phase, *rest):
        run(solver, phase, *rest)
        if phase in (12, 22) and solver.iparm[1] == 0:
            solver.iparm[13] = 1

    monkeypatch.setattr(Pardiso, "_run", perturbed)
    A = np.array([[2.0, 0, 1], [0, -3, 1], [1, 1, -5]])
    solver, values = full(A, "pardiso")
    factor = solver.factorise(values)
    assert factor.negative == 2
    np.testing.assert_allclose(A @ factor.solve(np.ones(3)), 1.0)


def test_a_tangent_without_stiffness_is_singular():
    flat = function_scene(
        1, lambda q, e: -q[0], lambda q, e: np.array([-1.0]), lambda q, e: np.zeros((1, 1))
    )
    flat.frame.solver = make_solver([0, 1], [0], symmetric=True, method="superlu")
    result = newton(flat, np.zeros(1), 0.0, rtol=1e-9)
    assert result.outcome is Outcome.SINGULAR
    assert not result.converged and result.iterations == 1


# -- what a scene hands over ---------------------------------------------------------------------


def bar():
    return Body.build(box([0, 1, 2], [0, 1], [0, 1]), "hex8")


def handed(scene):
    """The values that the scene gives to its solver."""
    seen = []
    scene.solver.factorise = lambda values: seen.append(values) or Recorded()
    scene.system(np.zeros(scene.size), 0.0).factorise()
    return seen[0]


def test_rows_are_scaled_to_the_stiffness_whatever_their_units():
    body, seen = bar(), []
    for unit, E in ((1.0, 1.0), (1e9, 1.0), (1e-6, 1e7)):
        rows = [make(body, k) for make in (translation_row, rotation_row) for k in range(3)]
        rows = [Row(unit * row.coefficients) for row in rows]
        scene = Scene(body, [Elastic(body, NeoHookean(E, 0.3))], rows=rows)
        seen.append(handed(scene) / E)
    for values in seen[1:]:
        np.testing.assert_allclose(values, seen[0], atol=1e-9)


def test_a_transposed_solve_sees_the_rows_too():
    body = bar()
    scene = Scene(
        body,
        [Elastic(body, NeoHookean(1.0, 0.3))],
        fixed=[Fixed(body.nodes_where(lambda X: X[:, 0] == 0), d) for d in np.eye(3)],
        rows=[Row(1e3 * translation_row(body, 1).coefficients)],
    )
    scene.solver.factorise = lambda values: Recorded()
    factor = scene.system(np.zeros(scene.size), 0.0).factorise()
    assert factor.solve(np.ones(scene.size), transposed=True)[0] == 7
    assert factor.solve(np.ones(scene.size))[0] == 3


class Recorded:
    """A factor that answers which solve was asked for."""

    negative, alive = 0, True

    def solve(self, b, *, transposed=False):
        return np.full_like(b, 7.0 if transposed else 3.0)


def test_the_sum_of_terms_changes_no_array_of_a_term():
    body = bar()
    one, two = (Elastic(body, NeoHookean(E, 0.3)) for E in (1.0, 2.0))
    u = 0.01 * np.random.default_rng(0).normal(size=body.nodes.shape)
    kept = replace(one.evaluate(u, 0.0), own=False)
    before = kept.stiffness.copy()
    one.evaluate = lambda *given: kept  # a term may keep what it gave
    total = Scene(body, [one, two]).evaluate(u, 0.0).stiffness
    np.testing.assert_array_equal(kept.stiffness, before)
    np.testing.assert_allclose(total, 3 * before, rtol=1e-12)


def test_a_body_that_a_barrier_may_hold_later_is_not_refused():
    body = bar()
    bottom = body.surface(lambda X: X[:, 2] < 1e-9)
    ground = Ground(body, bottom, thickness=1.0, pressure=0.1, height=-1.0)
    terms = [Elastic(body, NeoHookean(1.0, 0.3)), Gravity(body, 0.1, 1.0)]
    rows = [translation_row(body, 0), translation_row(body, 1), rotation_row(body, 2)]
    falling = Scene(body, [*terms, ground], rows=rows)
    falling.refuse_free_motion(np.zeros(falling.size), 0.0)
    loose = Scene(body, terms, rows=rows)
    with pytest.raises(ValueError, match=r"^3 of the body's rigid motions"):
        loose.refuse_free_motion(np.zeros(loose.size), 0.0)
