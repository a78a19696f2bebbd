"""How far steps go, on functions whose answer is known by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from solver.equilibrium.linesearch import Step, chords, damped, downhill, largest
from solver.equilibrium.outcome import Outcome


def size(dz):
    return float(np.abs(dz).max())


def same(R):
    return R


# -- the natural test ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("after", "fraction"),
    [
        (0.75, 1.0),  # (1 − t/4) times the step, met exactly
        (0.7501, 0.5),
        (2.0, 0.25),  # the parabola's minimum, ½ t²/2
        (50.0, 0.1),  # and not less than a tenth
    ],
)
def test_a_step_is_shortened_by_how_far_its_correction_is_off(after, fraction):
    """The correction after a full step is of ``after`` steps, and that after a shorter one none."""

    def residual(z):
        return np.where(z > 0.99, -after, 0.0)

    step = damped(residual, same, np.zeros(1), np.ones(1), size)
    assert step.fraction == pytest.approx(fraction) and step.z[0] == pytest.approx(fraction)
    assert step.residual[0] == residual(step.z)[0] and step.correction[0] == -step.residual[0]


def test_what_a_barrier_admits_is_the_longest_step():
    step = damped(lambda z: 0 * z, same, np.zeros(1), np.ones(1), size, longest=0.3)
    assert step.fraction == 0.3
    moved = damped(
        lambda z: 0 * z, same, np.zeros(1), np.ones(1), size, moved=lambda z, dz: z + 2 * dz
    )
    assert (moved.fraction, moved.z[0]) == (1.0, 2.0)


def test_a_step_that_leads_nowhere_says_whether_it_was_admissible():
    def search(residual, **options):
        return damped(residual, same, np.zeros(1), np.ones(1), size, **options)

    halves = []
    assert search(lambda z: halves.append(z[0])) is Outcome.INADMISSIBLE
    assert halves == [0.5**k for k in range(len(halves))] and halves[-1] < 1.5e-4
    assert search(lambda z: np.full(1, -9.0)) is Outcome.NO_PROGRESS
    # Of which the first was not.
    there = search(lambda z: None if z[0] > 0.3 else np.zeros(1))
    assert there.fraction == 0.25
    assert search(lambda z: None, trials=1) is Outcome.INADMISSIBLE
    tried = []
    search(lambda z: tried.append(1) or np.full(1, -9.0), trials=2)
    assert len(tried) == 2


# -- downhill --------------------------------------------------------------------------------------


class Hill:
    """A scene of one unknown with an energy, or of one and a multiplier."""

    def __init__(self, energy, slope, rows=0):
        self._energy, self._slope = energy, slope
        self.n_free, self.scales = 1, SimpleNamespace(energy=1.0)

    def moved(self, x, dx, e):
        return x + dx

    def gradient(self, x, e):
        value = self._energy(x[0])
        return None if value is None else (value, np.array([self._slope(x[0])]))

    def down(self, x, dx, longest=1.0):
        energy, slope = self.gradient(np.array([x]), 0.0)
        system = SimpleNamespace(energy=energy, residual=slope)
        return downhill(self, system, np.array([x]), 0.0, np.array([dx]), longest)


PARABOLA = Hill(lambda q: 0.5 * q * q, lambda q: q)


@pytest.mark.parametrize(("dx", "fraction"), [(-1.0, 1.0), (-1.9, 1.0), (-4.0, 0.25), (-40.0, 0.1)])
def test_a_step_goes_to_the_bottom_of_the_parabola_where_it_overshoots(dx, fraction):
    step = PARABOLA.down(1.0, dx)
    if dx == -40.0:  # a tenth is the least of one shortening; then the bottom
        fraction = 1 / 40
    assert step.fraction == pytest.approx(fraction)
    assert step.z[0] == pytest.approx(1.0 + fraction * dx)


def test_what_is_not_downhill_is_no_step():
    assert PARABOLA.down(1.0, 1.0) is None and PARABOLA.down(0.0, 1.0) is None
    assert PARABOLA.down(1.0, -1.0, longest=0.25).fraction == 0.25


def test_an_energy_that_is_not_there_is_halved_into_and_one_that_rises_is_no_progress():
    walled = Hill(lambda q: 0.5 * q * q if q > 0.6 else None, lambda q: q)
    assert walled.down(1.0, -1.0).fraction == 0.25
    nowhere = Hill(lambda q: 0.5 if q == 1.0 else None, lambda q: 1.0)
    assert nowhere.down(1.0, -1.0) is Outcome.INADMISSIBLE
    # A slope that lies: the energy rises along it, far beyond roundoff.
    rising = Hill(lambda q: 1.0 - q, lambda q: 1.0)
    assert rising.down(1.0, -1.0) is Outcome.NO_PROGRESS


@pytest.mark.parametrize(
    ("rise", "slope", "taken"),
    [
        (1e-7, 0.5, True),  # roundoff of the energy, whose slope has flattened
        (1e-7, 0.81, False),  # it has not
        (1e-7, -0.8, True),
        (1e-5, 0.5, False),  # no roundoff
    ],
)
def test_slopes_are_believed_where_the_energy_is_roundoff(rise, slope, taken):
    # From q = 1 to 0 with a slope of 1 at the start; the energy of 1 rises by a little.
    hill = Hill(lambda q: 1.0 if q == 1.0 else 1.0 + rise, lambda q: 1.0 if q == 1.0 else slope)
    step = hill.down(1.0, -1.0)
    assert (isinstance(step, Step) and step.fraction == 1.0) is taken


def test_a_step_that_mends_a_row_may_climb():
    """q = 1 is asked for at q = 0, where the energy q²/2 has its bottom."""

    class Rowed(Hill):
        def gradient(self, x, e):
            q, m = x
            return 0.5 * q * q + m * (q - 1.0), np.array([q + m, q - 1.0])

    scene, x = Rowed(None, None), np.array([0.0, 0.0])
    energy, R = scene.gradient(x, 0.0)
    system = SimpleNamespace(energy=energy, residual=R)
    step = downhill(scene, system, x, 0.0, np.array([1.0, -1.0]), 1.0)
    assert step.fraction == 1.0 and step.z.tolist() == [1.0, -1.0]


# -- corrections with the old factor ---------------------------------------------------------------


def chorded(contraction, *, rtol=1e-12, start=1.0, fraction=1.0, **options):
    """From a step at z = 0 whose corrections contract by a factor each."""
    corrections = [start * contraction**k for k in range(12)]
    ends = np.cumsum([0.0, *corrections])

    def residual(z):
        k = int(np.argmin(np.abs(ends - z[0])))
        return np.array([-corrections[k]])

    step = Step(np.zeros(1), fraction, residual(np.zeros(1)))
    z, last = chords(residual, same, step, size, rtol, **options)
    return z[0], last, ends


@pytest.mark.parametrize(("contraction", "steps"), [(0.25, 4), (0.251, 0), (0.1, 4)])
def test_chords_go_on_while_they_contract_fourfold(contraction, steps):
    z, last, ends = chorded(contraction)
    assert z == pytest.approx(ends[steps]) and last == np.inf


def test_chords_end_where_a_correction_is_within_the_tolerance():
    z, last, ends = chorded(0.125, rtol=0.125**2)
    # The correction that met it is taken too.
    assert z == pytest.approx(ends[3]) and last == pytest.approx(0.125**2)
    z, last, ends = chorded(0.125, rtol=1.0)
    assert (z, last) == (1.0, 1.0)
    assert chorded(0.125, rtol=0.125**4)[1] == np.inf
    assert chorded(0.125, rtol=0.125**4, most=5)[1] == pytest.approx(0.125**4)
    # A shortened step has no chords.
    assert chorded(0.125, rtol=1.0, fraction=0.9)[:2] == (0.0, np.inf)


def test_chords_stop_before_what_is_not_admissible():
    step = Step(np.zeros(1), 1.0, np.array([-1.0]))
    assert chords(lambda z: None, same, step, size, 1e-9) == (np.zeros(1), np.inf)


def test_the_largest_of_nothing_is_0():
    assert largest(np.array([1.0, -3.0])) == 3.0 and largest(np.empty(0)) == 0.0
