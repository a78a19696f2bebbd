"""The shapes of a unit's path as triangles for the page, coloured by strain."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.explore.live import packed
from foldlab.unit.render import principal

if TYPE_CHECKING:
    from foldlab.labels.run import Run

MOST = 40  # frames of a path
LAYERS = {"passive": 1, "active": 2}  # as the solver's output numbers them
CUTS = 1  # of each cell's edges, as a power of two, where its curved sides become triangles


def frames(run: Run, most: int = MOST) -> list[dict[str, Any]]:
    """At most so many states of a path, the first and the last among them, evenly by turning.

    Each has ``contraction``, ``m1`` (rad) and per layer its surface: ``points`` (n, 3) in l_s and
    ``triangles`` (m, 3), and ``strain`` (m,), the largest principal elastic strain by size in the
    triangle's cell. Arrays are packed: :func:`foldlab.explore.live.packed`.
    """
    import pyvista

    kept = chosen([row["m1"] for row in run.history], most)
    thin = replace(run, shapes=[run.shapes[k] for k in kept])
    out = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "unit.pvd"
        thin.write_series(path)
        reader = pyvista.get_reader(str(path))
        for at, k in enumerate(kept):
            reader.set_active_time_point(at)
            mesh = reader.read()[0].warp_by_vector("displacement")
            row = run.history[k]
            told = {"contraction": row["contraction"], "m1": row["m1"]}
            out.append(told | {"layers": {name: _surface(mesh, name) for name in LAYERS}})
    return out


def chosen(turning: list[float], most: int) -> list[int]:
    """Which states to keep: as evenly spaced by turning as they are there."""
    if len(turning) <= most:
        return list(range(len(turning)))
    way = np.r_[0.0, np.cumsum(np.abs(np.diff(turning)) + 1e-6)]
    near = np.searchsorted(way, np.linspace(0, way[-1], most))
    return np.unique(np.r_[0, near, len(turning) - 1].clip(max=len(turning) - 1)).tolist()


def _surface(mesh, layer: str) -> Mapping[str, str]:
    part = mesh.threshold([LAYERS[layer]] * 2, scalars="layer")
    part.cell_data["strain"] = principal(part.cell_data["F"], part.cell_data["growth"])
    skin = part.extract_surface(nonlinear_subdivision=CUTS, algorithm="dataset_surface")
    skin = skin.triangulate()
    return {
        "points": packed(skin.points),
        "triangles": packed(skin.regular_faces, "<i4"),
        "strain": packed(skin.cell_data["strain"]),
    }
