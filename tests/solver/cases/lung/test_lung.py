"""The lung: symmetry, stability, pressure and contraction, measures, bad input."""

import importlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gmsh_mark import needs_gmsh
from proofs import prove
from scipy.interpolate import CubicSpline

from foldlab.errors import InputError
from solver.cases.lung import paths
from solver.cases.lung.geometry import Lung, unit
from solver.cases.lung.measures import Section, measure, radial, section, thickness
from solver.cases.lung.mesh import Counts, hexahedra, tetrahedra
from solver.cases.lung.model import REST, State, Tissue, inner_stretch, run, scene, to_limit
from solver.cases.lung.stability import Classes, spread, total
from solver.equilibrium.newton import newton
from solver.equilibrium.outcome import Outcome
from solver.mesh.body import Body
from solver.paths.continuation import trace
from solver.paths.steppers import ArcLength

LUNG = Lung()
# Coarse, and with few cells: what symmetry and algebra must give holds on any mesh.
SMALL = Lung(n=1)
TIMES = {"wedge": 120, "octant": 8, "sphere": 1}


# -- the whole from its wedge --------------------------------------------------------------------


@pytest.fixture(scope="module")
def parts():
    """Wedge, octant and whole sphere of the same few linear elements, without and with a cage."""
    out = {}
    for muscle in (0.0, 0.075):
        lung = Lung(n=1, muscle=muscle)
        out[muscle] = lung, {p: hexahedra(lung, 0, part=p, element="hex8") for p in TIMES}
    return out


def states(lung, bodies, end, **tissue):
    """Scenes of all parts, and the wedge's equilibrium at e = 1 as displacement."""
    scenes = {p: scene(b, lung, Tissue(**tissue), REST, end) for p, b in bodies.items()}
    end = newton(scenes["wedge"], np.zeros(scenes["wedge"].size), 1.0, rtol=1e-10)
    assert end.converged
    return scenes, scenes["wedge"].displacement(end.x, 1.0), end


@pytest.mark.parametrize("fibres", ["along", "isotropic", "blended"])
def test_the_wedge_is_the_whole_sphere(parts, fibres):
    lung, bodies = parts[0.075]
    scenes, u, end = states(lung, bodies, State(0.02, -0.1), fibres=fibres)
    for part in ("octant", "sphere"):
        whole, stage = spread(bodies["wedge"], u, bodies[part]), scenes[part]
        size = np.abs(u).max()
        assert size > 0.01
        x = stage.unknowns(whole)
        np.testing.assert_allclose(stage.displacement(x, 1.0), whole, atol=1e-12)
        assert np.abs(stage.residual(x, 1.0)).max() < 1e-10
        share = TIMES["wedge"] / TIMES[part]
        assert stage.energy(x, 1.0) == pytest.approx(share * end.system.energy, rel=1e-9)
        mine, theirs = measure(bodies[part], lung, whole), measure(bodies["wedge"], lung, u)
        assert mine.aspect == pytest.approx(theirs.aspect, rel=1e-9)
        assert sum(c.number for c in mine.cells) == sum(c.number for c in theirs.cells) == 12


@pytest.mark.parametrize("p", [-0.05, -0.2])
def test_class_counts_add_up_to_the_whole_spheres(parts, p):
    """Under outer pressure a shell has many buckling modes, of every class."""
    lung, bodies = parts[0.0]
    scenes, u, _ = states(lung, bodies, State(p))
    counts = Classes(scenes["octant"]).count(bodies["wedge"], u, 1.0)
    assert min(counts.values()) > 10
    whole = scenes["sphere"]
    x = whole.unknowns(spread(bodies["wedge"], u, bodies["sphere"]))
    assert total(counts) == whole.system(x, 1.0).unstable


def test_a_stable_lung_has_no_unstable_modes(parts):
    lung, bodies = parts[0.075]
    scenes, u, _ = states(lung, bodies, State(0.02))
    counts = Classes(scenes["octant"]).count(bodies["wedge"], u, 1.0)
    assert counts == dict.fromkeys(counts, 0)
    with pytest.raises(ValueError, match="on the octant, not on the wedge"):
        Classes(scenes["wedge"])
    with pytest.raises(ValueError, match="have no image in the wedge"):
        spread(bodies["wedge"], u, hexahedra(lung, 1, part="octant"))


@needs_gmsh
def test_gmsh_tetrahedra_fill_the_same_lung():
    lung = SMALL
    hexes = hexahedra(lung, 1)
    tets = tetrahedra(lung, 0.2, part="wedge", order=2, muscle=0.1)
    for name in ("epithelium", "muscle"):
        mine, theirs = (b.weights[b.cells_of(name)].sum() for b in (tets, hexes))
        assert mine == pytest.approx(theirs, rel=1e-4)
    # Both carry the same pressure alike; tetrahedra with 4 nodes lock.
    found = []
    linear = tetrahedra(lung, 0.2, part="wedge", order=1)
    for body in (hexes, tets, linear):
        stage = scene(body, lung, Tissue(), REST, State(0.03))
        end = run(stage, steps=2, events=False, over=None).last
        found.append(measure(body, lung, stage.displacement(end.x, end.e)).aspect)
    assert found[1] == pytest.approx(found[0], rel=0.02)
    assert found[2] < 0.97 * found[0]


# -- pressure and contraction --------------------------------------------------------------------


def test_thick_sphere_against_the_radial_solution():
    """No muscle: the values of an ordinary differential equation, solved to 1e-12."""
    lung = Lung(n=1, epithelium=0.05 / 1.025, muscle=0.0)  # h is 0.05 of the mid-surface's radius
    body = hexahedra(lung, 0)
    stage = scene(body, lung, Tissue(), REST, State(0.03))

    def stretch(point):
        return inner_stretch(body, lung, stage.displacement(point.x, point.e))

    path = trace(
        stage,
        np.zeros(stage.size),
        ArcLength(rtol=1e-8, a=0.02, b=0.05),
        until=lambda p: stretch(p) - 2.6,
        max_steps=100,
    )
    curve = CubicSpline([stretch(p) for p in path.points], 0.03 * path.loads)
    for at, p in {1.05: 0.0060399, 1.2: 0.0161545, 1.4: 0.0204693, 1.75: 0.0202319,
                  2.5: 0.0154945}.items():  # fmt: skip
        assert curve(at) == pytest.approx(p, rel=5e-3)
    (fold_point,) = [event for event in path.events if event.kind == "fold"]
    assert 0.03 * fold_point.e == pytest.approx(0.020954238, rel=5e-3)
    assert stretch(fold_point) == pytest.approx(1.53123, rel=5e-3)


def test_a_pressure_beyond_the_limit_is_an_outcome():
    body = hexahedra(SMALL, 0)
    stage = scene(body, SMALL, Tissue(), REST, State(0.11))
    path = run(stage, steps=3, events=False, over=None)
    assert path.outcome is Outcome.MIN_STEP
    top = to_limit(stage, path, step=0.05)
    assert top.reached
    assert path.last.e < top.last.e < 1
    # Over the limit the load falls and a mode is unstable; the path ends and says why.
    over = run(stage, steps=3)
    assert not over.reached
    assert over.events[0].kind == "fold"
    assert over.events[0].e == pytest.approx(top.last.e, rel=1e-5)
    assert any(p.unstable for p in over.points)
    with pytest.raises(ValueError, match="over = 'under'; expected"):
        run(stage, over="under")


def test_contraction_without_pressure_shrinks_and_with_it_pushes_out():
    body = hexahedra(SMALL, 0)
    found = {}
    for name, before, after in (
        ("dry", REST, State(0.0, -0.3)),
        ("wet", State(0.05), State(0.045, -0.3)),
    ):
        x = None
        if before is not REST:
            x = run(scene(body, SMALL, Tissue(), REST, before), steps=5, events=False).last.x
        stage = scene(body, SMALL, Tissue(), before, after)
        path = run(stage, x, steps=10, events=False, over="settle")
        assert path.reached
        assert path.last.unstable == 0
        ends = [stage.displacement(p.x, p.e) for p in (path.points[0], path.last)]
        found[name] = [measure(body, SMALL, u) for u in ends], radial(body, ends[1]).max()
    (dry, highest), (wet, _) = found["dry"], found["wet"]
    # The cage shortens by about its contraction, and alone it takes everything inwards.
    assert dry[1].spacing == pytest.approx(0.7 * dry[0].spacing, rel=0.1)
    assert highest < 0.01
    assert wet[1].aspect > 1.2 * wet[0].aspect
    assert wet[1].aspect > dry[1].aspect


@pytest.mark.parametrize("fibres", ["along", "isotropic", "blended"])
def test_terms_of_the_lung_are_derivatives(fibres):
    body = hexahedra(SMALL, 0, element="hex8")
    stage = scene(body, SMALL, Tissue(fibres=fibres), State(0.01, -0.1), State(0.05, -0.3))
    u = 0.05 * body.nodes + 2e-3 * np.random.default_rng(0).standard_normal(body.nodes.shape)
    for term in stage.terms:
        prove(term, u, 0.7)
    assert [term.name for term in stage.terms] == ["elastic", "pressure"]
    # The muscle alone contracts: at e = 0.7 by 24 %.
    J = np.broadcast_to(
        stage.terms[0].growth.evaluate(0.7, body.weights.shape, body.points)[1], body.weights.shape
    )
    muscle = body.cells_of("muscle")
    assert (J[~muscle] == 1).all()
    if fibres == "blended":
        assert ((J[muscle] > 0.75) & (J[muscle] < 0.775)).all()  # (1 − 0.24/2)² in a joint
    else:
        want = {"along": 0.76, "isotropic": 0.76**3}[fibres]
        assert J[muscle] == pytest.approx(np.full(J[muscle].shape, want))
    assert scene(body, SMALL, Tissue()).terms[0].growth is None


def test_the_primitive_model_is_linear_and_its_load_dead():
    body = hexahedra(SMALL, 0)
    ends = []
    for p in (0.02, 0.04):
        stage = scene(body, SMALL, Tissue(model="primitive"), REST, State(p))
        path = run(stage, steps=1, events=False)
        ends.append(stage.displacement(path.last.x, 1.0))
    assert np.abs(ends[0]).max() > 0.01
    np.testing.assert_allclose(2 * ends[0], ends[1], rtol=0, atol=1e-7 * np.abs(ends[1]).max())
    # It starts as the full model does.
    stage = scene(body, SMALL, Tissue(), REST, State(1e-5))
    path = run(stage, steps=1, rtol=1e-12, events=False)
    full = stage.displacement(path.last.x, 1.0) / 1e-5
    np.testing.assert_allclose(ends[0] / 0.02, full, rtol=0, atol=2e-3 * np.abs(full).max())


# -- measures ------------------------------------------------------------------------------------


def test_measures_of_known_displacements():
    body = hexahedra(LUNG, 1)
    t = LUNG.tiling
    rest = measure(body, LUNG, np.zeros_like(body.nodes))
    assert {(c.edges, c.number) for c in rest.cells} == {(5, 12.0), (6, 30.0)}
    for cell in rest.cells:
        edge = np.flatnonzero((t.sides == cell.tile).any(axis=1))
        axis = t.centres[cell.tile]
        gaps = np.linalg.norm(t.middles[edge] - np.outer(t.middles[edge] @ axis, axis), axis=1)
        assert cell.spacing == pytest.approx(2 * gaps.mean(), rel=1e-12)
    # A hexagon's spacing is the distance of its opposite bundles, √3 of an edge but for curvature.
    (hexagon,) = [c for c in rest.cells if c.edges == 6]
    assert hexagon.spacing == pytest.approx(LUNG.spacing, rel=0.03)
    # In the mean over the sphere, not over the kinds of tiles.
    mean = sum(c.number * c.spacing for c in rest.cells) / 42
    assert rest.spacing == pytest.approx(mean, rel=1e-12)
    assert (rest.depth, rest.thinnest, rest.thickest) == pytest.approx((0, 1, 1))
    grown = measure(body, LUNG, 0.25 * body.nodes)
    # u·N grows with r, so the epithelium's own thickness is the depth.
    assert grown.depth == pytest.approx(0.25 * 0.05, rel=1e-9)
    assert grown.spacing == pytest.approx(1.25 * rest.spacing, rel=1e-12)
    assert (grown.mean_thickness, grown.variation) == pytest.approx((1.25, 0.0))
    thinner = unit(body.nodes) * 0.3 - 0.3 * body.nodes  # r → 0.3 + 0.7 r
    assert measure(body, LUNG, thinner).mean_thickness == pytest.approx(0.7, rel=1e-4)
    # Thicker towards one pole: the thinnest and the thickest leave a hundredth of the volume each.
    uneven = (
        unit(body.nodes) * (0.2 * np.linalg.norm(body.nodes, axis=1) * body.nodes[:, 2])[:, None]
    )
    ratios, volumes, _ = thickness(body, uneven)
    order = np.argsort(ratios)
    below = np.cumsum(volumes[order]) / volumes.sum()
    by = measure(body, LUNG, uneven)
    assert by.thinnest == ratios[order][np.argmax(below >= 0.01)]
    assert by.thickest == ratios[order][np.argmax(below >= 0.99)]
    assert by.thickest > np.quantile(ratios, 0.95) > by.thinnest
    # Its variation is over the volume, whatever the sizes of the cells.
    mean = np.average(ratios, weights=volumes)
    deviation = np.sqrt(np.average(ratios**2, weights=volumes) - mean**2)
    assert by.variation == pytest.approx(deviation / mean, rel=1e-9)
    # Sheared: volume over the area of the layer, whose tangents become A t.
    A = np.eye(3) + np.array([[0.1, 0.6, 0.0], [0.0, -0.2, 0.0], [0.3, 0.0, 0.0]])
    ratios, _, _ = thickness(body, body.nodes @ (A - np.eye(3)).T)
    N = unit(body.points()[body.cells_of("epithelium")]).reshape(-1, 3)
    one = unit(np.cross(N, [0.6, 0.48, 0.64]))
    area = np.linalg.norm(np.cross(one @ A.T, np.cross(N, one) @ A.T), axis=1)
    np.testing.assert_allclose(ratios, np.linalg.det(A) / area, rtol=1e-9)
    # A bump over the hexagon alone is the hexagon's and the whole's depth, not the pentagon's.
    bump = np.clip(1 - np.arccos(np.clip(unit(body.nodes)[:, 2], -1, 1)) / 0.2, 0, None)
    bumped = measure(body, LUNG, 0.1 * bump[:, None] * unit(body.nodes))
    depths = {c.edges: c.depth for c in bumped.cells}
    assert depths[6] == bumped.depth == pytest.approx(0.1, rel=1e-9)
    assert depths[5] == 0
    assert bumped.aspect == pytest.approx(0.1 / rest.spacing, rel=1e-9)
    turned = measure(body, LUNG, -2 * body.nodes * (1, 1, 0))
    assert turned.inverted == 0  # a half turn about z
    assert measure(body, LUNG, -2 * body.nodes).inverted == 1


def test_section_of_the_undeformed_wedge():
    cut = section(hexahedra(LUNG, 2), LUNG, np.zeros((len(hexahedra(LUNG, 2).nodes), 3)))
    inner, outer = cut.lines
    assert np.linalg.norm(inner, axis=1) == pytest.approx(np.full(len(inner), 0.95))
    assert np.linalg.norm(outer, axis=1) == pytest.approx(np.ones(len(outer)))
    # From the hexagon's axis to the pentagon's: atan(1/φ).
    angles = np.arctan2(*inner.T)
    assert (angles[0], angles[-1]) == pytest.approx((0, np.arctan(2 / (1 + np.sqrt(5)))), abs=1e-9)
    assert cut.sharpest == pytest.approx(1 / 0.95, rel=1e-3)
    assert not cut.overlaps
    inside = cut.bundle.mean(axis=0)
    entered = Section((inner, np.concatenate([outer, inside[None]])), cut.bundle)
    assert entered.overlaps
    width = np.ptp(np.arctan2(*cut.bundle.T))
    assert width == pytest.approx(LUNG.bundle, rel=1e-6)
    with pytest.raises(ValueError, match="n = 2"):
        section(hexahedra(SMALL, 0), SMALL, np.zeros((1, 3)))


def test_a_crease_on_the_axis_is_the_sharpest_place():
    # The cut begins on a mirror plane: of a kink in the middle one side alone is on it.
    y = np.linspace(0.0, 0.5, 11)
    kinked, flat = np.stack([y, 0.95 - 0.5 * y], 1), np.stack([y, np.full_like(y, 1.0)], 1)
    none = np.zeros((0, 2))
    # Circle through (−d, z), (0, z₀) and (d, z): R κ = 2 sin(turn / 2) / chord.
    turn, chord = 2 * np.arctan(0.5), 0.05 * np.hypot(1, 0.5)
    sharpest = Section((kinked, flat), none).sharpest
    assert sharpest == pytest.approx(2 * np.sin(turn / 2) / chord, rel=1e-9)
    assert Section((flat, kinked), none).sharpest == pytest.approx(0, abs=1e-9)


# -- bad input -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given, words",
    [
        ({"width": 0.6}, "where they would fill the cells of the tiling n = 2"),
        ({"width": 0.0}, "bundles 0 R wide"),
        ({"n": 5, "width": 0.3}, "fill the cells of the tiling n = 5"),
        ({"epithelium": 1.2}, "expected a thickness between 0 and the radius"),
        ({"epithelium": 0.0}, "epithelium = 0 R"),
        ({"muscle": -0.1}, "expected a thickness, or 0 for no cage"),
        ({"n": 0}, "n = 0; expected a whole number"),
        ({"n": 1.5}, "n = 1.5; expected a whole number"),
    ],
)
def test_what_is_no_lung_is_refused(given, words):
    with pytest.raises(ValueError, match=words):
        Lung(**given)


def test_what_is_no_lung_within_a_hair_is_built():
    """Bundles just narrower than the cells leave a hole in every cell."""
    lung = Lung(width=0.98 * LUNG.widest)
    assert isinstance(hexahedra(lung, 0), Body)


def test_a_stage_that_relaxes_is_the_one_that_contracts_walked_back():
    body, bent = hexahedra(SMALL, 0), State(0.1, -0.4)
    there, back = (scene(body, SMALL, Tissue(), *ends) for ends in ((REST, bent), (bent, REST)))
    x = there.unknowns(0.01 * body.nodes)
    for e in (0.0, 0.3, 1.0):
        np.testing.assert_allclose(back.residual(x, 1 - e), there.residual(x, e), atol=1e-12)
    assert np.abs(back.residual(x, 0.0) - back.residual(x, 1.0)).max() > 0.01  # it acts


def test_a_stage_is_followed_once_for_each_tissue(monkeypatch):
    followed = []

    def run_(made, x, **options):
        followed.append(made)
        return SimpleNamespace(reached=True, last=SimpleNamespace(x=made))

    monkeypatch.setattr(paths, "hexahedra", lambda lung, counts: None)
    monkeypatch.setattr(paths, "scene", lambda body, lung, *stage: stage)
    monkeypatch.setattr(paths, "run", run_)
    known, full = paths.Paths(LUNG, 1, steps=4), State(0.1)
    for tissue in (Tissue(), Tissue(stiffness=10.0), Tissue()):
        stage, path = known.stage(tissue, full, State(0.1, -0.4))
        assert stage == path.last.x == (tissue, full, State(0.1, -0.4))
    assert [made[0].stiffness for made in followed] == [75.0, 75.0, 10.0, 10.0]


@pytest.mark.parametrize(
    "name, given, words",
    [
        ("lung_inflation", {"width": 1.2}, "where they would fill the cells"),
        ("lung_inflation", {"epithelium": 1.0}, "between 0 and the radius"),
        ("lung_inflation", {"levels": (7,)}, "no level 7; there are: 0, 1"),
        ("lung_inflation", {"spheres": ("hex8",)}, "no sphere 'hex8'; there are: tet4"),
        ("lung_inflation", {"pressure_drop": 1.5}, "a drop between 0 and 1"),
        ("lung_inflation", {"nu": 0.5}, "expected -1 < nu < 0.5"),
        ("lung_studies", {"contractions": (-1.0,)}, "a contraction above -1"),
        ("lung_studies", {"contractions": (0.0,)}, "at least one below 0"),
        ("lung_studies", {"studies": ("colour",)}, "no study 'colour'"),
        ("lung_studies", {"pressure": 0.11, "studies": ("contraction",)}, "0.11 is not reached"),
    ],
)
def test_experiments_refuse_bad_settings(name, given, words):
    module = importlib.import_module(f"experiments.{name}")
    with pytest.raises(InputError, match=words):
        module.run(replace(module.TINY, **given), None)


def test_other_bad_input():
    body = hexahedra(SMALL, 0)
    with pytest.raises(ValueError, match="no part 'half'; there are: wedge, octant, sphere"):
        hexahedra(SMALL, 0, part="half")
    with pytest.raises(ValueError, match="level 9; there are 0 to 4"):
        hexahedra(SMALL, 9)
    with pytest.raises(ValueError, match="size = -1, order = 1; expected size > 0"):
        tetrahedra(SMALL, -1)
    with pytest.raises(ValueError, match="fibres 'across', model 'advanced'; expected one of"):
        Tissue(fibres="across")
    with pytest.raises(ValueError, match="stiffness = 0; expected"):
        Tissue(stiffness=0)
    with pytest.raises(ValueError, match="a contraction above -1"):
        State(0.1, -1.0)
    bare = Lung(n=1, muscle=0.0)
    with pytest.raises(ValueError, match="a contraction but no muscle"):
        scene(hexahedra(bare, 0), bare, Tissue(), REST, State(0.0, -0.1))
    with pytest.raises(ValueError, match="the middle of an edge is no node"):
        measure(body, LUNG, np.zeros_like(body.nodes))
    assert Counts() == Counts(rim=1, hole=1, strip=1, epithelium=1, muscle=1)
