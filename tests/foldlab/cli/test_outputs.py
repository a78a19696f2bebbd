"""Places that can't be written: told before any work, in one sentence, with nothing left behind."""

import errno
from pathlib import Path

import pytest
from full_disk import no_room_beyond

import foldlab.campaign.campaign
import foldlab.design
import foldlab.labels.solver
import foldlab.labels.store
import foldlab.learning.augment
import foldlab.learning.train
import foldlab.learning.tune
import foldlab.maps.regimes
import foldlab.unit.check
import foldlab.unit.record
from foldlab.cli import simulate as simulate_verb
from foldlab.cli.outputs import only_whole, output_folder, trouble
from foldlab.terminal import NotReached

UNIT = (
    "simulate --effects none --set E_ratio=0.1 --set h_ratio=5 --set hinge_length=0.2 "
    "--set aspect=0.2 --set slenderness=4e-3 --set contraction=0.05"
)
SHEET = (
    "check --passive PET --active SMP --set l_s=40mm --set b_s=10mm --set h_s=0.1mm "
    "--set h_i=0.2mm --set l_i=10mm --set contraction=5%"
)
SMALL = "--set initial=60 --set per_cycle=20 --set cycles=2 --set epochs=20 --set candidates=2000"
SEARCH = "--set epochs=[10,20] --set width=[4,6] --set depth=[1,1] --set members=[1,1]"
QUICK = "--set n_train=300 --set n_test=100 --set n_fresh=500 --set map_points=900"
# Per verb: the line, the name it writes, and the work that must not begin.
VERBS = {
    "sample": ("sample -n 3000", "d.csv", (foldlab.design.DesignSpace, "sample")),
    "label": ("label l.csv", "t.db", (foldlab.campaign.campaign, "run_campaign")),
    "export": ("export s.db", "all.csv", (foldlab.labels.store.LabelStore, "export")),
    "map": ("map m --points 900", "a.png", (foldlab.maps.regimes, "regime_map")),
    "train": ("train l.csv --model tree", "t", (foldlab.learning.train, "train_on")),
    "augment": (f"augment --seeds 1 {SMALL}", "a", (foldlab.learning.augment, "augment")),
    "tune": (f"tune l.csv --trials 1 {SEARCH}", "t", (foldlab.learning.tune, "tune")),
    "quickstart": (
        f'quickstart {QUICK} --set models=["tree"]',
        "q",
        (foldlab.design.DesignSpace, "sample"),
    ),
    "check": (SHEET, "c", (foldlab.unit.check, "by_rod")),
    "simulate": (UNIT, "s", (foldlab.labels.solver.SolverSource, "follow")),
}


@pytest.fixture
def inputs(foldlab, tmp_path):
    """A store, its labels, a model and a file; returns the entry point."""
    for line in (
        "sample -n 200 -o d.csv",
        "label d.csv -o s.db",
        "export s.db -o l.csv",
        "train l.csv --model tree -o m",
    ):
        assert foldlab(line)[0] == 0
    (tmp_path / "d.csv").unlink()
    (tmp_path / "taken").write_text("a file")
    return foldlab


def refused(result, tmp_path, before):
    status, out, err = result
    errors = [line for line in err.splitlines() if line.startswith("error: ")]
    assert status == 2 and len(errors) == 1 and "Traceback" not in err, err
    assert "Error" not in errors[0] and out == ""
    assert sorted(tmp_path.rglob("*")) == before
    return errors[0]


@pytest.mark.parametrize("verb", VERBS)
def test_outputs_are_looked_at_before_any_work(inputs, tmp_path, monkeypatch, verb):
    line, name, (owner, work) = VERBS[verb]
    before = sorted(tmp_path.rglob("*"))

    def begun(*_, **__):
        raise AssertionError("work began")

    monkeypatch.setattr(owner, work, begun)
    # In a folder that can't be: below a file.
    said = refused(inputs(f"{line} -o taken/{name}"), tmp_path, before)
    assert "taken is a file" in said
    if Path("/proc/self").exists():  # a folder in which nobody, not even root, makes files
        said = refused(inputs(f"{line} -o /proc/{name}"), tmp_path, before)
        assert f"/proc/{name}" in said
    if "." in name:  # what is written is a file
        (tmp_path / name).mkdir()
        said = refused(inputs(f"{line} -o {name}"), tmp_path, sorted([*before, tmp_path / name]))
        assert "is a folder" in said
        (tmp_path / name).rmdir()
    else:
        said = refused(inputs(f"{line} -o taken"), tmp_path, before)
        assert "taken" in said and ("file" in said or "exists" in said)
    with no_room_beyond(1000):
        result = inputs(f"{line} -o {name}")
    assert "can't write" in refused(result, tmp_path, before)


@pytest.mark.parametrize("verb", sorted(set(VERBS) - {"simulate", "check", "tune"}))
def test_a_disk_that_fills_up_on_the_way_is_one_sentence(inputs, tmp_path, verb):
    line, name, _ = VERBS[verb]
    line = line.replace("--model tree", "--model forest")
    before = sorted(tmp_path.rglob("*"))
    with no_room_beyond(5000):
        result = inputs(f"{line} -o {name}")
    # A store keeps what it has.
    advice = "running again completes the rest" if verb == "label" else "give another place"
    assert advice in refused(result, tmp_path, before)


def test_a_network_that_finds_no_room_does_not_end_the_process(inputs, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    with no_room_beyond(5000):
        result = inputs("train l.csv -o below/n --set members=1")
    refused(result, tmp_path, before)


def test_a_path_that_finds_no_room_is_taken_away(inputs, tmp_path, monkeypatch):
    def full(out, run):
        (out / "series").mkdir()
        (out / "series" / "unit.pvd").write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(simulate_verb, "write_path", full)
    before = sorted(tmp_path.rglob("*"))
    said = refused(inputs(f"{UNIT} --accuracy 0.5 --json"), tmp_path, before)
    assert "No space left on device" in said


def test_trials_that_ended_stay_where_the_rest_of_a_study_fails(inputs, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("foldlab.cli.learn.write_table", full)
    status, *_ = inputs(f"tune l.csv --trials 1 {SEARCH} -o t")
    assert status == 2
    assert [path.name for path in (tmp_path / "t").iterdir()] == ["study.journal"]


def test_what_was_there_before_a_failure_stays(tmp_path):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "mine.txt").write_text("mine")
    with pytest.raises(ZeroDivisionError), output_folder(tmp_path / "old") as out:
        (out / "new.txt").write_text("half")
        raise ZeroDivisionError
    assert [path.name for path in (tmp_path / "old").iterdir()] == ["mine.txt"]
    for ending, stays in ((NotReached, True), (KeyboardInterrupt, True), (OSError, False)):
        with pytest.raises(ending), only_whole(tmp_path / "a" / "b"):
            (tmp_path / "a" / "b").mkdir(parents=True)
            (tmp_path / "a" / "b" / "c").write_text("half")
            raise ending
        assert (tmp_path / "a").exists() == stays
        if stays:
            (tmp_path / "a" / "b" / "c").unlink()
            (tmp_path / "a" / "b").rmdir()
            (tmp_path / "a").rmdir()


def test_only_a_disk_or_a_memory_that_failed_is_told_so():
    def chained(error, cause):
        error.__cause__ = cause
        return error

    full = OSError(errno.ENOSPC, "No space left on device", "x.db")
    assert "No space left on device: x.db" in trouble(chained(RuntimeError("lost"), full))
    assert "not enough memory" in trouble(MemoryError())
    # A fault of ours keeps its traceback, whatever was looked for before it.
    assert trouble(chained(KeyError("a"), FileNotFoundError(errno.ENOENT, "none"))) is None
    assert trouble(ZeroDivisionError()) is None
