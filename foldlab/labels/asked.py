"""What may be asked of a label from the solver, as frozen records: what acts, and what effort."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from foldlab.errors import InputError

EFFECTS = ("gravity,ground", "gravity,ground,contact", "contact", "none")


# 999 took two minutes to mesh, whatever the time allowed, and more memory than there was.
MOST_STRIPS = 50


@dataclass(frozen=True)
class Plan:
    """What an asked accuracy chooses: the finest of the meshes 0, 1, …, rad that the fold turns by
    in a step, and the tolerance of Newton's method."""

    finest: int
    turn: float = 0.5
    tolerance: float = 1e-6
    element: str = "hex27"


# By the accuracy from which on they hold. Below 0.01 the path's mesh counts for nothing, and the
# error is that of two finer ones. Longer steps and looser tolerances save little: on 14 designs the
# median was 1.6, 1.5 and 2.1 core-seconds at 0.5 rad and 1e-6, 0.7 and 1e-5, 1.0 and 1e-4.
PLANS = {0.01: Plan(2), 0.0: Plan(3)}


def check_strips(strips: float) -> int:
    """Their number; raises :class:`InputError` for none of 0 … :data:`MOST_STRIPS`."""
    if not (0 <= strips <= MOST_STRIPS and float(strips).is_integer()):
        raise InputError(
            f"strips = {strips:g}; expected a whole number up to {MOST_STRIPS}: each adds 1200 "
            "unknowns"
        )
    return int(strips)


@dataclass(frozen=True)
class Conditions:
    """What acts on a unit, how its active layer contracts and is patterned, and what holds it.

    ``effects``: one of :data:`EFFECTS`; "contact" is that of the panels with each other.
    ``upright``: whether the unit is held against toppling. ``strips``: active strips side by side
    along the hinge that cover ``strip_share`` of its width (0: a solid layer). ``barrier``: the
    ground's, "surface" or the dissertation's "exponential" (Eq. 4.5). ``friction``: coefficient μ
    of the ground, 0 for none. Raises :class:`InputError` for names that are not there, for more
    than :data:`MOST_STRIPS`, and for friction without the surface's ground.
    """

    effects: str = "gravity,ground"
    growth: Literal["uniaxial", "isotropic"] = "uniaxial"
    upright: bool = True
    strips: int = 0
    strip_share: float = 0.5
    barrier: Literal["surface", "exponential"] = "surface"
    friction: float = 0.0

    def __post_init__(self):
        if self.growth not in ("uniaxial", "isotropic"):
            raise InputError(f"growth {self.growth!r}; expected 'uniaxial' or 'isotropic'")
        if self.effects not in EFFECTS:
            raise InputError(
                f"effects {self.effects!r}; expected one of {', '.join(map(repr, EFFECTS))}: "
                "weight and ground come together"
            )
        check_strips(self.strips)
        if self.barrier not in ("surface", "exponential"):
            raise InputError(f"barrier {self.barrier!r}; expected 'surface' or 'exponential'")
        if not 0 <= self.friction < np.inf:
            raise InputError(
                f"friction = {self.friction:g}; expected a number from 0 on, such as 0.3"
            )
        if self.friction and not (self.heavy and self.barrier == "surface"):
            raise InputError(
                f"friction = {self.friction:g} acts where a sheet presses on the ground: it needs "
                "weight and ground among the effects, and the barrier 'surface'"
            )

    @property
    def terms(self) -> tuple[str, ...]:
        """Effects as the solver takes them."""
        return () if self.effects == "none" else tuple(self.effects.split(","))

    @property
    def heavy(self) -> bool:
        """Whether weight acts."""
        return "gravity" in self.terms


@dataclass(frozen=True)
class Changing:
    """What the materials become until the full contraction, in proportion to it (§4.8.4).

    ``active_stiffness``, ``passive_stiffness``, ``active_density``, ``passive_density``: factors
    that are reached on E and on ρ (per volume of the flat state). ``passive_expansion``: strain
    that the sheet grows by in the directions in which the active layer contracts; negative shrinks.
    Raises :class:`InputError` for factors that are not above 0 and a strain not above −1.
    """

    active_stiffness: float = 1.0
    passive_stiffness: float = 1.0
    active_density: float = 1.0
    passive_density: float = 1.0
    passive_expansion: float = 0.0

    def __post_init__(self):
        for name, value in vars(self).items():
            least = -1.0 if name == "passive_expansion" else 0.0
            if not least < value <= 1e6:
                raise InputError(
                    f"{name} = {value!r}; expected a number above {least:g}, at most 1e6"
                )

    def at_end(self, design: Mapping[str, float]) -> dict[str, float]:
        """The groups of a design as they are at the full contraction."""
        factors = {
            "E_ratio": self.active_stiffness / self.passive_stiffness,
            "rho_ratio": self.active_density / self.passive_density,
            "stiffness_to_weight": self.passive_stiffness / self.passive_density,
        }
        return {name: value * factors.get(name, 1.0) for name, value in design.items()}


@dataclass(frozen=True)
class Effort:
    """How well a label is to be known, and what that may take.

    ``accuracy``: error that is asked for, of the fold angle and of the turning across the hinge,
    relative to the angle or to what counts as folded (|g|π), whichever is larger; meshes are
    refined until two of them agree so well, at most to the third, below 0.01 or where the verdict
    hangs on the error to the fourth.
    ``timeout``: core-seconds per label, after which it is unknown; what compiling takes, at the
    first label on a machine, is not counted. ``refine``: "always"; "near" a threshold only and
    where the coarsest path is in doubt, see :mod:`foldlab.labels.screening`; or "never". What is
    not refined states an error that was calibrated on other designs. ``sensitivity``: state how the
    last state changes with every group, too, see :meth:`foldlab.labels.run.Run.sensitivity`.
    ``whole``: follow isotropic paths to the full contraction even where they have curled too far to
    come back, see :func:`foldlab.labels.verdict.curled_away`. Raises :class:`InputError` for other
    values.
    """

    accuracy: float = 0.02
    timeout: float = 60.0
    refine: Literal["always", "near", "never"] = "always"
    sensitivity: bool = False
    whole: bool = False

    def __post_init__(self):
        for name in ("accuracy", "timeout"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} = {value!r}; expected a finite number above 0")
        if self.accuracy >= 1:
            raise InputError(f"accuracy = {self.accuracy!r}; expected a relative error below 1")
        if self.refine not in ("always", "near", "never"):
            raise InputError(f"refine {self.refine!r}; expected 'always', 'near' or 'never'")

    @property
    def plan(self) -> Plan:
        """Meshes, steps and tolerance for the accuracy."""
        return next(plan for least, plan in PLANS.items() if self.accuracy >= least)
