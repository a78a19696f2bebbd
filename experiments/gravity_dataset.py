"""How is the gravity dataset made? Packs the labels of campaigns into one Parquet table.

``--set uniaxial=STORE --set isotropic=STORE`` name the stores of ``gravity_campaign``; without them
a few labels are made on the spot. ``--set out=FILE`` is where the table goes.
"""

from __future__ import annotations

import json
import platform
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.common import OUT, main, save_figure
from experiments.gravity_campaign import SHEETS, picture
from foldlab.campaign.campaign import run_campaign
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource
from foldlab.labels.store import LabelStore
from foldlab.tables import write_table
from foldlab.tracking import commit

# What a table of thousands of labels can do without; the curves alone would be most of it.
DROPPED = ("curves", "stable", "seconds", "source", "threshold", "normalised_angle")
PACKAGES = ("numpy", "scipy", "scikit-fem", "pypardiso", "numba")


@dataclass(frozen=True)
class Config:
    seed: int = 0
    uniaxial: str = ""
    isotropic: str = ""
    commit: str = ""
    out: str = "out/gravity.parquet"


TINY = Config()


def run(config: Config, tracker) -> dict[str, Any]:
    parts = []
    for growth in ("uniaxial", "isotropic"):
        path = Path(getattr(config, growth) or OUT / f"dataset_{growth}.db")
        if not getattr(config, growth):
            OUT.mkdir(exist_ok=True)
            source = SolverSource(Conditions(growth=growth), Effort(accuracy=0.2, timeout=20.0))
            run_campaign(SHEETS.sample(2, seed=config.seed), source, path, progress=False)
        with LabelStore(path, mode="read") as store:
            frame = store.frame("solver")
        parts.append(frame.assign(growth=growth))
    table = pd.concat(parts, ignore_index=True)
    if not table["core_seconds"].notna().any():
        raise InputError("the stores hold no label that says what it cost; label again")
    reached = table["contraction_reached"].where(table["contraction_reached"] > 0)
    table["normalised_angle"] = table["fold_angle"] / reached
    first = [*FULL.names, "growth", "foldable", "outcome", "reason", "fold_angle"]
    rest = [c for c in table.columns if c not in first and c not in DROPPED]
    table = table[[*first, "normalised_angle", *rest]]
    table["reason"] = table["reason"].astype(str).str.slice(0, 200)
    narrow = table.select_dtypes("float64").columns.difference(FULL.names)
    table[narrow] = table[narrow].astype("float32")
    table.attrs["foldlab"] = {
        "command": "python -m experiments.gravity_campaign, then gravity_dataset",
        "commit": config.commit or commit(),
        "labels": len(table),
        "core_seconds": float(table["core_seconds"].sum()),
        "machine": f"{platform.machine()}, 2 shared cores, one BLAS thread per worker",
        "python": platform.python_version(),
        "versions": {name: version(name) for name in PACKAGES},
    }
    path = write_table(table, Path(config.out))
    figure = picture(table)
    save_figure(figure, "gravity_dataset")
    tracker.figure("gravity_dataset", figure)
    known = table["foldable"].notna()
    return {
        "labels": len(table),
        "known": float(known.mean()),
        "folds": int(table["foldable"].fillna(False).sum()),
        "megabytes": path.stat().st_size / 2**20,
        "made": json.dumps(table.attrs["foldlab"]),
        "table": table.groupby(["growth", "outcome"])
        .size()
        .reset_index(name="labels")
        .to_dict("records"),
    }


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
