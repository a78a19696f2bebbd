"""The short rules: their formulas are those that labels are judged by."""

import numpy as np
import pandas as pd
import pytest
import sympy

from experiments.gravity_rules import COLUMNS, GROUPS, E, S, T, W, _enough, _python, _row, terms
from foldlab.design import FULL
from foldlab.labels import beam


@pytest.mark.parametrize("term", terms(), ids=str)
def test_the_formulas_in_latex_are_those_in_numpy(term):
    designs = FULL.sample(50, seed=0)
    expression = terms()[term]
    names = sorted(expression.free_symbols, key=str)
    values = sympy.lambdify(names, expression)(*(designs[GROUPS[s]].to_numpy() for s in names))
    np.testing.assert_allclose(values, beam.formulas(designs)[COLUMNS[term]], rtol=1e-12)


def test_a_rule_in_python_says_what_the_rule_says():
    parts = beam.formulas(FULL.sample(200, seed=1))
    rule = T + E - W - S > 1
    net = parts["net"].to_numpy() > 1
    assert _row("folds", rule, parts, net)["accuracy"] == 1.0
    assert _row("folds", rule, parts, ~net)["accuracy"] == 0.0
    said = eval(_python(rule), {name: parts[name].to_numpy() for name in parts})
    assert np.array_equal(said, net)


def test_where_timoshenko_is_enough_is_counted_by_weight():
    known = pd.DataFrame({"stiffness_to_weight": [0.01, 0.02, 90.0, 100.0]})
    parts = pd.DataFrame({"turning": [2.0, 0.5, 2.0, 0.5], "edge": [0.0, 1.0, 0.0, 0.0]})
    low, high = _enough(known, parts, np.array([True, False, False, False]))
    assert (low["labels"], low["T"], low["T + E"]) == (2, 1.0, 0.5)
    assert (high["labels"], high["T"], high["T + E"]) == (2, 0.5, 0.5)
    assert low["from"] == pytest.approx(0.01) and high["to"] == pytest.approx(100)
