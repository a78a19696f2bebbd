"""Where in the design space does a path come to its end, why not elsewhere, and is it right?

Designs of the full space, with and without weight, contracting along the sheet and in all
directions, each on the coarsest mesh. A path is complete at the full contraction, or where the fold
has made a full turn; every last state is looked at again by the second code path of
solver.cases.unit.audit. The condition number is that of the stiffness on what supports and rows
leave free, in the 2-norm: largest eigenvalue (Lanczos' method, to 1 %) over the one nearest to 0
(inverse iteration). A run that was stopped goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.sparse import bsr_array
from scipy.sparse.linalg import LinearOperator, eigsh

from foldlab.design import FULL
from foldlab.labels import foldability
from foldlab.plots import LINES, STYLE, symbol
from solver.cases.unit.audit import audit, faults
from solver.cases.unit.choices import Meshing, Physics, Watch
from solver.cases.unit.model import build
from solver.cases.unit.path import Ending, fold
from solver.cases.unit.unit import EFFECTS, Unit
from solver.equilibrium.clock import core_seconds
from solver.equilibrium.descent import critical_mode
from solver.equilibrium.linear import SingularMatrix
from solver.equilibrium.scene import Scene

from .common import OUT, main, save_figure

THIRDS = ("low", "middle", "high")


@dataclass(frozen=True)
class Config:
    seed: int = 0
    designs: int = 120
    level: int = 0
    growths: tuple[str, ...] = ("uniaxial", "isotropic")
    lightest: float = 1e-3  # lower bound of Γ
    timeout: float = 15.0
    store: str = ""


TINY = Config(designs=3, growths=("uniaxial",), timeout=30.0)


def run(config: Config, tracker) -> dict[str, Any]:
    gamma = FULL["stiffness_to_weight"]
    space = FULL.with_bounds(stiffness_to_weight=(config.lightest, gamma.high))
    designs = space.sample(config.designs, seed=config.seed)
    path = _store(config)
    rows = _known(path)
    with path.open("a", encoding="utf-8") as out:
        for k, groups in enumerate(designs.to_dict("records")):
            if k in rows:
                continue
            growth = config.growths[k // 2 % len(config.growths)]
            effects = EFFECTS if k % 2 else ()
            rows[k] = {"design": k, **groups, **follow(groups, effects, growth, config)}
            out.write(json.dumps(rows[k]) + "\n")
            out.flush()
            if sys.stderr.isatty():
                print(f"\r{k + 1}/{config.designs}", end="", file=sys.stderr)
    frame = pd.DataFrame([rows[k] for k in range(config.designs)])
    table = by_region(frame, space)
    tracker.table("designs", frame)
    figure = picture(frame, table)
    save_figure(figure, "robustness")
    tracker.figure("robustness", figure)
    known = frame["condition"].dropna()
    worst = frame.loc[known.idxmax()] if len(known) else None
    return {
        "designs": len(frame),
        "complete": float(frame["complete"].mean()),
        "audited": int((frame["faults"].map(len) == 0).sum()),
        "faults": int(frame["faults"].map(len).sum()),
        "leaning": int((frame["leans"] > 1e-3).sum()),
        "reasons": dict(Counter(frame.loc[~frame["complete"], "reason"])),
        "complaints": [f"design {r.design}: {f}" for r in frame.itertuples() for f in r.faults],
        "worst_condition": None if worst is None else float(worst["condition"]),
        "worst_design": None
        if worst is None
        else {name: float(worst[name]) for name in FULL.names},
        "worst_correction": float(frame["correction"].max()),
        "seconds_median": float(frame["seconds"].median()),
        "seconds_most": float(frame["seconds"].max()),
        "store": str(path),
        "table": table,
    }


def _store(config: Config) -> Path:
    """The file of a run with these settings: another number of designs is another sample."""
    OUT.mkdir(exist_ok=True)
    kept = {k: v for k, v in asdict(config).items() if k != "store"}
    name = hashlib.sha256(json.dumps(kept).encode()).hexdigest()[:10]
    return Path(config.store) if config.store else OUT / f"robustness_{name}.jsonl"


def _known(path: Path) -> dict[int, dict]:
    """Rows of an earlier run; a line that was cut off while it was written is left out."""
    rows: dict[int, dict] = {}
    whole = ""
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(line)
            except json.JSONDecodeError:
                continue
            rows[row["design"]] = row
            whole += line + "\n"
        path.write_text(whole, encoding="utf-8")
    return rows


def follow(groups: dict[str, float], effects, growth: str, config: Config) -> dict[str, Any]:
    """The path of one design: how it ended, what its audit says, and its conditioning."""
    unit = Unit(**groups)
    begun = core_seconds()

    def stop(state) -> bool:
        m = foldability.measure(state.curves, unit.hinge_length)
        return bool(foldability.Thresholds().closed(m.m1, m.m2))

    model = build(
        unit,
        Meshing(config.level),
        Physics(effects, growth=growth),
        watch=Watch(deadline=begun + config.timeout),
    )
    folding = fold(model, stop=stop)
    seconds = core_seconds() - begun
    row: dict[str, Any] = {
        "effects": "+".join(effects) or "none",
        "growth": growth,
        "ending": folding.ending.name,
        "complete": folding.ending in (Ending.REACHED, Ending.STOPPED),
        "reason": folding.ending.value if folding.ending is Ending.TIMEOUT else folding.detail,
        "reached": float(folding.states[-1].e) if folding.states else 0.0,
        "happenings": [h.kind for h in folding.happenings],
        "unknowns": folding.model.scene.size,
        "seconds": seconds,
        "faults": list(faults(folding)),
        "correction": None,
        "leans": 0.0,
        "condition": None,
    }
    if folding.states:
        seen = audit(folding.model, folding.x, folding.last.e)
        # Against the moment of the unit's weight at an arm of half its length.
        own = 0.5 * unit.weight * unit.aspect * unit.slenderness
        row |= {"correction": seen.correction, "leans": seen.moment / own}
        row["condition"] = condition(folding.model.scene, folding.x, folding.last.e)
    return row


def condition(scene: Scene, x: np.ndarray, e: float) -> float | None:
    """Condition number of the stiffness at (x, e), see the module; None where it is singular."""
    # Without its deadline, which has passed where the time ran out.
    terms = [term for term in scene.terms if term.name != "deadline"]
    blocks = Scene(scene.body, terms).evaluate(scene.displacement(x, e), e, 2).stiffness
    g = scene.graph
    K = bsr_array((blocks, g.indices, g.indptr), shape=(3 * g.n, 3 * g.n))
    none = np.zeros(scene.n_rows)

    def product(v):
        du = scene.step_displacement(np.append(v, none))
        return scene.unknowns((K @ du.ravel()).reshape(-1, 3))[: scene.n_free]

    size = (scene.n_free, scene.n_free)
    largest = eigsh(
        LinearOperator(size, product, dtype=float),
        k=1,
        which="LA",
        tol=1e-2,
        v0=np.ones(scene.n_free),
        return_eigenvectors=False,
    )[0]
    try:
        least, _ = critical_mode(scene, scene.system_of(blocks).factorise(), sweeps=60)
    except SingularMatrix:
        return None
    return float(largest / abs(least))


def by_region(frame: pd.DataFrame, space) -> list[dict[str, Any]]:
    """Success, faults and worst conditioning by thirds of each group's range, and by setting."""
    parts = []
    for p in space:
        third = np.minimum((3 * p.to_unit(frame[p.name])).astype(int), 2)
        parts += [(p.name, THIRDS[k], frame[third == k]) for k in range(3)]
    for name in ("effects", "growth"):
        parts += [(name, value, part) for value, part in frame.groupby(name)]
    return [
        {
            "group": name,
            "region": region,
            "designs": len(part),
            "complete": float(part["complete"].mean()),
            "faults": int(part["faults"].map(len).sum()),
            "seconds_median": float(part["seconds"].median()),
            "worst_condition": float(part["condition"].max()),
        }
        for name, region, part in parts
        if len(part)
    ]


def picture(frame: pd.DataFrame, table: list[dict[str, Any]]) -> Figure:
    """Completed paths by thirds of each group, and conditioning against slenderness."""
    rows = pd.DataFrame(table)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.4, 3.2), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
        groups = [name for name in FULL.names if (rows["group"] == name).any()]
        for k, third in enumerate(THIRDS):
            part = rows[rows["region"] == third].set_index("group").reindex(groups)
            at = np.arange(len(groups)) + 0.25 * (k - 1)
            left.bar(at, part["complete"], 0.23, color=LINES[k], label=f"{third} third")
            for x, n, y in zip(at, part["designs"], part["complete"], strict=True):
                if np.isfinite(n):
                    left.text(x, y + 0.01, f"{n:.0f}", ha="center", fontsize=5.5)
        named = [symbol(g) if g != "stiffness_to_weight" else r"$\Gamma$" for g in groups]
        left.set_xticks(np.arange(len(groups)), named, rotation=40, ha="right")
        left.set(
            ylabel="fraction of paths that are complete",
            ylim=(0, 1.25),
            yticks=np.arange(0, 1.1, 0.2),
        )
        left.legend(ncols=3, loc="upper center", fontsize=7, columnspacing=1, handlelength=1)
        for growth, marker in (("uniaxial", "o"), ("isotropic", "s")):
            for effects, colour in (("none", LINES[0]), ("gravity+ground", LINES[1])):
                part = frame[(frame["growth"] == growth) & (frame["effects"] == effects)]
                part = part.dropna(subset=["condition"])
                for done in (True, False):
                    some = part[part["complete"] == done]
                    label = f"{growth}, {'weight' if effects != 'none' else 'no weight'}"
                    label = label if done and len(some) else None
                    right.plot(
                        some["slenderness"], some["condition"].astype(float), marker, color=colour,
                        ms=4, mfc=colour if done else "none", label=label,
                        ls="none",
                    )  # fmt: skip
        right.set(
            xscale="log",
            yscale="log",
            xlabel=symbol("slenderness"),
            ylabel="condition number of the last state's stiffness",
        )
        right.legend(fontsize=6.5, title="open: path not complete", title_fontsize=6.5)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
