"""The experiment on robustness: a run that was stopped goes on, and what it reports is counted."""

import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.sparse import bsr_array

from experiments import robustness
from experiments.robustness import Config, run
from foldlab.design import FULL
from solver.cases.unit.audit import audit
from solver.cases.unit.choices import Meshing, Physics
from solver.cases.unit.model import build
from solver.cases.unit.path import fold
from solver.cases.unit.unit import EFFECTS, Unit


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """Designs that were followed, by a stand-in that fails every third."""
    monkeypatch.chdir(tmp_path)
    seen = []

    def follow(groups, effects, growth, config):
        k = len(seen)
        seen.append((groups["E_ratio"], effects, growth))
        return {
            "effects": "+".join(effects) or "none", "growth": growth, "ending": "REACHED",
            "complete": k % 3 != 0, "reason": "" if k % 3 else "out of breath", "reached": 1.0,
            "happenings": [], "unknowns": 100, "seconds": 1.0, "faults": ["odd"] * (k == 1),
            "correction": 1e-9, "leans": 0.0, "condition": 10.0**k,
        }  # fmt: skip

    monkeypatch.setattr(robustness, "follow", follow)
    return seen


TRACKER = SimpleNamespace(table=lambda *_: None, figure=lambda *_: None)


def test_results_are_counted_by_region_and_reason(asked):
    result = run(Config(designs=9), TRACKER)
    assert result["designs"] == len(asked) == 9
    assert result["reasons"] == {"out of breath": 3} and result["complete"] == pytest.approx(2 / 3)
    assert (result["faults"], result["audited"]) == (1, 8)
    assert result["complaints"] == ["design 1: odd"]
    assert result["worst_condition"] == 1e8
    for group in ("E_ratio", "slenderness", "effects", "growth"):
        rows = [row for row in result["table"] if row["group"] == group]
        assert sum(row["designs"] for row in rows) == 9
        assert sum(row["designs"] * row["complete"] for row in rows) == pytest.approx(6)
    assert {effects for _, effects, _ in asked} == {(), EFFECTS}
    assert {growth for *_, growth in asked} == {"uniaxial", "isotropic"}


def test_a_run_that_was_stopped_goes_on_where_it_was(asked):
    config = Config(designs=6)
    whole = run(config, TRACKER)
    path = robustness._store(config)
    lines = path.read_text().splitlines()
    # Four rows and the beginning of a fifth.
    path.write_text("\n".join(lines[:4]) + "\n" + lines[4][:20])
    first = list(asked)
    asked.clear()
    again = run(config, TRACKER)
    assert [a for a, *_ in asked] == [a for a, *_ in first[4:]]
    assert again["designs"] == whole["designs"]
    assert [json.loads(line)["design"] for line in path.read_text().splitlines()] == list(range(6))
    asked.clear()
    run(config, TRACKER)
    assert asked == []


FRAME = pd.DataFrame([
    {
        "design": k, **FULL.sample(6, seed=0).iloc[k].to_dict(), "effects": effects,
        "growth": "uniaxial", "complete": complete, "reason": reason, "faults": faults,
        "seconds": seconds, "condition": condition, "correction": 1e-9 * k, "leans": leans,
    }
    for k, (effects, complete, reason, faults, seconds, condition, leans) in enumerate([
        ("none", True, "", [], 1.0, 1e5, 0.0),
        ("none", False, "slow", ["odd", "even"], 2.0, 1e7, 2e-3),
        ("gravity+ground", True, "", [], 3.0, None, 1e-3),
        ("gravity+ground", False, "slow", [], 4.0, 1e6, 0.5),
        ("gravity+ground", False, "lost", ["odd"], 50.0, 1e4, 0.0),
        ("none", True, "", [], 5.0, 1e3, 0.0),
    ])
])  # fmt: skip


def test_each_part_of_the_space_has_a_row():
    rows = {(row["group"], row["region"]): row for row in robustness.by_region(FRAME, FULL)}
    heavy = rows["effects", "gravity+ground"]
    assert heavy == {
        "group": "effects", "region": "gravity+ground", "designs": 3,
        "complete": pytest.approx(1 / 3), "faults": 1, "seconds_median": 4.0,
        "worst_condition": 1e6,
    }  # fmt: skip
    assert rows["effects", "none"]["faults"] == 2
    low, high = FULL["contraction"].low, FULL["contraction"].high
    at = FRAME.head(4).assign(contraction=[low, low + (high - low) / 2, high, low])
    rows = {
        row["region"]: row["designs"]
        for row in robustness.by_region(at, FULL)
        if row["group"] == "contraction"
    }
    assert rows == {"low": 2, "middle": 1, "high": 1}


def test_a_run_names_its_worst_design_and_counts_what_leans(asked, monkeypatch):
    rows = iter(FRAME.drop(columns=["design", *FULL.names]).to_dict("records"))
    monkeypatch.setattr(robustness, "follow", lambda *given: next(rows))
    result = run(Config(designs=6, seed=0, lightest=FULL["stiffness_to_weight"].low), TRACKER)
    assert result["complete"] == 0.5 and result["reasons"] == {"slow": 2, "lost": 1}
    assert (result["audited"], result["faults"], result["leaning"]) == (4, 3, 2)
    assert result["worst_condition"] == 1e7 and result["worst_correction"] == 5e-9
    assert result["worst_design"] == pytest.approx(FULL.sample(6, seed=0).iloc[1].to_dict())
    assert (result["seconds_median"], result["seconds_most"]) == (3.5, 50.0)


GROUPS = {
    "E_ratio": 1.0, "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0, "h_ratio": 1.0,
    "stiffness_to_weight": 0.05, "aspect": 0.2, "slenderness": 0.02, "contraction": 0.05,
}  # fmt: skip


def test_a_design_is_followed_to_its_end_audited_and_its_condition_is_that_of_the_whole_matrix():
    row = robustness.follow(GROUPS, EFFECTS, "uniaxial", Config(timeout=60.0))
    assert row["complete"] and row["ending"] == "REACHED" and row["reached"] == 1.0
    assert row["effects"] == "gravity+ground" and not row["faults"]
    assert row["correction"] < 1e-6 and row["unknowns"] > 100
    # The audit's moment over that of the unit's own weight.
    unit = Unit(**GROUPS)
    model = build(unit, Meshing(0), Physics(EFFECTS))
    folding = fold(model)
    assert row["reason"] == folding.detail
    moment = audit(folding.model, folding.x, folding.last.e).moment
    arm = unit.weight * unit.aspect * unit.slenderness / 2
    assert row["leans"] == pytest.approx(moment / arm, rel=1e-6, abs=1e-12)
    # Largest over smallest eigenvalue, of the matrix without rows written out.
    scene, x, e = folding.model.scene, folding.x, folding.last.e
    blocks = scene.evaluate(scene.displacement(x, e), e, 2).stiffness
    g = scene.graph
    K = bsr_array((blocks, g.indices, g.indptr), shape=(3 * g.n, 3 * g.n)).toarray()
    free = np.array([
        scene.step_displacement(np.append(v, np.zeros(scene.n_rows))).ravel()
        for v in np.eye(scene.n_free)
    ])  # fmt: skip
    values = np.linalg.eigvalsh(free @ K @ free.T)
    expected = values[-1] / np.abs(values).min()
    assert row["condition"] == pytest.approx(expected, rel=0.05)


def test_time_that_runs_out_is_the_reason_of_a_path_that_is_not_complete():
    row = robustness.follow(GROUPS, (), "isotropic", Config(timeout=1e-3))
    assert row["ending"] == "TIMEOUT" and not row["complete"]
    assert "time" in row["reason"] and row["reached"] < 1 and row["effects"] == "none"
    assert row["growth"] == "isotropic" and row["seconds"] > 1e-3


def test_the_picture_has_a_bar_for_each_third_and_opens_what_is_not_complete():
    table = robustness.by_region(FRAME, FULL)
    left, right = robustness.picture(FRAME, table).axes
    thirds = {bar.get_label(): [b.get_height() for b in bar] for bar in left.containers}
    for name in ("low", "middle", "high"):
        known = {r["group"]: r["complete"] for r in table if r["region"] == name}
        drawn = thirds[f"{name} third"]
        assert [h for h in drawn if h == h] == [known[g] for g in FULL.names if g in known]
    drawn = [line for line in right.lines if len(line.get_xdata())]
    done = {line.get_markerfacecolor() != "none": line.get_ydata().tolist() for line in drawn[:2]}
    assert done == {True: [1e5, 1e3], False: [1e7]}
