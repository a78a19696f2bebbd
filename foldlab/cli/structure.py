"""The verb ``structure``: a crease pattern of materials, folded under its weight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from foldlab.cli.check import Made, Need
from foldlab.cli.outputs import output_folder
from foldlab.errors import InputError
from foldlab.packaged import needed_for
from foldlab.quantities import in_si, numbers
from foldlab.terminal import Given, Json, NotReached, emit, note
from foldlab.unit.told import DEGREES

if TYPE_CHECKING:
    from foldlab.structure.answer import Answer
    from foldlab.unit.sized import Sized

EFFECTS = ("gravity", "ground", "contact")
LONGER = 5.0  # times the timeout of rigid panels, that a solid's path may take


@dataclass(frozen=True)
class Folded:
    """What acts, and how well it is solved."""

    effects: Annotated[
        str, typer.Option(help="Of gravity,ground and contact (of panels); or none.")
    ] = ",".join(EFFECTS)
    need: Need = None
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Hinges by their section alone; the solver isn't asked."),
    ] = False
    solid: Annotated[
        bool,
        typer.Option("--solid", help="Then as a solid, whose panels bend, and whose word counts."),
    ] = False
    accuracy: Annotated[
        float, typer.Option(help="Wanted relative error of each kind of hinge's label.")
    ] = 0.02
    timeout: Annotated[
        float,
        typer.Option(
            help="Core-seconds for the path and each hinge's label; five times for solids."
        ),
    ] = 60.0

    def acting(self) -> tuple[str, ...]:
        """Names of the effects."""
        names = [name.strip() for name in self.effects.split(",") if name.strip()]
        names = [] if names == ["none"] else names
        if unknown := [name for name in names if name not in EFFECTS]:
            raise InputError(
                f"--effects {unknown[0]!r}; expected some of {', '.join(EFFECTS)}, or none"
            )
        return tuple(names)


def structure(
    pattern: Annotated[
        Path, typer.Argument(help="Crease pattern: .fold, .svg, or a shipped one, such as cube.")
    ],
    *,
    given: Given,
    made: Made,
    folded: Folded,
    animate: Annotated[bool, typer.Option("--gif", help="An animation too.")] = False,
    no_pictures: Annotated[bool, typer.Option("--no-pictures", help="Numbers only.")] = False,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for results.")] = (
        Path("out/structure")
    ),
    as_json: Json = False,
) -> None:
    """Does a sheet with many hinges fold under its weight, and which hinge fails, and why?

    Panels are rigid here, hinges bend as the solver says of a unit with the same hinge; --solid
    also solves the whole sheet, whose panels sag and twist. --set gives h_s, h_i, contraction, l_i
    (the hinges' length along the sheet), size (the flat sheet's largest extent, where the file has
    no unit) and, where no material says them, E_s, rho_s, E_i, rho_i.
    """
    with needed_for("a structure"):
        import_contact()
    from foldlab.structure.answer import answer as judge
    from foldlab.structure.laws import from_labels

    if folded.solid:
        from foldlab.structure.solid import import_gmsh

        try:
            import_gmsh()
        except ImportError as error:
            raise InputError(str(error)) from None
    effects = folded.acting()
    unit, body = _read(pattern, given.read(), made)
    with output_folder(out):
        laws: list[dict[str, float]] = []
        if not folded.quick:
            note("hinges by the solver …")
            body, laws = from_labels(body, accuracy=folded.accuracy, timeout=folded.timeout)
        try:
            result = judge(
                body,
                effects,
                need=folded.need,
                timeout=folded.timeout,
                tell=note,
            )
        except ValueError as error:
            raise InputError(str(error)) from None
        told = summary(result, unit, laws)
        if folded.solid:
            told |= confirmed(body, effects, folded, told, out, pictures=not no_pictures)
        told["files"] = write(out, result, told, pictures=not no_pictures, animate=animate)
    if as_json:
        emit(told, True)
    else:
        emit(readable(told), False, rows(told))
    if told["foldable"] is None:
        raise NotReached(f"{told['reason']}; what there is is in {out}")


def import_contact() -> None:
    """Raises ModuleNotFoundError where the libraries of structures are not installed."""
    import ipctk  # noqa: F401
    import shapely  # noqa: F401


def confirmed(
    body: Any,
    effects: tuple[str, ...],
    folded: Folded,
    told: dict[str, Any],
    out: Path,
    *,
    pictures: bool,
) -> dict[str, Any]:
    """What the solid says, for the answer; its last state is written to ``out``."""
    from foldlab.plots import save_figure
    from foldlab.structure.pictures import plot_solid
    from foldlab.structure.solid import save_solid, solid

    # A path of a solid takes more than one of rigid panels.
    timeout = LONGER * folded.timeout
    result = solid(body, effects, need=folded.need, timeout=timeout, tell=note)
    for k, hinge in enumerate(told["hinges"]):
        hinge["solid"] = None if result.angles is None else float(result.angles[k])
        hinge["solid_error"] = None if result.error is None else float(result.error[k])
    if result.folding.states:
        save_solid(result.folding, out / "solid.vtu")
        if pictures:
            save_figure(plot_solid(result.folding), out / "solid.png")
    return {
        "foldable": result.foldable,
        "reason": f"as a solid: {result.reason} (rigid panels: {told['reason']})",
        "solid": result.row(),
    }


def _read(path: Path, given: dict[str, Any], made: Made) -> tuple[Sized, Any]:
    from foldlab.structure.files import read_pattern
    from foldlab.structure.made import structure_of

    size = None
    if "size" in given:
        size = in_si("size", given.pop("size"), "m")
        if size <= 0:
            raise InputError(f"size = {size:g}; expected a length above 0, such as 100mm")
    return structure_of(read_pattern(path), numbers(given), made.unit, size)


def summary(result: Answer, unit: Sized, laws: list[dict[str, float]]) -> dict[str, Any]:
    """What ``--json`` prints."""
    strain = result.evidence.get("strain")
    bears = {
        layer: None if strain is None else _bears(strain[layer], limits)
        for layer, limits in unit.strain.items()
    }
    return {
        "foldable": result.foldable,
        "reason": result.reason,
        "hinges": result.hinges,
        **result.evidence,
        "bears": bears,
        "laws": laws,
    }


def _bears(strain: float, limits: tuple[float, float]) -> bool | None:
    low, high = limits
    return True if strain <= low else False if strain > high else None


def write(
    out: Path, result: Answer, told: Mapping[str, Any], *, pictures: bool, animate: bool
) -> list[str]:
    """Files of the answer in ``out``, by name."""
    from foldlab.plots import save_figure
    from foldlab.structure import pictures as drawing
    from foldlab.structure.files import write_fold
    from foldlab.unit.record import write_json

    files = ["result.json"]
    files += [name for name in ("solid.vtu", "solid.png") if (out / name).exists()]
    folding = result.folding
    if folding.states:
        pattern = folding.model.structure.pattern
        write_fold(pattern, folding.states, out / "folded.fold")
        drawing.save_series(folding, out / "series")
        files += ["folded.fold", "series/structure.pvd"]
        if pictures:
            save_figure(drawing.plot_states(folding), out / "states.png")
            save_figure(drawing.plot_angles(folding), out / "angles.png")
            files += ["states.png", "angles.png"]
        if animate:
            drawing.save_gif(folding, out / "fold.gif")
            files.append("fold.gif")
    write_json(out / "result.json", dict(told))
    return [str(out / name) for name in files]


def rows(told: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A table of hinges of one kind and answer: how many, and their angles in degrees."""
    groups: dict[tuple, list[dict]] = {}
    for hinge in told["hinges"]:
        key = hinge["fold"], round(hinge["natural"], 6), hinge["folds"], hinge["why"]
        groups.setdefault(key, []).append(hinge)
    return [
        {
            "hinges": len(some),
            "fold": fold,
            "angle": _span([h["angle"] * DEGREES for h in some]),
            **_solid(some),
            "alone": f"{natural * DEGREES:.1f}°",
            "folds": {True: "yes", False: "no", None: "–"}[folds],
            "why not": why,
        }
        for (fold, natural, folds, why), some in groups.items()
    ]


def _solid(hinges: list[dict]) -> dict[str, str]:
    """The column of the solid's angles, where there are some."""
    angles = [h["solid"] for h in hinges if h.get("solid") is not None]
    if not angles:
        return {}
    errors = [h["solid_error"] for h in hinges if h["solid_error"] is not None]
    off = f" ± {max(errors) * DEGREES:.1g}°" if errors else ""
    return {"as a solid": _span([angle * DEGREES for angle in angles]) + off}


def _span(values: list[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.1f}°" if high - low < 0.1 else f"{low:.1f}° to {high:.1f}°"


def readable(told: Mapping[str, Any]) -> dict[str, Any]:
    """The answer in words."""
    strain, out = told.get("strain"), {"answer": told["reason"]}
    if strain is not None:
        words = {True: "borne", False: "more than it bears", None: "at which it may break"}
        for layer, name in (("passive", "sheet"), ("active", "active layer")):
            limit = f", {words[told['bears'][layer]]}" if layer in told["bears"] else ""
            out[f"strain of the {name}"] = f"{100 * strain[layer]:.2g} %{limit}"
        out["stands"] = {True: "yes", False: "no", None: "not known"}[told["stable"]]
        if told["clearance"] is not None and np.isfinite(told["clearance"]):
            out["panels"] = "touch"
    out["mass"] = f"{1e3 * told['mass']:.3g} g"
    labels = sum(law["core_seconds"] for law in told["laws"])
    whole = told["solid"]["core_seconds"] if "solid" in told else 0.0
    out["took"] = (
        f"{told['core_seconds'] + labels + whole:.2g} core-seconds, {labels:.2g} for the hinges"
    )
    if whole:
        out["took"] += f", {whole:.2g} as a solid"
    out["files"] = ", ".join(told["files"])
    return out
