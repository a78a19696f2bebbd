"""The verb ``simulate``: one design on the solver, its whole path in files and pictures.

What it writes into a folder: ``result.json`` (the label, and m1 … m4 of every state),
``curves.npz`` (the four curves of every state), ``series/unit.pvd`` (the whole unit, for ParaView),
``shapes.png``, ``angle.png`` and, if asked for, ``fold.gif``.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.settings import numbers, read_settings
from foldlab.terminal import Config, Json, NotReached, Sets, emit, err, plain

if TYPE_CHECKING:
    from foldlab.labels import Label
    from foldlab.sources import Run, SolverSource

# A hinge as wide as its panels and as dense: what a design is that says nothing of them.
DEFAULTS = {"rho_ratio": 1.0, "hinge_width": 1.0}
# Without weight these act nowhere.
WEIGHT = ("rho_ratio", "stiffness_to_weight")
FRAMES = 60  # of a GIF, at most
FILES = ("result.json", "curves.npz", "shapes.png", "angle.png", "fold.gif")


def simulate(
    settings: Sets = None,
    config: Config = None,
    effects: Annotated[
        str,
        typer.Option(
            help="gravity,ground or none; with contact the panels stop at each other: "
            "gravity,ground,contact or contact."
        ),
    ] = "gravity,ground",
    growth: Annotated[str, typer.Option(help="Contraction: uniaxial or isotropic.")] = "uniaxial",
    question: Annotated[
        str,
        typer.Option(help="from_flat, or exists: is there a folded stable state? (isotropic)"),
    ] = "from_flat",
    accuracy: Annotated[
        float, typer.Option(help="Wanted relative error of the angle, such as 0.05, 0.02, 0.005.")
    ] = 0.02,
    why: Annotated[
        bool, typer.Option("--why", help="What each effect contributed, and what to choose.")
    ] = False,
    ablation: Annotated[
        bool, typer.Option("--ablate", help="With --why: solve again without each effect.")
    ] = False,
    timeout: Annotated[float, typer.Option(help="Seconds after which to give up.")] = 60.0,
    free: Annotated[bool, typer.Option("--free", help="Let the unit topple.")] = False,
    strips: Annotated[
        int, typer.Option(min=0, help="Active strips side by side; 0: a solid layer.")
    ] = 0,
    barrier: Annotated[str, typer.Option(help="Ground: surface or exponential.")] = "surface",
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for results.")] = (
        Path("out/simulate")
    ),
    animate: Annotated[bool, typer.Option("--animate", help="Also draw fold.gif.")] = False,
    no_pictures: Annotated[bool, typer.Option("--no-pictures", help="Numbers only.")] = False,
    as_json: Json = False,
) -> None:
    """Fold one design on the solver: verdict, curves, a series for ParaView, pictures.

    --set gives the groups (lengths over l_s): E_ratio, h_ratio, hinge_length, aspect, slenderness,
    contraction; rho_ratio and hinge_width are 1 if not given; stiffness_to_weight is needed where
    gravity acts.
    """
    from foldlab.forecast import forecast
    from foldlab.sources import SolverSource

    if ablation and not why:
        raise InputError("--ablate belongs to --why; give both")
    if animate and no_pictures:
        raise InputError("--animate draws a picture and --no-pictures none; give one of them")
    given = numbers(read_settings(settings or (), config))
    source = SolverSource(
        accuracy=accuracy, effects=effects, growth=growth, question=question, upright=not free,
        timeout=timeout, barrier=barrier, strips=strips,
    )  # fmt: skip
    design = complete(given, heavy=source.heavy)
    source.unit(design)
    if design["h_ratio"] * design["slenderness"] > design["hinge_length"]:
        _warn(
            f"the active layer is {design['h_ratio'] * design['slenderness']:.3g} l_s thick and "
            f"the hinge only {design['hinge_length']:.3g} l_s long: this is no thin hinge, and the "
            "fold angle of its middle line says little"
        )
    if not source.heavy and "stiffness_to_weight" in given:
        _warn("stiffness_to_weight acts on nothing without gravity among the effects")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"can't write into --out {out} ({error}); give another folder") from None
    expected = forecast(design, source)
    _note(expected.sentence(accuracy) if expected else "expected: nothing known of such labels")
    clock = {} if why else None
    run, label = source.follow(design, clock)
    result = summary(label, run, source)
    result["plan"] = asdict(source.plan)
    result["expected"] = None if expected is None else asdict(expected)
    if why:
        result["why"] = explain(label, run, source, clock, ablation)
    for name in () if source.heavy else WEIGHT:
        result["design"][name] = None
    clear(out)
    write_json(out / "result.json", {**result, "label": asdict(label), "path": run.history})
    files = ["result.json"]
    if run.shapes:
        files += write_path(out, run)
        if not no_pictures:
            files += draw(out, label, run, source, animate=animate)
    result["files"] = [str(out / name) for name in files]
    if as_json:
        emit(result, True)
    else:
        emit(readable(result), False, rows(result))
        if why:
            _say_why(result["why"])
    if label.foldable is None:
        raise NotReached(f"{label.reason}; what there is is in {out}")


def complete(given: Mapping[str, float], *, heavy: bool) -> dict[str, float]:
    """All groups of the full space, from those given and the defaults.

    Raises :class:`InputError` for names that are no group and for missing ones.
    """
    for name in given:
        FULL[name]
    needed = {**DEFAULTS, **({} if heavy else {"stiffness_to_weight": 1.0}), **given}
    missing = [name for name in FULL.names if name not in needed]
    if missing:
        why = " (gravity acts; or give --effects none)" if "stiffness_to_weight" in missing else ""
        raise InputError(f"the design lacks {', '.join(missing)}{why}; add --set {missing[0]}=…")
    design = {name: needed[name] for name in FULL.names}
    for name, value in design.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} = {value:g}; expected a finite number above 0")
    return design


def summary(label: Label, run: Run, source: SolverSource) -> dict[str, Any]:
    """What ``--json`` prints; what the run did not come to is None."""
    from foldlab.foldability import TAGS

    e = label.evidence
    model = run.folding.model
    return {
        "fold_angle": e.get("fold_angle"),
        "foldable": label.foldable,
        "reason": label.reason,
        "outcome": e["outcome"],
        "measures": run.measures if run.history else None,
        "tags": {tag: e[tag] for tag in TAGS} if run.history else None,
        "events": e.get("events", []),
        "contraction_reached": e.get("contraction_reached"),
        "stable": e["stable"],
        "unstable_modes": e.get("unstable_modes"),
        "topples": e.get("topples"),
        "error_estimate": e.get("error_estimate"),
        # over h_s, None without a ground
        "rest_gap": e.get("rest_gap"),
        "penetration": e.get("penetration"),
        "effects": list(model.effects),
        "growth": source.growth,
        "question": source.question,
        "seconds": e["seconds"],
        "peak_memory_mb": e["peak_memory_mb"],
        "unknowns": e["unknowns"],
        "steps": e["steps"],
        "iterations": e["iterations"],
        "design": dict(label.design),
    }


def explain(label, run, source, clock, ablation: bool) -> dict[str, Any]:
    """What ``--why`` adds: shares of each effect, advice, and with ``ablation`` the answers without
    them."""
    from foldlab.why import ablate, advise, contributions

    shares = contributions(run, clock, label.evidence["seconds"]) if run.history else []
    without = ablate(label, source) if ablation else []
    return {"effects": shares, "without": without, "advice": advise(label, run, source, without)}


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


def rows(result: Mapping[str, Any]) -> list[dict]:
    """The measures against what counts as folded, for the eye."""
    if result["measures"] is None:
        return []
    need = np.pi * result["design"]["contraction"]
    limits = [f"> {need:.3g} rad", f"< {need / 2:.3g} rad", "1 ± 0.1", "1 ± 0.1"]
    says = (
        "turning along the sheet", "turning across the hinge", "edge along the middle",
        "other edge along the middle",
    )  # fmt: skip
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
    events = [f"{e['kind']} at {100 * e['contraction']:.3g} %" for e in result["events"]]
    lists = {"events": events, "effects": result["effects"], "files": result["files"]}
    return {**result, **{name: ", ".join(items) or "none" for name, items in lists.items()}}


def clear(out: Path) -> None:
    """Takes an earlier simulation's files away, so that none is taken for this one's."""
    for name in FILES:
        (out / name).unlink(missing_ok=True)
    for path in (out / "series").glob("unit*.*"):
        path.unlink()


def write_json(path: Path, result: Mapping[str, Any]) -> None:
    """All of it or nothing."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        text = json.dumps(plain(dict(result)), allow_nan=False, indent=1)
        draft.write_text(text, encoding="utf-8")
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def write_path(out: Path, run: Run) -> list[str]:
    """Curves of every state and the series; the names of both."""
    (out / "series").mkdir(exist_ok=True)
    run.write_series(out / "series" / "unit.pvd")
    draft = out / f".curves.{os.getpid()}.npz"
    try:
        np.savez_compressed(
            draft,
            curves=np.stack([shape.state.curves for shape in run.shapes]),
            contraction=np.array([row["contraction"] for row in run.history]),
            load=np.array([shape.load for shape in run.shapes]),
        )
        draft.replace(out / "curves.npz")
    finally:
        draft.unlink(missing_ok=True)
    return ["curves.npz", "series/unit.pvd"]


def draw(out: Path, label: Label, run: Run, source: SolverSource, *, animate: bool) -> list[str]:
    """The pictures; says on stderr what could not be drawn."""
    from foldlab.foldability import Thresholds
    from foldlab.plots import save_figure
    from foldlab.render import Request, render
    from foldlab.unit_plots import plot_angles, plot_shapes, plot_side, write_animation

    released = source.question == "exists"
    g, limits = label.design["contraction"], Thresholds()
    need = g * limits.turning
    load = np.array([shape.load for shape in run.shapes])
    figure = plot_angles(
        run.history, g, (need, limits.across * need), label.evidence["events"],
        load if released else None,
    )  # fmt: skip
    save_figure(figure, out / "angle.png")
    ground = source.heavy
    titles = [
        _title(row["contraction"], e, ground) for row, e in zip(run.history, load, strict=True)
    ]
    last = len(load) - 1
    three = sorted({0, int(np.abs(load - load[-1] / 2).argmin()), last})
    film = np.unique(np.linspace(0, last, min(last + 1, FRAMES)).round().astype(int))
    # A series keeps one state per load.
    order = {e: k for k, e in enumerate(dict.fromkeys(load))}
    with tempfile.TemporaryDirectory() as folder:
        names = {k: Path(folder) / f"shape{k}.png" for k in three}
        frames = {k: Path(folder) / f"frame{k}.png" for k in film} if animate else {}
        wanted = [(k, path, 1000) for k, path in names.items()]
        wanted += [(k, path, 480) for k, path in frames.items()]
        request = Request(
            str(out / "series" / "unit.pvd"), str(out / "curves.npz"), ground,
            label.design["slenderness"],
            [(int(k), order[load[k]], str(path), width) for k, path, width in wanted],
        )  # fmt: skip
        drawn = render(request, Path(folder))
        chosen = [titles[k] for k in three]
        if drawn:
            figure = plot_shapes([names[k] for k in three], chosen, ground=ground)
        else:
            _warn(
                "VTK can't render here: shapes.png shows the unit from the side"
                + (" and there is no fold.gif" if animate else "")
            )
            curves = np.stack([run.shapes[k].state.curves for k in three])
            figure = plot_side(curves, label.design, chosen, ground=ground)
        save_figure(figure, out / "shapes.png")
        if drawn and animate:
            write_animation(out / "fold.gif", list(frames.values()), [titles[k] for k in frames])
    return ["shapes.png", "angle.png", *(["fold.gif"] if drawn and animate else [])]


def _title(contraction: float, load: float, heavy: bool) -> str:
    if load == 0:
        return "at rest" if heavy else "flat"
    if load > 1:
        how = "to isotropic" if load == 2 else f"by {100 * (load - 1):.3g} %"
        return f"{100 * contraction:.3g} %, released {how}"
    return f"{100 * contraction:.3g} % contraction"


def _note(text: str) -> None:
    err.print(text, markup=False, highlight=False)


def _warn(text: str) -> None:
    err.print(f"warning: {text}", markup=False, highlight=False)
