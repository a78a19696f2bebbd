"""Regime maps: rates by hand, bounds met exactly, and which points are given to a solver."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.maps import regimes
from foldlab.maps.regimes import RegimeMap, Verdict, held_in_the_middle, regime_map, to_verify


def made(answers, truth=None, **options):
    """A map of two slices of two by two points."""
    predicted = np.array(answers, bool).reshape(2, 2, 2)
    given = {
        "space": REDUCED, "x": "E_ratio", "y": "h_ratio", "slice_by": "slenderness",
        "x_values": np.array([0.1, 10.0]), "y_values": np.array([0.2, 5.0]),
        "slices": np.array([1e-3, 1e-2]), "fixed": {}, "probability": predicted.astype(float),
        "predicted": predicted, "seconds": 1.5,
        "truth": None if truth is None else np.array(truth).reshape(2, 2, 2),
    }  # fmt: skip
    return RegimeMap(**(given | options))


# Three right (two yes, one no), three false positives, one missed, one unknown: no two rates agree.
GUESSED = made([1, 1, 0, 1, 1, 1, 0, 1], [1, 1, 0, 0, 0, 0, 1, -1], source="s", source_seconds=2.0)


def test_rates_are_of_known_points_by_what_they_do():
    assert GUESSED.counts == {
        "true_positive": 2, "true_negative": 1, "false_positive": 3, "false_negative": 1,
        "unknown": 1,
    }  # fmt: skip
    assert GUESSED.accuracy == 3 / 7
    assert GUESSED.false_positive_rate == 3 / 4 and GUESSED.recall == 2 / 3
    counts = GUESSED.slice_counts
    assert counts.index.name == "slenderness" and counts.index.tolist() == [1e-3, 1e-2]
    assert counts["true_positive"].tolist() == [2, 0] and counts["unknown"].tolist() == [0, 1]
    assert GUESSED.verdicts[0].ravel().tolist() == [
        Verdict.TRUE_POSITIVE, Verdict.TRUE_POSITIVE, Verdict.TRUE_NEGATIVE, Verdict.FALSE_POSITIVE,
    ]  # fmt: skip


def test_a_summary_has_rates_only_of_what_was_validated():
    told = GUESSED.summary()
    assert told["axes"] == ["E_ratio", "h_ratio"] and told["slices"] == [1e-3, 1e-2]
    assert (told["points"], told["predicted_foldable"], told["seconds"]) == (8, 6, 1.5)
    assert (told["source"], told["source_seconds"], told["recall"]) == ("s", 2.0, 2 / 3)
    assert (told["accuracy"], told["false_positive_rate"]) == (3 / 7, 3 / 4)
    plain = made([1] * 8).summary()
    assert "accuracy" not in plain and "source" not in plain and plain["predicted_foldable"] == 8


class Half:
    """Folds where E_i/E_s is at least 1."""

    classes_ = np.array([False, True])

    def predict_proba(self, X):
        p = np.where(np.asarray(X["E_ratio"]) >= 1, 0.75, 0.25)
        return np.column_stack([1 - p, p])

    def predict(self, X):
        return self.predict_proba(X)[:, 1] > 0.5


def test_a_map_has_at_most_so_many_points_and_at_least_those_asked_for(monkeypatch):
    monkeypatch.setattr(regimes, "MOST_POINTS", 100)
    slices = [1e-3, 1e-2]
    assert regime_map(Half(), points=98, slices=slices).points == 2 * 7**2
    assert regime_map(Half(), points=99, slices=slices).points == 2 * 8**2
    assert regime_map(Half(), points=100, slices=slices).points == 2 * 8**2
    assert regime_map(Half(), points=1, slices=slices).points == 2
    with pytest.raises(InputError, match="101 points; a map has at most 100, more show nothing"):
        regime_map(Half(), points=101, slices=slices)


def test_another_source_stands_beside_the_map_by_its_margins():
    source = TimoshenkoSource()
    regime = regime_map(Half(), points=32, slices=[1e-3, 1e-2], beside=("light", source))
    name, margins = regime.beside
    assert name == "light" and margins.shape == (2, 4, 4) and regime.truth is None
    again = regime_map(Half(), points=32, slices=[1e-3, 1e-2], source=source)
    np.testing.assert_array_equal(margins, again.margin)
    assert again.source == "timoshenko" and again.beside is None and again.source_seconds > 0

    def evaluate(designs):
        return pd.DataFrame({"foldable": [True] * len(designs)})

    silent = SimpleNamespace(name="silent", version="1", evaluate=evaluate)
    with pytest.raises(InputError, match="the source 'silent' gives no margins to draw"):
        regime_map(Half(), points=9, beside=("light", silent))


def test_half_of_the_points_to_verify_are_near_the_boundary():
    side = 20
    cells = (np.arange(side) + 0.5) / side
    p = np.tile(cells, (2, side, 1))
    regime = made(
        [1] * 8, x_values=REDUCED["E_ratio"].from_unit(cells), probability=p, predicted=p >= 0.7,
        y_values=REDUCED["h_ratio"].from_unit(cells), threshold=0.7,
    )  # fmt: skip
    designs = to_verify(regime, 41, seed=3)
    assert len(designs) == 41 and len(designs.drop_duplicates()) == 41
    assert list(designs) == [*REDUCED.names, "predicted"]
    at = REDUCED["E_ratio"].to_unit(designs["E_ratio"])
    # A tenth of 800 points: the two columns on both sides of 0.7.
    near = np.abs(at - 0.7) < 0.05
    assert near[:21].all() and 0 < (~near[21:]).sum() <= 20
    assert (designs["predicted"] == (at >= 0.7)).all()
    assert designs.equals(to_verify(regime, 41, seed=3))
    assert not designs.equals(to_verify(regime, 41, seed=4))
    whole = made([1] * 8)
    assert len(to_verify(whole, 8, seed=0).drop_duplicates()) == 8
    for n in (0, 9):
        with pytest.raises(InputError, match=f"{n} points to verify; expected 1 to 8"):
            to_verify(whole, n, seed=0)


def test_groups_that_nothing_is_said_of_are_held_in_the_middle_of_their_scale():
    held = held_in_the_middle(REDUCED, ("E_ratio",), {"h_ratio": 3.0})
    assert held == {"h_ratio": 3.0, "slenderness": pytest.approx(1e-2)}
    with pytest.raises(InputError, match="no group 'width'"):
        held_in_the_middle(REDUCED, (), {"width": 1.0})
