"""How the dataset's designs are drawn: reproducibly, split once, near the boundary where asked."""

import numpy as np
import pandas as pd
import pytest

from experiments import gravity_dataset
from experiments.gravity_dataset import draw, near_boundary
from foldlab.design import FULL, PATTERNED
from foldlab.labels.rod import RodSource
from foldlab.tables import write_table


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
    assert (draw("isotropic", 10, 3)["strips"] == 0).all()


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
