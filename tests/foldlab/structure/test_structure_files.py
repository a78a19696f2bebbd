"""Pattern files: what is read, what is refused, and what comes back."""

import json

import numpy as np
import pytest
from crease_patterns import folded, squares
from pytest import approx

from foldlab.errors import InputError
from foldlab.structure.files import SHIPPED, read_pattern, write_fold
from solver.cases.structure.pattern import area_of

UNIT = {
    "file_spec": 1.1,
    "frame_unit": "mm",
    "vertices_coords": [[0, 0], [50, 0], [100, 0], [100, 20], [50, 20], [0, 20]],
    "edges_vertices": [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 0], [1, 4]],
    "edges_assignment": ["B", "B", "B", "B", "B", "B", "V"],
}
CROSS = """<svg xmlns="http://www.w3.org/2000/svg" width="90mm" height="120mm" viewBox="0 0 90 120">
<path d="M30 0H60V30H90V60H60V120H30V60H0V30H30Z" fill="none" stroke="black"/>
<path d="M30 30H60M30 60H60M30 90H60" fill="none" stroke="blue"/>
<line x1="30" y1="30" x2="30" y2="60" stroke="#f00"/><line x1="60" y1="30" x2="60" y2="60"
stroke="rgb(0,0,255)"/></svg>"""


SHIPPED_PANELS = {"accordion": 5, "cube": 6, "gripper": 9, "miura": 4, "waterbomb": 8}


def written(folder, content, name="pattern.fold"):
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_fold_without_faces(tmp_path):
    pattern = read_pattern(written(tmp_path, UNIT)).pattern(0.01)
    assert pattern.extent == approx(0.1)
    assert [area_of(p) for p in pattern.panels] == approx([0.045 * 0.02] * 2)
    (hinge,) = pattern.hinges
    assert hinge.crease.fold == 1 and hinge.width == approx(0.02)
    assert (hinge.crease.start, hinge.crease.end) == (0.0, 1.0)


def test_fold_with_faces_places_in_space_and_words_of_its_own(tmp_path):
    more = {
        "vertices_coords": [[*place, 0.0] for place in UNIT["vertices_coords"]],
        "faces_vertices": [[0, 1, 4, 5], [1, 2, 3, 4]],
        "edges_assignment": [*"BBBBBB", "m"],
        "foldlab:edges_hingeLength": [None] * 6 + [4],
        "foldlab:edges_start": [None] * 6 + [0.25],
        "foldlab:edges_end": [None] * 6 + [0.5],
    }
    crease = read_pattern(written(tmp_path, UNIT | more)).pattern().hinges[0].crease
    assert (crease.fold, crease.start, crease.end) == (-1, 0.25, 0.5)
    assert crease.length == approx(0.004)


def test_a_size_beats_the_files_unit_and_is_needed_without_one(tmp_path):
    drawn = read_pattern(written(tmp_path, UNIT))
    assert drawn.pattern(0.01, size=0.2).extent == approx(0.2)
    inches = read_pattern(written(tmp_path, UNIT | {"frame_unit": "in"}))
    assert inches.pattern(0.01).extent == approx(2.54)
    bare = read_pattern(written(tmp_path, {k: v for k, v in UNIT.items() if k != "frame_unit"}))
    with pytest.raises(InputError, match="largest extent is 100; say --set size=100mm"):
        bare.pattern(0.01)


def test_svg_colours_and_size(tmp_path):
    pattern = read_pattern(written(tmp_path, CROSS, "net.svg")).pattern(0.005)
    assert pattern.extent == approx(0.12)
    assert len(pattern.panels) == 6
    folds = [h.crease.fold for h in pattern.hinges]
    assert sorted(folds) == [-1, 1, 1, 1, 1]
    # y points up on the sheet: the long arm, drawn downwards, lies lowest.
    x, y = pattern.vertices.T
    arm = np.sort(y[np.abs(x - x.min()) < 1e-9]) - y.min()
    assert arm == approx([0.06, 0.09])
    (mountain,) = [h for h in pattern.hinges if h.crease.fold == -1]
    assert mountain.sides[:, 0].mean() == approx(0.03)


def test_svg_lines_are_cut_where_they_meet(tmp_path):
    svg = """<svg xmlns="http://www.w3.org/2000/svg" width="100" height="100">
    <rect x="0" y="0" width="100" height="100" fill="none" stroke="#000"/>
    <path d="M0 50H100" stroke="red"/><path d="M50 0V100" stroke="blue"/></svg>"""
    pattern = read_pattern(written(tmp_path, svg, "x.svg")).pattern(0.001)
    assert len(pattern.panels) == 4
    assert sorted(h.crease.fold for h in pattern.hinges) == [-1, -1, 1, 1]
    assert pattern.extent == approx(100 * 0.0254 / 96)


@pytest.mark.parametrize(
    "change, says",
    [
        ({"edges_assignment": ["B"]}, "1 entries of edges_assignment for 7 edges"),
        ({"edges_assignment": [*"BBBBBB", "Q"]}, "edges_assignment 'Q'; expected M, V"),
        ({"edges_vertices": [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 0], [1, 9]]}, "vertex 9"),
        ({"vertices_coords": [[0, 0, 0], [1, 0, 1]]}, "not flat"),
        ({"vertices_coords": [[0], [1]]}, "two or three finite numbers"),
        ({"vertices_coords": "none"}, "no crease pattern"),
        ({"vertices_coords": None}, "no crease pattern"),
    ],
)
def test_what_is_no_fold_is_told(tmp_path, change, says):
    with pytest.raises(InputError, match=says):
        read_pattern(written(tmp_path, UNIT | change))


def test_files_that_are_none(tmp_path):
    for content, name, says in (
        ("{", "a.fold", "no crease pattern"),
        ("[]", "a.fold", "expected a JSON object"),
        ("{}", "a.fold", "no vertices_coords"),
        ("", "a.dxf", "ending '.dxf'; expected .fold, .json or .svg"),
        ("<svg/>", "a.svg", "no lines with a stroke"),
        (CROSS.replace("svg", "svh"), "a.svg", "root is no <svg>"),
        ("not xml", "a.svg", "no crease pattern|no lines"),
        (CROSS.replace("#f00", "magenta"), "a.svg", "the colour #ff00ff; expected red"),
        (CROSS.replace("M30 90H60", "M30 90C40 90 50 95 60 90"), "a.svg", "curved"),
    ):
        with pytest.raises(InputError, match=says):
            read_pattern(written(tmp_path, content, name))
    with pytest.raises(InputError, match="can't read the pattern"):
        read_pattern(tmp_path / "absent.fold")


@pytest.mark.parametrize(
    "change, says",
    [
        ({"edges_assignment": [*"BBBBBB", "F"]}, "no mountain and no valley"),
        (
            {
                "edges_vertices": [*UNIT["edges_vertices"], [0, 4]],
                "vertices_coords": [*UNIT["vertices_coords"][:4], [50, 20], [0, 20]],
                "edges_assignment": [*UNIT["edges_assignment"], "M"],
            },
            "no width|no panel|can't be folded",
        ),
        (
            {
                "edges_vertices": [*UNIT["edges_vertices"], [0, 3]],
                "edges_assignment": [*UNIT["edges_assignment"], "M"],
            },
            r"edges \[1, 4\] and \[0, 3\] cross|edges \[0, 3\] and \[1, 4\] cross",
        ),
        (
            {
                "vertices_coords": [*UNIT["vertices_coords"], [70, 10]],
                "edges_vertices": [*UNIT["edges_vertices"], [2, 6]],
                "edges_assignment": [*UNIT["edges_assignment"], "M"],
            },
            r"edge \[2, 6\] borders no face|edge \[6, 2\] borders no face",
        ),
    ],
)
def test_patterns_that_cannot_be_folded(tmp_path, change, says):
    drawn = read_pattern(written(tmp_path, UNIT | change))
    with pytest.raises(InputError, match=says):
        drawn.pattern(0.0399)


def test_a_hinge_length_is_needed(tmp_path):
    with pytest.raises(InputError, match="add --set l_i=10mm"):
        read_pattern(written(tmp_path, UNIT)).pattern()


@pytest.mark.parametrize("name, panels", SHIPPED_PANELS.items())
def test_shipped_patterns_are_read_by_name(name, panels):
    pattern = read_pattern(name).pattern(0.005)
    assert len(pattern.panels) == panels
    assert pattern.extent < 0.2


def test_all_shipped_patterns_are_known(tmp_path, monkeypatch):
    assert set(SHIPPED) == set(SHIPPED_PANELS)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        InputError, match=r"can't read the pattern boat.*shipped are accordion, cube"
    ):
        read_pattern("boat")


def test_large_files_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("foldlab.structure.files.MOST_BYTES", 10)
    with pytest.raises(InputError, match="larger than"):
        read_pattern(written(tmp_path, UNIT))
    monkeypatch.undo()
    monkeypatch.setattr("foldlab.structure.files.MOST_EDGES", 6)
    with pytest.raises(InputError, match="7 edges; at most 6"):
        read_pattern(written(tmp_path, UNIT))
    with pytest.raises(InputError, match="lines; at most 6"):
        read_pattern(written(tmp_path, CROSS, "net.svg"))


def test_folded_states_come_back_as_frames(tmp_path):
    folding = folded(squares([(0, 0), (1, 0)]), 1.0, effects=())
    write_fold(folding.model.structure.pattern, folding.states, tmp_path / "out.fold", "two")
    data = json.loads((tmp_path / "out.fold").read_text())
    assert len(data["file_frames"]) == len(folding.states) - 1
    last = data["file_frames"][-1]
    assert last["foldlab:hinge_angles"] == approx([np.degrees(1.0)], abs=0.01)
    places = np.array(last["vertices_coords"]) / 1e3
    np.testing.assert_allclose(places[:4], folding.last.panels[0], atol=1e-8)
    # Panels keep their sides, and each strip has its hinge's width.
    for face in data["faces_vertices"]:
        flat, bent = (np.array(f["vertices_coords"])[face] for f in (data, last))
        sides = [np.linalg.norm(np.roll(p, -1, axis=0) - p, axis=1) for p in (flat, bent)]
        if face is not data["faces_vertices"][-1]:
            np.testing.assert_allclose(*sides, rtol=1e-3)
        else:
            assert sides[1][0] == approx(1000.0, rel=1e-3)
