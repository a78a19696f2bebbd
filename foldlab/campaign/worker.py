"""What runs in a campaign's worker processes, and how these processes are started and ended.

Only labels in plain values come back: a source's exceptions and odd results may not pickle.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import platform
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

from foldlab.errors import InputError
from foldlab.labels.label import Label, design_key, storable

LONGEST_MESSAGE = 500  # characters of an exception's message that a reason keeps


class Parcel:
    """A source on its way to workers: pickled once, unpickled once in each process that uses it.

    ``limit``: core-seconds of one label after which the process that computes it ends itself, and
    ``wall``: seconds on the wall, for a label that waits and computes nothing; no limit where it is
    None. They do not hold in the process where the parcel was made.
    """

    def __init__(self, source, limit: float | None = None, wall: float | None = None):
        self._source, self.limit, self.wall, self._home = source, limit, wall, _here()
        self._bytes: bytes | None = None

    @property
    def away(self) -> bool:
        return self._home != _here()

    @property
    def source(self):
        # Not on arrival: Dask's scheduler unpacks what it passes on, and may lack the source.
        if self._source is None:
            self._source = _unpickled(self._bytes, self.away)
        return self._source

    def pickled(self) -> bytes:
        if self._bytes is None:
            try:
                self._bytes = pickle.dumps(self._source)
            except Exception as error:
                raise InputError(
                    f"the label source can't be sent to worker processes ({sentence(error)}); "
                    "define its class in a module and keep locks, files and lambdas out of it"
                ) from None
        return self._bytes

    def __getstate__(self):
        return {**self.__dict__, "_source": None, "_bytes": self.pickled()}


@lru_cache(maxsize=1)
def _unpickled(source: bytes, away: bool):
    if not away:
        return pickle.loads(source)
    # Before, for the libraries that the source imports; after, for those that it has loaded.
    one_thread()
    unpickled = pickle.loads(source)
    one_thread()
    return unpickled


def _here() -> str:
    return f"{platform.node()} {os.getpid()}"


def one_thread() -> None:
    """One thread for the numerical libraries of this process: labels run side by side."""
    import threadpoolctl

    # The variables are for libraries that load later, the call for those that are loaded.
    for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA", "VECLIB_MAXIMUM"):
        os.environ[f"{name}_NUM_THREADS"] = "1"
    threadpoolctl.threadpool_limits(limits=1)


def ready(parcel: Parcel) -> bool:
    """Answered by a worker that has taken the source."""
    return parcel.source is not None


def attempt(parcel: Parcel, design: Mapping[str, float]) -> Label:
    """The source's label, or an unknown one with the reason why there is none."""
    source = parcel.source
    if parcel.limit is None or not parcel.away:
        return ask(source.label, design)
    with _watched(parcel):
        return ask(source.label, design)


_lock, _labels = threading.Lock(), 0


@contextmanager
def _watched(parcel: Parcel):
    _watch(parcel, 1)
    try:
        yield
    finally:
        _watch(parcel, -1)


def _watch(parcel: Parcel, more: int) -> None:
    """Watch one label more, or less.

    The system counts the process's own time and a thread of C that on the wall: both end it even
    where compiled code never gives Python its turn. An executor of threads computes several labels
    in one process, whose time is the sum of theirs.
    """
    global _labels
    with _lock:
        _labels += more
        if not _labels:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            faulthandler.cancel_dump_traceback_later()
            return
        # Says where it hung, then does what the signal does by default: the process ends.
        faulthandler.register(signal.SIGPROF, file=sys.__stderr__, chain=True)
        signal.setitimer(signal.ITIMER_PROF, _labels * parcel.limit)
        faulthandler.dump_traceback_later(parcel.wall, exit=True, file=sys.__stderr__)


def ask(function: Callable, design: Mapping[str, float]) -> Label:
    """As :func:`attempt`, for a function from a design to a label."""
    start = time.perf_counter()
    try:
        return checked(function(dict(design)), design)
    # A source that calls sys.exit must not end the campaign.
    except (Exception, SystemExit) as error:
        return failed(error, design, seconds=time.perf_counter() - start)


def checked(label, design: Mapping[str, float]) -> Label:
    """A label in plain values; unknown, with the reason, if the source gave something else."""
    if not isinstance(label, Label):
        what = type(label).__name__
        return Label(dict(design), None, f"the source returned {what} instead of a Label")
    try:
        if design_key(label.design) != design_key(design):
            return Label(dict(design), None, "the source returned the label of another design")
        return storable(label)
    except InputError as error:
        return Label(dict(design), None, f"the source returned a bad label: {error}")


def failed(error: BaseException, design: Mapping[str, float], **evidence) -> Label:
    """The unknown label of a computation that raised."""
    if killed(error):
        tried = getattr(error, "allowed_failures", 0) + 1
        return _died(design, f"on each of the {tried} workers that tried it")
    frames = traceback.extract_tb(error.__traceback__)
    if frames:
        last = frames[-1]
        evidence["raised_at"] = f"{Path(last.filename).name}:{last.lineno} in {last.name}"
    return Label(dict(design), None, sentence(error), evidence)


def killed(error: BaseException | None) -> bool:
    """Whether this is how Dask says that workers died, on this design or on a neighbour of it."""
    return type(error).__name__ == "KilledWorker"


def _died(design: Mapping[str, float], how: str) -> Label:
    reason = (
        f"the worker process died on this design, {how}: out of memory, or a crash in compiled code"
    )
    return Label(dict(design), None, reason, {"outcome": "worker_died"})


def sentence(error: BaseException | None) -> str:
    """Type and message of an exception on one line."""
    try:
        message = " ".join(str(error).split())[:LONGEST_MESSAGE]
    except Exception:
        message = "its message can't be read"
    return f"{type(error).__name__}: {message}" if message else type(error).__name__


@contextmanager
def pool(workers: int):
    """A pool of spawned processes; an exception or a break ends them at once."""
    context = get_context("spawn")
    lifeline, held = context.Pipe(duplex=False)
    executor = ProcessPoolExecutor(
        workers, mp_context=context, initializer=_begin, initargs=(lifeline,)
    )
    ended = False
    try:
        yield executor
        ended = not getattr(executor, "_broken", False)
    finally:
        if not ended:
            held.close()
        executor.shutdown(wait=True, cancel_futures=True)
        held.close()
        lifeline.close()


def alone(parcel: Parcel, design: Mapping[str, float]) -> Label:
    """Label one design in a process of its own; unknown, with the reason, if that dies too."""
    context = get_context("spawn")
    (lifeline, held), (answers, answer) = context.Pipe(duplex=False), context.Pipe(duplex=False)
    with lifeline, held, answers, answer:
        process = context.Process(target=_answer_alone, args=(lifeline, answer, parcel, design))
        start = time.perf_counter()
        process.start()
        try:
            answer.close()
            return answers.recv()
        except (EOFError, OSError):
            process.join()
            code = process.exitcode
        finally:
            process.kill()
            process.join()
            process.close()
    if code == -signal.SIGPROF:
        reason = (
            f"no answer within {parcel.limit:g} core-seconds, twice: the computation hangs and was "
            "ended"
        )
        return Label(dict(design), None, reason, {"outcome": "hung"})
    if code == 1 and parcel.wall is not None and time.perf_counter() - start > parcel.wall:
        reason = (
            f"no answer within {parcel.wall:g} s on the wall, twice: the computation waits for "
            "something, or gets no core, and was ended"
        )
        return Label(dict(design), None, reason, {"outcome": "blocked"})
    how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
    return _died(design, f"again when run alone ({how})")


def _answer_alone(lifeline, answer, parcel: Parcel, design: Mapping[str, float]) -> None:
    _begin(lifeline)
    answer.send(attempt(parcel, design))


def _begin(lifeline) -> None:
    # Ctrl-C reaches the whole group; the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()
    one_thread()


def _end_with(lifeline) -> None:
    # The parent holds the other end and never sends: the pipe ends when it closes it or is killed.
    # Without this, workers outlive a killed campaign for ever.
    try:
        lifeline.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)
