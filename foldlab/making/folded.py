"""What a unit looks like folded: the solver's last state in millimetres, in the frame of
:mod:`foldlab.making.geometry`."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from foldlab.labels.run import Run

LAYERS = {"passive": 1, "active": 2}  # as the solver's output numbers them
CUTS = 2  # of each cell's edges, as a power of two, where its curved sides become triangles


@dataclass(frozen=True, eq=False)
class Folded:
    """A deformed unit, lengths in mm.

    ``middle`` (1000, 3): the sheet's mid-line, evenly spaced along the flat one. ``mesh``: the
    whole unit's PyVista grid in its reference state with the point field "displacement" and the
    cell field "layer".
    """

    middle: np.ndarray
    mesh: Any

    @classmethod
    def of(cls, run: Run, length: float) -> Folded:
        """The last state of a path; ``length`` of the sheet in mm."""
        import pyvista

        last = replace(run, shapes=run.shapes[-1:])
        with tempfile.TemporaryDirectory() as folder:
            last.write_series(Path(folder) / "unit.pvd")
            (name,) = Path(folder).glob("*.vtu")
            mesh = pyvista.read(name)
        mesh.points = length * turned(np.asarray(mesh.points, float))
        u = np.asarray(mesh.point_data["displacement"], float)
        mesh.point_data["displacement"] = length * turned(u)
        return cls(length * turned(np.asarray(run.shapes[-1].state.curves)[0]), mesh)

    @property
    def nodes(self) -> np.ndarray:
        """Deformed positions (n, 3)."""
        return np.asarray(self.mesh.points) + np.asarray(self.mesh.point_data["displacement"])

    def surface(self, layer: str) -> tuple[np.ndarray, np.ndarray]:
        """Corners (n, 3) and triangles (m, 3), outward, of a layer's closed surface."""
        moved = self.mesh.warp_by_vector("displacement")
        part = moved.threshold([LAYERS[layer]] * 2, scalars="layer")
        skin = part.extract_surface(nonlinear_subdivision=CUTS, algorithm="dataset_surface")
        skin = skin.triangulate().clean()
        skin = skin.compute_normals(
            cell_normals=False, auto_orient_normals=True, split_vertices=False
        )
        return np.asarray(skin.points, float), skin.regular_faces


def turned(points: np.ndarray) -> np.ndarray:
    """From the solver's axes (x across the sheet) to those of the files (x along it)."""
    return points[..., [1, 0, 2]] * (1.0, -1.0, 1.0)
