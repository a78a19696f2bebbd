"""The notebooks of docs/notebooks run from first cell to last, in a kernel of their own."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parent.parent / "docs" / "notebooks").glob("*.ipynb"))
RUN = """
import sys
import nbclient, nbformat
book = nbformat.read(sys.argv[1], as_version=4)
nbclient.NotebookClient(book, timeout=120, resources={"metadata": {"path": "."}}).execute()
nbformat.write(book, sys.argv[2])
"""


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_something(path, tmp_path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") for cell in cells), "clear its outputs before it is kept"
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(path), "run.ipynb"],
        cwd=tmp_path, capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads((tmp_path / "run.ipynb").read_text(encoding="utf-8"))["cells"]
    shown = [kind for c in told for o in c.get("outputs", ()) for kind in o.get("data", ())]
    pictures = {"explore_and_map": 1, "simulate_and_look": 2, "invert_and_make": 0}[path.stem]
    assert shown.count("image/png") >= pictures, "a figure or shape is not shown"
    assert "text/html" in shown, "no table is shown"


def test_there_are_three():
    assert [path.stem for path in NOTEBOOKS] == [
        "explore_and_map", "invert_and_make", "simulate_and_look",
    ]  # fmt: skip
