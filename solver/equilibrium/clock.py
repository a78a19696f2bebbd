"""Core-seconds of a label, and terms that watch them: time of every effect, deadline of a path.

What a computation may take is counted in CPU time of the thread that computes, so that a design has
the same answer whatever else runs on the machine; compiling, which happens once, is not counted.
"""

from __future__ import annotations

import logging
import threading
import time
from contextlib import contextmanager

import numpy as np
from numba.core import event
from threadpoolctl import threadpool_limits

from solver.equilibrium.linear import mkl_pardiso
from solver.physics.term import Evaluation


class _Own(threading.local):
    """Of one thread: how deep it is in the compiler, since when, and what it spent there."""

    depth, since, spent = 0, 0.0, 0.0


class Compiling(event.Listener):
    """Keeps the CPU time that each thread spends in Numba's compiler or on its cached code, and
    says when the first of our functions is compiled."""

    def __init__(self):
        self._own = _Own()
        self._told = False

    def on_start(self, event) -> None:
        """Numba asks for its compiler, or compiles."""
        if event.kind == "numba:compile":
            function = getattr(event.data["dispatcher"], "py_func", None)
            ours = getattr(function, "__module__", "").startswith("solver.")
            if ours and not self._told:
                self._told = True
                logging.getLogger(__name__).warning("compiling, first time only")
            return
        self._own.depth += 1
        if self._own.depth == 1:
            self._own.since = time.thread_time()

    def on_end(self, event) -> None:
        """It is done."""
        if event.kind == "numba:compile":
            return
        self._own.depth -= 1
        if self._own.depth == 0:
            self._own.spent += time.thread_time() - self._own.since

    @property
    def spent(self) -> float:
        """Seconds of this thread."""
        return self._own.spent


compiling = Compiling()
for _kind in ("numba:compiler_lock", "numba:compile"):
    event.register(_kind, compiling)


def core_seconds() -> float:
    """CPU time of this thread without what it spent on compiling, s."""
    return time.thread_time() - compiling.spent


_lock = threading.Lock()
_within, _limits = 0, None


@contextmanager
def one_core():
    """One thread for the numerical libraries: the core-seconds of a thread are then all its work.

    What was allowed before is allowed again when the last of those inside has left.
    """
    global _within, _limits
    mkl_pardiso()  # a library that loads later would have as many threads as it likes
    with _lock:
        _within += 1
        if _within == 1:
            _limits = threadpool_limits(1)
    try:
        yield
    finally:
        with _lock:
            _within -= 1
            if _within == 0:
                _limits.restore_original_limits()


class Timed:
    """A term that keeps the time it takes, in ``clock[name]``: evaluations and core-seconds."""

    def __init__(self, term, clock: dict[str, list[float]]):
        self._term, self._spent = term, clock.setdefault(term.name, [0, 0.0])

    def __getattr__(self, name):
        return getattr(self._term, name)

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """The term's own."""
        start = core_seconds()
        evaluation = self._term.evaluate(u, e, order)
        self._spent[0] += 1
        self._spent[1] += core_seconds() - start
        return evaluation


class OutOfTime(Exception):
    """The deadline of a path has passed."""


class Deadline:
    """A term that adds nothing and raises :class:`OutOfTime` once :func:`core_seconds` is past
    ``at``: any iteration, however deep, then ends. Part of a scene only where there is a limit."""

    name, graph, symmetric = "deadline", None, True

    def __init__(self, at: float):
        self.at = at

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Nothing."""
        if core_seconds() > self.at:
            raise OutOfTime
        return Evaluation(0.0, np.zeros(()))
