"""What does the solver cost? Seconds and memory against unknowns, and against accuracy.

Each case runs in a process of its own (its peak memory is its own), after imports and compilation.
A Newton iteration is force, stiffness, factorisation and solve; "pure" is factorisation and solve
of the same matrix in the same run, so that the overhead is a ratio and not a stopwatch's mood. The
last part compares a factorisation with conjugate gradients. ``parts`` chooses.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from foldlab.plots import STYLE

from ._solver_methods import compare, plot_methods, summary
from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    seed: int = 0
    parts: tuple[str, ...] = ("paths", "iterations", "methods")
    threads: int = 1
    repeats: int = 3
    # Problem P by level: accuracy against seconds
    path_levels: tuple[int, ...] = (0, 1, 2, 3)
    path_elements: tuple[str, ...] = ("hex27", "hex20", "tet10")
    path_threads: int = 2
    # (level, elements across) of hex27 paths with about 10⁴ and 5·10⁴ unknowns: who spends the time
    path_sizes: tuple[tuple[int, int], ...] = ((3, 2), (3, 12))
    # one Newton iteration against unknowns, about so many
    hex27: tuple[int, ...] = (1_000, 3_000, 10_000, 50_000, 100_000)
    tet4: tuple[int, ...] = (1_000, 10_000, 40_000, 200_000, 850_000)
    # a factorisation against conjugate gradients: bodies, and unknowns, about so many
    shapes: tuple[str, ...] = ("block", "slab")
    solves_hex27: tuple[int, ...] = (3_000, 10_000, 30_000, 75_000, 150_000)
    solves_tet4: tuple[int, ...] = (3_000, 10_000, 40_000, 150_000)


TINY = Config(
    repeats=1,
    path_levels=(0,),
    path_elements=("hex20",),
    path_threads=1,
    path_sizes=((0, 2),),
    hex27=(1_000,),
    tet4=(1_000, 3_000),
    solves_hex27=(1_000, 3_000),
    solves_tet4=(1_000,),
)


def run(config: Config, tracker) -> dict[str, Any]:
    known = {"paths": _paths, "iterations": _iterations, "methods": _methods}
    wrong = [part for part in config.parts if part not in known]
    if wrong or not config.parts:
        raise InputError(f"parts {wrong}; there are: {', '.join(known)}")
    result = {}
    for part in config.parts:
        result |= known[part](config, tracker)
    result.setdefault("table", next(iter(result.values())))
    return result


def _paths(config: Config, tracker) -> dict[str, Any]:
    paths = [
        _alone(config.path_threads, path_cost, element, level)
        for element in config.path_elements
        for level in config.path_levels
    ]
    paths += [
        _alone(config.path_threads, path_cost, "hex27", level, across)
        for level, across in config.path_sizes
    ]
    tracker.table("paths", pd.DataFrame(paths))
    return {"problem_p": paths}


def _iterations(config: Config, tracker) -> dict[str, Any]:
    rows = []
    for element in ("hex27", "tet4"):
        for unknowns in getattr(config, element):
            repeats = config.repeats if unknowns < 300_000 else 1
            row = _alone(config.threads, iteration_cost, element, unknowns, repeats)
            print(row, file=sys.stderr)
            rows.append(row)
    table = pd.DataFrame(rows)
    exponents = {
        f"{element}_{what}": _slope(part["unknowns"], part[what])
        for element, part in table.groupby("element")
        for what in ("iteration_s", "assembly_s", "factor_s")
    }
    figure = plot_cost(table, exponents)
    save_figure(figure, "solver_speed")
    tracker.figure("solver_speed", figure)
    tracker.table("iterations", table)
    return {"table": rows, "exponents": exponents}


def _methods(config: Config, tracker) -> dict[str, Any]:
    def alone(job, *args):
        row = _alone(config.threads, job, *args)
        print(row, file=sys.stderr)
        return row

    sizes = {"hex27": config.solves_hex27, "tet4": config.solves_tet4}
    rows = compare(sizes, config.shapes, config.repeats, alone)
    table = pd.DataFrame(rows)
    found = summary(table, _slope)
    figure = plot_methods(table, found)
    save_figure(figure, "solver_methods")
    tracker.figure("solver_methods", figure)
    tracker.table("methods", table)
    return {"methods": rows, "crossings": found}


def _alone(threads: int, job, *args) -> dict[str, Any]:
    """Run a job in a fresh process whose numerical libraries use so many threads."""
    names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, str(threads)))
    try:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            result = pool.submit(job, *args).result()
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)
    return {**result, "threads": threads}


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def path_cost(element: str, level: int, across: int = 1) -> dict[str, Any]:
    """Problem P from flat to g = −0.3: error of the angle, seconds, iterations, memory.

    ``overhead``: fraction of the path's time that is neither factorisation nor solve.
    """
    from solver.cases.unit import problem_p

    from .problem_p import follow_to

    follow_to(problem_p.scene(problem_p.mesh(0, element), g=-0.01))  # compiles, or loads the cache
    start = time.perf_counter()
    body = problem_p.mesh(replace(problem_p.LEVELS[level], across=across), element)
    scene = problem_p.scene(body)
    pure = _clocked(scene)
    built = time.perf_counter()
    path = follow_to(scene)
    seconds = time.perf_counter() - built
    last = path.points[-1]
    angle = problem_p.fold_angle(scene, last.x, last.e)
    return {
        "element": element,
        "level": level,
        "across": across,
        "unknowns": scene.size,
        "angle": angle,
        "error": abs(angle / problem_p.ANGLE - 1),
        "iterations": sum(p.iterations for p in path.points),
        "steps": len(path.points) - 1,
        "build_s": built - start,
        "seconds": seconds,
        "overhead": 1 - pure[0] / seconds,
        "peak_mb": _peak_mb(),
    }


def _clocked(scene) -> list[float]:
    """Seconds that the scene spends in factorisation and solves from here on; a growing cell."""
    spent, factorise = [0.0], scene.solver.factorise

    def clock(call):
        def timed(*args):
            start = time.perf_counter()
            try:
                return call(*args)
            finally:
                spent[0] += time.perf_counter() - start

        return timed

    def wrapped(values):
        factor = clock(factorise)(values)
        factor._solve = clock(factor._solve)
        return factor

    scene.solver.factorise = wrapped
    return spent


def sized(element: str, unknowns: int):
    """Problem P's whole unit on a uniform mesh of about so many unknowns."""
    from solver.cases.unit import problem_p

    best = None
    for n in range(2, 80):
        # cells about as long as wide, eight times longer than thick, layers kept apart
        layers = max(1, round(n / 8))
        counts = problem_p.Counts(
            first=0.5 / (4 * n),
            factor=1.0,
            longest=0.5 / (4 * n),
            passive=tuple(np.linspace(0, 1, layers + 1)),
            active=tuple(np.linspace(0, 1, 2 * layers + 1)),
            across=max(1, n // 2),
        )
        order = 2 if element == "hex27" else 1
        across, along = 2 * counts.across * order + 1, 8 * n * order + 1
        nodes = across * along * (layers * order + 1 + 0.2 * 2 * layers * order)
        if best is None or abs(np.log(3 * nodes / unknowns)) < best[0]:
            best = (abs(np.log(3 * nodes / unknowns)), counts)
        if 3 * nodes > 3 * unknowns:
            break
    return problem_p.mesh(best[1], element, quarter=False)


def iteration_cost(element: str, unknowns: int, repeats: int) -> dict[str, Any]:
    """One Newton iteration at g = −0.03 near the flat state; medians over repeats."""
    from solver.cases.unit import problem_p

    warm = problem_p.scene(problem_p.mesh(0, element))
    warm.system(np.zeros(warm.size), 0.1).factorise()
    start = time.perf_counter()
    body = sized(element, unknowns)
    scene = problem_p.scene(body, supported=True)
    build = time.perf_counter() - start
    x, e = np.zeros(scene.size), 0.1
    start = time.perf_counter()
    system = scene.system(x, e)
    factor = system.factorise()
    factor.solve(system.residual)
    first = time.perf_counter() - start
    timings = []
    for _ in range(repeats):
        a = time.perf_counter()
        system = scene.system(x, e)
        b = time.perf_counter()
        factor = system.factorise()
        c = time.perf_counter()
        factor.solve(system.residual)
        d = time.perf_counter()
        timings.append((b - a, c - b, d - c, d - a))
    assembly, factoring, solving, whole = np.median(timings, axis=0)
    return {
        "element": element,
        "unknowns": scene.size,
        "cells": len(body.cells),
        "build_s": build,
        "iteration_s": whole,
        "with_analysis_s": first,
        "assembly_s": assembly,
        "factor_s": factoring,
        "solve_s": solving,
        "overhead": assembly / whole,
        "peak_mb": _peak_mb(),
    }


def _slope(x, y) -> float | None:
    return float(np.polyfit(np.log(x), np.log(y), 1)[0]) if len(x) > 1 else None


def plot_cost(table: pd.DataFrame, exponents: dict[str, float | None]):
    """Seconds of one iteration against unknowns, log–log, with the fitted exponents."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.6, 3.4), layout="constrained")
        ax = figure.subplots()
        for k, (element, part) in enumerate(table.groupby("element")):
            for what, style in (("iteration_s", "o-"), ("assembly_s", "s--"), ("factor_s", "^:")):
                p = exponents[f"{element}_{what}"]
                name = f"{element}, {what.removesuffix('_s')}"
                name += f" (∝ N^{p:.2f})" if p is not None else ""
                ax.loglog(part["unknowns"], part[what], style, color=f"C{k}", ms=3.5, label=name)
        ax.set_xlabel("unknowns N")
        ax.set_ylabel("seconds, one thread")
        ax.grid(True, which="major", lw=0.3)
        ax.legend(fontsize=6.5)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
