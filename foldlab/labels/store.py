"""The file under a label store: its schema, how it is made, opened and found to be sound."""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Iterable
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import filelock
import pandas as pd

import foldlab
from foldlab.errors import InputError
from foldlab.labels.label import Label, design_key, labels_to_frame, reason_class, storable

_APPLICATION = 0x464F4C44  # "FOLD"
_FORMAT = 1
_BUSY_SECONDS = 60
# Designs have their own table so that a campaign lists them in its order before the first label:
# that order then outlives interruptions.
_SCHEMA = f"""
BEGIN;
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE design (id INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE);
CREATE TABLE label (
    source TEXT NOT NULL, version TEXT NOT NULL, design INTEGER NOT NULL REFERENCES design (id),
    foldable INTEGER CHECK (foldable IN (0, 1)), reason TEXT NOT NULL, evidence TEXT NOT NULL,
    checksum INTEGER NOT NULL, PRIMARY KEY (source, version, design)
) WITHOUT ROWID;
PRAGMA application_id = {_APPLICATION};
PRAGMA user_version = {_FORMAT};
COMMIT;
"""

SELECT = """
SELECT source, version, key, foldable, reason, evidence, checksum FROM label
JOIN design ON design.id = label.design
"""


def open_checked(path: Path, *, read_only: bool) -> sqlite3.Connection:
    """Open an existing store; :class:`InputError`, with the file untouched, if it is not sound."""
    if not path.is_file() or path.stat().st_size == 0:
        raise damaged(path, "it has 0 bytes" if path.is_file() else "it is no file")
    db = None
    try:
        application, number = _identity(path)
        if application != _APPLICATION:
            raise InputError(
                f"{path} is a database, but not a label store of foldlab; give another path "
                "(the file was left as it is)"
            )
        if number != _FORMAT:
            raise InputError(
                f"{path} has format {number}, and this foldlab reads format {_FORMAT}; use the "
                "foldlab that wrote it"
            )
        # Readers too open to write: the journal of a killed writer has to be rolled back.
        db = _connect(path, "rw")
        if read_only:
            db.execute("PRAGMA query_only = 1")
        ((verdict,),) = db.execute("PRAGMA integrity_check(1)").fetchall()
        if verdict != "ok":
            raise damaged(path, " ".join(verdict.split()))
        if db.execute("PRAGMA foreign_key_check").fetchone():
            raise damaged(path, "the design of a label is missing")
        # SQLite does not notice a changed byte inside a text.
        for *row, stored in db.execute(SELECT):
            texts = all(isinstance(text, str) for text in (*row[:3], *row[4:]))
            if not (texts and row[3] in (None, 0, 1)) or checksum(*row) != stored:
                raise damaged(path, f"the label of {row[2]} does not match its checksum")
        return db
    except BaseException as error:
        if db is not None:
            db.close()
        if isinstance(error, sqlite3.Error):
            raise failure(path, error) from None
        if isinstance(error, UnicodeDecodeError):
            # SQLite names what is damaged in the file's own bytes.
            raise damaged(path, "a name in it is no text") from None
        raise


def create(path: Path) -> sqlite3.Connection:
    """Make an empty store; the caller holds the lock."""
    # Made beside and moved into place: a kill never leaves an empty store behind.
    fresh = Path(f"{path}.new")
    drafts = (fresh, Path(f"{fresh}-journal"))
    for stale in (*drafts, Path(f"{path}-journal")):
        stale.unlink(missing_ok=True)
    made = {"foldlab": foldlab.__version__, "created": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"}
    try:
        with closing(sqlite3.connect(fresh)) as db, db:
            db.executescript(_SCHEMA)
            db.executemany("INSERT INTO meta VALUES (?, ?)", made.items())
        fresh.replace(path)
    except BaseException:
        for draft in drafts:
            draft.unlink(missing_ok=True)
        raise
    return _connect(path, "rw")


def checksum(source, version, key, foldable, reason, evidence) -> int:
    """CRC-32 of a row; ``foldable`` is None, or 0 and 1 in either type."""
    verdict = "?" if foldable is None else str(int(foldable))
    return zlib.crc32("\0".join((source, version, key, verdict, reason, evidence)).encode())


def damaged(path: Path, what: str) -> InputError:
    return InputError(
        f"{path} is damaged or no label store ({what}); restore a copy or move it away and label "
        "again (the file was left as it is)"
    )


def failure(path: Path, error: Exception) -> InputError:
    """The :class:`InputError` that says what an error of SQLite or the system means here."""
    code = getattr(error, "sqlite_errorname", None) or ""
    if code.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
        return InputError(f"{path} was busy for {_BUSY_SECONDS} s; try again later")
    outside = ("SQLITE_FULL", "SQLITE_IOERR", "SQLITE_READONLY", "SQLITE_PERM", "SQLITE_CANTOPEN")
    if isinstance(error, OSError) or code.startswith(outside):
        return InputError(
            f"{path} can't be used ({error}); check the space and the permissions of its folder: "
            "what was committed stays, and running again completes the rest"
        )
    return damaged(path, str(error))


def _identity(path: Path) -> tuple[int, int]:
    try:
        with closing(_connect(path, "ro")) as db:
            names = ("application_id", "user_version")
            return tuple(db.execute(f"PRAGMA {name}").fetchone()[0] for name in names)
    except sqlite3.OperationalError as error:
        if error.sqlite_errorname != "SQLITE_READONLY_ROLLBACK":
            raise
    # A journal waits to be rolled back. Look before SQLite does that: the file may be another's.
    with path.open("rb") as file:
        header = file.read(72)
    return int.from_bytes(header[68:72]), int.from_bytes(header[60:64])


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    return sqlite3.connect(
        f"{path.resolve().as_uri()}?mode={mode}", uri=True, timeout=_BUSY_SECONDS
    )


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
        self._bare = False  # made here, and without a label so far
        if mode not in ("read", "write"):
            raise InputError(f"mode {mode!r}; a store is opened to 'read' or to 'write'")
        if mode == "read" and not self.path.exists():
            raise InputError(f"no label store {path}; check the path, or run `foldlab label` first")
        try:
            if mode == "write":
                self._take_lock()
            if self.path.exists():
                self._db = open_checked(self.path, read_only=mode == "read")
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
            # Taken away while it is held: whoever waits for the file that was sees that it is gone.
            with suppress(OSError):
                Path(self._lock.lock_file).unlink()
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
            rows.append((*row[:2], *row[3:], checksum(*row), key))
        with self._writing() as db:
            db.executemany(
                "INSERT OR IGNORE INTO design (key) VALUES (?)", ((r[-1],) for r in rows)
            )
            count = db.executemany(_INSERT, rows).rowcount if rows else 0
        self._bare = self._bare and not count
        return count

    def frame(self, source: str | None = None, version: str | None = None) -> pd.DataFrame:
        """The table of :func:`labels_to_frame`, by source, version and first request of a design.

        Raises :class:`InputError` if the named source or version has no label here.
        """
        chosen = {k: v for k, v in (("source", source), ("version", version)) if v is not None}
        where = " AND ".join(f"{name} = ?" for name in chosen) or "1"
        query = f"{SELECT} WHERE {where} ORDER BY source, version, design.id"
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
            {
                "source": s,
                "version": v,
                "labels": n,
                "folds": folds,
                "not": known - folds,
                "unknown": n - known,
            }
            for s, v, n, known, folds in counts
        ]
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
        path = Path(path)
        if path.suffix.lower() != ".csv":
            write_table(frame, path)
            return len(frame)
        beside = path.with_name(path.name + ".json")

        def write(file: Path) -> None:
            frame.to_csv(file, index=False)
            # Before the table is moved into place, which needs no room.
            replace_file(beside, lambda other: other.write_text(json.dumps(how, indent=1) + "\n"))

        replace_file(path, write)
        return len(frame)

    def _take_lock(self) -> None:
        from foldlab.tables import need_folder

        need_folder(self.path)
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
            raise InputError(
                f"can't write {self.path} ({error.strerror or error}: {self.path}.lock); give "
                "another place"
            ) from None

    def _read(self, query: str, values: tuple = ()) -> list[tuple]:
        if self.mode == "closed":
            raise InputError(f"the store {self.path} is closed; open it again")
        if self._db is None:
            return []
        try:
            return self._db.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise failure(self.path, error) from error

    @contextmanager
    def _writing(self):
        if self.mode != "write":
            state = "closed" if self.mode == "closed" else "open for reading"
            raise InputError(f"the store {self.path} is {state}; open it with mode='write'")
        try:
            if self._db is None:
                self._db, self._bare = create(self.path), True
            with self._db:
                yield self._db
        except (sqlite3.Error, OSError) as error:
            if self._bare:
                self._db.close()
                for file in (self.path, Path(f"{self.path}-journal")):
                    file.unlink(missing_ok=True)
                self._db, self._bare = None, False
            raise failure(self.path, error) from error


def _verdict(stored: int | None) -> bool | None:
    return None if stored is None else bool(stored)
