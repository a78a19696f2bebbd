"""How a state of a folding unit changes with its groups, at the price of a few triangular solves.

At an equilibrium R(x, p) = 0 a small change of a group p moves the state by

    dx/dp = −K⁻¹ ∂R/∂p,

with the tangent K of the last iteration, factorised once for all groups. ∂R/∂p is a central
difference of the forces of two neighbouring units that are displaced alike (semi-analytical
differentiation; Haftka and Gürdal, *Elements of Structural Optimization*, ch. 7): geometry enters
through the meshes themselves, which keep their topology. What is asked of a state is then a central
difference of the two neighbours, so that any measure has its derivative, explicit parts included.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from solver.cases.unit.mesh import Curves
from solver.cases.unit.model import Model, acting, body_of
from solver.cases.unit.unit import Unit
from solver.paths.sensitivity import Sensitivity

GROUPS = tuple(f.name for f in fields(Unit) if f.name not in ("nu", "strips", "strip_share"))
# Of these the mesh knows nothing.
MATERIAL = ("E_ratio", "rho_ratio", "stiffness_to_weight", "contraction")
# Relative changes of groups that a mesh knows and of others: a central difference is off by their
# square, and membrane forces of a sheet that is displaced as before make much of a changed length.
CHANGE = {False: 1e-5, True: 1e-4}


@dataclass(frozen=True, eq=False)
class Neighbours:
    """A state beside an equilibrium on either side, to first order in one group.

    ``apart``: by how much the group differs between them; ``below``, ``above``: model and unknowns.
    """

    group: str
    apart: float
    below: tuple[Model, np.ndarray]
    above: tuple[Model, np.ndarray]


def neighbours(
    model: Model, x: np.ndarray, e: float, groups: tuple[str, ...] = GROUPS
) -> Iterator[Neighbours]:
    """The neighbours of an equilibrium x (size,) of a unit at the load e, group by group.

    Groups that cannot change without another number of elements are left out, such as the width of
    a hinge that is as wide as its panels. The load is the fraction e of the contraction, whatever
    that is. Raises ValueError
    for friction, which remembers, and for a mesh of one's own;
    :class:`solver.equilibrium.linear.SingularMatrix` at a critical point.
    """
    if model.physics.friction:
        raise ValueError("a state with friction hangs on its whole path, and has no derivatives")
    if not model.meshing.structured:
        raise ValueError("a mesh of one's own does not follow the groups, and has no derivatives")
    scene = model.scene
    u = scene.displacement(x, e)
    answers = Sensitivity(scene, scene.system(x, e))
    for name in groups:
        value, change = getattr(model.unit, name), CHANGE[name in MATERIAL]
        low, high = (_beside(model, name, value * (1 + s * change)) for s in (-1, 1))
        if low is None or high is None:
            continue
        apart = getattr(high.unit, name) - getattr(low.unit, name)
        rate = answers.rate((_force(high, u, e) - _force(low, u, e)) / apart)
        yield Neighbours(
            name,
            apart,
            *((one, x + (getattr(one.unit, name) - value) * rate) for one in (low, high)),
        )


def _beside(model: Model, name: str, value: float) -> Model | None:
    """The model of a unit with one group changed, held as this one is; None where that is no unit
    or has other elements."""
    try:
        unit = replace(model.unit, **{name: value})
    except ValueError:
        return None
    body = model.body
    if name not in MATERIAL:
        body = body_of(unit, model.meshing, model.physics, model.supports.cuts)
    same = body.cells.shape == model.body.cells.shape
    if not (same and np.array_equal(body.cells, model.body.cells)):
        return None
    terms, ground, contact = acting(unit, model.physics, model.supports, body)
    lines = model.lines if body is model.body else Curves(unit, body, model.mirrors)
    return replace(
        model, unit=unit, body=body, terms=tuple(terms), ground=ground, contact=contact,
        lines=lines,
    )  # fmt: skip


def _force(model: Model, u: np.ndarray, e: float) -> np.ndarray:
    """Of all terms on the nodes (nodes, 3) that are displaced by u."""
    return sum(t.evaluate(u, e, 1).force for t in model.terms)
