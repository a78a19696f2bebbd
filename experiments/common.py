"""What every experiment shares: the command line and the tracked run.

An experiment is a module with a frozen dataclass ``Config`` (with a ``seed``), an instance ``TINY``
that the tests run, and ``run(config, tracker) -> dict`` of plain results.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from foldlab.settings import build, read_settings
from foldlab.tables import replace_file
from foldlab.terminal import emit, plain
from foldlab.tracking import Run, track

OUT = Path("out")


def execute(name: str, run: Callable[[Any, Run], dict], config: Any) -> dict[str, Any]:
    """Run an experiment inside an MLflow run; its numbers become metrics."""
    with track(name, dataclasses.asdict(config), seed=config.seed) as tracker:
        result = plain(run(config, tracker))
        tracker.metrics(result)
    return result


def save_figure(figure, name: str) -> Path:
    """Write ``out/NAME.png`` (a folder that git ignores)."""
    OUT.mkdir(exist_ok=True)
    path = OUT / f"{name}.png"
    replace_file(path, lambda temporary: figure.savefig(temporary, dpi=150))
    return path


def main(module_doc: str, run: Callable, config_class: type, tiny: Any) -> None:
    """``python -m experiments.NAME [--json] [--tiny] [--set name=value …] [--config FILE]``."""
    name = Path(sys.argv[0]).stem
    parser = argparse.ArgumentParser(prog=f"python -m experiments.{name}", description=module_doc)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--tiny", action="store_true", help="the small version that the tests run")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--config", type=Path, help="TOML file of settings")
    args = parser.parse_args()
    try:
        settings = read_settings(args.set, args.config)
        result = execute(name, run, configured(config_class, settings, tiny if args.tiny else None))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    tell(result, args.json)


def configured(config_class: type, settings: dict[str, Any], tiny: Any = None) -> Any:
    """The configuration of ``settings``; those that are missing are ``tiny``'s, or the defaults."""
    return build(config_class, {**(dataclasses.asdict(tiny) if tiny else {}), **settings})


def tell(result: dict[str, Any], as_json: bool) -> None:
    """Print what :func:`execute` gave: one JSON object, or its table and its numbers."""
    if as_json:
        print(json.dumps(result, allow_nan=False))
    else:
        emit({k: v for k, v in result.items() if k != "table"}, False, result.get("table"))


def counted(known: pd.DataFrame) -> np.ndarray:
    """(n,): which labels count in a statistic; those of the hypercube where the table tells them
    from those near the boundary, else all."""
    cube = (known["drawn"] == "hypercube").to_numpy() if "drawn" in known else np.zeros(0, bool)
    return cube if cube.any() else np.ones(len(known), bool)
