"""Order of closure of neural tubes of one β all along, and folds that stay together."""

import warnings
from functools import lru_cache

import numpy as np
import pytest
from pytest import approx

from solver.cases.tissue import neural_tube
from solver.cases.tissue.neural_tube import Closure, Counts, Shape
from solver.viscous.evolution import TimeSteps, Unresolved, evolve, start

COUNTS = Counts(4, 5, 1)


@lru_cache
def path(radii=(1.0,), sealing=None, steps=20, back=False, counts=COUNTS):
    """Model, scene and states of a contraction by 0.4, and back."""
    shape = Shape(posterior=1.0, radii=radii)
    model = neural_tube.build(counts, element="hex20", shape=shape, sealing=sealing)
    scene = model.viscous(1 / steps)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Unresolved)
        found = evolve(
            scene, start(scene), TimeSteps(1e-6, 1 / steps), until=2.0 if back else 1.0,
            load=lambda t: min(t, max(2 - t, 0.0)), breaks=(1.0,),
        )  # fmt: skip
    assert found.reached
    return model, scene, found.states


def closures(*given, **options):
    model, scene, states = path(*given, **options)
    return model.closures((s.e, scene.displacement(s.x, s.e)) for s in states)


def loads(found):
    return np.array([np.inf if c.load is None else c.load for c in found])


def test_a_uniform_plate_closes_in_its_middle_first_and_both_ways_alike():
    found = closures()
    assert [c.x for c in found] == approx(np.linspace(0, 4, 9), abs=1e-8)
    at = loads(found)
    assert at == approx(at[::-1], rel=1e-5)
    assert at.argmin() == 4 and 0.4 < at[4] < 0.7
    # Free ends flare: the ends come last, or not at all.
    assert (np.diff(at[4:7]) > 0).all() and at[-1] == np.inf


def test_the_narrower_end_closes_first_whichever_it_is():
    front, back = (loads(closures(radii=radii)) for radii in ((1.2, 1.0), (1.0, 1.2)))
    assert front == approx(back[::-1], rel=1e-5)
    assert front.argmin() > 4
    narrow, wide = front[5:], front[3::-1]
    finite = np.isfinite(narrow)
    assert finite.sum() >= 2 and (narrow[finite] < wide[finite]).all()


def test_when_it_closes_converges_with_the_step():
    first = [loads(closures(steps=n)).min() for n in (20, 40)]
    assert abs(first[1] - first[0]) < 0.2 / 20


def test_folds_that_fused_stay_closed_when_the_contraction_is_taken_back():
    free, fused = path(back=True), path(sealing=1.0, back=True)
    for (model, scene, states), stays in ((free, False), (fused, True)):
        closed = [model.measure(scene.displacement(s.x, s.e)).closed for s in states]
        assert max(closed[:21]) > 0.3
        if stays:
            assert (np.diff(closed) >= 0).all()
        else:
            assert closed[-1] == 0
    model, scene, states = fused
    # They are under tension then, and hold.
    seal = model.terms[1].with_history(states[-1].level.marks[0])
    opened = seal.openings(scene.displacement(states[-1].x, states[-1].e))
    assert 1e-5 < opened.max() < 0.1 * model.touching
    # Until the first touch there is no difference.
    a, b = loads(closures()), loads(closures(sealing=1.0))
    assert a.min() == b.min()


def test_a_stiffer_seal_opens_less_in_proportion():
    opened = []
    for sealing in (1.0, 4.0):
        model, scene, states = path(sealing=sealing, back=True)
        seal = model.terms[1].with_history(states[-1].level.marks[0])
        opened.append(seal.openings(scene.displacement(states[-1].x, states[-1].e)).max())
    assert opened[0] / opened[1] == approx(4.0, rel=0.1)


def flat(model, heights):
    """A displacement that brings the edges of each section to a height over the mirror plane."""
    X, u = model.body.nodes, np.zeros_like(model.body.nodes)
    edge = model.body.nodes_of("edge")
    places = np.unique(X[edge, 0].round(9))
    at = np.searchsorted(places, X[edge, 0].round(9))
    u[edge, 2] = np.asarray(heights)[at] - X[edge, 2]
    return u


def test_closing_is_told_where_the_distance_comes_down_to_touching():
    model = neural_tube.build(Counts(1, 4, 1), element="hex20")
    touch = model.touching
    assert touch == approx(2 * 0.05 * 0.15)
    # Full distances over touching, per section: slows down, falls faster, never, from the start.
    rows = [(4.0, 1.0, -0.1, 2.0), (4.0, 3.0, -1.0, -1.0), (4.0, 3.0, 2.5, 2.4)]
    states = [
        (load, flat(model, (np.array(row) + 1) * touch / 2))
        for load, row in zip((0.0, 0.5, 0.6, 0.8), zip(*rows, strict=True), strict=True)
    ]
    found = model.closures(states)
    # 1.0 left, falling by 6 per load; 3.0 left, falling by 2: no later than the state beyond.
    assert [c.load for c in found] == [approx(0.5 + 0.1), approx(0.6), None]
    quick = [(0.0, states[0][1]), (0.5, flat(model, [2 * touch, touch, 0.1 * touch]))]
    assert [c.load for c in model.closures(quick)] == [None, None, approx(0.5 * 4 / 4.8)]
    slow = model.closures([(0.3, flat(model, [0.1 * touch] * 3)), *quick])
    assert slow[0] == Closure(0.0, 0.3)


def test_the_plate_follows_its_profiles():
    shape = Shape(radii=(1.2, 1.0), thicknesses=(1.0, 2.0, 1.0), rises=(0.8, 1.0))
    model = neural_tube.build(Counts(8, 6, 2), element="hex27", shape=shape)
    X = model.body.nodes
    for name, side in (("inner", -1), ("outer", 1)):
        nodes = model.body.nodes_of(name)
        r = np.hypot(X[nodes, 1], X[nodes, 2])
        x = X[nodes, 0]
        assert r == approx(shape.radius(x) + side * shape.thick(x) / 2, rel=1e-12)
    edge = model.body.nodes_of("edge")
    assert np.arctan2(X[edge, 2], -X[edge, 1]) == approx(shape.edge(X[edge, 0]), rel=1e-12)
    assert shape.radius(np.array([0, 4.0])) == approx([1.2, 1.0])
    assert shape.thick(np.array([0, 2.0, 4.0])) == approx([0.15, 0.3, 0.15])
    x = np.linspace(0, 4, 33)[:-1]
    pieces = np.pi / 2 * 0.8, np.pi / 2
    assert (np.diff(shape.edge(x)) > 0).all() and pieces[0] <= shape.edge(x).min()
    # The line of contraction keeps its distance from the edge, as an arc.
    for at in (0.0, 1.0, 4.0):
        r, edge_at = shape.radius(at) - shape.thick(at) / 2, shape.edge(at)
        angle = edge_at - (np.pi / 2 - 0.9) / shape.radius(at)
        place = np.array([at, -r * np.cos(angle), r * np.sin(angle)])
        assert Shape(**{**vars(shape), "posterior": 1.0}).beta(place) == approx(1.0)
    # Supports find its lowest line at both ends.
    _, foot, feet = model.fixed
    assert X[foot.nodes] == approx(np.array([[0, -1.2 - 0.075, 0]]), abs=1e-9)
    assert X[feet.nodes[1]] == approx(np.array([4, -1.0 - 0.075, 0]), abs=1e-9)


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"radii": ()}, r"radii = \(\); expected numbers > 0"),
        ({"radii": (1.0, -1.0)}, "expected numbers > 0"),
        ({"rises": (1.0, 2.0)}, "expected less than 2, where the edges meet"),
        ({"radii": (0.1, 1.0)}, "thickness = 0.15; expected less than the radius, which is 0.1"),
    ],
)
def test_profiles_that_make_no_plate_are_refused(bad, says):
    with pytest.raises(ValueError, match=says):
        Shape(**bad)


def test_a_seal_without_stiffness_is_refused():
    with pytest.raises(ValueError, match="the seal's stiffness = 0"):
        neural_tube.build(Counts(1, 4, 1), element="hex20", sealing=0.0)
    assert len(neural_tube.build(Counts(1, 4, 1), element="hex20").terms) == 1
