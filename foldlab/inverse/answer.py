"""Proposals and answers: what inverse design hands back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from foldlab.inverse.wish import Wish
from foldlab.labels.label import Label


@dataclass(frozen=True)
class Proposal:
    """One design that is predicted to do what was wished.

    ``groups``: value by group. ``physical``: SI values by name as far as the limits reach
    (``design.PHYSICAL``). ``mass`` in kg, or None. ``probability``: predicted P(foldable), None
    without a classifier. ``angle``: predicted fold angle, rad, None unless wished. ``margin``:
    half-width (fraction of the bounds) of the largest cube predicted to do as wished. ``box``:
    (low, high) by group; predicted to hold, with half the wished margin to spare on every side.
    After :func:`confirm`: the source's ``label`` of the design, and how many of ``box_checked``
    points of the box the source labels as wished (``box_held``) or could not tell
    (``box_unknown``). Under weight ``box`` is in SI quantities where the scale is known, its points
    are the corners that are worst by the rod, and ``core_seconds`` went into ``answers`` of the
    solver.
    """

    groups: Mapping[str, float]
    physical: Mapping[str, float]
    materials: tuple[str | None, str | None]
    mass: float | None
    probability: float | None
    angle: float | None
    margin: float
    box: Mapping[str, tuple[float, float]]
    label: Label | None = None
    confirmed: bool | None = None
    box_checked: int = 0
    box_held: int = 0
    box_unknown: int = 0
    core_seconds: float = 0.0
    answers: int = 0

    @property
    def box_confirmed(self) -> bool | None:
        """True if the source agrees at every checked point; None if unchecked or partly unknown."""
        if self.box_held + self.box_unknown < self.box_checked:
            return False
        return True if self.box_checked and not self.box_unknown else None

    def as_dict(self) -> dict:
        """Plain values for JSON; the label as its reason and evidence."""
        out = {k: v for k, v in self.__dict__.items() if k != "label"}
        out["groups"], out["physical"] = dict(self.groups), dict(self.physical)
        out["box"] = {name: list(ends) for name, ends in self.box.items()}
        out["materials"] = list(self.materials)
        out["box_confirmed"] = self.box_confirmed
        if self.label is not None:
            out |= {"reason": self.label.reason, "evidence": dict(self.label.evidence)}
        return out


@dataclass(frozen=True)
class Answer:
    """Proposals for a wish, most robust first; fewer than ``asked`` where ``reason`` says why.

    ``rejected``: designs that did as wished by the rod and not by the source. ``largest``: where
    nothing folds at the wished size, the largest unit that does. ``core_seconds``: of the search
    and of the source.
    """

    wish: Wish
    asked: int
    proposals: tuple[Proposal, ...]
    reason: str
    seconds: float
    source: str = ""
    weightless: bool = True
    core_seconds: float | None = None
    rejected: int = 0
    largest: Mapping | None = None

    def __repr__(self) -> str:
        return f"Answer({len(self.proposals)} of {self.asked} designs; {self.reason})"

    def _repr_html_(self) -> str:
        from foldlab.shown import html_table

        told = rows(self)
        cells = [[f"{v:.4g}" if isinstance(v, float) else v for v in row.values()] for row in told]
        return html_table(self.reason, cells, list(told[0]) if told else ())

    @property
    def complete(self) -> bool:
        return len(self.proposals) == self.asked

    @property
    def confirmed_fraction(self) -> float | None:
        """Confirmed over all proposals (unknown counts as not); None before :func:`confirm`."""
        if not self.proposals or any(p.label is None for p in self.proposals):
            return None
        return sum(p.confirmed is True for p in self.proposals) / len(self.proposals)

    def as_dict(self) -> dict:
        """Plain values for JSON."""
        return {
            "asked": self.asked,
            "proposed": len(self.proposals),
            "reason": self.reason,
            "seconds": self.seconds,
            "source": self.source,
            "weightless": self.weightless,
            "core_seconds": self.core_seconds,
            "rejected": self.rejected,
            "largest": self.largest,
            "confirmed_fraction": self.confirmed_fraction,
            "proposals": [p.as_dict() for p in self.proposals],
        }


def rows(answer: Answer) -> list[dict]:
    """The proposals as flat rows for a printed table: groups, probability, margin, verdicts."""
    out = []
    for p in answer.proposals:
        row = {**p.groups, "margin": p.margin}
        if p.probability is not None:
            row["probability"] = p.probability
        if p.angle is not None:
            row["fold_angle"] = p.angle
        if p.mass is not None:
            row["mass_kg"] = p.mass
        if p.label is not None:
            row |= {"confirmed": p.confirmed, "box": f"{p.box_held}/{p.box_checked}"}
        out.append(row)
    return out
