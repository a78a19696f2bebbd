"""Solids read back: STEP by Gmsh, STL by trimesh, against sizes and the solver's own nodes."""

import io
from contextlib import contextmanager

import numpy as np
import pytest
import trimesh
from gmsh_mark import needs_gmsh
from made_units import UNITS

from foldlab.design import FULL, PATTERNED
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource
from foldlab.making import step, stl
from foldlab.making.folded import Folded, turned
from foldlab.making.geometry import Geometry

GROUPS = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.2, "hinge_width": 1.0, "h_ratio": 1.0,
    "stiffness_to_weight": 10.0, "aspect": 0.25, "slenderness": 0.01, "contraction": 0.2,
}  # fmt: skip
BENT = {
    "plain": (GROUPS, Geometry(100.0, 25.0, 1.0, 20.0, 25.0, 1.0)),
    "strips": (
        {**GROUPS, "hinge_width": 0.6, "strips": 3.0, "strip_share": 0.6},
        Geometry(100.0, 25.0, 1.0, 20.0, 15.0, 1.0, strips=3, strip_share=0.6),
    ),
}


@pytest.fixture(scope="module", params=BENT)
def folded(request):
    """A unit, the solver's run, and what the files are made from."""
    groups, unit = BENT[request.param]
    space = PATTERNED if "strips" in groups else FULL
    source = SolverSource(Conditions(effects="none"), Effort(0.05), space=space)
    run, _ = source.follow(groups)
    return unit, run, Folded.of(run, unit.length)


@contextmanager
def opened(path):
    """Gmsh with a STEP file; its module and the tags of the file's solids."""
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        shapes = gmsh.model.occ.importShapes(str(path))
        gmsh.model.occ.synchronize()
        assert all(dim == 3 for dim, _ in shapes)
        yield gmsh, [tag for _, tag in shapes]
    finally:
        gmsh.finalize()


def solid_of(gmsh, tag):
    """A triangle mesh of a solid's sides."""
    tags, X, _ = gmsh.model.mesh.getNodes()
    place = np.zeros(int(tags.max()) + 1, int)
    place[tags] = np.arange(len(tags))
    sides = [abs(t) for _, t in gmsh.model.getBoundary([(3, tag)])]
    rows = [place[gmsh.model.mesh.getElements(2, t)[2][0]].reshape(-1, 3) for t in sides]
    mesh = trimesh.Trimesh(np.reshape(X, (-1, 3)), np.vstack(rows))
    trimesh.repair.fix_normals(mesh)
    return mesh


def loaded(points, triangles, name):
    return trimesh.load(io.BytesIO(stl.stl(points, triangles, name)), file_type="stl")


def parts(unit):
    return {"passive": 1, "active": max(unit.strips, 1)}


@pytest.mark.parametrize("name", UNITS)
@needs_gmsh
def test_a_flat_step_file_holds_a_named_solid_per_part(name, tmp_path, capfd):
    unit = UNITS[name]
    step.write_flat(tmp_path / "flat.step", unit)
    assert capfd.readouterr().out == ""
    assert "SI_UNIT(.MILLI.,.METRE.)" in (tmp_path / "flat.step").read_text()
    with opened(tmp_path / "flat.step") as (gmsh, tags):
        names = [gmsh.model.getEntityName(3, tag).split("/")[-1] for tag in tags]
        strips = [f"active {k + 1}" for k in range(unit.strips)]
        assert names == ["passive", *(strips or ["active"])]
        volumes = [gmsh.model.occ.getMass(3, tag) for tag in tags]
        assert volumes[0] == pytest.approx(unit.volumes["passive"], rel=1e-6)
        assert sum(volumes[1:]) == pytest.approx(unit.volumes["active"], rel=1e-6)
        for tag, size in zip(tags, [None, *[unit.strip] * len(tags[1:])], strict=True):
            ends = gmsh.model.getBoundary([(3, tag)], recursive=True)
            corners = np.array([gmsh.model.getValue(0, end, []) for _, end in ends])
            low, high = corners.min(axis=0), corners.max(axis=0)
            if size is None:
                wanted = [unit.length, unit.width, unit.thickness]
            else:
                wanted = [unit.hinge_length, size, unit.active_thickness]
                assert low[2] == pytest.approx(unit.thickness, rel=1e-6)
            np.testing.assert_allclose(high - low, wanted, rtol=1e-6)


@pytest.mark.parametrize("name", UNITS)
def test_flat_stl_files_are_closed_and_of_the_right_size(name):
    unit = UNITS[name]
    for layer, wide in (("passive", unit.width), ("active", None)):
        mesh = loaded(*stl.flat(unit, layer), layer)
        assert mesh.is_watertight and mesh.is_winding_consistent
        assert mesh.body_count == parts(unit)[layer]
        assert mesh.volume == pytest.approx(unit.volumes[layer], rel=1e-6)
        if layer == "passive":
            assert mesh.extents == pytest.approx([unit.length, wide, unit.thickness], rel=1e-6)
        else:
            assert mesh.extents[0] == pytest.approx(unit.hinge_length, rel=1e-6)
            assert mesh.bounds[:, 2] - unit.thickness == pytest.approx(
                [0, unit.active_thickness], rel=1e-6, abs=1e-7
            )


def deformed_volume(run, layer):
    """∫ det F over a layer of the whole unit, in l_s³, by the solver's own quadrature."""
    shape = run.shapes[-1]
    model, body = shape.model, shape.model.body
    u = model.scene.displacement(shape.x, shape.state.e)
    F = np.eye(3) + np.einsum("mki,mqkj->mqij", u[body.cells], body.gradients)
    cells = body.cells_of(layer)
    return float((np.linalg.det(F) * body.weights)[cells].sum()) * 2 ** len(model.mirrors)


def test_folded_stl_files_are_the_solvers_surface(folded):
    unit, run, shape = folded
    for layer in ("passive", "active"):
        mesh = loaded(*shape.surface(layer), layer)
        assert mesh.is_watertight and mesh.is_winding_consistent
        assert mesh.body_count == parts(unit)[layer]
        volume = deformed_volume(run, layer) * unit.length**3
        assert mesh.volume == pytest.approx(volume, rel=2e-3)
    both = [loaded(*shape.surface(layer), layer).bounds for layer in ("passive", "active")]
    extremes = np.array([np.min(both, axis=0)[0], np.max(both, axis=0)[1]])
    nodes = shape.nodes
    np.testing.assert_allclose(
        extremes, [nodes.min(axis=0), nodes.max(axis=0)], atol=1e-6 * unit.length
    )
    # Ends up, along x, symmetric: the files' axes.
    tip = shape.middle[-1]
    assert tip[0] > 0.2 * unit.length and tip[2] > 0.2 * unit.length
    assert shape.middle[0] == pytest.approx(tip * (-1, 1, 1), abs=1e-6 * unit.length)


@needs_gmsh
def test_folded_step_solids_pass_through_the_solvers_nodes(folded, tmp_path, capfd):
    unit, run, shape = folded
    step.write_folded(tmp_path / "folded.step", unit, shape)
    assert capfd.readouterr().out == ""
    flat = np.asarray(shape.mesh.points)
    under = np.flatnonzero(np.abs(flat[:, 2]) < 1e-9)
    over = np.flatnonzero(np.abs(flat[:, 2] - unit.thickness - unit.active_thickness) < 1e-9)
    chosen = np.concatenate([under[::7], over[::7]])
    with opened(tmp_path / "folded.step") as (gmsh, tags):
        names = [gmsh.model.getEntityName(3, tag).split("/")[-1] for tag in tags]
        strips = [f"active {k + 1}" for k in range(unit.strips)]
        assert names == ["passive", *(strips or ["active"])]
        sides = [tag for _, tag in gmsh.model.getEntities(2)]
        off = np.full(len(chosen), np.inf)
        for side in sides:
            near, _ = gmsh.model.getClosestPoint(2, side, shape.nodes[chosen].ravel())
            gap = np.linalg.norm(np.reshape(near, (-1, 3)) - shape.nodes[chosen], axis=1)
            off = np.minimum(off, gap)
        assert len(chosen) > 30 and off.max() < 1e-6 * unit.length
        gmsh.option.setNumber("Mesh.MeshSizeMax", 1.0)
        gmsh.model.mesh.generate(2)
        solids = [solid_of(gmsh, tag) for tag in tags]
    assert all(solid.is_watertight for solid in solids)
    wanted = {k: deformed_volume(run, k) * unit.length**3 for k in ("passive", "active")}
    assert abs(solids[0].volume) == pytest.approx(wanted["passive"], rel=2e-3)
    active = sum(abs(solid.volume) for solid in solids[1:])
    assert active == pytest.approx(wanted["active"], rel=1e-2)


@needs_gmsh
def test_a_mesh_of_other_cells_makes_no_step_file(folded, tmp_path):
    unit, _, shape = folded
    other = Folded(shape.middle, shape.mesh.triangulate())
    with pytest.raises(ValueError, match="not of 27-node hexahedra"):
        step.write_folded(tmp_path / "folded.step", unit, other)
    assert not (tmp_path / "folded.step").exists()
    wrong = Geometry(100.0, 25.0, 1.0, 21.0, unit.hinge_width, 1.0)
    with pytest.raises(ValueError, match="no line at"):
        step.write_folded(tmp_path / "folded.step", wrong, shape)
    assert not (tmp_path / "folded.step").exists()


def test_the_files_axes_are_the_solvers_turned_not_mirrored():
    assert np.linalg.det(turned(np.eye(3))) == 1
    assert turned(np.array([1.0, 2.0, 3.0])).tolist() == [2, -1, 3]
