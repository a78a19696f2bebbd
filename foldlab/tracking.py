"""Runs in MLflow: configuration, seed, commit, metrics, seconds, tables, figures and models.

``MLFLOW_TRACKING_URI`` is respected; without it the database is ``mlruns/mlflow.db`` below the
working directory and artifacts lie in ``mlruns/artifacts`` (one writer at a time). The database
names them relative to that directory, so that both may move together.
"""

from __future__ import annotations

import logging
import math
import os
import sqlite3
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import (
    AbstractContextManager,
    chdir,
    closing,
    contextmanager,
    nullcontext,
    suppress,
)
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import pandas as pd
from filelock import FileLock

import foldlab
from foldlab.errors import InputError
from foldlab.packaged import installed, missing, needed_for
from foldlab.terminal import plain

ROOT = Path("mlruns")
ARTIFACTS = ROOT / "artifacts"
# Libraries that a kind of saved model is read with, beside NumPy.
NEEDS = {"sklearn": ("scikit-learn", "skops"), "network": ("torch",), "formula": ()}
# Where MLflow keeps addresses of artifacts.
ADDRESSES = (
    ("experiments", "artifact_location"),
    ("runs", "artifact_uri"),
    ("logged_models", "artifact_location"),
)


class Run:
    """What an experiment may log; obtained from :func:`track`."""

    def __init__(self, mlflow, run_id: str):
        self._mlflow = mlflow
        self.run_id = run_id
        # Where addresses of artifacts are relative to, wherever the process goes meanwhile.
        self._folder = Path.cwd()

    def metrics(self, values: Mapping[str, Any], *, prefix: str = ""):
        """Log the finite numbers of a flat mapping; other values are left out."""
        numbers = {
            prefix + _metric_name(name): float(value)
            for name, value in ((name, _scalar(value)) for name, value in values.items())
            if isinstance(value, int | float) and math.isfinite(value)
        }
        self._mlflow.log_metrics(numbers)

    def table(self, name: str, frame: pd.DataFrame) -> None:
        """Log a table as ``tables/NAME.csv``."""
        with chdir(self._folder):
            self._mlflow.log_text(frame.to_csv(index=False), f"tables/{name}.csv")

    def figure(self, name: str, figure) -> None:
        """Log a Matplotlib figure as ``figures/NAME.png``."""
        with chdir(self._folder):
            self._mlflow.log_figure(figure, f"figures/{name}.png")

    def files(self, path: Path) -> None:
        """Log a file, or all that a folder holds, under its own name."""
        path = Path(path).resolve()
        with chdir(self._folder):
            if path.is_dir():
                self._mlflow.log_artifacts(str(path), path.name)
            else:
                self._mlflow.log_artifact(str(path))

    def answer(self, values: Mapping[str, Any]) -> None:
        """Log what a verb answers as ``answer.json``."""
        with chdir(self._folder):
            self._mlflow.log_dict(plain(values), "answer.json")

    def model(self, name: str, fitted, example: pd.DataFrame) -> str:
        """Log a fitted model with its signature and an input example (a few designs); its address.

        ``mlflow.pyfunc.load_model`` of that address answers designs by the names of their columns,
        see :class:`Served`. What is stored is the folder of
        :func:`foldlab.learning.saving.save_model`, without pickled code; a process that loads it
        needs foldlab.
        """
        from foldlab.learning.saving import read_card, save_model

        with chdir(self._folder), tempfile.TemporaryDirectory() as folder:
            saved = save_model(fitted, Path(folder) / name)
            answers = Served(fitted).predict(example)
            logged = self._mlflow.pyfunc.log_model(
                name=name,
                loader_module=__name__,
                data_path=str(saved),
                input_example=example,
                signature=self._mlflow.models.infer_signature(example, answers),
                pip_requirements=_requirements(*NEEDS[read_card(saved)["kind"]]),
            )
        return logged.model_uri


@dataclass(frozen=True)
class Served:
    """A fitted model as MLflow asks it."""

    model: Any

    def predict(self, designs: pd.DataFrame, params: Mapping[str, Any] | None = None):
        """Of designs (n rows, a column per group) the ``probability`` that they fold and the
        verdict ``foldable``; of a model of angles ``fold_angle`` in rad. A frame of n rows."""
        from foldlab.learning.features import as_labels, probability_of_folding

        if not hasattr(self.model, "predict_proba"):
            answers = {"fold_angle": self.model.predict(designs)}
        else:
            verdicts = as_labels(self.model.predict(designs)).astype(bool)
            probability = probability_of_folding(self.model, designs)
            answers = {"probability": probability, "foldable": verdicts}
        return pd.DataFrame(answers, index=designs.index)


def _load_pyfunc(path: str) -> Served:
    """What MLflow calls to load a model that :meth:`Run.model` logged."""
    from foldlab.learning.saving import load_model

    return Served(load_model(path)[0])


def _requirements(*packages: str) -> list[str]:
    # Given outright: MLflow would otherwise load the model in a new process to find them.
    return [f"{name}=={metadata.version(name)}" for name in (*packages, "numpy", "foldlab")]


class Unlogged:
    """In place of a :class:`Run` where nobody asked for one."""

    def __getattr__(self, name: str) -> Callable:
        return lambda *given, **more: None


def asked(wanted: bool) -> Callable[..., AbstractContextManager[Run | Unlogged]]:
    """:func:`track` for a verb, which calls it once it has its result: of input that is refused no
    run is left. The run's seconds count from here.

    Raises :class:`InputError` where MLflow is wanted and not installed, or its database is damaged.
    """
    if not wanted:
        return lambda *given, **more: nullcontext(Unlogged())
    if not installed("mlflow"):
        raise missing(ModuleNotFoundError(name="mlflow"), "--track")
    if not os.environ.get("MLFLOW_TRACKING_URI"):
        _check(ROOT / "mlflow.db")
    return partial(track, start=time.perf_counter())


@contextmanager
def track(
    experiment: str,
    config: Mapping[str, Any],
    *,
    seed: int | None = None,
    start: float | None = None,
) -> Iterator[Run]:
    """Open a run of ``experiment``; its status and seconds are logged even if the body raises.

    ``start``: what ``time.perf_counter`` said when what is logged began; now where not given.

    Inside a run of the caller's own it becomes a child of that run, in the caller's database. A
    deleted experiment is restored, without the runs that were deleted with it.
    """
    # Its import takes seconds and only tracked commands need it.
    with needed_for("tracking"):
        import mlflow

    logging.getLogger("mlflow").setLevel(logging.ERROR)
    logging.getLogger("alembic").setLevel(logging.ERROR)
    given = os.environ.get("MLFLOW_TRACKING_URI")
    inside = mlflow.active_run() is not None
    uri = mlflow.get_tracking_uri() if inside else given or _local_uri()
    start = time.perf_counter() if start is None else start
    with warnings.catch_warnings():
        # MLflow's own calls into SQLAlchemy, pydantic and protobuf; nothing a user could mend.
        warnings.simplefilter("ignore")
        if not inside:
            mlflow.set_tracking_uri(uri)
        local = uri == _local_uri()
        if local:
            _check(ROOT / "mlflow.db")
            ROOT.mkdir(exist_ok=True)
        try:
            if local:
                # Two that start at once would both make the database, and one would fail.
                with _alone(ROOT / "mlflow.db.lock"):
                    number = _experiment(experiment, str((ARTIFACTS / experiment).resolve()))
                    _make_relative(ROOT / "mlflow.db")
            else:
                number = _experiment(experiment)
            opened = mlflow.start_run(experiment_id=number, nested=inside)
        except Exception as error:  # whatever a server, or a database, makes MLflow raise
            raise _unusable(error, ROOT / "mlflow.db" if local else uri, local) from error
        with opened as run:
            mlflow.log_params({key: str(value)[:500] for key, value in config.items()})
            mlflow.set_tags({"seed": str(seed), "commit": commit(), "foldlab": foldlab.__version__})
            try:
                yield Run(mlflow, run.info.run_id)
            finally:
                mlflow.log_metric("seconds", time.perf_counter() - start)
                if not (given or inside):
                    # MLflow exports the address it was told; a later run may start elsewhere.
                    os.environ.pop("MLFLOW_TRACKING_URI", None)


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """A lock file held inside; none stays, and who waits for the one that was sees that."""
    with FileLock(path):
        try:
            yield
        finally:
            with suppress(OSError):
                path.unlink()


def _experiment(name: str, artifacts: str | None = None) -> str:
    """The number of an experiment, made or restored where it is not there."""
    import mlflow

    known = mlflow.get_experiment_by_name(name)
    if known is None:
        return mlflow.create_experiment(name, artifact_location=artifacts)
    number = known.experiment_id
    if known.lifecycle_stage == "deleted":
        client = mlflow.MlflowClient()
        old = client.search_runs([number], run_view_type=mlflow.entities.ViewType.DELETED_ONLY,
                                 max_results=50_000)  # fmt: skip
        client.restore_experiment(number)
        for run in old:
            client.delete_run(run.info.run_id)
    return number


def _unusable(error: Exception, place: Path | str, local: bool) -> InputError:
    """The one sentence for what MLflow could not open."""
    cause = error
    while cause is not None and not isinstance(cause, sqlite3.Error):
        cause = cause.__cause__ or cause.__context__
    # SQLAlchemy and MLflow put the names of their classes around what SQLite says.
    why = str(cause or error).partition("\n")[0]
    # The primary code is the low byte of an extended one.
    code = (getattr(cause, "sqlite_errorcode", None) or 0) & 0xFF
    disk = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY)
    if code in disk or (local and isinstance(error, OSError)):
        what = "free some space or give another place"
    elif local:
        what = "move that away to start afresh"
    else:
        what = "mend MLFLOW_TRACKING_URI, or unset it"
    return InputError(f"MLflow can't use {place} ({why}); {what}")


def _check(database: Path) -> None:
    """Raises :class:`InputError` where it is another file, or damaged: MLflow would only see later.

    A database that is not there, or still empty, is to be made.
    """
    if not database.exists() or (database.is_file() and database.stat().st_size == 0):
        return
    try:
        with closing(sqlite3.connect(f"{database.resolve().as_uri()}?mode=ro", uri=True)) as known:
            ((verdict,),) = known.execute("PRAGMA quick_check(1)").fetchall()
            if not known.execute("SELECT 1 FROM sqlite_master WHERE name = 'runs'").fetchall():
                verdict = "it has no runs"
    except sqlite3.Error as error:
        verdict = str(error)
    except UnicodeDecodeError:
        verdict = "a name in it is no text"  # SQLite names what is damaged in the file's own bytes
    if verdict != "ok":
        raise InputError(
            f"{database} is damaged or no database of MLflow ({' '.join(verdict.split())}); move "
            "it away to start afresh"
        )


def _make_relative(database: Path) -> None:
    # MLflow makes every address absolute, and then finds nothing after a move.
    start = f"{ARTIFACTS.as_posix()}/"
    with closing(sqlite3.connect(database, timeout=60)) as connection, connection:
        for table, column in ADDRESSES:
            connection.execute(
                f"UPDATE {table} SET {column} = substr({column}, instr({column}, ?)) "
                f"WHERE {column} LIKE ? AND {column} NOT LIKE '%\\%%' ESCAPE '\\'",
                (start, f"%/{start}%"),
            )


def tracking_uri() -> str:
    """``MLFLOW_TRACKING_URI`` if set, else the SQLite file below the working directory."""
    return os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{ROOT / 'mlflow.db'}"


def _local_uri() -> str:
    # Absolute, since MLflow keeps one store per address, whatever the working directory is by then.
    return f"sqlite:///{(ROOT / 'mlflow.db').resolve()}"


def commit() -> str:
    """The commit of the source tree, with ``-dirty`` where files differ from it; or ``unknown``."""
    here = Path(__file__)

    def git(*words: str) -> str:
        options = {"capture_output": True, "text": True, "check": True, "timeout": 10}
        return subprocess.run(["git", *words], cwd=here.parent, **options).stdout.strip()

    try:
        # An installed copy may lie in the folder of another project.
        git("ls-files", "--error-unmatch", here.name)
        return git("describe", "--always", "--dirty", "--abbrev=12", "--exclude=*")
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def _scalar(value: Any) -> Any:
    """The Python number of a NumPy or torch scalar; other values as they are."""
    return value.item() if getattr(value, "ndim", None) == 0 and hasattr(value, "item") else value


def _metric_name(name: str) -> str:
    return "".join(c if c.isalnum() or c in "_-. /" else "_" for c in name)
