"""Terms that watch the clock: seconds of every effect, and the deadline of a path."""

from __future__ import annotations

import time

import numpy as np

from solver.physics.term import Evaluation


class Timed:
    """A term that keeps the time it takes, in ``clock[name]``: evaluations and seconds."""

    def __init__(self, term, clock: dict[str, list[float]]):
        self._term, self._spent = term, clock.setdefault(term.name, [0, 0.0])

    def __getattr__(self, name):
        return getattr(self._term, name)

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """The term's own."""
        start = time.perf_counter()
        found = self._term.evaluate(u, e, order)
        self._spent[0] += 1
        self._spent[1] += time.perf_counter() - start
        return found


class OutOfTime(Exception):
    """The deadline of a path has passed."""


class Deadline:
    """A term that adds nothing and raises :class:`OutOfTime` once ``time.monotonic()`` is past
    ``at``: any iteration, however deep, then ends. Part of a scene only where there is a limit."""

    name, graph, symmetric = "deadline", None, True

    def __init__(self, at: float):
        self.at = at

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Nothing."""
        if time.monotonic() > self.at:
            raise OutOfTime
        return Evaluation(0.0, np.zeros(()))
