"""The curves C1 … C4 of physics.md §6 on a mesh of a folding unit, by which its shape is judged."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solver.cases.unit.unit import Unit
from solver.mesh.body import Body


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
