import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom
from sklearn.base import clone
from sklearn.utils.estimator_checks import parametrize_with_checks

from foldlab.design import FULL, REDUCED
from foldlab.errors import InputError
from foldlab.labels import timoshenko
from foldlab.learning.features import GroupFeatures, as_labels
from foldlab.learning.models import MODELS, make_classifier
from foldlab.learning.scoring import clopper_pearson, model_size, score, upper_bound

SMALL = {
    "tree": {},
    "distilled": {"n_designs": 4000},
    "forest": {"n_estimators": 20},
    "boosted": {"max_iter": 40},
    "network": {"members": 1},
    "dissertation": {"epochs": 15},
}
EVERY = pytest.mark.parametrize("name", SMALL)


def labelled(n, seed):
    X = REDUCED.sample(n, seed=seed)
    return X, np.asarray(timoshenko.folds(**X))


class Says:
    """Answers what it was told to."""

    classes_ = np.array([False, True])

    def __init__(self, answers):
        self.answers = np.asarray(answers, bool)

    def predict(self, X):
        return np.resize(self.answers, len(X))


def pipeline_keeps_fitted_steps(estimator):
    if isinstance(estimator, GroupFeatures):
        return {}
    reason = "scikit-learn's Pipeline fits its steps in place"
    checks = ("check_estimators_overwrite_params", "check_dont_overwrite_parameters")
    return dict.fromkeys(checks, reason)


@parametrize_with_checks(
    [GroupFeatures(), make_classifier("tree", None)],
    expected_failed_checks=pipeline_keeps_fitted_steps,
)
def test_is_a_scikit_learn_estimator(estimator, check):
    check(estimator)


def test_features_are_logs_of_groups_products_and_ratios():
    X = pd.DataFrame({"E_ratio": [100.0], "h_ratio": [0.1], "slenderness": [0.01]})
    features = GroupFeatures(REDUCED, pairs=True).fit(X)
    values = dict(zip(features.get_feature_names_out(), features.transform(X)[0], strict=True))
    assert values == pytest.approx(
        {
            "log10(E_ratio)": 2,
            "log10(h_ratio)": -1,
            "log10(slenderness)": -2,
            "log10(E_ratio*h_ratio)": 1,
            "log10(E_ratio/h_ratio)": 3,
            "log10(E_ratio*slenderness)": 0,
            "log10(E_ratio/slenderness)": 4,
            "log10(h_ratio*slenderness)": -3,
            "log10(h_ratio/slenderness)": 1,
        }
    )


def test_linear_groups_pass_and_names_decide():
    X = FULL.sample(5, seed=0)
    features = GroupFeatures(FULL).fit(X)
    values = features.transform(X[FULL.names[::-1]].assign(more=1))
    names = list(features.get_feature_names_out())
    assert np.array_equal(values[:, names.index("contraction")], X["contraction"])
    assert np.array_equal(values[:, names.index("log10(aspect)")], np.log10(X["aspect"]))
    assert np.array_equal(features.transform(X.to_numpy()), values)


@EVERY
def test_every_model_learns_and_is_seeded(name):
    X, y = labelled(1500, 0)
    fresh, truth = labelled(5000, 1)
    model = make_classifier(name, REDUCED, seed=3, **SMALL[name]).fit(X, y)
    assert 3 in model.get_params().values()  # the seed arrives, even where only ties feel it
    probability = model.predict_proba(fresh)
    assert list(model.classes_) == [False, True]
    assert np.mean(model.predict(fresh) == truth) > 0.94
    assert np.mean((probability[:, 1] > 0.5) == truth) > 0.94
    again = make_classifier(name, REDUCED, seed=3, **SMALL[name]).fit(X, y)
    assert np.array_equal(again.predict_proba(fresh[::-1])[::-1], probability)
    size, unit = model_size(model)
    assert size > 30 and unit in ("nodes", "weights")


@EVERY
def test_every_model_takes_a_weight_on_false_positives(name):
    X, y = labelled(1000, 0)
    fresh, truth = labelled(20_000, 1)

    def false_positives(weight):
        model = make_classifier(name, REDUCED, false_positive_weight=weight, **SMALL[name])
        folds = model.fit(X, y).predict(fresh)
        assert np.mean(folds[truth]) > 0.8
        return np.sum(folds & ~truth)

    assert false_positives(10.0) < 0.85 * false_positives(1.0)
    with pytest.raises(InputError, match="false_positive_weight"):
        make_classifier(name, REDUCED, false_positive_weight=-1.0, **SMALL[name]).fit(X, y)


def test_the_tree_reaches_its_accuracy_and_distillation_betters_it():
    X, y = labelled(4000, 0)
    fresh, truth = labelled(50_000, 1)
    accuracies = {}
    for name, options in (("tree", {}), ("distilled", {"n_designs": 15_000})):
        model = make_classifier(name, REDUCED, **options).fit(X, y)
        accuracies[name] = np.mean(model.predict(fresh) == truth)
    assert accuracies["tree"] > 0.964
    assert accuracies["distilled"] > 0.98
    assert model.agreement_ > 0.99
    # The further designs are asked of the teacher, not of the source: the labels are X, y alone.
    assert not hasattr(model, "teacher_")


def test_sizes_are_counted():
    X, y = labelled(400, 0)
    tree = make_classifier("tree", REDUCED).fit(X, y)
    assert model_size(tree) == (tree[-1].tree_.node_count, "nodes")
    forest = make_classifier("forest", REDUCED, n_estimators=3).fit(X, y)
    assert model_size(forest)[0] == sum(t.tree_.node_count for t in forest[-1].estimators_)
    boosted = make_classifier("boosted", REDUCED, max_iter=3).fit(X, y)
    assert model_size(boosted) == (3 * (2 * 8 - 1), "nodes")  # 8 leaves have 7 inner nodes
    with pytest.raises(InputError, match="Says does not state its size"):
        model_size(Says([True]))


def test_score_counts_and_rates():
    truth = np.array([True] * 6 + [False] * 4)
    result = score(Says([1, 1, 1, 1, 0, 0, 1, 0, 0, 0]), np.zeros((10, 3)), truth)
    counts = {k: result[k] for k in ("n", "tp", "fn", "fp", "tn")}
    assert counts == {"n": 10, "tp": 4, "fn": 2, "fp": 1, "tn": 3}
    assert result["accuracy"] == 0.7
    assert result["recall"] == pytest.approx(4 / 6)
    assert result["precision"] == 0.8
    assert result["false_positive_rate"] == 0.25
    assert result["accuracy_interval"] == clopper_pearson(7, 10)
    assert result["false_positive_rate_interval"] == clopper_pearson(1, 4)
    assert result["false_positive_rate_upper"] == upper_bound(1, 4)
    assert 0 < result["seconds_per_million"] < 10


def test_score_without_trials_is_none_and_bad_tables_are_refused():
    only = score(Says([False]), np.zeros((3, 3)), [True] * 3)
    assert only["precision"] is only["false_positive_rate"] is None
    assert only["false_positive_rate_interval"] is only["false_positive_rate_upper"] is None
    with pytest.raises(InputError, match="3 designs and 2 labels"):
        score(Says([True]), np.zeros((3, 3)), [True, False])
    with pytest.raises(InputError, match="1 of 3 labels are unknown"):
        score(Says([True]), np.zeros((3, 3)), pd.array([True, None, False], dtype="boolean"))


@pytest.mark.parametrize(("k", "n"), [(0, 20), (1, 20), (7, 50), (50, 50)])
def test_interval_inverts_the_binomial_tails(k, n):
    low, high = clopper_pearson(k, n)
    if k > 0:  # P(at least k | low) = 2.5 %
        assert binom.sf(k - 1, n, low) == pytest.approx(0.025)
    if k < n:  # P(at most k | high) = 2.5 %
        assert binom.cdf(k, n, high) == pytest.approx(0.025)
        assert binom.cdf(k, n, upper_bound(k, n)) == pytest.approx(0.05)
    assert low <= k / n <= high
    assert (low == 0) == (k == 0) and (high == 1) == (k == n)


@pytest.mark.parametrize(("k", "n"), [(3, 2), (-1, 5), (0, 0)])
def test_impossible_counts_are_refused(k, n):
    with pytest.raises(InputError, match="hits"):
        clopper_pearson(k, n)
    with pytest.raises(InputError, match="hits"):
        upper_bound(k, n)


def test_labels_are_yes_or_no():
    assert as_labels([1, 0, True]).tolist() == [True, False, True]
    assert as_labels(pd.Series([True, False], dtype="boolean")).dtype == bool
    assert as_labels(["yes", "No "]).tolist() == [True, False]
    with pytest.raises(InputError, match="contain maybe"):
        as_labels(["yes", "maybe"])
    with pytest.raises(InputError, match="contain 2"):
        as_labels([0, 1, 2])


def test_the_distilled_tree_keeps_the_names_of_two_classes():
    X, y = labelled(300, 0)
    told = {"classes": ("flat", "folds"), "words": ("no", "yes")}
    options = {"teacher": "tree", "n_designs": 1000}
    plain = make_classifier("distilled", REDUCED, **options).fit(X, y)
    for names in told.values():
        named = make_classifier("distilled", REDUCED, **options).fit(X, np.where(y, *names[::-1]))
        assert list(named.classes_) == list(names)
        assert np.array_equal(named.predict_proba(X), plain.predict_proba(X))
        assert np.array_equal(named.predict(X) == names[1], plain.predict(X))
    with pytest.raises(InputError, match="hold 3 classes, a, b, c"):
        make_classifier("distilled", REDUCED).fit(X[:3], ["a", "b", "c"])
    with pytest.raises(InputError, match="1 of 3 labels are unknown"):
        make_classifier("distilled", REDUCED).fit(X[:3], ["a", "b", None])


def test_unknown_models_and_options_are_refused_by_name():
    assert set(MODELS) >= set(SMALL)
    with pytest.raises(InputError, match=r"no model 'oracle'; there are: .*tree.*dissertation"):
        make_classifier("oracle", REDUCED)
    with pytest.raises(InputError, match=r"'tree' has no setting 'depth'; it has: .*max_depth, "):
        make_classifier("tree", REDUCED, depth=3)
    with pytest.raises(InputError, match=r"'symbolic' has no setting 'second'; .*seconds, th"):
        make_classifier("symbolic", REDUCED, second=3)
    with pytest.raises(InputError, match="constraints = 3; give its fields, such as seconds"):
        make_classifier("symbolic", REDUCED, constraints=3)
    for name in SMALL:
        with pytest.raises(InputError, match=f"'{name}' has no setting 'random_state'; it has"):
            make_classifier(name, REDUCED, random_state=3)
        with pytest.raises(InputError, match="false_positive_weight = 'a'; give a finite number"):
            make_classifier(name, REDUCED, false_positive_weight="a").fit(*labelled(50, 0))
    with pytest.raises(InputError, match="criterion"):
        make_classifier("tree", REDUCED, criterion="oracle")
    with pytest.raises(InputError, match=r"'network' has no setting 'layers'; .*hidden, "):
        make_classifier("network", REDUCED, layers=3)
    with pytest.raises(InputError, match="needs a space"):
        clone(make_classifier("distilled", None)).fit(np.eye(2), [0, 1])


def test_bad_designs_are_refused():
    X, y = labelled(50, 0)
    tree = make_classifier("tree", REDUCED).fit(X, y)
    with pytest.raises(InputError, match="lacks E_ratio"):
        tree.predict(X[["h_ratio", "slenderness"]])
    with pytest.raises(InputError, match="must be above 0"):
        tree.predict(X.assign(slenderness=0.0))
    with pytest.raises(InputError, match=r"shape \(50, 2\)"):
        tree.predict(X.to_numpy()[:, :2])
    with pytest.raises(InputError, match="pairs=True without a space"):
        GroupFeatures(pairs=True).fit(X)
