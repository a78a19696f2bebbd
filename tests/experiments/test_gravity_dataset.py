"""How the dataset's designs are drawn: reproducibly, split once, near the boundary where asked."""

import numpy as np
import pandas as pd
import pytest

from experiments import gravity_dataset
from experiments.gravity_dataset import draw, near_boundary
from foldlab.design import FULL, PATTERNED
from foldlab.labels.rod import RodSource
from foldlab.tables import read_table, write_table


def test_half_is_a_hypercube_split_once_and_half_lies_near_the_boundary():
    table = draw("uniaxial", 40, 7)
    assert table.equals(draw("uniaxial", 40, 7)) and not table.equals(draw("uniaxial", 40, 8))
    counts = table.groupby(["drawn", "part"]).size().to_dict()
    assert counts == {
        ("boundary", "train"): 20,
        ("hypercube", "test"): 4,
        ("hypercube", "train"): 12,
        ("hypercube", "validation"): 4,
    }
    cube = table[table["drawn"] == "hypercube"]
    # One of a hypercube's 20 in each twentieth of every group.
    strata = np.floor(20 * gravity_dataset.SHEETS.to_unit(cube)).astype(int)
    assert (np.sort(strata, axis=0) == np.arange(20)[:, None]).all()
    striped = table[table["space"] == "patterned"]
    assert len(striped) == 4 and (table[table["space"] == "full"]["strips"] == 0).all()
    PATTERNED.validate(striped)
    FULL.validate(table)


def test_near_the_boundary_is_where_the_rod_cannot_tell():
    near = near_boundary("uniaxial", 6, 3)
    outcomes = {label.evidence["outcome"] for label in RodSource().label_many(near)}
    assert outcomes == {"unresolved"}


def test_isotropic_designs_are_drawn_where_the_pieces_before_leave_doubt(tmp_path, monkeypatch):
    monkeypatch.setattr(gravity_dataset, "FOLDER", tmp_path)
    many = gravity_dataset.SHEETS.sample(30 * 8, seed=500_003)
    first = near_boundary("isotropic", 8, 3)
    pd.testing.assert_frame_equal(first, many.head(8))
    (tmp_path / "gravity").mkdir()
    known = gravity_dataset.SHEETS.sample(400, seed=1)
    noise = 0.2 * np.random.default_rng(0).normal(size=len(known))
    folds = np.log10(known["stiffness_to_weight"]) + noise > 0
    known["foldable"] = pd.array(folds, dtype="boolean")
    known.loc[0, "foldable"] = None
    write_table(known, tmp_path / "gravity" / "isotropic-000.parquet")
    weight = np.log10(near_boundary("isotropic", 8, 3)["stiffness_to_weight"])
    assert np.abs(weight).max() < 0.8 < np.abs(np.log10(first["stiffness_to_weight"])).max()
    # Of an odd number the larger half.
    table = draw("isotropic", 11, 3)
    assert table["drawn"].value_counts().to_dict() == {"boundary": 6, "hypercube": 5}
    assert (table["strips"] == 0).all()


def test_a_whole_piece_is_written_and_read_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(gravity_dataset, "FOLDER", tmp_path)

    class Tracker:
        table = figure = staticmethod(lambda *_: None)

    config = gravity_dataset.Config(size=4, accuracy=0.2, timeout=20.0, write=True)
    result = gravity_dataset.run(config, Tracker())
    monkeypatch.setattr("foldlab.datasets.FOLDER", tmp_path)
    from foldlab.datasets import load_dataset

    table = load_dataset("gravity", growth="uniaxial")
    assert len(table) == result["labels"] == 4 == table.attrs["foldlab"]["labels"]
    assert {"drawn", "part", "strips", "history", "error_m1", "strain.passive"} <= set(table)
    assert "curves" not in table and table["m1"].dtype == np.float32
    drawn = draw("uniaxial", 4, gravity_dataset.SEEDS)
    merged = drawn.merge(table, on=FULL.names)
    assert len(merged) == 4 and (merged["part_x"] == merged["part_y"]).all()


def test_bad_settings_are_one_sentence():
    for config, says in (
        (gravity_dataset.Config(growth="both"), "growth 'both'; expected 'uniaxial' or"),
        (gravity_dataset.Config(size=3), "size = 3; expected at least 4"),
    ):
        with pytest.raises(ValueError, match=says):
            gravity_dataset.run(config, None)


def test_labels_are_counted_by_how_they_were_drawn_and_by_part():
    table = pd.DataFrame({
        "drawn": ["hypercube"] * 3 + ["boundary"], "part": ["test", "test", "train", "train"],
        "foldable": pd.array([True, None, False, True], dtype="boolean"),
        "outcome": ["folds", "timeout", "grounded", "folds"],
        "core_seconds": [1.0, 30.0, 2.0, 4.0],
    })  # fmt: skip
    said = gravity_dataset.summary(table)
    assert (said["labels"], said["unknown"], said["folds"]) == (4, 1, 2)
    assert said["outcomes"] == {"folds": 2, "timeout": 1, "grounded": 1}
    assert said["core_seconds_median"] == 3.0 and said["core_seconds_mean"] == 9.25
    assert said["table"] == [
        {"drawn": "boundary", "part": "train", "labels": 1, "known": 1, "folds": 1},
        {"drawn": "hypercube", "part": "test", "labels": 2, "known": 1, "folds": 1},
        {"drawn": "hypercube", "part": "train", "labels": 1, "known": 1, "folds": 0},
    ]


@pytest.mark.parametrize("write", [True, False])
def test_pieces_are_drawn_labelled_and_written_each_by_itself(
    write, tracker, tmp_path, monkeypatch
):
    asked = []

    def labelled(designs, source, store, *, workers, progress):
        asked.append((source.space.name, len(designs), source.effort, source.conditions, workers))
        rows = designs.assign(
            foldable=pd.array([True] * len(designs), dtype="boolean"), outcome="folds",
            core_seconds=2.0, version="9-x", curves="…", history="[]", error_estimate=0.01,
            stiffness=1.0,
        )  # fmt: skip
        rows.loc[rows.index[0], "foldable"] = None
        return rows

    monkeypatch.setattr(gravity_dataset, "labelled", labelled)
    monkeypatch.setattr(gravity_dataset, "FOLDER", tmp_path)
    config = gravity_dataset.Config(
        seed=3, first=4, pieces=2, size=20, accuracy=0.1, timeout=9.0, workers=2, write=write
    )
    result = gravity_dataset.run(config, tracker)
    assert [(name, n) for name, n, *_ in asked] == [("full", 18), ("patterned", 2)] * 2
    effort, conditions, workers = asked[0][2:]
    assert (effort.accuracy, effort.timeout, workers) == (0.1, 9.0, 2)
    assert conditions.growth == "uniaxial"
    assert (result["labels"], result["unknown"], result["pieces"]) == (40, 4, 2)
    files = sorted(path.name for path in (tmp_path / "gravity").glob("*"))
    assert files == (["uniaxial-004.parquet", "uniaxial-005.parquet"] if write else [])
    if write:
        table = read_table(tmp_path / "gravity" / files[1])
        drawn = draw("uniaxial", 20, gravity_dataset.SEEDS + 3 + 5)
        found = drawn.merge(table, on=FULL.names, suffixes=("", "_read"))
        assert len(found) == 20
        made = table.attrs["foldlab"]
        assert made["labels"] == 20 and made["core_seconds"] == 40.0 and made["version"] == "9"
        assert "growth=uniaxial --set first=5 --set size=20 --set timeout=9" in made["command"]


def test_too_few_doubts_are_filled_up_with_others(monkeypatch):
    monkeypatch.setattr(
        gravity_dataset, "_rod_doubts", lambda many, n: np.arange(len(many)) % (4 * n) == 3
    )
    near = near_boundary("uniaxial", 10, 3)
    many = gravity_dataset.SHEETS.sample(300, seed=500_003)
    # 3, 43, 83, … are doubtful, 8 of them; then the first that are not.
    rows = [*range(3, 300, 40), 0, 1]
    pd.testing.assert_frame_equal(near, many.iloc[rows].reset_index(drop=True))
