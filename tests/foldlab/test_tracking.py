"""Runs in MLflow: where they go, and what a search keeps and drops."""

import os
import shutil
import sqlite3
import warnings
from contextlib import closing
from pathlib import Path

import mlflow
import numpy as np
import pandas as pd
import pytest
import torch

from foldlab.design import FULL, REDUCED
from foldlab.errors import InputError
from foldlab.labels import TimoshenkoSource
from foldlab.learning.models import AngleRegressor, make_classifier
from foldlab.learning.operating_point import with_threshold
from foldlab.learning.tune import can_not_reach_the_front
from foldlab.tracking import track, tracking_uri


def runs(uri, experiment):
    client = mlflow.MlflowClient(uri)
    return client.search_runs([client.get_experiment_by_name(experiment).experiment_id])


@pytest.fixture(scope="module")
def empty(tmp_path_factory):
    """A database of MLflow, which takes seconds to make."""
    path = tmp_path_factory.mktemp("empty") / "empty.db"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # MLflow's own calls
        mlflow.MlflowClient(f"sqlite:///{path}").search_experiments()
    return path


@pytest.fixture
def local(empty, tmp_path, monkeypatch):
    """A working directory with a database of its own; the address of that."""
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    folder = tmp_path.resolve() / "one"
    (folder / "mlruns").mkdir(parents=True)
    shutil.copy(empty, folder / "mlruns" / "mlflow.db")
    monkeypatch.chdir(folder)
    return f"sqlite:///{folder / 'mlruns' / 'mlflow.db'}"


@pytest.mark.parametrize("damage", ["cut", "other", "folder", "name"])
def test_another_or_a_damaged_database_is_refused_and_left_alone(damage, local):
    """MLflow ended in its own traceback, or made its tables in somebody's database."""
    path = Path("mlruns/mlflow.db")
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-8000])
    elif damage == "name":
        # SQLite's verdict holds these bytes, so that reading it fails in Python.
        name = b"sqlite_autoindex_experiments_1"
        path.write_bytes(path.read_bytes().replace(name, name[:-2] + b"\xb4_", 1))
    else:
        path.unlink()
        if damage == "folder":
            path.mkdir()
        else:
            with closing(sqlite3.connect(path)) as other, other:
                other.execute("CREATE TABLE mine (a)")
    before = None if damage == "folder" else path.read_bytes()
    cause = r"damaged or no database of MLflow \(.+\); move it away"
    with pytest.raises(InputError, match=cause), track("x", {}):
        pass
    assert damage == "folder" or path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_a_database_that_mlflow_fails_on_is_refused(local):
    """Sound to SQLite, but not to MLflow: a text column that holds no text."""
    with closing(sqlite3.connect("mlruns/mlflow.db")) as known, known:
        known.execute("UPDATE experiments SET artifact_location = CAST(x'f4f4' AS TEXT)")
    cause = r"MLflow can't use .*mlflow.db .*move that away"
    with pytest.raises(InputError, match=cause), track("kept", {}):
        pass


def test_an_address_that_is_none_is_refused(monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "nosuch://place")
    cause = r"can't use nosuch://place .*; mend MLFLOW_TRACKING_URI"
    with pytest.raises(InputError, match=cause), track("x", {}):
        pass


def test_a_given_address_is_respected(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    uri = f"sqlite:///{tmp_path / 'elsewhere.db'}"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    with track("given", {"a": 1, "long": "x" * 600}, seed=3) as run:
        run.metrics({"good": 1.5, "bad": float("nan"), "text": "x"})
    (kept,) = runs(uri, "given")
    assert kept.data.metrics["good"] == 1.5 and "bad" not in kept.data.metrics
    assert kept.data.tags["seed"] == "3"
    assert kept.data.params == {"a": "1", "long": "x" * 500}
    assert not (tmp_path / "mlruns" / "mlflow.db").exists()
    assert os.environ["MLFLOW_TRACKING_URI"] == uri == tracking_uri()


def test_without_one_it_lies_below_the_working_directory_and_a_failure_is_kept(
    tmp_path, monkeypatch
):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        with pytest.raises(RuntimeError, match="lost"), track("local", {}, seed=0):
            raise RuntimeError("lost")
        (kept,) = runs(f"sqlite:///{tmp_path.resolve() / name / 'mlruns' / 'mlflow.db'}", "local")
        assert kept.info.status == "FAILED" and kept.data.metrics["seconds"] > 0
    assert "MLFLOW_TRACKING_URI" not in os.environ


def test_numbers_of_numpy_are_metrics(local):
    values = {
        "f4": np.float32(0.5), "f8": np.float64(1.5), "i8": np.int64(3), "u1": np.uint8(4),
        "yes": np.bool_(True), "0d": np.array(2.5), "torch": torch.tensor(0.25),
    }  # fmt: skip
    with track("numbers", {}) as run:
        run.metrics({**values, "nan": np.float32("nan"), "array": np.ones(1)})
    assert [path.name for path in Path("mlruns").iterdir()] == ["mlflow.db"]
    (kept,) = runs(local, "numbers")
    kept.data.metrics.pop("seconds")
    assert kept.data.metrics == {
        "f4": 0.5,
        "f8": 1.5,
        "i8": 3,
        "u1": 4,
        "yes": 1,
        "0d": 2.5,
        "torch": 0.25,
    }


def test_a_run_of_the_users_own_goes_on_around_it(local, empty, tmp_path, monkeypatch):
    """It raised "Run with UUID … is already active"."""
    shutil.copy(empty, tmp_path / "mine.db")
    uri = f"sqlite:///{tmp_path / 'mine.db'}"
    mlflow.set_tracking_uri(uri)
    try:
        mlflow.set_experiment("mine")
        with mlflow.start_run() as outer:
            with track("inner", {"a": 1}) as run:
                run.metrics({"x": 1})
            mlflow.log_metric("after", 2)
        assert mlflow.get_tracking_uri() == uri
        with mlflow.start_run() as later:
            pass
        assert later.info.experiment_id == outer.info.experiment_id
    finally:
        mlflow.set_tracking_uri(None)
        monkeypatch.setattr(mlflow.tracking.fluent, "_active_experiment_id", None)
    (kept,) = runs(uri, "inner")
    assert kept.data.tags["mlflow.parentRunId"] == outer.info.run_id
    assert kept.data.metrics["x"] == 1
    assert any(r.data.metrics.get("after") == 2 for r in runs(uri, "mine"))


def test_a_deleted_experiment_starts_afresh(local):
    with track("again", {"n": 1}):
        pass
    client = mlflow.MlflowClient(local)
    client.delete_experiment(client.get_experiment_by_name("again").experiment_id)
    with track("again", {"n": 2}):
        pass
    (kept,) = runs(local, "again")
    assert kept.data.params["n"] == "2"


def test_artifacts_are_found_after_a_move(local, tmp_path, monkeypatch):
    frame = pd.DataFrame({"a": [1, 2]})
    with track("moves", {}) as run:
        monkeypatch.chdir(tmp_path)
        run.table("first", frame)
        monkeypatch.chdir(tmp_path / "one")
    X = REDUCED.sample(30, seed=0)
    with track("moves", {}) as second:
        tree = make_classifier("tree", REDUCED).fit(X, np.arange(30) % 2)
        second.model("tree", tree, X.head(2))
    (tmp_path / "one").rename(tmp_path / "two")
    monkeypatch.chdir(tmp_path / "two")
    client = mlflow.MlflowClient(f"sqlite:///{tmp_path / 'two' / 'mlruns' / 'mlflow.db'}")
    path = client.download_artifacts(run.run_id, "tables/first.csv")
    pd.testing.assert_frame_equal(pd.read_csv(path), frame)
    with track("moves", {}) as third:
        third.table("later", frame)
    (logged,) = client.search_logged_models([client.get_experiment_by_name("moves").experiment_id])
    for run_id, name in (
        (run.run_id, "tables/first.csv"), (third.run_id, "tables/later.csv"),
    ):  # fmt: skip
        assert Path(client.download_artifacts(run_id, name)).is_file()
    assert (tmp_path / "two" / logged.artifact_location / "MLmodel").is_file()
    assert not (tmp_path / "one").exists()


TRACKED = ("tree", "held", "network", "symbolic", "angle")


@pytest.fixture(scope="module")
def fitted():
    """A model of every kind that is saved, by name, with designs that each knows."""
    X = REDUCED.sample(80, seed=0)
    labels = TimoshenkoSource().evaluate(X)
    folds, angles = labels["foldable"], labels["normalised_angle"]
    tree = make_classifier("tree", REDUCED).fit(X, folds)
    network = make_classifier("network", REDUCED, epochs=5).fit(X, folds)
    symbolic = make_classifier("symbolic", REDUCED, seconds=1.0).fit(X, angles)
    full = FULL.sample(60, seed=0)
    angle = AngleRegressor(FULL, inputs="groups", max_iter=5).fit(full, full["contraction"])
    threshold = float(np.quantile(network.predict_proba(X.head(20))[:, 1], 0.8))
    held = with_threshold(network, threshold)
    assert (held.predict(X.head(20)) != network.predict(X.head(20))).any()
    models = (tree, held, network, symbolic, angle)
    return {
        name: (model, (full if name == "angle" else X).head(20))
        for name, model in zip(TRACKED, models, strict=True)
    }


@pytest.fixture(scope="module")
def logged(fitted, empty, tmp_path_factory):
    """Addresses of these models in a database of their own, and the folder that it lies in."""
    folder = tmp_path_factory.mktemp("logged")
    (folder / "mlruns").mkdir()
    shutil.copy(empty, folder / "mlruns" / "mlflow.db")
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        patch.chdir(folder)
        with track("models", {}) as run:
            addresses = {name: run.model(name, *fitted[name]) for name in TRACKED}
    return folder, addresses


@pytest.fixture
def in_logged(logged, monkeypatch):
    monkeypatch.chdir(logged[0])
    # MLflow keeps one store per address: a relative one may be that of another folder.
    mlflow.set_tracking_uri(f"sqlite:///{logged[0] / 'mlruns' / 'mlflow.db'}")
    yield logged[1]
    mlflow.set_tracking_uri(None)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)


@pytest.mark.filterwarnings("ignore")  # MLflow's own calls
@pytest.mark.parametrize("name", TRACKED)
def test_mlflow_loads_every_model_and_it_answers_with_probabilities(name, fitted, in_logged):
    """Networks took numbers without names, formulas were not to be loaded at all."""
    model, designs = fitted[name]
    loaded = mlflow.pyfunc.load_model(in_logged[name])
    told = loaded.predict(designs[designs.columns[::-1]])
    assert loaded.metadata.get_input_schema().input_names() == list(designs.columns)
    assert list(told.columns) == loaded.metadata.get_output_schema().input_names()
    if name == "angle":
        np.testing.assert_array_equal(told["fold_angle"], model.predict(designs))
        return
    np.testing.assert_array_equal(told["probability"], model.predict_proba(designs)[:, 1])
    np.testing.assert_array_equal(told["foldable"], model.predict(designs))
    assert told["foldable"].dtype == bool and 0 < told["probability"].mean() < 1


@pytest.mark.filterwarnings("ignore")
def test_a_logged_model_shows_designs_and_holds_no_pickle(fitted, in_logged):
    loaded = mlflow.pyfunc.load_model(in_logged["network"])
    pd.testing.assert_frame_equal(
        loaded.input_example.reset_index(drop=True), fitted["network"][1].reset_index(drop=True)
    )
    with pytest.raises(mlflow.MlflowException, match="slenderness"):
        loaded.predict(fitted["network"][1].drop(columns="slenderness"))
    files = {p.name for p in Path("mlruns/artifacts").rglob("*") if p.is_file()}
    assert {"model.json", "weights.npz", "model.skops", "formula.py"} <= files
    assert not [f for f in files if f.endswith((".pkl", ".pickle", ".pt", ".joblib"))]


def test_absolute_addresses_of_earlier_versions_are_mended(local, tmp_path):
    client = mlflow.MlflowClient(local)
    old = (tmp_path / "gone" / "mlruns" / "artifacts" / "old").as_uri()
    number = client.create_experiment("old", artifact_location=old)
    run = client.create_run(number).info.run_id
    with track("new", {}):
        pass
    assert client.get_run(run).info.artifact_uri == f"mlruns/artifacts/old/{run}/artifacts"


def test_only_what_is_slow_and_wrong_is_pruned():
    seen = ((0.8, 1), (0.9, 2), (0.95, 3))
    before = [{"early_accuracy": a, "early_seconds": s} for a, s in seen]
    assert can_not_reach_the_front(0.85, 2.5, before, warm_up=3)
    assert not can_not_reach_the_front(0.85, 1.5, before, warm_up=3)
    assert not can_not_reach_the_front(0.92, 2.5, before, warm_up=3)
    assert not can_not_reach_the_front(0.85, 2.5, before, warm_up=4)
