"""Parts (d) to (f) of accuracy_vs_time on made-up labels: which count, and what they cost."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from experiments._accuracy import labels
from experiments.accuracy_vs_time import TINY, Config, chosen
from foldlab.design import FULL
from foldlab.labels.screening import COARSE_ERROR
from foldlab.labels.store import LabelStore
from foldlab.labels.timoshenko import TimoshenkoSource


def booleans(*values):
    return pd.Series(pd.array(values, dtype="boolean"))


def made(n=60, seed=0):
    """Labels of a rule in one group, every tenth unknown, at 2 core-seconds each."""
    table = FULL.sample(n, seed=seed)
    table["foldable"] = pd.array(table["h_ratio"] > table["h_ratio"].median(), dtype="boolean")
    table.loc[::10, "foldable"] = None
    return table.assign(core_seconds=2.0, growth="uniaxial")


def test_the_coarse_error_is_that_of_the_larger_angle_where_both_came_to_the_end():
    g = 0.1
    need = np.pi * g
    accurate = pd.DataFrame({"m1": [1.0, 0.1, 2.0, 2.0, 2.0], "m2": 0.0, "m3": 1.0, "m4": 1.0})
    accurate["contraction"] = accurate["contraction_reached"] = g
    accurate["error_estimate"] = 0.01
    coarse = accurate.copy()
    coarse["m1"] = [1.0 + COARSE_ERROR / 2, 0.1 - 0.2 * need, 9.0, 9.0, 9.0]
    coarse["m2"] = [0.1 * need, 0.1 * need, 0.0, 0.0, 0.0]
    coarse["m3"], coarse["m4"] = [0.9, 1.01, 1.0, 1.0, 1.0], [1.0, 0.98, 1.0, 1.0, 1.0]
    # Of the last three one path ended early on each mesh, and one has no error.
    coarse.loc[2, "contraction_reached"] = 0.99 * g
    accurate.loc[3, "contraction_reached"] = 0.99 * g
    accurate.loc[4, "error_estimate"] = np.nan
    found = labels.calibration(accurate, coarse)
    assert found["designs"] == 2 and found["bound"] == COARSE_ERROR
    # m1 counts against |m1| or |g|π, the larger; m2 against |g|π.
    assert found["error_median"] == pytest.approx(np.mean([0.1, 0.2]))
    assert found["error_90"] == pytest.approx(0.19) and found["error_99"] == pytest.approx(0.199)
    assert found["error_95"] == pytest.approx(0.195)
    assert found["slip_median"] == pytest.approx(0.06) and found["slip_99"] == pytest.approx(0.0992)
    assert found["within"] == 0.5
    assert (found["within_low"], found["within_high"]) == labels.wilson(1, 2)
    nothing = labels.calibration(accurate, coarse.tail(3))
    assert nothing["designs"] == 0 and nothing["within"] is None
    lone = coarse.assign(error_estimate=[np.nan, 0.01, 0.01, 0.01, 0.01])
    assert labels.calibration(accurate, lone)["designs"] == 1


def mixed(**changes):
    """A mixture of one design, clear and settled on the coarse mesh but for what is changed."""
    row = {
        "m1": 2.0, "contraction": 0.1, "m2": 0.0, "m3": 1.0, "m4": 1.0, "unstable_modes": 0.0,
        "events": "[]", "core_seconds": 1.0, "error_estimate": 0.1, "outcome": "folds",
    } | changes  # fmt: skip
    coarse = pd.DataFrame([row]).assign(foldable=booleans(True))
    table = pd.DataFrame({"foldable": booleans(False), "core_seconds": [5.0]})
    return {row["band"]: row for row in labels.mixing(table, coarse, table)}


@pytest.mark.parametrize(
    ("changes", "refined"),
    [
        ({}, 0.0),
        ({"error_estimate": np.nan}, 1.0),
        ({"unstable_modes": 1.0}, 1.0),
        ({"m1": 6.4}, 1.0),
        ({"m2": 3.2}, 1.0),
        ({"events": "[snap]"}, 1.0),
        ({"events": "[bifurcation]"}, 1.0),
        ({"events": "[toppling]"}, 0.0),
    ],
    ids=str,
)
def test_what_is_in_doubt_is_refined_whatever_the_band(changes, refined):
    row = mixed(**changes)[0.0]
    assert row["refined"] == refined
    # Refined, it is the dataset's answer and price; else the coarse one's.
    assert (row["wrong"], row["core_seconds_mean"]) == ((0, 5.0) if refined else (1, 1.0))
    assert row["labels_per_hour"] == 3600 / row["core_seconds_mean"]


def test_bands_grow_and_what_cost_less_than_the_coarse_path_costs_nothing_more():
    need = 0.1 * np.pi
    rows = mixed(m1=1.1 * need, core_seconds=7.0)
    fractions = {band: row["refined"] for band, row in rows.items()}
    assert fractions == {
        "coarse": 0.0, 0.0: 0.0, 0.05: 0.0, COARSE_ERROR: 1.0, 0.3: 1.0, None: 1.0,
    }  # fmt: skip
    assert {row["core_seconds_mean"] for row in rows.values()} == {7.0}
    assert rows["coarse"]["labels_per_hour"] == pytest.approx(3600 / 7)
    assert rows["coarse"]["compared"] == 1 == rows["coarse"]["wrong"]


def test_prices_are_of_one_machine_and_of_the_same_designs():
    coarse = pd.DataFrame({"core_seconds": [1.0, 2.0, 6.0]}, index=[4, 5, 6])
    fine = pd.DataFrame({"core_seconds": [4.0, 8.0]}, index=[4, 5])
    assert labels.prices(coarse, fine) == {"coarse": 3.0, "accurate": 12.0}


def test_a_draw_is_of_whole_labels_and_of_no_more_than_there_are():
    table = pd.DataFrame({"a": range(5)})
    assert labels._drawn(table, 0.99, 0) is None and labels._drawn(table, 6.0, 0) is None
    assert len(labels._drawn(table, 1.0, 0)) == 1 and len(labels._drawn(table, 5.9, 0)) == 5
    two = labels._drawn(table, 2.9, 1)
    assert len(two) == 2 and two.equals(labels._drawn(table, 2, 1))
    assert any(not two.equals(labels._drawn(table, 2, s)) for s in range(2, 6))


def test_test_labels_are_known_and_nothing_learns_from_them():
    table = made()
    train, test = labels.split(table, Config(test=0.25, seed=1))
    assert len(test) == 14 and test["foldable"].notna().all()
    assert test["foldable"].sum() == 7  # as in the whole
    assert len(train) == 46 and not set(train.index) & set(test.index)
    pd.testing.assert_frame_equal(labels.split(table, Config(test=0.25, seed=1))[1], test)
    # Unknown ones were paid for; none comes first because it stood first.
    assert train["foldable"].isna().sum() == 6 and list(train.index) != sorted(train.index)


def test_classifiers_are_paid_for_by_their_labels(monkeypatch):
    other = made(seed=1).assign(growth="isotropic")
    table = pd.concat([made(200), other], ignore_index=True)
    table.loc[3::7, "foldable"] = ~table.loc[3::7, "foldable"]
    monkeypatch.setattr(labels, "load_dataset", lambda name: table)
    monkeypatch.setattr(labels, "seconds_per_million", lambda model, X: float(len(X)))
    said = []
    config = Config(models=("tree",), counts=(40, 80), seeds=2, test=0.25)
    rows = labels.classifiers(config, said.append)
    assert rows == said
    asked = [(40, 0), (40, 1), (80, 0), (80, 1), (155, 0)]
    assert [(r["labels"], r["seed"]) for r in rows] == asked
    for row in rows:
        assert row["test"] == 45 == row["seconds_per_million"]
        assert row["label_core_seconds"] == 2.0 * row["labels"]
        assert row["accuracy_low"] < row["accuracy"] <= row["accuracy_high"] <= 1
        assert row["model"] == "tree" and row["train_seconds"] > 0
    assert any(row["accuracy"] < row["accuracy_high"] for row in rows)
    assert rows[-1]["accuracy"] > 0.6


def test_labels_that_all_say_the_same_train_nothing():
    table = made().assign(foldable=booleans(*[True] * 30, *[None] * 30))
    assert labels._fitted("tree", table, 0) == (None, 0.0)
    model, seconds = labels._fitted("tree", made(), 0)
    known = made()[made()["foldable"].notna()]
    assert (model.predict(known[FULL.names]) == known["foldable"].astype(bool)).mean() > 0.9
    assert seconds > 0


def test_the_same_budget_buys_fewer_accurate_labels_than_coarse_ones():
    table = made(400)
    coarse = table.sample(120, random_state=0).assign(
        outcome="folds", core_seconds=0.5, error_estimate=0.01
    )
    config = replace(
        TINY, budgets=(20.0, 60.0, 400.0), seeds=2, budget_test=0.25, formula_labels=50
    )
    rows = labels.budgets(config, table, coarse, {"accurate": 2.0, "coarse": 0.5}, lambda _: None)
    counts = {}
    for row in rows:
        counts.setdefault((row["labels_are"], row["budget"]), []).append(row["labels"])
    *_, formula = rows
    assert formula["labels_are"] == "Timoshenko" and formula["labels"] == 50
    counts.pop(("Timoshenko", formula["budget"]))
    assert counts == {
        ("accurate", 20.0): [10, 10],
        ("coarse", 20.0): [40, 40],
        ("half coarse, half accurate", 20.0): [25, 25],
        ("accurate", 60.0): [30, 30],
        ("coarse", 60.0): [120, 120],
        ("half coarse, half accurate", 60.0): [75, 75],
        # 800 coarse labels there are not, nor half of them.
        ("accurate", 400.0): [200, 200],
    }
    known = table["foldable"].notna() & ~table.index.isin(coarse.index)
    assert {row["test"] for row in rows} == {int(np.ceil(0.25 * known.sum()))}
    assert {row["seed"] for row in rows} == {0, 1}


def test_an_hour_is_told_from_three_counts_on_and_of_their_means():
    def row(n, accuracy, kind="coarse"):
        return {"labels_are": kind, "labels": n, "accuracy": accuracy}

    rows = [row(n, 1 - 1 / n + d) for n in (10, 100, 1000) for d in (-1e-4, 1e-4)]
    rows += [row(10, 0.9, "accurate"), row(20, 0.9, "accurate")]
    (found,) = labels.in_an_hour(rows, {"coarse": 2.0, "accurate": 1.0, "none": 1.0})
    assert found["labels_are"] == "coarse" and found["core_seconds_per_label"] == 2.0
    assert found["labels"] == 1800 and found["beyond"] == 1.8
    assert found["exponent"] == pytest.approx(1.0)
    assert found["accuracy"] == pytest.approx(1 - 1 / 1800)


@pytest.fixture
def stand_ins(monkeypatch, tmp_path):
    """Labels at a price by source, in place of those that a solver makes; what was asked."""
    monkeypatch.chdir(tmp_path)
    asked = []

    def labelled(designs, source, store, workers):
        effort = getattr(source, "effort", None)
        asked.append((source, len(designs), workers))
        price = 0.0 if effort is None else effort.timeout / (1 + 10 * effort.accuracy)
        frame = designs[FULL.names].reset_index(drop=True)
        frame["foldable"] = booleans(*([True, False, None] * len(designs))[: len(designs)])
        if effort is None:
            frame["foldable"] = booleans(*[True] * len(designs))
        spent = price + np.arange(len(frame)) ** 2
        # A formula's label states seconds alone.
        frame["core_seconds"], frame["seconds"] = spent, (spent if effort is None else -1.0)
        if effort is None:
            frame = frame.drop(columns="core_seconds")
        return frame

    monkeypatch.setattr(labels, "labelled", labelled)
    return asked


def test_each_rung_is_compared_with_the_finest_on_the_same_designs(stand_ins):
    config = Config(ladder=7, ladder_whole=2, timeout=3.0, workers=1, seed=5)
    said = []
    rows = labels.ladder(config, said.append)
    assert rows == said and [r["labels"] for r in rows] == [7, 7, 7, 7, 7, 2]
    assert {workers for *_, workers in stand_ins} == {1}
    formula, *_, finest, whole = rows
    assert formula["source"] == "Timoshenko" and formula["known"] == 1.0
    assert (formula["compared"], formula["wrong"]) == (5, 2)
    assert finest["source"] == labels.FINEST and finest["wrong"] == 0
    assert finest["known"] == pytest.approx(5 / 7)
    assert finest["core_seconds_mean"] == pytest.approx(3 / 1.05 + 13)
    assert finest["core_seconds_median"] == pytest.approx(3 / 1.05 + 9)
    assert finest["labels_per_hour"] == pytest.approx(3600 / (3 / 1.05 + 13))
    assert whole["core_seconds_mean"] == pytest.approx(12 / 1.2 + 0.5)
    assert whole["compared"] == 2
    none = labels.ladder(replace(config, ladder_whole=0), said.append)
    assert [r["source"] for r in none] == [r["source"] for r in rows[:-1]]


def test_rungs_differ_in_what_they_refine_and_in_their_time():
    sources = labels.ladder_sources(3.0)
    asked = {
        name: (s.effort.refine, s.effort.accuracy, s.effort.timeout, s.seed)
        for name, s in sources.items()
        if name != "Timoshenko"
    }
    assert asked == {
        "quarter, coarse": ("never", 0.02, 3.0, None),
        "mixed": ("near", 0.02, 3.0, None),
        "quarter, 2 %": ("always", 0.02, 3.0, None),
        labels.FINEST: ("always", 0.005, 3.0, None),
        "whole, 2 %": ("always", 0.02, 12.0, 0),
    }
    assert sources["Timoshenko"].space is FULL


def test_labels_come_in_the_order_of_their_designs_whatever_the_store_has(tmp_path):
    designs = FULL.sample(5, seed=0)
    source = TimoshenkoSource(FULL)
    with LabelStore(tmp_path / "labels.db") as store:
        labels.labelled(designs.iloc[[3, 1]], source, store, 0)
        frame = labels.labelled(designs.iloc[[4, 3, 0]], source, store, 0)
    np.testing.assert_array_equal(frame[FULL.names], designs.iloc[[4, 3, 0]])
    assert list(frame.index) == [0, 1, 2] and "index" not in frame
    expected = source.evaluate(designs.iloc[[4, 3, 0]])["foldable"]
    assert frame["foldable"].tolist() == expected.tolist()


def test_cheap_labels_are_of_designs_of_the_dataset(stand_ins, monkeypatch):
    table = pd.concat([made(20, 1).assign(growth="isotropic"), made(30)], ignore_index=True)
    monkeypatch.setattr(labels, "load_dataset", lambda name: table)
    config = Config(cheap=9, clocked=3, timeout=3.0, workers=1)
    there, coarse, fine = labels.cheap_labels(config)
    assert (there["growth"] == "uniaxial").all() and len(there) == 30
    assert list(there.index) == list(range(30))
    assert [count for _, count, _ in stand_ins] == [9, 3]
    assert [source.effort.refine for source, *_ in stand_ins] == ["never", "always"]
    assert {source.effort.timeout for source, *_ in stand_ins} == {3.0}
    np.testing.assert_array_equal(coarse[FULL.names], there.loc[coarse.index, FULL.names])
    np.testing.assert_array_equal(fine[FULL.names], there.loc[fine.index, FULL.names])
    assert list(coarse.index[:3]) == list(fine.index)


def test_what_to_take_has_a_row_for_each_rung_and_for_the_best_of_the_most_labels():
    rung = {"disagreement_low": 0.01, "disagreement_high": 0.2, "wrong": 2, "compared": 40,
            "core_seconds_mean": 1.5, "labels_per_hour": 2400.0}  # fmt: skip
    names = ("Timoshenko", "mixed", labels.FINEST, "another")
    few = {"model": "tree", "labels": 100, "accuracy": 0.99, "accuracy_low": 0.9,
           "accuracy_high": 0.999, "label_core_seconds": 9.0, "train_seconds": 0.25,
           "seconds_per_million": 0.5}  # fmt: skip
    many = few | {"labels": 900, "accuracy": 0.95}
    best = few | {"model": "forest", "labels": 900, "accuracy": 0.97, "label_core_seconds": 1234.4}
    found = chosen(
        {"ladder": [rung | {"source": n} for n in names], "classifiers": [few, many, best]}
    )
    assert [row["take"] for row in found] == [
        "foldlab label --source timoshenko",
        "foldlab label --source solver --set refine=near",
        "foldlab label --source solver --set accuracy=0.005",
        "foldlab train --model forest, 900 labels",
    ]
    assert found[0]["wrong"] == "2 of 40 (1.0% to 20.0%)"
    assert found[2]["wrong"] == "what the others are compared with"
    assert found[0]["costs"] == "1.5 core-seconds, 2400 labels per core-hour"
    assert found[3]["wrong"] == "3.0% (0.1% to 10.0%)"
    assert found[3]["costs"] == (
        "1234 core-seconds of labels, 0.25 s of training, 0.5 s per million"
    )
    (none,) = chosen({})
    assert none["take"] == "parts a, d or e make rows"
