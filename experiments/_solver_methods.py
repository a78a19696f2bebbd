"""A factorisation or conjugate gradients? One linear solve by each, in thick and in thin bodies.

A thick ``block`` (a cube of equal cells, clamped at one side, under a weight) and a thin ``slab``
(Problem P's unit: a sheet 250 times longer than thick whose cells are 4 to 7 times longer than
thick, a hinge on it, contracting). Each solve has a process of its own, and so has the same scene
with its matrix but no solve: what stands above that one's peak is the solve's memory. Seconds are
those of the processor, for machines that others use, too.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from foldlab.plots import STYLE

# MB, below which two processes differ by chance.
LEAST = 1.0
METHODS = {"none": "auto", "direct": "auto", "iterative": "cg"}


def compare(
    sizes: dict[str, tuple[int, ...]], shapes: tuple[str, ...], repeats: int, alone: Callable
) -> list[dict[str, Any]]:
    """One row per shape, element and size (about so many unknowns); ``alone`` runs one job.

    Seconds ``…_s``: of a first solve with all that it prepares; ``…_again_s``: of the next one with
    another matrix of the pattern, as in Newton's method; ``…_mb``: above the peak without a solve,
    at least :data:`LEAST`.
    """
    rows = []
    for shape in shapes:
        for element, counts in sizes.items():
            for unknowns in counts:
                got = {m: alone(solve_cost, shape, element, unknowns, m, repeats) for m in METHODS}
                rows.append(_row(got))
    return rows


def _row(got: dict[str, dict[str, Any]]) -> dict[str, Any]:
    none = got["none"]
    row = {k: none[k] for k in ("shape", "element", "unknowns", "cells")}
    row["assembled_mb"] = none["peak_mb"]
    for method in ("direct", "iterative"):
        of = got[method]
        row[f"{method}_s"] = of["build_s"] - none["build_s"] + of["first_s"]
        row[f"{method}_again_s"] = of["again_s"]
        row[f"{method}_mb"] = max(of["peak_mb"] - none["peak_mb"], LEAST)
        row[f"{method}_peak_mb"] = of["peak_mb"]
        row[f"{method}_residual"] = of["residual"]
    row["iterations"] = got["iterative"]["iterations"]
    for what in ("s", "again_s", "mb", "peak_mb"):
        row[f"ratio_{what}"] = row[f"iterative_{what}"] / row[f"direct_{what}"]
    return row


def scene_of(shape: str, element: str, unknowns: int, linear: str):
    """Scene and right-hand side of about so many unknowns."""
    from solver.cases.unit import problem_p
    from solver.equilibrium.scene import Scene
    from solver.mesh.body import Body
    from solver.mesh.structured import box
    from solver.physics.elastic import Elastic
    from solver.physics.loads import Gravity
    from solver.physics.materials import NeoHookean
    from solver.physics.supports import Fixed

    from .solver_speed import sized

    if shape == "slab":
        return problem_p.scene(sized(element, unknowns), supported=True, linear=linear)
    order = 2 if element == "hex27" else 1
    n = max(1, round(((unknowns / 3) ** (1 / 3) - 1) / order))
    grid = box(*[np.linspace(0, 1, n + 1)] * 3, tets=element.startswith("tet"))
    body = Body.build(grid, element)
    low = body.nodes_where(lambda X: X[:, 0] < 1e-9)
    terms = [Elastic(body, NeoHookean(1.0, 0.3)), Gravity(body, 1.0, 1.0)]
    return Scene(body, terms, fixed=[Fixed(low, axis) for axis in np.eye(3)], linear=linear)


def solve_cost(
    shape: str, element: str, unknowns: int, method: str, repeats: int
) -> dict[str, Any]:
    """Core-seconds and peak memory of one solve; see :func:`compare`."""
    warm = scene_of("block", element, 100, METHODS[method])
    system = warm.system(np.zeros(warm.size), 1.0)
    system.factorise().solve(system.residual)
    start = time.process_time()
    scene = scene_of(shape, element, unknowns, METHODS[method])
    built = time.process_time()
    system = scene.system(np.zeros(scene.size), 1.0)
    row = {
        "shape": shape,
        "element": element,
        "unknowns": scene.size,
        "cells": len(scene.body.cells),
        "build_s": built - start,
    }
    if method != "none":
        seconds = []
        for _ in range(repeats + 1):
            start = time.process_time()
            x = scene.factorised(system.values).solve(system.residual)
            seconds.append(time.process_time() - start)
        row |= {
            "first_s": seconds[0],
            "again_s": float(np.median(seconds[1:])),
            "iterations": getattr(scene.solver, "iterations", None),
        }
    row["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if method != "none":
        off = scene.frame.times(system.values, x) - system.residual
        row["residual"] = float(np.linalg.norm(off) / np.linalg.norm(system.residual))
    return row


def crossing(unknowns: np.ndarray, ratio: np.ndarray) -> float | None:
    """Unknowns from which on a ratio stays below 1, between two sizes by a power law; the smallest
    size where it always is; None where the largest is above 1."""
    x, y = np.log(np.asarray(unknowns, float)), np.log(np.asarray(ratio, float))
    above = np.flatnonzero(y > 0)
    if not len(above):
        return float(np.exp(x[0]))
    k = above[-1]
    if k == len(y) - 1:
        return None
    return float(np.exp(x[k] + (x[k + 1] - x[k]) * y[k] / (y[k] - y[k + 1])))


def summary(table, slope: Callable) -> dict[str, dict[str, Any]]:
    """Of each shape and element the crossings in seconds and memory, and the fitted exponents."""
    out = {}
    for (shape, element), part in table.groupby(["shape", "element"]):
        of: dict[str, Any] = {
            f"crossing_{what}": crossing(part["unknowns"], part[f"ratio_{what}"])
            for what in ("s", "again_s", "mb", "peak_mb")
        }
        for method in ("direct", "iterative"):
            of[f"{method}_exponent_s"] = slope(part["unknowns"], part[f"{method}_again_s"])
            of[f"{method}_exponent_mb"] = slope(part["unknowns"], part[f"{method}_mb"])
        out[f"{shape}_{element}"] = of
    return out


def plot_methods(table, found: dict[str, dict[str, Any]]):
    """Core-seconds and memory of one solve against unknowns, log–log, with fitted exponents."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.4), layout="constrained")
        for ax, what, label in zip(
            figure.subplots(1, 2),
            ("again_s", "mb"),
            ("core-seconds, factorise and solve", "MB above the assembled matrix"),
            strict=True,
        ):
            for k, ((shape, element), part) in enumerate(table.groupby(["shape", "element"])):
                for method, style in (("direct", "o-"), ("iterative", "s--")):
                    p = found[f"{shape}_{element}"][f"{method}_exponent_{what[-2:].strip('_')}"]
                    name = f"{element} {shape}, {method}"
                    name += f" (∝ N^{p:.2f})" if p is not None else ""
                    values = part[f"{method}_{what}"]
                    ax.loglog(part["unknowns"], values, style, color=f"C{k}", ms=3.5, label=name)
            ax.set_xlabel("unknowns N")
            ax.set_ylabel(label)
            ax.grid(True, which="major", lw=0.3)
            ax.legend(fontsize=5.5)
    return figure
