"""The import arrow: experiments → foldlab → solver, and only foldlab/sources.py imports solver."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module.split(".")[0]


FORBIDDEN = {"solver": {"foldlab", "experiments"}, "foldlab": {"experiments"}}
FILES = [p for room in ("solver", "foldlab") for p in (ROOT / room).rglob("*.py")]


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_arrow(path):
    room = path.relative_to(ROOT).parts[0]
    found = set(imported(path))
    assert not found & FORBIDDEN[room]
    if room == "foldlab" and path.name != "sources.py":
        assert "solver" not in found


def test_the_arrow_test_sees_imports(tmp_path):
    probe = tmp_path / "probe.py"
    probe.write_text("import solver.body\ndef f():\n    from foldlab.design import FULL\n")
    assert set(imported(probe)) == {"solver", "foldlab"}
