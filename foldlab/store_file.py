"""The file under a label store: its schema, how it is made, opened and found to be sound."""

from __future__ import annotations

import sqlite3
import zlib
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import foldlab
from foldlab.errors import InputError

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
            raise damaged(path, verdict)
        # SQLite does not notice a changed byte inside a text.
        for *row, stored in db.execute(SELECT):
            if checksum(*row) != stored:
                raise damaged(path, f"the label of {row[2]} does not match its checksum")
        return db
    except BaseException as error:
        if db is not None:
            db.close()
        if isinstance(error, sqlite3.Error):
            raise failure(path, error) from None
        raise


def create(path: Path) -> sqlite3.Connection:
    """Make an empty store; the caller holds the lock."""
    # Made beside and moved into place: a kill never leaves an empty store behind.
    fresh = Path(f"{path}.new")
    for stale in (fresh, Path(f"{fresh}-journal"), Path(f"{path}-journal")):
        stale.unlink(missing_ok=True)
    made = {"foldlab": foldlab.__version__, "created": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"}
    with closing(sqlite3.connect(fresh)) as db, db:
        db.executescript(_SCHEMA)
        db.executemany("INSERT INTO meta VALUES (?, ?)", made.items())
    fresh.replace(path)
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
