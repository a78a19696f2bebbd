"""Labels that tell how their state changes with every group."""

from dataclasses import replace

import numpy as np
import pytest

from foldlab.design import FULL
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource
from solver.equilibrium.clock import OutOfTime

DESIGN = {
    "E_ratio": 0.5, "rho_ratio": 1.3, "hinge_length": 0.25, "hinge_width": 0.8, "h_ratio": 0.9,
    "stiffness_to_weight": 2.0, "aspect": 0.3, "slenderness": 0.01, "contraction": 0.12,
}  # fmt: skip
SOURCE = SolverSource(effort=Effort(0.05, sensitivity=True))


@pytest.fixture(scope="module")
def label():
    return SOURCE.label(DESIGN)


def test_derivatives_stand_in_the_label_and_predict_those_of_a_changed_design(label):
    rates = label.evidence["sensitivity"]
    assert set(rates) == {"m1", "m2", "tip", "strain.passive", "strain.active"}
    assert all(set(rate) == set(FULL.names) for rate in rates.values())
    changed = DESIGN | {"contraction": 0.121, "slenderness": 0.0101}
    other = SOURCE.label(changed)
    for name, value in (("m1", "m1"), ("strain.passive", "strain")):
        pick = lambda e, v=value: e[v]["passive"] if v == "strain" else e[v]  # noqa: E731
        before, after = (pick(one.evidence) for one in (label, other))
        step = sum(rates[name][g] * (changed[g] - DESIGN[g]) for g in DESIGN)
        assert after - before == pytest.approx(step, rel=0.03, abs=1e-5), name
    # Each tip rises with the contraction, in l_s.
    assert 0 < rates["tip"]["contraction"] < 10


def test_they_cost_nothing_where_nobody_asks(label):
    plain = replace(SOURCE, effort=Effort(0.05))
    assert "sensitivity" not in plain.label(DESIGN).evidence
    assert plain.version + "-sensitivity" == SOURCE.version
    assert SOURCE.label(DESIGN).foldable == label.foldable


def test_where_there_are_none_the_label_says_so():
    rough = replace(SOURCE, conditions=Conditions(friction=0.3))
    evidence = rough.label(DESIGN).evidence
    assert evidence["sensitivity"] is None and np.isfinite(evidence["m1"])


def test_a_label_that_runs_out_of_time_has_none_and_still_is_a_label(monkeypatch):
    # The time is up while derivatives are taken.
    def late(*_):
        raise OutOfTime
        yield

    monkeypatch.setattr("solver.cases.unit.sensitivity.neighbours", late)
    label = SOURCE.label(DESIGN)
    assert label.foldable is not None and label.evidence["sensitivity"] is None
    short = replace(SOURCE, effort=Effort(0.05, timeout=0.05, sensitivity=True)).label(DESIGN)
    assert short.foldable is None and short.evidence.get("sensitivity") is None
