"""The verbs of labelling: ``sample``, ``label``, ``export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foldlab.design import space_named, space_of
from foldlab.errors import InputError
from foldlab.settings import read_settings
from foldlab.tables import read_table, write_table
from foldlab.terminal import Config, Json, NotReached, Seed, Sets, Space, Workers, emit


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
