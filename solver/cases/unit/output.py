"""The path of a folding unit as files for ParaView: always of the whole unit.

A path may begin on a quarter, go on without a mirror plane and end on a finer mesh. Each state is
written on the whole mesh that belongs to the one it was solved on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver.cases.unit.model import Model, build, images
from solver.cases.unit.path import State
from solver.output import Series, cell_fields


@dataclass(frozen=True, eq=False)
class Shape:
    """A state of a model and its unknowns."""

    model: Model
    x: np.ndarray
    state: State

    @property
    def load(self) -> float:
        """e, and 1 + e along a release after it."""
        return float(self.state.e) + (self.model.growth == "release")


def write_path(path: str | Path, shapes: Sequence[Shape]) -> list[float]:
    """Writes a .pvd of all shapes in order with displacement, layers and the fields of
    :func:`solver.output.cell_fields`; returns the loads in it.

    Raises what :class:`solver.output.Series` raises.
    """
    model = series = None
    for shape in shapes:
        if shape.model is not model:
            model = shape.model
            whole = model
            near, signs = slice(None), 1.0
            if model.mirrors or model.watch.clock is not None:
                # Without what needs a mirror plane, a limit or a watch: the fields are the same.
                effects = tuple(t for t in model.physics.effects if t != "contact")
                physics = replace(model.physics, effects=effects)
                supports = replace(model.supports, mirrors=())
                whole = build(model.unit, model.meshing, physics, supports)
                near, signs = images(model.body, whole.body, model.mirrors)
            series = Series(path, whole.body, resume=series is not None)
        e = shape.state.e
        u = signs * model.scene.displacement(shape.x, e)[near]
        series.write(shape.load, u, cell_data=cell_fields(whole.body, u, whole.terms, e))
    return [] if series is None else series.loads
