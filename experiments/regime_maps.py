"""Where does a unit fold, and where is the prediction wrong? Figs. 4.28 and 4.29 by model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from foldlab.design import REDUCED
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.train import fit, symbolic_options
from foldlab.maps.plots import plot_regimes
from foldlab.maps.regimes import regime_map

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    seed: int = 0
    n_train: int = 6000
    points: int = 100_000
    symbolic_seconds: float = 20.0
    models: tuple[str, ...] = ("tree", "dissertation", "network", "symbolic")


TINY = Config(n_train=300, points=900, symbolic_seconds=1.0, models=("tree",))


def run(config: Config, tracker) -> dict[str, Any]:
    source = TimoshenkoSource()
    train = source.evaluate(REDUCED.sample(config.n_train, seed=config.seed))
    options = symbolic_options(config.symbolic_seconds, config.seed)
    rows = []
    for name in config.models:
        table = train.head(2000) if name == "symbolic" else train
        model = fit(name, REDUCED, table, seed=config.seed, **options.get(name, {}))
        regime = regime_map(model, points=config.points, source=source)
        for kind, validated in (("predicted", False), ("validated", True)):
            figure = plot_regimes(regime, validated=validated)
            save_figure(figure, f"regimes_{name}_{kind}")
            tracker.figure(f"regimes_{name}_{kind}", figure)
        row = {
            "model": name,
            "points": regime.points,
            **regime.counts,
            "accuracy": regime.accuracy,
            "false_positive_rate": regime.false_positive_rate,
            "seconds": regime.seconds,
        }
        tracker.metrics(row, prefix=f"{name}.")
        rows.append(row)
    return {"table": rows}


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
