"""One job at a time in a process beside the server, to be cancelled, and with a time budget."""

from __future__ import annotations

import itertools
import multiprocessing
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from foldlab.errors import InputError
from foldlab.explore.asked import choice, number, only
from foldlab.explore.work import checked, serve

KINDS = ("solve", "mend", "export")
# Seconds on the wall beyond the core-seconds asked for: of a machine shared with other work, and
# of a first solve, which compiles.
SHARED, COMPILING = 4, 180


@dataclass
class Job:
    """What was asked for, and how far it has come. Seconds are those of the wall."""

    number: int
    kind: str
    limit: float
    began: float
    said: str = "starting the solver"
    answer: dict[str, Any] | None = None
    error: str | None = None
    seconds: float | None = None
    content: bytes = b""

    @property
    def running(self) -> bool:
        """Whether there is no answer yet."""
        return self.seconds is None

    def end(self, answer: dict[str, Any] | None, error: str | None) -> None:
        """Keeps the answer, or why there is none."""
        if answer is not None and "content" in answer:
            self.content = answer["content"]
            answer = {"name": answer["name"], "bytes": len(self.content)}
        self.answer, self.error = answer, error
        self.seconds = time.monotonic() - self.began


class Jobs:
    """The jobs of a server; safe among threads. ``serve``: what the process runs."""

    def __init__(self, serve: Callable = serve):
        self._serve = serve
        self._lock = threading.RLock()
        self._numbers = itertools.count(1)
        self._job: Job | None = None
        self._process = self._pipe = None

    def start(self, request: Any) -> dict[str, Any]:
        """Begin a job, {"kind", "asked"}; raises :class:`InputError` where one is running."""
        request = only(request, ("kind", "asked"), "a job")
        kind = choice(request, "kind", KINDS)
        seconds = checked(kind, request.get("asked"))
        with self._lock:
            if self._job is not None and self._job.running:
                raise InputError("the solver is at work; wait for it, or cancel what it does")
            limit = SHARED * seconds + COMPILING
            job = self._job = Job(next(self._numbers), kind, limit, time.monotonic())
            if self._process is None or not self._process.is_alive():
                self._stop()
                self._begin()
            self._pipe.send((kind, request["asked"]))
            threading.Thread(target=self._wait, args=(job, self._pipe), daemon=True).start()
        return self.state({"job": job.number})

    def state(self, request: Any) -> dict[str, Any]:
        """How far the last job, {"job": number}, has come, and its answer once it is there."""
        job = self._asked(request)
        with self._lock:
            seconds = time.monotonic() - job.began if job.running else job.seconds
            return {
                "job": job.number, "kind": job.kind, "running": job.running, "said": job.said,
                "seconds": seconds, "answer": job.answer, "error": job.error,
            }  # fmt: skip

    def cancel(self, request: Any) -> dict[str, Any]:
        """End the last job, {"job": number}, if it is still running."""
        job = self._asked(request)
        with self._lock:
            if job.running:
                job.end(None, "cancelled")
                self._stop()
        return self.state(request)

    def file(self, request: Any) -> tuple[str, bytes]:
        """Name and content of the file that the last job, {"job": number}, made."""
        job = self._asked(request)
        if not job.content:
            raise InputError("that job made no file")
        return job.answer["name"], job.content

    def close(self) -> None:
        """End what is running."""
        with self._lock:
            if self._job is not None and self._job.running:
                self._job.end(None, "cancelled")
            self._stop()

    def _asked(self, request: Any) -> Job:
        wanted = number(only(request, ("job",), "a job"), "job", 0, (0, 1e9))
        if self._job is None or wanted != self._job.number:
            raise InputError("that job is not there any more; start another one")
        return self._job

    def _begin(self) -> None:
        # Not forked: the server has threads, and its models' memory is not the solver's.
        context = multiprocessing.get_context("spawn")
        self._pipe, there = context.Pipe()
        self._process = context.Process(target=self._serve, args=(there,), daemon=True)
        self._process.start()
        there.close()

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
            self._pipe.close()
        self._process = self._pipe = None

    def _wait(self, job: Job, pipe) -> None:
        """Hears what the process says until the job has ended."""
        while job.running:
            over = time.monotonic() - job.began > job.limit
            try:
                heard = pipe.recv() if not over and pipe.poll(0.2) else None
            except (EOFError, OSError):
                over, heard = True, None
            with self._lock:
                if not job.running:
                    return
                if over:
                    late = time.monotonic() - job.began > job.limit
                    why = f"no answer within {job.limit:.0f} s" if late else "its process ended"
                    job.end(None, f"the solver was stopped: {why}")
                    with suppress(OSError):
                        self._stop()
                elif heard and heard[0] == "said":
                    job.said = heard[1]
                elif heard:
                    job.end(*((heard[1], None) if heard[0] == "done" else (None, heard[1])))
