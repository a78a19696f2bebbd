"""The cutter's DXF read back by ezdxf, and FOLD files held to the rules of their format."""

import io
import json

import ezdxf
import numpy as np
import pytest
from made_units import UNITS, bent

from foldlab.making.dxf import dxf
from foldlab.making.fold import fold


@pytest.mark.parametrize("name", UNITS)
def test_a_dxf_has_every_cut_once_in_millimetres(name):
    unit = UNITS[name]
    document = ezdxf.read(io.StringIO(dxf(unit)))
    assert document.units == ezdxf.units.MM and document.header["$INSUNITS"] == 4
    assert document.header["$MEASUREMENT"] == 1 and not document.audit().has_errors
    assert {"outline", "active", "strips"} <= {layer.dxf.name for layer in document.layers}
    lines = {layer: [] for layer in ("outline", "active", "strips")}
    for entity in document.modelspace():
        assert entity.dxftype() == "LWPOLYLINE" and entity.closed
        lines[entity.dxf.layer].append(np.array(entity.get_points("xy")))
    active = "strips" if unit.strips else "active"
    assert {k: len(v) for k, v in lines.items()} == {
        "outline": 1, "active": 0, "strips": 0, active: max(unit.strips, 1)
    }  # fmt: skip
    (outline,) = lines["outline"]
    assert np.ptp(outline, axis=0) == pytest.approx([unit.length, unit.width], rel=1e-9)
    inner = outline[np.abs(outline[:, 0]) < unit.length / 2 - 1e-9]
    if unit.hinge_width < unit.width:
        waist = inner[np.abs(inner[:, 1]) < unit.width / 2 - 1e-9]
        sizes = [unit.hinge_length, unit.hinge_width]
        assert np.ptp(waist, axis=0) == pytest.approx(sizes, rel=1e-9)
    for patch in lines[active]:
        assert np.ptp(patch, axis=0) == pytest.approx([unit.hinge_length, unit.strip], rel=1e-9)
    centres = np.array([p[:, 1].mean() for p in lines[active]])
    assert np.diff(centres) == pytest.approx(unit.pitch, rel=1e-9)
    assert centres.mean() == pytest.approx(0, abs=1e-9)


def frames_of(text):
    """Frames of a FOLD file, what they inherit filled in; refuses what the format forbids."""
    whole = json.loads(text)
    assert whole["file_spec"] == 1.2
    key = {k: v for k, v in whole.items() if not k.startswith("file_")}
    frames = [key]
    for own in whole.get("file_frames", []):
        assert own["frame_parent"] < len(frames) and not any(k.startswith("file_") for k in own)
        frames.append({**(frames[own["frame_parent"]] if own["frame_inherit"] else {}), **own})
    for frame in frames:
        n, edges = len(frame["vertices_coords"]), frame["edges_vertices"]
        assert all(0 <= v < n for edge in edges for v in edge)
        assert len({frozenset(e) for e in edges}) == len(edges) == len(frame["edges_assignment"])
        assert set(frame["edges_assignment"]) <= set("BMVFU")
        assert {v for face in frame["faces_vertices"] for v in face} == set(range(n))
        users = {frozenset(e): 0 for e in edges}
        for face in frame["faces_vertices"]:
            for a, b in zip(face, [*face[1:], face[0]], strict=True):
                users[frozenset((a, b))] += 1
        sides = [users[frozenset(e)] for e in edges]
        borders = [a == "B" for a in frame["edges_assignment"]]
        assert [s == 1 for s in sides] == borders and set(sides) <= {1, 2}
        for angle, how in zip(
            frame.get("edges_foldAngle", []), frame["edges_assignment"], strict=False
        ):
            assert -180 <= angle <= 180
            assert (angle > 0) == (how == "V") and (angle < 0) == (how == "M")
    return frames


def normal(points):
    """Unit normal of a plane polygon by Newell's sum."""
    sums = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    return sums / np.linalg.norm(sums)


@pytest.mark.parametrize("name", UNITS)
def test_fold_files_keep_the_rules_and_fold_without_stretching(name):
    unit = UNITS[name]
    flat, folded = frames_of(json.dumps(fold(unit, bent(unit, 2.0), "unit")))
    assert flat["frame_unit"] == folded["frame_unit"] == "mm"
    X = np.array(flat["vertices_coords"])
    assert X.shape[1] == 2
    assert np.ptp(X, axis=0) == pytest.approx([unit.length, unit.width], rel=1e-9)
    x = np.array(folded["vertices_coords"])
    edges = np.array(flat["edges_vertices"])
    lengths = np.linalg.norm(X[edges[:, 0]] - X[edges[:, 1]], axis=1)
    now = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
    np.testing.assert_allclose(now, lengths, rtol=1e-9)
    area = 0.0
    for face in flat["faces_vertices"]:
        a, b = X[face].T
        own = np.sum(a * np.roll(b, -1) - b * np.roll(a, -1)) / 2
        assert own > 0  # counterclockwise from above
        area += own
    assert area == pytest.approx(unit.areas["passive"], rel=1e-9)


@pytest.mark.parametrize("name", UNITS)
def test_creases_turn_by_the_angles_that_the_file_states(name):
    unit, total = UNITS[name], 2.0
    (_, folded) = frames_of(json.dumps(fold(unit, bent(unit, total))))
    x = np.array(folded["vertices_coords"])
    normals = [normal(x[face]) for face in folded["faces_vertices"]]
    turned = 0.0
    for edge, how, angle in zip(
        folded["edges_vertices"], folded["edges_assignment"], folded["edges_foldAngle"], strict=True
    ):
        faces = [k for k, f in enumerate(folded["faces_vertices"]) if set(edge) <= set(f)]
        if how == "B":
            assert len(faces) == 1 and angle == 0
            continue
        a, b = (normals[k] for k in faces)
        # A valley where the normals point into each other.
        middles = [x[folded["faces_vertices"][k]].mean(axis=0) for k in faces]
        sign = np.sign((a - b) @ (middles[1] - middles[0]))
        between = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
        assert angle == pytest.approx(sign * between, abs=1e-6)
        turned += angle
    # Facets' ends stand for a whole facet: the last ones lie half a facet within the hinge.
    assert turned == pytest.approx(np.degrees(total), abs=1e-3)
    assert folded["foldlab:departure"] < 0.01 * unit.length


def test_without_a_folded_shape_creases_are_unassigned():
    (frame,) = frames_of(json.dumps(fold(UNITS["plain"])))
    assert set(frame["edges_assignment"]) == {"B", "U"} and "edges_foldAngle" not in frame


def test_a_twisted_unit_has_no_folded_frame_and_says_why():
    unit = UNITS["plain"]
    middle = bent(unit, 1.0)
    straight = middle + np.linspace(-0.5, 0.5, len(middle))[:, None] * (0, 1, 0)
    assert len(frames_of(json.dumps(fold(unit, straight)))) == 2
    twisted = middle + np.linspace(-4, 4, len(middle))[:, None] * (0, 1, 0)
    (frame,) = frames_of(json.dumps(fold(unit, twisted)))
    assert "twists, its mid-line leaves its plane by 4 mm" in frame["frame_description"]
    assert "edges_foldAngle" not in frame
