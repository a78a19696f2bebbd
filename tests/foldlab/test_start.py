"""What ``import foldlab`` and ``foldlab --help`` load, and what they don't."""

import inspect
import json
import subprocess
import sys

import pytest

import foldlab
from foldlab.cli import app

# What takes a tenth of a second or more to import.
HEAVY = {
    "numpy", "pandas", "scipy", "torch", "mlflow", "vtkmodules", "pyvista", "sklearn", "matplotlib",
    "numba", "pydantic", "sympy", "solver",
}  # fmt: skip


def loaded(code: str, *arguments: str) -> tuple[set[str], str]:
    """Top-level modules that a process of its own has loaded at its end, and what it printed."""
    code += "\nimport json, sys; print('\\n' + json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    printed, _, modules = done.stdout.rstrip().rpartition("\n")
    return {name.partition(".")[0] for name in json.loads(modules)}, printed


def test_the_import_loads_nothing_heavy_and_each_name_is_there():
    modules, _ = loaded("import foldlab; foldlab.__version__")
    assert "foldlab" in modules and not modules & HEAVY
    assert "numpy" in loaded("import foldlab; foldlab.FULL")[0]
    for name in foldlab.__all__:
        assert getattr(foldlab, name) is not None and name in dir(foldlab)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = foldlab.nothing


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], [], ["--version"]])
def test_the_help_of_the_command_line_loads_nothing_heavy(arguments):
    code = (
        "from foldlab.cli import main\ntry: main()\nexcept SystemExit as end: assert not end.code"
    )
    modules, printed = loaded(code, *arguments)
    # Typer checks what was given by pydantic, where it was not asked for help.
    assert not modules & HEAVY - (set() if arguments[:1] in (["-h"], ["--help"]) else {"pydantic"})
    assert "0.1.0" in printed if arguments == ["--version"] else "quickstart" in printed


def test_the_help_has_verbs_for_a_unit_before_those_for_a_study(capsys):
    with pytest.raises(SystemExit):
        app.app(["--help"])
    told = capsys.readouterr().out
    assert told.index("For a unit") < told.index(" check ") < told.index("For a study of many")
    assert told.index("For a study of many") < told.index(" sample ")


@pytest.mark.parametrize("verb", app.VERBS)
def test_a_verb_is_listed_with_the_beginning_of_its_help(verb):
    _, sentence = app.VERBS[verb]
    assert " ".join(inspect.getdoc(app.function_of(verb)).split()).startswith(sentence)
