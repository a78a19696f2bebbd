"""The main job in one go: sample, label, train, compare, map, fold, design, track; and its page."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from foldlab.campaign.campaign import run_campaign
from foldlab.cli import page, showcase
from foldlab.cli.outputs import only_whole, output_folder
from foldlab.design import REDUCED
from foldlab.errors import InputError
from foldlab.labels.store import LabelStore
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.compare import Comparison, compare, readable
from foldlab.learning.saving import save_model
from foldlab.learning.train import symbolic_options
from foldlab.maps.plots import plot_regimes
from foldlab.maps.regimes import regime_map
from foldlab.plots import save_figure
from foldlab.settings import build
from foldlab.tables import write_table
from foldlab.terminal import Given, Json, Seed, Workers, emit, note
from foldlab.tracking import ROOT, Run, track, tracking_uri

MODELS = ("tree", "forest", "boosted", "dissertation", "network", "symbolic")


@dataclass(frozen=True)
class Settings:
    """Sizes of the quickstart; of labels and maps they are the dissertation's (§4.6.3).

    Under weight: ``unit``: whether one is folded; ``proposals``: designs for a wish; ``verify``:
    designs of the map that the solver checks. 0 leaves them out.
    """

    n_train: int = 6000
    n_test: int = 1000
    n_fresh: int = 200_000
    map_points: int = 100_000
    symbolic_seconds: float = 45.0
    unit: bool = True
    proposals: int = 5
    verify: int = 12
    seed: int = 0
    models: tuple[str, ...] = MODELS

    def __post_init__(self):
        least = dict.fromkeys(("n_train", "n_test", "n_fresh", "map_points"), 1)
        for name, low in (least | {"proposals": 0, "verify": 0}).items():
            if getattr(self, name) < low:
                raise InputError(f"{name} = {getattr(self, name)}; expected at least {low}")
        if self.verify > self.map_points:
            raise InputError(
                f"verify = {self.verify} of map_points = {self.map_points}; expected at most those"
            )
        if not self.models:
            raise InputError(f"models = []; expected some of {', '.join(MODELS)}")


@dataclass
class Clock:
    """Wall-clock seconds of each part, in the order in which they were done."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Counts what is done inside."""
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start


def run(
    settings: Settings, out: Path, say: Callable[[str], None], *, workers: int = 1
) -> dict[str, Any]:
    """Run it into the folder ``out``; ``say`` takes progress lines. Labels there are reused."""
    start = time.perf_counter()
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    showcase.check_designs(out / "designs")
    clock = Clock()
    # While a run is open MLflow says its address in the environment, too.
    local = tracking_uri() if "MLFLOW_TRACKING_URI" not in os.environ else None
    with track("quickstart", asdict(settings), seed=settings.seed) as tracker:
        learned = _learn(settings, out, say, clock, tracker)
        shown = _weigh(settings, out, say, clock, tracker, workers)
        seconds = time.perf_counter() - start
        rest = seconds - sum(clock.seconds.values())
        written = page.write(
            out,
            page.Contents(
                **learned,
                **shown,
                labels=settings.n_train,
                tracking=local,
                seconds=clock.seconds | {"everything else": rest},
            ),
        )
    say(f"tracked  open the pages with: mlflow ui --backend-store-uri {tracking_uri()}")
    say(f"page     {written}")
    designed, mapped = shown["designed"], shown["mapped"]
    return {
        "table": learned["rows"],
        "best": learned["best"],
        "map_accuracy": learned["map_accuracy"],
        "fold_angle": shown["folding"] and shown["folding"].answer["fold_angle"],
        "confirmed": designed and len(designed.answer.proposals),
        "rejected": designed and designed.answer.rejected,
        **mapped.checked,
        "folder": out,
        "page": written,
        "parts": clock.seconds,
        "seconds": seconds,
    }


def _learn(settings: Settings, out: Path, say, clock: Clock, tracker: Run) -> dict[str, Any]:
    """Labels, models and maps without weight; what the page shows of them."""
    seed, source = settings.seed, TimoshenkoSource()
    with clock.part("labels by beam theory"):
        designs = REDUCED.sample(settings.n_train, seed=seed)
        with LabelStore(out / "labels.db") as store:
            report = run_campaign(designs, source, store, progress=False)
        say(f"labels   {report.outcome}")
        train = source.evaluate(designs)
        test = source.evaluate(REDUCED.sample(settings.n_test, seed=seed + 10_000))
        fresh = source.evaluate(REDUCED.sample(settings.n_fresh, seed=seed + 20_000))
    with clock.part("models, trained and scored"):
        say(f"models   {', '.join(settings.models)}")
        options = symbolic_options(settings.symbolic_seconds, seed)
        comparison = compare(
            settings.models, REDUCED, train, test, fresh, seed=seed, options=options
        )
        best = max(comparison.rows, key=lambda row: row["accuracy_fresh"])["model"]
        saved = save_model(comparison.models[best], out / "model", {"model": best}, overwrite=True)
        table = pd.DataFrame(comparison.rows)
        write_table(table, out / "comparison.csv")
        say(f"model    {saved} ({best})")
    with clock.part("maps without weight"):
        regime = regime_map(comparison.models[best], points=settings.map_points, source=source)
        for kind, validated in (("predicted", False), ("validated", True)):
            figure = plot_regimes(regime, validated=validated)
            path = save_figure(figure, out / f"regimes_{kind}.png")
            tracker.figure(f"regimes_{kind}", figure)
            say(f"map      {path}")
    with clock.part("models, logged in MLflow"):
        addresses = _log(comparison, test, tracker)
        tracker.table("comparison", table)
        tracker.metrics({"map_accuracy": regime.accuracy})
    shown = test[REDUCED.names].head(2)
    return {
        "rows": comparison.rows,
        "best": best,
        "addresses": addresses,
        "map_accuracy": regime.accuracy,
        "example": {k: [float(f"{v:.3g}") for v in shown[k]] for k in REDUCED.names},
    }


def _log(comparison: Comparison, test: pd.DataFrame, tracker: Run) -> dict[str, str]:
    """Each model and its scores in MLflow; the models' addresses by name."""
    for row in comparison.rows:
        tracker.metrics(row, prefix=f"{row['model']}.")
    example = test[REDUCED.names].head()
    return {name: tracker.model(name, model, example) for name, model in comparison.models.items()}


def _weigh(
    settings: Settings, out: Path, say, clock: Clock, tracker: Run, workers: int
) -> dict[str, Any]:
    """A unit, designs and a map under weight; what the page shows of them."""
    folding = designed = None
    if settings.unit:
        with clock.part("a unit that folds, with its film"):
            folding = showcase.fold(out / "unit")
            say(f"unit     {folding.label.reason}")
    if settings.proposals:
        with clock.part(f"{settings.proposals} designs with their files"):
            designed = showcase.designs(
                out / "designs", settings.proposals, seed=settings.seed, workers=workers, say=say
            )
            say(f"designs  {designed.answer.reason}")
    with clock.part("map under weight"):
        mapped = showcase.heavy_map(
            settings.map_points, settings.verify, seed=settings.seed, workers=workers
        )
        path = save_figure(mapped.figure, out / "map_under_weight.png")
        tracker.figure("map_under_weight", mapped.figure)
        tracker.metrics(mapped.checked)
        say(f"map      {path}")
    return {"folding": folding, "designed": designed, "mapped": mapped}


def quickstart(
    *,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for labels, maps, models.")] = (
        Path("out/quickstart")
    ),
    workers: Workers = 2,
    seed: Seed = 0,
    given: Given,
    as_json: Json = False,
) -> None:
    """Sample, label, train, compare, map and track; fold, design and map under weight; one page.

    Takes some minutes; --set unit=false, proposals=0 and verify=0 leave the solver out.
    """
    chosen = build(Settings, given.read(), seed=seed)
    local = "MLFLOW_TRACKING_URI" not in os.environ
    with only_whole(ROOT) if local else nullcontext(), output_folder(out):
        result = run(chosen, out, say=note, workers=workers)
    emit(result, as_json, readable(result["table"]))
