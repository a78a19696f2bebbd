"""How far does pressure push the lung's epithelium through its cage, and on which mesh is it right?

The thick sphere without muscle against the radial solution; the wedge on finer and finer meshes and
on Gmsh's tetrahedra; the aspect ratio up to the limit point, which lies a little above the
dissertation's pressure of 0.11; the unstable modes of the whole sphere on the way; pictures of
inflation and puncture. ``--set spheres=[...]`` solves the whole sphere too (minutes each): "tet4",
the dissertation's mesh of about 57 000 nodes, "hex27" and "tet10" with as many unknowns or more.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from foldlab.errors import InputError
from solver.cases.lung import model as case
from solver.cases.lung.geometry import Lung
from solver.cases.lung.measures import measure, radial
from solver.cases.lung.mesh import LEVELS, Counts, hexahedra, tetrahedra
from solver.cases.lung.model import REST, State, Tissue, inner_stretch, part_of, scene, to_limit
from solver.cases.lung.stability import Classes, spread, total
from solver.mesh.body import Body
from solver.output import Series
from solver.paths.continuation import trace
from solver.paths.steppers import ArcLength, LoadSteps
from solver.physics.materials import NeoHookean

from ._lung.plots import plot_inflation, plot_pictures
from ._lung.render import pictures
from .common import OUT, main, save_figure

# Thick neo-Hookean sphere, ν = 0.3, h = 0.05 of the mid-surface's radius: p/E over the inner
# stretch, and its limit point; from an ordinary differential equation solved to 1e-12.
RADIAL = {1.05: 0.0060399, 1.2: 0.0161545, 1.4: 0.0204693, 1.75: 0.0202319, 2.5: 0.0154945}
LIMIT, LIMIT_STRETCH = 0.020954238, 1.53123
TIMES = {"wedge": 120, "octant": 8, "sphere": 1}


@dataclass(frozen=True)
class Config:
    """Sizes in R, stresses in E_ep. ``levels``: of the wedge; ``tets``: sizes of tetrahedra with 4
    nodes and ``tets10`` with 10, of a wedge; ``spheres``: whole spheres; ``picture``: level of the
    mesh for series and pictures, and ``stability`` of that for the unstable modes; -1: none."""

    seed: int = 0
    n: int = 2
    epithelium: float = 0.05
    muscle: float = 0.075
    width: float | None = None
    stiffness: float = 75.0
    nu: float = 0.3
    pressure: float = 0.11
    contraction: float = -0.4
    pressure_drop: float = 0.1
    steps: int = 10
    levels: tuple[int, ...] = (0, 1, 2)
    tets: tuple[float, ...] = (0.0345, 0.02)
    tets10: tuple[float, ...] = (0.06, 0.0345)
    spheres: tuple[str, ...] = ()
    sphere_steps: int = 8
    picture: int = 1
    stability: int = 1


TINY = Config(
    n=1, pressure=0.02, contraction=-0.1, steps=2, levels=(0,), tets=(0.2,), tets10=(),
    picture=-1, stability=-1,
)  # fmt: skip
# As many unknowns as the dissertation's mesh, or a little more or fewer.
SPHERES = {
    "tet4": lambda lung: tetrahedra(lung, 0.0345),
    "hex27": lambda lung: hexahedra(lung, Counts(hole=2), part="sphere"),
    "tet10": lambda lung: tetrahedra(lung, 0.12, order=2),
}


def prepared(config, contraction: float, levels: Sequence[int]) -> tuple[Lung, Tissue]:
    """Lung and tissues of settings; raises InputError for what they refuse.

    ``config`` has sizes, stiffness, pressure, pressure_drop and steps, as ``Config`` here.
    """
    try:
        State(config.pressure, contraction)
        lung = Lung(config.n, config.epithelium, config.muscle, config.width)
        tissue = Tissue(config.stiffness, config.nu)
        NeoHookean(1.0, config.nu)
    except ValueError as error:
        raise InputError(str(error)) from error
    known(levels, range(len(LEVELS)), "level")
    if not 0 <= config.pressure_drop <= 1 or config.steps < 1 or config.pressure == 0:
        raise InputError(
            f"pressure = {config.pressure}, pressure_drop = {config.pressure_drop}, steps = "
            f"{config.steps}; expected a pressure, a drop between 0 and 1 and steps of at least 1"
        )
    return lung, tissue


def known(given: Sequence, there: Iterable, name: str) -> None:
    """Raises InputError for the first of ``given`` that is not there."""
    if unknown := [value for value in given if value not in there]:
        raise InputError(f"no {name} {unknown[0]!r}; there are: {', '.join(map(str, there))}")


def memory() -> float:
    """Peak memory of this process in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def thick_sphere(level: int) -> list[dict]:
    """The lung's own code without a cage, through the limit point of a bare sphere."""
    lung = Lung(n=1, epithelium=0.05 / 1.025, muscle=0.0)
    body = hexahedra(lung, level)
    stage = scene(body, lung, Tissue(), REST, State(0.03))

    def stretch(point):
        return inner_stretch(body, lung, stage.displacement(point.x, point.e))

    path = trace(
        stage,
        np.zeros(stage.size),
        ArcLength(rtol=1e-8, a=0.02, b=0.05),
        until=lambda p: stretch(p) - 2.6,
        max_steps=200,
    )
    along = np.array([stretch(p) for p in path.points])
    curve = CubicSpline(along, 0.03 * path.loads)
    rows = [
        {"stretch": s, "pressure": float(curve(s)), "radial": p, "error": float(curve(s) / p - 1)}
        for s, p in RADIAL.items()
    ]
    fold = next((event for event in path.events if event.kind == "fold"), None)
    if fold is not None:
        limit_pressure = 0.03 * fold.e
        rows.append(
            {"stretch": stretch(fold), "pressure": limit_pressure, "radial": LIMIT,
             "error": limit_pressure / LIMIT - 1, "at": "limit", "stretch_error":
             stretch(fold) / LIMIT_STRETCH - 1}
        )  # fmt: skip
    return rows


def inflate(name: str, body: Body, lung: Lung, tissue: Tissue, config: Config, limit=False):
    """One row of the table, and the curve of the aspect ratio up to the pressure, or the limit."""
    start = time.perf_counter()
    stage = scene(body, lung, tissue, REST, State(config.pressure))
    whole = part_of(body) == "sphere"
    if whole:
        path = trace(
            stage,
            np.zeros(stage.size),
            LoadSteps(rtol=1e-6, step=1 / config.sphere_steps, smallest=0.01),
            max_steps=20 * config.sphere_steps,
            events=False,
        )
    else:
        path = case.run(stage, steps=config.steps, events=False, over=None)
    seconds = time.perf_counter() - start
    u = stage.displacement(path.last.x, path.last.e)
    measures = measure(body, lung, u)
    row = {
        "mesh": name, "part": part_of(body), "unknowns": stage.size, "nodes": len(body.nodes),
        "pressure": config.pressure * path.last.e,
        "aspect": measures.aspect, "depth": measures.depth, "spacing": measures.spacing,
        "thinnest": measures.thinnest, "variation": measures.variation,
        "energy": TIMES[part_of(body)] * path.last.energy, "unstable": path.last.unstable,
        "iterations": path.iterations, "seconds": seconds, "memory_mb": memory(),
        "outcome": path.outcome.value,
    }  # fmt: skip
    curve = [(0.0, 0.0)]
    points = list(path.points[1:])
    if limit:
        ahead = to_limit(stage, path, step=0.3 / config.steps)
        points += ahead.points[1:]
        row["limit"] = config.pressure * ahead.last.e if ahead.reached else None
    for point in points:
        here = measure(body, lung, stage.displacement(point.x, point.e))
        curve.append((config.pressure * point.e, here.aspect))
    print(row, file=sys.stderr)
    return row, curve


def run(config: Config, tracker) -> dict[str, Any]:
    lung, tissue = prepared(config, config.contraction, config.levels)
    known(config.spheres, SPHERES, "sphere")
    if not config.levels:
        raise InputError("levels is empty; give at least one level of hexahedra")
    sphere = thick_sphere(min(config.levels))
    tracker.table("thick_sphere", pd.DataFrame(sphere))
    rows, curves = [], {}
    meshes = [(f"hex27, level {k}", lambda k=k: hexahedra(lung, k)) for k in config.levels]
    meshes += [
        (f"tet4, {s:g} R", lambda s=s: tetrahedra(lung, s, part="wedge")) for s in config.tets
    ]
    meshes += [
        (f"tet10, {s:g} R", lambda s=s: tetrahedra(lung, s, part="wedge", order=2))
        for s in config.tets10
    ]
    for name, make in meshes:
        row, curve = inflate(name, make(), lung, tissue, config, limit=True)
        rows.append(row)
        curves[name] = curve
    for kind in config.spheres:
        row, _ = inflate(kind, SPHERES[kind](lung), lung, tissue, config)
        rows.append(row)
    finest = rows[len(config.levels) - 1]
    for row in rows:
        row["beside_finest"] = row["aspect"] / finest["aspect"] - 1
    tracker.table("meshes", pd.DataFrame(rows))
    figure = plot_inflation(sphere, RADIAL | {LIMIT_STRETCH: LIMIT}, rows, curves, config.pressure)
    save_figure(figure, "lung_inflation")
    tracker.figure("lung_inflation", figure)
    result = {
        "table": rows,
        "thick_sphere": sphere,
        "bundle_width": lung.bundle,
        "mean_edge": float(lung.tiling.lengths.mean()),
        "spacing_undeformed": lung.spacing,
    }
    if config.stability >= 0:
        result["stability"] = modes(lung, tissue, config)
    if config.picture >= 0:
        result["series"] = show(lung, tissue, config, tracker)
    return result


def modes(lung: Lung, tissue: Tissue, config: Config) -> list[dict]:
    """Unstable modes of the whole sphere along the inflation and on to the limit point."""
    wedge, octant = (hexahedra(lung, config.stability, part=p) for p in ("wedge", "octant"))
    stage = scene(wedge, lung, tissue, REST, State(config.pressure))
    path = case.run(stage, steps=config.steps, events=False, over=None)
    ahead = to_limit(stage, path, step=0.1 / config.steps)
    classes = Classes(scene(octant, lung, tissue, REST, State(config.pressure)))
    rows = []
    for point in (*path.points[::3], path.last, *ahead.points[1:]):
        counts = classes.count(wedge, stage.displacement(point.x, point.e), point.e)
        row = {"pressure": config.pressure * point.e, "total": total(counts), **counts}
        print(row, file=sys.stderr)
        rows.append(row)
    return rows


def show(lung: Lung, tissue: Tissue, config: Config, tracker) -> str:
    """The whole lung through inflation and puncture: a series for ParaView, and pictures."""
    wedge, sphere = (hexahedra(lung, config.picture, part=p) for p in ("wedge", "sphere"))
    full, low = State(config.pressure), config.pressure * (1 - config.pressure_drop)
    stages = [
        scene(wedge, lung, tissue, REST, full),
        scene(wedge, lung, tissue, full, State(low, config.contraction)),
    ]
    folder = OUT / "lung"
    folder.mkdir(parents=True, exist_ok=True)
    series = Series(folder / "lung.pvd", sphere)
    x, chosen = None, []
    for number, stage in enumerate(stages):
        path = case.run(stage, x, steps=(1 + number) * config.steps, events=False,
                   over=None if number == 0 else "settle")  # fmt: skip
        x = path.last.x
        fractions = (0.0, 0.5, 1.0) if number == 0 else (1.0,)
        for fraction in fractions:
            point = min(path.points, key=lambda p, s=fraction: abs(p.e - s))
            u = stage.displacement(point.x, point.e)
            state = [
                s + point.e * (t - s)
                for s, t in (
                    ((0.0, config.pressure), (0.0, 0.0))
                    if number == 0
                    else ((config.pressure, low), (0.0, config.contraction))
                )
            ]
            on = spread(wedge, u, sphere)
            file = series.write(number + point.e, on, point_data={"radial": radial(sphere, on)})
            shell = np.unique(wedge.cells[wedge.cells_of("epithelium")])
            ends = radial(wedge, u)[shell]
            colours = (float(ends.min()), float(max(ends.max(), ends.min() + 1e-3)))
            title = f"p = {state[0]:.3g} $E_{{ep}}$, g = {state[1]:.3g}, aspect "
            chosen.append((file, colours, title + f"{measure(wedge, lung, u).aspect:.3f}"))
        if not path.reached:
            break
    targets = [folder / f"state{k}.png" for k in range(len(chosen))]
    files, colours, titles = zip(*chosen, strict=True)
    if pictures(files, targets, colours):
        figure = plot_pictures(targets, titles, colours)
        save_figure(figure, "lung_shapes")
        tracker.figure("lung_shapes", figure)
    else:
        print("nothing can be rendered on this machine; the series is whole", file=sys.stderr)
    return str(series.path)


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
