"""What of a run is tracked, without MLflow's database."""

import sqlite3
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest

from foldlab import tracking
from foldlab.tracking import Run


def logged(values, **options):
    seen = {}
    Run(SimpleNamespace(log_metrics=seen.update), "id").metrics(values, **options)
    return seen


def test_only_finite_numbers_are_metrics():
    values = {"inf": np.inf, "minus": -np.inf, "nan": np.nan, "none": None, "list": [1.0], "a": 2}
    assert logged(values) == {"a": 2.0}
    assert logged({"f": np.float32(-np.inf), "b": False, "i": np.int64(-3)}) == {"b": 0, "i": -3}


def test_names_of_metrics_are_those_that_mlflow_takes():
    values = {"a_b-c.d e/f": 1, "κ": 2, "E_i/E_s (log)": 3, "95%": 4}
    assert logged(values, prefix="tree.") == {
        "tree.a_b-c.d e/f": 1, "tree.κ": 2, "tree.E_i/E_s _log_": 3, "tree.95_": 4,
    }  # fmt: skip


def test_the_commit_is_of_the_source_tree_and_tells_where_files_differ(tmp_path, monkeypatch):
    def git(*words):
        name = ["-c", "user.name=a", "-c", "user.email=a@b"]
        done = subprocess.run(
            ["git", *name, *words], cwd=tmp_path, check=True, capture_output=True, text=True
        )
        return done.stdout.strip()

    monkeypatch.setattr(tracking, "__file__", str(tmp_path / "tracking.py"))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert tracking.commit() == "unknown"
    git("init")
    (tmp_path / "a.txt").write_text("1")
    git("add", "a.txt")
    git("commit", "-m", "another project, in whose folder the package is installed")
    (tmp_path / "tracking.py").touch()
    assert tracking.commit() == "unknown"
    git("add", "tracking.py")
    git("commit", "-m", "the package itself")
    git("tag", "-a", "v1", "-m", "a name says less than the commit")
    hashed = git("rev-parse", "HEAD")[:12]
    assert tracking.commit() == hashed
    (tmp_path / "a.txt").write_text("2")
    assert tracking.commit() == f"{hashed}-dirty"


def sqlite_error(code):
    error = sqlite3.OperationalError("what SQLite says\nand where")
    error.sqlite_errorcode = code
    return error


def caused(error, cause):
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "local", "advice"),
    [
        (sqlite_error(sqlite3.SQLITE_FULL), True, "free some space"),
        (sqlite_error(sqlite3.SQLITE_IOERR_WRITE), False, "free some space"),  # an extended code
        (sqlite_error(sqlite3.SQLITE_READONLY), True, "free some space"),
        (sqlite_error(sqlite3.SQLITE_CORRUPT), True, "move that away"),
        (sqlite_error(sqlite3.SQLITE_CORRUPT), False, "mend MLFLOW_TRACKING_URI"),
        (caused(RuntimeError("around it"), sqlite_error(sqlite3.SQLITE_FULL)), True, "free some"),
        (OSError("no space"), True, "free some space"),
        (OSError("no route"), False, "mend MLFLOW_TRACKING_URI"),
        (RuntimeError("strange"), True, "move that away"),
    ],
)
def test_what_mlflow_could_not_open_is_told_with_what_helps(error, local, advice):
    told = str(tracking._unusable(error, "place", local))
    assert told.startswith("MLflow can't use place (") and advice in told and "\n" not in told
    assert ("what SQLite says" in told) == ("what SQLite" in f"{error}{error.__cause__}")


def test_a_database_that_is_still_to_be_made_is_no_damaged_one(tmp_path):
    tracking._check(tmp_path / "mlflow.db")
    (tmp_path / "mlflow.db").touch()
    tracking._check(tmp_path / "mlflow.db")
    assert (tmp_path / "mlflow.db").read_bytes() == b""
