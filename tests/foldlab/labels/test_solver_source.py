"""Labels from the solver: what they say, what they keep, and how they end."""

import ctypes
import json
import os
import pickle
import subprocess
import sys
import weakref
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numba.core import event

from foldlab.design import PATTERNED, REDUCED
from foldlab.errors import InputError
from foldlab.labels import foldability, solver
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.foldability import Thresholds
from foldlab.labels.label import LabelSource, storable
from foldlab.labels.rod import RodSource
from foldlab.labels.solver import SolverSource
from foldlab.labels.sources import make_source
from foldlab.labels.strength import Strengths
from foldlab.labels.verdict import ACROSS, CURVE_POINTS, FLOOR, Errors
from foldlab.memory import hand_back
from solver.equilibrium import clock
from solver.physics.elastic import Elastic

LIGHT = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0, "h_ratio": 5.0,
    "stiffness_to_weight": 1.0, "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.2,
}  # fmt: skip
HEAVY = LIGHT | {"stiffness_to_weight": 0.01, "hinge_length": 0.1, "contraction": 0.1}
SOFT = LIGHT | {
    "E_ratio": 1e-3, "rho_ratio": 10.0, "h_ratio": 10.0, "stiffness_to_weight": 0.0123,
    "slenderness": 0.0256, "aspect": 0.3,
}  # fmt: skip


def labelled(design, **settings):
    label = make_source("solver", settings).label(design)
    kept = storable(label)
    assert kept.foldable == label.foldable  # nothing in the evidence that a store refuses
    json.dumps(dict(kept.evidence), allow_nan=False)
    assert (label.source, label.version) == ("solver", make_source("solver", settings).version)
    return label


def test_a_light_unit_folds():
    label = labelled(LIGHT)
    seen = label.evidence
    assert label.foldable is True and seen["outcome"] == "folds"
    assert f"{seen['m1']:.3g} rad" in label.reason and "0.628 rad" in label.reason
    assert seen["stable"] and seen["unstable_modes"] == 0
    assert seen["contraction_reached"] == pytest.approx(0.2)
    assert all(seen[tag] for tag in foldability.TAGS)
    assert 0 <= seen["error_estimate"] <= 0.02 and seen["levels"] >= 2
    # in h_s, what a ground scaled to the design allows
    assert seen["rest_gap"] <= 0.25 and seen["penetration"] <= 0.1
    kinds = [event["kind"] for event in seen["events"]]
    assert kinds == ["lift-off", "toppling"] and seen["topples"]
    places = [event["contraction"] for event in seen["events"]]
    assert 0 < places[0] <= places[1] < 0.2
    # What is kept of the curves still tells the angle, in chords of the panels.
    curves = np.array(seen["curves"])
    assert curves.shape == (4, len(CURVE_POINTS), 3)
    assert foldability.measure(curves, 0.25).m1 == pytest.approx(seen["m1"], abs=0.1)
    contractions = [entry[0] for entry in seen["history"]]
    assert contractions[0] == 0 and np.all(np.diff(contractions) > 0)
    assert 0 < seen["core_seconds"] <= seen["seconds"] * 1.5


BUSY = "ulimit -t 30; while :; do :; done"


def test_a_busy_neighbour_changes_no_answer():
    """With three busy processes for each core a label takes more on the wall than its timeout."""
    design, effort = LIGHT | {"contraction": 0.05}, Effort(accuracy=0.2, refine="never")
    first = SolverSource(effort=effort).label(design)
    timeout = 2 * first.evidence["core_seconds"]
    cores = os.cpu_count() or 1
    busy = [subprocess.Popen(["sh", "-c", BUSY]) for _ in range(3 * cores)]
    try:
        loaded = SolverSource(effort=replace(effort, timeout=timeout)).label(design)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert (loaded.foldable, loaded.reason) == (first.foldable, first.reason)
    for name in ("m1", "m2", "levels", "outcome"):
        assert loaded.evidence[name] == first.evidence[name]


ALONE = """
import json, sys
from foldlab.campaign import worker
from foldlab.cli import main  # as the main module of a campaign from the command line
from foldlab.labels.asked import Effort
from foldlab.labels.solver import SolverSource

source = SolverSource(effort=Effort(accuracy=0.2, refine="never"))
label = worker.attempt(worker.Parcel(source), json.loads(sys.argv[1]))
assert label.foldable, label.reason
print(*({"pandas", "pyarrow", "vtkmodules", "typer", "rich", "scipy.stats"} & set(sys.modules)))
"""


def test_a_label_needs_no_tables_and_no_pictures():
    """pandas and VTK hold 100 MB in each worker."""
    design = json.dumps(LIGHT | {"contraction": 0.05})
    done = subprocess.run(
        [sys.executable, "-c", ALONE, design], capture_output=True, text=True, timeout=100
    )
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


def test_a_label_hands_its_memory_back_when_nothing_of_the_path_is_held(monkeypatch):
    alive, follow = [], SolverSource._follow

    def followed(*args):
        run, label = follow(*args)
        alive.append(weakref.ref(run))
        return run, label

    told = []
    monkeypatch.setattr(SolverSource, "_follow", followed)
    monkeypatch.setattr(solver, "hand_back", lambda: told.append(alive[-1]()))
    SolverSource(effort=Effort(accuracy=0.2, refine="never")).label(LIGHT | {"contraction": 0.05})
    assert told == [None]


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="GNU's C library only")
def test_memory_that_lies_between_what_is_held_goes_back_to_the_system():
    def held():
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0]) / 1024

    # Below the size from which each block is mapped, so returned, by itself.
    blocks = [b"x" * 50_000 for _ in range(4000)]
    kept = blocks[::40]
    full = held()
    del blocks
    hand_back()
    assert full - held() > 100 and len(kept) == 100


def test_compiling_does_not_count(monkeypatch):
    passed = [0.0]
    monkeypatch.setattr(clock, "time", SimpleNamespace(thread_time=lambda: passed[0]))
    evaluate = Elastic.evaluate

    def compiles(*args):
        with event.trigger_event("numba:compiler_lock"):
            passed[0] += 100.0
        passed[0] += 1e-3
        return evaluate(*args)

    monkeypatch.setattr(Elastic, "evaluate", compiles)
    label = SolverSource(Conditions(effects="none"), Effort(accuracy=0.1, timeout=5.0)).label(LIGHT)
    assert label.foldable is True
    assert passed[0] > 1000 and 0.01 < label.evidence["core_seconds"] < 5


def test_the_error_covers_what_the_next_mesh_changes():
    source = SolverSource(Conditions(effects="none"), Effort(accuracy=0.1))
    label = source.label(LIGHT)
    assert label.evidence["levels"] == 2
    finer = source.run(LIGHT, 2).measures["m1"]
    off = abs(label.evidence["m1"] - finer) / finer
    assert off < label.evidence["error_estimate"] < 0.1


def test_a_heavy_unit_stays_on_the_ground():
    label = labelled(HEAVY)
    assert label.foldable is False and label.evidence["outcome"] == "grounded"
    assert label.reason.startswith("panels never left the ground")
    assert label.evidence["events"] == []
    assert not label.evidence["F1"] and label.evidence["stable"]


def test_where_a_soft_heavy_hinge_has_no_state_the_label_is_unknown_and_names_the_weight():
    label = labelled(SOFT)
    assert label.foldable is None and not label.evidence["stable"]
    assert label.evidence["outcome"] in ("no_rest", "lost", "unverified")
    assert label.reason.startswith("unknown")
    # Its weight per area, ρ_i g h_i with ρ_s g = (h_s/l_s)²/Γ, over E_i
    times = 0.0256**2 / 0.0123 * 10 * 10 * 0.0256 / 1e-3
    assert label.reason.endswith(f"presses on it with {times:.2g} times its modulus")
    # Without weight there is nothing of the kind to say.
    assert "weight" not in labelled(SOFT, effects="none").reason


def test_without_weight_there_is_no_ground_to_speak_of():
    label = labelled(LIGHT, effects="none")
    assert label.foldable is True
    assert not {"rest_gap", "penetration"} & set(label.evidence)
    assert label.evidence["events"] == [] and not label.evidence["topples"]


def test_time_that_runs_out_is_an_unknown_with_what_was_seen():
    # The first label of a process waits for the solver to be imported too.
    _, label = (labelled(LIGHT, timeout=0.05) for _ in range(2))
    assert label.evidence["core_seconds"] < 2
    assert label.foldable is None and label.evidence["outcome"] == "timeout"
    assert label.reason == "unknown: the time allowed was used up"
    assert not label.evidence["stable"]
    assert label.evidence.get("contraction_reached", 0.0) < 0.2


def test_a_fold_that_turns_fully_ends_there():
    label = labelled(LIGHT | {"contraction": 0.4, "hinge_length": 0.3}, effects="none")
    assert label.foldable is True
    assert label.evidence["m1"] >= 2 * np.pi
    assert label.evidence["contraction_reached"] < 0.4
    assert "through a full turn" in label.reason
    reached = label.evidence["contraction_reached"]
    assert f"{100 * reached:.3g} % contraction" in label.reason


def test_a_hinge_that_curls_by_half_a_turn_ends_there():
    # A wide thin hinge that contracts in all directions curls about the other axis.
    wide = LIGHT | {"aspect": 0.5, "hinge_length": 0.2, "slenderness": 0.01, "contraction": 0.4}
    run = SolverSource(Conditions(effects="none", growth="isotropic")).run(wide, 0)
    assert run.closed and run.settled
    assert run.measures["m2"] >= np.pi > run.history[-2]["m2"]
    assert run.measures["m1"] < 1 and run.folding.last.e < 1


@pytest.mark.parametrize(
    "across, m1, levels",
    [(0.0, 1.1, 2), (0.24, 1.1, 2), (0.26, 1.1, 3), (0.74, 1.1, 3), (0.76, 1.1, 2), (0.5, 0.9, 2)],
)
def test_where_turning_across_the_hinge_decides_two_elements_across_tell_it(
    across, m1, levels, monkeypatch
):
    """Meshes 0 and 1 have one element across; m2 errs by up to a quarter of |g|π on them."""
    source = SolverSource(Conditions(effects="none"), Effort(accuracy=0.1))
    run = source.run(LIGHT, 0)
    need = np.pi * LIGHT["contraction"]
    run.history[-1] |= {"m1": m1 * need, "m2": across * need}
    monkeypatch.setattr(SolverSource, "run", lambda *args, **limits: run)
    same = Errors(1e-6, 1e-6)
    monkeypatch.setattr(
        SolverSource, "_refined", lambda self, run, level, deadline, thorough: (run, same)
    )
    label = source.label(LIGHT)
    assert label.evidence["levels"] == levels
    # What is asked is the accuracy of m1; the error of m2 is stated beside it.
    assert label.evidence["error_estimate"] == FLOOR[levels - 1]
    assert label.evidence["error_m2"] == pytest.approx(ACROSS[levels - 1] * need)


def test_a_fold_can_exist_where_the_hinge_contracts_in_all_directions():
    # Little contraction of a narrow hinge: the fold survives the release, and fewer mesh.
    design = LIGHT | {"contraction": 0.05, "aspect": 0.05, "slenderness": 0.01}
    conditions = Conditions(growth="isotropic", effects="none")
    source = SolverSource(conditions, Effort(accuracy=0.1), question="exists")
    run = source.run(design, 0)
    assert run.settled and run.history[-1]["unstable"] == 0
    contractions = [row["contraction"] for row in run.history]
    assert contractions[0] == 0 and contractions[-1] == 0.05
    # First it folds as under uniaxial contraction, then it is released at the full contraction.
    first = SolverSource(Conditions(effects="none")).run(design, 0)
    released = contractions.index(0.05)
    assert run.history[released]["m1"] == pytest.approx(first.measures["m1"], rel=0.02)
    assert contractions.count(0.05) > 2
    assert run.measures["m2"] > 2 * run.history[released]["m2"]


def test_a_source_travels_to_other_processes():
    source = SolverSource(Conditions(growth="isotropic"), Effort(accuracy=0.05, timeout=9))
    assert isinstance(source, LabelSource)
    there = pickle.loads(pickle.dumps(source))
    assert vars(there) == vars(source)


def test_versions_tell_settings_apart():
    options = [
        {}, {"accuracy": 0.05}, {"effects": "none"}, {"growth": "isotropic"}, {"upright": False},
        {"growth": "isotropic", "question": "exists"}, {"seed": 1}, {"seed": 2},
        {"barrier": "exponential"}, {"strips": 2}, {"strips": 2, "strip_share": 0.8},
        {"effects": "contact"}, {"refine": "near"}, {"need": 1.57}, {"need": 1.571},
        {"passive_strain": 0.05}, {"active_strain": 0.05}, {"shear": 0.05},
    ]  # fmt: skip
    assert len({make_source("solver", o).version for o in options}) == len(options)
    # What can't change an answer makes no other version.
    same = [{}, {"timeout": 9.0}, {"strip_share": 0.8}]
    assert {make_source("solver", o).version for o in same} == {"12-uniaxial-gravity+ground-0.02"}


def test_settings_without_strips_do_not_say_what_strips_cover():
    assert make_source("solver", {"refine": "near", "strip_share": 0.8}).effort.refine == "near"


def test_a_design_may_say_its_strips_itself():
    cut = {"strips": 2, "strip_share": 0.8}
    common = Effort(accuracy=0.1)
    own = SolverSource(Conditions(effects="none"), common, space=PATTERNED)
    asked = SolverSource(Conditions(effects="none", **cut), common)
    one, other = own.label(LIGHT | cut), asked.label(LIGHT)
    assert one.evidence["m1"] == other.evidence["m1"]
    assert (
        one.evidence["m1"]
        != SolverSource(Conditions(effects="none"), common).label(LIGHT).evidence["m1"]
    )
    assert one.design == LIGHT | cut and other.design == LIGHT
    for change in ({"strips": 2.5}, {"strips": 51}, {"strip_share": 1.2}):
        with pytest.raises(InputError, match=next(iter(change))):
            own.label(LIGHT | cut | change)
    with pytest.raises(InputError, match="leave the setting out"):
        replace(own, conditions=Conditions(strips=3))
    with pytest.raises(InputError, match="refine"):
        replace(own, conditions=Conditions(), effort=Effort(refine="near"))


@pytest.mark.parametrize("accuracy, finest", [(0.02, 2), (0.005, 3)])
def test_meshes_beyond_the_cap_on_unknowns_are_not_refined(accuracy, finest, monkeypatch):
    source = SolverSource(Conditions(effects="none"), Effort(accuracy))
    run = source.run(LIGHT, 0)
    size = run.folding.model.scene.size
    monkeypatch.setattr(SolverSource, "run", lambda *args, **limits: run)
    refined = run, Errors(0.1, 0.0)
    monkeypatch.setattr(
        SolverSource, "_refined", lambda self, run, level, deadline, thorough: refined
    )
    for cap, levels in ((size, finest + 1), (size - 1, 2)):
        monkeypatch.setitem(solver.LARGEST, finest, cap)
        assert source.label(LIGHT).evidence["levels"] == levels


def test_a_verdict_that_hangs_on_the_mesh_gets_one_more_and_larger_ones(monkeypatch):
    monkeypatch.setattr(solver, "FURTHER", 3)
    source = SolverSource(Conditions(effects="none"), Effort(0.02))
    run = source.run(LIGHT, 0)
    size = run.folding.model.scene.size
    monkeypatch.setattr(SolverSource, "run", lambda *args, **limits: run)
    need = run.measures["m1"] / 1.01
    limits = Thresholds(need=need), Thresholds(need=need / 1.2)
    monkeypatch.setattr(
        SolverSource,
        "_refined",
        lambda self, run, level, deadline, thorough: (run, Errors(0.1, 0.0)),
    )
    for cap, near, far in ((size, 4, 3), (size - 1, 4, 2), (size / 3.01, 2, 2)):
        monkeypatch.setitem(solver.LARGEST, 2, cap)
        labels = [replace(source, thresholds=t).label(LIGHT) for t in limits]
        assert [label.evidence["levels"] for label in labels] == [near, far]
    assert labels[0].foldable is None and labels[1].foldable


@pytest.mark.parametrize(
    "settings, says",
    [
        ({"growth": "sideways"}, "uniaxial"),
        ({"question": "why"}, "from_flat"),
        ({"question": "exists"}, "isotropic"),
        ({"effects": "gravity"}, "together"),
        ({"accuracy": 0.0}, "accuracy"),
        ({"accuracy": np.nan}, "accuracy"),
        ({"accuracy": 2.0}, "relative error below 1"),
        ({"timeout": -1.0}, "timeout"),
        ({"space": REDUCED}, "full"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, says):
    with pytest.raises(InputError, match=says):
        make_source("solver", settings)


def test_a_design_that_is_no_unit_is_refused():
    for change in (
        {"slenderness": -1.0},
        {"hinge_length": 2.0},
        {"contraction": np.inf},
        {"aspect": 1e99},
    ):
        with pytest.raises(InputError):
            SolverSource().label(LIGHT | change)
    with pytest.raises(InputError, match=r"no mesh: .* and aspect = 1e\+29 lie .*inverted or flat"):
        SolverSource().label(LIGHT | {"aspect": 1e29})
    with pytest.raises(
        InputError, match="no mesh: slenderness = 1e-09 and l_s = 1 lie too far apart"
    ):
        SolverSource().label(LIGHT | {"slenderness": 1e-9})


def test_labels_know_what_strains_and_what_breaks():
    source = SolverSource(Conditions(effects="none"))
    label = source.label(LIGHT)
    e = label.evidence
    assert label.foldable
    assert e["turning_hinge"] + e["turning_ends"] == pytest.approx(e["m1"], rel=0.01)
    strain = e["strain"]["passive"]
    assert strain == max(e["tension"]["passive"], -e["compression"]["passive"]) > 0.01
    assert 0 <= e["peak_errors"]["strain"]["passive"] < 0.1
    assert e["averaged_over"] == LIGHT["slenderness"]

    def bearing(limit):
        return replace(source, strengths=Strengths(passive_strain=limit)).label(LIGHT)

    broken, sound, doubtful = (bearing(k * strain) for k in (0.8, 1.25, 1.0))
    assert (broken.foldable, broken.evidence["outcome"]) == (False, "breaks")
    assert "but breaks: the passive layer's strain is" in broken.reason
    assert sound.foldable and sound.reason.endswith("and nothing breaks")
    assert (doubtful.foldable, doubtful.evidence["outcome"]) == (None, "unresolved")
    # What does not fold is not asked whether it breaks.
    flat = replace(source, strengths=Strengths(passive_strain=1e-9)).label(
        LIGHT | {"E_ratio": 1e-3, "h_ratio": 0.1}
    )
    assert flat.evidence["outcome"] == "too_little"


def test_what_counts_as_folded_may_be_given_in_rad():
    angle = SolverSource(Conditions(effects="none")).label(LIGHT).evidence["m1"]
    for need, folds in ((0.9 * angle, True), (1.1 * angle, False)):
        label = make_source("solver", {"effects": "none", "need": need}).label(LIGHT)
        assert label.foldable is folds and f"{need:.3g} rad" in label.reason
        assert label.evidence["need"] == need


def test_the_dissertations_first_row_folds_where_contraction_is_along_the_sheet():
    """Table 4.2, row 1, printed foldable; its §4.3.2 contracts in all directions, which curls."""
    row = {
        "E_ratio": 0.1, "rho_ratio": 0.1, "hinge_length": 0.25, "hinge_width": 1.0, "h_ratio": 0.2,
        "stiffness_to_weight": 0.4, "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.4,
    }  # fmt: skip
    label = SolverSource().label(row)
    assert label.foldable and label.evidence["m1"] == pytest.approx(3.84, rel=0.01)
    isotropic = make_source("solver", {"growth": "isotropic", "accuracy": 0.1}).label(row)
    assert (isotropic.foldable, isotropic.evidence["outcome"]) == (False, "curled")
    assert "never left the ground" in isotropic.reason


def test_friction_is_told_in_the_version_and_changes_what_slides():
    sags = LIGHT | {
        "E_ratio": 0.1, "h_ratio": 2.0, "hinge_length": 0.3, "stiffness_to_weight": 0.05,
        "contraction": 0.05,
    }  # fmt: skip
    free, rubbed = (SolverSource(Conditions(friction=mu), Effort(0.1)) for mu in (0.0, 1.0))
    assert "friction" not in free.version and rubbed.version.endswith("-friction1")
    one, other = free.label(sags).evidence, rubbed.label(sags).evidence
    assert one["m1"] < other["m1"] < 0  # it sags, and its ends are held back
    assert other["levels"] == 2 and other["error_m1"] > 0  # two paths, each with its own pulls


@pytest.mark.parametrize(
    "asked",
    [{"friction": -1.0}, {"friction": np.inf}, {"friction": 0.3, "effects": "none"},
     {"friction": 0.3, "barrier": "exponential"}],
)  # fmt: skip
def test_friction_without_a_ground_is_refused(asked):
    with pytest.raises(InputError, match="friction = "):
        Conditions(**asked)


def test_a_rod_and_a_calibrated_error_know_no_friction():
    with pytest.raises(InputError, match=r"friction 0\.3: a planar rod"):
        RodSource(Conditions(friction=0.3))
    with pytest.raises(InputError, match="take 'always'"):
        SolverSource(Conditions(friction=0.3), Effort(refine="near"))
