"""Points of a path, its end, and the scalar product that makes displacement and load comparable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene


@dataclass(frozen=True, eq=False)
class Point:
    """An equilibrium on a path, and all that is needed to go on from it.

    ``x`` (size,), ``e``; ``tangent`` (size + 1,): d(x, e)/ds along the way the path was walked;
    ``unstable``: number of unstable modes, None if they can't be counted; ``energy``: None where
    there is none; ``iterations``: factorisations since the last point, rejected steps included;
    ``step``: change of e; ``residual``: largest entry over the scene's force; ``events``: what was
    located between the last point and this one; ``control``: step control of the stepper that came
    here; ``metric``: its sizes (of displacement over length, of e); ``history``: up to three points
    before, each as (e, x, tangent).
    """

    index: int
    e: float
    x: np.ndarray
    tangent: np.ndarray
    metric: Metric
    unstable: int | None
    energy: float | None
    iterations: int
    step: float
    residual: float
    control: tuple[float, ...] = ()
    events: tuple = ()
    history: tuple[tuple[float, np.ndarray, np.ndarray], ...] = ()

    @property
    def z(self) -> np.ndarray:
        """(x, e) as one vector, (size + 1,)."""
        return np.append(self.x, self.e)

    def past(self) -> tuple[tuple[float, np.ndarray, np.ndarray], ...]:
        """History for the next point: this one first."""
        return ((self.e, self.x, self.tangent), *self.history)[:3]


class Uncounted(UserWarning):
    """Unstable modes of points of a path were not counted, so its events and its stability are
    unknown there."""


class Unlocated(UserWarning):
    """Stability or the direction of the load changed between two points of a path, and the fold or
    branch point there was not located."""


@dataclass(frozen=True, eq=False)
class Ended:
    """Why a path has no next point, and what was located beyond its last one.

    ``why``: gives what the last attempt failed at, a sentence, or nothing where the outcome says it
    all. It is asked only where a path ends, for a stepper may go on from what another met.
    """

    outcome: Outcome
    events: tuple = ()
    why: Callable[[], str] = str

    @cached_property
    def detail(self) -> str:
        """What the last attempt failed at; empty where the outcome says it all."""
        return self.why()

    @property
    def reason(self) -> str:
        """The outcome's sentence and the detail."""
        return reason(self.outcome, self.detail)


def reason(outcome: Outcome, detail: str) -> str:
    """An outcome's sentence, and what it was in this case."""
    return f"{outcome.value}; {detail}" if detail else outcome.value


@dataclass(frozen=True)
class Metric:
    """Scalar product that makes displacement and load comparable: ‖Δu‖_rms / (a length), Δe / b."""

    a: float
    b: float
    n: int
    length: float

    def row(self, z: np.ndarray) -> np.ndarray:
        """The row r with r · z' = ⟨z, z'⟩; z (size + 1,)."""
        r = np.zeros_like(z)
        r[: self.n] = z[: self.n] / (self.n * (self.a * self.length) ** 2)
        r[-1] = z[-1] / self.b**2
        return r

    def dot(self, z: np.ndarray, other: np.ndarray) -> float:
        """⟨z, z'⟩."""
        v = z[: self.n] @ other[: self.n] / (self.n * (self.a * self.length) ** 2)
        return float(v + z[-1] * other[-1] / self.b**2)

    def norm(self, z: np.ndarray) -> float:
        """‖z‖."""
        return float(np.sqrt(self.dot(z, z)))

    def unit(self, z: np.ndarray) -> np.ndarray:
        """z / ‖z‖."""
        return z / self.norm(z)

    def sized(self, a: float, b: float) -> Metric:
        """The same product with other sizes."""
        return Metric(a, b, self.n, self.length)


def displacement_size(scene: Scene, x: np.ndarray) -> float:
    """Root mean square of the free components over the scene's length."""
    q = x[: scene.n_free]
    return float(np.linalg.norm(q) / np.sqrt(max(len(q), 1)) / scene.scales.length)
