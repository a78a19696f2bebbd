"""Rows of the experiment on a lung whose tissues relax."""

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from experiments import lung_viscous
from experiments.lung_viscous import TINY, Bench, creep_study, rate_study, rest_study, whole
from foldlab.errors import InputError
from solver.cases.lung.mesh import hexahedra


@pytest.fixture(scope="module")
def bench():
    return Bench(TINY)


@pytest.fixture(scope="module")
def body(bench):
    return hexahedra(bench.lung, 0)


def test_the_course_is_told_at_the_end_of_each_stage_and_with_twice_the_steps(bench):
    rows, curves = whole(bench)
    assert [row["steps"] for row in rows] == [10, 20]
    for row in rows:
        mine = curves[curves["steps"] == row["wanted_steps"]].set_index("t")["aspect"]
        for name, t in (("inflated", 1.2), ("rested", 3), ("punctured", 4.2), ("rested_again", 6)):
            assert row[name] == approx(mine.loc[mine.index[np.isclose(mine.index, t)]].iloc[0])
    assert rows[0]["inflated"] == approx(rows[1]["inflated"], rel=0.05)
    assert rows[0]["inflated"] < rows[0]["rested"] < rows[0]["punctured"]
    assert rows[0]["dissipated"] > 0 and rows[0]["internal"] > rows[0]["unknowns"]


def test_rates_go_from_the_fast_limit_to_the_slow_one(bench, body):
    (fast, slow), limits = rate_study(bench, body)
    assert (fast["time"], slow["time"]) == (1e-3, 1e5)
    for name in ("inflated", "punctured"):
        assert fast[name] == approx(limits["fast"][name], rel=5e-3)
        assert slow[name] == approx(limits["slow"][name], rel=5e-3)
    assert limits["fast"]["inflated"] < 0.7 * limits["slow"]["inflated"]


def test_what_stays_on_is_a_fraction_of_the_limit_point(body):
    bench = Bench(replace(TINY, creeps=(0.3, 1.6), until=12.0))
    (holds, gives), curves, limit = creep_study(bench, body)
    assert 0.05 < limit < 0.12
    assert (holds["pressure"], gives["pressure"]) == (approx(0.3 * limit), approx(1.6 * limit))
    assert holds["holds"] and holds["gave_way_at"] is None
    assert holds["aspect"] == approx(holds["slow"], rel=5e-3)
    mine = curves[curves["fraction"] == 0.3]
    assert np.interp(holds["time_to_95"], mine["t"], mine["aspect"]) == approx(
        0.95 * holds["slow"], rel=1e-6
    )
    # Nothing is left that would hold it: it creeps for a while and then gives way.
    assert not gives["holds"] and gives["slow"] is None and 0.1 < gives["gave_way_at"] < 12


def test_a_long_rest_starts_at_the_puncture(bench, body):
    (row,), rest = rest_study(bench, body)
    assert rest["t"].iloc[0] == 0 and rest["t"].iloc[-1] == approx(5.0)
    assert row["punctured"] == rest["aspect"].iloc[0] and row["aspect"] == rest["aspect"].iloc[-1]
    assert row["times"] == (1.2, 1.8, 1.2, 5.0) and row["lowest"] <= row["punctured"]


def test_tables_and_figure(tracker, monkeypatch):
    result = lung_viscous.run(replace(TINY, rates=(1.0,), until=1.0), tracker)
    assert set(tracker.tables) == {"course", "rates", "tissues", "creeps", "rest", "curves"}
    assert result["table"] == result["course"]
    assert [row["relaxes"] for row in result["tissues"]] == ["both", "epithelium", "muscle"]
    assert result["cpu_seconds_of_100_steps"] == approx(
        100 * result["table"][0]["cpu_seconds"] / 10
    )
    left, middle, right = tracker.figures["lung_viscous"].axes
    drawn = {line.get_label(): line.get_ydata() for line in middle.lines}
    assert drawn["punctured"].tolist() == [result["rates"][0]["punctured"]]
    assert left.lines[0].get_ydata()[-1] == result["table"][0]["rested_again"]
    assert {line.get_label() for line in right.lines} == {"0.9 $p_{lim}$", "after puncture"}


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"times": (1.0, 1.0)}, "expected four times above 0"),
        ({"times": (1.0, 1.0, 0.0, 1.0)}, "expected four times above 0"),
        ({"rates": (0.0,)}, "expected numbers above 0"),
        ({"steps": 2}, "expected at least 4"),
        ({"branch": 0.0}, "one above, or take the elastic lung"),
        ({"level": 9}, "no level 9"),
        ({"contraction": -1.5}, "a contraction above -1"),
    ],
)
def test_wrong_settings_are_refused(wrong, says, tracker):
    with pytest.raises(InputError, match=says):
        lung_viscous.run(replace(TINY, **wrong), tracker)
