"""What networks minimise, by the formulas of their docstrings, and what a saved one keeps."""

import warnings
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.special import expit
from sklearn.exceptions import ConvergenceWarning

from foldlab.design import FULL, REDUCED
from foldlab.errors import InputError
from foldlab.labels import timoshenko
from foldlab.learning import network, saving
from foldlab.learning.models import MODELS, make_classifier
from foldlab.learning.network import DissertationNetwork, SmoothNetwork
from foldlab.learning.saving import load_model, save_model
from foldlab.learning.symbolic.engines import Constraints
from foldlab.learning.symbolic.formula import Formula


def labelled(n, seed):
    X = REDUCED.sample(n, seed=seed)
    return X, np.asarray(timoshenko.folds(**X))


def fitted(model, *given, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return model.fit(*given, **options)


def cross_entropy(p, t, w, share=None):
    """− Σ s [t log p + w (1 − t) log(1 − p)] / Σ s [t + w (1 − t)]."""
    share = np.ones(len(t)) if share is None else share
    weight = share * np.where(t, 1.0, w)
    return -(weight * np.where(t, np.log(p), np.log1p(-p))).sum() / weight.sum()


@pytest.mark.parametrize("w", [1.0, 5.0])
@pytest.mark.parametrize("weighed", [False, True])
def test_a_smooth_network_minimises_cross_entropy_and_the_squares_of_its_weights(w, weighed):
    X, t = labelled(120, 3)
    share = np.linspace(0.5, 3.0, 120) if weighed else None
    model = SmoothNetwork(
        REDUCED, members=3, hidden=(5,), penalty=1e-2, epochs=99, rtol=1e-3, false_positive_weight=w
    )
    fitted(model, X, t, sample_weight=share)
    logs = torch.tensor(np.log10(X.to_numpy()))
    inputs = model.module_.standardise(logs)
    losses, odds = [], []
    for member in model.module_.members:
        odds.append(member(inputs)[:, 0].detach().numpy())
        size = sum(float((p.detach() ** 2).sum()) for p in member.parameters() if p.ndim == 2)
        losses.append(cross_entropy(expit(odds[-1]), t, w, share) + 1e-2 * size)
    # Each member's last value, whichever took longer; answers are the mean of their log-odds.
    assert model.loss_curve_[-1] == pytest.approx(np.mean(losses), rel=1e-9)
    assert model.n_epochs_ == len(model.loss_curve_) < 99 and model.n_labels_ == 120
    np.testing.assert_allclose(model.decision_function(X), np.mean(odds, axis=0), rtol=1e-12)
    # Scaled to mean 0 and variance 1 of the designs as they are weighed.
    share = np.ones(120) if share is None else share
    scaled = inputs.numpy()
    np.testing.assert_allclose(np.average(scaled, axis=0, weights=share), 0, atol=1e-12)
    np.testing.assert_allclose(np.average(scaled**2, axis=0, weights=share), 1, rtol=1e-9)


def test_the_dissertation_s_network_tells_the_mean_loss_of_all_designs_of_an_epoch():
    # At next to no learning rate all batches, the last one smaller, see the same network.
    X, t = labelled(100, 3)
    model = DissertationNetwork(
        REDUCED, epochs=2, learning_rate=1e-12, dropout=0.0, false_positive_weight=3.0
    )
    fitted(model, X, t)
    p = model.predict_proba(X)[:, 1]
    assert model.loss_curve_ == pytest.approx([cross_entropy(p, t, 3.0)] * 2, rel=1e-4)


def test_a_group_that_never_varies_does_no_harm():
    X, t = labelled(60, 3)
    model = fitted(SmoothNetwork(members=1, epochs=5), np.column_stack([X, np.full(60, 7.0)]), t)
    assert (
        model.module_.scale[-1] == 1 and np.isfinite(model.decision_function(np.ones((2, 4)))).all()
    )


def test_many_designs_are_answered_piece_by_piece(monkeypatch):
    X, t = labelled(60, 3)
    model = fitted(SmoothNetwork(REDUCED, members=1, epochs=5), X, t)
    whole = model.decision_function(X)
    monkeypatch.setattr(network, "CHUNK", 7)
    np.testing.assert_allclose(model.decision_function(X), whole, rtol=1e-12)


def test_a_member_has_converged_where_an_iteration_lowers_its_loss_by_less_than_asked():
    X, t = labelled(60, 3)
    model = SmoothNetwork(REDUCED, members=1, hidden=(4,), penalty=1e-2, rtol=1e-3).fit(X, t)
    drops = [a - b for a, b in pairwise(model.loss_curve_)]
    assert model.loss_curve_[0] < 1  # above, it would be the fraction
    assert model.converged_ and drops[-1] < 1e-3 <= min(drops[:-1])


@pytest.mark.parametrize(
    ("model", "name", "allowed", "refused"),
    [
        (DissertationNetwork, "dropout", [0.0, 0.99], [1.0, -0.01, "a"]),
        (DissertationNetwork, "hidden", [1], [0, 2.0]),
        (DissertationNetwork, "batch_size", [1], [0]),
        (DissertationNetwork, "learning_rate", [1e-9], [0.0, np.inf]),
        (SmoothNetwork, "hidden", [(1,), [2, 1]], [(), (0,), 3]),
        (SmoothNetwork, "members", [1], [0]),
        (SmoothNetwork, "rtol", [1e-9], [0.0, np.inf]),
        (SmoothNetwork, "penalty", [1e-9], [0.0]),
        (SmoothNetwork, "epochs", [1], [0]),
    ],
)
def test_settings_are_taken_up_to_their_bounds(model, name, allowed, refused):
    for value in allowed:
        model(**{name: value})._check_settings()
    for value in refused:
        with pytest.raises(InputError, match=f"{name} = "):
            model(**{name: value})._check_settings()


# -- other models ----------------------------------------------------------------------------------


@pytest.mark.parametrize("w", [1.0, 2.0])
def test_leaves_of_a_biased_tree_can_be_mixed(w):
    X, t = labelled(400, 0)
    tree = make_classifier("tree", REDUCED, false_positive_weight=w, ccp_alpha=0.0).fit(X, t)
    inner = tree[-1].tree_
    least = inner.n_node_samples[inner.children_left < 0].min()
    assert (least >= 10) == (w != 1)


@pytest.mark.parametrize("name", sorted(set(MODELS) - {"symbolic"}))
def test_no_model_is_biased_unless_it_is_told_to_be(name):
    plain, told, biased = (
        make_classifier(name, REDUCED, **weight)
        for weight in ({}, {"false_positive_weight": 1.0}, {"false_positive_weight": 2.0})
    )
    assert repr(plain) == repr(told) != repr(biased)


def test_boosting_uses_all_labels_and_trees():
    X, t = labelled(400, 0)
    model = make_classifier("boosted", REDUCED, max_iter=7).fit(X, t)
    assert model[-1].n_iter_ == 7 and not model[-1].early_stopping


def test_a_distilled_tree_learns_labels_and_its_teacher_s_answers_with_one_bias(monkeypatch):
    X, t = labelled(200, 0)
    made, tree = [], MODELS["tree"]
    monkeypatch.setitem(MODELS, "tree", lambda *a, **k: made.append((a, k)) or tree(*a, **k))
    model = make_classifier(
        "distilled", REDUCED, teacher="tree", n_designs=500, ccp_alpha=0.0, seed=4,
        false_positive_weight=3.0,
    )  # fmt: skip
    model.fit(X, t)
    taught = [(a, k) for a, k in made if k]
    assert [a[:2] for a, _ in taught] == [(REDUCED, 4)] * 2
    assert [k for _, k in taught] == [
        {"false_positive_weight": 3.0}, {"false_positive_weight": 3.0, "ccp_alpha": 0.0},
    ]  # fmt: skip
    assert model.tree_[-1].tree_.n_node_samples[0] == 700
    assert 0.9 < model.agreement_ <= 1 and model.n_features_in_ == 3


def test_limits_of_a_search_are_options_of_the_symbolic_model():
    model = make_classifier("symbolic", REDUCED, seed=5, seconds=2.0, max_size=9, threshold=3.0)
    limits = model.constraints
    assert (limits.seed, limits.seconds, limits.max_size, model.threshold) == (5, 2.0, 9, 3.0)
    given = Constraints(seed=8, max_depth=3)
    limits = make_classifier(
        "symbolic", REDUCED, seed=5, constraints=given, seconds=2.0
    ).constraints
    assert (limits.seed, limits.max_depth, limits.seconds) == (8, 3, 2.0)


# -- saved -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [SmoothNetwork, DissertationNetwork])
def test_a_saved_network_keeps_its_settings_its_past_and_its_draws(kind, tmp_path):
    X, t = labelled(80, 3)
    options = {"hidden": (6, 3), "members": 1} if kind is SmoothNetwork else {"hidden": 6}
    model = kind(REDUCED, epochs=3, false_positive_weight=2.0, random_state=7, **options)
    fitted(model, X, t)
    loaded, card = load_model(save_model(model, tmp_path / "m"))
    mine, its = loaded.get_params(deep=False), model.get_params(deep=False)
    assert mine == its and card["model"] == kind.__name__
    assert (loaded.n_labels_, loaded.n_epochs_, loaded.n_features_in_) == (80, model.n_epochs_, 3)
    assert loaded.classes_.dtype == model.classes_.dtype and loaded.loss_curve_ == model.loss_curve_
    # Adam's moments start anew; batches and dropout are drawn as they would have been.
    model.optimizer_ = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for network_ in (model, loaded):
            network_.continue_fit(X, t, 2)
    np.testing.assert_array_equal(loaded.predict_proba(X), model.predict_proba(X))


def test_a_saved_formula_keeps_its_threshold_its_width_and_all_errors(tmp_path):
    trees = "E_ratio", ("*", 2.0, "E_ratio")
    front = [
        (error, Formula(tree, tuple(REDUCED.names)))
        for error, tree in zip((0.5, 0.25), trees, strict=True)
    ]
    model = make_classifier("symbolic", REDUCED, threshold=3.0).restore(front, 1, 0.4)
    loaded, card = load_model(save_model(model, tmp_path / "m"))
    assert loaded.threshold == card["state"]["threshold"] == 3.0 and loaded.scale_ == 0.4
    assert loaded.front_["error"].tolist() == [0.5, 0.25]
    assert loaded.front_["size"].tolist() == [1, 3]
    # A design on the threshold folds; one below by half a width does so with less than a half.
    at = REDUCED.sample(3, seed=0).assign(E_ratio=[1.5, 1.5 * np.exp(-0.2), 1.4999])
    assert loaded.predict(at).tolist() == [True, False, False]
    assert loaded.predict_proba(at)[:2, 1] == pytest.approx([0.5, expit(-0.5)])
    scope = {}
    exec((tmp_path / "m" / "formula.py").read_text(), scope)
    (function,) = (f for name, f in scope.items() if callable(f) and not name.startswith("_"))
    assert function(2.0, 1.0, 1.0) == 4.0


@pytest.mark.parametrize(
    ("value", "plain"),
    [
        (np.float64("nan"), None), (-np.inf, None), (np.int64(3), 3), (np.bool_(True), True),
        ((1, [2.0, np.array([3, 4])]), [1, [2.0, [3, 4]]]),
        ({1: {"a": np.nan}}, {"1": {"a": None}}),
        (Path("a/b"), "a/b"), (None, None), ("text", "text"), (np.array(2.5), 2.5),
    ],
)  # fmt: skip
def test_metadata_is_plain_json(value, plain):
    found = saving._plain(value)
    assert found == plain and type(found) is type(plain)


def test_a_space_comes_back_with_its_bounds_and_scales():
    for space in (None, REDUCED, FULL.with_bounds(contraction=(0.1, 0.2))):
        assert saving.space_from_json(saving.space_to_json(space)) == space
