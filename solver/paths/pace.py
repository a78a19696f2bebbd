"""Step sizes: how long the next step is, from how long the last one was and what it cost.

A rule sees sizes and iterations only, never a scene; the stepper keeps its state in a point's
``control``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.given import positive
from solver.paths.point import Metric


def towards(step: float, remaining: float) -> float:
    """The step towards a target: the last two share what remains, so that no sliver is left."""
    size = remaining / np.ceil(remaining / step - 1e-9) if remaining < 2 * step else step
    return remaining if size > remaining * (1 - 1e-12) else size


@dataclass(frozen=True)
class LoadPace:
    """Sizes of load steps, as ``LoadSteps`` describes them; ValueError for senseless ones."""

    step: float
    first: float
    smallest: float
    cut: float
    growth: float
    largest: float

    def __post_init__(self):
        positive(self, "step", "first", "smallest", "growth", "largest")
        if not (self.cut > 1 and self.growth >= 1):
            raise ValueError(
                f"cut = {self.cut}, growth = {self.growth}; expected cut > 1 and growth >= 1"
            )

    def now(self, control: tuple[float, ...]) -> float:
        """The step to take next; control of another stepper says nothing."""
        return control[0] if len(control) == 1 else self.first * self.step

    @property
    def least(self) -> float:
        """The step below which the path stops."""
        return self.smallest * self.step

    def following(self, step: float, iterations: int) -> float:
        """The step after one that took so many iterations of Newton's method."""
        most = self.largest * self.step if iterations <= 3 else self.step
        return max(step, min(self.growth * step, most))


@dataclass(frozen=True)
class ArcPace:
    """Semi-axes of arc length, as ``ArcLength`` describes them; ValueError for senseless ones.

    ``easy``: iterations of a step that is neither too long nor too short.
    """

    a: float
    b: float
    smallest: float
    largest: float
    easy: int

    def __post_init__(self):
        positive(self, "a", "b", "smallest", "largest", "easy")

    def now(self, control: tuple[float, ...]) -> tuple[float, float]:
        """The semi-axes to take next; control of another stepper says nothing."""
        return control if len(control) == 2 else (self.a, self.b)

    def allows(self, a: float, b: float) -> bool:
        """Whether semi-axes are not too small to go on with."""
        return max(a / self.a, b / self.b) >= self.smallest

    @staticmethod
    def shorter(a: float, b: float) -> tuple[float, float]:
        """The semi-axes after a failure (2.76)."""
        return a / np.sqrt(10), b / np.sqrt(10)

    def following(self, metric: Metric, moved: tuple[float, float], iterations: int) -> tuple:
        """The semi-axes after a step (2.75), with a gentle growth.

        ``metric``: of the step; ``moved``: displacement over length, and load, that it covered.
        """
        # Where the path runs along one axis (at a fold Δe is almost nothing) the other semi-axis
        # would vanish and have to grow again step by step, so their ratio stays within a factor of
        # ten of the first.
        rate = np.clip(np.sqrt(self.easy / iterations), 0.5, np.sqrt(2))
        now, first = np.array([metric.a, metric.b]), np.array([self.a, self.b])
        ratio = np.clip(np.sqrt(2) * np.array(moved) * rate, 0.5 * now, 2 * now) / first
        ratio = np.minimum(np.maximum(ratio, ratio.max() / 10), self.largest)
        return tuple(float(c) for c in ratio * first)
