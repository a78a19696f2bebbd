"""What ``foldlab simulate`` and ``foldlab design`` print, and what they read of their options."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import typer

from foldlab.cli import app, design, simulate
from foldlab.cli.quickstart import Settings
from foldlab.errors import InputError
from foldlab.inverse.wish import Angle
from foldlab.labels.foldability import TAGS, Thresholds
from foldlab.labels.label import Label
from foldlab.unit import record

RESULT = {
    "events": [], "alternatives": [], "effects": [], "files": [], "strain": None, "stress": None,
    "interface": None, "peak_errors": None,
}  # fmt: skip


def test_events_are_dated_by_the_contraction_or_by_the_release():
    events = [
        {"kind": "lift-off", "contraction": 0.051},
        {"kind": "snap", "contraction": 0.3, "release": 0.42},
    ]
    others = [{"m1": 1.2345, "how": "the mesh before"}]
    told = simulate.readable(
        RESULT | {"events": events, "alternatives": others, "effects": ["elastic", "gravity"]}
    )
    assert told["events"] == "lift-off at 5.1 %, snap at 42 % of the release"
    assert told["alternatives"] == "1.23 rad (the mesh before)"
    assert told["effects"] == "elastic, gravity" and told["files"] == "none"


def test_peaks_stand_in_a_line_each_with_their_errors_in_per_cent():
    peaks = {
        "strain": {"passive": 0.0774, "active": 0.2}, "stress": {"passive": 0.08},
        "interface": {"opening": 0.001},
    }  # fmt: skip
    errors = {
        "strain": {"passive": 0.034, "active": 0.5}, "stress": {"passive": 0.02},
        "interface": {"opening": 0.1},
    }  # fmt: skip
    told = simulate.readable(RESULT | peaks | {"peak_errors": errors})
    assert told["strain"] == "passive 0.0774 ± 3.4 %, active 0.2 ± 50 %"
    assert (told["stress"], told["interface"]) == ("passive 0.08 ± 2 %", "opening 0.001 ± 10 %")
    told = simulate.readable(RESULT | peaks | {"peak_errors": None})
    assert told["strain"] == "passive 0.0774, active 0.2" and "peak_errors" not in told


def test_measures_stand_against_what_counts_as_folded():
    result = {
        "design": {"contraction": 0.2}, "measures": {f"m{k}": float(k) for k in range(1, 5)},
        "tags": dict(zip(TAGS, (True, False, True, False), strict=True)),
    }  # fmt: skip
    rows = simulate.rows(result, Thresholds(turning=2.0, across=0.25, parallel=0.07))
    assert [row["folded"] for row in rows] == ["> 0.4 rad", "< 0.1 rad", "1 ± 0.07", "1 ± 0.07"]
    assert [row["value"] for row in rows] == [1, 2, 3, 4]
    assert [row["tag"] for row in rows] == ["F1 yes", "F2 no", "F3 yes", "F4 no"]
    assert [row["measure"][:2] for row in rows] == ["m1", "m2", "m3", "m4"]
    assert simulate.rows({"measures": None}, Thresholds()) == []


def test_why_is_told_in_per_cent_and_changes_with_their_sign(capsys):
    effects = [
        {"effect": "elastic", "energy": 0.75, "force": 0.5, "time": 0.125},
        {"effect": "solving", "energy": None, "force": None, "time": 0.875},
    ]
    without = [
        {"without": "contact", "change": 0.5, "outcome": "folds", "seconds": 1.25},
        {"without": "gravity,ground", "change": None, "outcome": "timeout", "seconds": 60.0},
    ]
    simulate._say_why({"effects": effects, "without": without, "advice": ["do less"]})
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert lines[2:4] == [
        "elastic energy 75 % forces 50 % time 12.5 %", "solving energy – forces – time 87.5 %",
    ]  # fmt: skip
    assert lines[4:] == [
        "without contact: +0.5 rad, folds, 1.2 s",
        "without gravity,ground: no angle, timeout, 60 s", "- do less",
    ]  # fmt: skip


@pytest.mark.parametrize("run", [True, False])
def test_the_summary_tells_each_piece_of_evidence_by_its_own_name(run):
    same = (
        "outcome", "contraction_reached", "events", "stable", "unstable_modes", "topples", "need",
        "error_estimate", "error_m1", "error_m2", "turning_hinge", "turning_ends", "strain",
        "stress", "interface", "peak_errors", "sensitivity", "alternatives", "rest_gap",
        "penetration", "seconds", "core_seconds", "peak_memory_mb", "unknowns", "steps",
        "iterations", "fold_angle",
    )  # fmt: skip
    evidence = {name: f"evidence of {name}" for name in (*same, *TAGS)}
    label = Label({"a": 1.0}, None, "so", evidence)
    model = SimpleNamespace(effects=("elastic",))
    path = SimpleNamespace(
        folding=SimpleNamespace(model=model), history=[{}] * run, measures={"m1": 1.0}
    )
    source = SimpleNamespace(conditions=SimpleNamespace(growth="isotropic"), question="exists")
    told = record.summary(label, path, source)
    assert {name: told[name] for name in same} == {name: evidence[name] for name in same}
    assert told["measures"] == ({"m1": 1.0} if run else None)
    assert told["tags"] == ({tag: evidence[tag] for tag in TAGS} if run else None)
    assert (told["growth"], told["question"]) == ("isotropic", "exists")
    assert (told["foldable"], told["reason"], told["effects"]) == (None, "so", ["elastic"])
    assert told["design"] == {"a": 1.0}
    assert set(told) == {
        *same, "measures", "tags", "growth", "question", "foldable", "reason", "effects", "design",
    }  # fmt: skip


def test_a_design_that_says_nothing_of_them_is_as_wide_and_as_dense():
    groups = {
        "E_ratio": 0.1, "h_ratio": 5.0, "hinge_length": 0.2, "aspect": 0.2, "slenderness": 4e-3,
        "contraction": 0.3,
    }  # fmt: skip
    light = record.complete(groups, heavy=False)
    assert (light["rho_ratio"], light["hinge_width"], light["stiffness_to_weight"]) == (1, 1, 1)
    given = record.complete(groups | {"rho_ratio": 2.0, "stiffness_to_weight": 3.0}, heavy=True)
    assert (given["rho_ratio"], given["stiffness_to_weight"]) == (2, 3)
    with pytest.raises(InputError, match=r"lacks stiffness_to_weight \(gravity acts"):
        record.complete(groups, heavy=True)
    strips = record.complete(groups | {"strips": 3, "strip_share": 0.5}, heavy=False)
    assert (strips["strips"], strips["strip_share"]) == (3, 0.5) and "strips" not in light
    with pytest.raises(InputError, match="expected a finite number above 0"):
        record.complete(groups | {"E_ratio": np.inf}, heavy=False)


# -- options -------------------------------------------------------------------------------------


def test_each_option_of_a_design_arrives_as_the_wish_takes_it():
    given = design.Limits(
        ranges=["E_ratio = 0.1:10", "l_s=1e-2:2e-2"], passive=["PET"], active=["SMP", "gel"],
        max_mass=1.0, max_length=2.0, max_width=3.0, max_thickness=4.0, margin=0.1, stands=True,
        strain_margin=0.2, touching=False, least="mass",
    )  # fmt: skip
    assert given.read() == {
        "ranges": {"E_ratio": (0.1, 10.0), "l_s": (0.01, 0.02)}, "passive": ("PET",),
        "active": ("SMP", "gel"), "materials": None, "max_mass": 1.0, "max_length": 2.0,
        "max_width": 3.0, "max_thickness": 4.0, "margin": 0.1, "stands": True,
        "strain_margin": 0.2, "touching": False, "least": "mass",
    }  # fmt: skip
    assert design.Aim("angle", 1.5, 0.2).read() == Angle(1.5, 0.2)
    assert design.Aim("flat").read() == "flat"
    for aim in (design.Aim("angle"), design.Aim("flat", 1.0)):
        with pytest.raises(InputError, match="go together"):
            aim.read()


def test_a_model_of_another_space_is_refused(monkeypatch):
    from foldlab.learning import saving

    monkeypatch.setattr(saving, "load_model", lambda path: ("the model", {"space": "full"}))
    judges = design.Judges(model="m")
    assert judges.classifier(None, "full", 0) == "the model"
    with pytest.raises(InputError, match="trained on the full space; give --space full"):
        judges.classifier(None, "reduced", 0)


def test_options_of_a_simulation_arrive_in_the_source():
    solving = simulate.Solving(
        effects="gravity,ground,contact", growth="isotropic", question="exists", accuracy=0.05,
        timeout=7.0, free=True, strips=3, friction=0.25, need=1.25,
    )  # fmt: skip
    borne = simulate.Borne(*(0.01 * k for k in range(1, 7)))
    changed = simulate.Changed(2.0, 3.0, 4.0, 5.0, 0.06)
    source = solving.source(borne.strengths(), record.space_for({}), changed.changing())
    c, s, g = source.conditions, source.strengths, source.changing
    assert c.terms == ("gravity", "ground", "contact") and c.growth == "isotropic"
    assert (c.upright, c.strips, c.barrier, c.friction) == (False, 3, "surface", 0.25)
    soft = replace(solving, barrier="exponential", friction=0.0)
    source_of_it = soft.source(borne.strengths(), record.space_for({}), changed.changing())
    assert source_of_it.conditions.barrier == "exponential"
    assert (source.effort.accuracy, source.effort.timeout) == (0.05, 7.0)
    assert source.question == "exists" and source.thresholds == Thresholds(need=1.25)
    bears = s.passive_strain, s.active_strain, s.passive_stress, s.active_stress, s.opening, s.shear
    assert bears == pytest.approx((0.01, 0.02, 0.03, 0.04, 0.05, 0.06))
    factors = g.active_stiffness, g.passive_stiffness, g.active_density, g.passive_density
    assert (*factors, g.passive_expansion) == (2.0, 3.0, 4.0, 5.0, 0.06)


@pytest.mark.parametrize(
    ("name", "least"),
    [("n_train", 1), ("n_test", 1), ("n_fresh", 1), ("map_points", 1), ("proposals", 0)],
)
def test_the_quickstart_takes_the_least_of_each_and_not_less(name, least):
    assert getattr(Settings(**{"verify": 0, name: least}), name) == least
    with pytest.raises(InputError, match=f"{name} = {least - 1}; expected at least {least}"):
        Settings(**{"verify": 0, name: least - 1})


def test_no_more_of_a_map_is_verified_than_there_is():
    assert Settings(map_points=3, verify=3).verify == 3
    with pytest.raises(InputError, match="verify = 4 of map_points = 3"):
        Settings(map_points=3, verify=4)
    with pytest.raises(InputError, match="verify = -1; expected at least 0"):
        Settings(verify=-1)


@pytest.mark.parametrize(
    ("error", "status"), [(typer.Abort(), 130), (BrokenPipeError(), 0), (InputError("no"), 2)]
)
def test_how_a_verb_ended_is_its_exit_status(error, status, monkeypatch):
    def ends(**_):
        raise error

    monkeypatch.setattr(app, "app", ends)
    monkeypatch.setattr(sys, "stdout", sys.stdout)  # a broken pipe takes it away
    monkeypatch.setattr(app.warnings, "showwarning", app.warnings.showwarning)
    with pytest.raises(SystemExit) as end:
        app.main()
    assert end.value.code == status
