"""Pictures of the lung: cut open, coloured by radial displacement, drawn by VTK without a screen.

Runs as a process of its own, ``python -m experiments._lung.render REQUEST.json``, for the reason
that :mod:`foldlab.unit.render` gives. :func:`pictures` starts it and says whether there are
pictures.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from foldlab.unit.render import drawn_apart

COLOURS = "viridis"
MUSCLE = "#C9A3A0"
SIZE = 700  # pixels
SUBDIVISION = 2  # of quadratic faces into flat ones


def pictures(
    files: Sequence[Path],
    targets: Sequence[Path],
    limits: Sequence[tuple[float, float]],
    timeout: float = 300.0,
) -> bool:
    """Whether another process has drawn each VTU file into its PNG.

    The files have the fields "displacement" and "radial" at the points and "layer" in the cells
    (1 the epithelium, 2 the muscle). ``limits``: of the colours of each.
    """
    request = Path(targets[0]).with_suffix(".json")
    rows = [
        [str(f), str(t), *map(float, c)] for f, t, c in zip(files, targets, limits, strict=True)
    ]
    return drawn_apart(f"{__package__}.render", rows, request, targets, timeout)


def draw(rows: Sequence[Sequence]) -> None:
    """Draws in this process; one camera and one scale for all."""
    import pyvista

    shapes = [pyvista.read(row[0]).warp_by_vector("displacement") for row in rows]
    reach = max(max(abs(b) for b in shape.bounds) for shape in shapes)
    for shape, (_, target, low, high) in zip(shapes, rows, strict=True):
        plotter = pyvista.Plotter(off_screen=True, window_size=(SIZE, SIZE))
        plotter.set_background("white")
        plotter.enable_anti_aliasing("ssaa")
        # The coordinate planes are mirrors of the undeformed and of the deformed lung, and no cell
        # crosses them: an octant can be taken out whole.
        centres = shape.cell_centers().points
        away = (centres[:, 0] > 0) & (centres[:, 1] < 0) & (centres[:, 2] > 0)
        kept = shape.extract_cells(~away)
        for layer in (1, 2):
            part = kept.threshold([layer, layer], scalars="layer")
            if not part.n_cells:
                continue
            surface = part.extract_surface(
                nonlinear_subdivision=SUBDIVISION, algorithm="dataset_surface"
            ).compute_normals(feature_angle=40, split_vertices=True)
            look = {"smooth_shading": True, "ambient": 0.25, "diffuse": 0.8}
            if layer == 1:
                plotter.add_mesh(
                    surface,
                    scalars="radial",
                    cmap=COLOURS,
                    clim=(low, high),
                    show_scalar_bar=False,
                    **look,
                )
            else:
                plotter.add_mesh(surface, color=MUSCLE, **look)
        plotter.camera_position = [(3.2, -4.2, 2.9), (0, 0, 0), (0, 0, 1)]
        plotter.enable_parallel_projection()
        plotter.camera.parallel_scale = 1.04 * reach
        plotter.reset_camera_clipping_range()
        plotter.screenshot(target)
        plotter.close()


if __name__ == "__main__":
    draw(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
