"""Steps of a body that comes down on a barrier.

A barrier acts within a short reach only, so the tangent of a body above it knows nothing of it: the
step leads far below the floor, and what a fraction-to-the-boundary rule leaves of it is a small
part, again and again as point after point comes down. The step that belongs to the body is the
least of its quadratic energy among those that stay above:

    min gᵀd + ½ dᵀK d  with  s + A d ≥ t,    d = −K⁻¹g + K⁻¹Aᵀλ,    λ ≥ 0,

with s the distances of the points from the floor and t what is to remain of them. It goes downhill
whatever t ≤ s, as d = 0 is admitted; λ solves a least-squares problem without negative unknowns in
the few points that come down (Lawson and Hanson 1974).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls

from solver.equilibrium.scene import Scene

KEPT = 0.3  # of a point's distance, or of the barrier's reach where it is farther off
LOWEST = 0.1  # of a point's distance, as barriers admit: what doesn't go below needs no push
MOST = 80  # points that are pushed in one step
ROUNDS = 12


def around(scene: Scene, solve: Callable, x: np.ndarray, dx: np.ndarray, e: float) -> np.ndarray:
    """The step (size,) from x, of a definite tangent with inverse ``solve``, that stays above the
    barriers; ``dx`` (size,), Newton's step, itself where it does, or where no such step comes out.
    """
    barriers = [term for term in scene.terms if hasattr(term, "distances")]
    others = [t for t in scene.terms if hasattr(t, "longest_step") and t not in barriers]
    u = scene.displacement(x, e)
    du = scene.step_displacement(dx) if others else None
    if not barriers or any(term.longest_step(u, du) < 1 for term in others):
        return dx
    distances = [term.distances(u) for term in barriers]
    s = np.concatenate(distances)
    reaches = np.concatenate(
        [np.full(len(d), t.range) for t, d in zip(barriers, distances, strict=True)]
    )
    needed = np.maximum(KEPT * np.minimum(s, reaches), LOWEST * s) - s
    first = np.cumsum([0, *(len(d) for d in distances)])

    def approach(d: np.ndarray) -> np.ndarray:
        du = scene.step_displacement(d)
        return np.concatenate([term.approach(du) for term in barriers])

    def push(point: int) -> np.ndarray:
        k = int(np.searchsorted(first, point, side="right")) - 1
        return scene.pulls(barriers[k].push(point - first[k]))

    plain = change = approach(dx)
    step, pushed = dx, np.empty(0, int)
    moves, lifts = np.empty((len(dx), 0)), np.empty((len(s), 0))
    for _ in range(ROUNDS):
        low = np.setdiff1d(np.flatnonzero(change < (LOWEST - 1) * s), pushed)
        if not len(low):
            return step
        # Lifting the deepest lifts its neighbours.
        low = low[np.argsort(change[low] / s[low])][:ROUNDS]
        if len(pushed) + len(low) > MOST:
            break
        more = solve(np.column_stack([push(point) for point in low]))
        pushed = np.append(pushed, low)
        moves = np.column_stack([moves, more])
        lifts = np.column_stack([lifts, *(approach(move) for move in more.T)])
        compliance = lifts[pushed]
        compliance = (compliance + compliance.T) / 2
        # A facet's centre moves as its nodes do: more points than there is freedom.
        compliance[np.diag_indices(len(pushed))] *= 1 + 1e-8
        try:
            root = np.linalg.cholesky(compliance)
            force, _ = nnls(root.T, np.linalg.solve(root, (needed - plain)[pushed]))
        except (np.linalg.LinAlgError, RuntimeError):
            break
        step, change = dx + moves @ force, plain + lifts @ force
    return dx
