"""The lung's tiling, bundles, fibres and meshes."""

import numpy as np
import pytest

from solver.cases.lung.geometry import MIRRORS, Holes, Lung, Tiling, fold, unit
from solver.cases.lung.mesh import RATIO, Counts, hexahedra
from solver.cases.lung.model import blended_fibres, fibre_directions, part_of

LUNG = Lung()
SMALL = Lung(n=1)
TIMES = {"wedge": 120, "octant": 8, "sphere": 1}


def directions(count, seed=0):
    return unit(np.random.default_rng(seed).standard_normal((count, 3)))


# -- tiling --------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_goldberg_counts_and_euler(n):
    t = Tiling.build(n)
    assert np.bincount(t.degrees, minlength=7).tolist() == [0] * 5 + [12, 10 * (n * n - 1)]
    assert (len(t.edges), len(t.corners)) == (30 * n * n, 20 * n * n)
    assert len(t.corners) - len(t.edges) + len(t.centres) == 2
    # Three bundles meet at every corner.
    assert (np.bincount(t.edges.ravel()) == 3).all()
    assert [len(t.flags_in(p)) for p in TIMES] == [n * n, 15 * n * n, 120 * n * n]


def test_edges_of_the_second_tiling():
    lengths, counts = np.unique(Tiling.build(2).lengths.round(6), return_counts=True)
    # references: 60 of each, mean 0.349320; the printed 0.304 is none of them.
    assert lengths.tolist() == [0.345542, 0.353098]
    assert counts.tolist() == [60, 60]
    assert LUNG.bundle == pytest.approx(0.1 * np.sqrt(3) * 0.349320, rel=1e-6)
    assert Lung(width=0.1 * np.sqrt(3) * 0.304).bundle == pytest.approx(0.05265, rel=1e-3)


def test_the_tiling_has_the_symmetry_of_its_mirrors():
    X = directions(300)
    Y, Q = fold(X)
    assert (Y @ MIRRORS.T > -1e-12).all()
    np.testing.assert_allclose(np.einsum("pij,pj->pi", Q, X), Y, atol=1e-13)
    np.testing.assert_allclose(
        Q @ np.swapaxes(Q, 1, 2), np.tile(np.eye(3), (300, 1, 1)), atol=1e-13
    )
    # The mirrors' angles are those of a fundamental domain: π/5, π/2, π/3.
    angles = [np.arccos(-MIRRORS[i] @ MIRRORS[j]) for i, j in ((0, 2), (0, 1), (1, 2))]
    assert np.pi / np.array(angles) == pytest.approx([5, 2, 3])
    np.testing.assert_allclose(
        LUNG.tiling.angles(X).min(axis=1), LUNG.tiling.angles(Y).min(axis=1), atol=1e-12
    )


def test_the_nearest_edge_is_the_nearest():
    t, X = LUNG.tiling, directions(40, seed=1)
    s = np.linspace(0, 1, 400)[:, None]
    arcs = np.stack([unit((1 - s) * t.corners[a] + s * t.corners[b]) for a, b in t.edges])
    gap = np.arccos(np.clip(np.einsum("ksi,pi->pks", arcs, X), -1, 1)).min(axis=2)
    np.testing.assert_allclose(t.angles(X), gap, atol=3e-3)
    assert (gap[np.arange(40), t.nearest_edge(X)] - gap.min(axis=1) < 1e-5).all()


def test_fibres_run_along_the_bundles_with_the_tilings_symmetry():
    X = 1.03 * directions(500)
    f = fibre_directions(LUNG, X)
    np.testing.assert_allclose(np.einsum("pi,pi->p", f, X), 0, atol=1e-13)
    Y, Q = fold(X)
    for make in (fibre_directions, blended_fibres):
        here, there = make(LUNG, X), make(LUNG, Y)
        if here.ndim == 2:
            here, there = (v[:, :, None] * v[:, None, :] for v in (here, there))
        np.testing.assert_allclose(Q @ here @ np.swapaxes(Q, 1, 2), there, atol=1e-9)
        assert np.trace(here, axis1=1, axis2=2) == pytest.approx(np.ones(500))
    # Beside the middle of a bundle both are its own direction.
    t = LUNG.tiling
    along = unit(np.diff(t.corners[t.edges], axis=1)[:, 0])
    beside = t.middles + 0.01 * t.normals
    assert np.abs(np.einsum("ki,ki->k", fibre_directions(LUNG, beside), along)).min() > 0.9999
    dyads = along[:, :, None] * along[:, None, :]
    np.testing.assert_allclose(blended_fibres(LUNG, beside), dyads, atol=2e-3)
    # At a threefold joint no direction in the sphere is preferred, and nothing jumps there.
    C = unit(np.array([(1 + np.sqrt(5)) / 2, 0, 2 + np.sqrt(5)]))
    np.testing.assert_allclose(
        blended_fibres(LUNG, C[None])[0], (np.eye(3) - np.outer(C, C)) / 2, atol=1e-9
    )
    around = unit(C + 1e-5 * directions(20))
    assert np.ptp(blended_fibres(LUNG, around), axis=0).max() < 1e-3
    assert np.ptp(np.abs(fibre_directions(LUNG, around)), axis=0).max() > 0.5


@pytest.mark.parametrize("part", [0.3, 0.6, 0.9])
def test_beside_a_joint_bundles_count_by_how_far_they_are(part):
    # On one of three bundles, ``part`` of their width from the joint, where the other two begin:
    # at 120 degrees, each of the weight (1 − part²)².
    t, C = LUNG.tiling, unit(np.array([(1 + np.sqrt(5)) / 2, 0, 2 + np.sqrt(5)]))
    ends = np.abs(t.corners[t.edges] - C).max(axis=2).min(axis=1) < 1e-9
    assert ends.sum() == 3
    other = (1 - part**2) ** 2
    for middle in t.middles[ends]:
        way = unit(middle - (middle @ C) * C)
        at = unit(C + np.tan(part * LUNG.bundle) * way)
        along = unit(way - (way @ at) * at)
        across = np.cross(at, along)
        tensor = blended_fibres(LUNG, at[None])[0]
        known = np.array([1 + 2 * other / 4, 2 * other * 3 / 4]) / (1 + 2 * other)
        assert [along @ tensor @ along, across @ tensor @ across] == pytest.approx(known, abs=4e-3)


# -- meshes --------------------------------------------------------------------------------------


def cage_area(lung):
    """Area of the bundles on the unit sphere, by points of a Fibonacci lattice."""
    k = np.arange(30_000) + 0.5
    z, phi = 1 - 2 * k / len(k), np.pi * (1 + np.sqrt(5)) * k
    X = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], axis=1)
    t = lung.tiling
    off = np.abs(np.einsum("pi,pi->p", X, t.normals[t.nearest_edge(X)]))
    return 4 * np.pi * np.mean(off < np.sin(lung.bundle / 2))


@pytest.mark.parametrize("part", TIMES)
def test_volumes_of_shell_and_cage(part):
    body = hexahedra(SMALL if part == "sphere" else LUNG, 0, part=part)
    lung = SMALL if part == "sphere" else LUNG
    assert part_of(body) == part
    volume = {
        name: TIMES[part] * body.weights[body.cells_of(name)].sum()
        for name in ("epithelium", "muscle")
    }
    # The 27-node geometry follows the sphere to about 1e-6 of the volume.
    shell = 4 / 3 * np.pi * (1 - (1 - lung.epithelium) ** 3)
    assert volume["epithelium"] == pytest.approx(shell, rel=1e-4 if part == "sphere" else 1e-5)
    cage = cage_area(lung) * ((1 + lung.muscle) ** 3 - 1) / 3
    assert volume["muscle"] == pytest.approx(cage, rel=5e-3)


def test_elements_of_a_hole_are_shortest_at_its_rim():
    X = hexahedra(LUNG, Counts(hole=4)).nodes
    X = X[np.abs(np.linalg.norm(X, axis=1) - 1) < 1e-9]
    holes = Holes.of(LUNG.tiling, LUNG.tiling.flags_in("wedge"), LUNG.bundle)
    for centre, rim in zip(holes.centre, holes.at_middle, strict=True):
        across = np.abs(X @ unit(np.cross(centre, rim))) < 1e-9
        most = np.arccos(centre @ rim)
        on = np.arccos(np.clip(X[across] @ rim, -1, 1))
        there = np.arccos(np.clip(X[across] @ centre, -1, 1))
        # On the arc from the rim halfway to the centre, where the graded block ends.
        on = np.sort(on[(np.abs(on + there - most) < 1e-6) & (on < most / 2 + 1e-6)])
        assert len(on) == 9  # ends and middles of four elements
        steps = np.diff(on[::2])
        assert (np.diff(steps) > 0).all()
        assert steps[-1] / steps[0] == pytest.approx(RATIO)


def test_elements_of_a_bundle_are_shortest_at_its_rim():
    X = hexahedra(LUNG, Counts(strip=4)).nodes
    X = X[np.abs(np.linalg.norm(X, axis=1) - 1) < 1e-9]
    holes = Holes.of(LUNG.tiling, LUNG.tiling.flags_in("wedge"), LUNG.bundle)
    for middle, rim in zip(holes.middle, holes.at_middle, strict=True):
        # On the arc from the middle of the bundle to its rim, half its width.
        ends = [np.arccos(np.clip(X @ end, -1, 1)) for end in (middle, rim)]
        wide = np.arccos(middle @ rim)
        assert wide == pytest.approx(LUNG.bundle / 2, rel=2e-3)
        on = np.sort(ends[0][np.abs(ends[0] + ends[1] - wide) < 1e-7])
        assert len(on) == 9  # ends and middles of four elements
        steps = np.diff(on[::2])
        assert (np.diff(steps) < 0).all()
        assert steps[0] / steps[-1] == pytest.approx(RATIO, rel=0.02)


def test_bundles_and_shell_share_their_contact():
    body = hexahedra(LUNG, 1)
    r = np.linalg.norm(body.nodes, axis=1)
    of = {name: np.unique(body.cells[body.cells_of(name)]) for name in ("epithelium", "muscle")}
    both = np.intersect1d(of["epithelium"], of["muscle"])
    assert r[both] == pytest.approx(np.ones(len(both)), abs=1e-9)
    foot = of["muscle"][np.abs(r[of["muscle"]] - 1) < 1e-9]
    assert np.array_equal(np.sort(foot), both)
    # The rim lies half a width from the plane of its edge, and nothing of the muscle lies beyond.
    t, d = LUNG.tiling, unit(body.nodes[of["muscle"]])
    off = np.abs(np.einsum("pi,pi->p", d, t.normals[t.nearest_edge(d)]))
    assert off.max() == pytest.approx(np.sin(LUNG.bundle / 2), rel=1e-9)
    wall = body.nodes_of("inner")
    assert r[wall] == pytest.approx(np.full(len(wall), 0.95), abs=1e-9)


@pytest.mark.parametrize("n", [1, 3, 4])
def test_any_subdivision_has_a_wedge(n):
    body = hexahedra(Lung(n=n), 0)
    shell = body.weights[body.cells_of("epithelium")].sum()
    assert 120 * shell == pytest.approx(4 / 3 * np.pi * (1 - 0.95**3), rel=1e-4)
