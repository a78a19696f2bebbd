"""Why an iteration found no equilibrium, in words: what a path says where it ends.

The outcome says what the iteration met; the state that it ended in often tells the cause, such as
growth that turns a body inside out, or a part that nothing holds any more.
"""

from __future__ import annotations

from solver.equilibrium.newton import NewtonResult
from solver.equilibrium.outcome import Outcome
from solver.equilibrium.scene import Scene
from solver.paths.point import Ended

JUMPED = "it came to an equilibrium that the path does not lead to"
NO_TANGENT = "the path has no tangent at the equilibrium that it came to"


def no_result(scene: Scene, result: NewtonResult, outcome: Outcome | None = None) -> Ended:
    """The end of a path at an iteration that failed, with its own outcome if none is given."""

    def why():
        what = scene.obstacle(result.x, result.e) or (
            "" if outcome is None else result.outcome.value
        )
        at = f"at e = {result.e:.6g}"
        return f"{at}: {what}" if what else at

    return Ended(outcome or result.outcome, why=why)


def no_step(scene: Scene, result: NewtonResult | None, met: str) -> Ended:
    """The end of a path whose steps became too short, after a last one that came to ``result``.

    ``met``: what was wrong with it where it had converged.
    """
    if result is None:
        return Ended(Outcome.MIN_STEP)
    if result.outcome is Outcome.ILL_CONDITIONED:
        return no_result(scene, result)

    def why():
        what = (
            met if result.converged else scene.obstacle(result.x, result.e) or result.outcome.value
        )
        return f"the last try, to e = {result.e:.6g}, failed: {what}"

    return Ended(Outcome.MIN_STEP, why=why)
