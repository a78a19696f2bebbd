"""Core-seconds are those of the thread that computes, without compiling."""

import threading
import time
from types import SimpleNamespace

import numba
import numpy as np
import pytest
import threadpoolctl
from numba.core import event

from solver.equilibrium import clock


def test_time_within_the_compiler_is_not_counted_however_deep(monkeypatch):
    passed = [0.0]
    monkeypatch.setattr(clock, "time", SimpleNamespace(thread_time=lambda: passed[0]))
    start = clock.core_seconds()
    passed[0] += 1.0
    with event.trigger_event("numba:compiler_lock"):
        passed[0] += 10.0
        with event.trigger_event("numba:compiler_lock"):
            passed[0] += 10.0
        passed[0] += 10.0
    passed[0] += 2.0
    assert clock.core_seconds() - start == pytest.approx(3.0)


def test_the_first_compilation_of_ours_is_told_once(monkeypatch, caplog):
    monkeypatch.setattr(clock.compiling, "_told", False)
    before, worked = clock.compiling.spent, time.thread_time()
    for module in ("elsewhere", "solver.here", "solver.there"):

        def double(x):
            return 2 * x

        double.__module__ = module
        assert numba.njit(double)(2) == 4
        assert len(caplog.records) == (module != "elsewhere")
    assert caplog.messages == ["compiling, first time only"]
    assert 0 < clock.compiling.spent - before <= time.thread_time() - worked


def test_what_other_threads_do_is_not_counted():
    def work():
        while time.thread_time() < 0.3:
            sum(range(1000))

    other = threading.Thread(target=work)
    start, process = clock.core_seconds(), time.process_time()
    other.start()
    other.join()
    assert time.process_time() - process > 0.3 > 10 * (clock.core_seconds() - start)


def threads():
    return [library["num_threads"] for library in threadpoolctl.threadpool_info()]


def test_one_core_until_the_last_has_left():
    np.ones((2, 2)) @ np.ones((2, 2))
    clock.mkl_pardiso()
    with threadpoolctl.threadpool_limits(2):
        before = threads()
        assert max(before) == 2
        with clock.one_core():
            with clock.one_core():
                assert set(threads()) == {1}
            assert set(threads()) == {1}
        assert threads() == before
