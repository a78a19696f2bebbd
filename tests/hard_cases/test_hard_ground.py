"""Weight and ground at their ends: crushing, landing again and again, slopes, tipping over."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hard_scenes import COARSE, P, block, fold_angle, lift, reached, weight_of
from reference_scenes import AXES, held, near
from reference_structures import heavy_strip
from scipy.integrate import quad
from scipy.optimize import brentq

from solver.cases.unit.audit import audit
from solver.cases.unit.choices import Meshing, Physics, Supports, Watch
from solver.cases.unit.model import build
from solver.cases.unit.path import Ending, fold
from solver.equilibrium.clock import core_seconds
from solver.equilibrium.descent import descend
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.paths.continuation import load, trace
from solver.paths.stable import StableSteps
from solver.paths.steppers import LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.ground import Ground
from solver.physics.growth import General
from solver.physics.loads import Gravity
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed


def settled(scene, *, until=1.0, step=0.1, start=None, **options):
    """Points of the stable path to a load, which must be reached."""
    stepper = StableSteps(LoadSteps(rtol=1e-8, step=step, cut=4.0), **options, locate=False)
    start = np.zeros(scene.size) if start is None else start
    path = trace(scene, start, stepper, until=load(until), max_steps=300, events=False)
    assert path.reached, path.outcome.value
    assert {p.unstable for p in path.points} == {0}
    return path


# -- weight --------------------------------------------------------------------------------------


@pytest.mark.parametrize("load_", [0.1, 1.0, 10.0])
def test_a_column_is_crushed_by_its_own_weight(load_):
    """ρ g H / E up to 10: a confined column is squeezed to the height of the exact 1-D solution."""
    nu, n = 0.3, 12
    lam, mu = nu / ((1 + nu) * (1 - 2 * nu)), 1 / (2 * (1 + nu))
    body = Body.build(box([0, 0.1], [0, 0.1], np.linspace(0, 1, n + 1)), "hex27")
    walls = [*held(body, 0, 0.0, 0), *held(body, 0, 0.1, 0), *held(body, 1, 0.0, 1)]
    walls += [*held(body, 1, 0.1, 1), *held(body, 2, 0.0, 2)]
    terms = [Elastic(body, NeoHookean(1.0, nu)), Gravity(body, 1.0, lambda e: e * load_)]
    scene = Scene(body, terms, fixed=walls)
    path = trace(scene, np.zeros(scene.size), LoadSteps(rtol=1e-9, step=0.1), max_steps=99)
    assert path.reached

    def stretch(depth):
        # P(s) = μ (s − 1/s) + λ ln s / s carries what lies above.
        return brentq(
            lambda s: mu * (s - 1 / s) + lam * np.log(s) / s + load_ * depth, 1e-6, 1.0, xtol=1e-14
        )

    want = quad(stretch, 0, 1, epsabs=1e-10)[0]
    top = body.nodes_where(near(2, 1.0))
    height = 1 + scene.displacement(path.last.x, 1.0)[top, 2].mean()
    assert height == pytest.approx(want, rel=1e-3)


def test_a_crushing_weight_ends_in_words_or_in_an_audited_state():
    """Γ = 1e-3 on a hinge a thousand times softer than the sheet: a typed ending, no NaN, and a
    state that is reached passes the second code path."""
    unit = replace(P, stiffness_to_weight=1e-3, E_ratio=1e-3, h_ratio=10.0, rho_ratio=10.0)
    worked = time.process_time()
    found = fold(build(unit, Meshing(COARSE), watch=Watch(deadline=core_seconds() + 3)))
    # Its own seconds: a busy machine is no hang.
    assert time.process_time() - worked < 6
    assert found.ending in (Ending.REACHED, Ending.NO_REST, Ending.LOST, Ending.TIMEOUT)
    assert found.detail and (found.x is None) == (not found.states)
    for state in found.states:
        assert np.isfinite(state.curves).all()
    if found.ending is Ending.REACHED:
        seen = audit(found.model, found.x, 1.0)
        assert seen.held == 0 and seen.correction < 1e-6


def test_a_lighter_unit_never_lifts_its_edge_less():
    """Γ = 1e-3 … 1e2 and no weight at all: the tip rises monotonically, from the ground to the
    height that it has in empty space."""
    unit = replace(P, contraction=0.05)
    tips = []
    for gamma in (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0):
        found = reached(build(replace(unit, stiffness_to_weight=gamma), Meshing(COARSE)))
        assert found.last.lowest >= -0.1 * unit.slenderness
        tips.append(found.last.tip)
    free = reached(build(unit, Meshing(COARSE), Physics(())))
    curve = free.last.curves[0]
    # On the ground the edge hovers or sinks by a tenth of the thickness.
    assert np.all(np.diff(tips) > -0.2 * unit.slenderness) and tips[0] < 0.1 * unit.slenderness
    assert np.all(np.diff(tips[2:]) > 0)
    assert tips[-1] < np.ptp(curve[:, 2]) + unit.slenderness
    assert tips[-1] == pytest.approx(np.ptp(curve[:, 2]), rel=2e-2)


def test_a_weightless_scene_is_the_limit_of_a_vanishing_weight():
    """Fold angles for Γ = 10² … 10⁵ approach that of effects=none, and the difference falls as
    1/Γ: weight and ground leave nothing behind when they go."""
    unit = replace(P, contraction=0.1)
    body = build(unit, Meshing(COARSE), Physics(())).body
    free = fold_angle(reached(build(unit, Meshing(body=body), Physics(()))))
    gammas = np.array([1e2, 1e3, 1e4, 1e5])
    off = [
        abs(
            fold_angle(reached(build(replace(unit, stiffness_to_weight=g), Meshing(body=body))))
            - free
        )
        for g in gammas
    ]
    rates = -np.diff(np.log(off)) / np.diff(np.log(gammas))
    assert rates == pytest.approx(1.0, abs=0.05)
    assert off[-1] < 1e-5 * free


# -- contact that comes and goes -----------------------------------------------------------------


def curling(curvature, *, weight=20.0, h=0.01):
    """Half of a heavy strip whose middle curls by ``curvature(e)`` (references.md §2)."""
    scene, ground = heavy_strip(curvature=1.0, weight=weight, h=h, n=(4, 8))
    elastic = next(t for t in scene.terms if t.name == "elastic")
    z = scene.body.points()[..., 2] * scene.body.cells_where(lambda X: X[:, 0] < 0.1)[:, None]

    def tensor(e):
        Fg = np.broadcast_to(np.eye(3), (*z.shape, 3, 3)).copy()
        Fg[..., 0, 0] = 1 - curvature(e) * z
        return Fg

    moved = Elastic(scene.body, elastic.material, General(tensor))
    terms = [moved if t is elastic else t for t in scene.terms]
    body, X = scene.body, scene.body.nodes
    fixed = [*held(body, 1, 0.0, 1), *held(body, 1, X[:, 1].max(), 1), *held(body, 0, 0.0, 0)]
    return Scene(body, terms, fixed=fixed), ground


def test_a_strip_lifts_off_and_lands_three_times():
    """Curling and uncurling three times: each landing is the first state again (1e-6 of the
    thickness), each lift-off the same height, and the ground carries the weight at every point."""
    scene, ground = curling(lambda e: 10 * np.sin(3 * np.pi * e) ** 2)
    weight = weight_of(scene)
    states = []
    point = None
    for target in np.arange(1, 7) / 6:
        path = settled(
            scene, until=target, step=1 / 24, start=np.zeros(scene.size) if point is None else point
        )
        point = path.last
        for p in path.points:
            assert lift(scene, ground, p.x, p.e) == pytest.approx(weight, rel=1e-6)
        states.append(scene.displacement(point.x, point.e))
    up, down = states[0::2], states[1::2]
    tip = scene.body.nodes[:, 0].argmax()
    assert up[0][tip, 2] > 0.2
    for other in up[1:]:
        assert np.abs(other - up[0]).max() < 1e-8
    for other in down:
        assert np.abs(ground.gaps(other)).max() < 0.02 * 0.01
        assert np.abs(other - down[0]).max() < 1e-6 * 0.01


def test_a_block_pressed_down_and_lifted_gives_all_its_work_back():
    """The top of a block goes down onto the ground and up again, twice: reaction 0 in the air, the
    same on the way down and up, and no work over a cycle."""
    body = Body.build(box([0, 1], [0, 1], [0, 0.25, 0.5]), "hex27")
    top = body.nodes_where(near(2, 0.5))
    down = lambda e: 0.1 - 0.2 * np.sin(2 * np.pi * e) ** 2  # noqa: E731
    sides = [*held(body, 0, 0.0, 0), *held(body, 1, 0.0, 1)]
    fixed = [*sides, Fixed(top, AXES[2], value=down)]
    ground = Ground(body, body.surface(near(2, 0.0)), thickness=0.5, pressure=1e-2)
    scene = Scene(body, [Elastic(body, NeoHookean(1.0, 0.3)), ground], fixed=fixed)
    path = trace(scene, np.zeros(scene.size), LoadSteps(rtol=1e-10, step=1 / 48), max_steps=200)
    assert path.reached and {p.unstable for p in path.points} == {0}
    e = path.loads
    force = np.array([lift(scene, ground, p.x, p.e) for p in path.points])
    energy = np.array([p.energy for p in path.points])
    assert force.max() > 0.05 and (force >= 0).all()
    assert (force[np.array([down(v) for v in e]) > 0.05] == 0).all()
    same = np.interp(0.5 - e[e < 0.25], e, force)
    assert same == pytest.approx(force[e < 0.25], abs=0.02 * force.max())
    for cycle in (0.5, 1.0):
        assert np.interp(cycle, e, energy) == pytest.approx(energy[0], abs=1e-12)


@pytest.mark.parametrize("degrees", [2, 20, 60])
def test_a_sheet_dropped_at_a_slope_comes_to_lie_flat(degrees):
    """Dropped on one edge at 2°, 20°, 60°: the energy falls to the sheet lying flat, gap below
    h/100, the ground carrying the weight."""
    h = 0.02
    scene, ground, u = block(
        (0.2, 1.0, h), (2, 10, 1), tilt=np.radians(degrees), lift=0.05 * h, weight=1e-5
    )
    start = scene.unknowns(u)
    found = descend(scene, start, 0.0, rtol=1e-8)
    assert found.converged and found.system.unstable == 0
    assert scene.energy(found.x, 0.0) < scene.energy(start, 0.0)
    now = scene.body.nodes + scene.displacement(found.x, 0.0)
    under = scene.body.nodes[:, 2] == 0
    assert np.abs(now[under, 2]).max() < 0.01 * h
    assert np.ptp(now[~under & (scene.body.nodes[:, 2] == h), 2]) < 1e-3 * h
    assert lift(scene, ground, found.x, 0.0) == pytest.approx(weight_of(scene), rel=1e-6)


# -- toppling ------------------------------------------------------------------------------------


@pytest.mark.parametrize("share, stands", [(0.8, True), (1.2, False)])
def test_a_tall_block_falls_where_its_weight_passes_its_edge(share, stands):
    """A block of 1 × 3 tilted by 0.8 and 1.2 of atan(1/3): it rights itself, or comes to lie on
    its side; statics of a rigid block."""
    wide, high = 1.0, 3.0
    tilt = share * np.arctan(wide / high)
    scene, ground, u = block((1.0, wide, high), (2, 1, 2), tilt=tilt, lift=0.02, weight=1e-4)
    found = descend(scene, scene.unknowns(u), 0.0, rtol=1e-8)
    assert found.converged and found.system.unstable == 0
    now = scene.body.nodes + scene.displacement(found.x, 0.0)
    height = np.ptp(now[:, 2])
    assert height == pytest.approx(high if stands else wide, rel=2e-2)
    assert lift(scene, ground, found.x, 0.0) == pytest.approx(weight_of(scene), rel=1e-6)


def test_a_unit_that_is_let_go_ends_on_its_side_or_in_words():
    """A folded unit that would topple, not held upright: wherever it ends, no mode is unstable with
    nothing to hold it, by the second code path; or the ending says why not."""
    unit = replace(P, hinge_length=0.25, stiffness_to_weight=0.1, contraction=0.12)
    standing = fold(build(unit, Meshing(COARSE)))
    assert standing.last.topples
    found = fold(build(unit, Meshing(COARSE), supports=Supports(upright=False)), max_states=40)
    kinds = [h.kind for h in found.happenings]
    assert "toppling" in kinds or found.ending is not Ending.REACHED
    if found.ending is Ending.REACHED:
        seen = audit(found.model, found.x, found.last.e)
        assert seen.free == 0 and seen.moment == 0 and seen.correction < 1e-6
