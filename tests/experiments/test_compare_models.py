"""The table of models, the printed formula and its verdicts, on made-up rows."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from experiments import boundary_augmentation, compare_models, regime_maps, tune_network
from experiments.compare_models import equation_430, score_of_equation_430, summary
from foldlab.design import REDUCED
from foldlab.labels.timoshenko import FULL_TURN


def test_a_model_is_told_by_its_medians_and_the_spread_on_fresh_designs():
    rows = []
    for seed, fresh in enumerate((0.9, 0.99, 0.95)):
        rows.append({
            "seed": seed, "model": "tree", "accuracy": 0.8 + 0.01 * seed, "accuracy_fresh": fresh,
            "false_positive_rate": 0.1 * seed, "train_seconds": 1.0 + seed**2,
            "seconds_per_million": 2.0 + seed, "labels": 6000, "size": 10 * (seed + 1),
            "size_unit": "nodes", "dissertation": 0.77,
        })  # fmt: skip
    rows.append(rows[0] | {"model": "network", "size": 5, "size_unit": "weights"})
    tree, network = summary(pd.DataFrame(rows))
    assert tree == {
        "model": "tree", "accuracy": pytest.approx(0.81), "accuracy_fresh": 0.95,
        "fresh_min": 0.9, "fresh_max": 0.99, "false_positive_rate": pytest.approx(0.1),
        "train_seconds": 2.0, "seconds_per_million": 3.0, "labels": 6000, "size": "20 nodes",
        "dissertation": 0.77,
    }  # fmt: skip
    assert network["size"] == "5 weights" and network["fresh_min"] == network["fresh_max"] == 0.9


def test_equation_430_as_printed():
    design = pd.DataFrame({"E_ratio": [2.0], "h_ratio": [0.5], "slenderness": [0.1]})
    # 1.19/(0.1 · 0.5 (4 · 0.5 + 2.23) + 5.12 · 0.1 + 0.1/(0.5 · 0.50521))
    assert equation_430(design) == pytest.approx([1.19 / (0.2115 + 0.512 + 0.39587498)])


def test_the_printed_formula_is_right_where_it_says_what_the_labels_say():
    designs = REDUCED.sample(200, seed=0)
    says = equation_430(designs) >= FULL_TURN
    assert 0 < says.mean() < 1
    right = score_of_equation_430(designs.assign(foldable=says))
    assert right == {"accuracy": 1.0, "always_yes": says.mean()}
    wrong = score_of_equation_430(designs.assign(foldable=~says))
    assert wrong["accuracy"] == 0.0


def test_formulas_of_a_front_are_scored_at_the_models_threshold():
    class Front:
        threshold = 2.0
        front_ = pd.DataFrame({"size": [1, 3], "formula": [lambda X: X[:, 1], lambda X: X[:, 0]]})

    fresh = REDUCED.sample(40, seed=0)
    second = fresh[REDUCED.names[1]].to_numpy()
    front = compare_models._front(Front(), fresh.assign(foldable=second >= 2.0))
    first = fresh[REDUCED.names[0]].to_numpy()
    assert front["accuracy"].tolist() == [1.0, np.mean((first >= 2.0) == (second >= 2.0))]
    assert all(isinstance(text, str) for text in front["formula"])


def test_medians_leave_the_seed_out():
    rows = [{"seed": s, "recall": r} for s, r in ((0, 0.1), (1, 0.7), (2, 0.9))]
    assert compare_models._medians(rows) == {"recall": 0.7, "per_seed": rows}


def test_a_study_is_told_by_its_front_and_its_best_trial(tracker, monkeypatch):
    study = pd.DataFrame({
        "state": ["complete", "pruned", "complete", "complete"],
        "accuracy": [0.9, 0.5, 0.95, 0.8], "seconds": [2.0, 1.0, 3.0, 9.0],
        "on_front": [True, False, True, False],
    })  # fmt: skip
    seen = {}

    def tune(labels, space, journal, search):
        seen.update(labels=labels, journal=journal, search=search)
        return study.iloc[::-1]

    monkeypatch.setattr(tune_network, "tune", tune)
    config = tune_network.Config(seed=3, n_labels=20)
    result = tune_network.run(config, tracker)
    assert (result["trials"], result["pruned"], result["best_accuracy"]) == (4, 1, 0.95)
    assert [row["seconds"] for row in result["table"]] == [2.0, 3.0]
    assert "on_front" not in result["table"][0]
    # The study has the experiment's seed and its own labels.
    assert seen["search"].seed == 3 and len(seen["labels"]) == 20
    assert str(seen["journal"]) == "out/tune_network.journal"
    pd.testing.assert_frame_equal(seen["labels"][REDUCED.names], REDUCED.sample(20, seed=3))


def test_strategies_are_told_by_median_and_ends_over_seeds(tracker, monkeypatch):
    curves = pd.DataFrame({
        "strategy": ["a"] * 3, "labels": 10, "accuracy": [0.7, 0.9, 0.75], "seed": [4, 5, 6],
    })  # fmt: skip
    seen = {}

    def compare(source, plan, **options):
        seen.update(options)
        return curves, {"ratio": 0.5}

    monkeypatch.setattr(boundary_augmentation, "compare_strategies", compare)
    config = boundary_augmentation.Config(seed=4, seeds=3, target=0.8, test_designs=7)
    result = boundary_augmentation.run(config, tracker)
    assert list(seen["seeds"]) == [4, 5, 6]
    assert (seen["target"], seen["test_designs"]) == (0.8, 7)
    assert result["ratio"] == 0.5
    row = {"strategy": "a", "labels": 10, "median": 0.75, "min": 0.7, "max": 0.9}
    assert result["table"] == [row]


def test_maps_have_a_row_of_what_is_right_on_them_for_each_model(tracker, monkeypatch):
    seen = []
    fit = regime_maps.fit

    def counted(name, space, labels, **options):
        seen.append((name, len(labels), options))
        return fit("tree", space, labels, seed=0)

    drawn = []
    monkeypatch.setattr(regime_maps, "fit", counted)
    monkeypatch.setattr(
        regime_maps, "plot_regimes", lambda regime, validated: drawn.append(validated) or Figure()
    )
    config = regime_maps.Config(
        n_train=2100, points=400, models=("tree", "symbolic"), symbolic_seconds=3.0, seed=5
    )
    tree, symbolic = regime_maps.run(config, tracker)["table"]
    assert [(name, n) for name, n, _ in seen] == [("tree", 2100), ("symbolic", 2000)]
    assert seen[0][2] == {"seed": 5} and seen[1][2]["constraints"].seconds == 3.0
    # Counts of right and wrong answers give the accuracy and the rate of false positives.
    right = tree["true_positive"] + tree["true_negative"]
    assert right + tree["false_positive"] + tree["false_negative"] == tree["points"] >= 400
    assert tree["accuracy"] == pytest.approx(right / tree["points"])
    negative = tree["false_positive"] + tree["true_negative"]
    assert tree["false_positive_rate"] == pytest.approx(tree["false_positive"] / negative)
    assert tracker.told["tree.accuracy"] == tree["accuracy"]
    assert set(tracker.figures) == {
        f"regimes_{name}_{kind}" for name in config.models for kind in ("predicted", "validated")
    }
    assert drawn == [False, True] * 2
    assert symbolic["model"] == "symbolic" and tree["seconds"] > 0
