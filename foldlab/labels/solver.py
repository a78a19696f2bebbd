"""Labels from the finite-strain solver, which is imported only when a label is asked for."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from foldlab.design import FULL, DesignSpace
from foldlab.errors import InputError
from foldlab.labels import screening
from foldlab.labels import verdict as judging
from foldlab.labels.asked import Changing, Conditions, Effort, check_strips
from foldlab.labels.foldability import Thresholds
from foldlab.labels.label import Label
from foldlab.labels.run import Run
from foldlab.labels.strength import Strengths, breaking, peaks
from foldlab.memory import forget_peak, hand_back
from foldlab.settings import changed
from foldlab.shown import Shown

if TYPE_CHECKING:
    from solver.cases.unit.choices import Changes
    from solver.cases.unit.output import Shape
    from solver.cases.unit.path import State
    from solver.cases.unit.unit import Unit


@dataclass(frozen=True, repr=False)
class SolverSource(Shown):
    """Labels from the finite-strain solver, with weight and ground or without.

    ``question``: "from_flat", or "exists": is there a folded stable state, approached by uniaxial
    contraction and then released to isotropic? ``seed``: follow noisy steps (§4.3.3) on the whole
    unit instead of testing symmetric ones.

    Without "contact" panels pass through each other, as in the dissertation; a path ends where the
    fold has made a full turn, and where the hinge has curled through half a turn about the other
    axis.
    """

    conditions: Conditions = field(default_factory=Conditions)
    effort: Effort = field(default_factory=Effort)
    question: Literal["from_flat", "exists"] = "from_flat"
    seed: int | None = None
    space: DesignSpace = FULL
    thresholds: Thresholds = field(default_factory=Thresholds)
    strengths: Strengths = field(default_factory=Strengths)
    changing: Changing = field(default_factory=Changing)

    name: ClassVar[str] = "solver"

    def __post_init__(self):
        c, refine = self.conditions, self.effort.refine
        if self.question not in ("from_flat", "exists"):
            raise InputError(f"question {self.question!r}; expected 'from_flat' or 'exists'")
        if self.question == "exists" and c.growth != "isotropic":
            raise InputError(
                "question 'exists' is about isotropic contraction; set growth=isotropic"
            )
        # Without strips it does not matter what they would cover.
        solid = replace(c, strip_share=Conditions.strip_share)
        if self.patterned and c.strips:
            raise InputError(
                f"strips = {c.strips}, and each design of the {self.space.name} space has its own; "
                "leave the setting out"
            )
        if refine != "always" and (
            self.patterned
            or solid != Conditions()
            or self.seed is not None
            or self.changing != Changing()
        ):
            raise InputError(
                f"refine {refine!r} needs a known error of the coarsest mesh, and it was measured "
                "for uniaxial contraction of solid upright units of constant materials, with "
                "weight, without contact and friction; take 'always'"
            )
        if not set(FULL.names) <= set(self.space.names):
            raise InputError(
                f"the solver needs a whole unit, and space {self.space.name!r} has only "
                f"{', '.join(self.space.names)}; sample with --space full"
            )

    @property
    def patterned(self) -> bool:
        """Whether each design says how its active layer is cut in strips."""
        return "strips" in self.space.names

    @property
    def timeout(self) -> float:
        """Core-seconds after which a label ends by itself."""
        return self.effort.timeout

    @property
    def version(self) -> str:
        """Tells all settings apart that may change an answer."""
        c, effort = self.conditions, self.effort
        parts = ["12", c.growth, c.effects.replace(",", "+"), f"{effort.accuracy:g}"]
        parts += ["exists"] * (self.question == "exists") + ["falls"] * (not c.upright)
        parts += [f"noise{self.seed}"] * (self.seed is not None)
        parts += [f"pattern{c.strips}x{c.strip_share:g}"] * (c.strips > 0)
        parts += [c.barrier] * (c.barrier != "surface")
        parts += [f"friction{c.friction:g}"] * (c.friction > 0)
        for record in (self.thresholds, self.strengths, self.changing):
            parts += changed(record)
        parts += [f"{effort.refine}{screening.COARSE_ERROR:g}"] * (effort.refine != "always")
        parts += ["sensitivity"] * effort.sensitivity
        parts += ["hasty"] * self._hasty
        return "-".join(parts)

    def label(self, design: Mapping[str, float]) -> Label:
        """Never raises for a design that can be validated; what fails is an unknown label."""
        label = self.follow(design)[1]
        hand_back()  # what the path held, before this process waits for its next design
        return label

    def follow(
        self, design: Mapping[str, float], clock: dict[str, list[float]] | None = None
    ) -> tuple[Run, Label]:
        """As :meth:`label`, with the path that the label comes from.

        ``clock``, if given, keeps each effect's evaluations and core-seconds.
        """
        from solver.equilibrium.clock import one_core

        groups = self.space.validate_one(design, bounds=False)
        with one_core():
            return self._follow(groups, clock)

    def _follow(self, groups: dict[str, float], clock) -> tuple[Run, Label]:
        from solver.equilibrium.clock import OutOfTime, core_seconds

        start, worked = time.monotonic(), core_seconds()
        forget_peak()
        deadline = worked + self.timeout
        limits = {"deadline": deadline, "clock": clock}
        run, errors, levels = self.run(groups, 0, **limits), None, 1
        before: Run | None = None
        earlier: judging.Errors | None = None
        coarse = run.settled and self._enough(groups, run)
        if coarse:
            errors = judging.calibrated(run, groups, self.thresholds)
        clear = self._clear(groups, run)
        finest, asked, open_ = self.effort.plan.finest, self.effort.accuracy, []
        for level in () if coarse else range(1, min(finest + 1, FINEST) + 1):
            if not run.settled or core_seconds() > deadline:
                break
            if level > 1:
                # Where the verdict hangs on it, one mesh more and larger ones.
                size = run.folding.model.scene.size / (FURTHER if open_ else 1)
                if run.closed or size > LARGEST[finest] or (level > finest and not open_):
                    break
            # What costs the most is tried only where the verdict hangs on it.
            thorough = bool(open_) if level > 1 else not clear
            refined = self._refined(run, level, deadline, thorough=thorough)
            if refined is None and clear:
                errors, coarse = judging.calibrated(run, groups, self.thresholds), True
                break
            if refined is None and level > 1:
                break
            if refined is None:
                try:
                    again = self.run(groups, level, **limits)
                except OutOfTime:
                    break
                if not again.settled:
                    break
                refined = again, judging.difference(run, again, groups, self.thresholds)
            before, run, clear = run, refined[0], False
            errors = refined[1].stated(level, earlier, self._across(run, level))
            earlier, levels = refined[1], levels + 1
            open_ = judging.undecided(run, errors, self.thresholds, accuracy=asked)
            if errors.m1 <= asked and level + 1 >= finest and not open_:
                break
        foldable, reason, evidence = judging.judge(
            self.changing.at_end(self._pattern() | groups),
            run,
            errors,
            self.thresholds,
            accuracy=asked,
            levels=levels,
            coarse=coarse,
            before=before,
            gone=self._gone(groups, run),
        )
        if clear and coarse:
            reason += "; no finer mesh confirmed it, and the error is that of other designs"
        if run.history:
            evidence |= self._peaks(run, None if run.closed else before)
            foldable, reason, evidence["outcome"] = self._borne(foldable, reason, evidence)
            if self.effort.sensitivity:
                evidence["sensitivity"] = run.sensitivity()
        label = Label(groups, foldable, reason, evidence, self.name, self.version)
        basis = "calibrated" if coarse else "measured"
        spent = {
            "seconds": time.monotonic() - start,
            "core_seconds": core_seconds() - worked,
            **({} if errors is None else {"error_basis": basis}),
        }
        return run, replace(label, evidence={**label.evidence, **spent})

    def _peaks(self, run: Run, before: Run | None = None) -> dict[str, Any]:
        """Peak strain, stress and traction of the last state, and their errors."""
        from solver.cases.unit.strain import strain

        shapes = [r.shapes[-1] for r in (run, before) if r is not None]
        return peaks(*(strain(s.model, s.x, float(s.state.e)) for s in shapes))

    def _borne(self, foldable, reason: str, evidence) -> tuple[bool | None, str, str]:
        """Verdict, reason and outcome once more, where strengths are given."""
        outcome = evidence["outcome"]
        if not (foldable and self.strengths.given):
            return foldable, reason, outcome
        breaks, phrases = breaking(evidence, self.strengths)
        if breaks:
            return False, f"{reason}, but breaks: {' and '.join(phrases)}", "breaks"
        if breaks is None:
            return None, f"unknown: {reason}, but may break: {' and '.join(phrases)}", "unresolved"
        return foldable, f"{reason}, and nothing breaks", outcome

    def _across(self, run: Run, level: int) -> float:
        """Least that is stated of m2 on a mesh; see :data:`foldlab.labels.verdict.ACROSS`."""
        from solver.cases.unit.mesh import LEVELS

        model = run.folding.model
        elements = LEVELS[level].across + model.meshing.curls
        g = model.unit.contraction
        scale = float(self.thresholds.scale(run.measures["m1"], g))
        return judging.ACROSS[min(elements, 3)] * float(self.thresholds.angle(g)) / scale

    def _pattern(self) -> dict[str, float]:
        """The groups of strips where they are a setting."""
        c = self.conditions
        return {"strips": c.strips, "strip_share": c.strip_share} if c.strips else {}

    def _changes(self, course: Callable[[float], float]) -> tuple[Changes, Changes]:
        """Of the active and of the passive layer; ``course``: how far they have come at e."""
        from solver.cases.unit.choices import Changes

        def going(to: float, start: float = 1.0):
            return None if to == start else lambda e: start + (to - start) * course(e)

        c = self.changing
        return (
            Changes(going(c.active_stiffness), going(c.active_density)),
            Changes(
                going(c.passive_stiffness), going(c.passive_density),
                going(c.passive_expansion, 0.0),
            ),
        )  # fmt: skip

    def unit(self, design: Mapping[str, float]) -> Unit:
        """The solver's unit; raises :class:`InputError` for a design that is none."""
        from solver.cases.unit.unit import Unit

        try:
            groups = {k: float(v) for k, v in (self._pattern() | dict(design)).items()}
            groups["strips"] = check_strips(groups.get("strips", 0))
            return Unit(**groups)
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

        def closed(row: Mapping[str, float]) -> bool:
            return bool(self.thresholds.closed(row["m1"], row["m2"]))

        def enough(state: State) -> bool:
            row = judging.row_of(state, unit)
            history.append(row)
            hasty = self._hasty and state.e < 1
            away = hasty and judging.curled_away(row, unit.contraction, self.thresholds)
            return away or closed(row)

        c = self.conditions
        growth = "uniaxial" if self.question == "exists" else c.growth
        meshing = Meshing(level, self.effort.plan.element, curls=c.growth == "isotropic")
        physics = Physics(c.terms, growth, *self._changes(lambda e: e), c.barrier, c.friction)
        supports = Supports(("x", "y") if self.seed is None else (), c.upright)
        watch = Watch(deadline, clock)
        try:
            model = build(unit, meshing, physics, supports, watch=watch)
        except ValueError as error:
            raise InputError(f"the design has no mesh: {_why(unit)}{error}") from error
        noise = None if self.seed is None else (1e-3, self.seed)
        steps = {"rtol": self.effort.plan.tolerance, "turn": self.effort.plan.turn}
        folding = unit_path.fold(model, stop=enough, noise=noise, on_state=seen, **steps)
        if self.question == "exists" and folding.ending is unit_path.Ending.REACHED:
            before = len(history)
            active, passive = self._changes(lambda e: 1.0)
            released = replace(physics, growth="release", active=active, passive=passive)
            model, start = unit_path.carried(folding.model, folding.x, 1.0, physics=released)
            folding = unit_path.fold(model, start, stop=enough, noise=noise, on_state=seen, **steps)
            for row in history[before:]:
                row["release"] = row["contraction"] / unit.contraction
                row["contraction"] = unit.contraction
        stopped = folding.ending is unit_path.Ending.STOPPED
        return Run(folding, history, stopped and closed(history[-1]), shapes)

    def _enough(self, design: Mapping[str, float], run: Run) -> bool:
        """Whether the path on the coarsest mesh needs no second one."""
        if self.effort.refine != "near":
            return self.effort.refine == "never"
        if self.strengths.given and breaking(self._peaks(run), self.strengths)[0] is None:
            return False
        kinds = {h.kind for h in run.folding.happenings}
        return screening.decided(design, run.history[-1], kinds, run.closed, self.thresholds)

    @property
    def _measured(self) -> bool:
        """Whether labels are of the kind that rules of the coarsest mesh were measured on."""
        c = self.conditions
        plain = Conditions(growth=c.growth) == c and not self.patterned
        asked = self.question == "from_flat" and self.seed is None
        return plain and asked and self.changing == Changing()

    @property
    def _returnless(self) -> bool:
        """Whether labels are of the kind that curling for good was measured on."""
        isotropic = self.conditions.growth == "isotropic"
        return isotropic and self._measured and self.thresholds == Thresholds()

    @property
    def _hasty(self) -> bool:
        """Whether a path ends where it has curled for good."""
        return self._returnless and not self.effort.whole

    def _gone(self, design: Mapping[str, float], run: Run) -> bool:
        """Whether a path that has no end had curled for good."""
        return self._returnless and judging.beyond_return(run, design, self.thresholds)

    def _clear(self, groups: Mapping[str, float], run: Run) -> bool:
        """Whether a path on the coarsest mesh is enough to say that a design doesn't fold, or that
        it folds by a full turn."""
        if not (run.settled and self._measured):
            return False
        growth, closed = self.conditions.growth, run.closed
        g = groups["contraction"]
        return screening.clear(run.measures, g, self.thresholds, growth, closed)

    def _refined(
        self, run: Run, level: int, deadline: float, thorough: bool = True
    ) -> tuple[Run, judging.Errors] | None:
        """The last state of a run on a finer mesh, after the run's history; and its errors.

        ``thorough``: see :func:`solver.cases.unit.path.refined`.
        Where a path ended at a full turn, small differences have grown large. What is refined is
        then the state before, for the errors only.
        """
        from solver.cases.unit import path as unit_path
        from solver.cases.unit.output import Shape

        folding = run.folding
        if (run.closed and len(run.history) < 2) or folding.model.physics.friction:
            # What sticks where is a matter of the whole path.
            return None
        finer = unit_path.refined(
            folding, level, earlier=run.closed, rtol=self.effort.plan.tolerance, deadline=deadline,
            thorough=thorough,
        )  # fmt: skip
        if finer is None:
            return None
        row = judging.row_of(finer.last, finer.model.unit)
        before = run.history[-2 if run.closed else -1]
        row |= {name: before[name] for name in ("contraction", "release") if name in before}
        scale = max(float(self.thresholds.scale(row["m1"], before["contraction"])), 1e-9)
        off = judging.Errors(*(abs(row[m] - before[m]) / scale for m in ("m1", "m2")))
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
# And by what factor more where the verdict is open.
FURTHER = 3
FINEST = 3  # of all meshes


def _why(unit: Unit) -> str:
    """The cause of a mesh that can't be, where the lengths tell it; else empty."""
    lengths = {"l_s": 1.0} | {
        n: getattr(unit, n) for n in ("slenderness", "hinge_length", "aspect")
    }
    small, large = (end(lengths, key=lengths.get) for end in (min, max))
    if lengths[large] < 1e6 * lengths[small]:
        return ""
    told = (f"{n} = {lengths[n]:g}" for n in (small, large))
    return f"{' and '.join(told)} lie too far apart; "
