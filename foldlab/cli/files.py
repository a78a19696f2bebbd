"""The option ``--files`` of the verbs ``check`` and ``design``: a folder to make a unit by."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from foldlab.terminal import note

if TYPE_CHECKING:
    from foldlab.labels.run import Run
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.sized import Sized

Files = Annotated[
    Path | None,
    typer.Option(
        "--files",
        help="New folder for files to make the unit: drawing, DXF, STEP, STL, FOLD, report.",
    ),
]


def make(
    folder: Path,
    unit: Sized,
    source: SolverSource,
    answer: Mapping[str, Any],
    told: Mapping[str, Any],
    run: Run | None,
    picture: Path | None = None,
) -> dict[str, Any]:
    """Writes a unit's files into a folder that is there; their names, and why some are missing."""
    from foldlab.making.folder import FILES, Dossier, write

    missing = write(folder, Dossier(unit, answer, told, source, run, picture))
    for name, why in missing.items():
        note(f"warning: no {name}: {why}")
    return {"files": [name for name in FILES if name not in missing], "missing": missing}
