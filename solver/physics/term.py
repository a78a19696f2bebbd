"""The contract of an effect: energy, force = dE/du and stiffness at (u, e)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from solver.mesh.body import NodeGraph


@dataclass(frozen=True)
class Evaluation:
    """What a term contributes at (u, e); force = dE/du with that one sign.

    ``energy``: None where no potential exists; ``inf`` where the state is not admissible (an
    inverted element, a node beyond a barrier). ``force``: (nodes, 3). ``stiffness``: blocks
    d force_a / d u_b on the term's graph, (blocks, 3, 3); None for a term without stiffness.
    ``own``: whether who asked may change the stiffness, because the term does not keep it.
    ``dyads``: parts c g ⊗ g of the stiffness beside its blocks, c > 0 and g (nodes, 3), where a
    term couples nodes far apart through one number, such as a volume.
    """

    energy: float | None
    force: np.ndarray | None = None
    stiffness: np.ndarray | None = None
    own: bool = False
    dyads: tuple[tuple[float, np.ndarray], ...] = ()


class Term(Protocol):
    """One effect. Pure: no state, no mutation; history enters by constructor.

    ``graph``: where its stiffness blocks stand (None: it has none). ``symmetric``: whether its
    stiffness is. ``evaluate(u, e, order)``: order 0 asks for the energy, 1 for energy and force, 2
    for the stiffness too. A barrier may also have ``longest_step(u, du) -> float``, the part of du
    that stays admissible, and what :func:`solver.equilibrium.barriers.around` asks of it. A term
    with stresses may have ``extrapolated`` and ``under``, as in
    :class:`solver.physics.elastic.Elastic`.
    """

    name: str
    graph: NodeGraph | None
    symmetric: bool

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation: ...
