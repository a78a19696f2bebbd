"""The verb ``augment``: where labels are spent best."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foldlab.cli.outputs import output_folder
from foldlab.design import space_named
from foldlab.errors import InputError
from foldlab.settings import build
from foldlab.tables import read_table, write_table
from foldlab.terminal import Given, Json, Seed, Space, Workers, emit, note

if TYPE_CHECKING:
    import pandas as pd

STORE = "labels.db"


def augment(
    *,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for curves and picture.")],
    space: Space = "reduced",
    source: Annotated[str, typer.Option("--source", help="Label source.")] = "timoshenko",
    test: Annotated[
        Path | None,
        typer.Option("--test", help="Table of labels to score on; else fresh ones, if cheap."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Number of seeds.")] = 3,
    target: Annotated[float, typer.Option(help="Accuracy at which labels are compared.")] = 0.99,
    timeout: Annotated[float, typer.Option(help="Core-seconds per label of the solver.")] = 30.0,
    workers: Workers = 1,
    seed: Seed = 0,
    given: Given,
    as_json: Json = False,
) -> None:
    """Spend labels near the boundary (Algorithm 5) and at random; compare the labels needed. Labels
    of the solver are kept in the folder: run again, it goes on where it was."""
    from foldlab.campaign.campaign import labelled
    from foldlab.labels.sources import make_source
    from foldlab.labels.store import LabelStore
    from foldlab.learning.augment import Plan, compare_strategies
    from foldlab.learning.plots import plot_learning_curves
    from foldlab.plots import save_figure

    plan = build(Plan, given.read())
    maker = make_source(source, space=space_named(space))
    slow = not hasattr(maker, "label_many")
    if slow:
        maker = make_source(source, {"timeout": timeout}, space=maker.space)
    table = _test_labels(test, slow)
    if slow:
        labels = plan.initial + plan.per_cycle * (plan.cycles - 1)
        note(f"up to {2 * seeds * labels} labels by the {source}, each at most {timeout:g} core-s")
    with (
        output_folder(out, keep=[STORE]),
        LabelStore(out / STORE) if slow else nullcontext() as store,
    ):
        curves, summary = compare_strategies(
            maker,
            plan,
            seeds=range(seed, seed + seeds),
            target=target,
            progress=None if as_json else note,
            test=table,
            label=partial(
                labelled, source=maker, store=store, workers=workers, progress=not as_json
            )
            if slow
            else None,
        )
        write_table(curves, out / "curves.csv")
        save_figure(plot_learning_curves(curves, target=target, as_error=True), out / "curves.png")
    emit({**summary, "folder": out}, as_json)


def _test_labels(path: Path | None, slow: bool) -> pd.DataFrame | None:
    """What to score on: the table given, else the dataset's test part where labels are dear."""
    if path is not None:
        return read_table(path)
    if not slow:
        return None
    from foldlab.datasets import datasets, load_dataset

    if "gravity" not in datasets():
        raise InputError(
            "such labels are too dear to make test labels first: give some by --test TABLE"
        )
    table = load_dataset("gravity", growth="uniaxial", part="test")
    return table[table["strips"] == 0]
