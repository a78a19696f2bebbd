"""The verb ``map``: where a model says that units fold, and what slower answers say there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from foldlab.cli.outputs import check_file
from foldlab.design import space_named
from foldlab.errors import InputError
from foldlab.quantities import numbers
from foldlab.terminal import Given, Json, Seed, Workers, emit, note

if TYPE_CHECKING:
    import pandas as pd

    from foldlab.maps.regimes import RegimeMap

CONTOURS = (0.1, 0.9)


def map_(
    *,
    model: Annotated[
        str | None, typer.Argument(help="Folder of a trained model, or the name of a shipped one.")
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Picture (.png, .pdf, .svg).")],
    space: Annotated[
        str | None, typer.Option("--space", help="Without a model: take the one shipped for this.")
    ] = None,
    against: Annotated[
        str | None, typer.Option("--against", help="Validate every point against this source.")
    ] = None,
    verify: Annotated[
        int, typer.Option("--verify", min=0, help="Points that the solver checks, drawn on top.")
    ] = 0,
    x: Annotated[str, typer.Option(help="Group on the x axis.")] = "E_ratio",
    y: Annotated[str, typer.Option(help="Group on the y axis.")] = "h_ratio",
    slices: Annotated[str, typer.Option("--slice", help="Group that the panels step through.")] = (
        "slenderness"
    ),
    panels: Annotated[int, typer.Option(min=1, help="Number of slices.")] = 9,
    points: Annotated[int, typer.Option(min=1, help="Points in all panels together.")] = 100_000,
    timeout: Annotated[float, typer.Option(help="Core-seconds per label of --verify.")] = 30.0,
    workers: Workers = 1,
    seed: Seed = 0,
    given: Given,
    as_json: Json = False,
) -> None:
    """Draw what folds, slice by slice, and where a model is wrong.

    --set fixes the groups that are not on an axis; others are held in the middle of their bounds.
    """
    from foldlab.labels.sources import make_source
    from foldlab.labels.timoshenko import TimoshenkoSource
    from foldlab.learning.saving import load_model, shipped_for
    from foldlab.maps.plots import plot_regimes
    from foldlab.maps.regimes import held_in_the_middle, regime_map
    from foldlab.plots import FORMATS, save_figure

    check_file(out, FORMATS)
    if space is not None:
        space_named(space)
    if model is None:
        if space is None:
            raise InputError("no model: give the folder of one, or --space full for a shipped one")
        model = shipped_for(space)
    fitted, card = load_model(model)
    if space is not None and space != card["space"]:
        raise InputError(f"the model {model} is of the space {card['space']}, not {space}")
    chosen = space_named(card["space"])
    fixed = numbers(given.read())
    held = held_in_the_middle(chosen, (x, y, slices), fixed)
    if middle := [f"{name} = {value:.3g}" for name, value in held.items() if name not in fixed]:
        note(f"held in the middle of their bounds: {', '.join(middle)}")
    heavy = chosen.name != "reduced"
    if verify and not heavy:
        raise InputError(
            "--verify asks the solver, which needs a whole unit, and the reduced space has only "
            "its hinge; validate with --against timoshenko"
        )
    regime = regime_map(
        fitted,
        space=chosen,
        axes=(x, y),
        slice_by=slices,
        slices=chosen[slices].from_unit(cells(panels)),
        fixed=held,
        points=points,
        source=make_source(against, space=chosen) if against is not None else None,
        beside=("boundary without weight", TimoshenkoSource(space=chosen)) if heavy else None,
    )
    verified, checked = None, {}
    if verify:
        verified, checked = verification(regime, verify, seed, timeout, workers, quiet=as_json)
    contours = CONTOURS if heavy and against is None else ()
    save_figure(plot_regimes(regime, points=verified, contours=contours), out)
    emit({**regime.summary(), **checked, "file": out}, as_json)


def cells(panels: int) -> list[float]:
    """Where slices lie between bounds: from one to the other, a single one in the middle."""
    return [0.5] if panels == 1 else [k / (panels - 1) for k in range(panels)]


def verification(
    regime: RegimeMap, n: int, seed: int, timeout: float, workers: int, quiet: bool
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Designs of the map with the solver's labels, and how the model did on them."""
    from foldlab.campaign.campaign import labelled
    from foldlab.labels.sources import make_source
    from foldlab.maps.regimes import to_verify

    designs = to_verify(regime, n, seed=seed)
    source = make_source("solver", {"timeout": timeout}, space=regime.space)
    table = labelled(designs, source, workers=workers, progress=not quiet)
    known = table["foldable"].notna()
    agree = table["predicted"][known] == table["foldable"][known].astype(bool)
    return table, {
        "verified": len(table),
        "verified_known": int(known.sum()),
        "verified_agree": int(agree.sum()),
        "verified_core_seconds": float(table["core_seconds"].sum()),
    }
