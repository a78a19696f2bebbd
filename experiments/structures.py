"""Do structures of many hinges fold under their weight, and how far can the fast level be trusted?

Five patterns that people know, at a size that folds and at a larger one; two panels against the
label of a unit, over how far panels would sag; a Miura vertex against its rigid kinematics; a sheet
of 100 panels against the clock; random nets, each of which must end in a typed result; the largest
cube that closes, over pairs of materials; and rigid panels against the whole sheet as a solid.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.optimize import brentq

from foldlab.design import FULL
from foldlab.labels.asked import Effort
from foldlab.labels.solver import SolverSource
from foldlab.materials import read_materials
from foldlab.plots import LINES, STYLE
from foldlab.structure.answer import SAG, answer
from foldlab.structure.files import SHIPPED, read_pattern
from foldlab.structure.laws import from_labels
from foldlab.structure.solid import solid
from solver.cases.structure.hinges import Law, Layer
from solver.cases.structure.model import build
from solver.cases.structure.parts import Structure
from solver.cases.structure.path import fold
from solver.cases.structure.pattern import Crease, Pattern
from solver.equilibrium.clock import core_seconds

from .common import main, save_figure
from .gravity_campaign import SHEETS

# A film of PET with a stiff shape-memory polymer, as README's example.
SHEET = Layer(3.5e9, 1375.0, 1e-4)
ACTIVE = Layer(2e7, 1125.0, 2e-4, 0.23)
PAIRS = (
    ("polyester film", "shape-memory polymer"),
    ("polypropylene sheet", "shape-memory polymer"),
    ("paper", "shape-memory polymer"),
    ("silicone rubber", "liquid crystal elastomer"),
    ("silicone rubber", "thermoresponsive hydrogel"),
)


@dataclass(frozen=True)
class Config:
    seed: int = 0
    parts: tuple[str, ...] = ("examples", "unit", "miura", "many", "nets", "largest", "solid")
    units: int = 40
    nets: int = 200
    net_seconds: float = 4.0  # core-seconds of a net
    side: int = 10  # panels along a side of the large sheet
    timeout: float = 60.0
    large: float = 3.0  # times the pattern's own size
    solids: tuple[str, ...] = (*SHIPPED, "two panels")
    level: int = 1  # mesh of solids


TINY = Config(
    parts=("unit", "miura", "nets", "solid"), units=1, nets=2, timeout=20.0, solids=("two panels",)
)


def run(config: Config, tracker) -> dict[str, Any]:
    out: dict[str, Any] = {}
    make = {
        "examples": examples, "unit": against_units, "miura": miura, "many": many,
        "nets": random_nets, "largest": largest, "solid": against_solids,
    }  # fmt: skip
    for name in config.parts:
        rows, told = make[name](config)
        tracker.table(name, pd.DataFrame(rows))
        out[name] = told | {"rows": rows}
        print(f"{name}: {told}", file=sys.stderr, flush=True)
    for name, draw in (("unit", picture_of_units), ("largest", picture)):
        if name in out:
            figure = draw(out[name]["rows"])
            save_figure(figure, f"structures_{name}")
            tracker.figure(f"structures_{name}", figure)
    out["table"] = [{"part": name, "rows": len(out[name]["rows"])} for name in config.parts]
    return out


def examples(config: Config):
    """The shipped patterns, as drawn and ``large`` times as large, with the same sheet, layers and
    hinges of 5 mm."""
    rows = []
    for name, times in product(SHIPPED, (1.0, config.large)):
        drawn = replace(read_pattern(name), hinge={})
        extent = times * drawn.metres * float(np.ptp(drawn.vertices, axis=0).max())
        body, laws = from_labels(Structure.of(drawn.pattern(0.005, extent), SHEET, ACTIVE))
        result = answer(body, timeout=config.timeout)
        e = result.evidence
        rows.append(
            {
                "pattern": name,
                "extent_mm": 1e3 * extent,
                "foldable": result.foldable,
                "angles": [h["angle"] for h in result.hinges],
                "natural": [h["natural"] for h in result.hinges],
                "stable": e.get("stable"),
                "panel_sag": e["panel_sag"],
                "core_seconds": e["core_seconds"],
                "label_seconds": sum(law["core_seconds"] for law in laws),
                "reason": result.reason,
            }
        )
        print(f"{name}, {1e3 * extent:g} mm: {result.reason}", file=sys.stderr, flush=True)
    return rows, {"ended": sum(r["foldable"] is not None for r in rows), "of": len(rows)}


def against_units(config: Config):
    """Two panels against the label of the unit that they are: weight and ground, uniaxial."""
    source = SolverSource(effort=Effort(timeout=config.timeout, whole=True))
    rows = []
    for design in SHEETS.sample(8 * config.units, seed=config.seed + 700).to_dict("records"):
        if len(rows) >= config.units:
            break
        design["hinge_width"] = 1.0
        label = source.label(design)
        m1 = label.evidence.get("m1")
        if label.foldable is None or abs(m1) > np.pi:
            continue  # the label's panels pass through each other there
        start = core_seconds()
        body = from_labels(unit_of(design))[0]
        labelled = core_seconds()
        result = answer(body, ("gravity", "ground"), upright=True, timeout=config.timeout)
        hinge = result.hinges[0]
        rows.append(
            {
                "panel_sag": result.evidence["panel_sag"],
                "ending": result.evidence["outcome"],
                "angle": hinge["angle"],
                "label": m1,
                "natural": hinge["natural"],
                "stated": label.evidence["error_m1"],
                "same": hinge["folds"] is label.foldable,
                "label_seconds": label.evidence["core_seconds"],
                "law_seconds": labelled - start,
                "fast_seconds": core_seconds() - labelled,
            }
        )
    return rows, agreement(pd.DataFrame(rows))


def picture_of_units(rows: list[dict[str, Any]]) -> Figure:
    """How far the angles are from those of labels, over the sag of the panels."""
    table = pd.DataFrame(rows)
    table = table[table["ending"] == "reached"]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.2, 3.2), layout="constrained")
        ax = figure.subplots()
        off = (table["angle"] - table["label"]).abs()
        ax.loglog(table["panel_sag"].clip(1e-4), off.clip(1e-4), "o", ms=4, color=LINES[0])
        line = np.array([1e-4, 1.0])
        ax.plot(line, 2 * line, color="0.6", lw=0.8, zorder=0, label="the sag of both panels")
        ax.axvline(SAG, color=LINES[1], lw=0.8, label="beyond it a fold is unknown")
        ax.set_xlabel("sag of a panel, rad")
        ax.set_ylabel("angle off the label's, rad")
        ax.legend()
    return figure


def unit_of(design: dict[str, float]) -> Structure:
    """A unit as a structure of two panels, lengths in l_s and stresses in E_s."""
    y, h = design["aspect"] / 2, design["slenderness"]
    vertices = [[-0.5, -y], [0, -y], [0.5, -y], [0.5, y], [0, y], [-0.5, y]]
    crease = Crease((1, 4), 1, design["hinge_length"])
    layer = Layer(
        design["E_ratio"], design["rho_ratio"], h * design["h_ratio"], design["contraction"]
    )
    pattern = Pattern(np.array(vertices), [[0, 1, 4, 5], [1, 2, 3, 4]], [crease])
    return Structure.of(pattern, Layer(1.0, 1.0, h), layer, g=h**2 / design["stiffness_to_weight"])


def agreement(table: pd.DataFrame) -> dict[str, Any]:
    """How far the angles are from those of labels, as a ratio to the larger of the label's angle
    and the natural one, for panels that would sag by at most ``SAG`` and for others. A label's
    angle, from end to end, has the sag of both panels in it."""
    told: dict[str, Any] = {"units": len(table)}
    table = table[table["ending"] == "reached"]
    told["ended"] = len(table)
    scale = np.maximum(table["label"].abs(), table["natural"].abs())
    off = (table["angle"] - table["label"]).abs() / scale
    stiff = table["panel_sag"] <= SAG
    for name, some in (("stiff", stiff), ("soft", ~stiff)):
        told[name] = {
            "units": int(some.sum()),
            "off_median": float(off[some].median()) if some.any() else None,
            "off_most": float(off[some].max()) if some.any() else None,
            "within_5_percent": int((off[some] <= 0.05).sum()),
            "same_verdict": int(table.loc[some, "same"].sum()),
        }
    return told


def against_solids(config: Config):
    """Rigid panels against the whole sheet as a solid, which bends: weight and ground, hinges that
    would turn by some 80° alone. Off: the largest of a pattern's hinges, as a ratio to the largest
    angle of its solid; error: that of the solid, likewise."""
    layer, rows, acting = replace(ACTIVE, contraction=0.19), [], ("gravity", "ground")
    for name in config.solids:
        if name in SHIPPED:
            pattern = read_pattern(name).pattern(0.005)
        else:
            pattern = unit_of(dict.fromkeys(FULL.names, 0.2)).pattern
            pattern = Pattern(0.06 * pattern.vertices, pattern.faces, [Crease((1, 4), 1, 0.005)])
        body = from_labels(Structure.of(pattern, SHEET, layer))[0]
        start = core_seconds()
        fast = answer(body, acting, upright=True, timeout=config.timeout)
        fast_seconds = core_seconds() - start
        whole = solid(body, acting, upright=True, level=config.level, timeout=5 * config.timeout)
        row = {
            "pattern": name,
            "fast": fast.evidence["outcome"],
            "solid": whole.folding.ending.name.lower(),
            "panel_sag": fast.evidence["panel_sag"],
            "unknowns": whole.unknowns,
            "fast_seconds": fast_seconds,
            "solid_seconds": whole.core_seconds,
        }
        if whole.angles is not None and fast.folding.states:
            rigid, largest_ = fast.folding.last.angles, np.abs(whole.angles).max()
            row |= {
                "angles_fast": np.degrees(rigid).tolist(),
                "angles_solid": np.degrees(whole.angles).tolist(),
                "off": float(np.abs(rigid - whole.angles).max() / largest_),
                "error": None if whole.error is None else float(whole.error.max() / largest_),
            }
        rows.append(row)
        print(f"{name}: {row}", file=sys.stderr, flush=True)
    off = [row["off"] for row in rows if "off" in row]
    return rows, {
        "compared": len(off),
        "of": len(rows),
        "within_5_percent": sum(value <= 0.05 for value in off),
        "solid_seconds_most": max(row["solid_seconds"] for row in rows),
    }


def miura(config: Config):
    """A vertex of 60 degrees in thin stiff panels without weight, for shorter and shorter hinges,
    against tan(a/2) = cos 60° tan(b/2) of rigid ones."""
    rows = []
    for length in (4e-3, 2e-3, 1e-3):
        drawn = replace(read_pattern("miura"), hinge={})
        layer = replace(ACTIVE, contraction=min(0.5, 0.23 * 5e-3 / length))
        folding = fold(build(Structure.of(drawn.pattern(length), SHEET, layer), ()))
        off = []
        for state in folding.states[1:]:
            odd, one, plain, other = np.abs(state.angles)
            rigid = 2 * np.arctan(0.5 * np.tan((one + other) / 4))
            off.append(max(abs(odd - rigid), abs(plain - rigid), abs(one - other)))
        rows.append(
            {
                "hinge_mm": 1e3 * length,
                "ending": folding.ending.name,
                "angle_degrees": float(np.degrees(folding.last.angles[1])),
                "off_degrees": float(np.degrees(max(off))),
            }
        )
    return rows, {"off_degrees_most": max(row["off_degrees"] for row in rows)}


def many(config: Config):
    """A Miura sheet of ``side`` × ``side`` panels under its weight, the whole path."""
    pattern = miura_sheet(config.side, config.side, np.radians(70), 0.02, 0.002)
    start = core_seconds()
    body = Structure.of(pattern, SHEET, replace(ACTIVE, contraction=0.3))
    folding = fold(build(body, deadline=start + config.timeout))
    row = {
        "panels": len(pattern.panels),
        "hinges": len(pattern.hinges),
        "unknowns": folding.model.scene.size,
        "ending": folding.ending.name,
        "states": len(folding.states),
        "iterations": folding.iterations,
        "core_seconds": core_seconds() - start,
        "angle_degrees": float(np.degrees(np.abs(folding.last.angles).mean())),
    }
    return [row], row


def miura_sheet(nx: int, ny: int, alpha: float, size: float, length: float) -> Pattern:
    """Parallelograms in rows that lean to and fro by alpha (rad), ``size`` along x; zigzag lines
    all up or all down in turn, straight lines up and down along themselves."""
    lean = 0.8 / np.tan(alpha)
    vertices = [[i + (j % 2) * lean, 0.8 * j] for j in range(ny + 1) for i in range(nx + 1)]

    def at(i, j):
        return j * (nx + 1) + i

    faces = [
        [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]
        for j in range(ny)
        for i in range(nx)
    ]
    creases = [
        Crease((at(i, j), at(i + 1, j)), -1 if (i + j) % 2 else 1, length)
        for j in range(1, ny)
        for i in range(nx)
    ]
    creases += [
        Crease((at(i, j), at(i, j + 1)), 1 if i % 2 else -1, length)
        for i in range(1, nx)
        for j in range(ny)
    ]
    return Pattern(size * np.array(vertices), faces, creases)


def random_nets(config: Config):
    """Random connected squares with random folds, hinges, layers and weights."""
    rng = np.random.default_rng(config.seed)
    rows = []
    for _ in range(config.nets):
        body = random_net(rng)
        start = core_seconds()
        folding = fold(build(body, deadline=start + config.net_seconds))
        rows.append(
            {
                "panels": len(body.pattern.panels),
                "ending": folding.ending.name,
                "detail": folding.detail,
                "events": len(folding.happenings),
                "states": len(folding.states),
                "core_seconds": core_seconds() - start,
            }
        )
    table = pd.DataFrame(rows)
    return rows, {
        "endings": table["ending"].value_counts().to_dict(),
        "core_seconds_median": float(table["core_seconds"].median()),
        "core_seconds_mean": float(table["core_seconds"].mean()),
        "core_seconds_most": float(table["core_seconds"].max()),
    }


def random_net(rng: np.random.Generator) -> Structure:
    """Three to twelve squares of side 1; Γ of a square from 0.1 to 1000."""
    cells, count = [(0, 0)], int(rng.integers(3, 13))
    while len(cells) < count:
        i, j = cells[rng.integers(len(cells))]
        di, dj = ((1, 0), (-1, 0), (0, 1), (0, -1))[rng.integers(4)]
        if (i + di, j + dj) not in cells:
            cells.append((i + di, j + dj))
    number: dict[tuple[int, int], int] = {}

    def vertex(i, j):
        return number.setdefault((i, j), len(number))

    corners = ((0, 0), (1, 0), (1, 1), (0, 1))
    faces = [[vertex(i + a, j + b) for a, b in corners] for i, j in cells]
    length, creases = float(rng.uniform(0.05, 0.3)), []
    for i, j in cells:
        for di, dj, ends in ((1, 0, ((1, 0), (1, 1))), (0, 1, ((0, 1), (1, 1)))):
            if (i + di, j + dj) in cells:
                pair = tuple(vertex(i + a, j + b) for a, b in ends)
                creases.append(Crease(pair, int(rng.choice([-1, 0, 1], p=[0.4, 0.1, 0.5])), length))
    h = float(10 ** rng.uniform(-3, -2))
    layer = Layer(
        float(10 ** rng.uniform(-2, 1)), 1.0, h * float(10 ** rng.uniform(-0.5, 0.5)),
        float(rng.uniform(0.02, 0.3)),
    )  # fmt: skip
    pattern = Pattern(np.array(list(number), float), faces, creases)
    return Structure.of(pattern, Layer(1.0, 1.0, h), layer, g=h**2 / 10 ** rng.uniform(-1, 3))


def largest(config: Config):
    """For pairs of materials the largest cube (side, mm) whose net closes: every hinge by at least
    85°. Hinges are a sixth of the side; layers of 0.1 and 0.2 mm; the contraction is the one that
    closes a weightless cube; materials where they are most likely."""
    table, rows = read_materials(), []
    for passive, active in PAIRS:
        sheet, E, rho = _middle(table, passive, active)
        low, high = 0.005, 2.0
        seen: dict[float, tuple[bool | None, str]] = {}

        def closes(side, layers=(sheet, E, rho), seen=seen):
            seen[side] = _closes(*layers, side, config.timeout)
            return seen[side][0]

        for side in map(float, np.geomspace(low, high, 7)):
            if closes(side) is False and any(ok for ok, _ in seen.values()):
                break
        closed = [side for side, (ok, _) in seen.items() if ok]
        row = {"passive": passive, "active": active, "largest_mm": None, "fails_mm": None}
        if closed:
            low = max(closed)
            high = min([side for side in seen if side > low], default=None)
            for _ in range(4 if high else 0):
                middle = (low * high) ** 0.5
                low, high = (middle, high) if closes(middle) else (low, middle)
            row |= {"largest_mm": 1e3 * low, "fails_mm": None if high is None else 1e3 * high}
            row["why"] = None if high is None else seen[high][1]
        else:
            row["why"] = "; ".join(f"{1e3 * side:.3g} mm: {why}" for side, (_, why) in seen.items())
        rows.append(row)
        print(f"largest: {row}", file=sys.stderr, flush=True)
    return rows, {f"{r['passive']} + {r['active']}": r["largest_mm"] for r in rows}


def _middle(table: pd.DataFrame, passive: str, active: str) -> tuple[Layer, float, float]:
    """The sheet, and modulus and density of the active layer, in the middle of their ranges."""
    values = []
    for name in (passive, active):
        row = table.loc[name]
        values.append(float((row["E_low"] * row["E_high"]) ** 0.5))
        values.append(float((row["rho_low"] + row["rho_high"]) / 2))
    return Layer(values[0], values[1], 1e-4), values[2], values[3]


def _closes(
    sheet: Layer, E: float, rho: float, side: float, timeout: float
) -> tuple[bool | None, str]:
    """Whether a cube's net closes, None where that is unknown, and why."""
    length = side / 6
    contraction = _closing(sheet, E, rho, length)
    if contraction is None:
        return False, "no contraction folds so short a hinge by a right angle"
    layer = Layer(E, rho, 2 * sheet.h, contraction)
    pattern = replace(read_pattern("cube"), hinge={}).pattern(length, size=4 * side)
    result = answer(Structure.of(pattern, sheet, layer), need=np.radians(85), timeout=timeout)
    return result.foldable, result.reason


def _closing(sheet: Layer, E: float, rho: float, length: float) -> float | None:
    """The contraction with which a hinge of a length folds by a right angle; None: none does."""

    def off(c):
        layer = Layer(E, rho, 2 * sheet.h, c)
        return Law.of_section(sheet, layer, length, length).angle[-1] - np.pi / 2

    for top in (0.5, 0.3, 0.1):
        try:
            return brentq(off, 1e-6, top) if off(top) > 0 else None
        except ValueError:
            continue  # a section that is crushed
    return None


def picture(rows: list[dict[str, Any]]) -> Figure:
    """Largest closing cubes, bars from the size that closes to the one that does not."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.6, 0.45 * len(rows) + 1.0), layout="constrained")
        ax = figure.subplots()
        for k, row in enumerate(rows):
            size = row["largest_mm"]
            ax.barh(k, size or 0.0, color=LINES[0], height=0.6)
            ax.annotate(
                "none closes" if size is None else f"{size:.0f} mm", (size or ax.get_xlim()[0], k),
                xytext=(4, 0), textcoords="offset points", va="center", fontsize=8,
            )  # fmt: skip
        ax.set_yticks(range(len(rows)), [f"{r['passive']} + {r['active']}" for r in rows])
        ax.set_xscale("log")
        ax.set_xlabel("side of the largest cube whose net closes under its weight, mm")
        ax.margins(x=0.15)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
