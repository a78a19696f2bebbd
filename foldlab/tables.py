"""Tables on disk (Parquet or CSV, read with clear errors, written whole) and those of others."""

from __future__ import annotations

import csv
import io
import os
import re
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import ArrowException, interchange

from foldlab.errors import InputError

SUFFIXES = (".parquet", ".csv")
# How much of a CSV's text decides its separator and decimal sign.
HEAD = 1 << 16
# What one table may have; a label has some 60.
MOST_CELLS = 200_000_000


def read_table(path: str | Path) -> pd.DataFrame:
    """Read a Parquet or CSV table; raises :class:`InputError` if missing, empty or damaged.

    A CSV may have commas, semicolons or tabs between its cells, blanks after them, decimal commas
    (not between commas) and a byte-order mark; a column may stand in it only once, and no row may
    have more or fewer cells than the header.
    """
    path = Path(path)
    _check_suffix(path)
    if not path.is_file():
        raise InputError(f"no file {path}; give an existing .parquet or .csv table")
    try:
        _check_size(path)
        frame = pd.read_parquet(path) if _kind(path) == ".parquet" else _read_csv(path)
    except InputError:
        raise
    except (ArrowException, csv.Error, OSError, ValueError) as error:
        why = str(error).partition("\n")[0]
        raise InputError(
            f"{path} can't be read as {_kind(path)[1:]} ({why}); "
            "write it again, for example with `foldlab sample` or `foldlab export`"
        ) from None
    if len(frame) == 0:
        raise InputError(f"{path} has no rows; give a table with at least one design")
    return frame


def _check_size(path: Path) -> None:
    """Raises :class:`InputError` for a table of more cells than :data:`MOST_CELLS`: a Parquet file
    of a few kB may hold billions of equal ones."""
    if _kind(path) == ".parquet":
        told = pq.read_metadata(path)
        cells = told.num_rows * told.num_columns
    else:
        cells = path.stat().st_size // 2  # a digit and what parts it from the next
    if cells > MOST_CELLS:
        raise InputError(f"{path} has {cells:.3g} cells; at most {MOST_CELLS:.3g} are read")


def _read_csv(path: Path) -> pd.DataFrame:
    with path.open(encoding="utf-8-sig", newline="") as file:
        head = file.read(HEAD)
        separator = max(",;\t", key=lambda s: len(next(_rows(io.StringIO(head), s), [])))
        file.seek(0)
        rows = _rows(file, separator)
        header = next(rows, [])
        if not header:
            raise ValueError("it is empty")
        named = max(k for k, name in enumerate(header) if name) + 1
        for k, row in enumerate(rows):
            # pandas would shift such a row, or drop its last cells, without a word.
            if any(row[len(header) :]):
                raise InputError(
                    f"{path} has more cells in row {k} than the {len(header)} of its header; mend "
                    "the row (decimal commas need semicolons or tabs between cells)"
                )
            if len(row) < named:
                raise InputError(
                    f"{path} has {len(row)} cells in row {k} and {named} names in its header; "
                    "write the table again, or commas for cells that are empty"
                )
    if twice := [name for name in header if name and header.count(name) > 1]:
        raise InputError(f"{path} has the column {twice[0]} twice; keep the one that counts")
    frame = pd.read_csv(
        path, sep=separator, decimal=_decimal(head, separator), usecols=range(len(header)),
        index_col=False, skipinitialspace=True, encoding="utf-8-sig",
    )  # fmt: skip
    bare = {f"Unnamed: {k}" for k, name in enumerate(header) if not name}
    frame.columns = [name.strip() for name in frame.columns]
    return frame.drop(columns=[name for name in bare if frame[name].isna().all()])


def _rows(lines, separator: str):
    """The rows of a CSV that hold anything, their cells without blanks around them."""
    for row in csv.reader(lines, delimiter=separator, skipinitialspace=True):
        if any(cells := [cell.strip() for cell in row]):
            yield cells


def _decimal(text: str, separator: str) -> str:
    def cell(sign: str) -> re.Pattern:
        return re.compile(
            rf'(?m)(?:^|{separator})[ "]*[+-]?\d*{sign}\d+(?:[eE][+-]?\d+)?[ "]*'
            rf"(?:{separator}|\r|$)"
        )

    if separator == "," or cell(r"\.").search(text) or not cell(",").search(text):
        return "."
    return ","


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
        why = str(error).partition("\n")[0]
        raise InputError(
            f"the columns of this {type(X).__name__} can't be read by name "
            f"({type(error).__name__}: {why}); give a pandas frame"
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
    write = frame.to_parquet if _kind(path) == ".parquet" else frame.to_csv
    replace_file(path, lambda temporary: write(temporary, index=False))
    return path


def need_folder(path: Path) -> None:
    """Raises :class:`InputError` where ``path`` is a folder, or there is none to write it to."""
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the path of a file")
    if path.parent.is_dir():
        return
    above = next(folder for folder in path.parents if folder.exists())
    if not above.is_dir():
        raise InputError(f"can't write {path}: {above} is a file; give another place")
    raise InputError(f"no folder {path.parent} to write {path.name} to; make it first")


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, then move it into place."""
    need_folder(path)
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


def _kind(path: Path) -> str:
    return path.suffix.lower()


def _check_suffix(path: Path) -> None:
    if _kind(path) not in SUFFIXES:
        raise InputError(
            f"{path}: ending {path.suffix or '(none)'!r}; tables end in {' or '.join(SUFFIXES)}"
        )
