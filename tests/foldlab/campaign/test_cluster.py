"""Campaigns on a Dask cluster: real schedulers and workers, some of which die."""

import json
import os
import signal
import socket
import sys
import threading
import time
from contextlib import contextmanager

import dask
import pytest
from campaign_sources import FOLDS, KILLED, NOT, Slow, Timed, designs
from distributed import LocalCluster

from foldlab.campaign import cluster
from foldlab.campaign.campaign import run_campaign
from foldlab.campaign.cluster import dask_executor
from foldlab.cli import app as cli
from foldlab.errors import InputError
from foldlab.labels import sources
from foldlab.labels.store import LabelStore


@contextmanager
def workers(count, **settings):
    with (
        dask.config.set(settings),
        LocalCluster(
            n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as local,
    ):
        yield local.scheduler_address


def campaign(kinds, path, source, address=None, **options):
    if address is None:
        return run_campaign(designs(kinds), source, path, progress=False, **options)
    said = []
    with dask_executor(address, said.append) as executor:
        report = run_campaign(
            designs(kinds), source, path, executor=executor, progress=False, **options
        )
    assert said == []
    return report


def table(path):
    with LabelStore(path, mode="read") as store:
        return store.frame().drop(columns=["seconds", "calls"], errors="ignore")


def calls(log):
    return [tuple(map(int, line.split())) for line in log.read_text().splitlines()]


def test_a_worker_killed_mid_campaign_loses_nothing(tmp_path):
    log, path, calm = tmp_path / "log", tmp_path / "s.db", tmp_path / "calm.db"
    kinds = [k % 3 for k in range(60)]
    killed = []

    def kill():
        while not log.exists() or len(calls(log)) < 40:
            time.sleep(0.01)
        killed.append(calls(log)[-1])
        os.kill(killed[0][1], signal.SIGKILL)

    with workers(2) as address:
        killer = threading.Thread(target=kill)
        killer.start()
        report = campaign(kinds, path, Slow(log, seconds=0.1), address)
        killer.join()
    campaign(kinds, calm, Slow())
    assert report.complete and report.computed == 60
    assert report.reasons == {"answered None": 20}
    assert table(path).equals(table(calm))
    interrupted, pid = killed[0]
    again = [worker for x, worker in calls(log) if x == interrupted]
    assert len(again) == 2 and again[0] == pid != again[1]
    # What had its label before is not computed again.
    assert 61 <= len(calls(log)) <= 64


def test_a_design_that_kills_its_workers_is_unknown_and_its_neighbours_are_not(tmp_path):
    kinds = [FOLDS, NOT, FOLDS, KILLED, NOT, FOLDS, NOT, FOLDS]
    # Dask gives up what was on a worker at its first death: the neighbours, too.
    with workers(1, **{"distributed.scheduler.allowed-failures": 0}) as address:
        report = campaign(kinds, tmp_path / "s.db", Slow(), address)
    assert report.complete and (report.folds, report.not_folds, report.unknown) == (4, 3, 1)
    assert report.reasons == {"worker_died": 1}
    reason = table(tmp_path / "s.db")["reason"][3]
    assert reason.startswith("the worker process died on this design, on each of the 1 workers")


def test_a_scheduler_that_goes_away_ends_the_campaign_with_what_there_is(tmp_path):
    log, path = tmp_path / "log", tmp_path / "s.db"
    with workers(1) as address, dask_executor(address, print) as executor:

        def end():
            while not log.exists() or len(calls(log)) < 9:
                time.sleep(0.01)
            executor._client.scheduler_comm.comm.abort()

        ender = threading.Thread(target=end)
        ender.start()
        report = run_campaign(
            designs([FOLDS] * 200), Slow(log, 0.05), path, executor=executor, progress=False
        )
        ender.join()
    assert not report.complete and 0 < report.computed < 200
    assert "the executor broke" in report.outcome and "run again" in report.outcome
    assert len(table(path)) == report.computed


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_no_scheduler_is_an_error_at_once(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT", 1)
    for address in (f"tcp://127.0.0.1:{free_port()}", "nonsense", "foo://x:1"):
        with (
            pytest.raises(InputError, match=f"no Dask scheduler answers at {address}"),
            dask_executor(address, print),
        ):
            pass
    # Something listens there but never says a word.
    with socket.create_server(("127.0.0.1", 0)) as mute:
        address = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        with pytest.raises(InputError, match="no Dask scheduler"), dask_executor(address, print):
            pass


def test_without_distributed_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(InputError, match=r"pip install \"foldlab\[cluster\]\""),
        dask_executor("tcp://127.0.0.1:8786", print),
    ):
        pass


def test_a_cluster_without_workers_is_waited_for(tmp_path):
    with LocalCluster(n_workers=0, threads_per_worker=1, dashboard_address=":0") as local:
        said = []

        def say(text):
            said.append(text)
            local.scale(1)

        with dask_executor(local.scheduler_address, say) as executor:
            report = run_campaign(
                designs([FOLDS]), Slow(), tmp_path / "s.db", executor=executor, progress=False
            )
    assert report.complete
    assert len(said) == 1 and "no workers yet" in said[0]


def test_label_on_a_cluster_from_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sources.SOURCES, "timed", Timed)

    def foldlab(line):
        monkeypatch.setattr(sys, "argv", ["foldlab", *line.split()])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, *capsys.readouterr()

    foldlab("sample -n 40 -o d.parquet")
    with workers(1) as address:
        status, out, err = foldlab(
            f"label d.parquet -o s.db --source timed --set accuracy=0.02 --dask {address} --json"
        )
        assert status == 0, err
        report = json.loads(out)
        assert report["labels"] == report["computed"] == 40
        status, _, err = foldlab(f"label d.parquet -o t.db --dask {address}")
        assert status == 0 and "timoshenko is a formula: computed here" in err
    status, _, err = foldlab(f"label d.parquet -o u.db --dask {address} --workers 2")
    assert (status, err.count("\n")) == (2, 1) and "give one of them" in err
