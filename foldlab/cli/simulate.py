"""The verb ``simulate``: one design on the solver, its whole path in files and pictures.

What it writes into a folder: ``result.json`` (the label, and m1 … m4 of every state),
``curves.npz`` (the four curves of every state), ``series/unit.pvd`` (the whole unit, for ParaView),
``shapes.png``, ``angle.png``, ``strain.png`` and, if asked for, ``fold.gif``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from foldlab.cli.check import Made, Need
from foldlab.cli.outputs import output_folder, tell_slow
from foldlab.errors import InputError
from foldlab.quantities import numbers
from foldlab.terminal import Given, Json, NotReached, Track, emit, note
from foldlab.unit.record import (
    WEIGHT,
    _warn,
    clear,
    complete,
    draw,
    explain,
    space_for,
    summary,
    write_json,
    write_path,
)

if TYPE_CHECKING:
    from foldlab.design import DesignSpace
    from foldlab.labels.asked import Changing
    from foldlab.labels.foldability import Thresholds
    from foldlab.labels.solver import SolverSource
    from foldlab.labels.strength import Strengths


@dataclass(frozen=True)
class Solving:
    """What is solved, and how well."""

    effects: Annotated[
        str,
        typer.Option(
            help="gravity,ground or none; with contact the panels stop at each other: "
            "gravity,ground,contact or contact."
        ),
    ] = "gravity,ground"
    growth: Annotated[str, typer.Option(help="Contraction: uniaxial or isotropic.")] = "uniaxial"
    question: Annotated[
        str,
        typer.Option(help="from_flat, or exists: is there a folded stable state? (isotropic)"),
    ] = "from_flat"
    accuracy: Annotated[
        float, typer.Option(help="Wanted relative error of the angle, such as 0.05, 0.02, 0.005.")
    ] = 0.02
    timeout: Annotated[
        float, typer.Option(help="Core-seconds after which to give up, compiling not counted.")
    ] = 60.0
    free: Annotated[bool, typer.Option("--free", help="Let the unit topple.")] = False
    strips: Annotated[
        int, typer.Option(min=0, help="Active strips side by side; 0: a solid layer.")
    ] = 0
    barrier: Annotated[str, typer.Option(help="Ground: surface or exponential.")] = "surface"
    friction: Annotated[
        float, typer.Option(help="Coefficient of friction of the ground, such as 0.3.")
    ] = 0.0
    need: Need = None
    sensitivity: Annotated[
        bool,
        typer.Option("--sensitivity", help="Tell how angles and strains change with each group."),
    ] = False

    def source(self, strengths: Strengths, space: DesignSpace, changing: Changing) -> SolverSource:
        """The label source that solves so, and tells what breaks."""
        from foldlab.labels.asked import Conditions, Effort
        from foldlab.labels.foldability import Thresholds
        from foldlab.labels.solver import SolverSource

        conditions = Conditions(
            self.effects, self.growth, not self.free, self.strips, barrier=self.barrier,
            friction=self.friction,
        )  # fmt: skip
        effort = Effort(self.accuracy, self.timeout, sensitivity=self.sensitivity, whole=True)
        thresholds = Thresholds(need=self.need)
        return SolverSource(
            conditions, effort, self.question, space=space, thresholds=thresholds,
            strengths=strengths, changing=changing,
        )  # fmt: skip


@dataclass(frozen=True)
class Borne:
    """What the materials bear, strains as fractions and stresses over E_s."""

    passive_strain: Annotated[
        float | None, typer.Option(help="Strain at which the passive layer breaks, such as 0.05.")
    ] = None
    active_strain: Annotated[
        float | None, typer.Option(help="Elastic strain at which the active layer breaks.")
    ] = None
    passive_stress: Annotated[
        float | None, typer.Option(help="Strength of the passive layer over E_s.")
    ] = None
    active_stress: Annotated[
        float | None, typer.Option(help="Strength of the active layer over E_s.")
    ] = None
    opening: Annotated[
        float | None, typer.Option(help="Pull over E_s at which the layers come apart.")
    ] = None
    shear: Annotated[
        float | None, typer.Option(help="Shear over E_s at which the layers come apart.")
    ] = None

    def strengths(self) -> Strengths:
        """The same as the label source takes it."""
        from foldlab.labels.strength import Strengths

        return Strengths(**vars(self))


@dataclass(frozen=True)
class Changed:
    """What the materials become until the full contraction (§4.8.4)."""

    active_stiffness: Annotated[
        float, typer.Option(help="Factor that E of the active layer reaches as it contracts.")
    ] = 1.0
    passive_stiffness: Annotated[
        float, typer.Option(help="Factor that E of the passive layer reaches.")
    ] = 1.0
    active_density: Annotated[
        float, typer.Option(help="Factor that the density of the active layer reaches.")
    ] = 1.0
    passive_density: Annotated[
        float, typer.Option(help="Factor that the density of the passive layer reaches.")
    ] = 1.0
    passive_expansion: Annotated[
        float, typer.Option(help="Strain that the passive layer grows by where the other shrinks.")
    ] = 0.0

    def changing(self) -> Changing:
        """The same as the label source takes it."""
        from foldlab.labels.asked import Changing

        return Changing(**vars(self))


@dataclass(frozen=True)
class Asked:
    """What is told besides the verdict."""

    why: Annotated[
        bool, typer.Option("--why", help="What each effect contributed, and what to choose.")
    ] = False
    ablation: Annotated[
        bool, typer.Option("--ablate", help="With --why: solve again without each effect.")
    ] = False
    animate: Annotated[bool, typer.Option("--animate", help="Also draw fold.gif.")] = False
    no_pictures: Annotated[bool, typer.Option("--no-pictures", help="Numbers only.")] = False

    def __post_init__(self):
        if self.ablation and not self.why:
            raise InputError("--ablate belongs to --why; give both")
        if self.animate and self.no_pictures:
            raise InputError("--animate draws a picture and --no-pictures none; give one of them")


def simulate(
    *,
    given: Given,
    made: Made,
    solving: Solving,
    borne: Borne,
    changed: Changed,
    asked: Asked,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for results.")] = (
        Path("out/simulate")
    ),
    track: Track = False,
    as_json: Json = False,
) -> None:
    """Fold one design on the solver: verdict, curves, a series for ParaView, pictures.

    --set gives the groups (lengths over l_s): E_ratio, h_ratio, hinge_length, aspect, slenderness,
    contraction; rho_ratio and hinge_width are 1 if not given; stiffness_to_weight is needed where
    gravity acts; strips and strip_share cut the active layer. Or SI quantities and materials, as
    of the verb check.
    """
    from foldlab.labels.foldability import THICK_HINGE, thick_hinge
    from foldlab.labels.forecast import forecast
    from foldlab.tracking import asked as tracked

    groups = numbers(given.read())
    if made.asked(groups):
        groups = dict(made.unit(groups).groups)
    source = solving.source(borne.strengths(), space_for(groups), changed.changing())
    design = complete(groups, heavy=source.conditions.heavy)
    source.unit(design)
    if thick_hinge(design):
        _warn(
            f"the active layer is {design['h_ratio'] * design['slenderness']:.3g} l_s thick and "
            f"the hinge only {design['hinge_length']:.3g} l_s long: {THICK_HINGE}"
        )
    if not source.conditions.heavy and "stiffness_to_weight" in groups:
        _warn("stiffness_to_weight acts on nothing without gravity among the effects")
    log = tracked(track)
    with output_folder(out):
        tell_slow()
        expected = forecast(design, source)
        accuracy = solving.accuracy
        note(expected.sentence(accuracy) if expected else "expected: nothing known of such labels")
        clock = {} if asked.why else None
        run, label = source.follow(design, clock)
        result = summary(label, run, source)
        result["plan"] = asdict(source.effort.plan)
        result["expected"] = None if expected is None else asdict(expected)
        if asked.why:
            result["why"] = explain(label, run, source, clock, asked.ablation)
        for name in () if source.conditions.heavy else WEIGHT:
            result["design"][name] = None
        clear(out)
        write_json(out / "result.json", {**result, "label": asdict(label), "path": run.history})
        files = ["result.json"]
        if run.shapes:
            files += write_path(out, run)
            if not asked.no_pictures:
                files += draw(out, label, run, source, animate=asked.animate)
    result["files"] = [str(out / name) for name in files]
    with log("simulate", {**design, **asdict(solving)}) as tracker:
        for prefix, part in (("", result), ("measures.", result["measures"] or {})):
            tracker.metrics(part, prefix=prefix)
        for name in files:
            tracker.files(out / name if name != "series/unit.pvd" else out / "series")
    if as_json:
        emit(result, True)
    else:
        emit(readable(result), False, rows(result, source.thresholds))
        if asked.why:
            _say_why(result["why"])
    if label.foldable is None:
        raise NotReached(f"{label.reason}; what there is is in {out}")
    error = result["error_estimate"]
    if error is None or error > accuracy:
        error = "unknown" if error is None else f"{100 * error:.2g} %"
        raise NotReached(
            f"the error of the angle is {error}, {100 * accuracy:g} % was asked for; "
            f"the answer is in {out}"
        )


def _say_why(why: Mapping[str, Any]) -> None:
    """The same for the eye."""
    percent = lambda x: "–" if x is None else f"{100 * x:.3g} %"  # noqa: E731
    print("\nwhat each effect contributed at the last state, and of the time")
    for row in why["effects"]:
        print(
            f"  {row['effect']:<8} energy {percent(row['energy']):>8}   forces "
            f"{percent(row['force']):>8}   time {percent(row['time']):>8}"
        )
    for row in why["without"]:
        change = "no angle" if row["change"] is None else f"{row['change']:+.3g} rad"
        print(f"  without {row['without']}: {change}, {row['outcome']}, {row['seconds']:.2g} s")
    for sentence in why["advice"]:
        print(f"- {sentence}")


def rows(result: Mapping[str, Any], t: Thresholds) -> list[dict]:
    """The measures against what counts as folded, for the eye."""
    if result["measures"] is None:
        return []
    g = result["design"]["contraction"]
    limits = [f"> {t.angle(g):.3g} rad", f"< {t.most_across(g):.3g} rad"]
    limits += [f"1 ± {t.parallel:g}"] * 2
    says = (
        "turning along the sheet",
        "turning across the hinge",
        "edge along the middle",
        "other edge along the middle",
    )
    return [
        {
            "measure": f"m{k} {what}",
            "value": result["measures"][f"m{k}"],
            "folded": limit,
            "tag": f"F{k} {'yes' if result['tags'][f'F{k}'] else 'no'}",
        }
        for k, (what, limit) in enumerate(zip(says, limits, strict=True), start=1)
    ]


def readable(result: Mapping[str, Any]) -> dict[str, Any]:
    """The summary with lists as text, and without what the table of measures shows."""
    events = [
        f"{e['kind']} at {100 * e.get('release', e['contraction']):.3g} %"
        + (" of the release" if "release" in e else "")
        for e in result["events"]
    ]
    others = [f"{a['m1']:.3g} rad ({a['how']})" for a in result["alternatives"]]
    lists = {
        "events": events, "alternatives": others, "effects": result["effects"],
        "files": result["files"],
    }  # fmt: skip
    out = {**result, **{name: ", ".join(items) or "none" for name, items in lists.items()}}
    # Peaks in a line each, with their errors.
    peaks, errors = ("strain", "stress", "interface"), out.pop("peak_errors") or {}
    for name in peaks:
        if out[name] is not None:
            out[name] = ", ".join(
                f"{part} {value:.3g}" + (f" ± {100 * errors[name][part]:.2g} %" if errors else "")
                for part, value in out[name].items()
            )
    return out
