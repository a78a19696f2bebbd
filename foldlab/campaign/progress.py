"""What a running campaign shows on stderr: how far, how fast, how long, what came, what failed."""

from __future__ import annotations

import time
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

REASONS = 5  # the most frequent reasons of unknown labels that are shown
LOG_EVERY = 60  # seconds between lines where stderr is no terminal


@contextmanager
def progress_bar(book, total: int):
    """Draw until the body ends. ``book``: ``name``, ``computed``, ``verdicts``, ``reasons`` of the
    campaign, and ``on_commit``, which is set here."""

    class Bar(Progress):
        def get_renderables(self):
            yield self.make_tasks_table(self.tasks)
            for reason, count in book.reasons.most_common(REASONS):
                yield f"  {count} unknown: {reason[:200]}"

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[news]}", markup=False),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)
    begun = logged = time.perf_counter()
    with Bar(*columns, console=console) as bar:
        task = bar.add_task(f"labels: {book.name}", total=total, news="")

        def update():
            nonlocal logged
            now = time.perf_counter()
            rate = book.computed / (now - begun)
            folds, unknown = book.verdicts[True], book.verdicts[None]
            news = f"{rate:.3g}/s, {folds} fold, {unknown} unknown"
            bar.update(task, completed=book.computed, news=news)
            if not console.is_terminal and now - logged > LOG_EVERY:
                # A log file shows no bar: a line now and then.
                logged, remaining = now, (total - book.computed) / rate
                reasons = book.reasons.most_common(REASONS)
                why = "".join(f"; {count} × {reason[:80]}" for reason, count in reasons)
                console.print(f"{book.computed}/{total}, {news}, {remaining:.0f} s remaining{why}")

        book.on_commit = update
        yield
