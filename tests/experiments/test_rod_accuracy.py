"""How the rod is compared with the dataset, and the hinge's ends with the table that is shipped."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments import rod_accuracy
from experiments.rod_accuracy import Config, against_the_dataset, rotation_of, turn_of, underside
from foldlab.design import FULL
from solver.cases.unit.rod import ends


def test_ends_turn_and_give_as_in_the_table():
    # E_i/E_s = 1 and h_i/h_s = 10^0.5: a node of the table.
    m = 10**0.5
    table = ends(m, 1.0)
    assert turn_of(m, 1.0) == pytest.approx(table[:3], abs=3e-3)
    assert rotation_of(m, 1.0) == pytest.approx(table[3], rel=6e-3)


def test_the_underside_goes_from_the_middle_outwards_at_the_edge():
    nodes = np.array([[0, 0.5, 0], [0, 0.1, 0], [0.2, 0, 0], [0, 0, 0.1], [0, 0, 0]], float)
    assert underside(nodes).tolist() == [4, 1, 0]


@pytest.fixture
def dataset(monkeypatch):
    """Six labels of the solver, one of isotropic contraction, and what two rods say of them."""
    table = FULL.sample(6, seed=0).assign(
        growth="uniaxial", foldable=pd.array([True, True, False, False, None, True], "boolean"),
        m1=[1.0, 2.0, 0.1, 0.1, 1.0, 1.0], contraction=0.1,
    )  # fmt: skip
    table.loc[5, "growth"] = "isotropic"
    says = {0: (True, 1.01), 1: (None, 2.5), 2: (True, 0.1 + 0.02 * np.pi), 3: (False, 0.1)}

    class Rod:
        def __init__(self, decides):
            self.decides = decides

        def label(self, design):
            pass

        def label_many(self, designs):
            out = []
            for k in designs.index:
                folds, m1 = says[k]
                folds = False if folds is None and self.decides else folds
                evidence = {"m1": m1, "error_estimate": 0.19}
                out.append(SimpleNamespace(foldable=folds, evidence=evidence))
            return out

    monkeypatch.setattr(rod_accuracy, "load_dataset", lambda name: table)
    monkeypatch.setattr(
        rod_accuracy, "make_source", lambda name, settings=None: Rod(settings == {"sure": False})
    )
    return table


def test_the_rod_is_compared_with_known_labels_of_uniaxial_contraction(dataset):
    said = against_the_dataset(Config(labels=100))
    assert (said["labels"], said["unknown"], said["wrong"]) == (4, 1, 1)
    # What it may leave open it has to decide here: one more wrong.
    assert said["wrong_if_it_must_decide"] == 2
    # Off by 0.01 of 1.01, 0.5 of 2.5, 0.02 π of the |g|π = 0.314 that counts as folded, and 0.
    off = [0.01 / 1.01, 0.2, 0.2, 0.0]
    assert said["error_median"] == pytest.approx(np.median(off))
    assert said["error_95"] == pytest.approx(np.quantile(off, 0.95))
    assert said["within_the_stated_error"] == 0.5
    assert said["labels_per_core_second"] == pytest.approx(4 / 1e-3, rel=0.5)
    (ax,) = said["figure"].axes
    points = ax.lines[0].get_xydata()
    assert sorted(points[:, 0]) == [0.1, 0.1, 1.0, 2.0] and 2.5 in points[:, 1]
    assert against_the_dataset(Config(labels=3))["labels"] == 3


def test_a_row_for_each_layer_is_compared_with_the_table_and_written(tracker, monkeypatch):
    monkeypatch.setattr(rod_accuracy, "turn_of", lambda m, n: np.array([m, n, 0.5]))
    monkeypatch.setattr(rod_accuracy, "rotation_of", lambda m, n: 10 * m)
    monkeypatch.setattr(
        rod_accuracy, "ends", lambda m, n: np.array([m - (0.25 if m > 5 else 0.0), n + 0.1, 0.5, 0])
    )
    figure = SimpleNamespace(savefig=lambda path, dpi: path.write_bytes(b"png"))
    monkeypatch.setattr(
        rod_accuracy, "against_the_dataset", lambda config: {"figure": figure, "labels": 3}
    )
    config = Config(h_ratios=(0.0, 1.0), E_ratios=(-1.0,), write=True)
    result = rod_accuracy.run(config, tracker)
    assert result["off_the_table"] == pytest.approx(0.25) and result["labels"] == 3
    assert len(result["table"]) == 2
    first = result["table"][0]
    assert first["log10 h_ratio"] == 0.0 and first["log10 E_ratio"] == -1.0
    assert first["turn/c at 0"] == 1.0 and first["turn/c at 0.2"] == pytest.approx(0.1)
    assert first["rotation per M/(E_s h_s²)"] == 10.0
    lines = Path("out/hinge_ends.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == rod_accuracy.HEADER
    assert lines[1:] == ["0,-1,1.0000,0.1000,0.5000,10", "1,-1,10.0000,0.1000,0.5000,100"]
    less = rod_accuracy.run(replace(config, h_ratios=(0.0,), write=False), tracker)
    assert less["off_the_table"] == pytest.approx(0.1)
