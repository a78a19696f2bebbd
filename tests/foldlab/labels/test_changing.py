"""Labels of units whose materials change as the active layer contracts (§4.8.4)."""

import pytest
from test_solver_source import LIGHT

from foldlab.errors import InputError
from foldlab.labels.asked import Changing, Effort
from foldlab.labels.forecast import forecast
from foldlab.labels.solver import SolverSource
from foldlab.labels.sources import make_source
from solver.cases.unit.path import Ending

WEIGHTLESS = {"effects": "none", "accuracy": 0.1}


def test_the_last_materials_decide():
    label = make_source("solver", {"active_stiffness": 2.0, **WEIGHTLESS}).label(LIGHT)
    same = make_source("solver", WEIGHTLESS).label(LIGHT | {"E_ratio": 0.2})
    assert label.evidence["m1"] == pytest.approx(same.evidence["m1"], rel=1e-4)
    plain = make_source("solver", WEIGHTLESS).label(LIGHT)
    assert abs(label.evidence["m1"] - plain.evidence["m1"]) > 0.1
    assert label.version != plain.version and "active_stiffness2" in label.version


def test_all_that_changes_reaches_the_layer_it_belongs_to():
    changing = Changing(2.0, 3.0, 4.0, 5.0, 0.1)
    active, passive = SolverSource(changing=changing)._changes(lambda e: e)
    got = [f(e) for e in (0, 0.5, 1) for f in (active.stiffness, passive.stiffness)]
    assert got == [1, 1, 1.5, 2, 2, 3]
    assert (active.density(1), passive.density(1)) == (4, 5)
    assert (passive.expansion(0.5), active.expansion) == (0.05, None)
    assert SolverSource()._changes(lambda e: e)[0].stiffness is None


def test_a_release_keeps_what_the_contraction_made():
    source = make_source(
        "solver",
        {"question": "exists", "growth": "isotropic", "passive_stiffness": 2.0, **WEIGHTLESS},
    )
    run = source.run(LIGHT | {"contraction": 0.004}, 0)
    assert run.folding.ending is Ending.REACHED
    physics = run.folding.model.physics
    assert physics.growth == "release"
    assert {physics.passive.stiffness(e) for e in (0.0, 0.5, 1.0)} == {2.0}


def test_reasons_and_forecasts_know_the_last_materials():
    changing = Changing(active_stiffness=2, passive_stiffness=4, passive_density=8)
    now = changing.at_end(LIGHT)
    assert now["E_ratio"] == pytest.approx(LIGHT["E_ratio"] / 2)
    assert now["rho_ratio"] == pytest.approx(LIGHT["rho_ratio"] / 8)
    assert now["stiffness_to_weight"] == pytest.approx(LIGHT["stiffness_to_weight"] / 2)
    assert now["contraction"] == LIGHT["contraction"]
    told = forecast(LIGHT, SolverSource(changing=changing))
    assert told.memory_mb == forecast(now, SolverSource()).memory_mb
    # Too heavy at the end, though not at the start: the advice is about what it weighs then.
    heavier = {"passive_density": 1000.0, "active_density": 1000.0, "accuracy": 0.1}
    label = make_source("solver", heavier).label(LIGHT | {"hinge_length": 0.1, "contraction": 0.1})
    assert label.foldable is False and "Γ is 0.001" in label.reason


@pytest.mark.parametrize(
    "settings", [{"active_density": 0.0}, {"passive_expansion": -1.0}, {"passive_stiffness": -2.0}]
)
def test_materials_that_are_none_are_refused(settings):
    (name,) = settings
    with pytest.raises(InputError, match=f"{name} = .*expected a number above"):
        make_source("solver", settings)


def test_an_error_known_for_constant_materials_only_is_not_stated_for_others():
    with pytest.raises(InputError, match="constant materials"):
        SolverSource(effort=Effort(refine="near"), changing=Changing(active_stiffness=2.0))
