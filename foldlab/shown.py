"""How objects show themselves in a notebook: one small table of names and values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(title: str, rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """A table of text as HTML, everything escaped; ``head``: names of its columns."""

    def row(cells, tag):
        return "<tr>" + "".join(f"<{tag}>{escape(str(c))}</{tag}>" for c in cells) + "</tr>"

    body = "".join(row(cells, "td") for cells in rows)
    named = f"<thead>{row(head, 'th')}</thead>" if head else ""
    return f"<table><caption>{escape(title)}</caption>{named}<tbody>{body}</tbody></table>"
