"""Do the dissertation's figures of folding units hold? Each drawn, with its verdict beside ours.

4.16 (and Table 4.1): no weight, both contractions. 4.17: the same hinge with and without weight.
4.18: Γ = 0.04, 0.4, 0.4 with b_s/l_s = 0.25, 0.25, 0.5. 4.30, 4.31: a patterned hinge aligns the
fold. 4.15: an upright unit topples. Groups that a figure leaves open are those of the first row of
its Table 4.2, and are scanned where the verdict hangs on them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from experiments.common import main, save_figure
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource
from foldlab.plots import STYLE

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
    strips: int = 3
    scan: int = 3


TINY = Config(figures=("4.16",), timeout=5.0, scan=1)


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
    return {f"{g}, no weight": run for g, (run, _) in paths.items()}, {
        "dissertation": "uniaxial about 3.0 rad at g = 0.3; isotropic folds too",
        "ours": (
            f"uniaxial {angles['uniaxial']:.2f} rad; isotropic from flat "
            f"{angles['isotropic']:.2f} rad, curled by {m2:.2f} rad"
        ),
        "agrees": bool(abs(angles["uniaxial"] - 3.0) < 0.3),
        "why": "their linear tetrahedra lock; the converged angle is 3.77 rad",
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
    wanted = [False, True, False]
    # Where B folds and C does not hangs on the active layer: scan what the figure leaves open.
    held = []
    for h_ratio in np.geomspace(0.2, 2.0, config.scan):
        answers = []
        for gamma, aspect in cases.values():
            design = {
                **TABLE_42,
                "stiffness_to_weight": gamma,
                "aspect": aspect,
                "h_ratio": float(h_ratio),
            }
            answers.append(_path(config, design, growth="isotropic")[1].foldable)
        if answers == wanted:
            held.append(float(h_ratio))
    return paths, {
        "dissertation": "A no, B yes, C no (the hinge bends about the other axis)",
        "ours": "; ".join(f"{k}: {', '.join(map(_says, v))}" for k, v in said.items()),
        "agrees": wanted in said.values(),
        "why": (
            "isotropic from flat curls across the hinge; verdict holds at h_i/h_s = "
            + (", ".join(f"{h:.2g}" for h in held) or "none of those scanned")
        ),
    }


def patterned_unit(config: Config):
    paths, said = {}, []
    for gamma in (TABLE_42["stiffness_to_weight"], 25 * TABLE_42["stiffness_to_weight"]):
        design = {**TABLE_42, "stiffness_to_weight": gamma}
        solid, plain = _path(config, design, growth="isotropic")
        strips, cut = _path(
            config, design, growth="isotropic", strips=config.strips, strip_share=0.8
        )
        paths[f"solid, Γ = {gamma:g}"] = solid
        paths[f"{config.strips} strips, Γ = {gamma:g}"] = strips
        said.append((gamma, plain, cut))
    return paths, {
        "dissertation": "both fold alike",
        "ours": "; ".join(
            f"Γ = {gamma:g}: solid {_says(a)} (m2 {_value(a, 'm2'):.2f}), strips {_says(b)} "
            f"(m2 {_value(b, 'm2'):.2f})"
            for gamma, a, b in said
        ),
        "agrees": any(a.foldable is True and b.foldable is True for _, a, b in said),
        "why": "Γ, number and width of their cuts are not stated; strips cover 80 % here",
    }


def patterned_layer(config: Config):
    sheet = {**TABLE_41, "hinge_length": 0.5, "aspect": 0.5, "contraction": 0.24}
    options = {"growth": "isotropic", "effects": "none"}
    solid, plain = _path(config, sheet, **options)
    strips, cut = _path(config, sheet, **options, strips=config.strips)
    ratio = [_value(x, "m2") / max(abs(_value(x, "fold_angle")), 1e-9) for x in (plain, cut)]
    return {"solid": solid, f"{config.strips} strips": strips}, {
        "dissertation": "solid bends about a diagonal, strips along one direction",
        "ours": f"turning across over along: solid {ratio[0]:.2f}, strips {ratio[1]:.2f}",
        "agrees": ratio[1] < 0.5 * ratio[0],
        "why": "material and geometry of their bilayers are not stated",
    }


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
