"""Do the dissertation's figures of folding units hold? Each drawn, with its verdict beside ours.

4.16 (and Table 4.1): no weight, both contractions, and uniaxially on linear tetrahedra like theirs.
4.17: the same hinge with and without weight. 4.18: Γ = 0.04, 0.4, 0.4 with b_s/l_s = 0.25, 0.25,
0.5. 4.30: a unit with cuts in its hinge folds like one without. 4.31: a solid square bends about
its diagonal, strips along one direction. 4.15: an upright unit topples. Groups that a figure leaves
open are those of the first row of its Table 4.2, and are scanned where the verdict hangs on them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import product
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.foldability import measure
from foldlab.labels.solver import SolverSource
from foldlab.plots import STYLE
from solver.cases.unit.choices import Meshing, Physics
from solver.cases.unit.model import build
from solver.cases.unit.path import fold

from .common import main, save_figure

TABLE_41 = {
    "E_ratio": 0.1, "rho_ratio": 0.1, "hinge_length": 0.2, "hinge_width": 1.0, "h_ratio": 5.0,
    "stiffness_to_weight": 1.0, "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.3,
}  # fmt: skip
TABLE_42 = {
    "E_ratio": 0.1, "rho_ratio": 0.1, "hinge_length": 0.25, "hinge_width": 1.0, "h_ratio": 0.2,
    "stiffness_to_weight": 0.4, "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.4,
}  # fmt: skip
GROWTHS = ("uniaxial", "isotropic")


@dataclass(frozen=True)
class Config:
    seed: int = 0
    figures: tuple[str, ...] = ("4.16", "4.17", "4.18", "4.30", "4.31", "4.15")
    timeout: float = 120.0
    strips: tuple[int, ...] = (2, 3, 5)
    fraction: tuple[float, ...] = (0.5, 0.8, 0.95)  # of the pitch that a strip takes
    scan: int = 3
    tetrahedra: float = 0.49  # size over the local thickness, the finest of their Fig. 4.14


TINY = Config(figures=("4.16",), timeout=5.0, scan=1, tetrahedra=3.0)


def run(config: Config, tracker) -> dict[str, Any]:
    draw = {
        "4.15": toppling, "4.16": no_weight, "4.17": weight, "4.18": lift_and_width,
        "4.30": patterned_unit, "4.31": patterned_layer,
    }  # fmt: skip
    rows = []
    for name in config.figures:
        paths, verdict = draw[name](config)
        figure = _picture(paths, f"Fig. {name}: {verdict['ours']}")
        save_figure(figure, f"figure_{name.replace('.', '_')}")
        tracker.figure(f"figure_{name.replace('.', '_')}", figure)
        rows.append({"figure": name, **verdict})
        print(f"{name}: {verdict}", file=sys.stderr, flush=True)
    return {"table": rows}


def _path(config: Config, design, *, growth="uniaxial", effects="gravity,ground", **options):
    """Run and label of one design; the path is on the coarsest mesh."""
    conditions = Conditions(effects, growth, **options)
    source = SolverSource(conditions, Effort(accuracy=0.05, timeout=config.timeout))
    return source.follow(design)


def no_weight(config: Config):
    paths = {g: _path(config, TABLE_41, growth=g, effects="none") for g in GROWTHS}
    angles = {g: _value(label, "fold_angle") for g, (_, label) in paths.items()}
    m2 = _value(paths["isotropic"][1], "m2")
    unit = paths["uniaxial"][0].folding.model.unit
    locked = fold(build(unit, Meshing(grading=config.tetrahedra, element="tet4"), Physics(())))
    theirs = measure(locked.last.curves, unit.hinge_length).m1
    short = angles["uniaxial"] - 3.0
    return {f"{g}, no weight": run for g, (run, _) in paths.items()}, {
        "dissertation": "uniaxial about 3.0 rad at g = 0.3; isotropic folds too",
        "ours": (
            f"uniaxial {angles['uniaxial']:.2f} rad; isotropic from flat "
            f"{angles['isotropic']:.2f} rad, curled by {m2:.2f} rad"
        ),
        "agrees": bool(abs(short) < 0.3),
        "why": (
            f"linear tetrahedra of {config.tetrahedra:g} of the thickness give {theirs:.2f} rad "
            f"({locked.model.scene.size} unknowns): locking explains "
            f"{100 * (angles['uniaxial'] - theirs) / angles['uniaxial']:.0f} % of the converged "
            f"angle, and they read {100 * short / angles['uniaxial']:.0f} % less"
        ),
    }


def weight(config: Config):
    light = {**TABLE_42, "contraction": 0.25}
    paths, folds = {}, {}
    for name, gamma in (("Γ = 0.04", 0.04), ("Γ = 0.4", 0.4)):
        design = {**light, "stiffness_to_weight": gamma}
        paths[f"{name}, g = 0.25"], label = _path(config, design)
        folds[name] = label.foldable
    more = {**TABLE_42, "stiffness_to_weight": 0.04}
    paths["Γ = 0.04, g = 0.4"], label = _path(config, more)
    paths["no weight, g = 0.25"], free = _path(config, light, effects="none")
    return paths, {
        "dissertation": "folds without weight at 0.25; with weight neither at 0.25 nor at 0.4",
        "ours": (
            f"without weight {_says(free)}; Γ = 0.04: {_says(folds['Γ = 0.04'])} at 0.25, "
            f"{_says(label)} at 0.4; Γ = 0.4: {_says(folds['Γ = 0.4'])}"
        ),
        "agrees": free.foldable is True and folds["Γ = 0.04"] is False and label.foldable is False,
        "why": "their Γ is not stated; ours as given (uniaxial)",
    }


def lift_and_width(config: Config):
    cases = {"A": (0.04, 0.25), "B": (0.4, 0.25), "C": (0.4, 0.5)}
    paths, said = {}, {}
    questions = (
        ("uniaxial", {"growth": "uniaxial"}),
        ("isotropic from flat", {"growth": "isotropic"}),
        ("isotropic, exists", {"growth": "isotropic", "question": "exists"}),
    )
    for kind, options in questions:
        said[kind] = []
        for name, (gamma, aspect) in cases.items():
            design = {**TABLE_42, "stiffness_to_weight": gamma, "aspect": aspect}
            run, label = _path(config, design, **options)
            said[kind].append(label.foldable)
            paths[f"{name}: {kind}"] = run
    held, counts = _scanned(config, cases)
    return paths, {
        "dissertation": "A no, B yes, C no (the hinge bends about the other axis)",
        "ours": "; ".join(f"{k}: {', '.join(map(_says, v))}" for k, v in said.items()),
        "agrees": WANTED in said.values(),
        "why": (
            "isotropic from flat curls across the hinge. Over E_i/E_s, h_i/h_s and l_i/l_s, which "
            "the figure leaves open, "
            + ", ".join(f"{word} for {n}" for word, n in counts.items())
            + (": " + "; ".join(held) if held else "")
        ),
    }


WANTED = [False, True, False]


def _scanned(config: Config, cases) -> tuple[list[str], dict[str, int]]:
    """Units with the verdicts of Fig. 4.18, and how many have them, do not, or leave it open."""
    held, counts = [], {"holds": 0, "does not hold": 0, "is unknown": 0}
    over = (
        np.geomspace(0.05, 2.0, config.scan),
        np.geomspace(0.2, 5.0, config.scan),
        np.linspace(0.15, 0.45, config.scan),
    )
    for E_ratio, h_ratio, length in product(*over):
        groups = {"E_ratio": E_ratio, "h_ratio": h_ratio, "hinge_length": length}
        design = {**TABLE_42, **{name: float(value) for name, value in groups.items()}}
        answers = []
        # B first, which seldom folds.
        for name, want in zip("BAC", (True, False, False), strict=True):
            gamma, aspect = cases[name]
            asked = {**design, "stiffness_to_weight": gamma, "aspect": aspect}
            answers.append((_path(config, asked, growth="isotropic")[1].foldable, want))
            if answers[-1][0] is (not want):
                break
        wrong = any(got is (not want) for got, want in answers)
        unknown = any(got is None for got, _ in answers)
        word = "does not hold" if wrong else "is unknown" if unknown else "holds"
        counts[word] += 1
        if word == "holds":
            held.append(f"{E_ratio:.2g}, {h_ratio:.2g}, {length:.2g}")
        print(f"4.18: {groups}: {answers}: {word}", file=sys.stderr, flush=True)
    return held, counts


def patterned_unit(config: Config):
    paths, said, both = {}, [], False
    for gamma in (TABLE_42["stiffness_to_weight"], 25 * TABLE_42["stiffness_to_weight"]):
        design = {**TABLE_42, "stiffness_to_weight": gamma}
        paths[f"solid, Γ = {gamma:g}"], plain = _path(config, design, growth="isotropic")
        answers = []
        for strips, fraction in product(config.strips, config.fraction):
            run, cut = _path(
                config, design, growth="isotropic", strips=strips, strip_share=fraction
            )
            answers.append((strips, fraction, cut))
            print(f"4.30: Γ = {gamma:g}, {strips} of {fraction:g}: {cut.reason}", file=sys.stderr)
        paths[f"{strips} strips of {fraction:g}, Γ = {gamma:g}"] = run
        folding = [f"{n} of {fraction:g}" for n, fraction, cut in answers if cut.foldable]
        unknown = sum(cut.foldable is None for *_, cut in answers)
        both = both or (plain.foldable is True and bool(folding))
        said.append(
            f"Γ = {gamma:g}: solid {_says(plain)} (m2 {_value(plain, 'm2'):.2f}), strips that "
            f"fold: {', '.join(folding) or 'none'} of {len(answers)} patterns, {unknown} unknown"
        )
    return paths, {
        "dissertation": "both fold alike",
        "ours": "; ".join(said),
        "agrees": both,
        "why": "Γ, number and width of their cuts are not stated",
    }


def patterned_layer(config: Config):
    # A square bilayer, all but for two narrow panels.
    sheet = {**TABLE_41, "hinge_length": 0.9, "aspect": 1.0, "contraction": 0.24, "h_ratio": 1.0}
    sheet |= {"E_ratio": 1.0, "slenderness": 0.02}
    options = {"growth": "isotropic", "effects": "none"}
    solid, plain = _path(config, sheet, **options)
    strips, cut = _path(config, sheet, **options, strips=config.strips[-1])
    ways = [_bending(run) for run in (solid, strips)]
    told = [f"{k:.1f} and {other:.1f} about an axis {off:.0f}° off x" for k, other, off in ways]
    return {"solid": solid, f"{config.strips[-1]} strips": strips}, {
        "dissertation": "solid bends about a diagonal, strips along one direction",
        "ours": f"curvatures times l_s: solid {told[0]} ({plain.evidence['outcome']}); strips "
        f"{told[1]} ({cut.evidence['outcome']})",
        "agrees": bool(30 < ways[0][2] < 60 and ways[1][2] < 15),
        "why": "material and geometry of their bilayers are not stated; a square of l_s here",
    }


def _bending(run) -> tuple[float, float, float]:
    """Principal curvatures of the hinge, times l_s, in the mean over the last state, the larger
    first; and by how many degrees, 0 … 90, the axis that it bends about lies off x."""
    shape = run.shapes[-1]
    model, e = shape.model, float(shape.state.e)
    body = model.body
    u = model.scene.displacement(shape.x, e)
    F = np.eye(3) + np.einsum("cai,cqaj->cqij", u[body.cells], body.gradients)
    X = body.points()
    low = ~body.cells_of("active") & (np.abs(X[..., 1]).max(axis=1) < model.unit.hinge_length / 2)
    F, X, weights = F[low], X[low], body.weights[low]
    along = F[..., :, :2]
    normal = np.cross(F[..., :, 0], F[..., :, 1])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    # Slopes of the normal over each element, by least squares over its points.
    from_middle = X - X.mean(axis=1, keepdims=True)
    A = np.concatenate([np.ones_like(from_middle[..., :1]), from_middle], axis=-1)
    slopes = (np.linalg.pinv(A) @ normal)[:, 1:3]
    k = -np.einsum("cai,cqib->cqab", slopes, along)
    K = np.einsum("cq,cqab->ab", weights, (k + np.swapaxes(k, 2, 3)) / 2) / weights.sum()
    if "x" in model.mirrors or "y" in model.mirrors:
        K[0, 1] = K[1, 0] = 0.0  # the mirrored part twists the other way
    values, axes = np.linalg.eigh(K)
    order = np.argsort(-np.abs(values))
    bends = axes[:, order[0]]
    off = np.degrees(np.arctan2(abs(bends[0]), abs(bends[1])))
    return float(values[order[0]]), float(values[order[1]]), float(off)


def toppling(config: Config):
    held, upright = _path(config, TABLE_41)
    free, fallen = _path(config, TABLE_41, upright=False)
    at = [e["contraction"] for e in upright.evidence.get("events", ()) if e["kind"] == "toppling"]
    return {"held upright": held, "free to fall": free}, {
        "dissertation": "upright at g = 0.32 may be unstable; with noise it topples and is stable",
        "ours": (f"can topple from g = {at[0]:.2f} on" if at else "no toppling")
        + f"; let go: {fallen.evidence['outcome']}, m1 {_value(fallen, 'fold_angle'):.2f} rad",
        "agrees": bool(at),
        "why": "their design is not stated; Table 4.1 with Γ = 1 here",
    }


def _value(label, name: str) -> float:
    """A measure, NaN where the path had no state."""
    return label.evidence.get(name, float("nan"))


def _says(answer) -> str:
    folds = getattr(answer, "foldable", answer)
    return {True: "yes", False: "no", None: "unknown"}[folds]


def _picture(paths: dict, title: str) -> Figure:
    """The four curves at rest, halfway and in the end, one panel per path."""
    with mpl.rc_context(STYLE):
        columns = min(3, len(paths))
        rows = -(-len(paths) // columns)
        figure = Figure(figsize=(2.6 * columns, 2.3 * rows + 0.5))
        for k, (name, run) in enumerate(paths.items()):
            ax = figure.add_subplot(rows, columns, k + 1, projection="3d")
            states = run.folding.states
            if states:
                picks = sorted({0, len(states) // 2, len(states) - 1})
                for i, colour in zip(picks, ("#B8BEC6", "#6C8EBF", "#0B3C9C"), strict=False):
                    for c in states[i].curves:
                        ax.plot(*c.T, color=colour, lw=1)
                reached = run.history[-1]["contraction"]
                ax.set_title(f"{name}\nto g = {reached:.2f}", fontsize=7)
            ax.set_box_aspect((1, 2, 1))
            ax.set_aspect("equal")
            ax.view_init(elev=18, azim=-25)
            ax.set_axis_off()
        figure.suptitle(title, fontsize=8, wrap=True)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
