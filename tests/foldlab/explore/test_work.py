"""What the page gets of a path is the solver's: its verdict, its shapes, its strains."""

import base64
import json
import math

import numpy as np
import pytest

from foldlab.explore.live import FIRST
from foldlab.explore.work import Desk
from foldlab.terminal import plain
from foldlab.unit.told import in_degrees


@pytest.fixture(scope="module")
def solved():
    said = []
    desk = Desk(said.append)
    answer = desk.do("solve", {"design": FIRST, "accuracy": 0.2, "seconds": 120})
    return desk, answer, said


def array(text, kind="<f4"):
    return np.frombuffer(base64.b64decode(text), kind)


def test_the_answer_is_the_labels(solved):
    desk, answer, said = solved
    label = desk.last[3]
    assert answer["foldable"] is label.foldable is True and answer["reason"] == in_degrees(
        label.reason
    )
    assert "°" in answer["reason"] and " rad" not in answer["reason"]
    assert answer["fold_angle"] == label.evidence["fold_angle"] > answer["need"]
    assert 0 < answer["error_m1"] < 0.2 and answer["core_seconds"] > 0
    assert answer["contact"] is True and answer["touches"] is False
    assert answer["strain"]["passive"]["says"] == "bears it" and answer["length"] == 0.04
    assert {event["kind"] for event in answer["events"]} >= {"lift-off"}
    assert said == ["solving", "drawing"]
    json.dumps(plain(answer), allow_nan=False)


def test_the_frames_are_closed_surfaces_of_the_whole_unit(solved):
    desk, answer, _ = solved
    history = desk.last[2].history
    assert [f["m1"] for f in answer["frames"]] == [row["m1"] for row in history]
    groups = desk.last[0].groups
    for frame in (answer["frames"][0], answer["frames"][-1]):
        for name, layer in frame["layers"].items():
            points = array(layer["points"]).reshape(-1, 3)
            triangles = array(layer["triangles"], "<i4").reshape(-1, 3)
            assert len(array(layer["strain"])) == len(triangles)
            sides = np.sort(np.vstack([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
            assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all(), name
            # Of the whole unit: as far to one side of its middle as to the other.
            low, high = points.min(axis=0), points.max(axis=0)
            assert low[:2] == pytest.approx(-high[:2], abs=1e-3)
            width = groups["aspect"] * (groups["hinge_width"] if name == "active" else 1)
            assert high[0] - low[0] == pytest.approx(width, rel=0.05)


def test_the_last_frame_is_turned_by_the_fold_angle_and_the_first_lies_flat(solved):
    _, answer, _ = solved
    for frame, angle in ((answer["frames"][0], 0.0), (answer["frames"][-1], answer["fold_angle"])):
        points = array(frame["layers"]["passive"]["points"]).reshape(-1, 3)
        # Both edges of a panel, which is straight but for its weight.
        end = points[points[:, 1] > points[:, 1].max() - 1e-4].mean(axis=0)
        along = points[np.abs(points[:, 1] - 0.7 * points[:, 1].max()) < 0.03].mean(axis=0)
        slope = math.atan2(end[2] - along[2], end[1] - along[1])
        assert 2 * slope == pytest.approx(angle, abs=0.06)


def test_the_active_layer_is_strained_the_most(solved):
    _, answer, _ = solved
    layers = answer["frames"][-1]["layers"]
    most = {name: array(layer["strain"]).max() for name, layer in layers.items()}
    peaks = {name: row["peak"] for name, row in answer["strain"].items()}
    assert most["active"] == pytest.approx(peaks["active"], rel=0.3)
    assert most["passive"] < 0.1 * most["active"]
    assert array(answer["frames"][0]["layers"]["active"]["strain"]).max() < 1e-3
