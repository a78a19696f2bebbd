"""The label store: exact keys, one writer, loud on damage, honest about what is not finite."""

import json
import signal
import sqlite3
import subprocess
import sys
import textwrap

import numpy as np
import pandas as pd
import pytest
from full_disk import no_room_beyond

from foldlab.errors import InputError
from foldlab.labels.label import Label, design_key, labels_to_frame
from foldlab.labels.store import LabelStore
from foldlab.tables import read_table


def a_label(x=1.0, foldable=True, reason="because", **evidence):
    return Label({"x": x, "y": 2.0}, foldable, reason, evidence, "test", "1")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "s.db"


@pytest.fixture
def filled(path):
    with LabelStore(path) as store:
        store.add_many(a_label(x / 3, x % 2 == 0, "x" * 50, angle=x / 7) for x in range(500))
    return path


def test_key_is_exact_and_knows_no_order():
    assert design_key({"b": 0.1 + 0.2, "a": 1}) == '{"a": 1.0, "b": 0.30000000000000004}'
    assert design_key({"x": -0.0}) == design_key({"x": np.float32(0)})
    assert design_key({'q"': 1e-300}) == json.dumps({'q"': 1e-300})
    for bad in ({}, {"x": float("nan")}, {"x": np.inf}, {"x": "wide"}, {"x": None}):
        with pytest.raises(InputError, match="give"):
            design_key(bad)


def test_table_in_order_of_request_and_flat(path):
    with LabelStore(path) as store:
        store.register([design_key({"x": x, "y": 2.0}) for x in (3.0, 1.0, 2.0)])
        store.add(a_label(1.0, None, measures={"panel": 0.5}, modes=[1, 2], y=9))
        store.add(a_label(3.0, True, gap=None))
        frame = store.frame("test", "1")
    assert frame["x"].tolist() == [3.0, 1.0]
    assert frame["foldable"].dtype == "boolean"
    assert frame["foldable"].tolist() == [True, pd.NA]
    assert frame["evidence.y"].tolist()[1] == 9
    assert frame["measures.panel"][1] == 0.5
    assert json.loads(frame["modes"][1]) == [1, 2]
    assert frame["gap"].dtype == float
    assert list(labels_to_frame([])) == ["foldable", "reason", "source", "version"]


def test_an_answer_stays_and_an_unknown_is_replaced(path):
    with LabelStore(path) as store:
        assert store.add(a_label(1.0, None, "first")) == 1
        assert store.known("test", "1") == {design_key({"x": 1, "y": 2}): (None, "first")}
        assert store.add(a_label(1.0, False, "second")) == 1
        assert store.add(a_label(1.0, True, "third")) == 0
        assert store.frame()["reason"].tolist() == ["second"]
        assert store.known("test", "2") == {}
        (counts,) = store.meta()["labels"]
    assert (counts["labels"], counts["folds"], counts["not"], counts["unknown"]) == (1, 0, 1, 0)


def test_a_store_counts_each_verdict_by_itself(path):
    verdicts = [True, False, False, None, None, None]
    with LabelStore(path) as store:
        store.add_many(a_label(float(x), verdict) for x, verdict in enumerate(verdicts))
        (counts,) = store.meta()["labels"]
    assert (counts["labels"], counts["folds"], counts["not"], counts["unknown"]) == (6, 1, 2, 3)


def test_evidence_that_is_not_finite_makes_an_unknown(path):
    nan = {"deep": {"angle": np.float64("nan")}, "gaps": np.array([1.0, np.inf]), "odd": {1, 2}}
    with LabelStore(path) as store:
        store.add(a_label(1.0, True, "it folds", **nan, steps=np.int64(3)))
        frame = store.frame()
    (row,) = frame.to_dict("records")
    assert frame["foldable"].isna().all()
    for part in ("deep.angle is nan", "gaps[1] is inf", "odd is a set", "it folds"):
        assert part in row["reason"]
    assert row["steps"] == 3
    assert np.isnan(row["deep.angle"])
    assert json.loads(row["gaps"]) == [1.0, None]


@pytest.mark.parametrize(
    "bad",
    [
        Label({"x": 1.0}, True, "", {}, "", "1"),
        Label({"x": np.nan}, True, "", {}, "test", "1"),
        Label({"x": 1.0}, 0.7, "", {}, "test", "1"),
    ],
)
def test_bad_labels_write_nothing(path, bad):
    with LabelStore(path) as store, pytest.raises(InputError):
        store.add_many([a_label(), bad])
    assert not path.exists()


def test_odd_text_survives(path):
    with LabelStore(path) as store:
        store.add(a_label(1.0, None, "file \udcff, 角, \0 end", note="\udcff"))
        assert "角" in store.frame()["reason"][0]


def test_reading_makes_nothing(tmp_path, path):
    with pytest.raises(InputError, match="no label store"):
        LabelStore(path, mode="read")
    with pytest.raises(InputError, match="mode"):
        LabelStore(path, mode="rw")
    with pytest.raises(InputError, match="no folder"):
        LabelStore(tmp_path / "none" / "s.db")
    with LabelStore(path) as store:
        assert store.known("test", "1") == {}
        assert store.meta() == {"labels": []}
        assert len(store.frame()) == 0
    assert list(tmp_path.iterdir()) == []


def test_one_writer_and_readers_beside_it(path):
    with LabelStore(path) as writer:
        writer.add(a_label(1.0))
        with pytest.raises(InputError, match=r"another process is writing .*s\.db"):
            LabelStore(path)
        with LabelStore(path, mode="read") as reader:
            writer.add(a_label(2.0))
            assert len(reader.frame()) == 2
            with pytest.raises(InputError, match="open for reading"):
                reader.add(a_label(3.0))
    with pytest.raises(InputError, match="closed"):
        writer.add(a_label(3.0))
    with LabelStore(path) as store:
        store.add(a_label(3.0))


@pytest.mark.parametrize("mode", ["read", "write"])
def test_a_store_that_was_closed_answers_nothing_rather_than_that_it_is_empty(filled, mode):
    with LabelStore(filled, mode=mode) as store:
        assert len(store.known("test", "1")) == 500
    asked = (
        store.frame,
        store.meta,
        lambda: store.known("test", "1"),
        lambda: store.export(filled.with_name("t.csv")),
    )
    for ask in asked:
        with pytest.raises(InputError, match=r"s\.db is closed; open it again"):
            ask()
    assert not filled.with_name("t.csv").exists()
    store.close()  # once more harms nothing


def killed(code, *arguments):
    process = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)], timeout=60
    )
    assert process.returncode == -signal.SIGKILL


def test_a_killed_writer_frees_the_lock_and_loses_only_its_open_transaction(filled):
    with LabelStore(filled, mode="read") as store:
        before = store.frame()
    killed(
        """
        import os, signal, sys
        from foldlab.labels.store import LabelStore
        store = LabelStore(sys.argv[1])
        store._db.execute("PRAGMA cache_size = 1")  # pages reach the file before the commit
        store._db.execute("UPDATE label SET reason = 'half written'")
        os.kill(os.getpid(), signal.SIGKILL)
        """,
        filled,
    )
    assert b"half written" in filled.read_bytes()
    with LabelStore(filled, mode="read") as store:
        pd.testing.assert_frame_equal(store.frame(), before)
    with LabelStore(filled) as store:
        store.add(a_label(-1.0))


def truncated(data):
    return data[: len(data) // 2]


def truncated_by_a_page(data):
    return data[:-4096]


def garbage_header(data):
    return b"\x13" * 100 + data[100:]


def flipped_page(data):
    middle = len(data) // 2 // 4096 * 4096
    return data[:middle] + bytes(b ^ 0xFF for b in data[middle : middle + 64]) + data[middle + 64 :]


def flipped_text(data):
    return data.replace(b"x" * 50, b"x" * 49 + b"y", 1)


def flipped_verdict(data):
    return data.replace(b"angle", b"anglf", 1)


def index_name_no_text(data):
    # SQLite's verdict holds these bytes, so that reading it fails in Python.
    return data.replace(b"sqlite_autoindex_design_1", b"sqlite_autoindex_desig\xb4_1", 1)


def empty(data):
    return b""


def not_a_database(data):
    return b"E_ratio,h_ratio\n1,2\n" * 300


@pytest.mark.parametrize("mode", ["read", "write"])
@pytest.mark.parametrize(
    "damage",
    [
        truncated,
        truncated_by_a_page,
        garbage_header,
        flipped_page,
        flipped_text,
        flipped_verdict,
        index_name_no_text,
        empty,
        not_a_database,
    ],
    ids=lambda damage: damage.__name__,
)
def test_damage_is_one_clear_error(filled, damage, mode):
    data = damage(filled.read_bytes())
    filled.write_bytes(data)
    with pytest.raises(InputError, match=r"s\.db is damaged or no label store"):
        LabelStore(filled, mode=mode)
    assert filled.read_bytes() == data


def test_no_single_changed_byte_changes_a_table(filled):
    data = filled.read_bytes()
    with LabelStore(filled, mode="read") as store:
        before = store.frame()
    detected = 0
    for at in np.random.default_rng(5).integers(100, len(data), 60):
        filled.write_bytes(data[:at] + bytes([data[at] ^ 0x04]) + data[at + 1 :])
        try:
            with LabelStore(filled, mode="read") as store:
                pd.testing.assert_frame_equal(store.frame(), before)
        except InputError:
            detected += 1
    assert detected > 30


def test_a_label_without_its_design_is_damage(filled):
    with sqlite3.connect(filled) as db:
        db.execute("DELETE FROM design WHERE id = 1")
    db.close()
    with pytest.raises(InputError, match="the design of a label is missing"):
        LabelStore(filled, mode="read")


def test_a_store_leaves_no_lock_refused_or_closed(path):
    path.write_text("a table, perhaps")
    with pytest.raises(InputError, match="damaged or no label store"):
        LabelStore(path)
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    path.unlink()
    with LabelStore(path) as store:
        store.add(a_label())
        # Another's lock is left to it.
        with pytest.raises(InputError, match="another process is writing"):
            LabelStore(path)
        assert path.with_name(f"{path.name}.lock").exists()
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_other_databases_are_left_alone(path, filled):
    other = path.with_name("other.db")
    with sqlite3.connect(other) as db:
        db.execute("CREATE TABLE label (x)")
    db.close()
    data = other.read_bytes()
    for mode in ("read", "write"):
        with pytest.raises(InputError, match="not a label store of foldlab"):
            LabelStore(other, mode=mode)
    assert other.read_bytes() == data
    with sqlite3.connect(filled) as db:
        db.execute("PRAGMA user_version = 99")
    db.close()
    with pytest.raises(InputError, match="format 99"):
        LabelStore(filled, mode="read")
    with pytest.raises(InputError, match="no file"):
        LabelStore(path.parent, mode="read")


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_export_round_trip(path, suffix):
    out = path.with_suffix(suffix)
    with LabelStore(path) as store:
        for x, foldable in ((0.1 + 0.2, True), (1e-17 / 3, False), (np.pi, None)):
            store.add(a_label(x, foldable, 'said "no, never"', angle=x / 3, steps=3))
        assert store.export(out) == 3
        frame = store.frame()
    # A CSV file has no types: "1" comes back as a number.
    back = read_table(out).astype({"foldable": "boolean", "version": "str"})
    pd.testing.assert_frame_equal(back, frame)
    how = (
        back.attrs["foldlab"]
        if suffix == ".parquet"
        else json.loads((path.parent / "s.csv.json").read_text())
    )
    assert how["labels"] == 3
    assert how["foldlab"]
    assert how["sources"] == [{"source": "test", "version": "1", "labels": 3}]


@pytest.mark.parametrize("room", [30_000, 60_000])
def test_a_store_that_finds_no_room_for_its_first_labels_is_not_left(path, tmp_path, room):
    labels = [a_label(float(k), True, "r" * 2000) for k in range(40)]
    with LabelStore(path) as store:
        with no_room_beyond(room), pytest.raises(InputError, match="running again"):
            store.add_many(labels)
        assert not path.exists()
        assert store.add_many(labels) == 40
        with no_room_beyond(30_000), pytest.raises(InputError, match="what was committed stays"):
            store.add_many(a_label(k + 0.5, True, "r" * 2000) for k in range(40))
        assert len(store.frame()) == 40
    assert [p.name for p in tmp_path.iterdir()] == ["s.db"]


def test_a_table_is_not_left_without_what_says_how_it_was_made(path, tmp_path):
    """On a disk with room for the table alone it was: here a folder is in the other's place."""
    (tmp_path / "l.csv.json").mkdir()
    with LabelStore(path) as store:
        store.add(a_label())
        with pytest.raises(InputError, match=r"l\.csv\.json is a folder"):
            store.export(tmp_path / "l.csv")
    assert {p.name for p in tmp_path.iterdir()} == {"s.db", "l.csv.json"}


def test_export_refuses_clearly(path, tmp_path):
    with LabelStore(path) as store:
        store.register([design_key({"x": 1.0})])
        with pytest.raises(InputError, match="no labels yet"):
            store.export(tmp_path / "l.csv")
        store.add(a_label())
        for out in (tmp_path / "l.xls", tmp_path / "none" / "l.csv"):
            with pytest.raises(InputError, match=r"ending|no folder"):
                store.export(out)
        with pytest.raises(InputError, match="it has: test 1"):
            store.export(tmp_path / "l.csv", source="tset")
    assert {p.name for p in tmp_path.iterdir()} == {"s.db"}
