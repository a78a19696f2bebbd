"""Folding units that several tests follow, and how they ask for the end of a path."""

from dataclasses import replace

from foldlab.labels import foldability
from solver.cases.unit.mesh import Sizes
from solver.cases.unit.path import Ending, fold
from solver.cases.unit.unit import Unit

# Problem P, on whose angles two independent codes agree within 0.1 %.
P = Unit(
    E_ratio=0.1, rho_ratio=1.0, hinge_length=0.2, hinge_width=1.0, h_ratio=5.0,
    stiffness_to_weight=1.0, aspect=0.2, slenderness=4e-3, contraction=0.3,
)  # fmt: skip
HEAVY = replace(P, hinge_length=0.25, stiffness_to_weight=0.1)
NARROW = replace(P, hinge_width=0.4, h_ratio=0.7, aspect=0.3, rho_ratio=2.0)
COARSE = Sizes(0.5, 3, 1.6, 0.0, 3.0, 1)
COARSEST = Sizes(2.5, 6, 2.0, 0.0, 6.0, 1)


def angle(folding):
    """m1 of the last state in rad."""
    last = folding.last
    return foldability.measure(last.curves, folding.model.unit.hinge_length).m1


def reached(model, **options):
    """The path of a model that reaches the full contraction in a stable state."""
    found = fold(model, **options)
    assert found.ending is Ending.REACHED, found.detail
    assert found.last.unstable == 0
    return found
