"""Labels at their bounds: what is met exactly, what is stated, and what tells settings apart."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from foldlab.design import FULL, PATTERNED, REDUCED
from foldlab.errors import InputError
from foldlab.labels import screening, verdict
from foldlab.labels import solver as sources
from foldlab.labels.asked import Changing, Conditions, Effort
from foldlab.labels.foldability import TOUCHING, Thresholds
from foldlab.labels.run import Run
from foldlab.labels.solver import SolverSource
from foldlab.labels.sources import make_source
from foldlab.labels.strength import Strengths
from foldlab.labels.verdict import ACROSS, BRANCHED, Errors, calibrated, find_events, judge, since
from solver.cases.unit.path import Ending

LIMITS = Thresholds(turning=2.0, across=0.5, parallel=0.25)
DESIGN = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0, "h_ratio": 1.0,
    "stiffness_to_weight": 1.0, "aspect": 0.2, "slenderness": 0.01, "contraction": 0.25,
}  # fmt: skip
ROW = {
    "contraction": 0.25, "m1": 0.0, "m2": 0.0, "m3": 1.0, "m4": 1.0, "hinge": 0.0,
    "turning_hinge": 0.0, "turning_ends": 0.0, "unstable": 0,
}  # fmt: skip


def a_run(*rows, ending=Ending.REACHED, closed=False, growth="uniaxial", size=321):
    """A path of given states that the solver need not find."""
    history = [ROW | row for row in rows]
    curves = np.arange(12000.0).reshape(4, 1000, 3)
    state = SimpleNamespace(topples=True, curves=curves)
    unit = SimpleNamespace(contraction=0.25)
    folding = SimpleNamespace(
        ending=ending, detail=ending.value, happenings=(), last=state, iterations=7,
        states=(state,) * len(rows), model=SimpleNamespace(
            heavy=True, growth=growth, scene=SimpleNamespace(size=size), unit=unit,
            meshing=SimpleNamespace(curls=False),
        ),
    )  # fmt: skip
    return Run(folding, history, closed, [])


def judged(run, errors, **options):
    return judge(
        DESIGN, run, errors, LIMITS, **{"accuracy": 0.02, "levels": 3, "coarse": False} | options
    )


# -- met exactly -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("row", "beyond", "kind"),
    [
        ({"tip": 0.5}, {"tip": 0.5001}, "lift-off"),
        ({"clearance": TOUCHING}, {"clearance": 0.999 * TOUCHING}, "contact"),
        ({"m2": 0.2499}, {"m2": 0.25}, "curling"),
        ({"m3": 0.751}, {"m3": 0.75}, "warping"),
        ({"m3": 1.249}, {"m3": 1.25}, "warping"),
        ({"m4": 0.751}, {"m4": 0.75}, "warping"),
    ],
)
def test_an_event_sets_in_where_its_bound_is_met(row, beyond, kind):
    def seen(*rows):
        history = [ROW | r | {"contraction": 0.1 * k} for k, r in enumerate(rows, 1)]
        return [(e["kind"], round(e["contraction"], 9)) for e in find_events(history, 0.25, LIMITS)]

    assert seen(row) == seen(row, row) == []
    assert seen(row, beyond, beyond) == [(kind, 0.2)] and seen(beyond) == [(kind, 0.1)]
    # It stays: what went back again was none.
    assert seen(beyond, row) == [] and seen(beyond, row, beyond) == [(kind, 0.3)]
    # What curls or warps is by its tags no fold, at the same bound.
    if kind in ("curling", "warping"):
        tags = [all(LIMITS.tags(ROW | {"m1": 9.0} | r, 0.25).values()) for r in (row, beyond)]
        assert tags == [True, False]


@pytest.mark.parametrize(
    ("values", "index"),
    [([], None), ([True], 0), ([False], None), ([False, True, True], 1), ([True, False, True], 2),
     ([True, True], 0), ([True, False], None)],
)  # fmt: skip
def test_since_when_all_that_follows_is_true(values, index):
    assert since(values) == index


@pytest.mark.parametrize(("factor", "known"), [(1.0, True), (1.0001, False)])
def test_meshes_that_differ_by_less_than_branches_do_say_something_of_convergence(factor, known):
    earlier = Errors(0.1, factor * BRANCHED)
    stated = Errors(1e-9, 1e-9).stated(2, earlier, 0.0).m1
    assert (stated == pytest.approx(0.025)) is known
    # And so do two paths: at the bound the next mesh explains it.
    run, other = a_run({"m1": 2.0}), a_run({"m1": 0.1})
    evidence = judged(run, Errors(factor * BRANCHED, 0.0), before=other)[2]
    assert ("alternatives" in evidence) is not known


@pytest.mark.parametrize(("off", "open_"), [(0.02, False), (0.0201, True)])
def test_what_is_known_as_well_as_was_asked_for_is_decided(off, open_):
    for run, errors in (
        (a_run({"m1": 0.5001}), Errors(off, 0.0)),
        (a_run({"m1": 2.0, "m2": 0.2499}), Errors(0.0, off)),
        (a_run({"m1": 0.5001}), Errors(off, 0.3)),
    ):
        foldable, reason, evidence = judged(run, errors)
        assert foldable is (None if open_ else True), reason
        assert (evidence["outcome"] == "unresolved") is open_


@pytest.mark.parametrize(("accuracy", "open_"), [(0.15, False), (0.149, True)])
def test_edges_that_slip_on_the_coarsest_mesh_count_where_more_accuracy_was_asked_for(
    accuracy, open_
):
    run = a_run({"m1": 2.0, "m3": 0.7501})
    options = {"accuracy": accuracy, "coarse": True}
    foldable, reason, _ = judged(run, Errors(0.15, 0.1), **options)
    assert foldable is (None if open_ else True) and ("m3 is off 1 by 0.25" in reason) is open_


@pytest.mark.parametrize(("stiff", "told"), [(1.0, ""), (0.5, "2 times its modulus")])
def test_a_layer_bears_its_own_weight_up_to_its_modulus(stiff, told):
    design = DESIGN | {
        "E_ratio": stiff, "slenderness": 0.5, "stiffness_to_weight": 0.25, "rho_ratio": 2.0,
    }  # fmt: skip
    says = verdict._burden(design)
    assert told in says and bool(says) is bool(told)


# -- what the evidence states ----------------------------------------------------------------------


def test_evidence_is_of_the_last_state_and_of_the_whole_path():
    rows = (
        {"contraction": 0.0, "tip": 0.04, "lowest": 0.03},
        {"contraction": 0.1, "m1": 1 / 3, "m2": 0.1, "tip": 0.2, "lowest": -0.06},
        {"contraction": 0.25, "m1": 2.0, "m2": 0.2, "tip": 0.9, "lowest": -0.02},
    )
    run = a_run(*rows)
    foldable, reason, e = judged(run, Errors(0.01, 0.015))
    assert foldable is True and reason.startswith("folds by 2 rad, more than the 0.5 rad")
    assert (e["outcome"], e["stable"], e["unstable_modes"], e["topples"]) == (
        "folds",
        True,
        0,
        True,
    )
    assert (e["rest_gap"], e["penetration"]) == (0.04, 0.06)
    assert (e["fold_angle"], e["normalised_angle"], e["contraction_reached"]) == (2.0, 8.0, 0.25)
    assert (e["need"], e["threshold"], e["error_estimate"]) == (0.5, 2.0, 0.01)
    assert (e["error_m1"], e["error_m2"]) == pytest.approx((0.02, 0.03))
    assert (e["levels"], e["iterations"], e["steps"], e["unknowns"]) == (3, 7, 3, 321)
    assert e["history"] == [[0.0, 0.0, 0.0], [0.1, 0.333333, 0.1], [0.25, 2.0, 0.2]]
    first, last = np.array(e["curves"])[0, [0, -1]]
    assert first.tolist() == [0, 1, 2] and last.tolist() == [2997, 2998, 2999]
    assert np.shape(e["curves"]) == (4, 28, 3)
    unstable = judged(a_run({"m1": 2.0, "unstable": 1}), Errors(0.0, 0.0))[2]
    assert (unstable["stable"], unstable["unstable_modes"]) == (False, 1)
    lost = judged(a_run({"m1": 2.0}, ending=Ending.LOST), None)[2]
    assert (lost["stable"], lost["outcome"], lost["error_estimate"]) == (False, "lost", None)
    # Small angles: what counts as folded is what errors are relative to. Never lifted: no depth.
    flat = judged(a_run({"m1": 0.1, "tip": 0.0, "lowest": 0.01}), Errors(0.1, 0.2))[2]
    assert (flat["error_m1"], flat["error_m2"]) == pytest.approx((0.05, 0.1))
    assert flat["penetration"] == 0 and flat["rest_gap"] == 0.01


def test_a_row_of_the_history_is_in_rad_and_thicknesses():
    y = np.linspace(-0.5, 0.5, 1000)
    curves = np.zeros((4, 1000, 3))
    curves[[0, 2, 3], :, 1], curves[1, :, 0] = y, 0.2 * y
    state = SimpleNamespace(
        curves=curves, e=0.5, unstable=2, tip=0.02, lowest=-0.001, clearance=0.004
    )
    unit = SimpleNamespace(slenderness=0.01, active=0.02, hinge_length=0.2, contraction=0.3)
    row = verdict.row_of(state, unit)
    assert (row["contraction"], row["unstable"]) == (0.15, 2)
    assert [row[k] for k in ("m1", "m2", "m3", "m4")] == pytest.approx([0, 0, 1, 1], abs=1e-9)
    heights = row["tip"], row["lowest"], row["clearance"]
    assert heights == pytest.approx((2.0, -0.1, 0.4))
    bare = SimpleNamespace(curves=curves, e=0.5, unstable=0, tip=None, lowest=None, clearance=None)
    assert not {"tip", "lowest", "clearance"} & set(verdict.row_of(bare, unit))


@pytest.mark.parametrize(("m1", "over"), [(2.0, 2.0), (0.1, 0.5)])
def test_calibrated_errors_are_bounds_in_rad_over_the_larger_of_angle_and_threshold(m1, over):
    errors = calibrated(a_run({"m1": m1}), DESIGN, LIMITS)
    bound = screening.COARSE_ERROR
    assert (errors.m1, errors.m2) == pytest.approx((bound, bound * 0.5 / over))
    errors = calibrated(a_run({"m1": m1}, growth="isotropic"), DESIGN, LIMITS)
    along, across = screening.ISOTROPIC_ERRORS
    assert (errors.m1, errors.m2) == pytest.approx((along, across * 0.5 / over))


@pytest.mark.parametrize(
    ("curls", "level", "elements"), [(False, 0, 1), (True, 0, 2), (True, 2, 3)]
)
def test_the_turning_across_is_stated_by_the_elements_that_are_there(curls, level, elements):
    from solver.cases.unit.mesh import LEVELS

    run = a_run({"m1": 2.0})
    run.folding.model.meshing.curls = curls
    elements = min(LEVELS[level].across + curls, 3)
    least = SolverSource(thresholds=LIMITS)._across(run, level)
    # Over |g|π where that is the scale, and else less.
    assert least == pytest.approx(ACROSS[elements] * 0.5 / 2.0)
    flat = a_run({"m1": 0.1})
    flat.folding.model.meshing.curls = curls
    assert SolverSource(thresholds=LIMITS)._across(flat, level) == pytest.approx(ACROSS[elements])


# -- settings --------------------------------------------------------------------------------------

ISOTROPIC = Conditions(growth="isotropic")


def test_every_setting_that_may_change_an_answer_has_a_version_of_its_own():
    plain = SolverSource()
    several = [
        plain, SolverSource(ISOTROPIC), SolverSource(ISOTROPIC, question="exists"),
        *(
            SolverSource(Conditions(**given))
            for given in (
                {"effects": "none"}, {"effects": "contact"}, {"effects": "gravity,ground,contact"},
                {"upright": False}, {"strips": 2}, {"strips": 3}, {"strips": 2, "strip_share": 0.4},
                {"barrier": "exponential"}, {"friction": 0.1}, {"friction": 0.2},
            )
        ),
        SolverSource(seed=0), SolverSource(seed=1), SolverSource(effort=Effort(0.01)),
        SolverSource(effort=Effort(refine="near")), SolverSource(effort=Effort(refine="never")),
        *(SolverSource(thresholds=Thresholds(**{n: 1.25})) for n in vars(Thresholds())),
        *(SolverSource(strengths=Strengths(**{n: 0.1})) for n in vars(Strengths())),
        *(SolverSource(changing=Changing(**{n: 0.5})) for n in vars(Changing())),
    ]  # fmt: skip
    versions = [source.version for source in several]
    assert len(set(versions)) == len(versions)
    # Neither time nor the share of strips that are not there.
    assert replace(plain, effort=Effort(timeout=5.0)).version == plain.version
    assert SolverSource(Conditions(strip_share=0.3)).version == plain.version


@pytest.mark.parametrize(
    "given",
    [
        {"conditions": ISOTROPIC}, {"conditions": Conditions(effects="none")},
        {"conditions": Conditions(upright=False)}, {"conditions": Conditions(strips=2)},
        {"conditions": Conditions(friction=0.1)}, {"conditions": Conditions(barrier="exponential")},
        {"seed": 0}, {"changing": Changing(active_density=2.0)}, {"space": PATTERNED},
    ],
)  # fmt: skip
def test_the_coarsest_mesh_is_trusted_where_its_error_was_measured_alone(given):
    SolverSource(**given)
    for refine in ("near", "never"):
        with pytest.raises(InputError, match="take 'always'"):
            SolverSource(**given, effort=Effort(refine=refine))
        share = Conditions(strip_share=0.3)
        assert SolverSource(share, Effort(refine=refine)).effort.refine == refine


def test_a_question_needs_what_it_is_about():
    with pytest.raises(InputError, match="expected 'from_flat' or 'exists'"):
        SolverSource(question="ever")
    with pytest.raises(InputError, match="set growth=isotropic"):
        SolverSource(question="exists")
    with pytest.raises(InputError, match="sample with --space full"):
        SolverSource(space=REDUCED)
    with pytest.raises(InputError, match="leave the setting out"):
        SolverSource(Conditions(strips=1), space=PATTERNED)
    with pytest.raises(InputError, match="there are: timoshenko, rod, solver"):
        make_source("abaqus")
    assert SolverSource().space == FULL and not SolverSource().patterned


@pytest.mark.parametrize("e", [0.0, 0.25, 1.0])
def test_materials_change_in_proportion_to_the_contraction(e):
    source = SolverSource(changing=Changing(2.0, 0.5, 3.0, 0.25, 0.1))
    active, passive = source._changes(lambda e: e)
    assert active.stiffness(e) == pytest.approx(1 + e)
    assert active.density(e) == pytest.approx(1 + 2 * e) and active.expansion is None
    assert passive.stiffness(e) == pytest.approx(1 - 0.5 * e)
    assert passive.density(e) == pytest.approx(1 - 0.75 * e)
    assert passive.expansion(e) == pytest.approx(0.1 * e)
    same, other = SolverSource()._changes(lambda e: e)
    assert same == other and same.stiffness is same.density is same.expansion is None


@pytest.mark.parametrize(
    ("slenderness", "aspect", "told"),
    [
        (2e-6, 1.0, ""), (1e-6, 1.0, "slenderness = 1e-06 and l_s = 1 lie too far apart; "),
        (1e-3, 1e3, "slenderness = 0.001 and aspect = 1000 lie too far apart; "), (1e-3, 900.0, ""),
    ],
)  # fmt: skip
def test_lengths_too_far_apart_are_the_cause_of_a_mesh_that_can_not_be(slenderness, aspect, told):
    unit = SimpleNamespace(slenderness=slenderness, hinge_length=0.2, aspect=aspect)
    assert sources._why(unit) == told


@pytest.mark.parametrize(
    ("peak", "foldable", "outcome"),
    [(0.05, True, "folds"), (0.09, None, "unresolved"), (0.2, False, "breaks")],
)
def test_what_folds_and_breaks_does_not_fold(peak, foldable, outcome):
    evidence = {
        "outcome": "folds", "strain": {"passive": peak}, "peak_errors": {"strain": {"passive": 0.2}}
    }  # fmt: skip
    source = SolverSource(strengths=Strengths(passive_strain=0.1))
    got, reason, seen = source._borne(True, "folds", evidence)
    assert (got, seen) == (foldable, outcome)
    assert reason.startswith("unknown: ") == (foldable is None)
    assert ("nothing breaks" in reason) == (foldable is True)
    assert source._borne(None, "so", evidence) == (None, "so", "folds")
    assert SolverSource()._borne(True, "so", evidence) == (True, "so", "folds")


# -- meshes ----------------------------------------------------------------------------------------

NEED = 0.25 * np.pi


@pytest.mark.parametrize(
    ("m1", "offs", "accuracy", "size", "levels", "error"),
    [
        (2.0, (1e-3,), 0.02, 321, 1, 9e-3),  # two meshes agree
        (2.0, (0.1, 1e-3), 0.02, 321, 2, 0.025),  # a third one, and no fourth, though it is off
        (0.8, (0.1, 1e-3, 1e-3), 0.02, 321, 3, 2e-3),  # but where the verdict hangs on it
        (0.8, (0.1, 0.01, 1e-3), 0.02, 321, 3, 2.5e-3),
        (0.8, (1e-3,), 0.02, 321, 1, 9e-3),  # known as well as was asked for
        (2.0, (0.1,), 0.02, 6001, 1, 0.13),  # too large to be refined
        (2.0, (0.1, 1e-3), 0.02, 6000, 2, 0.025),
        (0.8, (0.1, 1e-3, 1e-3), 0.02, 18000, 3, 2e-3),  # larger where the verdict hangs on it
        (0.8, (0.1,), 0.02, 18003, 1, 0.13),
        (2.0, (1e-3,), 0.01, 321, 1, 9e-3),
        (2.0, (1e-3, 1e-3), 9.9e-3, 321, 2, 5.5e-3),  # the path's mesh counts for nothing
        (2.0, (1e-3, 1e-3, 1e-3), 5e-3, 321, 3, 2e-3),
        (2.0, (0.1, 1e-3), 5e-3, 20001, 1, 0.13),
    ],
)
def test_meshes_are_refined_until_two_agree_as_well_as_was_asked_for(
    m1, offs, accuracy, size, levels, error, monkeypatch
):
    run, asked = a_run({"m1": m1}, size=size), []

    def refined(self, before, level, deadline, thorough=True):
        asked.append(level)
        return run, Errors(offs[level - 1], 0.0)

    monkeypatch.setattr(SolverSource, "run", lambda self, groups, level=1, **limits: run)
    monkeypatch.setattr(SolverSource, "_refined", refined)
    monkeypatch.setattr(SolverSource, "_peaks", lambda self, run, before=None: {})
    label = SolverSource(effort=Effort(accuracy)).label(DESIGN)
    assert asked == list(range(1, levels + 1))
    e = label.evidence
    assert e["error_estimate"] == pytest.approx(error)
    assert (e["levels"], e["error_basis"]) == (levels + 1, "measured")
    sure = error <= accuracy or error * max(m1, NEED) < m1 - NEED
    assert label.foldable is (True if sure else None)
