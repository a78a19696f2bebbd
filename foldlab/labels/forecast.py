"""What a solver label will cost, from the labels of like designs in the shipped dataset.

Alike are designs whose hinge would turn as far, curl as far and lift as much weight: these decide
how many steps a path takes and whether it needs the whole unit. The median of sixteen neighbours is
the forecast. Seconds are those of this machine: a short piece of linear algebra is timed against
what it took where the dataset was made.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.labels.timoshenko import lift_off_stiffness, normalised_angle

NEIGHBOURS = 16
# Weight of each feature, over its standard deviation: what decides the path, then all groups.
WEIGHTS = np.r_[2.0 * np.ones(4), 0.7 * np.ones(len(FULL.names))]
# Of finer meshes: unknowns over those of the second mesh, and core-seconds per 1000 unknowns to
# find the last state there.
FINER = {2: 2.2, 3: 5.8}
SECONDS_PER_1000 = 0.22
# MiB of a process that forecasts and solves, and per 1000 unknowns; a campaign's workers, which
# load no tables, hold 120 less.
MEMORY = (330.0, 33.0)
# Of labels that the dataset has none of: seconds over those of their neighbours in it (one in ten
# less, the median, one in ten more), from 20 of its designs solved so. Toppling decides what a free
# unit takes: it hardly ever pays, or many times over.
ACTING = {
    "gravity,ground": (1.0, 1.0, 1.0),
    "gravity,ground,contact": (1.06, 1.11, 1.16),
    "contact": (0.71, 0.73, 0.87),
    "none": (0.68, 0.63, 0.63),
}
FREE = (1.0, 3.2, 9.0)
# Seconds of a label today over those of its like in the dataset, which an earlier version made: the
# median of 200 uniaxial and of 60 isotropic labels.
TODAY = {"uniaxial": 0.55, "isotropic": 0.6}
# Seconds of :func:`pace`'s piece of work where the dataset was made.
PACE = 1.78e-3


@dataclass(frozen=True)
class Forecast:
    """Core-seconds and MiB a label is expected to cost; ``low`` and ``high``: of like designs, one
    in ten took less, one in ten more."""

    seconds: float
    low: float
    high: float
    memory_mb: float

    def sentence(self, accuracy: float) -> str:
        """For the eye."""
        return (
            f"expected: {self.seconds:.2g} core-seconds ({self.low:.2g} to {self.high:.2g}) and "
            f"{self.memory_mb:.0f} MB for an error of the angle below {100 * accuracy:g} %"
        )


def forecast(design: Mapping[str, float], source) -> Forecast | None:
    """For a design and a :class:`foldlab.labels.solver.SolverSource`.

    None where no like labels are at hand: other questions than "from_flat", strips, noise.
    """
    strips = source.patterned or source.conditions.strips
    if source.question != "from_flat" or strips or source.seed is not None:
        return None
    design = source.changing.at_end(design)
    table, tree, scale = _labels(source.conditions.growth)
    if not source.conditions.heavy:
        # Weightless designs are most like those of the stiffest sheets.
        design = {**design, "stiffness_to_weight": float(FULL["stiffness_to_weight"].high)}
    at = _features(pd.DataFrame([dict(design)])[FULL.names].astype(float)) / scale * WEIGHTS
    near = table.iloc[tree.query(at[0], min(NEIGHBOURS, len(table)))[1]]
    seconds = near["core_seconds"].to_numpy(float)
    unknowns = near["unknowns"].to_numpy(float)
    levels = near["levels"].to_numpy(int)
    second = unknowns / np.where(levels > 2, FINER[2], 1.0)
    error = near["error_estimate"].to_numpy(float)
    # A finer mesh has about a quarter of the error.
    third = np.where(levels > 2, error * 4, error) > source.effort.accuracy
    if source.effort.plan.finest > 2:
        fourth, third = np.where(levels > 2, error, error / 4) > source.effort.accuracy, error >= 0
        seconds = seconds + np.where(fourth, FINER[3] * second, 0.0) * SECONDS_PER_1000 / 1000
    more = np.where(third & (levels == 2), FINER[2] * second, 0.0)
    seconds = seconds + more * SECONDS_PER_1000 / 1000
    sizes = second * np.where(third, FINER[2], 1.0)
    if source.effort.plan.finest > 2:
        sizes = np.where(fourth, FINER[3] * second, sizes)
    factor = np.array(ACTING[source.conditions.effects]) * TODAY[source.conditions.growth]
    if source.conditions.heavy and not source.conditions.upright:
        factor = factor * FREE
    low, middle, high = np.quantile(seconds, [0.1, 0.5, 0.9]) * factor * pace()
    memory = MEMORY[0] + MEMORY[1] * float(np.median(sizes)) / 1000
    return Forecast(float(middle), float(low), float(high), memory)


@lru_cache(maxsize=2)
def _labels(growth: str):
    table = load_dataset("gravity-5k")
    kept = (table["growth"] == growth) & table["core_seconds"].notna()
    table = table[kept & (table["outcome"] != "timeout")]
    features = _features(table[FULL.names].astype(float))
    scale = features.std(axis=0)
    return table, cKDTree(features / scale * WEIGHTS), scale


def _features(groups: pd.DataFrame) -> np.ndarray:
    """(designs, 4 + groups): logs of Timoshenko's turning along and across the hinge, of the weight
    over what lifts, of Γ; and of all groups."""
    angle = normalised_angle(groups["E_ratio"], groups["h_ratio"], groups["slenderness"])
    curvature = angle * groups["contraction"]
    least = np.array([lift_off_stiffness(row) for row in groups.to_dict("records")])
    gamma = groups["stiffness_to_weight"]
    first = [
        curvature * groups["hinge_length"],
        curvature * groups["hinge_width"] * groups["aspect"],
        least / gamma,
        gamma,
    ]
    return np.log(np.column_stack([*first, groups[FULL.names]]))


@lru_cache(maxsize=1)
def pace() -> float:
    """How long this machine takes over the one that made the dataset."""
    a = np.random.default_rng(0).standard_normal((160, 160))
    a = a + a.T
    spent = []
    with threadpool_limits(1):
        for _ in range(5):
            # The clock may tick as coarsely as 10 ms: go on until it has moved.
            start, runs, passed = time.thread_time(), 0, 0.0
            while passed <= 0:
                np.linalg.eigh(a)
                runs += 1
                passed = time.thread_time() - start
            spent.append(passed / runs)
    return min(spent) / PACE
