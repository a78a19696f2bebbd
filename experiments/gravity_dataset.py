"""The dataset ``gravity``: labels under weight, by the current solver, piece by piece.

Piece k of a growth holds ``size`` designs of sheets (h_s/l_s up to 3e-2): half a Latin hypercube
(a fifth of it for tests, a fifth for validation), half near the boundary, where the planar rod
cannot tell (uniaxial) or a model of the pieces before says neither yes nor no (isotropic). A tenth
of uniaxial designs have strips. Each piece is labelled into one store, so that a run that was
stopped goes on, and written when it is whole: ``--set write=true`` puts it among foldlab's data.
"""

from __future__ import annotations

import platform
import sys
import time
from collections import Counter
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.ensemble import HistGradientBoostingClassifier

from foldlab.campaign.campaign import labelled
from foldlab.datasets import FOLDER
from foldlab.design import FULL, PATTERNED
from foldlab.errors import InputError
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource
from foldlab.labels.store import LabelStore
from foldlab.tables import read_table, write_table
from foldlab.tracking import commit

from .common import OUT, main, save_figure
from .gravity_campaign import SHEETS, picture

SEEDS = 20_000  # where those of pieces begin, away from those of tests and tables
STRIPED = 0.1  # fraction of uniaxial designs that have strips
CANDIDATES = 30  # per design near the boundary
DOUBT = 0.02  # probability of either answer below which a model is sure
STRIPS = ["strips", "strip_share"]
# What a label says twice, or what nobody learns from.
DROPPED = ["curves", "seconds", "source", "threshold", "need", "alternatives"]


@dataclass(frozen=True)
class Config:
    seed: int = 0
    growth: str = "uniaxial"
    first: int = 0
    pieces: int = 1
    size: int = 300
    accuracy: float = 0.02
    timeout: float = 30.0
    workers: int = 1
    store: str = ""
    write: bool = False


TINY = Config(size=4, timeout=20.0, accuracy=0.2)


def run(config: Config, tracker) -> dict[str, Any]:
    if config.growth not in ("uniaxial", "isotropic"):
        raise InputError(f"growth {config.growth!r}; expected 'uniaxial' or 'isotropic'")
    if config.size < 4:
        raise InputError(f"size = {config.size}; expected at least 4 designs in a piece")
    path = Path(config.store) if config.store else OUT / f"gravity_dataset_{config.growth}.db"
    path.parent.mkdir(exist_ok=True)
    pieces = [_piece(config, k, path) for k in range(config.first, config.first + config.pieces)]
    table = pd.concat(pieces)
    tracker.table("labels", table.drop(columns=["history"], errors="ignore"))
    figure = picture(table)
    save_figure(figure, f"gravity_dataset_{config.growth}")
    tracker.figure(f"gravity_dataset_{config.growth}", figure)
    return {"growth": config.growth, "pieces": config.pieces, **summary(table)}


def summary(table: pd.DataFrame) -> dict[str, Any]:
    """Counts of the labels, also by how they were drawn and by part, and what they cost."""
    parts = table.groupby(["drawn", "part"])["foldable"]
    counts = parts.agg(labels="size", known="count", folds="sum").astype(int).reset_index()
    return {
        "labels": len(table),
        "unknown": int(table["foldable"].isna().sum()),
        "folds": int((table["foldable"] == True).sum()),  # noqa: E712
        "outcomes": dict(Counter(table["outcome"])),
        "core_seconds_median": float(table["core_seconds"].median()),
        "core_seconds_mean": float(table["core_seconds"].mean()),
        "table": counts.to_dict("records"),
    }


def _piece(config: Config, k: int, path: Path) -> pd.DataFrame:
    """Drawn, labelled and, if asked for, written."""
    name = f"{config.growth}-{k:03d}"
    drawn = draw(config.growth, config.size, SEEDS + config.seed + k)
    started, frames = time.perf_counter(), []
    with LabelStore(path) as store:
        for space, designs in drawn.groupby("space"):
            space = PATTERNED if space == "patterned" else FULL
            effort = Effort(config.accuracy, config.timeout)
            source = SolverSource(Conditions(growth=config.growth), effort, space=space)
            rows = labelled(designs, source, store, workers=config.workers, progress=False)
            unknown = int(rows["foldable"].isna().sum())
            told = f"{name}: {len(rows)} designs of the {space.name} space, {unknown} unknown"
            print(told, file=sys.stderr, flush=True)
            frames.append(rows)
    table = pd.concat(frames, ignore_index=True).assign(growth=config.growth)
    table = table.drop(columns=["space", *DROPPED], errors="ignore")
    numbers = [c for c in table.select_dtypes("float") if c not in (*FULL.names, *STRIPS)]
    table[numbers] = table[numbers].astype("float32")
    if config.write:
        table.attrs["foldlab"] = {
            "command": "python -m experiments.gravity_dataset "
            f"--set growth={config.growth} --set first={k} --set size={config.size} "
            f"--set timeout={config.timeout:g}",
            "commit": commit(),
            "labels": len(table),
            "core_seconds": float(table["core_seconds"].sum()),
            "wall_seconds": time.perf_counter() - started,
            "machine": f"{platform.machine()}, shared cores, one BLAS thread per worker",
            "python": platform.python_version(),
            "version": table["version"].iloc[0].split("-")[0],
            "versions": {p: version(p) for p in ("numpy", "scipy", "scikit-fem", "numba")},
        }
        (FOLDER / "gravity").mkdir(exist_ok=True)
        write_table(table, FOLDER / "gravity" / f"{name}.parquet")
    return table


def draw(growth: str, size: int, seed: int) -> pd.DataFrame:
    """``size`` designs: groups, strips (0: a solid layer), ``drawn``, ``part`` and ``space``."""
    cube = size // 2
    rows = SHEETS.sample(cube, seed=seed)
    rows["drawn"] = "hypercube"
    rows["part"] = np.resize(["test", "train", "validation", "train", "train"], cube)
    near = near_boundary(growth, size - cube, seed).assign(drawn="boundary", part="train")
    table = pd.concat([rows, near], ignore_index=True)
    table[STRIPS] = 0.0
    table["space"] = "full"
    if growth == "uniaxial":
        rng = np.random.default_rng(seed)
        striped = rng.permutation(len(table)) < STRIPED * len(table)
        pattern = PATTERNED.sample(int(striped.sum()), seed=seed)[STRIPS]
        table.loc[striped, STRIPS] = pattern.to_numpy(float)
        table.loc[striped, "space"] = "patterned"
    return table


def near_boundary(growth: str, n: int, seed: int) -> pd.DataFrame:
    """``n`` designs that a cheaper answer leaves open, from a Latin hypercube of many; where it
    leaves open too few, filled up with others."""
    many = SHEETS.sample(CANDIDATES * n, seed=seed + 500_000)
    doubt = _rod_doubts(many, n) if growth == "uniaxial" else _model_doubts(many, growth)
    order = np.argsort(~doubt, kind="stable")[:n]
    return many.iloc[order].reset_index(drop=True)


def _rod_doubts(many: pd.DataFrame, n: int) -> np.ndarray:
    from foldlab.labels.rod import RodSource

    source, doubt = RodSource(), np.zeros(len(many), bool)
    for row, design in enumerate(many.to_dict("records")):
        doubt[row] = source.label(design).evidence["outcome"] == "unresolved"
        if doubt.sum() == n:
            break
    return doubt


def _model_doubts(many: pd.DataFrame, growth: str) -> np.ndarray:
    files = sorted((FOLDER / "gravity").glob(f"{growth}-*.parquet"))
    if not files:
        return np.ones(len(many), bool)
    known = pd.concat([read_table(f) for f in files])
    known = known[known["foldable"].notna()]
    model = HistGradientBoostingClassifier(random_state=0)
    model.fit(np.log(known[FULL.names]), known["foldable"].astype(bool))
    return np.abs(model.predict_proba(np.log(many[FULL.names]))[:, 1] - 0.5) < 0.5 - DOUBT


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
