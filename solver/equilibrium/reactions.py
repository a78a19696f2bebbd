"""Reactions: what supports and rows exert on a body in equilibrium.

At a solution dE/du + Cᵀλ is zero where nothing is held; elsewhere it is the force of the supports
on the body. The rows' own forces are −Cᵀλ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.equilibrium.scene import Scene
from solver.given import node_numbers
from solver.physics.supports import Fixed, Row


@dataclass(frozen=True, eq=False)
class Reaction:
    """Resultant ``force`` (3,) and ``moment`` (3,), on the body, in the scene's units."""

    force: np.ndarray
    moment: np.ndarray


def reaction(
    scene: Scene,
    x: np.ndarray,
    e: float,
    at: Fixed | Row | np.ndarray,
    *,
    about: Sequence[float] = (0.0, 0.0, 0.0),
) -> Reaction:
    """What ``at`` exerts on the body in the equilibrium (x, e), such as a point of a path.

    ``at``: one of the scene's rows; a support, of which the part along its direction counts; or
    nodes (numbers, or a mask), where all supports count together. Moments are about the point
    ``about``, with the arms of the deformed state. The work-conjugate of a row's value is −λ. A
    scene with viscous terms must be the one of the step:
    :func:`solver.viscous.evolution.stepped`.

    Raises ValueError for a row of another scene, nodes that don't exist, and a state that a term
    does not admit.
    """
    u = scene.displacement(x, e)
    multipliers = x[scene.n_free :]
    if isinstance(at, Row):
        number = [k for k, row in enumerate(scene.rows) if row is at]
        if not number:
            raise ValueError(f"the row {at.name!r} is none of this scene's; take one of its rows")
        forces = -multipliers[number[0]] * np.asarray(at.coefficients, dtype=float)
    else:
        total = scene.evaluate(u, e, 1).force
        if total is None:
            raise ValueError("a term does not admit this state; give an equilibrium of the scene")
        for multiplier, row in zip(multipliers, scene.rows, strict=True):
            total = total + multiplier * row.coefficients
        nodes = node_numbers(at.nodes if isinstance(at, Fixed) else at, scene.n_nodes)
        forces = np.zeros_like(total)
        forces[nodes] = total[nodes]
        if isinstance(at, Fixed):
            d = np.asarray(at.direction, dtype=float)
            forces = np.outer(forces @ d, d) / (d @ d)
    arms = scene.body.nodes + u - np.asarray(about, dtype=float)
    return Reaction(forces.sum(axis=0), np.cross(arms, forces).sum(axis=0))
