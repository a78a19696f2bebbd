"""Jobs of the explorer run beside it: one at a time, to be cancelled, and never for ever."""

import time

import explore_toys
import numpy as np
import pytest

from foldlab.errors import InputError
from foldlab.explore import jobs as beside
from foldlab.explore import work
from foldlab.explore.live import FIRST


@pytest.fixture
def jobs(monkeypatch):
    monkeypatch.setattr(beside, "checked", lambda kind, request: 1.0)
    made = beside.Jobs(explore_toys.serve)
    yield made
    made.close()
    assert made._process is None


def start(jobs, toy):
    return jobs.start({"kind": "solve", "asked": {"toy": toy}})["job"]


def ended(jobs, number, within=20.0):
    end = time.monotonic() + within
    while (state := jobs.state({"job": number}))["running"]:
        assert time.monotonic() < end, state
        time.sleep(0.02)
    return state


def test_a_job_is_answered_and_the_process_stays_for_the_next(jobs):
    first = ended(jobs, start(jobs, "a"))
    assert first["answer"]["toy"] == "a" and first["error"] is None
    assert first["said"] == "at a" and first["seconds"] > 0
    second = ended(jobs, start(jobs, "b"))
    assert second["answer"]["process"] == first["answer"]["process"]
    with pytest.raises(InputError, match="that job is not there any more"):
        jobs.state({"job": first["job"]})


def test_what_is_refused_is_one_sentence(jobs):
    state = ended(jobs, start(jobs, "refuse"))
    assert state["error"] == "the design is no folding unit" and state["answer"] is None


def test_there_is_one_at_a_time_which_can_be_cancelled(jobs):
    number = start(jobs, "wait")
    with pytest.raises(InputError, match="the solver is at work; wait for it, or cancel"):
        start(jobs, "a")
    process = jobs._process
    state = jobs.cancel({"job": number})
    assert not state["running"] and state["error"] == "cancelled"
    with pytest.raises(ValueError):
        process.is_alive()  # closed, which a living process can't be
    assert ended(jobs, start(jobs, "a"))["answer"]["toy"] == "a"
    assert jobs.cancel({"job": number + 1})["answer"] is not None


def test_a_job_that_takes_too_long_is_stopped(jobs, monkeypatch):
    monkeypatch.setattr(beside, "COMPILING", -3.0)  # 4 core-seconds and no second more
    state = ended(jobs, start(jobs, "wait"))
    assert state["error"] == "the solver was stopped: no answer within 1 s"
    assert 1 <= state["seconds"] < 5


def test_a_process_that_ends_is_said_and_replaced(jobs):
    assert ended(jobs, start(jobs, "die"))["error"] == "the solver was stopped: its process ended"
    assert ended(jobs, start(jobs, "a"))["answer"]["toy"] == "a"


@pytest.mark.parametrize(
    "request_, says",
    [
        ({"kind": "shell", "asked": {}}, "kind = 'shell'; expected one of solve"),
        ({"kind": "solve", "asked": {}, "out": "/tmp"}, "a job: no 'out'"),
        ([], "a job: expected names with values"),
    ],
)
def test_other_jobs_are_refused_before_a_process_is_there(jobs, request_, says):
    with pytest.raises(InputError, match=says):
        jobs.start(request_)
    assert jobs._process is None


@pytest.mark.parametrize(
    "change, says",
    [
        ({"seconds": 1e9}, "seconds = 1e.09; expected 5 to 600"),
        ({"seconds": "60"}, "seconds = '60'; expected a number"),
        ({"accuracy": 0}, "accuracy = 0; expected 0.002 to 0.2"),
        ({"contact": "yes"}, "contact = 'yes'; expected true or false"),
        ({"design": {}}, "by its groups or by its quantities"),
        ({"effects": "none"}, "a job: no 'effects'"),
    ],
)
def test_what_the_solver_is_asked_is_checked_before_it_starts(change, says):
    with pytest.raises(InputError, match=says):
        work.checked("solve", {"design": FIRST, **change})
    assert work.checked("solve", {"design": FIRST}) == 60


def test_frames_are_the_first_the_last_and_evenly_between():
    from foldlab.explore.frames import chosen

    assert chosen([0.0, 0.1, 0.5], 5) == [0, 1, 2]
    kept = chosen(np.linspace(0, 3, 301).tolist(), 4)
    assert kept == pytest.approx([0, 100, 200, 300], abs=1)
    # Dense at the beginning, as load steps are.
    turning = np.linspace(0, 1, 200) ** 3
    gaps = np.diff(turning[chosen(turning.tolist(), 10)])
    assert gaps.max() < 0.13 and chosen([0.0] * 50, 3)[-1] == 49
