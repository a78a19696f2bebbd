"""Fields that a user brings: a scalar at scattered points (CSV) or on a mesh (VTU), interpolated.

A pattern answers at any positions (..., 3) within its reach, so it may stand for β(X) of
:class:`solver.physics.growth.Apical` and other fields of position.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import QhullError, cKDTree


class Pattern:
    """A scalar field interpolated linearly from a file, in the units of the mesh it is for.

    Between the data points of a CSV linearly; beyond their hull the nearest one counts within
    ``reach``, by default twice the median distance of the data points to their neighbours, so that
    a field sampled along a curved body's surface covers it. Answers raise ValueError for positions
    that the data doesn't cover.
    """

    def __init__(self, points: np.ndarray, values: np.ndarray, *, name: str = "field", reach=None):
        """Raises ValueError for fewer than four points, points in one plane, and values that are
        not finite."""
        points, values = np.asarray(points, dtype=float), np.asarray(values, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or values.shape != (len(points),):
            raise ValueError(
                f"{name}: points {points.shape} and values {values.shape}; expected (n, 3) and (n,)"
            )
        if len(points) < 4:
            raise ValueError(f"{name} has {len(points)} points; expected at least four")
        if not (np.isfinite(points).all() and np.isfinite(values).all()):
            row = int(np.flatnonzero(~(np.isfinite(points).all(1) & np.isfinite(values)))[0])
            raise ValueError(f"{name} is not finite at its point {row}; mend the file")
        self.name, self.values = name, values
        self._tree = cKDTree(points)
        self.reach = reach or 2 * float(np.median(self._tree.query(points, k=2)[0][:, 1]))
        try:
            self._linear = LinearNDInterpolator(points, values)
        except QhullError as error:
            raise ValueError(
                f"{name}: its points lie in one plane; give a field in three dimensions"
            ) from error

    def __call__(self, X: np.ndarray) -> np.ndarray:
        """Values at positions (..., 3)."""
        X = np.asarray(X, dtype=float)
        flat = X.reshape(-1, 3)
        distance, near = self._tree.query(flat)
        out = self._linear(flat)
        out = np.where(np.isnan(out), self.values[near], out)
        # In a hollow the hull has points that the data is nowhere near.
        far = distance > self.reach
        if far.any():
            x, y, z = flat[np.argmax(distance)]
            raise ValueError(
                f"{self.name} does not cover the mesh: {far.sum()} of {len(flat)} points lie more "
                f"than {self.reach:.3g} from its data, the farthest by {distance.max():.3g} near "
                f"({x:.4g}, {y:.4g}, {z:.4g}); check units and origin, or bring a larger field"
            )
        return out.reshape(X.shape[:-1])


def read_pattern(path: str | Path, field: str = "beta", *, reach: float | None = None) -> Pattern:
    """The pattern in a CSV with columns x, y, z and ``field``, or the point field of a VTU.

    Raises ValueError for another suffix, a missing file, column or field, and entries that are no
    numbers.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"there is no file {path}; give a .csv or .vtu with the field {field!r}")
    if path.suffix == ".csv":
        return _read_csv(path, field, reach)
    if path.suffix == ".vtu":
        return _read_vtu(path, field, reach)
    raise ValueError(f"{path.name}: expected a name that ends in .csv or .vtu")


def _read_csv(path, field, reach):
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    header = [name.strip() for name in lines[0].split(",")] if lines else []
    wanted = ["x", "y", "z", field]
    missing = [name for name in wanted if name not in header]
    if missing:
        raise ValueError(
            f"{path.name} has no column {missing[0]!r}; there are: {', '.join(header) or 'none'}; "
            f"expected {', '.join(wanted)}"
        )
    try:
        table = np.loadtxt(lines[1:], delimiter=",", ndmin=2, comments=None)
        columns = [table[:, header.index(name)] for name in wanted]
    except (ValueError, IndexError) as error:
        raise ValueError(f"{path.name} is no table of numbers: {error}") from error
    return Pattern(np.stack(columns[:3], axis=1), columns[3], name=path.name, reach=reach)


def _read_vtu(path, field, reach):
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput()
    data = grid.GetPointData()
    names = [data.GetArrayName(i) for i in range(data.GetNumberOfArrays())]
    if field not in names:
        raise ValueError(
            f"{path.name} has no point field {field!r}; there are: {', '.join(names) or 'none'}"
        )
    values = vtk_to_numpy(data.GetArray(field))
    points = vtk_to_numpy(grid.GetPoints().GetData())
    return Pattern(points, values, name=path.name, reach=reach)
