"""What `foldlab simulate` reads and leaves behind: result.json, curves, VTU series, pictures."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from foldlab.design import FULL, PATTERNED, STRIPS, DesignSpace
from foldlab.errors import InputError
from foldlab.labels.label import Label
from foldlab.labels.run import Run
from foldlab.labels.solver import SolverSource
from foldlab.packaged import installed
from foldlab.terminal import note, plain

# A hinge as wide as its panels and as dense: what a design is that says nothing of them.
DEFAULTS = {"rho_ratio": 1.0, "hinge_width": 1.0}

# Without weight these act nowhere.
WEIGHT = ("rho_ratio", "stiffness_to_weight")


FRAMES = 60  # of a GIF, at most


FILES = ("result.json", "curves.npz", "shapes.png", "strain.png", "angle.png", "fold.gif")


def space_for(given: Mapping[str, float]) -> DesignSpace:
    """The patterned space where a group of strips is given, else the full one."""
    return PATTERNED if any(name in given for name in STRIPS) else FULL


def complete(given: Mapping[str, float], *, heavy: bool) -> dict[str, float]:
    """All groups of the full or the patterned space, from those given and the defaults.

    Raises :class:`InputError` for names that are no group and for missing ones.
    """
    space = space_for(given)
    for name in given:
        space[name]
    needed = {**DEFAULTS, **({} if heavy else {"stiffness_to_weight": 1.0}), **given}
    missing = [name for name in space.names if name not in needed]
    if missing:
        why = " (gravity acts; or give --effects none)" if "stiffness_to_weight" in missing else ""
        raise InputError(f"the design lacks {', '.join(missing)}{why}; add --set {missing[0]}=…")
    design = {name: needed[name] for name in space.names}
    for name, value in design.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} = {value:g}; expected a finite number above 0")
    return design


def summary(label: Label, run: Run, source: SolverSource) -> dict[str, Any]:
    """What ``--json`` prints; what the run did not come to is None."""
    from foldlab.labels.foldability import TAGS

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
        # rad
        "need": e.get("need"),
        "error_m1": e.get("error_m1"),
        "error_m2": e.get("error_m2"),
        "turning_hinge": e.get("turning_hinge"),
        "turning_ends": e.get("turning_ends"),
        # peaks, stress and interface over E_s
        "strain": e.get("strain"),
        "stress": e.get("stress"),
        "interface": e.get("interface"),
        "peak_errors": e.get("peak_errors"),
        # by group: m1 and m2 in rad, tip in l_s; None where it was not asked for
        "sensitivity": e.get("sensitivity"),
        "alternatives": e.get("alternatives", []),
        # over h_s, None without a ground
        "rest_gap": e.get("rest_gap"),
        "penetration": e.get("penetration"),
        "effects": list(model.effects),
        "growth": source.conditions.growth,
        "question": source.question,
        "seconds": e["seconds"],
        "core_seconds": e["core_seconds"],
        "peak_memory_mb": e["peak_memory_mb"],
        "unknowns": e["unknowns"],
        "steps": e["steps"],
        "iterations": e["iterations"],
        "design": dict(label.design),
    }


def explain(label, run, source, clock, ablation: bool) -> dict[str, Any]:
    """What ``--why`` adds: fractions of each effect and advice, with ``ablation`` also the answers
    without them."""
    from foldlab.unit.why import ablate, advise, contributions

    effects = contributions(run, clock, label.evidence["core_seconds"]) if run.history else []
    without = ablate(label, source) if ablation else []
    return {"effects": effects, "without": without, "advice": advise(label, run, source, without)}


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
    """Curves of every state and, where VTK is installed, the series; the names of both."""
    series = installed("pyvista")
    if series:
        (out / "series").mkdir(exist_ok=True)
        run.write_series(out / "series" / "unit.pvd")
    else:
        _warn('no series for ParaView and no pictures in 3-D: pip install "foldlab[view]"')
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
    return ["curves.npz", *["series/unit.pvd"] * series]


def draw(
    out: Path, label: Label, run: Run, source: SolverSource, *, animate: bool, measured: bool = True
) -> list[str]:
    """The pictures, with ``measured`` those of angles and strains, too; says on stderr what could
    not be drawn."""
    from foldlab.plots import save_figure
    from foldlab.unit.plots import (
        plot_angles,
        plot_shapes,
        plot_side,
        plot_strain,
        write_animation,
    )
    from foldlab.unit.render import Request, render

    released = source.question == "exists"
    g, limits = label.design["contraction"], source.thresholds
    load = np.array([shape.load for shape in run.shapes])
    if measured:
        figure = plot_angles(
            run.history,
            g,
            (limits.angle(g), limits.most_across(g)),
            label.evidence["events"],
            load if released else None,
        )
        save_figure(figure, out / "angle.png")
    ground = source.conditions.heavy
    titles = [
        _title(row["contraction"], e, ground) for row, e in zip(run.history, load, strict=True)
    ]
    last = len(load) - 1
    three = sorted({0, int(np.abs(load - load[-1] / 2).argmin()), last})
    film = np.unique(np.linspace(0, last, min(last + 1, FRAMES)).round().astype(int))
    with tempfile.TemporaryDirectory() as folder:
        names = {k: Path(folder) / f"shape{k}.png" for k in three}
        frames = {k: Path(folder) / f"frame{k}.png" for k in film} if animate else {}
        wanted = [(k, path, 1000) for k, path in names.items()]
        wanted += [(k, path, 480) for k, path in frames.items()]
        strained, most = Path(folder) / "strained.png", max(label.evidence["strain"].values())
        wanted += [(last, strained, 1000)] * measured
        request = Request(
            str(out / "series" / "unit.pvd"),
            str(out / "curves.npz"),
            ground,
            label.design["slenderness"],
            [(int(k), str(path), width) for k, path, width in wanted],
            (str(strained),),
            most,
        )
        drawn = installed("pyvista") and render(request, Path(folder))
        chosen = [titles[k] for k in three]
        if drawn:
            figure = plot_shapes([names[k] for k in three], chosen, ground=ground)
        else:
            _warn(
                ("VTK can't render here" if installed("pyvista") else "No VTK")
                + ": shapes.png shows the unit from the side"
                + (" and there is no fold.gif" if animate else "")
            )
            curves = np.stack([run.shapes[k].state.curves for k in three])
            figure = plot_side(curves, label.design, chosen, ground=ground)
        save_figure(figure, out / "shapes.png")
        if drawn and measured:
            save_figure(plot_strain(strained, most, titles[last]), out / "strain.png")
        if drawn and animate:
            write_animation(out / "fold.gif", list(frames.values()), [titles[k] for k in frames])
    return [
        "shapes.png",
        *["angle.png"] * measured,
        *["strain.png"] * bool(drawn and measured),
        *["fold.gif"] * bool(drawn and animate),
    ]


def _title(contraction: float, load: float, heavy: bool) -> str:
    if load == 0:
        return "at rest" if heavy else "flat"
    if load > 1:
        how = "to isotropic" if load == 2 else f"by {100 * (load - 1):.3g} %"
        return f"{100 * contraction:.3g} %, released {how}"
    return f"{100 * contraction:.3g} % contraction"


def _warn(text: str) -> None:
    note(f"warning: {text}")
