"""The verb ``design``: proposals for a wish."""

from __future__ import annotations

from contextlib import ExitStack, nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from foldlab.cli.outputs import Files, new_folder
from foldlab.cli.proposed import SHOWN_AS, as_asked, made_of, make_each, need_sizes, told
from foldlab.design import space_named
from foldlab.errors import InputError
from foldlab.quantities import in_si, numbers
from foldlab.terminal import Given, Json, NotReached, Seed, Track, Workers, emit, err, note

if TYPE_CHECKING:
    from foldlab.inverse.answer import Answer
    from foldlab.inverse.wish import Wish


def _in(name: str, unit: str):
    """A parser of an option's text as a quantity, with a unit or in SI."""

    def parsed(text: str) -> float:
        return in_si(f"--{name}", text, unit)

    return parsed


def _option(name: str, unit: str, help: str):
    return typer.Option(parser=_in(name, unit), metavar="QUANTITY", help=help)


@dataclass(frozen=True)
class Aim:
    """What the designs shall do."""

    want: Annotated[str, typer.Option(help="foldable, flat, or angle=90deg.")] = "foldable"
    angle: Annotated[
        float | None, _option("angle", "rad", "Wanted fold angle, such as 90deg or 1.57.")
    ] = None
    tolerance: Annotated[
        float, _option("tolerance", "rad", "Tolerance of the angle, such as 3deg.")
    ] = 0.05

    def read(self) -> Any:
        """As a :class:`foldlab.inverse.wish.Wish` takes it."""
        from foldlab.inverse.wish import Angle

        want, equals, text = self.want.partition("=")
        if want.strip() not in ("foldable", "flat", "angle"):
            raise InputError(f"--want {self.want}: expected foldable, flat or angle=90deg")
        angle = in_si("--want angle", text.strip(), "rad") if equals else self.angle
        if equals and (want.strip() != "angle" or self.angle is not None):
            raise InputError(f"--want {self.want}: expected foldable, flat or angle=90deg, once")
        if (want.strip() == "angle") != (angle is not None):
            raise InputError("--want angle and --angle go together, as in --want angle=90deg")
        return want if angle is None else Angle(angle, self.tolerance)


@dataclass(frozen=True)
class Limits:
    """What the designs may be."""

    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range", metavar="NAME=LOW:HIGH", help="Group or quantity, as in h_s=50um:0.2mm."
        ),
    ] = None
    passive: Annotated[list[str] | None, typer.Option(help="Passive material(s).")] = None
    active: Annotated[list[str] | None, typer.Option(help="Active material(s).")] = None
    materials: Annotated[Path | None, typer.Option(help="CSV of materials.")] = None
    max_mass: Annotated[float | None, _option("max-mass", "kg", "Such as 5g.")] = None
    max_length: Annotated[float | None, _option("max-length", "m", "Such as 40mm.")] = None
    max_width: Annotated[float | None, _option("max-width", "m", "Such as 10mm.")] = None
    max_thickness: Annotated[float | None, _option("max-thickness", "m", "Such as 0.5mm.")] = None
    margin: Annotated[
        float | None, typer.Option(help="Half-width of the box, fraction of the bounds.")
    ] = None

    stands: Annotated[bool, typer.Option("--stands", help="Let go, it must not topple.")] = False
    strain_margin: Annotated[
        float | None,
        _option("strain-margin", "1", "Strain to spare of what the materials bear, such as 20%."),
    ] = None
    touching: Annotated[
        bool | None,
        typer.Option(
            "--panels-touch/--panels-apart",
            help="At the end its panels must, or must not, touch each other; else either will do.",
        ),
    ] = None
    least: Annotated[
        Literal["mass", "cost", "size"] | None,
        typer.Option(help="Of what the unit shall have as little as it may; cost needs prices."),
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
        Path | None,
        typer.Option(
            help="Trained model; without one a network is trained where nothing weighs, and "
            "formulas and a rod propose under weight."
        ),
    ] = None
    source: Annotated[
        str | None,
        typer.Option(
            "--source", help="Label source; by default solver under weight, else timoshenko."
        ),
    ] = None
    confirm: Annotated[
        bool | None,
        typer.Option(
            "--confirm/--no-confirm", help="Ask the source to confirm; done under weight."
        ),
    ] = None
    weightless: Annotated[
        bool, typer.Option("--weightless", help="As if nothing weighed, whatever its scale.")
    ] = False
    timeout: Annotated[float, typer.Option(help="Core-seconds for each answer of the solver.")] = (
        60.0
    )

    def classifier(self, maker, space: str, seed: int):
        """The model, trained on labels of the source ``maker`` where none is given."""
        from foldlab.learning.train import default_classifier

        if self.model is None:
            err.print("no --model given: training a network on 6000 labels …")
            return default_classifier(maker, seed=seed)
        return self.trained(space)

    def trained(self, space: str):
        """The model that was given; raises :class:`InputError` where it is of another space."""
        from foldlab.learning.saving import load_model

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
    space: Annotated[
        str | None,
        typer.Option(
            "--space",
            help="reduced or full; full where the scale is known, else reduced.",
        ),
    ] = None,
    given: Given,
    limits: Limits,
    judges: Judges,
    workers: Workers = 1,
    files: Files = None,
    track: Track = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Propose designs for a wish, such as an angle, and let the solver confirm them.

    --set fixes a group or a quantity, in SI units or with a unit; strips and strip_share cut the
    active layer. Where the scale is known (materials and a length, or stiffness_to_weight) designs
    feel their weight, and the solver confirms each with its tolerances.
    """
    from foldlab.inverse.wish import Wish, scales_of
    from foldlab.labels.sources import make_source
    from foldlab.tracking import asked as tracked

    want, fixed = aim.read(), numbers(given.read())
    said = {**asdict(aim), **asdict(limits), **asdict(judges), **fixed, "n": n}
    log = partial(tracked(track), "design", said, seed=seed)
    wish = Wish(want=want, fixed=fixed, **limits.read())
    if judges.weightless:
        why = ""
    elif "stiffness_to_weight" in {*wish.fixed, *wish.ranges}:
        why = "the wish limits stiffness_to_weight"
    elif all(scales_of(wish).values()):
        why = "the wish says materials and a size"
    else:
        why = "the full space has weight" if space == "full" and judges.source is None else ""
    asked = space == "full" and judges.source in ("solver", "rod") and not judges.weightless
    if not (why or asked):
        _light(n, wish, space or "reduced", judges, files, log, seed, as_json)
        return
    named = judges.source or "solver"
    _refuse(named, space, judges, want, why)
    chosen = space_named("patterned" if wish.patterned else space or "full")
    wish = Wish(chosen, want=want, fixed=fixed, **limits.read())
    settings = {"timeout": judges.timeout} if named == "solver" else {}
    source = as_asked(wish, make_source(named, settings, space=chosen))
    model = None if judges.model is None else judges.trained("full")
    _heavy(n, wish, source, model, judges.confirm is not False, workers, files, log, seed, as_json)


def _refuse(source: str, space: str | None, judges: Judges, want: Any, why: str) -> None:
    """Raises :class:`InputError` for who can't feel the weight that the wish speaks of."""
    cure = "leave it out, or say --weightless"
    if source == "timoshenko":
        raise InputError(f"--source timoshenko knows no weight, and {why}; {cure}")
    if space == "reduced":
        raise InputError(f"--space reduced knows no weight, and {why}; {cure}")
    if judges.model is None:
        return
    if not isinstance(want, str):
        raise InputError(f"--model {judges.model} says no angle; leave it out: a rod proposes")
    from foldlab.learning.saving import read_card

    made = read_card(judges.model)["space"]
    if made != "full":
        raise InputError(
            f"--model {judges.model} was trained on the {made} space and can't feel weight, and "
            f"{why}; {cure}"
        )


def _heavy(n, wish: Wish, source, model, confirm: bool, workers, files, log, seed, as_json) -> None:
    """Designs under their weight."""
    from foldlab.campaign.worker import pool
    from foldlab.inverse.weighted import weighted

    if files is not None:
        need_sizes(wish)
    with ExitStack() as stack:
        draft = None if files is None else stack.enter_context(new_folder(files))
        executor = stack.enter_context(pool(workers)) if workers > 1 and confirm else None
        answer = weighted(
            wish, n, seed=seed, source=source, model=model, confirmed=confirm,
            executor=executor, tell=note,
        )  # fmt: skip
        result = made_of(answer, source)
        if draft is not None:
            result["made"] = {"folder": str(files), "units": make_each(draft, answer)}
    _log(log, result, files)
    if as_json:
        emit(result, True)
    else:
        rows, words = told(answer, result)
        emit(words, False, rows)
        if rows:
            note(SHOWN_AS)
    if not answer.complete:
        raise NotReached(answer.reason)


def _light(n, wish: Wish, space: str, judges: Judges, files, log, seed, as_json) -> None:
    """Designs that weigh nothing."""
    from dataclasses import replace

    from foldlab.inverse import propose as inverse
    from foldlab.inverse.answer import rows
    from foldlab.inverse.confirm import confirm
    from foldlab.labels.sources import make_source

    heavy = (wish.strain_margin, wish.touching, wish.least)
    if wish.stands or wish.patterned or any(asked is not None for asked in heavy):
        raise InputError(
            "--stands, --strain-margin, --panels-touch, --panels-apart, --least and strips are for "
            "units whose weight is known; give materials and a size, and no --weightless"
        )
    chosen = space_named(space)
    wish = replace(wish, space=chosen)
    named = judges.source or "timoshenko"
    settings = {} if named == "timoshenko" else {"effects": "none"}
    maker = make_source(named, settings, space=chosen)
    by_angle = not isinstance(wish.want, str)
    if by_angle and not hasattr(maker, "evaluate"):
        raise InputError(
            f"--want angle asks for thousands of angles, and --source {named} gives one at "
            "a time; propose with --source timoshenko, and ask `foldlab check` of what you take"
        )
    if judges.model is None and not hasattr(maker, "evaluate"):
        raise InputError(
            f"a network is trained on thousands of labels, and --source {named} gives one at a "
            "time; give a --model, or propose with --source timoshenko"
        )
    if files is not None:
        need_sizes(wish)
    with nullcontext() if files is None else new_folder(files) as draft:
        answer: Answer = inverse.propose(
            wish,
            None if by_angle else judges.classifier(maker, space, seed),
            n,
            seed=seed,
            angle_model=maker if by_angle else None,
        )
        if judges.confirm:
            answer = confirm(answer, maker, seed=seed)
        result = {**answer.as_dict(), "weightless": True}
        if draft is not None:
            result["made"] = {"folder": str(files), "units": make_each(draft, answer)}
    _log(log, result, files)
    emit(result, as_json, rows(answer))
    if not answer.complete:
        raise NotReached(answer.reason)


def _log(log, result: dict[str, Any], files: Path | None) -> None:
    """Tells MLflow the answer, where that was asked for."""
    with log() as run:
        run.metrics(result)
        run.answer(result)
        if files is not None:
            run.files(files)


def _ranges(pairs) -> dict[str, tuple[float, float]]:
    out = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        try:
            low, high = text.split(":")
        except ValueError:
            raise InputError(
                f"--range {pair}: expected NAME=LOW:HIGH, as in --range E_ratio=0.1:10"
            ) from None
        name = name.strip()
        out[name] = (in_si(name, low.strip()), in_si(name, high.strip()))
    return out
