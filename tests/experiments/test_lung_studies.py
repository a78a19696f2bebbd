"""What the lung's studies conclude from measures, on a bench whose measures are made up."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments import lung_studies as studies
from experiments.lung_studies import Config
from foldlab.errors import InputError
from solver.cases.lung.model import State, Tissue

CONFIG = Config(pressure=0.1, pressure_drop=0.1, contractions=(0.0, -0.2, -0.4), n=1, tets=0.0)


def made(aspect, depth=0.2, spacing=0.5, highest=0.3, variation=0.1, inverted=0.0, cells=()):
    return SimpleNamespace(
        aspect=aspect, depth=depth, spacing=spacing, lowest=0.1, highest=highest, thinnest=0.7,
        variation=variation, inverted=inverted, cells=cells,
    )  # fmt: skip


def point(e, key=None):
    return SimpleNamespace(e=e, x=key, unstable=0)


class Bench:
    """``measures(tissue, states, e)`` at each point; paths have three, and the limit is at 1.2."""

    def __init__(self, measures, config=CONFIG, limit=1.2):
        self.config, self.measures, self.limit = config, measures, limit
        self.tissue, self.full, self.low = Tissue(), State(config.pressure), 0.09
        self.lung = self.body = SimpleNamespace(
            cells=np.array([[0, 1, 2]]), cells_of=lambda name: np.array([True]),
            nodes=np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]),
        )  # fmt: skip
        self.asked = []

    def stage(self, tissue, *states):
        self.asked.append((tissue, states))
        return self.path((tissue, states), (0.0, 0.5, 1.0))

    def path(self, key, loads, reached=True):
        points = tuple(point(e, key) for e in loads)
        path = SimpleNamespace(
            points=points, last=points[-1], loads=np.array(loads), reached=reached,
            events=[SimpleNamespace(kind=kind) for kind in ("snap", "fold", "bifurcation")],
            outcome=SimpleNamespace(value="reached"),
        )  # fmt: skip
        return SimpleNamespace(displacement=lambda x, e: self.moved(x, e)), path

    def moved(self, key, e):
        return np.zeros((3, 3))

    def at(self, stage, at):
        return self.measures(*at.x, at.e)

    def along(self, stage, path):
        return [self.at(stage, p) for p in path.points]

    def beyond(self, stage, path):
        return self.path(path.last.x, (0.0, 0.5, 1.0, self.limit), np.isfinite(self.limit))[1]


def case_of(bench, monkeypatch, fails=lambda *_: False):
    """Scenes and runs of :mod:`solver.cases.lung` that the bench does not know, in its way."""
    made_of = {}

    def scene(body, lung, tissue, before, state):
        stage, _ = bench.path((tissue, (state,)), (0.0, 1.0))
        made_of[id(stage)] = (tissue, (state,), stage)
        return stage

    def run(stage, *, steps, events, over):
        assert (steps, events, over) == (bench.config.steps, False, None)
        tissue, states, _ = made_of[id(stage)]
        return bench.path((tissue, states), (0.0, 0.8 if fails(states, tissue) else 1.0),
                          not fails(states, tissue))[1]  # fmt: skip

    monkeypatch.setattr(studies, "scene", scene)
    monkeypatch.setattr(studies.case, "run", run)


def test_a_row_is_of_the_end_of_a_path_and_counts_what_happened_on_it():
    bench = Bench(lambda *_: made(0.4))
    _, path = bench.stage(bench.tissue, bench.full)
    row = studies.row_of("so", path, [made(0.1), made(0.4, depth=0.3)], g=-0.2)
    assert row == {
        "case": "so", "g": -0.2, "aspect": 0.4, "depth": 0.3, "spacing": 0.5, "lowest": 0.1,
        "highest": 0.3, "thinnest": 0.7, "variation": 0.1, "inverted": 0.0, "unstable_even": 0,
        "reached": True, "snaps": 2, "outcome": "reached",
    }  # fmt: skip


def test_pressures_beyond_the_limit_have_no_equilibrium(monkeypatch):
    cells = (SimpleNamespace(edges=6, aspect=0.6), SimpleNamespace(edges=5, aspect=0.3))

    def measures(tissue, states, e):
        return made(10 * e * states[0].pressure, cells=cells)

    bench = Bench(measures, limit=1.02)
    case_of(bench, monkeypatch)
    study = studies.pressure(bench)
    low, _, high = study.rows
    assert [row["pressure"] for row in study.rows] == pytest.approx([0.095, 0.1, 0.105])
    assert [row["reached"] for row in study.rows] == [True, True, False]
    assert low["aspect"] == pytest.approx(0.95) and "aspect" not in high
    assert high["limit"] == pytest.approx(0.102) and study.verdict == "differs above"
    assert study.finding == (
        "aspect ratio p -5%: 0.950, p +0%: 1.000. There is no equilibrium at p +5% on this path: "
        "the limit point is at p = 0.1020, 2.0 % above 0.1."
    )
    lines = {line.get_label(): line.get_ydata() for line in study.figure.axes[0].lines}
    assert any(np.allclose(y, 0.3) for y in lines.values() if len(y) == 4)
    assert any(np.allclose(y, 0.6) for y in lines.values() if len(y) == 4)
    free = Bench(bench.measures, limit=np.inf)
    case_of(free, monkeypatch)
    study = studies.pressure(free)
    assert study.verdict == "agrees" and all(row["reached"] for row in study.rows)


def contracted(dry_highest=0.0, dry_aspect=0.1, shrunk=0.4, order=1, wet_highest=0.3):
    def measures(tissue, states, e):
        last = states[-1]
        if last.pressure == 0:
            return made(dry_aspect, depth=0.05, spacing=0.5 if e == 0 else shrunk,
                        highest=dry_highest)  # fmt: skip
        return made(0.3 - order * 0.5 * last.contraction * e, depth=0.2, highest=wet_highest)

    return measures


@pytest.mark.parametrize(
    ("measures", "verdict"),
    [
        (contracted(), "agrees agrees agrees agrees"),
        (contracted(order=-1), "agrees agrees differs differs"),
        (contracted(dry_aspect=0.26), "agrees agrees differs agrees"),
        (contracted(dry_highest=0.03), "agrees differs agrees agrees"),
        (contracted(shrunk=0.6), "differs agrees agrees agrees"),
    ],
)
def test_contraction_is_judged_by_shrinking_and_by_protrusions(measures, verdict):
    bench = Bench(measures)
    study = studies.contraction(bench)
    one, two, three, four = verdict.split()
    three += " at this contraction" if three == "differs" else ""
    assert study.verdict == (
        f"shrinking {one}; nothing moves outwards without pressure: {two}; no protrusion by its "
        f"aspect ratio: {three}; longer with contraction: {four}"
    )
    *wet, dry = study.rows
    assert [row["g"] for row in wet] == [0.0, -0.2, -0.4] and dry["g"] == -0.4
    assert dry["case"] == "g = -0.4, p = 0" and wet[-1]["case"] == "g = -0.4, p = 0.09"
    assert bench.asked[2] == (bench.tissue, (State(0.1), State(0.09, -0.4)))
    assert bench.asked[3] == (bench.tissue, (State(0.0, -0.4),))


def test_contraction_is_told_in_numbers():
    study = studies.contraction(Bench(contracted()))
    assert study.finding == (
        "the aspect ratio is 0.300 inflated, and with a lower pressure and contraction 0.300 at "
        "0 %, 0.400 at 20 %, 0.500 at 40 %. Without pressure the spacing changes by -20 % and the "
        "epithelium moves inwards (by 0.10 to 0.00 R; with it 0.10 to 0.30), yet it bulges "
        "through the shrinking cage as deep as 25 % of that under pressure: aspect ratio 0.100."
    )
    inward = studies.contraction(Bench(contracted(wet_highest=-0.1)))
    assert inward.finding.endswith("Under pressure nothing is farther out than at rest, either.")
    ax = study.figure.axes[0]
    assert any(line.get_xdata() == pytest.approx([0, 0.2, 0.4]) for line in ax.lines)


@pytest.mark.parametrize(("turned", "says"), [(0, "agrees"), (2, "differs")])
def test_fibres_are_compared_by_the_pattern_of_their_displacements(turned, says):
    aspects = {"along": 0.4, "blended": 0.44, "isotropic": 0.6}
    bench = Bench(lambda tissue, states, e: made(aspects[tissue.fibres]))

    def moved(key, e):
        u = np.diag([0.1, 0.2, 0.4])
        return np.diag(np.roll(np.diag(u), turned if key[0].fibres == "isotropic" else 0))

    bench.moved = moved
    study = studies.fibres(bench)
    assert [row["aspect"] for row in study.rows] == [0.4, 0.44, 0.6]
    assert study.verdict == f"{says} on the pattern; the depth depends on it"
    correlation = np.corrcoef([0.1, 0.2, 0.4], np.roll([0.1, 0.2, 0.4], turned))[0, 1]
    assert f"correlate to {correlation:.3f}; the aspect ratio is 0.400" in study.finding
    assert "0.600 (+50 %) isotropic, and 0.440 (+10 %) with blended joints." in study.finding
    assert study.finding.startswith("at |g| = 0.4 ")


def test_soft_muscle_passes_its_limit_before_the_pressure_and_stiff_muscle_has_a_plateau(
    monkeypatch,
):
    aspects = {10.0: 2.0, 25.0: 0.5, 75.0: 0.48, 150.0: 0.46}

    def measures(tissue, states, e):
        return made(aspects[tissue.stiffness] * e * states[0].pressure / 0.1)

    config = replace(CONFIG, stiffnesses=tuple(aspects), low_pressure=0.03)
    bench = Bench(measures, config)
    case_of(bench, monkeypatch, lambda states, t: t.stiffness == 10 and states[0].pressure > 0.05)
    study = studies.stiffness(bench)
    soft, first, *_, last = study.rows
    assert soft["aspect"] is None and first["aspect"] == 0.5 and last["aspect"] == 0.46
    assert soft["limit"] == pytest.approx(0.12) and soft["at_limit"] == pytest.approx(2.4)
    assert last["low"] == pytest.approx(0.3 * 0.46) and soft["case"] == "hex27, 10"
    assert study.verdict == (
        "plateau agrees; below it no threshold of the shape but a limit of the pressure"
    )
    assert study.finding == (
        "p = 0.1 is reached from E_sm/E_ep = 25 on; up to 10 the pressure passes its limit point "
        "before (0.120 to 0.120). Above, the aspect ratio goes from 0.500 at 25 to 0.460 at 150. "
        "At p = 0.03, which all of them carry, it rises smoothly from 0.600 at 10 to 0.138."
    )
    aspects[25.0] = 0.53
    case_of(bench, monkeypatch, lambda *_: False)
    assert studies.stiffness(bench).verdict == "plateau differs"


@pytest.mark.parametrize(("variation", "says"), [(0.13, "agrees"), (0.11, "differs")])
def test_models_are_compared_by_how_their_thickness_varies(variation, says, monkeypatch):
    bench = Bench(None)

    def measure(body, lung, u):
        primitive = u[0, 0] == 1
        return made(0.6 if primitive else 0.4, variation=variation if primitive else 0.1,
                    inverted=0.05 if primitive and u[0, 1] else 0.0)  # fmt: skip

    def moved(key, e):
        u = np.zeros((3, 3))
        u[0] = key[0].model == "primitive", len(key[1]) > 1, 0
        return u

    bench.moved = moved
    monkeypatch.setattr(studies, "measure", measure)
    study = studies.model(bench)
    assert [row["case"] for row in study.rows] == [
        f"{kind}, {name}"
        for kind in ("advanced", "primitive")
        for name in ("inflated", "punctured")
    ]
    assert study.verdict == f"thickness {says}"
    assert study.finding == (
        f"inflated, the primitive model's aspect ratio is 0.60 instead of 0.40, its thickness "
        f"varies by {100 * variation:.0f} % instead of 10 %, and 5.0 % of it is inside out when "
        "punctured."
    )


def test_modes_are_counted_with_the_pressure_and_contraction_of_their_state(monkeypatch):
    bench = Bench(None, replace(CONFIG, stability_every=2))

    class Classes:
        def __init__(self, stage):
            pass

        def count(self, body, u, e):
            lost = int(e > 0.9)
            return {"even": lost, "odd in one": 3 * lost, "odd in two": 0, "odd in three": 0}

    monkeypatch.setattr(studies, "Classes", Classes)
    monkeypatch.setattr(studies, "hexahedra", lambda lung, level, part: part)
    monkeypatch.setattr(studies, "scene", lambda *_: None)
    monkeypatch.setattr(
        studies, "to_limit",
        lambda stage, path, step: bench.path(path.last.x, (1.0, 1.1))[1] if step == 0.01 else None,
    )  # fmt: skip
    study = studies.stability(bench)
    seen = [(r["case"], r["e"], round(r["pressure"], 4), round(r["g"], 4), r["unstable"])
            for r in study.rows]  # fmt: skip
    assert seen == [
        ("inflation", 0.0, 0.0, 0.0, 0), ("inflation", 1.0, 0.1, 0.0, 4),
        ("inflation", 1.0, 0.1, 0.0, 4), ("inflation", 1.1, 0.11, 0.0, 4),
        ("puncture", 0.0, 0.1, 0.0, 0), ("puncture", 1.0, 0.09, -0.4, 4),
        ("puncture", 1.0, 0.09, -0.4, 4),
    ]  # fmt: skip
    assert study.finding == (
        "the icosahedral pattern is stable against every mode of the whole sphere up to p = 0; the "
        "first loss seen is in the inflation at p = 0.1, g = 0, with 4 modes."
    )


def test_studies_need_a_contraction_and_names_that_there_are(tracker):
    with pytest.raises(InputError, match="expected at least one below 0"):
        studies.run(Config(contractions=(0.0,)), tracker)
    with pytest.raises(InputError, match="no study 'shape'; there are: pressure, contraction"):
        studies.run(Config(studies=("shape",)), tracker)


def test_a_bench_has_its_states_at_the_pressure_and_a_drop_below_it():
    bench = studies.Bench(replace(CONFIG, level=0))
    assert bench.full == State(0.1) and bench.low == pytest.approx(0.09)
    assert bench.tissue == Tissue(75.0, 0.3) and bench.steps == 10
