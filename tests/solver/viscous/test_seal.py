"""Seals of what has touched: derivatives, a bar that is pulled off, work, and paths in time."""

import numpy as np
import pytest
from proofs import BODIES, prove, state
from pytest import approx

from solver.equilibrium.newton import newton
from solver.equilibrium.reactions import reaction
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics.elastic import Elastic
from solver.physics.ground import Ground
from solver.physics.loads import Traction
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed
from solver.viscous.evolution import State, TimeSteps, evolve, start, stepped
from solver.viscous.rheology import SLS, Spring
from solver.viscous.seal import Seal
from solver.viscous.term import Viscous

E, REACH = 2.0, 0.05


def contact(body, height=0.0):
    return Ground(
        body, body.surface(lambda X: X[:, 2] < 1e-9), thickness=1.0, pressure=0.05 * E,
        depth=REACH, reach=REACH, height=height,
    )  # fmt: skip


def shifted(body, z):
    return np.tile([0.0, 0.0, z], (len(body.nodes), 1))


@pytest.mark.parametrize("element", ["hex27", "hex20", "tet10"])
def test_derivatives_where_some_points_are_sealed_and_pulled_at(element):
    body = BODIES[element]
    ground = contact(body)
    first = Seal(ground, 30.0)
    half = shifted(body, 0.02) + np.array([0, 0, 0.2]) * (body.nodes[:, :1] > 0.6)
    seal = first.with_history(first.after(half))
    assert 0 < seal.sealed.sum() < len(seal.sealed)
    u = shifted(body, 0.03) + 0.1 * state(body)
    assert np.abs(seal.openings(u)[seal.sealed]).min() > 1e-4
    prove(seal, u, 0.0)
    # Nothing pulls at the others.
    lone = first.with_history(np.where(seal.sealed, np.nan, 0.1))
    both = seal.with_history(np.where(seal.sealed, seal.history, 0.1))
    parts = [term.evaluate(u, 0.0, 1).force for term in (seal, lone, both)]
    assert parts[2] == approx(parts[0] + parts[1], abs=1e-12)


def test_sealing_takes_no_work_and_nothing_that_is_sealed_opens():
    body = BODIES["hex27"]
    ground = contact(body)
    open_ = Seal(ground, 30.0)
    up, down, far = (shifted(body, z) for z in (REACH * 1.01, REACH * 0.9, 0.5))
    assert not open_.with_history(open_.after(up)).sealed.any()
    for u in (up, down, far):
        nothing = open_.evaluate(u, 0.0)
        assert nothing.energy == 0 and not nothing.force.any() and not nothing.stiffness.any()
    seal = open_.with_history(open_.after(down))
    assert seal.sealed.all()
    now = seal.evaluate(down, 0.0)
    assert now.energy == 0 and not now.force.any() and now.stiffness.any()
    # Where it is pulled far away, and comes back elsewhere, it remembers where it was sealed.
    again = seal.with_history(seal.after(far))
    again = again.with_history(again.after(shifted(body, 0.0)))
    np.testing.assert_array_equal(again.history, seal.history)
    pull = again.evaluate(far, 0.0, 1)
    area = 1.5
    assert pull.force.sum(axis=0) == approx([0, 0, 30 * area * (0.5 - 0.9 * REACH)])
    assert pull.energy == approx(30 * area * (0.5 - 0.9 * REACH) ** 2 / 2)


def bar():
    return Body.build(box([0, 1], [0, 1], [0, 1, 2]), "hex20")


def held(body, *more):
    sides = [Fixed(np.flatnonzero(np.abs(body.nodes[:, k]) < 1e-9), np.eye(3)[k]) for k in (0, 1)]
    return [*sides, *more]


@pytest.mark.parametrize("k", [5.0, 50.0, 500.0])
def test_a_sealed_bar_opens_by_its_traction_over_the_stiffness(k):
    """ν = 0: a uniform state; σ of the bar, and no contact left where it has opened this far."""
    body = bar()
    ground = contact(body)
    first = Seal(ground, k)
    seal = first.with_history(first.after(shifted(body, 0.9 * REACH)))
    pull = 0.8
    # Contact gives nothing where the points are beyond its reach.
    assert pull / k > 0.1 * REACH or k > 100
    terms = [
        Elastic(body, NeoHookean(E, 0.0)), seal,
        Traction(body, body.surface("z+"), lambda e: [0, 0, e * pull]),
    ]  # fmt: skip
    scene = Scene(body, terms, fixed=held(body))
    result = newton(scene, scene.unknowns(shifted(body, 0.9 * REACH)), 1.0, rtol=1e-10)
    assert result.converged
    u = scene.displacement(result.x, 1.0)
    assert seal.openings(u) == approx(pull / k, rel=1e-8)
    # Neo-Hookean bar with ν = 0: μ (s − 1/s) = σ.
    s = 1 + np.ptp(u[:, 2]) / 2
    assert E / 2 * (s - 1 / s) == approx(pull, rel=1e-8)


def driven(rheology, k, course, dt, until=1.0, state=None):
    """A bar a little above the ground whose top is moved by course(t)."""
    body = bar()
    ground = contact(body, height=-1.5 * REACH)
    top = Fixed(np.flatnonzero(body.nodes[:, 2] > 2 - 1e-9), [0, 0, 1], course)
    terms = [Viscous(body, rheology, dt=dt), ground]
    if k is not None:
        terms.append(Seal(ground, k))
    scene = Scene(body, terms, fixed=held(body, top))
    path = evolve(scene, state or start(scene), TimeSteps(1e-10, dt), until=until)
    assert path.reached
    return scene, path, top


def down_and_up(t):
    return -0.3 * np.sin(np.pi * min(t, 0.5)) + 0.5 * max(t - 0.5, 0) / 0.5


def heights(scene, path):
    seal = next(t for t in scene.terms if t.name == "ground")
    return [seal.gaps(scene.displacement(s.x, s.e)).min() for s in path.states]


def test_what_touched_stays_when_pulled_away_and_without_a_seal_it_leaves():
    found = {}
    for k in (None, 100.0):
        scene, path, _ = driven(Spring(E, 0.0), k, down_and_up, 0.05)
        found[k] = heights(scene, path)
    assert found[None][-1] > 3 * REACH
    # The bar carries E/2 (s − 1/s) over a length of 2: the seal opens by that over k.
    assert found[100.0][-1] < 1.3 * REACH
    # They part only after the first touch.
    touched = np.flatnonzero(np.array(found[None]) < REACH)[0]
    assert found[None][: touched + 1] == approx(found[100.0][: touched + 1], abs=1e-9)
    assert abs(found[None][-1] - found[100.0][-1]) > REACH


def test_the_work_of_the_support_is_the_energy_of_bar_contact_and_seal():
    """Without dashpots nothing is lost, sealing included; the sum over steps is of second order."""
    off = []
    for dt in (0.02, 0.01):
        scene, path, top = driven(Spring(E, 0.0), 20.0, down_and_up, dt)
        work = last = place = 0.0
        for before, after in zip(path.states, path.states[1:], strict=False):
            now = stepped(scene, before, after)
            seal = now.terms[-1]
            np.testing.assert_array_equal(seal.history, before.level.marks[0])
            pull = reaction(now, after.x, after.e, top).force[2]
            work += (pull + last) / 2 * (down_and_up(after.t) - place)
            last, place = pull, down_and_up(after.t)
        u = now.displacement(after.x, after.e)
        energies = {t.name: t.evaluate(u, after.e, 0).energy for t in now.terms}
        assert energies["seal"] > 0.02 * energies["viscous"] > 0
        off.append(abs(work / sum(energies.values()) - 1))
    assert off[1] < 0.01 and off[1] < 0.5 * off[0]


def test_a_path_that_was_saved_keeps_its_seals(tmp_path):
    tree = SLS(E, E, 0.0, E)
    _, path, _ = driven(tree, 100.0, down_and_up, 0.05)
    middle = path.states[12]
    assert not np.isnan(middle.level.marks[0]).any()
    back = State.load(middle.save(tmp_path / "middle.npz"))
    _, rest, _ = driven(tree, 100.0, down_and_up, 0.05, state=back)
    np.testing.assert_array_equal(rest.last.x, path.last.x)
    np.testing.assert_array_equal(rest.last.level.marks[0], path.last.level.marks[0])


def test_a_state_without_seals_belongs_to_another_scene():
    _, path, _ = driven(Spring(E, 0.0), None, down_and_up, 0.1, until=0.2)
    with pytest.raises(ValueError, match=r"0 histories of others, the scene .* 1; it belongs to"):
        driven(Spring(E, 0.0), 100.0, down_and_up, 0.1, state=path.last)


def test_what_makes_no_seal_is_refused():
    ground = contact(BODIES["hex27"])
    with pytest.raises(ValueError, match="the seal's stiffness = 0; expected one finite number"):
        Seal(ground, 0)
    with pytest.raises(ValueError, match="this ground has 25 contact points"):
        Seal(ground, 1.0, np.zeros(3))
    with pytest.raises(ValueError, match="the seal's ground is 'floor'"):
        Seal("floor", 1.0)
