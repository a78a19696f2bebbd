"""What takes seconds, done in a process of its own: following a unit on the solver."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from foldlab.errors import InputError
from foldlab.explore.asked import Asked, asked, number, only, switch
from foldlab.terminal import note

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from foldlab.labels.label import Label
    from foldlab.labels.run import Run
    from foldlab.labels.solver import SolverSource

    Solved = tuple[Asked, SolverSource, Run, Label]

WRONG = "something is wrong in foldlab itself; its terminal says what"
SECONDS = (5, 600)  # core-seconds that may be asked for
MENDING = 5  # answers of the solver that mending may take, as a rule
ASKED = ("design", "contact", "accuracy", "seconds")
Tell = Callable[[str], None]


def serve(pipe: Connection) -> None:
    """Does jobs (kind, request) of a pipe one after another, until it is closed.

    Answers ("said", text) on the way, and last ("done", answer) or ("error", text).
    """
    # Ctrl-C is the server's, which then closes the pipe; sliders come first.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError, AttributeError):
        os.nice(5)
    desk = Desk(lambda text: pipe.send(("said", text)))
    while True:
        try:
            kind, request = pipe.recv()
        except EOFError:
            return
        try:
            answer = "done", desk.do(kind, request)
        except InputError as error:
            answer = "error", str(error)
        except Exception as error:
            note(f"error: {kind}: {type(error).__name__}: {error}")
            answer = "error", WRONG
        with suppress(BrokenPipeError):
            pipe.send(answer)


class Desk:
    """Does jobs, and keeps what the last one solved."""

    def __init__(self, tell: Tell):
        self.tell = tell
        self.last: Solved | None = None

    def do(self, kind: str, request: Any) -> dict[str, Any]:
        """The answer to one job; raises :class:`InputError` for what can't be done."""
        return {"solve": self.solve, "mend": self.mend, "export": self.export}[kind](request)

    def solve(self, request: Any) -> dict[str, Any]:
        """The solver's path of a design, see :func:`told`."""
        what, source, run, label = self._solved(*asked_of_solver(request))
        self.tell("drawing")
        return told(what, source, run, label)

    def mend(self, request: Any) -> dict[str, Any]:
        """Designs near by that fold, as the solver confirms without contact:
        :func:`foldlab.explore.mend.mended`."""
        from foldlab.explore.mend import mended

        what, source = asked_of_solver({**only(request, ASKED, "a job"), "contact": False})
        return mended(what, source, self.tell)

    def export(self, request: Any) -> dict[str, Any]:
        """A ZIP of what is known of a design: :func:`foldlab.explore.export.zipped`."""
        from foldlab.explore.export import zipped

        last = self._solved(*asked_of_solver(request))
        return {"name": "foldlab-unit.zip", "content": zipped(*last, self.tell)}

    def _solved(self, what: Asked, source: SolverSource) -> Solved:
        """The path of a design, followed unless it was the last."""
        if self.last is None or (self.last[0].groups, self.last[1]) != (what.groups, source):
            self.tell("solving")
            run, label = source.follow(what.groups)
            self.last = what, source, run, label
        # The same groups may be those of another size.
        self.last = what, *self.last[1:]
        return self.last


def checked(kind: str, request: Any) -> float:
    """Core-seconds that a job may take; raises :class:`InputError` for what is none."""
    seconds = asked_of_solver(request)[1].timeout
    return {"solve": 1, "mend": MENDING, "export": 2}[kind] * seconds


def asked_of_solver(request: Any) -> tuple[Asked, SolverSource]:
    """The design of a request and the solver as it is to be asked: {"design", "contact",
    "accuracy", "seconds"}, of which the first is needed."""
    from foldlab.labels.asked import Conditions, Effort
    from foldlab.labels.solver import SolverSource

    request = only(request, ASKED, "a job")
    what = asked(request.get("design"))
    effects = "gravity,ground,contact" if switch(request, "contact", True) else "gravity,ground"
    accuracy = number(request, "accuracy", 0.02, (0.002, 0.2))
    seconds = number(request, "seconds", 60, SECONDS)
    return what, SolverSource(Conditions(effects), Effort(accuracy, seconds, whole=True))


def told(what: Asked, source: SolverSource, run: Run, label: Label) -> dict[str, Any]:
    """What the page shows of a path: verdict, reason, angle and error in rad, peak strains with
    what the materials bear, events, core-seconds, and the frames."""
    from foldlab.explore.frames import frames
    from foldlab.unit.check import strained
    from foldlab.unit.sized import Sized
    from foldlab.unit.told import in_degrees

    e: Mapping[str, Any] = label.evidence
    unit = what.unit or Sized({}, what.groups)
    kept = (
        "fold_angle", "error_m1", "need", "outcome", "stable", "topples", "core_seconds",
        "seconds", "unknowns",
    )  # fmt: skip
    events = [{"kind": v["kind"], "contraction": v["contraction"]} for v in e.get("events", ())]
    contact = "contact" in source.conditions.terms
    return {
        "foldable": label.foldable,
        "reason": in_degrees(label.reason),
        **{name: e.get(name) for name in kept},
        "events": events,
        "contact": contact,
        "touches": any(event["kind"] == "contact" for event in events) if contact else None,
        "strain": strained(unit, e),
        "length": unit.physical.get("l_s"),
        "frames": frames(run) if run.shapes else [],
    }
