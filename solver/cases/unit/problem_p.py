"""Problem P: the folding unit of Table 4.1 without weight, the reference of mesh and path.

A passive sheet |x| ≤ b/2, |y| ≤ ½, 0 ≤ z ≤ h_s with an active layer of 5 h_s on top for |y| ≤ 0.1;
lengths in units of the sheet's length l_s, stresses in units of E_s. The stress is singular where
the active layer ends; the mesh is graded towards that corner along y and z, and long elsewhere.
Converged fold angle at g = −0.3: 3.772 rad (uniaxial). Contracting in all directions from flat the
hinge curls about the other axis and waves run far into the panels: 0.493 rad, on which hex27, hex20
and tet10 agree within 1 % once elements in the panels are short too (long ones give up to 0.69).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.cases.levels import sizes_of
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box, growing, joined
from solver.physics.elastic import Elastic
from solver.physics.growth import Isotropic, Orthotropic
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, rotation_row, translation_row

WIDTH = 0.2  # b_s/l_s = b_i/l_s
HINGE = 0.2  # l_i/l_s
PASSIVE = 4e-3  # h_s/l_s
ACTIVE = 5 * PASSIVE  # h_i/l_s
E_ACTIVE = 0.1  # E_i/E_s
NU = 0.3
ANGLE = 3.772  # rad at g = −0.3, uniaxial
ANGLE_ISOTROPIC = 0.493  # rad at g = −0.3 from flat, ± 0.002


@dataclass(frozen=True)
class Counts:
    """Sizes of a mesh: shortest step along y (at the corner), factor from step to step, longest
    step in the hinge, layers' positions as fractions of the thickness, elements across half the
    width, longest step in the panels.
    """

    first: float
    factor: float
    longest: float
    passive: tuple[float, ...]
    active: tuple[float, ...]
    across: int = 1
    panel: float = 0.4


LEVELS = (
    Counts(2e-3, 3, 0.05, (0, 1), (0, 1)),
    Counts(1e-3, 3, 0.025, (0, 0.6, 1), (0, 0.1, 0.4, 1)),
    Counts(5e-4, 3, 0.025, (0, 0.5, 0.8, 1), (0, 0.05, 0.2, 0.5, 1)),
    Counts(2.5e-4, 2, 0.0125, (0, 0.5, 0.8, 0.95, 1), (0, 0.02, 0.06, 0.2, 0.5, 1)),
)

# For isotropic contraction: corner and thickness matter little, width and panels do.
LEVELS_ISOTROPIC = (
    Counts(2e-3, 2, 0.025, (0, 1), (0, 1), across=6, panel=0.04),
    Counts(2e-3, 2, 0.025, (0, 1), (0, 1), across=8, panel=0.03),
    Counts(2e-3, 2, 0.0125, (0, 1), (0, 1), across=12, panel=0.02),
)


def mesh(
    level: int | Counts = 1, element: str = "hex27", *, quarter: bool = True, bent: bool = True
) -> Body:
    """Body with sub-domains "passive" and "active".

    ``level`` picks the sizes from :data:`LEVELS`, or gives them. ``quarter=False`` gives the whole
    unit with the same elements. hex27 takes two points along y (``bent``). Raises ValueError for a
    level that is not there and for what the builders and Body.build refuse.
    """
    level = sizes_of(level, LEVELS)
    x = np.linspace(0, WIDTH / 2, level.across + 1)
    half = HINGE / 2
    y = joined(
        half - growing(half, level.first, level.factor, level.longest)[::-1],
        half + growing(0.5 - half, level.first, level.factor, level.panel),
    )
    z = joined(PASSIVE * np.array(level.passive), PASSIVE + ACTIVE * np.array(level.active))
    if not quarter:
        x, y = joined(-x[::-1], x), joined(-y[::-1], y)
    grid = box(
        x,
        y,
        z,
        keep=lambda X: (X[:, 2] < PASSIVE) | (np.abs(X[:, 1]) < half),
        layers={"passive": lambda X: X[:, 2] < PASSIVE, "active": lambda X: X[:, 2] > PASSIVE},
        tets=element.startswith("tet"),
    )
    return Body.build(grid, element, bent=1 if bent and element == "hex27" else None)


def scene(
    body: Body,
    g: float = -0.3,
    *,
    growth: str = "uniaxial",
    supported: bool = False,
    linear: str = "auto",
) -> Scene:
    """Contraction e·g of the active layer, along y (``uniaxial``) or in all directions.

    A quarter is held by its mirror planes x = 0 and y = 0, and one node along z; the whole unit by
    rows against rigid motion, or (``supported``) by six components of three nodes, as conjugate
    gradients need it for linear elements. Raises ValueError for another growth.
    """
    active = body.cells_where(lambda X: X[:, 2] > PASSIVE)
    if growth == "uniaxial":
        Fg = Orthotropic([0.0, lambda e: e * g, 0.0], cells=active)
    elif growth == "isotropic":
        Fg = Isotropic(lambda e: e * g, cells=active)
    else:
        raise ValueError(f"growth {growth!r}; expected 'uniaxial' or 'isotropic'")
    term = Elastic(body, NeoHookean(np.where(active, E_ACTIVE, 1.0), NU), Fg)
    X = body.nodes
    if X[:, 1].min() < -1e-9 and supported:
        corners = [(-WIDTH / 2, -0.5, 0), (WIDTH / 2, -0.5, 0), (-WIDTH / 2, 0.5, 0)]
        a, b, c = (np.flatnonzero(np.abs(X - at).max(axis=1) < 1e-9) for at in corners)
        held = [(a, 0), (a, 1), (a, 2), (b, 1), (b, 2), (c, 2)]
        fixed = [Fixed(node, np.eye(3)[axis]) for node, axis in held]
        return Scene(body, [term], fixed=fixed, linear=linear)
    if X[:, 1].min() < -1e-9:
        rows = [make(body, axis) for make in (translation_row, rotation_row) for axis in range(3)]
        return Scene(body, [term], rows=rows, linear=linear)
    on = [np.flatnonzero(np.abs(X[:, axis]) < 1e-12) for axis in (0, 1)]
    foot = np.flatnonzero(np.abs(X).max(axis=1) < 1e-12)
    fixed = [Fixed(on[0], [1, 0, 0]), Fixed(on[1], [0, 1, 0]), Fixed(foot, [0, 0, 1])]
    return Scene(body, [term], fixed=fixed, linear=linear)


def fold_angle(scene: Scene, x: np.ndarray, e: float) -> float:
    """Turning of the sheet from end to end on x = 0 in rad, between 0 and 2π for one half."""
    X = scene.body.nodes
    deformed = X + scene.displacement(x, e)
    turns = []
    for end in (0.5, -0.5):
        face = np.flatnonzero((np.abs(X[:, 1] - end) < 1e-9) & (np.abs(X[:, 0]) < 1e-9))
        if len(face):
            face = face[np.argsort(X[face, 2])]
            d = deformed[face[-1]] - deformed[face[0]]
            turns.append(np.arctan2(-d[1], d[2]))
    if len(turns) == 1:
        return float(2 * (turns[0] % (2 * np.pi)))
    return float((turns[0] - turns[1]) % (2 * np.pi))
