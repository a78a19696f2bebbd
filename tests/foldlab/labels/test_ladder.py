"""The ladder of label sources: who answers, at what price, and what climbs on."""

import pandas as pd
import pytest

from foldlab.datasets import load_dataset
from foldlab.design import FULL, PATTERNED
from foldlab.errors import InputError
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.foldability import Thresholds
from foldlab.labels.label import Label
from foldlab.labels.rod import RodSource
from foldlab.labels.solver import SolverSource
from foldlab.labels.sources import LadderSource, make_source

LADDER = LadderSource()


@pytest.fixture
def asked(monkeypatch):
    """Designs that climbed to the solver."""
    seen = []

    def label(self, design):
        seen.append(design)
        return Label(dict(design), True, "solved", {"core_seconds": 2.0}, "solver", self.version)

    monkeypatch.setattr(SolverSource, "label", label)
    return seen


def test_the_rod_answers_where_it_is_sure_and_all_else_climbs(asked):
    designs = FULL.sample(60, seed=3)
    rods = RodSource().label_many(designs)
    labels = [LADDER.label(d) for d in designs.to_dict("records")]
    for rod, label in zip(rods, labels, strict=True):
        assert (label.source, label.version) == ("ladder", LADDER.version)
        if rod.foldable is None:
            assert label.reason == "solved" and label.evidence["rung"] == "solver"
            # What the rod took is told, too.
            assert 2.0 < label.evidence["core_seconds"] < 3.0
        else:
            assert (label.foldable, label.reason) == (rod.foldable, rod.reason)
            assert label.evidence["rung"] == "rod" and label.evidence["core_seconds"] < 1.0
    unsure = sum(rod.foldable is None for rod in rods)
    assert len(asked) == unsure > 0 and unsure < 20


def test_what_the_rod_cannot_feel_has_the_solver_alone():
    assert [r.name for r in LADDER.rungs] == ["rod", "solver"]
    for options in (
        {"conditions": Conditions(growth="isotropic")},
        {"conditions": Conditions(strips=3)},
        {"space": PATTERNED},
    ):
        assert [r.name for r in LadderSource(**options).rungs] == ["solver"]


def test_a_design_outside_of_the_rod_s_tables_climbs(asked):
    design = FULL.sample(1, seed=0).iloc[0].to_dict() | {"E_ratio": 1e-5}
    with pytest.raises(InputError, match="no rod"):
        RodSource().label(design)
    assert LADDER.label(design).evidence["rung"] == "solver" and len(asked) == 1


def test_settings_reach_every_rung_and_its_version():
    ladder = LadderSource(
        Conditions(effects="none"), Effort(accuracy=0.1, timeout=7.0), FULL, Thresholds(need=1.5)
    )
    rod, solver = ladder.rungs
    assert rod.conditions == solver.conditions == Conditions(effects="none")
    assert rod.thresholds == solver.thresholds == Thresholds(need=1.5)
    assert solver.effort == Effort(accuracy=0.1, timeout=7.0) and ladder.timeout == 7.0
    assert ladder.version == f"rod:{rod.version}+solver:{solver.version}" != LADDER.version
    assert make_source("ladder", {"accuracy": 0.1}).effort.accuracy == 0.1
    with pytest.raises(InputError, match="there are: timoshenko, rod, solver, ladder"):
        make_source("stairs")


def test_it_agrees_with_the_solver_on_the_dataset(asked):
    table = load_dataset("gravity-5k", growth="uniaxial")
    known = table[table["foldable"].notna()].sample(300, random_state=1)
    labels = [LADDER.label(d) for d in known[FULL.names].to_dict("records")]
    rung = pd.Series([label.evidence["rung"] for label in labels], index=known.index)
    answers = pd.Series([label.foldable for label in labels], index=known.index)
    sure = rung == "rod"
    assert sure.mean() > 0.85
    assert (answers[sure] == known["foldable"][sure].astype(bool)).mean() > 0.99
