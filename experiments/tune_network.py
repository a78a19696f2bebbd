"""Which network is worth its seconds? Accuracy against training time, searched by Optuna."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from foldlab.design import REDUCED
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.plots import plot_study
from foldlab.learning.tune import Search, tune

from .common import OUT, main, save_figure


@dataclass(frozen=True)
class Config:
    seed: int = 0
    n_labels: int = 6000
    journal: str = ""  # default: out/tune_network.journal; a study that is there is resumed
    search: Search = dataclasses.field(
        default_factory=lambda: Search(trials=40, workers=2, validation=0.5)
    )


TINY = Config(
    n_labels=200,
    search=Search(trials=3, epochs=(10, 20), width=(4, 6), depth=(1, 1), members=(1, 1)),
)


def run(config: Config, tracker) -> dict[str, Any]:
    OUT.mkdir(exist_ok=True)
    journal = config.journal or OUT / "tune_network.journal"
    labels = TimoshenkoSource().evaluate(REDUCED.sample(config.n_labels, seed=config.seed))
    search = dataclasses.replace(config.search, seed=config.seed)
    study = tune(labels, REDUCED, journal, search)
    tracker.table("trials", study)
    figure = plot_study(study)
    save_figure(figure, "tune_network")
    tracker.figure("tune_network", figure)
    front = study[study["on_front"]].sort_values("seconds")
    return {
        "trials": len(study),
        "pruned": int((study["state"] == "pruned").sum()),
        "best_accuracy": float(study["accuracy"].max()),
        "table": front.drop(columns="on_front").to_dict("records"),
    }


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
