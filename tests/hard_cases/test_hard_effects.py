"""Only the effects that a scene calls for: absent ones are never made, asked or paid for.

Calls are counted, not timed. Each counter is first seen to count in a scene that has the effect.
"""

from collections import Counter
from contextlib import contextmanager

import numpy as np
import pytest
from hard_scenes import COARSE, P, reached
from reference_scenes import held

from solver.cases.unit.choices import Meshing, Physics
from solver.cases.unit.model import build
from solver.equilibrium import clock
from solver.equilibrium.linear import Pardiso
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body, NodeGraph
from solver.mesh.structured import box
from solver.paths.continuation import trace
from solver.paths.noise import Noise
from solver.paths.steppers import LoadSteps
from solver.physics import ground, growth, loads, pressure
from solver.physics.elastic import Elastic
from solver.physics.growth import Isotropic
from solver.physics.loads import Traction
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, translation_row

# Everything that belongs to one effect: its constructor, what terms are asked for, its kernels.
PARTS = {
    "gravity": [(loads.Gravity, ("__init__", "weights", "evaluate"))],
    "ground": [
        (ground.Ground, ("__init__", "evaluate", "gaps", "longest_step", "_heights")),
        (ground.GroundExponential, ("__init__", "evaluate", "gaps")),
        (ground, ("barrier", "_exponential")),
    ],
    "pressure": [(pressure.Pressure, ("__init__", "evaluate"))],
    "traction": [(loads.Traction, ("__init__", "loads", "evaluate"))],
    "deadline": [(clock.Deadline, ("__init__", "evaluate"))],
    "noise": [(Noise, ("draw",))],
    "growth": [
        (kind, ("__init__", "tensor"))
        for kind in (growth.Isotropic, growth.Orthotropic, growth.General, growth.AlongFibre)
    ]
    + [(growth.Growth, ("evaluate",)), (growth, ("_dyads",))],
}


def counting(own, effect, calls):
    """A function that does what ``own`` does and is counted."""

    def call(*args, **options):
        calls[effect] += 1
        return own(*args, **options)

    return call


@contextmanager
def counted(monkeypatch, *effects):
    """Counts every call into the parts of the effects, by effect."""
    calls = Counter()
    with monkeypatch.context() as patch:
        for effect in effects:
            for owner, names in PARTS[effect]:
                for name in names:
                    patch.setattr(owner, name, counting(getattr(owner, name), effect, calls))
        yield calls


def test_a_weightless_unit_never_hears_of_weight_or_ground(monkeypatch):
    """From building to folding and judging stability, no constructor, no evaluation, no kernel of
    gravity, ground, pressure, traction, deadline or noise is called; with weight both are."""
    names = ("gravity", "ground", "pressure", "traction", "deadline", "noise")
    with counted(monkeypatch, *names) as calls:
        reached(build(P, Meshing(COARSE), Physics(())))
        assert not calls
        reached(build(P, Meshing(COARSE)))
        assert set(calls) == {"gravity", "ground"} and min(calls.values()) > 20


def test_each_absent_effect_of_a_block_stays_silent(monkeypatch):
    """A block pulled by a traction: growth, weight, ground, pressure and noise are never called;
    each of them is counted once it is added."""
    body = Body.build(box([0, 0.5, 1], [0, 1], [0, 1]), "hex20")
    end = body.surface(lambda X: X[:, 0] > 1 - 1e-9)
    fixed = held(body, 0, 0.0, 0, 1, 2)
    solid = NeoHookean(1.0, 0.3)

    def run(*more, growth=None, noise=None):
        pull = Traction(body, end, lambda e: np.array([0.05 * e, 0, 0]))
        scene = Scene(body, [Elastic(body, solid, growth), pull, *more], fixed=fixed)
        path = trace(scene, np.zeros(scene.size), LoadSteps(1e-9, 0.5, noise=noise), max_steps=20)
        assert path.reached

    with counted(monkeypatch, *PARTS) as calls:
        run()
        assert set(calls) == {"traction"}
        run(growth=growth.Isotropic(lambda e: -0.1 * e))
        assert set(calls) == {"traction", "growth"}
        run(loads.Gravity(body, 1.0, 0.01), noise=Noise(1e-3, 0))
        assert set(calls) == {"traction", "growth", "gravity", "noise"}
        below = body.surface(lambda X: X[:, 2] < 1e-9)
        run(
            ground.Ground(body, below, thickness=1.0, pressure=0.1, height=-0.05),
            pressure.Pressure(body, end, lambda e: 0.01 * e),
            clock.Deadline(1e12),
        )
        assert set(calls) == set(PARTS)


def test_a_weightless_unit_is_the_scene_that_never_heard_of_weight():
    """Unknowns, graph and sparsity pattern equal those of a scene made of the elastic term alone by
    hand, entry by entry; one term, one graph, not a copy of it."""
    model = build(P, Meshing(COARSE), Physics(()))
    body = model.body
    (term,) = model.terms
    alone = Scene(
        body, [Elastic(body, term.material, term.growth)], fixed=_supports(model), rows=()
    )
    scene = model.scene
    assert scene.terms == model.terms and scene.graph is body.graph
    assert (scene.size, scene.n_free, scene.n_rows) == (alone.size, alone.n_free, 0)
    assert np.array_equal(scene.frame.pattern.indptr, alone.frame.pattern.indptr)
    assert np.array_equal(scene.frame.pattern.indices, alone.frame.pattern.indices)
    assert scene._where == [None]
    x = 1e-3 * np.random.default_rng(0).standard_normal(scene.size)
    assert scene.energy(x, 0.5) == alone.energy(x, 0.5)
    assert np.array_equal(scene.residual(x, 0.5), alone.residual(x, 0.5))


def _supports(model):
    """What holds a weightless quarter: two mirror planes and one node along z."""
    body = model.body
    foot = np.array([np.argmin(np.linalg.norm(body.nodes, axis=1))])
    planes = [*held(body, 0, 0.0, 0), *held(body, 1, 0.0, 1)]
    return [*planes, Fixed(foot, [0, 0, 1])]


def test_contact_adds_no_block_to_the_pattern():
    """Gravity has no stiffness, and a ground on nodes has diagonal blocks that are there anyway:
    with both the pattern is the elastic term's, so a heavy iteration factorises no more entries."""
    light, heavy = build(P, Meshing(COARSE), Physics(())), build(P, Meshing(COARSE))
    body = heavy.body
    _, gravity, below = heavy.terms
    assert gravity.graph is None and below.graph.blocks == len(body.nodes)
    assert NodeGraph.union([body.graph, below.graph]).blocks == body.graph.blocks
    assert heavy.scene.graph.blocks == body.graph.blocks
    assert heavy.scene.n_rows == light.scene.n_rows == 0


def test_a_body_that_does_not_grow_keeps_no_growth():
    """Without growth the elastic term holds an empty Fg⁻¹ and an empty Jg, and gives what growth of
    exactly 0 gives, to the last digits."""
    body = Body.build(box([0, 1, 2], [0, 1], [0, 1]), "hex27")
    plain = Elastic(body, NeoHookean(1.0, 0.3))
    grown = Elastic(body, NeoHookean(1.0, 0.3), Isotropic(0.0))
    assert plain.growth is None and all(part.size == 0 for part in plain._at(0.3)[1:])
    u = 0.05 * np.sin(3 * body.nodes[:, ::-1])
    one, two = (t.evaluate(u, 0.3) for t in (plain, grown))
    assert one.energy == pytest.approx(two.energy, rel=1e-12)
    assert np.abs(one.force - two.force).max() < 1e-14


def test_a_scene_without_rows_is_factorised_without_a_border(monkeypatch):
    """No constraint row: no multiplier, no border, no scaling of rows, and PARDISO with the cheap
    pivots; one row changes all of it."""
    body = Body.build(box([0, 1], [0, 1], [0, 1]), "hex27")
    solid, seen = Elastic(body, NeoHookean(1.0, 0.3)), []
    own = Pardiso.__init__

    def noted(self, *args, **options):
        seen.append(options["bordered"])
        own(self, *args, **options)

    monkeypatch.setattr(Pardiso, "__init__", noted)
    held_ = held(body, 2, 0.0, 0, 1, 2)
    free = Scene(body, [solid], fixed=held_)
    free.system(np.zeros(free.size), 0.0).factorise()
    assert free.size == free.n_free and free.frame._row_scale is None
    rowed = Scene(body, [solid], fixed=held(body, 2, 0.0, 0, 2), rows=[translation_row(body, 1)])
    rowed.system(np.zeros(rowed.size), 0.0).factorise()
    assert rowed.size == rowed.n_free + 1 and rowed.frame._row_scale is not None
    assert seen in ([False, True], [])  # [] where PARDISO is not installed


def test_properties_that_stand_still_are_looked_up_once(monkeypatch):
    """Constant E and density are resolved when a term is made and never again, however many states
    are evaluated; ones that move with e are, at each new load."""
    body = Body.build(box([0, 1], [0, 1], [0, 1]), "hex8")
    calls = Counter()
    own = NeoHookean.properties

    def counting(self, *args):
        calls[self] += 1
        return own(self, *args)

    monkeypatch.setattr(NeoHookean, "properties", counting)
    still, moving = NeoHookean(1.0, 0.3), NeoHookean(lambda e: 1 + e, 0.3)
    for material in (still, moving):
        term = Elastic(body, material)
        for e in np.linspace(0, 1, 5):
            for _ in range(3):
                term.evaluate(np.zeros_like(body.nodes), e)
    assert (calls[still], calls[moving]) == (1, 5)
