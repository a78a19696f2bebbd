"""What workers of any executor do: one thread, one unpickling, and an end to what hangs."""

import json
import os
import pickle
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest
from campaign_sources import EXITS, FOLDS, NOT, Counted, Hangs, Slow, Threads, designs

from foldlab.campaign import campaign, worker
from foldlab.campaign.campaign import run_campaign
from foldlab.labels.label import Label
from foldlab.labels.store import LabelStore


def run(kinds, path, source, **options):
    report = run_campaign(designs(kinds), source, path, progress=False, **options)
    with LabelStore(path, mode="read") as store:
        return report, store.frame()


def test_anothers_pool_gets_one_thread_and_one_source(tmp_path):
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        _, frame = run([FOLDS] * 6, tmp_path / "s.db", Threads(), executor=pool)
    assert frame["threads"].max() == 1
    assert sorted(frame["calls"]) == [1, 2, 3, 4, 5, 6]


def test_a_source_is_pickled_once_and_not_where_it_stays(tmp_path):
    counted = Counted()
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        run([FOLDS] * 6, tmp_path / "s.db", counted, executor=pool)
    assert counted.pickled == 1
    run([FOLDS] * 6, tmp_path / "t.db", counted, workers=2)
    assert counted.pickled == 2


def test_what_passes_a_parcel_on_needs_no_source():
    # Dask's scheduler unpacks the tasks that it hands to workers.
    parcel = worker.Parcel(Slow())
    parcel._bytes = b"of a class that is not here"
    passed_on = pickle.loads(pickle.dumps(parcel))
    with pytest.raises(pickle.UnpicklingError):
        worker.ready(passed_on)


@pytest.mark.parametrize(
    "busy, outcome, says",
    [
        (True, "hung", "no answer within 0.7 core-seconds, twice: the computation hangs"),
        (False, "blocked", "no answer within 1.4 s on the wall, twice: the computation waits"),
    ],
)
def test_a_computation_that_hangs_is_ended(busy, outcome, says, tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "GRACE", 0.5)
    # A busy one may take as long on the wall as a loaded machine makes it.
    monkeypatch.setattr(campaign, "STARVED", 1000 if busy else 2)
    hangs = Hangs(busy)
    report, frame = run([FOLDS, NOT, FOLDS, FOLDS], tmp_path / "s.db", hangs, workers=2)
    assert report.complete and report.folds == 3
    assert report.reasons == {outcome: 1}
    assert frame["reason"][1].startswith(says)


@pytest.mark.parametrize("code, wall", [(1, 1000.0), (7, 1e-3)])
def test_a_process_that_ended_by_itself_is_not_said_to_have_waited(code, wall):
    # The watch ends a process with status 1, once the time on the wall is over.
    parcel = worker.Parcel(Slow(), wall=wall)
    label = worker.alone(parcel, {"x": 0.0, "kind": EXITS, "code": code})
    assert label.foldable is None and label.evidence["outcome"] == "worker_died"
    assert f"(exit code {code})" in label.reason


def test_labels_side_by_side_in_one_process_are_watched_together(monkeypatch):
    timers, alarms = [], []
    monkeypatch.setattr(worker.signal, "setitimer", lambda which, s: timers.append(s))
    monkeypatch.setattr(worker.faulthandler, "register", lambda *a, **o: None)
    monkeypatch.setattr(
        worker.faulthandler, "dump_traceback_later", lambda s, **o: alarms.append(s)
    )
    monkeypatch.setattr(worker.faulthandler, "cancel_dump_traceback_later", lambda: None)
    parcel = worker.Parcel(Slow(), limit=3.0, wall=60.0)
    with worker._watched(parcel), worker._watched(parcel):
        pass
    # The time of a process is that of all its labels; no label's end ends the watch of another.
    assert timers == [3.0, 6.0, 3.0, 0.0]
    assert alarms == [60.0, 60.0, 60.0]


FOREIGN = """
import json, sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from campaign_sources import FOLDS, NOT, Hangs, designs
from foldlab.campaign import campaign

campaign.GRACE, campaign.STARVED = 0.5, 2
with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
    report = campaign.run_campaign(
        designs([FOLDS, NOT, FOLDS, FOLDS]), Hangs(), sys.argv[1], progress=False, executor=pool,
        in_flight=1,
    )
print(json.dumps([report.folds, report.complete, report.outcome]))
"""


def test_a_computation_that_hangs_in_anothers_pool_is_ended(tmp_path):
    # In a process of its own: once, on a loaded machine, that of the tests ended with the pool.
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", FOREIGN, str(tmp_path / "s.db")],
        env={**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{root / 'tests' / 'parts'}"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    folds, complete, outcome = json.loads(done.stdout)
    assert (folds, complete) == (1, False)
    assert "the executor broke" in outcome


def test_nothing_is_ended_in_the_process_that_asks():
    parcel = worker.Parcel(Slow(seconds=0.2), limit=0.01)
    assert worker.attempt(parcel, {"x": 1.0, "kind": FOLDS}).foldable is True


def test_a_source_without_an_end_has_no_limit(tmp_path):
    endless = Slow()
    endless.timeout = float("inf")
    report, _ = run([FOLDS, NOT], tmp_path / "s.db", endless, workers=1)
    assert (report.folds, report.not_folds) == (1, 1)


DESIGN = {"x": 1.0, "y": 2.0}


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (None, "the source returned NoneType instead of a Label"),
        (Label({"x": 1.0}, True, "so"), "the source returned the label of another design"),
        (Label(DESIGN, "yes", "so"), "the source returned a bad label: foldable is 'yes'"),
        (Label(DESIGN, True, "so", {"angle": float("nan")}), "the evidence is not usable (angle"),
    ],
)
def test_what_is_no_label_of_the_design_is_an_unknown_one_with_the_reason(made, says):
    label = worker.ask(lambda design: made, DESIGN)
    assert label.foldable is None and label.reason.startswith(says) and label.design == DESIGN


def test_a_source_gets_a_copy_of_its_design_and_may_take_the_program_down_with_it():
    def greedy(design):
        design["x"] = 9.0
        raise ValueError("a\n  long   way")

    label = worker.ask(greedy, DESIGN)
    assert DESIGN == {"x": 1.0, "y": 2.0} == label.design
    assert label.reason == "ValueError: a long way" and label.evidence["seconds"] >= 0
    assert label.evidence["raised_at"].startswith("test_worker.py:")
    assert label.evidence["raised_at"].endswith(" in greedy")
    assert worker.ask(lambda design: sys.exit(3), DESIGN).reason == "SystemExit: 3"
    with pytest.raises(KeyboardInterrupt):
        worker.ask(lambda design: (_ for _ in ()).throw(KeyboardInterrupt), DESIGN)


def test_an_exception_is_one_line_of_limited_length_or_its_name():
    class Mute(Exception):
        def __str__(self):
            raise RuntimeError

    assert worker.sentence(ValueError()) == "ValueError"
    assert worker.sentence(Mute()) == "Mute: its message can't be read"
    told = worker.sentence(ValueError("x" * 900))
    assert told == "ValueError: " + "x" * worker.LONGEST_MESSAGE


def test_workers_that_died_on_a_design_are_counted():
    class KilledWorker(Exception):
        allowed_failures = 3

    label = worker.failed(KilledWorker("gone"), DESIGN)
    assert "on each of the 4 workers that tried it" in label.reason
    assert label.evidence == {"outcome": "worker_died"} and label.foldable is None
    assert worker.killed(KilledWorker()) and not worker.killed(ValueError())
