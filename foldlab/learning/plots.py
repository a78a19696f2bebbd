"""Figures of learning: curves over labels, fronts of accuracy and cost, trade-offs, studies."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from foldlab.errors import InputError
from foldlab.plots import LINES, STYLE


def plot_study(table: pd.DataFrame):
    """The study's Pareto front, accuracy over training seconds; a Matplotlib figure."""
    from foldlab.learning.plots import plot_pareto

    return plot_pareto(
        table.assign(error=1 - table["accuracy"]),
        "seconds",
        "error",
        maximise=(False, False),
        log=(True, False),
        axis_labels={"seconds": "training, processor seconds", "error": "1 − accuracy"},
    )


def plot_learning_curves(
    curves: pd.DataFrame,
    *,
    target: float | None = None,
    as_error: bool = False,
    title: str | None = None,
) -> Figure:
    """Accuracy over the number of labels, one line per strategy, with the spread over seeds.

    ``curves``: columns ``strategy``, ``seed``, ``labels``, ``accuracy`` (0 … 1), a row per seed and
    label count. Line: median over seeds; band: minimum to maximum. ``target``: a dashed level.
    ``as_error`` draws 1 − accuracy on a log axis instead. Raises :class:`InputError` for missing
    columns or an empty table.
    """
    need_columns(curves, ["strategy", "seed", "labels", "accuracy"])
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.4, 3.1), layout="constrained")
        ax = figure.subplots()
        for k, (strategy, rows) in enumerate(curves.groupby("strategy", sort=False)):
            value = 1 - rows["accuracy"] if as_error else rows["accuracy"]
            group = value.groupby(rows["labels"])
            colour, marker = LINES[k % len(LINES)], "osD^v"[k % 5]
            labels = np.array(sorted(rows["labels"].unique()))
            ax.fill_between(labels, group.min(), group.max(), color=colour, alpha=0.18, lw=0)
            seeds = rows["seed"].nunique()
            ax.plot(
                labels,
                group.median(),
                color=colour,
                marker=marker,
                ms=3.5,
                lw=1.3,
                label=f"{strategy} ({seeds} seed{'s' if seeds > 1 else ''})",
            )
        if target is not None:
            level = 1 - target if as_error else target
            ax.axhline(level, color="#4D4D4D", ls=(0, (4, 3)), lw=0.8)
            ax.annotate(
                f"{target:g}",
                (1, level),
                (3, 0),
                xycoords=("axes fraction", "data"),
                textcoords="offset points",
                ha="left",
                va="center",
                color="#4D4D4D",
            )
        if as_error:
            ax.set_yscale("log")
        ax.set_xlabel("number of labels")
        ax.set_ylabel("1 − accuracy" if as_error else "accuracy")
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(loc="upper right" if as_error else "lower right")
        if title:
            ax.set_title(title)
    return figure


def pareto_mask(x, y, *, maximise: tuple[bool, bool] = (False, True)) -> np.ndarray:
    """True for the points that no other beats in both objectives, shape (n,).

    By default x (a cost) is to be small and y (a merit) large; NaN is never on the front. Of equal
    points all stay.
    """
    a = np.asarray(x, dtype=float) * (-1 if maximise[0] else 1)
    b = np.asarray(y, dtype=float) * (-1 if maximise[1] else 1)
    keep = np.isfinite(a) & np.isfinite(b)
    no_worse = (a[:, None] >= a) & (b[:, None] >= b)
    better = (a[:, None] > a) | (b[:, None] > b)
    return keep & ~(no_worse & better & keep[None, :]).any(axis=1)


def plot_pareto(
    front: pd.DataFrame,
    x: str,
    y: str,
    *,
    maximise: tuple[bool, bool] = (False, True),
    labels: str | None = None,
    axis_labels: Mapping[str, str] | None = None,
    log: tuple[bool, bool] = (False, False),
    title: str | None = None,
) -> Figure:
    """Scatter of two objectives (columns ``x`` and ``y``) with the front as a stair line.

    Dominated points are pale. ``labels``: a column of short texts written at the points of the
    front. ``axis_labels``: column → axis text. Raises :class:`InputError` for missing columns or a
    table without one finite point.
    """
    need_columns(front, [x, y, *([labels] if labels else [])])
    best = pareto_mask(front[x], front[y], maximise=maximise)
    if not best.any():
        raise InputError(f"no row has finite {x} and {y}; nothing to draw")
    texts = dict(axis_labels or {})
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.4, 3.1), layout="constrained")
        ax = figure.subplots()
        rest, line = front[~best], front[best].sort_values([x, y])
        ax.plot(
            rest[x],
            rest[y],
            ls="none",
            marker="o",
            ms=3,
            mfc="#C9C9C9",
            mec="none",
            label="dominated",
        )
        # The stair encloses what is attainable: it steps at each point away from the ideal corner.
        where = "pre" if maximise[0] else "post"
        ax.step(line[x], line[y], where=where, color=LINES[0], lw=0.9)
        ax.plot(
            line[x],
            line[y],
            ls="none",
            marker="o",
            ms=4.5,
            mfc=LINES[0],
            mec="white",
            mew=0.5,
            label="front",
        )
        if labels:
            for _, row in line.iterrows():
                ax.annotate(
                    str(row[labels]),
                    (row[x], row[y]),
                    (4, -8 if maximise[1] else 4),
                    textcoords="offset points",
                    fontsize=6.5,
                )
        if log[0]:
            ax.set_xscale("log")
        if log[1]:
            ax.set_yscale("log")
        ax.set_xlabel(texts.get(x, x.replace("_", " ")))
        ax.set_ylabel(texts.get(y, y.replace("_", " ")))
        ax.spines[["top", "right"]].set_visible(False)
        if len(rest):
            ax.legend(loc="best")
        if title:
            ax.set_title(title)
    return figure


def need_columns(table: pd.DataFrame, names: list[str]) -> None:
    """Raise :class:`InputError` unless the table has rows and these columns."""
    missing = [name for name in names if name not in table.columns]
    if missing or len(table) == 0:
        raise InputError(
            f"the table has {len(table)} rows and columns {', '.join(map(str, table.columns))}; "
            f"expected rows with {', '.join(names)}"
        )


def plot_trade_off(
    thresholds: pd.DataFrame,
    weights: pd.DataFrame | None = None,
    *,
    point: dict | None = None,
    rate: float | None = None,
) -> Figure:
    """Missed folds (1 − recall) over false-positive rate, both logarithmic.

    ``thresholds`` and ``weights`` come from the two curve functions; ``point`` is a
    :func:`foldlab.learning.scoring.score` to mark; ``rate`` draws the stated false-positive rate.
    """
    figure = Figure(figsize=(6, 4.5), layout="constrained")
    axes = figure.add_subplot()
    # A zero count has no place on a log axis: it is left out, not drawn as something else.
    shown = thresholds[(thresholds["false_positive_rate"] > 0) & (thresholds["recall"] < 1)]
    axes.fill_betweenx(
        1 - shown["recall"],
        shown["false_positive_rate_low"],
        shown["false_positive_rate_high"],
        alpha=0.25,
        linewidth=0,
        label="95 % interval",
    )
    axes.plot(shown["false_positive_rate"], 1 - shown["recall"], label="threshold bias")
    if weights is not None:
        axes.plot(weights["false_positive_rate"], 1 - weights["recall"], "s--", label="loss bias")
        for row in weights.itertuples():
            axes.annotate(
                f"{row.weight:g}",
                (row.false_positive_rate, 1 - row.recall),
                xytext=(5, 5),
                textcoords="offset points",
                fontsize="small",
            )
    if rate is not None:
        axes.axvline(rate, color="black", linestyle=":", label=f"stated rate {rate:.1%}")
    if point is not None:
        axes.plot(
            point["false_positive_rate"], 1 - point["recall"], "k*", ms=12, label="chosen point"
        )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="false-positive rate: non-folding designs called foldable",
        ylabel="missed folds: 1 − recall",
    )
    axes.legend()
    return figure


def plot_reliability(tables: Mapping[str, pd.DataFrame], *, title: str | None = None) -> Figure:
    """Fraction that folds over the predicted probability, with 95 % intervals; a line per model.

    ``tables``: name → table of :func:`foldlab.learning.scoring.reliability`.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.4, 4.0), layout="constrained")
        ax = figure.subplots()
        ax.plot([0, 1], [0, 1], color="#4D4D4D", ls=(0, (4, 3)), lw=0.8, label="calibrated")
        for k, (name, table) in enumerate(tables.items()):
            need_columns(table, ["probability", "fraction", "low", "high"])
            off = np.abs(table[["low", "high"]].to_numpy().T - table["fraction"].to_numpy())
            ax.errorbar(
                table["probability"],
                table["fraction"],
                yerr=off,
                color=LINES[k % len(LINES)],
                marker="osD^v"[k % 5],
                ms=3.5,
                lw=1.1,
                elinewidth=0.7,
                capsize=2,
                label=name,
            )
        ax.set_xlabel("predicted probability of folding")
        ax.set_ylabel("fraction that folds")
        ax.set_aspect("equal")
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(loc="upper left")
        if title:
            ax.set_title(title)
    return figure
