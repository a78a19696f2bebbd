"""Which of the dissertation's findings about the lung (§3.5, §3.6) hold on converged meshes?

Pressure ± 5 %; contraction 0, 20, 40 %; contraction along fibres or in all directions; stiffness of
the muscle; the full against the primitive model; the unstable modes of the whole sphere along
inflation and puncture. Each study is a figure that sets what the dissertation found beside what is
found here, with a verdict computed from the numbers. The studies are
independent functions of one bench; the file is long because there are six.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from foldlab.errors import InputError
from solver.cases.lung import model as case
from solver.cases.lung.measures import Measures, measure, radial
from solver.cases.lung.mesh import hexahedra, tetrahedra
from solver.cases.lung.model import REST, State, scene, to_limit
from solver.cases.lung.paths import Paths
from solver.cases.lung.stability import Classes, total
from solver.mesh.body import Body
from solver.paths.continuation import Path

from ._lung.plots import (
    plot_curves,
    plot_models,
    plot_pressure,
    plot_stability,
    plot_stiffness,
    signed,
)
from .common import main, save_figure
from .lung_inflation import known, prepared

HARDLY = 0.02  # of R: how far the epithelium may move outwards and yet hardly do so


@dataclass(frozen=True)
class Config:
    """Sizes in R, stresses in E_ep. ``level``: mesh of the wedge. ``tets``: size of the linear
    tetrahedra with which the stiffness is studied too (the dissertation's), 0: none."""

    seed: int = 0
    n: int = 2
    epithelium: float = 0.05
    muscle: float = 0.075
    width: float | None = None
    stiffness: float = 75.0
    nu: float = 0.3
    pressure: float = 0.11
    pressure_drop: float = 0.1
    steps: int = 10
    level: int = 1
    offsets: tuple[float, ...] = (-0.05, 0.0, 0.05)
    contractions: tuple[float, ...] = (0.0, -0.2, -0.4)
    stiffnesses: tuple[float, ...] = (5.0, 10.0, 15.0, 20.0, 25.0, 35.0, 50.0, 75.0, 100.0, 150.0)
    low_pressure: float = 0.03
    tets: float = 0.0345
    stability_every: int = 4
    studies: tuple[str, ...] = (
        "pressure", "contraction", "fibres", "stiffness", "model", "stability",
    )  # fmt: skip


TINY = Config(
    n=1, level=0, pressure=0.06, steps=2, contractions=(0.0, -0.05), stiffnesses=(25.0, 75.0),
    low_pressure=0.02, tets=0.0, stability_every=3,
)  # fmt: skip


class Bench(Paths):
    """What the studies share: the lung's paths, and two states."""

    def __init__(self, config: Config):
        lung, self.tissue = prepared(config, min(config.contractions), [config.level])
        super().__init__(lung, config.level, config.steps)
        self.config = config
        self.full = State(config.pressure)
        self.low = config.pressure * (1 - config.pressure_drop)


@dataclass(frozen=True)
class Study:
    """Rows of the table, the figure, and the two statements."""

    rows: list[dict]
    figure: Figure
    claim: str
    verdict: str
    finding: str


def pressure(bench: Bench) -> Study:
    """± 5 % and the limit."""
    config = bench.config
    stage, path = bench.stage(bench.tissue, bench.full)
    ahead = bench.beyond(stage, path)
    top = config.pressure * ahead.last.e if ahead.reached else np.inf
    rows = []
    for offset in config.offsets:
        p = config.pressure * (1 + offset)
        row = {"case": f"p {offset:+.0%}", "pressure": p, "reached": bool(p <= top), "limit": top}
        if p <= top:
            done = scene(bench.body, bench.lung, bench.tissue, REST, State(p))
            end = case.run(done, steps=config.steps, events=False, over=None)
            measures = bench.at(done, end.last)
            row |= {"reached": end.reached, "aspect": measures.aspect, "depth": measures.depth}
        rows.append(row)
    measures = bench.along(stage, ahead)
    loads = config.pressure * ahead.loads
    lines = {"all of the epithelium": [m.aspect for m in measures]}
    for edges, name in ((6, "hexagons"), (5, "pentagons")):
        parts = [[c.aspect for c in m.cells if c.edges == edges] for m in measures]
        if all(parts):
            lines[name] = [np.mean(p) for p in parts]
    figure = plot_pressure(loads, lines, rows, ahead.reached)
    reached = [r for r in rows if r["reached"]]
    sizes = ", ".join(f"{r['case']}: {r['aspect']:.3f}" for r in reached)
    beyond = [r["case"] for r in rows if not r["reached"]]
    finding = f"aspect ratio {sizes}."
    if beyond:
        finding += (
            f" There is no equilibrium at {', '.join(beyond)} on this path: the limit point is at "
            f"p = {top:.4f}, {100 * (top / config.pressure - 1):.1f} % above {config.pressure:g}."
        )
    return Study(
        rows,
        figure,
        "changing the final pressure by 5 % either way changes the degree of the deformation, not "
        "its kind.",
        "differs above" if beyond else "agrees",
        finding,
    )


def contraction(bench: Bench) -> Study:
    """How far the muscle contracts, with the pressure a tenth lower and with none."""
    config, rows, curves = bench.config, [], {}
    for g in config.contractions:
        stage, path = bench.stage(bench.tissue, bench.full, State(bench.low, g))
        measures = bench.along(stage, path)
        rows.append(row_of(f"g = {g:g}, p = {bench.low:.3g}", path, measures, g=g))
        curves[rows[-1]["case"]] = (-g * path.loads, [m.aspect for m in measures])
    g = min(config.contractions)
    stage, path = bench.stage(bench.tissue, State(0.0, g))
    measures = bench.along(stage, path)
    dry = row_of(f"g = {g:g}, p = 0", path, measures, g=g)
    shrunk, wet = measures[-1].spacing / measures[0].spacing - 1, rows[-1]
    curves[dry["case"]] = (-g * path.loads, [m.aspect for m in measures])
    cuts = {}
    if config.n == 2:
        cuts["without pressure"] = bench.cut(stage, path)
        cuts["with pressure"] = bench.cut(
            *bench.stage(bench.tissue, bench.full, State(bench.low, g))
        )
    figure = plot_curves(curves, "contraction |g|", cuts, f"g = {g:g}, cut x = 0")
    grows = all(a["aspect"] < b["aspect"] for a, b in pairwise(rows))
    start, full = bench.stage(bench.tissue, bench.full)
    inflated = bench.at(start, full.last).aspect
    sizes = ", ".join(f"{r['aspect']:.3f} at {abs(100 * r['g']):.0f} %" for r in rows)
    way = "in" if dry["highest"] < HARDLY else "out"
    finding = (
        f"the aspect ratio is {inflated:.3f} inflated, and with a lower pressure and contraction "
        f"{sizes}. Without pressure the spacing changes by "
        f"{100 * shrunk:.0f} % and the epithelium moves {way}"
        f"wards (by {dry['lowest']:.2f} to {dry['highest']:.2f} R; with it {wet['lowest']:.2f} to "
        f"{wet['highest']:.2f}), yet it bulges through the shrinking cage as deep as "
        f"{100 * dry['depth'] / wet['depth']:.0f} % of that under pressure: aspect ratio "
        f"{dry['aspect']:.3f}."
    )
    if wet["highest"] < HARDLY:
        finding += " Under pressure nothing is farther out than at rest, either."
    if any(cut.overlaps for cut in cuts.values()):
        finding += " Bulges pass into the bundles there: contact between them is not modelled."
    parts = [
        "shrinking " + ("agrees" if shrunk < 0 else "differs"),
        "nothing moves outwards without pressure: "
        + ("agrees" if dry["highest"] < HARDLY else "differs"),
        "no protrusion by its aspect ratio: "
        + ("agrees" if dry["aspect"] < wet["aspect"] / 2 else "differs at this contraction"),
        "longer with contraction: " + ("agrees" if grows else "differs"),
    ]
    return Study(
        [*rows, dry],
        figure,
        "contraction without pressure bends and shrinks the lung and hardly pushes the epithelium "
        "out; with pressure, more contraction makes the protrusions longer.",
        "; ".join(parts),
        finding,
    )


def fibres(bench: Bench) -> Study:
    """Along the fibres, with mitred and with blended joints, and in all directions."""
    config, rows, curves, fields = bench.config, [], {}, []
    g = min(config.contractions)
    shell = np.unique(bench.body.cells[bench.body.cells_of("epithelium")])
    kinds = {
        "along": "along fibres, mitred joints",
        "blended": "along fibres, blended joints",
        "isotropic": "isotropic",
    }
    for kind, name in kinds.items():
        tissue = replace(bench.tissue, fibres=kind)
        stage, path = bench.stage(tissue, bench.full, State(bench.low, g))
        measures = bench.along(stage, path)
        rows.append(row_of(kind, path, measures, g=g))
        curves[name] = (-g * path.loads, [m.aspect for m in measures])
        u = stage.displacement(path.last.x, path.last.e)
        fields.append(radial(bench.body, u)[shell])
    figure = plot_curves(curves, "contraction |g|")
    along, blended, isotropic = (r["aspect"] for r in rows)
    apart, joints = isotropic / along - 1, blended / along - 1
    same = float(np.corrcoef(fields[0], fields[2])[0, 1])
    return Study(
        rows,
        figure,
        "isotropic contraction and contraction along the fibres give the same pattern of "
        "deformation.",
        f"{'agrees' if same > 0.95 else 'differs'} on the pattern; the depth depends on it",
        f"at |g| = {-g:g} the radial displacements of the two correlate to {same:.3f}; the aspect "
        f"ratio is {along:.3f} along the fibres and {isotropic:.3f} ({100 * apart:+.0f} %) "
        f"isotropic, and {blended:.3f} ({100 * joints:+.0f} %) with blended joints.",
    )


def stiffness(bench: Bench) -> Study:
    """E_sm/E_ep, on hexahedra and on linear tetrahedra as coarse as the dissertation's."""
    config, rows = bench.config, []
    meshes: dict[str, Body] = {"hex27": bench.body}
    if config.tets:
        meshes[f"tet4, {config.tets:g} R"] = tetrahedra(bench.lung, config.tets, part="wedge")
    for name, body in meshes.items():
        for E in config.stiffnesses:
            tissue = replace(bench.tissue, stiffness=E)
            stage = scene(body, bench.lung, tissue, REST, bench.full)
            path = case.run(stage, steps=config.steps, events=False, over=None)
            ahead = bench.beyond(stage, path)
            low = scene(body, bench.lung, tissue, REST, State(config.low_pressure))
            at_low = case.run(low, steps=config.steps, events=False, over=None)
            row = row_of(f"{name}, {E:g}", path, [bench.at(stage, path.last)])
            if not path.reached:
                row["aspect"] = None
            row |= {
                "mesh": name,
                "stiffness": E,
                "limit": config.pressure * ahead.last.e if ahead.reached else None,
                "at_limit": bench.at(stage, ahead.last).aspect if ahead.reached else None,
                "low": bench.at(low, at_low.last).aspect if at_low.reached else None,
            }
            print(row, file=sys.stderr)
            rows.append(row)
    table = pd.DataFrame(rows)
    figure = plot_stiffness(table, config.pressure, config.low_pressure)
    own = table[table["mesh"] == "hex27"]
    held = own[own["aspect"].notna()]
    lost = own[own["aspect"].isna()]["stiffness"]
    least = held["stiffness"].min() if len(held) else np.inf
    finding = f"p = {config.pressure:g} is reached "
    finding += f"from E_sm/E_ep = {least:g} on" if len(held) else "at none of these ratios"
    if len(lost):
        finding += (
            f"; up to {lost.max():g} the pressure passes its limit point before "
            f"({own['limit'].min():.3f} to "
            f"{own[own['stiffness'] == lost.max()]['limit'].iloc[0]:.3f})"
        )
    if len(held) > 1:
        ends = held["aspect"].iloc[0], held["aspect"].iloc[-1]
        finding += (
            f". Above, the aspect ratio goes from {ends[0]:.3f} at {held['stiffness'].iloc[0]:g} "
            f"to {ends[1]:.3f} at {held['stiffness'].iloc[-1]:g}"
        )
    flat = len(held) > 1 and abs(held["aspect"].iloc[-1] / held["aspect"].iloc[0] - 1) < 0.1
    low = own[own["low"].notna()]
    if len(low) > 1:
        finding += (
            f". At p = {config.low_pressure:g}, which all of them carry, it rises smoothly from "
            f"{low['low'].iloc[0]:.3f} at {low['stiffness'].iloc[0]:g} to {low['low'].iloc[-1]:.3f}"
        )
    verdict = f"plateau {'agrees' if flat else 'differs'}"
    if len(lost):
        verdict += "; below it no threshold of the shape but a limit of the pressure"
    return Study(
        rows,
        figure,
        "at one final pressure no protrusions worth the name below E_sm/E_ep of about 25, and a "
        "plateau of their depth from 75 on.",
        verdict,
        finding + ".",
    )


def model(bench: Bench) -> Study:
    """Neo-Hookean with follower pressure against small strain with dead pressure."""
    config, rows, cuts = bench.config, [], {}
    g = min(config.contractions)
    for kind in ("advanced", "primitive"):
        tissue = replace(bench.tissue, model=kind)
        for name, states in (
            ("inflated", (bench.full,)),
            ("punctured", (bench.full, State(bench.low, g))),
        ):
            stage, path = bench.stage(tissue, *states)
            u = stage.displacement(path.last.x, path.last.e)
            row = row_of(f"{kind}, {name}", path, [measure(bench.body, bench.lung, u)])
            if config.n == 2:
                cut = bench.cut(stage, path)
                cuts.setdefault(f"{name}, cut x = 0", {})[kind] = cut
                row["sharpest"] = cut.sharpest
            rows.append(row)
    figure = plot_models(cuts, rows)
    ours, theirs = rows[0], rows[2]
    more = theirs["variation"] / ours["variation"]
    finding = (
        f"inflated, the primitive model's aspect ratio is {theirs['aspect']:.2f} instead of "
        f"{ours['aspect']:.2f}, its thickness varies by {100 * theirs['variation']:.0f} % instead "
        f"of {100 * ours['variation']:.0f} %"
    )
    finding += f", and {100 * rows[3]['inverted']:.1f} % of it is inside out when punctured"
    parts = ["thickness " + ("agrees" if more > 1.2 else "differs")]
    if cuts:
        sharp = [row["sharpest"] for row in rows]
        finding += (
            f". The sharpest curvature of its wall is {sharp[2]:.0f}/R instead of {sharp[0]:.0f}/R "
            f"inflated, and {sharp[3]:.0f}/R instead of {sharp[1]:.0f}/R punctured"
        )
        sharper = [sharp[2] > 1.2 * sharp[0], sharp[3] > 1.2 * sharp[1]]
        parts.append("curvature " + ("agrees" if all(sharper) else "agrees in one of two states"
                                     if any(sharper) else "differs"))  # fmt: skip
    return Study(
        rows,
        figure,
        "the primitive model has artefacts: sharper curvatures and a thickness that varies "
        "unrealistically.",
        "; ".join(parts),
        finding + ".",
    )


def stability(bench: Bench) -> Study:
    """Unstable modes of the whole sphere along inflation and puncture."""
    config, rows = bench.config, []
    octant = hexahedra(bench.lung, config.level, part="octant")
    g = min(config.contractions)
    for name, states in (
        ("inflation", (bench.full,)),
        ("puncture", (bench.full, State(bench.low, g))),
    ):
        before = states[-2] if len(states) > 1 else REST
        stage, path = bench.stage(bench.tissue, *states)
        points = [*path.points[:: config.stability_every], path.last]
        if name == "inflation":
            points += to_limit(stage, path, step=0.1 / config.steps).points[1:]
        classes = Classes(scene(octant, bench.lung, bench.tissue, before, states[-1]))
        for point in points:
            u = stage.displacement(point.x, point.e)
            counts = classes.count(bench.body, u, point.e)
            p, c = (
                a + point.e * (b - a)
                for a, b in (
                    (before.pressure, states[-1].pressure),
                    (before.contraction, states[-1].contraction),
                )
            )
            row = {"case": name, "e": point.e, "pressure": p, "g": c, "unstable": total(counts)}
            print(row | counts, file=sys.stderr)
            rows.append(row | counts)
    figure = plot_stability(pd.DataFrame(rows))
    lost = [r for r in rows if r["unstable"]]
    upto = [r for r in rows if r["case"] == "inflation" and r["e"] <= 1 and not r["unstable"]]
    finding = "the icosahedral pattern is stable against every mode of the whole sphere "
    if not lost:
        finding += "all along both paths"
    else:
        first = lost[0]
        finding += f"up to p = {upto[-1]['pressure']:.4g}" if upto else "nowhere"
        finding += (
            f"; the first loss seen is in the {first['case']} at p = {first['pressure']:.4g}, "
            f"g = {first['g']:.3g}, with {first['unstable']} modes"
        )
    return Study(
        rows,
        figure,
        "(no statement on stability: each state is taken as the lung's).",
        "new",
        finding + ".",
    )


def row_of(case: str, path: Path, measures: list[Measures], **more) -> dict:
    """One row of the table from the end of a path."""
    last = measures[-1]
    return {
        "case": case, **more, "aspect": last.aspect, "depth": last.depth, "spacing": last.spacing,
        "lowest": last.lowest, "highest": last.highest,
        "thinnest": last.thinnest, "variation": last.variation, "inverted": last.inverted,
        "unstable_even": path.last.unstable, "reached": path.reached,
        "snaps": sum(event.kind in ("snap", "bifurcation") for event in path.events),
        "outcome": path.outcome.value,
    }  # fmt: skip


STUDIES = {"pressure": pressure, "contraction": contraction, "fibres": fibres,
           "stiffness": stiffness, "model": model, "stability": stability}  # fmt: skip


def run(config: Config, tracker) -> dict[str, Any]:
    known(config.studies, STUDIES, "study")
    if not config.contractions or min(config.contractions) >= 0:
        raise InputError("contractions: expected at least one below 0, such as -0.4")
    bench, table, verdicts = Bench(config), [], {}
    for name in config.studies:
        start = time.process_time()
        try:
            study = STUDIES[name](bench)
        except ValueError as error:
            raise InputError(str(error)) from error
        seconds = time.process_time() - start
        figure = signed(study.figure, study.claim, study.finding, study.verdict)
        save_figure(figure, f"lung_{name}")
        tracker.figure(f"lung_{name}", figure)
        tracker.table(name, pd.DataFrame(study.rows))
        table += [{"study": name, **row} for row in study.rows]
        verdicts[name] = {
            "dissertation": study.claim,
            "finding": study.finding,
            "verdict": study.verdict,
            "cpu_seconds": seconds,
        }
        print(name, verdicts[name], file=sys.stderr)
    return {"table": table, "verdicts": verdicts}


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
