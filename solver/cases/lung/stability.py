"""Unstable modes of the whole sphere from its wedge.

The state has the symmetry of the icosahedron; the modes that break it need not. The coordinate
planes are three of its mirrors, and every mode of the whole sphere is a sum of modes that are even
or odd about each of them: eight classes, each a problem on the octant with its own supports. The
threefold axis (1, 1, 1) turns the planes into each other, so that four classes remain:

    even about all three, once      odd about one, three times (with one rigid translation each)
    odd about all three, once       odd about two, three times (with one rigid rotation each)

The counts times those numbers are the unstable modes of the whole sphere, exactly those that a
factorisation of its whole stiffness would count.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from solver.cases.lung.geometry import fold
from solver.cases.lung.model import part_of
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.physics.supports import Fixed

# Planes about which a mode is odd, and how many classes are like it.
CLASSES = {
    "even": ((), 1),
    "odd in one": ((0,), 3),
    "odd in two": ((0, 1), 3),
    "odd in three": ((0, 1, 2), 1),
}


def spread(wedge: Body, u: np.ndarray, other: Body) -> np.ndarray:
    """The displacement u (n, 3) of a wedge on a larger part of the same elements.

    Raises ValueError where a node of the other body has no image in the wedge.
    """
    Y, Q = fold(other.nodes)
    gap, node = cKDTree(wedge.nodes).query(Y)
    if gap.max() > 1e-8:
        raise ValueError(
            f"{int((gap > 1e-8).sum())} nodes have no image in the wedge; build both parts with "
            "the same counts and element"
        )
    return np.einsum("nji,nj->ni", Q, u[node])


class Classes:
    """Counts the unstable modes of icosahedral states of one stage."""

    def __init__(self, octant: Scene):
        """``octant``: the stage's scene on the octant. Raises ValueError for another part."""
        body = octant.body
        if part_of(body) != "octant":
            raise ValueError(f"expected a scene on the octant, not on the {part_of(body)}")
        self.octant = octant
        X = body.nodes
        on = [np.flatnonzero(np.abs(X[:, k]) < 1e-9) for k in range(3)]
        outer = np.linalg.norm(X, axis=1) > 1 - 1e-9
        self.scenes = {}
        for name, (odd, _) in CLASSES.items():
            fixed = []
            for plane in range(3):
                held = [k for k in range(3) if (k == plane) != (plane in odd)]
                fixed += [Fixed(on[plane], np.eye(3)[k]) for k in held]
            # A rigid motion that the class allows costs nothing: holding one component of one node
            # takes it out and leaves all other signs.
            far = np.flatnonzero(outer)[np.argmax(X[outer, 0])]
            if len(odd) == 1:
                fixed.append(Fixed(np.array([far]), [1.0, 0, 0]))
            elif len(odd) == 2:
                fixed.append(Fixed(np.array([far]), [0, 1.0, 0]))
            self.scenes[name] = Scene(body, octant.terms, fixed=fixed, scales=octant.scales)

    def count(self, wedge: Body, u: np.ndarray, e: float) -> dict[str, int | None]:
        """Unstable modes of each class, all its likes counted, at the wedge's state u (n, 3).

        None where the linear solver could not count.
        """
        stiffness = self.octant.evaluate(spread(wedge, u, self.octant.body), e).stiffness
        out = {}
        for name, (_, times) in CLASSES.items():
            unstable = self.scenes[name].system_of(stiffness).unstable
            out[name] = None if unstable is None else times * unstable
        return out


def total(counts: dict[str, int | None]) -> int | None:
    """Unstable modes of the whole sphere; None if a class was not counted."""
    return None if None in counts.values() else sum(counts.values())
