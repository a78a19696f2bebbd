"""Campaigns: whatever a source, a worker or the whole process does, no completed label is lost."""

import itertools
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from campaign_sources import (
    EXITS,
    FOLDS,
    KILLED,
    NAN,
    NONE,
    NOT,
    OTHER,
    RAISES,
    SYS_EXIT,
    UNKNOWN,
    UNPICKLABLE,
    Slow,
    Threads,
    designs,
)

from foldlab.campaign import progress
from foldlab.campaign.campaign import run_campaign
from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.labels.label import Label
from foldlab.labels.store import LabelStore
from foldlab.labels.timoshenko import TimoshenkoSource

SCRIPT = Path(__file__).parents[2] / "parts" / "campaign_sources.py"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "s.db"


def table(path):
    with LabelStore(path, mode="read") as store:
        frame = store.frame()
    return frame.drop(columns=["seconds", "calls"], errors="ignore")


def run(kinds, path, source=None, **options):
    return run_campaign(designs(kinds), source or Slow(), path, progress=False, **options)


class Inline(Executor):
    """Computes at once; breaks or is interrupted after some submissions."""

    def __init__(self, good=10**9, error=None):
        self.good, self.error, self.asked = good, error, 0

    def submit(self, fn, /, *args, **kwargs):
        self.asked += 1
        if self.asked > self.good:
            raise self.error
        future = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def test_formula_is_resumed_and_counted(path):
    table_ = REDUCED.sample(6000, seed=1)
    source = TimoshenkoSource()
    first = run_campaign(table_[:100], source, path, progress=False)
    again = run_campaign(pd.concat([table_, table_[:50]]), source, path, progress=False)
    assert (first.requested, first.computed, first.complete) == (100, 100, True)
    assert (again.requested, again.duplicates, again.already_there) == (6000, 50, 100)
    assert again.computed == 5900
    assert again.folds + again.not_folds == 6000
    with LabelStore(path, mode="read") as store:
        frame = store.frame()
    assert (frame[REDUCED.names].to_numpy() == table_.to_numpy()).all()
    expected = source.evaluate(table_)["foldable"].to_numpy()
    assert (frame["foldable"].to_numpy(bool) == expected).all()


class Formula:
    name, version = "formula", "1"

    def label_many(self, table):
        if (table["kind"] == RAISES).any():
            raise ArithmeticError("no root")
        return [Label(d, True, "yes") for d in table.to_dict("records") if d["kind"] != NONE]


def test_formula_failure_stays_with_its_design(path):
    report = run([FOLDS, RAISES, FOLDS, NONE], path, Formula())
    assert (report.folds, report.unknown) == (2, 2)
    assert "ArithmeticError: no root" in report.reasons


@pytest.mark.parametrize(
    "bad",
    [
        pd.DataFrame(),
        pd.DataFrame({"E_ratio": [1.0]}),
        REDUCED.sample(3, seed=1).assign(E_ratio=[1.0, float("nan"), 1.0]),
        REDUCED.sample(3, seed=1).assign(E_ratio=1e9),
    ],
)
def test_bad_designs_write_nothing(path, bad):
    with pytest.raises(InputError):
        run_campaign(bad, TimoshenkoSource(), path, progress=False)
    with LabelStore(path) as store, pytest.raises(InputError):
        run_campaign(bad, TimoshenkoSource(), store, progress=False)
    assert list(path.parent.iterdir()) == []


def test_bad_arguments(path):
    for bad in (pd.DataFrame(), pd.DataFrame({"x": ["wide"]}), pd.DataFrame({"x": [None]})):
        with pytest.raises(InputError):
            run_campaign(bad, Slow(), path, progress=False)
    with pytest.raises(InputError, match="workers = 0"):
        run([FOLDS], path, workers=0)
    nameless = Slow()
    nameless.version = None
    with pytest.raises(InputError, match="no version"):
        run([FOLDS], path, nameless)
    assert list(path.parent.iterdir()) == []


def test_workers_that_cannot_take_the_source_write_nothing(path):
    held = Slow()
    held.lock = lambda: None
    with pytest.raises(InputError, match=r"can't be sent to worker processes .*lambda"):
        run([FOLDS], path, held)
    with pytest.raises(InputError, match="can't start"):
        run([FOLDS], path, executor=Inline(0, BrokenExecutor("no node")))
    assert not path.exists()


def test_everything_that_can_go_wrong_in_a_pool(path, tmp_path):
    log = tmp_path / "log"
    kinds = [FOLDS, RAISES, EXITS, NONE, NOT, UNPICKLABLE, KILLED, NAN, SYS_EXIT, UNKNOWN, OTHER]
    kinds += [FOLDS] * 5
    report = run(kinds, path, Slow(log), workers=2, in_flight=2)
    assert report.complete
    assert (report.requested, report.computed) == (16, 16)
    assert (report.folds, report.not_folds, report.unknown) == (6, 1, 9)
    reasons = table(path)["reason"]
    assert reasons[RAISES - 2] == "ValueError: no state at 1 %"
    assert "exit code 7" in reasons[2]
    assert "NoneType instead of a Label" in reasons[3]
    assert reasons[5] == "Unpicklable: held a lambda"
    assert "SIGKILL" in reasons[6]
    assert "angle is nan" in reasons[7]
    assert reasons[8] == "SystemExit: enough"
    assert "another design" in reasons[10]
    assert report.reasons["ValueError: no state at # %"] == 1
    assert "9 unknown" in report.outcome

    called = log.read_text()
    again = run(kinds, path, Slow(log))
    assert (again.computed, again.already_there, again.unknown) == (0, 16, 9)
    assert log.read_text() == called
    assert again.reasons == report.reasons


def test_a_worker_keeps_its_source_and_one_thread(path):
    run([FOLDS] * 6, path, Threads())
    with LabelStore(path, mode="read") as store:
        frame = store.frame()
    assert frame["calls"].max() == 6
    assert frame["threads"].max() == 1


def test_retry_replaces_unknowns_only(path):
    class Better(Slow):
        def label(self, design):
            return Label(design, True, "now it is known")

    run([FOLDS, RAISES, NOT], path, executor=Inline())
    report = run([FOLDS, RAISES, NOT], path, Better(), executor=Inline(), retry_unknown=True)
    assert (report.computed, report.already_there) == (1, 2)
    # What was unknown before counts as what it is now.
    assert (report.folds, report.not_folds, report.unknown, report.reasons) == (2, 1, 0, {})
    assert table(path)["foldable"].tolist() == [True, True, False]


def test_threads_and_duplicates(path, tmp_path):
    log = tmp_path / "log"
    twice = pd.concat([designs([FOLDS, RAISES, NOT] * 5)] * 2)
    with ThreadPoolExecutor(3) as threads:
        report = run_campaign(twice, Slow(log), path, executor=threads, progress=False)
    assert (report.requested, report.duplicates, report.computed) == (15, 15, 15)
    assert report.reasons == {"ValueError: no state at # %": 5}
    assert len(log.read_text().splitlines()) == 15
    assert table(path)["x"].tolist() == list(range(15))


@pytest.mark.parametrize("error", [BrokenExecutor("the node is gone"), RuntimeError("shutdown")])
def test_a_foreign_executor_that_breaks_keeps_what_completed(path, error):
    report = run([FOLDS] * 9, path, executor=Inline(5, error), in_flight=2)
    assert (report.complete, report.computed) == (False, 4)
    assert str(error) in report.outcome
    assert "4 of 9" in report.outcome
    assert run([FOLDS] * 9, path, executor=Inline()).complete


def test_lost_futures_are_no_labels(path):
    class Losing(Inline):
        def submit(self, fn, /, *args, **kwargs):
            future = super().submit(fn, *args, **kwargs)
            if self.asked < 4:
                return future
            lost = Future()
            if self.asked == 4:
                lost.cancel()
                lost.set_running_or_notify_cancel()
            else:
                lost.set_exception(OSError("killed thrice"))
            return lost

    report = run([FOLDS] * 6, path, executor=Losing(), in_flight=6)
    assert (report.folds, report.unknown, report.complete) == (2, 3, False)
    assert report.reasons == {"OSError: killed thrice": 3}


def test_a_broken_executor_that_never_answers_is_left(path, monkeypatch):
    class Mute(Inline):
        _broken = False

        def submit(self, fn, /, *args, **kwargs):
            future = super().submit(fn, *args, **kwargs)
            self._broken = self.asked > 3
            return Future() if self._broken else future

    monkeypatch.setattr("foldlab.campaign.campaign.PATIENCE", 0.1)
    report = run([FOLDS] * 6, path, executor=Mute(), in_flight=6)
    assert (report.computed, report.complete) == (2, False)
    assert "without an answer" in report.outcome


class Breaks(Inline):
    """A worker that starts, and dies before or with the first design."""

    def __init__(self, loses):
        super().__init__(1, BrokenExecutor("killed while idle"))
        self.loses = loses

    def submit(self, fn, /, *args, **kwargs):
        if self.asked == 0 or not self.loses:
            return super().submit(fn, *args, **kwargs)
        future = Future()
        future.set_exception(BrokenExecutor("killed at work"))
        return future


@pytest.mark.parametrize(
    "loses, pools, labelled",
    [
        ([False] * 9, 3, 0),
        ([False, False, True, False, False, True, *[False] * 9], 9, 2),
    ],
)
def test_workers_that_die_without_a_design_end_the_campaign_at_the_third(
    path, monkeypatch, loses, pools, labelled
):
    made = []

    @contextmanager
    def pool(workers):
        made.append(Breaks(loses[len(made)]))
        yield made[-1]

    alone = lambda parcel, design: Label(dict(design), True, "alone")  # noqa: E731
    monkeypatch.setattr("foldlab.campaign.worker.pool", pool)
    monkeypatch.setattr("foldlab.campaign.worker.alone", alone)
    report = run([FOLDS] * 9, path, in_flight=1)
    assert (len(made), report.computed, report.complete) == (pools, labelled, False)
    assert "die before they get a design (BrokenExecutor: killed while idle)" in report.outcome


def test_interrupt_keeps_what_completed(path):
    with pytest.raises(KeyboardInterrupt):
        run([FOLDS] * 9, path, executor=Inline(5, KeyboardInterrupt()))
    assert len(table(path)) == 4
    assert run([FOLDS] * 9, path).already_there == 4


def test_progress_goes_to_stderr(path, capsys):
    kinds = [FOLDS, RAISES, NOT]
    run_campaign(designs(kinds), Slow(), path, executor=Inline())
    out, err = capsys.readouterr()
    assert out == ""
    for part in ("3/3", "1 fold", "1 unknown", "ValueError: no state at # %"):
        assert part in err


def test_unknowns_count_by_the_outcome_of_their_evidence(path):
    class Named(Slow):
        def label(self, design):
            x = design["x"]
            outcome = {0.0: "case_2", 1.0: "timeout", 2.0: "", 3.0: 7}.get(x, "timeout")
            return Label(design, None, f"stopped after {x} s", {"outcome": outcome})

    first = run([UNKNOWN] * 6, path, Named(), executor=Inline())
    assert first.reasons == {"timeout": 3, "stopped after # s": 2, "case_2": 1}
    assert run([UNKNOWN] * 6, path, Named(), executor=Inline()).reasons == first.reasons
    assert first.as_dict()["labels"] == first.as_dict()["unknown"] == 6


def test_a_log_file_gets_lines(path, capsys, monkeypatch):
    monkeypatch.setattr(progress, "LOG_EVERY", 0)
    kinds = [FOLDS, RAISES, NOT]
    run_campaign(designs(kinds), Slow(), path, executor=Inline(), in_flight=1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("1/3, ") and "1 fold, 0 unknown, " in lines[0]
    assert lines[0].endswith(" s remaining")
    assert lines[1].endswith("; 1 × ValueError: no state at # %")


def test_the_time_that_remains_falls_to_nothing(path, capsys, monkeypatch):
    ticks = itertools.count(0, 10)  # a label in 10 s
    monkeypatch.setattr(progress, "time", SimpleNamespace(perf_counter=lambda: next(ticks)))
    monkeypatch.setattr(progress, "LOG_EVERY", 0)
    run_campaign(designs([FOLDS] * 4), Slow(), path, executor=Inline(), in_flight=1)
    lines = capsys.readouterr().err.splitlines()
    told = [line.partition(" s remaining")[0].rpartition(" ")[2] for line in lines[:4]]
    assert told == ["30", "20", "10", "0"] and "0.1/s" in lines[0]


def start(path, how, count=600, seconds=0.01):
    command = [sys.executable, str(SCRIPT), str(path), str(count), str(seconds), how]
    # Where these tests run in a shell's background SIGINT is ignored, and children inherit that.
    heard = signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    signal.signal(signal.SIGINT, heard)
    assert process.stdout.readline() == "begun\n"
    return process


def end(process, signal_, *, wait=30):
    process.send_signal(signal_)
    process.wait(wait)
    process.stdout.close()


def workers_of(path):
    return {int(line.split()[1]) for line in Path(f"{path}.log").read_text().splitlines()}


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except FileNotFoundError:
        return False


def wait_until(condition, seconds=20):
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.02)


def test_sigkill_ten_times_and_resume(tmp_path):
    undisturbed, path = tmp_path / "calm.db", tmp_path / "s.db"
    kinds = [k % 3 for k in range(600)]
    with ThreadPoolExecutor(2) as threads:
        run(kinds, undisturbed, executor=threads)
    dice = random.Random(4)
    reached = []
    for k in range(10):
        how, longest = ("threads", 0.5) if k % 2 else ("pool", 2.5)
        process = start(path, how)
        time.sleep(dice.uniform(0, longest))
        end(process, signal.SIGKILL)
        if path.exists():
            with LabelStore(path, mode="read") as store:
                reached.append(len(store.frame()))
    assert reached == sorted(reached)
    assert len({*reached} - {0, 600}) > 1, "the kills did not meet the campaign at work"
    if Path(f"{path}.log").exists():
        wait_until(lambda: not any(alive(pid) for pid in workers_of(path)))
    report = run(kinds, path, workers=2)
    assert report.complete
    assert report.already_there == reached[-1]
    pd.testing.assert_frame_equal(table(path), table(undisturbed))


@pytest.mark.skipif(not Path("/proc").exists(), reason="looks at processes through /proc")
@pytest.mark.parametrize("signal_", [signal.SIGINT, signal.SIGKILL])
def test_no_worker_outlives_its_campaign(path, signal_):
    process = start(path, "pool", count=40, seconds=0.5)
    wait_until(lambda: path.exists() and len(table(path)) > 0)
    end(process, signal_)
    assert process.returncode == -signal_
    wait_until(lambda: not any(alive(pid) for pid in workers_of(path)))
    assert 0 < len(table(path)) < 40


def test_each_design_computed_once_where_nothing_dies(path, tmp_path):
    log = tmp_path / "log"
    run([FOLDS, NOT] * 10, path, Slow(log), workers=2)
    counts = Counter(line.split()[0] for line in log.read_text().splitlines())
    assert set(counts.values()) == {1}
