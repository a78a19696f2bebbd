"""Figures of the lung: meshes, paths, sections, stability, and what the dissertation says."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.ticker import MaxNLocator

from foldlab.plots import LINES, STYLE

from .render import COLOURS

PRESSURE = r"pressure $p/E_{ep}$"


def plot_pictures(
    images: Sequence[Path], titles: Sequence[str], limits: Sequence[tuple[float, float]]
) -> Figure:
    """The pictures side by side, each with the scale of its colours."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(2.75 * len(images), 3.65), layout="constrained", dpi=200)
        axes = figure.subplots(1, len(images), squeeze=False)[0]
        for ax, path, title, (low, high) in zip(axes, images, titles, limits, strict=True):
            ax.imshow(imread(path))
            ax.set_title(title)
            ax.set_axis_off()
            scale = ScalarMappable(Normalize(low, high), COLOURS)
            bar = figure.colorbar(
                scale,
                ax=ax,
                orientation="horizontal",
                shrink=0.7,
                pad=0.02,
                label="epithelium's radial displacement / R",
            )
            bar.locator = MaxNLocator(4)
            bar.ax.set_visible(high - low > 2e-3)
    return figure


def plot_inflation(
    sphere: Sequence[Mapping],
    radial: Mapping[float, float],
    rows: Sequence[Mapping],
    curves: Mapping[str, Sequence],
    pressure: float,
) -> Figure:
    """Bare sphere and radial solution; aspect ratio over pressure; meshes beside the finest one."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.4, 3.4), layout="constrained", dpi=200)
        left, middle, right = figure.subplots(1, 3)
        left.plot(radial.keys(), radial.values(), "k*", ms=8, label="radial solution")
        left.plot(
            [r["stretch"] for r in sphere],
            [r["pressure"] for r in sphere],
            "o",
            ms=3.5,
            color=LINES[1],
            label="wedge without muscle",
        )
        left.set(xlabel="inner stretch", ylabel=PRESSURE)
        worst = max(abs(r["error"]) for r in sphere)
        left.set_title(f"thick sphere: at most {100 * worst:.2g} % apart")
        left.legend()
        colours = mpl.colormaps["tab10"].colors
        for k, (name, curve) in enumerate(curves.items()):
            dashed = "-" if name.startswith("hex") else "--"
            middle.plot(*np.array(curve).T, dashed, color=colours[k % 10], label=name)
        middle.axvline(pressure, color="0.6", lw=0.8, zorder=0)
        middle.set(xlabel=PRESSURE, ylabel="aspect ratio, depth / spacing")
        middle.set_title("wedge, up to the limit point")
        middle.legend(fontsize=7)
        for k, row in enumerate(rows):
            whole = row["part"] == "sphere"
            name = f"{row['mesh']}{', whole sphere' if whole else ''}"
            unknowns = row["unknowns"] / (120 if whole else 1)
            right.plot(
                unknowns,
                100 * row["beside_finest"],
                "s" if whole else "o",
                color=colours[k % 10],
                label=name,
                ms=5,
            )
        right.axhspan(-2, 2, color="0.92", zorder=0)
        right.set(
            xscale="log",
            xlabel="unknowns per wedge",
            ylabel="aspect ratio beside the finest hexahedra, %",
        )
        right.set_title(f"at p = {pressure:g} (band: ± 2 %)")
        right.legend(fontsize=7)
    return figure


def panel(count: int = 1) -> tuple:
    """A figure of ``count`` axes with room for the statements below."""
    figure = Figure(figsize=(4.0 * count + 0.6, 4.3), dpi=200)
    figure.subplots_adjust(
        left=0.13 if count == 1 else 0.09, right=0.97, top=0.92, bottom=0.36, wspace=0.28
    )
    return figure, *figure.subplots(1, count, squeeze=False)[0]


def signed(figure: Figure, claim: str, finding: str, verdict: str) -> Figure:
    """The figure with what the dissertation says and what we computed below its axes."""
    wide = 4 + 76 * len(figure.axes)
    text = [f"Dissertation: {claim}", f"Here: {finding}", f"Verdict: {verdict}."]
    with mpl.rc_context(STYLE):
        figure.text(
            0.02, 0.02, "\n".join(textwrap.fill(t, wide) for t in text), fontsize=8, va="bottom"
        )
    return figure


def plot_pressure(
    loads: np.ndarray, lines: Mapping[str, Sequence[float]], rows: Sequence[Mapping], limit: bool
) -> Figure:
    """Aspect ratio over pressure; ``rows``: pressures asked for, and whether they are reached."""
    with mpl.rc_context(STYLE):
        figure, ax = panel()
        for k, (name, values) in enumerate(lines.items()):
            ax.plot(
                loads, values, "--" if k else "-", lw=1 if k else 1.4, color=LINES[k], label=name
            )
        asked = [row["pressure"] for row in rows]
        ax.axvspan(min(asked), max(asked), color="0.9", lw=0, label="pressures asked for")
        for row in rows:
            name = None if row["reached"] else f"{row['case']}: not reached"
            ax.axvline(
                row["pressure"],
                color="0.6" if row["reached"] else LINES[1],
                lw=0.8,
                ls="-" if row["reached"] else ":",
                label=name,
            )
        if limit:
            ax.plot(loads[-1], next(iter(lines.values()))[-1], "k*", ms=8, label="limit point")
        ax.set(xlabel=PRESSURE, ylabel="aspect ratio")
        ax.legend()
    return figure


def plot_curves(
    curves: Mapping[str, tuple],
    label: str,
    cuts: Mapping[str, object] | None = None,
    title: str = "",
) -> Figure:
    """Aspect ratio over something, a line per case; sections beside it where there are some."""
    with mpl.rc_context(STYLE):
        figure, ax, *right = panel(2 if cuts else 1)
        for k, (name, (along, values)) in enumerate(curves.items()):
            ax.plot(along, values, "o-", ms=2.5, color=LINES[k % len(LINES)], label=name)
        ax.set(xlabel=label, ylabel="aspect ratio")
        ax.legend()
        if cuts:
            draw_sections(right[0], cuts, title)
    return figure


def draw_sections(ax, cuts: Mapping[str, object], title: str) -> None:
    """Sections over each other, bundles hatched.

    Each has the ``lines`` of the epithelium's faces and the outline of the ``bundle``.
    """
    for (name, cut), colour in zip(cuts.items(), LINES, strict=False):
        inner, outer = cut.lines
        ax.fill(*np.concatenate([inner, outer[::-1]]).T, color=colour, alpha=0.25, lw=0)
        ax.plot(*inner.T, color=colour, lw=1, label=name)
        ax.plot(*outer.T, color=colour, lw=1)
        ax.fill(*cut.bundle.T, facecolor="none", edgecolor=colour, hatch="/////", lw=0.8)
    ax.set(xlabel="y / R", ylabel="z / R", title=title)
    ax.set_aspect("equal", adjustable="box")
    ax.legend(loc="upper right")


def plot_stiffness(table: pd.DataFrame, pressure: float, low: float) -> Figure:
    """Aspect ratio and largest pressure over E_sm/E_ep for each mesh."""
    with mpl.rc_context(STYLE):
        figure, ax, right = panel(2)
        for k, (name, part) in enumerate(table.groupby("mesh", sort=False)):
            style = {"color": LINES[k], "ms": 4, "lw": 1}
            E = part["stiffness"]
            ax.plot(
                E, part["aspect"].astype(float), "o-", **style, label=f"{name}, p = {pressure:g}"
            )
            ax.plot(
                E,
                part["at_limit"].astype(float),
                "*:",
                **style,
                label=f"{name}, at the limit point",
            )
            ax.plot(E, part["low"].astype(float), "s--", **style, label=f"{name}, p = {low:g}")
            right.plot(E, part["limit"].astype(float), "o-", **style, label=name)
        right.axhline(pressure, color="0.6", lw=0.8, zorder=0)
        ax.set(xlabel=r"$E_{sm}/E_{ep}$", ylabel="aspect ratio")
        right.set(xlabel=r"$E_{sm}/E_{ep}$", ylabel=r"largest pressure $p/E_{ep}$")
        ax.legend(fontsize=6.5, loc="center", bbox_to_anchor=(0.66, 0.37))
        right.legend()
    return figure


def plot_models(cuts: Mapping[str, Mapping[str, object]], rows: Sequence[Mapping]) -> Figure:
    """Sections of both models, a panel per state; bars where there are no sections."""
    with mpl.rc_context(STYLE):
        if not cuts:
            figure, ax = panel()
            ax.bar([r["case"] for r in rows], [r["aspect"] for r in rows], color=LINES[0])
            ax.tick_params(axis="x", labelsize=6)
            ax.set_ylabel("aspect ratio")
            return figure
        figure, *axes = panel(len(cuts))
        for ax, (title, pair) in zip(axes, cuts.items(), strict=True):
            draw_sections(ax, pair, title)
    return figure


def plot_stability(table: pd.DataFrame) -> Figure:
    """Unstable modes along inflation and puncture, by symmetry class and in all."""
    with mpl.rc_context(STYLE):
        figure, *axes = panel(2)
        for ax, name, along, label in (
            (axes[0], "inflation", "pressure", PRESSURE),
            (axes[1], "puncture", "g", "contraction g"),
        ):
            part = table[table["case"] == name]
            for k, column in enumerate(("even", "odd in one", "odd in two", "odd in three")):
                ax.plot(
                    part[along],
                    part[column].astype(float),
                    ".-",
                    lw=1,
                    color=LINES[k],
                    label=column,
                )
            ax.plot(part[along], part["unstable"].astype(float), "ko-", ms=3, label="whole sphere")
            ax.set(title=name, ylabel="unstable modes", xlabel=label)
            ax.set_ylim(-0.5, max(4.5, 1.1 * part["unstable"].max()))
            ax.yaxis.get_major_locator().set_params(integer=True)
            if name == "puncture":
                ax.invert_xaxis()
            ax.legend(fontsize=7)
    return figure
