"""The experiments from a wheel and from the sources, and a package 'solver' that is not ours."""

import ast
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import foldlab
from foldlab import packaged
from foldlab.cli import label_verbs
from foldlab.errors import InputError
from foldlab.terminal import Given

ROOT = Path(__file__).parents[2]


def ran(*arguments, cwd):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, *arguments], cwd=cwd, env=environment, text=True,
                          capture_output=True, timeout=120)  # fmt: skip


@pytest.fixture
def wheel(tmp_path, monkeypatch):
    """foldlab with the experiments inside, as setup.py packs them."""
    here = tmp_path / "foldlab"
    shutil.copytree(ROOT / "experiments", here / "_experiments")
    monkeypatch.setattr(packaged, "HERE", here)
    monkeypatch.setattr(foldlab, "__path__", [*foldlab.__path__, str(here)])
    before = set(sys.modules)
    yield here
    for name in set(sys.modules) - before:
        if name.startswith("foldlab._experiments"):
            del sys.modules[name]


def test_experiments_are_listed_with_their_question_in_a_line():
    known = packaged.experiments()
    files = {path.stem for path in (ROOT / "experiments").glob("*.py")}
    assert set(known) == {name for name in files if name[0] != "_"} - {"common"}
    assert known["problem_p"].startswith("Which element gives Problem P's fold angle")
    assert all(q and "\n" not in q for q in known.values())


def test_an_experiment_is_loaded_from_the_sources_and_from_a_wheel(wheel, monkeypatch):
    module, shared = packaged.experiment("problem_p")
    assert module.__name__ == "foldlab._experiments.problem_p"
    assert Path(module.__file__) == wheel / "_experiments" / "problem_p.py"
    assert shared.__name__ == "foldlab._experiments.common"
    monkeypatch.setattr(packaged, "HERE", ROOT / "foldlab")
    assert packaged.experiment("problem_p")[0].__name__ == "experiments.problem_p"


def test_the_verb_runs_what_python_m_runs(monkeypatch, capsys, tmp_path):
    from experiments import common, problem_p

    asked = []
    monkeypatch.setattr(common, "execute", lambda *given: asked.append(given) or {"table": []})
    label_verbs.experiment(
        name="problem_p", tiny=True, given=Given(settings=["seed=7"]), as_json=True
    )
    ((name, run, config),) = asked
    assert (name, run) == ("problem_p", problem_p.run)
    assert config.seed == 7 and config.elements == problem_p.TINY.elements
    assert json.loads(capsys.readouterr().out) == {"table": []}
    label_verbs.experiment(given=Given(), as_json=True)
    assert len(json.loads(capsys.readouterr().out)["experiments"]) > 20


@pytest.mark.parametrize(
    "name", ["common", "_lung", "_solver_methods", "__init__", "nothing", "../setup"]
)
def test_what_is_no_experiment_is_refused(name):
    with pytest.raises(InputError, match=r"no experiment .*; there are: accuracy_calibration"):
        packaged.experiment(name)
    with pytest.raises(InputError, match="name the experiment"):
        label_verbs.experiment(tiny=True, given=Given())


def test_experiments_name_each_other_relative_to_their_folder():
    # Else they would not find each other in a wheel, where the folder is foldlab/_experiments.
    for path in (ROOT / "experiments").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in getattr(node, "names", ())]
            if isinstance(node, ast.ImportFrom):
                names = [] if node.level else [node.module]
            if isinstance(node, ast.Import | ast.ImportFrom):
                assert not [n for n in names if n.split(".")[0] == "experiments"], path


def test_the_wheel_holds_every_package():
    code = (
        "import json, runpy, setuptools\n"
        "setuptools.setup = lambda **given: print(json.dumps(given))\n"
        "runpy.run_path('setup.py')"
    )
    done = ran("-c", code, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    given = json.loads(done.stdout)
    assert given["package_dir"] == {"foldlab._experiments": "experiments"}
    here = {
        path.parent.relative_to(ROOT).as_posix().replace("/", ".")
        for top in ("foldlab", "solver", "experiments")
        for path in (ROOT / top).rglob("__init__.py")
    }
    dotted = {("foldlab._" if n.startswith("experiments") else "") + n for n in here}
    assert set(given["packages"]) == dotted


@pytest.mark.parametrize("kind", ["file", "folder", "bare folder"])
def test_a_solver_that_is_not_ours_is_one_clear_error(kind, tmp_path):
    other = tmp_path / "solver.py"
    if kind == "file":
        other.write_text("raise RuntimeError('a stranger ran')\n")
    else:
        other = tmp_path / "solver"
        other.mkdir()
        if kind == "folder":
            (other / "__init__.py").write_text("raise RuntimeError('a stranger ran')\n")
    done = ran("-m", "foldlab.cli.app", "export", "none.db", "-o", "a.csv", cwd=tmp_path)
    if kind == "bare folder":  # Python prefers ours, which has an __init__.py
        assert "solver" not in done.stderr
        return
    assert done.returncode == 2 and done.stdout == "", done.stderr
    said = f"error: Python finds {other} as 'solver', and foldlab needs its own, {ROOT / 'solver'}"
    assert done.stderr.startswith(said) and len(done.stderr.splitlines()) == 1


def test_a_module_solver_that_was_imported_before_is_told_too(monkeypatch):
    packaged.check_solver()
    monkeypatch.setitem(sys.modules, "solver", type(sys)("solver"))
    with pytest.raises(InputError, match="finds no package as 'solver'"):
        packaged.check_solver()
