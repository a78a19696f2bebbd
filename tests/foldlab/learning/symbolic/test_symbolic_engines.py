"""The engines of symbolic regression: their trees become ours, PySR's arguments fit PySR."""

import ast
import importlib.util
import subprocess
import sys
import textwrap
import time
from importlib import metadata
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.learning.symbolic import engines
from foldlab.learning.symbolic import formula as fm
from foldlab.learning.symbolic.engines import Constraints
from foldlab.learning.symbolic.formula import Formula

NAMES = tuple(REDUCED.names)


def test_operon_reads_its_own_trees():
    """The tree we rebuild from Operon's nodes has Operon's values (it computes in float32)."""
    import pyoperon as op

    X = REDUCED.sample(200, seed=4).to_numpy()
    y = np.ones(len(X))
    dataset = op.Dataset(np.asfortranarray(np.column_stack([X, y])))
    names = {v.Name: v.Hash for v in dataset.Variables}
    hashes = sorted(dataset.Variables, key=lambda v: v.Index)
    text = "((2.5 * X1) - (X2 / (0.5 + X3))) * log(X2 * 3.0)"
    tree = op.InfixParser.Parse(text, names)
    labels = {v.Hash: n for v, n in zip(hashes, NAMES, strict=False)}
    ours = engines.read_operon(tree.Nodes, labels)
    n, m, t = X.T
    np.testing.assert_allclose(
        Formula(ours, NAMES)(X), (2.5 * n - m / (0.5 + t)) * np.log(m * 3), rtol=1e-6
    )
    # Now with weights on the inputs, which Operon keeps inside the variable's node.
    weights = np.linspace(0.5, 2.0, len(tree.GetCoefficients()))
    tree.SetCoefficients(weights.astype(np.float32))
    ours = engines.read_operon(tree.Nodes, labels)
    assert len(fm.constants(ours)) == len(weights) == 7
    theirs = op.Evaluate(op.DispatchTable(), tree, dataset, op.Range(0, len(X)))
    np.testing.assert_allclose(Formula(ours, NAMES)(X), theirs, rtol=1e-4)


def pysr_source():
    spec = importlib.util.find_spec("pysr")
    assert spec is not None, "the dev extra installs pysr"
    return Path(spec.origin).with_name("sr.py").read_text()


def pysr_init():
    for node in ast.walk(ast.parse(pysr_source())):
        if isinstance(node, ast.ClassDef) and node.name == "PySRRegressor":
            return next(
                f for f in node.body if isinstance(f, ast.FunctionDef) and f.name == "__init__"
            )
    raise AssertionError("no PySRRegressor in the installed pysr")


def accepted(annotation, value):
    """Whether a value fits a type annotation, as far as PySR's own annotations go."""
    if isinstance(annotation, ast.BinOp):
        return accepted(annotation.left, value) or accepted(annotation.right, value)
    if isinstance(annotation, ast.Constant):
        return value is None
    if isinstance(annotation, ast.Name):
        kinds = {"int": int, "float": (int, float), "str": str, "bool": bool}
        if annotation.id == "bool" or not isinstance(value, bool):
            return annotation.id in kinds and isinstance(value, kinds[annotation.id])
        return False
    if isinstance(annotation, ast.Subscript):
        inner = annotation.slice
        items = inner.elts if isinstance(inner, ast.Tuple) else [inner]
        match annotation.value.id:
            case "Literal":
                return value in [ast.literal_eval(i) for i in items]
            case "list":
                return isinstance(value, list) and all(accepted(items[0], v) for v in value)
            case "dict":
                return isinstance(value, dict) and all(
                    accepted(items[0], k) and accepted(items[1], v) for k, v in value.items()
                )
    return False


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("log_target", [True, False])
@pytest.mark.parametrize("nesting", [(), (("log", "log"), ("log", "/"), ("/", "/"))])
def test_every_argument_fits_the_installed_pysr(threads, log_target, nesting):
    limits = Constraints(
        threads=threads, forbidden_nesting=nesting, max_size=25, max_depth=6, seed=4
    )
    given = engines.pysr_arguments(limits, log_target, 12.5)
    init = pysr_init().args
    known = {a.arg: a.annotation for a in init.args[1:] + init.kwonlyargs}
    for name, value in given.items():
        assert name in known, f"PySRRegressor {metadata.version('pysr')} takes no {name}"
        assert accepted(known[name], value), f"{name}={value!r}: {ast.unparse(known[name])}"
    # what the words mean, from PySR's own documentation and checks
    assert given["maxsize"] == 25 and given["maxdepth"] == 6 and given["maxsize"] >= 7
    assert given["timeout_in_seconds"] == 12.5
    assert set(given["binary_operators"]) == set("+-*/") and given["unary_operators"] == ["log"]
    expected = {"log": {"log": 0, "/": 0}, "/": {"/": 0}} if nesting else None
    assert given["nested_constraints"] == expected
    assert given["deterministic"] is (threads == 1)
    assert not given["deterministic"] or (
        given["parallelism"] == "serial" and given["random_state"] == 4
    )
    # PySR warns about a seed without determinism
    assert given["deterministic"] or given["random_state"] is None


def test_pysr_nesting_names_only_operators_in_use():
    limits = Constraints(operators=("+", "*"), forbidden_nesting=(("log", "log"), ("*", "+")))
    given = engines.pysr_arguments(limits, True, 1.0)
    assert given["nested_constraints"] == {"*": {"+": 0}} and given["unary_operators"] == []


def test_without_julia_one_sentence_and_pysr_is_never_imported(tmp_path):
    """In a fresh process with an empty PATH: importing pysr would start a download."""
    code = """
        import sys
        import numpy as np
        from foldlab.errors import InputError
        from foldlab.learning.symbolic.estimators import SymbolicRegressor
        sys.prefix = sys.argv[1]
        try:
            SymbolicRegressor(engine="pysr").fit(np.ones((20, 1)), np.ones(20))
        except InputError as error:
            print(error)
        assert not {"pysr", "juliacall", "juliapkg"} & set(sys.modules)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), str(tmp_path)],
        env={"PATH": str(tmp_path), "HOME": str(tmp_path), "PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    message = done.stdout.strip()
    assert "install Julia" in message and "operon" in message
    assert "\n" not in message and ". " not in message
    assert done.stderr == ""


def test_pysr_hall_of_fame_becomes_formulas(monkeypatch):
    """The adapter from the call to the parsed equations, with PySR's class replaced."""
    seen = {}

    class Regressor:
        def __init__(self, **arguments):
            seen.update(arguments)

        def fit(self, X, y, variable_names):
            seen["names"] = variable_names
            self.equations_ = pd.DataFrame(
                {"equation": ["x0", "(x0 * -1.5e-3) / log(x1)", "x1 - (-x0)"]}
            )

    module = type(sys)("pysr")
    module.PySRRegressor = Regressor
    monkeypatch.setitem(sys.modules, "pysr", module)
    monkeypatch.setattr(engines.importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(engines, "julia", lambda: "/opt/julia")
    monkeypatch.setenv("PYTHON_JULIAPKG_EXE", "/opt/julia")
    X, y = np.ones((5, 2)), np.ones(5)
    trees = engines.pysr(X, y, ("x0", "x1"), Constraints(), True, time.monotonic() + 3)
    assert trees == [
        "x0",
        ("/", ("*", "x0", -1.5e-3), ("log", "x1")),
        ("-", "x1", ("*", -1.0, "x0")),
    ]
    assert seen["names"] == ["x0", "x1"] and 1 <= seen["timeout_in_seconds"] <= 3
    with pytest.raises(InputError, match="from 7 up"):
        engines.pysr(X, y, ("x0", "x1"), Constraints(max_size=5), True, time.monotonic())
