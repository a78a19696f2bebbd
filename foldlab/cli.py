"""The command line: one verb per step of the workbench.

Results go to stdout (``--json``: one JSON object), progress and messages to stderr. Exit status 0:
done; 2: bad input, nothing written; 3: ran but could not reach the result.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from foldlab.design import space_named, space_of
from foldlab.errors import InputError
from foldlab.settings import build, numbers, read_settings
from foldlab.tables import read_table, replace_file, write_table

# Heavy imports (torch, MLflow, Matplotlib) stay inside the verbs, so that --help answers at once.

app = typer.Typer(
    name="foldlab",
    help="Which self-folding units fold, why, how sure we are, and what to build instead.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
err = Console(stderr=True)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of every random choice.")]
Sets = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Override a setting.")
]
Config = Annotated[Path | None, typer.Option("--config", help="TOML file of settings.")]
Space = Annotated[str, typer.Option("--space", help="Design space: reduced or full.")]
Workers = Annotated[int, typer.Option("--workers", min=1, help="Worker processes.")]


class NotReached(Exception):
    """Ran, but could not reach the result; exit status 3."""


def main() -> None:
    """Entry point: turns :class:`InputError` into one line on stderr and exit status 2."""
    try:
        status = app(standalone_mode=False)
    except InputError as error:
        err.print(f"error: {error}", markup=False, highlight=False, soft_wrap=True)
        sys.exit(2)
    except NotReached as error:
        err.print(f"not reached: {error}", markup=False, highlight=False, soft_wrap=True)
        sys.exit(3)
    except typer.Abort:
        sys.exit(130)
    except Exception as error:
        if not hasattr(error, "exit_code"):
            raise
        # click's own usage errors
        err.print(f"error: {error.format_message()}", markup=False, highlight=False)
        sys.exit(2)
    sys.exit(status or 0)


def emit(result: dict[str, Any], as_json: bool, rows: list[dict] | None = None) -> None:
    """Print a result: JSON, or a table of ``rows`` and the scalars below it."""
    if as_json:
        print(json.dumps(plain(result), allow_nan=False))
        return
    out = Console()
    if rows:
        table = Table(show_edge=False)
        for name in rows[0]:
            table.add_column(name, justify="left" if isinstance(rows[0][name], str) else "right")
        for row in rows:
            table.add_row(*(_cell(value) for value in row.values()))
        out.print(table)
    for name, value in result.items():
        if not isinstance(value, dict | list):
            out.print(f"{name}: {_cell(value)}", markup=False, highlight=False, soft_wrap=True)


def _cell(value: Any) -> str:
    if value is None:
        return "–"
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


@app.command()
def sample(
    n: Annotated[int, typer.Option("-n", help="Number of designs.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Table to write (.parquet, .csv).")],
    space: Space = "reduced",
    seed: Seed = 0,
    optimize: Annotated[
        str | None, typer.Option(help="Spread the points: random-cd or lloyd (cost ~ n²).")
    ] = None,
    as_json: Json = False,
) -> None:
    """Draw designs by Latin hypercube, uniform on each group's own scale."""
    if optimize not in (None, "random-cd", "lloyd"):
        raise InputError(f"--optimize {optimize}; expected random-cd or lloyd")
    designs = space_named(space).sample(n, seed=seed, optimization=optimize)
    write_table(designs, out)
    emit({"designs": len(designs), "space": space, "seed": seed, "file": out}, as_json)


@app.command()
def label(
    designs: Annotated[Path, typer.Argument(help="Table of designs.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Label store (SQLite file).")],
    source: Annotated[str, typer.Option("--source", help="Label source.")] = "timoshenko",
    workers: Workers = 1,
    retry_unknown: Annotated[
        bool, typer.Option("--retry-unknown", help="Compute labels again that ended unknown.")
    ] = False,
    settings: Sets = None,
    config: Config = None,
    as_json: Json = False,
) -> None:
    """Label designs into a store; what the store holds already is not computed again."""
    from foldlab.campaign import run_campaign
    from foldlab.labels import LabelStore
    from foldlab.sources import make_source

    table = read_table(designs)
    space = space_of(table)
    maker = make_source(source, space=space, **read_settings(settings or (), config))
    table = space.validate(table)
    with LabelStore(out) as store:
        report = run_campaign(
            table, maker, store, workers=workers, retry_unknown=retry_unknown, progress=not as_json
        )
    emit({**report.as_dict(), "store": out}, as_json)
    if not report.complete:
        raise NotReached(report.outcome)


@app.command()
def export(
    store: Annotated[Path, typer.Argument(help="Label store.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Table to write (.parquet, .csv).")],
    source: Annotated[str | None, typer.Option("--source", help="Only this source.")] = None,
    as_json: Json = False,
) -> None:
    """Write the labels of a store to one flat table."""
    from foldlab.labels import LabelStore

    with LabelStore(store, mode="read") as labels:
        count = labels.export(out, source=source)
    emit({"labels": count, "file": out}, as_json)


if __name__ == "__main__":
    main()
