"""The main job in one go: sample, label, train, compare, map, design and track."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from foldlab.campaign.campaign import run_campaign
from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.inverse.confirm import confirm
from foldlab.inverse.propose import propose
from foldlab.inverse.wish import Wish
from foldlab.labels.store import LabelStore
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.compare import compare
from foldlab.learning.saving import save_model
from foldlab.learning.train import symbolic_options
from foldlab.maps.plots import plot_regimes
from foldlab.maps.regimes import regime_map
from foldlab.plots import save_figure
from foldlab.tables import write_table
from foldlab.tracking import track, tracking_uri

MODELS = ("tree", "forest", "boosted", "dissertation", "network", "symbolic")


@dataclass(frozen=True)
class Settings:
    """Sizes of the quickstart; the defaults are the dissertation's (§4.6.3)."""

    n_train: int = 6000
    n_test: int = 1000
    n_fresh: int = 200_000
    map_points: int = 100_000
    symbolic_seconds: float = 45.0
    proposals: int = 5
    seed: int = 0
    models: tuple[str, ...] = MODELS

    def __post_init__(self):
        for name in ("n_train", "n_test", "n_fresh", "map_points", "proposals"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {getattr(self, name)}; expected at least 1")
        if not self.models:
            raise InputError(f"models = []; expected some of {', '.join(MODELS)}")


def run(settings: Settings, out: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Run it into the folder ``out``; ``say`` takes progress lines. Labels there are reused."""
    start = time.perf_counter()
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    seed, source = settings.seed, TimoshenkoSource()
    config = asdict(settings)
    with track("quickstart", config, seed=seed) as tracker:
        designs = REDUCED.sample(settings.n_train, seed=seed)
        with LabelStore(out / "labels.db") as store:
            report = run_campaign(designs, source, store, progress=False)
        say(f"labels   {report.outcome}")
        train = source.evaluate(designs)
        test = source.evaluate(REDUCED.sample(settings.n_test, seed=seed + 10_000))
        fresh = source.evaluate(REDUCED.sample(settings.n_fresh, seed=seed + 20_000))
        say(f"models   {', '.join(settings.models)}")
        options = symbolic_options(settings.symbolic_seconds, seed)
        comparison = compare(
            settings.models, REDUCED, train, test, fresh, seed=seed, options=options
        )
        for row in comparison.rows:
            tracker.metrics(row, prefix=f"{row['model']}.")
        best = max(comparison.rows, key=lambda row: row["accuracy_fresh"])["model"]
        regime = regime_map(comparison.models[best], points=settings.map_points, source=source)
        for kind, validated in (("predicted", False), ("validated", True)):
            figure = plot_regimes(regime, validated=validated)
            path = save_figure(figure, out / f"regimes_{kind}.png")
            tracker.figure(f"regimes_{kind}", figure)
            say(f"map      {path}")
        saved = save_model(comparison.models[best], out / "model", {"model": best}, overwrite=True)
        for name, model in comparison.models.items():
            tracker.model(name, model, test[REDUCED.names].head())
        say(f"model    {saved} ({best})")
        wish = Wish(fixed={"slenderness": 0.01})
        answer = confirm(
            propose(wish, comparison.models[best], settings.proposals, seed=seed), source
        )
        confirmed = answer.confirmed_fraction
        told = answer.reason if confirmed is None else f"{confirmed:.0%} confirmed"
        say(f"designs  {len(answer.proposals)} proposed at slenderness 0.01, {told}")
        import pandas as pd

        table = pd.DataFrame(comparison.rows)
        write_table(table, out / "comparison.csv")
        tracker.table("comparison", table)
        tracker.metrics({"confirmed_fraction": confirmed, "map_accuracy": regime.accuracy})
        seconds = time.perf_counter() - start
    say(f"tracked  open the pages with: mlflow ui --backend-store-uri {tracking_uri()}")
    return {
        "table": comparison.rows,
        "best": best,
        "map_accuracy": regime.accuracy,
        "confirmed_fraction": confirmed,
        "folder": out,
        "seconds": seconds,
    }
