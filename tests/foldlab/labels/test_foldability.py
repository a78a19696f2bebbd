"""Measures of curves whose turning is known, tags, verdicts, and the closed form of lift-off."""

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from foldlab.errors import InputError
from foldlab.labels import foldability
from foldlab.labels.foldability import Thresholds, measure
from foldlab.labels.timoshenko import lift_off_stiffness
from foldlab.labels.verdict import find_events, verdict

LENGTH = 0.2  # l_i/l_s
HALF = 0.1  # b_i/2

S = np.linspace(-0.5, 0.5, 1000)
SIDE = np.array([HALF, 0, 0])


def _line(angles):
    """The curve in the plane x = 0 whose chords have these angles."""
    t = np.stack([0 * angles, np.cos(angles), np.sin(angles)], -1)
    return np.vstack([np.zeros(3), np.cumsum(t, axis=0)]) / len(angles)


def unit(fold=0.0, curl=0.0):
    """Curves of a sheet whose hinge folds to an arc of angle ``fold``, or is a cylinder of angle
    ``curl`` about the other axis; lines along it stay parallel."""

    chords = (S[1:] + S[:-1]) / 2
    angle = fold * np.clip(chords / LENGTH, -0.5, 0.5)
    middle = _line(angle)
    a = curl * np.linspace(-0.5, 0.5, 1000)
    radius = 2 * HALF / curl if curl else np.inf
    across = np.stack([2 * HALF * np.linspace(-0.5, 0.5, 1000), 0 * a, 0 * a], -1)
    if curl:
        across = np.stack([radius * np.sin(a), 0 * a, radius * (1 - np.cos(a))], -1)
    return np.stack([middle, across, middle + SIDE, middle - SIDE])


@pytest.mark.parametrize("fold", [0.3, 1.5, np.pi, 2 * np.pi - 0.1, 2 * np.pi + 0.1, 3 * np.pi])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_circular_hinge_turns_by_its_angle_with_its_sign(fold, sign):
    m = measure(unit(fold=sign * fold), LENGTH)
    assert m.m1 == pytest.approx(sign * fold, rel=1e-6)
    # The last chord of the hinge may lie in part in the panel.
    assert m.hinge == pytest.approx(sign * fold, rel=3e-3)
    assert m.m2 == pytest.approx(0, abs=1e-6)
    assert (m.m3, m.m4) == pytest.approx((1, 1))


def test_turning_by_the_hinge_and_by_its_ends_are_told_apart():
    y = np.linspace(-0.5, 0.5, 2001)
    # An arc of 0.6 rad, and 0.4 rad more within 0.02 around either end.
    angles = 0.6 * np.clip(y / 0.2, -0.5, 0.5)
    for end in (-0.1, 0.1):
        angles = angles + 0.4 * np.clip((y - end) / 0.02, -0.5, 0.5)
    steps = np.stack([np.zeros(2000), np.cos(angles[1:]), np.sin(angles[1:])], axis=1) / 2000
    line = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    across = np.stack([np.linspace(-0.1, 0.1, 2001), np.zeros(2001), np.zeros(2001)], axis=1)
    m = measure(np.stack([line, across, line, line]), 0.2, (0.02, 0.02))
    assert m.m1 == pytest.approx(1.4, abs=1e-3)
    assert (m.turning_hinge, m.turning_ends) == pytest.approx((0.6, 0.8), abs=2e-3)
    # Without a reach all that turns within the hinge is the hinge's.
    m = measure(np.stack([line, across, line, line]), 0.2)
    assert (m.turning_hinge, m.turning_ends) == pytest.approx((1.0, 0.0), abs=2e-3)


@pytest.mark.parametrize("reach", [0.1, 0.4])
def test_of_a_hinge_shorter_than_its_ends_reach_the_middle_half_tells(reach):
    m = measure(unit(fold=0.8), LENGTH, (reach, 0.02))
    assert (m.turning_hinge, m.turning_ends) == pytest.approx((0.8, 0.0), abs=5e-3)


def test_of_an_arc_over_the_whole_length_the_hinge_turns_its_part():
    arc = _line(2.0 * (S[1:] + S[:-1]) / 2)
    m = measure(np.stack([arc, unit()[1], arc + SIDE, arc - SIDE]), LENGTH)
    assert m.m1 == pytest.approx(2.0, rel=2e-3)  # between the middles of the first and last chord
    assert m.hinge == pytest.approx(2.0 * LENGTH, rel=1e-6)


@pytest.mark.parametrize("curl", [0.2, 1.0, -1.0, np.pi, 4.5])
def test_a_cylinder_about_the_other_axis_turns_across(curl):
    m = measure(unit(curl=curl), LENGTH)
    assert m.m2 == pytest.approx(abs(curl), rel=2e-3)
    assert m.m1 == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("rate", [0.5, 2.0, 6.0])
def test_the_edges_of_a_twisted_strip_are_helices(rate):
    # Sections turn by rate · s: the edge's tangent is (0, 1, 0) + HALF · rate · (…), at right
    # angles to the axis, so t₁·t₃ = 1/√(1 + (HALF · rate)²).
    edge = [
        np.stack([side * HALF * np.cos(rate * S), S, side * HALF * np.sin(rate * S)], -1)
        for side in (1, -1)
    ]
    flat = unit()
    m = measure(np.stack([flat[0], flat[1], *edge]), LENGTH)
    assert (m.m3, m.m4) == pytest.approx([1 / np.hypot(1, HALF * rate)] * 2, rel=1e-6)
    assert m.m1 == pytest.approx(0, abs=1e-9)


def test_each_edge_has_its_own_measure():
    # One edge keeps to the middle line, the other climbs at an angle φ to it: t₁·t = cos φ.
    flat = unit()
    tilted = np.stack([np.full(1000, HALF), S * np.cos(0.4), S * np.sin(0.4)], -1)
    m = measure(np.stack([flat[0], flat[1], tilted, flat[3]]), LENGTH)
    assert (m.m3, m.m4) == pytest.approx((np.cos(0.4), 1.0))
    m = measure(np.stack([flat[0], flat[1], flat[2], tilted - 2 * SIDE]), LENGTH)
    assert (m.m3, m.m4) == pytest.approx((1.0, np.cos(0.4)))


def test_a_flat_sheet_measures_nothing():
    m = measure(unit(), LENGTH)
    assert (m.m1, m.m2, m.hinge) == pytest.approx((0, 0, 0), abs=1e-12)
    assert (m.m3, m.m4) == pytest.approx((1, 1), abs=1e-12)


def test_a_hair_of_sideways_bending_is_no_fold():
    # A straight curve has no plane of its own: the hinge's width gives it one.
    sideways = _line(3e-4 * (S[1:] + S[:-1]) / 2)[:, [2, 1, 0]]
    m = measure(np.stack([sideways, unit()[1], sideways + SIDE, sideways - SIDE]), LENGTH)
    assert m.m1 == pytest.approx(0, abs=1e-7)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("fold, curl", [(2.5, 0.0), (-0.4, 0.7), (7.0, 0.3), (0.0, 0.0)])
def test_rigid_motion_changes_nothing(seed, fold, curl):
    curves = unit(fold=fold, curl=curl)
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    moved = curves @ turn.T + np.random.default_rng(seed).normal(size=3)
    before, after = (vars(measure(c, LENGTH)) for c in (curves, moved))
    assert list(after.values()) == pytest.approx(list(before.values()), abs=1e-9)


def test_curves_that_are_none_are_refused():
    for bad in (np.zeros((3, 10, 3)), np.zeros((4, 2, 3)), np.full((4, 10, 3), np.nan)):
        with pytest.raises(InputError):
            measure(bad, LENGTH)


# -- tags ----------------------------------------------------------------------------------------

GOOD = {"m1": 2.0, "m2": 0.1, "m3": 1.0, "m4": 1.0}


@pytest.mark.parametrize(
    "tag, name, limit, holds_below",
    [
        ("F1", "m1", 0.3 * np.pi, False),
        ("F2", "m2", 0.3 * np.pi / 2, True),
        ("F3", "m3", 1.1, True),
        ("F3", "m3", 0.9, False),
        ("F4", "m4", 1.1, True),
        ("F4", "m4", 0.9, False),
    ],
)
def test_tags_change_at_their_thresholds(tag, name, limit, holds_below):
    for side, holds in ((-1, holds_below), (1, not holds_below)):
        tags = Thresholds().tags(GOOD | {name: limit + side * 1e-9}, 0.3)
        assert tags == dict.fromkeys(foldability.TAGS, True) | {tag: holds}


def test_a_sheet_that_only_sags_is_not_folded():
    assert not Thresholds().tags(GOOD | {"m1": -2.0}, 0.3)["F1"]


def test_other_thresholds_apply_to_stored_measures():
    m = measure(unit(fold=1.0, curl=0.4), LENGTH)
    stored = dict(vars(m))
    assert Thresholds().tags(stored, 0.3) == Thresholds().tags(m, 0.3)
    assert Thresholds().tags(m, 0.3)["F1"] and Thresholds().tags(m, 0.3)["F2"]
    strict = Thresholds(turning=4.0, across=0.25, parallel=0.1)
    assert not strict.tags(stored, 0.3)["F1"]
    assert not strict.tags(stored, 0.3)["F2"]


def test_a_path_closes_after_a_full_turn_or_half_of_it_across():
    closed = Thresholds().closed
    m1, m2 = np.array([6.25, 6.253, -6.29, 0, 0]), np.array([0, 0, 0, 3.14, 3.15])
    assert closed(m1, m2).tolist() == [False, True, True, False, True]


def test_errors_are_relative_to_the_angle_or_to_what_counts_as_folded():
    scale = Thresholds(turning=2.0).scale
    assert scale(np.array([-1.0, 0.1]), 0.3).tolist() == [1.0, 0.6]


def test_a_hinge_is_thick_whose_active_layer_is_thicker_than_it_is_long():
    design = DESIGN | {"h_ratio": 10.0, "slenderness": 0.03}
    table = pd.DataFrame([design | {"hinge_length": 0.29}, design | {"hinge_length": 0.31}])
    assert foldability.thick_hinge(table).tolist() == [True, False]


# -- events and verdicts -------------------------------------------------------------------------

DESIGN = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0, "h_ratio": 1.0,
    "stiffness_to_weight": 0.01, "aspect": 0.2, "slenderness": 0.01, "contraction": 0.3,
}  # fmt: skip


def row(contraction=0.3, **values):
    start = {"m1": 0.0, "m2": 0.0, "m3": 1.0, "m4": 1.0, "hinge": 0.0}
    return {"contraction": contraction, **start, **values}


def judged(*history, closed=False, **changed):
    design = DESIGN | changed
    tags = Thresholds().tags(history[-1], design["contraction"])
    events = find_events(history, design["contraction"], Thresholds())
    return verdict(design, history, tags, events, closed, Thresholds()), events


def test_an_event_is_where_it_set_in_to_stay():
    history = [row(0.0), row(0.1, m2=0.6, tip=1.0), row(0.2, m2=0.1, tip=0.0)]
    history += [row(0.25, m2=0.5, tip=2.0), row(0.3, m2=0.7, tip=9.0, m4=0.85)]
    (_, outcome, _), events = judged(*history)
    assert {event["kind"]: event["contraction"] for event in events} == {
        "lift-off": 0.25,
        "curling": 0.25,
        "warping": 0.3,
    }
    assert outcome == "curled"
    assert judged(row(0.0), row(0.1, m2=0.6), row(0.3, m1=2.0))[1] == []


def test_verdicts_say_why():
    (folds, outcome, why), _ = judged(row(m1=2.0))
    assert (folds, outcome) == (True, "folds")
    assert "2 rad" in why and "0.942 rad" in why
    (folds, outcome, why), _ = judged(row(0.2, m1=6.3), closed=True)
    assert (folds, outcome) == (True, "folds") and "full turn at 20 % contraction" in why
    (folds, outcome, why), _ = judged(row(0.25, m1=2.0, m2=3.2), closed=True)
    assert (folds, outcome) == (False, "curled") and "half a turn at 25 % contraction" in why
    for m1 in (0.1, 2.0):
        (folds, outcome, why), _ = judged(row(0.0), row(0.12, m1=m1, m2=0.6), row(m1=m1, m2=0.7))
        assert (folds, outcome) == (False, "curled") and "at 12 % contraction" in why
    (folds, outcome, why), _ = judged(row(m1=0.5))
    assert (folds, outcome) == (False, "too_little")
    assert "0.5 rad, short of the 0.942 rad" in why
    (folds, outcome, why), _ = judged(row(0.1), row(0.2, m3=0.8), row(m1=2.0, m3=0.8))
    assert (folds, outcome) == (False, "warped") and "at 20 % contraction" in why


def test_verdicts_on_the_ground():
    low = {"tip": 0.1, "hinge": 0.2}
    (folds, outcome, why), _ = judged(row(**low))
    assert (folds, outcome) == (False, "grounded")
    assert f"lift-off needs Γ ≥ {lift_off_stiffness(DESIGN):.2g} here, Γ is 0.01" in why
    # Where stiff panels would have lifted, it is their own bending that keeps them down.
    (folds, outcome, why), _ = judged(row(**low), stiffness_to_weight=100.0)
    assert outcome == "grounded" and "needs" not in why and "0.2 rad" in why
    (folds, outcome, why), _ = judged(row(tip=9.0, m1=0.5, hinge=1.5))
    assert (folds, outcome) == (False, "sags")
    assert "turns by 1.5 rad" in why and "0.5 rad of the 0.942 rad" in why
    # Without a ground there is no weight, and nothing that could sag.
    (folds, outcome, why), _ = judged(row(m1=0.5, hinge=1.5))
    assert (folds, outcome) == (False, "too_little") and "sag" not in why


def test_every_end_has_a_verdict_and_only_true_tags_fold():
    ends = itertools.product(
        (-6.5, -1.0, 0.5, 2.0, 6.5), (0.0, 0.6, 3.2), (1.0, 0.7), (None, 0.0, 5.0), (False, True)
    )
    for m1, m2, m3, tip, closed in ends:
        low, high = ({}, {}) if tip is None else ({"tip": 0.0}, {"tip": tip})
        last = row(m1=m1, m2=m2, m3=m3, hinge=m1, **high)
        (folds, outcome, why), _ = judged(row(0.0, **low), last, closed=closed)
        assert folds == all(Thresholds().tags(last, 0.3).values()) == (outcome == "folds")
        assert why and why[0].islower()


# -- lift-off ------------------------------------------------------------------------------------


def test_lift_off_is_where_the_closed_form_has_it():
    # Equal layers, E_i = E_s: κ h_s = 0.75 g and B = (2h)³/12 · E; β = w L_p² l_i / (4 B) = κ l_i/2
    d = DESIGN | {"E_ratio": 1.0, "h_ratio": 1.0, "hinge_width": 0.5}
    h, l_i, g = d["slenderness"], d["hinge_length"], d["contraction"]
    gamma = lift_off_stiffness(d)
    weight = h * h**2 / gamma  # of a panel per area
    B = 0.5 * (2 * h) ** 3 / 12  # the hinge is half as wide
    beta = weight * ((1 - l_i) / 2) ** 2 * l_i / (4 * B)
    assert beta == pytest.approx(0.75 * g / h * l_i / 2)
    assert lift_off_stiffness(d | {"contraction": 0.0}) == np.inf
