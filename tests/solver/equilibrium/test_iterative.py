"""Conjugate gradients on two levels: what they solve, in how many iterations, what they refuse."""

import numpy as np
import pytest
import scipy.sparse as sp

from solver.equilibrium.iterative import (
    Coarse,
    Indefinite,
    LineBlocks,
    TwoLevels,
)
from solver.equilibrium.linear import SingularMatrix, make_solver, product
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.paths import LoadSteps, trace
from solver.physics.elastic import Elastic
from solver.physics.growth import Isotropic
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, Held, Row, Tied, rotation_row, translation_row


def body_of(element="hex27", counts=(2, 2, 2), size=(1.0, 1.0, 1.0), shape=None):
    axes = [np.linspace(0, length, n + 1) for n, length in zip(counts, size, strict=True)]
    return Body.build(box(*axes, tets=element.startswith("tet"), shape=shape), element)


def clamp(body):
    low = body.nodes_where(lambda X: X[:, 0] < 1e-9)
    return [Fixed(low, axis) for axis in np.eye(3)]


def scene_of(body, linear="cg", nu=0.3, **held):
    return Scene(body, [Elastic(body, NeoHookean(1.0, nu))], linear=linear, **held)


def compared(body, nu=0.3, **held):
    """Iterations, and the error of the solution in the energy's norm beside the direct one."""
    held = held or {"fixed": clamp(body)}
    iterative, direct = (scene_of(body, linear, nu, **held) for linear in ("cg", "auto"))
    x, b = np.zeros(direct.size), np.random.default_rng(0).normal(size=direct.size)
    system = direct.system(x, 0.0)
    want = system.factorise().solve(b)
    got = iterative.system(x, 0.0).factorise().solve(b)
    off = got - want
    error = np.sqrt(off @ direct.frame.times(system.values, off) / (b @ want))
    return iterative.solver.iterations, error


def held_askew(body):
    """Clamped at one end, on a mirror plane at an angle at the other, one node tied to another."""
    high = body.nodes_where(lambda X: X[:, 0] > X[:, 0].max() - 1e-9)
    inner = body.nodes_where(lambda X: np.abs(X[:, 0] - 0.5) < 1e-9)
    z = body.nodes[inner, 2]
    ends = inner[z < 1e-9], inner[z > z.max() - 1e-9]
    low, top = (end[np.argsort(body.nodes[end, 1])] for end in ends)
    fixed = [*clamp(body), Fixed(high, [1.0, 2.0, 0.5])]
    return {"fixed": fixed, "tied": [Tied(low, top, (1, -1, 1))]}


@pytest.mark.parametrize(
    ("element", "counts", "size", "most"),
    [
        ("hex27", (3, 3, 3), (1, 1, 1), 10),
        ("hex20", (3, 3, 3), (1, 1, 1), 17),
        ("tet10", (2, 2, 2), (1, 1, 1), 15),
        ("hex27", (6, 3, 1), (1, 0.5, 0.04), 13),
        ("tet10", (6, 3, 1), (1, 0.5, 0.04), 22),
    ],
)
def test_the_solution_is_that_of_a_factorisation(element, counts, size, most):
    iterations, error = compared(body_of(element, counts, size))
    assert error < 1e-7
    assert 1 < iterations <= most


def test_supports_at_an_angle_and_ties_are_seen_by_the_coarse_space():
    body = body_of(counts=(4, 2, 2))
    plain, _ = compared(body)
    iterations, error = compared(body, **held_askew(body))
    assert error < 1e-7
    assert iterations <= plain + 3


def rigid_rows(body, size=1.0):
    rows = [make(body, k) for make in (translation_row, rotation_row) for k in range(3)]
    return [Row(size * row.coefficients, 0.1 * k) for k, row in enumerate(rows)]


@pytest.mark.parametrize(
    ("size", "fixed"), [((1, 1, 1), False), ((1, 1, 0.1), False), ((1, 1, 1), True)]
)
def test_rows_are_kept_and_may_be_all_that_holds_a_body(size, fixed):
    body = body_of(counts=(3, 2, 2), size=size)
    low = body.nodes_where(lambda X: X[:, 0] < 1e-9)
    # A mirror plane at an angle does some of their work.
    fixed, rows = ([Fixed(low, [1, 1, 0])], [1, 2, 3]) if fixed else ([], range(6))
    rows = [rigid_rows(body, 1e3)[k] for k in rows]
    iterative, direct = (scene_of(body, to, fixed=fixed, rows=rows) for to in ("cg", "auto"))
    b = np.random.default_rng(0).normal(size=direct.size)
    system, n = direct.system(np.zeros(direct.size), 0.0), direct.n_free
    want = system.factorise().solve(b)
    got = iterative.system(np.zeros(direct.size), 0.0).factorise().solve(b)
    assert 1 < iterative.solver.iterations <= 12
    np.testing.assert_allclose(got[:n], want[:n], atol=1e-7 * np.abs(want[:n]).max())
    np.testing.assert_allclose(got[n:], want[n:], rtol=1e-6)
    np.testing.assert_allclose(iterative.frame.C_free @ got[:n], b[n:], rtol=1e-7)


def test_rows_of_linear_elements_are_refused():
    body = body_of("hex8")
    with pytest.raises(ValueError, match="quadratic elements only"):
        scene_of(body, rows=rigid_rows(body))


def test_iterations_do_not_grow_with_the_mesh():
    few = [compared(body_of(counts=(n, n, n)))[0] for n in (2, 6)]
    assert few[1] <= few[0] + 2 and few[1] <= 10
    # A plate whose cells are five times longer than thick, whatever their number.
    few = [compared(body_of(counts=(n, n, 1), size=(1, 1, 0.2 / n)))[0] for n in (5, 12)]
    assert few[1] <= few[0] + 2 and few[1] <= 13


def test_a_nearly_incompressible_body_takes_a_bounded_number_more():
    few = [compared(body_of(counts=(n, n, n)), nu=0.49) for n in (2, 5)]
    assert all(error < 1e-6 for _, error in few)
    assert few[1][0] <= few[0][0] + 6 and few[1][0] <= 35


# -- the coarse space -----------------------------------------------------------------------------


def left_over(P, q):
    """How much of a motion of the free unknowns is not in the coarse space."""
    found = np.linalg.lstsq(P.toarray(), q, rcond=None)[0]
    return np.linalg.norm(P @ found - q) / np.linalg.norm(q)


def bent(body):
    """u of a plate in pure bending: w = x²/2 with the sections turned along."""
    x, z = body.nodes[:, 0], body.nodes[:, 2]
    return np.stack([-z * x, np.zeros_like(x), x**2 / 2], axis=1)


@pytest.mark.parametrize("element", ["hex27", "hex20"])
def test_corners_of_flat_cells_turn_so_that_the_coarse_space_bends(element):
    free = Held(len(body_of(element).nodes), [])
    thick = body_of(element)
    rigid = np.array([1.0, 2.0, 3.0]) + np.cross([0.3, -0.5, 1.0], thick.nodes)
    P = Coarse.of(thick, free).prolongation
    assert P.shape[1] == 3 * 27
    assert left_over(P, rigid.ravel()) < 1e-12
    assert left_over(P, bent(thick).ravel()) > 1e-2
    flat = body_of(element, size=(1.0, 1.0, 0.1))
    P = Coarse.of(flat, free).prolongation
    assert P.shape[1] == 6 * 27
    assert left_over(P, bent(flat).ravel()) < 1e-12


def test_linear_elements_have_no_coarse_space():
    body = body_of("hex8")
    assert Coarse.of(body, Held(len(body.nodes), [])) is None


@pytest.mark.parametrize("size", [(1.0, 1.0, 1.0), (1.0, 1.0, 0.1)])
def test_linear_motions_that_supports_and_ties_admit_are_coarse(size):
    body = body_of(counts=(4, 2, 2), size=size)
    held = Held(len(body.nodes), **held_askew(body))
    P = Coarse.of(body, held).prolongation
    # The end slides along its mirror plane; what is tied moves alike.
    u = body.nodes[:, :1] * [0.5, 0.0, -1.0]
    assert left_over(P, held.to_local(u).ravel()[held.index]) < 1e-12
    clamped = body.nodes_where(lambda X: X[:, 0] < 1e-9)
    assert held.free.sum() == P.shape[0] == 3 * len(body.nodes) - len(held.tied) - 25 - 75
    assert len(clamped) == 25


def test_the_coarse_matrix_is_galerkins():
    rng = np.random.default_rng(0)
    A = sp.random_array((12, 12), density=0.4, rng=rng).toarray()
    A = A + A.T + 12 * np.eye(12)
    P = sp.random_array((12, 5), density=0.5, rng=rng, format="csr")
    upper = sp.csr_array(np.triu(A))
    upper.sort_indices()
    levels = TwoLevels(upper.indptr, upper.indices, Coarse(P, np.arange(12) // 3, np.arange(12.0)))
    seen = []

    class Recorder:
        negative = 0

        def solve(self, b):
            return np.zeros_like(b)

    levels._solver.factorise = lambda values: seen.append(values) or Recorder()
    cycle = levels.of(upper.data, np.zeros((0, 12)))
    starts, columns = levels._coarse
    got = sp.csr_array((seen[0], columns, starts), shape=(5, 5)).toarray()
    np.testing.assert_allclose(got, np.triu(P.T @ A @ P), rtol=1e-8, atol=1e-12)
    # Without the coarse solve: a polynomial of the matrix, symmetric and positive.
    B = np.column_stack([cycle(column) for column in np.eye(12)])
    np.testing.assert_allclose(B, B.T, atol=1e-12)
    assert np.linalg.eigvalsh(B).min() > 0
    for symmetric, stored in ((True, upper), (False, sp.csr_array(A))):
        x = rng.normal(size=12)
        got = product(stored.indptr, stored.indices, stored.data, x, symmetric)
        np.testing.assert_allclose(got, A @ x, rtol=1e-12)


def test_lines_are_solved_for_together():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(9, 9))
    A = A @ A.T + np.eye(9)
    upper = sp.csr_array(np.triu(A))
    line, place = np.array([2, 0, 1, 2, 0, 2, 1, 0, 3]), rng.normal(size=9)
    solve = LineBlocks(upper.indptr, upper.indices, line, place).of(upper.data)
    r = rng.normal(size=9)
    blocks = np.where(line[:, None] == line, A, 0.0)
    np.testing.assert_allclose(blocks @ solve(r), r, atol=1e-12)


def test_a_line_in_the_order_of_its_places_is_a_narrow_band():
    place = np.random.default_rng(0).permutation(9)
    chain = np.where(np.abs(place[:, None] - place) <= 1, -1.0, 0.0) + 3 * np.eye(9)
    upper = sp.csr_array(np.triu(chain))
    lines = LineBlocks(upper.indptr, upper.indices, np.zeros(9, int), place)
    assert lines._width == 2
    np.testing.assert_allclose(chain @ lines.of(upper.data)(np.ones(9)), 1.0)


# -- what is refused ------------------------------------------------------------------------------


def solver_of(A, P):
    upper = sp.csr_array(np.triu(A))
    solver = make_solver(
        upper.indptr, upper.indices, symmetric=True, method="cg", modes=np.zeros((len(A), 6)),
        coarse=Coarse(sp.csr_array(P), np.arange(len(A)), np.zeros(len(A))),
    )  # fmt: skip
    return solver, upper.data


def indefinite(seen):
    """A matrix with the eigenvalue −0.1; the coarse space has its vector or is across it."""
    n = 12
    v = np.ones(n) / np.sqrt(n)
    w = np.tile([1.0, -1.0], n // 2) / np.sqrt(n)
    A = np.diag(np.linspace(1.0, 2.0, n))
    A = A - (v @ A @ v + 0.1) * np.outer(v, v) - np.outer(A @ v - v * (v @ A @ v), v)
    A = (A + A.T) / 2
    assert np.linalg.eigvalsh(A)[0] < -0.05
    return A, (v if seen else w)[:, None]


@pytest.mark.parametrize(("seen", "message"), [(True, "at least 1 negative"), (False, "curvature")])
def test_a_negative_eigenvalue_is_noticed(seen, message):
    A, P = indefinite(seen)
    solver, values = solver_of(A, P)
    with pytest.raises(Indefinite, match=message):
        solver.factorise(values).solve(np.random.default_rng(0).normal(size=len(A)))


def test_what_has_no_answer_is_an_error_and_no_hang():
    solver, values = solver_of(np.diag([1.0, -1.0, 2.0]), np.ones((3, 1)))
    with pytest.raises(Indefinite, match="line of unknowns"):
        solver.factorise(values)
    chain = 2 * np.eye(60) - np.eye(60, k=1) - np.eye(60, k=-1)
    solver, values = solver_of(chain, np.ones((60, 1)))
    solver._most = 2
    with pytest.raises(SingularMatrix, match="did not converge in 2"):
        solver.factorise(values).solve(np.arange(1.0, 61))
    solver._most = 500
    factor = solver.factorise(values)
    assert factor.negative is None
    with pytest.raises(SingularMatrix, match="broke down"):
        factor.solve(np.full(60, np.nan))
    assert (factor.solve(np.zeros((60, 2))) == 0).all()


def test_a_body_pressed_past_buckling_is_refused():
    body = body_of(counts=(8, 1, 1), size=(1.0, 0.1, 0.1))
    scene = scene_of(body, fixed=clamp(body))
    u = np.zeros(body.nodes.shape)
    u[:, 0] = -0.1 * body.nodes[:, 0]
    direct = scene_of(body, "auto", fixed=clamp(body))
    assert direct.system(direct.unknowns(u), 0.0).unstable > 0
    with pytest.raises(Indefinite):
        scene.system(scene.unknowns(u), 0.0).factorise().solve(np.ones(scene.size))
    # Rows alone hold it: their own negative eigenvalues don't count.
    scene = scene_of(body, rows=rigid_rows(body))
    rest, pressed = (scene.unknowns(v) for v in (0 * u, u))
    x = scene.system(rest, 0.0).factorise().solve(np.ones(scene.size))
    assert np.isfinite(x).all()
    with pytest.raises(Indefinite, match=r"at least [1-9]"):
        scene.system(pressed, 0.0).factorise()


def test_a_path_is_the_direct_one():
    body = body_of(counts=(6, 2, 1), size=(1.0, 0.3, 0.1))
    upper = body.points()[..., 2] > 0.05
    ends = []
    for linear in ("cg", "auto"):
        growth = Isotropic(lambda e: 0.2 * e * upper)
        term = Elastic(body, NeoHookean(1.0, 0.3), growth)
        scene = Scene(body, [term], fixed=clamp(body), linear=linear)
        path = trace(scene, np.zeros(scene.size), LoadSteps(rtol=1e-9, step=0.5), max_steps=20)
        assert path.last.e == 1.0
        ends.append(scene.displacement(path.last.x, 1.0))
    assert np.abs(ends[1]).max() > 0.1
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-8)
