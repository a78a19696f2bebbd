"""VTU and PVD: cell types, order of nodes, fields, atomic and resumable series."""

import numpy as np
import pytest
import pyvista as pv
import skfem
from full_disk import no_room_beyond

from solver import output
from solver.mesh.body import ELEMENTS, Body
from solver.mesh.structured import box, polar
from solver.output import Series, cell_fields, grid, write_vtu
from solver.physics.elastic import Elastic
from solver.physics.growth import General, Orthotropic
from solver.physics.materials import NeoHookean

TYPES = {"hex27": 29, "hex20": 25, "hex8": 12, "tet10": 24, "tet4": 10}


def make(element, shape=None):
    layers = {"low": lambda X: X[:, 2] < 0.5, "high": lambda X: X[:, 2] > 0.5}
    x, y = np.linspace(1, 2, 3), np.linspace(0, 1, 4)
    mesh = box(x, y, [0, 0.5, 1], layers=layers, shape=shape, tets=element.startswith("tet"))
    return Body.build(mesh, element)


def quadratic(X):
    x, y, z = X.T
    return x * x - 2 * y * z + 0.5 * z * z + 3 * x - y * x


@pytest.mark.parametrize("element", ELEMENTS)
def test_vtu_keeps_type_order_and_fields(element, tmp_path):
    body = make(element)
    u = np.stack([quadratic(body.nodes), body.nodes[:, 0], body.nodes[:, 1] ** 2], -1) / 20
    m, q = body.weights.shape
    path = write_vtu(
        tmp_path / "a.vtu", body, u,
        point_data={"f": quadratic(body.nodes), "cap": body.nodes[:, 2] == 1},
        cell_data={"x": body.points()[..., 0], "F": np.tile(np.eye(3), (m, q, 1, 1)),
                   "id": np.arange(m)},
    )  # fmt: skip
    assert [p.name for p in tmp_path.iterdir()] == ["a.vtu"]
    seen = pv.read(path)
    assert set(seen.celltypes) == {TYPES[element]}
    centre = body.mesh.p[0][body.mesh.t].mean(axis=0)
    np.testing.assert_allclose(seen.points, body.nodes)
    np.testing.assert_allclose(seen.point_data["displacement"], u)
    np.testing.assert_array_equal(seen.point_data["cap"], body.nodes[:, 2] == 1)
    np.testing.assert_allclose(seen.cell_data["x"], centre, atol=1e-12)
    assert seen.cell_data["F"].shape == (m, 9)
    np.testing.assert_array_equal(seen.cell_data["id"], np.arange(m))
    assert list(seen.field_data["layer_names"]) == ["none", "low", "high"]
    high = seen.cell_data["layer"] == 2
    np.testing.assert_array_equal(high, body.cells_of("high"))
    assert set(seen.cell_data["layer"]) == {1, 2}
    # VTK's own interpolation, which reads the nodes in VTK's order.
    rng = np.random.default_rng(1)
    at = rng.uniform((1.01, 0.01, 0.01), (1.99, 0.99, 0.99), (200, 3))
    found = pv.PolyData(at).sample(seen)
    assert found["vtkValidPointMask"].all()
    if element in ("hex27", "hex20", "tet10"):
        # VTK finds the place in a cell by Newton steps, to about 1e-4.
        np.testing.assert_allclose(found["f"], quadratic(at), atol=1e-3)
    else:
        np.testing.assert_allclose(found["displacement"][:, 1], at[:, 0] / 20, atol=1e-9)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("mirrored", [False, True])
def test_displaced_volume_is_positive_and_right(element, mirrored):
    """Mirrored cells (which scikit-fem makes of tetrahedra) are turned right side out."""
    flip = np.array([1.0, 1.0, -1.0 if mirrored else 1.0])
    body = make(element, shape=lambda X: X * flip)
    A = np.array([[1.2, 0.3, 0.0], [0.0, 0.9, 0.1], [0.2, 0.0, 1.1]])
    u = body.nodes @ (A - np.eye(3)).T
    sizes = pv.wrap(grid(body, u)).warp_by_vector("displacement").compute_cell_sizes()["Volume"]
    np.testing.assert_allclose(sizes, np.linalg.det(A) * body.weights.sum(axis=1), rtol=1e-6)


@pytest.mark.parametrize("element", ["hex27", "tet10"])
def test_curved_cells_stay_curved(element, tmp_path):
    body = make(element, shape=polar)
    seen = pv.read(write_vtu(tmp_path / "arch.vtu", body))
    # Mid-side nodes follow the arc: the surface, cut fine, has the arc's radius everywhere.
    skin = seen.extract_surface(nonlinear_subdivision=3, algorithm="dataset_surface").points
    r = np.hypot(skin[:, 0], skin[:, 1])
    outside = r > 1.9
    assert outside.sum() > 50
    np.testing.assert_allclose(r[outside & (r > 1.99)], 2, rtol=2e-4)


def test_a_field_at_the_points_becomes_its_mean_over_the_cell():
    # Of y² over a cell from a to b: (a² + ab + b²)/3; Gauss's points have weights of their own.
    body = make("hex27")
    y = body.points()[..., 1]
    cells = pv.wrap(grid(body, cell_data={"yy": y**2, "row": np.stack([y, y**2], -1)})).cell_data
    ends = body.nodes[body.cells, 1]
    a, b = ends.min(axis=1), ends.max(axis=1)
    np.testing.assert_allclose(cells["yy"], (a * a + a * b + b * b) / 3, rtol=1e-12)
    np.testing.assert_allclose(cells["row"][:, 1], cells["yy"], rtol=1e-12)


def elastic(body, g=-0.2):
    active = body.cells_of("high")
    fg = Orthotropic((0.0, g, 0.0), cells=active)
    return [
        Elastic(body, NeoHookean(2.0, 0.3), cells=~active),
        Elastic(body, NeoHookean(5.0, 0.3), fg, cells=active),
    ]


@pytest.mark.parametrize("element", ELEMENTS)
def test_stress_growth_and_energy(element):
    body = make(element, shape=polar)
    terms = elastic(body)
    rng = np.random.default_rng(0)
    u = 0.01 * rng.normal(size=body.nodes.shape)
    fields = cell_fields(body, u, terms, 1.0)
    evaluated = [t.evaluate(u, 1.0, 1) for t in terms]
    # Σ w Jg ψ is the energy; Σ w J σ F⁻ᵀ ∇N is the force: the terms' own numbers.
    assert np.sum(body.weights * fields["energy density"]) == pytest.approx(
        sum(t.energy for t in evaluated), rel=1e-12
    )
    F, sigma = fields["F"], fields["cauchy"]
    P = np.linalg.det(F)[..., None, None] * sigma @ np.swapaxes(np.linalg.inv(F), 2, 3)
    np.testing.assert_allclose(fields["P"], P, atol=1e-12)
    nodal = np.einsum("mq,mqij,mqkj->mki", body.weights, P, body.gradients)
    force = np.zeros_like(u)
    np.add.at(force, body.cells, nodal)
    np.testing.assert_allclose(force, sum(t.force for t in evaluated), atol=1e-12)
    np.testing.assert_allclose(sigma, np.swapaxes(sigma, 2, 3), atol=1e-12)
    high = body.cells_of("high")
    np.testing.assert_allclose(
        fields["growth"][high], np.broadcast_to(np.diag([1, 0.8, 1]), F[high].shape), atol=1e-12
    )
    np.testing.assert_allclose(fields["growth"][~high], np.broadcast_to(np.eye(3), F[~high].shape))


def test_nominal_stress_of_terms_on_the_same_cells_with_skew_growth():
    body = make("hex8")
    Fg = np.eye(3) + np.random.default_rng(1).uniform(-0.2, 0.2, (3, 3))
    terms = [Elastic(body, NeoHookean(2.0, 0.3), General(Fg)), Elastic(body, NeoHookean(1.0, 0.2))]
    u = body.nodes @ np.random.default_rng(2).uniform(-0.2, 0.2, (3, 3))
    P = cell_fields(body, u, terms, 0.0)["P"]
    force = np.zeros_like(u)
    np.add.at(force, body.cells, np.einsum("mq,mqij,mqkj->mki", body.weights, P, body.gradients))
    np.testing.assert_allclose(force, sum(t.evaluate(u, 0.0).force for t in terms), atol=1e-12)


def test_free_growth_leaves_no_stress_in_the_file(tmp_path):
    body = make("hex27")
    A = np.diag([1.0, 0.8, 1.0])
    terms = [Elastic(body, NeoHookean(1.0, 0.3), Orthotropic((0.0, -0.2, 0.0)))]
    u = body.nodes @ (A - np.eye(3))
    seen = pv.read(
        write_vtu(tmp_path / "a.vtu", body, u, cell_data=cell_fields(body, u, terms, 1.0))
    )
    np.testing.assert_allclose(seen.cell_data["cauchy"], 0, atol=1e-13)
    np.testing.assert_allclose(
        seen.cell_data["F"], np.tile(A.ravel(), (len(body.cells), 1)), atol=1e-12
    )


def test_series_is_resumable_and_names_only_whole_files(tmp_path, monkeypatch):
    body = make("hex8")
    u = np.zeros_like(body.nodes)
    first = Series(tmp_path / "fold.pvd", body)
    for e in (0.0, 0.25):
        first.write(e, u + e)
    again = Series(tmp_path / "fold.pvd", body, resume=True)
    assert again.loads == [0.0, 0.25]
    again.write(0.1 + 0.2, u + 0.3, cell_data={"e": np.full(len(body.cells), 0.3)})
    again.write(0.25, u + 9, time=1)  # replaced, not doubled
    reader = pv.PVDReader(tmp_path / "fold.pvd")
    assert reader.time_values == [0.0, 1.0, 2.0]
    reader.set_active_time_value(1.0)
    np.testing.assert_allclose(reader.read()[0]["displacement"], 9)
    # A failure while writing leaves the series as it was.
    monkeypatch.setattr(output.os, "replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError, match="full"):
        again.write(0.5, u)
    monkeypatch.undo()
    assert Series(tmp_path / "fold.pvd", body, resume=True).loads == [0.0, 0.25, 0.1 + 0.2]
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "fold.pvd",
        "fold_00000.vtu",
        "fold_00001.vtu",
        "fold_00002.vtu",
    ]
    assert Series(tmp_path / "fold.pvd", body).loads == []


@pytest.mark.parametrize("times", [None, [0.0, 0.5, 1.2, 1.25, 2.0, 7.0]])
def test_states_keep_their_order_when_the_load_returns_or_snaps(times, tmp_path):
    """Sorted by load, a path that turned back came out shuffled, and a snap lost a state."""
    body = make("hex8")
    u = np.zeros_like(body.nodes)
    loads = [0.0, 0.6, 0.4, 0.4, 0.6, -0.1]
    series = Series(tmp_path / "snap.pvd", body)
    for k, e in enumerate(loads):
        if k == 3:
            series = Series(tmp_path / "snap.pvd", body, resume=True)
            assert series.loads == loads[:3]
        series.write(e, u + k, time=times and times[k])
    wanted = times or list(range(6))
    assert (series.loads, series.times) == (loads, wanted)
    reader = pv.PVDReader(tmp_path / "snap.pvd")
    assert reader.time_values == wanted
    for k, e in enumerate(loads):
        reader.set_active_time_point(k)
        state = reader.read()[0]
        assert state.field_data["load"] == [e]
        np.testing.assert_array_equal(state["displacement"], k)
    with pytest.raises(ValueError, match="give steps or lengths that grow"):
        series.write(0.3, u, time=1.1)
    with pytest.raises(ValueError, match="time = nan; expected one finite number"):
        series.write(0.3, u, time=np.nan)


def test_series_of_earlier_versions_go_on(tmp_path):
    body = make("hex8")
    path = tmp_path / "old.pvd"
    entry = '<DataSet timestep="{0}" part="0" file="old_{0}.vtu"/>'
    text = '<VTKFile type="Collection" version="0.1"><Collection>{}</Collection></VTKFile>'
    path.write_text(text.format(entry.format(0.0) + entry.format(0.7)))
    series = Series(path, body, resume=True)
    series.write(0.5, np.zeros_like(body.nodes))
    assert (series.times, series.loads) == ([0.0, 0.7, 1.0], [0.0, 0.7, 0.5])
    path.write_text(text.format(entry.format(0.7) + entry.format(0.0)))
    with pytest.raises(ValueError, match="its times do not grow"):
        Series(path, body, resume=True)


def test_overlapping_and_missing_layers():
    mesh = box([0, 1, 2, 3], [0, 1], [0, 1])
    body = Body.build(mesh.with_subdomains({"a": np.array([0, 1]), "b": np.array([1])}), "hex8")
    seen = pv.wrap(grid(body))
    np.testing.assert_array_equal(seen.cell_data["layer"], [1, 1, 0])
    bare = pv.wrap(grid(Body.build(skfem.MeshHex(), "hex8")))
    assert "layer" not in bare.cell_data


@pytest.mark.parametrize("room", [0, 900])
def test_a_vtu_without_room_is_an_error_and_no_lines_of_vtk(room, tmp_path, capfd):
    body = make("hex27")
    with no_room_beyond(room), pytest.raises(OSError, match=r"could not write .*a\.vtu"):
        write_vtu(tmp_path / "a.vtu", body, np.zeros_like(body.nodes))
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_output_refuses(tmp_path):
    body = make("hex8")
    n, m = len(body.nodes), len(body.cells)
    u = np.zeros((n, 3))
    (tmp_path / "bad.pvd").write_text("not xml")
    for call, message in (
        (lambda: write_vtu(tmp_path / "a.vtk", body), "ends in .vtu"),
        (lambda: write_vtu(tmp_path / "no" / "a.vtu", body), "there is no folder"),
        (lambda: write_vtu(tmp_path / "a.vtu", body, u[1:]), r"expected \(36, 3\)"),
        (lambda: grid(body, point_data={"f": u[1:]}), "point field 'f' has shape"),
        (lambda: grid(body, cell_data={"f": np.zeros(m + 1)}), "cell field 'f' has shape"),
        (lambda: Series(tmp_path / "a.vtu", body), "ends in .pvd"),
        (lambda: Series(tmp_path / "no" / "a.pvd", body), "there is no folder"),
        (lambda: Series(tmp_path / "bad.pvd", body, resume=True), "is no PVD series"),
        (lambda: Series(tmp_path / "a.pvd", body).write(np.nan, u), "e = nan; expected one finite"),
        (lambda: Series(tmp_path / "a.pvd", body).write(0, u, time="b"), "time is 'b'; expected"),
        (lambda: cell_fields(body, u, [], 0.0), "no Elastic term"),
        (lambda: cell_fields(body, -2 * body.nodes, elastic(body), 0.0), "does not admit"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    assert [p.name for p in tmp_path.iterdir()] == ["bad.pvd"]


def test_a_new_state_takes_a_name_that_no_other_has(tmp_path):
    body = make("hex8")
    u = np.zeros_like(body.nodes)
    entry = '<DataSet timestep="0.0" part="0" load="0.0" file="fold_00001.vtu"/>'
    text = f'<VTKFile type="Collection" version="0.1"><Collection>{entry}</Collection></VTKFile>'
    (tmp_path / "fold.pvd").write_text(text)
    series = Series(tmp_path / "fold.pvd", body, resume=True)
    assert series.write(0.5, u).name == "fold_00002.vtu"
    assert series.write(0.7, u).name == "fold_00003.vtu"
    assert series.loads == [0.0, 0.5, 0.7] and series.times == [0.0, 1.0, 2.0]
