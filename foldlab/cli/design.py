"""The verb ``design``: proposals for a wish."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from foldlab.design import space_named
from foldlab.errors import InputError
from foldlab.quantities import numbers
from foldlab.terminal import Given, Json, NotReached, Seed, Space, emit, err


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
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Propose designs for a wish; --set fixes a group or an SI quantity."""
    from foldlab.inverse import propose as inverse
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
    answer = inverse.propose(
        wish,
        None if by_angle else judges.classifier(maker, space, seed),
        n,
        seed=seed,
        angle_model=maker if by_angle else None,
    )
    if judges.confirm:
        answer = inverse.confirm(answer, maker, seed=seed)
    # What Timoshenko's formula says of a unit holds where it weighs nothing.
    heavy = getattr(getattr(maker, "conditions", None), "heavy", False)
    emit({**answer.as_dict(), "weightless": not heavy}, as_json, inverse.rows(answer))
    if not answer.complete:
        raise NotReached(answer.reason)


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
