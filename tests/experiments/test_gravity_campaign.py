"""What a campaign under weight is said to have cost, and how its labels are counted."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments import gravity_campaign as campaign
from experiments.gravity_campaign import Config, picture, run, summary
from foldlab.design import FULL

FRAME = pd.DataFrame({
    "foldable": pd.array([True, True, False, None, False], dtype="boolean"),
    "outcome": ["folds", "folds", "grounded", "timeout", "folds"],
    "core_seconds": [1.0, 2.0, 3.0, 14.0, 5.0],
    "seconds": [2.0, 2.0, 4.0, 15.0, 7.0],
    "error_estimate": [0.02, "0.01", 0.5, None, 0.03],
    "peak_memory_mb": [300.0, 310.0, 305.0, 900.0, 1.0],
    "stiffness_to_weight": [0.02, 0.02, 0.02, 50.0, 3.0],
})  # fmt: skip


def test_costs_are_of_all_labels_and_errors_of_those_that_have_one():
    said = summary(FRAME, Config(accuracy=0.02, workers=2), wall=20.0)
    assert (said["labels"], said["folds"]) == (5, 2)
    assert said["core_seconds_median"] == 3.0 and said["core_seconds_mean"] == 5.0
    assert said["core_seconds_90"] == pytest.approx(10.4)
    assert said["error_median"] == pytest.approx(0.025)
    # The accuracy itself is kept; what has no error doesn't keep it.
    assert said["error_within"] == pytest.approx(2 / 5)
    assert said["peak_memory_mb_median"] == 305.0 and said["peak_memory_mb_most"] == 900.0
    assert said["stable_or_reason"] == pytest.approx(4 / 5)
    assert said["outcomes"] == {"folds": 3, "grounded": 1, "timeout": 1}
    assert said["wall_seconds"] == 20.0
    # Two workers for 20 s, of which labels took 30.
    assert said["overhead_seconds"] == pytest.approx(2.0)
    assert summary(FRAME, Config(workers=1), wall=20.0)["overhead_seconds"] == 0.0
    first, *rest = said["table"]
    assert first == {"outcome": "folds", "labels": 3, "median_core_seconds": 2.0}
    assert {row["labels"] for row in rest} == {1}


def test_the_picture_adds_up_outcomes_by_weight_and_labels_by_cost():
    cost, ends = picture(FRAME).axes
    (steps,) = cost.lines
    assert steps.get_xydata() == pytest.approx(
        np.array([[1, 0.2], [2, 0.4], [3, 0.6], [5, 0.8], [14, 1.0]])
    )
    bars = {(round(np.log10(b.get_x()), 3), b.get_y()): b.get_height() for b in ends.patches}
    assert bars[-2.0, 0.0] == pytest.approx(2 / 3) and bars[1.5, 0.0] == 1.0
    assert bars[-2.0, 2 / 3] == pytest.approx(1 / 3)
    tops = {}
    for (left, below), height in bars.items():
        tops[left] = max(tops.get(left, 0.0), below + height)
    assert {k for k, top in tops.items() if top > 0.99} == {-2.0, 0.0, 1.5}


class Store:
    """In place of a store: what was labelled before, and what is labelled now."""

    def __init__(self, path):
        assert path.name == "labels.db" and path.parent.is_dir()
        self.frames = [labelled(campaign.SHEETS.sample(4, seed=77))]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def frame(self, name, version):
        return pd.concat(self.frames, ignore_index=True)


def labelled(piece):
    rows = FRAME.head(len(piece)).drop(columns="stiffness_to_weight")
    return pd.concat([piece.reset_index(drop=True), rows], axis=1)


def test_each_piece_is_a_hypercube_of_its_own_and_earlier_labels_do_not_count(
    tracker, tmp_path, monkeypatch
):
    def run_campaign(piece, source, store, *, workers, progress):
        assert (source.effort.accuracy, source.effort.timeout, workers) == (0.1, 9.0, 3)
        assert source.conditions.growth == "isotropic"
        store.frames.append(labelled(piece))
        return SimpleNamespace(outcome="done", as_dict=dict)

    monkeypatch.setattr(campaign, "LabelStore", Store)
    monkeypatch.setattr(campaign, "run_campaign", run_campaign)
    config = Config(
        seed=3, pieces=2, size=4, growth="isotropic", accuracy=0.1, timeout=9.0, workers=3,
        store=str(tmp_path / "there" / "labels.db"),
    )  # fmt: skip
    result = run(config, tracker)
    assert result["labels"] == 8 and result["wall_seconds"] < 60
    pieces = [campaign.SHEETS.sample(4, seed=s)[FULL.names] for s in (3, 4)]
    np.testing.assert_allclose(tracker.tables["labels"][FULL.names], pd.concat(pieces))
