"""Settings and tables: what users type and what files hold."""

import os
from dataclasses import dataclass

import pandas as pd
import pytest

from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.settings import build, call, changed, read_settings
from foldlab.tables import read_table, write_table


@dataclass(frozen=True)
class Sizes:
    width: int = 3
    rate: float = 0.1
    name: str = "a"

    def __post_init__(self):
        if self.width < 1:
            raise InputError(f"width = {self.width}; expected at least 1")


def test_pairs_win_over_the_file(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text("width = 5\nrate = 0.5\n")
    assert read_settings(["rate=1e-3", "name=b c"], path) == {
        "width": 5,
        "rate": 1e-3,
        "name": "b c",
    }


def test_values_keep_their_types():
    got = read_settings(["a=1", "b=.5", "c=true", "d=[1, 2]", "e=text", "f=1e3"])
    assert got == {"a": 1, "b": 0.5, "c": True, "d": [1, 2], "e": "text", "f": 1000.0}
    assert isinstance(got["a"], int)


@pytest.mark.parametrize("pair", ["width", "=3"])
def test_a_pair_needs_a_name_and_a_value(pair):
    with pytest.raises(InputError, match="expected name=value"):
        read_settings([pair])


def test_bad_files_are_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml"):
        read_settings([], tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("width : 3")
    with pytest.raises(InputError, match="is not TOML"):
        read_settings([], tmp_path / "bad.toml")


def test_build_checks_names_types_and_the_class_itself():
    assert build(Sizes, {"width": 4}, rate=1.0) == Sizes(4, 1.0)
    with pytest.raises(InputError, match="no setting 'wdith'; there are: name, rate, width"):
        build(Sizes, {"wdith": 4})
    with pytest.raises(InputError, match="no setting 'rate'; there are: name, width"):
        build(Sizes, {"rate": 2.0}, rate=1.0)  # it was passed over without a word
    with pytest.raises(InputError, match="width = 'x'"):
        build(Sizes, {"width": "x"})
    with pytest.raises(InputError, match=r"width = 0; expected at least 1"):
        build(Sizes, {"width": 0})


class Box:
    def __init__(self, sizes: Sizes = Sizes(2), depth: float = 1.0, space=None):
        self.sizes, self.depth, self.space = sizes, depth, space


def test_settings_go_flat_into_the_records_of_a_constructor():
    made = call(Box, {"rate": 1, "depth": 2}, what="a box", space="s")
    assert (made.sizes, made.depth, made.space) == (Sizes(rate=1.0), 2.0, "s")
    assert isinstance(made.sizes.rate, float)
    # Of a record that nothing is said of, the constructor's own default holds.
    assert call(Box, {}, what="a box").sizes == Sizes(2)
    with pytest.raises(InputError, match="a box has no setting 'sizes'; it has: width, rate, name"):
        call(Box, {"sizes": 1}, what="a box")
    with pytest.raises(InputError, match="width = 'x'"):
        call(Box, {"width": "x"}, what="a box")
    with pytest.raises(InputError, match="width = 0; expected at least 1"):
        call(Box, {"width": 0}, what="a box")


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_tables_come_back_to_the_last_digit(tmp_path, suffix):
    designs = REDUCED.sample(500, seed=0)
    path = write_table(designs, tmp_path / f"d.{suffix}")
    pd.testing.assert_frame_equal(read_table(path), designs, check_exact=True)


def test_bad_tables(tmp_path):
    with pytest.raises(InputError, match="no file"):
        read_table(tmp_path / "none.parquet")
    with pytest.raises(InputError, match="tables end in"):
        read_table(tmp_path / "d.xlsx")
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(InputError, match="can't be read as csv"):
        read_table(tmp_path / "empty.csv")
    (tmp_path / "header.csv").write_text("a,b\n")
    with pytest.raises(InputError, match="has no rows"):
        read_table(tmp_path / "header.csv")
    (tmp_path / "d.parquet").write_bytes(b"PAR1 nonsense")
    with pytest.raises(InputError, match="can't be read as parquet"):
        read_table(tmp_path / "d.parquet")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = write_table(pd.DataFrame({"a": [1]}), tmp_path / "d.parquet")
    with pytest.raises(Exception, match="Refuses"):
        write_table(pd.DataFrame({"a": [Refuses()]}), path)
    assert read_table(path)["a"].tolist() == [1]
    assert os.listdir(tmp_path) == ["d.parquet"]
    with pytest.raises(InputError, match="no folder"):
        write_table(pd.DataFrame({"a": [1]}), tmp_path / "missing" / "d.csv")


class Refuses:
    def __arrow_array__(self, type=None):
        raise TypeError("oops")

    def __repr__(self):
        raise TypeError("oops")

    __str__ = __repr__


def test_a_version_tells_the_settings_that_are_not_the_defaults():
    @dataclass(frozen=True)
    class Effort:
        accuracy: float = 0.02
        need: float | None = None

    assert changed(Effort()) == []
    assert changed(Effort(0.05, 1.5)) == ["accuracy0.05", "need1.5"]
