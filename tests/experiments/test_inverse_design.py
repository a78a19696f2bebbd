"""What is counted of wishes under weight: confirmed, answered by a size, off, and at what price."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments import inverse_design
from experiments.inverse_design import PAIRS, SIZES, SPACE, Config, _figure, _open, _summary, _want
from foldlab.inverse.wish import Angle, Wish

TABLE = pd.DataFrame({
    "kind": ["possible", "open", "possible", "open", "possible"],
    "confirmed": [True, False, True, True, False],
    "rejected": [1, 2, 0, 0, 1],
    "largest_mm": [None, 20.0, None, None, None],
    "angle_off": [0.05, None, 0.2, None, None],
    "held": [1.0, None, 0.5, 0.9, None],
    "core_seconds": [10.0, 99.0, 20.0, 60.0, 99.0],
    "l_s_mm": [10.0, 20.0, 30.0, 40.0, 50.0],
})  # fmt: skip


def test_fractions_are_of_wishes_of_a_kind_and_of_designs_that_the_solver_saw():
    said = _summary(TABLE, Config(tolerance=0.05))
    assert said["wishes"] == 5
    assert said["confirmed_of_possible"] == pytest.approx(2 / 3)
    assert said["confirmed_of_open"] == pytest.approx(1 / 2)
    # Three confirmed, four rejected.
    assert said["confirmed_of_proposed"] == pytest.approx(3 / 7)
    assert said["answered_by_a_size"] == 1
    # The tolerance itself is within; only angles that were wished count.
    assert said["angle_within"] == 0.5
    assert said["angle_off_median"] == pytest.approx(0.125) and said["angle_off_most"] == 0.2
    assert said["corners_that_hold"] == pytest.approx(0.8)
    assert said["core_seconds_confirmed_median"] == 20.0
    assert said["core_seconds_confirmed_mean"] == 30.0
    assert said["core_seconds_confirmed_most"] == 60.0


def test_where_nothing_is_confirmed_there_is_no_fraction_of_it():
    none = TABLE[~TABLE["confirmed"]].assign(rejected=0)
    said = _summary(none, Config())
    assert (
        said["confirmed_of_proposed"] is said["angle_within"] is said["corners_that_hold"] is None
    )


def test_two_of_three_wishes_are_of_an_angle():
    config = Config(tolerance=0.1)
    wants = [_want(k, 0.7, config) for k in range(12)]
    assert [want == "foldable" for want in wants] == [True, False, False] * 4
    assert wants[1] == Angle(0.7, 0.1)


def test_open_wishes_lie_within_what_is_wished():
    for seed in range(20):
        wish = _open(Config(), np.random.default_rng(seed), 1)
        length = wish.fixed["l_s"]
        assert SIZES[0] <= length <= SIZES[1] and 0.1 <= wish.fixed["b_s"] / length <= 0.8
        assert 0.005 <= wish.max_thickness / length <= 0.08
        assert np.radians(20) <= wish.want.value <= np.radians(160)
        assert (wish.passive[0], wish.active[0]) in PAIRS


def answered(monkeypatch, want, proposals, largest=None):
    wish = Wish(SPACE, passive=("PET",), active=("SMP",), fixed={"l_s": 0.04}, want=want)
    asked = []

    def weighted(wish, count, **options):
        asked.append((count, options))
        return SimpleNamespace(
            wish=wish, proposals=proposals, rejected=3, largest=largest, reason="so it is"
        )

    monkeypatch.setattr(inverse_design, "weighted", weighted)
    monkeypatch.setattr(inverse_design, "_held", lambda *given: 0.75)
    row = inverse_design._answered(wish, Config(seed=8, walkers=64), "source", 2)
    assert asked == [(1, {"seed": 8, "source": "source", "walkers": 64})]
    return row


def test_a_confirmed_wish_states_how_far_its_angle_is_off(monkeypatch):
    row = answered(monkeypatch, Angle(1.0, 0.05), (SimpleNamespace(margin=0.02, angle=0.9),))
    assert row["confirmed"] and row["angle_off"] == pytest.approx(0.1)
    assert row["want"] == pytest.approx(57.29578) and row["l_s_mm"] == 40.0
    assert (row["margin"], row["held"], row["rejected"]) == (0.02, 0.75, 3)
    assert row["materials"] == "PET + SMP" and row["largest_mm"] is None
    assert row["core_seconds"] >= 0


def test_a_wish_that_is_not_met_may_have_a_size(monkeypatch):
    row = answered(monkeypatch, "foldable", (), largest={"l_s": 0.02})
    assert not row["confirmed"] and row["largest_mm"] == 20.0 and row["want"] is None
    assert row["angle_off"] is row["margin"] is row["held"] is None and row["reason"] == "so it is"


def test_the_picture_tells_confirmed_wishes_from_others():
    config = Config(kinds=("possible", "open"))
    (ax,) = _figure(TABLE, config).axes
    drawn = [line.get_xydata().tolist() for line in ax.lines]
    assert drawn == [[[10.0, 10.0], [30.0, 20.0]], [[50.0, 99.0]], [[40.0, 60.0]], [[20.0, 99.0]]]
