"""Pictures: matplotlib figures without global state, saved whole or not at all.

Every function returns a ``matplotlib.figure.Figure``; :func:`save_figure` writes it.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from foldlab.errors import InputError

SYMBOLS = {
    "E_ratio": r"E_i/E_s",
    "rho_ratio": r"\rho_i/\rho_s",
    "hinge_length": r"l_i/l_s",
    "hinge_width": r"b_i/b_s",
    "h_ratio": r"h_i/h_s",
    "stiffness_to_weight": r"E_s h_s^2/(\rho_s g\, l_s^3)",
    "aspect": r"b_s/l_s",
    "slenderness": r"h_s/l_s",
    "contraction": r"|g_i|",
}
LINES = ("#0B3C9C", "#D1652C", "#2E8B57", "#7A3E9D", "#4D4D4D")
STYLE = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 10,
    "axes.linewidth": 0.6,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "ytick.minor.size": 1.5,
    "xtick.direction": "out",
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    # Bundled with matplotlib, so that figures look alike on every machine.
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "figure.dpi": 100,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
}
FORMATS = (".png", ".pdf", ".svg")


def symbol(name: str) -> str:
    """The group's symbol as mathtext; other names unchanged."""
    return f"${SYMBOLS[name]}$" if name in SYMBOLS else name


def number(value: float) -> str:
    """A value as mathtext without dollars: a power of ten where it is a plain one."""
    if value == 1:
        return "1"
    exponent = np.log10(value) if value > 0 else np.nan
    nearest = np.round(exponent * 20) / 20
    if np.isclose(exponent, nearest, rtol=0, atol=1e-9):
        return f"10^{{{nearest:g}}}"
    return f"{value:.3g}"


def save_figure(figure: Figure, path: str | os.PathLike) -> Path:
    """Write a figure as PNG, PDF or SVG; the file appears complete or not at all.

    Raises :class:`InputError` for another ending or a missing folder.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            f"{path.name}: figures are written as {', '.join(FORMATS)}; change the ending"
        )
    if not path.parent.is_dir():
        raise InputError(f"no folder {path.parent}; make it first")
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        with mpl.rc_context(STYLE):
            figure.savefig(temporary)
        # mkstemp makes files for the owner only; a figure is as readable as any other new file.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


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
                labels, group.median(), color=colour, marker=marker, ms=3.5, lw=1.3,
                label=f"{strategy} ({seeds} seed{'s' if seeds > 1 else ''})",
            )  # fmt: skip
        if target is not None:
            level = 1 - target if as_error else target
            ax.axhline(level, color="#4D4D4D", ls=(0, (4, 3)), lw=0.8)
            ax.annotate(
                f"{target:g}", (1, level), (3, 0), xycoords=("axes fraction", "data"),
                textcoords="offset points", ha="left", va="center", color="#4D4D4D",
            )  # fmt: skip
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
        ax.plot(rest[x], rest[y], ls="none", marker="o", ms=3, mfc="#C9C9C9", mec="none",
                label="dominated")  # fmt: skip
        # The stair encloses what is attainable: it steps at each point away from the ideal corner.
        where = "pre" if maximise[0] else "post"
        ax.step(line[x], line[y], where=where, color=LINES[0], lw=0.9)
        ax.plot(line[x], line[y], ls="none", marker="o", ms=4.5, mfc=LINES[0], mec="white",
                mew=0.5, label="front")  # fmt: skip
        if labels:
            for _, row in line.iterrows():
                ax.annotate(
                    str(row[labels]), (row[x], row[y]), (4, -8 if maximise[1] else 4),
                    textcoords="offset points", fontsize=6.5,
                )  # fmt: skip
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
