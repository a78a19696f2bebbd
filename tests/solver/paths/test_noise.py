"""Noise on a step's guess: seeded by the point, of size one, and the body's own answer."""

from types import SimpleNamespace

import numpy as np
import pytest

from solver.equilibrium.linear import SingularMatrix
from solver.paths.noise import Noise


class System:
    """A stiffness of 1, 2, … on the free unknowns."""

    def factorise(self):
        return self

    def solve(self, force):
        return force / np.arange(1, len(force) + 1)


class Singular(System):
    def solve(self, force):
        raise SingularMatrix("held by nothing")


def scene(system):
    return SimpleNamespace(size=6, n_free=4, system=lambda x, e: system)


def at(index):
    return SimpleNamespace(index=index, x=np.zeros(6), e=0.5)


def drawn(seed, index):
    return np.random.default_rng([seed, index]).standard_normal(4)


@pytest.mark.parametrize("system", [System(), Singular(), None])
def test_a_field_is_the_answer_to_random_forces_or_the_forces(system):
    given = scene(system)
    same, field = Noise(1e-3, 7).draw(given, at(3))
    wanted = drawn(7, 3) / (np.arange(1, 5) if type(system) is System else 1)
    assert field[:4] == pytest.approx(wanted / np.abs(wanted).max())
    assert np.abs(field).max() == 1.0 and not field[4:].any() and same is given


def test_it_depends_on_the_seed_and_the_number_of_the_point_alone():
    fields = [Noise(1e-3, s).draw(scene(System()), at(k))[1] for s, k in ((1, 0), (1, 1), (2, 0))]
    again = Noise(9.0, 1).draw(scene(System()), at(0))[1]
    np.testing.assert_array_equal(fields[0], again)
    assert not np.allclose(fields[0], fields[1]) and not np.allclose(fields[0], fields[2])


def test_the_scene_of_a_step_may_be_drawn_too():
    other, seen = scene(None), []

    def change(given, rng):
        seen.append((given, rng.standard_normal(4)))
        return other

    given = scene(System())
    used, field = Noise(1e-3, 7, change).draw(given, at(3))
    ((was, numbers),) = seen
    assert used is other and was is given and (numbers == drawn(7, 3)).all()
    rest = np.random.default_rng([7, 3]).standard_normal(8)[4:]
    assert field[:4] == pytest.approx(rest / np.abs(rest).max())


@pytest.mark.parametrize(("amplitude", "seed"), [(0.0, 0), (-1e-3, 0), (1e-3, -1), (1e-3, 0.5)])
def test_noise_has_a_size_and_a_whole_seed(amplitude, seed):
    with pytest.raises(ValueError, match="expected"):
        Noise(amplitude, seed)
    assert Noise(1e-9, 0).seed == 0
