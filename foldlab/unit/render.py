"""Pictures of a unit's path in three dimensions, drawn by VTK without a screen.

Runs as a process of its own, ``python -m foldlab.unit.render REQUEST.json``: where no driver can
render, VTK ends the process that asks. :func:`drawn_apart` starts it, as it does for others, and
says whether there are pictures.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

# Passive, active, ground; C1 … C4.
LAYERS = {"passive": "#9DB4CC", "active": "#E2A33B", "ground": "#E9E7E1"}
CURVES = ("#0B3C9C", "#B3202A", "#2E7D4F", "#7A3E9D")
STRAIN = "viridis"
# From the side, turned so far that the width shows.
TOWARDS = np.array([1.0, -0.62, 0.42])


@dataclass(frozen=True)
class Request:
    """What to draw.

    ``series``: PVD file; ``curves``: NPZ file with ``curves`` (states, 4, points, 3); ``ground``:
    whether there is one at z = 0. Each of ``pictures`` is (state, PNG file, width in pixels); all
    have one camera and one scale. Those named in ``strained`` are coloured by the largest principal
    elastic strain, by size, up to ``most``, and show no curves.
    """

    series: str
    curves: str
    ground: bool
    slenderness: float
    pictures: list[tuple[int, str, int]]
    strained: tuple[str, ...] = ()
    most: float = 1.0


def render(request: Request, folder: Path, timeout: float = 120.0) -> bool:
    """Whether another process has drawn all pictures. ``folder`` takes the request."""
    path = Path(folder) / "request.json"
    pictures = [name for _, name, _ in request.pictures]
    return drawn_apart("foldlab.unit.render", asdict(request), path, pictures, timeout)


def drawn_apart(
    module: str, request, path: Path, pictures: Sequence[str | Path], timeout: float
) -> bool:
    """Whether ``python -m MODULE PATH`` has drawn all pictures within ``timeout`` seconds.

    ``request``: what the module reads at ``path``, as JSON; the file is taken away again.
    """
    path.write_text(json.dumps(request), encoding="utf-8")
    root = Path(__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path])}
    command = [sys.executable, "-m", module, str(path)]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, timeout=timeout, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    finally:
        path.unlink(missing_ok=True)
    return done.returncode == 0 and all(Path(name).exists() for name in pictures)


def draw(request: Request) -> None:
    """Draws in this process."""
    import pyvista

    reader = pyvista.get_reader(request.series)
    with np.load(request.curves) as file:
        curves = file["curves"]
    shapes = {}
    for state, _, _ in request.pictures:
        if state not in shapes:
            reader.set_active_time_point(state)
            shapes[state] = reader.read()[0].warp_by_vector("displacement")
    bounds = np.array([shape.bounds for shape in shapes.values()]).reshape(-1, 3, 2)
    low, high = bounds[..., 0].min(axis=0), bounds[..., 1].max(axis=0)
    floor = None
    if request.ground:
        pad = 0.06 * float((high - low).max())
        corners = [(low[0] - pad, high[0] + pad), (low[1] - pad, high[1] + pad)]
        floor = pyvista.Plane(
            center=(sum(corners[0]) / 2, sum(corners[1]) / 2, 0.0),
            direction=(0, 0, 1),
            i_size=corners[0][1] - corners[0][0],
            j_size=corners[1][1] - corners[1][0],
        )
    seen = [shape.points for shape in shapes.values()] + ([] if floor is None else [floor.points])
    focus, reach, extent = _frame(seen)
    # The curves lie within the sheet. Of a thin one tubes come out on both sides.
    thin = request.slenderness < 0.008
    radius = 0.5 * request.slenderness + 0.0018
    for state, name, width in request.pictures:
        height = max(2, round(width * extent[1] / extent[0]))
        plotter = pyvista.Plotter(off_screen=True, window_size=(width, height))
        plotter.set_background("white")
        plotter.enable_anti_aliasing("ssaa")
        if floor is not None:
            plotter.add_mesh(floor, color=LAYERS["ground"], lighting=False)
        for number, layer in ((1, "passive"), (2, "active")):
            part = shapes[state].threshold([number, number], scalars="layer")
            if name in request.strained:
                part = part.copy()
                part.cell_data["strain"] = principal(part.cell_data["F"], part.cell_data["growth"])
                plotter.add_mesh(
                    part.extract_surface(nonlinear_subdivision=4, algorithm="dataset_surface"),
                    scalars="strain",
                    clim=(0.0, request.most),
                    cmap=STRAIN,
                    show_scalar_bar=False,
                    ambient=0.4,
                    diffuse=0.6,
                )
                continue
            surface = part.extract_surface(nonlinear_subdivision=4, algorithm="dataset_surface")
            plotter.add_mesh(
                surface.compute_normals(feature_angle=40, split_vertices=True),
                color=LAYERS[layer],
                ambient=0.25,
                diffuse=0.75,
                smooth_shading=True,
            )
        lines = [] if name in request.strained else zip(curves[state], CURVES, strict=True)
        for curve, colour in lines:
            line = pyvista.lines_from_points(np.asarray(curve[::5], float))
            if thin:
                plotter.add_mesh(line.tube(radius=radius), color=colour, ambient=0.5, diffuse=0.5)
            # What the layers hide of it is drawn on top of them.
            hidden = plotter.add_mesh(
                line, color=colour, opacity=0.75, line_width=width / (300 if thin else 160)
            )
            hidden.mapper.SetResolveCoincidentTopologyToPolygonOffset()
            hidden.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0, -66000)
        plotter.camera_position = [tuple(focus + 5 * TOWARDS), tuple(focus), (0, 0, 1)]
        plotter.enable_parallel_projection()
        plotter.camera.parallel_scale = reach
        plotter.reset_camera_clipping_range()
        plotter.screenshot(name)
        plotter.close()


def principal(F: np.ndarray, growth: np.ndarray) -> np.ndarray:
    """Largest principal elastic strain |λ − 1| of each cell, from rows of F and Fg (cells, 9)."""
    Fe = F.reshape(-1, 3, 3) @ np.linalg.inv(growth.reshape(-1, 3, 3))
    return np.abs(np.linalg.svd(Fe, compute_uv=False) - 1).max(axis=1)


def _frame(clouds: Sequence[np.ndarray]) -> tuple[np.ndarray, float, tuple[float, float]]:
    """Focus, half height and (width, height) of the view that holds all points."""
    towards = TOWARDS / np.linalg.norm(TOWARDS)
    right = np.cross((0, 0, 1), towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    points = np.vstack(clouds)
    flat = points @ np.stack([right, up, towards], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = (high - low)[:2] + 0.05 * (high - low)[:2].max()
    focus = np.stack([right, up, towards], axis=1) @ ((low + high) / 2)
    return focus, float(size[1] / 2), (float(size[0]), float(size[1]))


if __name__ == "__main__":
    _given = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    draw(Request(**_given))
