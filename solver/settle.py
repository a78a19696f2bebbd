"""A stable path without the search for its critical points: cheap enough for thousands of paths.

:class:`solver.stability.StablePath` follows the arc to each loss of stability and locates it. Here
a load step that fails, or ends in an unstable state, is shortened a few times; then the energy
falls from there to the next stable equilibrium. The loss of stability is known to one step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from solver.arc import Point
from solver.descent import descend
from solver.newton import Outcome, largest
from solver.scene import Scene
from solver.stability import Event
from solver.steppers import LoadSteps


@dataclass(frozen=True)
class Settle:
    """Load steps on a stable path, and the fall to the next one where it ends.

    ``steps``: the load steps. ``cuts``: how often a step is divided (by their ``cut``) before the
    energy falls. ``reach``: see :func:`solver.descent.descend`; ``most``: iterations of the fall at
    a path's beginning. A fall is a ``snap`` where it moves the body by more than ``far``, max|Δu|
    over length, and the tangents at its ends don't explain that; else it is a ``bifurcation`` if it
    left an unstable state, and nothing if Newton's method had only failed. Needs a scene with an
    energy.
    """

    steps: LoadSteps
    cuts: int = 2
    reach: float = 0.1
    far: float = 0.05
    most: int = 600
    _quick: LoadSteps = field(init=False, repr=False)

    def __post_init__(self):
        smallest = 0.9 * self.steps.cut ** -float(self.cuts)
        object.__setattr__(self, "_quick", replace(self.steps, smallest=smallest))

    @property
    def rtol(self) -> float:
        """That of the steps."""
        return self.steps.rtol

    def begin(self, scene: Scene, x: np.ndarray, e: float, sign: float) -> Point | Outcome:
        """First point: the stable equilibrium down the energy from the guess."""
        found = descend(scene, x, e, rtol=self.rtol, reach=self.reach, max_iterations=self.most)
        if not found.converged:
            return found.outcome
        point = self.steps.begin(scene, found.x, e, sign)
        if isinstance(point, Outcome):
            return point
        return replace(point, iterations=point.iterations + found.iterations)

    def resume(self, point: Point, target: float | None) -> Point:
        """The point, set to walk towards the target."""
        return self.steps.resume(point, target)

    def advance(self, scene: Scene, point: Point, target: float | None) -> Point | Outcome:
        """The next stable point."""
        found = self._quick.advance(scene, point, target)
        if isinstance(found, Point) and found.unstable == 0:
            return found
        unstable = isinstance(found, Point)
        spent = found.iterations if unstable else 0
        sign = float(np.sign(target - point.e if target is not None else point.tangent[-1]))
        x, e = (found.x, found.e) if unstable else (point.x, point.e)
        on = self.steps.step / self.steps.cut
        fallen = None
        for share, reach in ((0.0, 1.0), (1.0, 1.0), (2.0, 3.0), (4.0, 10.0)):
            if share == 0.0 and not unstable:
                continue
            load = e + sign * share * on
            if target is not None and (load - target) * sign > 0:
                load = target
            fallen = descend(scene, x, load, rtol=self.rtol, reach=reach * self.reach)
            spent += fallen.iterations
            if fallen.converged:
                break
        if not fallen.converged:
            return fallen.outcome
        begin = scene.energy(point.x, fallen.e)
        after = self.steps._point(scene, point, fallen, spent, self.steps.step / 8)
        if after is None:
            return Outcome.SINGULAR
        shift = np.append(fallen.x - point.x, 0.0)
        size = largest(shift[: scene.n_free]) / scene.scales.length
        events = ()
        snapped = size > self.far and not self.steps._smooth(scene, point, after)
        if unstable or snapped:
            kind = "snap" if snapped else "bifurcation"
            count = found.unstable if unstable else None
            drop = 0.0 if begin is None else float(begin - after.energy)
            events = (
                Event(
                    kind, fallen.e, fallen.x, shift[:-1], 1.0, (count, after.unstable),
                    size=size, energy_drop=drop,
                ),
            )  # fmt: skip
        return replace(after, events=events, history=())
