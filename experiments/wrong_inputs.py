"""Is any wrong input accepted, answered by a traceback, or left to hang?

Seeded wrong inputs over every verb of the command line and every kind of file that is read: options
and settings of the wrong kind or out of range, damaged tables, stores, models, settings, journals,
materials, fields, meshes and MLflow databases. Each has to be refused with one sentence and exit
status 2, with nothing left behind; random damage may also be one that changes no answer. A case
has ``seconds`` of processor time. A run that was stopped goes on where it was, so that it may be
made in pieces: ``--set until=5000``, then ``--set until=20000``.
"""

from __future__ import annotations

import json
import multiprocessing
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from foldlab.plots import STYLE

from ._wrong_inputs import cases, judge
from .common import OUT, main, save_figure


@dataclass(frozen=True)
class Config:
    seed: int = 0
    until: int = 20_000
    seconds: float = 20.0
    folder: str = str(OUT / "wrong_inputs")


TINY = Config(until=300)


def run(config: Config, tracker) -> dict[str, Any]:
    folder = Path(config.folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"seed_{config.seed}.jsonl"
    rows = _known(path)
    numbers = [k for k in range(config.until) if k not in rows]
    with path.open("a", encoding="utf-8") as out:
        for row in attempts(numbers, config, (folder / "good").resolve()):
            rows[row["case"]] = row
            out.write(json.dumps(row) + "\n")
            out.flush()
            if sys.stderr.isatty():
                print(f"\r{row['case'] + 1}/{config.until}", end="", file=sys.stderr)
    frame = pd.DataFrame([rows[k] for k in range(config.until)])
    tracker.table("cases", frame)
    counts = pd.crosstab([frame["line"], frame["kind"]], frame["ending"])
    figure = picture(pd.crosstab(frame["line"], frame["ending"]))
    save_figure(figure, "wrong_inputs")
    tracker.figure("wrong_inputs", figure)
    wrong = frame[~frame["ending"].isin(judge.RIGHT)]
    return {
        "cases": len(frame),
        **{ending: int(n) for ending, n in frame["ending"].value_counts().items()},
        "faults": len(wrong),
        "complaints": [
            f"case {r.case}: {r.line}, {r.what}: {r.ending}: {r.said.splitlines()[-1:]}"
            for r in wrong.head(50).itertuples()
        ],
        "seconds_most": float(frame["seconds"].max()),
        "store": str(path),
        "table": counts.reset_index().to_dict("records"),
    }


def _known(path: Path) -> dict[int, dict]:
    """Rows of an earlier run; a line that was cut off while it was written is taken away."""
    rows: dict[int, dict] = {}
    if path.exists():
        whole = [
            line for line in path.read_text(encoding="utf-8").splitlines(True) if line[-1] == "\n"
        ]
        path.write_text("".join(whole), encoding="utf-8")
        rows = {row["case"]: row for row in map(json.loads, whole)}
    return rows


def attempts(numbers, config: Config, files: Path):
    """A row for each of the numbers, tried in another process, which some may end."""
    context = multiprocessing.get_context("spawn")
    process = connection = None
    for number in numbers:
        if process is None:
            connection, theirs = context.Pipe()
            process = context.Process(
                target=judge.serve, args=(theirs, config.seed, str(files), config.seconds)
            )
            process.start()
            theirs.close()
        try:
            connection.send(number)
            yield connection.recv()
        except (EOFError, ConnectionError):
            process.join()
            hang = process.exitcode == -signal.SIGPROF
            process = None
            yield _lost(number, config, files, judge.HANG if hang else judge.CRASH)
    if process is not None:
        connection.send(None)
        process.join()


def _lost(number: int, config: Config, files: Path, ending: str) -> dict[str, Any]:
    import tempfile

    with tempfile.TemporaryDirectory() as here:
        case = cases.make(config.seed, number, files, Path(here))
    return {
        "case": number, "line": case.line, "kind": case.kind, "what": case.what,
        "seconds": config.seconds if ending == judge.HANG else np.nan, "ending": ending,
        "status": None, "said": " ".join(case.arguments),
    }  # fmt: skip


def picture(counts: pd.DataFrame) -> Figure:
    """How the cases of each line ended."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.0, 5.0), layout="constrained")
        axes = figure.subplots()
        counts.plot.barh(stacked=True, ax=axes)
        axes.set(xlabel="cases", ylabel="")
        axes.legend(fontsize=7)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
