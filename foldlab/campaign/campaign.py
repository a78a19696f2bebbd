"""Campaigns: designs × label source × executor → store.

Every design ends as a row, answered or unknown with the reason; each row is committed as it
completes, and running again computes what is missing.
"""

from __future__ import annotations

import asyncio
import math
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from contextlib import ExitStack, nullcontext
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from foldlab.campaign import worker
from foldlab.campaign.progress import progress_bar
from foldlab.errors import InputError
from foldlab.labels.label import Label, LabelSource, design_key, reason_class
from foldlab.labels.store import LabelStore

CHUNK = 5000  # designs per commit of a source that is a formula
FOREIGN_IN_FLIGHT = 128  # submissions that wait at an executor whose size we do not know
PATIENCE = 10  # seconds without a label before we look whether the executor still lives
GRACE = 30  # core-seconds beyond twice a source's own timeout, after which its process is ended
STARVED = 20  # times as long on the wall, after which a process that hardly computes is ended
IDLE_BREAKS = 3  # pools that may break one after another with no design in them


@dataclass(frozen=True)
class CampaignReport:
    """What a campaign met and made. Counts are distinct designs of this request.

    ``requested`` = ``already_there`` + ``computed`` + those still missing; ``folds``, ``not_folds``
    and ``unknown`` count the labels in the store for this request, old and new. ``reasons`` counts
    the unknowns by :func:`foldlab.labels.label.reason_class`. ``rate`` is computed labels per
    second, ``seconds`` the wall time, ``outcome`` one sentence; ``complete``: every design has its
    label.
    """

    source: str
    version: str
    requested: int
    duplicates: int
    already_there: int
    computed: int
    folds: int
    not_folds: int
    unknown: int
    reasons: Mapping[str, int]
    seconds: float
    rate: float
    complete: bool
    outcome: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values: ``labels`` are those in the store for this request, and the sum of
        ``folds``, ``not`` and ``unknown``; ``labels_per_second`` is the rate."""
        values = asdict(self)
        folds, others, unknown = (values.pop(n) for n in ("folds", "not_folds", "unknown"))
        return {
            "labels": folds + others + unknown,
            "folds": folds,
            "not": others,
            "unknown": unknown,
            "labels_per_second": values.pop("rate"),
            **values,
        }


def run_campaign(
    designs: pd.DataFrame,
    source: LabelSource,
    store: LabelStore | str | Path,
    *,
    executor: Executor | None = None,
    workers: int = 1,
    in_flight: int | None = None,
    retry_unknown: bool = False,
    progress: bool = True,
) -> CampaignReport:
    """Label the designs that the store lacks; returns what came of it.

    ``designs``: one column per group, one row per design, dimensionless; duplicates are computed
    once. ``store``: open for writing, or a path, which is opened after the designs are checked.
    A source with ``label_many`` runs here, in chunks. Any other runs on ``executor``, or on
    ``workers`` spawned processes with one BLAS thread each, with at most ``in_flight`` submissions
    (default: two per worker, 128 for an executor). ``retry_unknown`` also recomputes labels that
    ended unknown. ``progress`` draws a bar on stderr.

    A source that raises or returns no label, or whose worker process dies, makes an unknown label
    with that reason; so does one that has a ``timeout`` (core-seconds) and hangs far beyond it, or
    waits for ever, unless it runs in this process. An executor that breaks ends the campaign early;
    the report says so. Ctrl-C is raised again after what completed is committed. Raises
    :class:`InputError`, with nothing written, for bad designs, a source that the workers can't
    take, or workers that can't start.
    """
    started = time.perf_counter()
    if workers < 1 or (in_flight is not None and in_flight < 1):
        raise InputError(f"workers = {workers}, in_flight = {in_flight}; give at least 1")
    table = _designs_by_key(designs, source)
    with nullcontext(store) if isinstance(store, LabelStore) else LabelStore(store) as opened:
        known = opened.known(source.name, source.version)
        there = {key: known[key] for key in table if key in known}
        missing = [k for k in table if k not in there or (retry_unknown and there[k][0] is None)]
        book = _Book(opened, source, table)
        for key in there.keys() - missing:
            book.count(*there[key])
        stopped = ""
        if missing:
            waiting = deque(missing)
            with progress_bar(book, len(missing)) if progress else nullcontext():
                if hasattr(source, "label_many"):
                    _formula(source, waiting, book)
                elif executor is not None:
                    stopped = _foreign(source, waiting, book, executor, in_flight)
                else:
                    stopped = _pooled(source, waiting, book, workers, in_flight)
        return _report(book, len(designs), len(table) - len(missing), stopped, started)


def labelled(
    designs: pd.DataFrame, source: LabelSource, store: LabelStore | None = None, **options
) -> pd.DataFrame:
    """The table of designs with their labels beside them, in its order and with its index.

    Runs a campaign (``options`` are those of :func:`run_campaign`) into ``store``, or into one that
    is thrown away. What was not labelled, as by an executor that broke, is unknown. Raises as
    :func:`run_campaign` does.
    """
    names = source.space.names
    with ExitStack() as stack:
        if store is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            store = stack.enter_context(LabelStore(Path(folder) / "labels.db"))
        run_campaign(designs[names], source, store, **options)
        labels = store.frame(source.name, source.version)
    beside = [c for c in labels if c in names or c not in designs]
    return designs.merge(labels[beside], on=names, how="left").set_index(designs.index)


def _designs_by_key(designs: pd.DataFrame, source) -> dict[str, dict[str, float]]:
    for name in ("name", "version"):
        if not (isinstance(getattr(source, name, None), str) and getattr(source, name)):
            raise InputError(f"the label source {source!r} has no {name}; give it one, as text")
    if not (hasattr(source, "label") or hasattr(source, "label_many")):
        raise InputError(f"the label source {source!r} has neither label nor label_many")
    if hasattr(source, "space"):
        designs = source.space.validate(designs)
    if not len(designs):
        raise InputError("the table of designs is empty; give at least one row")
    records = [{str(k): v for k, v in row.items()} for row in designs.to_dict("records")]
    return {design_key(row): {k: float(v) for k, v in row.items()} for row in records}


class _Book:
    """Commits labels under the campaign's source and counts what came of them."""

    def __init__(self, store: LabelStore, source, table: dict[str, dict[str, float]]):
        self.store, self.designs = store, table
        self.name, self.version = source.name, source.version
        self.verdicts: Counter[bool | None] = Counter()
        self.reasons: Counter[str] = Counter()
        self.computed = 0
        self.on_commit: Callable[[], None] = lambda: None

    def begin(self) -> None:
        self.store.register(self.designs)

    def commit(self, answers: Iterable[tuple[str, Label]]) -> None:
        labels = [
            replace(label, design=self.designs[key], source=self.name, version=self.version)
            for key, label in answers
        ]
        if not labels:
            return
        self.store.add_many(labels)
        self.computed += len(labels)
        for label in labels:
            self.count(label.foldable, reason_class(label.reason, label.evidence.get("outcome")))
        self.on_commit()

    def count(self, foldable: bool | None, reason: str | None) -> None:
        self.verdicts[foldable] += 1
        if foldable is None:
            self.reasons[reason or ""] += 1


def _formula(source, waiting: deque[str], book: _Book) -> None:
    def one(design):
        return source.label_many(pd.DataFrame([design]))[0]

    book.begin()
    while waiting:
        keys = [waiting.popleft() for _ in range(min(CHUNK, len(waiting)))]
        designs = [book.designs[key] for key in keys]
        try:
            labels = list(source.label_many(pd.DataFrame(designs)))
            if len(labels) != len(keys):
                raise ValueError(f"{len(labels)} labels for {len(keys)} designs")
            answers = list(map(worker.checked, labels, designs))
        except Exception:
            # One by one, so that the failure stays with the designs that cause it.
            answers = [worker.ask(one, design) for design in designs]
        book.commit(zip(keys, answers, strict=True))


def _foreign(source, waiting: deque[str], book: _Book, executor: Executor, in_flight) -> str:
    parcel = _parcel(source)
    _probe(executor, 1, parcel)
    book.begin()
    running: dict[Future, str] = {}
    suspects: list[str] = []
    call = partial(executor.submit, worker.attempt, parcel)
    at_once = in_flight or FOREIGN_IN_FLIGHT
    try:
        lost, broken = _drain(executor, call, waiting, running, book, at_once, suspects)
        if suspects and not (lost or broken):
            # A design that kills its worker takes those down that wait beside it: one at a time.
            lost, broken = _drain(executor, call, deque(suspects), running, book, 1)
    finally:
        for future in running:
            future.cancel()
    return f"the executor broke ({worker.sentence(broken)})" if lost or broken else ""


def _pooled(source, waiting: deque[str], book: _Book, workers: int, in_flight) -> str:
    parcel = _parcel(source)
    parcel.pickled()
    begun, idle = False, 0
    while waiting:
        size = min(workers, len(waiting))
        with worker.pool(size) as pool:
            try:
                # One per worker: a pool that starts a process while another dies may hang.
                _probe(pool, size, parcel)
            except InputError as error:
                if begun:
                    return str(error)
                raise
            if not begun:
                book.begin()
                begun = True
            call = partial(pool.submit, worker.attempt, parcel)
            lost, broken = _drain(pool, call, waiting, {}, book, in_flight or 2 * workers)
        for key in lost:
            book.commit([(key, worker.alone(parcel, book.designs[key]))])
        idle = idle + 1 if broken and not lost else 0
        if idle >= IDLE_BREAKS:
            return f"worker processes die before they get a design ({worker.sentence(broken)})"
    return ""


def _parcel(source) -> worker.Parcel:
    timeout = getattr(source, "timeout", None)
    if timeout in (None, math.inf):
        return worker.Parcel(source)
    limit = 2 * timeout + GRACE
    return worker.Parcel(source, limit, STARVED * limit)


def _probe(executor: Executor, count: int, parcel: worker.Parcel) -> None:
    """See that workers start and can take the source, before anything is written."""
    try:
        for future in [executor.submit(worker.ready, parcel) for _ in range(count)]:
            future.result()
    except BrokenExecutor as error:
        raise InputError(
            f"the workers can't start ({worker.sentence(error)}); a script that runs a campaign "
            "needs `if __name__ == '__main__':` around it"
        ) from None
    except (Exception, asyncio.CancelledError) as error:
        raise InputError(
            f"the workers can't take the label source ({worker.sentence(error)}); its class must "
            "be importable there, as foldlab itself"
        ) from None


def _drain(
    executor: Executor,
    call: Callable[[dict], Future],
    waiting: deque[str],
    running: dict[Future, str],
    book: _Book,
    in_flight: int,
    suspects: list[str] | None = None,
) -> tuple[list[str], BaseException | None]:
    """Submit and commit until none waits or the executor breaks.

    Returns the keys whose computation broke with it, and the error. Keys leave ``waiting`` when
    they are submitted, and ``running`` only after their commit: an interrupt loses nothing. Designs
    that an executor gave up because their workers died go to ``suspects``, where there is such a
    list, instead of into the store.
    """
    lost: list[str] = []
    broken: BaseException | None = None

    def suspect(f: Future) -> bool:
        return suspects is not None and not f.cancelled() and worker.killed(f.exception())

    def commit(done: Iterable[Future]) -> None:
        kept = [f for f in done if not suspect(f)]
        answers = [(running[f], _answer(f, book.designs[running[f]])) for f in kept]
        book.commit((key, label) for key, label in answers if label is not None)

    try:
        while running or (waiting and broken is None):
            while waiting and broken is None and len(running) < in_flight:
                try:
                    future = call(book.designs[waiting[0]])
                except Exception as error:
                    broken = error
                    break
                running[future] = waiting.popleft()
            done, _ = wait(running, timeout=PATIENCE, return_when=FIRST_COMPLETED)
            if not done and getattr(executor, "_broken", False):
                # What is submitted in the moment of the break is never answered.
                broken = broken or BrokenExecutor("it broke without an answer")
                lost.extend(running.values())
                running.clear()
            commit(done)
            for future in done:
                key = running.pop(future)
                if suspect(future):
                    suspects.append(key)
                elif _answer(future, book.designs[key]) is None:
                    lost.append(key)
                    broken = CancelledError() if future.cancelled() else future.exception()
    except KeyboardInterrupt:
        commit([f for f in running if f.done()])
        raise
    return lost, broken


def _answer(future: Future, design: dict[str, float]) -> Label | None:
    """The label of a future that is done; None if the executor lost it."""
    if future.cancelled():
        return None
    error = future.exception()
    if error is None:
        return future.result()
    gone = isinstance(error, BrokenExecutor | CancelledError) or not isinstance(error, Exception)
    return None if gone else worker.failed(error, design)


def _report(book: _Book, rows: int, there: int, stopped: str, started: float) -> CampaignReport:
    requested, labelled = len(book.designs), there + book.computed
    seconds = time.perf_counter() - started
    folds, not_folds, unknown = (book.verdicts[verdict] for verdict in (True, False, None))
    counts = f"{folds} fold, {not_folds} do not, {unknown} unknown"
    if labelled == requested:
        outcome = f"all {requested} designs have a label: {counts}"
    else:
        outcome = (
            f"stopped: {stopped}; {labelled} of {requested} designs have a label ({counts}): "
            "run again to complete the rest"
        )
    return CampaignReport(
        source=book.name,
        version=book.version,
        requested=requested,
        duplicates=rows - requested,
        already_there=there,
        computed=book.computed,
        folds=folds,
        not_folds=not_folds,
        unknown=unknown,
        reasons=dict(book.reasons.most_common()),
        seconds=seconds,
        rate=book.computed / seconds,
        complete=labelled == requested,
        outcome=outcome,
    )
