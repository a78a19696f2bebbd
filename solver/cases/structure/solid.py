"""A structure as a solid: sheet and layers as they are, on a mesh of the whole pattern.

What the fast level (:mod:`solver.cases.structure.model`) takes for rigid or for a law bends here:
panels sag and twist, hinges curl. Lengths are in units of the pattern's extent, stresses in those
of the sheet's modulus. Panels touch each other with their middle surfaces, a thickness apart; what
a hinge touches is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from solver.cases.structure.linked import Linked
from solver.cases.structure.model import EFFECTS, acting, gap_of, held
from solver.cases.structure.parts import Structure
from solver.cases.structure.sheet import Sheet, Sizes, apron, mesh
from solver.cases.structure.touch import Touch
from solver.equilibrium.clock import Deadline
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.physics.elastic import Elastic
from solver.physics.ground import Ground
from solver.physics.growth import AlongFibre, Growth, Isotropic
from solver.physics.loads import Gravity
from solver.physics.materials import NeoHookean
from solver.physics.term import Term

NEAR = 2.5  # thicknesses, or gaps where those are less, within which contact is kept ready
GROWTHS = ("uniaxial", "isotropic")


@dataclass(frozen=True, eq=False)
class Solid:
    """A structure on a mesh, with what :func:`solver.cases.structure.path.fold` asks of a model.

    Sparse weights of the nodes (…, n) at places on the panels' middle surface: ``sides``, three on
    each side of each hinge, by which its angle is told; ``ends`` of its side on a and of that on b;
    ``outlines``: corners of each panel. ``about`` (hinges,): angles near which others are sought.
    """

    structure: Structure
    effects: tuple[str, ...]
    upright: bool
    sheet: Sheet
    scene: Scene = field(repr=False)
    ground: Ground | None
    contact: Touch | None
    sides: sp.csr_array = field(repr=False)
    ends: tuple[sp.csr_array, sp.csr_array] = field(repr=False)
    outlines: tuple[sp.csr_array, ...] = field(repr=False)
    about: np.ndarray = field(repr=False)

    @property
    def body(self) -> Body:
        """That of the sheet."""
        return self.sheet.body

    def angles(self, x: np.ndarray, e: float) -> np.ndarray:
        """Angle between the panels at each crease, rad, (creases,): between their slopes near the
        hinge, about its axis there."""
        return self._angles(self.scene.displacement(x, e))

    def _angles(self, u: np.ndarray) -> np.ndarray:
        X = (self.sides @ (self.body.nodes + u)).reshape(-1, 2, 3, 3)
        # Of each side a place on the axis, one further along it, and one into its panel.
        t = X[:, :, 1] - X[:, :, 0]
        into = X[:, :, 2] - X[:, :, 0]
        t /= np.linalg.norm(t, axis=-1, keepdims=True)
        into[:, 0] *= -1  # both from a to b
        into -= (into * t).sum(axis=-1, keepdims=True) * t
        into /= np.linalg.norm(into, axis=-1, keepdims=True)
        axis = t.sum(axis=1)
        axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
        sine = (np.cross(into[:, 0], into[:, 1]) * axis).sum(axis=-1)
        raw = np.arctan2(sine, (into[:, 0] * into[:, 1]).sum(axis=-1))
        return raw + 2 * np.pi * np.round((self.about - raw) / (2 * np.pi))

    def panels(self, x: np.ndarray, e: float) -> list[np.ndarray]:
        """Outline (k, 3) of the middle surface of each panel, in the pattern's unit."""
        X = self._places(x, e)
        return [outline @ X for outline in self.outlines]

    def strips(self, x: np.ndarray, e: float) -> np.ndarray:
        """Corners (creases, 4, 3) of each hinge's strip: its side on a, then back along b."""
        X = self._places(x, e)
        a, b = ((end @ X).reshape(-1, 2, 3) for end in self.ends)
        return np.concatenate([a, b[:, ::-1]], axis=1)

    def _places(self, x: np.ndarray, e: float) -> np.ndarray:
        u = self.scene.displacement(x, e)
        return self.structure.pattern.extent * (self.body.nodes + u)

    def lowest(self, u: np.ndarray) -> float:
        """Height of the lowest point above the ground, in the pattern's unit."""
        return float(self.structure.pattern.extent * self.ground.gaps(u).min())

    def clearance(self, u: np.ndarray) -> float:
        """Of panels from each other, in the pattern's unit; inf where none are near."""
        return self.structure.pattern.extent * self.contact.distance(u)

    def centre_of_mass(self, u: np.ndarray) -> np.ndarray:
        """Of the structure displaced by u (n, 3), in the pattern's unit, (3,)."""
        m = self.body.weights * _densities(self.structure, self.sheet)[:, None]
        x = np.einsum("qk,mki->mqi", self.body.shapes, (self.body.nodes + u)[self.body.cells])
        return self.structure.pattern.extent * np.einsum("mq,mqi->i", m, x) / m.sum()

    def anchored(self, x: np.ndarray, e: float) -> Solid:
        """The model for the step from x: angles go on from those there, contact is ready for what
        is near, and rows that hold rotations see them as the structure lies now."""
        u = self.scene.displacement(x, e)
        contact = None if self.contact is None else self.contact.moved(u)
        terms = [contact if t is self.contact else t for t in self.scene.terms]
        scene = held(self, terms, u)
        return replace(self, scene=scene, contact=contact, about=self._angles(u))


def build(
    structure: Structure,
    effects: Sequence[str] = EFFECTS,
    *,
    level: int | Sizes = 1,
    growth: str = "uniaxial",
    upright: bool = False,
    deadline: float | None = None,
) -> Solid:
    """The scene of a structure lying flat, as a solid.

    ``effects``: as of :func:`solver.cases.structure.model.build`; ``growth``: of the layers, across
    each hinge only ("uniaxial") or in all directions ("isotropic"); ``level``: see
    :data:`solver.cases.structure.sheet.LEVELS`; ``upright`` and ``deadline`` as in
    :func:`solver.cases.structure.model.build`. Raises ValueError for what is not offered, and
    ImportError where Gmsh can't be loaded.
    """
    effects, heavy = acting(effects)
    if growth not in GROWTHS:
        raise ValueError(f"growth {growth!r}; expected {' or '.join(GROWTHS)}")
    sheet = mesh(structure, level)
    body, extent, E = sheet.body, structure.pattern.extent, structure.sheet.E
    own = _by_layer(structure, sheet, lambda layer: layer.E)
    material = NeoHookean(own / E, structure.nu)
    terms: list[Term] = [Elastic(body, material, _growth(structure, sheet, growth))]
    ground = contact = None
    if heavy:
        weight = structure.g * extent / E
        areal = max(structure.weight_per_area(k) for k in range(len(structure.laws))) / extent
        ground = Ground(
            body, body.surface(lambda X: np.ones(len(X), bool)),
            thickness=structure.sheet.h / extent, pressure=weight * areal,
            height=float(body.nodes[:, 2].min()),
        )  # fmt: skip
        terms += [Gravity(body, _densities(structure, sheet), weight), ground]
    if "contact" in effects:
        gap = gap_of(structure) / extent
        energy = gap * max(law.stiffness[0] for law in structure.laws) / (E * extent**3)
        contact = Touch(body, *sheet.middle(), gap=gap, energy=energy, reach=NEAR * gap)
        terms.append(contact)
    sides, a, b, outlines = _places(structure, sheet)
    empty = Solid(
        structure, effects, upright, sheet, None, ground, contact, sides, (a, b), outlines,
        np.zeros(len(structure.pattern.hinges)),
    )  # fmt: skip
    sections = _sections(structure, sheet, heavy)
    scene = held(empty, terms, np.zeros_like(body.nodes), sections=sections)
    if deadline is not None:
        # Scales are an evaluation too, and a model must come of it however late it is.
        scene = scene.with_terms([*terms, Deadline(deadline)])
    return replace(empty, scene=scene)


def _by_layer(structure: Structure, sheet: Sheet, value) -> np.ndarray:
    """A layer's value of each cell."""
    out = np.full(len(sheet.hinge), float(value(structure.sheet)))
    for k, layer in enumerate(structure.layers):
        if layer is not None:
            out[sheet.active & (sheet.hinge == k)] = value(layer)
    return out


def _densities(structure: Structure, sheet: Sheet) -> np.ndarray:
    return _by_layer(structure, sheet, lambda layer: layer.rho)


def _growth(structure: Structure, sheet: Sheet, growth: str) -> Growth:
    creases = [hinge.crease for hinge in structure.pattern.hinges]
    # Cells that are no layer's contract by nothing.
    full = np.array([0.0 if own is None else own.contraction for own in structure.layers] + [0.0])
    start = np.array([c.start for c in creases] + [0.0])
    end = np.array([c.end for c in creases] + [1.0])
    of = np.where(sheet.active, sheet.hinge, len(creases))

    def g(e: float) -> np.ndarray:
        on = np.clip((e - start) / (end - start), 0.0, 1.0)
        return (-full * on)[of]

    if growth == "isotropic":
        return Isotropic(g)
    axes = np.array([hinge.axis for hinge in structure.pattern.hinges] + [[1.0, 0.0]])
    across = np.column_stack([-axes[:, 1], axes[:, 0], np.zeros(len(axes))])
    return AlongFibre(g, across[of], cells=sheet.active)


def _places(structure: Structure, sheet: Sheet):
    """Weights of the nodes at the places that angles, strips and outlines are told by."""
    pattern = structure.pattern
    seen, a, b = [], [], []
    for hinge in pattern.hinges:
        across = np.array([-hinge.axis[1], hinge.axis[0]])
        # Beyond what the hinge's end does to the panel beside it.
        off, deep = hinge.width / 8 * hinge.axis, apron(structure)
        for face, side, way, ends in zip(hinge.faces, hinge.sides, (-1, 1), (a, b), strict=True):
            into = way * deep * across
            told = [side - off + into, side + off + into, side - off + 1.25 * into]
            seen.append(sheet.at(face, np.array(told) / pattern.extent))
            ends.append(sheet.at(face, np.array([side - 4 * off, side + 4 * off]) / pattern.extent))
    outlines = tuple(sheet.at(k, X / pattern.extent) for k, X in enumerate(pattern.panels))
    return (*(sp.vstack(rows, "csr") for rows in (seen, a, b)), outlines)


def _sections(structure: Structure, sheet: Sheet, grounded: bool) -> Linked:
    """How steps turn panels, and rows of nodes across the hinges between them."""
    pattern, body, extent = structure.pattern, sheet.body, structure.pattern.extent
    of, pairs, sides = np.full(len(body.nodes), -1), [], []
    for k in range(len(pattern.panels)):
        of[body.cells[sheet.panel == k]] = k
    count = len(pattern.panels)

    def mean(nodes: np.ndarray) -> sp.csr_array:
        out = np.zeros((1, len(of)))
        out[0, nodes] = 1 / len(nodes)
        return sp.csr_array(out)

    for k, hinge in enumerate(pattern.hinges):
        nodes = np.unique(body.cells[sheet.hinge == k])
        across = np.array([-hinge.axis[1], hinge.axis[0]])
        depth = np.round(body.nodes[nodes, :2] @ across - hinge.sides[0] @ across / extent, 9)
        rows = [nodes[depth == s] for s in np.unique(depth)]
        a, b = hinge.faces
        numbers = [a, *range(count, count + len(rows) - 2), b]
        count += len(rows) - 2
        for number, row in zip(numbers, rows, strict=True):
            # A panel also has what of a layer stands on its edge.
            of[row[of[row] < 0]] = number
        pairs += list(pairwise(numbers))
        inner = [row[of[row] == own] for row, own in zip(rows, numbers, strict=True)]
        sides += [(mean(low), mean(high)) for low, high in pairwise(inner)]
    first = int(np.argmax([np.sum(of == k) for k in range(len(pattern.panels))]))
    both = tuple(sp.vstack([pair[k] for pair in sides], "csr") for k in (0, 1))
    return Linked.of_links(of, np.array(pairs), both, first, grounded=grounded)
