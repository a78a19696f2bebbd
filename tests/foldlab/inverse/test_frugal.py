"""The least mass, cost or size of a unit that does as wished."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from foldlab.errors import InputError
from foldlab.inverse import weighted as weighted_module
from foldlab.inverse.extreme import Price, frugal
from foldlab.inverse.points import groups_of, physical_of
from foldlab.inverse.rungs import SPACE, Rungs, turned
from foldlab.inverse.weighted import drafts, regions_of, weighted
from foldlab.inverse.wish import Angle, Wish
from foldlab.labels.solver import SolverSource

PRICES = """\
name,role,E_low,E_high,rho_low,rho_high,contraction_low,contraction_high,price_low,price_high
foil,passive,2e9,5e9,1350,1400,,,3,5
gel,active,1e6,2e7,1000,1200,0.1,0.5,80,120
free,active,1e6,2e7,1000,1200,0.1,0.5,,
"""
RIGHT = Angle(np.pi / 2, 0.05)


@pytest.fixture
def wish(tmp_path):
    path = tmp_path / "prices.csv"
    path.write_text(PRICES)
    return Wish(
        SPACE, want=RIGHT, fixed={"b_s": 0.01}, ranges={"l_s": (0.02, 0.06)},
        passive=("foil",), active=("gel",), materials=path,
    )  # fmt: skip


def some(wish, n=3):
    return drafts(wish, regions_of(wish), n, seed=0, walkers=512).drafts


def worst(draft, rungs):
    return np.inf


def test_mass_and_cost_are_those_of_the_layers(wish):
    (_, region), *_ = [(None, r) for _, r in regions_of(wish)]
    x = np.array([draft.x for draft in some(wish)])
    p = physical_of(region, groups_of(region, x), x)
    sheet = p["rho_s"] * p["h_s"] * (p["b_s"] * (p["l_s"] - p["l_i"]) + p["b_i"] * p["l_i"])
    active = p["rho_i"] * p["h_i"] * p["b_i"] * p["l_i"]
    pair = ("foil", "gel")

    def price(what):
        return Price(replace(wish, least=what), pair, region)(x)

    np.testing.assert_allclose(price("mass"), sheet + active, rtol=1e-6)
    np.testing.assert_allclose(price("cost"), 4 * sheet + 100 * active, rtol=1e-6)
    np.testing.assert_allclose(price("size"), p["l_s"], rtol=1e-6)


def test_what_a_least_value_depends_on_is_asked_for(wish):
    _, region = regions_of(wish)[0]
    bare = replace(wish, least="cost", active=("free",))
    with pytest.raises(InputError, match=r"active material .free. has no price.*--least mass"):
        Price(bare, ("foil", "free"), region)
    with pytest.raises(InputError, match=r"passive material .none is named. has no price"):
        Price(bare, (None, "gel"), region)
    groups = Wish(SPACE, fixed={"stiffness_to_weight": 3.0}, least="mass")
    with pytest.raises(InputError, match="the least mass also depends on"):
        Price(groups, (None, None), regions_of(groups)[0][1])
    with pytest.raises(InputError, match="least 'price'; expected mass, cost or size"):
        replace(wish, least="price")


@pytest.mark.parametrize("what", ["mass", "cost", "size"])
def test_an_angle_is_kept_while_the_value_falls(wish, what):
    wish = replace(wish, least=what)
    starts = some(wish)
    designs = frugal(starts, wish, worst)
    value = {d.pair: Price(wish, d.pair, d.region) for d in designs}
    values = [float(value[d.pair](d.x[None])[0]) for d in designs]
    assert values == sorted(values)
    before = min(float(value[d.pair](d.x[None])[0]) for d in starts)
    assert values[0] < (0.7 if what != "size" else 1.0) * before
    for design in designs[:3]:
        assert turned(design.groups)[0] == pytest.approx(np.pi / 2, abs=3e-3)
        assert design.region.excess(design.x[None])[0] < 1e-6
    # The way back ends where a design came from.
    assert any(np.allclose(d.x, start.x, atol=0.05) for d in designs for start in starts)


def test_the_cheapest_and_the_lightest_differ(wish):
    def first(what):
        asked = replace(wish, least=what)
        return frugal(some(asked), asked, worst)[0]

    light, cheap = first("mass"), first("cost")
    pair, region = light.pair, light.region
    prices = [
        float(Price(replace(wish, least=what), pair, region)(d.x[None])[0])
        for what in ("mass", "cost") for d in (light, cheap)
    ]  # fmt: skip
    assert prices[0] < prices[1] and prices[3] < prices[2]


def test_a_label_keeps_the_box_of_its_margin(wish):
    asked = replace(wish, want="foldable", margin=0.01, least="mass")
    starts = some(asked)
    rungs = Rungs(asked, rocking=True)
    designs = frugal(starts, asked, lambda d, r: weighted_module._worst(d, r, np.inf))
    assert weighted_module._worst(designs[0], rungs, np.inf) >= 0
    light = Price(asked, designs[0].pair, designs[0].region)
    assert light(designs[0].x[None])[0] < 0.9 * min(light(s.x[None])[0] for s in starts)
    rooms = Rungs(asked, meet=True).rooms(pd.DataFrame([designs[0].groups]))
    assert rooms[0] > 0


def test_the_search_proposes_the_least_first_and_says_so(wish, monkeypatch):
    told = []
    asked = replace(wish, least="mass")
    answer = weighted(
        asked, 2, seed=0, source=SolverSource(), confirmed=False, walkers=512, tell=told.append
    )
    plain = weighted(wish, 2, seed=0, source=SolverSource(), confirmed=False, walkers=512)
    assert any("each given as little mass as it can do with" in text for text in told)
    masses = [p.mass for p in answer.proposals]
    assert masses == sorted(masses) and masses[0] < min(p.mass for p in plain.proposals)
    with pytest.raises(InputError, match="has no price"):
        weighted(replace(asked, least="cost", active=("free",)), 1, seed=0, source=SolverSource())
