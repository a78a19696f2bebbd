"""Regime maps and their pictures."""

import numpy as np
import pandas as pd
import pytest

from foldlab.design import FULL, REDUCED
from foldlab.errors import InputError
from foldlab.labels.label import Label, ask
from foldlab.labels.timoshenko import FULL_TURN, TimoshenkoSource, normalised_angle
from foldlab.learning.features import probability_of_folding
from foldlab.learning.plots import pareto_mask, plot_learning_curves, plot_pareto
from foldlab.maps.plots import COLOURS, plot_regimes
from foldlab.maps.regimes import Verdict, regime_map
from foldlab.plots import save_figure

SOURCE = TimoshenkoSource()
SMALL = {"points": 9 * 20**2, "source": SOURCE}


class Oracle:
    """A classifier that knows Eq. 4.26 with its threshold multiplied by ``factor``."""

    def __init__(self, factor=1.0, classes=(False, True)):
        self.factor, self.classes_ = factor, np.array(classes)

    def predict_proba(self, designs):
        angle = normalised_angle(designs["E_ratio"], designs["h_ratio"], designs["slenderness"])
        p = (angle >= self.factor * FULL_TURN).astype(float)
        return np.column_stack([1 - p, p] if self.classes_[1] else [p, 1 - p])

    def predict(self, designs):
        return self.classes_[self.predict_proba(designs).argmax(axis=1)]


class Slow:
    """One label at a time; unknown for thick active layers, failing for stiff ones."""

    name, version = "slow", "1"

    def label(self, design):
        if design["E_ratio"] > 100:
            raise RuntimeError("diverged")
        foldable = None if design["h_ratio"] > 5 else SOURCE.label(design).foldable
        return Label(design, foldable, "so")


def test_default_map_is_the_dissertations():
    regime = regime_map(Oracle(), source=SOURCE)
    assert regime.points >= 100_000
    assert np.allclose(regime.slices, 10.0 ** np.arange(-3, -0.99, 0.25), rtol=1e-12)
    assert regime.predicted.shape == (9, len(regime.y_values), len(regime.x_values))
    assert regime.counts["false_positive"] == regime.counts["false_negative"] == 0
    assert regime.counts["true_positive"] > 0 < regime.counts["true_negative"]
    assert regime.accuracy == 1.0 and regime.false_positive_rate == 0.0 and regime.recall == 1.0
    assert sum(regime.counts.values()) == regime.points


@pytest.mark.parametrize(
    ("factor", "wrong", "absent"),
    [(0.5, "FALSE_POSITIVE", "false_negative"), (2.0, "FALSE_NEGATIVE", "false_positive")],
)
def test_shifted_classifier_errs_exactly_between_the_two_boundaries(factor, wrong, absent):
    regime = regime_map(Oracle(factor), **SMALL)
    s, h, E = np.meshgrid(regime.slices, regime.y_values, regime.x_values, indexing="ij")
    angle = normalised_angle(E, h, s) / FULL_TURN
    between = (angle >= min(1, factor)) & (angle < max(1, factor))
    assert between.any()
    assert np.array_equal(regime.verdicts == Verdict[wrong], between)
    assert regime.counts[absent] == 0
    n = regime.counts
    negatives = n["false_positive"] + n["true_negative"]
    assert regime.false_positive_rate == n["false_positive"] / negatives
    assert regime.slice_counts[wrong.lower()].to_list() == between.sum(axis=(1, 2)).tolist()


def test_axes_may_be_any_pair_in_any_order():
    regime = regime_map(
        Oracle(),
        axes=("slenderness", "E_ratio"),
        slice_by="h_ratio",
        slices=[4.0, 0.2],
        points=800,
        source=SOURCE,
    )
    assert regime.slices.tolist() == [4.0, 0.2]
    assert regime.x_values.min() > 1e-3 and regime.x_values.max() < 1e-1
    k, j, i = 0, 3, 15
    value = normalised_angle(regime.y_values[j], 4.0, regime.x_values[i])
    assert regime.margin[k, j, i] == pytest.approx(np.log(value / FULL_TURN), rel=1e-12)


def test_full_space_holds_the_other_groups_and_gives_the_model_its_own_columns():
    seen = []

    class Model(Oracle):
        feature_names_in_ = np.array(["E_ratio", "h_ratio", "slenderness"])

        def predict_proba(self, designs):
            seen.append(list(designs.columns))
            return super().predict_proba(designs)

    fixed = dict.fromkeys(("rho_ratio", "aspect", "stiffness_to_weight"), 0.5)
    fixed |= {"hinge_length": 0.2, "hinge_width": 0.5, "contraction": 0.3}
    regime = regime_map(Model(), space=FULL, fixed=fixed, points=900, source=TimoshenkoSource(FULL))
    assert seen == [["E_ratio", "h_ratio", "slenderness"]] * 2
    # F1 asks κ l_i/g ≥ π where the model asks κ l_s/g ≥ 2π: only false positives at l_i = l_s/5.
    assert regime.counts["false_positive"] > 0 == regime.counts["false_negative"]


def test_unknown_labels_are_a_fifth_verdict_and_count_nowhere_else():
    regime = regime_map(Oracle(), points=9 * 8**2, source=Slow())
    h, E = np.meshgrid(regime.y_values, regime.x_values, indexing="ij")
    unknown = np.broadcast_to((h > 5) | (E > 100), regime.predicted.shape)
    assert 0 < unknown.sum() < unknown.size
    assert np.array_equal(regime.verdicts == Verdict.UNKNOWN, unknown)
    assert regime.accuracy == 1.0
    assert regime.margin is None
    label = ask(Slow(), pd.DataFrame({"E_ratio": [999.0], "h_ratio": 1.0, "slenderness": 0.01}))[0]
    assert label.foldable is None and "diverged" in label.reason


def test_a_source_may_say_unknown_as_nan():
    class Partial:
        name, version = "partial", "1"

        def evaluate(self, designs):
            truth = SOURCE.evaluate(designs)["foldable"].astype(object)
            return pd.DataFrame({"foldable": truth.where(designs["h_ratio"] < 1, np.nan)})

    regime = regime_map(Oracle(), points=900, source=Partial())
    assert regime.counts["unknown"] == (regime.y_values >= 1).mean() * regime.points


def test_nothing_known_gives_no_rates():
    class Silent:
        name, version = "silent", "1"

        def label(self, design):
            return Label(design, None, "no idea")

    regime = regime_map(Oracle(), points=9, source=Silent())
    assert regime.accuracy is regime.false_positive_rate is regime.recall is None
    assert plot_regimes(regime).get_suptitle().count("undefined") == 3


def test_threshold_moves_the_decision_and_class_order_is_respected():
    class Graded(Oracle):
        def predict_proba(self, designs):
            p = np.linspace(0, 1, len(designs))
            return np.column_stack([1 - p, p])

    assert regime_map(Graded(), points=900, threshold=0.9).predicted.mean() == pytest.approx(0.1)

    class Leaves(Oracle):
        """Like a tree, which gives a few probabilities only."""

        def predict_proba(self, designs):
            p = np.where(designs["E_ratio"] > 1, 0.75, 0.25)
            return np.column_stack([1 - p, p])

    # Eq. 4.31: a design at the threshold folds.
    assert regime_map(Leaves(), points=900, threshold=0.75).predicted.mean() == pytest.approx(0.5)
    designs = REDUCED.sample(200, seed=0)
    p = probability_of_folding(Oracle(), designs)
    assert 0 < p.mean() < 1
    assert np.array_equal(probability_of_folding(Oracle(classes=(1, 0)), designs), p)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"axes": ("E_ratio", "E_ratio")}, "more than once"),
        ({"axes": ("E_ratio", "nonsense")}, "no group 'nonsense'"),
        ({"slice_by": "h_ratio", "axes": ("E_ratio", "slenderness"), "slices": [20]}, "outside"),
        ({"slices": [np.nan]}, "nan"),
        ({"slices": []}, "0 slices"),
        ({"points": 0}, "0 points"),
        ({"threshold": 2.0}, "between 0 and 1"),
        ({"space": FULL}, "neither axis, slice nor fixed"),
    ],
)
def test_bad_requests_are_named(options, words):
    with pytest.raises(InputError, match=words):
        regime_map(Oracle(), **options)


def test_bad_classifiers_are_named():
    class Gaps(Oracle):
        def predict_proba(self, designs):
            return np.full((len(designs), 2), np.nan)

    with pytest.raises(InputError, match="not numbers"):
        regime_map(Gaps(), points=9)
    with pytest.raises(InputError, match="class 'no'"):
        regime_map(Oracle(classes=("no", "yes")), points=9)
    with pytest.raises(InputError, match="no predict_proba"):
        regime_map(object(), points=9)
    with pytest.raises(InputError, match="not validated"):
        _ = regime_map(Oracle(), points=9).verdicts


def test_picture_shows_each_verdict_in_its_colour_panel_by_panel():
    regime = regime_map(Oracle(0.5), points=9 * 30**2, source=SOURCE)
    points = SOURCE.evaluate(REDUCED.sample(30, seed=2)).astype({"foldable": "boolean"})
    points.loc[3, "foldable"] = pd.NA
    figure = plot_regimes(regime, points=points)
    panels = figure.get_axes()
    assert [ax.get_title() for ax in panels][:2] == [
        "$h_s/l_s = 10^{-3}$",
        "$h_s/l_s = 10^{-2.75}$",
    ]
    assert panels[0].get_xscale() == panels[0].get_yscale() == "log"
    shown = sum(len(line.get_xdata()) for ax in panels for line in ax.get_lines())
    assert shown == len(points)
    texts = [t.get_text() for t in figure.legends[0].get_texts()]
    assert any(t.startswith("false positive (") for t in texts)
    assert "boundary of timoshenko" in texts and "verified: unknown" in texts
    mesh = panels[4].collections[0]
    assert np.array_equal(np.asarray(mesh.get_array()), regime.verdicts[4])
    colour = mesh.cmap(mesh.norm(int(Verdict.FALSE_POSITIVE)))
    assert (
        "#{:02X}{:02X}{:02X}".format(*(round(255 * c) for c in colour[:3]))
        == (COLOURS[Verdict.FALSE_POSITIVE])
    )
    predicted = plot_regimes(regime, validated=False)
    assert "predicted to fold" in predicted.legends[0].get_texts()[0].get_text()
    assert set(np.unique(predicted.get_axes()[0].collections[0].get_array())) <= {0, 1}


def test_verified_points_stand_on_the_slice_nearest_on_the_group_s_own_scale():
    regime = regime_map(Oracle(), points=9, slices=[1e-3, 1e-1])
    # Nearer to 1e-3 by their difference, to 1e-1 by their ratio.
    near = {1.2e-3: 0, 9e-3: 0, 1.1e-2: 1, 4e-2: 1}
    points = pd.DataFrame({"E_ratio": 1.0, "h_ratio": 1.0, "slenderness": list(near)})
    points["foldable"] = True
    shown = plot_regimes(regime, points=points).get_axes()
    counts = [sum(len(line.get_xdata()) for line in ax.get_lines()) for ax in shown[:2]]
    assert counts == [list(near.values()).count(k) for k in (0, 1)]


def test_figures_are_written_whole_or_not_at_all(tmp_path):
    figure = plot_regimes(regime_map(Oracle(), points=900))
    for ending in ("png", "pdf", "svg"):
        assert save_figure(figure, tmp_path / f"map.{ending}").stat().st_size > 1000
    before = sorted(tmp_path.iterdir())
    old = (tmp_path / "map.png").read_bytes()

    class Broken:
        def savefig(self, path):
            path.write_bytes(b"half")
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        save_figure(Broken(), tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes() == old
    assert sorted(tmp_path.iterdir()) == before
    with pytest.raises(InputError, match="change the ending"):
        save_figure(figure, tmp_path / "map.txt")
    with pytest.raises(InputError, match="no folder"):
        save_figure(figure, tmp_path / "absent" / "map.png")


def test_pareto_front_holds_what_nothing_beats():
    seconds, accuracy = [1, 2, 3, 2, np.nan, 1], [0.9, 0.95, 0.94, 0.95, 1.0, 0.8]
    assert pareto_mask(seconds, accuracy).tolist() == [True, True, False, True, False, False]
    both_small = pareto_mask([1, 2, 3], [3, 3, 1], maximise=(False, False))
    assert both_small.tolist() == [True, False, True]
    table = pd.DataFrame({"seconds": seconds, "accuracy": accuracy, "name": list("abcdef")})
    ax = plot_pareto(table, "seconds", "accuracy", labels="name").get_axes()[0]
    assert sorted(t.get_text() for t in ax.texts) == ["a", "b", "d"]
    with pytest.raises(InputError, match="expected rows with"):
        plot_pareto(table, "seconds", "speed")


def test_learning_curves_show_median_and_spread():
    accuracy = {0: 0.90, 1: 0.96, 2: 0.92}
    curves = pd.DataFrame(
        [
            {"strategy": s, "seed": k, "labels": n, "accuracy": a + (0.02 if n > 100 else 0)}
            for s in ("augmentation", "random")
            for k, a in accuracy.items()
            for n in (200, 100)
        ]
    )
    ax = plot_learning_curves(curves, target=0.93).get_axes()[0]
    line = next(li for li in ax.get_lines() if li.get_label().startswith("augmentation"))
    assert np.allclose(line.get_xydata(), [[100, 0.92], [200, 0.94]])
    band = ax.collections[0].get_paths()[0].vertices
    assert band[:, 1].min() == pytest.approx(0.90) and band[:, 1].max() == pytest.approx(0.98)
    with pytest.raises(InputError, match="strategy"):
        plot_learning_curves(curves.drop(columns="strategy"))
