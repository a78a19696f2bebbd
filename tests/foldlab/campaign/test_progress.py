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


def test_a_line_says_how_fast_what_came_and_how_long_it_will_take(monkeypatch, capsys):
    now = 1000.0
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now)
    reasons = Counter({"time [ran] out": 3, "it broke": 2})
    verdicts = Counter({True: 4, False: 1, None: 5})
    book = SimpleNamespace(name="toy", computed=0, reasons=reasons, verdicts=verdicts)
    with progress.progress_bar(book, 100):
        now, book.computed = 1060.0, 10
        book.on_commit()
        assert "remaining" not in capsys.readouterr().err  # a minute is not yet more than one
        now, book.computed = 1080.0, 20
        book.on_commit()
        told = capsys.readouterr().err
    line = "20/100, 0.25/s, 4 fold, 5 unknown, 320 s remaining; 3 × time [ran] out; 2 × it broke"
    assert line in told.splitlines()
