"""The sizes of a unit in millimetres, and the lines and solids that every writer takes from them.

x runs along the sheet, y across it, z up; the origin is the middle of the sheet's underside. (The
solver's x runs across: a point there is (y, −x, z) here.) The sheet's panels are ``width`` wide
and its hinge, |x| ≤ hinge_length/2, ``hinge_width``; the active layer lies on the hinge, as one
patch or as strips along x with half a gap at each edge of the hinge.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np

from foldlab.errors import InputError

MM = 1e3  # in a metre
SAME = 1e-9  # relative: a hinge as wide as its panels
# Field and SI quantity (:data:`foldlab.design.PHYSICAL`).
QUANTITIES = {
    "length": "l_s", "width": "b_s", "thickness": "h_s",
    "hinge_length": "l_i", "hinge_width": "b_i", "active_thickness": "h_i",
}  # fmt: skip


@dataclass(frozen=True)
class Geometry:
    """Sizes in mm. ``strips``: how many, 0 for a solid active layer; ``strip_share``: fraction of
    the hinge's width that they cover. Raises :class:`InputError` for sizes that are no unit."""

    length: float
    width: float
    thickness: float
    hinge_length: float
    hinge_width: float
    active_thickness: float
    strips: int = 0
    strip_share: float = 1.0

    def __post_init__(self):
        for f in fields(self):
            value = getattr(self, f.name)
            if not (np.isfinite(value) and (value > 0 or f.name == "strips")):
                raise InputError(f"{f.name} = {value:g} mm; expected a finite number above 0")
        for part, whole in (("hinge_length", "length"), ("hinge_width", "width")):
            if getattr(self, part) > getattr(self, whole) * (1 + SAME):
                raise InputError(
                    f"{part} = {getattr(self, part):g} mm is more than {whole} = "
                    f"{getattr(self, whole):g} mm; the hinge lies within its sheet"
                )
        if self.strip_share > 1:
            raise InputError(f"strip_share = {self.strip_share:g}; expected at most 1")

    @classmethod
    def of(
        cls, physical: Mapping[str, float], groups: Mapping[str, float] | None = None
    ) -> Geometry:
        """From SI quantities by name, and strips from ``groups`` where there are any.

        Raises :class:`InputError` that names the sizes that are missing.
        """
        if missing := [name for name in QUANTITIES.values() if name not in physical]:
            raise InputError(
                f"the size is not known: {', '.join(missing)} missing; add --set {missing[0]}=…"
            )
        pattern = {k: groups[k] for k in ("strips", "strip_share") if k in (groups or {})}
        if "strips" in pattern:
            pattern["strips"] = round(pattern["strips"])
        return cls(**{k: float(physical[q]) * MM for k, q in QUANTITIES.items()}, **pattern)

    @property
    def waisted(self) -> bool:
        """Whether the hinge is narrower than its panels."""
        return self.hinge_width < self.width * (1 - SAME)

    @property
    def pitch(self) -> float:
        """From strip to strip, mm; the hinge's width where there is one patch."""
        return self.hinge_width / max(self.strips, 1)

    @property
    def strip(self) -> float:
        """Width of a strip, mm; the hinge's width where there is one patch."""
        return self.pitch * (self.strip_share if self.strips else 1.0)

    @property
    def outline(self) -> np.ndarray:
        """Corners of the sheet, (4, 2), or (12, 2) of a narrow hinge; counterclockwise."""
        L, b, li, bi = (
            v / 2 for v in (self.length, self.width, self.hinge_length, self.hinge_width)
        )
        if not self.waisted:
            return np.array([(-L, -b), (L, -b), (L, b), (-L, b)])
        lower = [(-L, -b), (-li, -b), (-li, -bi), (li, -bi), (li, -b), (L, -b)]
        return np.array([*lower, *((x, -y) for x, y in lower[::-1])])

    @property
    def patches(self) -> np.ndarray:
        """Corners of the active layer's parts, (parts, 4, 2); counterclockwise."""
        x = self.hinge_length / 2 * np.array([-1, 1, 1, -1])
        y = self.strip / 2 * np.array([-1, -1, 1, 1])
        n = max(self.strips, 1)
        centres = (np.arange(n) - (n - 1) / 2) * self.pitch
        return np.stack([np.column_stack([x, y + c]) for c in centres])

    @property
    def areas(self) -> dict[str, float]:
        """Of each layer from above, mm²."""
        return {
            "passive": self.width * (self.length - self.hinge_length)
            + self.hinge_width * self.hinge_length,
            "active": max(self.strips, 1) * self.strip * self.hinge_length,
        }

    @property
    def thicknesses(self) -> dict[str, float]:
        """Of each layer, mm."""
        return {"passive": self.thickness, "active": self.active_thickness}

    @property
    def volumes(self) -> dict[str, float]:
        """Of each layer, mm³."""
        return {layer: area * self.thicknesses[layer] for layer, area in self.areas.items()}

    def facets(self, inside: Sequence[float] = ()) -> tuple[np.ndarray, list[list[int]]]:
        """The sheet as polygons side by side: vertices (n, 2), and vertices of each facet.

        Facets are cut at the ends of the hinge and at the stations ``inside`` (x, mm); they run
        counterclockwise, from low to high x, and share their vertices.
        """
        ends = np.array([self.length, self.hinge_length]) / 2
        stations = np.unique([*inside, *ends, *-ends])
        vertices: list[tuple[float, float]] = []
        columns = []
        for x in stations:
            half = [self.width / 2] if abs(x) >= ends[1] else []
            half += (
                [self.hinge_width / 2] if abs(x) <= ends[1] and (self.waisted or not half) else []
            )
            y = sorted([*(-h for h in half), *half])
            columns.append(range(len(vertices), len(vertices) + len(y)))
            vertices += [(float(x), v) for v in y]
        faces = []
        for (left, low), (right, high) in pairwise(zip(columns, stations, strict=True)):
            hinge = abs(low + high) / 2 < ends[1]
            most = (self.hinge_width if hinge else self.width) / 2 * (1 + SAME)
            a, b = ([v for v in c if abs(vertices[v][1]) <= most] for c in (left, right))
            faces.append([*b, *a[::-1]])
        return np.array(vertices), faces
