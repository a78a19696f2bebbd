"""Structures that fold: against units, rigid kinematics, and what people know."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from crease_patterns import (
    MODULUS,
    THICKNESS,
    folded,
    for_angle,
    miura_vertex,
    squares,
    structure,
    two_panels,
)
from pytest import approx

from solver.cases.structure import path
from solver.cases.structure.hinges import Layer
from solver.cases.structure.model import build
from solver.cases.structure.parts import Structure
from solver.cases.structure.path import Ending, fold
from solver.cases.structure.pattern import Crease, Pattern
from solver.equilibrium.clock import core_seconds
from solver.equilibrium.outcome import Outcome
from solver.paths.point import Ended
from solver.paths.stable import StableSteps
from solver.paths.steppers import LoadSteps

CROSS = [(0, 0), (1, 0), (2, 0), (1, 1), (1, -1), (1, 2)]


def test_two_panels_without_weight_fold_as_their_law_says():
    folding = folded(two_panels(), 2.5, length=0.2, effects=())
    assert folding.ending is Ending.REACHED
    assert folding.last.angles == approx(2.5, abs=1e-6)
    assert all(s.unstable == 0 for s in folding.states)
    law = folding.model.structure.laws[0]
    for state in folding.states:
        assert state.angles == approx(law.at(float(state.e))[0], abs=1e-6)
    assert folding.last.lowest is None and folding.last.clearance is None


@pytest.mark.parametrize("alpha", [60, 75])
@pytest.mark.parametrize("effects", [(), ("gravity", "ground", "contact")])
def test_a_miura_vertex_moves_as_rigid_panels_must(alpha, effects):
    # Opposite folds are equal, and tan(ρ/2) of one pair is cos α times that of the other.
    # That is the limit of short hinges.
    length = 0.03
    folding = folded(miura_vertex(np.radians(alpha), length), 1.2, length=length, effects=effects)
    assert folding.ending is Ending.REACHED
    for state in folding.states[1:]:
        odd, one, plain, other = state.angles
        assert one == approx(other, abs=np.radians(0.5))
        assert odd == approx(-plain, abs=np.radians(0.5))
        expected = 2 * np.arctan(np.cos(np.radians(alpha)) * np.tan(one / 2))
        assert plain == approx(expected, abs=np.radians(1.0))
    assert folding.last.angles[1] > 0.6


def test_a_cube_closes_under_its_weight_at_one_size_and_not_at_another():
    closed = folded(squares(CROSS), np.pi / 2, gamma=100)
    assert closed.ending is Ending.REACHED
    assert closed.last.angles == approx(np.full(5, np.pi / 2), abs=0.02)
    assert closed.last.unstable == 0
    heavy = folded(squares(CROSS), np.pi / 2, gamma=0.01)
    assert heavy.ending is Ending.REACHED
    assert np.abs(heavy.last.angles).max() < 0.01
    assert heavy.last.centre[2] < THICKNESS


def test_a_box_that_would_close_too_far_is_stopped_by_its_own_panels():
    folding = folded(squares(CROSS), 1.1 * np.pi / 2, gamma=100)
    assert folding.ending is Ending.REACHED
    assert 0 < folding.last.clearance <= THICKNESS
    assert np.sort(folding.last.angles)[:3] == approx(np.full(3, np.pi / 2), abs=0.03)
    assert folding.last.unstable == 0


@pytest.mark.parametrize("effects", [(), ("gravity", "ground")])
def test_strips_are_outlines_between_the_edges_of_their_panels(effects):
    model = build(structure(squares([(0, 0), (1, 0), (2, 0)])), effects)
    flat = model.strips(np.zeros(model.scene.size), 0.0)
    for strip, x in zip(flat, (1.0, 2.0), strict=True):
        assert strip.mean(axis=0)[:2] == approx([x, 0.5])
        # Corner by corner around: of a strip whose corners cross, the parts cancel.
        area = np.cross(strip, np.roll(strip, -1, axis=0)).sum(axis=0) / 2
        assert np.abs(area) == approx([0, 0, 0.1 * 1.0], abs=1e-12)
    bent = folded(squares([(0, 0), (1, 0), (2, 0)]), 1.0, effects=effects).last
    corners = np.concatenate(bent.panels)
    for strip, angle in zip(bent.strips, bent.angles, strict=True):
        gaps = np.linalg.norm(strip[:, None] - corners, axis=-1).min(axis=1)
        assert gaps == approx(0, abs=1e-6)
        # Along the panels' edges as long as they are, across them the chord of an arc, nearly.
        sides = np.linalg.norm(strip - np.roll(strip, -1, axis=0), axis=1)
        assert sides[[0, 2]] == approx(1.0)
        assert sides[[1, 3]] == approx(0.1 * np.sin(angle / 2) / (angle / 2), rel=0.05)


def test_hinges_fold_in_the_order_that_they_are_told():
    def pattern(order):
        plain = squares([(0, 0), (1, 0), (2, 0)])
        creases = [
            Crease(c.ends, 1, c.length, start, start + 0.5)
            for c, start in zip(plain.creases, order, strict=True)
        ]
        return Pattern(plain.vertices, plain.faces, creases)

    folding = folded(pattern((0.0, 0.5)), 1.0, effects=())
    halfway = next(s for s in folding.states if s.e == 0.5)  # a point of the path of its own
    assert halfway.angles == approx([1.0, 0.0], abs=1e-6)
    assert folding.last.angles == approx([1.0, 1.0], abs=1e-6)


def test_weight_and_centre_of_mass_are_those_of_the_sheet_and_its_layers():
    pattern = two_panels(length=0.2)
    h, g = 2e-3, 9.81
    made = Structure.of(pattern, Layer(1e9, 1000, h), Layer(1e8, 2000, 3 * h, 0.1), g=g)
    model, mass = build(made), 1000 * h * 1.0 * 0.2 + 2000 * 3 * h * 0.2 * 0.2
    assert model.parts.mass.sum() == approx(mass)
    assert build(made, ()).parts.mass.sum() == approx(mass)
    pull = next(t for t in model.scene.terms if t.name == "gravity").loads(0.0)
    assert pull.sum(axis=0) == approx([0, 0, -g * mass])
    flat = fold(build(structure(two_panels(), contraction=0.001))).states[0]
    assert flat.centre == approx([0, 0, 0], abs=0.1 * THICKNESS)


def test_a_strip_that_stands_on_its_fold_alone_stays_up_where_it_is_held():
    made = structure(two_panels(), contraction=for_angle(2.0, 0.2), gamma=100)
    held = fold(build(made, upright=True))
    assert held.ending is Ending.REACHED and held.happenings == ()
    assert held.last.angles == approx(2.0, abs=0.05)
    heights = [panel[:, 2].max() for panel in held.last.panels]
    assert heights[0] == approx(heights[1], abs=0.06)
    # Let go it leans over onto one of its panels.
    free = fold(build(made))
    heights = [panel[:, 2].max() for panel in free.last.panels]
    assert abs(heights[0] - heights[1]) > 0.1


def test_the_answer_does_not_hang_on_how_rigid_rigid_is():
    angles = []
    for rigid in (1e5, 1e7):
        made = structure(miura_vertex(np.radians(60), 0.1), contraction=0.01, gamma=1.0)
        angles.append(fold(build(made, rigid=rigid)).last.angles)
    np.testing.assert_allclose(*angles, atol=2e-4)


def test_units_of_measurement_change_nothing():
    pattern = squares([(0, 0), (1, 0), (2, 0)], fold=lambda cell, way: (-1) ** cell[0])
    small = Pattern(
        pattern.vertices * 1e-2, pattern.faces,
        [Crease(c.ends, c.fold, c.length * 1e-2) for c in pattern.creases],
    )  # fmt: skip
    first = fold(build(structure(pattern, contraction=0.03, gamma=1.0)))
    h, E = THICKNESS * 1e-2, 1e3 * MODULUS
    g = E * h**2 / (1.0 * 900 * 1e-6)
    second = fold(build(Structure.of(small, Layer(E, 900, h), Layer(E, 900, h, 0.03), g=g)))
    assert first.ending is second.ending is Ending.REACHED
    np.testing.assert_allclose(first.last.angles, second.last.angles, atol=1e-4)


def test_a_deadline_and_a_stop_end_a_path_with_their_reasons():
    made = structure(squares(CROSS), contraction=0.02)
    late = fold(build(made, deadline=core_seconds()))
    assert late.ending is Ending.TIMEOUT
    stopped = fold(build(made), stop=lambda state: state.e > 0.3)
    assert stopped.ending is Ending.STOPPED and 0.3 < stopped.last.e < 1
    short = fold(build(made), max_states=3)
    assert short.ending is Ending.TOO_LONG and len(short.states) == 3


def test_a_step_that_finds_no_state_is_tried_as_a_long_fall(monkeypatch):
    advance, failed = StableSteps.advance, []

    def once(self, scene, point, target):
        if point.e > 0.3 and not failed:
            failed.append(point.e)
            return Ended(Outcome.NO_STABLE_STATE)
        return advance(self, scene, point, target)

    monkeypatch.setattr(StableSteps, "advance", once)
    folding = folded(squares([(0, 0), (1, 0)]), 1.0, effects=())
    assert failed and folding.ending is Ending.REACHED
    assert folding.last.angles == approx(1.0, abs=1e-5)
    (happening,) = folding.happenings
    assert happening.kind == "snap" and happening.e > failed[0] and 0 < happening.size < 1
    monkeypatch.setattr(StableSteps, "advance", lambda *_: Ended(Outcome.NO_STABLE_STATE))
    monkeypatch.setattr(path, "_slowly", lambda *_: Ended(Outcome.NO_STABLE_STATE))
    lost = folded(squares([(0, 0), (1, 0)]), 1.0, effects=())
    assert lost.ending is Ending.LOST and len(lost.states) == 1


def test_a_long_fall_begins_half_a_step_ahead_and_is_told_in_lengths(monkeypatch):
    @dataclass(frozen=True)
    class At:
        x: np.ndarray
        e: float
        index: int
        events: tuple = ()

    tried = []

    def begin(self, scene, x, e, sign):
        tried.append((e, self.most))
        return At(x + np.array([0.03, -0.05, 9.0]), e, 0) if e > 0.37 else Ended(Outcome.NO_START)

    monkeypatch.setattr(StableSteps, "begin", begin)
    scene = SimpleNamespace(n_free=2, scales=SimpleNamespace(length=0.1))
    stepper = StableSteps(LoadSteps(1e-8, 0.1))
    for target, to in ((1.0, 0.4), (0.38, 0.38)):
        tried.clear()
        start = At(np.array([1.0, 2.0, 3.0]), 0.3, 7)
        there = path._slowly(stepper, SimpleNamespace(scene=scene), start, target)
        assert tried == [(approx(0.35), path.SLIDE), (approx(to), path.SLIDE)]
        (event,) = there.events
        # The last number is no displacement.
        assert (event.kind, event.e, event.size) == ("snap", approx(to), approx(0.5))
        assert there.index == 8 and event.vector == approx([0.03, -0.05, 9.0])


def test_absent_effects_are_absent():
    made = structure(two_panels())
    assert [t.name for t in build(made, ()).scene.terms] == ["elastic", "hinges"]
    names = [t.name for t in build(made).scene.terms]
    assert names == ["elastic", "hinges", "gravity", "ground", "contact"]


def test_what_cannot_be_built_is_told():
    made = structure(two_panels())
    with pytest.raises(ValueError, match="effect 'wind'"):
        build(made, ("wind",))
    with pytest.raises(ValueError, match="come together"):
        build(made, ("gravity",))
    apart = Pattern(
        [*two_panels().vertices, [3, 0], [4, 0], [3, 1]],
        [[0, 1, 4, 5], [1, 2, 3, 4], [6, 7, 8]], [Crease((1, 4), 1, 0.1)],
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"faces \[2\] hang together with the others by no crease"):
        build(structure(apart))
    with pytest.raises(ValueError, match="2 layers for 1 creases"):
        Structure.of(two_panels(), Layer(1, 1, 1), [Layer(1, 1, 1)] * 2)
