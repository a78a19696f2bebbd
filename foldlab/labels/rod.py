"""Labels from the planar rod: weight and ground between Timoshenko's formula and the solver.

Thousands of labels a second, see :mod:`solver.cases.unit.rod` for what the rod is. It judges F1 of
Eq. 4.21 alone: curling and warping across the hinge are not seen by it (of 4 644 uniaxial labels of
the solver, one failed by them alone). Isotropic contraction curls first what a rod would fold: it
would be right on 72 of 104 such labels, and is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from foldlab.design import FULL, DesignSpace
from foldlab.errors import InputError
from foldlab.labels import verdict as judging
from foldlab.labels.asked import Conditions
from foldlab.labels.foldability import Thresholds
from foldlab.labels.label import Label
from foldlab.settings import changed
from foldlab.shown import Shown

if TYPE_CHECKING:
    import pandas as pd

    from solver.cases.unit.rod import Bent

# A rod that jumps later than at this fraction of the contraction might not jump as a solid: the
# loads of jumps agree within 10 %.
LATE = 0.8
# Answers that are kept: a validation asks for the same labels in each of its folds.
REMEMBERED = 100_000


@dataclass(frozen=True, repr=False)
class RodSource(Shown):
    """Labels from the rod, with weight and ground ("gravity,ground") or without ("none").

    ``sure``: designs whose angle lies nearer to the threshold than its error are unknown; without,
    every settled rod decides. Raises :class:`InputError` for conditions that a planar rod cannot
    feel.
    """

    conditions: Conditions = field(default_factory=Conditions)
    sure: bool = True
    space: DesignSpace = FULL
    thresholds: Thresholds = field(default_factory=Thresholds)

    name: ClassVar[str] = "rod"

    def __post_init__(self):
        c = self.conditions
        unfelt = {
            f"growth {c.growth!r}": c.growth != "uniaxial",
            f"effects {c.effects!r}": "contact" in c.terms,
            f"{c.strips} strips": c.strips > 0,
            "upright=false": not c.upright,
            f"barrier {c.barrier!r}": c.barrier != "surface",
            f"friction {c.friction:g}": c.friction > 0,
        }
        for what, asked in unfelt.items():
            if asked:
                raise InputError(
                    f"{what}: a planar rod feels uniaxial contraction, weight and ground of solid "
                    "upright units only; take --source solver"
                )
        if "strips" in self.space.names:
            raise InputError(
                f"the rod knows solid layers only, and designs of the {self.space.name} space have "
                "strips; take --source solver"
            )
        if self.space.name != "full":
            raise InputError(
                f"the rod needs a whole unit, and space {self.space.name!r} has only "
                f"{', '.join(self.space.names)}; sample with --space full"
            )

    @property
    def version(self) -> str:
        """Tells all settings apart that may change an answer."""
        c = self.conditions
        parts = ["1", c.effects.replace(",", "+"), *(["decided"] * (not self.sure))]
        return "-".join([*parts, *changed(self.thresholds)])

    def label(self, design: Mapping[str, float]) -> Label:
        """Raises :class:`InputError` for a design that is no unit or that no rod is known for."""
        return self._label(self.space.validate_one(design, bounds=False))

    def label_many(self, designs: pd.DataFrame) -> list[Label]:
        """Labels of a table of designs, in its order."""
        table = self.space.validate(designs, bounds=False)
        return [self._label(groups) for groups in table[self.space.names].to_dict("records")]

    def bent(self, design: Mapping[str, float]) -> Bent:
        """The rod of a design; raises :class:`InputError` as :meth:`label` does."""
        return self._bent(self.space.validate_one(design, bounds=False))

    def _bent(self, design: dict[str, float]) -> Bent:
        from solver.cases.unit.rod import bend
        from solver.cases.unit.unit import Unit

        try:
            return bend(Unit(**design), heavy=self.conditions.heavy)
        except ValueError as error:
            raise InputError(f"the design is no rod: {error}") from error

    def _label(self, design: dict[str, float]) -> Label:
        foldable, reason, evidence = self._judged(design, self._bent(design))
        return Label(design, foldable, reason, evidence, self.name, self.version)

    def _judged(self, design, bent: Bent) -> tuple[bool | None, str, dict[str, Any]]:
        if not len(bent.states):
            reason = f"unknown: {bent.ending.value}"
            return None, reason, {"outcome": "lost", "seconds": bent.seconds}
        c = design["contraction"]
        need, history = self.thresholds.angle(c), self._history(design, bent)
        last, closed = history[-1], bool(self.thresholds.closed(bent.angle, 0.0))
        room = bent.angle - need
        tags = {"F1": room > 0, "F2": True, "F3": True, "F4": True}
        events = judging.find_events(history, c, self.thresholds)
        events += [{"kind": "snap", "contraction": e * c} for e in bent.snaps]
        events.sort(key=lambda event: event["contraction"])
        foldable, outcome, reason = None, "lost", f"unknown: {bent.ending.value}"
        if bent.settled:
            foldable, outcome, reason = judging.verdict(
                design, history, tags, events, closed, self.thresholds
            )
        if bent.settled and self.sure:
            doubt = None
            if closed and any(e > LATE for e in bent.snaps):
                doubt = "it jumps so late that a solid might not"
            elif not closed and abs(room) < bent.error:
                doubt = f"the rod's error is {bent.error:.2g} rad"
            if doubt:
                foldable, outcome = None, "unresolved"
                reason = f"unknown: m1 is {bent.angle:.3g} rad, {need:.3g} needed, and {doubt}"
        return foldable, reason, {
            "outcome": outcome,
            "fold_angle": bent.angle,
            "m1": bent.angle,
            "hinge": bent.hinge,
            "natural_angle": bent.natural,
            "F1": tags["F1"],
            "margin": room / need,
            "threshold": self.thresholds.turning,
            "contraction_reached": last["contraction"],
            "normalised_angle": bent.angle / last["contraction"] if last["contraction"] else None,
            "stable": bent.settled,
            "steady": bent.steady,
            "topples": bent.topples,
            "softness": bent.softness,
            "events": events,
            "error_estimate": bent.error / float(self.thresholds.scale(bent.angle, c)),
            "error_basis": "calibrated",
            "discretisation": bent.discretisation,
            "iterations": bent.iterations,
            "steps": len(bent.states),
            "seconds": bent.seconds,
        }  # fmt: skip

    def _history(self, design, bent: Bent) -> list[dict[str, float]]:
        """As the solver keeps it, without what a rod has not: no m2, and edges that follow."""
        from solver.cases.unit import rod_kernel as kernel

        rows, h = [], design["slenderness"]
        for state in bent.states:
            row = {
                "contraction": float(state[kernel.LOAD]) * design["contraction"],
                "m1": 2 * float(state[kernel.TIP_ANGLE]),
                "hinge": 2 * float(state[kernel.HINGE_ANGLE]),
                "m2": 0.0, "m3": 1.0, "m4": 1.0,
            }  # fmt: skip
            if self.conditions.heavy:
                row["tip"] = float(state[kernel.TIP]) / h
            rows.append(row)
        rows[-1] |= {"m1": bent.angle, "hinge": bent.hinge}
        return rows


def rod_of(designs: pd.DataFrame, space: DesignSpace = FULL) -> pd.DataFrame:
    """The rod's net turning (``rod``) and its stated error (``rod_error``), both over π|g|.

    ``designs`` (n, groups of the space) → (n, 2), half a millisecond a design; answers are
    remembered. Of a rod that finds no state 0 and 1, the whole threshold. Raises
    :class:`InputError` for designs that no rod is known for.
    """
    import pandas as pd

    table = space.validate(designs, bounds=False)
    rows = [_turned(space, *row) for row in table[space.names].to_numpy().tolist()]
    return pd.DataFrame(rows, columns=["rod", "rod_error"], dtype=float)


@lru_cache(maxsize=REMEMBERED)
def _turned(space: DesignSpace, *groups: float) -> tuple[float, float]:
    source = RodSource(sure=False, space=space)
    design = dict(zip(space.names, groups, strict=True))
    evidence, c = source._label(design).evidence, design["contraction"]
    turned = evidence.get("m1", np.nan) / source.thresholds.angle(c)
    error = evidence.get("error_estimate", np.nan) * max(abs(turned), 1.0)
    return (turned, error) if np.isfinite([turned, error]).all() else (0.0, 1.0)
