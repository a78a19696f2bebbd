"""The verb ``design``: proposals for a wish."""

from __future__ import annotations

import tempfile
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from foldlab.cli.check import afterwards, beforehand, readable
from foldlab.cli.files import Files, make
from foldlab.cli.outputs import new_folder
from foldlab.design import space_named
from foldlab.errors import InputError
from foldlab.quantities import numbers
from foldlab.terminal import Given, Json, NotReached, Seed, Space, emit, err, note

if TYPE_CHECKING:
    from foldlab.inverse.answer import Answer
    from foldlab.inverse.wish import Wish
    from foldlab.unit.sized import Sized


@dataclass(frozen=True)
class Aim:
    """What the designs shall do."""

    want: Annotated[str, typer.Option(help="foldable, flat, or angle.")] = "foldable"
    angle: Annotated[float | None, typer.Option(help="Wanted fold angle in rad.")] = None
    tolerance: Annotated[float, typer.Option(help="Tolerance of the angle in rad.")] = 0.05

    def read(self) -> Any:
        """As a :class:`foldlab.inverse.wish.Wish` takes it."""
        from foldlab.inverse.wish import Angle

        if (self.want == "angle") != (self.angle is not None):
            raise InputError("--want angle and --angle RAD go together")
        return self.want if self.angle is None else Angle(self.angle, self.tolerance)


@dataclass(frozen=True)
class Limits:
    """What the designs may be."""

    ranges: Annotated[
        list[str] | None,
        typer.Option("--range", metavar="NAME=LOW:HIGH", help="Group or SI quantity in a range."),
    ] = None
    passive: Annotated[list[str] | None, typer.Option(help="Passive material(s).")] = None
    active: Annotated[list[str] | None, typer.Option(help="Active material(s).")] = None
    materials: Annotated[Path | None, typer.Option(help="CSV of materials.")] = None
    max_mass: Annotated[float | None, typer.Option(help="kg")] = None
    max_length: Annotated[float | None, typer.Option(help="m")] = None
    max_width: Annotated[float | None, typer.Option(help="m")] = None
    max_thickness: Annotated[float | None, typer.Option(help="m")] = None
    margin: Annotated[
        float | None, typer.Option(help="Half-width of the box, fraction of the bounds.")
    ] = None

    def read(self) -> dict[str, Any]:
        """As a :class:`foldlab.inverse.wish.Wish` takes them."""
        return asdict(self) | {
            "ranges": _ranges(self.ranges or ()),
            "passive": tuple(self.passive or ()),
            "active": tuple(self.active or ()),
        }


@dataclass(frozen=True)
class Judges:
    """Who predicts, and who confirms."""

    model: Annotated[
        Path | None, typer.Option(help="Trained model; without one a network is trained.")
    ] = None
    source: Annotated[str, typer.Option("--source", help="Label source.")] = "timoshenko"
    confirm: Annotated[bool, typer.Option("--confirm", help="Ask the source to confirm.")] = False

    def classifier(self, maker, space: str, seed: int):
        """The model, trained on labels of the source ``maker`` where none is given."""
        from foldlab.learning.saving import load_model
        from foldlab.learning.train import default_classifier

        if self.model is None:
            err.print("no --model given: training a network on 6000 labels …")
            return default_classifier(maker, seed=seed)
        classifier, card = load_model(self.model)
        if card["space"] != space:
            raise InputError(
                f"{self.model} was trained on the {card['space']} space; "
                f"give --space {card['space']}"
            )
        return classifier


def design(
    *,
    n: Annotated[int, typer.Option("-n", min=1, help="Number of proposals.")] = 5,
    aim: Aim,
    space: Space = "reduced",
    given: Given,
    limits: Limits,
    judges: Judges,
    files: Files = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Propose designs for a wish; --set fixes a group or an SI quantity."""
    from foldlab.inverse import propose as inverse
    from foldlab.inverse.answer import rows
    from foldlab.inverse.confirm import confirm
    from foldlab.inverse.wish import Wish
    from foldlab.labels.solver import make_source

    chosen = space_named(space)
    want, fixed = aim.read(), numbers(given.read())
    wish = Wish(chosen, want=want, fixed=fixed, **limits.read())
    maker = make_source(judges.source, space=chosen)
    by_angle = aim.angle is not None
    if by_angle and not hasattr(maker, "evaluate"):
        raise InputError(
            f"--want angle asks for thousands of angles, and --source {judges.source} gives one at "
            "a time; propose with --source timoshenko, and ask `foldlab check` of what you take"
        )
    if files is not None:
        _need_sizes(wish)
    with nullcontext() if files is None else new_folder(files) as draft:
        answer = inverse.propose(
            wish,
            None if by_angle else judges.classifier(maker, space, seed),
            n,
            seed=seed,
            angle_model=maker if by_angle else None,
        )
        if judges.confirm:
            answer = confirm(answer, maker, seed=seed)
        # What Timoshenko's formula says of a unit holds where it weighs nothing.
        heavy = getattr(getattr(maker, "conditions", None), "heavy", False)
        result = {**answer.as_dict(), "weightless": not heavy}
        if draft is not None:
            result["made"] = {"folder": str(files), "units": _make(draft, answer)}
    emit(result, as_json, rows(answer))
    if not answer.complete:
        raise NotReached(answer.reason)


def _need_sizes(wish: Wish) -> None:
    """Raises :class:`InputError` for a wish that leaves sizes or materials of its designs open, or
    their scale to the search, which knows of none that is too large to make."""
    import numpy as np

    from foldlab.inverse.wish import limits_of, quantities_of
    from foldlab.making.geometry import QUANTITIES
    from foldlab.materials import read_materials
    from foldlab.unit.sized import missing

    table = read_materials(wish.materials) if wish.passive or wish.active else None
    for pair in wish.pairs:
        names = sorted({name for limit in limits_of(wish, pair, table) for name in limit.powers})
        known = quantities_of(np.zeros((1, len(names))), names)
        if absent := missing(dict.fromkeys(known.columns, 1.0)):
            raise InputError(
                f"--files needs the size and the materials of a unit, and the wish leaves "
                f"{', '.join(absent)} open; add --set {absent[0]}=… or --range, or materials "
                "(--passive, --active)"
            )
    limited = {*wish.fixed, *wish.ranges}
    sizes = (wish.max_length, wish.max_width, wish.max_thickness, wish.max_mass)
    scales = {
        "l_s": bool(limited & set(QUANTITIES.values())) or any(s is not None for s in sizes),
        "E_s": bool(limited & {"E_s", "E_i"}) or bool(wish.passive or wish.active),
        "rho_s": bool(limited & {"rho_s", "rho_i"}) or bool(wish.passive or wish.active),
    }
    for name, known in scales.items():
        if not known:
            raise InputError(
                f"--files needs a scale, and nothing in the wish limits {name}; add --set {name}=… "
                "or " + ("--max-length" if name == "l_s" else "materials (--passive, --active)")
            )


def _make(folder: Path, answer: Answer) -> list[dict[str, Any]]:
    """Solves each proposal as the verb check does, and writes its files into a folder of its
    number; what the solver said of each, and its files."""
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.check import by_rod
    from foldlab.unit.record import draw, write_path

    source, out = SolverSource(), []
    for number, proposal in enumerate(answer.proposals, start=1):
        unit = _unit(answer.wish, proposal)
        run, label = source.follow(unit.groups)
        said = beforehand(unit, source, by_rod(unit, source))
        said |= afterwards(unit, source, run, label)
        note(f"{number} of {len(answer.proposals)}, by the solver under its weight: {label.reason}")
        own = folder / str(number)
        own.mkdir()
        with tempfile.TemporaryDirectory() as pictures:
            if run.shapes:
                write_path(Path(pictures), run)
                draw(Path(pictures), label, run, source, animate=False)
            told = readable(said | {"files": []}, unit)
            del told["to change"]  # nothing was tried
            made = make(own, unit, source, said, told, run, Path(pictures) / "shapes.png")
        kept = ("foldable", "fold_angle", "reason", "topples", "core_seconds")
        out.append({"folder": str(number), **{k: said[k] for k in kept}, **made})
    return out


def _unit(wish: Wish, proposal) -> Sized:
    """A proposal in SI units; of its materials the ranges that the wish left open."""
    from foldlab.materials import read_materials
    from foldlab.unit.sized import OF_MATERIAL, sized

    table = read_materials(wish.materials)
    unit = sized(proposal.physical, table, *proposal.materials)
    # A stimulus is chosen with the design; E and rho are what the material turns out to have.
    left = {
        quantity
        for role, name in zip(OF_MATERIAL, proposal.materials, strict=True)
        for quantity in OF_MATERIAL[role]
        if name is not None and quantity not in (*wish.fixed, "contraction")
    }
    given = {k: v for k, v in proposal.physical.items() if k not in left}
    return replace(unit, ranges=sized(given, table, *proposal.materials).ranges)


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
