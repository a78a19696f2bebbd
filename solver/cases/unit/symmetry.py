"""Stability of a folding unit in the symmetry classes that the symmetries of its model hide.

A quarter hides perturbations odd about one of its mirror planes or about both: the latter keep the
half-turn about z. A half hides what is odd about its own plane, or under its half-turn.

A unit that stands on the ground may be able to tip over as a whole, with no elastic mode unstable.
That is told apart by Haynsworth's formula: with the rotations' rows C the number of unstable modes
is n₋(K) + n₋(−C K⁻¹ Cᵀ) − m, without them n₋(K).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from solver.cases.unit.model import Model, axis_nodes, opposite, plane
from solver.equilibrium.linear import SingularMatrix
from solver.equilibrium.scene import Scene
from solver.physics.supports import Tied, rotation_row

# What a mode does, by the symmetries that it keeps of a unit with both mirror planes.
CLASSES = {("x", "y"): "symmetric", ("y",): "sideways", ("x",): "rocking", ("turn",): "twisting"}


@dataclass(frozen=True)
class Check:
    """Unstable modes of one symmetry class, held upright and free to tip; None: not counted."""

    kept: tuple[str, ...]
    held: int | None
    free: int | None


def own_check(model: Model, x: np.ndarray, e: float, unstable: int | None) -> Check:
    """Counts in the model's own class, as :meth:`Symmetries.check` gives them for the others.

    The block of the bordered inverse at the rows of the rotations is −(C K⁻¹ Cᵀ)⁻¹.
    """
    names = [row.name for row in model.scene.rows]
    rows = [k for k, name in enumerate(names) if name in ("rotation x", "rotation y")]
    if not (rows and model.heavy) or unstable is None:
        return Check(model.mirrors, unstable, unstable)
    at = model.scene.n_free + np.array(rows)
    unit = np.zeros((model.scene.size, len(rows)))
    unit[at, np.arange(len(rows))] = 1.0
    try:
        block = model.scene.system(x, e).factorise().solve(unit)[at]
    except SingularMatrix:
        return Check(model.mirrors, unstable, None)
    tips = len(rows) - int((np.linalg.eigvalsh(block + block.T) < 0).sum())
    return Check(model.mirrors, unstable, unstable + tips)


class Symmetries:
    """The classes of a model that its symmetries hide: on its mesh, with other supports."""

    def __init__(self, model: Model):
        self.model = model
        hidden = {2: [("x",), ("y",), ("turn",)], 1: [()], 0: []}[len(model.mirrors)]
        tied = [Tied(*opposite(model.body), (1, 1, -1))] if model.mirrors == ("turn",) else []
        # Where both panels move the same way, their distance stays.
        apart = [t for t in model.terms if t.name != "contact"]
        bare = Scene(model.body, apart, tied=tied, scales=model.scene.scales) if hidden else None
        near = bare
        if model.contact is not None and ("y",) in hidden:
            near = Scene(model.body, model.terms, tied=tied, scales=model.scene.scales)
        # What a class holds are rows of the identity, so that one analysis does for all of them.
        self._scenes = {kept: near if "y" in kept else bare for kept in hidden}
        self._held = {
            kept: scene.unknowns(self._odd(kept, tied).astype(float)) > 0
            for kept, scene in self._scenes.items()
        }
        # Of the state asked about last: a point is judged where it is looked for and accepted.
        self._judged: tuple[np.ndarray, float, list[Check]] | None = None

    def _odd(self, kept: tuple[str, ...], tied: list[Tied]) -> np.ndarray:
        """Components (nodes, 3) that vanish in perturbations odd about the mirror planes that are
        not kept, or under the half-turn; and those that pin motions that cost nothing."""
        model, body = self.model, self.model.body
        held = np.zeros((len(body.nodes), 3), bool)
        if tied:
            held[axis_nodes(body), 2] = True
        for axis, name in enumerate("xy"):
            if name in model.mirrors:
                directions = [axis] if name in kept else [k for k in range(3) if k != axis]
                held[np.ix_(plane(body, axis), directions)] = True
        # Odd under the half-turn is neither a rotation about z nor a shift along it.
        impossible = [2, 5] if tied else []
        # Motions that cost nothing are pinned, each at one component: the inertia is the same for
        # any choice. Pins near the hinge keep their levers while the panels turn.
        near = np.flatnonzero(
            (np.abs(body.nodes[:, 1]) <= model.unit.hinge_length / 3) & (body.nodes[:, 2] < 1e-12)
        )
        near = np.setdiff1d(near, tied[0].nodes) if tied else near
        modes = [np.broadcast_to(k, body.nodes.shape) for k in np.eye(3)]
        modes += [np.cross(k, body.nodes) for k in np.eye(3)]
        idle = [0, 1, 5] if model.heavy else range(6)
        allowed = [
            modes[k]
            for k in idle
            if k not in impossible and not np.abs(modes[k][held]).max(initial=0) > 1e-12
        ]
        if allowed:
            candidates = np.array([(n, k) for n in near for k in range(3) if not held[n, k]])
            lever = np.array([[m[n, k] for n, k in candidates] for m in allowed])
            for pick in qr(lever, pivoting=True)[2][: len(allowed)]:
                held[tuple(candidates[pick])] = True
        return held

    def check(self, x: np.ndarray, e: float) -> list[Check]:
        """Counts in each hidden class at an equilibrium of the model."""
        if not self._scenes:
            return []
        if self._judged is None or self._judged[0] is not x or self._judged[1] != e:
            self._judged = x, e, self._checks(x, e)
        return list(self._judged[2])

    def _checks(self, x: np.ndarray, e: float) -> list[Check]:
        model = self.model
        u = model.scene.displacement(x, e)
        blocks = model.scene.evaluate(u, e, 2).stiffness
        checks = []
        for kept, scene in self._scenes.items():
            if model.contact is not None:
                blocks = scene.evaluate(u, e, 2).stiffness
            out = self._held[kept]
            try:
                factor = scene.system_of(blocks).holding(out).factorise()
            except SingularMatrix:
                checks.append(Check(kept, None, None))
                continue
            free = held = factor.negative
            rows = self._rows(kept, u) if model.heavy else []
            if rows and free is not None:
                C = np.where(out, 0.0, np.stack([scene.pulls(row) for row in rows]))
                S = C @ factor.solve(np.ascontiguousarray(C.T)).reshape(scene.size, len(C))
                held = free + int((np.linalg.eigvalsh(-(S + S.T)) < 0).sum()) - len(rows)
            checks.append(Check(kept, held, free))
        return checks

    def _rows(self, kept, u) -> list[np.ndarray]:
        """Coefficients of the rotations about x and y that the class can make."""
        mirrors, centred = self.model.mirrors, self.model.supports.centred
        odd = [m for m in mirrors if m not in kept]
        # A rotation about x is odd about the plane normal to y and even about that normal to x.
        # Both are odd under the half-turn about z.
        rows = []
        for axis, turns in ((0, "y"), (1, "x")):
            other = "x" if turns == "y" else "y"
            odd_about = turns not in mirrors or turns in odd
            even_about = other not in mirrors or other in kept
            if odd_about and even_about:
                rows.append(rotation_row(self.model.body, axis, u, centred).coefficients)
        return rows
