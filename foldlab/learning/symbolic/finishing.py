"""What is done with an engine's formulas: constants refitted, guards, front of size and error."""

from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.stats import qmc

from foldlab.learning.symbolic import formula as fm
from foldlab.learning.symbolic.formula import Formula, Tree

_CORNERS = 10  # dimensions up to which every corner of the box is one of the guards
_WORST_LOG = 20.0
_REFIT_STEPS = 12  # Levenberg–Marquardt; the engine has tuned the constants before
_GUARDS = 2048  # points of the box at which a formula must be defined


def refit(tree: Tree, X, y, inputs, log_target: bool) -> tuple[Tree, float]:
    """Least-squares constants in double precision: (tree, rms error); error as in ``front_``.

    X: (n, len(inputs)), y: (n,). An undefined or negative value counts as a relative error e^20.
    """
    start = np.array(fm.constants(tree))
    names = [f"c{k}_" for k in range(len(start))]
    model = Formula(fm.with_names(tree, names), (*inputs, *names)).function
    columns = tuple(X.T)

    def residual(c):
        with np.errstate(all="ignore"):
            values = np.broadcast_to(model(*columns, *c), y.shape)
            r = np.log(values / y) if log_target else values - y
        if log_target:
            return np.where(np.isfinite(r), np.clip(r, -_WORST_LOG, _WORST_LOG), _WORST_LOG)
        return r

    best = start
    if len(start) and np.isfinite(residual(start)).all():
        try:
            solution = least_squares(
                residual,
                start,
                method="lm" if len(y) >= len(start) else "trf",
                x_scale=np.maximum(np.abs(start), 1e-6),
                max_nfev=_REFIT_STEPS * (len(start) + 1),
            )
            best = solution.x
        except ValueError:  # a trial step left the domain of a plain-squares model
            best = start
    error = float(np.sqrt(np.mean(residual(best) ** 2)))
    return fm.with_constants(tree, best), error


def scale_of(y) -> float:
    """What the target is divided by for the search: a power of ten, 1 where it is of order 1.

    The engine draws constants of order 1, and a fit that starts e^20 away does not move.
    """
    sizes = np.abs(y[y != 0])
    exponent = round(float(np.mean(np.log10(sizes)))) if len(sizes) else 0
    return 10.0**exponent if abs(exponent) > 3 else 1.0  # it may cost a node or two


def guard_points(low, high, seed: int) -> np.ndarray:
    """Points of a box and its corners; inside, log-uniform where all values are positive."""
    unit = qmc.LatinHypercube(d=len(low), rng=seed).random(_GUARDS)
    columns = []
    for k, u in enumerate(unit.T):
        if low[k] > 0:
            columns.append(np.exp(np.log(low[k]) + u * np.log(high[k] / low[k])))
        else:
            columns.append(low[k] + u * (high[k] - low[k]))
    if len(low) <= _CORNERS:
        upper = np.array(list(product((False, True), repeat=len(low))))
    else:
        upper = unit > 0.5
    return np.vstack([np.column_stack(columns), np.where(upper, high, low)])


def front_of(rows: list[tuple]) -> pd.DataFrame:
    """The rows that no other beats in both size and error, by size."""
    front = []
    for row in sorted(rows, key=lambda r: (r[0], r[2], r[1])):
        # More nodes for rounding are no gain.
        if not front or row[2] < (1 - 1e-6) * front[-1][2]:
            front.append(row)
    return pd.DataFrame(front, columns=["size", "depth", "error", "formula"])
