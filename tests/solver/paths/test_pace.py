"""Step sizes: rules of numbers, without a scene."""

import numpy as np
import pytest

from solver.paths.pace import ArcPace, LoadPace, towards
from solver.paths.point import Metric


@pytest.mark.parametrize(
    ("step", "remaining", "taken"),
    [(0.3, 1.0, 0.3), (0.3, 0.5, 0.25), (0.3, 0.3, 0.3), (0.3, 0.29, 0.29), (0.3, np.inf, 0.3)],
)
def test_the_last_two_steps_share_what_remains(step, remaining, taken):
    assert towards(step, remaining) == pytest.approx(taken)


def test_steps_of_the_load_grow_to_the_usual_one_and_beyond_where_newton_is_quick():
    pace = LoadPace(step=1.0, first=0.25, smallest=1e-4, cut=10.0, growth=2.0, largest=3.0)
    assert pace.now(()) == pace.now((0.1, 0.2)) == 0.25
    assert pace.now((0.5,)) == 0.5
    assert pace.following(0.2, 9) == 0.4
    assert pace.following(0.8, 9) == 1.0
    assert pace.following(0.8, 3) == 1.6
    assert pace.following(2.0, 3) == 3.0
    assert pace.following(2.0, 4) == 2.0  # a long step that was hard is not made longer


def test_semi_axes_follow_the_path_and_keep_their_ratio():
    pace = ArcPace(a=0.1, b=1.0, smallest=1e-2, largest=4.0, easy=4)
    metric = Metric(0.1, 1.0, 3, 1.0)
    # Moved as far along both axes as the ellipsoid is wide, in as many iterations as aimed at.
    assert pace.following(metric, (0.1 / 2**0.5, 1 / 2**0.5), 4) == pytest.approx((0.1, 1.0))
    # Quicker steps grow by √2 at most, slow ones shrink to a half at most.
    assert pace.following(metric, (0.1 / 2**0.5, 1 / 2**0.5), 1) == pytest.approx(
        (0.1414, 1.414), rel=1e-3
    )
    assert pace.following(metric, (0.1 / 2**0.5, 1 / 2**0.5), 99) == pytest.approx((0.05, 0.5))
    # A load that stands still takes its axis down no further than to a tenth of the other.
    flat = Metric(0.1, 0.1, 3, 1.0)
    assert pace.following(flat, (0.1, 0.0), 4) == pytest.approx((0.1414, 0.1414), rel=1e-3)
    assert pace.following(Metric(0.4, 4.0, 3, 1.0), (0.4, 4.0), 1) == pytest.approx((0.4, 4.0))
    assert pace.allows(0.001, 0.001) and not pace.allows(0.0009, 0.009)
    a, b = pace.shorter(*pace.shorter(0.1, 1.0))
    assert (a, b) == pytest.approx((0.01, 0.1))


def test_senseless_sizes_are_refused():
    for options in ({"step": 0}, {"cut": 1.0}, {"growth": 0.5}, {"largest": -1}):
        sizes = dict(step=1.0, first=0.25, smallest=1e-4, cut=10.0, growth=2.0, largest=1.0)
        with pytest.raises(ValueError, match="expected"):
            LoadPace(**(sizes | options))
    with pytest.raises(ValueError, match="easy = 0"):
        ArcPace(0.1, 1.0, 1e-4, 4.0, 0)


def test_control_of_another_stepper_says_nothing_of_semi_axes():
    pace = ArcPace(a=0.1, b=1.0, smallest=1e-2, largest=4.0, easy=4)
    assert pace.now((0.2, 3.0)) == (0.2, 3.0)
    assert pace.now(()) == pace.now((0.5,)) == (0.1, 1.0)


def test_semi_axes_change_by_a_factor_of_two_at_most():
    pace = ArcPace(a=0.1, b=1.0, smallest=1e-2, largest=8.0, easy=4)
    metric = Metric(0.2, 2.0, 3, 1.0)
    assert pace.following(metric, (9.0, 90.0), 4) == pytest.approx((0.4, 4.0))
    assert pace.following(metric, (1e-6, 1e-6), 4) == pytest.approx((0.1, 1.0))
    assert not pace.allows(0.00099, 0.0099) and pace.allows(0.1, 0.0)
