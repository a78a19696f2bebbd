"""What a campaign says of itself where stderr is no terminal."""

from collections import Counter
from types import SimpleNamespace

from foldlab.campaign import progress


def test_a_line_is_written_at_most_once_a_minute(monkeypatch, capsys):
    now = 1000.0
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now)
    book = SimpleNamespace(name="toy", computed=0, reasons=Counter(), verdicts=Counter())
    lines = []
    with progress.progress_bar(book, 100):
        for seconds in (59, 61, 62, 120, 122, 123):
            now, book.computed = 1000.0 + seconds, book.computed + 1
            book.on_commit()
            if "s remaining" in capsys.readouterr().err:
                lines.append(seconds)
    assert lines == [61, 122]
