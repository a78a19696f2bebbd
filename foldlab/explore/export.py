"""What is known of a design, as one ZIP: numbers, figures, and files to make it."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foldlab.explore.asked import Asked

if TYPE_CHECKING:
    from foldlab.labels.label import Label
    from foldlab.labels.run import Run
    from foldlab.labels.solver import SolverSource

READ_ME = """\
result.json   the solver's label, and m1 … m4 of every state; stresses over E_s, lengths over l_s
design.json   the design, as groups and, where its size is known, in SI units
curves.npz, series/   the path: curves of the sheet, and the whole unit for ParaView
*.png         shapes, angle over contraction, strain
make/         drawing, DXF, STEP, STL, FOLD, report; only where materials and sizes are known
"""


def zipped(
    what: Asked, source: SolverSource, run: Run, label: Label, tell: Callable[[str], None]
) -> bytes:
    """A ZIP with the files that its READ_ME.txt names; written beside nothing of the user's."""
    from foldlab.unit.record import draw, summary, write_json, write_path

    with tempfile.TemporaryDirectory(prefix="foldlab-") as folder:
        out = Path(folder)
        (out / "READ_ME.txt").write_text(READ_ME, encoding="utf-8")
        result = summary(label, run, source)
        write_json(out / "result.json", {**result, "label": asdict(label), "path": run.history})
        write_json(out / "design.json", _design(what))
        if run.shapes:
            tell("drawing figures")
            write_path(out, run)
            draw(out, label, run, source, animate=False)
        if what.unit is not None:
            tell("writing files to make it")
            _make(out, what, source, run, label)
        return _zip(out)


def _design(what: Asked) -> dict[str, Any]:
    unit = what.unit
    return {
        "format": "foldlab design 1",
        "groups": dict(what.groups),
        "physical": None if unit is None else dict(unit.physical),
        "materials": None if unit is None else dict(unit.materials),
    }


def _make(out: Path, what: Asked, source: SolverSource, run: Run, label: Label) -> None:
    from foldlab.making.folder import Dossier, write
    from foldlab.unit.check import by_rod
    from foldlab.unit.told import afterwards, beforehand, readable

    (out / "make").mkdir()
    answer = beforehand(what.unit, source, by_rod(what.unit, source))
    answer |= afterwards(what.unit, source, run, label) | {"files": []}
    told = readable(answer, what.unit)
    picture = out / "shapes.png"
    write(
        out / "make",
        Dossier(what.unit, answer, told, source, run, picture if picture.exists() else None),
    )


def _zip(folder: Path) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, path.relative_to(folder))
    return content.getvalue()
