"""Figures of one unit's path: its shapes, its angles over the contraction, an animation."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from foldlab.plots import LINES, STYLE
from foldlab.unit.render import CURVES, LAYERS, STRAIN

CURVE_NAMES = ("C1, along the sheet", "C2, across the hinge", "C3, edge", "C4, edge")


def plot_shapes(pictures: Sequence[Path], titles: Sequence[str], *, ground: bool) -> Figure:
    """Rendered pictures of one size side by side, with what their colours mean."""
    images = [imread(path) for path in pictures]
    high, wide = images[0].shape[:2]
    with mpl.rc_context(STYLE):
        width = 9.0
        panel = width / len(images) * high / wide
        figure = Figure(figsize=(width, panel + 0.62), layout="constrained", dpi=200)
        axes = figure.subplots(1, len(images), squeeze=False)[0]
        for ax, image, title in zip(axes, images, titles, strict=True):
            ax.imshow(image, interpolation="antialiased")
            ax.set_title(title, fontsize=10)
            ax.set_axis_off()
        _legend(figure, ground)
    return figure


def plot_strain(picture: Path, most: float, title: str) -> Figure:
    """A rendered picture that is coloured by strain up to ``most``, with its scale."""
    image = imread(picture)
    with mpl.rc_context(STYLE):
        width = 6.0
        figure = Figure(
            figsize=(width, width * image.shape[0] / image.shape[1] + 1.2),
            layout="constrained",
            dpi=200,
        )
        ax = figure.subplots()
        ax.imshow(image, interpolation="antialiased")
        ax.set_title(title, fontsize=10)
        ax.set_axis_off()
        scale = mpl.cm.ScalarMappable(mpl.colors.Normalize(0.0, 100 * most), STRAIN)
        figure.colorbar(
            scale, ax=ax, location="bottom", shrink=0.7, extend="max",
            label="largest principal elastic strain in a cell, %",
        )  # fmt: skip
    return figure


def plot_side(
    curves: np.ndarray, design: Mapping[str, float], titles: Sequence[str], *, ground: bool
) -> Figure:
    """Shapes from the side where nothing renders in three dimensions: C1 with the thicknesses.

    ``curves`` (states, 4, points, 3). The section is drawn in the plane of y and z, as if
    thicknesses stayed what they were.
    """
    h, top = design["slenderness"], design["h_ratio"] * design["slenderness"]
    with mpl.rc_context(STYLE):
        span = np.ptp(np.asarray(curves)[:, 0, :, 1:], axis=(0, 1)) + 0.1
        high = 1.3 + 8.2 / len(titles) * span[1] / span[0]
        figure = Figure(figsize=(9.0, high), layout="constrained", dpi=200)
        axes = figure.subplots(1, len(titles), sharex=True, sharey=True, squeeze=False)[0]
        for ax, state, title in zip(axes, curves, titles, strict=True):
            middle = state[0][:, 1:]
            t = np.gradient(middle, axis=0)
            normal = np.stack([-t[:, 1], t[:, 0]], axis=1) / np.linalg.norm(t, axis=1)[:, None]
            inside = np.abs(np.linspace(-0.5, 0.5, len(middle))) <= design["hinge_length"] / 2
            for on, low, high, name in (
                (slice(None), -h / 2, h / 2, "passive"),
                (inside, h / 2, h / 2 + top, "active"),
            ):
                m, n = middle[on], normal[on]
                outline = np.vstack([m + low * n, (m + high * n)[::-1]])
                ax.fill(*outline.T, color=LAYERS[name], ec="#666666", lw=0.3)
            ax.plot(*middle.T, color=CURVES[0], lw=0.8)
            if ground:
                ax.axhspan(-0.02, 0.0, color=LAYERS["ground"], lw=0)
            ax.set_aspect("equal")
            ax.set_title(title, fontsize=10)
            ax.set_xlabel(r"$y/l_s$")
            ax.spines[["top", "right"]].set_visible(False)
        axes[0].set_ylabel(r"$z/l_s$")
        _legend(figure, ground, curves=1)
    return figure


def _legend(figure: Figure, ground: bool, curves: int = 4) -> None:
    handles = [
        Patch(fc=LAYERS[name], ec="#666666", lw=0.4, label=label)
        for name, label in (("passive", "passive"), ("active", "active"), ("ground", "ground"))
        if ground or name != "ground"
    ]
    handles += [
        Line2D([], [], color=colour, lw=1.6, label=label)
        for colour, label in zip(CURVES[:curves], CURVE_NAMES[:curves], strict=True)
    ]
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=len(handles),
        columnspacing=1.4,
        handlelength=1.4,
    )


def plot_angles(
    history: Sequence[Mapping[str, float]],
    contraction: float,
    limits: tuple[float, float],
    events: Sequence[Mapping[str, Any]],
    loads: Sequence[float] | None = None,
) -> Figure:
    """m1 and m2 over the contraction in per cent, with the angles that tell folded and curled.

    ``limits``: those angles at the full contraction. ``loads``: the abscissa of a path that goes on
    at full contraction, 0 … 1 uniaxial and 1 … 2 released, instead.
    """
    x = 100 * np.array([h["contraction"] for h in history])
    end = 100 * contraction
    if loads is not None:
        x, end = np.asarray(loads, float), 2.0
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.2), layout="constrained", dpi=200)
        axes = figure.subplots(1, 2)
        for ax, name, limit, label, says in zip(
            axes,
            ("m1", "m2"),
            limits,
            ("fold angle $m_1$, rad", "turning across the hinge $m_2$, rad"),
            ("folded above", "curled above"),
            strict=True,
        ):
            ax.plot(x, [h[name] for h in history], "o-", ms=3, color=LINES[0])
            ax.plot(
                [0, end],
                [limit, limit] if loads is not None else [0, limit],
                ls=(0, (4, 3)),
                lw=0.9,
                color=LINES[4],
                label=says,
            )
            ax.set_xlim(0, end * 1.03)
            ax.set_xlabel("contraction, %" if loads is None else "uniaxial to 1, released to 2")
            ax.set_ylabel(label)
            ax.spines[["top", "right"]].set_visible(False)
            ax.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1, borderpad=0)
        # An event's place on a path with a release is not its contraction alone.
        if loads is None:
            _mark(axes[0], events)
    return figure


def _mark(ax, events: Sequence[Mapping[str, Any]]) -> None:
    """Dotted lines where events are; those too near to each other for two names share one."""
    near = 0.035 * ax.get_xlim()[1]
    groups: list[tuple[float, list[str]]] = []
    for event in sorted(events, key=lambda event: event["contraction"]):
        place = 100 * event["contraction"]
        ax.axvline(place, color=LINES[1], ls=":", lw=0.9, zorder=0)
        if not groups or place - groups[-1][0] > near:
            groups.append((place, []))
        if event["kind"] not in groups[-1][1]:
            groups[-1][1].append(event["kind"])
    for place, kinds in groups:
        ax.annotate(
            ", ".join(kinds), (place, 0.98), (2, 0), rotation=90, fontsize=8, color=LINES[1],
            xycoords=ax.get_xaxis_transform(), textcoords="offset points", ha="left", va="top",
            bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.6},
        )  # fmt: skip


def write_animation(path: Path, pictures: Sequence[Path], titles: Sequence[str]) -> None:
    """A GIF of rendered pictures, each under its title; the last one stays."""
    from PIL import Image

    frames = []
    for picture, title in zip(pictures, titles, strict=True):
        image = imread(picture)
        high, wide = image.shape[:2]
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(wide / 100, high / 100 + 0.3), dpi=100)
            FigureCanvasAgg(figure)
            fraction = high / (high + 30)
            ax = figure.add_axes((0, 0, 1, fraction))
            ax.imshow(image, interpolation="none", aspect="auto")
            ax.set_axis_off()
            figure.text(0.5, (1 + fraction) / 2, title, ha="center", va="center", fontsize=11)
            figure.canvas.draw()
            pixels = np.asarray(figure.canvas.buffer_rgba())
        frames.append(Image.fromarray(pixels).convert("RGB").quantize(64))
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        frames[0].save(
            draft, format="GIF", save_all=True, append_images=frames[1:], loop=0, optimize=True,
            duration=[150] * (len(frames) - 1) + [1500],
        )  # fmt: skip
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
