"""How does a ventral furrow form, step by step, and on which mesh is its depth to be believed?

An ellipsoidal shell of a standard linear solid contracts on the outer side of its ventral midline
(§5.5.4). Pictures of the sections and of the whole at 0, half and full contraction.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import LinearSegmentedColormap
from scipy.spatial import cKDTree

from foldlab.errors import InputError
from foldlab.plots import LINES, STYLE
from solver.cases.tissue import furrow
from solver.cases.tissue.model import Model, ramp
from solver.output import Series, grid
from solver.physics.patterns import read_pattern
from solver.viscous.evolution import TimeSteps, march, start

from .common import OUT, main, save_figure

# Of β from 0 to 1.
COLOURS = LinearSegmentedColormap.from_list("pattern", ["#9DB4CC", "#E2A33B"])


@dataclass(frozen=True)
class Config:
    """``meshes``: element:level, the last of them for pictures; ``field``: CSV or VTU with the
    point field "beta" instead of the analytic pattern; ``steps`` of fixed size over t_fin."""

    seed: int = 0
    meshes: tuple[str, ...] = (
        "tet4:2",
        "hex20:0",
        "hex20:1",
        "hex20:2",
        "hex27:0",
        "hex27:1",
        "hex27:2",
    )
    steps: int = 100
    order: int = 2
    contraction: float = 0.5
    t_fin: float = 1.0
    field: str = ""
    pictures: bool = True


TINY = Config(meshes=("hex20:0",), steps=5, contraction=0.05)


def run(config: Config, tracker) -> dict[str, Any]:
    return study(
        config, tracker, "furrow", furrow.build, ("depth", "indentation"),
        ("depth —, indentation - -\n(half lengths)", ("cavity", "cavity's volume")), draw,
    )  # fmt: skip


def study(config, tracker, name: str, build: Callable, shown, axes, draw) -> dict[str, Any]:
    """Paths of one case on all meshes: table, histories, VTU series, figure and pictures."""
    rows, histories, model, shapes = [], {}, None, []
    for mesh in config.meshes:
        element, _, level = mesh.partition(":")
        if not level.isdigit():
            raise InputError(f"mesh {mesh!r}; expected element:level, such as hex27:1")
        try:
            beta = read_pattern(config.field) if config.field else None
            model = build(int(level), element=element, contraction=config.contraction, beta=beta)
        except ValueError as error:
            raise InputError(str(error)) from error
        row, path, shapes = follow(config, model, mesh)
        print(row, file=sys.stderr)
        rows.append(row)
        histories[mesh] = path
    last = histories[config.meshes[-1]]
    tracker.table("meshes", pd.DataFrame(rows))
    tracker.table("history", last)
    figure = plot(histories, shown, *axes)
    save_figure(figure, name)
    tracker.figure(name, figure)
    series = write_series(name, model, shapes)
    if config.pictures:
        path = OUT / f"{name}_frames.png"
        draw(model, shapes, path)
        figure = framed(path, shapes, config.contraction)
        save_figure(figure, f"{name}_frames")
        tracker.figure(f"{name}_frames", figure)
    return {
        "table": rows,
        "history": last.to_dict("records"),
        "series": str(series),
        **{k: v for k, v in rows[-1].items() if k != "mesh"},
    }


def follow(config: Config, model: Model, mesh: str):
    """One path: its row, its history and the shapes (fraction of contraction, u) for pictures."""
    clock = time.perf_counter()
    dt = config.t_fin / config.steps
    scene = model.viscous(dt)
    stepper = TimeSteps(1e-6, dt, order=config.order)
    nothing = np.zeros((len(model.body.nodes), 3))
    path = [{"t": 0.0, "load": 0.0, **asdict(model.measure(nothing)), "dissipated": 0.0}]
    shapes, iterations, outcome, detail = [(0.0, nothing)], 0, None, ""
    walk = march(scene, start(scene), stepper, until=config.t_fin, load=ramp(config.t_fin))
    while outcome is None:
        try:
            state = next(walk)
        except StopIteration as stop:
            outcome, detail = stop.value
            break
        u = scene.displacement(state.x, state.e)
        iterations += state.iterations
        path.append({"t": state.t, "load": state.e, **asdict(model.measure(u)),
                     "dissipated": state.dissipated})  # fmt: skip
        if state.e >= 0.5 * len(shapes) - 1e-9:
            shapes.append((state.e, u))
    row = {
        "mesh": mesh,
        "elements": len(model.body.cells),
        "unknowns": scene.size,
        "internal": 6 * model.body.weights.size,
        **asdict(model.measure(u)),
        "dissipated": state.dissipated,
        "steps": state.index,
        "iterations": iterations,
        "seconds": time.perf_counter() - clock,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "outcome": f"{outcome.value}; {detail}" if detail else outcome.value,
    }
    return row, pd.DataFrame(path), shapes


def write_series(name: str, model: Model, shapes):
    """The shapes as ``out/NAME/NAME.pvd``, with β."""
    folder = OUT / name
    folder.mkdir(parents=True, exist_ok=True)
    series = Series(folder / f"{name}.pvd", model.body)
    for load, u in shapes:
        series.write(load, u, cell_data={"beta": model.beta})
    return folder / f"{name}.pvd"


def plot(histories, shown: Sequence[str], label: str, second: tuple[str, str]):
    """Measures over time on each mesh, the first ones left, one right."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.7), layout="constrained")
        left, right = figure.subplots(1, 2)
        for colour, (mesh, path) in zip(
            np.resize(LINES, len(histories)), histories.items(), strict=True
        ):
            for style, key in zip(("-", "--", ":"), shown, strict=False):
                left.plot(path["t"], path[key], style, color=colour, lw=1,
                          label=mesh if style == "-" else None)  # fmt: skip
            right.plot(path["t"], path[second[0]], color=colour, lw=1)
        left.set_ylabel(label)
        right.set_ylabel(second[1])
        for ax in (left, right):
            ax.set_xlabel("time $t$, s")
        left.legend(fontsize=7)
    return figure


def warped(model: Model, shapes, mirrors: Sequence[str]):
    """The deformed whole at each shape as PyVista grids, β in [0, 1] as point data."""
    import pyvista

    # What lies next to a node, for means over cells as thick as the shell would hide the pattern.
    body = model.body
    beta = np.broadcast_to(model.beta.reshape(*model.beta.shape[:1], -1), body.weights.shape)
    near = cKDTree(body.points().reshape(-1, 3)).query(body.nodes)[1]
    out = []
    for _, u in shapes:
        data = grid(body, u, point_data={"beta": beta.ravel()[near]})
        part = pyvista.wrap(data).warp_by_vector("displacement")
        for normal in mirrors:
            part = part.merge(
                part.reflect({"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}[normal]),
                merge_points=False,
            )
        out.append(part)
    return out


def panel(plotter, place, shape, camera) -> None:
    """One picture: a grid's surface coloured by β, seen by a camera of parallel rays."""
    surface = shape.extract_surface(nonlinear_subdivision=3, algorithm="dataset_surface")
    plotter.subplot(*place)
    plotter.add_mesh(
        surface.compute_normals(feature_angle=40, split_vertices=True), scalars="beta",
        clim=(0, 1), cmap=COLOURS, show_scalar_bar=False, smooth_shading=True, ambient=0.3,
        diffuse=0.7,
    )  # fmt: skip
    towards, up, focus, reach = camera
    focus = np.array(focus, float)
    plotter.camera_position = [tuple(focus + 10 * np.array(towards)), tuple(focus), up]
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = reach
    plotter.reset_camera_clipping_range()


def draw(model: Model, shapes, path) -> None:
    """Section across at x = 0, section along at y = 0, and the ventral side in perspective."""
    import pyvista

    whole = warped(model, shapes, ("x", "y"))
    plotter = pyvista.Plotter(
        off_screen=True, window_size=(500 * len(whole), 1100), shape=(3, len(whole)), border=False
    )
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")
    for k, (half, shape) in enumerate(zip(warped(model, shapes, ("y",)), whole, strict=True)):
        panel(plotter, (0, k), half, ((-1, 0, 0), (0, 0, 1), (0, 0, 0), 0.5))
        along = warped(model, shapes[k : k + 1], ("x",))[0]
        panel(plotter, (1, k), along, ((0, -1, 0), (0, 0, 1), (0, 0, 0), 0.8))
        panel(plotter, (2, k), shape, ((0.25, -0.75, -1), (0, 0, 1), (0, 0, 0), 0.75))
    plotter.screenshot(str(path))
    plotter.close()


def framed(path, shapes, contraction: float):
    """The screenshot with a title over each of its columns."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    image = mpl.image.imread(str(path))
    with mpl.rc_context(STYLE):
        width, top, bottom = 6.4, 0.35, 0.62
        height = width * image.shape[0] / image.shape[1] + top + bottom
        figure = Figure(figsize=(width, height))
        ax = figure.add_axes((0, bottom / height, 1, 1 - (top + bottom) / height))
        ax.imshow(image)
        ax.axis("off")
        for k, (load, _) in enumerate(shapes):
            figure.text(
                (k + 0.5) / len(shapes),
                1 - 0.22 / height,
                f"$|g| = {load * contraction:.2g}$",
                ha="center",
            )
        bar = figure.add_axes((0.35, 0.44 / height, 0.3, 0.1 / height))
        scale = mpl.cm.ScalarMappable(mpl.colors.Normalize(0, 1), COLOURS)
        figure.colorbar(scale, cax=bar, orientation="horizontal", label=r"pattern $\beta$")
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
