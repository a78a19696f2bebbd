"""Physics as inputs: columns, defaults, refusals, and every model with them."""

import numpy as np
import pytest
from sklearn.base import clone

from foldlab.datasets import load_dataset
from foldlab.design import FULL, PATTERNED, REDUCED
from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.rod import rod_of
from foldlab.learning.features import GroupFeatures
from foldlab.learning.models import make_classifier
from foldlab.learning.network import SmoothNetwork
from foldlab.learning.physics import PhysicsFeatures, default_inputs, features
from foldlab.learning.saving import load_model, save_model, space_of_model
from foldlab.learning.train import fit, train_on
from foldlab.tracking import track

QUICK = {
    "tree": {},
    "distilled": {"n_designs": 500, "teacher": "tree"},
    "forest": {"n_estimators": 5},
    "boosted": {"max_iter": 5},
    "network": {"members": 1},
    "dissertation": {"epochs": 3},
    "symbolic": {"seconds": 60.0, "generations": 15},
}


@pytest.fixture(scope="module")
def labels():
    table = load_dataset("gravity-5k")
    table["threshold"] = np.pi
    return table[(table["growth"] == "uniaxial") & table["foldable"].notna()]


def test_columns_are_the_groups_their_beams_and_the_rod():
    X = FULL.sample(30, seed=2)
    features = clone(PhysicsFeatures(FULL, rod=True)).fit(X)
    seen = dict(zip(features.get_feature_names_out(), features.transform(X).T, strict=True))
    groups = GroupFeatures(FULL).fit(X)
    for name, values in zip(groups.get_feature_names_out(), groups.transform(X).T, strict=True):
        np.testing.assert_array_equal(seen.pop(name), values)
    parts = beam.formulas(X).join(rod_of(X))
    for name in ("turning", "weight", "sag", "lift_off", "rod_error"):
        np.testing.assert_allclose(10 ** seen.pop(f"log10({name})"), parts[name])
    for name in ("net", "ratio", "rod"):
        np.testing.assert_allclose(np.sinh(seen.pop(f"arcsinh({name})")), parts[name])
    np.testing.assert_array_equal(seen.pop("edge"), parts["edge"])
    assert not seen
    plain = PhysicsFeatures(FULL).fit(X)
    assert not any("rod" in n.replace("rho", "") for n in plain.get_feature_names_out())
    assert plain.transform(X.to_numpy()).shape == (30, len(plain.get_feature_names_out()))


def test_physics_is_seen_wherever_it_can_be_computed():
    assert default_inputs(FULL) == default_inputs(PATTERNED) == "physics"
    assert default_inputs(REDUCED) == default_inputs(None) == "groups"
    assert isinstance(make_classifier("tree", FULL)[0], PhysicsFeatures)
    assert isinstance(make_classifier("tree", FULL, inputs="groups")[0], GroupFeatures)
    assert make_classifier("network", FULL).inputs == "physics"


@pytest.mark.parametrize(
    "space, inputs, message",
    [
        (REDUCED, "physics", "need rho_ratio, hinge_length, .* which the reduced space lacks"),
        (None, "rod", "which plain numbers lacks; take inputs 'groups'"),
        (PATTERNED, "rod", "solid layers only; take inputs 'physics' with strips"),
        (FULL, "magic", "inputs 'magic'; expected groups, physics, rod"),
    ],
)
@pytest.mark.parametrize("name", ["tree", "network", "symbolic"])
def test_inputs_that_a_space_cannot_give_are_refused(name, space, inputs, message):
    with pytest.raises(InputError, match=message):
        make_classifier(name, space, inputs=inputs)


@pytest.mark.parametrize("inputs", ["physics", "rod"])
@pytest.mark.parametrize("name", QUICK)
def test_every_model_sees_the_physics_before_and_after_saving(name, inputs, labels, tmp_path):
    train, test = labels.iloc[:300], labels.iloc[300:500]
    model = fit(name, FULL, train, seed=0, inputs=inputs, **QUICK[name])
    X = test[FULL.names]
    # None of them is as good with 300 labels from groups alone.
    assert (model.predict(X) == test["foldable"].astype(bool)).mean() > 0.93
    loaded, card = load_model(save_model(model, tmp_path / "m"))
    np.testing.assert_array_equal(loaded.predict_proba(X), model.predict_proba(X))
    assert card["space"] == "full" and space_of_model(loaded) == FULL
    # The order of the columns is the table's own affair.
    shuffled = X[X.columns[::-1]]
    np.testing.assert_array_equal(model.predict_proba(shuffled), model.predict_proba(X))


def test_an_exported_network_answers_from_the_columns_of_the_physics(labels, tmp_path):
    import torch

    X = labels[FULL.names].head(200)
    model = SmoothNetwork(FULL, members=1, inputs="physics").fit(X, labels["foldable"].head(200))
    save_model(model, tmp_path / "m")
    program = torch.export.load(tmp_path / "m" / "network.pt2").module()
    columns = PhysicsFeatures(FULL).fit(X).transform(X)
    logits = program(torch.tensor(columns)).detach().numpy()
    np.testing.assert_allclose(logits, model.decision_function(X), rtol=1e-9)


def test_a_formula_of_sags_is_for_the_signed_margin(labels):
    few = labels.head(300)
    assert fit("symbolic", FULL, few, seed=0, seconds=1.0).margin
    angles = few["normalised_angle"].abs() + 0.1
    rising = few.assign(normalised_angle=angles, foldable=angles > np.pi)
    model = fit("symbolic", FULL, rising, seed=0, seconds=1.0)
    assert not model.margin
    assert (model.regressor_.predict(model._seen(few[FULL.names])) > 0).all()


def test_train_says_which_inputs_it_took(labels):
    _, card = train_on(labels.head(400), "tree", seed=0)
    assert card["inputs"] == "physics"
    _, card = train_on(labels.head(400), "tree", seed=0, options={"inputs": "groups"})
    assert card["inputs"] == "groups"


@pytest.mark.parametrize("inputs", ["physics", "rod"])
def test_a_formula_of_physics_is_defined_in_designs_that_no_label_is_near(inputs, labels):
    # log(ratio) fits well, and has no value where a soft layer's ends take all of its turning.
    some = labels[beam.formulas(labels)["ratio"].to_numpy() > 0.02].head(200)
    model = fit("symbolic", FULL, some, seed=0, inputs=inputs, seconds=60.0, generations=15)
    fresh = FULL.sample(1000, seed=77)
    assert (beam.formulas(fresh)["ratio"] < 0).any()
    assert np.isfinite(model.predict_proba(fresh)).all()


def test_a_network_of_physics_is_tracked(labels, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    X = labels[FULL.names].head(60)
    network = SmoothNetwork(FULL, members=1, epochs=40, inputs="physics", rtol=0.1)
    with track("physics", {}) as run:
        run.model("network", network.fit(X, labels["foldable"].head(60)), X.head(3))
    assert list((tmp_path / "mlruns").rglob("*.pt2"))


def test_the_rod_is_asked_only_where_it_was_wanted():
    assert [features(FULL, name).rod for name in ("rod", "physics", None)] == [True, False, False]
