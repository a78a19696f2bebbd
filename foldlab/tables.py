"""Tables on disk: Parquet or CSV by the file's ending, read with clear errors, written whole."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import pandas as pd
from pyarrow import ArrowException

from foldlab.errors import InputError

SUFFIXES = (".parquet", ".csv")


def read_table(path: str | Path) -> pd.DataFrame:
    """Read a Parquet or CSV table; raises :class:`InputError` if missing, empty or damaged."""
    path = Path(path)
    _check_suffix(path)
    if not path.is_file():
        raise InputError(f"no file {path}; give an existing .parquet or .csv table")
    try:
        frame = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path)
    except (ArrowException, OSError, ValueError) as error:
        raise InputError(
            f"{path} can't be read as {path.suffix[1:]} ({str(error).splitlines()[0]}); "
            "write it again, for example with `foldlab sample` or `foldlab export`"
        ) from None
    if len(frame) == 0:
        raise InputError(f"{path} has no rows; give a table with at least one design")
    return frame


def write_table(frame: pd.DataFrame, path: str | Path) -> Path:
    """Write a Parquet or CSV table by way of a temporary file: whole or not at all."""
    path = Path(path)
    _check_suffix(path)
    write = frame.to_parquet if path.suffix == ".parquet" else frame.to_csv
    replace_file(path, lambda temporary: write(temporary, index=False))
    return path


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, then move it into place."""
    if not path.parent.is_dir():
        raise InputError(f"no folder {path.parent} to write {path.name} to; make it first")
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the path of a file")
    handle, temporary = tempfile.mkstemp(
        dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix
    )
    os.close(handle)
    try:
        write(Path(temporary))
        # mkstemp makes files that only their owner may read.
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    finally:
        Path(temporary).unlink(missing_ok=True)


def _check_suffix(path: Path) -> None:
    if path.suffix not in SUFFIXES:
        raise InputError(
            f"{path}: ending {path.suffix or '(none)'!r}; tables end in {' or '.join(SUFFIXES)}"
        )
