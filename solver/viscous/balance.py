"""What growth that answers to stress does with energy.

Stored energy of a grown body: d/dt ∫ Jg ψ dV₀ = ∫ P : Ḟ dV₀ − dashpots − ∫ Jg (M − ψ 1) : Lg dV₀
with Lg = Ḟg Fg⁻¹. What growth takes is negative where it drives, for which a living body pays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solver.equilibrium.scene import Scene
from solver.viscous.evolution import State, stepped
from solver.viscous.feedback import Growing
from solver.viscous.term import viscous


@dataclass(frozen=True, eq=False)
class Balance:
    """Energies of the growing terms at the end of each step, (steps,) each.

    ``t``: time; ``stored``: in springs; since the first of these times ``work``: done on the terms
    by all others and the supports, ``dissipated``: by dashpots, ``grown``: what growth took.
    """

    t: np.ndarray
    stored: np.ndarray
    work: np.ndarray
    dissipated: np.ndarray
    grown: np.ndarray

    @property
    def gap(self) -> float:
        """Largest |stored − (first stored + work − dissipated − grown)| over the largest part."""
        sum_ = self.stored[0] + self.work - self.dissipated - self.grown
        parts = np.abs([self.stored, self.work, self.dissipated, self.grown])
        return float(np.abs(self.stored - sum_).max() / max(parts.max(), 1e-300))


def balance(scene: Scene, states: Sequence[State]) -> Balance:
    """Energies along states of one path in turn, by the trapezoidal rule: exact to second order in
    the step.

    Raises ValueError for fewer than three states, those that do not follow each other, and a scene
    without a Growing term.
    """
    numbers = [k for k, term in enumerate(viscous(scene)) if isinstance(term, Growing)]
    if not numbers:
        raise ValueError("the scene has no Growing term; swap a Viscous or an Elastic one for it")
    if len(states) < 3:
        raise ValueError(f"{len(states)} states; expected three at least: two steps in turn")
    rows, last = [], None
    for before, after in pairwise(states):
        now, u, e = stepped(scene, before, after), scene.displacement(after.x, after.e), after.e
        entries, sums = [], np.zeros(4)
        for number in numbers:
            term, memory = viscous(now)[number], after.level.memories[number]
            density, driving = term.ledger(u, memory, e)
            entry = (u, term.evaluate(u, e, 1).force, memory.growth, driving)
            sums[0] += term.integral(density, e)
            if last is not None:
                u_1, force_1, growth_1, driving_1 = last[len(entries)]
                force, driving = (entry[1] + force_1) / 2, (driving + driving_1) / 2
                rise = (driving * (memory.growth - growth_1)).sum(-1)
                taken = term.dissipation(memory, e)[0].sum(-1)
                sums[1] += (force * (u - u_1)).sum()
                sums[2:] += term.integral(taken, e), term.integral(rise, e)
            entries.append(entry)
        rows.append(sums)
        last = entries
    sums = np.array(rows)
    flows = np.cumsum(sums[:, 1:], axis=0).T
    return Balance(np.array([state.t for state in states[1:]]), sums[:, 0], *flows)
