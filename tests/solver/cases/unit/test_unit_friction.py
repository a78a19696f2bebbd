"""Friction of the ground under a folding unit: where it matters, and that it is absent else."""

import numpy as np
import pytest
from folding_units import NARROW

from solver.cases.unit.audit import audit
from solver.cases.unit.choices import Meshing, Physics, Supports, Watch
from solver.cases.unit.model import SLIP, build
from solver.cases.unit.path import Ending, fold
from solver.cases.unit.unit import Unit

# Its panels sag, and their ends slide on the ground.
SAGS = Unit(
    E_ratio=0.1, rho_ratio=1.0, hinge_length=0.3, hinge_width=1.0, h_ratio=2.0,
    stiffness_to_weight=0.05, aspect=0.3, slenderness=0.01, contraction=0.05,
)  # fmt: skip


def turned(unit, friction, watch=Watch()):
    model = build(unit, Meshing(level=0), Physics(friction=friction), watch=watch)
    path = fold(model)
    assert path.ending is Ending.REACHED and path.last.unstable == 0
    t = np.diff(path.last.curves[0], axis=0)
    angles = np.unwrap(np.arctan2(t[:, 2], t[:, 1]))
    return angles[-1] - angles[0], path


def test_a_unit_without_friction_has_no_such_term():
    model = build(NARROW, Meshing(level=0), Physics(), Supports())
    assert "friction" not in model.effects
    rubbed = build(NARROW, Meshing(level=0), Physics(friction=0.3), Supports())
    assert rubbed.effects == (*model.effects, "friction")
    assert rubbed.terms[-1].slip == SLIP * NARROW.slenderness


def test_friction_holds_back_ends_that_slide_and_the_more_the_larger_it_is():
    free, _ = turned(SAGS, 0.0)
    little, _ = turned(SAGS, 1e-3)
    assert little == pytest.approx(free, rel=1e-3)
    angles = [free, *(turned(SAGS, mu)[0] for mu in (0.5, 2.0))]
    assert np.diff(angles).min() > 1e-4 or np.diff(angles).max() < -1e-4
    assert abs(angles[-1] - free) > 0.01 * abs(free)


def test_pulls_are_taken_along_the_path_and_timed_like_other_terms():
    clock = {}
    _, path = turned(SAGS, 0.5, Watch(clock=clock))
    assert clock["friction"][0] > path.iterations
    model, x, e = path.model, path.x, path.last.e
    (friction,) = (t for t in model.terms if t.name == "friction")
    u = model.scene.displacement(x, e)
    force = friction.evaluate(u, e, 1).force
    # By symmetry the quarter's pulls do not sum to 0; none exceeds μ of what presses.
    assert np.abs(force[:, :2]).max() > 0
    pressing = model.ground.pressing(u)
    after = model.anchored(x, e)
    (next_,) = (t for t in after.terms if t.name == "friction")
    pulled = np.linalg.norm(next_.evaluate(u, e, 1).force[:, :2], axis=1).sum()
    assert pulled <= 0.5 * pressing.sum() * (1 + 1e-9)
    assert next_.stuck is not friction.stuck


@pytest.mark.parametrize(
    "given", [{"friction": -0.1}, {"friction": np.nan}, {"friction": 0.3, "effects": ()},
              {"friction": 0.3, "barrier": "exponential"}],
)  # fmt: skip
def test_friction_needs_a_ground_that_is_pressed_on(given):
    with pytest.raises(ValueError, match="friction"):
        Physics(**given)


def test_the_second_look_does_not_judge_what_it_does_not_know():
    _, path = turned(SAGS, 0.5)
    with pytest.raises(ValueError, match="friction"):
        audit(path.model, path.x, path.last.e)
