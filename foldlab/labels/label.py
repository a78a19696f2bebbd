"""What a label is, who makes labels, and the store that keeps them.

The store is one SQLite file: a row per (source, version, design), committed as it completes. It
keeps SQLite's rollback journal rather than WAL, which does not work on network file systems.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from foldlab.errors import InputError

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Label:
    """The answer to "does this design fold?", with the reason and the evidence.

    ``foldable`` is None where the source could not tell; ``reason`` is one sentence either way.
    ``evidence`` holds plain JSON values: angle (rad), error estimate, margin, seconds, …, and
    ``outcome``, a short name such as "folds", "curled" or "timeout", where a source has such names.
    """

    design: Mapping[str, float]
    foldable: bool | None
    reason: str
    evidence: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""
    version: str = ""

    def __repr__(self) -> str:
        who = f"{self.source}: " if self.source else ""
        return f"Label({self._says()}; {who}{self.reason})"

    def _says(self) -> str:
        """The verdict, and the angle where the source gives one."""
        verdict = {True: "folds", False: "does not fold"}.get(self.foldable, "unknown")
        angle = self.evidence.get("fold_angle")
        return f"{verdict}, {angle:.4g} rad" if isinstance(angle, float) else verdict

    def _repr_html_(self) -> str:
        from foldlab.shown import html_table

        rows = [("reason", self.reason), ("source", self.source or "–")]
        rows += [(name, f"{value:.4g}") for name, value in self.design.items()]
        return html_table(self._says(), rows)


@runtime_checkable
class LabelSource(Protocol):
    """Turns a design into a label. ``name`` and ``version`` identify the rows in the store.

    A source that is a formula also has ``label_many(designs: DataFrame) -> list[Label]``.
    Sources are pickled to worker processes. A source that ends its labels by itself after a time
    says so in ``timeout`` (core-seconds); a worker process that hangs far beyond it is ended.
    """

    name: str
    version: str

    def label(self, design: Mapping[str, float]) -> Label: ...


def design_key(design: Mapping[str, float]) -> str:
    """The one text of a design: names sorted, numbers exact to the last bit.

    Raises :class:`InputError` for an empty design and for values that are not finite numbers.
    """
    exact = _exact(design)
    # As json.dumps(exact, sort_keys=True) gives it, in a third of the time.
    return "{" + ", ".join(f"{_quoted(name)}: {exact[name]!r}" for name in sorted(exact)) + "}"


def _exact(design: Mapping[str, float]) -> dict[str, float]:
    if not design:
        raise InputError("the design is empty; give at least one group with its value")
    exact = {}
    for name, value in design.items():
        try:
            # Adding 0 makes -0.0 and 0.0 the same design.
            number = float(value) + 0.0
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            raise InputError(f"{name} = {value!r} in a design; give finite numbers")
        exact[str(name)] = number
    return exact


@lru_cache(maxsize=1024)
def _quoted(name: str) -> str:
    return json.dumps(name)


def reason_class(reason: str, outcome: Any = None) -> str:
    """What labels are counted by: the ``outcome`` of their evidence, or else the reason.

    Words with digits are masked as "#": reasons that differ in a figure, an address or a task's
    name count as one.
    """
    if isinstance(outcome, str) and outcome:
        return outcome
    return re.sub(r"[\w.:/+-]*\d[\w.:/+-]*", "#", reason)


def storable(label: Label) -> Label:
    """The label with evidence in plain JSON values and ``foldable`` True, False or None.

    Evidence that is not a finite number, or of a type that JSON lacks, becomes None, and the label
    then becomes unknown with a reason that names it. Raises :class:`InputError` for a design that
    is not finite or a ``foldable`` of another type.
    """
    if not (label.foldable is None or isinstance(label.foldable, bool | np.bool_)):
        raise InputError(f"foldable is {label.foldable!r}; a label has True, False or None there")
    foldable = None if label.foldable is None else bool(label.foldable)
    bad: list[str] = []
    evidence = _plain(label.evidence, "", bad)
    reason = _text(label.reason)
    if bad:
        foldable = None
        reason = f"the evidence is not usable ({', '.join(bad)}); the source said: {reason}"
    design = _exact(label.design)
    return Label(design, foldable, reason, evidence, label.source, label.version)


def _plain(value, name: str, bad: list[str]):
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float):
        if math.isfinite(value):
            return float(value)
        bad.append(f"{name} is {value}")
    elif isinstance(value, Mapping):
        prefix = f"{name}." if name else ""
        return {_text(k): _plain(v, f"{prefix}{k}", bad) for k, v in value.items()}
    elif isinstance(value, list | tuple):
        return [_plain(v, f"{name}[{k}]", bad) for k, v in enumerate(value)]
    elif isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist(), name, bad)
    else:
        bad.append(f"{name} is a {type(value).__name__}")
    return None


def _text(value) -> str:
    # System messages may hold lone surrogates, which neither SQLite nor Arrow takes.
    return str(value).encode("utf-8", "replace").decode("utf-8")


def labels_to_frame(labels: Iterable[Label]) -> pd.DataFrame:
    """Flat table, one row per label in the given order: the groups, ``foldable`` (nullable
    boolean), reason, evidence, source, version.

    Nested evidence gets dotted names, lists become JSON text, and evidence that shares its name
    with another column is called ``evidence.<name>``.
    """
    import pandas as pd

    labels = list(labels)
    groups = dict.fromkeys(name for label in labels for name in label.design)
    taken = {*groups, "foldable", "reason", "source", "version"}
    rows = []
    for label in labels:
        row = {**label.design, "foldable": label.foldable, "reason": label.reason}
        for name, value in _flat(label.evidence):
            row[f"evidence.{name}" if name in taken else name] = value
        rows.append({**row, "source": label.source, "version": label.version})
    evidence = [name for name in dict.fromkeys(n for row in rows for n in row) if name not in taken]
    columns = [*groups, "foldable", "reason", *evidence, "source", "version"]
    frame = pd.DataFrame(rows, columns=columns)
    for name in evidence:
        if frame[name].isna().all():
            frame[name] = np.nan
    return frame.astype({"foldable": "boolean"})


def _flat(evidence: Mapping, prefix: str = ""):
    for name, value in evidence.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, json.dumps(value) if isinstance(value, list | tuple) else value


def _as_bool(value) -> bool:
    if value in (0, 1):
        return bool(value)
    raise InputError(
        f"the classifier has a class {str(value)!r}; expected foldable as false/true or 0/1"
    )


def ask(source, designs: pd.DataFrame, *, executor: Executor | None = None) -> list[Label]:
    """Labels of all designs: in one call where the source is a formula, one by one elsewhere.

    A source that raises gives a label with ``foldable`` unknown and the error as its reason; only
    :class:`InputError` (the design itself is bad) passes through.
    """
    if hasattr(source, "label_many"):
        return list(source.label_many(designs))
    rows = designs.to_dict("records")
    one = partial(_label_or_unknown, source)
    return list(executor.map(one, rows) if executor else map(one, rows))


def _label_or_unknown(source, design: Mapping[str, float]) -> Label:
    try:
        return source.label(design)
    except InputError:
        raise
    except Exception as error:
        reason = f"the source failed: {type(error).__name__}: {error}"
        return Label(design, None, reason, source=source.name, version=source.version)


def truth_of(source, designs: pd.DataFrame, *, executor: Executor | None = None):
    """``(foldable, margin)`` of all designs by a label source.

    ``foldable``: nullable booleans, shape (n,), NA where the source could not tell. ``margin``:
    signed distance to the source's own boundary (0 on it), shape (n,), or None if it gives none.
    """
    import pandas as pd

    if hasattr(source, "evaluate"):
        table = source.evaluate(designs)
        foldable, margin = table["foldable"], table.get("margin")
    else:
        labels = ask(source, designs, executor=executor)
        foldable = pd.Series([label.foldable for label in labels], dtype=object)
        values = [label.evidence.get("margin") for label in labels]
        margin = None if None in values else pd.Series(values)
    # Strict about what a truth is: only true, false and the several spellings of unknown.
    foldable = pd.array([None if pd.isna(f) else _as_bool(f) for f in foldable], dtype="boolean")
    if len(foldable) != len(designs):
        raise InputError(f"the source gave {len(foldable)} answers to {len(designs)} designs")
    return foldable, None if margin is None else margin.to_numpy(dtype=float)
