"""The option --track: what MLflow is told of a verb, and that nothing is told of refused input."""

import json
import sqlite3
from contextlib import closing

import mlflow
import pandas as pd
import pytest

from foldlab import tracking
from foldlab.design import REDUCED
from foldlab.labels.timoshenko import TimoshenkoSource

pytestmark = pytest.mark.filterwarnings("ignore")  # MLflow's own calls

UNIT = (
    "--passive PET --active SMP --set l_s=40mm --set b_s=10mm --set h_s=0.1mm --set h_i=0.2mm "
    "--set l_i=10mm --set contraction=5%"
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A database of MLflow as it is new; to make one takes seconds."""
    folder = tmp_path_factory.mktemp("mlflow")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        with tracking.track("none", {}):
            pass
    return (folder / "mlruns" / "mlflow.db").read_bytes()


@pytest.fixture
def folder(foldlab, made, tmp_path):
    """Where verbs are called; with labels, and MLflow's database."""
    labels = TimoshenkoSource().evaluate(REDUCED.sample(80, seed=0))
    labels.to_csv(tmp_path / "labels.csv", index=False)
    (tmp_path / "mlruns").mkdir()
    (tmp_path / "mlruns" / "mlflow.db").write_bytes(made)
    return tmp_path


def the_run(folder, verb):
    """The only run of a verb, and paths of its artifacts."""
    client = mlflow.MlflowClient(f"sqlite:///{folder / 'mlruns' / 'mlflow.db'}")
    known = client.get_experiment_by_name(verb)
    if known is None:
        return None, set()
    (run,) = client.search_runs([known.experiment_id])
    root = folder / run.info.artifact_uri
    return run, {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()}


def test_a_model_that_train_tracks_is_loaded_after_a_move(foldlab, folder, monkeypatch):
    command = "train labels.csv --model tree --set max_depth=4 -o model --track --seed 3 --json"
    status, out, err = foldlab(command)
    assert status == 0, err
    run, _ = the_run(folder, "train")
    assert run.info.status == "FINISHED" and run.data.tags["seed"] == "3"
    assert run.data.params["model"] == "tree" and run.data.params["max_depth"] == "4"
    told = json.loads(out)
    assert run.data.metrics["holdout_accuracy"] == told["holdout_accuracy"]
    assert run.data.metrics["seconds"] > 0
    with closing(sqlite3.connect(folder / "mlruns" / "mlflow.db")) as db:
        ((address,),) = db.execute("SELECT artifact_location FROM logged_models").fetchall()
    assert address.startswith("mlruns/artifacts/train/")
    moved = folder.parent / f"{folder.name}-moved"
    folder.rename(moved)
    monkeypatch.chdir(moved)
    model = mlflow.pyfunc.load_model(address)
    assert model.metadata.get_input_schema().input_names() == REDUCED.names
    assert model.metadata.get_output_schema().input_names() == ["probability", "foldable"]
    answers = model.predict(REDUCED.sample(20, seed=1))
    assert answers["probability"].between(0, 1).all() and answers["foldable"].nunique() == 2


def test_labels_are_tracked_with_their_table(foldlab, folder):
    status, out, err = foldlab("label labels.csv -o labels.db --track --json")
    assert status == 0, err
    run, artifacts = the_run(folder, "label")
    assert artifacts == {"labels.parquet"}
    table = pd.read_parquet(folder / run.info.artifact_uri / "labels.parquet")
    told = json.loads(out)
    assert len(table) == run.data.metrics["labels"] == told["labels"] == 80
    assert run.data.metrics["folds"] == told["folds"] == table["foldable"].sum()
    assert run.data.params["source"] == "timoshenko"


def test_a_simulation_is_tracked_with_its_files(foldlab, folder):
    status, out, err = foldlab(
        f"simulate {UNIT} --accuracy 0.2 --no-pictures -o sim --track --json"
    )
    assert status == 0, err
    run, artifacts = the_run(folder, "simulate")
    told = json.loads(out)
    assert run.data.metrics["fold_angle"] == told["fold_angle"]
    assert run.data.metrics["measures.m1"] == told["measures"]["m1"]
    assert float(run.data.params["contraction"]) == 0.05 and run.data.params["accuracy"] == "0.2"
    assert {"result.json", "curves.npz", "series/unit.pvd"} <= artifacts
    root = folder / run.info.artifact_uri
    assert (root / "result.json").read_bytes() == (folder / "sim" / "result.json").read_bytes()


def test_a_wish_is_tracked_with_its_answer(foldlab, folder):
    wish = "design --want angle=45deg --weightless -n 2 --track --json"
    status, out, err = foldlab(
        f"{wish} --set E_ratio=1 --set hinge_length=0.25 --set contraction=0.3"
    )
    assert status == 0, err
    run, artifacts = the_run(folder, "design")
    assert artifacts == {"answer.json"} and run.data.metrics["proposed"] == 2
    assert run.data.params["want"] == "angle=45deg" and run.data.params["E_ratio"] == "1.0"
    assert json.loads((folder / run.info.artifact_uri / "answer.json").read_text()) == json.loads(
        out
    )


def test_of_refused_input_no_run_is_left_and_without_the_option_nothing_is_told(foldlab, folder):
    status, _, err = foldlab("train labels.csv --model tree --set max_deep=4 -o model --track")
    assert status == 2 and "max_deep" in err
    assert the_run(folder, "train") == (None, set())
    assert foldlab("label labels.csv -o labels.db --json")[0] == 0
    assert the_run(folder, "label") == (None, set())


def test_a_damaged_database_is_told_before_any_work(foldlab, folder):
    (folder / "mlruns" / "mlflow.db").write_bytes(b"no database")
    status, _, err = foldlab("train labels.csv --model tree -o model --track")
    assert status == 2 and "damaged or no database of MLflow" in err
    assert not (folder / "model").exists()
