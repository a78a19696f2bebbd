"""The picture of the experiment on fits of growth."""

from __future__ import annotations

import numpy as np

from foldlab.plots import LINES, STYLE
from solver.cases.tissue import furrow
from solver.cases.tissue.pattern import Profile
from solver.fitting.fit import Fit

from .bench import Bench


def plot(bench: Bench, bands: dict[str, Fit], draws: list[dict], others: list[dict]):
    """β around the middle with its band, errors of all draws, misfits of all models."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    shape, angles = furrow.Shape(), np.linspace(0, 1.0, 101)
    X = shape.across * np.stack([0 * angles, np.sin(angles), -np.cos(angles)], axis=-1)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.0), layout="constrained")
        axes = figure.subplots(1, 3 if draws else 1, squeeze=False)[0]
        for (name, found), color in zip(bands.items(), LINES, strict=False):
            beta, half = found.band(X, bench.config.level, everywhere=True)
            axes[0].fill_between(angles, beta - half, beta + half, color=color, alpha=0.3, lw=0)
            axes[0].plot(angles, beta, color=color, label=f"fitted, {name}")
            if not draws:
                continue
            off = [100 * row["off"] for row in draws if row["family"] == name]
            rms = [100 * row["rms"] for row in draws if row["family"] == name]
            axes[1].plot(off, "o", ms=3, color=color, label=f"{name}, largest")
            axes[1].plot(rms, "x", ms=4, color=color, label=f"{name}, root mean square")
        axes[0].set(xlabel="angle from the midline, rad", ylabel=r"$\beta$ outside at $x = 0$")
        if not draws:
            axes[0].legend(fontsize=7)
            return figure
        axes[0].plot(angles, Profile().values(bench.true, X), "k--", lw=1, label="true profile")
        axes[1].axhline(5, color="#777777", lw=0.7)
        axes[1].set(xlabel="draw", ylabel=r"error of $\beta$ over its range, %")
        axes[1].set_ylim(bottom=0)
        rows = np.arange(len(others))
        axes[2].barh(rows, [row["misfit"] for row in others], color=LINES[0], height=0.5)
        axes[2].axvline(1, color="#777777", lw=0.7)
        axes[2].set_yticks(rows, [row["shape"] for row in others], fontsize=7)
        axes[2].set(xlabel=r"$\chi^2$ over its freedom", xscale="log")
        axes[2].invert_yaxis()
        for ax in axes[:2]:
            ax.legend(fontsize=7)
    return figure
