"""How many labels does recursive boundary augmentation (Algorithm 5) save at equal accuracy?"""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass
from typing import Any

from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.augment import Plan, compare_strategies
from foldlab.learning.plots import plot_learning_curves

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    seed: int = 0
    seeds: int = 5
    target: float = 0.99
    test_designs: int = 200_000
    plan: Plan = dataclasses.field(
        default_factory=lambda: Plan(initial=100, per_cycle=50, cycles=22, epochs=100)
    )


TINY = Config(
    seeds=1,
    target=0.9,
    test_designs=1000,
    plan=Plan(initial=60, per_cycle=20, cycles=3, epochs=30, candidates=2000),
)


def run(config: Config, tracker) -> dict[str, Any]:
    curves, summary = compare_strategies(
        TimoshenkoSource(),
        config.plan,
        seeds=range(config.seed, config.seed + config.seeds),
        target=config.target,
        test_designs=config.test_designs,
        progress=lambda text: print(text, file=sys.stderr),
    )
    tracker.table("curves", curves)
    figure = plot_learning_curves(curves, target=config.target, as_error=True)
    save_figure(figure, "boundary_augmentation")
    tracker.figure("boundary_augmentation", figure)
    table = curves.groupby(["strategy", "labels"])["accuracy"].agg(["median", "min", "max"])
    return {**summary, "table": table.reset_index().to_dict("records")}


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
