"""What a label is, who makes labels, and the store that keeps them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import pandas as pd


@dataclass(frozen=True)
class Label:
    """The answer to "does this design fold?", with the reason and the evidence.

    ``foldable`` is None where the source could not tell; ``reason`` is one sentence either way.
    ``evidence`` holds plain JSON values: angle (rad), error estimate, margin, seconds, …
    """

    design: Mapping[str, float]
    foldable: bool | None
    reason: str
    evidence: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""
    version: str = ""


@runtime_checkable
class LabelSource(Protocol):
    """Turns a design into a label. ``name`` and ``version`` identify the rows in the store.

    A source that is a formula also has ``label_many(designs: DataFrame) -> list[Label]``.
    Sources are pickled to worker processes.
    """

    name: str
    version: str

    def label(self, design: Mapping[str, float]) -> Label: ...


def labels_to_frame(labels) -> pd.DataFrame:
    """Flat table: the groups, ``foldable`` (nullable boolean), reason, evidence, source, version."""
    rows = [
        {
            **label.design,
            "foldable": label.foldable,
            "reason": label.reason,
            **label.evidence,
            "source": label.source,
            "version": label.version,
        }
        for label in labels
    ]
    frame = pd.DataFrame(rows)
    if len(frame):
        frame["foldable"] = frame["foldable"].astype("boolean")
    return frame
