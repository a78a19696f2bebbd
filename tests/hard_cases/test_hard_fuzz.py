"""Random designs over the whole design space: no crash, no hang, no NaN, no silent wrong answer.

Each path either ends in words or in a state that a second code path (solver.cases.unit.audit:
plain NumPy, complex steps, LAPACK, no supports) finds at rest, stable and of the energy that was
reported. ``FOLDLAB_FUZZ_HOURS=8 pytest tests/hard_cases -k fuzz`` goes on with further designs.
"""

import os
import time
from dataclasses import replace

import numpy as np
import pytest
from hard_scenes import COARSE, P

from foldlab.design import FULL, REDUCED
from foldlab.labels import foldability
from solver.cases.unit.audit import audit, faults
from solver.cases.unit.choices import Meshing, Physics, Supports, Watch
from solver.cases.unit.model import build, plane
from solver.cases.unit.path import Ending, fold
from solver.cases.unit.unit import EFFECTS, Unit
from solver.equilibrium.clock import core_seconds
from solver.equilibrium.descent import descend
from solver.equilibrium.scene import Scene
from solver.paths.continuation import load, trace
from solver.paths.steppers import LoadSteps
from solver.physics.supports import Fixed, Row

DESIGNS, BATCH, TIMEOUT = 40, 10, 30.0
SEED = 20


def designs(batch):
    """A batch of Latin-hypercube designs in the bounding box of the reduced and the full bounds."""
    ends = {p.name: (min(p.low, FULL[p.name].low), max(p.high, FULL[p.name].high)) for p in REDUCED}
    box = FULL.with_bounds(**ends)
    return [Unit(**row) for row in box.sample(BATCH, seed=SEED + batch).to_dict("records")]


def settings(k):
    """Weight every other time; contraction in all directions every fifth."""
    return Physics(EFFECTS if k % 2 else (), "isotropic" if k % 5 == 4 else "uniaxial")


def examine(unit, physics, timeout=TIMEOUT):
    """The folding of a design and the faults of its last state, or of how it ended."""
    begun = core_seconds()

    def stop(state):
        m = foldability.measure(state.curves, unit.hinge_length)
        return bool(foldability.Thresholds().closed(m.m1, m.m2))

    found = fold(build(unit, Meshing(0), physics, watch=Watch(begun + timeout)), stop=stop)
    # Its own seconds: a busy machine is no hang.
    spent, wrong = core_seconds() - begun, list(faults(found))
    if spent > timeout + 5:
        wrong.append(f"it took {spent:.1f} s, {timeout:g} were allowed")
    if not found.detail:
        wrong.append("it ended without a word")
    loads = [s.e for s in found.states]
    if not (np.diff(loads) > 0).all():
        wrong.append("loads do not rise along the path")
    if found.ending is Ending.REACHED and loads[-1] != 1.0:
        wrong.append(f"reached, but the load is {loads[-1]}")
    return found, wrong


def fuzz(batch):
    """Examines a batch; (endings, complaints)."""
    endings, complaints = [], []
    for k, unit in enumerate(designs(batch)):
        physics = settings(k)
        found, wrong = examine(unit, physics)
        endings.append(found.ending)
        complaints += [f"{unit} {physics}: {fault}" for fault in wrong]
    return endings, complaints


def judge(endings):
    """Most paths complete, and enough of them within their time to say so."""
    in_time = [end for end in endings if end is not Ending.TIMEOUT]
    assert len(in_time) >= 0.5 * len(endings), f"too few ended in time: {endings}"
    done = sum(end in (Ending.REACHED, Ending.STOPPED) for end in in_time)
    assert done >= 0.7 * len(in_time), endings


def test_a_batch_that_runs_out_of_time_or_gives_up_fails():
    """All of a batch out of time, or most of it given up: no fuzz passes on that."""
    for endings in ([Ending.TIMEOUT] * 10, [Ending.TIMEOUT] * 6 + [Ending.REACHED] * 4):
        with pytest.raises(AssertionError, match="too few ended in time"):
            judge(endings)
    with pytest.raises(AssertionError):
        judge([Ending.LOST] * 4 + [Ending.REACHED] * 6)
    judge([Ending.TIMEOUT] * 3 + [Ending.REACHED] * 5 + [Ending.STOPPED, Ending.LOST])


# Ten designs may each use their time.
@pytest.mark.timeout(2 * BATCH * TIMEOUT)
@pytest.mark.parametrize("batch", range(DESIGNS // BATCH))
def test_random_designs_end_in_audited_states_or_in_words(batch):
    """Forty designs of the full space in all, with and without weight, uniaxial and isotropic:
    every ending typed, every last state confirmed by the second code path, most paths complete."""
    endings, complaints = fuzz(batch)
    assert not complaints, "\n".join(complaints)
    judge(endings)


@pytest.mark.timeout(0)
@pytest.mark.skipif("FOLDLAB_FUZZ_HOURS" not in os.environ, reason="hours of it on demand only")
def test_fuzz_for_hours():
    """The same for as long as FOLDLAB_FUZZ_HOURS says, with designs of their own."""
    until = time.monotonic() + 3600 * float(os.environ["FOLDLAB_FUZZ_HOURS"])
    batch = DESIGNS // BATCH
    while time.monotonic() < until:
        complaints = fuzz(batch)[1]
        assert not complaints, "\n".join(complaints)
        batch += 1


def test_the_second_code_path_notices_what_is_wrong():
    """A state moved by 1e-4, an energy off by 1e-4, a count off by one, a design of other weight, a
    state that is not finite: each is a fault, and the state as it is has none."""
    unit = replace(P, contraction=0.1)
    found = fold(build(unit, Meshing(COARSE)))
    assert faults(found) == ()
    last = found.last

    def with_last(**changes):
        return replace(found, states=(*found.states[:-1], replace(last, **changes)))

    x = found.x.copy()
    x[: found.model.scene.n_free] += (
        1e-4 * np.random.default_rng(0).standard_normal(found.model.scene.n_free) * unit.slenderness
    )
    assert any("Newton step" in f for f in faults(replace(found, x=x)))
    assert any("energy" in f for f in faults(with_last(energy=last.energy * (1 + 1e-4))))
    odd = replace(last.checks[0], held=1)
    assert any("not 1" in f for f in faults(with_last(checks=(odd, *last.checks[1:]))))
    heavier = replace(found.model, unit=replace(unit, stiffness_to_weight=0.9))
    assert any("Newton step" in f for f in faults(replace(found, model=heavier)))
    assert faults(replace(found, x=np.full_like(found.x, np.nan))) == ("the state is not finite",)


def test_the_second_code_path_counts_unstable_modes():
    """Contracting in all directions Problem P passes a branch point on its symmetric path: the
    audit of the state beyond it has the solver's count, above 0, and before it 0."""
    model = build(P, Meshing(COARSE), Physics((), growth="isotropic"))
    counts = []
    for e in (0.2, 0.45):
        path = trace(
            model.scene,
            np.zeros(model.scene.size),
            LoadSteps(rtol=1e-6, step=0.1),
            until=load(e),
            max_steps=50,
            events=False,
        )
        whole, x = model.widened((), path.last.x, e)
        counts.append((audit(model, path.last.x, e).held, whole.scene.system(x, e).unstable))
    assert counts[0] == (0, 0) and counts[1][0] == counts[1][1] > 0


def test_the_second_code_path_sees_a_unit_lean():
    """A unit pushed over against the rows that hold it: the moment that it leans with is seen, and
    what is left beside it is at rest."""
    unit = replace(P, contraction=0.1)
    model = build(unit, Meshing(COARSE), supports=Supports(("x",)))
    found = fold(model)
    straight = audit(found.model, found.x, 1.0)
    rows = [
        replace(r, value=r.value + 1e-3) for r in found.model.scene.rows if r.name == "rotation x"
    ]
    rest = [r for r in found.model.scene.rows if r.name != "rotation x"]
    held = found.model
    scene = Scene(held.body, held.terms, fixed=_mirror(held), rows=[*rest, *rows])
    assert isinstance(rows[0], Row) and scene.size == held.scene.size
    pushed = descend(scene, found.x, 1.0, rtol=1e-8)
    assert pushed.converged
    leaning = audit(replace(held, scene=scene), pushed.x, 1.0)
    assert leaning.moment > 100 * straight.moment and leaning.moment > 0
    assert leaning.correction < 1e-6


def _mirror(model):
    return [
        Fixed(plane(model.body, "xy".index(m)), np.eye(3)["xy".index(m)]) for m in model.mirrors
    ]
