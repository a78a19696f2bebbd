"""The folding unit: two panels joined by a bilayer hinge, from its nondimensional groups.

Lengths in units of the sheet's length l_s, stresses in units of E_s. x runs along the fold, y along
the sheet, z up. The passive sheet is |y| ≤ ½, 0 ≤ z ≤ h_s, its panels b_s wide and its hinge,
|y| ≤ l_i/2, b_i wide; the active layer lies on top of the hinge and contracts to g = −contraction
as the load e goes from 0 to 1. Weight per volume: ρ_s g = (h_s/l_s)²/Γ, Γ = E_s h_s²/(ρ_s g l_s³).

A model is a quarter, a half or the whole of it, as its mirror planes leave it, or the half y ≥ 0
that a half-turn about z makes whole: what a twisted unit keeps. What may be absent is absent:
without the effect there is no Gravity and no Ground among the terms, a solid active
layer has no strips.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from scipy.spatial import cKDTree

from solver.cases.unit import mesh as unit_mesh
from solver.cases.unit.choices import Meshing, Physics, Supports, Watch
from solver.cases.unit.mesh import Curves
from solver.cases.unit.unit import GROWTHS, Unit
from solver.equilibrium.clock import Deadline, Timed
from solver.equilibrium.scene import Scene
from solver.equilibrium.sections import FreeSections, Sections
from solver.mesh.body import Body
from solver.physics.elastic import Elastic
from solver.physics.friction import Friction
from solver.physics.ground import Ground, GroundExponential
from solver.physics.growth import Orthotropic
from solver.physics.loads import Gravity
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, Tied, _sight, rotation_row, translation_row
from solver.physics.term import Term

SLIP = 0.01  # of the sheet's thickness, that a point moves before it slides


@dataclass(frozen=True, eq=False)
class Model:
    """A unit on a mesh: the choices, the terms, and the scene whose path is followed.

    ``ground`` and ``contact``, of the panels with each other, are None where there is none.
    """

    unit: Unit
    meshing: Meshing
    physics: Physics
    supports: Supports
    watch: Watch
    body: Body
    terms: tuple[Term, ...]
    scene: Scene = field(repr=False)
    ground: Ground | GroundExponential | None
    contact: Ground | None
    lines: Curves = field(repr=False)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the terms that act."""
        return tuple(t.name for t in self.terms if not isinstance(t, Deadline))

    @property
    def growth(self) -> str:
        """Its name."""
        return self.physics.growth

    @property
    def heavy(self) -> bool:
        """Whether there is weight, so that the ground carries the unit."""
        return self.physics.heavy

    @property
    def mirrors(self) -> tuple[str, ...]:
        """Mirror planes, of ("x", "y"), or ("turn",)."""
        return self.supports.mirrors

    @property
    def upright(self) -> bool:
        """Whether the unit is held against toppling."""
        return self.supports.upright

    def curves(self, x: np.ndarray, e: float) -> np.ndarray:
        """C1 … C4 of physics.md §6 in the deformed state, (4, 1000, 3), in l_s."""
        return self.lines.of(self.body.nodes + self.scene.displacement(x, e))

    def gaps(self, x: np.ndarray, e: float) -> np.ndarray:
        """Heights of the sheet's underside above the ground, (points,), in l_s."""
        return self.ground.gaps(self.scene.displacement(x, e))

    def clearance(self, x: np.ndarray, e: float) -> float:
        """Least distance of a panel from the plane in which the panels touch, in l_s."""
        return float(self.contact.gaps(self.scene.displacement(x, e)).min())

    def anchored(self, x: np.ndarray, e: float) -> Model:
        """The model whose rows hold the rotations about the state x as it is now, and whose
        friction goes on from there.

        The unknowns keep their meaning. Where the rows still see most of each rotation it is this
        model itself: seen from the flat sheet's arms, a unit whose panels stand upright turns by
        nothing.
        """
        u = self.scene.displacement(x, e)
        if self.physics.friction:
            terms = tuple(self._sticking(term, u) for term in self.terms)
            moved = replace(self, terms=terms, scene=self.scene.with_terms(terms))
            return moved._turned(u)
        return self._turned(u)

    def _sticking(self, term: Term, u: np.ndarray) -> Term:
        """The term for the step from u, where it remembers."""
        if term.name != "friction":
            return term
        clock = self.watch.clock
        return term.moved(u) if clock is None else Timed(term.moved(u), clock)

    def _turned(self, u: np.ndarray) -> Model:
        turning = [row for row in self.scene.rows if row.name.startswith("rotation")]
        seen = [_sight(row, self.body.nodes + u, self.supports.centred) for row in turning]
        if min(seen, default=1.0) > 0.7:
            return self
        held = _held(self.body, self.supports, self.heavy, u)
        scene = Scene(
            self.body, self.terms, scales=self.scene.scales, sections=self.scene.sections, **held
        )
        return replace(self, scene=scene)

    def widened(self, mirrors: Sequence[str], x: np.ndarray, e: float) -> tuple[Model, np.ndarray]:
        """The model with fewer mirror planes, and the same state on it as its unknowns.

        Its rows hold the rotations where the state has them. Raises ValueError for a mirror plane
        that this model doesn't have, and for a model on a mesh of one's own.
        """
        if not self.meshing.structured:
            raise ValueError(
                "the unit loses a symmetry, and the mesh that was given is only a part of it; "
                "give one of the whole unit, with mirrors=()"
            )
        kept = set(mirrors)
        if kept not in fewer(self.mirrors):
            raise ValueError(f"mirrors {tuple(mirrors)}; expected fewer of {self.mirrors}")
        u = self.scene.displacement(x, e)

        @cache
        def mapped(body: Body) -> np.ndarray:
            near, signs = images(self.body, body, self.mirrors)
            return signs * u[near]

        supports = replace(self.supports, mirrors=tuple(mirrors))
        wide = build(
            self.unit, self.meshing, self.physics, supports, watch=self.watch, about=mapped
        )
        return wide, wide.scene.unknowns(mapped(wide.body))


def build(
    unit: Unit,
    meshing: Meshing = Meshing(),
    physics: Physics = Physics(),
    supports: Supports = Supports(),
    *,
    watch: Watch = Watch(),
    about: Callable[[Body], np.ndarray] | None = None,
) -> Model:
    """Model of a unit, see :mod:`solver.cases.unit.choices` for what may be chosen.

    Contact of the panels, in the mirror plane between them, needs that plane. ``about`` gives the
    displacement (nodes, 3) of a body about which rows hold rotations, zeros by default.

    Raises ValueError for contact without its mirror plane and what mesh and terms refuse.
    """
    if "contact" in physics.effects and "y" not in supports.mirrors:
        raise ValueError(
            "the panels' contact is known in the mirror plane between them, and this model is "
            "without it; keep 'y' among the mirrors, or leave the effect 'contact' out"
        )
    body = body_of(unit, meshing, physics, supports.cuts)
    terms, ground, contact = acting(unit, physics, supports, body)
    u = np.zeros_like(body.nodes) if about is None else about(body)
    if physics.friction:
        terms.append(Friction.at_rest(ground, physics.friction, SLIP * unit.slenderness, u))
    if watch.clock is not None:
        terms = [Timed(t, watch.clock) for t in terms]
    sections = _sections(body, supports.mirrors, physics.heavy) if meshing.structured else None
    scene = Scene(body, terms, sections=sections, **_held(body, supports, physics.heavy, u))
    if watch.deadline is not None:
        # Scales are an evaluation too, and a model must come of it however late it is.
        terms.append(Deadline(watch.deadline))
        scene = scene.with_terms(terms)
    lines = Curves(unit, body, supports.mirrors)
    return Model(
        unit, meshing, physics, supports, watch, body, tuple(terms), scene, ground, contact, lines
    )


def acting(
    unit: Unit, physics: Physics, supports: Supports, body: Body
) -> tuple[list[Term], Ground | GroundExponential | None, Ground | None]:
    """The terms that act on a unit's body, but for friction; its ground and its panels' contact."""
    terms: list[Term] = [_elastic(unit, physics, body)]
    ground = contact = None
    if physics.heavy:
        layers = (unit.rho_ratio, physics.active.density), (1.0, physics.passive.density)
        density = _by_layer(body, *layers)
        ground = _ground(unit, physics, supports, body)
        terms += [Gravity(body, density, unit.weight), ground]
    if "contact" in physics.effects:
        contact = _contact(unit, body)
        terms.append(contact)
    return terms, ground, contact


def body_of(unit: Unit, meshing: Meshing, physics: Physics, mirrors: tuple[str, ...]) -> Body:
    """The mesh of a unit or of what the planes normal to ``mirrors`` leave of one."""
    if meshing.body is not None:
        return meshing.body
    if meshing.grading is not None:
        return unit_mesh.tetrahedra(unit, meshing.grading, mirrors=mirrors, element=meshing.element)
    curls = physics.growth != "uniaxial" if meshing.curls is None else meshing.curls
    return unit_mesh.mesh(
        unit, meshing.level, mirrors=mirrors, element=meshing.element, heavy=physics.heavy,
        curls=curls,
    )  # fmt: skip


def _by_layer(body: Body, active: tuple, passive: tuple):
    """A quantity of the cells, or a function of e that gives it, from each layer's value and the
    factor on it, which may be None."""
    on = body.cells_of("active")
    (own, rising), (other, falling) = active, passive
    if rising is None and falling is None:
        return np.where(on, own, other)
    rising, falling = rising or _same, falling or _same
    return lambda e: np.where(on, own * rising(e), other * falling(e))


def _same(e: float) -> float:
    return 1.0


def _elastic(unit: Unit, physics: Physics, body: Body) -> Elastic:
    E = _by_layer(body, (unit.E_ratio, physics.active.stiffness), (1.0, physics.passive.stiffness))
    return Elastic(body, NeoHookean(E, unit.nu), _growth(unit, physics, body))


def _growth(unit: Unit, physics: Physics, body: Body) -> Orthotropic:
    active = body.cells_of("active")
    parts = GROWTHS[physics.growth]
    strains = [
        (lambda e, s=s: -unit.contraction * s(e)) if callable(s) else -unit.contraction * s
        for s in parts
    ]
    swelling = physics.active.expansion, physics.passive.expansion
    if swelling == (None, None):
        return Orthotropic(strains, cells=active)
    own, other = (f or (lambda e: 0.0) for f in swelling)

    def along(strain):
        at = strain if callable(strain) else lambda e: strain
        return lambda e: np.where(active, at(e) + own(e), other(e))

    return Orthotropic(
        [along(g) if callable(s) or s else g for s, g in zip(parts, strains, strict=True)]
    )


def _ground(
    unit: Unit, physics: Physics, supports: Supports, body: Body
) -> Ground | GroundExponential:
    if physics.barrier == "exponential":
        return GroundExponential(body, length=1.0, modulus=1.0)
    # The most that the hinge weighs on the way, as its ends tell.
    own, other = (c.density or _same for c in (physics.active, physics.passive))
    hinge = unit.weight * max(
        unit.slenderness * other(e) + unit.rho_ratio * unit.active * own(e) for e in (0.0, 1.0)
    )
    low = unit.slenderness * 1e-6
    # Planes within the whole unit: nothing touches.
    cut = ["xy".index(m) for m in supports.cuts]

    def touching(X):
        return X[:, 2] < low if supports.upright else (np.abs(X[:, cut]) > 1e-9).all(axis=1)

    return Ground(body, body.surface(touching), thickness=unit.slenderness, pressure=hinge)


def _sections(body: Body, mirrors: tuple[str, ...], heavy: bool) -> Sections | FreeSections:
    if len(mirrors) == 2:
        return Sections.across(body.nodes, grounded=heavy)
    about = (0,) if "x" in mirrors else (0, 1, 2)
    return FreeSections.across(body.nodes, grounded=heavy, about=about)


def _contact(unit: Unit, body: Body) -> Ground:
    """The panels' faces against the mirror plane between them: what touches is its own image."""
    start, top = unit.hinge_length / 2 * (1 - 1e-9), unit.slenderness * (1 - 1e-9)
    faces = body.surface(lambda X: (X[:, 1] > start) & (X[:, 2] > top))
    # The hinge's moment, B κ with B = E_s h_s³/12, on the panels' ends.
    pressure = unit.slenderness**2 * max(unit.curvature, 1.0) / 12
    return Ground(
        body, faces, thickness=unit.slenderness, pressure=pressure, axis=1, name="contact"
    )


def uneven(amplitude: float, watch: Watch) -> Callable[[Scene, np.random.Generator], Scene]:
    """For :class:`solver.paths.noise.Noise`: scenes whose cells are by up to ``amplitude`` too
    heavy or too light."""

    def drawn(term: Term, rng: np.random.Generator) -> Term:
        factors = 1 + amplitude * rng.uniform(-1, 1, len(term.body.cells))
        rho = term.density
        density = (lambda e: factors * rho(e)) if callable(rho) else factors * rho
        new = Gravity(term.body, density, term.g)
        return new if watch.clock is None else Timed(new, watch.clock)

    def scene(given: Scene, rng: np.random.Generator) -> Scene:
        # A term that keeps time has the name and fields of its own.
        terms = [drawn(t, rng) if t.name == "gravity" else t for t in given.terms]
        return given.with_terms(terms)

    return scene


def fewer(mirrors: Sequence[str]) -> list[set[str]]:
    """The symmetries that a unit may be left with where it loses some: of both mirror planes the
    product is the half-turn about z."""
    if len(mirrors) == 2:
        return [{"x"}, {"y"}, {"turn"}, set()]
    return [set()] if mirrors else []


def images(part: Body, whole: Body, mirrors: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """For each node of a body its image in the part that symmetries keep, and (n, 3) signs.

    ``mirrors``: those symmetries. Raises ValueError where a node has no image.
    """
    there, signs = whole.nodes.copy(), np.ones_like(whole.nodes)
    for name in mirrors:
        axis, flipped = (1, [0, 1]) if name == "turn" else ("xy".index(name), ["xy".index(name)])
        beyond = there[:, axis] < -1e-12
        for k in flipped:
            signs[beyond, k] = -1
            there[beyond, k] *= -1
    off, near = cKDTree(part.nodes).query(there)
    if off.max() > 1e-9:
        raise ValueError("the mesh of the larger model is no image of this one")
    return near, signs


def plane(body: Body, axis: int) -> np.ndarray:
    """Nodes on the mirror plane normal to an axis."""
    return np.flatnonzero(np.abs(body.nodes[:, axis]) < 1e-9)


def foot(body: Body, at=(0.0, 0.0, 0.0)) -> np.ndarray:
    """The node nearest to a reference position."""
    return np.array([np.argmin(np.linalg.norm(body.nodes - at, axis=1))])


def opposite(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Nodes on the cut y = 0 with x < 0, and where a half-turn about z takes them."""
    on = plane(body, 1)
    nodes = on[body.nodes[on, 0] < -1e-9]
    off, near = cKDTree(body.nodes[on]).query(body.nodes[nodes] * (-1, -1, 1))
    if off.max() > 1e-9:
        raise ValueError("the mesh is not symmetric about x = 0 on the cut y = 0")
    return nodes, on[near]


def axis_nodes(body: Body) -> np.ndarray:
    """Nodes on the axis of the half-turn, x = y = 0."""
    return np.intersect1d(plane(body, 0), plane(body, 1))


def _held(body: Body, supports: Supports, heavy: bool, u: np.ndarray) -> dict:
    """What holds a model, as arguments of a scene; the rows hold rotations about u."""
    if supports.mirrors == ("turn",):
        fixed = [Fixed(axis_nodes(body), np.eye(3)[k]) for k in (0, 1)]
        if not heavy:
            fixed.append(Fixed(foot(body), [0, 0, 1]))
        rows = [rotation_row(body, 2, u, supports.centred)]
        return {"fixed": fixed, "rows": rows, "tied": [Tied(*opposite(body), (-1, -1, 1))]}
    axes = ["xy".index(m) for m in supports.mirrors]
    fixed = [Fixed(plane(body, axis), np.eye(3)[axis]) for axis in axes]
    free = [axis for axis in (0, 1) if axis not in axes]
    if not heavy:
        # No force needs a support: one node holds the height.
        fixed.append(Fixed(foot(body), [0, 0, 1]))
    rows = [translation_row(body, axis) for axis in free]
    # A mirror plane normal to one axis forbids rotations about the other two.
    turns = {0: 1 not in axes, 1: 0 not in axes, 2: not axes}
    for axis, loose in turns.items():
        if loose and (axis == 2 or supports.upright or not heavy):
            rows.append(rotation_row(body, axis, u))
    return {"fixed": fixed, "rows": rows}
