"""The short rules: their formulas are those that labels are judged by."""

import re

import numpy as np
import pandas as pd
import pytest
import sympy
from sklearn.model_selection import StratifiedKFold

from experiments import gravity_rules
from experiments.gravity_rules import (
    COLUMNS,
    GROUPS,
    LIFT,
    E,
    S,
    T,
    W,
    _enough,
    _python,
    _row,
    terms,
)
from foldlab.datasets import of_space
from foldlab.design import FULL
from foldlab.labels import beam
from foldlab.learning.scoring import clopper_pearson


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


def made(n=300):
    """Labels of the beam formulas; sheets that do not leave the ground, and unknown ones."""
    table = FULL.sample(n, seed=0)
    parts = beam.formulas(table)
    table["foldable"] = pd.array(parts["net"] > 1, dtype="boolean")
    table["outcome"] = np.where(parts["lift_off"] > 1, "folds", "grounded")
    table["strips"] = 0.0
    table.loc[::30, "strips"] = 2.0
    table.loc[1::30, "foldable"] = None
    return table


def test_rules_are_judged_on_known_labels_of_solid_layers(tracker, monkeypatch):
    table = made()
    monkeypatch.setattr(
        gravity_rules, "load_dataset", lambda name, growth, space: of_space(table, name, space)
    )
    result = gravity_rules.run(gravity_rules.Config(), tracker)
    known = table[(table["strips"] == 0) & table["foldable"].notna()]
    parts, folds = beam.formulas(known), known["foldable"].to_numpy(bool)
    assert result["labels"] == len(known) == 280
    rows = result["table"]
    assert [row["question"] for row in rows] == [
        "folds", "folds", "folds", "leaves the ground", "folds", "folds", "leaves the ground",
        "folds",
    ]  # fmt: skip
    plain, ends, net, lift = rows[:4]
    assert plain["accuracy"] == np.mean((parts["turning"] > 1) == folds)
    assert ends["accuracy"] == np.mean((parts["turning"] + parts["edge"] > 1) == folds)
    assert net["accuracy"] == lift["accuracy"] == 1.0
    low, high = clopper_pearson(280, 280)
    assert (net["accuracy_low"], net["accuracy_high"]) == (low, high)
    assert rows[-1]["rule"].startswith("tree of ") and "ratio" in rows[-1]["python"]
    assert rows[-1]["accuracy"] > 0.9
    # How much each group matters, the largest first.
    values = list(result["importance"].values())
    assert values == sorted(values, reverse=True) and set(result["importance"]) == set(FULL.names)
    assert sum(row["labels"] for row in result["timoshenko_is_right"]) == 280
    assert set(result["terms"]) == {"T", "S", "lambda"}
    few = gravity_rules.run(gravity_rules.Config(limit=120), tracker)
    assert few["labels"] == 120


def test_weights_are_told_so_that_the_threshold_is_one_or_a_power():
    rng = np.random.default_rng(0)
    parts = pd.DataFrame({name: rng.uniform(0, 3, 800) for name in ("turning", "weight")})
    parts["lift_off"] = 10 ** rng.uniform(-1, 1, 800)
    splits = StratifiedKFold(5, shuffle=True, random_state=0)
    folds = (1.5 * parts["turning"] - 0.5 * parts["weight"] > 1).to_numpy()
    row = gravity_rules._fitted("folds", [T, W], parts, folds, splits)
    # Up to the noise of a fit, the rule that made the labels.
    numbers = [float(x) for x in re.findall(r"\d+\.\d+", row["python"])]
    assert sorted(numbers) == pytest.approx([0.5, 1.5], abs=0.05) and "> 1" in row["python"]
    assert row["accuracy"] > 0.98 and row["rule"].endswith("(fitted)")
    up = (2.0 * np.log(parts["lift_off"]) > 0.6).to_numpy()
    row = gravity_rules._fitted("leaves the ground", [LIFT], parts, up, splits)
    weight, bound = (float(x) for x in re.findall(r"\d+\.\d+", row["python"]))
    assert "log" in row["python"] and bound / weight == pytest.approx(0.3, abs=0.03)


def test_the_picture_sets_what_turns_against_what_weight_takes():
    known = made(60)
    parts, folds = beam.formulas(known), (beam.formulas(known)["net"] > 1).to_numpy()
    enough = [{"from": 0.01, "to": 1.0, "T": 0.5, "T + E": 0.7}]
    figure = gravity_rules.picture(known, parts, folds, {"h_ratio": 0.2, "aspect": 0.1}, enough)
    rule, bars, line = figure.axes
    yes, no, border = (drawn.get_xydata() for drawn in rule.lines)
    turns, takes = parts["turning"] + parts["edge"], parts["weight"] + parts["sag"]
    assert yes == pytest.approx(np.column_stack([turns, takes])[folds])
    assert len(no) == (~folds).sum() and border[:, 1] == pytest.approx(border[:, 0] - 1)
    assert [bar.get_width() for bar in bars.patches] == [0.1, 0.2]
    assert [drawn.get_xydata().tolist() for drawn in line.lines] == [[[0.1, 0.5]], [[0.1, 0.7]]]
