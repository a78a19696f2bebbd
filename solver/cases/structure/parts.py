"""What a structure is made of as rigid parts and hinges between them.

Without weight every panel is a part and every crease a hinge. With weight a hinge may rest on the
ground with its middle line, which is a part of its own then, between two halves of the hinge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.cases.structure.hinges import Law, Layer
from solver.cases.structure.pattern import Hinge, Pattern, area_of, triangles


@dataclass(frozen=True, eq=False)
class Structure:
    """What is folded: ``sheet``, and on each hinge of ``pattern`` a layer of ``layers`` (one for
    all, or one per crease; None: the sheet alone) with its ``laws``.

    ``g``: the acceleration of gravity. Raises ValueError for what does not fit together.
    """

    pattern: Pattern
    sheet: Layer
    layers: tuple[Layer | None, ...]
    laws: tuple[Law, ...]
    g: float = 9.81
    nu: float = 0.3

    @classmethod
    def of(
        cls,
        pattern: Pattern,
        sheet: Layer,
        layer: Layer | Sequence[Layer | None],
        *,
        g: float = 9.81,
        nu: float = 0.3,
    ) -> Structure:
        """With the laws of bilayer sections; creases that don't fold have no layer."""
        count = len(pattern.hinges)
        if not count:
            raise ValueError("the pattern has no creases, so nothing folds; give at least one")
        layers = (layer,) * count if isinstance(layer, Layer) else tuple(layer)
        if len(layers) != count:
            raise ValueError(f"{len(layers)} layers for {count} creases; expected one, or one each")
        layers = tuple(
            own if h.crease.fold else None for own, h in zip(layers, pattern.hinges, strict=True)
        )
        known: dict = {}
        laws = []
        for hinge, own in zip(pattern.hinges, layers, strict=True):
            key = own, hinge.crease.length, round(hinge.width, 12)
            if key not in known:
                size = key[1], hinge.width, nu
                bare = own is None
                known[key] = (
                    Law.of_sheet(sheet, *size) if bare else Law.of_section(sheet, own, *size)
                )
            laws.append(known[key])
        return cls(pattern, sheet, layers, tuple(laws), g, nu)

    @property
    def bending(self) -> float:
        """B of the sheet per width."""
        return self.sheet.E * self.sheet.h**3 / (12 * (1 - self.nu**2))

    def sag(self, panel: int) -> float:
        """Angle that the far edge of a panel would turn by under its weight, clamped at the hinge
        that it reaches farthest from, rad: q L³ / 6 B."""
        load = self.sheet.rho * self.sheet.h * self.g
        reach = 0.0
        for hinge in self.pattern.hinges:
            for face, side, way in zip(hinge.faces, hinge.sides, (-1, 1), strict=True):
                if face == panel:
                    across = way * np.array([-hinge.axis[1], hinge.axis[0]])
                    reach = max(reach, ((self.pattern.panels[face] - side) @ across).max())
        return float(load * reach**3 / (6 * self.bending))

    def weight_per_area(self, hinge: int) -> float:
        """Mass per area of a hinge's strip, both layers."""
        layer, sheet = self.layers[hinge], self.sheet
        return sheet.rho * sheet.h + (0.0 if layer is None else layer.rho * layer.h)


@dataclass(frozen=True, eq=False)
class Parts:
    """``outlines``: of each panel, (k, 2); ``lines``: middle line of each hinge, ends (2, 2), parts
    numbered after the panels; ``hinges`` between parts, their ``laws``, and how many of them make
    one ``crease``; ``mass`` (k,) and ``where`` (k, 3): of which part, x and y.
    """

    outlines: tuple[np.ndarray, ...]
    lines: tuple[np.ndarray, ...]
    hinges: tuple[Hinge, ...]
    laws: tuple[Law, ...]
    crease: int
    mass: np.ndarray
    where: np.ndarray

    @property
    def count(self) -> int:
        """Of parts, middle lines among them."""
        return len(self.outlines) + len(self.lines)

    @classmethod
    def of(cls, structure: Structure, heavy: bool) -> Parts:
        """Of a structure, ``heavy``: with weight and ground."""
        outlines, hinges = structure.pattern.panels, structure.pattern.hinges
        halves, lines = [], []
        for hinge in hinges if heavy else ():
            (a, b), (at_a, at_b) = hinge.faces, hinge.sides
            middle, line = hinge.sides.mean(axis=0), len(outlines) + len(lines)
            off = hinge.width / 2 * hinge.axis
            lines.append(np.stack([middle - off, middle + off]))
            halves.append(replace(hinge, faces=(a, line), sides=np.stack([at_a, middle])))
            halves.append(replace(hinge, faces=(line, b), sides=np.stack([middle, at_b])))
        laws, between = structure.laws, hinges
        if heavy:
            laws, between = tuple(law.half for law in laws for _ in range(2)), tuple(halves)
        mass, where = _masses(structure, between, heavy)
        return cls(outlines, tuple(lines), between, laws, 2 if heavy else 1, mass, where)

    def underside(self, structure: Structure) -> tuple[list[int], list[np.ndarray]]:
        """Parts and places (3,) that may touch the ground: corners, and ends of middle lines, below
        a layer that lies below."""
        h, owners, places = structure.sheet.h, [], []
        for k, outline in enumerate(self.outlines):
            owners += [k] * len(outline)
            places += [np.array([*X, -h / 2]) for X in outline]
        for k, ends in enumerate(self.lines):
            layer, fold = structure.layers[k], structure.pattern.hinges[k].crease.fold
            below = layer.h if layer is not None and fold < 0 else 0.0
            owners += [len(self.outlines) + k] * 2
            places += [np.array([*X, -h / 2 - below]) for X in ends]
        return owners, places


def _masses(structure: Structure, hinges, heavy: bool) -> tuple[np.ndarray, np.ndarray]:
    """Masses (k,) and (k, 3): whose, x and y. A strip's mass lies at the ends of its halves."""
    mass, where = [], []
    sheet = structure.sheet.rho * structure.sheet.h
    for k, outline in enumerate(structure.pattern.panels):
        for t in triangles(outline):
            mass.append(sheet * area_of(outline[t]))
            where.append((k, *outline[t].mean(axis=0)))
    halves = 2 if heavy else 1
    for k, hinge in enumerate(hinges):
        own = hinge.crease.length * hinge.width / halves * structure.weight_per_area(k // halves)
        for part, side in zip(hinge.faces, hinge.sides, strict=True):
            mass.append(own / 2)
            where.append((part, *side))
    return np.array(mass), np.array(where)
