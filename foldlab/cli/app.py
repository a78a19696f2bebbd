"""The command line: one verb per step of the workbench.

Results go to stdout (``--json``: one JSON object), progress and messages to stderr. Exit status 0:
done; 2: bad input, nothing written; 3: ran but could not reach the result.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from importlib import import_module
from typing import Annotated

import typer
from typer.core import TyperCommand, TyperGroup

import foldlab
from foldlab.errors import InputError
from foldlab.terminal import NotReached, note, with_records

# Where each verb is (module of foldlab.cli, or another one by its whole name), and the first
# sentence of its help: told before it is imported, so that --help answers at once and a verb loads
# only its own.
UNIT = {
    "check": (
        "check",
        "Will my unit fold under its weight, how sure is that, and what shall I change?",
    ),
    "explore": (
        "foldlab.explore.verb",
        "Set a unit by hand on a page of this machine: verdict at once, map, shapes, files.",
    ),
    "design": (
        "design",
        "Propose designs for a wish, such as an angle, and let the solver confirm them.",
    ),
    "simulate": (
        "simulate",
        "Fold one design on the solver: verdict, curves, a series for ParaView, pictures.",
    ),
    "structure": (
        "structure",
        "Does a sheet with many hinges fold under its weight, and which hinge fails, and why?",
    ),
    "predict": (
        "predict",
        "Predict folding: probability, verdict or don't know, angle, nearest label",
    ),
    "map": ("maps", "Draw what folds, slice by slice, and where a model is wrong."),
    "materials": (
        "check",
        "List the materials with the ranges of their properties, and what those rest on.",
    ),
    "quickstart": (
        "quickstart",
        "Sample, label, train, compare, map and track; fold, design and map under weight",
    ),
}
STUDY = {
    "sample": (
        "label_verbs",
        "Draw designs by Latin hypercube, uniform on each group's own scale.",
    ),
    "label": (
        "label_verbs",
        "Label designs into a store; what the store holds already is not computed again.",
    ),
    "export": ("label_verbs", "Write the labels of a store to one flat table."),
    "train": ("learn", "Train a model on labels"),
    "score": ("learn", "Score a trained model on a table of labels"),
    "augment": (
        "learn",
        "Spend labels near the boundary (Algorithm 5) and at random; compare the labels needed.",
    ),
    "tune": (
        "learn",
        "Search the network's architecture and loss bias: accuracy against training seconds.",
    ),
    "experiment": (
        "label_verbs",
        "Run one of the experiments that the documentation's tables come from, or list them.",
    ),
}
VERBS = UNIT | STUDY


def function_of(verb: str) -> Callable:
    """A verb's function, whose module this imports; ``map`` is Python's own."""
    module, _ = VERBS[verb]
    home = import_module(module if "." in module else f"foldlab.cli.{module}")
    return getattr(home, "map_" if verb == "map" else verb)


class Verbs(TyperGroup):
    """The verbs, each imported when it is called."""

    _listing = False

    def list_commands(self, ctx) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx, cmd_name: str):
        if cmd_name not in VERBS:
            return None
        if self._listing:
            panel = "For a unit" if cmd_name in UNIT else "For a study of many"
            return TyperCommand(cmd_name, help=VERBS[cmd_name][1], rich_help_panel=panel)
        verb = function_of(cmd_name)
        alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        alone.command(cmd_name)(with_records(verb))
        return typer.main.get_command(alone)

    def format_help(self, ctx, formatter) -> None:
        self._listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self._listing = False


app = typer.Typer(
    name="foldlab",
    cls=Verbs,
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
            return f"{text.partition('.')[0]}; there are: {', '.join(VERBS)}"
        if hasattr(error.__cause__, "errors"):  # pydantic's
            return f"{text}; it is {error.__cause__.errors()[0]['input']!r}"
        return text
    if isinstance(error, ImportError):
        from foldlab.packaged import missing

        if (lacking := missing(error)) is not None:
            return str(lacking)
    from foldlab.cli.outputs import trouble

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


if __name__ == "__main__":
    main()
