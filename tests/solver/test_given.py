"""What a stranger may give by mistake is refused by a sentence of ours, never by NumPy's."""

import numpy as np
import pytest
from proofs import block

from solver.equilibrium.newton import newton
from solver.equilibrium.reactions import reaction
from solver.equilibrium.scene import Scales, Scene
from solver.mesh.body import Body
from solver.output import grid
from solver.paths.continuation import load, trace
from solver.paths.noise import Noise
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.ground import Ground, GroundExponential
from solver.physics.growth import AlongFibre, Apical, General, Isotropic, Orthotropic
from solver.physics.loads import Foundation, Gravity, PointLoad, Traction
from solver.physics.materials import Fibre, FibreReinforced, NeoHookean
from solver.physics.patterns import Pattern
from solver.physics.pressure import Pressure
from solver.physics.rubber import MooneyRivlin
from solver.physics.supports import Fixed, Row, rotation_row, translation_row
from solver.viscous.evolution import TimeSteps, evolve, start
from solver.viscous.rheology import Maxwell
from solver.viscous.term import Viscous

BODY = block("hex8")
M, N = len(BODY.cells), len(BODY.nodes)
TOP = BODY.surface(lambda X: X[:, 2] > 0.8 - 1e-9)
SOLID = NeoHookean(1.0, 0.3)
CLOUD = np.random.default_rng(0).normal(size=(9, 3))

RAGGED = [[1], [1, 2]]
NEVER = [
    np.nan,
    np.inf,
    "much",
    [],
    RAGGED,
    np.ones((2, 2)),
    np.full(M, np.nan),
    np.ones(M + 1, bool),
]
PLUS = [*NEVER, None, -1.0]
POSITIVE = [*PLUS, 0.0]


def fibres(direction=(1, 0, 0), k1=1.0, k2=1.0):
    return Elastic(BODY, FibreReinforced(1.0, 0.3, [Fibre(direction, k1, k2, False)]))


def grown(growth):
    return Elastic(BODY, SOLID, growth)


def ground(**given):
    return Ground(BODY, TOP, **({"thickness": 0.1, "pressure": 1.0} | given))


def scene(*more, **given):
    return Scene(BODY, [Elastic(BODY, SOLID), *more], **given)


LOW = BODY.nodes[:, 2] < 1e-9
HELD_BY = [Fixed(LOW, axis) for axis in np.eye(3)]
HELD = scene(fixed=HELD_BY)
REST = np.zeros(HELD.size)


SLOW = Scene(BODY, [Viscous(BODY, Maxwell(1.0, 0.3, 1.0), dt=0.1)], fixed=HELD_BY)


def late(state=None, **given):
    state = start(SLOW) if state is None else state
    return evolve(SLOW, state, TimeSteps(1e-8, 0.1, 0.1), **({"until": 0.1} | given))


WORDS = np.full(N, 1, object)


def arc(**given):
    return ArcLength(1e-8, 0.1, 0.1, **given)


def stable(**given):
    return StableSteps(LoadSteps(1e-8, 0.1), **given)


def walk(**given):
    return trace(HELD, REST, LoadSteps(1e-8, 0.5), **({"max_steps": 9} | given))


# Makes something of one value; one that it takes; what it must refuse.
GIVEN = {
    "E": (lambda v: Elastic(BODY, NeoHookean(v, 0.3)), 1.0, POSITIVE),
    "nu": (lambda v: Elastic(BODY, NeoHookean(1.0, v)), np.full(M, 0.4), [*PLUS, 0.5]),
    "c10": (lambda v: Elastic(BODY, MooneyRivlin(v, 0.1, 0.45)), 1.0, PLUS),
    "fibre direction": (lambda v: fibres(direction=v), (0, 2, 0), [*POSITIVE, (0, 0, 0)]),
    "k1": (lambda v: fibres(k1=v), 1.0, POSITIVE),
    "k2": (lambda v: fibres(k2=v), 0.0, PLUS),
    "fibres": (lambda v: FibreReinforced(1.0, 0.3, v), [Fibre((1, 0, 0), 1.0, 0, True)], POSITIVE),
    "material": (lambda v: Elastic(BODY, v), SOLID, POSITIVE),
    "cells": (lambda v: Elastic(BODY, SOLID, cells=v), np.ones(M, bool), [*NEVER, 1, range(M)]),
    "growth": (grown, Isotropic(0.1), [*NEVER, 0.1]),
    "growth's cells": (
        lambda v: grown(Isotropic(0.1, cells=v)),
        np.ones(M, bool),
        [*NEVER, 1, range(M)],
    ),
    "isotropic": (lambda v: grown(Isotropic(v)), -0.5, PLUS),
    "orthotropic": (lambda v: grown(Orthotropic(v)), (0.1, -0.2, 0), POSITIVE),
    "frame": (lambda v: grown(Orthotropic((0.1, 0, 0), v)), np.eye(3), [*NEVER, 1.0]),
    "along fibre": (lambda v: grown(AlongFibre(v, (1, 0, 0))), 0.1, PLUS),
    "along": (lambda v: grown(AlongFibre(0.1, v)), (1, 0, 0), [*POSITIVE, (0, 0, 0)]),
    "apical": (lambda v: grown(Apical(v, 0.5)), -1.0, [*NEVER, None, 3.0]),
    "beta": (lambda v: grown(Apical(0.5, v)), 0.5, [*PLUS, 1.5]),
    "general": (lambda v: grown(General(v)), 2 * np.eye(3), [*POSITIVE, -np.eye(3)]),
    "density": (lambda v: Gravity(BODY, v, 1.0), 0.0, PLUS),
    "g": (lambda v: Gravity(BODY, 1.0, v), (0, 0, -1), NEVER),
    "traction": (lambda v: Traction(BODY, TOP, v), (0, 0, 1), POSITIVE),
    "traction's surface": (lambda v: Traction(BODY, v, (0, 0, 1)), TOP, POSITIVE),
    "loaded nodes": (
        lambda v: PointLoad(BODY, v, (0, 0, 1)),
        [0, 1],
        [*PLUS, N, np.zeros(N, bool), LOW.astype(int)],
    ),
    "held nodes": (
        lambda v: scene(fixed=[Fixed(v, (1, 0, 0))]),
        LOW,
        [*PLUS, N, np.zeros(N, bool), LOW.astype(int), LOW.astype(np.uint8)],
    ),
    "nodes of a reaction": (
        lambda v: reaction(HELD, REST, 0.0, v),
        LOW,
        [*PLUS, N, LOW.astype(int)],
    ),
    "foundation": (lambda v: Foundation(BODY, TOP, v), 1.0, PLUS),
    "pressure": (lambda v: Pressure(BODY, TOP, v), -1.0, [*NEVER, None]),
    "pressure's surface": (lambda v: Pressure(BODY, v, 1.0), TOP, [*POSITIVE, "top"]),
    "potential": (lambda v: Pressure(BODY, TOP, 1.0, potential=v), None, NEVER),
    "origin": (lambda v: Pressure(BODY, TOP, 1.0, origin=v), (1, 2, 3), POSITIVE),
    "pressure's supports": (
        lambda v: Pressure(BODY, TOP, 1.0, fixed=v),
        [],
        [Fixed([0], (1, 0, 0)), 1],
    ),
    "thickness": (lambda v: ground(thickness=v), 0.1, POSITIVE),
    "resting pressure": (lambda v: ground(pressure=v), 0.1, POSITIVE),
    "depth": (lambda v: ground(depth=v), 0.1, POSITIVE),
    "height": (lambda v: ground(height=v), -1.0, [*NEVER, None]),
    "axis": (lambda v: ground(axis=v), 1, [*PLUS, 3, 1.0, True]),
    "ground's surface": (lambda v: Ground(BODY, v, thickness=1.0, pressure=1.0), TOP, POSITIVE),
    "length": (lambda v: GroundExponential(BODY, length=v, modulus=1.0), 1.0, POSITIVE),
    "pattern's points": (lambda v: Pattern(v, np.arange(9.0)), CLOUD, POSITIVE),
    "pattern's values": (lambda v: Pattern(CLOUD, v), np.arange(9.0), POSITIVE),
    "reach": (lambda v: Pattern(CLOUD, np.arange(9.0), reach=v), None, [*NEVER, -1.0, 0.0]),
    "translation": (lambda v: translation_row(BODY, v), 2, [*PLUS, 3]),
    "rotation": (lambda v: rotation_row(BODY, v), 2, [*PLUS, 3]),
    "rotation's state": (
        lambda v: rotation_row(BODY, 0, v),
        BODY.nodes,
        [*NEVER, 0.0, BODY.nodes + np.nan],
    ),
    "mirrors": (lambda v: rotation_row(BODY, 0, None, v), ("x",), ["z", ("x", 1)]),
    "terms": (lambda v: Scene(BODY, v), [Elastic(BODY, SOLID)], POSITIVE),
    "term": (scene, Gravity(BODY, 1.0, 1.0), POSITIVE),
    "supports": (lambda v: scene(fixed=v), [], [*POSITIVE[:3], Fixed([0], (1, 0, 0)), [Row([1])]]),
    "rows": (lambda v: scene(rows=v), [], [*POSITIVE[:3], Row(np.ones((N, 3))), [Fixed([0], 0)]]),
    "scales": (lambda v: scene(scales=v), Scales(1.0, 1.0, 1.0), [*NEVER, 1.0]),
    "scale": (lambda v: Scales(1.0, v, 1.0), 1.0, POSITIVE),
    "x": (lambda v: HELD.displacement(v, 0.0), REST, [*POSITIVE[3:], REST[1:]]),
    "u": (HELD.unknowns, BODY.nodes, [*POSITIVE[2:], BODY.nodes[1:], BODY.nodes.ravel()]),
    "guess": (lambda v: newton(HELD, v, 0.0, rtol=1e-8), REST, [*POSITIVE[2:], REST[1:]]),
    "step": (lambda v: LoadSteps(1e-8, v), 0.1, [*POSITIVE[2:], np.nan]),
    "rtol": (lambda v: ArcLength(v, a=0.1, b=0.1), 1e-8, [*POSITIVE[2:], np.nan]),
    "load of newton": (lambda v: newton(HELD, REST, v, rtol=1e-8), 0.0, [*NEVER, None]),
    "tolerance": (lambda v: newton(HELD, REST, 0.0, rtol=v), 1e-8, POSITIVE),
    "load of the start": (lambda v: walk(e=v), 0.5, [*NEVER, None]),
    "order": (lambda v: LoadSteps(1e-8, 0.1, order=v), 0, [*PLUS, 1.5, 6]),
    "order of an arc": (lambda v: arc(order=v), 5, [*POSITIVE, 1.5, 6]),
    "forward": (lambda v: arc(forward=v), -1, [*NEVER, None, 1.0]),
    "iterations": (lambda v: LoadSteps(1e-8, 0.1, max_iterations=v), 1, [*POSITIVE, 1.5]),
    "iterations of an arc": (lambda v: arc(max_iterations=v), 1, [*POSITIVE, 1.5]),
    "noise": (lambda v: LoadSteps(1e-8, 0.1, noise=v), Noise(1e-3, 0), [*NEVER, 1.0]),
    "noise of an arc": (lambda v: arc(noise=v), None, [*NEVER, 1.0]),
    "amplitude": (lambda v: Noise(v, 0), 1e-3, POSITIVE),
    "seed": (lambda v: Noise(1e-3, v), 0, [*PLUS, 0.5]),
    "stable steps": (StableSteps, LoadSteps(1e-8, 0.1), [*POSITIVE, arc()]),
    "side": (lambda v: stable(side=v), -1, [*POSITIVE[2:3], None, 0, 2]),
    "reach of a fall": (lambda v: stable(reach=v), 0.1, [*POSITIVE[2:], np.nan]),
    "nudge": (lambda v: stable(nudge=v), 0.1, [*POSITIVE[2:], np.nan]),
    "beyond": (lambda v: stable(beyond=v), 0.1, [*POSITIVE[2:], np.nan]),
    "far": (lambda v: stable(far=v), 0.1, [*POSITIVE[2:], np.nan]),
    "most": (lambda v: stable(most=v), 1, [*POSITIVE, 1.5]),
    "steps of an arc": (lambda v: stable(max_arc_steps=v), 1, [*POSITIVE, 1.5]),
    "cuts": (lambda v: stable(cuts=v), 0, [*PLUS, 1.5]),
    "rheology": (lambda v: Viscous(BODY, v, dt=0.1), Maxwell(1.0, 0.3, 1.0), [*POSITIVE, SOLID]),
    "state": (lambda v: evolve(SLOW, v, TimeSteps(1e-8, 0.1), until=0.01), start(SLOW), POSITIVE),
    "time to reach": (lambda v: late(until=v), 0.1, [*POSITIVE, 0.0]),
    "steps in time": (lambda v: late(max_steps=v), 9, [*POSITIVE, 1.5]),
    "step in time": (lambda v: TimeSteps(1e-8, v), 0.1, [*POSITIVE[2:], np.nan]),
    "strain per step": (lambda v: TimeSteps(1e-8, 1, v), None, [*POSITIVE[2:6], -1.0, 0.0]),
    "iterations in time": (lambda v: TimeSteps(1e-8, 1, max_iterations=v), 1, [*POSITIVE, 1.5]),
    "other terms": (HELD.with_terms, HELD.terms, POSITIVE),
    "field": (lambda v: grid(BODY, point_data={"f": v}), np.ones(N), [*NEVER, WORDS, WORDS * 1j]),
    "target": (lambda v: walk(until=v), load(1.0), [1.0, "e", None, lambda p: None, lambda p: "e"]),
    "load to reach": (load, 1.0, [*NEVER, None]),
    "steps allowed": (lambda v: walk(max_steps=v), 9, [*POSITIVE, 1.5]),
    "bounds": (lambda v: walk(bounds=v), (-1, 2), [*POSITIVE, (1,)]),
    "element": (lambda v: Body.build(BODY.mesh, v), "hex27", [*NEVER, -1.0]),
    "facets": (BODY.surface, [0, 1], [*PLUS, [-1], [10**6], np.ones(4, bool), lambda X: X[:, 0]]),
    "test of nodes": (lambda v: BODY.nodes_where(lambda X: v), np.ones(N, bool), POSITIVE),
    "test of cells": (lambda v: BODY.cells_where(lambda X: v), np.ones(M, bool), POSITIVE),
    "boundary": (BODY.nodes_of, None, POSITIVE),
    "positions": (BODY.interpolation, [[0.5, 0.5, 0.4]], [*POSITIVE, [[np.nan] * 3]]),
}
NUMPYS = "could not|broadcast|inhomogeneous|ambiguous|unhashable|unsupported|has no attribute"


@pytest.mark.parametrize("name", GIVEN)
def test_wrong_values_are_refused_in_our_words(name):
    make, good, bad = GIVEN[name]
    if name != "boundary":
        make(good)
    for value in bad:
        with pytest.raises(ValueError) as refused:
            make(value)
        message = str(refused.value)
        assert not any(words in message for words in NUMPYS.split("|")), (value, message)
        assert len(message) < 300


def test_terms_of_another_body_are_refused():
    other = Body.build(BODY.mesh, "hex27")
    for term in (Elastic(other, SOLID), Gravity(other, 1.0, 1.0)):
        with pytest.raises(ValueError, match=f"acts on a body of {len(other.nodes)} nodes"):
            scene(term)
