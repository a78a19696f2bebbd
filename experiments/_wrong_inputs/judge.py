"""A process that tries cases one after the other and says how each ended."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

import numpy as np

from foldlab.cli import app
from solver.mesh import gmsh_import
from solver.mesh.body import Body
from solver.physics.patterns import read_pattern

from .. import common
from . import cases, good

REFUSED, HARMLESS, GOES_ON = "refused", "harmless", "goes on"
ACCEPTED, TRACEBACK, UNCLEAR = "accepted though wrong", "traceback", "unclear"
LEFT_OVER, HANG, CRASH = "something left behind", "hang", "crash"
RIGHT = (REFUSED, HARMLESS, GOES_ON)
MEMORY = 6 << 30  # bytes
# Measured anew each time, or named after the folder.
CHANGING = re.compile(r'"[a-z_]*(seconds|per_second|store|file|folder)[a-z_0-9]*": [^,}]*')


@dataclasses.dataclass(frozen=True)
class _Settings:
    size: int = 3
    ratio: float = 0.5
    seed: int = 0

    def __post_init__(self):
        if self.size < 1 or not 0 < self.ratio < 1:
            raise common.InputError("size and ratio: expected above 0, and below 1")


def serve(connection, seed: int, folder: str, seconds: float) -> None:
    """Tries the numbers that come; answers with rows. Ends by SIGPROF where a case takes longer.

    Seconds are those of the processor: a busy machine is no hang.
    """
    os.environ.pop("MLFLOW_TRACKING_URI", None)
    files = good.make(Path(folder))
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    # Else unlucky files would fill the terminal from within C.
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    right: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as scratch:
        while (number := connection.recv()) is not None:
            signal.setitimer(signal.ITIMER_PROF, seconds)
            # MLflow keeps databases that it knows by their path open.
            here = Path(scratch) / f"case{number}"
            row = attempt(seed, number, files, here, right)
            shutil.rmtree(here, ignore_errors=True)
            signal.setitimer(signal.ITIMER_PROF, 0)
            connection.send(row)


def attempt(seed: int, number: int, files: Path, here: Path, right: dict[str, str]) -> dict:
    """One case, in the new folder ``here``."""
    here.mkdir(parents=True)
    case = cases.make(seed, number, files, here)
    before = _state(here)
    start = time.process_time()
    status, out, err = call(case.arguments, here)
    row = {
        "case": number, "line": case.line, "kind": case.kind, "what": case.what,
        "seconds": round(time.process_time() - start, 3),
    }  # fmt: skip
    ending = _ending(status, err)
    if ending == ACCEPTED and case.random:
        if case.line not in right:
            right[case.line] = _right(case.line, files, here)
        ending = HARMLESS if CHANGING.sub("", out) == right[case.line] else ACCEPTED
    if ending == REFUSED and (changed := _changed(before, _state(here))):
        ending = LEFT_OVER
        err += f" [{', '.join(changed)}]"
    said = err.strip().splitlines() or [""]
    text = err[-3000:] if ending == TRACEBACK else said[-1][:400]
    return row | {"ending": ending, "status": status, "said": text}


def call(arguments, here: Path) -> tuple[int | str, str, str]:
    """Exit status (or "traceback"), standard output and standard error of a call in ``here``."""
    out, err = io.StringIO(), io.StringIO()
    environment = dict(os.environ)
    os.environ.pop("MLFLOW_TRACKING_URI", None)
    with contextlib.chdir(here), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            _call(list(arguments))
            status: int | str = 0
        except SystemExit as end:
            status = end.code or 0
        except Exception:
            traceback.print_exc(file=err)
            status = TRACEBACK
    os.environ.clear()
    os.environ.update(environment)
    return status, out.getvalue(), err.getvalue()


def _call(arguments: list[str]) -> None:
    what, *rest = arguments
    if what == "experiment":
        sys.argv = ["wrong", *rest]
        common.main("?", lambda config, tracker: {}, _Settings, _Settings())
    elif what in ("pattern", "mesh"):
        # Read by experiments and by Python: a ValueError is their refusal.
        try:
            print(json.dumps(_read(what, Path(rest[0]))))
        except ValueError as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
    else:
        sys.argv = ["foldlab", *arguments, "--json"]
        app.main()


def _read(what: str, path: Path) -> list:
    if what == "pattern":
        pattern = read_pattern(path)
        order = np.lexsort(pattern._tree.data.T)
        return [pattern._tree.data[order].tolist(), pattern.values[order].tolist()]
    mesh = Body.build(gmsh_import.read(path), "hex8").mesh
    return [mesh.p.tolist(), mesh.t.tolist(), sorted(mesh.subdomains or {})]


def _ending(status, err: str) -> str:
    lines = [line for line in err.splitlines() if line.startswith(("error: ", "not reached: "))]
    if status == TRACEBACK:
        return TRACEBACK
    if status == 0:
        return ACCEPTED
    clear = len(lines) == 1 and len(lines[0].split()) > 3 and "object at 0x" not in err
    last = err.strip().splitlines()[-1] if err.strip() else ""
    return REFUSED if status == 2 and clear and last == lines[0] else UNCLEAR


def _right(line: str, files: Path, here: Path) -> str:
    # Beside the damaged one: MLflow still holds a database open that was there.
    sound = here.with_name(f"{here.name}_sound")
    sound.mkdir()
    text, names = cases.LINES[line]
    cases.copy(files, sound, names)
    status, out, err = call(cases.shlex.split(text), sound)
    shutil.rmtree(sound)
    assert status == 0, f"{line} should be right: {err}"
    return CHANGING.sub("", out)


def _state(here: Path) -> dict[str, str]:
    """Every file and folder with its content."""
    return {
        str(path.relative_to(here)): "/"
        if path.is_dir()
        else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in here.rglob("*")
    }


def _changed(before: dict[str, str], after: dict[str, str]) -> list[str]:
    names = sorted(before.keys() | after.keys())
    return [name for name in names if before.get(name) != after.get(name)]
