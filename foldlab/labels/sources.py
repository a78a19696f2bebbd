"""Label sources by name; and a ladder of them, where the cheapest that is sure gives the label.

Rungs, by what a label costs: the planar rod (a millisecond, with an error that it states), then the
solver. What the rod cannot feel, and designs that its error leaves open, climb on.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

from foldlab.design import FULL, DesignSpace
from foldlab.errors import InputError
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.foldability import Thresholds
from foldlab.labels.label import Label
from foldlab.labels.rod import RodSource
from foldlab.labels.solver import SolverSource
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.settings import call
from foldlab.shown import Shown

if TYPE_CHECKING:
    from foldlab.labels.label import LabelSource


@dataclass(frozen=True, repr=False)
class LadderSource(Shown):
    """Labels from the rod where it is sure, else from the solver.

    The evidence tells the ``rung`` that answered, and ``core_seconds`` of all that were asked. Of
    designs of a Latin hypercube 95 % end on the rod; ``python -m experiments.gravity_ladder`` says
    how often it is wrong. Raises :class:`InputError` as the solver's source does.
    """

    conditions: Conditions = field(default_factory=Conditions)
    effort: Effort = field(default_factory=Effort)
    space: DesignSpace = FULL
    thresholds: Thresholds = field(default_factory=Thresholds)

    name: ClassVar[str] = "ladder"

    def __post_init__(self):
        _ = self.rungs

    @property
    def rungs(self) -> tuple[LabelSource, ...]:
        """The sources, the cheapest first; those that cannot feel what is asked are left out."""
        asked = {
            "conditions": self.conditions, "space": self.space, "thresholds": self.thresholds
        }  # fmt: skip
        rungs: list[Any] = [SolverSource(effort=self.effort, **asked)]
        with suppress(InputError):
            rungs.insert(0, RodSource(**asked))
        return tuple(rungs)

    @property
    def timeout(self) -> float:
        """Core-seconds after which a label ends by itself."""
        return self.effort.timeout

    @property
    def version(self) -> str:
        """Tells all settings apart that may change an answer."""
        return "+".join(f"{rung.name}:{rung.version}" for rung in self.rungs)

    def label(self, design: Mapping[str, float]) -> Label:
        """Never raises for a design that the solver can label; see :class:`SolverSource`."""
        spent, rungs = 0.0, self.rungs
        for rung in rungs:
            try:
                label = rung.label(design)
            except InputError:
                # Outside of what the rod's tables hold.
                if rung is rungs[-1]:
                    raise
                continue
            evidence = label.evidence
            spent += evidence.get("core_seconds", evidence.get("seconds", 0.0))
            if label.foldable is not None:
                break
        evidence = {**evidence, "rung": label.source, "core_seconds": spent}
        return replace(label, evidence=evidence, source=self.name, version=self.version)


SOURCES = {
    source.name: source for source in (TimoshenkoSource, RodSource, SolverSource, LadderSource)
}


def make_source(name: str, settings: Mapping[str, Any] | None = None, **fixed):
    """A label source by name, with a user's ``settings`` checked against its types.

    ``fixed`` is what the program gives, such as the space. Raises :class:`InputError` for an
    unknown source, unknown settings or values of a wrong type.
    """
    if name not in SOURCES:
        raise InputError(f"no label source {name!r}; there are: {', '.join(SOURCES)}")
    return call(SOURCES[name], settings or {}, what=f"source {name!r}", **fixed)
