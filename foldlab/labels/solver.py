"""Label sources. The only foldlab file that may import ``solver``, and only on request."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd

from foldlab.design import FULL, DesignSpace
from foldlab.errors import InputError
from foldlab.labels import screening
from foldlab.labels import verdict as judging
from foldlab.labels.foldability import Thresholds
from foldlab.labels.label import Label
from foldlab.labels.memory import forget_peak
from foldlab.labels.run import Run
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.settings import call

if TYPE_CHECKING:
    from solver.cases.unit.output import Shape
    from solver.cases.unit.path import State
    from solver.cases.unit.unit import Unit


@dataclass(frozen=True)
class Plan:
    """What an asked accuracy chooses: the finest of the meshes 0, 1, …, rad that the fold turns by
    in a step, and the tolerance of Newton's method."""

    finest: int
    turn: float = 0.5
    tolerance: float = 1e-6
    element: str = "hex27"


# By the accuracy from which on they hold. Below 0.01 the path's mesh counts for nothing, and the
# error is that of two finer ones. Longer steps and looser tolerances save little: on 14 designs the
# median was 1.6, 1.5 and 2.1 core-seconds at 0.5 rad and 1e-6, 0.7 and 1e-5, 1.0 and 1e-4.
PLANS = {0.01: Plan(2), 0.0: Plan(3)}

EFFECTS = ("gravity,ground", "gravity,ground,contact", "contact", "none")


class SolverSource:
    """Labels from the finite-strain solver, with weight and ground or without.

    ``accuracy``: error that is asked for, of the fold angle and of the turning across the hinge,
    relative to the angle or to what counts as folded (|g|π), whichever is larger; meshes are
    refined until two of them agree so well, at most to the third, below 0.01 to the fourth.
    ``effects``: one of :data:`EFFECTS`; "contact" is that of the panels with each other.
    ``growth``: "uniaxial" or "isotropic". ``question``: "from_flat", or "exists": is there a folded
    stable state, approached by uniaxial contraction and then released to isotropic? ``upright``:
    whether the unit is held against toppling. ``timeout``: seconds per label, after which it is
    unknown. ``seed``: follow noisy steps (§4.3.3) on the whole unit instead of testing symmetric
    ones. ``strips``: active strips side by side along the hinge that cover ``strip_share`` of its
    width (0: a solid layer). ``barrier``: the ground's, "surface" or the dissertation's
    "exponential" (Eq. 4.5). ``refine``: "always"; "near" a threshold only and where the coarsest
    path is in doubt, see :mod:`foldlab.labels.screening`; or "never". What is not refined states an
    error that was calibrated on other designs.

    Without "contact" panels pass through each other, as in the dissertation; a path ends where the
    fold has made a full turn, and where the hinge has curled through half a turn about the other
    axis.
    """

    name = "solver"
    thresholds = Thresholds()

    def __init__(
        self,
        space: DesignSpace = FULL,
        accuracy: float = 0.02,
        effects: str = "gravity,ground",
        growth: Literal["uniaxial", "isotropic"] = "uniaxial",
        question: Literal["from_flat", "exists"] = "from_flat",
        upright: bool = True,
        timeout: float = 60.0,
        seed: int | None = None,
        strips: int = 0,
        strip_share: float = 0.5,
        barrier: Literal["surface", "exponential"] = "surface",
        refine: Literal["always", "near", "never"] = "always",
    ):
        known = {"uniaxial", "isotropic"}
        if growth not in known:
            raise InputError(f"growth {growth!r}; expected one of {', '.join(sorted(known))}")
        if question not in ("from_flat", "exists"):
            raise InputError(f"question {question!r}; expected 'from_flat' or 'exists'")
        if question == "exists" and growth != "isotropic":
            raise InputError(
                "question 'exists' is about isotropic contraction; set growth=isotropic"
            )
        if effects not in EFFECTS:
            raise InputError(
                f"effects {effects!r}; expected one of {', '.join(map(repr, EFFECTS))}: weight and "
                "ground come together"
            )
        if barrier not in ("surface", "exponential"):
            raise InputError(f"barrier {barrier!r}; expected 'surface' or 'exponential'")
        if refine not in ("always", "near", "never"):
            raise InputError(f"refine {refine!r}; expected 'always', 'near' or 'never'")
        usual = growth == "uniaxial" and effects == "gravity,ground" and upright and seed is None
        if refine != "always" and not (usual and strips == 0 and barrier == "surface"):
            raise InputError(
                f"refine {refine!r} needs a known error of the coarsest mesh, and it was measured "
                "for uniaxial contraction of solid upright units with weight, without contact; "
                "take 'always'"
            )
        for name, value in (("accuracy", accuracy), ("timeout", timeout)):
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} = {value!r}; expected a finite number above 0")
        if space.name != "full":
            raise InputError(
                f"the solver needs a whole unit, and space {space.name!r} has only "
                f"{', '.join(space.names)}; sample with --space full"
            )
        self.space = FULL
        self.accuracy, self.effects, self.growth = float(accuracy), effects, growth
        self.question, self.upright, self.timeout = question, bool(upright), float(timeout)
        self.seed, self.barrier, self.refine = seed, barrier, refine
        self.strips, self.strip_share = strips, float(strip_share)
        parts = ["3", growth, effects.replace(",", "+"), f"{accuracy:g}"]
        parts += ["exists"] * (question == "exists") + ["falls"] * (not upright)
        parts += [f"noise{seed}"] * (seed is not None) + [f"strips{strips}x{strip_share:g}"] * (
            strips > 0
        )
        parts += [barrier] * (barrier != "surface")
        parts += [f"{refine}{screening.COARSE_ERROR:g}"] * (refine != "always")
        self.version = "-".join(parts)

    @property
    def terms(self) -> tuple[str, ...]:
        """Effects as the solver takes them."""
        return () if self.effects == "none" else tuple(self.effects.split(","))

    @property
    def heavy(self) -> bool:
        """Whether weight acts."""
        return "gravity" in self.terms

    def label(self, design: Mapping[str, float]) -> Label:
        """Never raises for a design that can be validated; what fails is an unknown label."""
        return self.follow(design)[1]

    def follow(
        self, design: Mapping[str, float], clock: dict[str, list[float]] | None = None
    ) -> tuple[Run, Label]:
        """As :meth:`label`, with the path that the label comes from.

        ``clock``, if given, keeps each effect's evaluations and seconds.
        """
        from solver.equilibrium.clock import OutOfTime

        groups = self.space.validate(pd.DataFrame([dict(design)]), bounds=False)
        groups = groups[self.space.names].iloc[0].to_dict()
        start, worked = time.monotonic(), time.process_time()
        forget_peak()
        deadline = start + self.timeout
        limits = {"deadline": deadline, "clock": clock}
        run, error, levels = self.run(groups, 0, **limits), None, 1
        coarse = run.settled and self._enough(groups, run)
        if coarse:
            error = screening.COARSE_ERROR
        for level in () if coarse else range(1, self.plan.finest + 1):
            if not run.settled or time.monotonic() > deadline:
                break
            size = run.folding.model.scene.size
            if level > 1 and (run.closed or size > LARGEST[self.plan.finest]):
                break
            found = self._refined(run, level, deadline)
            if found is None and level > 1:
                break
            if found is None:
                try:
                    again = self.run(groups, level, **limits)
                except OutOfTime:
                    break
                if not again.settled:
                    break
                found = again, judging.difference(run, again, groups, self.thresholds)
            run, error = found[0], judging.stated(found[1], level)
            levels += 1
            if (
                error <= self.accuracy
                and level + 1 >= self.plan.finest
                and not self._across(run, level)
            ):
                break
        foldable, reason, evidence = judging.judge(
            groups,
            run,
            error,
            self.thresholds,
            accuracy=self.accuracy,
            levels=levels,
            coarse=coarse,
        )
        label = Label(groups, foldable, reason, evidence, self.name, self.version)
        basis = "calibrated" if coarse else "measured"
        spent = {
            "seconds": time.monotonic() - start,
            "core_seconds": time.process_time() - worked,
            **({} if error is None else {"error_basis": basis}),
        }
        return run, replace(label, evidence={**label.evidence, **spent})

    @property
    def plan(self) -> Plan:
        """Meshes, steps and tolerance for the accuracy."""
        return next(plan for least, plan in PLANS.items() if self.accuracy >= least)

    def _across(self, run: Run, level: int) -> bool:
        """Whether the turning across the hinge decides, and one element is too few to know it."""
        g = run.folding.model.unit.contraction
        need = self.thresholds.angle(g)
        near = abs(run.measures["m2"] - self.thresholds.most_across(g)) < ACROSS * need
        return level < 2 and run.measures["m1"] > need and near and not run.closed

    def unit(self, design: Mapping[str, float]) -> Unit:
        """The solver's unit; raises :class:`InputError` for a design that is none."""
        from solver.cases.unit.unit import Unit

        try:
            groups = {k: float(v) for k, v in design.items()}
            return Unit(**groups, strips=self.strips, strip_share=self.strip_share)
        except (TypeError, ValueError) as error:
            raise InputError(f"the design is no folding unit: {error}") from error

    def run(
        self,
        design: Mapping[str, float],
        level: int = 1,
        *,
        deadline: float | None = None,
        clock: dict[str, list[float]] | None = None,
    ) -> Run:
        """The path of a design on one mesh.

        Raises :class:`InputError` for a design that is no unit.
        """
        from solver.cases.unit import path as unit_path
        from solver.cases.unit.choices import Meshing, Physics, Supports, Watch
        from solver.cases.unit.model import build
        from solver.cases.unit.output import Shape

        unit = self.unit(design)
        history: list[dict[str, float]] = []
        shapes: list[Shape] = []
        seen = lambda *shape: shapes.append(Shape(*shape))  # noqa: E731

        def closed(state: State) -> bool:
            row = judging.row_of(state, unit)
            history.append(row)
            return bool(self.thresholds.closed(row["m1"], row["m2"]))

        growth = "uniaxial" if self.question == "exists" else self.growth
        meshing = Meshing(level, self.plan.element, curls=self.growth == "isotropic")
        physics = Physics(self.terms, growth, barrier=self.barrier)
        supports = Supports(("x", "y") if self.seed is None else (), self.upright)
        watch = Watch(deadline, clock)
        model = build(unit, meshing, physics, supports, watch=watch)
        noise = None if self.seed is None else (1e-3, self.seed)
        steps = {"rtol": self.plan.tolerance, "turn": self.plan.turn}
        folding = unit_path.fold(model, stop=closed, noise=noise, on_state=seen, **steps)
        if self.question == "exists" and folding.ending is unit_path.Ending.REACHED:
            before = len(history)
            model, start = unit_path.carried(
                folding.model, folding.x, 1.0, physics=replace(physics, growth="release")
            )
            folding = unit_path.fold(model, start, stop=closed, noise=noise, on_state=seen, **steps)
            for row in history[before:]:
                row["contraction"] = unit.contraction
        return Run(folding, history, folding.ending is unit_path.Ending.STOPPED, shapes)

    def _enough(self, design: Mapping[str, float], run: Run) -> bool:
        """Whether the path on the coarsest mesh needs no second one."""
        if self.refine != "near":
            return self.refine == "never"
        kinds = {h.kind for h in run.folding.happenings}
        return screening.decided(design, run.history[-1], kinds, run.closed, self.thresholds)

    def _refined(self, run: Run, level: int, deadline: float) -> tuple[Run, float] | None:
        """The last state of a run on a finer mesh, after the run's history; and its error.

        Where a path ended at a full turn, small differences have grown large. What is refined is
        then the state before, for the error only.
        """
        from solver.cases.unit import path as unit_path
        from solver.cases.unit.output import Shape

        folding = run.folding
        if run.closed and len(run.history) < 2:
            return None
        finer = unit_path.refined(
            folding, level, earlier=run.closed, rtol=self.plan.tolerance, deadline=deadline
        )
        if finer is None:
            return None
        row = judging.row_of(finer.last, finer.model.unit)
        before = run.history[-2 if run.closed else -1]
        row["contraction"] = before["contraction"]
        scale = max(float(self.thresholds.scale(row["m1"], before["contraction"])), 1e-9)
        off = max(abs(row[m] - before[m]) for m in ("m1", "m2")) / scale
        if run.closed:
            return run, off
        finer = replace(
            finer,
            states=(*folding.states[:-1], finer.last),
            happenings=folding.happenings,
            iterations=folding.iterations + finer.iterations,
            before=folding.before,
        )
        shapes = [*run.shapes[:-1], Shape(finer.model, finer.x, finer.last)]
        return Run(finer, [*run.history[:-1], row], False, shapes), off


# Unknowns of a mesh that is not refined again; the error then stays as stated. By finest level.
LARGEST = {2: 6000, 3: 20000}

# Error over |g|π of m2 on meshes of one element across the hinge; the worst of 18 was 0.17.
ACROSS = 0.2


SOURCES = {"timoshenko": TimoshenkoSource, "solver": SolverSource}


def make_source(name: str, settings: Mapping[str, Any] | None = None, **fixed):
    """A label source by name, with a user's ``settings`` checked against its types.

    ``fixed`` is what the program gives, such as the space. Raises :class:`InputError` for an
    unknown source, unknown settings or values of a wrong type.
    """
    if name not in SOURCES:
        raise InputError(f"no label source {name!r}; there are: {', '.join(SOURCES)}")
    return call(SOURCES[name], settings or {}, what=f"source {name!r}", **fixed)
