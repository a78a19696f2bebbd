"""The command line as a user meets it: the chain of verbs, exit statuses, clear errors."""

import json
import re
import sqlite3
from pathlib import Path

import pandas as pd
import pytest
from campaign_sources import Timed

from foldlab import __version__
from foldlab.campaign import campaign
from foldlab.datasets import load_dataset
from foldlab.labels import sources
from foldlab.labels.label import Label


def last_json(result):
    status, out, err = result
    assert status == 0, err
    assert out.count("\n") == 1, "one JSON object on stdout and nothing else"
    return json.loads(out)


@pytest.fixture
def labels(foldlab):
    """``l.parquet`` with 400 labels and the store ``s.db`` that it came from."""
    assert last_json(foldlab("sample -n 400 --seed 1 -o d.parquet --json"))["designs"] == 400
    report = last_json(foldlab("label d.parquet -o s.db --source timoshenko --json"))
    assert report["computed"] == 400
    assert last_json(foldlab("export s.db -o l.parquet --json"))["labels"] == 400
    return "l.parquet"


def test_chain_from_sample_to_score_and_map(foldlab, labels):
    trained = last_json(foldlab(f"train {labels} --model network -o m --set members=1 --json"))
    assert trained["labels"] == 320
    assert trained["holdout_n"] == 80
    scored = last_json(foldlab(f"score m {labels} --json"))
    assert scored["n"] == 400
    assert scored["accuracy"] > 0.93
    drawn = last_json(foldlab("map m -o map.png --against timoshenko --points 900 --json"))
    assert drawn["accuracy"] > 0.9
    with open("map.png", "rb") as file:
        assert file.read(4) == b"\x89PNG"


def test_label_takes_the_settings_of_a_source(foldlab, monkeypatch, tmp_path):
    monkeypatch.setitem(sources.SOURCES, "timed", Timed)
    foldlab("sample -n 60 --seed 4 -o d.parquet")
    line = "label d.parquet -o s.db --source timed --set accuracy=2e-2 --set growth=isotropic"
    report = last_json(foldlab(f"{line} --set timeout=60 --workers 2 --json"))
    assert report["version"] == "0.02-isotropic-60.0"
    assert report["labels"] == report["folds"] + report["not"] + report["unknown"] == 60
    assert report["reasons"] == {"timeout": report["unknown"]} and report["unknown"] > 0
    assert report["labels_per_second"] == pytest.approx(60 / report["seconds"])
    (tmp_path / "c.toml").write_text('accuracy = 0.05\ngrowth = "uniaxial"\n')
    status, out, err = foldlab("label d.parquet -o t.db --source timed --config c.toml")
    assert status == 0 and "version: 0.05-uniaxial-60.0" in out
    assert "unknown because" in out and re.search(rf"timeout +│ +{report['unknown']} ", out)
    assert f"{report['unknown']} unknown: timeout" in err and "60/60" in err
    for bad, message in {
        "": "accuracy",
        "--set accuracy=fine": "accuracy = 'fine': Input should be a valid number",
        "--set accuracy=1 --set growth=3": "growth = 3: Input should be a valid string",
        "--set accuracy=1 --set space=full": "no setting 'space'; it has: accuracy, growth, timeo",
    }.items():
        status, _, err = foldlab(f"label d.parquet -o u.db --source timed {bad}")
        assert (status, err.count("\n")) == (2, 1) and message in err
    assert not (tmp_path / "u.db").exists()


def test_labelling_again_computes_nothing(foldlab, labels):
    report = last_json(foldlab("label d.parquet -o s.db --json"))
    assert (report["computed"], report["already_there"]) == (0, 400)


def test_csv_and_parquet_give_the_same_labels(foldlab, labels):
    foldlab("export s.db -o l.csv")
    a, b = pd.read_parquet("l.parquet"), pd.read_csv("l.csv")
    assert (a["foldable"].astype(bool) == b["foldable"]).all()
    assert (a["E_ratio"] == b["E_ratio"]).all()


def test_a_stated_false_positive_rate_is_kept_in_the_model(foldlab, labels):
    line = f"train {labels} --model forest -o m --holdout 0.5 --false-positive-rate 0.15 --json"
    trained = last_json(foldlab(line))
    assert trained["threshold"] != 0.5
    with open("m/model.json", encoding="utf-8") as card:
        assert json.load(card)["threshold"] == trained["threshold"]
    scored = last_json(foldlab(f"score m {labels} --json"))
    assert scored["false_positive_rate"] < 0.15


def test_design_confirms_its_proposals(foldlab, labels):
    foldlab(f"train {labels} --model network -o m --set members=1")
    answer = last_json(
        foldlab("design --set slenderness=0.01 --want foldable -n 5 --confirm --model m --json")
    )
    assert answer["proposed"] == 5
    assert answer["confirmed_fraction"] == 1.0
    for proposal in answer["proposals"]:
        assert proposal["groups"]["slenderness"] == 0.01
        low, high = proposal["box"]["E_ratio"]
        assert low < proposal["groups"]["E_ratio"] < high


def test_a_campaign_that_stopped_half_way_is_status_3(foldlab, monkeypatch):
    def broken(source, waiting, book, workers, in_flight):
        book.begin()
        book.commit([(key, Label({}, True, "it folds")) for key in list(waiting)[:2]])
        return "the workers died"

    monkeypatch.setitem(sources.SOURCES, "timed", Timed)
    monkeypatch.setattr(campaign, "_pooled", broken)
    foldlab("sample -n 5 -o d.parquet")
    status, out, err = foldlab("label d.parquet -o s.db --source timed --set accuracy=0.1 --json")
    assert (status, json.loads(out)["computed"], json.loads(out)["complete"]) == (3, 2, False)
    assert "not reached: stopped: the workers died; 2 of 5 designs have a label" in err


def test_design_for_an_angle_needs_no_model(foldlab):
    line = "design --space full --source timoshenko --want angle --angle 1.5 -n 3 --confirm --json"
    answer = last_json(foldlab(line))
    assert answer["confirmed_fraction"] == 1.0 and answer["weightless"] is True


def test_what_no_design_can_do_is_status_3_with_the_reason(foldlab, labels):
    foldlab(f"train {labels} --model network -o m --set members=1")
    line = "design --model m --range slenderness=0.09:0.1 --range E_ratio=900:1000"
    status, _, err = foldlab(f"{line} --range h_ratio=9:10 -n 2")
    assert status == 3
    assert err.startswith("not reached: ")


def test_augment_writes_curves(foldlab):
    line = (
        "augment -o a --seeds 1 --target 0.9 --json --set initial=60 --set per_cycle=20 "
        "--set cycles=2 --set epochs=20 --set candidates=2000"
    )
    result = last_json(foldlab(line))
    assert {"labels_boundary", "labels_random", "ratio"} <= set(result)
    assert len(pd.read_csv("a/curves.csv")) == 4


def test_tune_resumes_its_study(foldlab, labels):
    sizes = [
        "--set",
        "epochs=[10,20]",
        "--set",
        "width=[4,6]",
        "--set",
        "depth=[1,1]",
        "--set",
        "members=[1,1]",
    ]
    assert last_json(foldlab("tune l.parquet -o t --trials 2 --json", *sizes))["trials"] == 2
    assert last_json(foldlab("tune l.parquet -o t --trials 3 --json", *sizes))["trials"] == 3


def test_quickstart(foldlab, tmp_path):
    line = (
        "quickstart --json --set n_train=300 --set n_test=100 --set n_fresh=1000 "
        "--set map_points=900 --set symbolic_seconds=1 --set unit=false --set proposals=0 "
        "--set verify=0"
    )
    status, out, err = foldlab(line, "--set", 'models=["tree","network","symbolic"]')
    assert status == 0, err
    result = json.loads(out)
    assert [row["model"] for row in result["table"]] == ["tree", "network", "symbolic"]
    assert "mlflow ui --backend-store-uri sqlite:///" in err
    assert (tmp_path / "out/quickstart/regimes_validated.png").is_file()
    assert result["page"] == "out/quickstart/index.html" and (tmp_path / result["page"]).is_file()
    assert (tmp_path / "mlruns/mlflow.db").is_file()


BAD = {
    "no such space": ("sample --space half -n 3 -o d.parquet", "no design space 'half'"),
    "no designs": ("sample -n 0 -o d.parquet", "at least one design"),
    "no whole number": (
        "sample -n 1e11 -o d.parquet",
        "a valid integer, unable to parse string as an integer; it is '1e11'",
    ),
    "below its least": ("sample -n 3 --seed -1 -o d.csv", "greater than or equal to 0; it is '-1'"),
    "wrong ending": ("sample -n 3 -o d.xlsx", "ending '.xlsx'; expected .parquet or .csv"),
    "missing folder": ("sample -n 3 -o no/d.parquet", "no folder no"),
    "missing table": ("label none.parquet -o s.db", "no file none.parquet"),
    "unknown source": ("label d.parquet -o s.db --source abaqus", "no label source 'abaqus'"),
    "unknown setting": ("label d.parquet -o s.db --set nu=1", "nu"),
    "missing store": ("export none.db -o l.parquet", "no label store none.db"),
    "unknown model": ("train l.parquet --model oracle -o m", "no model 'oracle'"),
    "unknown option": ("train l.parquet --model tree -o m --set dpeth=3", "dpeth"),
    "bad holdout": ("train l.parquet -o m --holdout 1.5", "holdout = 1.5"),
    "missing model": ("score none l.parquet", "none"),
    "bad pair": ("design --set slenderness", "expected name=value"),
    "out of bounds": ("design --set slenderness=3", "slenderness"),
    "bad range": ("design --range slenderness=3", "expected NAME=LOW:HIGH"),
    "unknown wish": ("design --want fold", "--want fold: expected foldable, flat or angle"),
    "angle alone": ("design --angle 1", "go together"),
    "unknown option of the verb": (
        "sample -n 3 -o d.csv --sead 1",
        "sample has: -n, --out,",
    ),
    "no verb": ("simulat", "No such command 'simulat'; there are: check, explore, design"),
    "far too many designs": ("sample -n 100000000000 -o big.csv", "at most 10000000 designs"),
    "far too many points": ("map m -o a.png --points 1000000000", "a map has at most 10000000"),
    "target above 1": ("augment -o a --target 1.5", "target = 1.5; an accuracy"),
    "target of 0": ("augment -o a --target 0", "target = 0; an accuracy"),
    "bad plan": ("augment -o a --set cycles=0", "cycles = 0"),
    "bad search": ("tune l.parquet -o t --set width=[9,4]", "width = 9"),
    "endless search": ("tune l.parquet -o t --set penalty=[1,inf]", "penalty = 1 … inf"),
    "no models": ("quickstart --set models=[]", "models = []; expected some of tree,"),
    "a seed that is another option's": ("quickstart --set seed=3", "no setting 'seed'"),
    "angles of the solver": (
        "design --want angle=90deg --space full --source solver --weightless -n 2",
        "--source solver gives one at a time; propose with --source timoshenko",
    ),
    "no source": ("map m -o a.png --against=", "no label source ''"),
    "bad quickstart": ("quickstart --set n_train=0", "n_train = 0"),
}


@pytest.mark.parametrize("line, message", BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_line_status_2_and_writes_nothing(foldlab, tmp_path, line, message):
    foldlab("sample -n 60 -o d.parquet")
    foldlab("label d.parquet -o given.db")
    foldlab("export given.db -o l.parquet")
    if line.startswith("map"):
        foldlab("train l.parquet --model tree -o m")
    before = sorted(tmp_path.rglob("*"))
    status, out, err = foldlab(line)
    assert status == 2, err
    assert err.startswith("error: ") and message in err
    assert err.count("\n") == 1
    assert out == ""
    assert sorted(tmp_path.rglob("*")) == before


def write(frame, name):
    frame.to_parquet(name, index=False)


DAMAGE = {
    "outside": (lambda d: d.assign(slenderness=0.5), "outside"),
    "nan": (lambda d: d.assign(h_ratio=float("nan")), "nan"),
    "text": (lambda d: d.assign(h_ratio="thick"), "not numeric"),
    "column": (lambda d: d.rename(columns={"h_ratio": "thickness"}), "thickness"),
    "empty": (lambda d: d.iloc[:0], "no rows"),
}


@pytest.mark.parametrize("change, message", DAMAGE.values(), ids=DAMAGE.keys())
def test_bad_designs_never_reach_the_store(foldlab, tmp_path, change, message):
    foldlab("sample -n 20 -o d.parquet")
    write(change(pd.read_parquet("d.parquet")), "bad.parquet")
    status, _, err = foldlab("label bad.parquet -o s.db")
    assert status == 2
    assert message in err
    assert not (tmp_path / "s.db").exists()


def test_a_damaged_store_is_named_and_left_alone(foldlab, tmp_path):
    foldlab("sample -n 20 -o d.parquet")
    damaged = tmp_path / "s.db"
    damaged.write_bytes(b"SQLite format 3\x00" + b"\x17" * 5000)
    for line in ("label d.parquet -o s.db", "export s.db -o l.parquet"):
        before = damaged.read_bytes()
        status, _, err = foldlab(line)
        assert status == 2
        assert "s.db" in err
        assert damaged.read_bytes() == before
    sqlite3.connect("other.db").close()


def test_labels_of_one_kind_do_not_train(foldlab):
    foldlab("sample -n 60 -o d.parquet")
    designs = pd.read_parquet("d.parquet")
    write(designs.assign(foldable=True), "l.parquet")
    status, _, err = foldlab("train l.parquet -o m")
    assert status == 2
    assert "60 of 60 designs fold" in err


def test_the_version_is_told(foldlab):
    assert foldlab("--version") == (0, f"foldlab {__version__}\n", "")


def test_every_verb_has_a_short_help(foldlab):
    status, out, err = foldlab("design -h")
    assert (status, err) == (0, "") and "--max-thickness" in out and "--config" in out


@pytest.mark.parametrize("line", ["", "-h", "--help"])
def test_help_names_every_verb(foldlab, line):
    status, out, err = foldlab(line)
    assert (status, err) == (0, "")
    for verb in [
        "quickstart",
        "sample",
        "label",
        "export",
        "train",
        "score",
        "map",
        "augment",
        "tune",
        "design",
    ]:
        assert f" {verb} " in out


def test_thick_layers_are_warned_about_not_refused(foldlab, tmp_path, monkeypatch):
    design = {
        "E_ratio": 0.1,
        "rho_ratio": 1.0,
        "hinge_length": 0.05,
        "hinge_width": 1.0,
        "h_ratio": 5.0,
        "stiffness_to_weight": 1.0,
        "aspect": 0.2,
        "slenderness": 0.02,
        "contraction": 0.1,
    }
    table = pd.DataFrame([design, {**design, "hinge_length": 0.3}])
    table.to_parquet(tmp_path / "d.parquet")
    quick = "--source solver --set timeout=0.001 -o s.db"
    status, _, err = foldlab(f"label d.parquet {quick}")
    assert status == 0 and "warning: 1 of 2 designs have an active layer thicker" in err


def test_an_angle_and_a_dont_know_go_from_training_to_score(foldlab):
    load_dataset("gravity-5k").query("growth == 'uniaxial'").to_parquet("u.parquet")
    train = "train u.parquet --model {} -o {} --holdout 0.4 --json"
    angle = last_json(foldlab(train.format("angle", "a") + " --set max_iter=20"))
    assert angle["holdout_error_median"] < 0.1
    scored = last_json(foldlab("score a u.parquet --json"))
    assert scored["n"] == angle["labels"] + angle["holdout_n"] and scored["error_median"] < 0.1
    careful = last_json(foldlab(train.format("tree", "t") + " --coverage 0.99"))
    assert careful["borders"]["coverage"] == 0.99 and careful["holdout_decided"] > 0.9
    scored = last_json(foldlab("score t u.parquet --json"))
    assert scored["decided"] > 0.9 and scored["covered"] > 0.98
    status, _, told = foldlab("train u.parquet --model angle -o b --coverage 0.9")
    assert status == 2 and "no probability" in told and not Path("b").exists()
