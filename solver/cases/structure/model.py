"""A structure of rigid panels and hinges: the fast level.

Panels are rigid, hinges bend by a law (:mod:`solver.cases.structure.hinges`); weight, ground and
contact of panels act where they are asked for. What this level misses: panels that sag or twist,
hinges that curve about the other axis, the sheet that hinges share around a vertex, friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import skfem

from solver.cases.structure.hinges import Hinges, Law, Layer, point_weights
from solver.cases.structure.linked import Linked
from solver.cases.structure.pattern import Pattern, area_of, triangles
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
class Structure:
    """What is folded: ``sheet``, and on each hinge of ``pattern`` a layer of ``layers`` (one for
    all, or one per crease; None: the sheet alone) with its ``laws``.

    ``g``: the acceleration of gravity. Raises ValueError for what does not fit together.
    """

    pattern: Pattern
    sheet: Layer
    layers: tuple[Layer | None, ...]
    laws: tuple[Law, ...]
    g: float = 9.81
    nu: float = 0.3

    @classmethod
    def of(
        cls,
        pattern: Pattern,
        sheet: Layer,
        layer: Layer | Sequence[Layer | None],
        *,
        g: float = 9.81,
        nu: float = 0.3,
    ) -> Structure:
        """With the laws of bilayer sections; creases that don't fold have no layer."""
        count = len(pattern.hinges)
        layers = (layer,) * count if isinstance(layer, Layer) else tuple(layer)
        if len(layers) != count:
            raise ValueError(f"{len(layers)} layers for {count} creases; expected one, or one each")
        layers = tuple(
            own if h.crease.fold else None for own, h in zip(layers, pattern.hinges, strict=True)
        )
        known: dict = {}
        laws = []
        for hinge, own in zip(pattern.hinges, layers, strict=True):
            key = own, hinge.crease.length, round(hinge.width, 12)
            if key not in known:
                size = key[1], hinge.width, nu
                bare = own is None
                known[key] = (
                    Law.of_sheet(sheet, *size) if bare else Law.of_section(sheet, own, *size)
                )
            laws.append(known[key])
        return cls(pattern, sheet, layers, tuple(laws), g, nu)

    @cached_property
    def masses(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the parts that weigh, each on a panel: mass (k,), and (k, 3): panel, x and y."""
        mass, where = [], []
        for k, outline in enumerate(self.pattern.panels):
            for t in triangles(outline):
                mass.append(self.sheet.rho * self.sheet.h * area_of(outline[t]))
                where.append((k, *outline[t].mean(axis=0)))
        for hinge, layer in zip(self.pattern.hinges, self.layers, strict=True):
            per_area = self.sheet.rho * self.sheet.h
            if layer is not None:
                per_area += layer.rho * layer.h
            half = per_area * hinge.crease.length * hinge.width / 2
            middle = hinge.sides.mean(axis=0)
            for face, side in zip(hinge.faces, hinge.sides, strict=True):
                mass.append(half)
                where.append((face, *((side + middle) / 2)))
        return np.array(mass), np.array(where)


@dataclass(frozen=True, eq=False)
class Model:
    """A structure as a scene. ``corners`` (v, n) sparse: weights of the nodes at the panels'
    corners, ``owners`` (v,): of which panel each is."""

    structure: Structure
    effects: tuple[str, ...]
    body: Body
    scene: Scene = field(repr=False)
    hinges: Hinges
    ground: PointGround | None
    contact: Touch | None
    corners: sp.csr_array = field(repr=False)
    owners: np.ndarray = field(repr=False)

    def angles(self, x: np.ndarray, e: float) -> np.ndarray:
        """Angle of each hinge, rad, (hinges,)."""
        return self.hinges.angles(self.scene.displacement(x, e))

    def panels(self, x: np.ndarray, e: float) -> list[np.ndarray]:
        """Outline (k, 3) of the middle surface of each panel."""
        X = self.corners @ (self.body.nodes + self.scene.displacement(x, e))
        return [X[self.owners == k] for k in range(len(self.structure.pattern.panels))]

    def strips(self, x: np.ndarray, e: float) -> np.ndarray:
        """Corners (hinges, 4, 3) of each hinge's strip, as if it were straight."""
        return self.hinges.strips(self.scene.displacement(x, e))

    def anchored(self, x: np.ndarray, e: float) -> Model:
        """The model for the step from x: angles go on from those there, contact is ready for what
        is near, and rows that hold rotations see them as the structure lies now."""
        u = self.scene.displacement(x, e)
        hinges = self.hinges.moved(u)
        contact = None if self.contact is None else self.contact.moved(u)
        terms = [{"hinges": hinges, "contact": contact}.get(t.name, t) for t in self.scene.terms]
        return replace(self, scene=_scene(self, terms, u), hinges=hinges, contact=contact)


def build(
    structure: Structure,
    effects: Sequence[str] = EFFECTS,
    *,
    deadline: float | None = None,
    rigid: float = RIGID,
) -> Model:
    """The scene of a structure lying flat.

    ``effects``: of "gravity", "ground" and "contact"; gravity and ground come together.
    ``deadline``: as in :class:`solver.cases.unit.choices.Watch`. Raises ValueError for unknown
    effects, and for panels that hang together with nothing.
    """
    effects = tuple(effects)
    unknown = [name for name in effects if name not in EFFECTS]
    if unknown:
        raise ValueError(f"effect {unknown[0]!r}; expected some of {', '.join(EFFECTS)}")
    if ("gravity" in effects) != ("ground" in effects):
        raise ValueError("weight and ground come together; give both effects or none")
    pattern = structure.pattern
    body = _body(structure)
    pairs = np.array([h.faces for h in pattern.hinges], int).reshape(-1, 2)
    sides = np.array(
        [
            [
                point_weights(body, face, np.array([*side, 0.0]))
                for face, side in zip(h.faces, h.sides, strict=True)
            ]
            for h in pattern.hinges
        ]
    ).reshape(-1, 2, 4)
    mass, where = structure.masses
    heaviest = int(np.argmax(np.bincount(where[:, 0].astype(int), mass)))
    linked = Linked.of_hinges(len(pattern.panels), pairs, sides, heaviest)
    if len(linked.order) < len(pattern.panels):
        reached = set(linked.order.tolist())
        loose = sorted(min(reached, set(range(len(pattern.panels))) - reached, key=len))
        raise ValueError(f"the faces {loose} hang together with the others by no crease")
    stiffness = np.array([law.stiffness[0] for law in structure.laws])
    volume = body.weights.sum(axis=1)
    modulus = rigid * stiffness.sum() / volume
    hinges = Hinges(body, pattern.hinges, structure.laws)
    terms: list[Term] = [Elastic(body, NeoHookean(modulus, 0.0)), hinges]
    corners, owners, faces = _corners(body, pattern, -structure.sheet.h / 2)
    ground = contact = None
    h = structure.sheet.h
    if "gravity" in effects:
        ground = PointGround(
            body, corners, force=structure.g * mass.sum() / 3, depth=0.1 * h, height=-h / 2
        )
        terms += [PointLoad(body, *_weight(structure, body, mass, where), name="gravity"), ground]
    middle, owners, faces = _corners(body, pattern, 0.0)
    if "contact" in effects:
        contact = Touch(
            body, middle, owners, faces, gap=_gap(structure), energy=float(stiffness.max())
        )
        terms.append(contact)
    if deadline is not None:
        terms.append(Deadline(deadline))
    extent = pattern.extent
    scales = Scales(extent, float(stiffness.sum()) / extent, float(stiffness.sum()))
    empty = Model(structure, effects, body, None, hinges, ground, contact, middle, owners)
    scene = _scene(empty, terms, np.zeros_like(body.nodes), scales=scales, sections=linked)
    return replace(empty, scene=scene)


def _body(structure: Structure) -> Body:
    """A tetrahedron per panel at its centroid, of the panel's size."""
    nodes = []
    for outline in structure.pattern.panels:
        parts = triangles(outline)
        areas = np.array([area_of(outline[t]) for t in parts])
        centre = areas @ outline[parts].mean(axis=1) / areas.sum()
        size = np.sqrt(areas.sum()) / 4
        corner = np.array([*centre, 0.0])
        nodes += [corner, *(corner + size * np.eye(3))]
    cells = np.arange(len(nodes)).reshape(-1, 4)
    return Body.build(skfem.MeshTet1(np.array(nodes).T, cells.T), "tet4", parts=True)


def _corners(body: Body, pattern: Pattern, z: float):
    """Weights (v, n) of the nodes at the panels' corners at height z, whose they are (v,), and
    triangles (t, 3) of them."""
    rows, columns, values, owners, faces, count = [], [], [], [], [], 0
    for k, outline in enumerate(pattern.panels):
        for X in outline:
            rows += [len(owners)] * 4
            columns += range(4 * k, 4 * k + 4)
            values += point_weights(body, k, np.array([*X, z])).tolist()
            owners.append(k)
        faces.append(triangles(outline) + count)
        count += len(outline)
    shape = (count, len(body.nodes))
    weights = sp.csr_array(sp.coo_array((values, (rows, columns)), shape=shape))
    return weights, np.array(owners), np.concatenate(faces)


def _weight(structure: Structure, body: Body, mass, where) -> tuple[np.ndarray, np.ndarray]:
    """All nodes, and the weight (n, 3) on each."""
    force = np.zeros_like(body.nodes)
    for m, (panel, *place) in zip(mass, where, strict=True):
        k = int(panel)
        weights = point_weights(body, k, np.array([*place, 0.0]))
        force[4 * k : 4 * k + 4, 2] -= m * structure.g * weights
    return np.arange(len(force)), force


def _gap(structure: Structure) -> float:
    """How far middle surfaces stay apart: a thickness, or less where panels lie closer flat."""
    import shapely

    outlines = [shapely.Polygon(outline) for outline in structure.pattern.panels]
    tree = shapely.STRtree(outlines)
    reach = 3 * structure.sheet.h
    i, j = tree.query(outlines, predicate="dwithin", distance=reach)
    near = [outlines[a].distance(outlines[b]) for a, b in zip(i, j, strict=True) if a < b]
    return min(structure.sheet.h, 0.4 * min(near, default=reach))


def _scene(model: Model, terms: Sequence[Term], u: np.ndarray, **options) -> Scene:
    """Its terms, held against the rigid motions that nothing else holds, about u (n, 3)."""
    body, heavy = model.body, "gravity" in model.effects
    old = model.scene
    if old is not None:
        options = {"scales": old.scales, "sections": old.sections}
        turning = [row for row in old.rows if row.name.startswith("rotation")]
        graphs = {id(t.graph) for t in old.terms}
        same = all(t.graph is None or id(t.graph) in graphs for t in terms)
        if same and min(_sight(row, body.nodes + u) for row in turning) > 0.7:
            return old.with_terms(terms)
    rows = [translation_row(body, axis) for axis in ((0, 1) if heavy else (0, 1, 2))]
    rows += [rotation_row(body, axis, u) for axis in ((2,) if heavy else (0, 1, 2))]
    return Scene(body, terms, rows=rows, **options)
