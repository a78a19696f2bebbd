"""What following one unit gave: the states kept, the history and how the path ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from foldlab.labels.foldability import measure
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
    def stopped(self) -> bool:
        """Whether it was ended where it was, for more of it would not change the verdict."""
        return self.folding.ending is Ending.STOPPED

    @property
    def timed_out(self) -> bool:
        """Whether the time allowed ended it."""
        return self.folding.ending is Ending.TIMEOUT

    @property
    def measures(self) -> dict[str, float]:
        """Of the last state."""
        names = ("m1", "m2", "m3", "m4", "hinge", "turning_hinge", "turning_ends")
        return {k: self.history[-1][k] for k in names}

    def sensitivity(self) -> dict[str, dict[str, float]] | None:
        """Derivatives of the last state by every group of the unit: of ``m1``, ``m2`` (rad),
        ``tip`` (height of the sheet's end in l_s, over a ground) and ``strain.passive``,
        ``strain.active`` (peak principal strain of each layer).

        At the load of the state, see :func:`solver.cases.unit.sensitivity.neighbours`, which leaves
        out what has none. None with friction, at a critical point, and for a path without an end.
        """
        from solver.cases.unit.sensitivity import neighbours
        from solver.equilibrium.clock import OutOfTime
        from solver.equilibrium.linear import SingularMatrix

        if not self.settled or self.folding.model.physics.friction:
            return None

        last, rates = self.folding.last, {}
        try:
            for side in neighbours(self.folding.model, self.folding.x, last.e):
                low, high = (_measured(*at, last.e) for at in (side.below, side.above))
                for name, value in high.items():
                    rates.setdefault(name, {})[side.group] = (value - low[name]) / side.apart
        except (SingularMatrix, OutOfTime):
            return None
        return rates

    def write_series(self, path: Path) -> list[float]:
        """The whole unit's path as a PVD series for ParaView; its loads, see ``Shape.load``."""
        from solver.cases.unit.output import write_path

        return write_path(path, self.shapes)


def _measured(model, x, e: float) -> dict[str, float]:
    from solver.cases.unit.model import foot
    from solver.cases.unit.strain import strain

    m = measure(model.curves(x, e), model.unit.hinge_length)
    peak = strain(model, x, e)
    out = {"m1": m.m1, "m2": m.m2}
    if model.ground is not None:
        there = model.body.nodes + model.scene.displacement(x, e)
        out["tip"] = float(there[foot(model.body, (0.0, 0.5, 0.0)), 2].item())
    layers = {"strain.passive": peak.passive, "strain.active": peak.active}
    return out | {name: max(layer.tension, -layer.compression) for name, layer in layers.items()}
