"""Tables on disk (Parquet or CSV, read with clear errors, written whole) and those of others."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import ArrowException, interchange

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


def as_frame(X):
    """A pandas frame of whatever names its columns; an array without names as it came.

    Reads tables of pyarrow, polars and others by their own conversion or exchange protocol,
    structured arrays, mappings of columns, and lists of rows with names. Raises
    :class:`InputError` where names are there but can't be read: positions must not stand in.
    """
    if isinstance(X, pd.DataFrame):
        return X
    try:
        frame = _named(X)
    except Exception as error:  # whatever a stranger's table raises
        raise InputError(
            f"the columns of this {type(X).__name__} can't be read by name "
            f"({type(error).__name__}: {error}); give a pandas frame"
        ) from None
    # Numbers that merely count the columns, as of a labelled array without labels, are no names.
    return frame if frame is not None and any(isinstance(c, str) for c in frame) else X


def _named(X) -> pd.DataFrame | None:
    if isinstance(X, pd.Series):
        return None
    if hasattr(X, "to_pandas"):
        return X.to_pandas()
    if hasattr(X, "__arrow_c_stream__"):
        return pa.table(X).to_pandas()
    if hasattr(X, "__dataframe__"):
        return interchange.from_dataframe(X).to_pandas()
    if isinstance(X, Mapping):
        names = list(X)
    elif isinstance(X, list | tuple):
        rows = all(isinstance(row, Mapping | pd.Series) or hasattr(row, "_fields") for row in X)
        return pd.DataFrame(map(_row, X)) if X and rows else None
    else:
        names = next(
            (getattr(X, a) for a in ("columns", "column_names", "colnames") if hasattr(X, a)),
            getattr(getattr(X, "dtype", None), "names", None),
        )
        names = names() if callable(names) else names
    if names is None:
        return None
    return pd.DataFrame({name: np.asarray(X[name]) for name in names})


def _row(row) -> Mapping:
    return row._asdict() if hasattr(row, "_asdict") else row


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
