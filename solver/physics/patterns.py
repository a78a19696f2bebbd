"""Fields that a user brings: a scalar at scattered points (CSV) or on a mesh (VTU), interpolated.

A pattern answers at any positions (..., 3) within its reach, so it may stand for β(X) of
:class:`solver.physics.growth.Apical` and other fields of position.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import QhullError, cKDTree

from solver.given import number, numbers
from solver.mesh.vtk import vtk_silenced


class Pattern:
    """A scalar field interpolated linearly from a file, in the units of the mesh it is for.

    Points that coincide, as where each cell of a file has nodes of its own, count once with the
    mean of their values. Between the data points linearly; beyond their hull the nearest one
    counts within ``reach``, by default twice the median distance of the data points to their
    neighbours, so that a field sampled along a curved body's surface covers it. Answers raise
    ValueError for positions that the data doesn't cover.
    """

    def __init__(self, points: np.ndarray, values: np.ndarray, *, name: str = "field", reach=None):
        """Raises ValueError for fewer than four points, points in one plane, and values that are
        not finite."""
        points, values = numbers(f"{name}: points", points), numbers(f"{name}: values", values)
        if points.ndim != 2 or points.shape[1] != 3 or values.shape != (len(points),):
            raise ValueError(
                f"{name}: points {points.shape} and values {values.shape}; expected (n, 3) and (n,)"
            )
        if not (np.isfinite(points).all() and np.isfinite(values).all()):
            row = int(np.flatnonzero(~(np.isfinite(points).all(1) & np.isfinite(values)))[0])
            raise ValueError(f"{name} is not finite at its point {row}; mend the file")
        points, values = _merged(points, values)
        if len(points) < 4:
            raise ValueError(f"{name} has {len(points)} points; expected at least four")
        self.name, self.values = name, values
        self._tree = cKDTree(points)
        if reach is not None:
            number(f"{name}: reach", reach, above=0)
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


def _merged(points: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points that differ by more than rounding, and the mean of the values at each."""
    if not len(points):
        return points, values
    low = points.min(axis=0)
    grain = 1e-9 * float((points - low).max()) or 1.0
    _, first, same = np.unique(
        np.round((points - low) / grain), axis=0, return_index=True, return_inverse=True
    )
    same = same.ravel()
    return points[first], np.bincount(same, weights=values) / np.bincount(same)


# What a stranger's file may ask for.
MOST_BYTES, MOST_POINTS = 500_000_000, 20_000_000


def read_pattern(path: str | Path, field: str = "beta", *, reach: float | None = None) -> Pattern:
    """The pattern in a CSV with columns x, y, z and ``field``, or the point field of a VTU.

    Raises ValueError for another suffix, a missing or damaged file, one larger than
    :data:`MOST_BYTES` or of more points than :data:`MOST_POINTS`, a missing column or field, and
    entries of these that are no numbers; other columns may hold anything.
    """
    path = checked_file(path, f"the field {field!r}")
    reader = _read_csv if path.suffix.lower() == ".csv" else _read_vtu
    return reader(path, field, reach)


def checked_file(path: str | Path, what: str) -> Path:
    """A .csv or .vtu with ``what``, which is there and not too large; ValueError else."""
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"there is no file {path}; give a .csv or .vtu with {what}")
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path.name} is larger than {MOST_BYTES / 1e6:g} MB")
    if path.suffix.lower() not in (".csv", ".vtu"):
        raise ValueError(f"{path.name}: expected a name that ends in .csv or .vtu")
    return path


def _read_csv(path, field, reach):
    table = read_columns(path, ["x", "y", "z", field])
    return Pattern(table[:, :3], table[:, 3], name=path.name, reach=reach)


def columns_of(path: Path) -> list[str]:
    """The names of a CSV's columns; raises ValueError for a file that is no text."""
    return _rows(path)[0]


def read_columns(path: Path, wanted: list[str]) -> np.ndarray:
    """Columns of a CSV by their names, (rows, columns); raises what :func:`read_pattern` does."""
    header, rows = _rows(path)
    for name in wanted:
        if header.count(name) != 1:
            raise ValueError(
                f"{path.name} has {'no' if name not in header else 'more than one'} column "
                f"{name!r}; there are: {', '.join(header) or 'none'}; expected {', '.join(wanted)}"
            )
    columns = [header.index(name) for name in wanted]
    table = np.empty((len(rows), len(wanted)))
    for k, row in enumerate(rows):
        try:
            if any(row[len(header) :]):
                raise ValueError(f"{len(row)} cells below a header of {len(header)}")
            cells = [row[column] for column in columns]
            if "\n" in "".join(cells):
                raise ValueError("a quote that is not closed")
            table[k] = [float(cell) for cell in cells]
        except (ValueError, IndexError) as error:
            raise ValueError(f"{path.name} is no table of numbers in row {k}: {error}") from error
    return table


def _rows(path):
    """Header and rows of a CSV."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [row for row in csv.reader(file, skipinitialspace=True) if any(row)]
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path.name} is no table of text: {error}") from error
    return [name.strip() for name in rows[0]] if rows else [], rows[1:]


def _read_vtu(path, field, reach):
    points, numbers = read_grid(path)
    if field not in numbers:
        raise ValueError(
            f"{path.name} has no point field {field!r} of numbers; "
            f"there are: {', '.join(numbers) or 'none'}"
        )
    return Pattern(points, numbers[field], name=path.name, reach=reach)


def read_grid(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points (n, 3) of a VTU and its point fields of numbers; raises what :func:`read_pattern`
    does."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    # VTK would end the process.
    head = path.read_bytes().partition(b"<AppendedData")[0]
    if wrong := re.search(rb'NumberOf\w+="\s*(-[^"]*)"', head):
        raise ValueError(
            f"{path.name} is damaged, or no VTU (a number of {wrong[1].decode()}); write it again"
        )
    # A compressed field of equal numbers may be a thousand times as large as its file.
    counts = re.findall(rb'NumberOf(?:Points|Cells)="\s*(\d+)', head)
    if max(map(int, counts), default=0) > MOST_POINTS:
        raise ValueError(f"{path.name} has more than {MOST_POINTS:.3g} points or cells")
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    # What it says tells a damaged file from one without the field.
    with vtk_silenced() as complaint:
        reader.Update()
    grid = reader.GetOutput()
    n = grid.GetNumberOfPoints()
    nodes = vtk_to_numpy(grid.GetCells().GetConnectivityArray()) if n else ()
    why = complaint() or ("" if n else "it has no points")
    if len(nodes) and not 0 <= nodes.min() <= nodes.max() < n:
        why = f"it has {n} points, and a cell with others"
    if why:
        raise ValueError(f"{path.name} is damaged, or no VTU ({why}); write it again")
    data = grid.GetPointData()
    # Arrays of words are None here.
    arrays = [a for i in range(data.GetNumberOfArrays()) if (a := data.GetArray(i))]
    fields = {array.GetName(): vtk_to_numpy(array) for array in arrays if array.GetName()}
    return vtk_to_numpy(grid.GetPoints().GetData()), fields
