"""Scenes: what is held, constraint rows, frames, inertia, and the linear solvers behind them."""

import numpy as np
import pytest
import scipy.sparse as sp
import skfem

from solver.equilibrium.linear import SingularMatrix, make_solver, mkl_pardiso
from solver.equilibrium.pattern import ByBlocks
from solver.equilibrium.scene import Scales, Scene
from solver.mesh.body import Body, NodeGraph
from solver.physics.supports import Fixed, Tied, rotation_row, translation_row
from solver.physics.term import Evaluation

DIRECT = ["superlu"] + (["pardiso"] if mkl_pardiso() else [])


@pytest.fixture
def rng():
    return np.random.default_rng(0)


class Springs:
    """Every pair of nodes in a cell pulls on its rest length, ½ k (l − l₀)²; and a load e·f."""

    name, symmetric = "springs", True

    def __init__(self, body, load=None, k=1.0):
        self.graph, self.X, self.k, self.load = body.graph, body.nodes, k, load
        g = body.graph
        self.a = np.repeat(np.arange(g.n), np.diff(g.indptr))
        self.b = g.indices
        self.pairs = np.flatnonzero(self.a < self.b)

    def evaluate(self, u, e, order=2):
        a, b = self.a[self.pairs], self.b[self.pairs]
        x = self.X + u
        d, d0 = x[b] - x[a], self.X[b] - self.X[a]
        length, rest = np.linalg.norm(d, axis=1), np.linalg.norm(d0, axis=1)
        energy = 0.5 * self.k * float(((length - rest) ** 2).sum())
        force = np.zeros_like(u)
        n = d / length[:, None]
        pull = self.k * (length - rest)[:, None] * n
        np.add.at(force, b, pull)
        np.add.at(force, a, -pull)
        if self.load is not None:
            energy -= e * float((self.load * u).sum())
            force -= e * self.load
        blocks = np.zeros((self.graph.blocks, 3, 3))
        nn = np.einsum("ni,nj->nij", n, n)
        slack = (1 - rest / length)[:, None, None]
        h = self.k * (nn + slack * (np.eye(3) - nn))
        blocks[self.pairs] = -h
        reverse = NodeGraph(self.graph.indptr, self.graph.indices)
        back = reverse.positions(np.column_stack([b, a]))[:, 0, 1]
        blocks[back] = -h
        diagonal = np.flatnonzero(self.a == self.b)
        total = np.zeros((self.graph.n, 3, 3))
        np.add.at(total, a, h)
        np.add.at(total, b, h)
        blocks[diagonal] = total[self.a[diagonal]]
        return Evaluation(energy, force, blocks)


class Curl:
    """A force without a potential, its stiffness unsymmetric: f = e·c × x at every node."""

    name, symmetric = "curl", False

    def __init__(self, body):
        self.graph = NodeGraph.of(len(body.nodes))
        self.X = body.nodes
        self.spin = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0.0]])

    def evaluate(self, u, e, order=2):
        blocks = np.broadcast_to(e * self.spin, (self.graph.blocks, 3, 3)).copy()
        return Evaluation(None, e * (self.X + u) @ self.spin.T, blocks)


@pytest.fixture(scope="module")
def body():
    mesh = skfem.MeshHex.init_tensor(*(np.linspace(0, L, n) for L, n in ((2, 3), (1, 3), (1, 2))))
    return Body.build(mesh, "hex8")


SCALES = Scales(1.0, 1.0, 1.0)


def dense(scene, x, e):
    """The whole tangent by differences of the residual."""
    h = 1e-6
    columns = [
        (scene.residual(x + h * d, e) - scene.residual(x - h * d, e)) / (2 * h)
        for d in np.eye(scene.size)
    ]
    return np.array(columns).T


def matrix(scene, system):
    n = scene.size
    at = scene.frame.pattern
    m = sp.csr_array((system.values, at.indices, at.indptr), shape=(n, n)).toarray()
    return m + np.triu(m, 1).T if scene.symmetric else m


def scenes(body, linear="auto"):
    load = np.random.default_rng(1).normal(size=body.nodes.shape)
    low = body.nodes_where(lambda X: X[:, 0] < 1e-9)
    slanted = body.nodes_where(lambda X: X[:, 0] > 2 - 1e-9)
    clamp = [Fixed(low, axis) for axis in np.eye(3)]
    tilt = np.array([1.0, 2.0, 0.5])
    rows = [translation_row(body, k) for k in range(3)] + [rotation_row(body, k) for k in range(3)]
    face = body.nodes_where(lambda X: (X[:, 0] > 2 - 1e-9) & (X[:, 2] < 1e-9))
    tie = Tied(face, above(body, face), (-1, 1, -1))
    return {
        "tied": Scene(body, [Springs(body, load)], fixed=clamp, tied=[tie], linear=linear),
        "tied, held by rows": Scene(
            body, [Springs(body, load)], tied=[tie], rows=rows[1:5], linear=linear
        ),
        "tied, unsymmetric": Scene(
            body, [Springs(body, load), Curl(body)], fixed=clamp, tied=[tie], linear=linear
        ),
        "clamped": Scene(body, [Springs(body, load)], fixed=clamp, linear=linear),
        "mirror at an angle": Scene(
            body, [Springs(body, load)], fixed=[*clamp, Fixed(slanted, tilt)], linear=linear
        ),
        "free, held by rows": Scene(body, [Springs(body, load)], rows=rows, linear=linear),
        "rows and mirror": Scene(
            body, [Springs(body, load)], fixed=[Fixed(slanted, tilt)], rows=rows[:2], linear=linear
        ),
        "unsymmetric": Scene(
            body, [Springs(body, load), Curl(body)], fixed=clamp, rows=rows[:1], linear=linear
        ),
    }


def above(body, nodes):
    """The node over each of these."""
    there = body.nodes[nodes] + (0, 0, 1)
    return np.array([np.argmin(np.linalg.norm(body.nodes - p, axis=1)) for p in there])


NAMES = ["clamped", "mirror at an angle", "free, held by rows", "rows and mirror", "unsymmetric"]
NAMES += ["tied", "tied, held by rows", "tied, unsymmetric"]


@pytest.mark.parametrize("name", NAMES)
def test_tangent_is_the_derivative_of_the_residual(body, name, rng):
    scene = scenes(body)[name]
    x = 0.05 * rng.normal(size=scene.size)
    system = scene.system(x, 0.7)
    np.testing.assert_allclose(system.residual, scene.residual(x, 0.7), atol=1e-14)
    np.testing.assert_allclose(matrix(scene, system), dense(scene, x, 0.7), atol=1e-7)


@pytest.mark.parametrize("linear", DIRECT)
def test_solve_and_count_against_dense_algebra(body, linear, rng):
    for name, scene in scenes(body, linear).items():
        # Squeezed springs push sideways: the stiffness is indefinite there.
        squeezed = -0.6 * (body.nodes - body.nodes.mean(axis=0))
        x = scene.unknowns(squeezed) + 0.02 * rng.normal(size=scene.size)
        system = scene.system(x, 0.7)
        A, b = matrix(scene, system), rng.normal(size=(scene.size, 2))
        got = system.factorise().solve(b)
        np.testing.assert_allclose(A @ got, b, atol=1e-8 * np.abs(got).max(), err_msg=name)
        np.testing.assert_allclose(system.factorise().solve(b[:, 0]), got[:, 0], rtol=1e-9)
        if not scene.symmetric:
            assert system.unstable is None
        elif linear == "pardiso":
            m = scene.n_rows
            C = A[scene.n_free :, : scene.n_free]
            Z = np.linalg.svd(C)[2][m:].T if m else np.eye(scene.n_free)
            modes = np.linalg.eigvalsh(Z.T @ A[: scene.n_free, : scene.n_free] @ Z)
            assert system.unstable == (modes < 0).sum() > 0, name


@pytest.mark.parametrize("name", NAMES)
def test_unknowns_held_afterwards_are_as_if_they_had_no_rows(body, name, rng):
    scene = scenes(body)[name]
    squeezed = -0.6 * (body.nodes - body.nodes.mean(axis=0))
    system = scene.system(scene.unknowns(squeezed) + 0.02 * rng.normal(size=scene.size), 0.7)
    held = np.zeros(scene.size, bool)
    held[rng.choice(scene.n_free, 4, replace=False)] = True
    own, b = system.holding(held), rng.normal(size=scene.size)
    rest = matrix(scene, system)[np.ix_(~held, ~held)]
    solution = own.factorise().solve(np.where(held, 0.0, b))
    np.testing.assert_allclose(solution[~held], np.linalg.solve(rest, b[~held]), rtol=1e-7)
    assert not solution[held].any() and not own.residual[held].any()
    assert np.array_equal(own.residual[~held], system.residual[~held])
    if scene.symmetric:
        modes = (np.linalg.eigvalsh(rest) < 0).sum() - scene.n_rows
        assert own.unstable == modes


@pytest.mark.parametrize("linear", DIRECT)
def test_a_scene_that_holds_nothing_is_factorised_by_blocks(body, rng, linear):
    scene = Scene(body, [Springs(body)], scales=SCALES, linear=linear)
    squeezed = -0.6 * (body.nodes - body.nodes.mean(axis=0))
    system = scene.system(scene.unknowns(squeezed) + 0.02 * rng.normal(size=scene.size), 0.0)
    assert isinstance(scene.solver, ByBlocks) == (linear == "pardiso")
    A, b = matrix(scene, system), rng.normal(size=(scene.size, 2))
    # One component of a node that is held with the others free, and all three of one.
    for few in ([0, 1, 5, 9, 10, 20], [3, 4, 5, 22, 31, 47], []):
        kept = np.setdiff1d(np.arange(scene.size), few)
        own = system.shifted(-0.3).holding(np.isin(np.arange(scene.size), few))
        rest = A[np.ix_(kept, kept)] - 0.3 * np.eye(len(kept))
        assert own.unstable in ((np.linalg.eigvalsh(rest) < 0).sum(), None)
        assert own.unstable is not None or linear == "superlu"
        solution = own.factorise().solve(b)[kept]
        np.testing.assert_allclose(solution, np.linalg.solve(rest, b[kept]), rtol=1e-7)


def test_superlu_counts_where_it_did_not_exchange_rows(body):
    scene = scenes(body, "superlu")["clamped"]
    assert scene.system(np.zeros(scene.size), 0.0).unstable in (0, None)


def test_prescribed_values_move_along_their_direction(body, rng):
    end = body.nodes_where(lambda X: X[:, 0] > 2 - 1e-9)
    start = body.nodes_where(lambda X: X[:, 0] < 1e-9)
    tilt = np.array([0.0, 3.0, 4.0])
    profile = np.linspace(1, 2, len(end))
    scene = Scene(
        body,
        [Springs(body)],
        fixed=[
            Fixed(end, -tilt, value=lambda e: e * profile),
            Fixed(start, [-1, 0, 0], value=0.25),
        ],
        scales=SCALES,
    )
    u = scene.displacement(rng.normal(size=scene.size), 0.5)
    np.testing.assert_allclose(u[end] @ (-tilt / 5), 0.5 * profile, atol=1e-14)
    np.testing.assert_allclose(u[start][:, 0], -0.25, atol=1e-14)


@pytest.mark.parametrize("name", ["mirror at an angle", "tied"])
def test_unknowns_and_displacement_are_inverse(body, name, rng):
    scene = scenes(body)[name]
    x = rng.normal(size=scene.size)
    np.testing.assert_allclose(scene.unknowns(scene.displacement(x, 0.3)), x, atol=1e-14)
    y = rng.normal(size=scene.size)
    np.testing.assert_allclose(
        scene.displacement(x, 0.3) + scene.step_displacement(y - x),
        scene.displacement(y, 0.3),
        atol=1e-13,
    )


@pytest.mark.parametrize("name", ["mirror at an angle", "tied"])
def test_force_on_unknowns_is_the_gradient_of_the_energy(body, name, rng):
    scene = scenes(body)[name]
    x, d, h = 0.1 * rng.normal(size=scene.size), rng.normal(size=scene.size), 1e-6
    slope = (scene.energy(x + h * d, 0.4) - scene.energy(x - h * d, 0.4)) / (2 * h)
    assert slope == pytest.approx(d @ scene.residual(x, 0.4), rel=1e-7)
    rate = (scene.residual(x, 0.5) - scene.residual(x, 0.3)) / 0.2
    np.testing.assert_allclose(scene.load_rate(x, 0.4), rate, atol=1e-8)


def test_rows_measure_rigid_motion(body):
    X = body.nodes
    centre = body.node_volumes() @ X / body.node_volumes().sum()
    for axis in range(3):
        shift = np.zeros_like(X)
        shift[:, axis] = 0.3
        spin = np.cross(np.eye(3)[axis], X - centre)
        for other in range(3):
            t, r = translation_row(body, other).coefficients, rotation_row(body, other).coefficients
            assert (t * shift).sum() == pytest.approx(0.3 if other == axis else 0, abs=1e-14)
            assert (t * spin).sum() == pytest.approx(0, abs=1e-14)
            assert (r * shift).sum() == pytest.approx(0, abs=1e-14)
        assert abs((rotation_row(body, axis).coefficients * spin).sum()) > 0.1


def test_rows_beside_a_large_stiffness_still_count(body, rng):
    rows = [translation_row(body, k) for k in range(3)] + [rotation_row(body, k) for k in range(3)]
    for k in (1.0, 1e9):
        scene = Scene(body, [Springs(body, k=k)], rows=rows)
        system = scene.system(np.zeros(scene.size), 0.0)
        assert system.unstable == 0
        b = rng.normal(size=scene.size)
        x = system.factorise().solve(b)
        A = matrix(scene, system)
        np.testing.assert_allclose(A @ x, b, atol=1e-14 * np.abs(A).max() * np.abs(x).max())


def test_rows_hold_and_their_multipliers_balance_the_load(body):
    load = np.zeros_like(body.nodes)
    load[:, 2] = 0.01  # a net force: the multiplier of the z translation must carry it
    rows = [translation_row(body, k) for k in range(3)] + [rotation_row(body, k) for k in range(3)]
    scene = Scene(body, [Springs(body, load)], rows=rows)
    x = np.zeros(scene.size)
    for _ in range(6):
        system = scene.system(x, 1.0)
        x = x - system.factorise().solve(system.residual)
    assert np.abs(scene.residual(x, 1.0)).max() < 1e-12
    u = scene.displacement(x, 1.0)
    for row in rows:
        assert (row.coefficients * u).sum() == pytest.approx(0, abs=1e-14)
    assert x[scene.n_free + 2] == pytest.approx(load.sum(), rel=1e-10)
    assert system.unstable == 0


def test_an_inadmissible_term_is_no_state(body):
    class Wall(Springs):
        def evaluate(self, u, e, order=2):
            return Evaluation(np.inf) if u.max() > 0.5 else super().evaluate(u, e, order)

        def longest_step(self, u, du):
            return min(1.0, 0.5 / max(du.max(), 1e-300))

    scene = Scene(body, [Wall(body)], rows=[translation_row(body, 0)])
    far = np.ones(scene.size)
    assert scene.energy(far, 0.0) == np.inf
    assert scene.residual(far, 0.0) is None
    assert scene.system(far, 0.0) is None
    assert scene.longest_step(np.zeros(scene.size), far, 0.0) == pytest.approx(0.5)
    assert Scene(body, [Springs(body)]).longest_step(far, far, 0.0) == 1.0


def test_supports_are_checked(body):
    node = np.array([0])
    with pytest.raises(ValueError, match="at an angle"):
        Scene(
            body, [Springs(body)], fixed=[Fixed(node, [1, 0, 0]), Fixed(node, [1, 1, 0], value=0.1)]
        )
    with pytest.raises(ValueError, match="direction"):
        Scene(body, [Springs(body)], fixed=[Fixed(node, [0, 0, 0])])
    with pytest.raises(ValueError, match="no term has a stiffness"):
        Scene(body, [])
    with pytest.raises(ValueError, match="constraint rows"):
        Scene(body, [Springs(body)], rows=[translation_row(body, 0)], linear="cg")


def test_planes_at_an_angle_leave_their_common_line(body, rng):
    one, two, three = np.array([1.0, 0, 0]), np.array([1.0, 2, 0]), np.array([1.0, -1, 0])
    fixed = [Fixed(np.array([3]), n) for n in (one, two, three)]
    scene = Scene(body, [Springs(body)], fixed=fixed)
    assert scene.size == 3 * len(body.nodes) - 2
    u = scene.displacement(rng.normal(size=scene.size), 0.0)[3]
    assert abs(u[2]) > 0.01 and np.abs(u[:2]).max() < 1e-14
    point = Scene(body, [Springs(body)], fixed=[*fixed, Fixed(np.array([3]), [1.0, 1, 1])])
    assert np.abs(point.displacement(rng.normal(size=point.size), 0.0)[3]).max() == 0


def test_free_rigid_motion_is_refused_and_counted(body):
    rows = [translation_row(body, k) for k in range(3)] + [rotation_row(body, k) for k in range(3)]
    for kept in range(7):
        scene = Scene(body, [Springs(body)], rows=rows[:kept])
        x = np.zeros(scene.size)
        if kept == 6:
            scene.refuse_free_motion(x, 0.0)
            continue
        with pytest.raises(ValueError, match=f"^{6 - kept} of the body's rigid motions"):
            scene.refuse_free_motion(x, 0.0)


def test_tied_nodes_move_as_their_images(body, rng):
    scene = scenes(body)["tied"]
    low = body.nodes_where(lambda X: (X[:, 0] > 2 - 1e-9) & (X[:, 2] < 1e-9))
    u = scene.displacement(rng.normal(size=scene.size), 0.3)
    assert np.array_equal(u[low], u[above(body, low)] * (-1, 1, -1)) and np.abs(u[low]).min() > 0
    assert scene.size == 3 * (len(body.nodes) - 6 - len(low))


def test_what_ties_leave_free_is_counted(body):
    """Opposite under a half-turn about z, a whole face moves along z and turns about z only; tied
    to the contrary it shifts along x and y and turns about them."""
    face = body.nodes_where(lambda X: X[:, 0] < 1e-9)
    face = face[body.nodes[face, 1] < 0.5 - 1e-9]
    images = [
        np.argmin(np.linalg.norm(body.nodes - p, axis=1))
        for p in body.nodes[face] * (1, -1, 1) + (0, 1, 0)
    ]
    axis = body.nodes_where(lambda X: (X[:, 0] < 1e-9) & (np.abs(X[:, 1] - 0.5) < 1e-9))
    for signs, held, loose in (((-1, -1, 1), (0, 1), 2), ((1, 1, -1), (2,), 4)):
        fixed = [Fixed(axis, np.eye(3)[k]) for k in held]
        scene = Scene(body, [Springs(body)], fixed=fixed, tied=[Tied(face, images, signs)])
        with pytest.raises(ValueError, match=f"^{loose} of the body's rigid motions"):
            scene.refuse_free_motion(np.zeros(scene.size), 0.0)


def test_ties_are_checked(body):
    def tie(nodes, images, signs=(1, 1, 1), fixed=()):
        Scene(body, [Springs(body)], fixed=fixed, tied=[Tied(nodes, images, signs)])

    for nodes, images in (([0, 1], [1, 2]), ([0, 0], [1, 2])):
        with pytest.raises(ValueError, match=r"node [01] is tied"):
            tie(nodes, images)
    for fixed in (Fixed([0], [1, 0, 0]), Fixed([1], [1, 2, 0])):
        with pytest.raises(ValueError, match="node 0 is tied"):
            tie([0], [1], fixed=[fixed])
    tie([0], [1], fixed=[Fixed([1], [1, 0, 0])])
    with pytest.raises(ValueError, match="as many images"):
        tie([0, 1], [2])
    with pytest.raises(ValueError, match="three signs"):
        tie([0], [2], (1, 1, 0.5))


def test_other_terms_are_judged_by_the_scales_that_were_given(body):
    scales = Scales(2.0, 3.0, 5.0)
    low = body.nodes_where(lambda X: X[:, 0] < 1e-9)
    clamp = [Fixed(low, axis) for axis in np.eye(3)]
    scene = Scene(body, [Springs(body)], fixed=clamp, scales=scales)
    assert scene.with_terms([Springs(body)]).scales == scales


def test_the_same_plane_twice_holds_once(body):
    nodes = body.nodes_where(lambda X: X[:, 0] < 1e-9)
    once = Scene(body, [Springs(body)], fixed=[Fixed(nodes, [1, 0, 0])])
    twice = Scene(body, [Springs(body)], fixed=[Fixed(nodes, [1, 0, 0]), Fixed(nodes, [-1, 0, 0])])
    assert once.size == twice.size == 3 * len(body.nodes) - len(nodes)


def test_conjugate_gradients_agree_with_a_factorisation(rng):
    cube = Body.build(skfem.MeshHex.init_tensor(*[np.linspace(0, 1, 8)] * 3), "hex8")
    low = cube.nodes_where(lambda X: X[:, 0] < 1e-9)
    clamp = [Fixed(low, axis) for axis in np.eye(3)]
    scene = Scene(cube, [Springs(cube)], fixed=clamp)
    iterative = Scene(cube, [Springs(cube)], fixed=clamp, linear="cg")
    x, b = np.zeros(scene.size), rng.normal(size=scene.size)
    want = scene.system(x, 0.0).factorise().solve(b)
    system = iterative.system(x, 0.0)
    got = system.factorise().solve(b)
    np.testing.assert_allclose(got, want, rtol=1e-6, atol=1e-8 * np.abs(want).max())
    assert 1 < iterative.solver.iterations < 60
    assert system.unstable is None
    iterative.solver._most = 2
    with pytest.raises(SingularMatrix, match="did not converge in 2"):
        system.factorise().solve(b)


@pytest.mark.parametrize("method", DIRECT)
def test_singular_matrices_are_a_typed_error(method):
    solver = make_solver([0, 2, 3], [0, 1, 1], symmetric=True, method=method)
    with pytest.raises(SingularMatrix):
        factor = solver.factorise(np.array([1.0, 1.0, np.nan]))
        x = factor.solve(np.ones(2))
        if not np.isfinite(x).all():
            raise SingularMatrix("not finite")


def test_unknown_method():
    with pytest.raises(ValueError, match="expected auto"):
        make_solver([0, 1], [0], symmetric=True, method="umfpack")


@pytest.mark.skipif("pardiso" not in DIRECT, reason="MKL is not installed")
def test_many_solvers_do_not_leak():
    import resource

    n = 20_000
    A = sp.diags_array(
        [np.full(n, 4.0), np.full(n - 1, -1.0), np.full(n - 50, -1.0)], offsets=[0, 1, 50]
    ).tocsr()

    def use():
        make_solver(A.indptr, A.indices, symmetric=True, method="pardiso").factorise(A.data)

    for _ in range(3):
        use()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(20):
        use()
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    assert grown < 60  # each holds about 20 MB
