"""Rungs below the solver: what beam formulas, a model or the rod say of designs under weight.

Each gives the ``worth`` of designs for a wish, ≥ 0 where they do as wished. The formulas take a
microsecond, the rod half a millisecond; the solver decides (``finish``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from foldlab.design import FULL, PATTERNED, STRIPS
from foldlab.errors import InputError
from foldlab.inverse.wish import Angle, Wish
from foldlab.labels import beam
from foldlab.labels.rod import RodSource
from foldlab.learning.features import probability_of_folding

# The full space, and sheets that feel their weight much more or hardly: rod and solver know them.
SPACE = FULL.with_bounds(stiffness_to_weight=(1e-4, 1e6))
CUT_SPACE = PATTERNED.with_bounds(stiffness_to_weight=(1e-4, 1e6))
# rad: panels meet at π. Designs that reach it are wished for only where nothing else folds.
MEET = 0.97 * np.pi
# rad by which the formulas may miss an angle that a rod is then driven to.
NEAR = 0.3
LOST = -10.0
# rad beyond the touch of its panels by which a rod may turn: panels that press on each other harder
# lose their mirror plane, and with it the solver's contact.
PRESSED = 1.0


@dataclass(frozen=True)
class Rungs:
    """``model``: a classifier of the full space, or None; ``meet``: whether panels may meet;
    ``rocking``: whether designs that topple by the rod are left to the solver, which says otherwise
    of 7 % of the units that fold."""

    wish: Wish
    model: Any = None
    meet: bool = False
    rocking: bool = False

    def room(self, angle, contraction) -> np.ndarray:
        """rad to spare of fold angles; ≥ 0 is as wished; NaN is lost."""
        want, need = self.wish.want, np.pi * np.asarray(contraction)
        angle = np.asarray(angle, dtype=float)
        if isinstance(want, Angle):
            room = want.tolerance - np.abs(angle - want.value)
        elif want == "flat":
            room = need - angle
        else:
            room = angle - need if self.meet else np.minimum(angle - need, MEET - angle)
        return np.where(np.isfinite(room), room, LOST)

    def first(self, designs: pd.DataFrame) -> np.ndarray:
        """Worth by the beam formulas, and by the model where there is one for a label, shape (n,);
        an angle may be missed by :data:`NEAR`."""
        want, contraction = self.wish.want, designs["contraction"].to_numpy()
        angle = beam.formulas(solid(designs))["net"].to_numpy() * np.pi * contraction
        if isinstance(want, Angle):
            return NEAR - np.abs(angle - want.value)
        if self.model is None:
            return self.room(angle, contraction)
        known = FULL.from_unit(np.clip(FULL.to_unit(designs), 0, 1))
        p = probability_of_folding(self.model, known)
        room = (p if want == "foldable" else 1 - p) - self.wish.min_probability
        return room if self.meet or want == "flat" else np.minimum(room, MEET - angle)

    def rod(self, designs: pd.DataFrame) -> pd.DataFrame:
        """The rod's ``angle`` and its ``error``, rad, and whether it ``topples``; NaN where it
        finds no stable state."""
        rows = [answered(design) for design in designs.to_dict("records")]
        return pd.DataFrame(rows, columns=["angle", "error", "topples"], dtype=float)

    def second(self, designs: pd.DataFrame, slack: float = 0.0) -> np.ndarray:
        """Worth by the rod, shape (n,), rad; ``slack`` widens an angle's tolerance."""
        return self.rooms(designs) + slack

    def rooms(self, designs: pd.DataFrame, correction: float = 0.0) -> np.ndarray:
        """rad to spare by the rod, whose angles are off by ``correction``; shape (n,)."""
        rod = self.rod(designs)
        room = self.room(rod["angle"] + correction, designs["contraction"].to_numpy())
        if self.wish.touching is not None:
            apart = np.array([parted(design) for design in designs.to_dict("records")])
            kept = np.minimum(-apart, PRESSED + apart) if self.wish.touching else apart
            room = np.where(np.isfinite(apart), np.minimum(room, kept), LOST)
        asked = self.wish.stands and not self.rocking
        return np.where((rod["topples"].to_numpy() != 0) & asked, np.minimum(room, LOST), room)


def turned(design: Mapping[str, float]) -> tuple[float, float]:
    """The rod's angle of one design and its error, rad; NaN where it finds no stable state."""
    return answered(design)[:2]


def answered(design: Mapping[str, float]) -> tuple[float, float, float]:
    """As :func:`turned`, and 1 where it topples, else 0."""
    try:
        label = RodSource(sure=False).label(solid(design))
    except InputError:  # no rod is known for such layers
        return np.nan, np.nan, np.nan
    if label.foldable is None:
        return np.nan, np.nan, np.nan
    angle = label.evidence["m1"]
    scale = max(abs(angle), np.pi * design["contraction"])
    return angle, label.evidence["error_estimate"] * scale, float(label.evidence["topples"])


def solid(design):
    """The groups of a design, or of a table of them, whose active layer is solid.

    Strips count as a layer so much softer and lighter as they cover less of the hinge; where the
    rod knows none so soft, as one that is thinner by as much as its moment E_i h_i (h_i + h_s) is
    less.
    """
    if "strip_share" not in design:
        return design
    cover, h = design["strip_share"], design["h_ratio"]
    E = np.maximum(design["E_ratio"] * cover, FULL["E_ratio"].low)
    moment = h * (1 + h) * design["E_ratio"] * cover / E
    thin = 2 * moment / (1 + np.sqrt(1 + 4 * moment))
    out = {name: design[name] for name in design if name not in STRIPS}
    out |= {"E_ratio": E, "h_ratio": thin, "rho_ratio": design["rho_ratio"] * cover * h / thin}
    return pd.DataFrame(out) if isinstance(design, pd.DataFrame) else out


def parted(design: Mapping[str, float]) -> float:
    """By how much the rod may still turn until its panels touch, rad; ≤ 0 where they would pass
    through each other, NaN where it finds no stable state."""
    try:
        rod = RodSource(sure=False).bent(solid(design))
    except InputError:
        return np.nan
    if not rod.settled:
        return np.nan
    angle = np.cumsum(rod.turns)
    reach = np.cumsum(np.diff(rod.s) * np.cos(angle - rod.turns / 2))
    half = design["hinge_length"] / 2
    panel = rod.s[1:] > half * (1 + 1e-9)
    # Half a thickness lies between the middle of the sheet and its upper side.
    gaps = reach - design["slenderness"] / 2 * np.sin(angle)
    return float((2 * gaps[panel] / (rod.s[1:][panel] - half / 2)).min())
