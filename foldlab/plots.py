"""Pictures: matplotlib figures without global state, saved whole or not at all.

Every function returns a ``matplotlib.figure.Figure``; :func:`save_figure` writes it.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
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
