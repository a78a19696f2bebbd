"""Make it fold: the nearest designs that do, each confirmed by the solver."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.explore.asked import Asked
from foldlab.explore.nearest import Way, ways
from foldlab.unit.check import ATTEMPTS, changes
from foldlab.unit.sized import Sized
from foldlab.unit.told import in_degrees

if TYPE_CHECKING:
    from foldlab.labels.label import Label
    from foldlab.labels.solver import SolverSource

SEEN = 0.01  # change of a group over its bounds, below which it is not named
Tell = Callable[[str], None]


def mended(what: Asked, source: SolverSource, tell: Tell) -> dict[str, Any]:
    """``options``, the nearest first, each with its ``design`` as the page gives it, ``changes``
    (name, from, to; SI) and what the solver says of it; ``folds``: whether the design itself does;
    ``said``: what came of it.

    Of a unit given in sizes one of them changes, by the rod's scan of
    :func:`foldlab.unit.check.changes`; of groups all, and one alone, by the shipped model.
    """
    tell("asking the solver of the design as it is")
    label = source.label(what.groups)
    if label.foldable:
        return {
            "options": [],
            "folds": True,
            "said": f"it folds as it is: {in_degrees(label.reason)}",
        }
    by_size = what.unit is not None and not what.by_groups
    options = _sizes(what.unit, source, tell) if by_size else _groups(what, source, tell)
    said = f"as it is: {in_degrees(label.reason)}"
    if not options:
        said += "; nothing near by was confirmed to fold" + (
            ", by a change of one size or the contraction" if by_size else ""
        )
    return {"options": options, "folds": label.foldable, "said": said}


def _sizes(unit: Sized, source: SolverSource, tell: Tell) -> list[dict[str, Any]]:
    """Up to two changes of one quantity each, the smaller first."""
    out = []
    for change in changes(unit, source)[:ATTEMPTS]:
        tell(f"trying {change.quantity} × {change.factor:.3g}")
        changed = unit.changed(**{change.quantity: change.value})
        label = source.label(changed.groups)
        if label.foldable:
            given = {k: float(v) for k, v in changed.physical.items() if k != "g_earth"}
            names = [n for n, v in given.items() if v != unit.physical[n]]
            moved = [{"name": n, "from": unit.physical[n], "to": given[n]} for n in names]
            out.append(_option({"quantities": given, **unit.materials}, moved, label))
        if len(out) == 2:
            break
    return out


def _groups(what: Asked, source: SolverSource, tell: Tell) -> list[dict[str, Any]]:
    """The nearest by all groups, and by one alone."""
    from foldlab.learning.saving import shipped_for
    from foldlab.predicted import Predictor

    model, out = Predictor.of(shipped_for(FULL.name)), []

    def folds(designs) -> np.ndarray:
        return model.answers(designs)["foldable"].fillna(False).astype(bool)

    tell("looking for the nearest design that folds, by the model")
    for way in ways(FULL, dict(what.groups), folds):
        found = _confirmed(way, source, tell)
        if found is None:
            continue
        groups, label = found
        moved = FULL.to_unit(_table(groups)) - FULL.to_unit(_table(what.groups))
        named = [n for n, by in zip(FULL.names, moved[0], strict=True) if abs(by) >= SEEN]
        rows = [{"name": n, "from": what.groups[n], "to": groups[n]} for n in named]
        out.append(_option({"groups": groups}, rows, label))
    return out


def _confirmed(way: Way, source: SolverSource, tell: Tell) -> tuple[dict, Label] | None:
    for point in way.further():
        groups = {n: float(v) for n, v in FULL.from_unit(point).iloc[0].items()}
        tell(f"trying {way.alone or 'several groups'}")
        try:
            label = source.label(groups)
        except InputError:
            continue
        if label.foldable:
            return groups, label
    return None


def _table(groups: Mapping[str, float]):
    import pandas as pd

    return pd.DataFrame([dict(groups)])


def _option(design: dict[str, Any], moved: list[dict], label: Label) -> dict[str, Any]:
    return {
        "design": design,
        "changes": moved,
        "reason": in_degrees(label.reason),
        "fold_angle": label.evidence["fold_angle"],
        "error_m1": label.evidence.get("error_m1"),
        "core_seconds": label.evidence["core_seconds"],
    }
