"""How far may the planar rod be trusted, and where do the numbers of the hinge's ends come from?

The rod (solver/cases/unit/rod.py) takes from the solid what the end of an active layer does: how
far it turns beyond the section's curvature, and by how much a moment turns it. Here both are
computed again, in plane strain, for layers of a grid, and compared with the table that is shipped
(``--set write=true`` writes it to out/hinge_ends.csv). Then the rod labels designs of the shipped
dataset, whose labels are the solver's.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from foldlab.datasets import load_dataset
from foldlab.labels import make_source
from foldlab.plots import STYLE
from solver.cases.unit.choices import Meshing, Physics
from solver.cases.unit.mesh import Sizes
from solver.cases.unit.model import build, foot, plane
from solver.cases.unit.rod import ends
from solver.cases.unit.section import natural
from solver.cases.unit.unit import Unit
from solver.equilibrium.scene import Scene
from solver.paths import LoadSteps, trace
from solver.physics.supports import Fixed

from .common import OUT, main, save_figure

LARGEST, HINGE, THICKNESS = 0.4, 0.3, 0.03  # contraction, l_i/l_s and (h_i + h_s)/l_s
MESHES = {
    "turn": Sizes(0.25, 3, 0.35, 0.25, 0.6, 1),
    "rotation": Sizes(0.12, 2, 0.5, 0.12, 0.5, 1),
}
HEADER = (
    "log10 h_ratio,log10 E_ratio,turn/c at 0,turn/c at 0.2,turn/c at 0.4,rotation per M/(E_s h_s²)"
)


@dataclass(frozen=True)
class Config:
    seed: int = 0
    # log10 of h_i/h_s and E_i/E_s, of the whole table by default
    h_ratios: tuple[float, ...] = tuple(np.linspace(-1, 1, 9).tolist())
    E_ratios: tuple[float, ...] = tuple(np.linspace(-3, 3, 13).tolist())
    labels: int = 5000
    write: bool = False


TINY = Config(h_ratios=(0.5,), E_ratios=(0.0,), labels=40)


def run(config: Config, tracker) -> dict[str, Any]:
    rows, off, lines = [], 0.0, [HEADER]
    for a in config.h_ratios:
        for b in config.E_ratios:
            computed = np.append(turn_of(10**a, 10**b), rotation_of(10**a, 10**b))
            off = max(off, float(np.abs(computed[:3] - ends(10**a, 10**b)[:3]).max()))
            turns = ",".join(f"{v:.4f}" for v in computed[:3])
            lines.append(f"{a:g},{b:g},{turns},{computed[3]:.4g}")
            rows.append(dict(zip(HEADER.split(","), [a, b, *computed.tolist()], strict=True)))
    if config.write:
        OUT.mkdir(exist_ok=True)
        (OUT / "hinge_ends.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    tracker.table("hinge_ends", pd.DataFrame(rows))
    labels = against_the_dataset(config)
    figure = labels.pop("figure")
    tracker.figure("rod_accuracy", figure)
    save_figure(figure, "rod_accuracy")
    return {"table": rows, "off_the_table": off, **labels}


def plane_strain(m: float, n: float, sizes: Sizes) -> tuple[Any, Scene]:
    """Half a weightless unit, held across the width; model and scene."""
    unit = Unit(n, 1.0, HINGE, 1.0, m, 1.0, 0.05, THICKNESS / (1 + m), LARGEST)
    model = build(unit, Meshing(sizes, curls=False), Physics(()))
    every = np.arange(len(model.body.nodes))
    held = [(every, 0), (plane(model.body, 1), 1), (foot(model.body), 2)]
    fixed = [Fixed(nodes, np.eye(3)[axis]) for nodes, axis in held]
    return model, Scene(model.body, model.terms, fixed=fixed)


def underside(nodes: np.ndarray) -> np.ndarray:
    """Nodes of the underside's edge x = 0, from the middle outwards."""
    on = np.flatnonzero((np.abs(nodes[:, 2]) < 1e-9) & (nodes[:, 0] < 1e-9))
    return on[np.argsort(nodes[on, 1])]


def turn_of(m: float, n: float) -> np.ndarray:
    """By how much more than κ l_i/2 half a free unit turns, over c, at c = 0, 0.2 and 0.4."""
    model, scene = plane_strain(m, n, MESHES["turn"])
    unit, nodes = model.unit, model.body.nodes
    step = min(0.125, 0.45 / max(unit.fold_angle / 2, 1.2))
    steps = LoadSteps(rtol=1e-7, step=step, growth=1.4, largest=1.5)
    path = trace(scene, np.zeros(scene.size), steps, max_steps=200)
    line, rows = underside(nodes), []
    for point in path.points[1:]:
        t = np.diff((nodes + scene.displacement(point.x, point.e))[line], axis=0)
        section = np.zeros((4, 3))
        natural(m, n, LARGEST * point.e, unit.nu, section)
        free = section[-1, 0] / unit.slenderness * unit.hinge_length / 2
        turned = np.unwrap(np.arctan2(t[:, 2], t[:, 1]))[-1]
        rows.append((LARGEST * point.e, (turned - free) / (LARGEST * point.e)))
    c, over = np.array(rows).T
    return np.polyval(np.polyfit(c, over, 2), [0.0, 0.2, 0.4])


def rotation_of(m: float, n: float) -> float:
    """Rotation of the end per M/(E_s h_s²) beyond that of hinge and panel, small strain."""
    model, scene = plane_strain(m, n, MESHES["rotation"])
    unit, body, h = model.unit, model.body, model.unit.slenderness
    end = body.surface(lambda X: X[:, 1] > 0.5 - 1e-9)
    heights = np.einsum("fqk,fk->fq", end.shapes, body.nodes[end.nodes][:, :, 2]) - h / 2
    force = np.zeros_like(body.nodes)
    np.add.at(force[:, 1], end.nodes, -np.einsum("fq,fqk,fq->fk", end.weights, end.shapes, heights))
    moment = -(force[:, 1] * (body.nodes[:, 2] - h / 2)).sum() / body.nodes[:, 0].max()
    flat = scene.system(np.zeros(scene.size), 0.0)
    u = scene.displacement(flat.factorise().solve(scene.unknowns(force)), 0.0)
    line = underside(body.nodes)
    y = body.nodes[line, 1]
    # Near the hinge the underside is not yet that of a beam; at its middle the panel is.
    far, middle = y > HINGE / 2 + 2 * THICKNESS, HINGE / 2 + 0.1
    slope = np.polyfit(y[far] - middle, u[line][far, 2], 2)[1]
    mn = m * n
    hinge = ((1 + m**3 * n) / 12 + mn * (1 + m) ** 2 / (4 * (1 + mn))) / (1 - unit.nu**2)
    panel = 1 / 12 / (1 - unit.nu**2)
    return float((slope / moment - (HINGE / 2 / hinge + 0.1 / panel) / h**3) * h**2)


def against_the_dataset(config: Config) -> dict[str, Any]:
    """Verdicts, angles and stated errors of the rod against the solver's labels."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    table = load_dataset("gravity-5k")
    table = table[(table["growth"] == "uniaxial") & table["foldable"].notna()]
    table = table.sample(min(config.labels, len(table)), random_state=config.seed)
    sure, decided = make_source("rod"), make_source("rod", {"sure": False})
    sure.label(table.iloc[0])  # compiles
    begun = time.process_time()
    labels = sure.label_many(table)
    spent = time.process_time() - begun
    truth = table["foldable"].to_numpy(bool)
    known = np.array([label.foldable is not None for label in labels])
    right = np.array([label.foldable == t for label, t in zip(labels, truth, strict=True)])
    every = decided.label_many(table)
    all_right = np.array([label.foldable == t for label, t in zip(every, truth, strict=True)])
    m1 = np.array([label.evidence["m1"] for label in labels])
    stated = np.array([label.evidence["error_estimate"] for label in labels])
    scale = np.maximum(np.abs(m1), np.pi * table["contraction"].to_numpy())
    off = np.abs(m1 - table["m1"].to_numpy()) / scale
    with rc_context(STYLE):
        figure = Figure(figsize=(3.4, 3.2), layout="constrained")
        ax = figure.subplots()
        ax.plot(table["m1"], m1, ".", ms=2, alpha=0.5)
        ax.plot([-7, 7], [-7, 7], "k-", lw=0.5)
        ax.set(xlim=(-3, 8), ylim=(-3, 8), xlabel="m1 of the solver, rad", ylabel="of the rod, rad")
    return {
        "labels": len(labels),
        "unknown": int((~known).sum()),
        "wrong": int((known & ~right).sum()),
        "wrong_if_it_must_decide": int((~all_right).sum()),
        "error_median": float(np.median(off)),
        "error_95": float(np.quantile(off, 0.95)),
        "within_the_stated_error": float(np.mean(off <= stated)),
        "labels_per_core_second": len(labels) / max(spent, 1e-3),
        "figure": figure,
    }


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
