"""Runs in MLflow: where they go, and what a search keeps and drops."""

import os

import mlflow
import pytest

from foldlab.learning.tune import can_not_reach_the_front
from foldlab.tracking import track, tracking_uri


def runs(uri, experiment):
    client = mlflow.MlflowClient(uri)
    return client.search_runs([client.get_experiment_by_name(experiment).experiment_id])


def test_a_given_address_is_respected(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    uri = f"sqlite:///{tmp_path / 'elsewhere.db'}"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    with track("given", {"a": 1}, seed=3) as run:
        run.metrics({"good": 1.5, "bad": float("nan"), "text": "x"})
    (kept,) = runs(uri, "given")
    assert kept.data.metrics["good"] == 1.5 and "bad" not in kept.data.metrics
    assert kept.data.tags["seed"] == "3"
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


def test_only_what_is_slow_and_wrong_is_pruned():
    seen = ((0.8, 1), (0.9, 2), (0.95, 3))
    before = [{"early_accuracy": a, "early_seconds": s} for a, s in seen]
    assert can_not_reach_the_front(0.85, 2.5, before, warm_up=3)
    assert not can_not_reach_the_front(0.85, 1.5, before, warm_up=3)
    assert not can_not_reach_the_front(0.92, 2.5, before, warm_up=3)
    assert not can_not_reach_the_front(0.85, 2.5, before, warm_up=4)
