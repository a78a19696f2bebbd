"""What every experiment's command line prints, writes and tracks."""

import json
import sys
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from matplotlib.figure import Figure

from experiments import common
from foldlab.errors import InputError


@dataclass(frozen=True)
class Config:
    seed: int = 0
    size: int = 3


TINY = Config(size=1)


@pytest.fixture
def tracked(tmp_path, monkeypatch):
    """Runs that were tracked: name, settings, seed, metrics."""
    monkeypatch.chdir(tmp_path)
    seen = []

    class Run:
        def metrics(self, values):
            seen[-1].append(values)

    @contextmanager
    def track(name, settings, *, seed):
        seen.append([name, settings, seed])
        yield Run()

    monkeypatch.setattr(common, "track", track)
    return seen


def run(config, tracker):
    if config.size < 0:
        raise InputError(f"size = {config.size}; expected 0 or more")
    table = [{"a": np.float64(config.size), "b": "x"}]
    return {"mean": np.float64(0.5), "none": None, "table": table}


def called(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["experiments/sizes.py", *arguments])
    common.main("How large?", run, Config, TINY)
    return capsys.readouterr()


def test_a_run_is_tracked_by_name_settings_and_seed_and_its_result_is_plain(tracked):
    result = common.execute("sizes", run, Config(seed=4, size=2))
    assert result == {"mean": 0.5, "none": None, "table": [{"a": 2.0, "b": "x"}]}
    assert type(result["mean"]) is float
    assert tracked == [["sizes", {"seed": 4, "size": 2}, 4, result]]


def test_json_is_one_object_and_a_table_is_printed_beside_its_numbers(tracked, monkeypatch, capsys):
    out = called(monkeypatch, capsys, "--json").out
    assert json.loads(out)["table"] == [{"a": 3.0, "b": "x"}] and len(out.splitlines()) == 1
    assert tracked[0][0] == "sizes"
    out = called(monkeypatch, capsys, "--tiny").out
    assert "0.5" in out and "x" in out and "table" not in out
    assert tracked[1][1] == {"seed": 0, "size": 1}


def test_settings_come_from_a_file_and_from_pairs_that_win(tracked, monkeypatch, capsys, tmp_path):
    (tmp_path / "c.toml").write_text("seed = 5\nsize = 6\n")
    called(monkeypatch, capsys, "--config", "c.toml", "--set", "size=7", "--json")
    assert tracked[0][1] == {"seed": 5, "size": 7} and tracked[0][2] == 5


def test_what_is_refused_is_one_sentence_with_status_2(tracked, monkeypatch, capsys):
    with pytest.raises(SystemExit) as ended:
        called(monkeypatch, capsys, "--set", "size=-1")
    told = capsys.readouterr()
    assert ended.value.code == 2 and told.out == ""
    assert told.err == "error: size = -1; expected 0 or more\n"


def test_figures_are_written_into_a_folder_of_their_own(tracked, tmp_path):
    path = common.save_figure(Figure(figsize=(2, 1)), "one")
    assert path.resolve() == tmp_path / "out" / "one.png"
    header = path.read_bytes()[:24]
    # 150 points per inch.
    assert header[:4] == b"\x89PNG" and int.from_bytes(header[16:20]) == 300
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["one.png"]
