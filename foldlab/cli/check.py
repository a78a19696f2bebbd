"""The verbs ``check`` (will my unit fold, and what shall I change?) and ``materials``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from foldlab.cli.outputs import Files, make, new_folder, output_folder, tell_slow
from foldlab.errors import InputError
from foldlab.quantities import in_si, numbers
from foldlab.terminal import Given, Json, NotReached, emit, note
from foldlab.unit.told import (
    afterwards,
    beforehand,
    changed,
    degrees,
    holding,
    in_degrees,
    number,
    over,
    readable,
    yes,
)

if TYPE_CHECKING:
    from foldlab.labels.label import Label
    from foldlab.labels.run import Run
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.sized import Sized


def _angle(text: str) -> float:
    angle = in_si("need", text, "rad")
    if angle > 2 * math.pi:
        raise InputError(f"need = {angle:g} rad is more than a full turn; 90 degrees are 90deg")
    return angle


Need = Annotated[
    float | None,
    typer.Option(
        parser=_angle, metavar="ANGLE",
        help="Angle that counts as folded, such as 90deg or 1.57; by default π times the "
        "contraction.",
    ),
]  # fmt: skip


@dataclass(frozen=True)
class Made:
    """What a unit is made of."""

    passive: Annotated[
        str | None, typer.Option(help="Material of the sheet, such as PET; see foldlab materials.")
    ] = None
    active: Annotated[
        str | None, typer.Option(help="Material of the active layer, such as SMP.")
    ] = None
    materials: Annotated[
        Path | None, typer.Option(help="CSV of your own materials, beside the shipped ones.")
    ] = None

    def unit(self, given: Mapping[str, float]) -> Sized:
        """The unit of these materials and of the quantities given."""
        from foldlab.materials import read_materials
        from foldlab.unit.sized import sized

        unit = sized(given, read_materials(self.materials), self.passive, self.active)
        if (length := unit.physical["l_s"]) > 1 and "l_s" in given:
            note(f"l_s is {length:g} m: numbers without a unit are in metres (40mm is 40 mm)")
        return unit

    def asked(self, given: Mapping[str, float]) -> bool:
        """Whether the unit is one in SI units."""
        from foldlab.design import PHYSICAL

        named = any(name in PHYSICAL and name != "contraction" for name in given)
        return named or any(value is not None for value in vars(self).values())


def check(
    *,
    given: Given,
    made: Made,
    growth: Annotated[str, typer.Option(help="Contraction: uniaxial or isotropic.")] = "uniaxial",
    need: Need = None,
    accuracy: Annotated[float, typer.Option(help="Wanted relative error of the angle.")] = 0.02,
    timeout: Annotated[
        float, typer.Option(help="Core-seconds for each answer of the solver.")
    ] = 60.0,
    quick: Annotated[
        bool, typer.Option("--quick", help="The rod's answer only, at once; no files.")
    ] = False,
    no_pictures: Annotated[bool, typer.Option("--no-pictures", help="Numbers only.")] = False,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for results.")] = (
        Path("out/check")
    ),
    files: Files = None,
    as_json: Json = False,
) -> None:
    """Will my unit fold under its weight, how sure is that, and what shall I change?

    --set gives quantities in SI units or with a unit: length l_s, width b_s and thickness h_s of
    the sheet, l_i, b_i, h_i of the active layer, contraction; E_s, rho_s, E_i, rho_i where no
    material says them; strips and strip_share cut the active layer.
    """
    from foldlab.labels.asked import Conditions, Effort
    from foldlab.labels.foldability import Thresholds
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.check import by_rod, confirmed
    from foldlab.unit.record import space_for

    if quick and files is not None:
        raise InputError("--files needs the solver's answer; leave --quick out")
    unit = made.unit(numbers(given.read()))
    source = SolverSource(
        Conditions(growth=growth), Effort(accuracy, timeout, whole=True),
        thresholds=Thresholds(need=need), space=space_for(unit.groups),
    )  # fmt: skip
    source.unit(unit.groups)
    with ExitStack() as stack:
        if not quick:
            stack.enter_context(output_folder(out))
        draft = None if files is None else stack.enter_context(new_folder(files))
        first = by_rod(unit, source)
        note(_first(first, quick))
        answer = beforehand(unit, source, first)
        if not quick:
            tell_slow()
            run, label = source.follow(unit.groups)
            answer |= _solved(unit, source, run, label, out, pictures=not no_pictures)
            if label.foldable is False and first is not None:
                answer["change"] = changed(confirmed(unit, source), unit)
            if draft is not None:
                told = readable(answer, unit)
                answer["made"] = {
                    "folder": str(files),
                    **make(draft, unit, source, answer, told, run, out / "shapes.png"),
                }
            from foldlab.unit.record import write_json

            write_json(out / "result.json", {**answer, "label": asdict(label)})
    if quick:
        foldable = None if first is None else first.foldable
        angle = None if first is None else first.evidence.get("m1")
        answer |= {"foldable": foldable, "fold_angle": angle, "confirmed": False}
        emit(answer if as_json else _quickly(answer), as_json)
        if foldable is None:
            raise NotReached("the rod can't tell; leave --quick out")
        return
    if as_json:
        emit(answer, True)
    else:
        emit(readable(answer, unit), False)
    if label.foldable is None:
        raise NotReached(f"{label.reason}; what there is is in {out}")


def _solved(
    unit: Sized, source: SolverSource, run: Run, label: Label, out: Path, *, pictures: bool
) -> dict[str, Any]:
    """The solver's answer, and its files in ``out``."""
    from foldlab.unit.record import clear, draw, write_path

    clear(out)
    files = ["result.json"]
    if run.shapes:
        files += write_path(out, run)
        if pictures:
            files += draw(out, label, run, source, animate=False)
    return afterwards(unit, source, run, label) | {"files": [str(out / name) for name in files]}


def _first(label: Label | None, quick: bool) -> str:
    if label is None:
        asked = "" if quick else "; the solver is asked …"
        return f"first answer: none, for a rod does not know such units{asked}"
    angle = label.evidence.get("m1")
    reason = in_degrees(label.reason)
    turned = "" if angle is None or degrees(angle) in reason else f" ({degrees(angle)})"
    return f"first answer, of a rod: {reason}{turned}"


def _quickly(answer: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "folds": yes(answer["foldable"]),
        "angle": degrees(answer["fold_angle"]),
        "over the materials": over(answer["over_materials"]),
        "it stays so for": holding(answer["holds"]),
        "confirmed": "no, the rod's answer only",
    }


def materials(
    *,
    path: Annotated[
        Path | None, typer.Option("--materials", help="CSV of your own, beside the shipped ones.")
    ] = None,
    as_json: Json = False,
) -> None:
    """List the materials with the ranges of their properties, and what those rest on."""
    from foldlab.materials import read_materials

    table = read_materials(path)
    rows = [
        {
            "name": name, "also": row["aliases"].replace(";", ", "), "role": row["role"],
            "E, MPa": _range(row, "E", 1e-6), "rho, kg/m³": _range(row, "rho", 1.0),
            "contraction, %": _range(row, "contraction", 100.0),
            "bears, %": _range(row, "strain", 100.0), "basis": row["basis"],
        }
        for name, row in table.iterrows()
    ]  # fmt: skip
    listed = table.reset_index().astype(object).where(table.reset_index().notna(), None)
    emit({"materials": listed.to_dict("records")}, as_json, rows)


def _range(row, name: str, factor: float) -> str:
    low, high = row[f"{name}_low"] * factor, row[f"{name}_high"] * factor
    if low != low:
        return "–"
    return number(low) if low == high else f"{number(low)} to {number(high)}"
