"""Paths of one lung on one wedge, each stage followed once however many ask for it."""

from __future__ import annotations

from solver.cases.lung.geometry import Lung
from solver.cases.lung.measures import Measures, Section, measure, section
from solver.cases.lung.mesh import Counts, hexahedra
from solver.cases.lung.model import REST, State, Tissue, run, scene, to_limit
from solver.equilibrium.scene import Scene
from solver.paths.continuation import Path


class Paths:
    """Stages of a lung from rest, on the wedge."""

    def __init__(self, lung: Lung, counts: int | Counts, steps: int):
        """``steps``: load steps of an inflation; a stage that contracts takes twice as many."""
        self.lung, self.steps = lung, steps
        self.body = hexahedra(lung, counts)
        self._known: dict[tuple, tuple[Scene, Path]] = {}

    def stage(self, tissue: Tissue, *states: State) -> tuple[Scene, Path]:
        """The last stage of the path from rest through the states.

        An inflation ends at its limit point, if it has one; a contraction settles. Raises
        ValueError if a stage before the last is not reached.
        """
        key = (tissue, *states)
        if key not in self._known:
            before, x = REST, None
            if len(states) > 1:
                before = states[-2]
                _, done = self.stage(tissue, *states[:-1])
                if not done.reached:
                    raise ValueError(
                        f"the pressure {before.pressure:g} is not reached: the path ends at "
                        f"{before.pressure * done.last.e:.4g} ({done.reason}); take less"
                    )
                x = done.last.x
            made = scene(self.body, self.lung, tissue, before, states[-1])
            bends = states[-1].contraction != before.contraction
            path = run(
                made,
                x,
                steps=(2 if bends else 1) * self.steps,
                events=False,
                over="settle" if bends and tissue.model == "advanced" else None,
            )
            self._known[key] = made, path
        return self._known[key]

    def beyond(self, stage: Scene, path: Path) -> Path:
        """A path of load steps, and on to the limit point ahead; not reached if there is none."""
        ahead = to_limit(stage, path, step=0.3 / self.steps)
        points = (*path.points, *ahead.points[1:])
        return Path(points, ahead.outcome, (), ahead.warnings, ahead.detail)

    def at(self, stage: Scene, point) -> Measures:
        """Measures of a point of any path of this lung."""
        return measure(stage.body, self.lung, stage.displacement(point.x, point.e))

    def along(self, stage: Scene, path: Path) -> list[Measures]:
        """Measures of all points of a path."""
        return [self.at(stage, point) for point in path.points]

    def cut(self, stage: Scene, path: Path) -> Section:
        """The section at the end of a path."""
        return section(self.body, self.lung, stage.displacement(path.last.x, path.last.e))
