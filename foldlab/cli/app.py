"""The command line: one verb per step of the workbench.

Results go to stdout (``--json``: one JSON object), progress and messages to stderr. Exit status 0:
done; 2: bad input, nothing written; 3: ran but could not reach the result.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Annotated

import typer

from foldlab.cli import label_verbs
from foldlab.cli.simulate import simulate
from foldlab.design import space_named, space_of
from foldlab.errors import InputError
from foldlab.settings import build, numbers, read_settings
from foldlab.tables import read_table, write_table
from foldlab.terminal import Config, Json, NotReached, Seed, Sets, Space, Workers, emit, err

# Heavy imports (torch, MLflow, Matplotlib) stay inside the verbs, so that --help answers at once.

app = typer.Typer(
    name="foldlab",
    help="Which self-folding units fold, why, how sure we are, and what to build instead.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Entry point: turns :class:`InputError` into one line on stderr and exit status 2."""
    warnings.showwarning = _show_warning
    try:
        status = app(standalone_mode=False)
    except InputError as error:
        err.print(f"error: {error}", markup=False, highlight=False)
        sys.exit(2)
    except NotReached as error:
        err.print(f"not reached: {error}", markup=False, highlight=False)
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


def _show_warning(message, category, filename, lineno, file=None, line=None) -> None:
    err.print(f"warning: {message}", markup=False, highlight=False)


for verb in (label_verbs.sample, label_verbs.label, label_verbs.export, simulate):
    app.command()(verb)


@app.command()
def train(
    labels: Annotated[Path, typer.Argument(help="Table of labels.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of the model.")],
    model: Annotated[str, typer.Option("--model", help="Which model.")] = "network",
    holdout: Annotated[float, typer.Option(help="Share of labels kept for scoring.")] = 0.2,
    rate: Annotated[
        float | None,
        typer.Option("--false-positive-rate", help="Threshold for this rate, from the hold-out."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a saved model.")] = False,
    seed: Seed = 0,
    settings: Sets = None,
    config: Config = None,
    as_json: Json = False,
) -> None:
    """Train a model on labels; --set passes the model's own settings, as in --set epochs=500."""
    from foldlab.learning.train import train_on

    table = read_table(labels)
    fitted, result = train_on(
        table, model, seed=seed, holdout=holdout, rate=rate,
        options=read_settings(settings or (), config),
    )  # fmt: skip
    from foldlab.learning.saving import save_model

    save_model(fitted, out, result, overwrite=overwrite)
    emit({**result, "folder": out}, as_json)


@app.command()
def score(
    model: Annotated[Path, typer.Argument(help="Folder of a trained model.")],
    labels: Annotated[Path, typer.Argument(help="Table of labels.")],
    as_json: Json = False,
) -> None:
    """Score a trained model on a table of labels; designs of unknown label are left out."""
    from foldlab.learning.saving import load_model
    from foldlab.learning.scoring import score as scores
    from foldlab.learning.train import known_labels

    fitted, card = load_model(model)
    table, unknown = known_labels(read_table(labels), space_named(card["space"]))
    result = scores(fitted, table.drop(columns="foldable"), table["foldable"])
    emit({"model": card["model"], **result, "unknown": unknown}, as_json)


@app.command("map")
def map_(
    model: Annotated[Path, typer.Argument(help="Folder of a trained model.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Picture (.png, .pdf, .svg).")],
    against: Annotated[
        str | None, typer.Option("--against", help="Validate against this label source.")
    ] = None,
    x: Annotated[str, typer.Option(help="Group on the x axis.")] = "E_ratio",
    y: Annotated[str, typer.Option(help="Group on the y axis.")] = "h_ratio",
    slices: Annotated[str, typer.Option("--slice", help="Group that the panels step through.")] = (
        "slenderness"
    ),
    points: Annotated[int, typer.Option(min=1, help="Points in all panels together.")] = 100_000,
    settings: Sets = None,
    config: Config = None,
    as_json: Json = False,
) -> None:
    """Draw a regime map (Figs. 4.28, 4.29); --set fixes the groups that are not on an axis."""
    from foldlab.labels.solver import make_source
    from foldlab.learning.saving import load_model
    from foldlab.maps.plots import plot_regimes
    from foldlab.maps.regimes import regime_map
    from foldlab.plots import save_figure

    fitted, card = load_model(model)
    space = space_named(card["space"])
    regime = regime_map(
        fitted,
        space=space,
        axes=(x, y),
        slice_by=slices,
        fixed=numbers(read_settings(settings or (), config)),
        points=points,
        source=make_source(against, space=space) if against else None,
    )
    save_figure(plot_regimes(regime), out)
    emit({**regime.summary(), "file": out}, as_json)


@app.command()
def augment(
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for curves and picture.")],
    space: Space = "reduced",
    source: Annotated[str, typer.Option("--source", help="Label source.")] = "timoshenko",
    seeds: Annotated[int, typer.Option(min=1, help="Number of seeds.")] = 3,
    target: Annotated[float, typer.Option(help="Accuracy at which labels are compared.")] = 0.99,
    seed: Seed = 0,
    settings: Sets = None,
    config: Config = None,
    as_json: Json = False,
) -> None:
    """Spend labels near the boundary (Algorithm 5) and at random; compare the labels needed."""
    from foldlab.labels.solver import make_source
    from foldlab.learning.augment import Plan, compare_strategies
    from foldlab.learning.plots import plot_learning_curves
    from foldlab.plots import save_figure

    plan = build(Plan, read_settings(settings or (), config))
    _new_folder(out)
    maker = make_source(source, space=space_named(space))
    curves, summary = compare_strategies(
        maker, plan, seeds=range(seed, seed + seeds), target=target,
        progress=None if as_json else err.print,
    )  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    write_table(curves, out / "curves.csv")
    save_figure(plot_learning_curves(curves, target=target, as_error=True), out / "curves.png")
    emit({**summary, "folder": out}, as_json)


@app.command()
def tune(
    labels: Annotated[Path, typer.Argument(help="Table of labels.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder; a study in it is resumed.")],
    trials: Annotated[int, typer.Option(min=1, help="Trials in all.")] = 40,
    workers: Workers = 1,
    seed: Seed = 0,
    settings: Sets = None,
    config: Config = None,
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
    search = build(
        Search, {**read_settings(settings or (), config)}, trials=trials, workers=workers, seed=seed
    )
    out.mkdir(parents=True, exist_ok=True)
    study = run_study(table, space, out / "study.journal", search)
    write_table(study, out / "trials.csv")
    save_figure(plot_study(study), out / "front.png")
    front = study[study["on_front"]].sort_values("seconds").drop(columns="on_front")
    rows = front.to_dict("records")
    emit({"trials": len(study), "front": rows, "folder": out}, as_json, rows)


@app.command()
def design(
    n: Annotated[int, typer.Option("-n", min=1, help="Number of proposals.")] = 5,
    want: Annotated[str, typer.Option(help="foldable, flat, or angle.")] = "foldable",
    angle: Annotated[float | None, typer.Option(help="Wanted fold angle in rad.")] = None,
    tolerance: Annotated[float, typer.Option(help="Tolerance of the angle in rad.")] = 0.05,
    space: Space = "reduced",
    settings: Sets = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option("--range", metavar="NAME=LOW:HIGH", help="Group or SI quantity in a range."),
    ] = None,
    config: Config = None,
    passive: Annotated[list[str] | None, typer.Option(help="Passive material(s).")] = None,
    active: Annotated[list[str] | None, typer.Option(help="Active material(s).")] = None,
    materials: Annotated[Path | None, typer.Option(help="CSV of materials.")] = None,
    max_mass: Annotated[float | None, typer.Option(help="kg")] = None,
    max_length: Annotated[float | None, typer.Option(help="m")] = None,
    max_width: Annotated[float | None, typer.Option(help="m")] = None,
    max_thickness: Annotated[float | None, typer.Option(help="m")] = None,
    margin: Annotated[
        float | None, typer.Option(help="Half-width of the box, share of the bounds.")
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="Trained model; without one a network is trained.")
    ] = None,
    source: Annotated[str, typer.Option("--source", help="Label source.")] = "timoshenko",
    confirm: Annotated[bool, typer.Option("--confirm", help="Ask the source to confirm.")] = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Propose designs for a wish; --set fixes a group or an SI quantity."""
    from foldlab.inverse import propose as inverse
    from foldlab.inverse import wish
    from foldlab.labels.solver import make_source
    from foldlab.learning.saving import load_model
    from foldlab.learning.train import default_classifier

    if (want == "angle") != (angle is not None):
        raise InputError("--want angle and --angle RAD go together")
    chosen = space_named(space)
    wanted = wish.Wish(
        space=chosen,
        want=wish.Angle(angle, tolerance) if angle is not None else want,
        fixed=numbers(read_settings(settings or (), config)),
        ranges=_ranges(ranges or ()),
        passive=tuple(passive or ()),
        active=tuple(active or ()),
        materials=materials,
        max_mass=max_mass,
        max_length=max_length,
        max_width=max_width,
        max_thickness=max_thickness,
        margin=margin,
    )
    maker = make_source(source, space=chosen)
    classifier = angle_model = None
    if angle is not None:
        angle_model = maker
    elif model is not None:
        classifier, card = load_model(model)
        if card["space"] != space:
            raise InputError(
                f"{model} was trained on the {card['space']} space; give --space {card['space']}"
            )
    else:
        err.print("no --model given: training a network on 6000 labels …")
        classifier = default_classifier(maker, seed=seed)
    answer = inverse.propose(wanted, classifier, n, seed=seed, angle_model=angle_model)
    if confirm:
        answer = inverse.confirm(answer, maker, seed=seed)
    emit(answer.as_dict(), as_json, inverse.rows(answer))
    if not answer.complete:
        raise NotReached(answer.reason)


@app.command()
def quickstart(
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for labels, maps, models.")] = (
        Path("out/quickstart")
    ),
    seed: Seed = 0,
    settings: Sets = None,
    config: Config = None,
    as_json: Json = False,
) -> None:
    """Sample, label, train, compare, map and track on the reduced space, in about two minutes."""
    from foldlab.cli.quickstart import Settings, run
    from foldlab.learning.compare import readable

    chosen = build(Settings, read_settings(settings or (), config), seed=seed)
    result = run(chosen, out, say=lambda text: err.print(text, highlight=False))
    emit(result, as_json, readable(result["table"]))


def _ranges(pairs) -> dict[str, tuple[float, float]]:
    out = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        try:
            low, high = (float(part) for part in text.split(":"))
        except ValueError:
            raise InputError(
                f"--range {pair}: expected NAME=LOW:HIGH, as in --range E_ratio=0.1:10"
            ) from None
        out[name.strip()] = (low, high)
    return out


def _new_folder(path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file; give a folder")


if __name__ == "__main__":
    main()
