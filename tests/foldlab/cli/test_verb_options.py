"""What each verb makes of its options: the work behind it is replaced by a witness."""

import json
from contextlib import contextmanager
from dataclasses import asdict
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from foldlab import plots as figures
from foldlab.campaign import campaign
from foldlab.campaign.cluster import IN_FLIGHT
from foldlab.cli import label_verbs, quickstart
from foldlab.design import FULL, REDUCED
from foldlab.labels.store import LabelStore
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning import augment, plots, saving, train, tune
from foldlab.maps import regimes


class Stop(Exception):
    """The work was reached."""


@pytest.fixture
def witness(foldlab, monkeypatch):
    """Runs a line until a function is called; returns what that was given."""

    def call(line, owner, name):
        seen = []

        def reached(*given, **options):
            seen.append((given, options))
            raise Stop

        monkeypatch.setattr(owner, name, reached)
        with pytest.raises(Stop):
            foldlab(line)
        ((given, options),) = seen
        return given, options

    return call


@pytest.mark.parametrize(
    ("more", "retry", "options"),
    [
        ("", False, {"workers": 1}),
        ("--workers 3 --retry-unknown", True, {"workers": 3}),
        ("--dask tcp://a:1", False, {"executor": "tcp://a:1", "in_flight": IN_FLIGHT}),
    ],
)
def test_label_asks_for_as_many_workers_as_it_was_told(
    foldlab, witness, monkeypatch, more, retry, options
):
    @contextmanager
    def executor(address, note):
        yield address

    monkeypatch.setattr(label_verbs, "dask_executor", executor)
    foldlab("sample -n 5 -o d.csv --seed 2")
    line = f"label d.csv -o s.db --json {more}"
    given, seen = witness(line, campaign, "run_campaign")
    pd.testing.assert_frame_equal(given[0], REDUCED.sample(5, seed=2), check_exact=False)
    assert isinstance(given[1], TimoshenkoSource)
    assert seen == {"retry_unknown": retry, "progress": False, **options}


def test_workers_here_and_a_cluster_are_told_apart(foldlab):
    status, _, err = foldlab("label d.csv -o s.db --workers 2 --dask tcp://a:1")
    assert status == 2 and "give one of them" in err
    status, _, err = foldlab("sample -n 5 -o d.csv --optimize best")
    assert status == 2 and "expected random-cd or lloyd" in err


def test_sample_draws_what_the_space_draws(foldlab):
    for line, space, options in (
        ("sample -n 6 -o d.csv", REDUCED, {"seed": 0}),
        ("sample -n 6 -o d.csv --seed 3 --space full", FULL, {"seed": 3}),
        ("sample -n 6 -o d.csv --optimize lloyd", REDUCED, {"seed": 0, "optimization": "lloyd"}),
    ):
        status, out, _ = foldlab(f"{line} --json")
        assert status == 0 and json.loads(out)["designs"] == 6
        want = space.sample(6, **options)
        np.testing.assert_allclose(pd.read_csv("d.csv")[space.names], want, rtol=1e-12)


@pytest.fixture
def model(monkeypatch):
    """What stands in for a saved model."""
    loaded = "the model", {"space": "reduced", "model": "tree"}
    monkeypatch.setattr(saving, "load_model", lambda path: loaded)


def test_a_map_is_asked_for_as_it_was_told(witness, model):
    given, seen = witness("map m -o a.png", regimes, "regime_map")
    assert given == ("the model",)
    np.testing.assert_allclose(seen.pop("slices"), np.logspace(-3, -1, 9))
    assert seen == {
        "space": REDUCED, "axes": ("E_ratio", "h_ratio"), "slice_by": "slenderness", "fixed": {},
        "points": 100_000, "source": None, "beside": None,
    }  # fmt: skip
    line = "map m -o a.png --x slenderness --y E_ratio --slice h_ratio --points 9 --set h_ratio=2"
    _, seen = witness(f"{line} --against timoshenko", regimes, "regime_map")
    assert (seen["axes"], seen["slice_by"]) == (("slenderness", "E_ratio"), "h_ratio")
    assert (seen["points"], seen["fixed"]) == (9, {"h_ratio": 2})
    assert len(seen["slices"]) == 9
    assert isinstance(seen["source"], TimoshenkoSource)


def test_training_gets_its_hold_out_rate_and_settings(foldlab, witness):
    pd.DataFrame({"a": [1.0]}).to_csv("l.csv", index=False)
    (table, name), seen = witness("train l.csv -o m", train, "train_on")
    assert list(table) == ["a"] and name == "network"
    assert seen == {"seed": 0, "holdout": None, "rate": None, "coverage": None, "options": {}}
    line = "train l.csv -o m --model tree --seed 4 --holdout 0.5 --false-positive-rate 0.1"
    (_, name), seen = witness(f"{line} --coverage 0.9 --set depth=3", train, "train_on")
    assert name == "tree"
    options = {"options": {"depth": 3}}
    assert seen == {"seed": 4, "holdout": 0.5, "rate": 0.1, "coverage": 0.9, **options}


def test_strategies_are_compared_on_as_many_seeds_as_were_told(witness):
    (maker, plan), seen = witness("augment -o a", augment, "compare_strategies")
    assert isinstance(maker, TimoshenkoSource) and plan == augment.Plan()
    assert list(seen["seeds"]) == [0, 1, 2] and seen["target"] == 0.99 and seen["progress"]
    line = "augment -o a --seed 5 --seeds 2 --target 0.9 --set cycles=3 --space full --json"
    (maker, plan), seen = witness(line, augment, "compare_strategies")
    assert maker.space == FULL and plan.cycles == 3
    assert list(seen["seeds"]) == [5, 6] and seen["target"] == 0.9 and seen["progress"] is None


def test_a_study_tells_its_front_by_the_seconds_that_it_takes(foldlab, monkeypatch):
    study = pd.DataFrame(
        {"seconds": [3.0, 1.0, 2.0], "accuracy": [0.9, 0.8, 0.7], "on_front": [True, True, False]}
    )
    searches = []

    def run(table, space, journal, search):
        searches.append((len(table), space, journal.name, search))
        return study

    foldlab("sample -n 30 -o d.csv")
    foldlab("label d.csv -o s.db")
    foldlab("export s.db -o l.csv")
    monkeypatch.setattr(tune, "tune", run)
    monkeypatch.setattr(plots, "plot_study", lambda study: "figure")
    monkeypatch.setattr(figures, "save_figure", lambda figure, path: path)
    status, out, _ = foldlab("tune l.csv -o t --trials 7 --workers 2 --seed 3 --json")
    told = json.loads(out)
    assert status == 0 and told["trials"] == 3
    assert told["front"] == [{"seconds": 1.0, "accuracy": 0.8}, {"seconds": 3.0, "accuracy": 0.9}]
    ((rows, space, journal, search),) = searches
    assert (rows, space, journal) == (30, REDUCED, "study.journal")
    assert (search.trials, search.workers, search.seed) == (7, 2, 3)


# -- quickstart ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("asked", "sizes"), [(4, (40, 30, 20)), (0, (30, 30, 30))])
def test_the_quickstart_trains_tests_and_compares_on_designs_of_their_own(
    asked, sizes, tmp_path, monkeypatch
):
    logged, said = [], []
    models = {"tree": "a tree", "network": "a network"}
    rows = [
        {"model": "tree", "accuracy": 0.99, "accuracy_fresh": 0.9},
        {"model": "network", "accuracy": 0.98, "accuracy_fresh": 0.95},
    ]
    seen = {}

    @contextmanager
    def track(name, config, *, seed):
        seen.update(tracked=(name, config, seed))
        yield SimpleNamespace(
            metrics=lambda values, prefix="": logged.append((prefix, dict(values))),
            figure=lambda name, figure: logged.append(name),
            model=lambda name, model, example: logged.append((name, model, len(example))) or name,
            table=lambda name, table: logged.append((name, len(table))),
        )

    def compare(names, space, known, test, fresh, *, seed, options):
        seen.update(compared=(names, space, seed, options), sets=(known, test, fresh))
        return SimpleNamespace(rows=rows, models=models)

    def regime_map(model, *, points, source):
        seen["mapped"] = model, points
        return SimpleNamespace(accuracy=0.75)

    def fold(folder):
        label = SimpleNamespace(reason="folds by a lot")
        return SimpleNamespace(label=label, answer={"fold_angle": 3.0})

    def designs(folder, n, *, seed, workers, say):
        seen["designed"] = folder.name, n, seed, workers
        answer = SimpleNamespace(proposals=[1] * 3, rejected=1, reason="only 3 designs")
        return SimpleNamespace(answer=answer)

    def heavy_map(points, verify, *, seed, workers):
        seen["weighed"] = points, verify, seed, workers
        return SimpleNamespace(figure="heavy", checked={"verified": 8, "verified_agree": 7})

    def write(folder, contents):
        seen["page"] = contents
        return folder / "index.html"

    for name, fake in {
        "track": track, "compare": compare, "regime_map": regime_map,
        "plot_regimes": lambda regime, validated: validated,
        "save_figure": lambda figure, path: path, "tracking_uri": lambda: "uri",
        "save_model": lambda model, path, metadata, overwrite: (path.name, model, metadata),
    }.items():  # fmt: skip
        monkeypatch.setattr(quickstart, name, fake)
    for fake in (fold, designs, heavy_map):
        monkeypatch.setattr(quickstart.showcase, fake.__name__, fake)
    monkeypatch.setattr(quickstart.page, "write", write)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://me:secret@host")
    settings = quickstart.Settings(
        *sizes, map_points=50, symbolic_seconds=2.0, unit=bool(asked), proposals=asked, verify=8,
        seed=3, models=("tree", "network"),
    )  # fmt: skip
    out = tmp_path / "deep" / "q"
    result = quickstart.run(settings, out, said.append, workers=5)
    assert seen["tracked"] == ("quickstart", asdict(settings), 3)
    names, space, seed, options = seen["compared"]
    assert (names, space, seed) == (("tree", "network"), REDUCED, 3)
    assert options["symbolic"]["constraints"].seconds == 2.0
    sets = [table[REDUCED.names].to_numpy() for table in seen["sets"]]
    assert tuple(len(rows) for rows in sets) == sizes
    assert len(np.unique(np.vstack(sets), axis=0)) == 90
    # What it does best on designs that it never saw is mapped, kept and asked.
    assert seen["mapped"] == ("a network", 50)
    assert seen["weighed"] == (50, 8, 3, 5)
    assert seen.get("designed") == (("designs", 4, 3, 5) if asked else None)
    assert result["best"] == "network" and result["table"] == rows
    assert result["map_accuracy"] == 0.75 and result["verified_agree"] == 7
    told = [result[name] for name in ("fold_angle", "confirmed", "rejected")]
    assert told == ([3.0, 3, 1] if asked else [None] * 3)
    assert ("designs  only 3 designs" in said) == ("unit     folds by a lot" in said) == bool(asked)
    assert ("network", "a network", 5) in logged and ("tree", "a tree", 5) in logged
    assert ("tree.", rows[0]) in logged and ("comparison", 2) in logged
    assert {"regimes_predicted", "regimes_validated", "map_under_weight"} <= {
        entry for entry in logged if isinstance(entry, str)
    }
    # An address with a password is in no page.
    assert seen["page"].tracking is None and seen["page"].addresses["tree"] == "tree"
    assert set(result["parts"]) < set(seen["page"].seconds)
    assert sum(seen["page"].seconds.values()) == pytest.approx(result["seconds"])
    kept = pd.read_csv(out / "comparison.csv")
    assert kept["model"].tolist() == ["tree", "network"]
    with LabelStore(out / "labels.db", mode="read") as store:
        assert store.export(tmp_path / "l.csv") == sizes[0]
