"""The experiment on robustness: a run that was stopped goes on, and what it reports is counted."""

import json
from types import SimpleNamespace

import pytest

from experiments import robustness
from experiments.robustness import Config, run
from solver.cases.unit.unit import EFFECTS


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
