"""Fields that people bring, as other programs write them."""

import numpy as np
import pytest
import pyvista as pv
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from solver.physics import patterns
from solver.physics.patterns import Pattern, read_pattern

X = np.random.default_rng(0).uniform(-1, 1, (40, 3)).round(6)
BETA = (X @ (0.1, 0.2, -0.3)).round(9)
AT = 0.5 * X[:5]


def lines(*, header="x,y,z,beta", row="{},{},{},{}"):
    rows = [row.format(*values) for values in np.column_stack([X, BETA]).tolist()]
    return "\n".join([header, *rows]) + "\n"


@pytest.mark.parametrize(
    "text",
    [
        lines(),
        lines(header='"x","y","z","beta"'),
        lines(header='"name","x","y","z","beta"', row='"a, b",{},{},{},{}'),
        lines(header="x,y,z,part,beta", row="{},{},{},skin,{}"),
        lines(header="x,y,z,beta,", row="{},{},{},{},"),
        lines(row="{},{},{},{},,"),
        lines(header="x, y, z, beta", row="{}, {}, {}, {}"),
        "\ufeff" + lines(header='"x","y","z","beta"').replace("\n", "\r\n"),
        lines().replace("\n", "\n\n"),
        lines(row='"{}","{}","{}","{}"'),
    ],
    ids=["plain", "quoted header", "text first", "text between", "trailing commas",
         "trailing commas in the rows", "blanks", "of Excel", "empty lines", "quoted numbers"],
)  # fmt: skip
@pytest.mark.parametrize("suffix", [".csv", ".CSV"])
def test_tables_of_other_programs_are_read(text, suffix, tmp_path):
    path = tmp_path / f"b{suffix}"
    path.write_text(text, encoding="utf-8", newline="")
    np.testing.assert_array_equal(read_pattern(path)(AT), Pattern(X, BETA)(AT))


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (lines(header="x,y,z,beta,beta", row="{},{},{},{},1"), "more than one column 'beta'"),
        (lines(row="{},{},{},{},1"), "in row 0: 5 cells below a header of 4"),
        (lines(row="{},{},{}"), "in row 0: list index out of range"),
        (lines(header="x,y,z,part", row="{},{},{},much").replace("part", "beta"), "'much'"),
        ("", "no column 'x'; there are: none"),
        (lines(row='{},{},{},"{}'), "in row 0: a quote that is not closed"),
        (lines()[:-1].rpartition(",")[0] + ',"1\n', "in row 39: a quote that is not closed"),
        ("x,y,z,beta\n", "has 0 points"),
        ("größe".encode("latin-1"), "is no table of text: .*utf-8"),
    ],
)
def test_tables_that_can_not_be_read_name_the_cause(text, cause, tmp_path):
    path = tmp_path / "b.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=cause):
        read_pattern(path)


def apart(grid):
    """The grid with nodes of its own for each cell, as many programs write it."""
    nodes = grid.cell_connectivity
    kinds = np.full(grid.n_cells, pv.CellType.HEXAHEDRON)
    cells = np.arange(len(nodes)).reshape(-1, 8)
    out = pv.UnstructuredGrid({kinds[0]: cells}, grid.points[nodes])
    out.point_data["beta"] = grid.point_data["beta"][nodes]
    return out


@pytest.fixture
def cube():
    grid = pv.ImageData(dimensions=(6, 6, 6), spacing=(0.2, 0.2, 0.2)).cast_to_unstructured_grid()
    grid = pv.UnstructuredGrid(
        {
            pv.CellType.HEXAHEDRON: grid.cell_connectivity.reshape(-1, 8)[
                :, [0, 1, 3, 2, 4, 5, 7, 6]
            ]
        },
        np.asarray(grid.points, float),
    )
    grid.point_data["beta"] = grid.points @ (0.1, 0.2, 0.3)
    return grid


def test_nodes_repeated_per_cell_are_one(cube, tmp_path):
    """Their distances of 0 made a reach of 0, so that the field covered nothing."""
    apart(cube).save(tmp_path / "b.vtu")
    pattern = read_pattern(tmp_path / "b.vtu")
    assert pattern.reach == pytest.approx(0.4)
    at = np.random.default_rng(1).uniform(0, 1, (50, 3))
    np.testing.assert_allclose(pattern(at), at @ (0.1, 0.2, 0.3), atol=1e-6)
    np.testing.assert_allclose(pattern([[1.05, 1.0, 1.0]]), 0.6, atol=1e-6)
    jump = Pattern(np.vstack([X, X[:1]]), np.append(BETA, BETA[0] + 1))
    assert jump(X[0]) == pytest.approx(BETA[0] + 0.5)


DAMAGED = r"b\.vtu is damaged, or no VTU \(.+\); write it again"


# Of an appended file that is nearly whole only the closing tag is missing.
@pytest.mark.parametrize(
    ("mode", "shares"),
    [
        ("Ascii", (0.0, 0.02, 0.3, 0.6, 0.9, 0.995)),
        ("Binary", (0.0, 0.02, 0.3, 0.6, 0.9, 0.995)),
        ("Appended", (0.0, 0.02, 0.3, 0.6, 0.9)),
    ],
)
def test_a_damaged_vtu_is_named_as_such(cube, mode, shares, tmp_path, capfd):
    path = tmp_path / "b.vtu"
    writer = vtkXMLUnstructuredGridWriter(file_name=str(path), input_data=cube)
    getattr(writer, f"SetDataModeTo{mode}")()
    writer.Write()
    whole = path.read_bytes()
    read_pattern(path)
    for share in shares:
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ValueError, match=DAMAGED):
            read_pattern(path)
    assert capfd.readouterr().err == ""


def test_damage_inside_a_vtu_is_named_as_such(cube, tmp_path):
    path = tmp_path / "b.vtu"
    cube.save(path)
    whole = path.read_bytes()
    at = whole.index(b"\n", whole.index(b'Name="beta"')) + 150  # in the field's packed numbers
    path.write_bytes(whole[:at] + b"0000" + whole[at + 4 :])
    with pytest.raises(ValueError, match=r"b\.vtu is damaged, or no VTU \(Zlib error"):
        read_pattern(path)


@pytest.mark.parametrize(
    ("stated", "cause"),
    [(-4, "a number of -4"), (215, "it has 215 points, and a cell with others")],
)
def test_a_vtu_with_a_wrong_number_of_points_is_damaged(cube, stated, cause, tmp_path):
    """Below 0 VTK ended the process; where there are fewer than written the rest was dropped."""
    path = tmp_path / "b.vtu"
    cube.save(path)
    whole = path.read_bytes()
    assert whole.count(b'NumberOfPoints="216"') == 1
    path.write_bytes(whole.replace(b'NumberOfPoints="216"', b'NumberOfPoints="%d"' % stated))
    with pytest.raises(ValueError, match=rf"b\.vtu is damaged, or no VTU \({cause}"):
        read_pattern(path)


def test_a_vtu_without_points_or_with_a_field_of_words_is_refused(cube, tmp_path):
    path = tmp_path / "b.vtu"
    piece = '<Piece NumberOfPoints="0" NumberOfCells="0"></Piece>'
    grid = f"<UnstructuredGrid>{piece}</UnstructuredGrid>"
    path.write_text(f'<VTKFile type="UnstructuredGrid">{grid}</VTKFile>')
    with pytest.raises(ValueError, match="it has no points"):
        read_pattern(path)
    cube.clear_data()
    cube.point_data["beta"] = np.full(cube.n_points, "much")
    cube.save(path)
    with pytest.raises(ValueError, match="no point field 'beta' of numbers; there are: none"):
        read_pattern(path)


def test_a_file_may_not_ask_for_more_than_its_limit(cube, tmp_path, monkeypatch):
    apart(cube).save(tmp_path / "b.vtu")
    (tmp_path / "b.csv").write_text("x,y,z,beta\n" + 9 * "0,0,0,1\n")
    monkeypatch.setattr(patterns, "MOST_POINTS", 3)
    with pytest.raises(ValueError, match=r"b\.vtu has more than 3 points or cells"):
        read_pattern(tmp_path / "b.vtu")
    monkeypatch.setattr(patterns, "MOST_BYTES", 50)
    for name in ("b.vtu", "b.csv"):
        with pytest.raises(ValueError, match=rf"{name} is larger than"):
            read_pattern(tmp_path / name)
