"""What choosing near the boundary saves: which labels are drawn from, and ratios of labels."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from experiments import gravity_augmentation
from experiments.gravity_augmentation import TINY, ratios_of, reached_by
from foldlab.datasets import of_space
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.learning.augment import Plan


def test_the_ratio_is_of_labels_near_the_boundary_to_random_ones():
    reached = {"boundary": 100, "random": 400, "boundary, states": 50, "random, states": np.inf}
    rows = [{"strategy": k, "accuracy": 0.98, "labels": v} for k, v in reached.items()]
    assert ratios_of(rows, (0.98,)) == {"0.98": 0.25, "0.98, states": None}


def test_costs_are_read_where_the_median_reaches_the_accuracy():
    curves = pd.DataFrame({
        "strategy": ["a"] * 6 + ["b"] * 2,
        "labels": [10, 20, 10, 20, 10, 20, 10, 20],
        "accuracy": [0.8, 0.9, 0.8, 0.9, 0.1, 0.99, 0.5, 0.6],
        "core_seconds": [1.0, 3.0, 1.0, 3.0, 50.0, 90.0, 1.0, 2.0],
    })  # fmt: skip
    first, second, never, _ = reached_by(curves, (0.85, 0.9))
    assert first["strategy"] == "a" and first["accuracy"] == 0.85
    assert first["labels"] == pytest.approx(15) and first["core_seconds"] == pytest.approx(2.0)
    assert second["labels"] == 20 and second["core_seconds"] == 3.0
    assert never["strategy"] == "b" and never["labels"] == np.inf and never["core_seconds"] is None


@pytest.fixture
def dataset(monkeypatch):
    """Labels of a rule, some with strips, some unknown, one core-second each."""
    table = FULL.sample(300, seed=0)
    heavy = table["h_ratio"] / table["E_ratio"] ** 0.5
    table["foldable"] = pd.array(heavy > heavy.median(), dtype="boolean")
    table.loc[::10, "foldable"] = None
    table.loc[5::50, "strips"] = 3.0
    table["strips"] = table["strips"].fillna(0.0)
    table = table.assign(growth="uniaxial", core_seconds=1.0)
    monkeypatch.setattr(
        gravity_augmentation,
        "load_dataset",
        lambda name, growth, space: of_space(table, name, space),
    )
    return table


def test_strategies_draw_the_same_numbers_of_labels_and_are_tested_on_the_same(
    dataset, tracker, monkeypatch
):
    seen = []
    augment = gravity_augmentation.augment

    def spied(space, source, make, **options):
        seen.append(options)
        return augment(space, source, make, **(options | {"expand": None}))

    monkeypatch.setattr(gravity_augmentation, "augment", spied)
    config = replace(
        TINY, seeds=2, test=50, targets=(0.6, 0.9999), plan=Plan(60, 20, cycles=3, epochs=1)
    )
    result = gravity_augmentation.run(config, tracker)
    assert len(seen) == 8 and result["seeds"] == 2 and result["test_labels"] == 50
    assert [o["seed"] for o in seen] == [0] * 4 + [1] * 4
    assert [o["expand"] is not None for o in seen] == [False, True] * 4
    for options in seen:
        (designs, truth), pool = options["test"], options["pool"]
        assert len(designs) == len(truth) == 50 and len(pool) == 294 - 50
        assert not set(designs.index) & set(pool.index)
        assert "strips" not in pool and pool["foldable"].isna().any()
    assert not seen[0]["pool"].index.equals(seen[4]["pool"].index)
    curves = tracker.tables["curves"]
    names = ["boundary", "boundary, states", "random", "random, states"]
    assert curves["strategy"].drop_duplicates().tolist() == names
    # One core-second for each label that was asked for.
    np.testing.assert_allclose(curves["core_seconds"], curves["labels"])
    assert result["final_labels"] == 100
    last = curves[curves["labels"] == 100].groupby("strategy")["accuracy"].median()
    assert result["final_accuracy"] == last.to_dict() and len(last) == 4
    beyond = [row for row in result["table"] if row["accuracy"] == 0.9999]
    assert {row["labels"] for row in beyond} == {None} and result["ratio"]["0.9999"] is None


def test_all_labels_but_those_of_the_test_may_be_drawn(dataset, tracker, monkeypatch):
    monkeypatch.setattr(gravity_augmentation, "states_as_labels", lambda table: table)
    # 244: the last of the pool is asked for in the third cycle.
    config = replace(TINY, test=50, plan=Plan(100, 72, cycles=3, epochs=1))
    assert gravity_augmentation.run(config, tracker)["final_labels"] == 244
    with pytest.raises(InputError, match="the pool has 244 designs, and the plan asks for 246"):
        more = replace(config, plan=replace(config.plan, per_cycle=73))
        gravity_augmentation.run(more, tracker)
