"""The verbs of studies: ``sample``, ``label``, ``export``, ``experiment``."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from foldlab.campaign.cluster import IN_FLIGHT, dask_executor
from foldlab.cli.outputs import check_file, tell_slow
from foldlab.design import space_named, space_of
from foldlab.errors import InputError
from foldlab.tables import SUFFIXES, read_table, write_table
from foldlab.terminal import Given, Json, NotReached, Seed, Space, Track, emit, note


def sample(
    n: Annotated[int, typer.Option("-n", help="Number of designs.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Table to write (.parquet, .csv).")],
    space: Space = "reduced",
    seed: Seed = 0,
    optimize: Annotated[
        str | None, typer.Option(help="Spread the points: random-cd or lloyd (cost ~ n²).")
    ] = None,
    as_json: Json = False,
) -> None:
    """Draw designs by Latin hypercube, uniform on each group's own scale."""
    if optimize not in (None, "random-cd", "lloyd"):
        raise InputError(f"--optimize {optimize}; expected random-cd or lloyd")
    check_file(out, SUFFIXES)
    designs = space_named(space).sample(n, seed=seed, optimization=optimize)
    write_table(designs, out)
    emit({"designs": len(designs), "space": space, "seed": seed, "file": out}, as_json)


def label(
    *,
    designs: Annotated[Path, typer.Argument(help="Table of designs.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Label store (SQLite file).")],
    source: Annotated[str, typer.Option("--source", help="Label source.")] = "timoshenko",
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Worker processes here (default 1).")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option("--dask", metavar="ADDRESS", help="Label on this Dask scheduler's workers."),
    ] = None,
    retry_unknown: Annotated[
        bool, typer.Option("--retry-unknown", help="Compute labels again that ended unknown.")
    ] = False,
    given: Given,
    track: Track = False,
    as_json: Json = False,
) -> None:
    """Label designs into a store; what the store holds already is not computed again.

    --set passes the source's own settings.
    """
    from foldlab.campaign.campaign import run_campaign
    from foldlab.labels.foldability import THICK_HINGE, thick_hinge
    from foldlab.labels.sources import make_source
    from foldlab.labels.store import LabelStore
    from foldlab.tracking import asked

    if dask is not None and workers is not None:
        raise InputError("--workers are processes here and --dask is a cluster; give one of them")
    table = read_table(designs)
    space = space_of(table)
    settings = given.read()
    maker = make_source(source, settings, space=space)
    table = space.validate(table)
    if source == "solver":
        thick = int(thick_hinge(table).sum())
        if thick:
            note(
                f"warning: {thick} of {len(table)} designs have an active layer thicker than their "
                f"hinge is long: {THICK_HINGE}"
            )
    check_file(out)
    log = asked(track)
    if not hasattr(maker, "label_many"):
        tell_slow()
    with ExitStack() as stack:
        store = stack.enter_context(LabelStore(out))
        options = {"workers": workers or 1}
        if dask is not None:
            executor = stack.enter_context(dask_executor(dask, note))
            options = {"executor": executor, "in_flight": IN_FLIGHT}
            if hasattr(maker, "label_many"):
                note(f"the source {source} is a formula: computed here, not on the cluster")
        report = run_campaign(
            table, maker, store, retry_unknown=retry_unknown, progress=not as_json, **options
        )
        said = {
            "designs": designs,
            "source": source,
            "store": out,
            "workers": workers,
            "dask": dask,
        }
        with log("label", {**said, **settings}) as run, TemporaryDirectory() as folder:
            run.metrics(report.as_dict())
            if track:
                store.export(Path(folder) / "labels.parquet", source=source)
                run.files(Path(folder) / "labels.parquet")
    reasons = [{"unknown because": why, "labels": n} for why, n in report.reasons.items()]
    emit({**report.as_dict(), "store": out}, as_json, reasons)
    if not report.complete:
        raise NotReached(report.outcome)


def export(
    store: Annotated[Path, typer.Argument(help="Label store.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Table to write (.parquet, .csv).")],
    source: Annotated[str | None, typer.Option("--source", help="Only this source.")] = None,
    as_json: Json = False,
) -> None:
    """Write the labels of a store to one flat table."""
    from foldlab.labels.store import LabelStore

    check_file(out, SUFFIXES)
    with LabelStore(store, mode="read") as labels:
        count = labels.export(out, source=source)
    emit({"labels": count, "file": out}, as_json)


def experiment(
    *,
    name: Annotated[
        str | None, typer.Argument(help="Which experiment; without one they are listed.")
    ] = None,
    tiny: Annotated[bool, typer.Option("--tiny", help="A small version, to see it run.")] = False,
    given: Given,
    as_json: Json = False,
) -> None:
    """Run one of the experiments that the documentation's tables come from, or list them.

    Pictures and files go to the folder out, the run to MLflow. --set overrides the experiment's own
    settings.
    """
    from foldlab import packaged

    settings = given.read()
    if name is None:
        if tiny or settings:
            raise InputError("name the experiment to run; without one they are only listed")
        known = [{"experiment": n, "question": q} for n, q in packaged.experiments().items()]
        emit({"experiments": known}, as_json, known)
        return
    module, shared = packaged.experiment(name)
    config = shared.configured(module.Config, settings, module.TINY if tiny else None)
    shared.tell(shared.execute(name, module.run, config), as_json)
