"""Every experiment runs in its TINY form, tracked, and says what its table needs."""

import importlib
import json
import math
import pkgutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mlflow
import numpy as np
import pandas as pd
import pytest
import pyvista

import experiments
from experiments import accuracy_calibration, problem_p
from experiments.common import execute, main
from foldlab.errors import InputError

NAMES = [
    m.name
    for m in pkgutil.iter_modules(experiments.__path__)
    if m.name != "common" and not m.name.startswith("_")  # parts of an experiment
]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    return tmp_path


@pytest.mark.parametrize("name", NAMES)
def test_tiny(name, here):
    module = importlib.import_module(f"experiments.{name}")
    assert module.__doc__.strip().splitlines()[0].endswith(("?", ".")), "state the question"
    result = execute(name, module.run, module.TINY)
    json.dumps(result, allow_nan=False)
    assert result["table"]
    assert not result.get("complaints")
    client = mlflow.MlflowClient(f"sqlite:///{here.resolve() / 'mlruns' / 'mlflow.db'}")
    (run,) = client.search_runs([client.get_experiment_by_name(name).experiment_id])
    assert run.info.status == "FINISHED"
    assert run.data.params["seed"] == "0"
    assert run.data.tags["commit"]
    assert math.isfinite(run.data.metrics["seconds"])
    assert Path(run.info.artifact_uri).is_relative_to(f"mlruns/artifacts/{name}")
    assert {f.path for f in client.list_artifacts(run.info.run_id)} >= {"figures"}
    assert list((here / "out").glob("*.png"))


def test_a_wrong_setting_ends_with_status_2(here):
    done = subprocess.run(
        [sys.executable, "-m", "experiments.regime_maps", "--set", "pionts=3"],
        capture_output=True,
        text=True,
        cwd=Path(experiments.__file__).parent.parent,
    )
    assert done.returncode == 2
    assert "no setting 'pionts'; there are: " in done.stderr
    assert done.stdout == ""


def test_a_comparison_without_the_network_is_refused(here):
    # It trained all others, and ended in a KeyError.
    from experiments import compare_models

    config = replace(compare_models.TINY, models=("tree",))
    with pytest.raises(InputError, match="add network"):
        compare_models.run(config, None)


@pytest.mark.parametrize(
    ("flags", "designs"), [(["--tiny"], 1), (["--tiny", "--set", "designs=2"], 2)]
)
def test_tiny_is_the_small_version_and_settings_win_over_it(flags, designs, monkeypatch, here):
    seen = []

    def run(config, tracker):
        seen.append(config)
        return {"table": [{"a": 1.0}]}

    monkeypatch.setattr(sys, "argv", ["experiments/robustness.py", "--json", *flags])
    tiny = replace(accuracy_calibration.TINY, designs=1)
    main("Is it small?", run, accuracy_calibration.Config, tiny)
    (config,) = seen
    assert config.designs == designs and config.accuracies == tiny.accuracies
    assert config.accuracies != accuracy_calibration.Config().accuracies


def test_problem_p_states_relative_errors_and_writes_its_series_over_the_load(here):
    result = execute("problem_p", problem_p.run, problem_p.TINY)
    for row in result["table"]:
        exact = problem_p.ANGLES[row["growth"]]
        assert row["error"] == pytest.approx(abs(row["angle"] / exact - 1))
    reader = pyvista.get_reader(here / "out" / "problem_p" / "unit.pvd")
    loads = []
    for time in reader.time_values:
        reader.set_active_time_value(time)
        loads.append(float(reader.read()[0].field_data["load"][0]))
    assert loads[0] == 0.0 and loads[-1] == 1.0 and loads == sorted(loads)


def test_problem_p_draws_its_curves_over_the_contraction_as_what_converged():
    curves = pd.DataFrame({"growth": "uniaxial", "element": "hex27", "g": [0.0, -0.1, -0.3]})
    curves["angle"] = [0.0, 1.2, 3.7]
    (ax,) = problem_p.plot_angles(curves).axes
    drawn = {line.get_label(): line.get_xydata() for line in ax.lines}
    assert drawn["hex27"] == pytest.approx(np.array([[0.0, 0.0], [0.1, 1.2], [0.3, 3.7]]))
    assert drawn["converged"][-1] == pytest.approx([0.3, problem_p.ANGLES["uniaxial"]], rel=1e-3)
