"""The verbs ``check`` (will my unit fold, and what shall I change?) and ``materials``."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from foldlab.cli.outputs import Files, make, new_folder, output_folder
from foldlab.errors import InputError
from foldlab.quantities import in_si, numbers
from foldlab.terminal import Given, Json, NotReached, emit, note

if TYPE_CHECKING:
    from foldlab.labels.label import Label
    from foldlab.labels.run import Run
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.check import Change
    from foldlab.unit.sized import Sized

# SI units as a maker reads them, and how many of them make one.
SHOWN = {"m": ("mm", 1e3), "Pa": ("MPa", 1e-6), "kg/m³": ("kg/m³", 1.0), "1": ("", 1.0)}
DEGREES = 57.29577951308232


def _angle(text: str) -> float:
    return in_si("need", text, "rad")


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

        return sized(given, read_materials(self.materials), self.passive, self.active)

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
            run, label = source.follow(unit.groups)
            answer |= _solved(unit, source, run, label, out, pictures=not no_pictures)
            if label.foldable is False and first is not None:
                answer["change"] = _told(confirmed(unit, source), unit)
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


def beforehand(unit: Sized, source: SolverSource, first: Label | None) -> dict[str, Any]:
    """What is known of a unit before the solver is asked; ``first``: the rod's answer."""
    from foldlab.unit.check import holds, uncertainty

    return {
        "materials": dict(unit.materials),
        "physical": dict(unit.physical),
        "design": dict(unit.groups),
        "rod": None if first is None else {"foldable": first.foldable, "reason": first.reason},
        "over_materials": uncertainty(unit, source),
        "holds": holds(unit, source),
    }


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


def afterwards(unit: Sized, source: SolverSource, run: Run, label: Label) -> dict[str, Any]:
    """What the solver says of a unit."""
    from foldlab.unit.check import strained
    from foldlab.unit.record import summary

    result = summary(label, run, source)
    kept = (
        "foldable", "fold_angle", "need", "error_m1", "reason", "outcome", "stable", "topples",
        "events", "core_seconds",
    )  # fmt: skip
    return {
        **{name: result[name] for name in kept},
        "confirmed": True,
        "strain": strained(unit, label.evidence),
        "change": None,
    }


def _told(change: Change | None, unit: Sized) -> dict[str, Any] | None:
    if change is None or change.label is None:
        return None
    return {
        "quantity": change.quantity,
        "from": unit.physical[change.quantity],
        "to": change.value,
        "fold_angle": change.label.evidence["m1"],
        "reason": change.label.reason,
    }


def _first(label: Label | None, quick: bool) -> str:
    if label is None:
        asked = "" if quick else "; the solver is asked …"
        return f"first answer: none, for a rod does not know such units{asked}"
    angle = label.evidence.get("m1")
    turned = "" if angle is None else f" ({angle * DEGREES:.0f}°)"
    return f"first answer, of a rod: {label.reason}{turned}"


def _quickly(answer: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "folds": _yes(answer["foldable"]),
        "angle": _degrees(answer["fold_angle"]),
        "over the materials": _over(answer["over_materials"]),
        "it stays so for": _holds(answer["holds"]),
        "confirmed": "no, the rod's answer only",
    }


def readable(answer: Mapping[str, Any], unit: Sized) -> dict[str, Any]:
    """The answer in a maker's words and units."""
    error = answer["error_m1"]
    sure = "" if error is None else f" ± {_number(float(f'{error * DEGREES:.1g}'))}°"
    angle = f"{_degrees(answer['fold_angle'])}{sure}"
    if abs(answer["fold_angle"] or 0.0) > np.pi:
        angle += " (panels meet at about 180° and pass through each other here)"
    change = answer["change"]
    if change is not None:
        change = (
            f"{change['quantity']} from {_shown(change['quantity'], change['from'])} to "
            f"{_shown(change['quantity'], change['to'])}: it then folds by "
            f"{_degrees(change['fold_angle'])}, by the solver"
        )
    elif answer["foldable"] is False:
        change = "no change of one quantity was confirmed to help"
    else:
        change = "nothing"
    return {
        "folds": _yes(answer["foldable"]),
        "angle": f"{angle}, {_degrees(answer['need'])} count as folded",
        "why": answer["reason"],
        "stable": _yes(answer["stable"]),
        "tips over": _yes(answer["topples"]),
        "strain": _strain(answer["strain"]),
        "over the materials": _over(answer["over_materials"]),
        "it stays so for": _holds(answer["holds"]),
        "to change": change,
        "core_seconds": answer["core_seconds"],
        "files": ", ".join(answer["files"]),
        **({"to make it": answer["made"]["folder"]} if "made" in answer else {}),
    }


def _yes(value: bool | None) -> str:
    return {True: "yes", False: "no", None: "unknown"}[value]


def _degrees(angle: float | None) -> str:
    # Below a twentieth of a degree lies what no sheet shows.
    return "–" if angle is None else f"{0.0 if abs(angle) < 9e-4 else angle * DEGREES:.3g}°"


def _strain(rows: Mapping[str, Mapping[str, Any]]) -> str:
    told = []
    for layer, row in rows.items():
        text = f"{layer} {100 * row['peak']:.2g} %"
        if row["says"] is not None:
            low, high = _number(100 * row["low"]), _number(100 * row["high"])
            text += f" ({row['says']}: its limit is {low} to {high} %)"
        told.append(text)
    return ", ".join(told) or "–"


def _over(answer: Mapping[str, Any] | None) -> str:
    if answer is None:
        return "–"
    names = ", ".join(
        f"{name} {_shown(name, low)} to {_shown(name, high)}"
        for name, (low, high) in answer["ranges"].items()
    )
    formula = f" ({answer['by_formula']} by beam formulas)" if answer["by_formula"] else ""
    return (
        f"{100 * answer['folds']:.0f} % of {answer['draws']} units fold by the rod{formula}, "
        f"90 % of all turn by {_degrees(answer['angle_low'])} to "
        f"{_degrees(answer['angle_high'])} ({names})"
    )


def _holds(answer: Mapping[str, Any] | None) -> str:
    if answer is None:
        return "–"
    told = []
    for name, (low, high) in answer.items():
        if low is not None and high is not None:
            told.append(f"{name} {_shown(name, low)} to {_shown(name, high)}")
        elif low is not None:
            told.append(f"{name} above {_shown(name, low)}")
        elif high is not None:
            told.append(f"{name} below {_shown(name, high)}")
    return f"{', '.join(told) or 'any change of one quantity'} (each alone, by the rod)"


def _shown(name: str, value: float) -> str:
    from foldlab.design import PHYSICAL

    unit, factor = SHOWN[PHYSICAL[name]]
    if name == "contraction":
        return f"{_number(100 * value)} %"
    return f"{_number(value * factor)} {unit}"


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
    return _number(low) if low == high else f"{_number(low)} to {_number(high)}"


def _number(value: float) -> str:
    """Three digits, and no power of ten where it can be helped."""
    return f"{float(f'{value:.3g}'):g}"
