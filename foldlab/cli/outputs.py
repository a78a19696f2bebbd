"""Where results go: looked at before any work; nothing half-made stays where a verb fails.

Also the option ``--files`` of the verbs ``check`` and ``design``: a folder to make a unit by.
"""

from __future__ import annotations

import errno
import os
import platform
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from foldlab.errors import InputError
from foldlab.packaged import installed
from foldlab.tables import need_folder
from foldlab.terminal import NotReached, note

if TYPE_CHECKING:
    from foldlab.labels.run import Run
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.sized import Sized

Files = Annotated[
    Path | None,
    typer.Option(
        "--files",
        help="New folder for files to make the unit: drawing, DXF, STEP, STL, FOLD, report.",
    ),
]


def check_file(path: Path, suffixes: Sequence[str] = ()) -> None:
    """That a file can be written at ``path``, which ends in one of ``suffixes`` if there are any;
    raises :class:`InputError` where not."""
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(
            f"{path}: ending {path.suffix or '(none)'!r}; expected {' or '.join(suffixes)}"
        )
    need_folder(path)
    _try_writing(path.parent, path)


@contextmanager
def output_folder(path: Path, *, keep: Sequence[str] = ()) -> Iterator[Path]:
    """The folder ``path``, made where it is missing.

    If the body fails, what it put there is taken away again but for the files named in ``keep``;
    what a verb that did not reach its result has written stays. Raises :class:`InputError` where
    nothing can be written.
    """
    with only_whole(path, keep=keep):
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"can't make the folder {path} ({error.strerror}); give another one"
            ) from None
        _try_writing(path, path)
        yield path


@contextmanager
def only_whole(path: Path, *, keep: Sequence[str] = ()) -> Iterator[None]:
    """Takes away what the body made at or below the folder ``path`` if it fails.

    Raises :class:`InputError` before the body where nothing could be written there.
    """
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file; give a folder")
    above = (path, *path.parents)[len(missing)]
    if not above.is_dir():
        raise InputError(f"can't make the folder {path}: {above} is a file; give another folder")
    _try_writing(above, path)
    before = set(path.iterdir()) if path.exists() else set()
    try:
        yield
    except NotReached:
        raise
    except Exception:
        for made in set(path.iterdir()) - before if path.is_dir() else ():
            if made.is_dir():
                shutil.rmtree(made, ignore_errors=True)
            elif made.name not in keep:
                made.unlink(missing_ok=True)
        for folder in missing:
            with suppress(OSError):
                folder.rmdir()
        raise


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A draft beside ``path`` that becomes the folder ``path`` where the body ends well, and is
    taken away where it fails.

    Raises :class:`InputError` where there is something at ``path``, or nothing can be written.
    """
    if path.exists():
        raise InputError(f"{path} is there already; give a new folder, or move it away")
    with only_whole(path):
        draft = path.with_name(f".{path.name}.{os.getpid()}")
        draft.mkdir(parents=True)
        try:
            yield draft
            draft.rename(path)
        finally:
            shutil.rmtree(draft, ignore_errors=True)


def _try_writing(folder: Path, path: Path) -> None:
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            # An empty file can be made on a full disk, too.
            file.write(b"\0" * 4096)
            file.flush()
    except OSError as error:
        raise InputError(
            f"can't write {path} ({error.strerror}: {folder}); give another place"
        ) from None


# What a disk may answer whatever is asked of it.
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO)


def trouble(error: BaseException | None) -> str | None:
    """One sentence about a disk or a memory that failed underneath an error; None for others."""
    known, first = None, error
    while known is None and error is not None:
        if isinstance(error, MemoryError):
            known = f"not enough memory ({error or 'out of memory'}); ask for less"
        elif isinstance(error, sqlite3.OperationalError):
            known = f"can't use the database ({error}); free some space or give another place"
        elif isinstance(error, OSError) and (error is first or error.errno in _DISK):
            where = f": {error.filename}" if error.filename else ""
            known = (
                f"can't read or write ({error.strerror or error}{where}); "
                "free some space or give another place"
            )
        error = error.__cause__ or error.__context__
    return known


def tell_slow() -> None:
    """Say on stderr that the solver would be faster with MKL, where it is not installed."""
    if platform.machine().lower() in ("x86_64", "amd64") and not installed("pypardiso"):
        note('without MKL the solver takes three times as long: pip install "foldlab[fast]"')


def make(
    folder: Path,
    unit: Sized,
    source: SolverSource,
    answer: Mapping[str, Any],
    told: Mapping[str, Any],
    run: Run | None,
    picture: Path | None = None,
) -> dict[str, Any]:
    """Writes a unit's files into a folder that is there; their names, and why some are missing."""
    from foldlab.making.folder import FILES, Dossier, write

    missing = write(folder, Dossier(unit, answer, told, source, run, picture))
    for name, why in missing.items():
        note(f"warning: no {name}: {why}")
    return {"files": [name for name in FILES if name not in missing], "missing": missing}
