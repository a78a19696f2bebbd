"""What stands in the picture of a regime map: counts, rates, ticks and panels."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from foldlab.design import FULL, REDUCED
from foldlab.errors import InputError
from foldlab.labels.label import Label
from foldlab.maps import plots
from foldlab.maps.plots import COLOURS, plot_regimes
from foldlab.maps.regimes import Verdict, held_in_the_middle, regime_map, to_verify


class Stiff:
    """Folds from E_ratio = 1 on."""

    classes_ = np.array([False, True])

    def predict_proba(self, designs):
        p = (designs["E_ratio"].to_numpy() >= 1).astype(float)
        return np.column_stack([1 - p, p])

    def predict(self, designs):
        return designs["E_ratio"].to_numpy() >= 1


class Source:
    """Labels and margins: folds from h_ratio = 1 on, and in slices of h_s/l_s ≥ 0.05 always."""

    name, version = "source", "1"

    def evaluate(self, designs):
        thick = designs["slenderness"] > 0.05
        margin = np.where(thick, 1.0, np.log(designs["h_ratio"]))
        return pd.DataFrame({"foldable": margin >= 0, "margin": margin})


def a_map(**options):
    return regime_map(Stiff(), points=3 * 20**2, slices=[1e-3, 1e-2, 1e-1], **options)


def test_panels_stand_in_a_square_and_only_outer_ones_have_labels():
    figure = plot_regimes(a_map())
    shown = [ax for ax in figure.get_axes() if ax.get_visible()]
    assert len(figure.get_axes()) == 4 and len(shown) == 3
    assert [ax.get_title() for ax in shown] == [f"$h_s/l_s = 10^{{{e}}}$" for e in (-3, -2, -1)]
    # The second has nothing below it, the first has the third.
    assert [bool(ax.get_xlabel()) for ax in shown] == [False, True, True]
    assert [bool(ax.get_ylabel()) for ax in shown] == [True, False, True]
    numbered = [ax.xaxis.get_tick_params()["labelbottom"] for ax in shown]
    assert numbered == [False, True, True]


def test_the_source_s_boundary_is_drawn_where_it_is():
    figure = plot_regimes(a_map(source=Source()))
    panels = figure.get_axes()[:3]
    # Beside the picture there are lines in the slices that the boundary crosses.
    assert [len(ax.collections) for ax in panels] == [2, 2, 1]
    (line,) = panels[0].collections[1].get_paths()
    assert np.abs(line.vertices[:, 1] - 1.0).max() < 0.05
    texts = [t.get_text() for t in figure.legends[0].get_texts()]
    assert texts[-1] == "boundary of source"
    assert "boundary" not in plot_regimes(a_map()).legends[0].get_texts()[-1].get_text()


@pytest.mark.parametrize(
    ("margin", "crosses"),
    [([1, 2], False), ([-1, -2], False), ([-1, 2], True), ([np.nan, np.nan], False),
     ([np.nan, -1, 1], True), ([0, 1], False)],
)  # fmt: skip
def test_a_boundary_lies_where_the_margin_changes_its_sign(margin, crosses):
    assert plots._crosses_zero(np.array(margin, float)) is crosses


def test_the_legend_and_the_title_count_what_is_shown():
    regime = a_map(source=Source())
    figure = plot_regimes(regime)
    n = regime.counts
    told = [t.get_text() for t in figure.legends[0].get_texts()]
    names = [v for v in Verdict if v is not Verdict.UNKNOWN]
    assert told[:4] == [f"{v.name.lower().replace('_', ' ')} ({n[v.name.lower()]})" for v in names]
    assert not any("unknown" in text for text in told)
    rates = regime.accuracy, regime.false_positive_rate, regime.recall
    percent = [f"{100 * rate:.2f} %" for rate in rates]
    assert figure.get_suptitle() == (
        f"1\u2009200 designs: accuracy {percent[0]}, false-positive rate {percent[1]}, "
        f"recall {percent[2]}"
    )
    assert plots._count(1234567) == "1\u2009234\u2009567"
    predicted = plot_regimes(regime, validated=False)
    assert predicted.get_suptitle() == "1\u2009200 designs, 50.00 % predicted to fold"
    told = [t.get_text() for t in predicted.legends[0].get_texts()]
    assert told[:2] == ["predicted to fold (600)", "predicted not to fold (600)"]
    assert len(set(COLOURS.values())) == len(Verdict)
    with pytest.raises(InputError):
        plot_regimes(a_map(), validated=True)


def test_groups_that_are_held_stand_above_the_title():
    fixed = dict.fromkeys(set(FULL.names) - {"E_ratio", "h_ratio", "slenderness"}, 0.25)
    regime = regime_map(Stiff(), space=FULL, fixed=fixed, points=100, slices=[0.01])
    held, title = plot_regimes(regime).get_suptitle().split("\n")
    assert "$b_s/l_s = 0.25$" in held and title.endswith("predicted to fold")
    assert plot_regimes(a_map(), title="mine").get_suptitle() == "mine"


@pytest.mark.parametrize(
    ("bounds", "ticks", "labels"),
    [
        # Six decades: every third has its number, four of them every second.
        ((1e-3, 1e3), 10.0 ** np.arange(-3, 4), ["-3", "", "", "0", "", "", "3"]),
        ((1e-2, 1e2), 10.0 ** np.arange(-2, 3), ["-2", "", "0", "", "2"]),
        ((2e-3, 3e1), 10.0 ** np.arange(-2, 2), ["-2", "", "", "1"]),
    ],
)
def test_long_logarithmic_axes_have_few_numbers(bounds, ticks, labels):
    ax = Figure().subplots()
    space = REDUCED.with_bounds(E_ratio=bounds)
    regime = SimpleNamespace(x="E_ratio", y="h_ratio", space=space)
    plots._scale_axes(ax, regime, numbers=True)
    assert ax.get_xlim() == pytest.approx(bounds) and ax.get_xscale() == "log"
    np.testing.assert_allclose(ax.get_xticks(), ticks)
    told = [t.get_text() for t in ax.get_xticklabels()]
    assert told == [f"$10^{{{e}}}$" if e else "" for e in labels]
    sides = [t.label1.get_ha() for t in ax.xaxis.get_major_ticks()]
    # Those at the very ends stand within the panel.
    at_end = np.isclose(ticks, bounds[0]), np.isclose(ticks, bounds[1])
    assert [s == "left" for s in sides] == at_end[0].tolist()
    assert [s == "right" for s in sides] == at_end[1].tolist()
    p = space["h_ratio"]
    assert ((ax.get_yticks() >= p.low * (1 - 1e-9)) & (ax.get_yticks() <= p.high)).all()


def test_verified_designs_are_white_black_or_crossed():
    points = REDUCED.sample(4, seed=0)
    points["foldable"] = pd.array([True, False, None, True], dtype="boolean")
    kinds = plots._overlay_kinds(points)
    found = {text: (len(rows), style["mfc"], style["marker"]) for text, rows, style in kinds}
    assert found == {
        "verified: folds": (2, "white", "o"), "verified: does not": (1, "black", "o"),
        "verified: unknown": (1, "#9A9A9A", "X"),
    }  # fmt: skip
    told = [handle.get_label() for handle in plots._overlay_handles(points[:2])]
    assert told == ["verified: folds", "verified: does not"]
    with pytest.raises(InputError, match="foldable"):
        plots._overlay_handles(points.drop(columns="foldable"))


def test_a_second_boundary_is_dashed_and_contours_are_white_lines():
    regime = a_map(beside=("without weight", Source()))
    figure = plot_regimes(regime, contours=(0.5,))
    lines = [ax.collections[1:] for ax in figure.get_axes()[:3]]
    # P steps from 0 to 1 in every panel; the source has no boundary in the last.
    assert [len(found) for found in lines] == [2, 2, 1]
    white, dashed = lines[0]
    # At E_i/E_s = 1 the one, at h_i/h_s = 1 the other.
    np.testing.assert_allclose(np.log10(white.get_paths()[0].vertices[:, 0]), 0, atol=0.2)
    np.testing.assert_allclose(np.log10(dashed.get_paths()[0].vertices[:, 1]), 0, atol=0.06)
    assert dashed.get_linestyle()[0][1] and not white.get_linestyle()[0][1]
    told = [text.get_text() for text in figure.legends[0].get_texts()]
    assert told[-2:] == ["without weight", "P(folds) = 0.5"]
    assert len(plot_regimes(a_map()).get_axes()[0].collections) == 1


def test_half_of_what_is_verified_lies_near_the_boundary():
    class Sloping(Stiff):
        def predict_proba(self, designs):
            p = REDUCED["E_ratio"].to_unit(designs["E_ratio"].to_numpy())
            return np.column_stack([1 - p, p])

    regime = regime_map(Sloping(), points=400, slices=[1e-3])
    designs = to_verify(regime, 21, seed=0)
    assert designs.equals(to_verify(regime, 21, seed=0))
    assert not designs.equals(to_verify(regime, 21, seed=1))
    assert len(designs) == 21 and not designs.duplicated().any()
    REDUCED.validate(designs[REDUCED.names])
    # Two of twenty columns are the tenth nearest to it.
    near = np.abs(REDUCED["E_ratio"].to_unit(designs["E_ratio"].to_numpy()) - 0.5) < 0.05
    assert near[:11].all() and not near[11:].all()
    assert (designs["predicted"] == (designs["E_ratio"] >= 1)).all()
    assert len(to_verify(regime, 400, seed=0).drop_duplicates()) == 400
    moved = replace(regime, threshold=0.8)
    at = REDUCED["E_ratio"].to_unit(to_verify(moved, 20, seed=0)["E_ratio"].to_numpy())
    assert (np.abs(at[:10] - 0.8) < 0.06).all()
    for n in (0, 401):
        with pytest.raises(InputError, match=f"{n} points to verify; expected 1 to 400"):
            to_verify(regime, n, seed=0)


def test_groups_that_nobody_fixed_are_held_in_the_middle():
    used = ("E_ratio", "h_ratio", "slenderness")
    held = held_in_the_middle(FULL, used, {"contraction": 0.3})
    assert set(held) == set(FULL.names) - set(used) and held["contraction"] == 0.3
    # Of a scale of ten decades the geometric mean, of lengths the arithmetic one.
    assert held["stiffness_to_weight"] == pytest.approx(1.0)
    assert held["hinge_length"] == pytest.approx(0.275)
    with pytest.raises(InputError, match="thickness"):
        held_in_the_middle(FULL, used, {"thickness": 1.0})


def test_a_source_without_margins_has_no_boundary_to_draw():
    class Slow:
        name, version = "slow", "1"

        def label(self, design):
            return Label(design, True, "so")

    with pytest.raises(InputError, match="'slow' gives no margins"):
        a_map(beside=("other", Slow()))
