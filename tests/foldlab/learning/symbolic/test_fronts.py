"""Which formulas are kept, chosen and told apart; without a search."""

import time
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from foldlab.design import FULL, REDUCED
from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.rod import rod_of
from foldlab.learning.symbolic import engines, finishing
from foldlab.learning.symbolic.engines import Constraints, read_operon
from foldlab.learning.symbolic.estimators import SymbolicClassifier, SymbolicRegressor
from foldlab.learning.symbolic.finishing import refit
from foldlab.learning.symbolic.formula import Formula

NAMES = tuple(REDUCED.names)


# -- engines ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "least"),
    [("max_depth", 1), ("max_size", 1), ("population", 10), ("seed", 0), ("threads", 1),
     ("generations", 1)],
)  # fmt: skip
def test_limits_are_taken_down_to_their_least(name, least):
    assert getattr(Constraints(**{name: least}), name) == least
    with pytest.raises(InputError, match=f"{name} = {least - 1}; expected a whole number"):
        Constraints(**{name: least - 1})
    with pytest.raises(InputError, match="seconds = inf"):
        Constraints(seconds=np.inf)


def node(name, arity=2):
    return SimpleNamespace(
        IsVariable=False, IsConstant=False, Arity=arity, Type=SimpleNamespace(name=name)
    )


def leaf(value, key=None):
    return SimpleNamespace(
        IsVariable=key is not None, IsConstant=key is None, Value=value, HashValue=key
    )


def test_operon_s_postfix_has_its_first_argument_on_top():
    x, y = leaf(2.0, 7), leaf(0.5, 8)
    named = {7: "x", 8: "y"}
    assert read_operon([y, x, node("Sub")], named) == ("-", ("*", 2.0, "x"), ("*", 0.5, "y"))
    assert read_operon([leaf(3.0), node("Log", 1)], named) == ("log", 3.0)
    three = read_operon([leaf(1.0), leaf(2.0), leaf(3.0), node("Div", 3)], named)
    assert three == ("/", ("/", 3.0, 2.0), 1.0)


def test_the_best_of_each_length_is_refitted_before_any_second_best():
    candidates = [
        (0.3, 1, "b"), (0.2, 1, "a"), (0.1, 3, "d"), (0.15, 3, "e"), (0.5, 1, "c"),
        (0.1000001, 3, "d with its arguments swapped"), (0.6, 1, "f"),
        (0.7, 1, "fifth of a length"),
    ]  # fmt: skip
    assert engines._by_length(candidates) == ["d", "a", "e", "b", "c", "f"]
    assert engines._by_length(candidates, keep=1) == ["d", "a"]
    # Errors are compared by their ratio: those of small targets and good formulas are small.
    for scale in (1e-6, 1e6):
        scaled = [(scale * error, size, tree) for error, size, tree in candidates]
        assert engines._by_length(scaled) == ["d", "a", "e", "b", "c", "f"]


@pytest.mark.parametrize(
    ("known", "path"),
    [
        ({"PYTHON_JULIAPKG_EXE": "/a", "PYTHON_JULIACALL_EXE": "/b"}, "/a"),
        ({"PYTHON_JULIACALL_EXE": "/b"}, "/b"),
        ({}, "/usr/bin/julia"),
    ],
)
def test_the_julia_that_was_named_comes_before_the_one_on_the_path(known, path, monkeypatch):
    for name in ("PYTHON_JULIAPKG_EXE", "PYTHON_JULIACALL_EXE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in known.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(engines.shutil, "which", lambda n: {"julia": "/usr/bin/julia"}.get(n, n))
    assert engines.julia() == path
    monkeypatch.setattr(engines.shutil, "which", lambda n: None)
    assert engines.julia() is None


def test_a_search_without_generations_ends_by_its_time():
    given = engines.pysr_arguments(Constraints(), False, 3.0)
    assert given["niterations"] == 10**9 and given["elementwise_loss"] == "L2DistLoss()"
    given = engines.pysr_arguments(Constraints(generations=7), True, 3.0)
    assert given["niterations"] == 7 and "log(abs(a / y)" in given["elementwise_loss"]


# -- estimators ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ([1.0, 2.0], 1.0), ([1e3], 1.0), ([3.2e3], 1e4), ([1e-3, 1e-3], 1.0), ([1e-4], 1e-4),
        ([0.0, -1e6, 1e6], 1e6), ([0.0], 1.0), ([1e4, 1e6], 1e5),
    ],
)  # fmt: skip
def test_targets_are_scaled_by_a_power_of_ten_beyond_three_decades(values, scale):
    assert finishing.scale_of(np.array(values)) == pytest.approx(scale, rel=1e-12)


@pytest.mark.parametrize("d", [1, 3, 10, 11])
def test_formulas_are_guarded_within_the_box_and_at_its_corners(d):
    low, high = np.full(d, 1e-4), np.full(d, 1e2)
    low[0], high[0] = -3.0, 5.0
    points = finishing.guard_points(low, high, 0)
    inside, corners = points[:2048], points[2048:]
    assert (points >= low - 1e-12).all() and (points <= high * (1 + 1e-12)).all()
    assert np.isclose(corners[..., None], np.stack([low, high], -1)).any(-1).all()
    # All of them where there are few.
    assert len(np.unique(corners, axis=0)) >= min(2**d, 1024)
    # Even where values may be negative, and in the logarithm where they are not.
    assert inside[:, 0].mean() == pytest.approx(1.0, abs=0.05)
    for column in inside[:, 1:].T:
        assert np.log10(column).mean() == pytest.approx(-1.0, abs=0.05)


def test_the_front_holds_what_no_other_beats_in_size_and_error():
    rows = [
        (3, 2, 0.5, "a"), (1, 1, 0.9, "b"), (3, 2, 0.6, "worse"), (5, 3, 0.5, "longer"),
        (7, 3, 0.5 * (1 - 1e-7), "by rounding"), (9, 4, 0.1, "c"), (1, 1, 0.95, "worse"),
        (9, 3, 0.1, "d"),
    ]  # fmt: skip
    front = finishing.front_of(rows)
    # Of two as long and as good the one of fewer levels.
    assert front["formula"].tolist() == ["b", "a", "d"]
    assert list(front.columns) == ["size", "depth", "error", "formula"]


@pytest.mark.parametrize(("excess", "chosen"), [(0.009, "E_ratio"), (0.011, "weighed")])
def test_the_smallest_formula_within_a_hundredth_of_the_least_error_answers(
    excess, chosen, monkeypatch
):
    # log y is off log E by noise of standard deviation s and mean m: a weight takes off the mean.
    X = REDUCED.sample(200, seed=1)
    noise = np.random.default_rng(0).standard_normal(200)
    noise = (noise - noise.mean()) / noise.std()
    y = X.E_ratio.to_numpy() * np.exp(0.3 * (noise + np.sqrt((1 + excess) ** 2 - 1)))
    candidates = ["E_ratio", ("*", 1.2, "E_ratio")]
    monkeypatch.setitem(engines.ENGINES, "operon", lambda *_: candidates)
    model = SymbolicRegressor(REDUCED, reciprocal=False).fit(X, y)
    errors = model.front_["error"].to_numpy()
    assert errors == pytest.approx([0.3 * (1 + excess), 0.3], rel=1e-6)
    assert model.formula_.size == (1 if chosen == "E_ratio" else 3)


def test_the_engine_gets_85_per_cent_of_the_time_and_the_target_as_it_is_searched(monkeypatch):
    seen = {}

    def search(X, y, inputs, limits, log_target, deadline):
        seen.update(y=y, inputs=inputs, log=log_target, left=deadline - time.monotonic())
        return [1.0 if seen["log"] else "a"]

    monkeypatch.setitem(engines.ENGINES, "operon", search)
    X = pd.DataFrame({"a": [1.0, 2.0, 4.0]})
    limits = Constraints(seconds=1e6)
    model = SymbolicRegressor(constraints=limits).fit(X, np.array([1e6, 2e6, 4e6]))
    # The fit has just begun.
    assert seen["left"] == pytest.approx(0.85e6, abs=600) and seen["inputs"] == ("a",)
    assert seen["y"] == pytest.approx([1, 0.5, 0.25]) and seen["log"] is True
    assert model.predict(X) == pytest.approx([2e6] * 3)
    plain = SymbolicRegressor(constraints=limits, log_target=False, reciprocal=False)
    plain.fit(X, np.array([1e6, 2e6, 4e6]))
    assert seen["y"] == pytest.approx([1, 2, 4]) and seen["log"] is False


def test_an_error_is_that_of_the_target_in_its_own_units():
    X, y = np.array([[1.0], [2.0], [-3.0], [-4.0]]), np.ones(4)
    # Two of four are negative, which is as wrong as e^20.
    _, error = refit("x", X, y, ("x",), True)
    assert error == pytest.approx(np.sqrt((np.log(2) ** 2 + 2 * 20**2) / 4))
    _, error = refit("x", X, y, ("x",), False)
    assert error == pytest.approx(np.sqrt((0 + 1 + 16 + 25) / 4))
    fitted, error = refit(("*", 5.0, "x"), X[:2], np.array([3.0, 6.0]), ("x",), True)
    assert fitted == ("*", pytest.approx(3.0), "x") and error == pytest.approx(0, abs=1e-9)


def test_inputs_keep_names_that_a_formula_can_have():
    for columns, names in (
        (["a", "b"], ("a", "b")), (["a", "if"], ("x0", "x1")), (["a", "log"], ("x0", "x1")),
        (["a", "b c"], ("x0", "x1")),
    ):  # fmt: skip
        model = SymbolicRegressor()
        model.feature_names_in_, model.n_features_in_ = np.array(columns), 2
        assert model._names() == names
    bare = SymbolicRegressor()
    bare.n_features_in_ = 3
    assert bare._names() == ("x0", "x1", "x2")


def test_a_formula_on_its_threshold_folds_and_one_that_is_not_positive_never_does():
    at = REDUCED.sample(4, seed=0).assign(E_ratio=[2.0, 1.999, 0.5, 0.25])
    front = [(0.1, Formula("E_ratio", NAMES)), (0.2, Formula(("-", "E_ratio", 0.5), NAMES))]
    model = SymbolicClassifier(REDUCED, threshold=2.0).restore(front, 0, 0.5)
    assert model.predict(at).tolist() == [True, False, False, False]
    assert model.decision_function(at)[2] == pytest.approx(np.log(0.25))
    model = SymbolicClassifier(REDUCED, threshold=2.0).restore(front, 1, 0.5)
    assert model.decision_function(at)[2:].tolist() == [-np.inf, -np.inf]
    assert model.predict_proba(at)[2:].tolist() == [[1.0, 0.0]] * 2
    assert model.size_ == (3, "nodes") and model.n_features_in_ == 3


def test_errors_of_plain_squares_are_as_they_are_and_those_of_logs_have_a_limit():
    X, y = np.array([[1.0], [1.0]]), np.array([1.0, 101.0])
    for log_target, error in ((False, np.sqrt(100**2 / 2)), (True, np.log(101) / np.sqrt(2))):
        assert refit("x", X, y, ("x",), log_target)[1] == pytest.approx(error)
    # Where a formula has no value its error is none, or that of e^20.
    apart = np.array([[-1.0], [1.0]])
    assert np.isnan(refit(("log", "x"), apart, y, ("x",), False)[1])
    assert refit("x", apart, np.ones(2), ("x",), True)[1] == pytest.approx(20 / np.sqrt(2))


@pytest.mark.parametrize("inputs, column", [("physics", "net"), ("rod", "rod")])
def test_a_formula_of_physics_answers_designs_beyond_the_box_that_it_learnt_from(inputs, column):
    designs = FULL.sample(20, seed=5)
    table = beam.formulas(designs)
    if inputs == "rod":
        table = table.join(rod_of(designs))
    known, narrow = table[column].to_numpy(), FULL.with_bounds(h_ratio=(0.9, 1.1))
    front = [(0.1, Formula(column, tuple(table)))]
    model = SymbolicClassifier(narrow, threshold=1.0, inputs=inputs).restore(front, 0, 0.5)
    ahead = known > 0
    assert ahead.sum() > 3
    np.testing.assert_allclose(np.exp(model.decision_function(designs))[ahead], known[ahead])
    assert (model.predict(designs) == (known >= 1)).all()
    # Columns in any order, and rows without names in that of the space.
    mixed = designs[designs.columns[::-1]]
    assert (model.predict(mixed) == model.predict(designs)).all()
    assert (model.predict(designs[FULL.names].to_numpy()) == model.predict(designs)).all()
