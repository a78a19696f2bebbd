"""Why a path ended, in words: what was met at the last try, and what the state tells."""

from types import SimpleNamespace

import pytest

from solver.equilibrium.outcome import Outcome
from solver.paths.reasons import no_result, no_step


def scene(obstacle=""):
    return SimpleNamespace(obstacle=lambda x, e: obstacle)


def result(outcome, converged=False):
    return SimpleNamespace(x=0, e=0.25, outcome=outcome, converged=converged)


@pytest.mark.parametrize(
    ("obstacle", "given", "says"),
    [
        ("a cell is inverted", None, "at e = 0.25: a cell is inverted"),
        ("", None, "at e = 0.25"),
        ("", Outcome.MIN_STEP, f"at e = 0.25: {Outcome.NO_PROGRESS.value}"),
        ("a cell is inverted", Outcome.MIN_STEP, "at e = 0.25: a cell is inverted"),
    ],
)
def test_an_iteration_that_failed_says_where_and_what_it_met(obstacle, given, says):
    ended = no_result(scene(obstacle), result(Outcome.NO_PROGRESS), given)
    assert ended.outcome is (given or Outcome.NO_PROGRESS) and ended.why() == says


def test_steps_that_became_too_short_tell_of_the_last_try():
    assert no_step(scene(), None, "jumped").outcome is Outcome.MIN_STEP
    jumped = no_step(scene("x"), result(Outcome.NO_PROGRESS, converged=True), "it jumped")
    assert jumped.why() == "the last try, to e = 0.25, failed: it jumped"
    for obstacle, told in (("a cell is inverted",) * 2, ("", Outcome.NO_PROGRESS.value)):
        ended = no_step(scene(obstacle), result(Outcome.NO_PROGRESS), "it jumped")
        assert ended.outcome is Outcome.MIN_STEP
        assert ended.why() == f"the last try, to e = 0.25, failed: {told}"
    ill = no_step(scene("nothing holds it"), result(Outcome.ILL_CONDITIONED), "it jumped")
    assert ill.outcome is Outcome.ILL_CONDITIONED and ill.why() == "at e = 0.25: nothing holds it"
