import json
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
import skops.io
import torch
from sklearn.svm import SVC

from foldlab.design import FULL, REDUCED
from foldlab.errors import InputError
from foldlab.labels import timoshenko
from foldlab.learning import saving
from foldlab.learning.models import make_classifier
from foldlab.learning.network import DissertationNetwork, SmoothNetwork
from foldlab.learning.operating_point import with_threshold
from foldlab.learning.saving import load_model, read_card, save_model, space_of_model
from foldlab.learning.scoring import score
from foldlab.learning.symbolic.formula import Formula

OPTIONS = {
    "tree": {},
    "distilled": {"n_designs": 1000},
    "forest": {"n_estimators": 5},
    "boosted": {"max_iter": 5},
    "network": {"members": 2},
    "dissertation": {"epochs": 3},
}


def labelled(n, seed, space=REDUCED):
    X = space.sample(n, seed=seed)
    return X, np.asarray(timoshenko.folds(**X[REDUCED.names]))


def fitted(name, space=REDUCED):
    return make_classifier(name, space, **OPTIONS[name]).fit(*labelled(300, 0, space))


@pytest.fixture
def saved(tmp_path):
    return save_model(fitted("tree"), tmp_path / "tree")


@pytest.mark.parametrize("name", OPTIONS)
def test_loaded_models_answer_as_saved(name, tmp_path):
    model = fitted(name)
    save_model(model, tmp_path / "m", {"labels": 300, "seconds": np.float64(1.5)})
    loaded, card = load_model(tmp_path / "m")
    X, _ = labelled(5000, 1)
    assert np.array_equal(loaded.predict_proba(X), model.predict_proba(X))
    assert np.array_equal(loaded.predict(X[::-1]), model.predict(X[::-1]))
    assert space_of_model(loaded) == REDUCED
    assert card["columns"] == REDUCED.names and card["classes"] == [False, True]
    assert card["space"] == "reduced" and card["threshold"] is None
    assert card["metadata"] == {"labels": 300, "seconds": 1.5}
    files = {p.name for p in (tmp_path / "m").iterdir()}
    assert not any(f.endswith((".pkl", ".pickle", ".pt", ".joblib")) for f in files)
    assert [p.name for p in tmp_path.iterdir()] == ["m"]  # nothing temporary stays
    assert (tmp_path / "m").stat().st_mode & 0o777 == 0o755  # others may read it


def test_another_process_reads_the_same_answers(tmp_path):
    model = fitted("network")
    save_model(model, tmp_path / "m")
    code = (
        "import sys, pandas as pd; from foldlab.learning.saving import load_model;"
        "m, _ = load_model(sys.argv[1]); X = pd.read_parquet(sys.argv[2]);"
        "print([v.hex() for v in m.predict_proba(X)[:, 1].tolist()])"
    )
    X, _ = labelled(20, 1)
    X.to_parquet(tmp_path / "X.parquet")
    run = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "m", tmp_path / "X.parquet"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.strip() == str([v.hex() for v in model.predict_proba(X)[:, 1].tolist()])


@pytest.mark.parametrize("name", ["network", "dissertation"])
def test_exported_program_runs_alone_for_any_number_of_designs(name, tmp_path):
    model = fitted(name)
    save_model(model, tmp_path / "m")
    program = torch.export.load(tmp_path / "m" / "network.pt2").module()
    for n in (1, 2, 777):
        X, _ = labelled(n, 1)
        logits = program(torch.tensor(X.to_numpy())).detach().numpy()
        assert np.allclose(logits, model.decision_function(X), rtol=1e-5, atol=1e-5)


def test_threshold_bounds_of_the_space_and_metrics_are_kept(tmp_path):
    space = REDUCED.with_bounds(slenderness=(0.002, 0.03))
    model = with_threshold(fitted("network", space), 0.9)
    X, y = labelled(500, 1, space)
    save_model(model, tmp_path / "m", {"metrics": {**score(model, X, y), "lost": np.nan}})
    loaded, card = load_model(tmp_path / "m")
    assert np.array_equal(loaded.predict(X), model.predict(X))
    assert not np.array_equal(loaded.predict(X), fitted("network", space).predict(X))
    assert space_of_model(loaded) == space != REDUCED
    assert card["threshold"] == 0.9
    assert card["metadata"]["metrics"]["n"] == 500
    assert card["metadata"]["metrics"]["lost"] is None


def test_full_space_and_plain_numbers_with_other_classes(tmp_path):
    model = fitted("forest", FULL)
    save_model(model, tmp_path / "full")
    X, y = labelled(300, 0, FULL)
    assert np.array_equal(load_model(tmp_path / "full")[0].predict_proba(X), model.predict_proba(X))
    words = np.where(y, "yes", "no")
    plain = SmoothNetwork(members=1).fit(np.log(X.to_numpy()), words)
    save_model(plain, tmp_path / "plain")
    loaded, card = load_model(tmp_path / "plain")
    assert np.array_equal(loaded.predict(np.log(X.to_numpy())), plain.predict(np.log(X.to_numpy())))
    assert card["space"] is None and card["classes"] == ["no", "yes"]


def test_training_continues_after_loading(tmp_path):
    X, y = labelled(300, 0)
    model = DissertationNetwork(REDUCED, epochs=3).fit(X, y)
    save_model(model, tmp_path / "m")
    loaded, _ = load_model(tmp_path / "m")
    loaded.continue_fit(X, y, 2)
    assert loaded.n_epochs_ == 5 and loaded.loss_curve_[:3] == model.loss_curve_
    assert loaded.loss_curve_[-1] < model.loss_curve_[0]


def test_nothing_is_written_over_by_accident(saved, tmp_path):
    before = (saved / "model.json").read_bytes()
    with pytest.raises(InputError, match="exists; choose another"):
        save_model(fitted("network"), saved)
    assert (saved / "model.json").read_bytes() == before
    save_model(fitted("network"), saved, overwrite=True)
    assert read_card(saved)["kind"] == "network" and not (saved / "model.skops").exists()
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.txt").write_text("mine")
    with pytest.raises(InputError, match="holds no model; it is left alone"):
        save_model(fitted("tree"), tmp_path / "thesis", overwrite=True)
    assert (tmp_path / "thesis" / "chapter.txt").read_text() == "mine"
    assert {p.name for p in tmp_path.iterdir()} == {"tree", "thesis"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_an_interrupted_save_leaves_all_as_it_was(overwrite, tmp_path, monkeypatch):
    if overwrite:
        save_model(fitted("tree"), tmp_path / "m")
    before = sorted(tmp_path.rglob("*"))

    def full_disk(*args, **kwargs):
        raise OSError("no space left")

    monkeypatch.setattr(np, "savez", full_disk)
    with pytest.raises(OSError, match="no space left"):
        save_model(fitted("network"), tmp_path / "m", overwrite=overwrite)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_failed_exchange_puts_the_old_model_back(saved, tmp_path, monkeypatch):
    rename, calls = os.rename, []

    def fails_second(*args):
        calls.append(args)
        if len(calls) == 2:
            raise OSError("gone")
        rename(*args)

    monkeypatch.setattr(os, "rename", fails_second)
    with pytest.raises(OSError, match="gone"):
        save_model(fitted("network"), saved, overwrite=True)
    assert read_card(saved)["kind"] == "sklearn"
    assert [p.name for p in tmp_path.iterdir()] == ["tree"]


def test_what_cannot_be_saved_is_refused_and_leaves_nothing(tmp_path):
    X, y = labelled(50, 0)
    with pytest.raises(InputError, match="not fitted"):
        save_model(SmoothNetwork(REDUCED), tmp_path / "m")
    with pytest.raises(InputError, match="plain JSON"):
        save_model(fitted("tree"), tmp_path / "m", {"figure": object()})
    with pytest.raises(InputError, match="skops cannot write this SVC"):
        save_model(SVC(kernel=lambda a, b: a @ b.T).fit(X, y), tmp_path / "m")
    stranger = SVC().fit(X, y)
    stranger.note = Bomb
    with pytest.raises(InputError, match="types that would not be loaded again"):
        save_model(stranger, tmp_path / "m")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        save_model(fitted("tree"), tmp_path / "file" / "m")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_missing_and_damaged_models_are_refused(saved, tmp_path):
    (tmp_path / "file").write_text("")
    for name in ("nowhere", "file"):
        with pytest.raises(InputError, match=rf"no model in .*{name} \(no model.json\)"):
            load_model(tmp_path / name)
    content = bytearray((saved / "model.skops").read_bytes())
    content[len(content) // 2] ^= 1
    (saved / "model.skops").write_bytes(content)
    with pytest.raises(InputError, match="checksum differs"):
        load_model(saved)
    (saved / "model.skops").unlink()
    with pytest.raises(InputError, match=r"lacks its file model\.skops"):
        load_model(saved)
    (saved / "model.json").write_text('{"format": 1')
    with pytest.raises(InputError, match="cannot read"):
        load_model(saved)
    (saved / "model.json").write_text("[1]")
    with pytest.raises(InputError, match="does not describe a model"):
        load_model(saved)


def edit(directory, **changes):
    card = read_card(directory)
    card.update(changes)
    (directory / "model.json").write_text(json.dumps(card))


def test_a_wrong_card_is_refused(saved):
    files, kind = read_card(saved)["files"], read_card(saved)["kind"]
    edit(saved, kind="oracle")
    with pytest.raises(InputError, match="kind 'oracle'"):
        load_model(saved)
    card = json.loads((saved / "model.json").read_text()) | {"kind": kind, "format": 99}
    (saved / "model.json").write_text(json.dumps(card))
    with pytest.raises(InputError, match="format 99"):
        load_model(saved)
    card["format"] = saving.FORMAT
    (saved / "model.json").write_text(json.dumps(card))
    edit(saved, files={"../tree/model.skops": files["model.skops"]})
    with pytest.raises(InputError, match="lacks its file"):
        load_model(saved)
    edit(saved, files=files, kind="network")
    with pytest.raises(InputError, match="cannot read the model"):
        load_model(saved)
    for wrong, cause in (
        ({"threshold": "nan"}, "threshold = 'nan'; expected a probability"),
        ({"threshold": {"a": 1}}, "expected a probability"),
        ({"threshold": True}, "threshold = True; expected a probability"),
        ({"threshold": 1.5}, "expected a probability"),
        ({"kind": []}, r"kind \[\]"),
        ({"space": []}, "does not describe a model"),
    ):
        right = card | {"files": files, "kind": kind, "space": "reduced", "threshold": None}
        (saved / "model.json").write_text(json.dumps(right | wrong))
        with pytest.raises(InputError, match=cause):
            load_model(saved)


class Bomb:
    def __reduce__(self):
        return (open, ("exploded", "w"))


def test_strangers_types_and_pickles_are_not_loaded(saved, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stranger = SVC().fit(np.eye(2), [0, 1])
    stranger.note = Bomb
    skops.io.dump(stranger, saved / "model.skops")
    edit(saved, files={"model.skops": saving._digest(saved / "model.skops")})
    with pytest.raises(InputError, match=r"types that are not trusted: .*Bomb"):
        load_model(saved)
    network = save_model(fitted("network"), tmp_path / "network")
    with np.load(network / "weights.npz") as archive:
        weights = dict(archive)
    weights["centre"] = np.array([Bomb()], dtype=object)
    np.savez(network / "weights.npz", **weights)
    edit(network, files={"weights.npz": saving._digest(network / "weights.npz")})
    with pytest.raises(InputError, match="cannot read the model"):
        load_model(network)
    (network / "weights.npz").write_bytes(pickle.dumps(Bomb()))
    edit(network, files={"weights.npz": saving._digest(network / "weights.npz")})
    with pytest.raises(InputError, match="cannot read the model"):
        load_model(network)
    assert not (tmp_path / "exploded").exists()


def test_a_formula_comes_back_with_its_front_and_its_choice(tmp_path):
    # Given, not fitted: how many formulas a search of seconds finds hangs on the machine's load.
    short = ("/", 0.8371946205, "slenderness")
    trees = (
        (0.9, short),
        (0.4, ("/", short, ("+", "h_ratio", 1.2))),
        (0.2, ("/", short, "h_ratio")),
    )
    front = [(error, Formula(tree, tuple(REDUCED.names))) for error, tree in trees]
    model = make_classifier("symbolic", REDUCED, seconds=1.0).restore(front, 1, 0.31)
    save_model(model, tmp_path / "m")
    loaded, card = load_model(tmp_path / "m")
    fresh, _ = labelled(2000, 1)
    assert np.array_equal(loaded.predict_proba(fresh), model.predict_proba(fresh))
    assert 0.1 < loaded.predict(fresh).mean() < 0.99
    assert str(loaded.formula_) == str(front[1][1]) == card["state"]["formula"]
    assert len(loaded.front_) == len(model.front_) == 3 and loaded.size_ == model.size_
    assert card["state"]["chosen"] == 1
