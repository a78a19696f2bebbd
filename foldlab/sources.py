"""Label sources. The only foldlab file that may import ``solver``."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from foldlab import timoshenko
from foldlab.design import REDUCED, DesignSpace
from foldlab.errors import InputError
from foldlab.labels import Label
from foldlab.settings import call


class TimoshenkoSource:
    """Labels from the bimetal strip: no weight, small strain, no edges.

    In the reduced space Eq. 4.26 *defines* the label, so its error is 0. In the full space a design
    folds if the hinge alone turns by more than |g|π (F1 of Eq. 4.21); weight is not seen there and
    the error is unknown (None).
    """

    name = "timoshenko"
    version = "1"

    def __init__(self, space: DesignSpace = REDUCED, assumption: timoshenko.Assumption = "strip"):
        if assumption not in timoshenko.ASSUMPTIONS:
            raise InputError(
                f"no assumption {assumption!r}; there are: {', '.join(timoshenko.ASSUMPTIONS)}"
            )
        self.space = space
        self.assumption = assumption
        if assumption != "strip":
            self.version = f"1-{assumption}"

    def label(self, design: Mapping[str, float]) -> Label:
        return self.label_many(pd.DataFrame([dict(design)]))[0]

    def label_many(self, designs: pd.DataFrame) -> list[Label]:
        start = time.perf_counter()
        table = self.evaluate(designs)
        seconds = (time.perf_counter() - start) / len(table)
        groups = table[self.space.names].to_dict("records")
        evidence = table.drop(columns=[*self.space.names, "foldable"]).to_dict("records")
        exact = 0.0 if "contraction" not in table else None
        return [
            Label(
                design=design,
                foldable=bool(foldable),
                reason=_reason(foldable, values),
                evidence={**values, "error_estimate": exact, "seconds": seconds},
                source=self.name,
                version=self.version,
            )
            for design, foldable, values in zip(groups, table["foldable"], evidence, strict=True)
        ]

    def evaluate(self, designs: pd.DataFrame) -> pd.DataFrame:
        """Vectorised: groups with ``normalised_angle``, ``threshold``, ``margin``, ``foldable``.

        ``margin`` = ln(angle / threshold): 0.1 means that the angle clears the threshold by 10 %.
        """
        table = self.space.validate(designs)
        angle = timoshenko.normalised_angle(
            table["E_ratio"], table["h_ratio"], table["slenderness"], assumption=self.assumption
        )
        threshold = timoshenko.FULL_TURN
        if "contraction" in table:
            table["fold_angle"] = angle * table["hinge_length"] * table["contraction"]
            angle, threshold = angle * table["hinge_length"], np.pi
        table["normalised_angle"] = angle
        table["threshold"] = threshold
        table["margin"] = np.log(angle / threshold)
        table["foldable"] = angle >= threshold
        return table


def _reason(foldable: bool, values: Mapping[str, float]) -> str:
    verdict = "reaches" if foldable else "stays below"
    return (
        f"the angle per unit strain, {values['normalised_angle']:.4g}, {verdict} the threshold "
        f"{values['threshold']:.4g}"
    )


SOURCES = {"timoshenko": TimoshenkoSource}


def make_source(name: str, settings: Mapping[str, Any] | None = None, **fixed):
    """A label source by name, with a user's ``settings`` checked against its types.

    ``fixed`` is what the program gives, such as the space. Raises :class:`InputError` for an
    unknown source, unknown settings or values of a wrong type.
    """
    if name not in SOURCES:
        raise InputError(f"no label source {name!r}; there are: {', '.join(SOURCES)}")
    return call(SOURCES[name], settings or {}, what=f"source {name!r}", **fixed)
