"""What a label is, who makes labels, and the store that keeps them.

The store is one SQLite file: a row per (source, version, design), committed as it completes. It
keeps SQLite's rollback journal rather than WAL, which does not work on network file systems.
"""

from __future__ import annotations

import json
import math
import re
import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import filelock
import numpy as np
import pandas as pd

import foldlab
from foldlab import store_file
from foldlab.errors import InputError


@dataclass(frozen=True)
class Label:
    """The answer to "does this design fold?", with the reason and the evidence.

    ``foldable`` is None where the source could not tell; ``reason`` is one sentence either way.
    ``evidence`` holds plain JSON values: angle (rad), error estimate, margin, seconds, …, and
    ``outcome``, a short name such as "folds", "curled" or "timeout", where a source has such names.
    """

    design: Mapping[str, float]
    foldable: bool | None
    reason: str
    evidence: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""
    version: str = ""


@runtime_checkable
class LabelSource(Protocol):
    """Turns a design into a label. ``name`` and ``version`` identify the rows in the store.

    A source that is a formula also has ``label_many(designs: DataFrame) -> list[Label]``.
    Sources are pickled to worker processes. A source that ends its labels by itself after a time
    says so in ``timeout`` (seconds); a worker process that hangs far beyond it is ended.
    """

    name: str
    version: str

    def label(self, design: Mapping[str, float]) -> Label: ...


def design_key(design: Mapping[str, float]) -> str:
    """The one text of a design: names sorted, numbers exact to the last bit.

    Raises :class:`InputError` for an empty design and for values that are not finite numbers.
    """
    exact = _exact(design)
    # As json.dumps(exact, sort_keys=True) gives it, in a third of the time.
    return "{" + ", ".join(f"{_quoted(name)}: {exact[name]!r}" for name in sorted(exact)) + "}"


def _exact(design: Mapping[str, float]) -> dict[str, float]:
    if not design:
        raise InputError("the design is empty; give at least one group with its value")
    exact = {}
    for name, value in design.items():
        try:
            # Adding 0 makes -0.0 and 0.0 the same design.
            number = float(value) + 0.0
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            raise InputError(f"{name} = {value!r} in a design; give finite numbers")
        exact[str(name)] = number
    return exact


@lru_cache(maxsize=1024)
def _quoted(name: str) -> str:
    return json.dumps(name)


def reason_class(reason: str, outcome: Any = None) -> str:
    """What labels are counted by: the ``outcome`` of their evidence, or else the reason.

    Words with digits are masked as "#": reasons that differ in a figure, an address or a task's
    name count as one.
    """
    if isinstance(outcome, str) and outcome:
        return outcome
    return re.sub(r"[\w.:/+-]*\d[\w.:/+-]*", "#", reason)


def storable(label: Label) -> Label:
    """The label with evidence in plain JSON values and ``foldable`` True, False or None.

    Evidence that is not a finite number, or of a type that JSON lacks, becomes None, and the label
    then becomes unknown with a reason that names it. Raises :class:`InputError` for a design that
    is not finite or a ``foldable`` of another type.
    """
    if not (label.foldable is None or isinstance(label.foldable, bool | np.bool_)):
        raise InputError(f"foldable is {label.foldable!r}; a label has True, False or None there")
    foldable = None if label.foldable is None else bool(label.foldable)
    bad: list[str] = []
    evidence = _plain(label.evidence, "", bad)
    reason = _text(label.reason)
    if bad:
        foldable = None
        reason = f"the evidence is not usable ({', '.join(bad)}); the source said: {reason}"
    design = _exact(label.design)
    return Label(design, foldable, reason, evidence, label.source, label.version)


def _plain(value, name: str, bad: list[str]):
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float):
        if math.isfinite(value):
            return float(value)
        bad.append(f"{name} is {value}")
    elif isinstance(value, Mapping):
        prefix = f"{name}." if name else ""
        return {_text(k): _plain(v, f"{prefix}{k}", bad) for k, v in value.items()}
    elif isinstance(value, list | tuple):
        return [_plain(v, f"{name}[{k}]", bad) for k, v in enumerate(value)]
    elif isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist(), name, bad)
    else:
        bad.append(f"{name} is a {type(value).__name__}")
    return None


def _text(value) -> str:
    # System messages may hold lone surrogates, which neither SQLite nor Arrow takes.
    return str(value).encode("utf-8", "replace").decode("utf-8")


def labels_to_frame(labels: Iterable[Label]) -> pd.DataFrame:
    """Flat table, one row per label in the given order: the groups, ``foldable`` (nullable
    boolean), reason, evidence, source, version.

    Nested evidence gets dotted names, lists become JSON text, and evidence that shares its name
    with another column is called ``evidence.<name>``.
    """
    labels = list(labels)
    groups = dict.fromkeys(name for label in labels for name in label.design)
    taken = {*groups, "foldable", "reason", "source", "version"}
    rows = []
    for label in labels:
        row = {**label.design, "foldable": label.foldable, "reason": label.reason}
        for name, value in _flat(label.evidence):
            row[f"evidence.{name}" if name in taken else name] = value
        rows.append({**row, "source": label.source, "version": label.version})
    evidence = [name for name in dict.fromkeys(n for row in rows for n in row) if name not in taken]
    columns = [*groups, "foldable", "reason", *evidence, "source", "version"]
    frame = pd.DataFrame(rows, columns=columns)
    for name in evidence:
        if frame[name].isna().all():
            frame[name] = np.nan
    return frame.astype({"foldable": "boolean"})


def _flat(evidence: Mapping, prefix: str = ""):
    for name, value in evidence.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, json.dumps(value) if isinstance(value, list | tuple) else value


_INSERT = """
INSERT INTO label SELECT ?, ?, id, ?, ?, ?, ? FROM design WHERE key = ?
ON CONFLICT DO UPDATE SET foldable = excluded.foldable, reason = excluded.reason,
    evidence = excluded.evidence, checksum = excluded.checksum WHERE label.foldable IS NULL
"""


class LabelStore:
    """Labels in one SQLite file; a context manager.

    ``mode="write"`` opens a store or makes a new one with the first write, and holds the lock file
    beside it: a second writer gets an :class:`InputError` at once, a killed writer frees it.
    ``mode="read"`` needs an existing store and may be used while a campaign writes. Either way a
    damaged, truncated, empty or foreign file raises :class:`InputError` and is left as it is.
    """

    def __init__(self, path: str | Path, mode: Literal["read", "write"] = "write"):
        self.path = Path(path)
        self.mode = mode
        self._db: sqlite3.Connection | None = None
        self._lock: filelock.BaseFileLock | None = None
        if mode not in ("read", "write"):
            raise InputError(f"mode {mode!r}; a store is opened to 'read' or to 'write'")
        if mode == "read" and not self.path.exists():
            raise InputError(f"no label store {path}; check the path, or run `foldlab label` first")
        try:
            if mode == "write":
                self._take_lock()
            if self.path.exists():
                self._db = store_file.open_checked(self.path, read_only=mode == "read")
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> LabelStore:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and free the lock; what was added is already on disk."""
        if self._db is not None:
            self._db.close()
        if self._lock is not None:
            if not self.path.exists():
                Path(self._lock.lock_file).unlink(missing_ok=True)
            self._lock.release()
        self._db = self._lock = None
        self.mode = "closed"

    def known(self, source: str, version: str) -> dict[str, tuple[bool | None, str | None]]:
        """The labels that are there: ``{design_key: (foldable, reason class if unknown)}``."""
        query = (
            "SELECT key, foldable, CASE WHEN foldable IS NULL THEN reason END, "
            "CASE WHEN foldable IS NULL THEN json_extract(evidence, '$.outcome') END FROM label "
            "JOIN design ON design.id = label.design WHERE source = ? AND version = ?"
        )
        return {
            key: (_verdict(foldable), None if reason is None else reason_class(reason, outcome))
            for key, foldable, reason, outcome in self._read(query, (source, version))
        }

    def register(self, keys: Iterable[str]) -> None:
        """Fix the order of designs (by their keys) in tables, before their labels come."""
        with self._writing() as db:
            db.executemany("INSERT OR IGNORE INTO design (key) VALUES (?)", ((k,) for k in keys))

    def add(self, label: Label) -> int:
        """As :meth:`add_many`, for one label."""
        return self.add_many([label])

    def add_many(self, labels: Iterable[Label]) -> int:
        """Commit labels in one transaction; returns how many rows were written.

        An answer that is already there stays; an unknown is replaced. Evidence that is not finite
        makes the label unknown (:func:`storable`). Raises :class:`InputError`, with nothing
        written, for a label without source or version or with a design that is not finite.
        """
        rows = []
        for label in map(storable, labels):
            if not (label.source and label.version):
                raise InputError(
                    f"a label from source {label.source!r}, version {label.version!r}; give "
                    "both: they identify its row in the store"
                )
            key, evidence = design_key(label.design), json.dumps(dict(label.evidence))
            row = (
                str(label.source),
                str(label.version),
                key,
                label.foldable,
                label.reason,
                evidence,
            )
            rows.append((*row[:2], *row[3:], store_file.checksum(*row), key))
        with self._writing() as db:
            db.executemany(
                "INSERT OR IGNORE INTO design (key) VALUES (?)", ((r[-1],) for r in rows)
            )
            return db.executemany(_INSERT, rows).rowcount if rows else 0

    def frame(self, source: str | None = None, version: str | None = None) -> pd.DataFrame:
        """The table of :func:`labels_to_frame`, by source, version and first request of a design.

        Raises :class:`InputError` if the named source or version has no label here.
        """
        chosen = {k: v for k, v in (("source", source), ("version", version)) if v is not None}
        where = " AND ".join(f"{name} = ?" for name in chosen) or "1"
        query = f"{store_file.SELECT} WHERE {where} ORDER BY source, version, design.id"
        rows = self._read(query, tuple(chosen.values()))
        if chosen and not rows:
            there = ", ".join(f"{m['source']} {m['version']}" for m in self.meta()["labels"])
            wanted = " ".join(f"{name} {value}" for name, value in chosen.items())
            raise InputError(f"{self.path} has no labels of {wanted}; it has: {there or 'none'}")
        return labels_to_frame(
            Label(json.loads(key), _verdict(foldable), reason, json.loads(evidence), name, number)
            for name, number, key, foldable, reason, evidence, _ in rows
        )

    def meta(self) -> dict[str, Any]:
        """How the store was made, and under ``labels`` the counts by source and version."""
        counts = self._read(
            "SELECT source, version, COUNT(*), COUNT(foldable), COALESCE(SUM(foldable), 0) "
            "FROM label GROUP BY source, version ORDER BY source, version"
        )
        labels = [
            {"source": s, "version": v, "labels": n, "folds": folds, "not": known - folds,
             "unknown": n - known}
            for s, v, n, known, folds in counts
        ]  # fmt: skip
        return {**dict(self._read("SELECT key, value FROM meta")), "labels": labels}

    def export(
        self, path: str | Path, source: str | None = None, version: str | None = None
    ) -> int:
        """Write :meth:`frame` to ``.parquet`` or ``.csv``, whole or not at all; returns the rows.

        How it was made (foldlab version, sources, counts) goes into ``attrs["foldlab"]`` of the
        Parquet table or into ``<path>.json`` beside the CSV. Raises :class:`InputError` for another
        suffix, a missing folder, or if there is no label to write.
        """
        # Arrow is slow to import, and worker processes import this module.
        from foldlab.tables import replace_file, write_table

        frame = self.frame(source, version)
        if not len(frame):
            raise InputError(f"{self.path} holds no labels yet; run `foldlab label` first")
        counts = frame.groupby(["source", "version"]).size()
        how = {
            "foldlab": foldlab.__version__,
            "sources": [
                {"source": s, "version": v, "labels": int(n)} for (s, v), n in counts.items()
            ],
            "labels": len(frame),
        }
        frame.attrs["foldlab"] = how
        path = write_table(frame, path)
        if path.suffix == ".csv":
            text = json.dumps(how, indent=1) + "\n"
            replace_file(path.with_name(path.name + ".json"), lambda file: file.write_text(text))
        return len(frame)

    def _take_lock(self) -> None:
        if not self.path.parent.is_dir():
            raise InputError(f"no folder {self.path.parent} for the store; make it first")
        self._lock = filelock.FileLock(f"{self.path}.lock", thread_local=False)
        try:
            self._lock.acquire(blocking=False)
        except filelock.Timeout:
            self._lock = None
            raise InputError(
                f"another process is writing {self.path} (it holds {self.path}.lock); wait for it, "
                "or label into another store"
            ) from None
        except OSError as error:
            self._lock = None
            raise InputError(f"{self.path} can't be locked for writing ({error})") from None

    def _read(self, query: str, values: tuple = ()) -> list[tuple]:
        if self.mode == "closed":
            raise InputError(f"the store {self.path} is closed; open it again")
        if self._db is None:
            return []
        try:
            return self._db.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise store_file.failure(self.path, error) from error

    @contextmanager
    def _writing(self):
        if self.mode != "write":
            state = "closed" if self.mode == "closed" else "open for reading"
            raise InputError(f"the store {self.path} is {state}; open it with mode='write'")
        try:
            if self._db is None:
                self._db = store_file.create(self.path)
            with self._db:
                yield self._db
        except (sqlite3.Error, OSError) as error:
            raise store_file.failure(self.path, error) from error


def _verdict(stored: int | None) -> bool | None:
    return None if stored is None else bool(stored)
