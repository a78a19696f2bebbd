"""Meshes of the folding unit: structured hexahedra whose counts follow from design and accuracy.

The stress is singular where the active layer ends and at the free edges of the interface; steps
shrink geometrically towards them. Elsewhere an element turns by no more than a set angle. And the
curves C1 … C4 of physics.md §6 on a mesh, by which a unit's shape is judged.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from solver.cases.levels import sizes_of
from solver.cases.unit.unit import Unit
from solver.mesh.body import Body
from solver.mesh.structured import box, growing, joined


@dataclass(frozen=True)
class Sizes:
    """What fixes a mesh.

    ``corner``: shortest step at the end of the active layer, over the thinner layer's thickness;
    ``factor``: from step to step; ``turn``: rad that an element of the hinge turns by at most;
    ``layered``: whether layers are graded towards their interface or are one element each;
    ``panel``: longest element of a panel, over the length in which weight bends it; ``across``:
    number of elements over half the hinge's width, at least one more where it may curl.
    """

    corner: float
    factor: float
    turn: float
    layered: float
    panel: float
    across: int


LEVELS = (
    Sizes(0.5, 3, 0.8, 0.0, 1.5, 1),
    Sizes(0.25, 3, 0.5, 0.5, 1.0, 1),
    Sizes(0.125, 3, 0.35, 0.125, 0.5, 2),
    Sizes(0.0625, 2, 0.25, 0.125, 0.35, 3),
)


def mesh(
    unit,
    level: int | Sizes,
    *,
    mirrors: tuple[str, ...],
    element: str = "hex27",
    curls: bool = False,
    heavy: bool = True,
) -> Body:
    """Body with sub-domains "passive" and "active"; ``level`` picks from :data:`LEVELS`.

    ``curls``: whether the hinge may curl about the sheet's axis; ``heavy``: whether weight bends
    the panels. Raises ValueError for a level or mirror plane that is not there.
    """
    level = sizes_of(level, LEVELS)
    if not set(mirrors) <= {"x", "y"}:
        raise ValueError(f"mirrors {mirrors}; expected some of 'x' and 'y'")
    h, top, half = unit.slenderness, unit.active, unit.hinge_length / 2
    first = level.corner * min(h, top)
    # Past a full turn of the fold no path is followed.
    turning = min(unit.fold_angle / 2, np.pi)
    longest = half / max(np.ceil(turning / level.turn), 2)
    y = joined(
        half - growing(half, first, level.factor, longest)[::-1],
        half + growing(0.5 - half, first, level.factor, _panel(unit, level, curls, heavy)),
    )
    x, solid = _across(unit, level, curls)
    start = level.layered * min(h, top)
    below = h - growing(h, start, level.factor)[::-1] if level.layered else np.array([0, h])
    above = h + growing(top, start, level.factor) if level.layered else np.array([h, h + top])
    z = joined(below, above)
    if "x" not in mirrors:
        x = joined(-x[::-1], x)
    if "y" not in mirrors:
        y = joined(-y[::-1], y)
    width = unit.width / 2

    def kept(X):
        inside = (np.abs(X[:, 1]) < half) & (np.abs(X[:, 0]) < width)
        panel = np.abs(X[:, 1]) > half
        return np.where(X[:, 2] > h, inside & solid(np.abs(X[:, 0])), inside | panel)

    grid = box(
        x,
        y,
        z,
        keep=kept,
        layers={"passive": lambda X: X[:, 2] < h, "active": lambda X: X[:, 2] > h},
        tets=element.startswith("tet"),
    )
    return Body.build(grid, element, bent=1 if element == "hex27" else None)


def tetrahedra(unit, c: float, *, mirrors: tuple[str, ...], element: str = "tet10") -> Body:
    """Body of Gmsh's tetrahedra of size c·h, h the local layer's thickness (§4.3.1).

    Sub-domains as in :func:`mesh`. Raises ImportError where Gmsh can't be loaded, ValueError for a
    hinge of strips, a c that is not positive and elements that are no tetrahedra.
    """
    from solver.mesh.gmsh_model import Model  # its wheel needs libraries that bare machines lack

    if unit.strips:
        raise ValueError("strips are meshed by hexahedra only; leave grading out")
    if element not in ("tet4", "tet10"):
        raise ValueError(f"element {element!r} with grading; expected 'tet4' or 'tet10'")
    h, half, width, wide = unit.slenderness, unit.hinge_length / 2, unit.width / 2, unit.aspect / 2

    with Model("unit") as model:

        def block(x: float, low: float, high: float, z: float, up: float) -> int:
            start_x = 0.0 if "x" in mirrors else -x
            corners = [(start_x, low, z), (x, low, z), (x, high, z), (start_x, high, z)]
            return model.extrude(model.polygon(corners), (0, 0, up)).volume

        start = 0.0 if "y" in mirrors else -half
        passive = [block(width, start, half, 0, h), block(wide, half, 0.5, 0, h)]
        if "y" not in mirrors:
            passive.append(block(wide, -0.5, -half, 0, h))
        model.subdomain("passive", passive)
        model.subdomain("active", [block(width, start, half, h, unit.active)])
        model.glue()
        sizes = {"passive": h, "active": unit.active}
        grid = model.tetrahedra(c, sizes, order=2 if element == "tet10" else 1)
    return Body.build(grid, element)


def _panel(unit, level: Sizes, curls: bool, heavy: bool) -> float:
    """Longest element of a panel along y."""
    longest = 0.4
    if heavy:
        # Length over which weight bends a sheet: (B/w)^⅓ with B = h³/12 and w = h³/Γ.
        longest = min(0.2, level.panel * (unit.stiffness_to_weight / 12) ** (1 / 3) / 2)
    if curls:
        # What curls across the hinge dies away in the panel over the hinge's width.
        longest = min(longest, level.panel * unit.width / 3)
    return longest


def _across(unit, level: Sizes, curls: bool):
    """x coordinates of the half x ≥ 0, and the test of |x| for the active layer."""
    half = unit.width / 2
    n = level.across
    if curls:
        turning = min(unit.curvature * half, np.pi)
        n = max(n + 1, int(np.ceil(turning / level.turn)))
    if unit.strips:
        # Strips and gaps alternate, a gap of half the width at each edge of the hinge.
        pitch = unit.width / unit.strips
        strip = unit.strip_share * pitch
        centres = (np.arange(unit.strips) - (unit.strips - 1) / 2) * pitch
        edges = np.concatenate([centres - strip / 2, centres + strip / 2])
        edges = np.unique(np.round(np.concatenate([[0.0, half], edges[edges > 1e-12]]), 12))
        edges = edges[edges <= half * (1 + 1e-9)]
        edges[-1] = half
        x = edges[:1]
        for low, high in pairwise(edges):
            x = joined(x, np.linspace(low, high, int(np.ceil((high - low) * n / half - 1e-9)) + 1))

        def solid(ax):
            return (np.abs(ax[:, None] - np.abs(centres)) < strip / 2).any(axis=1)
    else:
        # Towards the free edge, whose boundary layer is about as wide as the hinge is thick.
        thick = unit.slenderness + unit.active
        first = max(min(thick, half / n), half / (3 * n)) if n > 1 else half
        x = half - growing(half, first, 3.0, half / max(n - 1, 1))[::-1]

        def solid(ax):
            return np.ones(len(ax), bool)

    wide = unit.aspect / 2
    if wide > half * (1 + 1e-9):
        x = joined(x, half + growing(wide - half, max(half, 0.1), 3.0))
    return x, solid


@dataclass(frozen=True, eq=False)
class Curves:
    """Where the curves run in a body that is a unit or what ``mirrors`` (or a turn) keep of one.

    On the passive layer's mid-plane: x = 0 along y, y = 0 along x within the hinge's width, and
    x = ±b_i/2 along y.
    """

    unit: Unit
    body: Body
    mirrors: tuple[str, ...]

    @cached_property
    def _interpolations(self):
        h, half = self.unit.slenderness / 2, self.unit.width / 2
        # An even number of points: none on a mirror plane, none twice.
        s, across = np.linspace(-0.5, 0.5, 1000), np.linspace(-half, half, 1000)
        if "x" in self.mirrors:
            across = across[500:]
        if self.mirrors and self.mirrors != ("x",):
            s = s[500:]

        def along(x):
            return np.stack([np.full(len(s), x), s, np.full(len(s), h)], axis=1)

        lines = [along(0.0), np.stack([across, 0 * across, 0 * across + h], axis=1), along(half)]
        if "x" not in self.mirrors:
            lines.append(along(-half))
        # A hair inside of the body, whatever rounding did to its edges.
        return [self.body.interpolation(line * (1 - 1e-9)) for line in lines]

    def of(self, deformed: np.ndarray) -> np.ndarray:
        """Positions (4, 1000, 3) where the nodes are at ``deformed`` (nodes, 3), lengths in l_s."""
        curves = [m @ deformed for m in self._interpolations]
        if "x" in self.mirrors:
            curves[1] = np.vstack([(curves[1] * (-1, 1, 1))[::-1], curves[1]])
            curves.append(curves[2] * (-1, 1, 1))
        if "y" in self.mirrors:
            for k in (0, 2, 3):
                curves[k] = np.vstack([(curves[k] * (1, -1, 1))[::-1], curves[k]])
        if "turn" in self.mirrors:
            beyond = [(curves[k] * (-1, -1, 1))[::-1] for k in (0, 1, 3, 2)]
            for k in (0, 2, 3):
                curves[k] = np.vstack([beyond[k], curves[k]])
        return np.stack(curves)
