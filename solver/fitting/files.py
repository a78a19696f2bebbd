"""Shapes that a user brings: points in a CSV, or the points of a VTU."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver.fitting.targets import section
from solver.physics.patterns import checked_file, columns_of, read_columns, read_grid


def read_shape(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Where points were and where they are, both (p, 3), in the units of the mesh they are for.

    A CSV has columns x, y and z, or two of them: the outline of the section through the origin
    across the third axis. What the points were isn't known: they are given twice. A VTU has its
    points, moved by the point field "displacement" where there is one, as our own are written.
    Raises ValueError as :func:`solver.physics.patterns.read_pattern` does, and for no points and
    such as are not finite.
    """
    path = checked_file(path, "the points of a shape")
    if path.suffix.lower() == ".csv":
        names = [axis for axis in "xyz" if axis in columns_of(path)]
        points = read_columns(path, names if len(names) > 1 else ["x", "y", "z"])
        if len(names) == 2:
            points = section(points, next(k for k, axis in enumerate("xyz") if axis not in names))
        was, now = points, points
    else:
        was, fields = read_grid(path)
        now = was
        if "displacement" in fields:
            moved = fields["displacement"]
            if moved.shape != was.shape:
                raise ValueError(
                    f"{path.name}: displacement has shape {moved.shape}; expected {was.shape}"
                )
            now = was + moved
    if not len(now) or not np.isfinite(now).all():
        raise ValueError(f"{path.name} has {len(now)} points; expected at least one, all finite")
    return np.asarray(was, float), np.asarray(now, float)
