"""Every command and every block of Python in the README does what it says there.

They run as they stand but for their size: fewer designs, cycles and trials; ``make demo`` and
``make test`` by whoever runs them.
"""

import re
from pathlib import Path

import pytest
import written

from foldlab.cli import app as cli
from foldlab.design import FULL
from foldlab.materials import read_materials
from foldlab.unit.sized import sized

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
# What makes a command or block quicker, and leaves it the same otherwise.
SMALLER = {
    "-n 2000": "-n 300",
    "foldlab train l.parquet": "foldlab train l.parquet --set epochs=300",
    "foldlab design --set": "foldlab design --model m --set",
    "--want angle=90deg -n 3": "--want angle=90deg -n 1 --no-confirm",
    "foldlab augment -o a": "foldlab augment -o a --set cycles=1 --set epochs=50 --set initial=60",
    "foldlab tune l.parquet": "foldlab tune l.parquet --trials 2 --set epochs=[20,40]",
    "foldlab check": "foldlab check --no-pictures --accuracy 0.2",
    "foldlab explore": "foldlab explore --no-browser --seconds 1",
    "foldlab simulate": "foldlab simulate --no-pictures --accuracy 0.2",
    "-o w.png --verify 40": "-o w.png --verify 1 --points 500",
    "sample(6000": "sample(300",
    "100_000": "2000",
}


def blocks(language: str) -> list[str]:
    found = [text for kind, _, text in written.blocks(README) if kind == language]
    assert len(found) >= 3
    return found


def smaller(text: str) -> str:
    for old, new in SMALLER.items():
        text = text.replace(old, new)
    return text


def test_nothing_is_made_smaller_that_the_readme_does_not_have():
    for old in SMALLER:
        assert old in README, f"the README no longer has {old!r}"


def test_commands_run_in_their_order(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    verbs = set()
    for block in blocks("sh"):
        for line in block.replace("\\\n", " ").splitlines():
            verbs |= set(written.run_command(smaller(line), monkeypatch, capsys)[1:2])
    assert verbs >= {"check", "simulate", "sample", "label", "train", "map", "design", "tune"}
    assert "predict" in verbs
    assert {"d.parquet", "s.db", "l.parquet", "m", "map.png", "a", "t"} <= {
        p.name for p in tmp_path.iterdir()
    }


@pytest.mark.parametrize("block", blocks("python"))
def test_python_runs(block, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile(smaller(block), "README.md", "exec"), {})
    printed = capsys.readouterr().out
    if "path.reason" in block:
        assert "the path reached its target" in printed


def test_inline_commands_name_experiments_and_verbs_that_there_are():
    experiments = {p.stem for p in (Path(__file__).parent.parent / "experiments").glob("*.py")}
    named = set(re.findall(r"python -m experiments\.(\w+)", README))
    assert named and named - {"NAME"} <= experiments
    known = set(cli.VERBS)
    named = set(re.findall(r"`foldlab (\w+)", README))
    assert named and named <= known


def test_the_table_of_groups_is_that_of_the_design_space():
    rows = [line.split(" | ") for line in README.splitlines() if re.match(r"\| `\w+` \| ", line)]
    told = {row[0].strip("| `"): row[1:] for row in rows}
    made = sized(
        {
            "l_s": 0.04, "b_s": 0.01, "h_s": 1e-4, "h_i": 2e-4, "l_i": 0.01, "contraction": 0.2,
        },
        read_materials(), "PET", "SMP",
    )  # fmt: skip
    for group in FULL:
        symbol, meaning, bounds, example = told[group.name]
        assert symbol.replace("\\", "") == group.symbol and meaning == group.meaning
        assert bounds == f"{group.low:g} to {group.high:g}"
        value = float(example.strip(" |").rsplit("= ", 1)[-1])
        assert value == pytest.approx(made.groups[group.name], rel=0.02), group.name
