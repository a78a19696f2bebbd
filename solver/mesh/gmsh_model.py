"""General geometry through Gmsh: points → curves → loops → surfaces → volumes → mesh.

    with Model() as model:
        contact = model.polygon([(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)])
        passive = model.extrude(contact, (0, 0, -0.1))
        active = model.extrude(contact, (0, 0, 0.5))
        model.subdomain("passive", [passive.volume])
        model.subdomain("active", [active.volume])
        model.boundary("top", [active.end])
        mesh = model.tetrahedra(c=0.49, thickness={"passive": 0.1, "active": 0.5}, order=2)

Layers that grow from one contact surface share its nodes; ``glue`` makes touching volumes share
their faces in general. Lengths are in whatever unit the scene uses. Gmsh is imported only
when it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import skfem

from solver.mesh.gmsh_import import from_model, refused, session


@dataclass(frozen=True)
class Extrusion:
    """Tags of an extruded ``volume``, the surface at its ``end``, and its ``sides``.

    The sides follow the curves of the surface that was extruded.
    """

    volume: int
    end: int
    sides: tuple[int, ...]


class Model:
    """A Gmsh model as a context; its tags are of no use outside it.

    Entering raises ImportError where Gmsh can't be loaded. Methods raise ValueError for what Gmsh
    refuses.
    """

    def __init__(self, name: str = "model"):
        self._session = session(name)
        self._gmsh: Any = None  # while the session lasts
        self._cad: Any = None
        self._volumes: dict[str, list[int]] = {}
        self._surfaces: dict[str, list[int] | Callable] = {}
        self._divided: set[int] = set()

    def __enter__(self) -> Model:
        self._gmsh = self._session.__enter__()
        self._cad = self._gmsh.model.occ
        return self

    def __exit__(self, *error) -> None:
        self._session.__exit__(*error)

    # -- geometry --------------------------------------------------------------------------------

    def point(self, x: float, y: float, z: float) -> int:
        """Tag of a point."""
        return self._cad.addPoint(x, y, z)

    def line(self, start: int, end: int) -> int:
        """Tag of a straight curve between two points."""
        return refused(self._cad.addLine, start, end)

    def arc(self, start: int, centre: int, end: int) -> int:
        """Tag of the shorter circular arc between two points around a third."""
        return refused(self._cad.addCircleArc, start, centre, end)

    def loop(self, curves: Sequence[int]) -> int:
        """Tag of a closed loop of curves."""
        return refused(self._cad.addCurveLoop, list(curves))

    def surface(self, loop: int, holes: Sequence[int] = ()) -> int:
        """Tag of a plane surface within a loop, less the loops of its holes."""
        return refused(self._cad.addPlaneSurface, [loop, *holes])

    def patch(self, loop: int) -> int:
        """Tag of a curved surface that fills a loop."""
        return refused(self._cad.addSurfaceFilling, loop)

    def polygon(
        self,
        corners: Sequence[Sequence[float]],
        holes: Sequence[Sequence[Sequence[float]]] = (),
    ) -> int:
        """Tag of a plane surface with the given corners, less holes given by theirs."""
        loops = []
        for around in (corners, *holes):
            tags = [self.point(*c) for c in around]
            ends = zip(tags, tags[1:] + tags[:1], strict=True)
            loops.append(self.loop([self.line(a, b) for a, b in ends]))
        return self.surface(loops[0], loops[1:])

    def volume(self, surfaces: Sequence[int]) -> int:
        """Tag of the volume that a closed set of surfaces bounds."""
        shell = refused(self._cad.addSurfaceLoop, list(surfaces), -1, True)
        return refused(self._cad.addVolume, [shell])

    def extrude(self, surface: int, vector: Sequence[float]) -> Extrusion:
        """Volume that a surface sweeps along a vector; it shares the surface it grows from."""
        return self._extrusion(refused(self._cad.extrude, [(2, surface)], *vector))

    def revolve(
        self, surface: int, point: Sequence[float], axis: Sequence[float], angle: float
    ) -> Extrusion:
        """Volume that a surface sweeps around an axis through a point; angle in radians, < π."""
        return self._extrusion(refused(self._cad.revolve, [(2, surface)], *point, *axis, angle))

    def _extrusion(self, tags) -> Extrusion:
        at = [dim for dim, _ in tags].index(3)
        return Extrusion(tags[at][1], tags[at - 1][1], tuple(t for _, t in tags[at + 1 :]))

    def glue(self) -> None:
        """Cuts all volumes where they touch or overlap, so that they share faces and nodes.

        Names follow; other tags may change, so name surfaces before, or by a test, and divide
        curves after.
        """
        self._divided.clear()
        self._cad.synchronize()
        volumes = self._gmsh.model.getEntities(3)
        named = sorted({(2, t) for s in self._surfaces.values() if not callable(s) for t in s})
        children = refused(self._cad.fragment, volumes, named)[1]
        new = {
            old: [t for dim, t in made if dim == old[0]]
            for old, made in zip([*volumes, *named], children, strict=True)
        }
        for dim, names in ((3, self._volumes), (2, self._surfaces)):
            for name, tags in names.items():
                if not callable(tags):
                    names[name] = sorted({t for tag in tags for t in new.get((dim, tag), [tag])})

    # -- names -----------------------------------------------------------------------------------

    def subdomain(self, name: str, volumes: Sequence[int]) -> None:
        """Names volumes."""
        self._volumes[name] = list(volumes)

    def boundary(
        self, name: str, surfaces: Sequence[int] | Callable[[np.ndarray], np.ndarray]
    ) -> None:
        """Names surfaces by their tags, or by a test of their centres of mass X (n, 3)."""
        self._surfaces[name] = surfaces if callable(surfaces) else list(surfaces)

    # -- meshes ----------------------------------------------------------------------------------

    def divide(
        self,
        n: int,
        where: Callable[[np.ndarray, np.ndarray], bool],
        *,
        ratio: float = 1.0,
        toward: Sequence[float] | None = None,
    ) -> None:
        """Puts n elements on each curve for which ``where(middle, direction)`` is true, both (3,).

        ``direction`` is the unit vector between the ends. ``ratio`` is longest over shortest step,
        shrinking toward the end that is nearer to the point ``toward``. Raises ValueError if no
        curve is chosen, or for a ratio without ``toward``.
        """
        if n < 1 or not ratio >= 1 or (ratio > 1 and toward is None):
            raise ValueError(
                f"n = {n}, ratio = {ratio:g}, toward = {toward}; expected n ≥ 1, ratio ≥ 1, and a "
                "point toward which the steps shrink where the ratio is above 1"
            )
        self._cad.synchronize()
        chosen = 0
        for curve in self._curves():
            start, middle, end = self._along(curve)
            span = np.linalg.norm(end - start)
            if not where(middle, (end - start) / (span or 1.0)):
                continue
            step = ratio ** (1 / max(n - 1, 1))
            if toward is not None:
                near_end = np.linalg.norm(end - toward) < np.linalg.norm(start - toward)
                step = 1 / step if near_end else step
            self._gmsh.model.mesh.setTransfiniteCurve(curve, n + 1, "Progression", step)
            self._divided.add(curve)
            chosen += 1
        if not chosen:
            raise ValueError("no curve was chosen; check the test of middle and direction")

    def hexahedra(self, order: int = 2) -> skfem.Mesh:
        """Transfinite mesh of volumes with six sides, all of whose curves were divided.

        ``order`` 1 or 2. Raises ValueError if a curve was not divided, if the numbers on opposite
        curves differ, or if a volume has not six sides of four curves.
        """
        self._cad.synchronize()
        model = self._gmsh.model
        loose = [c for c in self._curves() if c not in self._divided]
        if loose:
            where = ", ".join(f"{x:.4g}" for x in self._along(loose[0])[1])
            raise ValueError(
                f"{len(loose)} curves were not divided, the first around ({where}); call divide"
            )
        for _, tag in model.getEntities(2):
            model.mesh.setTransfiniteSurface(tag)
            model.mesh.setRecombine(2, tag)
        for _, tag in model.getEntities(3):
            model.mesh.setTransfiniteVolume(tag)
        mesh = self._generate(order)
        if not isinstance(mesh, skfem.MeshHex1):
            raise ValueError("not every volume has six sides of four curves; use tetrahedra")
        return mesh

    def tetrahedra(self, c: float, thickness: Mapping[str, float], *, order: int = 1) -> skfem.Mesh:
        """Unstructured mesh with elements of size c·h, h the thickness of each sub-domain.

        On shared faces the smaller size holds; Gmsh grades between. Raises ValueError for a c or
        thickness that is not positive, and unless each volume has a name with a thickness.
        """
        self._cad.synchronize()
        model = self._gmsh.model
        sizes = {t: c * h for name, h in thickness.items() for t in self._volumes.get(name, [])}
        if unknown := sorted(set(thickness) - set(self._volumes)):
            raise ValueError(f"no sub-domain {', '.join(unknown)}; name its volumes first")
        if not all(h > 0 and np.isfinite(h) for h in sizes.values()):
            raise ValueError(f"c = {c}, thickness = {dict(thickness)}; expected positive numbers")
        bare = [t for _, t in model.getEntities(3) if t not in sizes]
        if bare:
            raise ValueError(f"{len(bare)} volumes have no thickness; name them as sub-domains")
        fields = []
        for tag, size in sizes.items():
            field = model.mesh.field.add("Constant")
            model.mesh.field.setNumbers(field, "VolumesList", [tag])
            model.mesh.field.setNumber(field, "VIn", size)
            model.mesh.field.setNumber(field, "VOut", 1e22)
            fields.append(field)
        least = model.mesh.field.add("Min")
        model.mesh.field.setNumbers(least, "FieldsList", fields)
        model.mesh.field.setAsBackgroundMesh(least)
        for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            self._gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)
        # Without it slivers stay: scaled Jacobian 0.001 instead of 0.13 on a folding unit, c = 1.
        self._gmsh.option.setNumber("Mesh.OptimizeNetgen", 1)
        return self._generate(order)

    def write(self, path: str | Path) -> None:
        """Writes the generated mesh as .msh, names included."""
        refused(self._gmsh.write, str(path))

    def _generate(self, order: int) -> skfem.Mesh:
        if order not in (1, 2):
            raise ValueError(f"order = {order}; expected 1 or 2")
        model = self._gmsh.model
        model.mesh.clear()
        model.removePhysicalGroups()
        for name in [*self._volumes, *self._surfaces]:
            model.removePhysicalName(name)
        for name, tags in self._volumes.items():
            model.addPhysicalGroup(3, tags, name=name)
        every = [t for _, t in model.getEntities(2)]
        centres = np.array([self._cad.getCenterOfMass(2, t) for t in every])
        for name, tags in self._surfaces.items():
            if callable(tags):
                tags = [t for t, yes in zip(every, np.asarray(tags(centres)), strict=True) if yes]
            if not tags:
                raise ValueError(f"boundary {name!r} is empty; check its test of the centres")
            model.addPhysicalGroup(2, tags, name=name)
        self._gmsh.option.setNumber("Mesh.ElementOrder", order)
        self._gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0)
        refused(model.mesh.generate, 3)
        return from_model()

    def _curves(self) -> list[int]:
        """Curves of the volumes; loose ones, such as an arc's radius, carry no mesh."""
        model = self._gmsh.model
        sides = model.getBoundary(model.getEntities(3), combined=False, oriented=False)
        curves = model.getBoundary(sides, combined=False, oriented=False)
        return sorted({tag for _, tag in curves})

    def _along(self, curve: int) -> np.ndarray:
        """Start, middle and end of a curve, (3, 3)."""
        model = self._gmsh.model
        low, high = (bound[0] for bound in model.getParametrizationBounds(1, curve))
        return np.reshape(model.getValue(1, curve, [low, (low + high) / 2, high]), (3, 3))
