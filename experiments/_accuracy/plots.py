"""Figures of accuracy_vs_time: work–precision, log–log where both axes are costs and errors."""

from __future__ import annotations

import matplotlib as mpl
import matplotlib.ticker
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from foldlab.plots import LINES, STYLE

MARKERS = "osD^vP"
ELEMENTS = ("tet4", "tet10", "hex8", "hex20", "hex27")
FLOOR = 1e-13  # an error of 0 has no place on a log axis


def panels(count: int, width: float = 3.1, height: float = 2.9, columns: int = 4):
    """A figure and its axes in rows of at most ``columns``."""
    across = min(count, columns)
    down = -(-count // across)
    figure = Figure(figsize=(width * across, height * down), layout="constrained")
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for ax in axes[count:]:
        ax.set_visible(False)
    for ax in axes[:count]:
        ax.grid(True, which="major", lw=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes[:count]


def seconds(ax) -> None:
    """Plain numbers on a log axis of seconds; between few powers of ten at 2 and 5 too."""
    low, high = ax.get_xlim()
    between = ("2", "5") if high < 200 * low else ()
    ax.xaxis.set_major_formatter(mpl.ticker.FuncFormatter(lambda v, _: f"{v:g}"))
    ax.xaxis.set_minor_formatter(
        mpl.ticker.FuncFormatter(lambda v, _: f"{v:g}" if f"{v:e}"[0] in between else "")
    )


def draw_elements(rows: list[dict]) -> Figure:
    """(a): error of the fold angle against core-seconds, a line per element along its meshes."""
    table = pd.DataFrame(rows)
    with mpl.rc_context(STYLE):
        scenes = list(table["scene"].unique())
        figure, axes = panels(len(scenes), columns=2, width=3.6)
        for ax, scene in zip(axes, scenes, strict=True):
            for k, element in enumerate(ELEMENTS):
                part = table[(table["scene"] == scene) & (table["element"] == element)]
                part = part[part["error"].notna()]
                if len(part):
                    ax.loglog(
                        part["core_seconds"], part["error"].clip(lower=1e-7), marker=MARKERS[k],
                        color=LINES[k], ms=4, lw=1, label=element,
                    )  # fmt: skip
            ax.set(title=scene, xlabel="core-seconds of the path", ylabel="error of the fold angle")
            seconds(ax)
        axes[0].legend(loc="best")
    return figure


def draw_steppers(rows: list[dict]) -> Figure:
    """(b): what the stepper adds to the error, between the points and at the end."""
    table = pd.DataFrame(rows)
    with mpl.rc_context(STYLE):
        scenes, kinds = list(table["scene"].unique()), list(table["stepper"].unique())
        figure, axes = panels(2 * len(scenes), columns=2, width=3.6)
        rtols = sorted(table["rtol"].unique(), reverse=True)
        for (ax_path, ax_end), scene in zip(axes.reshape(-1, 2), scenes, strict=True):
            for k, kind in enumerate(kinds):
                for j, rtol in enumerate(rtols):
                    part = table[(table["scene"] == scene) & (table["stepper"] == kind)]
                    part = part[(part["rtol"] == rtol) & part["error"].notna()]
                    style = {"color": LINES[k], "marker": MARKERS[j], "ms": 3.5, "lw": 0.8}
                    style["mfc"] = "none" if j else LINES[k]
                    ax_path.loglog(part["core_seconds"], part["error"], **style)
                    floored = part["end_error"].clip(lower=FLOOR)
                    ax_end.loglog(part["core_seconds"], floored, **(style | {"ls": "none"}))
            arrived = table.loc[table["scene"] == scene, "error"].notna()
            short = f"{(~arrived).sum()} of {len(arrived)} paths end early"
            ax_path.set(title=f"{scene}: {short}", ylabel="error between the points, as drawn")
            ax_end.set(title=scene, ylabel="error at the full contraction")
        for ax in axes:
            ax.set_xlabel("core-seconds of the path")
            seconds(ax)
        for k, kind in enumerate(kinds):
            axes[0].plot([], [], color=LINES[k], label=kind)
        for j, rtol in enumerate(rtols):
            face = "none" if j else "#4D4D4D"
            axes[1].plot([], [], color="#4D4D4D", marker=MARKERS[j], mfc=face, ls="none",
                         label=f"rtol {rtol:.0e}")  # fmt: skip
        axes[0].legend(fontsize=7)
        axes[1].legend(fontsize=7)
    return figure


def draw_wholes(rows: list[dict]) -> Figure:
    """(c): core-seconds of a quarter and of the whole, by scene and mesh."""
    table = pd.DataFrame(rows)
    with mpl.rc_context(STYLE):
        figure, (ax,) = panels(1, width=5.2)
        names = [f"{r['scene']}\nmesh {r['level']}" for r in rows if r["model"] == "quarter"]
        place = np.arange(len(names))
        for k, kind in enumerate(("quarter", "whole")):
            part = table[table["model"] == kind]
            ax.bar(place + 0.38 * (k - 0.5), part["core_seconds"], 0.36, color=LINES[k], label=kind)
        for at, row in zip(place, table[table["model"] == "whole"].to_dict("records"), strict=True):
            apart = "" if pd.isna(row["apart"]) else f"\napart {row['apart']:.0e}"
            ax.annotate(
                f"×{row['ratio']:.1f}{apart}", (at + 0.19, row["core_seconds"]), (0, 2),
                textcoords="offset points", ha="center", va="bottom", fontsize=6.5,
            )  # fmt: skip
        ax.set(yscale="log", ylabel="core-seconds of the path")
        ax.margins(y=0.25)
        ax.set_xticks(place, names, fontsize=6.5)
        ax.legend(loc="upper left")
    return figure


def draw_ladder(rows: list[dict], bands: list[dict]) -> Figure:
    """(d): disagreement with the finest labels against labels per hour; beside it, by band."""
    with mpl.rc_context(STYLE):
        figure, axes = panels(2 if bands else 1, width=3.9, height=3.2)
        for k, row in enumerate(rows):
            if row["disagreement"] is None:
                continue
            _interval(axes[0], row, color=(*LINES, "#B8860B")[k % 6], marker=MARKERS[k % 6],
                      label=f"{row['source']} ({row['wrong']} of {row['compared']})")  # fmt: skip
        axes[0].set_yscale("symlog", linthresh=0.02)
        axes[0].set(
            xscale="log",
            xlabel="labels per core-hour",
            title="the ladder of sources",
            ylabel="fraction that disagrees with the finest",
        )
        axes[0].legend(fontsize=6.5, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
        for k, row in enumerate(bands):
            band = row["band"]
            name = {"coarse": "coarse, none refined", None: "all refined", 0.0: "only if in doubt"}
            name = name.get(band) or f"within {band:g} too"
            _interval(axes[1], row, color=mpl.colormaps["viridis"](k / len(bands)), marker="o",
                      label=f"{name} ({100 * row['refined']:.0f} %)")  # fmt: skip
        if bands:
            axes[1].set(
                xlabel="labels per core-hour",
                ylabel="fraction that disagrees with all refined",
                title=f"mixed labels, {bands[0]['compared']} designs of the dataset",
            )
            axes[1].legend(fontsize=6.5, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
    return figure


def _interval(ax, row: dict, **style) -> None:
    y = row["disagreement"]
    spread = [[y - row["disagreement_low"]], [row["disagreement_high"] - y]]
    ax.errorbar(
        row["labels_per_hour"], y, np.maximum(spread, 0), ls="none", ms=5, lw=1, capsize=2, **style
    )


def draw_classifiers(rows: list[dict]) -> Figure:
    """(e): error of classifiers against labels, and what they cost to train and to ask."""
    table = pd.DataFrame(rows)
    with mpl.rc_context(STYLE):
        figure, axes = panels(3, width=3.3)
        for k, (name, part) in enumerate(table.groupby("model", sort=False)):
            by = part.groupby("labels").mean(numeric_only=True)
            style = {"marker": MARKERS[k % 6], "color": LINES[k % 5], "ms": 4, "lw": 1}
            axes[0].loglog(by["label_core_seconds"], 1 - by["accuracy"], label=name, **style)
            axes[1].loglog(by["train_seconds"], 1 - by["accuracy"], label=name, **style)
            axes[2].loglog(by["seconds_per_million"], 1 - by["accuracy"], label=name, **style)
        wrong = "fraction of wrong answers on test designs"
        axes[0].set(xlabel="core-seconds of labelling", ylabel=wrong)
        axes[1].set(xlabel="seconds of training", ylabel=wrong)
        axes[2].set(xlabel="seconds per million predictions", ylabel=wrong)
        for ax in axes:
            seconds(ax)
        axes[0].legend()
    return figure


def draw_budgets(rows: list[dict], hour: list[dict]) -> Figure:
    """(f): error of a classifier against the core-seconds spent on its labels."""
    table = pd.DataFrame(rows)
    with mpl.rc_context(STYLE):
        figure, (ax,) = panels(1, width=4.6, height=3.4)
        for k, (kind, part) in enumerate(table.groupby("labels_are", sort=False)):
            wrong = 1 - part.groupby("budget")["accuracy"].agg(["mean", "min", "max"])
            if kind == "Timoshenko":
                count = part["labels"].iloc[0]
                ax.axhline(wrong["mean"].iloc[0], color="#4D4D4D", ls=(0, (4, 3)), lw=0.9,
                           label=f"Timoshenko, {count} labels for nothing")  # fmt: skip
                continue
            ax.fill_between(wrong.index, wrong["max"], wrong["min"], color=LINES[k], alpha=0.15)
            ax.loglog(wrong.index, wrong["mean"], marker=MARKERS[k], color=LINES[k], ms=4,
                      label=f"{kind} labels")  # fmt: skip
            for row in hour:
                if row["labels_are"] == kind:
                    ax.plot(3600, 1 - row["accuracy"], marker=MARKERS[k], ms=7, mfc="none",
                            color=LINES[k], ls="none")  # fmt: skip
        if hour:
            ax.plot(
                [], [], "ko", mfc="none", ms=7, ls="none", label="one hour, by the fitted slope"
            )
        ax.set(
            xlabel="core-seconds of labelling",
            ylabel="fraction of wrong answers on accurate labels",
        )
        ax.legend(fontsize=7)
    return figure
