"""Gmsh: geometry, names, both orders, and the round trip through a file."""

import builtins

import numpy as np
import pytest
from gmsh_mark import needs_gmsh

from solver.cases.unit import model as folding_unit
from solver.cases.unit.choices import Meshing, Physics, Supports
from solver.cases.unit.path import fold
from solver.mesh.body import Body
from solver.mesh.gmsh_import import load_gmsh, read, session
from solver.mesh.gmsh_model import Model
from solver.mesh.quality import quality

H, L = 0.1, 0.5  # thickness of the passive and the active layer


def unit(model):
    """Hinge of two layers, 2 × 1, and a panel that goes on from the passive one, as §4.3.1."""
    contact = model.polygon([(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)])
    passive = model.extrude(contact, (0, 0, -H))
    active = model.extrude(contact, (0, 0, L))
    panel = model.extrude(passive.sides[1], (2, 0, 0))
    model.subdomain("passive", [passive.volume, panel.volume])
    model.subdomain("active", [active.volume])
    model.boundary("top", [active.end])
    model.boundary("contact", [contact])
    model.boundary("end", lambda X: X[:, 0] > 3.9)


def right(mesh, element):
    """Volumes, faces, and a quadratic field's gradient, which sees any node out of place."""
    body = Body.build(mesh, element)
    assert body.weights[body.cells_of("passive")].sum() == pytest.approx(4 * H, rel=1e-10)
    assert body.weights[body.cells_of("active")].sum() == pytest.approx(2 * L, rel=1e-10)
    for name, area in (("top", 2), ("contact", 2), ("end", H)):
        assert body.surface(name).weights.sum() == pytest.approx(area, rel=1e-10)
    np.testing.assert_allclose(body.surface("top").normals[..., 2], 1, atol=1e-9)
    np.testing.assert_allclose(body.nodes[body.nodes_of("end"), 0], 4, atol=1e-9)
    if element in ("hex27", "hex20", "tet10"):
        d = np.array([1.0, -0.5, 2.0])
        found = np.einsum("mqki,mk->mqi", body.gradients, ((body.nodes @ d) ** 2)[body.cells])
        wanted = 2 * (body.points() @ d)[..., None] * d
        np.testing.assert_allclose(found, wanted, atol=1e-6)  # Gmsh places nodes to about 1e-8
    return body


@needs_gmsh
@pytest.mark.parametrize("order, element", [(1, "tet4"), (2, "tet10")])
def test_tetrahedra_graded_by_thickness(order, element, tmp_path):
    with Model() as model:
        unit(model)
        mesh = model.tetrahedra(1.0, {"passive": H, "active": L}, order=order)
        model.write(tmp_path / "unit.msh")
    body = right(mesh, element)
    # Size c·h: the passive layer's cells are about H long, the active one's grow away from it.
    X = body.nodes[body.cells[:, :4]]
    size = np.linalg.norm(X[:, 0] - X[:, 1], axis=1)
    assert np.median(size[body.cells_of("passive")]) == pytest.approx(H, rel=0.4)
    assert size[body.cells_of("active")].max() > 3 * H
    assert quality(body).scaled_jacobian[0] > 0.05  # no slivers
    again = read(tmp_path / "unit.msh")
    np.testing.assert_allclose(right(again, element).nodes, body.nodes, atol=1e-12)
    assert again.t.shape == mesh.t.shape


@needs_gmsh
@pytest.mark.parametrize("order, element", [(1, "hex8"), (2, "hex20"), (2, "hex27")])
def test_transfinite_hexahedra(order, element, tmp_path):
    with Model() as model:
        unit(model)
        model.divide(4, lambda X, d: abs(d[0]) > 0.9, ratio=8, toward=(2, 0, 0))
        model.divide(3, lambda X, d: abs(d[1]) > 0.9)
        model.divide(2, lambda X, d: abs(d[2]) > 0.9)
        mesh = model.hexahedra(order)
        model.write(tmp_path / "unit.msh")
    body = right(mesh, element)
    assert len(body.cells) == 3 * 4 * 3 * 2
    x = np.unique(body.mesh.p[0, : body.mesh.nvertices].round(6))
    steps = np.diff(x)
    assert steps[3] == pytest.approx(steps[4], rel=1e-3)
    assert steps[0] / steps[3] == pytest.approx(8, rel=1e-3)
    right(read(tmp_path / "unit.msh"), element)


@needs_gmsh
@pytest.mark.parametrize("version", [2.2, 4.1])
def test_a_volume_in_two_groups_has_its_cells_once(version, tmp_path):
    """Format 2.2 writes them once for each group: the body weighed twice what it should."""
    with Model() as model:
        unit(model)
        volumes = [v for tags in model._volumes.values() for v in tags]
        model.subdomain("all", volumes)
        mesh = model.tetrahedra(1.0, {"passive": H, "active": L}, order=2)
        load_gmsh().option.setNumber("Mesh.MshFileVersion", version)
        model.write(tmp_path / "unit.msh")
        load_gmsh().option.setNumber("Mesh.MshFileVersion", 4.1)
    again = read(tmp_path / "unit.msh")
    assert again.t.shape == mesh.t.shape
    body = right(again, "tet10")
    assert body.weights.sum() == pytest.approx(4 * H + 2 * L, rel=1e-10)
    assert body.cells_of("all").all()


@needs_gmsh
def test_groups_without_a_name_are_called_by_their_number(tmp_path):
    with session("boxes") as gmsh:
        first, second = (
            gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1),
            gmsh.model.occ.addBox(1, 0, 0, 1, 1, 2),
        )
        gmsh.model.occ.fragment([(3, first)], [(3, second)])
        gmsh.model.occ.synchronize()
        (low,) = gmsh.model.getEntitiesInBoundingBox(-0.1, -0.1, -0.1, 0.1, 1.1, 1.1, 2)
        for dim, entities, tag in ((3, [first], 7), (3, [second], 9), (2, [low[1]], 4)):
            gmsh.model.addPhysicalGroup(dim, entities, tag)
        gmsh.model.setPhysicalName(3, 9, "tall")
        gmsh.model.mesh.generate(3)
        gmsh.write(str(tmp_path / "boxes.msh"))
    body = Body.build(read(tmp_path / "boxes.msh"), "tet4")
    assert set(body.mesh.subdomains) == {"7", "tall"} and set(body.mesh.boundaries) == {"4"}
    for name, volume in (("7", 1.0), ("tall", 2.0)):
        assert body.weights[body.cells_of(name)].sum() == pytest.approx(volume)
    assert body.surface("4").weights.sum() == pytest.approx(1.0)


@needs_gmsh
def test_reading_a_file_leaves_the_callers_own_session_and_model(tmp_path):
    with Model() as model:
        unit(model)
        model.tetrahedra(1.0, {"passive": H, "active": L}, order=1)
        model.write(tmp_path / "unit.msh")
    gmsh = load_gmsh()
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.model.add("the caller's")
        assert read(tmp_path / "unit.msh").t.shape[1] > 0
        assert gmsh.isInitialized()
        assert gmsh.model.getCurrent() == "the caller's" and "read" not in gmsh.model.list()
    finally:
        if gmsh.isInitialized():
            gmsh.finalize()


@needs_gmsh
def test_serendipity_file(tmp_path):
    """A .msh of 20-node hexahedra gets its face and centre nodes by their shape functions."""
    with Model() as model:
        unit(model)
        model.divide(2, lambda X, d: True)
        model.hexahedra(2)
        gmsh = load_gmsh()
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 1)
        gmsh.model.mesh.setOrder(1)
        gmsh.model.mesh.setOrder(2)
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0)
        assert list(gmsh.model.mesh.getElementTypes(3)) == [17]
        model.write(tmp_path / "unit.msh")
    right(read(tmp_path / "unit.msh"), "hex20")
    right(read(tmp_path / "unit.msh"), "hex27")


@needs_gmsh
@pytest.mark.parametrize("element", ["tet10", "hex27"])
def test_points_to_volumes_with_arcs(element):
    """A quarter ring from points, arcs and loops; second-order cells follow the arc."""
    with Model() as model:
        o, a, b, c, d = (
            model.point(*p) for p in ((0, 0, 0), (1, 0, 0), (1.5, 0, 0), (0, 1.5, 0), (0, 1, 0))
        )
        around = [model.line(a, b), model.arc(b, o, c), model.line(c, d), model.arc(d, o, a)]
        ring = model.extrude(model.surface(model.loop(around)), (0, 0, 0.5))
        model.subdomain("ring", [ring.volume])
        model.boundary("outside", [ring.sides[1]])
        if element == "tet10":
            mesh = model.tetrahedra(0.5, {"ring": 0.5}, order=2)
        else:
            model.divide(2, lambda X, d: abs(d[2]) > 0.9 or np.hypot(*X[:2]) in (1.25,))
            model.divide(4, lambda X, d: abs(d[2]) < 0.9 and abs(d[0] * d[1]) > 0.1)
            mesh = model.hexahedra(2)
    body = Body.build(mesh, element)
    assert body.weights.sum() == pytest.approx(np.pi / 4 * 1.25 * 0.5, rel=2e-4)
    assert body.surface("outside").weights.sum() == pytest.approx(np.pi / 2 * 1.5 * 0.5, rel=2e-4)
    r = np.hypot(*body.nodes[body.nodes_of("outside"), :2].T)
    if element == "tet10":
        np.testing.assert_allclose(r, 1.5, atol=1e-6)


@needs_gmsh
def test_a_narrow_hinge_needs_glue_and_a_hole_is_left_out():
    """A volume on part of another's face: separate parts until glued, and names follow."""
    for glued in (False, True):
        with Model() as model:
            wide = model.polygon(
                [(0, 0, 0), (3, 0, 0), (3, 2, 0), (0, 2, 0)],
                holes=[[(0.2, 0.2, 0), (0.6, 0.2, 0), (0.6, 0.7, 0)]],
            )
            base = model.extrude(wide, (0, 0, -0.5))
            small = model.polygon([(1, 0.5, 0), (2, 0.5, 0), (2, 1.5, 0), (1, 1.5, 0)])
            top = model.extrude(small, (0, 0, 0.4))
            model.subdomain("base", [base.volume])
            model.subdomain("top", [top.volume])
            model.boundary("lid", [top.end])
            model.boundary("floor", lambda X: X[:, 2] < -0.49)
            if glued:
                model.glue()
            mesh = model.tetrahedra(1.0, {"base": 0.5, "top": 0.4})
        if not glued:
            with pytest.raises(ValueError, match="2 parts that share no facet"):
                Body.build(mesh, "tet4")
            continue
        body = Body.build(mesh, "tet4")
        assert body.weights[body.cells_of("base")].sum() == pytest.approx((6 - 0.1) / 2)
        assert body.weights[body.cells_of("top")].sum() == pytest.approx(0.4)
        assert body.surface("lid").weights.sum() == pytest.approx(1)
        assert body.surface("floor").weights.sum() == pytest.approx(5.9)


@needs_gmsh
def test_revolved_and_closed_volumes():
    with Model() as model:
        face = model.polygon([(1, 0, 0), (1.2, 0, 0), (1.2, 0, 0.5), (1, 0, 0.5)])
        sector = model.revolve(face, (0, 0, 0), (0, 0, 1), np.pi / 3)
        model.subdomain("sector", [sector.volume])
        mesh = model.tetrahedra(1.0, {"sector": 0.2}, order=2)
    assert Body.build(mesh, "tet10").weights.sum() == pytest.approx(
        np.pi / 6 * 0.44 * 0.5, rel=1e-4
    )
    with Model() as model:
        p = [model.point(*x) for x in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))]
        e = {(i, j): model.line(p[i], p[j]) for i in range(4) for j in range(i + 1, 4)}
        faces = [
            model.surface(model.loop([e[i, j], e[j, k], e[i, k]]))
            for i, j, k in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
        ]
        model.subdomain("corner", [model.volume(faces)])
        mesh = model.tetrahedra(1.0, {"corner": 0.5})
    assert Body.build(mesh, "tet4").weights.sum() == pytest.approx(1 / 6)


@needs_gmsh
def test_models_that_are_refused(tmp_path):
    def tetra(**thickness):
        return lambda m: m.tetrahedra(1.0, thickness)

    for work, message in (
        (lambda m: m.hexahedra(), "28 curves were not divided, the first around"),
        (lambda m: m.divide(2, lambda X, d: False), "no curve was chosen"),
        (lambda m: m.divide(0, lambda X, d: True), "n = 0"),
        (lambda m: m.divide(3, lambda X, d: True, ratio=2), "a point toward which"),
        (tetra(passive=H), "1 volumes have no thickness"),
        (tetra(passive=H, active=-1), "expected positive numbers"),
        (tetra(passive=H, active=L, lid=1), "no sub-domain lid"),
        (lambda m: m.tetrahedra(1.0, {"passive": H, "active": L}, order=3), "order = 3"),
        (
            lambda m: (m.boundary("no", lambda X: X[:, 0] > 9), tetra(passive=H, active=L)(m)),
            "boundary 'no' is empty",
        ),
        (lambda m: m.line(1, 9999), "Gmsh refused"),
    ):
        with Model() as model:
            unit(model)
            with pytest.raises(ValueError, match=message):
                work(model)
    with Model() as model:  # nothing meshed
        model.write(tmp_path / "empty.msh")
    with pytest.raises(ValueError, match="volume elements in the Gmsh model: none"):
        read(tmp_path / "empty.msh")
    with pytest.raises(ValueError, match="there is no file"):
        read(tmp_path / "gone.msh")
    (tmp_path / "text.msh").write_text("$MeshFormat\nnonsense\n")
    with pytest.raises(ValueError, match=r"Gmsh refused|none"):
        read(tmp_path / "text.msh")


def test_a_missing_gmsh_says_what_to_install(monkeypatch):
    real = builtins.__import__

    def fails(name, *given, **named):
        if name == "gmsh":
            raise OSError("libGLU.so.1: cannot open shared object file")
        return real(name, *given, **named)

    monkeypatch.setattr(builtins, "__import__", fails)
    with pytest.raises(ImportError, match=r"libGLU.so.1.*pip install 'foldlab\[gmsh\]'.*libglu1"):
        load_gmsh()


@needs_gmsh
def test_a_folding_unit_of_graded_tetrahedra_folds_like_that_of_hexahedra():
    given = {
        "E_ratio": 0.5, "rho_ratio": 1.0, "hinge_length": 0.3, "hinge_width": 0.6, "h_ratio": 1.0,
        "stiffness_to_weight": 50.0, "aspect": 0.3, "slenderness": 0.03, "contraction": 0.1,
    }  # fmt: skip
    unit = folding_unit.Unit(**given)
    turned = []
    for meshing in (Meshing(1), Meshing(grading=1.5, element="tet10")):
        model = folding_unit.build(unit, meshing, Physics(()))
        layers = [model.body.weights[model.body.cells_of(k)].sum() for k in ("passive", "active")]
        assert layers == pytest.approx([0.03 * (0.7 * 0.3 + 0.3 * 0.18) / 4, 0.03 * 0.3 * 0.18 / 4])
        curve = fold(model).last.curves[0]
        ends = np.diff(curve, axis=0)[[0, -1]]
        turned.append(np.diff(np.arctan2(ends[:, 2], ends[:, 1])).item())
    assert turned[1] == pytest.approx(turned[0], rel=0.03)
    with pytest.raises(ValueError, match="give one of the whole unit"):
        model.widened(("y",), np.zeros(model.scene.size), 0.0)
    whole = folding_unit.build(
        unit, Meshing(grading=2.0, element="tet4"), Physics(()), Supports(())
    )
    assert whole.body.weights.sum() == pytest.approx(4 * sum(layers))
    with pytest.raises(ValueError, match="hexahedra only"):
        folding_unit.build(
            folding_unit.Unit(**given, strips=2), Meshing(grading=2.0, element="tet4")
        )
