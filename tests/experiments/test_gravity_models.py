"""How models of folding under weight are judged: folds, halves, curves, angles and the map."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments import gravity_models
from experiments.common import counted
from experiments.gravity_models import AXES, HELD, SLICED, TINY, Config
from foldlab.design import FULL
from foldlab.labels.foldability import Thresholds
from foldlab.labels.label import Label
from foldlab.learning.conformal import borders_of
from foldlab.learning.operating_point import threshold_of
from foldlab.learning.scoring import upper_bound


def made(n=120, seed=0):
    """Known labels of a rule in two groups that a tree has to learn."""
    table = FULL.sample(n, seed=seed)
    weight = table["h_ratio"] / table["E_ratio"] ** 0.5
    table["foldable"] = weight > weight.median()
    table["fold_angle"] = np.pi * table["contraction"] * np.where(table["foldable"], 1.5, 0.5)
    table["normalised_angle"] = table["fold_angle"] / table["contraction"]
    return table.assign(growth="uniaxial", threshold=Thresholds().turning)


@pytest.fixture
def guesses():
    """Probabilities that rise with the truth, noisily, and whether each label folds."""
    rng = np.random.default_rng(3)
    y = rng.random(600) < 0.5
    return np.clip(0.5 + 0.3 * (2 * y - 1) + 0.2 * rng.normal(size=600), 0.001, 0.999), y


def halves(n, seed):
    return np.random.default_rng(seed).random(n) < 0.5


def test_the_half_that_chose_a_threshold_is_not_the_one_that_it_is_stated_on(guesses):
    p, y = guesses
    config = Config(seed=4, rate=0.05)
    said = gravity_models._careful(p, y, config)
    chooses = halves(600, 4)
    threshold = threshold_of(p[chooses], y[chooses], rate=0.05).threshold
    folds, truth = p[~chooses] >= threshold, y[~chooses]
    wrong, of = int((folds & ~truth).sum()), int((~truth).sum())
    assert wrong > 0 and said["false_positive_rate"] == wrong / of
    assert said["recall"] == (folds & truth).sum() / truth.sum()
    assert said["false_positive_bound"] == upper_bound(wrong, of) > wrong / of


def test_a_threshold_itself_is_an_answer_that_folds():
    y = np.array([True, False] * 100)
    p = np.where(y, 0.75, 0.25)
    said = gravity_models._careful(p, y, Config(rate=0.2))
    assert (said["recall"], said["false_positive_rate"]) == (1.0, 0.0)
    certain = np.ones(200)
    none = {"recall": None, "false_positive_rate": None, "false_positive_bound": None}
    assert gravity_models._careful(certain, y, Config(rate=0.01)) == none


def test_answers_and_wrong_ones_are_counted_on_the_half_that_did_not_choose(guesses):
    p, y = guesses
    said = gravity_models._sure(p, y, Config(seed=4, coverage=0.9))
    chooses = halves(600, 4)
    answers = borders_of(p[chooses], y[chooses], coverage=0.9).answers(p[~chooses])
    told = ~answers.isna()
    wrong = np.array([a is not pd.NA and a != t for a, t in zip(answers, y[~chooses], strict=True)])
    assert said == {"decided": told.mean(), "covered": pytest.approx(1 - wrong.mean())}
    assert wrong.sum() > 0 and told.mean() < 1
    few = gravity_models._sure(p[:20], y[:20], Config(coverage=0.99))
    assert few == {"decided": None, "covered": None}


def test_each_label_is_predicted_by_a_model_that_has_not_seen_it(monkeypatch):
    known, seen = made(30), []

    def fit(name, space, labels, *, seed, **options):
        seen.append((name, len(labels), seed, options))
        return set(labels.index)

    def probability(model, designs):
        assert not model & set(designs.index)
        return np.where(known.loc[designs.index, "foldable"], 0.5, 0.4)

    monkeypatch.setattr(gravity_models, "fit", fit)
    monkeypatch.setattr(gravity_models, "probability_of_folding", probability)
    monkeypatch.setattr(gravity_models, "model_size", lambda model: (7, "nodes"))
    config = Config(folds=3, seed=5)
    row, told, last = gravity_models._validated(known, "tree", "physics", config)
    assert seen == [("tree", 20, 5, {"inputs": "physics"})] * 3 and len(last) == 20
    # 0.5 itself folds.
    assert row["accuracy"] == row["accuracy_low"] == row["accuracy_high"] == 1.0
    assert told.tolist() == np.where(known["foldable"], 0.5, 0.4).tolist()
    assert row["size"] == "7 nodes" and row["train_seconds"] >= 0 and "formula" not in row
    assert row["calibration_error"] == pytest.approx(0.45)
    assert (row["model"], row["inputs"]) == ("tree", "physics")


def test_accuracies_of_the_folds_are_told_as_mean_and_ends():
    known = made(90)
    config = Config(folds=3)
    row, told, _ = gravity_models._validated(known, "tree", "groups", config)
    right = (told >= 0.5) == known["foldable"].to_numpy()
    folds = [right[held].mean() for _, held in gravity_models._folds(known, config)]
    assert row["accuracy"] == pytest.approx(np.mean(folds)) and len(folds) == 3
    assert row["accuracy_low"] == min(folds) < max(folds) == row["accuracy_high"]


def test_designs_near_the_boundary_are_learned_from_and_do_not_count(monkeypatch):
    known = made(90)
    y = known["foldable"].to_numpy()
    known["drawn"] = np.where(np.arange(90) < 60, "hypercube", "boundary")
    assert counted(known).sum() == 60
    assert counted(known.drop(columns="drawn")).all()
    assert counted(known.assign(drawn="boundary")).all()
    sizes = []

    def fit(name, space, labels, *, seed, **options):
        sizes.append(len(labels))

    def probability(model, designs):
        """Right, but for every third near the boundary."""
        at = designs.index.to_numpy()
        return np.where(y[at] ^ ((at >= 60) & (at % 3 == 0)), 0.9, 0.1)

    monkeypatch.setattr(gravity_models, "fit", fit)
    monkeypatch.setattr(gravity_models, "probability_of_folding", probability)
    monkeypatch.setattr(gravity_models, "model_size", lambda model: (7, "nodes"))
    row, told, _ = gravity_models._validated(known, "tree", "groups", Config(folds=3))
    assert sizes == [60] * 3 and np.isfinite(told).all()
    assert row["accuracy"] == row["accuracy_low"] == 1.0 and row["near"] == pytest.approx(2 / 3)
    assert row["calibration_error"] == pytest.approx(0.1)


def test_a_small_tree_has_no_more_than_its_leaves():
    known = made(400, seed=2)
    rng = np.random.default_rng(0)
    known["foldable"] ^= rng.random(400) < 0.2
    model = gravity_models._fitted("small tree", known, "groups", Config())
    assert model[-1].get_n_leaves() == 16
    large = gravity_models._fitted("tree", known, "groups", Config())
    assert large[-1].get_n_leaves() > 16


def test_only_formulas_are_given_seconds_and_a_size():
    config = Config(symbolic_seconds=3.0, symbolic_nodes=9, seed=2)
    assert gravity_models._options("tree", "rod", config) == {"inputs": "rod"}
    options = gravity_models._options("symbolic", "groups", config)
    assert options["max_size"] == 9 and options["inputs"] == "groups"
    assert (options["constraints"].seconds, options["constraints"].seed) == (3.0, 2)


def test_the_learning_curve_has_a_point_for_each_number_of_labels_and_fold():
    known = made(61)
    config = Config(folds=2, curve=(20, 100), learner="tree", inputs=("groups", "physics"))
    curves = gravity_models._curves(known, config)
    # Of 61 labels the halves are 31 and 30: one point of the curve.
    points = curves.groupby(["strategy", "labels", "seed"]).size()
    assert points.to_dict() == {
        (name, n, fold): 1 for name in config.inputs for n in (20, 30) for fold in (0, 1)
    }
    assert curves["accuracy"].between(0, 1).all() and curves["accuracy"].mean() > 0.6
    alike = known.assign(foldable=[True] * 55 + [False] * 6)
    few = gravity_models._curves(alike, replace(config, curve=(2, 40)))
    assert set(few["labels"]) <= {2, 30} and 30 in set(few["labels"])


def test_angles_are_compared_with_those_of_the_labels_and_of_the_rod_itself(monkeypatch):
    known = made(80)
    rod = pd.DataFrame({"rod": known["fold_angle"] / Thresholds().angle(known["contraction"])})
    monkeypatch.setattr(gravity_models, "rod_of", lambda table: rod)
    groups, physics, itself = gravity_models._angles(
        known, Config(folds=2, inputs=("groups", "physics"))
    )
    assert (groups["inputs"], physics["inputs"]) == ("groups", "physics")
    assert groups["n"] == physics["n"] == itself["n"] == 80
    assert 0 < groups["error_median"] < 1 and groups["error_median"] < groups["error_90"]
    assert itself["inputs"] == "the rod itself" and itself["accuracy"] == 1.0
    assert itself["error_median"] == pytest.approx(0, abs=1e-12)


def test_isotropic_labels_are_learned_from_where_each_fold_has_both_answers():
    table = made(60).assign(growth="isotropic")
    table["foldable"] = pd.array(table["foldable"], dtype="boolean")
    table.loc[:5, "foldable"] = None
    table = pd.concat([table, made(50, 1)], ignore_index=True)
    config = Config(folds=3, inputs=("groups",))
    said = gravity_models._isotropic(table, config)
    known = table[(table["growth"] == "isotropic") & table["foldable"].notna()]
    folds = int(known["foldable"].sum())
    assert (said["labels"], said["scored"], said["folds"]) == (54, 54, folds)
    assert said["majority"] == pytest.approx(max(folds, 54 - folds) / 54)
    row, *_ = gravity_models._validated(known.reset_index(drop=True), "boosted", "groups", config)
    assert said["groups"] == row["accuracy"]
    few = known.assign(foldable=[True] * 3 + [False] * 51)
    assert "groups" in gravity_models._isotropic(few, config)
    fewer = known.assign(foldable=[True] * 2 + [False] * 52)
    assert gravity_models._isotropic(fewer, config) == {"labels": 54, "scored": 54, "folds": 2}
    none = known.assign(foldable=[False] * 54)
    assert gravity_models._isotropic(none, config) == {"labels": 54, "scored": 54, "folds": 0}


class Rule:
    """Folds from h_i/h_s = 1 on."""

    classes_ = np.array([False, True])

    def predict_proba(self, X):
        p = np.where(np.asarray(X["h_ratio"]) >= 1, 0.5, 0.2)
        return np.column_stack([1 - p, p])

    def predict(self, X):
        return self.predict_proba(X)[:, 1] >= 0.5


def test_the_map_is_verified_where_the_solver_has_an_answer(tracker, monkeypatch):
    asked = []

    class Source:
        def __init__(self, *, effort):
            assert effort.timeout == 30.0

        def label(self, design):
            asked.append(design)
            k = len(asked)
            folds = design["h_ratio"] >= 1
            return Label(design, None if k % 4 == 0 else folds != (k % 4 == 1), "")

    drawn = {}

    def plot(regime, *, points, title):
        drawn.update(regime=regime, points=points)
        return SimpleNamespace(savefig=lambda path, dpi: path.write_bytes(b"png"))

    monkeypatch.setattr(gravity_models, "SolverSource", Source)
    monkeypatch.setattr(gravity_models, "plot_regimes", plot)
    said = gravity_models._map(Rule(), replace(TINY, verified=8, points=600), tracker)
    # Of each four one is wrong and one unknown.
    assert (said["verified"], said["verified_agree"]) == (6, pytest.approx(4 / 6))
    assert said["map_points"] == drawn["regime"].points >= 500
    assert len(drawn["points"]) == 8 and drawn["points"]["foldable"].isna().sum() == 2
    slices = FULL[SLICED].from_unit(np.array([1, 3, 5, 7, 9, 11]) / 12)
    for design in asked:
        assert {name: design[name] for name in HELD} == HELD and list(design) == FULL.names
        assert np.isclose(design[SLICED], slices).any()
    assert len({design[name] for design in asked for name in AXES}) == 16


def test_shipped_models_are_named_after_what_they_see(monkeypatch):
    saved = {}

    def train_on(table, name, *, seed, **options):
        return (name, seed, options), {"accuracy": 0.9}

    monkeypatch.setattr(gravity_models, "train_on", train_on)
    monkeypatch.setattr(
        gravity_models, "save_model",
        lambda model, path, card, overwrite: saved.update({path.name: (model, card, overwrite)}),
    )  # fmt: skip
    gravity_models._ship(made(), Config(seed=6))
    assert {name: model for name, (model, *_) in saved.items()} == {
        "gravity": ("network", 6, {"coverage": 0.99, "options": {"inputs": "physics"}}),
        "gravity-angle": ("angle", 6, {"options": {"inputs": "rod"}}),
    }
    for _, card, overwrite in saved.values():
        assert overwrite and card["accuracy"] == 0.9 and card["growth"] == "uniaxial"
        assert card["dataset"] == "gravity" and "under weight" in card["limits"]


def test_the_best_of_those_without_a_rod_is_mapped_and_what_saw_no_label_is_told_beside(
    tracker, monkeypatch
):
    table = made(90)
    table["foldable"] = pd.array(table["foldable"], dtype="boolean")
    table.loc[::9, "foldable"] = None
    accuracies = {
        ("tree", "groups"): 0.8, ("tree", "physics"): 0.85, ("tree", "rod"): 0.99,
        ("boosted", "groups"): 0.9, ("boosted", "physics"): 0.7, ("boosted", "rod"): 0.98,
    }  # fmt: skip
    mapped = []

    def validated(known, name, inputs, config):
        row = {"model": name, "inputs": inputs, "accuracy": accuracies[name, inputs]}
        return row, np.full(len(known), 0.5), (name, inputs)

    monkeypatch.setattr(gravity_models, "load_dataset", lambda name, *, space: table)
    monkeypatch.setattr(gravity_models, "_validated", validated)
    monkeypatch.setattr(gravity_models, "_angles", lambda known, config: len(known))
    monkeypatch.setattr(gravity_models, "_isotropic", lambda table, config: len(table))
    monkeypatch.setattr(gravity_models, "_map", lambda *given: mapped.append(given[0]) or {})
    monkeypatch.setattr(gravity_models, "fit", lambda name, space, known, **o: (name, len(known)))
    curves = pd.DataFrame({"strategy": "groups", "labels": [50] * 3, "accuracy": [0.1, 0.6, 0.7],
                           "seed": [0, 1, 2]})  # fmt: skip
    monkeypatch.setattr(gravity_models, "_curves", lambda known, config: curves)
    known = table[table["foldable"].notna()]
    y = known["foldable"].to_numpy(bool)
    rod = pd.DataFrame({"rod": np.where(np.arange(len(y)) < 20, ~y, y) + 0.5})
    monkeypatch.setattr(gravity_models, "rod_of", lambda known: rod.head(len(known)))
    monkeypatch.setattr(
        gravity_models.beam,
        "formulas",
        lambda known: pd.DataFrame({"net": np.full(len(known), 1.5)}),
    )
    config = Config(models=("tree", "boosted"), rate=0.1, coverage=0.9)
    result = gravity_models.run(config, tracker)
    assert result["labels"] == 80 and result["unknown"] == 10
    assert result["majority"] == max(y.mean(), 1 - y.mean())
    assert result["beam_accuracy"] == y.mean() and result["rod_accuracy"] == 0.75
    assert result["best_without_rod"] == "boosted groups" and mapped == [("boosted", 80)]
    assert result["learning"] == [{"inputs": "groups", "labels": 50, "accuracy": 0.6}]
    assert (result["angles"], result["isotropic"]) == (80, 90)
    assert [(r["model"], r["inputs"]) for r in result["table"]] == [
        (name, inputs) for name in ("tree", "boosted") for inputs in ("groups", "physics", "rod")
    ]
    assert set(tracker.models) == {f"{name}-{inputs}" for name, inputs in accuracies}
    few = gravity_models.run(replace(config, limit=45), tracker)
    assert few["labels"] == 40
