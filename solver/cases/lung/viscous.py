"""A lung whose tissues relax: a Maxwell branch beside the spring of epithelium and of muscle.

The springs are the elastic lung's, so that is what is left after long; at once the branches act,
too. Times are in units of the caller's, stresses in E_ep. A stage takes the time that ``load`` of
:func:`solver.viscous.evolution.evolve` gives it:

    stages = (REST, INFLATED, INFLATED)                      # inflate, then hold
    scene = viscous(body, lung, Tissue(), Relaxing(), stages, dt=0.02)
    path = evolve(scene, start(scene), TimeSteps(1e-7, 0.02), until=2.0,
                  load=course(1.0, 1.0), breaks=(1.0,))
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.cases.lung.geometry import Lung
from solver.cases.lung.model import State, Tissue, muscle_of, staged
from solver.equilibrium.scene import Scene
from solver.given import number
from solver.mesh.body import Body
from solver.physics.elastic import Elastic
from solver.physics.materials import NeoHookean
from solver.viscous.rheology import SLS
from solver.viscous.term import softened


@dataclass(frozen=True)
class Relaxing:
    """What relaxes of each tissue: the branch's modulus over the spring's, E_m/E_s, and its time
    η/E_m; a modulus of 0: that tissue stays elastic.

    Raises ValueError for moduli below 0, none above, and times that are not above 0.
    """

    epithelium: float = 1.0
    muscle: float = 1.0
    epithelium_time: float = 1.0
    muscle_time: float = 1.0

    def __post_init__(self):
        moduli = [number(name, getattr(self, name)) for name in ("epithelium", "muscle")]
        if min(moduli) < 0 or max(moduli) == 0:
            raise ValueError(
                f"moduli {self.epithelium:g} and {self.muscle:g} of the branches; expected none "
                "below 0 and one above, or take the elastic lung"
            )
        for name in ("epithelium_time", "muscle_time"):
            number(name, getattr(self, name), above=0)


def viscous(
    body: Body,
    lung: Lung,
    tissue: Tissue,
    relaxing: Relaxing,
    states: Sequence[State],
    *,
    dt: float,
) -> Scene:
    """The stages of :func:`solver.cases.lung.model.staged` with tissues that relax; ``dt``: of the
    first step. Raises ValueError for the primitive model, too, whose strains are small."""
    elastic = staged(body, lung, _advanced(tissue), states)
    E, more, time = _moduli(body, tissue, relaxing)
    cells = more > 0
    # Where nothing relaxes a number has to stand, which is not used.
    branch = np.where(cells, more, 1.0) * E
    rheology = SLS(E, branch, tissue.nu, branch * time)
    return softened(elastic, rheology, dt=dt, cells=cells)


def at_once(
    body: Body, lung: Lung, tissue: Tissue, relaxing: Relaxing, states: Sequence[State]
) -> Scene:
    """The elastic lung that it is in an infinitely fast process: springs and branches together."""
    slow = staged(body, lung, _advanced(tissue), states)
    E, more, _ = _moduli(body, tissue, relaxing)
    (old,) = (term for term in slow.terms if isinstance(term, Elastic))
    new = Elastic(body, NeoHookean((1 + more) * E, tissue.nu), old.growth)
    return slow.with_terms([new if term is old else term for term in slow.terms])


def course(*times: float) -> Callable[[float], float]:
    """e of the time where each stage takes its own of ``times``, and stays at the last after them.

    Raises ValueError for times that are not above 0.
    """
    ends = np.cumsum([0.0, *(number("the time of a stage", t, above=0) for t in times)])
    return lambda t: float(np.interp(t, ends, np.arange(len(ends))))


def _advanced(tissue: Tissue) -> Tissue:
    if tissue.model != "advanced":
        raise ValueError(
            f"model {tissue.model!r}: what relaxes has large strains; take model='advanced'"
        )
    return replace(tissue)


def _moduli(body: Body, tissue: Tissue, relaxing: Relaxing) -> tuple[np.ndarray, ...]:
    """Spring's modulus, branch's over it, and relaxation time per cell, (m,) each."""
    muscle = muscle_of(body)
    pairs = (
        (tissue.stiffness, 1.0),
        (relaxing.muscle, relaxing.epithelium),
        (relaxing.muscle_time, relaxing.epithelium_time),
    )
    return tuple(np.where(muscle, a, b) for a, b in pairs)
