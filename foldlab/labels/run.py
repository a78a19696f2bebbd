"""What following one unit gave: the states kept, the history and how the path ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from solver.cases.unit.output import Shape
from solver.cases.unit.path import Ending, Folding


@dataclass(frozen=True, eq=False)
class Run:
    """One path of one design on one mesh.

    ``history``: per state ``contraction``, m1 … m4, ``hinge``, ``unstable``, and over a ground
    ``tip`` and ``lowest`` (heights over h_s). ``closed``: whether it ended at a full turn.
    ``shapes``: what the unit looked like in each of them.
    """

    folding: Folding
    history: list[dict[str, float]]
    closed: bool
    shapes: list[Shape]

    @property
    def settled(self) -> bool:
        """Whether it ended in a stable state that answers the question."""
        return self.folding.ending is Ending.REACHED or self.closed

    @property
    def timed_out(self) -> bool:
        """Whether the time allowed ended it."""
        return self.folding.ending is Ending.TIMEOUT

    @property
    def measures(self) -> dict[str, float]:
        """Of the last state."""
        names = ("m1", "m2", "m3", "m4", "hinge", "turning_hinge", "turning_ends")
        return {k: self.history[-1][k] for k in names}

    def write_series(self, path: Path) -> list[float]:
        """The whole unit's path as a PVD series for ParaView; its loads, see ``Shape.load``."""
        from solver.cases.unit.output import write_path

        return write_path(path, self.shapes)
