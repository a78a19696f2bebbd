"""What every verb of the command line shares: options, results on stdout, messages on stderr."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from rich.console import Console

err = Console(stderr=True, soft_wrap=True)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of every random choice.")]
Sets = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Override a setting.")
]
Config = Annotated[Path | None, typer.Option("--config", help="TOML file of settings.")]
Space = Annotated[str, typer.Option("--space", help="Design space: reduced, full or patterned.")]
Track = Annotated[
    bool, typer.Option("--track", help="Log settings, figures and files of this run to MLflow.")
]
Workers = Annotated[int, typer.Option("--workers", min=1, help="Worker processes.")]


@dataclass(frozen=True)
class Given:
    """The settings that a verb was given."""

    settings: Sets = None
    config: Config = None

    def read(self) -> dict[str, Any]:
        """Names to values; see :func:`foldlab.settings.read_settings`."""
        # Pydantic takes a tenth of a second, which --help does not need.
        from foldlab.settings import read_settings

        return read_settings(self.settings or (), self.config)


def with_records(verb: Callable) -> Callable:
    """The verb as Typer takes it: each field of a parameter that is a dataclass is an option."""
    hints = get_type_hints(verb, include_extras=True)
    options, records = [], {}
    for name, parameter in inspect.signature(verb).parameters.items():
        kind = hints[name]
        if not dataclasses.is_dataclass(kind):
            options.append(parameter.replace(annotation=kind, kind=parameter.KEYWORD_ONLY))
            continue
        inner = get_type_hints(kind, include_extras=True)
        records[name] = kind, [field.name for field in dataclasses.fields(kind)]
        for name, given in inspect.signature(kind).parameters.items():
            options.append(given.replace(annotation=inner[name], kind=given.KEYWORD_ONLY))

    def command(**values):
        for name, (kind, fields) in records.items():
            values[name] = kind(**{field: values.pop(field) for field in fields})
        return verb(**values)

    command.__name__, command.__doc__ = verb.__name__, verb.__doc__
    command.__signature__ = inspect.Signature(options)
    command.__annotations__ = {option.name: option.annotation for option in options}
    return command


def note(text: str) -> None:
    """Say something on stderr, as it stands."""
    err.print(text, markup=False, highlight=False)


class NotReached(Exception):
    """Ran, but could not reach the result; exit status 3."""


def emit(result: dict[str, Any], as_json: bool, rows: list[dict] | None = None) -> None:
    """Print a result: JSON, or a table of ``rows`` and the scalars below it."""
    if as_json:
        print(json.dumps(plain(result), allow_nan=False))
        return
    width = None if sys.stdout.isatty() else 160
    out = Console(width=width, markup=False, highlight=False)
    if rows:
        from rich.table import Table

        table = Table(show_edge=False)
        for name in rows[0]:
            table.add_column(name, justify="left" if isinstance(rows[0][name], str) else "right")
        for row in rows:
            table.add_row(*(_cell(value) for value in row.values()))
        out.print(table)
    for name, value in result.items():
        if not isinstance(value, dict | list):
            out.print(f"{name}: {_cell(value)}", soft_wrap=True)


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, tuple):
        return f"({', '.join(map(_cell, value))})"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def plain(value: Any) -> Any:
    """JSON values only: NumPy scalars become Python's, NaN and infinities become null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
