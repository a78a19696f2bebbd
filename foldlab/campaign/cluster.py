"""A Dask cluster as the executor of a campaign."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from functools import partial

from foldlab.campaign.worker import sentence
from foldlab.errors import InputError
from foldlab.packaged import needed_for

CONNECT = 10  # seconds in which the scheduler must answer
IN_FLIGHT = 1000  # designs that wait at the cluster, enough for some hundred workers


@contextmanager
def dask_executor(address: str, say: Callable[[str], None]) -> Iterator[Executor]:
    """An executor whose workers are those of the Dask scheduler at ``address``.

    A cluster that has no worker yet is waited for, and ``say`` is told so. A design whose worker
    dies goes to another one; after several deaths it is unknown. Raises :class:`InputError` if
    distributed is not installed or no scheduler answers within ``CONNECT`` seconds.
    """
    with needed_for("a Dask cluster"):
        from distributed import Client
    try:
        # Client itself, once made, takes long to give up and does so noisily.
        kind = asyncio.run(asyncio.wait_for(_kind(address), CONNECT))
    except Exception as error:
        reason = f"within {CONNECT} s" if isinstance(error, TimeoutError) else sentence(error)
        raise InputError(_no_scheduler(address, reason)) from None
    if kind != "Scheduler":
        raise InputError(_no_scheduler(address, f"a {kind} does"))
    with Client(address, timeout=CONNECT, set_as_default=False) as client:
        if not client.nthreads():
            say(f"the cluster at {address} has no workers yet: waiting for the first")
            client.wait_for_workers(1)
        try:
            yield _OnCluster(client)
        finally:
            if client.status != "running":
                # The campaign says that the connection broke; Dask adds a traceback as it closes.
                logging.getLogger("distributed").setLevel(logging.CRITICAL)


class _OnCluster(Executor):
    # Dask's own executor leaves its futures unanswered when the scheduler goes.

    def __init__(self, client):
        self._client = client

    @property
    def _broken(self) -> bool:
        return self._client.status != "running"

    def submit(self, fn, /, *args):
        if self._broken:
            raise BrokenExecutor("the connection to the scheduler is lost")
        # Not pure: Dask would hash every argument to look for the answer among those it holds.
        remote = self._client.submit(fn, *args, pure=False)
        local = Future()
        local.add_done_callback(lambda _: remote.cancel() if local.cancelled() else None)
        remote.add_done_callback(partial(_hand_over, local))
        return local


def _hand_over(local: Future, remote) -> None:
    if not local.set_running_or_notify_cancel():
        return
    try:
        if remote.status == "error":
            local.set_exception(remote.exception())
        else:
            local.set_result(remote.result())
    except BaseException as error:
        local.set_exception(BrokenExecutor(sentence(error)))
    finally:
        # Dask computes again what it holds on a worker that dies.
        remote.release()


async def _kind(address: str) -> str:
    from distributed.core import rpc
    from distributed.security import Security

    security = Security().get_connection_args("client")
    async with rpc(address, timeout=CONNECT, connection_args=security) as remote:
        return (await remote.identity())["type"]


def _no_scheduler(address: str, reason: str) -> str:
    return (
        f"no Dask scheduler answers at {address} ({reason}); "
        "give the address that `dask scheduler` prints, as in tcp://10.0.0.1:8786"
    )
