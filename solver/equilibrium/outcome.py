"""How an iteration or a path ends."""

from __future__ import annotations

from enum import Enum


class Outcome(Enum):
    """How an iteration or a path ended; the value is a sentence for people."""

    CONVERGED = "the iteration met its tolerance"
    REACHED = "the path reached its target"
    NOT_CONVERGED = "the iteration did not meet its tolerance in the iterations it was allowed"
    SINGULAR = "the tangent is singular: something can move freely, or this is a critical point"
    INADMISSIBLE = (
        "the state is not admissible (an inverted element, a node beyond a barrier), and a shorter "
        "step does not help"
    )
    STAGNATED = (
        "the corrections stopped shrinking above the tolerance: roundoff; ask for a looser rtol"
    )
    ILL_CONDITIONED = (
        "the stiffness is singular, or too ill-conditioned for floating-point numbers (a body far "
        "too thin, or far too unlike in its stiffness): what the linear solve gave is roundoff"
    )
    NO_PROGRESS = "no step along the correction, however short, came nearer to equilibrium"
    NO_STABLE_STATE = "the energy fell without coming to rest in a stable equilibrium"
    NO_START = "there is no equilibrium near the start at its load; the path has no points"
    NO_EQUILIBRIUM = "the start, at its target, is no equilibrium of the scene; give x as a guess"
    MIN_STEP = "the step fell below its minimum; the path stops at the last converged point"
    MAX_STEPS = "the steps allowed were used up; the path stops at the last converged point"
    OUT_OF_BOUNDS = "the load left its bounds; the path stops at the last point within them"
    DISSIPATION = (
        "the dashpots gave energy instead of taking it, and a shorter step does not help; the path "
        "stops at the last state before"
    )
    NO_BRANCH = "no second branch was found along the critical vector"
