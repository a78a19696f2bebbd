"""The command line: one verb per step of the workbench.

Results go to stdout (``--json``: one JSON object), progress and messages to stderr. Exit status 0:
done; 2: bad input, nothing written; 3: ran but could not reach the result.
"""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

import foldlab
from foldlab.cli import label_verbs
from foldlab.cli.augment import augment
from foldlab.cli.check import check, materials
from foldlab.cli.design import design
from foldlab.cli.maps import map_
from foldlab.cli.outputs import only_whole, output_folder, trouble
from foldlab.cli.predict import predict
from foldlab.cli.simulate import simulate
from foldlab.cli.structure import structure
from foldlab.design import space_named, space_of
from foldlab.errors import InputError
from foldlab.settings import build
from foldlab.tables import read_table, write_table
from foldlab.terminal import Given, Json, NotReached, Seed, Workers, emit, note, with_records

# Heavy imports (torch, MLflow, Matplotlib) stay inside the verbs, so that --help answers at once.

app = typer.Typer(
    name="foldlab",
    help="Which self-folding units fold, why, how sure we are, and what to build instead.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Entry point: what a user can mend becomes one line on stderr and exit status 2."""
    warnings.showwarning = _show_warning
    try:
        status = app(standalone_mode=False)
    except NotReached as error:
        note(f"not reached: {error}")
        sys.exit(3)
    except typer.Abort:
        sys.exit(130)
    except BrokenPipeError:
        # Whoever read the output, such as head, has enough.
        sys.stdout = None
        sys.exit(0)
    except Exception as error:
        note(f"error: {_sentence(error)}")
        sys.exit(2)
    sys.exit(status or 0)


def _sentence(error: Exception) -> str:
    """What to tell of an error; raises it again where it is ours."""
    if isinstance(error, InputError):
        return str(error)
    if hasattr(error, "exit_code"):
        # Typer's own errors of usage
        text, here = error.format_message(), getattr(error, "ctx", None)
        if here is not None and text.startswith("No such option"):
            names = [max(p.opts, key=len) for p in here.command.params if p.opts[0][0] == "-"]
            return f"{text.partition(' (')[0]}; {here.command.name} has: {', '.join(names)}"
        if here is not None and text.startswith("No such command"):
            return f"{text.partition('.')[0]}; there are: {', '.join(here.command.commands)}"
        if isinstance(error.__cause__, ValidationError):
            return f"{text}; it is {error.__cause__.errors()[0]['input']!r}"
        return text
    if (text := trouble(error)) is None:
        raise error
    return text


def _show_warning(message, category, filename, lineno, file=None, line=None) -> None:
    note(f"warning: {message}")


@app.callback(invoke_without_command=True)
def top(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        print(f"foldlab {foldlab.__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())


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
    as_json: Json = False,
) -> None:
    """Train a model on labels; --set passes the model's own settings, as in --set epochs=500."""
    from foldlab.learning.saving import check_target, save_model
    from foldlab.learning.train import train_on

    table, options = read_table(labels), given.read()
    check_target(out, overwrite)
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


def quickstart(
    *,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for labels, maps, models.")] = (
        Path("out/quickstart")
    ),
    workers: Workers = 2,
    seed: Seed = 0,
    given: Given,
    as_json: Json = False,
) -> None:
    """Sample, label, train, compare, map and track; fold, design and map under weight; one page.

    Takes some minutes; --set unit=false, proposals=0 and verify=0 leave the solver out.
    """
    from foldlab.cli.quickstart import Settings, run
    from foldlab.learning.compare import readable
    from foldlab.tracking import ROOT

    chosen = build(Settings, given.read(), seed=seed)
    local = "MLFLOW_TRACKING_URI" not in os.environ
    with only_whole(ROOT) if local else nullcontext(), output_folder(out):
        result = run(chosen, out, say=note, workers=workers)
    emit(result, as_json, readable(result["table"]))


for verb in (
    *(check, label_verbs.sample, label_verbs.label, label_verbs.export, simulate, structure),
    *(train, score, predict, map_, augment, tune, design, materials, quickstart),
):
    app.command(verb.__name__.rstrip("_"))(with_records(verb))


if __name__ == "__main__":
    main()
