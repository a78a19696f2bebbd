"""Can the contraction of a furrow be read off its shape, how surely, and what does the shape hide?

Points on the outer side of a furrow whose pattern β is known, with noise, in many draws: how far
the fitted pattern is from the true one and how often its band holds that, with three parameters of
a formula and with a free field. Then shapes that other models made, which the fit has to notice,
and what pictures of less than the whole leave open (§6.3.3).
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from solver.cases.tissue import furrow
from solver.cases.tissue.model import Tissue, ramp
from solver.cases.tissue.pattern import Profile, outside, places
from solver.fitting.creeping import Creep
from solver.fitting.elastic import Equilibria, Unreached
from solver.fitting.files import read_shape
from solver.fitting.fit import Fit, Prior, fit
from solver.fitting.targets import Cloud, Measured, section
from solver.physics.materials import StVenantKirchhoff
from solver.viscous.evolution import TimeSteps, Unresolved

from ._growth_fit.bench import Basal, Bench, Config, Stripes
from ._growth_fit.picture import plot
from .common import main, save_figure

TINY = Config(
    mesh="hex20:0", finer="hex8:0", points=100, draws=1, noise=0.02, steps=3, times=(0.5, 1.0),
    creeps=1,
)  # fmt: skip


def run(config: Config, tracker) -> dict[str, Any]:
    bench = Bench.of(config, config.mesh)
    if config.shape:
        return own(bench, tracker)
    rng = np.random.default_rng(config.seed)
    draws, bands = [], {}
    for name, field, p, prior in families(bench):
        rows, bands[name] = drawn(bench, name, field, p, prior, rng)
        draws += rows
    others = other_models(bench, rng)
    hidden = pictures(bench, rng)
    creeps = over_time(config, rng)
    found = {"draws": draws, "models": others, "pictures": hidden, "over_time": creeps}
    for name, rows in found.items():
        tracker.table(name, pd.DataFrame(rows))
    table = [summed(name, [r for r in draws if r["family"] == name]) for name in bands]
    figure = plot(bench, bands, draws, others)
    save_figure(figure, "growth_fit")
    tracker.figure("growth_fit", figure)
    return {"table": table, **found, **headline(table[0])}


def own(bench: Bench, tracker) -> dict[str, Any]:
    """What a shape from a file tells: the fits of both families, and each parameter's interval."""
    config, model = bench.config, bench.model
    if not config.sigma > 0:
        raise InputError(f"sigma = {config.sigma}; give the standard deviation of the points")
    try:
        was, now = read_shape(config.shape)
        # Of a body that is there as a whole its outer side; of points all.
        if (was != now).any():
            now = now[furrow.Shape().depth(was) > 0.99]
        cloud = Cloud(outside(model.body), now, config.sigma, mirrors=(0, 1))
    except ValueError as error:
        raise InputError(str(error)) from error
    table, parameters, bands = [], [], {}
    for name, field, _, prior in families(bench):
        solver = Equilibria(model.elastic(model.tissue.slow()), field)
        found = bands[name] = fit(solver, [(1.0, cloud)], prior=prior)
        if found.states is None:
            raise InputError(f"{found.ending.value}: {found.detail}")
        table.append({
            "family": name, "points": cloud.size, "misfit": found.chi_square / found.freedom,
            "probability": found.probability, "explained": found.explained,
            "unfixed": "; ".join(map(str, found.unfixed)), "ending": found.ending.value,
        })  # fmt: skip
        for key, value, (low, high), held in zip(
            field.names, found.p, found.interval(config.level), found.at_bound, strict=True
        ):
            row = {"family": name, "parameter": key, "value": value, "low": low, "high": high}
            parameters.append({**row, "at_bound": bool(held)})
    tracker.table("parameters", pd.DataFrame(parameters))
    figure = plot(bench, bands, [], [])
    save_figure(figure, "growth_fit")
    tracker.figure("growth_fit", figure)
    return {"table": table, "parameters": parameters}


def families(bench: Bench):
    """Name, field, true parameters and prior of the profile, and of the free field that has its
    values at the knots."""
    yield "profile", Profile(), bench.true, None
    field = bench.free
    a, x = np.meshgrid(field.around[:-1], field.along, indexing="ij")
    p = bench.true[0] * np.exp(-((a / bench.true[1]) ** 2) - (x / bench.true[2]) ** 4)
    yield "free field", field, p.ravel(), Prior.smooth(field.bends(), bench.config.bend)


def drawn(bench: Bench, name: str, field, p, prior, rng) -> tuple[list[dict], Fit]:
    """Fits of as many draws of the noise: rows, and the last fit."""
    config, X = bench.config, bench.places()
    u, true, rows = bench.seen(field, p), field.values(p, X), []
    sigma = config.noise * np.abs(u).max()
    solver = Equilibria(bench.model.elastic(bench.model.tissue.slow()), field)
    for k in range(config.draws):
        clock = time.perf_counter()
        found = fit(solver, [(1.0, bench.cloud(u, sigma, rng))], prior=prior)
        beta, half = found.band(X, config.level)
        wide = found.band(X, config.level, everywhere=True)[1]
        low, high = found.interval(config.level).T
        off = np.abs(beta - true)
        rows.append({
            "family": name, "draw": k, "off": off.max() / np.ptp(true),
            "rms": np.sqrt((off**2).mean()) / np.ptp(true), "half": half.max() / np.ptp(true),
            "covered": bool((off <= wide + 1e-12).all()),
            "parameters_inside": float(((low <= p) & (p <= high)).mean()),
            "places_inside": float((off <= half + 1e-12).mean()),
            "misfit": found.chi_square / found.freedom, "explained": found.explained,
            "at_bound": int(found.at_bound.sum()), "unfixed": len(found.unfixed),
            "evaluations": found.evaluations, "seconds": time.perf_counter() - clock,
            "ending": found.ending.value,
        })  # fmt: skip
        print(rows[-1], file=sys.stderr)
    return rows, found


def summed(name: str, rows: Sequence[dict]) -> dict:
    """A family over its draws: errors in ranges of the true β, shares of draws."""
    table = pd.DataFrame(rows)
    return {
        "family": name,
        "draws": len(table),
        "off_median": table["off"].median(),
        "off_most": table["off"].max(),
        "rms_most": table["rms"].max(),
        "covered": table["covered"].mean(),
        "parameters_inside": table["parameters_inside"].mean(),
        "explained": table["explained"].mean(),
        "at_bound": table["at_bound"].mean(),
        "seconds": table["seconds"].mean(),
    }


def headline(row: dict) -> dict:
    """The figures of the first family by themselves."""
    return {"off": row["off_most"], "covered": row["covered"]}


def other_models(bench: Bench, rng) -> list[dict]:
    """Shapes of other models, fitted with the profile: the noise is that of the first."""
    config, model = bench.config, bench.model
    E, nu = model.tissue.E, model.tissue.nu
    own = bench.seen(Profile(), bench.true)
    sigma = config.noise * np.abs(own).max()
    finer = Bench.of(config, config.finer)
    made = {
        "the same": (bench, own),
        f"mesh {config.finer}": (finer, finer.seen(Profile(), bench.true)),
        "St Venant–Kirchhoff": (bench, bench.seen(Profile(), bench.true, StVenantKirchhoff(E, nu))),
        "twice as stiff": (bench, bench.seen(Profile(), bench.true, model.tissue.fast())),
        "viscoelastic": (bench, ended(bench, None)),
        "viscoelastic, parts unlike": (bench, ended(bench, unlike(bench))),
        "two stripes": (bench, bench.seen(Stripes(), bench.true)),
        "on the inner side": (bench, bench.seen(Basal(), bench.true)),
    }
    solver = Equilibria(model.elastic(model.tissue.slow()), Profile())
    rows, X = [], bench.places()
    true = Profile().values(bench.true, X)
    for name, (of, u) in made.items():
        found = fit(solver, [(1.0, bench.cloud(u, sigma, rng, of))])
        off = np.abs(found.field.values(found.p, X) - true).max() / np.ptp(true)
        rows.append({
            "shape": name, "misfit": found.chi_square / found.freedom,
            "probability": found.probability, "explained": found.explained, "off": off,
            **dict(zip(found.field.names, found.p, strict=True)), "ending": found.ending.value,
        })  # fmt: skip
        print(rows[-1], file=sys.stderr)
    return rows


def creeping(bench: Bench, tissue: Tissue | None = None) -> Creep:
    """The viscoelastic furrow, which contracts for a second."""
    dt, model = 1 / bench.config.steps, bench.model
    model = furrow.Furrow(
        model.body, model.fixed, model.beta, tissue or model.tissue, model.contraction
    )
    return Creep(model.viscous(dt), Profile(), TimeSteps(1e-9, dt), ramp(1.0))


def unlike(bench: Bench) -> Tissue:
    """Tissue that relaxes in a second by the midline, where it contracts, and at once beside it:
    one tissue everywhere looks elastic."""
    around = places(furrow.Shape(), bench.model.body.points())[0]
    return Tissue(E=1.0, E_m=9.0, eta=np.where(around < 0.5, 9.0, 0.09))


def followed(creep: Creep, p: np.ndarray, times: Sequence[float]):
    """Its states. That steps are long is no news: the shape has the same as the fit."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Unresolved)
        found = creep.solve(p, times)
    if isinstance(found, Unreached):
        raise InputError(f"the viscoelastic furrow was not followed to its end: {found.why}")
    return found.at


def ended(bench: Bench, tissue: Tissue | None) -> np.ndarray:
    """The displacement (n, 3) of a viscoelastic furrow when its contraction ends."""
    (state,) = followed(creeping(bench, tissue), bench.true, [1.0])
    return state.u


def over_time(config: Config, rng) -> list[dict]:
    """Fits of a furrow of :func:`unlike` tissue to clouds while it contracts and after, and of an
    elastic one to the first of them."""
    bench, rows = Bench.of(config, config.creeping), []
    creep = creeping(bench, unlike(bench))
    states = followed(creep, bench.true, config.times)
    sigma = config.noise * np.abs(states[-1].u).max()
    X = bench.places()
    true = Profile().values(bench.true, X)
    elastic = Equilibria(bench.model.elastic(bench.model.tissue.slow()), Profile())
    for k in range(config.creeps):
        data = [(s.e, bench.cloud(s.u, sigma, rng)) for s in states]
        # The load that an elastic body sees at the first time.
        first = [(ramp(1.0)(data[0][0]), data[0][1])]
        for name, solver, seen in (("over time", creep, data), ("as if elastic", elastic, first)):
            clock = time.perf_counter()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Unresolved)
                found = fit(solver, seen)
            beta, _ = found.band(X)
            off = np.abs(beta - true)
            rows.append({
                "fit": name, "draw": k, "off": off.max() / np.ptp(true),
                "rms": np.sqrt((off**2).mean()) / np.ptp(true),
                "covered": found.distance(bench.true) <= config.level,
                "misfit": found.chi_square / found.freedom, "explained": found.explained,
                "evaluations": found.evaluations, "seconds": time.perf_counter() - clock,
                "ending": found.ending.value,
            })  # fmt: skip
            print(rows[-1], file=sys.stderr)
    return rows


def pictures(bench: Bench, rng) -> list[dict]:
    """What is left open by less than the outer side, and by one parameter too many."""
    config, model = bench.config, bench.model
    scene = model.elastic(model.tissue.slow())
    solver, both = (Equilibria(scene, Profile(contraction=c)) for c in (False, True))
    u = bench.seen(Profile(), bench.true)
    sigma = config.noise * np.abs(u).max()
    rim = bench.places()[:, 0] < 1e-9
    outline = (model.body.nodes + u)[furrow.Shape().depth(model.body.nodes) > 1 - 1e-6][rim, 1:]
    outline = np.repeat(outline, max(1, config.points // len(outline)), axis=0)
    outline = outline + sigma * rng.standard_normal(outline.shape)

    def indented(u):
        return np.array([model.measure(u).indentation])

    half = Equilibria(scene, Profile()).solve(bench.true, [0.5, 1.0]).at
    lengths = [(s.e, Measured(("indentation",), indented, indented(s.u), sigma)) for s in half]
    side = Cloud(outside(model.body), section(outline, 0), sigma, mirrors=(0, 1))
    rows = []
    for name, forward, data in (
        ("outer side", solver, [(1.0, bench.cloud(u, sigma, rng))]),
        ("outline at x = 0", solver, [(1.0, side)]),
        ("indentation at ½ and 1", solver, lengths),
        ("outer side, contraction unknown too", both, [(1.0, bench.cloud(u, sigma, rng))]),
    ):
        found = fit(forward, data)
        weakest = found.combinations[0]
        rows.append({
            "seen": name, "parameters": len(found.p), "unfixed": len(found.unfixed),
            "weakest": str(weakest), "weakest_sd": min(weakest.sd, 1e9),
            "explained": found.explained, "ending": found.ending.value,
        })  # fmt: skip
        print(rows[-1], file=sys.stderr)
    return rows


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
