"""What is answered at once: facts for the page, the models' answer to a design, and a map."""

from __future__ import annotations

import base64
import math
import threading
import time
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from foldlab.design import FULL, PHYSICAL, DesignSpace, to_groups
from foldlab.errors import InputError
from foldlab.explore.asked import SIZES, Asked, asked, choice, materials, number, only
from foldlab.unit.told import in_degrees

if TYPE_CHECKING:
    from foldlab.predicted import Predictor

SIDE = 48  # of a map, in designs
# What the page opens with: the unit of the README, 40 mm of PET with 10 mm of polymer.
FIRST = {
    "quantities": {
        "l_s": 0.04, "b_s": 0.01, "h_s": 1e-4, "l_i": 0.01, "h_i": 2e-4, "contraction": 0.2,
    },
    "passive": "polyester film",
    "active": "shape-memory polymer",
}  # fmt: skip


class Live:
    """The shipped models, loaded when first asked or by :meth:`warm`; safe among threads."""

    def __init__(self):
        self._lock = threading.RLock()
        self._loading = False

    def warm(self) -> None:
        """Load and run what an answer needs; meanwhile a rod, which is there first, answers."""
        self._loading = True
        what = asked(FIRST)
        self._why(what.groups)
        self._answer(what)
        self.map({"design": FIRST, "x": "h_s", "y": "h_i"})
        self._loading = False

    @cached_property
    def _model(self) -> Predictor:
        from foldlab.learning.saving import shipped_for
        from foldlab.predicted import Predictor

        return Predictor.of(shipped_for(FULL.name))

    @cached_property
    def _threads(self):
        from threadpoolctl import ThreadpoolController

        self._model.angles(pd.DataFrame([asked(FIRST).groups]))  # which loads its libraries
        return ThreadpoolController()

    @cached_property
    def _rod(self):
        from foldlab.labels.rod import RodSource

        return RodSource()

    def facts(self, request: Any) -> dict[str, Any]:
        """Sliders, materials and the first design; of no model, so that the page opens at once."""
        only(request, (), "facts")
        table = materials()
        return {
            "groups": _sliders(FULL, dict.fromkeys(FULL.names, "1")),
            "sizes": _sliders(SIZES, PHYSICAL),
            "materials": {
                role: [
                    {"name": name, "basis": row["basis"], "also": row["aliases"]}
                    for name, row in table[table["role"] == role].iterrows()
                ]
                for role in ("passive", "active")
            },
            "first": FIRST,
        }

    def answer(self, request: Any) -> dict[str, Any]:
        """What the models say of a design, and what a rod says why; no ``probability`` while the
        models are being loaded."""
        start = time.perf_counter()
        what = asked(request)
        told = self._early(what) if self._loading else self._answer(what)
        return told | {"seconds": time.perf_counter() - start}

    def _answer(self, what: Asked) -> dict[str, Any]:
        frame = pd.DataFrame([what.groups])
        # One design is too little work to share: where the cores are busy, threads that wait for
        # each other took it seconds.
        with self._lock, self._threads.limit(limits=1):
            said = self._model.answers(frame)
            angle, off = self._angle(frame)
            near = self._model.nearest(frame).iloc[0]
        foldable = said["foldable"][0]
        early = self._early(what)
        need = early["need"]
        card = self._model.card["metadata"]
        return early | {
            "probability": float(said["probability"][0]),
            "foldable": None if foldable is pd.NA else bool(foldable),
            "outside": _outside(what.groups, card.get("bounds", {})),
            "fold_angle": angle,
            # rad, of nine in ten
            "fold_angle_error": None if angle is None else off * max(abs(angle), need),
            "nearest_foldable": _plain(near.get("nearest_foldable")),
            "nearest_distance": _plain(near.get("nearest_distance")),
            "coverage": card["borders"]["coverage"] if card.get("borders") else None,
        }

    def _angle(self, frame: pd.DataFrame) -> tuple[float | None, float | None]:
        try:
            angles, off = self._model.angles(frame)
        except InputError:  # beyond what a rod knows
            return None, None
        return (None, None) if angles is None else (float(angles[0]), off)

    def _early(self, what: Asked) -> dict[str, Any]:
        """What is known without the models."""
        rod = self._why(what.groups)
        return {
            "groups": dict(what.groups),
            "physical": None if what.unit is None else dict(what.unit.physical),
            "materials": None if what.unit is None else dict(what.unit.materials),
            "need": math.pi * what.groups["contraction"],
            "rod": rod,
            "probability": None,
            "foldable": rod and rod["foldable"],
            "fold_angle": rod and rod["fold_angle"],
        }

    def _why(self, groups: Mapping[str, float]) -> dict[str, Any] | None:
        try:
            label = self._rod.label(groups)
        except InputError:
            return None
        angle = label.evidence.get("m1")
        reason = in_degrees(label.reason)
        return {"foldable": label.foldable, "reason": reason, "fold_angle": angle}

    def ranges(self, request: Any) -> dict[str, Any]:
        """What the ranges of materials leave open, in words, of a unit of which some quantity is
        known by its material only: ``said``, None of others."""
        from foldlab.labels.solver import SolverSource
        from foldlab.unit.check import uncertainty
        from foldlab.unit.told import over

        unit = asked(request).unit
        left = None if unit is None or not unit.ranges else uncertainty(unit, SolverSource())
        return {"said": None if left is None else over(left)}

    def map(self, request: Any) -> dict[str, Any]:
        """Probability of folding over two sliders, all else as the design has it: rows of y, each
        of x, in float32 and base64; NaN where there is no unit. ``light``: signed distance to the
        boundary without weight (Timoshenko)."""
        start = time.perf_counter()
        request = only(request, ("design", "x", "y", "side"), "a map")
        what = asked(request.get("design"))
        space = SIZES if "quantities" in request["design"] else FULL
        x, y = (choice(request, axis, space.names) for axis in "xy")
        if x == y:
            raise InputError(f"both axes are {x}; take two")
        side = int(number(request, "side", SIDE, (2, 128)))
        designs, there = _grid(what, space, x, y, side)
        p, light = np.full((2, side * side), np.nan, dtype=np.float32)
        with self._lock, self._threads.limit(limits=1):
            if there.any():
                p[there] = self._model.answers(designs[there])["probability"]
                light[there] = _timoshenko(designs[there])
            borders = self._model.borders
        return {
            "x": x, "y": y, "side": side, "probability": packed(p), "light": packed(light),
            "folds_from": borders.folds_from if borders else 0.5,
            "not_up_to": borders.not_up_to if borders else 0.5,
            "seconds": time.perf_counter() - start,
        }  # fmt: skip


def _grid(
    what: Asked, space: DesignSpace, x: str, y: str, side: int
) -> tuple[pd.DataFrame, np.ndarray]:
    """Groups of the designs at the middles of the map's cells, and which of them are units."""
    cells = (np.arange(side) + 0.5) / side
    b, a = np.meshgrid(space[y].from_unit(cells), space[x].from_unit(cells), indexing="ij")
    columns = {x: a.ravel(), y: b.ravel()}
    if space is FULL:
        designs = pd.DataFrame({**what.groups, **columns}, index=range(side * side))
        return designs[FULL.names], np.ones(len(designs), dtype=bool)
    physical = pd.DataFrame({**what.unit.physical, **columns}, index=range(side * side))
    if what.unit.physical["b_i"] == what.unit.physical["b_s"] and "b_i" not in (x, y):
        physical["b_i"] = physical["b_s"]
    there = (physical["l_i"] < physical["l_s"]) & (physical["b_i"] <= physical["b_s"])
    return to_groups(physical)[FULL.names], there.to_numpy()


def _timoshenko(designs: pd.DataFrame) -> np.ndarray:
    from foldlab.labels.label import truth_of
    from foldlab.labels.timoshenko import TimoshenkoSource

    ends = {name: (0.9 * designs[name].min(), 1.1 * designs[name].max()) for name in FULL.names}
    return truth_of(TimoshenkoSource(space=FULL.with_bounds(**ends)), designs)[1]


def _outside(groups: Mapping[str, float], bounds: Mapping[str, list[float]]) -> list[str]:
    """Groups that lie beyond all that a model learned from, by more than a hundredth of the
    space."""
    out = []
    for name, ends in bounds.items():
        low, at, high = FULL[name].to_unit([ends[0], groups[name], ends[1]])
        if not low - 0.01 <= at <= high + 0.01:
            out.append(name)
    return out


def _sliders(space: DesignSpace, units: Mapping[str, str]) -> list[dict[str, Any]]:
    return [
        {
            "name": p.name, "symbol": p.symbol, "low": p.low, "high": p.high, "scale": p.scale,
            "meaning": p.meaning, "unit": units[p.name],
        }
        for p in space
    ]  # fmt: skip


def packed(array: np.ndarray, kind: str = "<f4") -> str:
    """Numbers in little-endian order as base64, row by row."""
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode("ascii")


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else value
