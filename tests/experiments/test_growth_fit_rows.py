"""Rows of the experiment on what the shape of a furrow tells of its contraction."""

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from experiments import growth_fit
from experiments.growth_fit import (
    TINY,
    Basal,
    Bench,
    Profile,
    Stripes,
    drawn,
    families,
    other_models,
    over_time,
    pictures,
    summed,
)
from foldlab.errors import InputError
from solver.cases.tissue import furrow
from solver.cases.tissue.furrow import Shape
from solver.output import write_vtu


@pytest.fixture(scope="module")
def bench():
    return Bench.of(TINY, TINY.mesh)


@pytest.fixture(scope="module")
def small():
    """Fewer elements, for tests of many fits."""
    return Bench(TINY, furrow.build(furrow.Counts(3, 3, 4, 1), element="hex20"))


def on_the_midline(depth):
    return Shape().place(np.array([depth]), np.array([[0.0, 0.0, -1.0]]))


def test_the_free_field_is_the_profile_at_its_knots(bench):
    (_, profile, p, none), (_, field, q, prior) = families(bench)
    assert none is None and prior.A.shape[1] == len(q) == 9
    assert field.values(q, on_the_midline(1.0)) == approx(profile.values(p, on_the_midline(1.0)))
    assert q[0] == TINY.strength and q[-1] == approx(
        TINY.strength * np.exp(-((0.4 / TINY.angle) ** 2) - (0.8 / TINY.reach) ** 4)
    )


def test_other_patterns_stand_elsewhere():
    p = np.array([0.8, 0.35, 0.7])
    inner, outer = on_the_midline(0.0), on_the_midline(1.0)
    assert Basal().values(p, inner) == approx(0.8) and Basal().values(p, outer) == approx(0.0)
    assert Profile().values(p, outer) == approx(0.8) and Profile().values(p, inner) == approx(0.0)
    assert Stripes().values(p, outer) < 0.02
    beside = 0.4 * np.array([[0.0, np.sin(0.4), -np.cos(0.4)]])
    assert Stripes().values(p, beside) == approx(0.8)


def test_a_draw_is_judged_by_the_true_pattern(bench):
    rng = np.random.default_rng(0)
    quiet = Bench(replace(TINY, noise=1e-4, draws=1), bench.model)
    (row,), found = drawn(quiet, "profile", Profile(), quiet.true, None, rng)
    assert row["off"] < 1e-3 and row["rms"] < row["off"] and row["explained"]
    assert found.p == approx(quiet.true, rel=1e-3) and row["half"] < 2e-3
    # Of a formula what isn't covered somewhere isn't covered.
    X = quiet.places()
    true = Profile().values(quiet.true, X)
    off = np.abs(found.band(X)[0] - true)
    assert row["off"] == approx(off.max() / np.ptp(true))
    wide = found.band(X, 0.95, everywhere=True)[1]
    assert row["covered"] == bool((off <= wide + 1e-12).all())
    assert Shape().depth(X) == approx(1.0, abs=1e-6) and len(X) > 50


def test_draws_are_summed_by_their_worst():
    rows = [
        {"off": o, "rms": o / 2, "covered": c, "parameters_inside": 1.0, "explained": True,
         "at_bound": 1, "seconds": 2.0}
        for o, c in ((0.1, True), (0.4, False), (0.2, True), (0.3, True))
    ]  # fmt: skip
    row = summed("some", rows)
    assert row["draws"] == 4 and row["off_most"] == 0.4 and row["rms_most"] == 0.2
    assert row["off_median"] == approx(0.25) and row["covered"] == 0.75
    assert growth_fit.headline(row) == {"off": 0.4, "covered": 0.75}


def test_shapes_of_other_patterns_are_not_explained(small):
    rows = {row["shape"]: row for row in other_models(small, np.random.default_rng(0))}
    assert rows["the same"]["explained"] and rows["twice as stiff"]["explained"]
    for name in ("two stripes", "on the inner side", f"mesh {TINY.finer}"):
        assert not rows[name]["explained"] and rows[name]["misfit"] > 1.5
    assert rows["on the inner side"]["off"] > 0.5 > rows["the same"]["off"]


def test_what_pictures_leave_open_is_told(small):
    rows = {row["seen"]: row for row in pictures(small, np.random.default_rng(0))}
    whole, outline, *rest = rows.values()
    assert whole["unfixed"] == 0 and [row["unfixed"] for row in rest] == [1, 1]
    assert outline["weakest"].split(":")[0].split()[1] == "reach"
    assert outline["weakest_sd"] > 3 * whole["weakest_sd"]
    both = rows["outer side, contraction unknown too"]
    assert both["parameters"] == 4 and "not at all" in both["weakest"]
    assert all(row["explained"] for row in rows.values())


def test_over_time_both_fits_see_the_same_clouds():
    config = replace(TINY, noise=0.002, points=200, times=(0.5,), steps=4)
    time, elastic = over_time(config, np.random.default_rng(0))
    assert (time["fit"], elastic["fit"]) == ("over time", "as if elastic")
    # What contracts is still stiff, and the rest isn't.
    assert time["explained"] and time["off"] < 0.05 < elastic["off"]
    assert not elastic["covered"]


def test_a_shape_of_one_s_own_is_fitted(bench, tmp_path, tracker):
    u = bench.seen(Profile(), bench.true)
    write_vtu(tmp_path / "a.vtu", bench.model.body, u)
    config = replace(TINY, shape=str(tmp_path / "a.vtu"), sigma=1e-3)
    result = growth_fit.run(config, tracker)
    # The nodes of the outer side alone, without noise.
    (profile, _), rows = result["table"], result["parameters"]
    assert profile["points"] == len(bench.places()) and profile["misfit"] < 1e-6
    assert profile["explained"] and profile["unfixed"] == ""
    found = {row["parameter"]: row for row in rows if row["family"] == "profile"}
    assert [found[n]["value"] for n in Profile().names] == approx(bench.true, rel=1e-4)
    assert found["angle"]["low"] < TINY.angle < found["angle"]["high"]
    assert len(rows) == 3 + 9 and "growth_fit" in tracker.figures
    assert len(tracker.tables["parameters"]) == len(rows)


@pytest.mark.parametrize(
    ("shape", "sigma", "message"),
    [("none.csv", 0.0, "give the standard deviation"), ("none.csv", 0.1, "there is no file")],
)
def test_a_shape_that_is_no_shape_is_refused(shape, sigma, message, tracker):
    with pytest.raises(InputError, match=message):
        growth_fit.run(replace(TINY, shape=shape, sigma=sigma), tracker)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": 0}, "points = 0; expected more than 0"),
        ({"noise": -0.1}, "noise = -0.1"),
        ({"level": 1.0}, "expected between 0 and 1"),
        ({"around": (0.1, 0.2)}, "knots that increase from 0"),
        ({"strength": 3.0}, "leads to no state: beta would run"),
    ],
)
def test_wrong_settings_are_refused(change, message, bench):
    config = replace(TINY, **change)
    with pytest.raises(InputError, match=message):
        made = Bench.of(config, config.mesh)
        made.seen(Profile(), made.true)
    for mesh in ("hex20", "hex20:9", "cube:0"):
        with pytest.raises(InputError):
            Bench.of(TINY, mesh)
