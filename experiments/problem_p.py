"""Which element gives Problem P's fold angle at what cost, and how badly do linear tets lock?

Uniaxial contraction needs one element across the quarter's width. Isotropic contraction lets the
hinge curl about the other axis and the panels wave, which takes several across and along, with
three points along every axis.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from foldlab.plots import STYLE
from solver.cases.unit import problem_p
from solver.output import Series, cell_fields
from solver.paths.continuation import Path, trace
from solver.paths.steppers import LoadSteps

from .common import OUT, main, save_figure


@dataclass(frozen=True)
class Config:
    seed: int = 0
    levels: tuple[int, ...] = (0, 1, 2, 3)
    elements: tuple[str, ...] = ("hex27", "hex20", "hex8", "tet10", "tet4")
    growths: tuple[str, ...] = ("uniaxial", "isotropic")
    isotropic_levels: tuple[int, ...] = (0, 1, 2)
    series_level: int = 1
    g: float = -0.3
    steps: int = 12


TINY = Config(
    levels=(0,), elements=("hex20", "tet4"), growths=("uniaxial",), steps=6, series_level=0
)

ANGLES = {"uniaxial": problem_p.ANGLE, "isotropic": problem_p.ANGLE_ISOTROPIC}


def follow_to(scene, steps: int = 8, rtol: float = 1e-7) -> Path:
    """The path from flat to e = 1 by load steps with the predictor of third order."""
    stepper = LoadSteps(rtol=rtol, step=1 / steps)
    return trace(scene, np.zeros(scene.size), stepper, max_steps=50 * steps, events=False)


def run(config: Config, tracker) -> dict[str, Any]:
    rows, curves = [], []
    for growth in config.growths:
        for element in config.elements:
            uniaxial = growth == "uniaxial"
            for level in config.levels if uniaxial else config.isotropic_levels:
                start = time.perf_counter()
                sizes = (problem_p.LEVELS if uniaxial else problem_p.LEVELS_ISOTROPIC)[level]
                body = problem_p.mesh(sizes, element, bent=uniaxial)
                scene = problem_p.scene(body, config.g, growth=growth)
                path = follow_to(scene, config.steps if uniaxial else 3 * config.steps)
                seconds = time.perf_counter() - start
                angles = [problem_p.fold_angle(scene, p.x, p.e) for p in path.points]
                row = {
                    "growth": growth,
                    "element": element,
                    "level": level,
                    "unknowns": scene.size,
                    "angle": angles[-1] if path.reached else None,
                    "error": abs(angles[-1] / ANGLES[growth] - 1)
                    if path.reached and config.g == -0.3
                    else None,
                    "iterations": path.iterations,
                    "unstable": path.last.unstable,
                    "seconds": seconds,
                    "outcome": path.outcome.value,
                }
                print(row, file=sys.stderr)
                rows.append(row)
                curves += [
                    {"growth": growth, "element": element, "level": level, "g": config.g * p.e,
                     "angle": angle, "unstable": p.unstable}
                    for p, angle in zip(path.points, angles, strict=True)
                ]  # fmt: skip
    curves = pd.DataFrame(curves)
    tracker.table("elements", pd.DataFrame(rows))
    tracker.table("curves", curves)
    finest = curves.groupby("growth")["level"].transform("max")
    figure = plot_angles(curves[curves["level"] == finest])
    save_figure(figure, "problem_p")
    tracker.figure("problem_p", figure)
    series = write_series(config.series_level, config.g)
    picture(series, OUT / "problem_p_shapes.png")
    return {"table": rows, "curves": curves.to_dict("records"), "series": str(series.path)}


def write_series(level: int, g: float):
    """The whole unit as a series ``out/problem_p/unit.pvd`` (ParaView, PyVista)."""
    scene = problem_p.scene(problem_p.mesh(level, quarter=False), g)
    path = follow_to(scene)
    folder = OUT / "problem_p"
    folder.mkdir(parents=True, exist_ok=True)
    series = Series(folder / "unit.pvd", scene.body)
    for point in path.points:
        u = scene.displacement(point.x, point.e)
        series.write(point.e, u, cell_data=cell_fields(scene.body, u, scene.terms, point.e))
    return series


def picture(series: Series, path, times: int = 3) -> None:
    """Deformed shapes at the start, middle and end of a series, coloured by layer."""
    import pyvista

    reader = pyvista.get_reader(str(series.path))
    plotter = pyvista.Plotter(
        off_screen=True, window_size=(1200, 420), shape=(1, times), border=False
    )
    plotter.set_background("white")
    for k in range(times):
        near = np.abs(np.array(series.loads) - k / (times - 1))
        reader.set_active_time_point(int(near.argmin()))
        shape = reader.read()[0].warp_by_vector("displacement")
        surface = shape.extract_surface(nonlinear_subdivision=4, algorithm="dataset_surface")
        plotter.subplot(0, k)
        plotter.add_mesh(surface, scalars="layer", cmap=["#e8c35a", "#3b74b8"],
                         show_scalar_bar=False, smooth_shading=False)  # fmt: skip
        plotter.camera_position = [(1.6, -1.3, 0.9), (0, 0, 0.14), (0, 0, 1)]
        plotter.camera.zoom(1.1)
    plotter.screenshot(str(path))
    plotter.close()


def plot_angles(curves: pd.DataFrame):
    """Fold angle over contraction for each element on its finest mesh."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        growths = list(curves["growth"].unique())
        figure = Figure(figsize=(3.4 * len(growths), 3.0), layout="constrained")
        for ax, growth in zip(
            figure.subplots(1, len(growths), squeeze=False)[0], growths, strict=True
        ):
            part = curves[curves["growth"] == growth]
            for element, curve in part.groupby("element", sort=False):
                ax.plot(-curve["g"], curve["angle"], "o-", ms=2.5, lw=1, label=element)
            if growth == "uniaxial":
                reference = [1.2393, 2.4913, 3.772]
                ax.plot([0.1, 0.2, 0.3], reference, "k*", ms=7, label="converged", zorder=5)
            ax.set_xlabel("contraction |g|")
            ax.set_ylabel("fold angle, rad")
            ax.set_title(growth)
            ax.legend(fontsize=7)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
