"""Bodies: volumes, shape functions, surfaces and the node graph, for every element."""

import numpy as np
import pytest
import skfem

from solver.mesh.body import ELEMENTS, Body, NodeGraph
from solver.mesh.structured import box, polar

ORDER = {"hex27": 2, "hex20": 2, "hex8": 1, "tet10": 2, "tet4": 1}


def wavy(X):
    """Moves nodes of the unit cube without folding it."""
    x, y, z = X.T
    return np.stack(
        [x + 0.1 * y * z, y + 0.08 * np.sin(2 * x + z), z - 0.1 * x * y - 0.2 * x * x * y * y],
        axis=-1,
    )


def build(element, kind):
    """Body of the unit cube (2 × 3 × 2 cells), distorted, warped, or of an arch."""
    tets = element.startswith("tet")
    ax = [np.array([0, 0.4, 1.0]), np.linspace(0, 1, 4), np.array([0, 0.7, 1.0])]
    if kind == "straight":
        return Body.build(box(*ax, tets=tets), element)
    if kind in ("distorted", "warped"):
        return Body.build(box(*ax, tets=tets, shape=wavy, quadratic=kind == "warped"), element)
    r, a, w = np.array([1, 1.2, 1.5]), np.linspace(0, np.pi / 2, 5), np.array([0, 0.3, 0.5])
    return Body.build(box(r, a, w, tets=tets, shape=polar), element)


KINDS = ("straight", "distorted", "warped", "curved")


@pytest.fixture(params=[(e, k) for e in ELEMENTS for k in KINDS], ids="-".join)
def body(request):
    return build(*request.param)


def test_shapes_are_a_partition_of_unity_and_one_at_their_own_node(body):
    np.testing.assert_allclose(body.shapes.sum(axis=1), 1, atol=1e-13)
    np.testing.assert_allclose(body.gradients.sum(axis=2), 0, atol=1e-10)
    X = np.einsum("qk,mki->mqi", body.shapes, body.nodes[body.cells])
    np.testing.assert_allclose(X, body.points(), atol=1e-13)


def test_gradient_of_a_linear_field_is_exact(body):
    d = np.array([1.0, -2.0, 3.0])
    found = np.einsum("mqki,mk->mqi", body.gradients, (body.nodes @ d)[body.cells])
    np.testing.assert_allclose(found, np.broadcast_to(d, found.shape), atol=1e-11)


@pytest.mark.parametrize(
    "element, kind",
    [("hex27", "straight"), ("hex27", "distorted"), ("hex20", "straight"), ("tet10", "straight"),
     ("tet10", "distorted")],
)  # fmt: skip
def test_gradient_of_a_quadratic_field_is_exact(element, kind):
    body = build(element, kind)
    H = np.array([[1.0, 0.5, -0.3], [0.5, -2.0, 0.7], [-0.3, 0.7, 0.4]])
    values = np.einsum("ni,ij,nj->n", body.nodes, H, body.nodes) / 2
    found = np.einsum("mqki,mk->mqi", body.gradients, values[body.cells])
    np.testing.assert_allclose(found, body.points() @ H, atol=1e-11)


def test_volume_is_the_flux_of_position_through_the_surface(body):
    surface = body.surface(body.mesh.boundary_facets())
    x = np.einsum("fqk,fki->fqi", surface.shapes, body.nodes[surface.nodes])
    flux = np.einsum("fq,fqi,fqi->", surface.weights, x, surface.normals) / 3
    # Two points along a curved side (hex20, and tet10's four) don't integrate det(∂X/∂ξ) exactly.
    assert body.weights.sum() == pytest.approx(flux, rel=2e-4)
    np.testing.assert_allclose(
        np.einsum("fq,fqi->i", surface.weights, surface.normals), 0, atol=1e-12
    )


@pytest.mark.parametrize("element", ELEMENTS)
def test_volumes_and_areas(element):
    cube = build(element, "straight")
    assert cube.weights.sum() == pytest.approx(1, rel=1e-13)
    assert cube.node_volumes(2.0).sum() == pytest.approx(2, rel=1e-13)
    for i, side in enumerate(("x-", "x+", "y-", "y+", "z-", "z+")):
        surface = cube.surface(side)
        assert surface.weights.sum() == pytest.approx(1, rel=1e-13)
        normal = np.zeros(3)
        normal[i // 2] = 2 * (i % 2) - 1
        np.testing.assert_allclose(
            surface.normals, np.broadcast_to(normal, surface.normals.shape), atol=1e-13
        )
    arch = build(element, "curved")
    # A quarter ring in four pieces: chords for order 1, parabolas for order 2.
    tolerance = 6e-5 if ORDER[element] == 2 else 0.03
    quarter = np.pi / 4 * (1.5**2 - 1) * 0.5
    assert arch.weights.sum() == pytest.approx(quarter, rel=tolerance)
    outside = arch.surface("x+")
    assert outside.weights.sum() == pytest.approx(np.pi / 2 * 1.5 * 0.5, rel=tolerance)
    x = np.einsum("fqk,fki->fqi", outside.shapes, arch.nodes[outside.nodes])
    assert (np.einsum("fqi,fqi->fq", x * (1, 1, 0), outside.normals) > 1.3).all()


def test_surface_tangents_differentiate_along_right_handed_frames(body):
    surface = body.surface("y+")
    t1, t2 = surface.frames[:, :, 0], surface.frames[:, :, 1]
    np.testing.assert_allclose(np.cross(t1, t2), surface.normals, atol=1e-12)
    X = body.nodes[surface.nodes]
    found = np.einsum("fqkt,fki->fqti", surface.tangents, X)
    np.testing.assert_allclose(found, surface.frames, atol=1e-10)
    np.testing.assert_allclose(surface.shapes.sum(axis=2), 1, atol=1e-12)


def test_names_reach_nodes_cells_and_facets():
    mesh = box([0, 1, 2], [0, 1], [0, 1, 3], layers={"top": lambda X: X[:, 2] > 1},
               boundaries={"cap": lambda X: (X[:, 2] == 3) & (X[:, 0] < 1)})  # fmt: skip
    body = Body.build(mesh, "hex27")
    assert set(body.nodes_of("x+")) == set(body.nodes_where(lambda X: X[:, 0] == 2))
    assert body.weights[body.cells_of("top")].sum() == pytest.approx(4)
    assert body.surface("cap").weights.sum() == pytest.approx(1)
    assert body.surface(lambda X: X[:, 2] == 3).weights.sum() == pytest.approx(2)
    with pytest.raises(ValueError, match="no boundary 'lid'; there are: x-"):
        body.nodes_of("lid")
    with pytest.raises(ValueError, match="no boundary 'lid'"):
        body.surface("lid")
    with pytest.raises(ValueError, match="no sub-domain 'lid'; there are: top"):
        body.cells_of("lid")
    with pytest.raises(ValueError, match="no facet was chosen"):
        body.surface(lambda X: X[:, 2] > 5)


def test_node_graph_against_brute_force(body):
    graph, n = body.graph, len(body.nodes)
    dense = np.zeros((n, n), bool)
    for cell in body.cells:
        dense[np.ix_(cell, cell)] = True
    rows = np.repeat(np.arange(n), np.diff(graph.indptr))
    found = np.zeros((n, n), bool)
    found[rows, graph.indices] = True
    np.testing.assert_array_equal(found, dense)
    assert graph.blocks == dense.sum()
    at = body.positions
    k = body.cells.shape[1]
    np.testing.assert_array_equal(rows[at], np.repeat(body.cells[:, :, None], k, axis=2))
    np.testing.assert_array_equal(graph.indices[at], np.repeat(body.cells[:, None, :], k, axis=1))


def test_union_and_find_of_graphs():
    a = NodeGraph.of(5, np.array([[0, 1], [1, 2]]))
    b = NodeGraph.of(5, np.array([[2, 3, 4]]))
    both = NodeGraph.union([a, b])
    assert both.blocks == a.blocks + b.blocks - 5  # the diagonal is in each
    for part in (a, b):
        where = both.find(part)
        np.testing.assert_array_equal(both.indices[where], part.indices)
    missing = a.find(b) < 0
    np.testing.assert_array_equal(missing, [0, 0, 0, 1, 1, 1, 0, 1, 1, 1, 0])
    assert NodeGraph.union([a, both, b]) is both


@pytest.mark.parametrize("element", ["hex27", "hex20", "hex8"])
def test_curved_geometry_is_no_richer_than_the_element(element):
    body = build(element, "curved")
    assert isinstance(body.mesh, skfem.MeshHex2) == (element != "hex8")
    on_arc = np.isclose(np.hypot(*body.nodes[:, :2].T), 1.5, atol=1e-12)
    assert on_arc.sum() == len(body.nodes_of("x+"))


@pytest.mark.parametrize(
    "element, mesh, message",
    [
        ("hex64", skfem.MeshHex(), "no element 'hex64'; there are: hex27"),
        ("hex27", skfem.MeshTet(), "on a MeshTet1; expected a mesh of hexahedra"),
        ("tet4", skfem.MeshHex(), "on a MeshHex1; expected a mesh of tetrahedra"),
        ("hex8", skfem.MeshTri(), "on a MeshTri1; expected a mesh of hexahedra"),
    ],
)
def test_elements_that_do_not_fit_the_cells_are_refused(element, mesh, message):
    with pytest.raises(ValueError, match=message):
        Body.build(mesh, element)


@pytest.mark.parametrize("element, kind", [("hex27", skfem.MeshHex2), ("tet10", skfem.MeshTet2)])
def test_a_body_far_from_the_origin_is_the_same_body_or_refused(element, kind):
    straight = skfem.MeshHex1 if element == "hex27" else skfem.MeshTet1
    mesh = kind.from_mesh(straight.init_tensor(*(np.linspace(0, s, 3) for s in (1, 2, 0.1))))

    def top(far):
        body = Body.build(mesh.translated((far, -far, 0)), element)
        return body, body.surface(lambda X: X[:, 2] > 0.1 - 1e-6)

    near, face = top(0.0)
    for far in (1e6, 1e8):
        body, other = top(far)
        slack = 1e-14 * far
        np.testing.assert_allclose(body.weights, near.weights, rtol=slack)
        np.testing.assert_allclose(other.weights, face.weights, rtol=slack)
        np.testing.assert_allclose(other.normals, face.normals, atol=slack)
        np.testing.assert_allclose(other.shapes, face.shapes, atol=slack)
        np.testing.assert_allclose(other.tangents, face.tangents, atol=slack * 10)
        assert (other.nodes == face.nodes).all()
    with pytest.raises(ValueError, match=r"reaches 1e\+12 from the origin .* move it"):
        top(1e12)


def test_facets_of_cells_that_are_hardly_more_than_roundoff_close_the_body():
    lines = (np.array([0, 1, 1 + 1e-10]), np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    mesh = skfem.MeshHex1.init_tensor(*lines)
    bent = mesh.doflocs + 1e-11 * np.random.default_rng(0).normal(size=mesh.doflocs.shape)
    body = Body.build(skfem.MeshHex1(bent, mesh.t), "hex8", parts=True)
    surface = body.surface(body.mesh.boundary_facets())
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=-1), 1, rtol=1e-14)
    closed = np.einsum("fq,fqi->i", surface.weights, surface.normals)
    np.testing.assert_allclose(closed, 0, atol=1e-15)
    thin = surface.weights.sum(axis=1) < 1e-6
    assert thin.sum() == 4 and surface.weights[thin].sum() == pytest.approx(4e-10, rel=0.2)


@pytest.mark.parametrize("element", ["hex27", "hex20", "tet10"])
def test_a_quadratic_field_is_interpolated_exactly(element):
    # An L of cells that are up to a thousand times longer than thick.
    lines = np.array([0, 1e-3, 0.1, 0.4, 1]), np.array([0, 0.3, 1]), np.array([0, 1e-3, 3e-3])
    mesh = box(*lines, keep=lambda X: (X[:, 0] < 0.4) | (X[:, 2] < 1e-3), tets="tet" in element)
    body = Body.build(mesh, element)

    def field(X):
        x, y, z = X.T
        return 1 + x - 2 * y * y + x * y + 3e3 * x * z

    rng = np.random.default_rng(0)
    low = rng.uniform(0, 1, (300, 3)) * (1, 1, 1e-3)
    high = rng.uniform(0, 1, (300, 3)) * (0.4, 1, 3e-3)
    # On edges and faces of cells, inner and outer, and a rounding outside.
    there = np.concatenate([low, high, body.nodes, body.nodes * (1 + 1e-15) - 1e-17])
    M = body.interpolation(there)
    np.testing.assert_allclose(M @ field(body.nodes), field(there), atol=1e-11)
    for outside in ([0.5, 0.5, 2e-3], [0.2, 0.5, -1e-6], [1.1, 0.5, 0]):
        with pytest.raises(ValueError, match="outside of the body"):
            body.interpolation(np.array([[0.1, 0.1, 1e-4], outside]))
