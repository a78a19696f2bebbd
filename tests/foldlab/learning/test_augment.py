"""Algorithm 5: where the labels go, equal budgets, and what "labels saved" means."""

import numpy as np
import pandas as pd
import pytest
from sklearn.linear_model import LogisticRegression

from foldlab.design import FULL, REDUCED
from foldlab.errors import InputError
from foldlab.labels.label import Label
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning import augment as augmenting
from foldlab.learning.augment import Plan, augment, compare_strategies, labels_to_reach

PLAN = Plan(initial=60, per_cycle=20, cycles=4, epochs=3, candidates=2000)


class Recorder:
    """A classifier with ``continue_fit``: logistic regression on logs that notes its budget."""

    def __init__(self, seed, epochs):
        self.seed, self.epochs, self.calls, self.asked = seed, epochs, [], []

    def fit(self, X, y):
        return self.continue_fit(X, y, epochs=self.epochs)

    def continue_fit(self, X, y, *, epochs):
        self.calls.append((len(X), epochs))
        self._model = LogisticRegression(C=100.0).fit(np.log(X), y)
        self.classes_ = self._model.classes_
        return self

    def predict(self, X):
        return self._model.predict(np.log(X))

    def predict_proba(self, X):
        p = self._model.predict_proba(np.log(X))
        self.asked.append((X, p[:, 1]))
        return p


def run(strategy, plan=PLAN, source=None, seed=0):
    designs = REDUCED.sample(500, seed=99)
    truth = TimoshenkoSource().evaluate(designs)["foldable"].to_numpy()
    return augment(
        REDUCED,
        source or TimoshenkoSource(),
        Recorder,
        strategy=strategy,
        plan=plan,
        seed=seed,
        test=(designs, truth),
    )


def test_both_strategies_spend_the_same_labels_and_epochs():
    boundary, random = run("boundary"), run("random")
    assert boundary.model.calls == random.model.calls == [(60, 3), (80, 3), (100, 3), (120, 3)]
    assert list(boundary.curve["labels"]) == list(random.curve["labels"]) == [60, 80, 100, 120]
    pd.testing.assert_frame_equal(
        boundary.labels.iloc[:60].drop(columns="seconds"),
        random.labels.iloc[:60].drop(columns="seconds"),
    )


def test_added_designs_lie_in_the_band_of_the_network_that_chose_them():
    result = run("boundary", Plan(initial=60, per_cycle=20, cycles=2, epochs=1, candidates=2000))
    first = Recorder(0, 1).fit(
        result.labels.iloc[:60][REDUCED.names],
        result.labels.iloc[:60]["foldable"].to_numpy(bool),
    )
    p = first.predict_proba(result.labels.iloc[60:][REDUCED.names])[:, 1]
    assert ((p >= 0.4) & (p <= 0.6)).all()
    assert result.curve["in_band"].iloc[1] == 1.0
    random = run("random", Plan(initial=60, per_cycle=20, cycles=2, epochs=1, candidates=2000))
    q = first.predict_proba(random.labels.iloc[60:][REDUCED.names])[:, 1]
    assert ((q < 0.4) | (q > 0.6)).any()


@pytest.mark.parametrize("band, candidates", [((0.4999, 0.5001), 500), ((0.2, 0.5001), 60)])
def test_a_thin_band_is_filled_with_the_nearest_designs_and_says_so(band, candidates):
    plan = Plan(initial=60, per_cycle=20, cycles=2, epochs=1, band=band, candidates=candidates)
    result = run("boundary", plan)
    (pool, p), *_ = result.model.asked
    inside = (p >= band[0]) & (p <= band[1])
    assert inside.sum() < 20
    # All of the band, then the nearest to 0.5 of what lies outside it.
    further = np.sort(np.abs(p[~inside] - 0.5))[: 20 - inside.sum()]
    expected = inside | (~inside & (np.abs(p - 0.5) <= further[-1]))
    added = result.labels.iloc[60:][REDUCED.names].to_numpy()
    assert len(added) == 20 == expected.sum()
    assert set(map(tuple, added)) == set(map(tuple, pool[expected].to_numpy()))
    assert result.curve["in_band"].iloc[1] == inside.sum() / 20


def test_seed_reproduces_and_changes():
    a, b, c = run("boundary"), run("boundary"), run("boundary", seed=1)
    groups = REDUCED.names
    pd.testing.assert_frame_equal(a.labels[groups], b.labels[groups])
    assert not a.labels[groups].equals(c.labels[groups])


class Forgetful(TimoshenkoSource):
    """Every fifth label is unknown."""

    def label_many(self, designs):
        labels = super().label_many(designs)
        return [
            Label(x.design, None, "lost", {}, self.name, self.version) if k % 5 == 0 else x
            for k, x in enumerate(labels)
        ]


def test_unknown_labels_are_counted_and_not_trained_on():
    result = run("boundary", source=Forgetful())
    assert list(result.curve["unknown"]) == [12, 16, 20, 24]
    # They were paid for all the same.
    assert list(result.curve["labels"]) == [60, 80, 100, 120]
    assert [n for n, _ in result.model.calls] == [48, 64, 80, 96]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cycles": 0}, "cycles = 0"),
        ({"band": (0.6, 0.7)}, "around 0.5"),
        ({"per_cycle": 30_000}, "exceeds candidates"),
    ],
)
def test_plans_are_checked(changes, message):
    with pytest.raises(InputError, match=message):
        Plan(**changes)


def test_one_class_and_unknown_strategy():
    with pytest.raises(InputError, match="no strategy 'middle'"):
        run("middle")
    with pytest.raises(InputError, match="all True"):
        augment(
            REDUCED.with_bounds(slenderness=(1e-3, 1.1e-3), E_ratio=(0.1, 1)),
            TimoshenkoSource(),
            Recorder,
            plan=PLAN,
            seed=0,
            test=(REDUCED.sample(2, seed=0), np.array([True, False])),
        )


def test_labels_to_reach_interpolates_the_median():
    curve = pd.DataFrame(
        {"labels": [100, 100, 100, 200, 200, 200], "accuracy": [0.9, 0.9, 0.1, 0.98, 1.0, 0.98]}
    )
    assert labels_to_reach(curve, 0.94) == pytest.approx(150)
    assert labels_to_reach(curve, 0.9) == 100
    assert labels_to_reach(curve, 0.99) == np.inf


def test_a_full_band_is_sampled_not_searched_for_its_middle():
    plan = Plan(initial=60, per_cycle=20, cycles=2, epochs=1, candidates=5000)
    result = run("boundary", plan)
    known = result.labels.iloc[:60]
    first = Recorder(0, 1).fit(known[REDUCED.names], known["foldable"].to_numpy(bool))
    p = first.predict_proba(result.labels.iloc[60:][REDUCED.names])[:, 1]
    # The nearest to 0.5 of 5000 candidates would all lie within 0.02 of it.
    assert np.abs(p - 0.5).max() > 0.05


def test_the_ratio_is_of_labels_near_the_boundary_to_random_ones(monkeypatch):
    reached = {"boundary": 100, "random": 400}

    def followed(space, source, make_model, *, strategy, plan, seed, test):
        rows = {
            "strategy": strategy, "seed": seed, "cycle": [0, 1],
            "labels": [50, reached[strategy]], "accuracy": [0.8, 0.95], "seconds": 0.0,
        }  # fmt: skip
        return augmenting.Augmented(None, pd.DataFrame(), pd.DataFrame(rows))

    monkeypatch.setattr(augmenting, "augment", followed)
    curves, summary = compare_strategies(
        TimoshenkoSource(), PLAN, seeds=(0, 1), target=0.95, test_designs=10, make_model=Recorder
    )
    assert len(curves) == 8
    assert (summary["labels_boundary"], summary["labels_random"]) == (100, 400)
    assert summary["ratio"] == 0.25


def pool_of(n):
    designs = REDUCED.sample(n, seed=5)
    truth = TimoshenkoSource().evaluate(designs)["foldable"]
    return designs.assign(foldable=pd.array(truth.to_numpy(bool), dtype="boolean"))


class Refitted(Recorder):
    """One that can only be fitted anew."""

    continue_fit = None

    def __getattribute__(self, name):
        if name == "continue_fit":
            raise AttributeError(name)
        return super().__getattribute__(name)

    def fit(self, X, y):
        return Recorder.continue_fit(self, X, y, epochs=self.epochs)


@pytest.mark.parametrize("strategy", ["boundary", "random"])
def test_a_pool_is_drawn_from_without_putting_back(strategy):
    pool, asked = pool_of(140), []

    def label(designs):
        asked.extend(designs.index)
        return pool.loc[designs.index]

    test = pool[REDUCED.names], pool["foldable"].to_numpy(bool)
    result = augment(
        REDUCED, label, Refitted, strategy=strategy, plan=PLAN, seed=0, test=test, pool=pool
    )
    assert len(asked) == len(set(asked)) == 120 and set(asked) <= set(pool.index)
    assert result.model.calls == [(60, 3), (80, 3), (100, 3), (120, 3)]
    with pytest.raises(InputError, match="the pool has 119 designs, and the plan asks for 120"):
        augment(
            REDUCED, label, Refitted, strategy=strategy, plan=PLAN, seed=0, test=test,
            pool=pool.iloc[:119],
        )  # fmt: skip


def test_what_labels_teach_besides_is_trained_on_and_costs_nothing():
    def twice(known):
        assert known["foldable"].notna().all()
        return known

    designs = REDUCED.sample(50, seed=9)
    truth = TimoshenkoSource().evaluate(designs)["foldable"].to_numpy()
    result = augment(
        REDUCED, Forgetful(), Recorder, plan=PLAN, seed=0, test=(designs, truth), expand=twice
    )
    assert [n for n, _ in result.model.calls] == [96, 128, 160, 192]
    assert list(result.curve["labels"]) == [60, 80, 100, 120]


class Dear:
    name, version, space = "dear", "1", REDUCED

    def label(self, design):
        return TimoshenkoSource().label(design)


def test_a_source_that_is_no_formula_needs_test_labels():
    with pytest.raises(InputError, match="'dear' is no formula, and 20000 test designs would cost"):
        compare_strategies(Dear(), PLAN, seeds=(0,), make_model=Recorder)
    table = pool_of(300)
    table.loc[:9, "foldable"] = None
    curves, _ = compare_strategies(
        Dear(), PLAN, seeds=(0,), make_model=Recorder, test=table, target=0.5
    )
    rest = table.iloc[10:]
    known = rest[REDUCED.names], rest["foldable"].to_numpy(bool)
    same = augment(REDUCED, Dear(), Recorder, plan=PLAN, seed=0, test=known).curve
    got = curves[curves["strategy"] == "boundary"]["accuracy"]
    assert got.tolist() == same["accuracy"].tolist()


def test_a_network_that_nobody_chose_sees_the_physics_where_there_is_some():
    assert augmenting._default_network(FULL, 0, 5).inputs == "physics"
    assert augmenting._default_network(REDUCED, 0, 5).inputs == "groups"
