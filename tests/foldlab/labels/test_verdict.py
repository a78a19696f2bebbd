"""From a path to a label: differences of meshes, what is near a threshold, what weight explains."""

from types import SimpleNamespace

import numpy as np
import pytest

from foldlab.errors import InputError
from foldlab.labels import screening
from foldlab.labels.asked import Changing, Conditions
from foldlab.labels.foldability import Thresholds
from foldlab.labels.run import Run
from foldlab.labels.solver import SolverSource
from foldlab.labels.verdict import FLOOR, RETURN, Errors, beyond_return, difference, judge
from solver.cases.unit.path import Ending, Happening

LIMITS = Thresholds()
DESIGN = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0, "h_ratio": 1.0,
    "stiffness_to_weight": 1.0, "aspect": 0.2, "slenderness": 0.01, "contraction": 0.3,
}  # fmt: skip
ALPHA = 0.3 * np.pi


def a_run(
    *, ending=Ending.REACHED, closed=False, heavy=True, states=True, happenings=(),
    growth="uniaxial", **measures,
):  # fmt: skip
    """A path of one state, or of none, that the solver need not find."""
    row = {"contraction": 0.3, "m1": 0.0, "m2": 0.0, "m3": 1.0, "m4": 1.0, "hinge": 0.0}
    row |= {"turning_hinge": 0.0, "turning_ends": 0.0}
    row |= {"unstable": 0, **measures}
    state = SimpleNamespace(topples=False, curves=np.zeros((4, 1000, 3)))
    folding = SimpleNamespace(
        ending=ending, detail=ending.value, happenings=happenings, last=state, states=(state,),
        iterations=1, model=SimpleNamespace(
            heavy=heavy, growth=growth, scene=SimpleNamespace(size=1),
            unit=SimpleNamespace(contraction=0.3),
        ),
    )  # fmt: skip
    return Run(folding, [row] if states else [], closed, [])


def judged(run, error, *, limits=LIMITS, before=None, gone=False, **changed):
    design = DESIGN | changed
    errors = Errors(error, error) if isinstance(error, float) else error
    foldable, reason, evidence = judge(
        design, run, errors, limits, accuracy=0.02, levels=2, coarse=False, before=before, gone=gone
    )
    return foldable, evidence["outcome"], reason


# -- the difference of two meshes ----------------------------------------------------------------


@pytest.mark.parametrize(
    "coarse, fine, off",
    [
        ({"m1": 1.9}, {"m1": 2.0}, (0.1 / 2.0, 0)),
        ({"m1": 0.1}, {"m1": 0.2}, (0.1 / ALPHA, 0)),  # little angles count against what folds
        ({"m1": 2.0, "m2": 0.3}, {"m1": 2.0, "m2": 0.1}, (0, 0.2 / 2.0)),
        ({"m1": 1.9, "m2": 0.3}, {"m1": 2.0, "m2": 0.0}, (0.1 / 2.0, 0.3 / 2.0)),
    ],
)
def test_meshes_differ_by_each_turning(coarse, fine, off):
    got = difference(a_run(**coarse), a_run(**fine), DESIGN, LIMITS)
    assert (got.m1, got.m2) == pytest.approx(off)
    assert got.largest == pytest.approx(max(off))


def test_closed_paths_differ_by_the_contraction_that_a_full_turn_takes():
    runs = [a_run(closed=True, m1=6.3, contraction=g) for g in (0.2, 0.25)]
    assert difference(*runs, DESIGN, LIMITS).largest == pytest.approx(0.25)
    # Where only one of them closed, the angles are what differs.
    runs = [a_run(m1=5.0), a_run(closed=True, m1=6.25, contraction=0.25)]
    assert difference(*runs, DESIGN, LIMITS).largest == pytest.approx(0.2)


def test_each_turning_is_stated_with_a_margin_and_not_below_what_chance_may_give():
    stated = Errors(0.1, 1e-4).stated(2, None, 0.01)
    assert vars(stated) == pytest.approx({"m1": 0.07, "m2": 0.01})
    stated = Errors(1e-4, 0.1).stated(1, None, 0.1)
    assert vars(stated) == pytest.approx({"m1": 9e-3, "m2": 0.13})


def test_two_meshes_that_agree_by_chance_state_a_part_of_the_difference_before():
    by_chance = Errors(1e-4, 1e-4)
    stated = by_chance.stated(2, Errors(0.1, 0.2), 0.01)
    assert vars(stated) == pytest.approx({"m1": 0.025, "m2": 0.01})
    assert Errors(0.1, 0.0).stated(2, Errors(0.1, 0.0), 0.01).m1 == pytest.approx(0.07)
    # Where the mesh before took another branch it says nothing about convergence.
    assert by_chance.stated(2, Errors(0.31, 0.0), 0.01).m1 == FLOOR[2]


# -- what an error leaves open -------------------------------------------------------------------


@pytest.mark.parametrize(
    "measures, error, outcome",
    [
        ({"m1": 1.02 * ALPHA}, 0.05, "unresolved"),
        ({"m1": 0.98 * ALPHA}, 0.05, "unresolved"),
        ({"m1": 1.01 * ALPHA}, 0.015, "folds"),  # as accurate as asked for
        ({"m1": 1.10 * ALPHA}, 0.05, "folds"),
        ({"m1": 0.90 * ALPHA}, 0.05, "too_little"),
        ({"m1": 2 * ALPHA, "m2": 0.45 * ALPHA}, 0.05, "unresolved"),
        ({"m1": 2 * ALPHA, "m2": 0.35 * ALPHA}, 0.05, "folds"),
        # The error of one says nothing of the other.
        ({"m1": 1.02 * ALPHA, "m2": 0.1}, Errors(0.01, 0.2), "folds"),
        ({"m1": 1.02 * ALPHA, "m2": 0.1}, Errors(0.05, 0.001), "unresolved"),
        ({"m1": 2 * ALPHA, "m2": 0.45 * ALPHA}, Errors(0.1, 0.01), "folds"),
        ({"m1": 2 * ALPHA, "m2": 0.45 * ALPHA}, Errors(0.01, 0.1), "unresolved"),
        ({"m1": 1.005 * ALPHA, "m2": 0.1}, Errors(0.01, 0.2), "folds"),
        ({"m1": 0.995 * ALPHA, "m2": 0.1}, Errors(0.01, 0.2), "too_little"),
        ({"m1": 2 * ALPHA, "m2": 0.495 * ALPHA}, Errors(0.1, 0.01), "folds"),
        # What fails by more than its error decides, however near the other is.
        ({"m1": 0.5 * ALPHA, "m2": 0.49 * ALPHA}, 0.05, "too_little"),
    ],
)
def test_within_its_error_of_a_threshold_a_label_is_unknown(measures, error, outcome):
    foldable, seen, reason = judged(a_run(**measures), error)
    assert seen == outcome
    assert (foldable is None) == (outcome == "unresolved") == reason.startswith("unknown")


def test_what_counts_as_folded_may_be_an_angle():
    run = a_run(m1=1.5, m2=0.6)
    assert judged(run, 0.01)[1] == "curled"  # m2 above half of 0.3 π
    assert judged(run, 0.01, limits=Thresholds(need=1.4))[:2] == (True, "folds")
    foldable, outcome, reason = judged(run, 0.01, limits=Thresholds(need=1.6))
    assert (foldable, outcome) == (False, "too_little") and "the 1.6 rad needed" in reason
    assert judged(run, 0.05, limits=Thresholds(need=1.45))[:2] == (None, "unresolved")


@pytest.mark.parametrize("name", ["need", "turning", "across"])
def test_thresholds_are_positive(name):
    with pytest.raises(InputError, match=rf"{name} = 0\.0; expected a finite number above 0"):
        Thresholds(**{name: 0.0})


def test_a_fold_by_the_ends_of_the_active_layer_is_told():
    ends = a_run(m1=1.2, turning_hinge=0.1, turning_ends=1.1)
    assert "the hinge bends by 0.1 rad only" in judged(ends, 0.01)[2]
    assert "only" not in judged(a_run(m1=1.2, turning_hinge=0.9, turning_ends=0.3), 0.01)[2]


@pytest.mark.parametrize(
    "other, this, error, agreed",
    [
        (2.0, 4.0, 1.0, True),
        (0.1, 0.5, 1.0, True),
        (1.05 * ALPHA, 4.0, 1.0, False),  # one of them may not fold after all
        (2.0, 1.1 * ALPHA, 1.0, False),
        (0.1, 2.0, 1.0, False),
        (1.25 * ALPHA, 1.2 * ALPHA, 0.2, False),  # the mesh may explain it, and the next go on
    ],
)
def test_branches_that_agree_on_the_verdict_are_told_with_it(other, this, error, agreed):
    foldable, _, reason = judged(a_run(m1=this), error, before=a_run(m1=other))
    assert foldable is ((this > ALPHA) if agreed else None)
    assert agreed == ("with the same verdict" in reason)
    assert (error == 1.0) == ("took another branch" in reason)
    lost = a_run(m1=other, ending=Ending.LOST)
    assert judged(a_run(m1=this), error, before=lost)[0] is None


def test_another_branch_is_told_whatever_the_verdict():
    def told(before, this, error):
        errors = Errors(error, error)
        return judge(
            DESIGN, this, errors, LIMITS, accuracy=0.02, levels=2, coarse=False, before=before
        )[2].get("alternatives")

    there = [{"m1": 0.1, "m2": 0.2, "how": "the path on the mesh before"}]
    other, this = a_run(m1=0.1, m2=0.2), a_run(m1=2.0)
    assert told(other, this, 1.0) == told(other, a_run(m1=9.0), 0.9) == there
    assert told(other, this, 0.2) is told(None, this, 1.0) is None
    assert told(a_run(m1=0.1, ending=Ending.LOST), this, 1.0) is None
    # At a full turn it is the contraction that differs.
    assert told(other, a_run(closed=True, m1=6.3), 1.0) is None
    assert told(a_run(closed=True, m1=6.3), this, 1.0) is None


def test_a_closed_path_is_resolved_whatever_its_error():
    # At half a turn, which is not near what counts as folded but by the size of the error.
    run = a_run(closed=True, m1=6.3, m2=0.45 * ALPHA)
    assert judged(run, 0.1)[:2] == (True, "folds")
    assert judged(a_run(m1=6.3, m2=0.45 * ALPHA), 0.1)[:2] == (None, "unresolved")


def test_what_no_second_mesh_confirmed_is_unknown():
    foldable, outcome, reason = judged(a_run(m1=2.0), None)
    assert (foldable, outcome) == (None, "unverified")
    assert reason.startswith("unknown") and "folds by 2 rad" in reason


# -- weight in a reason --------------------------------------------------------------------------

# Own weight of the active layer over E_i: h_s³/Γ · (ρ_i/ρ_s)(h_i/h_s) / (E_i/E_s), lengths in l_s
SOFT = {"E_ratio": 1e-3, "rho_ratio": 10.0, "h_ratio": 10.0, "slenderness": 0.01}


def test_a_burden_beyond_the_modulus_is_named_and_is_no_verdict():
    lost = a_run(ending=Ending.NO_REST, states=False)
    for gamma, times in ((0.101, None), (0.099, "1 times"), (0.01, "10 times")):
        foldable, outcome, reason = judged(lost, None, **SOFT, stiffness_to_weight=gamma)
        assert (foldable, outcome) == (None, "no_rest")
        assert reason.startswith(f"unknown: {Ending.NO_REST.value}")
        assert ("its modulus" in reason) == (times is not None)
        assert times is None or f"with {times} its modulus" in reason


@pytest.mark.parametrize(
    "run, error, says",
    [
        (a_run(ending=Ending.LOST, states=False), None, True),
        (a_run(), None, True),  # no finer mesh confirmed it
        (a_run(), 0.01, False),  # a state is a state, however heavy
        (a_run(ending=Ending.TIMEOUT, states=False), None, False),  # time explains it
        (a_run(ending=Ending.LOST, states=False, heavy=False), None, False),  # no weight acts
    ],
)
def test_weight_is_named_only_where_it_may_be_the_reason(run, error, says):
    assert ("its modulus" in judged(run, error, **SOFT, stiffness_to_weight=0.01)[2]) == says


# -- what came first, and when -------------------------------------------------------------------


def test_curling_is_not_hidden_by_panels_that_stay_on_the_ground():
    curled = {"m1": 0.1, "m2": 0.9, "tip": 0.1, "lowest": 0.1}
    foldable, outcome, reason = judged(a_run(**curled), 0.01)
    assert (foldable, outcome) == (False, "curled")
    assert "curled about the other axis at 30 % contraction" in reason and "the ground" in reason
    assert judged(a_run(**curled | {"m2": 0.1}), 0.01)[1] == "grounded"


def test_events_of_a_release_are_dated_by_the_release():
    happenings = (Happening("snap", 0.4), Happening("twisting", 0.2))
    run = a_run(m1=2.0, m2=1.0, growth="release", release=0.9, happenings=happenings)
    _, _, evidence = judge(
        DESIGN, run, Errors(0.01, 0.01), LIMITS, accuracy=0.02, levels=2, coarse=False
    )
    dated = [(e["kind"], e["contraction"], e["release"]) for e in evidence["events"]]
    assert dated == [("twisting", 0.3, 0.2), ("snap", 0.3, 0.4), ("curling", 0.3, 0.9)]
    assert judged(run, 0.01)[2].endswith("at 90 % of the release")
    before = a_run(m1=2.0, happenings=happenings[:1])
    _, _, evidence = judge(
        DESIGN, before, Errors(0.01, 0.01), LIMITS, accuracy=0.02, levels=2, coarse=False
    )
    assert evidence["events"] == [{"kind": "snap", "contraction": pytest.approx(0.12)}]


def test_what_curled_beyond_return_is_no_fold_though_its_path_has_no_end():
    curled = a_run(m1=2.0, m2=2.5, ending=Ending.TIMEOUT)
    foldable, outcome, reason = judged(curled, None, gone=True)
    assert (foldable, outcome) == (False, "curled")
    times = 2.5 / (ALPHA / 2)
    assert f"2.5 rad at 30 % contraction, {times:.1f} times" in reason
    assert "none of 47 measured paths came back" in reason
    assert Ending.TIMEOUT.value in reason
    assert judged(curled, None)[:2] == (None, "timeout")
    # A path that came to its end says what it is by itself.
    assert judged(a_run(m1=2.0), 0.001, gone=True)[:2] == (True, "folds")


def test_no_return_is_told_of_paths_without_an_end_and_beyond_what_the_mesh_is_off():
    bound = RETURN * ALPHA / 2 + screening.ISOTROPIC_ERRORS[1] * ALPHA
    for m2, ending, beyond in (
        (1.01 * bound, Ending.TIMEOUT, True),
        (1.01 * bound, Ending.LOST, True),
        (0.99 * bound, Ending.TIMEOUT, False),
        (1.01 * bound, Ending.REACHED, False),
    ):
        assert beyond_return(a_run(m1=0.1, m2=m2, ending=ending), DESIGN, LIMITS) is beyond
    assert not beyond_return(a_run(ending=Ending.NO_REST, states=False), DESIGN, LIMITS)


@pytest.mark.parametrize(
    "changed, gone",
    [
        ({}, True),
        ({"conditions": Conditions()}, False),
        ({"conditions": Conditions(growth="isotropic", strips=4)}, False),
        ({"thresholds": Thresholds(need=1.0)}, False),
        ({"question": "exists"}, False),
        ({"seed": 0}, False),
        ({"changing": Changing(active_stiffness=0.5)}, False),
    ],
)
def test_no_return_is_told_of_labels_that_it_was_measured_on(changed, gone):
    source = SolverSource(**({"conditions": Conditions(growth="isotropic")} | changed))
    assert source._gone(DESIGN, a_run(m1=0.1, m2=3.0, ending=Ending.TIMEOUT)) is gone


def test_half_a_turn_about_the_other_axis_is_told_where_it_is_the_larger_turning():
    closed = {"closed": True, "m2": 3.2, "hinge": 3.0, "contraction": 0.2}
    _, outcome, reason = judged(a_run(m1=1.0, **closed), 0.01)
    assert outcome == "curled" and "through half a turn at 20 % contraction" in reason
    # Closed along the sheet it curled on the way.
    _, outcome, reason = judged(a_run(m1=6.3, **closed), 0.01)
    assert outcome == "curled" and "half a turn" not in reason


@pytest.mark.parametrize(
    ("measures", "outcome"),
    [
        ({"hinge": 2 * ALPHA, "tip": 1.0, "lowest": 0.0}, "sags"),
        ({"hinge": 2 * ALPHA}, "too_little"),  # without weight nothing sags
        ({"hinge": ALPHA, "tip": 1.0, "lowest": 0.0}, "too_little"),
        ({"hinge": 0.9 * ALPHA, "tip": 1.0, "lowest": 0.0}, "too_little"),
    ],
)
def test_panels_sag_where_the_hinge_alone_would_do(measures, outcome):
    assert judged(a_run(m1=0.5 * ALPHA, **measures), 0.01)[:2] == (False, outcome)
