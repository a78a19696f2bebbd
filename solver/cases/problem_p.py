"""Problem P: the folding unit of Table 4.1 without weight, the reference of mesh and path.

A passive sheet |x| ≤ b/2, |y| ≤ ½, 0 ≤ z ≤ h_s with an active layer of 5 h_s on top for |y| ≤ 0.1;
lengths in units of the sheet's length l_s. The mesh is graded in y toward the end of the active
layer, where the shear lag is the slow part of convergence.
"""

from __future__ import annotations

import numpy as np

from solver.body import Body
from solver.meshes import box, graded, joined

WIDTH = 0.2  # b_s/l_s = b_i/l_s
HINGE = 0.2  # l_i/l_s
PASSIVE = 4e-3  # h_s/l_s
ACTIVE = 5 * PASSIVE  # h_i/l_s

# Elements across half the width, along half the hinge, along a panel, through each layer; the
# longest step along y over the shortest.
LEVELS = (
    ((1, 6, 5, 1), 10.0),
    ((1, 10, 8, 1), 20.0),
    ((1, 16, 12, 2), 40.0),
    ((2, 28, 20, 3), 80.0),
)


def mesh(
    level: int = 1,
    element: str = "hex27",
    *,
    counts: tuple[int, int, int, int] | None = None,
    ratio: float | None = None,
    quarter: bool = True,
) -> Body:
    """Body with sub-domains "passive" and "active"; the quarter has boundaries "x=0" and "y=0".

    ``level`` picks the element counts of the quarter model, ``counts`` (half the width, half the
    hinge, a panel, each layer) and ``ratio`` (longest over shortest step along y) override them.
    ``quarter=False`` gives the whole unit with the same elements. Raises ValueError for a level
    that is not there and for what the builders and Body.build refuse.
    """
    if level not in range(len(LEVELS)):
        raise ValueError(f"level {level}; there are 0 to {len(LEVELS) - 1}, or give counts")
    (nx, hinge, panel, layer), grading = LEVELS[level]
    nx, hinge, panel, layer = counts or (nx, hinge, panel, layer)
    grading = grading if ratio is None else ratio
    x = np.linspace(0, WIDTH / 2, nx + 1)
    y = joined(
        graded(0, HINGE / 2, hinge, toward="b", ratio=grading),
        graded(HINGE / 2, 0.5, panel, toward="a", ratio=grading),
    )
    z = joined(
        np.linspace(0, PASSIVE, layer + 1), np.linspace(PASSIVE, PASSIVE + ACTIVE, layer + 1)
    )
    planes = {"x=0": lambda X: X[:, 0] == 0, "y=0": lambda X: X[:, 1] == 0}
    if not quarter:
        x, y, planes = joined(-x[::-1], x), joined(-y[::-1], y), None
    grid = box(
        x,
        y,
        z,
        keep=lambda X: (X[:, 2] < PASSIVE) | (np.abs(X[:, 1]) < HINGE / 2),
        layers={"passive": lambda X: X[:, 2] < PASSIVE, "active": lambda X: X[:, 2] > PASSIVE},
        boundaries=planes,
        tets=element.startswith("tet"),
    )
    return Body.build(grid, element)
