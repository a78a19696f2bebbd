"""What runs in a campaign's worker processes, and how these processes are started and ended.

Only labels in plain values come back: a source's exceptions and odd results may not pickle.
"""

from __future__ import annotations

import os
import pickle
import signal
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
from foldlab.labels import Label, design_key, storable

LONGEST_MESSAGE = 500  # characters of an exception's message that a reason keeps


def ready(source) -> bool:
    """Answered by a worker that has taken the source."""
    return source is not None


def attempt(source, design: Mapping[str, float]) -> Label:
    """The source's label, or an unknown one with the reason why there is none."""
    return ask(source.label, design)


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
    frames = traceback.extract_tb(error.__traceback__)
    if frames:
        last = frames[-1]
        evidence["raised_at"] = f"{Path(last.filename).name}:{last.lineno} in {last.name}"
    return Label(dict(design), None, sentence(error), evidence)


def sentence(error: BaseException | None) -> str:
    """Type and message of an exception on one line."""
    try:
        message = " ".join(str(error).split())[:LONGEST_MESSAGE]
    except Exception:
        message = "its message can't be read"
    return f"{type(error).__name__}: {message}" if message else type(error).__name__


def pickled(source) -> bytes:
    """The source as it travels to our own workers, which unpickle it once and then keep it."""
    try:
        return pickle.dumps(source)
    except Exception as error:
        raise InputError(
            f"the label source can't be sent to worker processes ({sentence(error)}); define its "
            "class in a module and keep locks, files and lambdas out of it"
        ) from None


_unpickled = lru_cache(maxsize=1)(pickle.loads)


def ready_pickled(source: bytes) -> bool:
    return ready(_unpickled(source))


def attempt_pickled(source: bytes, design: Mapping[str, float]) -> Label:
    return attempt(_unpickled(source), design)


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


def alone(source: bytes, design: Mapping[str, float]) -> Label:
    """Label one design in a process of its own; unknown, with the reason, if that dies too."""
    context = get_context("spawn")
    (lifeline, held), (answers, answer) = context.Pipe(duplex=False), context.Pipe(duplex=False)
    with lifeline, held, answers, answer:
        process = context.Process(target=_answer_alone, args=(lifeline, answer, source, design))
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
    how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
    reason = (
        f"the worker process died on this design, again when run alone ({how}): "
        "out of memory, or a crash in compiled code"
    )
    return Label(dict(design), None, reason)


def _answer_alone(lifeline, answer, source: bytes, design: Mapping[str, float]) -> None:
    _begin(lifeline)
    answer.send(attempt_pickled(source, design))


def _begin(lifeline) -> None:
    import threadpoolctl

    # Ctrl-C reaches the whole group; the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()
    # The variables are for libraries that load later, the call for those that are loaded.
    for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA", "VECLIB_MAXIMUM"):
        os.environ[f"{name}_NUM_THREADS"] = "1"
    threadpoolctl.threadpool_limits(limits=1)


def _end_with(lifeline) -> None:
    # The parent holds the other end and never sends: the pipe ends when it closes it or is killed.
    # Without this, workers outlive a killed campaign for ever.
    try:
        lifeline.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)
