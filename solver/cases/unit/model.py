"""The folding unit: two panels joined by a bilayer hinge, from its nondimensional groups.

Lengths in units of the sheet's length l_s, stresses in units of E_s. x runs along the fold, y along
the sheet, z up. The passive sheet is |y| ≤ ½, 0 ≤ z ≤ h_s, its panels b_s wide and its hinge,
|y| ≤ l_i/2, b_i wide; the active layer lies on top of the hinge and contracts to g = −contraction
as the load e goes from 0 to 1. Weight per volume: ρ_s g = (h_s/l_s)²/Γ, Γ = E_s h_s²/(ρ_s g l_s³).

A model is a quarter, a half or the whole of it: ``mirrors`` names the mirror planes, normal to x or
to y. What may be absent is absent: without the effect there is no Gravity and no Ground among the
terms, a solid active layer has no strips.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from solver.cases.unit import mesh as unit_mesh
from solver.cases.unit.unit import EFFECTS, GROWTHS, KNOWN, Unit
from solver.equilibrium.clock import Deadline, Timed
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.physics.elastic import Elastic
from solver.physics.ground import Ground, GroundExponential
from solver.physics.growth import Orthotropic
from solver.physics.loads import Gravity
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, _sight, translation_row, turning_row
from solver.physics.term import Term


@dataclass(frozen=True, eq=False)
class Model:
    """A unit on a mesh: the terms, and scenes of them under various supports.

    ``mirrors``: mirror planes, of ("x", "y"); ``scene``: the one whose path is followed. ``ground``
    and ``contact``, of the panels with each other, are None where there is none.
    """

    unit: Unit
    body: Body
    terms: tuple[Term, ...]
    growth: str
    mirrors: tuple[str, ...]
    upright: bool
    scene: Scene = field(repr=False)
    ground: Ground | GroundExponential | None
    contact: Ground | None
    options: dict = field(repr=False)  # what it was built with

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the terms that act."""
        return tuple(t.name for t in self.terms if not isinstance(t, Deadline))

    @property
    def heavy(self) -> bool:
        """Whether there is weight, so that the ground carries the unit."""
        return "gravity" in self.effects

    @cached_property
    def _curves(self):
        h, half = self.unit.slenderness / 2, self.unit.width / 2
        # An even number of points: none on a mirror plane, none twice.
        s, across = np.linspace(-0.5, 0.5, 1000), np.linspace(-half, half, 1000)
        if "x" in self.mirrors:
            across = across[500:]
        if "y" in self.mirrors:
            s = s[500:]

        def along(x):
            return np.stack([np.full(len(s), x), s, np.full(len(s), h)], axis=1)

        lines = [along(0.0), np.stack([across, 0 * across, 0 * across + h], axis=1), along(half)]
        if "x" not in self.mirrors:
            lines.append(along(-half))
        # A hair inside of the body, whatever rounding did to its edges.
        return [self.body.interpolation(line * (1 - 1e-9)) for line in lines]

    def curves(self, x: np.ndarray, e: float) -> np.ndarray:
        """C1 … C4 of physics.md §6 in the deformed state, (4, 1000, 3), in l_s.

        On the passive layer's mid-plane: x = 0 along y, y = 0 along x within the hinge's width, and
        x = ±b_i/2 along y.
        """
        deformed = self.body.nodes + self.scene.displacement(x, e)
        found = [m @ deformed for m in self._curves]
        if "x" in self.mirrors:
            found[1] = np.vstack([(found[1] * (-1, 1, 1))[::-1], found[1]])
            found.append(found[2] * (-1, 1, 1))
        if "y" in self.mirrors:
            for k in (0, 2, 3):
                found[k] = np.vstack([(found[k] * (1, -1, 1))[::-1], found[k]])
        return np.stack(found)

    def gaps(self, x: np.ndarray, e: float) -> np.ndarray:
        """Heights of the sheet's underside above the ground, (points,), in l_s."""
        return self.ground.gaps(self.scene.displacement(x, e))

    def clearance(self, x: np.ndarray, e: float) -> float:
        """Least distance of a panel from the plane in which the panels touch, in l_s."""
        return float(self.contact.gaps(self.scene.displacement(x, e)).min())

    def anchored(self, x: np.ndarray, e: float) -> Model:
        """The model whose rows hold the rotations about the state x as it is now.

        The unknowns keep their meaning. Where the rows still see most of each rotation it is this
        model itself: seen from the flat sheet's arms, a unit whose panels stand upright turns by
        nothing.
        """
        u = self.scene.displacement(x, e)
        turning = [row for row in self.scene.rows if row.name.startswith("rotation")]
        seen = [_sight(row, self.body.nodes + u) for row in turning]
        if min(seen, default=1.0) > 0.7:
            return self
        fixed, rows = _supports(self.body, self.mirrors, self.heavy, self.upright, lambda body: u)
        scene = Scene(self.body, self.terms, fixed=fixed, rows=rows, scales=self.scene.scales)
        made = replace(self, scene=scene)
        made.__dict__["_curves"] = self._curves  # the same body's
        return made

    def widened(self, mirrors: Sequence[str], x: np.ndarray, e: float) -> tuple[Model, np.ndarray]:
        """The model with fewer mirror planes, and the same state on it as its unknowns.

        Its rows hold the rotations where the state has them. Raises ValueError for a mirror plane
        that this model doesn't have, and for a model on a mesh of one's own.
        """
        if self.options["body"] is not None or self.options["grading"] is not None:
            raise ValueError(
                "the unit loses a symmetry, and the mesh that was given is only a part of it; "
                "give one of the whole unit, with mirrors=()"
            )
        lost = [axis for axis, name in enumerate("xy") if name in self.mirrors]
        lost = [axis for axis in lost if "xy"[axis] not in mirrors]
        if not lost or not set(mirrors) <= set(self.mirrors):
            raise ValueError(f"mirrors {tuple(mirrors)}; expected fewer of {self.mirrors}")
        u = self.scene.displacement(x, e)

        def mapped(body: Body) -> np.ndarray:
            near, signs = images(self.body, body, lost)
            return signs * u[near]

        wide = build(self.unit, **{**self.options, "mirrors": tuple(mirrors), "at": mapped})
        return wide, wide.scene.unknowns(mapped(wide.body))


def build(
    unit: Unit,
    level: int | unit_mesh.Sizes = 1,
    *,
    growth: str = "uniaxial",
    effects: Sequence[str] = EFFECTS,
    mirrors: Sequence[str] = ("x", "y"),
    upright: bool = True,
    element: str = "hex27",
    grading: float | None = None,
    curls: bool | None = None,
    stiffening: Callable[[float], float] | None = None,
    barrier: str = "surface",
    body: Body | None = None,
    deadline: float | None = None,
    clock: dict[str, list[float]] | None = None,
    at: Callable[[Body], np.ndarray] | None = None,
) -> Model:
    """Model of a unit.

    ``level``: fineness of the mesh, see :mod:`solver.cases.unit.mesh`. ``effects``: of ("gravity",
    "ground", "contact"); weight needs the ground, and contact of the panels, in the mirror plane
    between them, needs that plane. ``upright``: hold the unit against toppling (rows on its
    rotations) where mirror planes don't; otherwise all of its surface may touch the ground.
    ``grading``: size of Gmsh's tetrahedra over the local thickness (tet4 or tet10), instead of
    structured elements. ``curls``: whether the mesh resolves curling across the hinge, by default
    where the growth makes it curl. ``stiffening``: factor on E_i as a function of e (§4.8.4).
    ``barrier``: "surface", or "exponential" for the dissertation's (Eq. 4.5). ``body``: a mesh of
    one's own, with sub-domains "passive" and "active". ``deadline``: ``time.monotonic()`` at which
    any iteration is broken off. ``clock`` keeps each term's evaluations and seconds. ``at`` gives
    the displacement (nodes, 3) about which rows hold rotations.

    Raises ValueError for names that are not there and what mesh and terms refuse.
    """
    if growth not in GROWTHS:
        raise ValueError(f"growth {growth!r}; expected one of {', '.join(GROWTHS)}")
    for effect in effects:
        if effect not in KNOWN:
            raise ValueError(f"effect {effect!r}; expected some of {', '.join(KNOWN)}")
    if ("gravity" in effects) != ("ground" in effects):
        raise ValueError(
            "weight and ground come together: without ground a weight falls, without weight "
            "nothing lies on the ground; give both effects or none"
        )
    heavy = "gravity" in effects
    if "contact" in effects and "y" not in mirrors:
        raise ValueError(
            "the panels' contact is known in the mirror plane between them, and this model is "
            "without it; keep 'y' among the mirrors, or leave the effect 'contact' out"
        )
    if barrier not in ("surface", "exponential"):
        raise ValueError(f"barrier {barrier!r}; expected 'surface' or 'exponential'")
    mirrors = tuple(mirrors)
    options = {
        "level": level, "growth": growth, "effects": effects, "mirrors": mirrors,
        "upright": upright, "element": element, "grading": grading, "curls": curls,
        "stiffening": stiffening, "barrier": barrier, "body": body, "deadline": deadline,
        "clock": clock,
    }  # fmt: skip
    if grading is not None and body is None:
        body = unit_mesh.tetrahedra(unit, grading, mirrors=mirrors, element=element)
    if body is None:
        body = unit_mesh.mesh(
            unit, level, mirrors=mirrors, element=element, heavy=heavy,
            curls=growth != "uniaxial" if curls is None else curls,
        )  # fmt: skip
    active = body.cells_of("active")
    shares = [
        (lambda e, s=s: -unit.contraction * s(e)) if callable(s) else -unit.contraction * s
        for s in GROWTHS[growth]
    ]
    E = np.where(active, unit.E_ratio, 1.0)
    if stiffening is not None:
        E = lambda e: np.where(active, unit.E_ratio * stiffening(e), 1.0)  # noqa: E731
    terms: list[Term] = [Elastic(body, NeoHookean(E, unit.nu), Orthotropic(shares, cells=active))]
    ground = contact = None
    if heavy:
        density = np.where(active, unit.rho_ratio, 1.0)
        terms.append(Gravity(body, density, unit.weight))
        if barrier == "exponential":
            ground = GroundExponential(body, length=1.0, modulus=1.0)
        else:
            hinge = unit.weight * (unit.slenderness + unit.rho_ratio * unit.active)
            low = unit.slenderness * 1e-6
            cut = ["xy".index(m) for m in mirrors]  # planes within the whole unit: nothing touches

            def touching(X):
                return X[:, 2] < low if upright else (np.abs(X[:, cut]) > 1e-9).all(axis=1)

            surface = body.surface(touching)
            ground = Ground(body, surface, thickness=unit.slenderness, pressure=hinge)
        terms.append(ground)
    if "contact" in effects:
        contact = _contact(unit, body)
        terms.append(contact)
    if clock is not None:
        terms = [Timed(t, clock) for t in terms]
    fixed, rows = _supports(body, mirrors, heavy, upright, at)
    scene = Scene(body, terms, fixed=fixed, rows=rows)
    if deadline is not None:
        # Scales are an evaluation too, and a model must come of it however late it is.
        terms.append(Deadline(deadline))
        scene = Scene(body, terms, fixed=fixed, rows=rows, scales=scene.scales)
    return Model(
        unit, body, tuple(terms), growth, mirrors, upright, scene, ground, contact, options
    )


def _contact(unit: Unit, body: Body) -> Ground:
    """The panels' faces against the mirror plane between them: what touches is its own image."""
    start, top = unit.hinge_length / 2 * (1 - 1e-9), unit.slenderness * (1 - 1e-9)
    faces = body.surface(lambda X: (X[:, 1] > start) & (X[:, 2] > top))
    # The hinge's moment, B κ with B = E_s h_s³/12, on the panels' ends.
    pressure = unit.slenderness**2 * max(unit.curvature, 1.0) / 12
    return Ground(
        body, faces, thickness=unit.slenderness, pressure=pressure, axis=1, name="contact"
    )


def images(part: Body, whole: Body, axes: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """For each node of a body its image in a part of it that mirror planes left, and (n, 3) signs.

    ``axes``: the normals of those planes. Raises ValueError where a node has no image.
    """
    there, signs = whole.nodes.copy(), np.ones_like(whole.nodes)
    for axis in axes:
        signs[:, axis] = np.where(there[:, axis] < 0, -1, 1)
        there[:, axis] = np.abs(there[:, axis])
    off, near = cKDTree(part.nodes).query(there)
    if off.max() > 1e-9:
        raise ValueError("the mesh of the larger model is no mirror image of this one")
    return near, signs


def plane(body: Body, axis: int) -> np.ndarray:
    """Nodes on the mirror plane normal to an axis."""
    return np.flatnonzero(np.abs(body.nodes[:, axis]) < 1e-9)


def foot(body: Body, at=(0.0, 0.0, 0.0)) -> np.ndarray:
    """The node nearest to a reference position."""
    return np.array([np.argmin(np.linalg.norm(body.nodes - at, axis=1))])


def _supports(body, mirrors, heavy, upright, at):
    axes = ["xy".index(m) for m in mirrors]
    fixed = [Fixed(plane(body, axis), np.eye(3)[axis]) for axis in axes]
    free = [axis for axis in (0, 1) if axis not in axes]
    if not heavy:
        # No force needs a support: one node holds the height.
        fixed.append(Fixed(foot(body), [0, 0, 1]))
    u = np.zeros_like(body.nodes) if at is None else at(body)
    rows = [translation_row(body, axis) for axis in free]
    # A mirror plane normal to one axis forbids rotations about the other two.
    turns = {0: 1 not in axes, 1: 0 not in axes, 2: not axes}
    for axis, loose in turns.items():
        if loose and (axis == 2 or upright or not heavy):
            rows.append(turning_row(body, axis, u))
    return fixed, rows
