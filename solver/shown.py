"""How objects show themselves in a notebook: one small table of names and values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(title: str, rows: Iterable[Sequence], head: Sequence[str] = ()) -> str:
    """A table of text as HTML, everything escaped; ``head``: names of its columns."""

    def row(cells, tag):
        return "<tr>" + "".join(f"<{tag}>{escape(str(c))}</{tag}>" for c in cells) + "</tr>"

    body = "".join(row(cells, "td") for cells in rows)
    named = f"<thead>{row(head, 'th')}</thead>" if head else ""
    return f"<table><caption>{escape(title)}</caption>{named}<tbody>{body}</tbody></table>"


def scene_table(scene) -> str:
    """What is summed, how large it is and in which scales tolerances are ratios, as HTML."""
    rows = [
        (term.name, type(term).__name__, "–" if term.graph is None else "yes")
        for term in scene.terms
    ]
    of = scene.scales
    size = f"{scene.n_nodes} nodes, {scene.n_free} unknowns, {scene.n_rows} rows"
    scales = f"length {of.length:.4g}, force {of.force:.4g}, energy {of.energy:.4g}"
    return html_table(f"scene: {size}; {scales}", rows, ("term", "kind", "stiffness"))


def path_table(path, most: int = 10) -> str:
    """Points of a path as HTML: those before which something happened, and of the others about
    ``most``, evenly spread; last what happened beyond the last point."""
    points, every = path.points, max(1, -(-len(path.points) // most))
    rows = [
        (k, f"{p.e:.4g}", "–" if p.unstable is None else p.unstable, _named(p.events))
        for k, p in enumerate(points)
        if k % every == 0 or p is points[-1] or p.events
    ]
    seen = {id(event) for p in points for event in p.events}
    if beyond := [event for event in path.events if id(event) not in seen]:
        rows.append(("", "", "", _named(beyond)))
    head = ("point", "e", "unstable modes", "on the way there")
    return html_table(f"{len(points)} points: {path.reason}", rows, head)


def _named(events: Iterable) -> str:
    return ", ".join(f"{event.kind} at {event.e:.4g}" for event in events)
