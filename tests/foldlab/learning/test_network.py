import warnings

import numpy as np
import pandas as pd
import pytest
import torch
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils.estimator_checks import parametrize_with_checks

from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.labels import timoshenko
from foldlab.learning.network import DissertationNetwork, SmoothNetwork

BOTH = pytest.mark.parametrize(
    "network",
    [SmoothNetwork(REDUCED, members=2), DissertationNetwork(REDUCED, epochs=6)],
    ids=lambda n: type(n).__name__,
)


def labelled(n, seed):
    X = REDUCED.sample(n, seed=seed)
    return X, np.asarray(timoshenko.folds(**X))


def batches_are_drawn(estimator):
    if isinstance(estimator, SmoothNetwork):
        return {}
    reason = "a design that stands twice falls into two batches"
    return {"check_sample_weight_equivalence_on_dense_data": reason}


@parametrize_with_checks(
    [SmoothNetwork(members=1, hidden=(4,)), DissertationNetwork(epochs=20, hidden=32)],
    expected_failed_checks=batches_are_drawn,
)
def test_is_a_scikit_learn_classifier(estimator, check):
    with warnings.catch_warnings():
        # The checks fit noise, a single epoch and vanishing data: warnings are right there.
        warnings.simplefilter("ignore", ConvergenceWarning)
        check(estimator)


def test_smooth_network_reaches_the_accuracy_that_we_promise_at_its_size():
    X, y = labelled(2000, 0)
    fresh, truth = labelled(50_000, 1)
    model = SmoothNetwork(REDUCED).fit(X, y)
    assert model.converged_
    assert np.mean(model.predict(fresh) == truth) > 0.994


def test_dissertation_network_has_the_layers_of_fig_4_27_and_learns():
    X, y = labelled(2000, 0)
    model = DissertationNetwork(REDUCED, epochs=20).fit(X, y)
    kinds = [type(layer).__name__ for layer in model.module_.members[0]]
    assert kinds == ["Linear", "ReLU", "Dropout", "Linear", "PReLU", "Linear"]
    assert model.module_.members[0][2].p == 0.2
    # 3·128 + 128, 128² + 128, the slope of PReLU, 128 + 1
    assert model.size_ == (512 + 16512 + 1 + 129, "weights")
    fresh, truth = labelled(20_000, 1)
    assert np.mean(model.predict(fresh) == truth) > 0.97


@BOTH
def test_columns_are_found_by_name_and_arrays_are_in_the_order_of_the_space(network):
    X, y = labelled(300, 3)
    model = clone(network).fit(X, y)
    expected = model.predict_proba(X)
    shuffled = X.assign(note="text")[["note", *reversed(REDUCED.names)]]
    assert np.array_equal(model.predict_proba(shuffled), expected)
    assert np.array_equal(model.predict_proba(X.to_numpy()), expected)
    assert list(model.feature_names_in_) == REDUCED.names
    assert np.allclose(expected.sum(1), 1, atol=1e-15)
    assert np.array_equal(model.predict(X), expected[:, 1] > 0.5)


def test_logs_are_taken_inside():
    X, y = labelled(400, 3)
    with_space = SmoothNetwork(REDUCED, members=1).fit(X, y)
    # By the same function: NumPy's rounds otherwise on some processors, and training turns a last
    # digit into another network.
    logs = torch.log10(torch.from_numpy(np.ascontiguousarray(X.to_numpy()))).numpy()
    assert np.allclose(logs, np.log10(X.to_numpy()), rtol=1e-13, atol=1e-15)
    plain = SmoothNetwork(members=1).fit(logs, y)
    assert np.allclose(with_space.decision_function(X), plain.decision_function(logs))


@BOTH
def test_same_seed_same_network_and_the_callers_torch_is_left_alone(network):
    X, y = labelled(300, 3)
    torch.manual_seed(5)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        state = torch.get_rng_state()
        first = clone(network).fit(X, y).predict_proba(X)
        assert torch.equal(torch.get_rng_state(), state)
        assert torch.get_num_threads() == 2
        torch.manual_seed(6)
        second = clone(network).fit(X, y).predict_proba(X)
        other = clone(network).set_params(random_state=1).fit(X, y).predict_proba(X)
    finally:
        torch.set_num_threads(threads)
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


@BOTH
def test_a_weight_on_false_positives_makes_fewer_of_them(network):
    X, y = labelled(600, 3)
    fresh, truth = labelled(20_000, 4)
    # The smooth network separates its labels: a weight acts on it through the penalty alone.
    smooth = isinstance(network, SmoothNetwork)
    calls = [
        clone(network)
        .set_params(false_positive_weight=w, epochs=1000 if smooth else 20)
        .fit(X, y)
        .predict(fresh)
        for w in (1.0, 100.0 if smooth else 4.0)
    ]
    plain, biased = (np.sum(call & ~truth) for call in calls)
    assert biased < 0.5 * plain
    assert np.sum(calls[1] & truth) > 0.8 * truth.sum()  # not by never saying yes


def test_training_in_two_parts_equals_training_at_once():
    X, y = labelled(300, 3)
    whole = DissertationNetwork(REDUCED, epochs=6).fit(X, y)
    parts = DissertationNetwork(REDUCED, epochs=2).fit(X, y).continue_fit(X, y, 4)
    assert np.array_equal(whole.predict_proba(X), parts.predict_proba(X))
    assert parts.n_epochs_ == 6 and len(parts.loss_curve_) == 6


def test_continued_training_starts_from_the_weights_and_keeps_the_scaling():
    X, y = labelled(300, 3)
    more, truth = labelled(600, 4)
    model = SmoothNetwork(REDUCED, members=2).fit(X, y)
    scale, before = model.module_.scale.clone(), model.n_epochs_
    cold = SmoothNetwork(REDUCED, members=2).fit(more, truth)
    model.continue_fit(more, truth, 3000)
    assert torch.equal(model.module_.scale, scale)
    assert model.n_labels_ == 600
    assert 0 < model.n_epochs_ - before < cold.n_epochs_
    assert model.loss_curve_[before] < cold.loss_curve_[0]


@BOTH
def test_designs_of_no_weight_do_not_count_and_equal_weights_change_nothing(network):
    X, y = labelled(300, 3)
    wrong = np.arange(300) % 3 == 0
    told = np.where(wrong, ~y, y)
    ignored = clone(network).fit(X, told, sample_weight=~wrong)
    kept = clone(network).fit(X[~wrong], y[~wrong])
    assert np.array_equal(ignored.predict_proba(X), kept.predict_proba(X))
    again = clone(network).fit(X, y, sample_weight=np.full(300, 7.0))
    assert np.array_equal(again.predict_proba(X), clone(network).fit(X, y).predict_proba(X))


@BOTH
def test_of_two_labels_of_a_design_the_heavier_is_learnt(network):
    X, y = labelled(200, 3)
    both, told = pd.concat([X, X]), np.concatenate([y, ~y])
    first = np.repeat([20.0, 1.0], len(y))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model = clone(network).set_params(epochs=30).fit(both, told, sample_weight=first)
        assert np.mean(model.predict(X) == y) > 0.8
        model.continue_fit(both, told, 60, sample_weight=first[::-1])
    assert np.mean(model.predict(X) == y) < 0.2


def test_bad_sample_weights_are_refused():
    X, y = labelled(50, 3)
    network = SmoothNetwork(REDUCED, members=1)
    for weights, message in ((np.ones(49), "49"), (-np.ones(50), "egative"), (0 * y, "zero")):
        with pytest.raises(ValueError, match=message):
            network.fit(X, y, sample_weight=weights)
    with pytest.raises(InputError, match="one class only"):
        network.fit(X, y, sample_weight=y)


def test_continued_training_refuses_a_new_class_and_no_epochs():
    X, y = labelled(100, 3)
    model = SmoothNetwork(REDUCED, members=1).fit(X, y.astype(int))
    model.continue_fit(X[y], np.ones(y.sum(), int), 3000)
    with pytest.raises(InputError, match="class 2 is new"):
        model.continue_fit(X, np.full(100, 2))
    with pytest.raises(InputError, match="epochs = 0"):
        model.continue_fit(X, y.astype(int), 0)


def test_unfinished_training_says_so():
    X, y = labelled(300, 3)
    with pytest.warns(ConvergenceWarning, match="not converged after 5 epochs"):
        model = SmoothNetwork(REDUCED, epochs=5).fit(X, y)
    assert not model.converged_
    with pytest.warns(ConvergenceWarning, match="no better than a constant"):
        DissertationNetwork(REDUCED, epochs=1, learning_rate=1e-9).fit(X, y)
    with pytest.raises(InputError, match="loss left the finite numbers in epoch"):
        DissertationNetwork(REDUCED, epochs=3, learning_rate=1e30).fit(X, y)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"false_positive_weight": 0.0}, "false_positive_weight = 0.0"),
        ({"epochs": 2.5}, "whole number"),
        ({"penalty": "much"}, "penalty = 'much'"),
        ({"hidden": (16, 0)}, "layer widths"),
    ],
)
def test_bad_settings_are_refused(settings, message):
    X, y = labelled(50, 3)
    with pytest.raises(InputError, match=message):
        SmoothNetwork(REDUCED, **settings).fit(X, y)


def test_bad_designs_and_labels_are_refused():
    X, y = labelled(50, 3)
    network = SmoothNetwork(REDUCED, members=1)
    with pytest.raises(InputError, match="lacks slenderness"):
        network.fit(X.drop(columns="slenderness"), y)
    with pytest.raises(InputError, match="must be above 0"):
        network.fit(X.assign(E_ratio=-1.0), y)
    with pytest.raises(InputError, match="one class only"):
        network.fit(X, np.ones(50, bool))
    with pytest.raises(InputError, match="50 designs and 49 labels"):
        network.fit(X, y[:49])
    with pytest.raises(InputError, match="unknown"):
        network.fit(X, pd.array([pd.NA, *y[1:]], dtype="boolean"))
    with pytest.raises(InputError, match="nan"):
        network.fit(X, y).predict(X.assign(h_ratio=np.nan))
