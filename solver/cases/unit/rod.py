"""The folding unit as a planar rod: a first answer in a millisecond, before any solid is meshed.

Half of the sheet is a rod without stretch that bends by any angle, under its weight, on one-sided
ground (:mod:`solver.cases.unit.rod_kernel`). What it is made of:

- Panels: B = E_s h_s³/12 per width b_s, as of a narrow strip; weight ρ_s g h_s b_s.
- Hinge: natural curvature κ, stiffness B and stretch λ₀ of the bilayer in exact pure bending at
  finite strain (:mod:`solver.cases.unit.section`), per width b_i; B of a narrow strip, (1 − ν²) of
  that in plane strain. For layers of one ν neither κ nor λ₀ depends on the width, and the hinge
  does not curl across. The active layer's weight acts at its own height.
- Ends of the hinge. Where the active layer ends, the stress in it dies away over a length of the
  order of its thickness. Of the end as a whole the rod needs two numbers, functions of h_i/h_s and
  E_i/E_s: how far it turns beyond what κ l_i says, ψ(c), and its rotation per moment beyond what
  B says. They come from the solid in plane strain, ν = 0.3 (``hinge_ends.csv``,
  made by ``python -m experiments.rod_accuracy --set write=true``). A stiff thick
  layer bends nothing and turns the sheet by 3 c at its two ends; a soft one ends early and is weak
  there.

What it cannot feel: whatever happens across the sheet (curling, warping, twisting, isotropic
contraction), a panel that is wider than its hinge, ends that overlap in a short thick hinge, and
contact of the panels. Measured against labels of the solid, see :meth:`Bent.error`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from enum import Enum
from functools import lru_cache
from pathlib import Path

import numpy as np

from solver.cases.unit import rod_kernel as kernel
from solver.cases.unit.section import natural
from solver.cases.unit.unit import Unit

NU = 0.3  # of the table of ends
STATES = 400
# Longest and shortest step of e, tolerance and most turn against what was expected, in rad.
RULES = (0.34, 1e-4, 1e-6, 0.3)
# Quantile regression for 95 % of 1874 of the uniaxial labels of gravity-5k whose rod reached the
# full contraction without a jump, then raised, as 30 fresh designs did not keep it: of all 3759
# labels 97.5 % lie within, of those that sag 88 %. ``python -m experiments.rod_accuracy`` counts.
ERROR = (0.03, 0.05, 0.1, 0.15)
# Least stiffness of the softest symmetric mode, over its bending stiffness alone, at which a path
# counts as steady: 0 at a limit point, 1 without weight.
STEADY = 0.1


class Ending(Enum):
    """Why a rod's path ended where it did."""

    REACHED = "the full contraction was reached"
    CLOSED = "the fold made a full turn"
    LOST = "no stable equilibrium was found"
    TOO_LONG = "the states allowed were used up"


_ENDINGS = {
    kernel.REACHED: Ending.REACHED,
    kernel.CLOSED: Ending.CLOSED,
    kernel.LOST: Ending.LOST,
    kernel.TOO_LONG: Ending.TOO_LONG,
}


@dataclass(frozen=True, eq=False)
class Bent:
    """The path of a unit as a rod, each angle of the whole sheet in rad, lengths in l_s.

    ``angle``: net turning (m1); ``hinge``: within the hinge; ``natural``: what the free hinge would
    turn by; ``discretisation``: error of ``angle``, from a rod of twice as many intervals, which
    gave it. ``states``: a row per state, see the kernel's columns. ``s``, ``turns`` and ``height``:
    arc lengths (n + 1) of the nodes, turns (n) of the intervals of the half and height of its
    middle in the last state.
    """

    unit: Unit
    ending: Ending
    states: np.ndarray = field(repr=False)
    angle: float
    hinge: float
    natural: float
    discretisation: float
    iterations: int
    seconds: float
    s: np.ndarray = field(repr=False)
    turns: np.ndarray = field(repr=False)
    height: float

    @property
    def settled(self) -> bool:
        """Whether it ended in a stable state that answers the question."""
        return self.ending in (Ending.REACHED, Ending.CLOSED)

    @property
    def e(self) -> float:
        """Load of the last state."""
        return float(self.states[-1, kernel.LOAD]) if len(self.states) else 0.0

    @property
    def snaps(self) -> list[float]:
        """Loads at which it jumped."""
        rows = self.states[self.states[:, kernel.SNAP] > 0]
        return rows[:, kernel.LOAD].tolist()

    @property
    def softness(self) -> float:
        """Least stiffness of the softest symmetric mode on the path, over its bending stiffness."""
        return float(self.states[:, kernel.SOFTNESS].min(initial=np.inf))

    @property
    def error(self) -> float:
        """Of ``angle`` against the solid, in rad: what most of the designs of :data:`ERROR` keep.

        A fraction of the angle, of the contraction, of what the weight takes from the natural turn
        (over the softness, as what is nearly unstable multiplies errors), and of the natural turn
        where the layers are thick against the hinge's length, so that its ends overlap.
        """
        u = self.unit
        taken = abs(self.natural - self.angle) / min(max(self.softness, 0.01), 1.0)
        thick = (u.slenderness + u.active) / u.hinge_length
        parts = abs(self.angle), u.contraction, taken, abs(self.natural) * thick
        return float(np.dot(ERROR, parts)) + self.discretisation

    @property
    def steady(self) -> bool:
        """Whether the path from flat met neither a limit point nor a loss of symmetric stability,
        and was never near one."""
        return self.settled and not self.snaps and self.softness > STEADY

    @property
    def topples(self) -> bool:
        """Whether the last state would rock over if let go."""
        return bool(self.states[-1, kernel.ROCKING])


@lru_cache(maxsize=1)
def _ends_table() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = np.loadtxt(
        Path(__file__).parent / "data" / "hinge_ends.csv",
        delimiter=",",
        skiprows=1,
        encoding="utf-8",
    )
    m, n = np.unique(rows[:, 0]), np.unique(rows[:, 1])
    return m, n, np.ascontiguousarray(rows[:, 2:].reshape(len(m), len(n), 4))


def ends(h_ratio: float, E_ratio: float) -> np.ndarray:
    """ψ/c of one end of the hinge at c = 0, 0.2 and 0.4, and its rotation per M/(E_s h_s²).

    M per width; plane strain, ν = 0.3. Raises ValueError outside of the table.
    """
    *axes, table = _ends_table()
    weights, starts = [], []
    for name, value, axis in zip(("h_ratio", "E_ratio"), (h_ratio, E_ratio), axes, strict=True):
        at = (np.log10(value) - axis[0]) / (axis[1] - axis[0])
        if not -1e-9 <= at <= len(axis) - 1 + 1e-9:
            raise ValueError(
                f"{name} = {value:g}; the rod knows the hinge's ends from {10 ** axis[0]:g} to "
                f"{10 ** axis[-1]:g}"
            )
        start = min(max(int(at) - 1, 0), len(axis) - 4)
        weights.append(_cubic(at - start))
        starts.append(start)
    (i, j), (x, y) = starts, weights
    return np.einsum("i,j,ijk->k", x, y, table[i : i + 4, j : j + 4])


def _cubic(t: float) -> np.ndarray:
    """Weights of the values at 0, 1, 2 and 3 in the cubic through them at t."""
    a, b, c = t - 1, t - 2, t - 3
    return np.array([-a * b * c / 6, t * b * c / 2, -t * a * c / 2, t * a * b / 6])


@dataclass(frozen=True)
class _Hinge:
    """What the kernel's ``set_load`` takes after the intervals."""

    table: np.ndarray
    end: float

    @classmethod
    def of(cls, unit: Unit) -> _Hinge | None:
        """None where the section has no natural state."""
        at_ends, section = ends(unit.h_ratio, unit.E_ratio), np.zeros((4, 3))
        if not natural(unit.h_ratio, unit.E_ratio, unit.contraction, unit.nu, section):
            return None
        h, narrow = unit.slenderness, 1 - unit.nu**2
        c = unit.contraction * np.arange(4) / 3
        t = c / 0.2
        turn = at_ends[0] * (t - 1) * (t - 2) / 2 + at_ends[1] * t * (2 - t)
        turn += at_ends[2] * t * (t - 1) / 2
        table = np.stack([section[:, 0] / h, section[:, 1] * narrow, section[:, 2], c * turn], 1)
        return cls(np.ascontiguousarray(table), float(at_ends[3]) * h / narrow)


def _parts(unit: Unit, heavy: bool, lengths: np.ndarray, hinge: int):
    """Intervals, nodes and ground as the kernel takes them, forces in E_s h_s³ b_s/l_s²."""
    n, h, heaped = len(lengths), unit.slenderness, unit.rho_ratio * unit.h_ratio
    rods = np.stack([lengths, 1 / (12 * lengths), np.zeros(n)], axis=1)
    nodes = np.zeros((n + 1, 3))
    ground = np.array([0.0, 0.2 * h, 0.1 * h, h / 2])
    if heavy:
        per_length = np.ones((n, 3))
        per_length[:hinge, kernel.WEIGHT] = unit.hinge_width * (1 + heaped)
        per_length[:hinge, kernel.AREA] = unit.hinge_width
        per_length[:, kernel.OFFSET] = 0.0
        lever = (1 + unit.h_ratio) / 2 * h
        per_length[:hinge, kernel.OFFSET] = unit.hinge_width * heaped * lever
        per_length[:, [kernel.WEIGHT, kernel.OFFSET]] /= unit.stiffness_to_weight
        halves = per_length * lengths[:, None] / 2
        nodes[:-1] += halves
        nodes[1:] += halves
        # At the middle of the barrier it bears the weight of the hinge.
        ground[kernel.KAPPA] = (1 + heaped) / unit.stiffness_to_weight / -_MIDDLE
    return rods, nodes, ground


# Slope of the ground's barrier b at the middle of its range.
_MIDDLE = np.log(0.5) - 0.5


def bend(unit: Unit, *, heavy: bool = True) -> Bent:
    """The stable path of a unit as a rod, from flat, at rest, to its contraction.

    ``heavy``: with weight and ground. Raises ValueError for what the rod does not know: strips, ν
    other than 0.3, layers outside of the table of ends.
    """
    begun = time.perf_counter()
    if unit.strips or unit.nu != NU:
        raise ValueError(
            f"strips = {unit.strips} and nu = {unit.nu:g}; the rod knows solid layers with "
            f"nu = {NU:g} only"
        )
    made, half = _Hinge.of(unit), unit.hinge_length / 2
    if made is None:
        return Bent(unit, Ending.LOST, np.empty((0, 8)), *[np.nan] * 4, 0, 0.0, *_NOTHING)
    free = float(made.table[-1, 0] * half + made.table[-1, 3])
    hinge, panel = int(np.clip(np.ceil(min(abs(free), np.pi) / 0.2), 6, 16)), 8
    if heavy:
        # Weight bends a panel over the length (B/w)^⅓, here with B = 1/12 and w = 1/Γ.
        least = (unit.stiffness_to_weight / 12) ** (1 / 3)
        panel = int(np.clip(np.ceil(5 * (0.5 - half) / least), 12, 36))
    lengths = np.repeat([half / hinge, (0.5 - half) / panel], [hinge, panel])
    x, history = np.zeros(len(lengths) + 1), np.empty((STATES, 8))
    rules = (min(0.25, 0.25 / max(abs(free), 1e-9)), *RULES)
    hinge_parts = unit.hinge_width, made.table, made.end
    ending, count, iterations = kernel.follow(
        lengths, hinge, *hinge_parts, *_parts(unit, heavy, lengths, hinge), rules, x, history
    )
    states = history[:count].copy()
    if not count:
        return Bent(
            unit, _ENDINGS[ending], states, *[np.nan] * 4, iterations,
            time.perf_counter() - begun, *_NOTHING,
        )  # fmt: skip
    # The last state once more on intervals of half the length.
    coarse = lengths, x.copy()
    angle, turned = states[-1, [kernel.TIP_ANGLE, kernel.HINGE_ANGLE]]
    lengths = np.repeat(lengths / 2, 2)
    x = np.concatenate([x[:1], np.repeat(x[1:] / 2, 2)])
    parts, n = _parts(unit, heavy, lengths, 2 * hinge), len(lengths)
    kernel.set_load(states[-1, kernel.LOAD], lengths, 2 * hinge, *hinge_parts, parts[0])
    shape, scratch = np.zeros((6, n + 1)), (np.zeros((3, n + 1)), np.zeros((n + 1, 3)))
    lift = 0.01 * unit.slenderness
    while not np.isfinite(kernel.energy(x, *parts, shape)) and lift < 1:
        # Between the coarser nodes it lies below the floor; of a sheet that is very long against
        # its thickness, by many thicknesses.
        x[0] += lift
        lift *= 2
    used, _, _ = kernel.settle(x, *parts, shape, *scratch, RULES[2], 100)
    # Of second order: a third of the difference remains.
    doubt = 2 * abs(shape[kernel.ANGLE, n] - angle) / 3
    if used > 0:
        angle, turned = shape[kernel.ANGLE, [n, 2 * hinge]]
    else:
        # What doesn't settle there was no state of the rod.
        ending, doubt, (lengths, x) = kernel.LOST, np.inf, coarse
    return Bent(
        unit, _ENDINGS[ending], states, 2 * angle, 2 * turned, 2 * free, doubt,
        iterations + abs(used), time.perf_counter() - begun,
        np.concatenate([[0.0], np.cumsum(lengths)]), x[1:], float(x[0]),
    )  # fmt: skip


_NOTHING = (np.zeros(1), np.empty(0), 0.0)
