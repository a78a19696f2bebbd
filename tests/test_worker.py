"""What workers of any executor do: one thread, one unpickling, and an end to what hangs."""

import pickle
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest
from campaign_sources import FOLDS, NOT, Counted, Hangs, Slow, Threads, designs

from foldlab import campaign, worker
from foldlab.campaign import run_campaign
from foldlab.labels import LabelStore


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


@pytest.mark.parametrize("foreign", [False, True])
def test_a_computation_that_hangs_is_ended(tmp_path, monkeypatch, foreign):
    monkeypatch.setattr(campaign, "GRACE", 1.0)
    start = time.perf_counter()
    kinds = [FOLDS, NOT, FOLDS, FOLDS]
    if foreign:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            report, _ = run(kinds, tmp_path / "s.db", Hangs(), executor=pool, in_flight=1)
        assert (report.folds, report.complete) == (1, False)
        assert "the executor broke" in report.outcome
    else:
        report, frame = run(kinds, tmp_path / "s.db", Hangs(), workers=2)
        assert report.complete and report.folds == 3
        assert report.reasons == {"hung": 1}
        assert frame["reason"][1].startswith("no answer within 1.2 s, twice")
    assert time.perf_counter() - start < 20


def test_nothing_is_ended_in_the_process_that_asks():
    parcel = worker.Parcel(Slow(seconds=0.2), limit=0.01)
    assert worker.attempt(parcel, {"x": 1.0, "kind": FOLDS}).foldable is True


def test_a_source_without_an_end_has_no_limit(tmp_path):
    endless = Slow()
    endless.timeout = float("inf")
    report, _ = run([FOLDS, NOT], tmp_path / "s.db", endless, workers=1)
    assert (report.folds, report.not_folds) == (1, 1)
