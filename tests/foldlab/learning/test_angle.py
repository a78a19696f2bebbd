"""The fold angle as a number: what is learnt is what the first answer has wrong."""

import numpy as np
import pytest
from sklearn.base import clone

from foldlab.datasets import load_dataset
from foldlab.design import FULL, REDUCED
from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.rod import rod_of
from foldlab.learning.models import AngleRegressor
from foldlab.learning.saving import load_model, save_model, space_of_model
from foldlab.learning.scoring import angle_errors
from foldlab.learning.train import fit_angle, train_on


@pytest.fixture(scope="module")
def labels():
    table = load_dataset("gravity-5k")
    return table[table["growth"] == "uniaxial"].head(700)


@pytest.fixture(scope="module")
def parts(labels):
    known = labels[labels["foldable"].notna()]
    return known.iloc[:450], known.iloc[450:]


class Says:
    def __init__(self, angles):
        self.angles = np.asarray(angles)

    def predict(self, X):
        return self.angles


@pytest.mark.parametrize("inputs, most", [("groups", 0.6), ("physics", 0.06), ("rod", 0.015)])
def test_physics_makes_angles_of_few_labels_accurate(inputs, most, parts):
    train, test = parts
    model = fit_angle(FULL, train, seed=0, inputs=inputs)
    errors = angle_errors(model, test[FULL.names], test["fold_angle"])
    assert errors["folding_median"] < most
    assert errors["n"] == len(test)
    if inputs != "groups":
        assert errors["accuracy"] > 0.95
        assert (model.predict(test[FULL.names]) < -0.05).any()  # what sags turns the other way


def test_where_the_rod_is_right_nothing_is_added_to_it():
    X, fresh = FULL.sample(60, seed=0), FULL.sample(30, seed=1)
    model = AngleRegressor(FULL, inputs="rod", max_iter=20)
    model.fit(X, rod_of(X)["rod"] * np.pi * X["contraction"])
    told = model.predict(fresh) / (np.pi * fresh["contraction"])
    np.testing.assert_allclose(told, rod_of(fresh)["rod"], rtol=1e-9, atol=1e-9)


def test_beams_that_are_right_stop_at_a_full_turn_and_on_the_ground():
    X, fresh = FULL.sample(200, seed=0), FULL.sample(100, seed=1)

    def stopped(designs):
        need = np.pi * designs["contraction"]
        return np.clip(beam.formulas(designs)["net"] * need, 0, 2 * np.pi)

    model = clone(AngleRegressor(FULL, max_iter=20)).fit(X, stopped(X))
    np.testing.assert_allclose(model.predict(fresh), stopped(fresh), rtol=1e-9, atol=1e-9)
    assert 0 < (stopped(fresh) == 0).sum() < 100 and (stopped(fresh) == 2 * np.pi).any()


def test_errors_are_relative_to_the_angle_or_to_what_is_needed():
    X = FULL.sample(4, seed=0).assign(contraction=1 / np.pi)  # 1 rad is needed
    told, known = [2.2, 0.1, -0.2, 1.2], [2.0, 0.2, 0.1, 0.8]
    errors = angle_errors(Says(told), X, known)
    assert errors["error_median"] == pytest.approx(np.median([0.1, 0.1, 0.3, 0.4]))
    assert errors["error_90"] == pytest.approx(np.quantile([0.1, 0.1, 0.3, 0.4], 0.9))
    assert errors["folding_median"] == pytest.approx(0.1)
    assert errors["accuracy"] == 0.75
    assert angle_errors(Says(told), X, [0.0] * 4)["folding_median"] is None


def test_a_saved_regressor_answers_as_before(parts, tmp_path):
    train, test = parts
    model = fit_angle(FULL, train, seed=0, max_iter=20)
    loaded, card = load_model(save_model(model, tmp_path / "m"))
    np.testing.assert_array_equal(loaded.predict(test[FULL.names]), model.predict(test[FULL.names]))
    assert space_of_model(loaded) == FULL and card["classes"] is None
    assert (tmp_path / "m" / "model.skops").stat().st_size < 100_000
    with pytest.raises(InputError, match="not fitted"):
        save_model(AngleRegressor(FULL), tmp_path / "n")


def test_training_keeps_labels_aside_and_counts_those_without_an_angle(labels):
    model, card = train_on(labels, "angle", seed=0, options={"max_iter": 20})
    unknown = int(labels["foldable"].isna().sum())
    assert unknown > 0 and card["without_angle"] == unknown
    assert card["labels"] + card["holdout_n"] == len(labels) - unknown
    assert card["inputs"] == "physics" and card["size"] == model.size_[0] > 0
    assert card["holdout_error_median"] < 0.1
    # What `foldlab predict` asks a model for.
    assert card["task"] == "angle" and set(card["bounds"]) == set(FULL.names)
    assert card["bounds"]["contraction"][1] <= labels["contraction"].max()


@pytest.mark.parametrize(
    "options, message",
    [
        ({"rate": 0.01}, "no probability"),
        ({"coverage": 0.9}, "no probability"),
        ({"options": {"depth": 3}}, "no setting 'depth'; it has: inputs, max_iter"),
        ({"options": {"max_iter": -1}}, "'max_iter' parameter"),
        ({"options": {"inputs": "magic"}}, "inputs 'magic'; expected groups, physics, rod"),
        ({"holdout": 0.999}, "a training of 20 need more"),
    ],
)
def test_what_an_angle_cannot_be_asked_is_refused(labels, options, message):
    with pytest.raises(InputError, match=message):
        train_on(labels.head(60), "angle", seed=0, **options)


def test_tables_and_spaces_without_angles_are_refused(labels):
    with pytest.raises(InputError, match="no column fold_angle"):
        train_on(labels.drop(columns="fold_angle"), "angle", seed=0)
    with pytest.raises(InputError, match="no design in the table has a fold angle"):
        train_on(labels.assign(fold_angle=np.nan), "angle", seed=0)
    X = REDUCED.sample(30, seed=0)
    with pytest.raises(InputError, match="reduced space have no contraction"):
        AngleRegressor(REDUCED).fit(X, np.ones(30))
    X = FULL.sample(30, seed=0)
    with pytest.raises(InputError, match="1 of 30 fold angles are no numbers"):
        AngleRegressor(FULL).fit(X, np.append(np.ones(29), np.nan))
