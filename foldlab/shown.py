"""How objects show themselves: settings in a line, and in a notebook as a table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import is_dataclass
from inspect import signature
from typing import Any

from solver.shown import html_table

__all__ = ["Shown", "html_table"]


class Shown:
    """A source that shows its settings: in a line those that are not the default, in a table all.

    For classes whose constructor takes their attributes and needs none; records among them are
    told by their own fields, and a space by its name.
    """

    name: str
    version: str

    def __repr__(self) -> str:
        usual = dict(_settings(type(self)()))
        told = [f"{k}={v!r}" for k, v in _settings(self) if v != usual[k]]
        return f"{type(self).__name__}({', '.join(told)})"

    def _repr_html_(self) -> str:
        usual = dict(_settings(type(self)()))
        rows = [(k, v, "" if v == usual[k] else usual[k]) for k, v in _settings(self)]
        head = ("setting", "value", "default, where it is another")
        return html_table(f"{self.name}, version {self.version}", rows, head)


def _settings(record: Any) -> Iterator[tuple[str, Any]]:
    for name in signature(type(record)).parameters:
        value = getattr(record, name)
        if name == "space":
            yield name, value.name
        elif is_dataclass(value):
            yield from _settings(value)
        else:
            yield name, value
