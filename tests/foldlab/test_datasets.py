"""The datasets that come with foldlab: what they hold, and that they hold together."""

import numpy as np
import pandas as pd
import pytest

from foldlab.datasets import FOLDER, card, datasets, load_dataset
from foldlab.design import FULL, PATTERNED
from foldlab.errors import InputError
from foldlab.labels.foldability import Thresholds
from foldlab.learning.train import fit, known_labels, train_on
from foldlab.tables import write_table


@pytest.fixture(scope="module")
def gravity():
    return load_dataset("gravity-5k")


def test_it_says_how_it_was_made_and_is_small(gravity):
    made = gravity.attrs["foldlab"]
    assert made["labels"] == len(gravity) > 1000
    assert made["core_seconds"] == pytest.approx(gravity["core_seconds"].sum(), rel=1e-3)
    assert {"command", "commit", "machine", "versions"} <= set(made)
    assert (FOLDER / "gravity-5k.parquet").stat().st_size < 5e6


def test_designs_are_sheets_of_the_full_space_and_stand_once(gravity):
    FULL.validate(gravity)
    assert gravity["slenderness"].between(1e-3, 3e-2).all()
    assert not gravity.duplicated([*FULL.names, "growth"]).any()
    assert set(gravity["growth"]) == {"uniaxial", "isotropic"}


def test_tags_follow_from_the_measures_and_verdicts_from_the_tags(gravity):
    seen = gravity[gravity["m1"].notna()]
    thresholds = Thresholds()
    tags = [thresholds.tags(row, row["contraction"]) for row in seen.to_dict("records")]
    # Measures were rounded to single precision, so a tag may differ on the threshold itself.
    for name in ("F1", "F2", "F3", "F4"):
        assert np.mean(seen[name].astype(bool) == [t[name] for t in tags]) > 0.999
    known = seen[seen["foldable"].notna()]
    whole = known[["F1", "F2", "F3", "F4"]].astype(bool).all(axis=1)
    assert (known["foldable"].astype(bool) == whole).all()


def test_every_label_has_a_reason_and_every_known_one_an_error(gravity):
    assert (gravity["reason"].str.len() > 10).all()
    known = gravity["foldable"].notna()
    error = gravity.loc[known, "error_estimate"]
    assert error.notna().all() and (error >= 0).all()
    assert gravity.loc[~gravity["foldable"].notna(), "reason"].str.contains("unknown|Exc").all()


def test_more_weight_folds_less(gravity):
    light = gravity["stiffness_to_weight"] > 1
    share = gravity["foldable"].astype("Float64").groupby(light).mean()
    assert share[True] > share[False] + 0.2


def test_a_model_trains_on_it_and_unknown_labels_are_counted(gravity):
    part = gravity[gravity["growth"] == "uniaxial"].head(400)
    _, card = train_on(part, "tree", seed=0)
    assert card["unknown"] == part["foldable"].isna().sum()
    assert card["holdout_accuracy"] > max(0.7, part["foldable"].mean())


def test_a_formula_learns_from_it_though_sagging_units_have_no_positive_angle(gravity):
    part = gravity[gravity["growth"] == "uniaxial"].head(300).copy()
    # A source may also know that a design does not fold and state no angle.
    grounded = part.index[part["outcome"] == "grounded"][0]
    part.loc[grounded, "normalised_angle"] = np.nan
    assert (part["normalised_angle"] < 0).any()
    part["threshold"] = np.pi
    model = fit("symbolic", FULL, part, seed=0, seconds=2.0)
    assert model.threshold == np.pi
    known = part[part["foldable"].notna()]
    right = model.predict(known[FULL.names]) == known["foldable"].astype(bool)
    assert right.mean() > known["foldable"].astype(bool).mean()


def test_growths_are_not_mixed_in_training(gravity):
    with pytest.raises(InputError, match="5000 labels of uniaxial growth and 195 labels of isotr"):
        train_on(gravity, "tree", seed=0)
    with pytest.raises(InputError, match="growth='uniaxial'"):
        known_labels(gravity, FULL)


def test_an_unknown_name_is_told_what_there_is():
    assert "gravity-5k" in datasets()
    with pytest.raises(InputError, match=r"no dataset 'weight'; there are: .*gravity-5k"):
        load_dataset("weight")
    assert isinstance(load_dataset("gravity-5k"), pd.DataFrame)


@pytest.fixture
def pieces(tmp_path, monkeypatch):
    """A dataset of two pieces, one per growth."""
    monkeypatch.setattr("foldlab.datasets.FOLDER", tmp_path)
    (tmp_path / "made").mkdir()
    for growth, n, commit in (("uniaxial", 4, "abc"), ("isotropic", 2, "def")):
        table = pd.DataFrame({
            "growth": growth,
            "part": (["test", "train", "validation", "train"] * 2)[:n],
            "drawn": "hypercube",
            "foldable": pd.array([True, None, False, True][:n], dtype="boolean"),
            "outcome": ["folds", "timeout", "sags", "folds"][:n],
            "error_estimate": [0.01, None, 0.03, 0.02][:n],
            "core_seconds": [1.0, 30.0, 2.0, 1.0][:n],
        })  # fmt: skip
        made = {"commit": commit, "labels": n, "core_seconds": table["core_seconds"].sum()}
        table.attrs["foldlab"] = made | {"version": "11"}
        write_table(table, tmp_path / "made" / f"{growth}-000.parquet")


def test_a_dataset_in_pieces_is_one_table(pieces):
    table = load_dataset("made")
    assert datasets() == ["made"] and len(table) == 6 and list(table.index) == list(range(6))
    made = table.attrs["foldlab"]
    assert made["labels"] == 6 and made["core_seconds"] == 34.0 + 31.0
    assert made["commit"] == "def, abc" and made["version"] == "11" and len(made["pieces"]) == 2


def test_its_parts_and_growths_can_be_asked_for(pieces):
    train = load_dataset("made", growth="uniaxial", part="train")
    assert list(train["outcome"]) == ["timeout", "folds"] and list(train.index) == [0, 1]
    assert train.attrs["foldlab"]["labels"] == 6  # of the whole
    with pytest.raises(InputError, match="growth 'both' is not in the dataset made; it has: iso"):
        load_dataset("made", growth="both")
    with pytest.raises(InputError, match="part 'validation' is not in the dataset made; it has: t"):
        load_dataset("made", growth="isotropic", part="validation")


def test_a_dataset_without_strips_says_so(pieces):
    assert len(load_dataset("made", space="full")) == 6
    with pytest.raises(InputError, match="space 'patterned' is not in the dataset made; it has: f"):
        load_dataset("made", space="patterned")


def test_solid_layers_and_strips_can_be_asked_for():
    table = load_dataset("gravity", growth="uniaxial")
    solid, cut = (
        load_dataset("gravity", growth="uniaxial", space=space) for space in ("full", "patterned")
    )
    assert len(solid) == (table["strips"] == 0).sum() and "strip_share" not in solid
    assert len(cut) == len(table) - len(solid) > 0
    PATTERNED.validate(cut)
    assert list(solid.index) == list(range(len(solid)))


def test_pieces_are_told_as_one_command(pieces, tmp_path):
    for k in range(1, 4):
        table = pd.DataFrame({"growth": "uniaxial", "foldable": [True], "core_seconds": [1.0]})
        table.attrs["foldlab"] = {"command": f"make --set first={k} --set size=1", "labels": 1}
        (tmp_path / "more").mkdir(exist_ok=True)
        write_table(table, tmp_path / "more" / f"p-{k}.parquet")
    assert load_dataset("more").attrs["foldlab"]["command"] == "make --set first=1…3 --set size=1"


def test_a_dataset_without_parts_says_so():
    with pytest.raises(InputError, match="part 'test' is not in the dataset gravity-5k; it has: n"):
        load_dataset("gravity-5k", part="test")


def test_its_card_counts_what_it_holds(pieces):
    text = card("made")
    assert "## uniaxial: 4 labels" in text and "## isotropic: 2 labels" in text
    assert "folds: 2, does not: 1, unknown: 1 (25.0 %); timeout: 1" in text
    assert "median 1.50, mean 8.50" in text and "median 0.02, 90 % below 0.028" in text
    assert "parts: test 1, train 2, validation 1" in text
    assert "- commit: def, abc" in text and "Licence: MIT" in text and "version 11" in text
    assert "pieces" not in text


def test_the_growing_dataset_is_one_version_split_once():
    table = load_dataset("gravity")
    assert len(set(table["version"].str.split("-").str[0])) == 1
    FULL.validate(table)
    assert not table.duplicated([*FULL.names, "strips", "growth"]).any()
    cube = table["drawn"] == "hypercube"
    assert set(table["part"][~cube]) == {"train"}
    assert set(table["part"][cube]) == {"train", "validation", "test"}
    # As many of each kind as a card can be held to.
    uniaxial = table[table["growth"] == "uniaxial"]
    assert uniaxial["foldable"].isna().mean() < 0.02
    made = table.attrs["foldlab"]
    assert made["labels"] == len(table) and "gravity_dataset" in made["command"]
    for path in (FOLDER / "gravity").glob("*.parquet"):
        assert path.stat().st_size < 5e6
