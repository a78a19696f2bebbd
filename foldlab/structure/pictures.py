"""Pictures of a structure as it folds: states side by side, a GIF, angles over the contraction."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from foldlab.plots import LINES, STYLE

if TYPE_CHECKING:
    from solver.cases.structure.path import Folding, State

PANEL, VALLEY, MOUNTAIN, FREE = "#9DB4CC", "#E2A33B", "#B9653A", "#D9DDE2"
VIEW = {"elev": 28, "azim": -62}
FRAMES = 40  # of a GIF, at most


def _limits(states: Sequence[State]) -> np.ndarray:
    """Low and high (2, 3) of everything, m."""
    points = np.concatenate([p for s in states for p in s.panels])
    return np.array([points.min(axis=0), points.max(axis=0)])


def _draw(ax, state: State, folds: Sequence[int], limits: np.ndarray, unit: float) -> None:
    colours = {1: VALLEY, -1: MOUNTAIN, 0: FREE}
    strips = [colours[f] for f in folds]
    parts = [unit * p for p in (*state.panels, *state.strips)]
    faces = Poly3DCollection(
        parts, facecolors=[PANEL] * len(state.panels) + strips, edgecolors="#3C4650",
        linewidths=0.4, shade=False,
    )  # fmt: skip
    ax.add_collection3d(faces)
    low, high = unit * limits
    size = np.maximum(high - low, 0.05 * (high - low).max())
    for axis, a, s in zip("xyz", low, size, strict=True):
        getattr(ax, f"set_{axis}lim")(a, a + s)
    ax.set_box_aspect(size, zoom=1.25)
    ax.view_init(**VIEW)
    ax.set_axis_off()


def picked(states: Sequence[State], count: int) -> list[State]:
    """``count`` of the states, spread evenly over the load, the first and the last among them."""
    loads = np.array([float(s.e) for s in states])
    at = [int(np.abs(loads - e).argmin()) for e in np.linspace(loads[0], loads[-1], count)]
    return [states[k] for k in dict.fromkeys(at)]


def plot_states(folding: Folding, count: int = 4) -> Figure:
    """States side by side, in mm, with how far the contraction has come."""
    chosen = picked(folding.states, count)
    limits = _limits(chosen)
    folds = [h.crease.fold for h in folding.model.structure.pattern.hinges]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(2.6 * len(chosen), 2.4), dpi=200)
        for k, state in enumerate(chosen):
            ax = figure.add_subplot(1, len(chosen), k + 1, projection="3d")
            _draw(ax, state, folds, limits, 1e3)
            ax.set_title(f"{100 * float(state.e):.0f} % of the contraction", fontsize=8)
        figure.subplots_adjust(left=0, right=1, bottom=0, top=0.92, wspace=0)
    return figure


def plot_angles(folding: Folding) -> Figure:
    """Angle of every hinge over the contraction, valleys and mountains."""
    e = [100 * float(s.e) for s in folding.states]
    angles = np.degrees([s.angles for s in folding.states])
    hinges = folding.model.structure.pattern.hinges
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.2, 3.0), layout="constrained")
        ax = figure.subplots()
        named = set()
        for k, hinge in enumerate(hinges):
            fold = hinge.crease.fold
            label = {1: "valley", -1: "mountain", 0: "free"}[fold]
            ax.plot(
                e, angles[:, k], color=LINES[{1: 0, -1: 1, 0: 4}[fold]], lw=1, alpha=0.8,
                label=None if label in named else label,
            )  # fmt: skip
            named.add(label)
        ax.axhline(0, color="0.8", lw=0.6, zorder=0)
        ax.set_xlabel("contraction, % of the full one")
        ax.set_ylabel("angle of each hinge, degrees")
        ax.legend()
    return figure


def plot_solid(folding: Folding) -> Figure:
    """The surface of a solid in its last state, seen from both sides; mountains' layers lie below
    the sheet."""
    model, x, e = folding.model, folding.x, folding.last.e
    mesh = model.body.mesh
    facets = mesh.boundary_facets()
    ring = _around(mesh, facets)
    corners = model.body.cells[:, :8]
    at = np.empty(mesh.p.shape[1], int)
    at[mesh.t.T] = corners
    X = 1e3 * model.structure.pattern.extent * (
        model.body.nodes + model.scene.displacement(x, e)
    )[at[ring]]  # fmt: skip
    own = mesh.f2t[0, facets]
    folds = np.array([h.crease.fold for h in model.structure.pattern.hinges])
    layer = np.where(folds[model.sheet.hinge[own]] > 0, VALLEY, MOUNTAIN)
    colours = np.where(model.sheet.active[own], layer, PANEL)
    low, high = X.min(axis=(0, 1)), X.max(axis=(0, 1))
    size = np.maximum(high - low, 0.05 * (high - low).max())
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 3.4), dpi=200)
        for k, view in enumerate((VIEW, VIEW | {"azim": VIEW["azim"] + 180})):
            ax = figure.add_subplot(1, 2, k + 1, projection="3d")
            faces = Poly3DCollection(X, facecolors=colours, edgecolors="#3C4650", linewidths=0.1)
            ax.add_collection3d(faces)
            for axis, a, s in zip("xyz", low, size, strict=True):
                getattr(ax, f"set_{axis}lim")(a, a + s)
            ax.set_proj_type("ortho")
            ax.set_box_aspect(size / size.max(), zoom=0.95)
            ax.view_init(**view)
            ax.set_axis_off()
        figure.subplots_adjust(left=0, right=1, bottom=0, top=1, wspace=0)
    return figure


def _around(mesh, facets: np.ndarray) -> np.ndarray:
    """Corners (f, 4) of quadrilaterals in order around each."""
    ring = mesh.facets[:, facets].T
    X = mesh.p.T[ring]
    # Of the three ways to go around, the one whose sides are shortest crosses nothing.
    ways = np.array([[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 1, 3]])
    long = [np.linalg.norm(X[:, w] - X[:, np.roll(w, -1)], axis=2).sum(axis=1) for w in ways]
    return np.take_along_axis(ring, ways[np.argmin(long, axis=0)], axis=1)


def save_gif(folding: Folding, path: Path) -> None:
    """The states as an animation."""
    from PIL import Image

    chosen = picked(folding.states, FRAMES)
    limits = _limits(folding.states)
    folds = [h.crease.fold for h in folding.model.structure.pattern.hinges]
    frames = []
    for state in chosen:
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(4.4, 3.6), dpi=100)
            ax = figure.add_subplot(projection="3d")
            _draw(ax, state, folds, limits, 1e3)
            figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
            frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))
    held = [80] * (len(frames) - 1) + [1200]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=held, loop=0)


def save_series(folding: Folding, folder: Path) -> Path:
    """The states as VTK surfaces and a ``structure.pvd`` for ParaView, m."""
    import pyvista

    folder.mkdir(parents=True, exist_ok=True)
    folds = [h.crease.fold for h in folding.model.structure.pattern.hinges]
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "<Collection>"]
    for k, state in enumerate(folding.states):
        parts, cells, at = [*state.panels, *state.strips], [], 0
        for part in parts:
            cells += [len(part), *range(at, at + len(part))]
            at += len(part)
        surface = pyvista.PolyData(np.concatenate(parts), faces=np.array(cells))
        none = [0.0] * len(state.panels)
        surface.cell_data["angle"] = np.array(none + state.angles.tolist())
        surface.cell_data["fold"] = np.array(none + [float(f) for f in folds])
        name = f"structure_{k:04d}.vtp"
        surface.save(folder / name)
        lines.append(f'<DataSet timestep="{float(state.e):.9g}" file="{name}"/>')
    path = folder / "structure.pvd"
    path.write_text("\n".join([*lines, "</Collection>", "</VTKFile>"]), encoding="utf-8")
    return path
