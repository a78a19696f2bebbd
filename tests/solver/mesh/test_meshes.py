"""Structured builders, refused meshes and the quality report."""

from itertools import product

import numpy as np
import pytest
import skfem

from solver.cases.unit import problem_p
from solver.mesh import checks
from solver.mesh.body import Body
from solver.mesh.quality import quality
from solver.mesh.structured import box, graded, growing, joined, polar, spherical, weld

TWO = [0.0, 1.0, 2.0]
ONE = [0.0, 1.0]


# -- builders --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "toward, shortest", [("a", [0]), ("b", [5]), ("both", [0, 5]), ("middle", [2, 3])]
)
def test_graded_steps_are_geometric_and_shrink_where_they_should(toward, shortest):
    x = graded(-1, 2, 6, toward=toward, ratio=8)
    steps = np.diff(x)
    assert (x[0], x[-1]) == (-1, 2)
    assert steps.max() / steps.min() == pytest.approx(8)
    np.testing.assert_array_equal(np.flatnonzero(np.isclose(steps, steps.min())), shortest)
    factors = {1.0, 8 ** (1 / 5) if toward in "ab" else 8**0.5}
    for f in steps[1:] / steps[:-1]:
        assert min(abs(f - g) for a in factors for g in (a, 1 / a)) < 1e-12
    np.testing.assert_allclose(graded(0, 3, 3, ratio=1), [0, 1, 2, 3])
    np.testing.assert_allclose(graded(0, 3, 1, ratio=9), [0, 3])


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: graded(0, 1, 0), "n = 0"),
        (lambda: graded(1, 1, 3), "no length"),
        (lambda: graded(0, 1, 3, ratio=0.5), "ratio = 0.5"),
        (lambda: graded(0, 1, 3, toward="left"), "toward = 'left'"),
        (lambda: joined([0, 1], [1.5, 2]), "a piece starts at 1.5 but the last one ends at 1"),
        (lambda: box([0, 0], ONE, ONE), "x coordinates: expected at least two"),
        (lambda: box(ONE, ONE, [0, np.nan]), "z coordinates"),
        (lambda: box(TWO, ONE, ONE, keep=lambda X: X[:, 0] > 9), "keep leaves no cell"),
        (lambda: box(TWO, ONE, ONE, layers={"top": lambda X: X[:, 2] > 9}), "'top' is empty"),
        (lambda: box(TWO, ONE, ONE, layers={"top": lambda X: X[:, 2]}), "expected a mask"),
        (lambda: box(TWO, ONE, ONE, boundaries={"e": lambda X: X[:, 0] == 1}), "'e' is empty"),
        (lambda: box(TWO, ONE, ONE, shape=lambda X: X[:, :2]), "shape gave"),
    ],
)
def test_builders_refuse(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("tets", [False, True])
def test_box_with_a_narrow_hinge_and_strips(tets):
    """Panels 2 wide, a hinge 1 wide between them, strips of an active layer on the hinge."""
    element = "tet4" if tets else "hex8"

    def keep(X):
        panel = (np.abs(X[:, 1]) > 1) & (X[:, 2] < 1)
        hinge = (np.abs(X[:, 1]) < 1) & (X[:, 0] < 1)
        strip = np.abs(X[:, 1]) > 0.5
        return panel | (hinge & ((X[:, 2] < 1) | strip))

    mesh = box(TWO, [-3, -1, -0.5, 0.5, 1, 3], [0, 1, 3], keep=keep, tets=tets,
               layers={"active": lambda X: X[:, 2] > 1},
               boundaries={"cut": lambda X: (X[:, 0] == 1) & (X[:, 2] < 1)})  # fmt: skip
    body = Body.build(mesh, element)
    assert body.weights.sum() == pytest.approx(8 + 2 + 2)
    assert body.weights[body.cells_of("active")].sum() == pytest.approx(2)
    assert body.surface("cut").weights.sum() == pytest.approx(2)
    assert body.surface("z+").weights.sum() == pytest.approx(1)
    assert body.surface("x+").weights.sum() == pytest.approx(4)


@pytest.mark.parametrize("element", ["hex27", "tet10", "hex8", "tet4"])
def test_ring_closes_and_sphere_patch_is_a_24th(element):
    tets, rel = element.startswith("tet"), 1e-4 if element in ("hex27", "tet10") else 0.05
    ring = box([1, 1.2], np.linspace(0, 2 * np.pi, 21), [0, 0.5], shape=polar, tets=tets)
    assert set(ring.boundaries) == {"x-", "x+", "z-", "z+"}
    body = Body.build(ring, element)
    assert body.weights.sum() == pytest.approx(np.pi * 0.44 * 0.5, rel=rel)
    angles = np.linspace(0, np.pi / 4, 5)
    patch = Body.build(box([1, 1.5], angles, angles, shape=spherical, tets=tets), element)
    assert 24 * patch.weights.sum() == pytest.approx(4 / 3 * np.pi * (1.5**3 - 1), rel=rel)
    # Its sides are mirror planes: y = 0, z = 0, y = x, z = x.
    for side, normal in (
        ("y-", (0, 1, 0)),
        ("z-", (0, 0, 1)),
        ("y+", (1, -1, 0)),
        ("z+", (1, 0, -1)),
    ):
        np.testing.assert_allclose(patch.nodes[patch.nodes_of(side)] @ normal, 0, atol=1e-12)


@pytest.mark.parametrize("shape", [None, lambda X: X[:, [1, 2, 0]]])
def test_reference_axes_of_the_cells_are_the_axes_of_the_box(shape):
    mesh = box([0, 2], [0, 3], [0, 5], shape=shape)
    J = checks.jacobians(mesh, np.full((3, 1), 0.3))[0, :, :, 0]
    wanted = np.diag([2.0, 3.0, 5.0])
    np.testing.assert_allclose(J, wanted if shape is None else wanted[[1, 2, 0]], atol=1e-12)


@pytest.mark.parametrize("tets", [False, True])
def test_weld_joins_layers_and_keeps_names(tets):
    lower = box(TWO, ONE, ONE, tets=tets)
    upper = box(TWO, ONE, [1.0, 2.0], tets=tets)
    n, m = lower.p.shape[1], lower.t.shape[1]
    # The upper corners are numbered backwards: merging them changes the order within a cell.
    both = type(lower)(
        np.hstack([lower.p, upper.p[:, ::-1]]), np.hstack([lower.t, 2 * n - 1 - upper.t])
    )
    both = both.with_subdomains({"top": np.arange(m, 2 * m)}).with_boundaries(
        {"floor": lambda X: X[2] == 0, "seam": lambda X: X[2] == 1, "end": lambda X: X[0] == 2}
    )
    element = "tet4" if tets else "hex8"
    with pytest.raises(ValueError, match=r"2 parts .* 6 pairs of nodes coincide"):
        Body.build(both, element)
    assert Body.build(both, element, parts=True).weights.sum() == pytest.approx(4)
    body = Body.build(weld(both), element)
    assert len(body.nodes) == 18
    assert body.surface("floor").weights.sum() == pytest.approx(2)
    assert body.surface("end").weights.sum() == pytest.approx(2)
    assert set(body.nodes_of("seam")) == set(body.nodes_where(lambda X: X[:, 2] == 1))
    assert body.weights[body.cells_of("top")].sum() == pytest.approx(2)
    with pytest.raises(ValueError, match="only linear meshes"):
        weld(skfem.MeshHex2())


def test_growing_steps_keep_their_first_their_factor_and_the_longest():
    for length, first, factor, longest in ((1.0, 0.01, 3.0, 0.1), (0.4, 0.3, 2.0, 0.1)):
        steps = np.diff(growing(length, first, factor, longest))
        assert steps.sum() == pytest.approx(length)
        # They shrink to fit, by less than one of them.
        assert 0.5 * min(first, longest) < steps[0] <= min(first, longest) * (1 + 1e-12)
        assert 0.5 * longest < steps.max() <= longest * (1 + 1e-12)
        assert (steps[1:] / steps[:-1] < factor * (1 + 1e-12)).all()


def test_problem_p():
    passive, active = 0.1 * 0.5 * 4e-3, 0.1 * 0.1 * 20e-3
    before = 0
    for level in range(3):
        body = problem_p.mesh(level)
        assert body.weights[body.cells_of("active")].sum() == pytest.approx(active, rel=1e-12)
        assert body.weights[body.cells_of("passive")].sum() == pytest.approx(passive, rel=1e-12)
        assert body.unknowns > before
        before = body.unknowns
        y = np.unique(body.mesh.p[1].round(12))
        # The shortest steps stand at the end of the active layer, on both sides.
        hinge, panel = y[y < 0.1 + 1e-9], y[y > 0.1 - 1e-9]
        assert hinge[-1] == pytest.approx(0.1, abs=1e-12)
        assert np.argmin(np.diff(hinge)) == len(hinge) - 2 and np.argmin(np.diff(panel)) == 0
        for name, axis in (("x-", 0), ("y-", 1)):
            on = body.nodes_where(lambda X, k=axis: np.abs(X[:, k]) < 1e-9)
            assert set(body.nodes_of(name)) == set(on)
    whole = problem_p.mesh(0, "tet4", quarter=False)
    assert whole.weights.sum() == pytest.approx(4 * (passive + active), rel=1e-12)
    with pytest.raises(ValueError, match="level 9"):
        problem_p.mesh(9)


# -- facets and refusals ---------------------------------------------------------------------------


@pytest.mark.parametrize("tets", [False, True])
def test_facets_are_scikit_fems(tets):
    mesh = box(graded(0, 1, 4), TWO, TWO, tets=tets)
    table = checks.facets(mesh)
    np.testing.assert_array_equal(table.vertices, mesh.facets)
    np.testing.assert_array_equal(table.of_cell, mesh.t2f)
    np.testing.assert_array_equal(table.cells, mesh.f2t)
    np.testing.assert_array_equal(np.sort(table.boundary), mesh.boundary_facets())


def cubes(*offsets, merge=True):
    """Unit cubes at offsets, their corners merged where they meet."""
    p, t = [], []
    for i, offset in enumerate(offsets):
        one = skfem.MeshHex()
        p.append(one.p + np.array(offset)[:, None])
        t.append(one.t + 8 * i)
    mesh = skfem.MeshHex(np.hstack(p), np.hstack(t))
    return weld(mesh) if merge else mesh


def moved(mesh, vertex, position):
    p = mesh.p.copy()
    p[:, vertex] = position
    return type(mesh)(p, mesh.t)


def fold():
    """Two tetrahedra on the same side of their common face."""
    p = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, 1], [0.3, 0.3, 0.5]]).T
    return skfem.MeshTet(p, np.array([[0, 1, 2, 3], [0, 1, 2, 4]]).T)


def twice():
    one = cubes((0, 0, 0))
    return skfem.MeshHex(one.p, np.hstack([one.t] * 3))


def hanging(shift=0.0):
    """A cell of height 1 beside two of height ½ that share its corners; see ``shift``."""
    coarse = skfem.MeshHex.init_tensor([0, 1], [0, 1], [0, 1])
    fine = skfem.MeshHex.init_tensor([1, 2], [0, 1], [0, 0.5 + shift, 1])
    p = np.hstack([coarse.p, fine.p])
    return weld(skfem.MeshHex(p, np.hstack([coarse.t, fine.t + 8])))


def test_nodes_that_hang_anywhere_on_a_facet_are_seen():
    # Sixteen facets against one: on its sides, its diagonals, and in each of its quarters.
    coarse = skfem.MeshHex.init_tensor([0, 1], [0, 1], [0, 1])
    places = [0, 0.2, 0.5, 0.8, 1]
    fine = skfem.MeshHex.init_tensor([1, 2], places, places)
    mesh = weld(skfem.MeshHex(np.hstack([coarse.p, fine.p]), np.hstack([coarse.t, fine.t + 8])))
    loose = mesh.p[:, checks.hanging(mesh, checks.facets(mesh))].T
    corners = {(1, 0, 0), (1, 0, 1), (1, 1, 0), (1, 1, 1)}
    assert {tuple(x) for x in loose.tolist()} == set(product([1], places, places)) - corners


def bridged():
    """The hanging mesh, with a cell below all of it that makes it one part."""
    mesh = hanging()
    floor = skfem.MeshHex.init_tensor([0, 1, 2], [0, 1], [-1, 0])
    p = np.hstack([mesh.p, floor.p])
    return weld(skfem.MeshHex(p, np.hstack([mesh.t, floor.t + mesh.p.shape[1]])))


def slit():
    """2 × 1 × 2 cells, the upper two joined to the lower ones but not to each other."""
    mesh = box(TWO, ONE, TWO)
    p, t = mesh.p, mesh.t.copy()
    middle = np.flatnonzero((p[0] == 1) & (p[2] == 2))
    right = np.flatnonzero(p[:, t].mean(axis=1)[0] > 1)
    for i, v in enumerate(middle):
        t[:, right] = np.where(t[:, right] == v, p.shape[1] + i, t[:, right])
    return skfem.MeshHex(np.hstack([p, p[:, middle]]), t)


@pytest.mark.parametrize(
    "mesh, message",
    [
        (moved(skfem.MeshHex(), 7, (-1, -1, -1)), r"1 of 1 cells are inverted or flat, the first"),
        (moved(skfem.MeshHex(), 7, (0.2, 0.2, 0.2)), "1 of 1 cells are inverted"),
        (moved(skfem.MeshTet(), 7, (1, 1, 1e-15)), "inverted or flat"),
        (moved(skfem.MeshHex(), 3, (np.nan, 0, 0)), "1 nodes have no finite position"),
        (
            skfem.MeshHex(
                np.hstack([np.full((3, 1), 5.0), skfem.MeshHex().p]), skfem.MeshHex().t + 1
            ),
            r"1 nodes belong to no cell, the first near \(5",
        ),
        (fold(), "at 1 facets lie on the same side .* folded over"),
        (twice(), "6 facets belong to more than two cells"),
        (cubes((0, 0, 0), (3, 0, 0)), r"2 parts that share no facet \(cells: 1, 1\)"),
        (cubes((0, 0, 0), (1, 1, 0)), "2 parts that share no facet"),
        (cubes((0, 0, 0), (1, 0, 0), merge=False), "4 pairs .* parts touch"),
        (hanging(), r"2 parts that share no facet"),
        (bridged(), r"2 nodes hang on facets of other cells, the first near \(1, 0, 0.5\)"),
        (slit(), r"2 pairs of nodes coincide without being one, the first near \(1, [01], 2\)"),
    ],
)
def test_meshes_that_are_refused(mesh, message):
    element = "tet4" if isinstance(mesh, skfem.MeshTet1) else "hex8"
    with pytest.raises(ValueError, match=message):
        Body.build(mesh, element)


@pytest.mark.parametrize(
    "mesh, volume", [(cubes((0, 0, 0), (3, 0, 0)), 2), (bridged(), 4), (slit(), 4)]
)
def test_separate_parts_are_admitted_on_request(mesh, volume):
    assert Body.build(mesh, "hex8", parts=True).weights.sum() == pytest.approx(volume)


def test_a_hanging_node_at_any_height_and_on_a_graded_mesh_is_found():
    grid = box(graded(0, 1, 12), graded(0, 1, 12), [0, 1e-3, 1])
    table = checks.facets(grid)
    assert len(checks.hanging(grid, table)) == 0
    mesh = hanging(0.3)
    found = checks.hanging(mesh, checks.facets(mesh))
    np.testing.assert_allclose(sorted(map(tuple, mesh.p[:, found].T)), [(1, 0, 0.8), (1, 1, 0.8)])


def test_a_mirrored_order_of_nodes_is_no_fault():
    grid = box(TWO, TWO, TWO)
    flipped = grid.t.copy()
    mirror = [1, 0, 4, 5, 2, 3, 7, 6]  # z turned round
    flipped[:, ::2] = flipped[mirror][:, ::2]
    body = Body.build(skfem.MeshHex(grid.p, flipped), "hex27")
    assert body.weights.sum() == pytest.approx(8)


def test_a_curved_cell_inverted_only_at_its_corner_is_refused():
    def pinched(X):
        x, y, z = X.T
        return np.stack([x, y, z + 0.6 * x * x * y * y * z * (z - 2)], axis=-1)

    mesh = box(ONE, ONE, ONE, shape=pinched)
    det = skfem.Basis(mesh, skfem.ElementHex2(), intorder=5).dx
    assert (det > 0).all()
    with pytest.raises(ValueError, match="1 of 1 cells are inverted"):
        Body.build(mesh, "hex27")


# -- quality ---------------------------------------------------------------------------------------


def test_quality_of_bricks_and_regular_tetrahedra():
    found = quality(box([0, 1, 2], [0, 0.5, 1, 1.5], [0, 0.1]), (0, 1, 0))
    assert (found.cells, found.nodes, found.parts, found.inverted) == (6, 24, 1, 0)
    assert found.aspect == pytest.approx((10, 10))
    assert found.scaled_jacobian == pytest.approx((1, 1))
    assert found.bending == pytest.approx(1)
    assert found.sizes == pytest.approx((0.1, 1))
    assert found.through == {"the mesh": pytest.approx((3, 3))}
    assert "6 hexahedra, 24 nodes, 1 part\n" in str(found)
    assert "elements through the mesh: least 3, median 3" in str(found)
    p = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]]).T
    regular = quality(skfem.MeshTet(p, np.array([[0], [1], [2], [3]])))
    assert regular.aspect == pytest.approx((1, 1))
    assert regular.scaled_jacobian == pytest.approx((1, 1))


def test_quality_of_a_sheared_brick_and_of_split_bricks():
    shear = box(
        TWO, ONE, ONE, shape=lambda X: X + X[:, [1]] * np.array([1.0, 0, 0]), quadratic=False
    )
    assert quality(shear).scaled_jacobian == pytest.approx((2**-0.5, 2**-0.5))
    layers = {"low": lambda X: X[:, 2] < 0.12, "high": lambda X: X[:, 2] > 0.12}
    x, y, z = np.linspace(0, 4, 5), np.linspace(0, 1, 4), np.linspace(0, 0.3, 6)
    split = box(x, y, z, tets=True, layers=layers)
    found = quality(split, (0, 0, 1)).through
    assert found == {"low": pytest.approx((2, 2)), "high": pytest.approx((3, 3))}


def test_quality_counts_inverted_cells_and_parts_and_refuses_nonsense():
    mesh = cubes((0, 0, 0), (3, 0, 0))
    bad = moved(mesh, int(np.argmax(mesh.p.sum(axis=0))), (2.5, -1, -1))
    found = quality(bad)
    assert (found.parts, found.inverted) == (2, 1)
    assert found.scaled_jacobian[0] < 0 and found.bending < 0
    assert "1 cells are inverted" in str(found)
    with pytest.raises(ValueError, match="expected a mesh of hexahedra or tetrahedra"):
        quality(skfem.MeshTri())
    with pytest.raises(ValueError, match="direction"):
        quality(mesh, (0, 0, 0))
