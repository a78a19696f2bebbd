"""What is done to a file so that it is certainly wrong, or damaged where damage can be seen.

A function takes a random generator and a path, changes the file, and says what it did. Digits that
become other digits are no damage that anybody could see, and are not made, but where a format has
checksums.
"""

from __future__ import annotations

import csv
import io
import json
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd

FOREIGN = {
    "empty": b"",
    "blank": b" \n\n",
    "a picture": b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 4,
    "JSON": b'{"op": 1, "E_ratio": [1, 2]}\n',
    "prose": "Sehr geehrte Damen und Herren,\nanbei die Größen.\n".encode("latin-1"),
    "zeros": bytes(4096),
    "a web page": b"<!DOCTYPE html><html><body>404</body></html>\n",
    "a header": b"E_ratio,h_ratio,slenderness\n",
}
# Where these are empty they are to be made, as where they are missing.
MADE = ("mlflow.db", "study.journal")
NO_NUMBER = ("much", "--", "1.2.3", "0x1f", "1e", "[1]", "1/2", "\x00", "None?", "#REF!")
NO_DESIGN = ("", "nan", "inf", "-inf", "-1", "0", "1e99", "-1e-3", *NO_NUMBER)


def pick(rng, choices):
    """One of them; NumPy's own choice would take zeros off the end of a text."""
    return list(choices)[int(rng.integers(len(choices)))]


def foreign(rng, path: Path) -> str:
    what = pick(rng, [name for name in FOREIGN if name != "empty" or path.name not in MADE])
    path.write_bytes(FOREIGN[what])
    return f"is {what}"


def cut(rng, path: Path) -> str:
    """Anywhere but behind its last hundredth, which some formats do without."""
    data = path.read_bytes()
    at = int(rng.uniform(0, 0.99) * len(data))
    path.write_bytes(data[:at])
    return f"cut at byte {at} of {len(data)}"


def flipped(rng, path: Path) -> str:
    data = bytearray(path.read_bytes())
    at = rng.integers(len(data), size=rng.integers(1, 6))
    for k in at:
        data[k] ^= int(rng.integers(1, 256))
    path.write_bytes(bytes(data))
    return f"flipped at bytes {', '.join(map(str, at))}"


def missing(rng, path: Path) -> str:
    path.unlink()
    return "is missing"


def folder(rng, path: Path) -> str:
    path.unlink()
    path.mkdir()
    return "is a folder"


def strange_bytes(rng, path: Path) -> str:
    data = path.read_bytes()
    at = int(rng.integers(len(data)))
    more = bytes(rng.integers(0x80, 0x100, size=3, dtype=np.uint8)) + b"\xff"
    path.write_bytes(data[:at] + more + data[at:])
    return f"strange bytes at {at}"


ANY = (foreign, missing, folder)


def table_damage(columns: Sequence[str], bad: Sequence[str] = NO_DESIGN):
    """Damage to a CSV or Parquet table whose ``columns`` must be numbers, none of them ``bad``."""

    def cell(rng, path):
        rows = _rows(path)
        row, name = int(rng.integers(1, len(rows))), pick(rng, columns)
        rows[row][rows[0].index(name)] = value = pick(rng, bad)
        _write(path, rows)
        return f"{name} = {value!r} in row {row - 1}"

    def column(rng, path):
        rows, name = _rows(path), pick(rng, columns)
        at = rows[0].index(name)
        how = pick(rng, ["renamed", "dropped", "twice"])
        for k, row in enumerate(rows):
            if how == "dropped":
                del row[at]
            elif how == "twice":
                row.append(row[at])
            elif k == 0:
                row[at] = f"{name}_{rng.integers(10)}"
        _write(path, rows)
        return f"column {name} {how}"

    def row(rng, path):
        rows, last = _rows(path), max(_rows(path)[0].index(name) for name in columns)
        k = int(rng.integers(1, len(rows)))
        if rng.integers(2):
            rows[k] += ["7"] * int(rng.integers(1, 4))
        else:
            del rows[k][int(rng.integers(1, last + 1)) :]
        _write(path, rows)
        return f"row {k - 1} has {len(rows[k])} cells of {len(rows[0])}"

    def quote(rng, path):
        rows, name = _rows(path), pick(rng, columns)
        k = int(rng.integers(1, len(rows)))
        text = io.StringIO()
        csv.writer(text).writerows(rows[:k])
        at = rows[0].index(name)
        line = ",".join([*rows[k][:at], '"' + rows[k][at], *rows[k][at + 1 :]])
        rest = io.StringIO()
        csv.writer(rest).writerows(rows[k + 1 :])
        path.write_text(text.getvalue() + line + "\n" + rest.getvalue(), newline="")
        return f"a quote that never ends in row {k - 1}"

    return cell, column, row, quote


def _rows(path: Path) -> list[list[str]]:
    with path.open(newline="") as file:
        return list(csv.reader(file))


def _write(path: Path, rows) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file).writerows(rows)


def parquet_damage(columns: Sequence[str]):
    def values(rng, path):
        frame, name = pd.read_parquet(path), pick(rng, columns)
        k = int(rng.integers(len(frame)))
        how = {
            "words": lambda c: c.astype(str) + " m",
            "lists": lambda c: pd.Series([[v] for v in c]),
            "dates": lambda c: pd.to_datetime(c, unit="s"),
            "bytes": lambda c: pd.Series([bytes([1, 2])] * len(c)),
            "nan": lambda c: c.where(c.index != k),
            "out of bounds": lambda c: c.where(c.index != k, 1e9),
            "below 0": lambda c: -c,
            "complex": lambda c: pd.Series([{"re": v, "im": 1.0} for v in c]),
            "truths": lambda c: c > c.median(),
        }
        what = pick(rng, how)
        frame[name] = how[what](frame[name])
        frame.to_parquet(path, index=False)
        return f"{name}: {what}"

    def column(rng, path):
        frame, name = pd.read_parquet(path), pick(rng, columns)
        if rng.integers(2):
            frame.drop(columns=name).to_parquet(path, index=False)
            return f"without {name}"
        frame.head(0).to_parquet(path, index=False)
        return "without rows"

    def as_text(rng, path):
        pd.read_parquet(path).to_csv(path, index=False)
        return "is a CSV"

    return values, column, as_text


def store_changed(rng, path: Path) -> str:
    """A store that was written by another hand: the checksums no longer hold."""
    changes = (
        "UPDATE label SET foldable = 1 - foldable WHERE design = 3",
        "UPDATE label SET evidence = '{' WHERE design = 2",
        "UPDATE label SET checksum = 'x'",
        "UPDATE label SET reason = reason || '!' WHERE design = 1",
        "DELETE FROM design WHERE id = 4",
        "DROP TABLE label",
        "DROP TABLE design",
        "ALTER TABLE label RENAME COLUMN evidence TO facts",
        "PRAGMA application_id = 7",
        "PRAGMA user_version = 99",
        "UPDATE design SET key = 'x' WHERE id = 5",
    )
    change = pick(rng, changes)
    with closing(sqlite3.connect(path)) as db:
        db.execute("PRAGMA foreign_keys = 0")
        db.execute(change)
        db.commit()
    return change


def card_changed(rng, path: Path) -> str:
    """``model.json`` with an entry that is missing, or of a kind that it can't have."""
    card = json.loads(path.read_text())
    name = pick(rng, ["format", "kind", "threshold", "state", "files", "metadata", "space"])
    wrong: list = ["?", 99, [], {"a": 1}, True, None, -1.5, "nan"]
    if name == "threshold":
        wrong.remove(None)
    if name in ("metadata", "files"):
        wrong.remove({"a": 1})
    if name != "space" and rng.integers(3) == 0:
        del card[name]
        what = f"without {name}"
    else:
        card[name] = wrong[int(rng.integers(len(wrong)))]
        what = f"{name} = {card[name]!r}"
    path.write_text(json.dumps(card))
    return what


def journal_changed(rng, path: Path) -> str:
    """A line within a journal that is no operation of Optuna's, or not one that can follow."""
    lines = path.read_bytes().splitlines(keepends=True)
    k = int(rng.integers(len(lines) - 1))
    new = (b"garbage", b'{"op_code": 99}', b"[]", b'{"op_code":', b"\x00\xff", b"7")
    lines[k] = pick(rng, new) + b"\n"
    path.write_bytes(b"".join(lines))
    return f"line {k} is {lines[k]!r}"


def toml_changed(rng, path: Path) -> str:
    texts = ("epochs = ", "epochs 12", "[", "epochs = 12\nepochs = 13", "epochs: 12", "= 3",
             "nothing = 3", 'epochs = "many"', "epochs = [1]", "[epochs]\na = 1", "[table]\nx = 1",
             '{"epochs": 12}', "epochs = nan", "epochs = -3", "epochs = 1e400")  # fmt: skip
    text = pick(rng, texts)
    path.write_text(text)
    return repr(text)


def mesh_changed(rng, path: Path) -> str:
    old, new = (
        ("2 4 3 5 6 8 7\n", "2 4 3 5 6 8 99\n"), ("2 4 3 5 6 8 7\n", "2 4 3 5 6 8\n"),
        ("\n1 5 2", "\n1 77 2"), ("\n1 5 2", "\n1 3 2"), ("$Nodes\n12", "$Nodes\n13"),
        ("$Nodes\n12", "$Nodes\n7"), ("$Elements\n2", "$Elements\n9"), ("$Nodes", "$Nodez"),
        ("2.2 0 8", "9.9 0 8"), ("2.2 0 8", "2.2 1 8"), ("\n1 0 0 0\n", "\n1 0 nan 0\n"),
        ("\n1 0 0 0\n", "\n1 0 much 0\n"), ("\n1 0 0 0\n", "\n1 inf 0 0\n"),
        ("1 5 2 1 1 1 2 4 3 5 6 8 7", "1 5 2 1 1 1 1 1 1 5 6 8 7"),
        ("\n8 1 1 1\n", "\n8 -5 -5 1\n"),
    )[int(rng.integers(15))]  # fmt: skip
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return f"{old!r} is {new!r}"


def vtu_changed(rng, path: Path) -> str:
    old, new = (
        (b'"beta"', b'"zeta"'), (b"UnstructuredGrid", b"PolyData"),
        (b"<Points>", b"<Pints>"), (b'type="Float64"', b'type="Words"'),
        (b'NumberOfComponents="3"', b'NumberOfComponents="2"'),
        (b"NumberOfPoints=\"27\"", b"NumberOfPoints=\"999\""), (b"<Piece", b"<Piece <"),
        (b"NumberOfPoints=\"27\"", b"NumberOfPoints=\"-4\""), (b"</Piece>", b""),
        (b"PointData", b"CellData"), (b'format="', b'format="x'), (b"27", b"26"),
    )[int(rng.integers(12))]  # fmt: skip
    path.write_bytes(path.read_bytes().replace(old, new))
    return f"{old!r} is {new!r}"
