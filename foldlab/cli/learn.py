"""The verbs of learning: ``train``, ``score``, ``tune``, ``augment``."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foldlab.cli.outputs import only_whole, output_folder
from foldlab.design import space_named, space_of
from foldlab.errors import InputError
from foldlab.settings import build
from foldlab.tables import read_table, write_table
from foldlab.terminal import Given, Json, Seed, Space, Track, Workers, emit, note

if TYPE_CHECKING:
    import pandas as pd

STORE = "labels.db"


def train(
    *,
    labels: Annotated[Path, typer.Argument(help="Table of labels.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of the model.")],
    model: Annotated[str, typer.Option("--model", help="Which model.")] = "network",
    holdout: Annotated[
        float | None,
        typer.Option(help="Fraction of labels kept for scoring; else the table's parts, or 0.2."),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option("--false-positive-rate", help="Threshold for this rate, from the hold-out."),
    ] = None,
    coverage: Annotated[
        float | None,
        typer.Option(help="Say don't know, so as to be right or silent this often."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a saved model.")] = False,
    seed: Seed = 0,
    given: Given,
    track: Track = False,
    as_json: Json = False,
) -> None:
    """Train a model on labels; --set passes the model's own settings, as in --set epochs=500."""
    from foldlab.learning.saving import check_target, save_model
    from foldlab.learning.train import train_on
    from foldlab.tracking import asked

    table, options = read_table(labels), given.read()
    check_target(out, overwrite)
    log = asked(track)
    with only_whole(out):
        fitted, result = train_on(
            table,
            model,
            seed=seed,
            holdout=holdout,
            rate=rate,
            coverage=coverage,
            options=options,
        )
        save_model(fitted, out, result, overwrite=overwrite)
    said = {"labels": labels, "holdout": holdout, "rate": rate, "coverage": coverage, **options}
    with log("train", {**said, "model": model, "folder": out}, seed=seed) as run:
        run.metrics(result)
        run.model(model, fitted, table[space_of(table).names].head(5))
    emit({**result, "folder": out}, as_json)


def score(
    *,
    model: Annotated[Path, typer.Argument(help="Folder of a trained model.")],
    labels: Annotated[Path, typer.Argument(help="Table of labels.")],
    as_json: Json = False,
) -> None:
    """Score a trained model on a table of labels; designs of unknown label are left out."""
    from foldlab.learning.conformal import Borders, measured
    from foldlab.learning.models import AngleRegressor
    from foldlab.learning.saving import load_model
    from foldlab.learning.scoring import angle_errors
    from foldlab.learning.scoring import score as scores
    from foldlab.learning.train import known_angles, known_labels

    fitted, card = load_model(model)
    space = space_named(card["space"])
    if isinstance(fitted, AngleRegressor):
        table, unknown = known_angles(read_table(labels), space)
        result = angle_errors(fitted, table[space.names], table["fold_angle"])
        emit({"model": card["model"], **result, "without_angle": unknown}, as_json)
        return
    table, unknown = known_labels(read_table(labels), space)
    designs, truth = table.drop(columns="foldable"), table["foldable"]
    result = scores(fitted, designs, truth)
    if borders := card["metadata"].get("borders"):
        result |= measured(fitted, Borders(**borders), designs, truth)
    emit({"model": card["model"], **result, "unknown": unknown}, as_json)


def tune(
    *,
    labels: Annotated[Path, typer.Argument(help="Table of labels.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder; a study in it is resumed.")],
    trials: Annotated[int, typer.Option(min=1, help="Trials in all.")] = 40,
    workers: Workers = 1,
    seed: Seed = 0,
    given: Given,
    as_json: Json = False,
) -> None:
    """Search the network's architecture and loss bias: accuracy against training seconds."""
    from foldlab.learning.plots import plot_study
    from foldlab.learning.train import known_labels
    from foldlab.learning.tune import Search
    from foldlab.learning.tune import tune as run_study
    from foldlab.plots import save_figure

    table = read_table(labels)
    space = space_of(table)
    table, _ = known_labels(table, space)
    search = build(Search, given.read(), trials=trials, workers=workers, seed=seed)
    # The trials that have ended are worth keeping: the study goes on with them.
    with output_folder(out, keep=["study.journal"]):
        study = run_study(table, space, out / "study.journal", search)
        write_table(study, out / "trials.csv")
        save_figure(plot_study(study), out / "front.png")
    front = study[study["on_front"]].sort_values("seconds").drop(columns="on_front")
    rows = front.to_dict("records")
    emit({"trials": len(study), "front": rows, "folder": out}, as_json, rows)


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
