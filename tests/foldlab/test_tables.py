"""Tables that people bring: names decide columns, whatever library made the table."""

import os
import stat
from collections import namedtuple
from functools import partial

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.labels import timoshenko
from foldlab.learning.features import GroupFeatures, groups_array
from foldlab.learning.models import make_classifier
from foldlab.learning.network import SmoothNetwork
from foldlab.learning.scoring import score
from foldlab.learning.symbolic.engines import Constraints
from foldlab.learning.symbolic.estimators import SymbolicRegressor
from foldlab.learning.train import known_labels
from foldlab.tables import read_table, write_table


class Like:
    """A table of a library that is not here: names, columns by name, an array by position."""

    def __init__(self, frame, attribute="columns"):
        self._frame = frame
        setattr(self, attribute, list(frame.columns))

    def __getitem__(self, name):
        return self._frame[name].to_numpy()

    def __array__(self, dtype=None, copy=None):
        return self._frame.to_numpy(dtype)

    def __len__(self):
        return len(self._frame)


class Exchanges(Like):
    """Speaks the exchange protocol and nothing else."""

    def __init__(self, frame):
        self._frame = frame

    def __dataframe__(self, **options):
        return pa.Table.from_pandas(self._frame).__dataframe__(**options)

    def __getitem__(self, name):
        raise KeyError(name)


class Arrow(Exchanges):
    def __arrow_c_stream__(self, requested_schema=None):
        return pa.Table.from_pandas(self._frame).__arrow_c_stream__(requested_schema)

    __dataframe__ = None


class Converts(Exchanges):
    __dataframe__ = None

    def to_pandas(self):
        return self._frame


def structured(frame):
    return frame.to_records(index=False)


def rows(frame):
    Row = namedtuple("Row", frame.columns)
    return [Row(*values) for values in frame.to_numpy()]


TABLES = {
    "pyarrow": pa.Table.from_pandas,
    "pyarrow batch": pa.RecordBatch.from_pandas,
    "arrow stream": Arrow,
    "exchange": Exchanges,
    "its own conversion": Converts,
    "columns": Like,
    "column_names": lambda f: Like(f, "column_names"),
    "colnames": lambda f: Like(f, "colnames"),
    "structured": structured,
    "mapping": lambda f: {name: f[name].to_numpy() for name in f},
    "records": lambda f: f.to_dict("records"),
    "rows of pandas": lambda f: [row for _, row in f.iterrows()],
    "named tuples": rows,
}
TURNED = REDUCED.names[::-1]


@pytest.mark.parametrize("make", TABLES.values(), ids=TABLES)
def test_names_decide_columns_in_any_table(make):
    X = REDUCED.sample(7, seed=0)
    strange = make(X[TURNED].assign(note=1.0))
    np.testing.assert_array_equal(groups_array(strange, REDUCED), X.to_numpy())
    with pytest.raises(InputError, match="lacks h_ratio"):
        groups_array(make(X.rename(columns={"h_ratio": "h"})), REDUCED)
    labels = timoshenko.TimoshenkoSource().evaluate(make(X[TURNED]))
    np.testing.assert_array_equal(labels["foldable"], timoshenko.folds(**X))


def test_models_answer_alike_whatever_the_order_of_the_columns():
    X = REDUCED.sample(400, seed=0)
    y = timoshenko.folds(**X)
    turned = pa.RecordBatch.from_pandas(X[TURNED])
    model = make_classifier("tree", REDUCED, seed=0).fit(X, y)
    np.testing.assert_array_equal(model.predict(turned), model.predict(X))
    assert score(model, turned, y)["accuracy"] == score(model, X, y)["accuracy"]
    formula = SymbolicRegressor(REDUCED)
    np.testing.assert_array_equal(formula._columns(turned), X)


@pytest.mark.parametrize("model", [GroupFeatures(), SymbolicRegressor(), SmoothNetwork(None)])
def test_without_a_space_columns_in_another_order_are_refused(model):
    X = REDUCED.sample(40, seed=0)
    turned = pa.RecordBatch.from_pandas(X[TURNED])
    if isinstance(model, SmoothNetwork):
        model._read(X, None, reset=True)
        call = partial(model._read, y=None, reset=False)
    else:
        limits = {"constraints": Constraints(seconds=60, generations=2, population=20)}
        model.set_params(**limits if "constraints" in model.get_params() else {})
        model.fit(X, np.arange(1, 41))
        call = model.predict if hasattr(model, "predict") else model.transform
    with pytest.raises(ValueError, match="order"):
        call(turned)


def test_names_that_can_not_be_read_are_an_error_not_a_guess():
    class Lazy(Like):
        def __getitem__(self, name):
            raise TypeError("collect first")

    X = REDUCED.sample(3, seed=0)
    with pytest.raises(InputError, match=r"Lazy can't be read by name .*collect first"):
        groups_array(Lazy(X), REDUCED)
    np.testing.assert_array_equal(groups_array(X.to_numpy(), REDUCED), X)
    with pytest.raises(InputError, match="came as ndarray; give a table with names"):
        REDUCED.validate(X.to_numpy())
    with pytest.raises(InputError, match="column E_ratio stands 2 times"):
        groups_array(pd.concat([X, X["E_ratio"]], axis=1), REDUCED)


X = REDUCED.sample(5, seed=3).round(4)
PLAIN = X.to_csv(index=False)
GERMAN = PLAIN.replace(",", ";").replace(".", ",")
READABLE = {
    "plain": PLAIN,
    "blanks": PLAIN.replace(",", " ,  "),
    "semicolons": PLAIN.replace(",", ";"),
    "decimal commas": GERMAN,
    "quoted decimal commas": GERMAN.replace(";", '";"').replace("\n", '"\n"')[:-1],
    "tabs": PLAIN.replace(",", "\t"),
    "tabs, decimal commas": GERMAN.replace(";", "\t"),
    "byte-order mark": "\ufeff" + PLAIN,
    "quoted header": PLAIN.replace("E_ratio", '"E_ratio"'),
    "quoted header after a mark": "\ufeff" + GERMAN.replace("E_ratio", '"E_ratio"'),
    "trailing commas": PLAIN.replace("\n", ",\n"),
    "trailing commas in the rows": PLAIN.replace("\n", ",\n").replace(",\n", "\n", 1),
    "lines of Windows": PLAIN.replace("\n", "\r\n"),
    "lines of Windows, German": GERMAN.replace("\n", ";\r\n"),
    "empty lines": "\n" + PLAIN.replace("\n", "\n\n"),
}


@pytest.mark.parametrize("name", READABLE)
@pytest.mark.parametrize("suffix", [".csv", ".CSV"])
def test_tables_of_other_programs_are_read(name, suffix, tmp_path):
    text = READABLE[name]
    if name == "quoted decimal commas":
        text = '"' + text
    path = tmp_path / f"d{suffix}"
    path.write_text(text, encoding="utf-8", newline="")
    pd.testing.assert_frame_equal(read_table(path), X)


def add(line, cells):
    """The plain table with cells added to one line, or to all rows."""
    lines = PLAIN.splitlines()
    for k in range(1, len(lines)) if line is None else [line]:
        lines[k] += cells
    return "\n".join(lines)


UNREADABLE = {
    "first row too long": (add(1, ",3"), "more cells in row 0 than the 3 of its header"),
    "a later row too long": (add(4, ",3"), "more cells in row 3 than"),
    "all rows too long": (add(None, ",3"), "more cells in row 0 than"),
    "a later row far too long": (add(4, ",3,,4"), "more cells in row 3 than"),
    "a row too short": ("\n".join(PLAIN.splitlines())[:-12], "2 cells in row 4 and 3 names"),
    "decimal commas between commas": (PLAIN.replace(".", ","), "decimal commas need semicolons"),
    "repeated": (PLAIN.replace("h_ratio", "E_ratio"), "has the column E_ratio twice"),
    "repeated after a mark": (
        "\ufeff" + PLAIN.replace("h_ratio", "E_ratio"),
        "the column E_ratio twice",
    ),
    "repeated after blanks": (PLAIN.replace("h_ratio", " E_ratio "), "the column E_ratio twice"),
    "empty": (" \n\n", r"can't be read as csv \(it is empty\)"),
    "Latin letters": ("größe,b\n1,2\n".encode("latin-1"), "can't be read as csv .*utf-8"),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_tables_that_can_not_be_read_name_the_cause(name, tmp_path):
    text, cause = UNREADABLE[name]
    path = tmp_path / "d.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=cause):
        read_table(path)


def test_thousands_between_decimal_points_are_no_decimals(tmp_path):
    path = tmp_path / "d.csv"
    path.write_text("E_ratio;h_ratio;slenderness\n1,000;2.5;0.01\n")
    with pytest.raises(InputError, match="E_ratio is not numeric"):
        REDUCED.validate(read_table(path))


def test_tables_are_written_by_endings_in_capitals_too(tmp_path):
    for name in ("d.CSV", "d.PARQUET"):
        pd.testing.assert_frame_equal(read_table(write_table(X, tmp_path / name)), X)


@pytest.mark.parametrize(("yes", "no"), [("yes", "no"), ("Yes ", "No"), ("TRUE", "False")])
def test_labels_may_be_words(yes, no, tmp_path):
    path = tmp_path / "d.csv"
    words = [yes, no, "", no, yes]
    path.write_text(X.assign(foldable=words).to_csv(index=False))
    known, unknown = known_labels(read_table(path), REDUCED)
    assert known["foldable"].tolist() == [True, False, False, True] and unknown == 1
    path.write_text(X.assign(foldable=[*words[:4], "perhaps"]).to_csv(index=False))
    with pytest.raises(InputError, match="labels contain perhaps"):
        known_labels(read_table(path), REDUCED)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("umask, mode", [(0o022, 0o644), (0o007, 0o660)])
def test_a_table_may_be_read_by_whom_the_users_files_may(umask, mode, suffix, tmp_path):
    before = os.umask(umask)
    try:
        path = write_table(REDUCED.sample(3, seed=0), tmp_path / f"designs.{suffix}")
        assert os.umask(umask) == umask
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == mode
