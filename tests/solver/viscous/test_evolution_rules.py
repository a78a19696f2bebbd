"""Rules of the steps in time: what counts as dissipation, and when a growth outruns a step."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics.growth import Isotropic
from solver.viscous import evolution
from solver.viscous.evolution import Level, Unresolved, warn_unresolved
from solver.viscous.rheology import KelvinVoigt
from solver.viscous.term import Memory, Viscous


@pytest.mark.parametrize("order", [1, 2])
def test_energy_given_in_all_is_no_dissipation_whatever_the_order(order):
    works = [np.array([2.0, 1.0, 0.5])]
    assert evolution._dissipates(works, 3.5, order)
    assert not evolution._dissipates(works, -1e-6, order)
    # Roundoff of the sum.
    assert evolution._dissipates(works, -1e-12, order)


def test_only_backward_euler_is_held_to_every_point():
    works = [np.array([2.0, -0.1])]
    assert not evolution._dissipates(works, 1.9, 1)
    assert evolution._dissipates(works, 1.9, 2)
    assert not evolution._dissipates([np.array([np.nan])], 1.0, 2)


def level(t, strain):
    return Level(t, np.zeros(1), (Memory(np.full((1, 1, 6, 1), strain), np.empty((1, 1, 0))),))


@pytest.mark.parametrize(("order", "before"), [(1, 0.1), (2, 0.1), (2, 0.07), (2, 0.13)])
def test_the_estimate_is_what_the_formula_leaves_out(order, before):
    # The first power of t that the formula does not integrate: from exact values
    # of the past and the rate, one step is off by what is estimated, as a strain ½ C.
    dt, k = 0.1, order + 1
    t = 0.3 + np.array([0.0, -dt, -dt - before, -dt - before - 0.1])[: order + 2]
    C = 5.0 * (t - 0.3) ** k
    if order == 1:
        step = C[1]  # C_n + dt C′, C′ = 0 at the new time
    else:
        a = np.linalg.solve(np.vander(t[:3] - 0.3, increasing=True).T, [0.0, 1.0, 0.0])
        step = -(a[1] * C[1] + a[2] * C[2]) / a[0]
    levels = [level(at, value) for at, value in zip(t, C, strict=True)]
    estimate = evolution._error(levels[0], tuple(levels[1:]), order)
    assert estimate == pytest.approx(abs(step - C[0]) / 2, rel=1e-9)


def term(growth):
    """What the rule asks of a term."""
    points = np.zeros((1, 1, 3))
    body = SimpleNamespace(weights=np.ones((1, 1)), points=points)
    return SimpleNamespace(body=body, shortest_time=lambda e: 1e9, growth=growth, name="tissue")


def test_growth_is_judged_within_the_time_that_is_walked():
    # Grows in 0 ≤ t ≤ 0.1 by 0.004, a step of 0.1 at a time: less than 0.01 is resolved. Beyond the
    # end, where nothing is walked, it would explode.
    def load(t):
        assert t <= 0.1 * (1 + 1e-12), "asked for a load beyond the end"
        return 0.004 * t / 0.1

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_unresolved([term(Isotropic(lambda e: e))], 0.5, lambda t: 0.2 * load(t), 0.0, 0.1)
    with pytest.warns(Unresolved, match="grow by 0.02 in a step; take dt <= 0.25"):
        warn_unresolved([term(Isotropic(lambda e: e))], 0.5, load, 0.0, 0.1)


@pytest.mark.parametrize("chosen", [False, True])
def test_what_is_integrated_over_a_grown_body_is_over_its_grown_volume(chosen):
    body = Body.build(box([0, 1, 3], [0, 1], [0, 1]), "hex8")
    cells = body.cells_where(lambda X: X[:, 0] < 1) if chosen else None
    grown = Isotropic(lambda e: e)
    part = Viscous(body, KelvinVoigt(1.0, 0.3, 1.0), grown, dt=0.1, cells=cells)
    density = np.full(body.weights.shape, 2.0)
    volume = 1.0 if chosen else 3.0
    assert part.integral(density, 0.5) == pytest.approx(2 * volume * 1.5**3)
