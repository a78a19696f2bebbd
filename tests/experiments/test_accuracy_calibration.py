"""What the calibration of stated errors counts, and which state it compares with which."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments import accuracy_calibration as calibration
from experiments.accuracy_calibration import Config
from experiments.gravity_campaign import SHEETS
from foldlab.design import FULL
from foldlab.labels.foldability import Thresholds
from foldlab.labels.rod import RodSource

FRAME = pd.DataFrame({
    "outcome": ["folds", "grounded", "timeout", "curled", "folds"],
    "true_m1": [0.01, 0.03, np.nan, 0.0, np.nan],
    "stated_m1": [0.01, 0.01, np.nan, 0.02, 0.5],
    "true_m2": [0.04, 0.01, np.nan, 0.05, np.nan],
    "stated_m2": [0.01, 0.04, np.nan, 0.02, 0.5],
    "scale": [2.0, 1.0, np.nan, 4.0, np.nan],
    "seconds": [2.0, 1.0, 90.0, 3.0, 8.0],
    "expected_seconds": [1.0, 2.1, 1.0, 2.0, 1.0],
    "memory_mb": [119.0, 121.0, 900.0, 85.0, 81.0],
    "expected_memory_mb": [100.0, 100.0, 100.0, 100.0, 100.0],
})  # fmt: skip


def test_stated_errors_are_counted_where_a_true_one_is_known_and_seconds_where_no_time_ran_out():
    said = calibration.verdict(0.02, FRAME)
    assert (said["accuracy"], said["labels"], said["with_reference"]) == (0.02, 5, 3)
    # An error that is met exactly is a bound that holds.
    assert said["m1_below_stated"] == pytest.approx(2 / 3)
    assert said["m2_below_stated"] == pytest.approx(1 / 3)
    assert said["m1_interval"] == [0.208, 0.939] and said["m2_interval"] == [0.061, 0.792]
    # In fractions of the angle: 0.005, 0.01 and 0.005 stated; 0.005, 0.03 and 0 true.
    assert said["m1_median_stated"] == pytest.approx(0.005)
    assert said["m1_median_true"] == pytest.approx(0.005)
    assert said["m2_median_stated"] == pytest.approx(0.005)
    assert said["m2_median_true"] == pytest.approx(0.0125)
    # Twice the forecast is within a factor of 2; of four labels that came to their end.
    assert said["seconds_within_2"] == 2 / 4
    assert said["seconds_interval"] == calibration.interval(2, 4)
    assert said["median_seconds"] == 2.5
    assert said["median_seconds_over_expected"] == pytest.approx(1.75)
    assert said["memory_within_20_percent"] == 3 / 4


def test_nothing_known_is_no_fraction_of_anything():
    said = calibration.verdict(0.02, FRAME[FRAME["outcome"] == "timeout"])
    assert said["m1_below_stated"] == 0 and said["m1_interval"] is None
    assert said["seconds_within_2"] == 0 and said["seconds_interval"] is None


def test_half_of_the_designs_are_near_the_threshold_by_the_rod():
    config = Config(designs=11, seed=2)
    designs = calibration.drawn(config)
    angles = np.array([label.evidence["m1"] for label in RodSource().label_many(designs)])
    off = np.abs(angles / Thresholds().angle(designs["contraction"]) - 1)
    assert len(designs) == 11 and (off < config.near).sum() == 5
    # The first of each kind, in the order in which they were drawn.
    pool = SHEETS.sample(300, seed=4245)
    angles = np.array([label.evidence["m1"] for label in RodSource().label_many(pool)])
    near = np.abs(angles / Thresholds().angle(pool["contraction"]) - 1).to_numpy() < config.near
    first = np.sort(np.r_[np.flatnonzero(near)[:5], np.flatnonzero(~near)[:6]])
    pd.testing.assert_frame_equal(designs, pool.iloc[first].reset_index(drop=True))
    again = calibration.drawn(replace(config, designs=2))
    assert len(again) == 2 and not again.equals(designs.head(2))


@pytest.fixture
def followed(monkeypatch):
    """Follow a made-up path, closed or not, on so many meshes; what was asked comes back too."""
    asked = {}

    def refined(folding, mesh, *, earlier, deadline):
        asked.update(folding=folding, mesh=mesh, earlier=earlier, deadline=deadline)
        return None if folding == "lost" else SimpleNamespace(last=SimpleNamespace(curves="finer"))

    def measure(curves, length):
        assert (curves, length) == ("finer", 0.25)
        return SimpleNamespace(m1=1.1, m2=0.2)

    monkeypatch.setattr(calibration.unit_path, "refined", refined)
    monkeypatch.setattr(calibration.foldability, "measure", measure)
    monkeypatch.setattr(calibration, "core_seconds", lambda: 1000.0)
    monkeypatch.setattr(
        calibration, "forecast", lambda *_: SimpleNamespace(seconds=3.0, memory_mb=400.0)
    )

    def follow(closed=False, levels=2, folding="folding", stated=0.05, history=None):
        if history is None:
            history = [
                {"m1": 0.1, "m2": 0.05, "contraction": 0.05},
                {"m1": 1.0, "m2": 0.25, "contraction": 0.1},
                {"m1": 2.0, "m2": 0.5, "contraction": 0.2},
            ]
        path = SimpleNamespace(
            history=history, closed=closed, folding=folding, measures={"m1": 2.0}
        )
        evidence = {
            "outcome": "folds", "levels": levels, "unknowns": 900, "core_seconds": 2.0,
            "peak_memory_mb": 500.0,
        }  # fmt: skip
        if stated is not None:
            evidence |= {"error_m1": stated, "error_m2": 2 * stated}
        source = SimpleNamespace(
            follow=lambda design: (path, SimpleNamespace(evidence=evidence)),
            thresholds=Thresholds(),
        )
        return calibration.one(source, {"hinge_length": 0.25}, Config())

    follow.asked = asked
    return follow


def test_a_label_is_compared_at_its_last_state_two_levels_finer(followed):
    row = followed()
    assert row["true_m1"] == pytest.approx(0.9) and row["true_m2"] == pytest.approx(0.3)
    assert (row["stated_m1"], row["stated_m2"]) == (0.05, 0.1)
    # |m1| of the finer mesh, or what counts as folded.
    assert row["scale"] == pytest.approx(1.1)
    assert followed.asked["mesh"] == 3 and followed.asked["earlier"] is False
    assert followed.asked["deadline"] == 1000.0 + Config().reference_timeout
    assert (row["seconds"], row["expected_seconds"]) == (2.0, 3.0)
    assert (row["memory_mb"], row["expected_memory_mb"]) == (500.0, 400.0)
    assert (row["outcome"], row["levels"], row["unknowns"]) == ("folds", 2, 900)


def test_a_full_turn_is_compared_at_the_state_before_it_where_its_error_is_that_of_half_the_angle(
    followed,
):
    row = followed(closed=True)
    assert row["true_m1"] == pytest.approx(0.1) and row["true_m2"] == pytest.approx(0.05)
    assert row["stated_m1"] == pytest.approx(0.025) and row["stated_m2"] == pytest.approx(0.05)
    assert followed.asked["mesh"] == 2 and followed.asked["earlier"] is True


def test_beyond_the_finest_mesh_there_is_one_more(followed):
    followed(levels=len(calibration.LEVELS) - 1)
    assert followed.asked["mesh"] is calibration.FINEST
    followed(levels=len(calibration.LEVELS) - 2)
    assert followed.asked["mesh"] == len(calibration.LEVELS) - 1


@pytest.mark.parametrize("how", [{"folding": "lost"}, {"stated": None}, {"history": []}])
def test_without_a_state_or_a_finer_one_there_is_no_true_error(how, followed):
    row = followed(**how)
    assert row["true_m1"] is row["true_m2"] is row["scale"] is None
    assert row["stated_m1"] == how.get("stated", 0.05)


def test_each_accuracy_is_asked_for_the_designs_that_it_is_to_have(tracker, monkeypatch):
    seen = []

    def one(source, design, config):
        seen.append((source.effort.accuracy, source.conditions.effects, source.effort.timeout))
        return FRAME.iloc[0].to_dict() | {"design_has": sorted(design)}

    monkeypatch.setattr(calibration, "one", one)
    config = Config(designs=3, accuracies=(0.02, 0.1), fine_designs=1, effects="none", timeout=7.0)
    result = calibration.run(config, tracker)
    assert [a for a, *_ in seen] == [0.02] * 3 + [0.1] * 3 + [0.005]
    assert {tuple(rest) for _, *rest in seen} == {("none", 7.0)}
    assert [(r["accuracy"], r["labels"]) for r in result["table"]] == [
        (0.005, 1), (0.02, 3), (0.1, 3),
    ]  # fmt: skip
    table = tracker.tables["designs"]
    assert result["designs"] == 3 and table["design"].tolist() == [0, 1, 2, 0, 1, 2, 0]
    assert table["design_has"].iloc[0] == sorted(FULL.names)
    seen.clear()
    calibration.run(replace(config, fine_designs=0), tracker)
    assert len(seen) == 6


def test_pictures_show_errors_as_fractions_and_what_was_expected_against_what_came():
    errors, seconds = calibration.picture(FRAME.assign(accuracy=0.02)).axes
    m1, m2, line = (drawn.get_xydata() for drawn in errors.lines)
    assert m1 == pytest.approx(np.array([[0.005, 0.005], [0.01, 0.03], [0.005, 1e-6]]))
    assert m2[0] == pytest.approx([0.005, 0.02]) and (line[:, 0] == line[:, 1]).all()
    assert seconds.lines[0].get_xydata()[1] == pytest.approx([2.1, 1.0])
    band = seconds.collections[0].get_paths()[0].vertices
    assert (band[:, 1] / band[:, 0]).max() == pytest.approx(2)
    assert (band[:, 1] / band[:, 0]).min() == pytest.approx(1 / 2)
