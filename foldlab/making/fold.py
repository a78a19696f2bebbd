"""Creases as FOLD 1.2 (https://github.com/edemaine/fold): the flat sheet and its folded form.

FOLD knows rigid facets and straight creases. A hinge bends, so it is cut into facets across, as are
the panels, which sag; each facet turns as the solver's mid-line between its ends does. Lengths are
the flat ones, so the folded frame is an isometry of the flat one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from foldlab.making.geometry import Geometry

HINGE, PANEL = 12, 4  # facets of the hinge and of each panel
FLAT = 1e-6  # degrees below which a crease is flat
PLANE = 0.02  # of the length: a mid-line that leaves its plane by more is twisted


def fold(unit: Geometry, middle: np.ndarray | None = None, title: str = "") -> dict[str, Any]:
    """A FOLD file's content, lengths in mm.

    ``middle`` (n, 3): the folded sheet's mid-line, evenly spaced along the flat one, in mm. Without
    it, and where it is twisted, which creases side by side cannot be, the creases are unassigned
    and there is no folded frame. With it the key ``foldlab:departure`` of the folded frame says how
    far facets' ends are from the mid-line, mm.
    """
    half, hinge = unit.length / 2, unit.hinge_length / 2
    stations = np.concatenate(
        [
            np.linspace(-half, -hinge, PANEL + 1)[:-1],
            np.linspace(-hinge, hinge, HINGE + 1)[:-1],
            np.linspace(hinge, half, PANEL + 1),
        ]
    )
    vertices, faces = unit.facets(stations[1:-1])
    edges, owners = _edges(faces)
    crossing = np.array([len(faces) == 2 for faces in owners])
    out: dict[str, Any] = {
        "file_spec": 1.2,
        "file_creator": "foldlab",
        "file_classes": ["singleModel"],
        "frame_title": f"{title}, flat" if title else "flat",
        "frame_classes": ["creasePattern"],
        "frame_attributes": ["2D", "manifold", "orientable"],
        "frame_unit": "mm",
        "vertices_coords": vertices.tolist(),
        "edges_vertices": edges,
        "edges_assignment": ["U" if c else "B" for c in crossing],
        "faces_vertices": faces,
    }
    if middle is None:
        return out
    if (off := float(np.abs(middle[:, 1]).max())) > PLANE * unit.length:
        out["frame_description"] = (
            f"no folded form: the unit twists, its mid-line leaves its plane by {off:.3g} mm, and "
            "rigid facets between parallel creases cannot"
        )
        return out
    places, angles, departure = _turned(stations, middle)
    # Creases lie at stations; vertices stand in columns over them.
    at = np.abs(vertices[:, :1] - stations).argmin(axis=1)
    turn = np.concatenate([[0.0], np.degrees(np.diff(angles)), [0.0]])
    turn[np.abs(turn) < FLAT] = 0.0
    turns = [float(turn[at[a]]) if c else 0.0 for (a, _), c in zip(edges, crossing, strict=True)]
    out["edges_foldAngle"] = turns
    out["edges_assignment"] = [
        ("V" if t > 0 else "M" if t < 0 else "F") if c else "B"
        for t, c in zip(turns, crossing, strict=True)
    ]
    x, z = places[at].T
    out["file_frames"] = [
        {
            "frame_parent": 0,
            "frame_inherit": True,
            "frame_title": f"{title}, folded" if title else "folded",
            "frame_classes": ["foldedForm"],
            "frame_attributes": ["3D", "manifold", "orientable"],
            "frame_description": "rigid facets that turn as the solver's mid-line does",
            "vertices_coords": np.column_stack([x, vertices[:, 1], z]).tolist(),
            "foldlab:departure": departure,
        }
    ]
    return out


def _edges(faces: list[list[int]]) -> tuple[list[list[int]], list[list[int]]]:
    """Edges as pairs of vertices, in the order in which the faces have them; faces of each."""
    owners: dict[tuple[int, int], list[int]] = {}
    for k, face in enumerate(faces):
        for a, b in zip(face, [*face[1:], face[0]], strict=True):
            owners.setdefault((min(a, b), max(a, b)), []).append(k)
    return [list(edge) for edge in owners], list(owners.values())


def _turned(stations: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Places (x, z) of the stations, angle of each facet (rad), largest distance from the line."""
    flat = np.linspace(stations[0], stations[-1], len(middle))
    line = np.column_stack([np.interp(stations, flat, column) for column in middle.T])
    chord = np.diff(line[:, [0, 2]], axis=0)
    angles = np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
    along = np.diff(stations)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    places = np.vstack([np.zeros(2), np.cumsum(along, axis=0)])
    centre = len(stations) // 2
    places += line[centre, [0, 2]] - places[centre]
    off = np.column_stack([places[:, 0], 0 * places[:, 0], places[:, 1]]) - line
    return places, angles, float(np.linalg.norm(off, axis=1).max())
