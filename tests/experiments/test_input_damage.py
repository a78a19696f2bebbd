"""Damage to files is done where it is said to be done, and only there."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from experiments._wrong_inputs import damage

HEAD = ["E_ratio", "h_ratio", "note", "slenderness"]
ROWS = [[f"{k}.5", f"{k}.25", f"row {k}, so", f"{k}e-3"] for k in range(1, 8)]
NUMBERS = ("E_ratio", "h_ratio", "slenderness")


def rngs(count=60):
    return (np.random.default_rng(seed) for seed in range(count))


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "t.csv"
    damage._write(path, [HEAD, *ROWS])
    return path


def again(table):
    damage._write(table, [HEAD, *ROWS])


def test_a_cell_is_wrong_where_it_is_said_to_be(table):
    cell, *_ = damage.table_damage(NUMBERS)
    seen = set()
    for rng in rngs():
        again(table)
        name, value, k = re.fullmatch(r"(\S+) = (.*) in row (\d+)", cell(rng, table)).groups()
        head, *rows = damage._rows(table)
        changed = [(i, j) for i, row in enumerate(rows) for j, v in enumerate(row)
                   if v != ROWS[i][j]]  # fmt: skip
        assert head == HEAD and changed == [(int(k), HEAD.index(name))]
        assert repr(rows[int(k)][HEAD.index(name)]) == value
        seen.add((name, int(k)))
    assert {name for name, _ in seen} == set(NUMBERS) and {k for _, k in seen} == set(range(7))


def test_a_column_is_renamed_dropped_or_twice_there(table):
    _, column, *_ = damage.table_damage(NUMBERS)
    seen = set()
    for rng in rngs():
        again(table)
        name, how = re.fullmatch(r"column (\S+) (\w+)", column(rng, table)).groups()
        rows, at = damage._rows(table), HEAD.index(name)
        for made, row in zip(rows[1:], ROWS, strict=True):
            rest = row[:at] + row[at + 1 :]
            assert made == {"dropped": rest, "twice": [*row, row[at]]}.get(how, row)
        assert ([*HEAD, name] == rows[0]) is (how == "twice")
        assert (name in rows[0]) is (how == "twice") and len(rows[0]) == len(rows[1])
        seen.add(how)
    assert seen == {"renamed", "dropped", "twice"}


def test_a_row_has_as_many_cells_as_it_is_said_to_have(table):
    _, _, row, quote = damage.table_damage(NUMBERS[:2])
    for rng in rngs():
        again(table)
        k, cells = map(int, re.match(r"row (\d+) has (\d+) cells of 4", row(rng, table)).groups())
        _, *rows = damage._rows(table)
        assert [len(r) for r in rows] == [cells if i == k else 4 for i in range(7)]
        # A number of those that have to be there is missing, or there is one too many.
        assert cells > 4 or cells < 2
        again(table)
        k = int(re.fullmatch(r"a quote that never ends in row (\d+)", quote(rng, table))[1])
        assert damage._rows(table)[: k + 1] == [HEAD, *ROWS][: k + 1]
        assert table.read_text().splitlines()[k + 1].count('"') % 2 == 1


def test_bytes_are_cut_flipped_and_put_in_where_they_are_said_to_be(tmp_path):
    path, whole = tmp_path / "f", bytes(range(256)) * 2
    for rng in rngs():
        path.write_bytes(whole)
        at = int(re.fullmatch(r"cut at byte (\d+) of 512", damage.cut(rng, path))[1])
        assert path.read_bytes() == whole[:at] and at < 507
        path.write_bytes(whole)
        told = {int(k) for k in re.findall(r"\d+", damage.flipped(rng, path))}
        changed = {k for k, (a, b) in enumerate(zip(path.read_bytes(), whole, strict=True))
                   if a != b}  # fmt: skip
        assert changed <= told and 0 < len(told) <= 5
        path.write_bytes(whole)
        at = int(re.fullmatch(r"strange bytes at (\d+)", damage.strange_bytes(rng, path))[1])
        made = path.read_bytes()
        assert made[:at] + made[at + 4 :] == whole and min(made[at : at + 4]) >= 0x80


def test_a_parquet_table_is_wrong_in_the_column_that_is_told(tmp_path):
    path = tmp_path / "t.parquet"
    frame = pd.DataFrame({"a": np.arange(1.0, 9.0), "b": np.arange(11.0, 19.0)})
    values, column, as_text = damage.parquet_damage(["a", "b"])
    seen = set()
    for rng in rngs():
        frame.to_parquet(path)
        name, how = values(rng, path).split(": ")
        made, other = pd.read_parquet(path), {"a": "b", "b": "a"}[name]
        pd.testing.assert_series_equal(made[other], frame[other])
        assert not made[name].equals(frame[name])
        if how in ("nan", "out of bounds"):
            wrong = made[name].isna() if how == "nan" else made[name] == 1e9
            assert wrong.sum() == 1 and (made[name] == frame[name]).sum() == 7
        seen.add(how)
        frame.to_parquet(path)
        told, made = column(rng, path), pd.read_parquet(path)
        assert list(made) == [n for n in ("a", "b") if told != f"without {n}"]
        assert len(made) == (0 if told == "without rows" else 8)
    assert len(seen) == 9
    assert as_text(None, path) == "is a CSV" and path.read_bytes()[:1] != b"P"


def test_a_card_lacks_what_it_is_said_to_lack(tmp_path):
    path = tmp_path / "model.json"
    names = ["format", "kind", "threshold", "state", "files", "metadata", "space"]
    card = dict.fromkeys(names, "right") | {"other": 1}
    for rng in rngs(600):
        path.write_text(json.dumps(card))
        told, made = damage.card_changed(rng, path), json.loads(path.read_text())
        if told.startswith("without "):
            name = told.removeprefix("without ")
            assert name != "space" and made == {k: v for k, v in card.items() if k != name}
            continue
        name, value = told.split(" = ", 1)
        assert repr(made[name]) == value and made[name] != "right"
        assert made | {name: "right"} == card
        # What those may be is not wrong.
        assert not (name == "threshold" and made[name] is None)
        assert not (name in ("metadata", "files") and made[name] == {"a": 1})
