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
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from foldlab.plots import LINES, STYLE
from solver.cases.tissue import furrow
from solver.cases.tissue.model import Tissue, ramp
from solver.cases.tissue.pattern import POWER, Free, Profile, outside, places
from solver.fitting.creeping import Creep
from solver.fitting.elastic import Equilibria, Unreached
from solver.fitting.files import read_shape
from solver.fitting.fit import Fit, Prior, fit
from solver.fitting.targets import Cloud, Measured, section
from solver.physics.materials import StVenantKirchhoff
from solver.viscous.evolution import TimeSteps, Unresolved

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    """``mesh``, ``finer``: element:level of the fit and of one shape that it sees; ``points`` of a
    cloud; ``noise``: standard deviation of each coordinate over the largest displacement;
    ``strength``, ``angle`` (rad), ``reach`` (half lengths): the true pattern; ``bend``: standard
    deviation of second differences of a free field beforehand; ``around`` (rad), ``along`` (half
    lengths): its knots; ``level`` of the bands; ``steps`` of a viscoelastic furrow in the second in
    which it contracts, ``creeping``: its mesh, ``times`` (s) at which it is seen, ``creeps``: draws
    of it. ``shape``: a CSV or VTU with the outer side of a furrow of your own, whole or in part,
    to be fitted instead of all that; ``sigma``: standard deviation of its coordinates in half
    lengths."""

    seed: int = 0
    mesh: str = "hex20:1"
    finer: str = "hex20:2"
    points: int = 1000
    noise: float = 0.01
    draws: int = 20
    strength: float = 0.8
    angle: float = 0.35
    reach: float = 0.7
    bend: float = 0.3
    around: tuple[float, ...] = (0.0, 0.2, 0.4, 0.8)
    along: tuple[float, ...] = (0.0, 0.4, 0.8)
    level: float = 0.95
    steps: int = 20
    creeping: str = "hex20:0"
    times: tuple[float, ...] = (0.5, 1.0, 1.5)
    creeps: int = 5
    shape: str = ""
    sigma: float = 0.0


TINY = Config(
    mesh="hex20:0", finer="hex8:0", points=100, draws=1, noise=0.02, steps=3, times=(0.5, 1.0),
    creeps=1,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Bench:
    """A model, how its outer side is seen, and the true pattern."""

    config: Config
    model: furrow.Furrow

    @classmethod
    def of(cls, config: Config, mesh: str) -> Bench:
        """Raises InputError for a mesh that isn't there, and for numbers that make no sense."""
        for name in ("points", "draws", "creeps", "steps", "noise", "bend"):
            if not getattr(config, name) > 0:
                raise InputError(f"{name} = {getattr(config, name)}; expected more than 0")
        if not 0 < config.level < 1:
            raise InputError(f"level = {config.level}; expected between 0 and 1, such as 0.95")
        element, _, level = mesh.partition(":")
        if not level.isdigit():
            raise InputError(f"mesh {mesh!r}; expected element:level, such as hex20:1")
        try:
            Free(config.around, config.along)
            return cls(config, furrow.build(int(level), element=element))
        except ValueError as error:
            raise InputError(str(error)) from error

    @property
    def true(self) -> np.ndarray:
        """Parameters of the true profile, (3,)."""
        return np.array([self.config.strength, self.config.angle, self.config.reach])

    @property
    def free(self) -> Free:
        """The free field."""
        return Free(self.config.around, self.config.along)

    def seen(self, field, p, material=None) -> np.ndarray:
        """The displacement (n, 3) of an elastic body of a pattern."""
        material = material or self.model.tissue.slow()
        found = Equilibria(self.model.elastic(material), field).solve(p, [1.0])
        if isinstance(found, Unreached):
            raise InputError(f"the true pattern leads to no state: {found.why}")
        (state,) = found.at
        return state.u

    def cloud(self, u: np.ndarray, sigma: float, rng, of: Bench | None = None) -> Cloud:
        """Noisy points on the outer side of a body (of another mesh) displaced by u, as this model
        would be held against them."""
        shown = (of or self).model.body
        points = outside(shown).scattered(shown.nodes + u, self.config.points, rng)
        points += sigma * rng.standard_normal(points.shape)
        return Cloud(outside(self.model.body), points, sigma, mirrors=(0, 1))

    def places(self) -> np.ndarray:
        """Where β is compared: the nodes of the outer side, (p, 3)."""
        X = self.model.body.nodes
        return X[furrow.Shape().depth(X) > 1 - 1e-6]


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


class Basal(Profile):
    """The same pattern on the inner side of the shell."""

    def values(self, p, X):
        around, along, depth = places(self.shape, X)
        return p[0] * np.exp(-((around / p[1]) ** 2) - (along / p[2]) ** 4) * (1 - depth) ** POWER


class Stripes(Profile):
    """Contraction in two stripes beside the midline."""

    def values(self, p, X):
        around, along, depth = places(self.shape, X)
        form = np.exp(-(((around - 0.4) / 0.2) ** 2) - (along / p[2]) ** 4)
        return p[0] * form * depth**POWER


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


def plot(bench: Bench, bands: dict[str, Fit], draws: list[dict], others: list[dict]):
    """β around the middle with its band, errors of all draws, misfits of all models."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    shape, angles = furrow.Shape(), np.linspace(0, 1.0, 101)
    X = shape.across * np.stack([0 * angles, np.sin(angles), -np.cos(angles)], axis=-1)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.0), layout="constrained")
        axes = figure.subplots(1, 3 if draws else 1, squeeze=False)[0]
        for (name, found), color in zip(bands.items(), LINES, strict=False):
            beta, half = found.band(X, bench.config.level, everywhere=True)
            axes[0].fill_between(angles, beta - half, beta + half, color=color, alpha=0.3, lw=0)
            axes[0].plot(angles, beta, color=color, label=f"fitted, {name}")
            if not draws:
                continue
            off = [100 * row["off"] for row in draws if row["family"] == name]
            rms = [100 * row["rms"] for row in draws if row["family"] == name]
            axes[1].plot(off, "o", ms=3, color=color, label=f"{name}, largest")
            axes[1].plot(rms, "x", ms=4, color=color, label=f"{name}, root mean square")
        axes[0].set(xlabel="angle from the midline, rad", ylabel=r"$\beta$ outside at $x = 0$")
        if not draws:
            axes[0].legend(fontsize=7)
            return figure
        axes[0].plot(angles, Profile().values(bench.true, X), "k--", lw=1, label="true profile")
        axes[1].axhline(5, color="#777777", lw=0.7)
        axes[1].set(xlabel="draw", ylabel=r"error of $\beta$ over its range, %")
        axes[1].set_ylim(bottom=0)
        rows = np.arange(len(others))
        axes[2].barh(rows, [row["misfit"] for row in others], color=LINES[0], height=0.5)
        axes[2].axvline(1, color="#777777", lw=0.7)
        axes[2].set_yticks(rows, [row["shape"] for row in others], fontsize=7)
        axes[2].set(xlabel=r"$\chi^2$ over its freedom", xscale="log")
        axes[2].invert_yaxis()
        for ax in axes[:2]:
            ax.legend(fontsize=7)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
