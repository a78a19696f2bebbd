"""What may be chosen about a model of a folding unit beside the unit itself, as frozen records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from solver.cases.unit.mesh import Sizes
from solver.cases.unit.unit import EFFECTS, GROWTHS, KNOWN
from solver.mesh.body import Body


@dataclass(frozen=True)
class Meshing:
    """The mesh: ``level`` of fineness, see :mod:`solver.cases.unit.mesh`, and ``element``.

    ``curls``: whether the mesh resolves curling across the hinge; None: where the growth makes it
    curl. ``grading``: size of Gmsh's tetrahedra over the local thickness (tet4 or tet10), instead
    of structured elements. ``body``: a mesh of one's own, with sub-domains "passive" and "active".
    """

    level: int | Sizes = 1
    element: str = "hex27"
    curls: bool | None = None
    grading: float | None = None
    body: Body | None = None

    @property
    def structured(self) -> bool:
        """Whether the mesh of a part is a part of the mesh of the whole."""
        return self.body is None and self.grading is None


@dataclass(frozen=True)
class Changes:
    """How a layer's material changes on the way, as functions of e; None: it doesn't (§4.8.4).

    ``stiffness``, ``density``: factors on E and on ρ, per volume of the flat state. ``expansion``:
    strain that the layer grows by, beside any contraction, in the directions of the contraction;
    negative shrinks.
    """

    stiffness: Callable[[float], float] | None = None
    density: Callable[[float], float] | None = None
    expansion: Callable[[float], float] | None = None


@dataclass(frozen=True)
class Physics:
    """``effects``: of ("gravity", "ground", "contact"); weight needs the ground.

    ``growth``: a name in :data:`solver.cases.unit.unit.GROWTHS`. ``active``, ``passive``: what
    changes in these layers beside the contraction. ``barrier``: the ground's, "surface", or
    "exponential" for the dissertation's (Eq. 4.5). ``friction``: its coefficient μ on the surface
    barrier, 0 for none. Raises ValueError for names that are not there, and for friction without
    that ground.
    """

    effects: tuple[str, ...] = EFFECTS
    growth: str = "uniaxial"
    active: Changes = Changes()
    passive: Changes = Changes()
    barrier: str = "surface"
    friction: float = 0.0

    def __post_init__(self):
        if not 0 <= self.friction < float("inf"):
            raise ValueError(f"friction = {self.friction}; expected a number from 0 on")
        if self.friction and (self.barrier != "surface" or "ground" not in self.effects):
            raise ValueError(
                "friction acts where a sheet presses on the ground: it needs the effects gravity "
                "and ground, and the barrier 'surface'"
            )
        if self.growth not in GROWTHS:
            raise ValueError(f"growth {self.growth!r}; expected one of {', '.join(GROWTHS)}")
        for effect in self.effects:
            if effect not in KNOWN:
                raise ValueError(f"effect {effect!r}; expected some of {', '.join(KNOWN)}")
        if ("gravity" in self.effects) != ("ground" in self.effects):
            raise ValueError(
                "weight and ground come together: without ground a weight falls, without weight "
                "nothing lies on the ground; give both effects or none"
            )
        if self.barrier not in ("surface", "exponential"):
            raise ValueError(f"barrier {self.barrier!r}; expected 'surface' or 'exponential'")

    @property
    def heavy(self) -> bool:
        """Whether there is weight, so that the ground carries the unit."""
        return "gravity" in self.effects

    @property
    def changes(self) -> bool:
        """Whether anything but the contraction changes with e."""
        return (self.active, self.passive) != (Changes(), Changes())


@dataclass(frozen=True)
class Supports:
    """``mirrors``: mirror planes, of ("x", "y"), normal to these axes, or instead ("turn",): the
    half-turn about z.

    ``upright``: hold the unit against toppling (rows on its rotations) where mirror planes don't;
    otherwise all of its surface may touch the ground.
    """

    mirrors: tuple[str, ...] = ("x", "y")
    upright: bool = True

    @property
    def cuts(self) -> tuple[str, ...]:
        """Normals of the planes that the mesh of a model ends at."""
        return ("y",) if self.mirrors == ("turn",) else self.mirrors

    @property
    def centred(self) -> tuple[str, ...]:
        """Axes along which symmetry keeps the unit's centre at 0, whatever part the model is."""
        return ("x", "y") if self.mirrors == ("turn",) else self.mirrors


@dataclass(frozen=True)
class Watch:
    """``deadline``: :func:`solver.equilibrium.clock.core_seconds` of the thread that computes at
    which any iteration is broken off; ``clock`` keeps each term's evaluations and core-seconds."""

    deadline: float | None = None
    clock: dict[str, list[float]] | None = None
