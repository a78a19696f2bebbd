"""Models side by side: which labels each figure is from."""

import pytest

import foldlab.learning.compare as comparing
from foldlab.design import REDUCED
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.compare import compare, readable
from foldlab.learning.scoring import score


def test_each_figure_is_of_the_labels_that_it_names():
    train, fresh = (TimoshenkoSource().evaluate(REDUCED.sample(n, seed=n)) for n in (600, 3000))
    # A test whose labels are all wrong: what is right there is wrong on fresh designs.
    test = fresh.head(1000).assign(foldable=~fresh["foldable"].head(1000))
    made = compare(["tree"], REDUCED, train, test, fresh, seed=0)
    ((row,), model) = made.rows, made.models["tree"]
    seen, told = (score(model, t[REDUCED.names], t["foldable"]) for t in (test, fresh))
    assert row["accuracy"] == seen["accuracy"] < 0.2 < 0.8 < told["accuracy"]
    assert (row["accuracy_low"], row["accuracy_high"]) == seen["accuracy_interval"]
    assert row["accuracy_fresh"] == told["accuracy"]
    assert row["false_positive_rate"] == told["false_positive_rate"] < 0.2
    assert (row["labels"], row["dissertation"]) == (600, 0.962)
    assert row["size"] == model[-1].tree_.node_count and row["size_unit"] == "nodes"
    (text,) = readable(made.rows)
    assert float(text["fresh"]) == pytest.approx(told["accuracy"], abs=1e-4)
    assert text["dissertation"] == "0.962"


def test_only_the_symbolic_model_learns_from_the_first_labels(monkeypatch):
    fit, seen = comparing.fit, {}

    def noted(name, space, table, **options):
        seen[name] = list(table.index)
        return fit("tree", space, table, **options)

    monkeypatch.setattr(comparing, "fit", noted)
    train, test = (TimoshenkoSource().evaluate(REDUCED.sample(n, seed=n)) for n in (300, 200))
    made = compare(["symbolic", "tree"], REDUCED, train, test, test, seed=0, symbolic_labels=120)
    assert seen == {"symbolic": list(range(120)), "tree": list(range(300))}
    assert [row["labels"] for row in made.rows] == [120, 300]
