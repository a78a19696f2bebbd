"""Shapes from files."""

import numpy as np
import pytest
from proofs import BODIES, state
from pytest import approx

from solver.fitting.files import read_shape
from solver.output import write_vtu


def test_a_vtu_tells_where_points_were_and_are(tmp_path):
    body = BODIES["hex20"]
    u = state(body)
    write_vtu(tmp_path / "a.vtu", body, u)
    was, now = read_shape(tmp_path / "a.vtu")
    assert was == approx(body.nodes) and now == approx(body.nodes + u)
    write_vtu(tmp_path / "b.vtu", body)
    assert read_shape(tmp_path / "b.vtu")[1] == approx(body.nodes)


def test_a_table_of_two_columns_is_a_section(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("z,y,cell\n1,2,a\n3,4,b\n")
    was, now = read_shape(path)
    assert now.tolist() == was.tolist() == [[0, 2, 1], [0, 4, 3]]
    path.write_text("z,x\n1,2\n")
    assert read_shape(path)[1].tolist() == [[2, 0, 1]]
    path.write_text("x,y,z\n1,2,3\n")
    assert read_shape(path)[1].tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "x\n1\n", "no column 'y'"),
        ("a.csv", "x,y\n1,two\n", "no table of numbers in row 0"),
        ("a.csv", "x,y\n1,inf\n", "all finite"),
        ("a.csv", "x,y,z\n", "has 0 points"),
        ("a.vtu", "<VTKFile/>", "damaged, or no VTU"),
        ("a.txt", "x,y\n", "ends in .csv or .vtu"),
    ],
)
def test_wrong_files_are_refused_in_a_sentence(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=message):
        read_shape(tmp_path / name)


def test_a_missing_file_and_another_displacement_are_told(tmp_path):
    with pytest.raises(ValueError, match="with the points of a shape"):
        read_shape(tmp_path / "none.csv")
    body = BODIES["hex8"]
    write_vtu(tmp_path / "a.vtu", body, point_data={"displacement": np.ones(len(body.nodes))})
    with pytest.raises(ValueError, match=r"displacement has shape"):
        read_shape(tmp_path / "a.vtu")
