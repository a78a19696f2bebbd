"""A structure of rigid panels and hinges: the fast level.

Parts are rigid (:mod:`solver.cases.structure.parts`), hinges bend by a law
(:mod:`solver.cases.structure.hinges`); weight, ground and contact of panels act where they are
asked for. What this level misses: panels that sag or twist, hinges that curve about the other axis,
the sheet around a vertex, friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp
import skfem

from solver.cases.structure.hinges import Hinges, point_weights
from solver.cases.structure.linked import Linked
from solver.cases.structure.parts import Parts, Structure
from solver.cases.structure.pattern import area_of, triangles
from solver.cases.structure.touch import PointGround, Touch
from solver.equilibrium.clock import Deadline
from solver.equilibrium.scene import Scales, Scene
from solver.mesh.body import Body
from solver.physics.elastic import Elastic
from solver.physics.loads import PointLoad
from solver.physics.materials import NeoHookean
from solver.physics.supports import _sight, rotation_row, translation_row
from solver.physics.term import Term

RIGID = 1e5  # times the stiffness of all hinges, that of a panel against a change of its shape
EFFECTS = ("gravity", "ground", "contact")


@dataclass(frozen=True, eq=False)
class Model:
    """A structure as a scene: four nodes for each of its ``parts``.

    ``corners`` (v, n) sparse: weights of the nodes at the panels' corners, ``owners`` (v,): of
    which panel each is.
    """

    structure: Structure
    effects: tuple[str, ...]
    upright: bool
    parts: Parts
    body: Body
    scene: Scene = field(repr=False)
    hinges: Hinges
    ground: PointGround | None
    contact: Touch | None
    corners: sp.csr_array = field(repr=False)
    owners: np.ndarray = field(repr=False)

    def angles(self, x: np.ndarray, e: float) -> np.ndarray:
        """Angle of each crease's hinge, rad, (creases,)."""
        angles = self.hinges.angles(self.scene.displacement(x, e))
        return angles.reshape(-1, self.parts.crease).sum(axis=1)

    def panels(self, x: np.ndarray, e: float) -> list[np.ndarray]:
        """Outline (k, 3) of the middle surface of each panel."""
        X = self.corners @ (self.body.nodes + self.scene.displacement(x, e))
        return [X[self.owners == k] for k in range(len(self.parts.outlines))]

    def strips(self, x: np.ndarray, e: float) -> np.ndarray:
        """Corners (creases, 4, 3) of each hinge's strip, as if it were straight: its side on a,
        then back along that on b."""
        sides = self.hinges.sides(self.scene.displacement(x, e))
        a, b = sides[:: self.parts.crease, 0], sides[self.parts.crease - 1 :: self.parts.crease, 1]
        return np.concatenate([a, b[:, ::-1]], axis=1)

    def lowest(self, u: np.ndarray) -> float:
        """Height of the lowest corner of the underside above the ground."""
        return float(self.ground.heights(u).min())

    def clearance(self, u: np.ndarray) -> float:
        """Of panels from each other; inf where none are near."""
        return self.contact.distance(u)

    def centre_of_mass(self, u: np.ndarray) -> np.ndarray:
        """Of the structure displaced by u (n, 3), (3,)."""
        mass, Y = self.parts.mass, self.body.nodes + u
        owners, places = _of_masses(self.parts)
        return mass @ (_points(self.body, owners, places) @ Y) / mass.sum()

    def anchored(self, x: np.ndarray, e: float) -> Model:
        """The model for the step from x: angles go on from those there, contact is ready for what
        is near, and rows that hold rotations see them as the structure lies now."""
        u = self.scene.displacement(x, e)
        hinges = self.hinges.moved(u)
        contact = None if self.contact is None else self.contact.moved(u)
        terms = [{"hinges": hinges, "contact": contact}.get(t.name, t) for t in self.scene.terms]
        return replace(self, scene=held(self, terms, u), hinges=hinges, contact=contact)


def build(
    structure: Structure,
    effects: Sequence[str] = EFFECTS,
    *,
    upright: bool = False,
    deadline: float | None = None,
    rigid: float = RIGID,
) -> Model:
    """The scene of a structure lying flat.

    ``effects``: of "gravity", "ground" and "contact"; gravity and ground come together.
    ``upright``: a structure that folds symmetrically is held against toppling, by its mean
    rotation. ``deadline``: as in
    :class:`solver.cases.unit.choices.Watch`. Raises ValueError for unknown effects, and for panels
    that hang together with nothing.
    """
    effects, heavy = acting(effects)
    pattern, h = structure.pattern, structure.sheet.h
    parts = Parts.of(structure, heavy)
    body = _body(parts)
    linked = _linked(structure, parts, body)
    stiffness = np.array([law.stiffness[0] for law in structure.laws])
    modulus = rigid * stiffness.sum() / body.weights.sum(axis=1)
    hinges = Hinges(body, parts.hinges, parts.laws)
    terms: list[Term] = [Elastic(body, NeoHookean(modulus, 0.0)), hinges]
    ground = contact = None
    if heavy:
        owners, places = parts.underside(structure)
        low = min(place[2] for place in places)
        points, force = _points(body, owners, places), structure.g * parts.mass.sum() / 3
        ground = PointGround(body, points, force=force, depth=0.1 * h, height=low)
        pull = np.zeros_like(body.nodes)
        pull[:, 2] = -structure.g * (_points(body, *_of_masses(parts)).T @ parts.mass)
        terms += [PointLoad(body, np.arange(len(pull)), pull, name="gravity"), ground]
    corners, owners, faces = _corners(body, parts)
    if "contact" in effects:
        energy = float(stiffness.max())
        contact = Touch(body, corners, owners, faces, gap=gap_of(structure), energy=energy)
        terms.append(contact)
    if deadline is not None:
        terms.append(Deadline(deadline))
    extent = pattern.extent
    scales = Scales(extent, float(stiffness.sum()) / extent, float(stiffness.sum()))
    empty = Model(
        structure, effects, upright, parts, body, None, hinges, ground, contact, corners, owners
    )
    scene = held(empty, terms, np.zeros_like(body.nodes), scales=scales, sections=linked)
    return replace(empty, scene=scene)


def acting(effects: Sequence[str]) -> tuple[tuple[str, ...], bool]:
    """The effects, and whether weight is one; raises ValueError for what is none, and for weight
    without ground."""
    effects = tuple(effects)
    unknown = [name for name in effects if name not in EFFECTS]
    if unknown:
        raise ValueError(f"effect {unknown[0]!r}; expected some of {', '.join(EFFECTS)}")
    if ("gravity" in effects) != ("ground" in effects):
        raise ValueError("weight and ground come together; give both effects or none")
    return effects, "gravity" in effects


def _linked(structure: Structure, parts: Parts, body: Body) -> Linked:
    """How steps turn the parts; raises ValueError for panels that hang together with nothing."""
    pairs = np.array([h.faces for h in parts.hinges], int).reshape(-1, 2)
    places = [[np.array([*h.sides[side], 0.0]) for h in parts.hinges] for side in (0, 1)]
    sides = tuple(_points(body, pairs[:, k], places[k]) for k in (0, 1))
    mass = np.bincount(parts.where[:, 0].astype(int), parts.mass)[: len(parts.outlines)]
    of = np.repeat(np.arange(parts.count), 4)
    linked = Linked.of_links(of, pairs, sides, int(np.argmax(mass)))
    if len(linked.order) < parts.count:
        seen = set(linked.order[linked.order < len(parts.outlines)].tolist())
        others = set(range(len(structure.pattern.panels))) - seen
        loose = sorted(min(seen, others, key=len))
        raise ValueError(f"the faces {loose} hang together with the others by no crease")
    return linked


def _body(parts: Parts) -> Body:
    """A tetrahedron per part, of its size: at an outline's centroid, on the middle of a line."""
    nodes = []

    def add(centre: np.ndarray, size: float) -> None:
        corner = np.array([*centre, 0.0])
        nodes.extend([corner, *(corner + size * np.eye(3))])

    for outline in parts.outlines:
        pieces = triangles(outline)
        areas = np.array([area_of(outline[t]) for t in pieces])
        add(areas @ outline[pieces].mean(axis=1) / areas.sum(), np.sqrt(areas.sum()) / 4)
    for hinge, (low, high) in zip(parts.hinges[::2], parts.lines, strict=False):
        size = np.sqrt(hinge.crease.length * np.linalg.norm(high - low)) / 4
        add((low + high) / 2, size)
    cells = np.arange(len(nodes)).reshape(-1, 4)
    return Body.build(skfem.MeshTet1(np.array(nodes).T, cells.T), "tet4", parts=True)


def _points(body: Body, owners: Sequence[int], places: Sequence[np.ndarray]) -> sp.csr_array:
    """Weights (p, n) of the nodes at points (3,) of the parts that own them."""
    columns = [range(4 * k, 4 * k + 4) for k in owners]
    values = [point_weights(body, k, place) for k, place in zip(owners, places, strict=True)]
    rows = np.repeat(np.arange(len(owners)), 4)
    entries = (np.concatenate(values), (rows, np.concatenate(columns)))
    return sp.csr_array(sp.coo_array(entries, shape=(len(owners), len(body.nodes))))


def _of_masses(parts: Parts) -> tuple[list[int], list[np.ndarray]]:
    """Whose each mass is, and its place (3,)."""
    owners = parts.where[:, 0].astype(int).tolist()
    return owners, [np.array([x, y, 0.0]) for x, y in parts.where[:, 1:]]


def _corners(body: Body, parts: Parts) -> tuple[sp.csr_array, np.ndarray, np.ndarray]:
    """Weights (v, n) of the nodes at corners on the middle surface, of which part they are (v,),
    and triangles (t, 3) of them."""
    owners, places, faces = [], [], []
    for k, outline in enumerate(parts.outlines):
        faces.append(triangles(outline) + len(owners))
        owners += [k] * len(outline)
        places += [np.array([*X, 0.0]) for X in outline]
    return _points(body, owners, places), np.array(owners), np.concatenate(faces)


def gap_of(structure: Structure) -> float:
    """How far middle surfaces stay apart: a thickness, or less where panels lie closer flat."""
    import shapely

    outlines = [shapely.Polygon(outline) for outline in structure.pattern.panels]
    tree = shapely.STRtree(outlines)
    reach = 3 * structure.sheet.h
    i, j = tree.query(outlines, predicate="dwithin", distance=reach)
    near = [outlines[a].distance(outlines[b]) for a, b in zip(i, j, strict=True) if a < b]
    return min(structure.sheet.h, 0.4 * min(near, default=reach))


def held(model, terms: Sequence[Term], u: np.ndarray, **options) -> Scene:
    """A model's terms, held against the rigid motions that nothing else holds, about u (n, 3).

    ``options`` of its first scene; later ones take over what it knows.
    """
    body, old, heavy = model.body, model.scene, model.ground is not None
    if old is not None:
        options = {"scales": old.scales, "sections": old.sections}
        turning = [row for row in old.rows if row.name.startswith("rotation")]
        graphs = {id(t.graph) for t in old.terms}
        same = all(t.graph is None or id(t.graph) in graphs for t in terms)
        if same and min(_sight(row, body.nodes + u) for row in turning) > 0.7:
            return old.with_terms(terms)
    rows = [translation_row(body, axis) for axis in ((0, 1) if heavy else (0, 1, 2))]
    turns = (2,) if heavy and not model.upright else (0, 1, 2)
    rows += [rotation_row(body, axis, u) for axis in turns]
    return Scene(body, terms, rows=rows, **options)
