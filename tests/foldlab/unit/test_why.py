"""What a label will cost, what each effect contributed, and the advice that follows."""

import time

import numpy as np
import pandas as pd
import pytest
from scipy.spatial import cKDTree

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.labels import forecast
from foldlab.labels.asked import EFFECTS, Conditions, Effort
from foldlab.labels.label import Label
from foldlab.labels.solver import SolverSource
from foldlab.labels.sources import make_source
from foldlab.labels.timoshenko import weight_turning
from foldlab.labels.verdict import FLOOR
from foldlab.unit import why
from solver.cases.unit.choices import Meshing, Physics, Watch
from solver.cases.unit.model import build
from solver.cases.unit.path import fold
from solver.cases.unit.unit import Unit
from solver.physics.elastic import Elastic
from solver.physics.loads import Gravity

DESIGN = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.2, "hinge_width": 1.0, "h_ratio": 5.0,
    "stiffness_to_weight": 1.0, "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.3,
}  # fmt: skip


@pytest.fixture(scope="module")
def heavy():
    source, clock = SolverSource(effort=Effort(accuracy=0.05)), {}
    run, label = source.follow(DESIGN, clock)
    return source, run, label, clock


# -- the forecast --------------------------------------------------------------------------------


def test_the_forecast_is_the_median_of_like_labels(monkeypatch):
    monkeypatch.setattr(forecast, "pace", lambda: 1.0)
    source = SolverSource()
    table = load_dataset("gravity-5k")
    known = (table["growth"] == "uniaxial") & table["core_seconds"].notna()
    table = table[known & (table["outcome"] != "timeout")].sample(80, random_state=1)
    ratio = [
        forecast.forecast({k: float(row[k]) for k in FULL.names}, source).seconds
        / (0.55 * row["core_seconds"])  # labels cost less today
        for _, row in table.iterrows()
    ]
    # Each is one of its own neighbours; of sixteen that says little.
    assert np.mean(np.abs(np.log(ratio)) < np.log(2)) > 0.85
    # A quarter of all labels takes less than half of another quarter: it is no constant.
    quarters = table["core_seconds"].quantile([0.1, 0.9])
    assert quarters.iloc[1] / quarters.iloc[0] > 2.5


def test_the_forecast_follows_accuracy_and_machine(monkeypatch):
    monkeypatch.setattr(forecast, "pace", lambda: 1.0)
    base = forecast.forecast(DESIGN, SolverSource())
    fine = forecast.forecast(DESIGN, SolverSource(effort=Effort(accuracy=0.005)))
    assert fine.seconds > 1.5 * base.seconds and fine.memory_mb > base.memory_mb + 50
    monkeypatch.setattr(forecast, "pace", lambda: 2.0)
    slow = forecast.forecast(DESIGN, SolverSource())
    assert slow.seconds == pytest.approx(2 * base.seconds) and slow.memory_mb == base.memory_mb
    assert "for an error of the angle below 2 %" in slow.sentence(0.02)


@pytest.mark.parametrize(
    "accuracy, levels, error, times",
    [
        # Third and fourth mesh have FINER times the unknowns of the second; each has a quarter of
        # the error of the one before.
        (0.02, 2, 0.021, forecast.FINER[2]),
        (0.02, 2, 0.019, 1.0),
        (0.02, 3, 0.0051, forecast.FINER[2]),
        (0.02, 3, 0.0049, 1.0),
        (0.005, 2, 0.021, forecast.FINER[3]),
        (0.005, 2, 0.019, forecast.FINER[2]),
        (0.005, 3, 0.0051, forecast.FINER[3]),
        (0.005, 3, 0.0049, forecast.FINER[2]),
    ],
)
def test_a_mesh_is_foreseen_where_the_one_before_would_not_do(
    accuracy, levels, error, times, monkeypatch
):
    of_like = {"core_seconds": 1.0, "unknowns": 2000.0, "levels": levels, "error_estimate": error}
    table = pd.DataFrame([of_like] * forecast.NEIGHBOURS)
    features = np.zeros((len(table), len(forecast.WEIGHTS)))
    made = table, cKDTree(features), np.ones(len(forecast.WEIGHTS))
    monkeypatch.setattr(forecast, "_labels", lambda growth: made)
    monkeypatch.setattr(forecast, "pace", lambda: 1.0)
    second = 2000.0 / (forecast.FINER[2] if levels == 3 else 1.0)
    least, per_1000 = forecast.MEMORY
    seen = forecast.forecast(DESIGN, SolverSource(effort=Effort(accuracy)))
    assert seen.memory_mb == pytest.approx(least + per_1000 * times * second / 1000)


def test_the_forecast_knows_what_acts_and_what_is_free(monkeypatch):
    monkeypatch.setattr(forecast, "pace", lambda: 1.0)

    def seen(**conditions):
        return forecast.forecast(DESIGN, SolverSource(Conditions(**conditions)))

    base, light = seen(), seen(effects="none")
    both, panels = seen(effects="gravity,ground,contact"), seen(effects="contact")
    free = seen(upright=False)
    assert light.seconds < panels.seconds < base.seconds < both.seconds < free.seconds
    for given in (base, light, both, panels, free):
        assert given.low < given.seconds < given.high
    # A unit that may topple often takes no longer, and sometimes ten times as long.
    assert free.low == base.low and free.high > 5 * base.high
    assert seen(effects="none", upright=False) == light  # nothing topples it
    assert {*forecast.ACTING} == {*EFFECTS}


def test_the_forecast_of_a_weightless_unit_asks_for_no_weight(monkeypatch):
    monkeypatch.setattr(forecast, "pace", lambda: 1.0)
    source = SolverSource(Conditions(effects="none"))
    seen = {
        forecast.forecast({**DESIGN, "stiffness_to_weight": gamma}, source) for gamma in (1.0, 1e4)
    }
    (one,) = seen
    design = {k: v for k, v in DESIGN.items() if k != "stiffness_to_weight"}
    assert forecast.forecast(design, source) == one


def test_no_forecast_where_no_like_labels_are():
    assert forecast.forecast(DESIGN, SolverSource(Conditions(strips=3))) is None
    assert forecast.forecast(DESIGN, SolverSource(seed=1)) is None
    released = SolverSource(Conditions(growth="isotropic"), question="exists")
    assert forecast.forecast(DESIGN, released) is None


# -- accuracy ------------------------------------------------------------------------------------


def test_a_finer_accuracy_takes_finer_meshes():
    coarse, fine = (
        SolverSource(Conditions(effects="none"), Effort(accuracy)).label(DESIGN).evidence
        for accuracy in (0.05, 0.005)
    )
    assert fine["levels"] > coarse["levels"] and fine["unknowns"] > 2 * coarse["unknowns"]
    assert FLOOR[3] <= fine["error_estimate"] < min(0.005, coarse["error_estimate"])
    # Problem P: two independent codes agree on 3.772 within 0.1 %.
    assert abs(fine["m1"] / 3.772 - 1) < fine["error_estimate"] + 1e-3
    assert abs(coarse["m1"] / 3.772 - 1) < coarse["error_estimate"]


def test_meshes_that_agree_by_chance_make_no_small_error_and_no_fine_label():
    # The path's mesh and the next differ by 0.0004 here.
    groups = {
        "E_ratio": 0.009076, "rho_ratio": 0.1082, "hinge_length": 0.3228, "hinge_width": 0.9549,
        "h_ratio": 0.6798, "stiffness_to_weight": 0.2411, "aspect": 0.8363, "slenderness": 0.02049,
        "contraction": 0.1616,
    }  # fmt: skip
    coarse = SolverSource(effort=Effort(accuracy=0.02)).label(groups).evidence
    assert coarse["levels"] == 2 and coarse["error_estimate"] == FLOOR[1]
    fine = SolverSource(effort=Effort(accuracy=0.005)).label(groups).evidence
    assert fine["levels"] > 2 and fine["error_estimate"] >= FLOOR[3]
    assert fine["unknowns"] > 2 * coarse["unknowns"]


# -- contributions -------------------------------------------------------------------------------


def test_fractions_of_effects(heavy):
    _, run, label, clock = heavy
    rows = why.contributions(run, clock, label.evidence["core_seconds"])
    by = {row["effect"]: row for row in rows}
    assert list(by) == ["elastic", "gravity", "ground", "solving"]
    for kind in ("energy", "force", "time"):
        assert sum(row[kind] or 0 for row in rows) == pytest.approx(1)
    # The ground carries the weight, and little else acts on it.
    assert by["ground"]["force"] == pytest.approx(by["gravity"]["force"], rel=1e-3)
    # ρ g h of the lifted panels against the hinge's ½ E κ² I: both by hand.
    assert 1e-4 < by["gravity"]["energy"] < 0.02 < by["elastic"]["energy"]
    assert by["elastic"]["evaluations"] > 50 and by["solving"]["time"] > 0.2


def test_energies_are_against_those_of_the_flat_unit_at_rest(heavy):
    _, run, label, clock = heavy
    rows = why.contributions(run, clock, label.evidence["core_seconds"])
    by = {row["effect"]: row["energy"] for row in rows}
    model, e = run.folding.model, run.folding.last.e
    u = model.scene.displacement(run.folding.x, e)
    # Flat and not contracted it holds no elastic energy: all of it counts, and of the weight's
    # what has been lifted.
    lifted = DESIGN["slenderness"] ** 2 * (model.body.node_volumes() @ u[:, 2])
    stored = model.terms[0].evaluate(u, e, 0).energy
    assert by["gravity"] / by["elastic"] == pytest.approx(lifted / stored, rel=1e-9)


def test_the_watch_counts_and_is_absent_unless_asked_for(monkeypatch):
    calls = []
    evaluate = Elastic.evaluate
    monkeypatch.setattr(Elastic, "evaluate", lambda *a: calls.append(1) or evaluate(*a))
    unit = Unit(**DESIGN)
    clock = {}
    model = build(unit, Meshing(0), Physics(()), watch=Watch(clock=clock))
    fold(model)
    assert clock["elastic"][0] == len(calls) and clock["elastic"][1] > 0
    assert list(clock) == ["elastic"]
    plain = build(unit, Meshing(0))
    assert [type(t) for t in plain.terms[:2]] == [Elastic, Gravity]


def test_ablation_labels_again_without_each_effect():
    source = SolverSource(Conditions(effects="gravity,ground,contact"), Effort(accuracy=0.05))
    label = source.label(DESIGN)
    rows = {row["without"]: row for row in why.ablate(label, source)}
    assert set(rows) == {"gravity,ground", "contact"}
    bare = SolverSource(Conditions(effects="contact"), Effort(accuracy=0.05)).label(DESIGN)
    light = rows["gravity,ground"]
    assert light["fold_angle"] == bare.evidence["m1"]
    assert light["change"] == pytest.approx(bare.evidence["m1"] - label.evidence["m1"])
    # Panels that pass through each other turn by half a radian more.
    assert rows["contact"]["change"] > 0.4
    assert source.conditions.effects == "gravity,ground,contact"


def test_without_an_effect_every_label_is_refined(monkeypatch):
    # The error of the coarsest mesh was measured with weight only.
    asked = []
    made = Label(DESIGN, None, "", {"outcome": "timeout", "seconds": 0.0})
    monkeypatch.setattr(SolverSource, "label", lambda self, design: asked.append(self) or made)
    source = SolverSource(effort=Effort(accuracy=0.1, refine="near"))
    (row,) = why.ablate(made, source)
    assert row["change"] is None
    assert asked == [SolverSource(Conditions(effects="none"), Effort(accuracy=0.1))]


# -- advice --------------------------------------------------------------------------------------


def advice(**options):
    source = make_source("solver", {"accuracy": 0.05, **options})
    design = options.pop("design", DESIGN)
    run, label = source.follow(design)
    return why.advise(label, run, source)


def says(advised, text):
    return any(text in sentence for sentence in advised)


def test_weight_that_changes_nothing_is_called_superfluous(heavy):
    source, run, label, _ = heavy
    assert not says(why.advise(label, run, source), "superfluous")
    light = {**DESIGN, "stiffness_to_weight": 50.0}
    run, label = source.follow(light)
    assert says(why.advise(label, run, source), "gravity is superfluous")
    # The bound that the advice rests on holds here: with and without differ by less.
    bare = SolverSource(Conditions(effects="none"), Effort(accuracy=0.05)).label(light)
    off = abs(bare.evidence["m1"] - label.evidence["m1"])
    assert off < weight_turning(light) / 50.0 + 2 * 0.01 * bare.evidence["m1"]
    # Measured, it is the measurement that counts.
    for change, superfluous in ((1.0, False), (-1.0, False), (-0.01, True)):
        without = [{"without": "gravity,ground", "change": change}]
        assert says(why.advise(label, run, source, without), "superfluous") is superfluous


def test_left_out_weight_contact_and_simpler_models_are_named():
    advised = advice(effects="none")
    assert says(advised, "weight was left out")
    assert says(advised, "the panels passed through each other")
    assert says(advised, "a quarter was enough")
    source = SolverSource(Conditions(effects="contact"), Effort(accuracy=0.05))
    run, label = source.follow({**DESIGN, "contraction": 0.05})
    assert says(why.advise(label, run, source), "contact never acted")
    assert says(why.advise(label, run, source), "Timoshenko's formula gives 0.606")
    assert not says(why.advise(label, run, source), "small strain")  # 0.606² / 6 = 6 %
    run, label = source.follow({**DESIGN, "contraction": 0.03})
    assert says(why.advise(label, run, source), "small strain and small rotations would do")


def test_a_curled_unit_is_told_to_ask_for_a_folded_state(heavy):
    _, run, label, _ = heavy
    source = SolverSource(Conditions(growth="isotropic"), Effort(0.05))
    events = [{"kind": "twisting", "contraction": 0.1}]
    evidence = {**label.evidence, "outcome": "curled", "events": events}
    curled = Label(label.design, False, "curled", evidence, "solver", "1")
    advised = why.advise(curled, run, source)
    assert says(advised, "--question exists") and says(
        advised, "lost at 10 % contraction (twisting)"
    )
    assert says(advised, "--free shows where it lands")


def test_weight_turning_is_the_beam_theory_of_a_light_unit():
    # A stiff sheet, whose deflections are small: the solver's own drop of the angle, at a
    # contraction so small that the panels stay nearly level and touch the ground nowhere else.
    d = {**DESIGN, "contraction": 0.02, "stiffness_to_weight": 20.0}
    angles = [
        SolverSource(Conditions(effects=e), Effort(accuracy=0.05)).label(d).evidence["m1"]
        for e in ("none", "gravity,ground")
    ]
    expected = weight_turning(d) / d["stiffness_to_weight"]
    assert angles[0] - angles[1] == pytest.approx(expected, rel=0.1)


def test_the_pace_is_no_zero_where_the_clock_ticks_coarsely(monkeypatch):
    # Under a CPU limit a short computation took 0 s by the thread's clock.
    real = time.thread_time
    monkeypatch.setattr(time, "thread_time", lambda: real() // 0.01 * 0.01)
    forecast.pace.cache_clear()
    assert forecast.pace() > 0
    forecast.pace.cache_clear()


def test_without_weight_there_is_no_friction_either():
    design = DESIGN | {"stiffness_to_weight": 1.0}
    source = SolverSource(Conditions(friction=0.3), Effort(0.2))
    (row,) = why.ablate(source.label(design), source)
    assert row["without"] == "gravity,ground" and row["fold_angle"] is not None
