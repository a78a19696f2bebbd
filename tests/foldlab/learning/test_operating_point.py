import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import beta

from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.labels import timoshenko
from foldlab.learning.models import make_classifier
from foldlab.learning.operating_point import (
    at_rate,
    choose_threshold,
    loss_weight_curve,
    negatives_needed,
    threshold_curve,
    with_threshold,
)
from foldlab.learning.plots import plot_trade_off
from foldlab.learning.scoring import clopper_pearson, score, upper_bound


def labelled(n, seed):
    X = REDUCED.sample(n, seed=seed)
    return X, np.asarray(timoshenko.folds(**X))


class Identity:
    """The first column is the probability."""

    classes_ = np.array([False, True])

    def predict_proba(self, X):
        p = np.asarray(X, float)[:, 0]
        return np.column_stack([1 - p, p])


def column(values):
    return np.asarray(values, float)[:, None]


@pytest.fixture(scope="module")
def network():
    return make_classifier("network", REDUCED, members=2).fit(*labelled(2000, 0))


def test_negatives_needed_is_where_zero_false_positives_just_suffice():
    # ln(0.05) / ln(0.999) = 2994.2
    assert negatives_needed(0.001) == 2995
    for rate in (0.3, 0.05, 0.01):
        n = negatives_needed(rate)
        assert upper_bound(0, n) <= rate < upper_bound(0, n - 1)


def test_threshold_passes_as_many_false_positives_as_the_bound_allows():
    negatives = np.linspace(0, 0.9, 1000)
    positives = np.linspace(0.5, 1, 500)
    X = column([*negatives, *positives])
    y = np.repeat([False, True], [1000, 500])
    point = choose_threshold(Identity(), X, y, rate=0.02)
    passed = np.sum(negatives >= point.threshold)
    assert passed == point.false_positives > 0
    assert point.upper == upper_bound(passed, 1000) <= 0.02 < upper_bound(passed + 1, 1000)
    assert negatives[-passed - 1] < point.threshold <= negatives[-passed]
    assert point.recall == np.mean(positives >= point.threshold)
    assert (point.negatives, point.labels) == (1000, 1500)


def test_tied_probabilities_are_passed_or_stopped_together():
    X = column([0.2] * 900 + [0.8] * 100 + [0.9] * 10)
    y = np.repeat([False, True], [1000, 10])
    point = choose_threshold(Identity(), X, y, rate=0.02)
    assert point.false_positives == 0 and point.recall == 1


def test_the_bound_holds_as_often_as_it_says():
    rng = np.random.default_rng(0)
    broken = 0
    for _ in range(400):
        negatives = rng.random(200)  # uniform: the true rate above t is 1 − t
        X, y = column([*negatives, 1]), np.array([False] * 200 + [True])
        broken += 1 - choose_threshold(Identity(), X, y, rate=0.05).threshold > 0.05
    # 5 % of 400 = 20 expected at most; 34 would come by chance once in a thousand.
    allowed = next(k for k in range(200) if upper_bound(k + 1, 200) > 0.05)
    assert beta.sf(0.05, allowed + 1, 200 - allowed) <= 0.05
    assert 3 <= broken <= 34


def test_exactly_as_many_negatives_as_needed_are_enough():
    n = negatives_needed(0.05)
    X, y = column([*np.linspace(0, 0.5, n), 1]), np.array([False] * n + [True])
    point = choose_threshold(Identity(), X, y, rate=0.05)
    assert (point.negatives, point.false_positives, point.recall) == (n, 0, 1)
    with pytest.raises(InputError, match=f"needs at least {n} of them"):
        choose_threshold(Identity(), X[1:], y[1:], rate=0.05)


def test_too_few_negatives_say_how_many_are_needed(network):
    X, y = labelled(500, 5)
    with pytest.raises(InputError, match=r"needs at least 2995 of them \(here about [78]\d\d\d"):
        choose_threshold(network, X, y, rate=0.001)
    with pytest.raises(InputError, match="expected both between 0 and 1"):
        choose_threshold(network, X, y, rate=0.0)
    with pytest.raises(InputError, match="500 designs and 499 labels"):
        choose_threshold(network, X, y[:-1], rate=0.1)


def test_a_model_that_is_certain_and_wrong_has_no_threshold():
    X, y = column([1.0] * 50 + [0.1] * 150 + [1.0]), np.array([False] * 200 + [True])
    with pytest.raises(InputError, match="50 of 200 non-folding designs probability 1"):
        choose_threshold(Identity(), X, y, rate=0.05)


def test_stated_rate_holds_on_untouched_designs_at_high_recall(network):
    X, y = labelled(4000, 5)
    model, point = at_rate(network, X, y, rate=0.004)
    fresh, truth = labelled(100_000, 6)
    result = score(model, fresh, truth)
    plain = score(network, fresh, truth)
    assert point.labels == 4000 and point.upper <= 0.004
    assert result["false_positive_rate_upper"] <= 0.004 < plain["false_positive_rate"]
    assert result["recall"] > 0.97
    assert np.array_equal(
        model.predict(fresh), network.predict_proba(fresh)[:, 1] >= point.threshold
    )


def test_threshold_is_a_probability(network):
    X, _ = labelled(50, 7)
    certain = network.predict_proba(X)[:, 1] >= 1
    assert np.array_equal(with_threshold(network, 1).predict(X), certain)
    assert with_threshold(network, 0).predict(X).all()
    with pytest.raises(InputError, match=r"threshold = 1.5"):
        with_threshold(network, 1.5)


def test_threshold_curve_agrees_with_scores_and_falls(network):
    X, y = labelled(5000, 7)
    curve = threshold_curve(network, X, y, points=40)
    assert (np.diff(curve["threshold"]) > 0).all()
    assert (np.diff(curve["false_positive_rate"]) <= 0).all()
    assert (np.diff(curve["recall"]) <= 0).all()
    middle = curve[curve["threshold"] == 0.5].iloc[0]
    for row in (middle, curve.iloc[len(curve) // 2], curve.iloc[5]):
        result = score(with_threshold(network, row["threshold"]), X, y)
        for name in ("false_positive_rate", "recall", "precision", "accuracy"):
            assert row[name] == pytest.approx(result[name])
        interval = result["false_positive_rate_interval"]
        assert (row["false_positive_rate_low"], row["false_positive_rate_high"]) == interval
    with pytest.raises(InputError, match="one class only"):
        threshold_curve(network, X[y], y[y])


def test_threshold_curve_counts_designs_on_the_threshold_as_passing():
    curve = threshold_curve(Identity(), column([0.5, 0.2, 0.5, 0.9]), [False, False, True, True])
    row = curve[curve["threshold"] == 0.5].iloc[0]
    assert (row["false_positive_rate"], row["recall"]) == (0.5, 1)


def test_loss_weights_trade_recall_for_fewer_false_positives():
    X, y = labelled(800, 0)
    fresh, truth = labelled(20_000, 1)

    def make(**bias):
        return make_classifier("network", REDUCED, members=1, **bias)

    curve = loss_weight_curve(make, X, y, fresh, truth, weights=(1, 100))
    assert curve["weight"].tolist() == [1, 100]
    assert curve["false_positive_rate"][1] < 0.5 * curve["false_positive_rate"][0]
    assert curve["recall"][1] < curve["recall"][0]
    rate = curve["false_positive_rate"][0]
    negatives = int(np.sum(~truth))
    assert (curve["false_positive_rate_low"][0], curve["false_positive_rate_high"][0]) == (
        clopper_pearson(round(rate * negatives), negatives)
    )
    with pytest.raises(InputError, match="no weights"):
        loss_weight_curve(make, X, y, fresh, truth, weights=())


def test_plot_shows_both_curves_and_the_point(network, tmp_path):
    X, y = labelled(3000, 7)
    curve = threshold_curve(network, X, y, points=30)
    weights = curve.iloc[5:8].assign(weight=[1.0, 3.0, 10.0])
    figure = plot_trade_off(curve, weights, point=score(network, X, y), rate=0.01)
    assert isinstance(figure, Figure)
    axes = figure.axes[0]
    drawn = {line.get_label(): line for line in axes.get_lines()}
    assert set(drawn) == {"threshold bias", "loss bias", "stated rate 1.0%", "chosen point"}
    assert np.array_equal(drawn["loss bias"].get_ydata(), 1 - weights["recall"])
    assert len(drawn["threshold bias"].get_xdata()) > 5
    assert axes.get_xscale() == axes.get_yscale() == "log"
    figure.savefig(tmp_path / "trade_off.png")


def test_a_rate_that_is_the_bound_itself_is_kept():
    rate = upper_bound(2, 60)
    negatives = np.linspace(0, 0.9, 60)
    X, y = column([*negatives, 0.95]), np.array([False] * 60 + [True])
    point = choose_threshold(Identity(), X, y, rate=rate)
    assert point.false_positives == 2 and point.upper == rate
    assert choose_threshold(Identity(), X, y, rate=rate * (1 - 1e-9)).false_positives == 1


def test_those_that_are_as_certain_as_the_most_certain_are_counted():
    X, y = column([1.0, 1.0, *[0.2] * 98, 1.0]), np.array([False] * 100 + [True])
    with pytest.raises(InputError, match="gives 2 of 100 non-folding designs probability 1, 0 are"):
        choose_threshold(Identity(), X, y, rate=0.03)


@pytest.mark.parametrize(("rate", "confidence"), [(1.0, 0.9), (0.0, 0.9), (0.1, 1.0), (0.1, 0.0)])
def test_rates_and_confidences_lie_between_0_and_1(rate, confidence):
    X, y = column([0.1] * 90 + [0.9]), np.array([False] * 90 + [True])
    with pytest.raises(InputError, match="expected both between 0 and 1"):
        choose_threshold(Identity(), X, y, rate=rate, confidence=confidence)


def test_no_designs_have_no_threshold():
    with pytest.raises(InputError, match="0 designs and 0 labels; expected one label per design"):
        threshold_curve(Identity(), column([]), np.array([], dtype=bool))


def test_the_rows_of_loss_weights_are_scores_of_models_that_were_trained_with_them():
    class Weighted(Identity):
        def __init__(self, false_positive_weight):
            self.weight = false_positive_weight

        def fit(self, X, y):
            return self

        def predict(self, X):
            return np.asarray(X, float)[:, 0] >= self.weight / 10

    X, y = column([0.1, 0.3, 0.5, 0.2, 0.6, 0.7, 0.8]), np.array([False] * 3 + [True] * 4)
    curve = loss_weight_curve(Weighted, X, y, X, y, weights=(2, 4)).set_index("weight")
    for weight, (fp, tp) in {2.0: (2, 4), 4.0: (1, 3)}.items():
        row = curve.loc[weight]
        assert row["false_positive_rate"] == fp / 3 and row["recall"] == tp / 4
        assert row["precision"] == tp / (tp + fp) and row["accuracy"] == (tp + 3 - fp) / 7
        low, high = clopper_pearson(fp, 3)
        assert row["false_positive_rate_low"] == low and row["false_positive_rate_high"] == high
