"""The verb ``predict``: what a model says of a table of designs, and how far it can be trusted."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from foldlab.cli.outputs import check_file
from foldlab.design import space_named, space_of
from foldlab.errors import InputError
from foldlab.tables import SUFFIXES, read_table, write_table
from foldlab.terminal import Json, Workers, emit, note

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from foldlab.design import DesignSpace


MANY, ROD = 20_000, 6e-4  # designs from which on seconds are told, and seconds of a rod


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
    from foldlab.learning.saving import load_model, shipped_for

    check_file(out, SUFFIXES)
    table = read_table(designs)
    space = space_of(table)
    fitted, card = load_model(model if model is not None else shipped_for(space.name))
    if card["space"] != space.name:
        raise InputError(
            f"the model is of the space {card['space']}, and the designs are of {space.name}"
        )
    groups, start = space.validate(table, bounds=False), time.perf_counter()
    result = groups.assign(**_answers(fitted, card, groups))
    told, off = _angles(space, groups)
    if told is not None:
        result["fold_angle"] = told
    result = result.join(_nearest(card, labels, groups))
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


def _answers(fitted, card: dict[str, Any], groups: pd.DataFrame) -> dict[str, Any]:
    """Probability, verdict (NA: don't know), who gave it, and whether it lies where it learned."""
    from foldlab.learning.conformal import Borders
    from foldlab.learning.features import as_labels, probability_of_folding

    p = probability_of_folding(fitted, groups)
    made = card["metadata"]
    if made.get("borders"):
        foldable: Any = Borders(**made["borders"]).answers(p)
    else:
        import pandas as pd

        foldable = pd.array(as_labels(fitted.predict(groups)), dtype="boolean")
    answers = {"probability": p, "foldable": foldable, "by": "model"}
    if bounds := made.get("bounds"):
        inside = [groups[name].between(*ends) for name, ends in bounds.items()]
        answers["inside"] = sum(~part for part in inside) == 0
    return answers


def _angles(space: DesignSpace, groups: pd.DataFrame) -> tuple[np.ndarray | None, float | None]:
    """Fold angles in rad from the shipped model for this space, and what nine of ten labels of its
    card are off by at most, over the angle or what counts as folded; None without such a model."""
    from foldlab.learning.saving import load_model, shipped_for

    try:
        name = shipped_for(space.name, task="angle")
    except InputError:
        return None, None
    model, card = load_model(name)
    if card["metadata"]["inputs"] == "rod" and len(groups) > MANY:
        note(f"fold angles take a rod each: about {len(groups) * ROD:.0f} s")
    return model.predict(groups), card["metadata"].get("holdout_error_90")


def _nearest(card: dict[str, Any], path: Path | None, groups: pd.DataFrame) -> pd.DataFrame:
    """The nearest labelled design: its row, its verdict, and how far off it is, as a root mean
    square over the groups of the fraction of their bounds."""
    import numpy as np
    import pandas as pd
    from scipy.spatial import cKDTree

    from foldlab.datasets import load_dataset
    from foldlab.learning.train import known_labels

    if path is not None:
        table = read_table(path)
    elif "dataset" in card["metadata"]:
        made = card["metadata"]
        table = load_dataset(made["dataset"], growth=made["growth"], space=card["space"])
    else:
        return pd.DataFrame(index=groups.index)
    space = space_named(card["space"])
    known, _ = known_labels(table, space)
    units = (space.to_unit(frame[space.names]) for frame in (known, groups))
    off, near = cKDTree(next(units)).query(next(units))
    return pd.DataFrame(
        {
            "nearest": known.index.to_numpy()[near],
            "nearest_foldable": known["foldable"].to_numpy()[near],
            "nearest_distance": off / np.sqrt(len(space)),
        },
        index=groups.index,
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
