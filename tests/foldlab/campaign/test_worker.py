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
from campaign_sources import FOLDS, NOT, Counted, Hangs, Slow, Threads, designs

from foldlab.campaign import campaign, worker
from foldlab.campaign.campaign import run_campaign
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


def test_a_computation_that_hangs_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "GRACE", 1.0)
    report, frame = run([FOLDS, NOT, FOLDS, FOLDS], tmp_path / "s.db", Hangs(), workers=2)
    assert report.complete and report.folds == 3
    assert report.reasons == {"hung": 1}
    assert frame["reason"][1].startswith("no answer within 1.2 s, twice")


FOREIGN = """
import json, sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from campaign_sources import FOLDS, NOT, Hangs, designs
from foldlab.campaign import campaign

campaign.GRACE = 1.0
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
