"""What works, and what is said, where only the packages of a bare installation are there."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest

from foldlab import packaged
from foldlab.design import FULL, REDUCED
from foldlab.errors import InputError
from foldlab.labels.timoshenko import TimoshenkoSource

ROOT = Path(__file__).parents[2]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
# A process in which no library of an extra can be imported; it prints how each command ended.
BARE = """
import contextlib, io, json, sys
from foldlab import packaged
finders = sys.meta_path[:]
class Bare:
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] not in packaged.EXTRAS:
            found = (finder.find_spec(name, path, target) for finder in finders)
            return next((spec for spec in found if spec is not None), None)
sys.meta_path[:] = [Bare]
from foldlab import terminal
from foldlab.cli import main
ends = []
for words in json.loads(sys.argv[1]):
    sys.argv = ["foldlab", *words.split()]
    said = terminal.err.file = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            main()
        except SystemExit as end:
            ends.append((end.code or 0, said.getvalue()))
assert not packaged.EXTRAS.keys() & sys.modules
print(json.dumps(ends))
"""


def bare(folder, *commands):
    """Exit status and messages of each command."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", BARE, json.dumps(commands)], cwd=folder, text=True,
                          env=environment, capture_output=True, timeout=240)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_each_library_stands_in_the_extra_that_is_named_for_it_and_in_no_bare_installation():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    always = {re.split(r"[\[<>=!~; ]", line)[0] for line in project["dependencies"]}
    named = {"vtkmodules": "pyvista", "distributed": "dask"}
    for library, extra in packaged.EXTRAS.items():
        package = named.get(library, library)
        assert any(line.startswith(package) for line in EXTRAS[extra]), library
        assert package not in always


def test_the_verbs_of_the_start_need_no_extra(tmp_path):
    ends = bare(
        tmp_path,
        "sample --space reduced -n 60 --seed 1 -o designs.parquet",
        "label designs.parquet -o labels.db",
        "export labels.db -o labels.parquet",
        "train labels.parquet --model tree -o model",
        "score model labels.parquet",
        "predict designs.parquet --model model -o predicted.csv",
        "map model -o map.png",
        "materials",
        "experiment",
    )
    assert [status for status, _ in ends] == [0] * 9, ends
    assert len(pd.read_csv(tmp_path / "predicted.csv")) == 60
    assert (tmp_path / "map.png").exists()


def test_a_unit_is_folded_and_drawn_without_vtk_and_mkl(tmp_path):
    design = {
        "E_ratio": 0.01, "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0,
        "h_ratio": 1.0, "stiffness_to_weight": 50.0, "aspect": 0.25, "slenderness": 0.02,
        "contraction": 0.03,
    }  # fmt: skip
    given = " ".join(f"--set {name}={value}" for name, value in design.items())
    ((status, said),) = bare(tmp_path, f"simulate {given} --accuracy 0.2 -o out --json")
    assert status == 0, said
    assert 'pip install "foldlab[view]"' in said and 'pip install "foldlab[fast]"' in said
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"result.json", "curves.npz", "shapes.png", "angle.png"} <= names
    assert "series" not in names


def test_a_verb_that_needs_more_names_the_extra_and_leaves_nothing(tmp_path):
    source = TimoshenkoSource()
    source.evaluate(REDUCED.sample(60, seed=0)).to_csv(tmp_path / "labels.csv", index=False)
    FULL.sample(3, seed=0).to_csv(tmp_path / "designs.csv", index=False)
    needs = {
        "train labels.csv --model network -o model": "torch",
        "train labels.csv --model symbolic -o model": "pyoperon",
        "tune labels.csv -o study": "optuna",
        "predict designs.csv -o predicted.csv": "torch",
        "experiment regime_maps --tiny": "mlflow",
        "label labels.csv -o labels.db --dask tcp://localhost:1": "distributed",
        "structure cube": "ipctk",
    }
    ends = bare(tmp_path, *needs)
    for (command, library), (status, said) in zip(needs.items(), ends, strict=True):
        extra = packaged.EXTRAS[library]
        says = f'needs {library}, which is not installed: pip install "foldlab[{extra}]"\n'
        assert status == 2 and said.startswith("error: ") and said.endswith(says), (command, said)
        assert len(said.splitlines()) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"labels.csv", "designs.csv"}


def test_from_python_it_is_an_input_error(monkeypatch):
    from foldlab.learning.models import make_classifier

    for name in [n for n in sys.modules if n.partition(".")[0] == "torch"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "foldlab.learning.network", raising=False)
    with pytest.raises(InputError, match=r"a network needs torch, .*foldlab\[learn\]"):
        make_classifier("network", REDUCED)


def test_other_missing_modules_are_not_taken_for_an_extra():
    assert packaged.missing(ModuleNotFoundError("x", name="solver.nothing")) is None
    assert packaged.missing(ImportError("no libGL", name="vtkmodules")) is None
    with pytest.raises(ModuleNotFoundError), packaged.needed_for("this"):
        import foldlab.nothing  # noqa: F401
