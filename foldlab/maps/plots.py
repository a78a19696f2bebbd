"""Pictures of regime maps: predicted (Fig. 4.28) and validated (Fig. 4.29)."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import NullLocator

from foldlab.design import DesignSpace
from foldlab.learning.plots import need_columns
from foldlab.maps.regimes import RegimeMap, Verdict
from foldlab.plots import STYLE, SYMBOLS, number, symbol

# The dissertation's green, red, yellow and blue, spread in lightness so that they stay apart
# for red-green blindness and in grey.
COLOURS = {
    Verdict.TRUE_POSITIVE: "#52B788",
    Verdict.TRUE_NEGATIVE: "#B3261E",
    Verdict.FALSE_POSITIVE: "#FFE94D",
    Verdict.FALSE_NEGATIVE: "#0B3C9C",
    Verdict.UNKNOWN: "#EFEFEF",
}


def plot_regimes(
    regime: RegimeMap,
    *,
    validated: bool | None = None,
    points: pd.DataFrame | None = None,
    contours: Sequence[float] = (),
    title: str | None = None,
) -> Figure:
    """Panels of a regime map, one per slice: predicted (Fig. 4.28) or validated (Fig. 4.29).

    ``validated``: colour by verdict; by default wherever the map has truth. The source's own
    boundary is a black line where the source gave margins. ``points``: verified designs (columns:
    groups, and ``foldable`` as true, false or missing) drawn over the slice nearest to each, white
    for folding, black for not, crossed for unknown; fixed groups are not compared. ``contours``:
    probabilities to draw as thin lines. A source beside the map is a dashed line. Raises
    :class:`InputError` when asked for a validation that the map lacks.
    """
    validated = regime.truth is not None if validated is None else validated
    if validated:
        values, used = regime.verdicts, list(Verdict)
    else:
        values = np.where(regime.predicted, Verdict.TRUE_POSITIVE, Verdict.TRUE_NEGATIVE)
        used = [Verdict.TRUE_POSITIVE, Verdict.TRUE_NEGATIVE]
    panels = len(regime.slices)
    columns = int(np.ceil(np.sqrt(panels)))
    rows = int(np.ceil(panels / columns))
    handles = _regime_handles(values, used, validated)
    if points is not None:
        handles += _overlay_handles(points)
    if regime.margin is not None:
        handles.append(Line2D([], [], color="black", lw=0.9, label=f"boundary of {regime.source}"))
    if regime.beside is not None:
        handles.append(Line2D([], [], color="black", lw=1.1, ls="--", label=regime.beside[0]))
    if contours:
        levels = ", ".join(f"{level:g}" for level in contours)
        handles.append(Line2D([], [], color="white", lw=1.0, label=f"P(folds) = {levels}"))
        handles[-1].set_path_effects([Stroke(linewidth=2.0, foreground="0.4"), Normal()])
    title = title or _regime_title(regime, validated)
    with mpl.rc_context(STYLE):
        legend_columns = min(len(handles), 3)
        foot = 0.52 + 0.19 * -(-len(handles) // legend_columns)
        head = 0.28 + 0.17 * len(title.splitlines())
        width, height = max(2.0 * columns + 0.6, 4.4), 1.85 * rows - 0.2 + head + foot
        figure = Figure(figsize=(width, height))
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        figure.subplots_adjust(
            left=0.68 / width,
            right=1 - 0.12 / width,
            bottom=foot / height,
            top=1 - head / height,
            wspace=0.10,
            hspace=0.24,
        )
        colours = ListedColormap([COLOURS[v] for v in Verdict])
        norm = BoundaryNorm(np.arange(len(Verdict) + 1) - 0.5, len(Verdict))
        edges = [_edges(regime.space, name, n) for name, n in _sides(regime)]
        nearest = None if points is None else _nearest_slice(regime, points)
        for k, ax in enumerate(axes.flat):
            if k >= panels:
                ax.set_visible(False)
                continue
            # Images inside vector files: a panel of vector cells shows seams and weighs megabytes.
            ax.pcolormesh(*edges, values[k], cmap=colours, norm=norm, rasterized=True)
            if regime.margin is not None and _crosses_zero(regime.margin[k]):
                ax.contour(
                    regime.x_values,
                    regime.y_values,
                    regime.margin[k],
                    [0.0],
                    colors="black",
                    linewidths=0.7,
                )
            lines = [(regime.probability[k] - level, "white", "-") for level in contours]
            if regime.beside is not None:
                lines.append((regime.beside[1][k], "black", "--"))
            for field, colour, style in lines:
                if _crosses_zero(field):
                    ax.contour(
                        regime.x_values, regime.y_values, field, [0.0], colors=colour,
                        linestyles=style, linewidths=0.8,
                    )  # fmt: skip
            if points is not None:
                _overlay(ax, regime, points[nearest == k])
            _scale_axes(ax, regime, numbers=k + columns >= panels)
            ax.set_title(f"${SYMBOLS[regime.slice_by]} = {number(regime.slices[k])}$", pad=5)
            if k + columns >= panels:
                ax.set_xlabel(symbol(regime.x), labelpad=2)
            if k % columns == 0:
                ax.set_ylabel(symbol(regime.y), labelpad=2)
        figure.legend(
            handles=handles,
            loc="lower center",
            ncols=legend_columns,
            handlelength=1.3,
            columnspacing=1.6,
            borderaxespad=0.3,
        )
        figure.suptitle(title, fontsize=9.5, y=1 - 0.06 / height)
    return figure


def _sides(regime):
    return (regime.x, len(regime.x_values)), (regime.y, len(regime.y_values))


def _edges(space: DesignSpace, name: str, n: int) -> np.ndarray:
    return space[name].from_unit(np.linspace(0, 1, n + 1))


def _crosses_zero(margin: np.ndarray) -> bool:
    return bool(np.nanmin(margin) < 0 < np.nanmax(margin)) if np.isfinite(margin).any() else False


def _scale_axes(ax, regime: RegimeMap, *, numbers: bool) -> None:
    for name, axis in ((regime.x, ax.xaxis), (regime.y, ax.yaxis)):
        p = regime.space[name]
        ax.set(**{f"{axis.axis_name}scale": p.scale, f"{axis.axis_name}lim": (p.low, p.high)})
        ticks = [t for t in axis.get_majorticklocs() if p.low <= t * (1 + 1e-9) and t <= p.high]
        if p.scale == "log" and p.high / p.low > 1.001e3:
            low, high = int(np.ceil(np.log10(p.low))), int(np.floor(np.log10(p.high)))
            step = 3 if (high - low) % 3 == 0 else 2
            labels = ["" if (e - low) % step else f"$10^{{{e}}}$" for e in range(low, high + 1)]
            axis.set_ticks(10.0 ** np.arange(low, high + 1), labels)
            axis.set_minor_locator(NullLocator())
        else:
            axis.set_ticks(ticks)
    ax.tick_params(labelbottom=numbers)
    if numbers:
        # Numbers at the very ends would run into those of the neighbouring panel.
        p = regime.space[regime.x]
        for tick, where in zip(ax.xaxis.get_major_ticks(), ax.get_xticks(), strict=True):
            if p.to_unit(where) < 0.02:
                tick.label1.set_ha("left")
            elif p.to_unit(where) > 0.98:
                tick.label1.set_ha("right")


def _regime_handles(values, used, validated):
    names = (
        {v: v.name.lower().replace("_", " ") for v in Verdict}
        if validated
        else {
            Verdict.TRUE_POSITIVE: "predicted to fold",
            Verdict.TRUE_NEGATIVE: "predicted not to fold",
        }
    )
    counts = {v: int((values == v).sum()) for v in used}
    return [
        Patch(
            facecolor=COLOURS[v],
            edgecolor="black",
            lw=0.4,
            label=f"{names[v]} ({_count(counts[v])})",
        )
        for v in used
        if v is not Verdict.UNKNOWN or counts[v]
    ]


def _count(n: int) -> str:
    return f"{n:,}".replace(",", "\u2009")


def _percent(fraction: float | None) -> str:
    return "undefined" if fraction is None else f"{100 * fraction:.2f} %"


def _regime_title(regime: RegimeMap, validated: bool) -> str:
    text = f"{_count(regime.points)} designs"
    if regime.fixed:
        held = ", ".join(f"${SYMBOLS[k]} = {v:.3g}$" for k, v in regime.fixed.items())
        text = f"{held}\n{text}"
    if not validated:
        return f"{text}, {_percent(float(regime.predicted.mean()))} predicted to fold"
    return (
        f"{text}: accuracy {_percent(regime.accuracy)}, "
        f"false-positive rate {_percent(regime.false_positive_rate)}, "
        f"recall {_percent(regime.recall)}"
    )


def _overlay_kinds(points: pd.DataFrame):
    """(text, rows, marker) of the verified points that fold, that do not, and the unknown."""
    foldable = points["foldable"].astype("boolean")
    common = {"ls": "none", "ms": 3.6, "mew": 0.6}
    kinds = (
        (
            "verified: folds",
            foldable.fillna(False),
            {"marker": "o", "mfc": "white", "mec": "black"},
        ),
        (
            "verified: does not",
            ~foldable.fillna(True),
            {"marker": "o", "mfc": "black", "mec": "white"},
        ),
        ("verified: unknown", foldable.isna(), {"marker": "X", "mfc": "#9A9A9A", "mec": "black"}),
    )
    return [(text, points[mask.to_numpy(bool)], common | marker) for text, mask, marker in kinds]


def _overlay(ax, regime: RegimeMap, points: pd.DataFrame) -> None:
    for _, rows, style in _overlay_kinds(points):
        ax.plot(rows[regime.x], rows[regime.y], clip_on=False, zorder=3, **style)


def _overlay_handles(points: pd.DataFrame) -> list:
    need_columns(points, ["foldable"])
    return [
        Line2D([], [], label=t, **style) for t, rows, style in _overlay_kinds(points) if len(rows)
    ]


def _nearest_slice(regime: RegimeMap, points: pd.DataFrame) -> np.ndarray:
    need_columns(points, [regime.x, regime.y, regime.slice_by])
    p = regime.space[regime.slice_by]
    position = p.to_unit(points[regime.slice_by].to_numpy(float))
    return np.abs(position[:, None] - p.to_unit(regime.slices)[None, :]).argmin(axis=1)
