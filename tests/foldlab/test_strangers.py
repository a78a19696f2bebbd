"""No file of a stranger runs code, asks for more memory than it may, or leads out of its folder."""

import ast
import json
import pickle
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import skops.io
from sklearn.exceptions import ConvergenceWarning

from foldlab import tables
from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.labels.label import Label
from foldlab.labels.store import LabelStore
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning import saving
from foldlab.learning.models import make_classifier
from foldlab.learning.saving import load_model, save_model
from foldlab.learning.symbolic.estimators import SymbolicClassifier
from foldlab.learning.symbolic.formula import Formula
from foldlab.settings import read_settings
from foldlab.structure.files import read_pattern
from solver.mesh import gmsh_import
from solver.viscous.evolution import State

ROOT = Path(__file__).parents[2]
CODE = "__import__('pathlib').Path('exploded').touch()"


class Bomb:
    def __reduce__(self):
        return (eval, (CODE,))


@pytest.fixture(autouse=True)
def nothing_ran(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert pickle.loads(pickle.dumps(Bomb())) is None and Path("exploded").exists()
    Path("exploded").unlink()
    yield
    assert not (tmp_path / "exploded").exists()


def edited(folder, **changes):
    """Changes a model's card, and makes its checksums right again."""
    card = json.loads((folder / "model.json").read_text())
    card |= changes
    card["files"] |= {
        n: saving._digest(folder / n) for n in card["files"] if (folder / n).is_file()
    }
    (folder / "model.json").write_text(json.dumps(card))
    return folder


@pytest.fixture
def labels():
    return TimoshenkoSource().evaluate(REDUCED.sample(200, seed=0))


def fitted(name, labels, **options):
    model = make_classifier(name, REDUCED, **options)
    return model.fit(labels[REDUCED.names], labels["foldable"])


@pytest.mark.parametrize(
    "tree",
    [CODE, ["+", "E_ratio", CODE], ["log", [CODE, 1.0]], [CODE, "E_ratio", 1.0], ["log"], [["+"]]],
)
def test_a_formula_is_made_of_operators_numbers_and_inputs(tree, tmp_path):
    model = SymbolicClassifier(REDUCED)
    model = model.restore([(0.1, Formula(("log", "h_ratio"), tuple(REDUCED.names)))], 0, 1.0)
    model.classes_ = np.array([False, True])
    folder = save_model(model, tmp_path / "model")
    load_model(folder)
    state = json.loads((folder / "model.json").read_text())["state"]
    state["front"][0]["tree"] = tree
    with pytest.raises(InputError, match="in a formula; expected"):
        load_model(edited(folder, state=state))


@pytest.mark.parametrize("name", [f"x={CODE}", "x, y", "lambda", ""])
def test_inputs_of_a_formula_are_names(name):
    with pytest.raises(InputError, match="expected names of columns"):
        Formula(1.0, (name,))


def leading_out(tree, how):
    """A state of scikit-learn's tree whose root leads where it may not."""
    state = tree.__getstate__()
    nodes = state["nodes"].copy()
    inner = int(np.flatnonzero(nodes["left_child"] >= 0)[-1])
    match how:
        case "far":
            nodes["left_child"][inner] = 10**9
        case "circle":
            nodes["right_child"][inner] = 0
        case "column":
            nodes["feature"][inner] = 10**6
        case "count":
            state["node_count"] = 10**8
    return {**state, "nodes": nodes}


@pytest.mark.parametrize("how", ["far", "circle", "column", "count"])
@pytest.mark.parametrize("name", ["tree", "forest", "boosted"])
def test_a_tree_that_leads_out_of_its_memory_is_refused(name, how, labels, tmp_path):
    options = {"forest": {"n_estimators": 3}, "boosted": {"max_iter": 3}}.get(name, {})
    model = fitted(name, labels, **options)
    folder = save_model(model, tmp_path / "model")
    load_model(folder)
    inner = model.steps[-1][1]
    if name == "boosted":
        nodes = inner._predictors[-1][0].nodes
        at = int(np.flatnonzero(nodes["is_leaf"] == 0)[-1])
        field = {"far": "left", "circle": "right", "column": "feature_idx", "count": "left"}[how]
        nodes[field][at] = {"circle": 0, "column": 10**6}.get(how, 10**8)
    else:
        grown = inner.tree_ if name == "tree" else inner.estimators_[-1].tree_
        grown.__setstate__(leading_out(grown, "far" if how == "count" else how))
    skops.io.dump(model, folder / "model.skops")
    with pytest.raises(InputError, match="a tree of the model is damaged"):
        load_model(edited(folder))


def test_a_model_may_not_unpack_to_more_than_its_limit(labels, tmp_path, monkeypatch):
    folder = save_model(fitted("tree", labels), tmp_path / "model")
    card = (folder / "model.json").stat().st_size
    monkeypatch.setattr(saving, "MOST_BYTES", 10 * card)
    with pytest.raises(InputError, match=r"holds .* GB; at most .* are read"):
        monkeypatch.setattr(saving, "_digest", None)  # before anything is read
        load_model(folder)
    monkeypatch.setattr(saving, "MOST_BYTES", 9 * card)
    with pytest.raises(InputError, match=r"model.json is larger than"):
        load_model(folder)


def test_a_network_is_no_larger_than_its_weights_and_its_program_is_not_run(labels, tmp_path):
    with pytest.warns(ConvergenceWarning):
        model = fitted("network", labels, members=1, epochs=20)
    folder = save_model(model, tmp_path / "model")
    (folder / "network.pt2").write_bytes(pickle.dumps(Bomb()))
    load_model(edited(folder))
    state = json.loads((folder / "model.json").read_text())["state"]
    for name, value in {"hidden": [200_000, 200_000], "members": 10**9}.items():
        changed = {**state, "parameters": {**state["parameters"], name: value}}
        with pytest.raises(InputError, match="larger than its weights are many"):
            load_model(edited(folder, state=changed))


@pytest.mark.parametrize("name", ["../outside", "/etc/passwd", ".."])
def test_a_card_names_files_of_its_own_folder_only(name, labels, tmp_path):
    folder = save_model(fitted("tree", labels), tmp_path / "model")
    (tmp_path / "outside").write_text("x")
    with pytest.raises(InputError, match="lacks its file"):
        load_model(edited(folder, files={name: "0"}))


@pytest.mark.parametrize("name", ["a.msh", "a.geo", "a.py"])
def test_a_script_is_no_mesh(name):
    Path(name).write_text('SystemCall "touch exploded";\n')
    with pytest.raises(ValueError, match="is no mesh of Gmsh"):
        gmsh_import.read(name)


def test_entities_of_an_svg_are_neither_read_nor_multiplied(tmp_path):
    (tmp_path / "secret.txt").write_text("secret")
    lines = "".join(f'<!ENTITY e{k} "{"".join(10 * [f"&e{k - 1};"])}">' for k in range(1, 12))
    for entities, used in [
        (f'<!ENTITY e0 "lol">{lines}', "&e11;"),
        ('<!ENTITY e SYSTEM "secret.txt">', "&e;"),
    ]:
        Path("a.svg").write_text(f"<!DOCTYPE svg [{entities}]><svg><text>{used}</text></svg>")
        with pytest.raises(InputError) as told:
            read_pattern("a.svg")
        assert "secret\n" not in str(told.value) and len(str(told.value)) < 400


def test_a_saved_state_holds_numbers_only():
    np.savez("state.npz", facts=np.array(json.dumps({})), t0=np.zeros(()),
             x0=np.array([Bomb()], dtype=object))  # fmt: skip
    with pytest.raises(ValueError, match="holds no saved state"):
        State.load("state.npz")


def test_a_table_may_not_hold_more_than_its_limit(labels, monkeypatch):
    labels.to_parquet("a.parquet")
    labels.to_csv("a.csv")
    monkeypatch.setattr(tables, "MOST_CELLS", labels.size - 1)
    monkeypatch.setattr(pd, "read_parquet", None)
    for name in ("a.parquet", "a.csv"):
        with pytest.raises(InputError, match=r"cells; at most .* are read"):
            tables.read_table(name)


def test_a_store_holds_text_only():
    with LabelStore("a.db") as store:
        store.add_many([Label({"a": 1.0}, True, "it folds", {}, "mine", "1")])
    with closing(sqlite3.connect("a.db")) as db, db:
        db.execute("UPDATE label SET evidence = ?", (pickle.dumps(Bomb()),))
    with pytest.raises(InputError, match="damaged"), LabelStore("a.db", mode="read") as store:
        store.frame()


def test_a_journal_holds_json_only():
    from foldlab.learning.tune import open_study

    for content in (pickle.dumps(Bomb()), b'{"op_code":0,"worker_id":"' + CODE.encode() + b'"}\n'):
        Path("study.journal").write_bytes(content)
        with pytest.raises(InputError, match="is no journal of a study"):
            open_study(Path("study.journal"), 0)
        assert Path("study.journal").read_bytes() == content


def test_settings_are_values_and_text():
    Path("a.toml").write_text(f'a = "{CODE}"\n')
    assert read_settings([f"b={CODE}"], Path("a.toml")) == {"a": CODE, "b": CODE}


# Readers that may run what they read, and who may: workers get pickles of their own parent, and a
# formula's source is made of a checked tree.
RUNS = {"pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "torch", "yaml", "skops"}
MAY = {
    "foldlab/campaign/worker.py": {"pickle.loads"},
    "foldlab/learning/symbolic/formula.py": {"exec"},
    "foldlab/learning/saving.py": {"skops.io.load"},
}


def test_nothing_else_runs_what_it_reads():
    seen = set()
    for path in sorted(p for top in ("foldlab", "solver") for p in (ROOT / top).rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            called = ast.unparse(node.func)
            given = {k.arg: ast.unparse(k.value) for k in node.keywords}
            assert given.get("allow_pickle", "False") == "False", (name, node.lineno)
            assert given.get("shell", "False") == "False", (name, node.lineno)
            first, _, last = called.partition(".")
            runs = called in ("eval", "exec", "os.system", "os.popen", "pd.read_pickle")
            if runs or (first in RUNS and last.rpartition(".")[2] in ("load", "loads", "open")):
                assert called in MAY.get(name, ()), f"{name}:{node.lineno} calls {called}"
                seen.add(called)
    assert seen == set().union(*MAY.values())
