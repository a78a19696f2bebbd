"""The verb ``predict``: what a model says of a table of designs, and how far it can be trusted."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from foldlab.cli.outputs import check_file
from foldlab.design import space_of
from foldlab.errors import InputError
from foldlab.tables import SUFFIXES, read_table, write_table
from foldlab.terminal import Json, Workers, emit, note

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from foldlab.design import DesignSpace


def predict(
    *,
    designs: Annotated[Path, typer.Argument(help="Table of designs.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Table to write (.parquet, .csv).")],
    model: Annotated[
        str | None,
        typer.Option("--model", help="Folder of a model, or a shipped one; else by the groups."),
    ] = None,
    labels: Annotated[
        Path | None, typer.Option("--labels", help="Table of labels to find the nearest one in.")
    ] = None,
    defer: Annotated[
        Literal["solver"] | None,
        typer.Option("--defer", help="Whom to ask where the model doesn't know."),
    ] = None,
    timeout: Annotated[float, typer.Option(help="Core-seconds per label of --defer.")] = 30.0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Predict folding: probability, verdict or don't know, angle, nearest label, trained or not."""
    from foldlab.learning.saving import shipped_for
    from foldlab.predicted import Predictor

    check_file(out, SUFFIXES)
    table = read_table(designs)
    space = space_of(table)
    known = None if labels is None else read_table(labels)
    said = Predictor.of(model if model is not None else shipped_for(space.name), known)
    card = said.card
    if card["space"] != space.name:
        raise InputError(
            f"the model is of the space {card['space']}, and the designs are of {space.name}"
        )
    groups, start = space.validate(table, bounds=False), time.perf_counter()
    result = groups.assign(**said.answers(groups))
    told, off = said.angles(groups, tell=note)
    if told is not None:
        result["fold_angle"] = told
    result = result.join(said.nearest(groups))
    open_ = result["foldable"].isna().to_numpy()
    asked = 0
    if defer is not None and open_.any():
        asked = int(open_.sum())
        result = _deferred(result, space, open_, timeout, workers, quiet=as_json)
    write_table(result, out)
    emit(
        {
            **_summary(result, card, asked),
            "fold_angle_error_90": off,
            "seconds": time.perf_counter() - start,
            "file": out,
        },
        as_json,
    )


def _deferred(
    result: pd.DataFrame, space: DesignSpace, open_: np.ndarray, timeout, workers: int, quiet: bool
) -> pd.DataFrame:
    """With the solver's labels where the model has none."""
    from foldlab.campaign.campaign import labelled
    from foldlab.labels.sources import make_source

    source = make_source("solver", {"timeout": timeout}, space=space)
    asked = result.loc[open_, space.names]
    labels = labelled(asked, source, workers=workers, progress=not quiet)
    out = result.assign(reason="", core_seconds=0.0)
    out.loc[open_, "by"] = "solver"
    for name in ("foldable", "reason", "fold_angle", "core_seconds"):
        if name in labels:
            out.loc[open_, name] = labels[name]
    return out


def _summary(result: pd.DataFrame, card: dict[str, Any], asked: int) -> dict[str, Any]:
    known = result["foldable"].notna()
    folds = int((result["foldable"] == True).sum())  # noqa: E712
    borders = card["metadata"].get("borders")
    return {
        "designs": len(result),
        "folds": folds,
        "does_not": int(known.sum()) - folds,
        "does_not_know": int((~known).sum()),
        "asked_the_solver": asked,
        "outside_of_training": int((~result["inside"]).sum()) if "inside" in result else None,
        "model": card["metadata"].get("model", card["model"]),
        "coverage": borders["coverage"] if borders else None,
    }
