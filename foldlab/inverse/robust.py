"""How robustly a design is predicted to do what is wished: score, margin and box.

Distances are in the unit cube of the groups (each on its own scale, bounds to bounds), max norm.
They extend along fixed groups too, since what is made differs from what is drawn, and end at the
bounds of the space, beyond which no label is defined. "Everywhere in a box" is judged at its
corners, the centres of its faces and a fixed set of points inside.

A wanted fold angle is κ l_i = (κ l_s/g)(l_i/l_s)|g| (Eq. 4.15 with 4.25): in the reduced space the
model gives κ l_s/g and the wish limits l_i/l_s and |g|, which then count as groups of the box.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd
from scipy.stats import qmc

from foldlab.errors import InputError
from foldlab.inverse.wish import Angle, Wish, box_parameters
from foldlab.learning.features import probability_of_folding


class Score:
    """How much better than required a design is predicted to be; ≥ 0 is as wished.

    For a label: its predicted probability less the one required. For an angle: the tolerance less
    the predicted deviation, rad. Raises :class:`InputError` where the needed model is absent.
    """

    def __init__(self, wish: Wish, classifier, angle_model):
        self.wish, self.classifier, self.angle_model = wish, classifier, angle_model
        self.parameters = box_parameters(wish)
        self.names = [p.name for p in self.parameters]
        if isinstance(wish.want, Angle):
            if angle_model is None:
                raise InputError("a fold angle needs angle_model: a formula source or a regressor")
        elif classifier is None:
            raise InputError(f"the label {wish.want!r} needs a classifier; train one first")
        self.pattern = pattern_points(len(self.parameters))

    def __call__(self, designs: pd.DataFrame) -> np.ndarray:
        want = self.wish.want
        if isinstance(want, Angle):
            return want.tolerance - np.abs(self.angle(designs) - want.value)
        p = self.probability(designs)
        return (p if want == "foldable" else 1 - p) - self.wish.min_probability

    def probability(self, designs: pd.DataFrame) -> np.ndarray:
        return probability_of_folding(self.classifier, designs[self.wish.space.names])

    def angle(self, designs: pd.DataFrame) -> np.ndarray:
        groups = designs[self.wish.space.names]
        if hasattr(self.angle_model, "evaluate"):
            table = self.angle_model.evaluate(groups)
            if "fold_angle" in table:
                return table["fold_angle"].to_numpy(float)
            value = table["normalised_angle"].to_numpy(float)
        else:
            value = np.asarray(self.angle_model.predict(groups), dtype=float)
            if "contraction" in self.wish.space.names:
                return value
        return value * designs["hinge_length"].to_numpy() * designs["contraction"].to_numpy()

    def unit(self, designs: pd.DataFrame) -> np.ndarray:
        return np.column_stack([p.to_unit(designs[p.name].to_numpy()) for p in self.parameters])

    def frame(self, unit: np.ndarray) -> pd.DataFrame:
        return pd.DataFrame(
            {p.name: p.from_unit(unit[:, k]) for k, p in enumerate(self.parameters)}
        )

    def everywhere(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """The worst score in each box; ends in the unit cube, shape (n, groups)."""
        low, high = np.clip(low, 0, 1)[:, None], np.clip(high, 0, 1)[:, None]
        points = low + self.pattern * (high - low)
        flat = self(self.frame(points.reshape(-1, points.shape[2])))
        return flat.reshape(points.shape[:2]).min(axis=1)

    def margin(self, unit: np.ndarray) -> np.ndarray:
        """Half-width of the largest cube of the wished behaviour around each point, shape (n,)."""
        good, bad = np.full(len(unit), self.wish.margin), np.full(len(unit), 0.5)
        for _ in range(11):
            half = (good + bad) / 2
            ok = self.everywhere(unit - half[:, None], unit + half[:, None]) >= 0
            good, bad = np.where(ok, half, good), np.where(ok, bad, half)
        return good

    def box(self, unit: np.ndarray, margin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Boxes grown side by side from the cube, half the wished margin inside the boundary."""
        guard = self.wish.margin / 2
        half = (margin - guard)[:, None]
        low, high = np.clip(unit - half, 0, 1), np.clip(unit + half, 0, 1)
        for factor in (2.0, 2.0, 1.5, 1.25):
            for k in range(unit.shape[1]):
                for side, sign in ((low, -1), (high, 1)):
                    tried = side.copy()
                    tried[:, k] = unit[:, k] + factor * (side[:, k] - unit[:, k])
                    ends = (tried, high) if sign < 0 else (low, tried)
                    ok = self.everywhere(ends[0] - guard, ends[1] + guard) >= 0
                    side[ok, k] = np.clip(tried[ok, k], 0, 1)
        return low, high


def pattern_points(d: int) -> np.ndarray:
    """Centre, corners (64 of them beyond six groups), face centres and inner points of a cube."""
    corners = np.array(list(product((0.0, 1.0), repeat=d)))
    if d > 6:
        corners = corners[np.random.default_rng(0).choice(len(corners), 64, replace=False)]
    faces = np.full((2 * d, d), 0.5)
    for k in range(d):
        faces[2 * k : 2 * k + 2, k] = 0.0, 1.0
    inner = qmc.Halton(d=d, rng=0).random(16)
    return np.vstack([np.full((1, d), 0.5), corners, faces, inner])
