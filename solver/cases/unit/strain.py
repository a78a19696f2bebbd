"""How hard a folded unit is strained: each layer's peak strain and stress, and what pulls its
layers apart (§4.2.3, §4.8.4).

At the ends of the active layer elastic stress has no limit: a finer mesh finds ever more. What is
stated is therefore *linearised* through each layer's thickness, as pressure vessels are judged, and
averaged over ``length`` along the sheet, by default h_s. Averages are of Green's strain and of
RᵀσR, which bending does not turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from solver.cases.unit.model import Model, axis_nodes, opposite, plane
from solver.mesh.body import Surface
from solver.output import cell_fields
from solver.physics.elastic import Elastic


@dataclass(frozen=True)
class Layer:
    """Peaks in one layer, over its two faces.

    ``tension`` and ``compression``: largest and smallest principal elastic strain λ − 1;
    ``stress``: von Mises, of Cauchy's stress, in E_s.
    """

    tension: float
    compression: float
    stress: float

    @property
    def strain(self) -> float:
        """The larger of the two, by size."""
        return max(self.tension, -self.compression)


@dataclass(frozen=True)
class Strain:
    """Peaks of a state: the two layers, and the traction between them in E_s.

    ``opening``: the largest pull across the interface, 0 where it is pressed together
    everywhere; ``shear``: the largest along it. Tractions are forces per area of the flat state.
    ``length``: in l_s, that all are averaged over.
    """

    passive: Layer
    active: Layer
    opening: float
    shear: float
    length: float


def strain(model: Model, x: np.ndarray, e: float, *, length: float | None = None) -> Strain:
    """Peaks of the state x (size,) of a unit at the load e.

    ``length``: of averaging, in l_s; h_s if None. Raises ValueError for a length that is not
    positive and for a state that the material does not admit.
    """
    unit, body = model.unit, model.body
    length = unit.slenderness if length is None else length
    if not (np.isfinite(length) and length > 0):
        raise ValueError(f"length = {length!r}; expected a length of averaging above 0, in l_s")
    u = model.scene.displacement(x, e)
    # The term itself, not one that a clock wraps.
    (own,) = [t for t in model.terms if t.name == "elastic"]
    elastic = Elastic(body, own.material, own.growth)
    fields = cell_fields(body, u, [elastic], e)
    E, S = _corotated(fields)
    active = body.cells_of("active")
    top = unit.slenderness
    faces = {"passive": (0.0, top), "active": (top, top + unit.active)}
    layers = {}
    for name, (low, high) in faces.items():
        cells = np.flatnonzero(active == (name == "active"))
        layers[name] = _layer(model, cells, E[cells], S[cells], (low, high), length)
    opening, shear = _interface(model, u, e, active, length)
    return Strain(**layers, opening=opening, shear=shear, length=length)


def _corotated(fields) -> tuple[np.ndarray, np.ndarray]:
    """Green's elastic strain, and RᵀσR with the rotation R of Fe; each (m, q, 3, 3)."""
    Fe = fields["F"] @ np.linalg.inv(fields["growth"])
    C = np.swapaxes(Fe, 2, 3) @ Fe
    squares, axes = np.linalg.eigh(C)
    inverse = (axes / np.sqrt(squares)[..., None, :]) @ np.swapaxes(axes, 2, 3)
    R = Fe @ inverse
    return (C - np.eye(3)) / 2, np.swapaxes(R, 2, 3) @ fields["cauchy"] @ R


def _layer(model: Model, cells, E, S, faces, length) -> Layer:
    X = model.body.points()[cells]
    # One place per column of cells: those above each other have one centre in the plane.
    middle = X[..., :2].mean(axis=1)
    _, first, own = np.unique(middle.round(9), axis=0, return_index=True, return_inverse=True)
    points, q = X.reshape(-1, 3), X.shape[1]
    # The points of a column count however long it is, others within half the length.
    rows, cols = _pairs(middle[first], points[:, :2], length / 2)
    rows = np.append(rows, np.repeat(own.ravel(), q))
    cols = np.append(cols, np.arange(len(points)))
    W = sp.csr_array((np.ones(len(rows)), (rows, cols)), shape=(len(first), len(points)))
    W.data = model.body.weights[cells].ravel()[W.indices]  # pairs that stand twice count once
    z = points[:, 2]
    s0, s1, s2 = (W @ np.stack([np.ones_like(z), z, z**2], axis=1)).T
    centre, spread = s1 / s0, s2 / s0 - (s1 / s0) ** 2

    def linearised(T):
        T = T.reshape(-1, 9)
        mean = (W @ T) / s0[:, None]
        slope = ((W @ (z[:, None] * T)) / s0[:, None] - centre[:, None] * mean) / spread[:, None]
        ends = [mean + (face - centre)[:, None] * slope for face in faces]
        return np.stack(ends).reshape(-1, 3, 3)

    stretches = np.sqrt(np.maximum(1 + 2 * np.linalg.eigvalsh(linearised(E)), 0.0)) - 1
    s = linearised(S)
    s -= np.trace(s, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    mises = np.sqrt(1.5 * (s**2).sum(axis=(1, 2)))
    return Layer(max(0.0, float(stretches.max())), min(0.0, float(stretches.min())),
                 float(mises.max()))  # fmt: skip


def _interface(model: Model, u, e, active, length) -> tuple[float, float]:
    """Peaks of pull and shear: what the active layer's nodes on the interface carry, per area.

    These forces balance the sheet's whatever the stress does at a corner. Hats around each node
    average them, which converge where stress does not.
    """
    body = model.body
    one, two = body.mesh.f2t
    facets = np.flatnonzero((two >= 0) & (active[one] != active[two]))
    surface = body.surface(facets)
    nodes = np.unique(surface.nodes)
    area = np.bincount(
        surface.nodes.ravel(), np.einsum("fq,fqk->fk", surface.weights, surface.shapes).ravel(),
        minlength=len(body.nodes),
    )[nodes]  # fmt: skip
    pull = _force_of(model, u, e, active)
    # In a plane of symmetry the stress in it stands too; it has no part in the traction.
    if model.mirrors == ("turn",):
        cut, twin = opposite(body)
        pull[axis_nodes(body), :2] = 0.0
        pull[twin] = (pull[twin] + (-1, -1, 1) * pull[cut]) / 2
        pull[cut] = (-1, -1, 1) * pull[twin]
    else:
        for axis in ("xy".index(m) for m in model.mirrors):
            pull[plane(body, axis), axis] = 0.0
    pull = pull[nodes]
    pull = np.einsum("nij,nj->ni", _frames(surface, u, len(body.nodes))[nodes], pull)
    place = body.nodes[nodes, :2]
    reach = np.maximum(length, _sizes(body.nodes[:, :2], surface.nodes)[nodes])
    rows, cols = _pairs(place, place, reach)
    hat = (1 - np.abs(place[rows] - place[cols]) / reach[rows, None]).prod(axis=1)
    H = sp.csr_array((hat, (rows, cols)), shape=(len(nodes), len(nodes)))
    whole = H @ area
    # Of serendipity elements a corner's area is negative.
    good = whole > 0.2 * (H @ np.abs(area))
    t = (H @ pull)[good] / whole[good, None]
    return max(0.0, float(t[:, 0].max())), float(np.linalg.norm(t[:, 1:], axis=1).max())


def _force_of(model: Model, u, e, active) -> np.ndarray:
    """Inner force and weight of the active layer at the nodes (n, 3)."""
    body, unit = model.body, model.unit
    (own,) = [t for t in model.terms if t.name == "elastic"]
    force = Elastic(body, own.material, own.growth, cells=active).evaluate(u, e, 1).force
    if model.heavy:
        density = np.where(active, unit.rho_ratio, 0.0)[:, None]
        force[:, 2] += unit.weight * body.node_volumes(density)
    return force


def _frames(surface: Surface, u: np.ndarray, n: int) -> np.ndarray:
    """At each node of the interface (n, 3, 3): its deformed normal, out of the active layer, the
    direction that x has become, and a third."""
    moved = surface.frames + np.einsum("fqkt,fki->fqti", surface.tangents, u[surface.nodes])
    weights = surface.weights[..., None] * np.abs(surface.shapes)
    # Derivatives of the deformed positions along x and y.
    parts = np.einsum("fqk,fqta,fqti->fkai", weights, surface.frames[..., :2], moved)
    sides = np.zeros((n, 2, 3))
    np.add.at(sides, surface.nodes, parts)
    out = np.zeros((n, 3, 3))
    nodes = np.unique(surface.nodes)
    along = sides[nodes, 0] / np.linalg.norm(sides[nodes, 0], axis=1, keepdims=True)
    normal = np.cross(sides[nodes, 1], along)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    out[nodes] = np.stack([normal, along, np.cross(normal, along)], axis=1)
    return out


def _sizes(places: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """How far each node's nearest neighbours on a facet are, at most, (n,)."""
    corner = places[facets]
    apart = np.abs(corner[:, :, None] - corner[:, None]).max(axis=-1)
    apart[apart == 0] = np.inf
    out = np.zeros(len(places))
    np.maximum.at(out, facets, apart.min(axis=2))
    return out


def _pairs(centres: np.ndarray, points: np.ndarray, reach) -> tuple[np.ndarray, np.ndarray]:
    """(centre, point) of all points within reach along both axes."""
    near = cKDTree(points).query_ball_point(centres, reach, p=np.inf)
    counts = [len(k) for k in near]
    return np.repeat(np.arange(len(centres)), counts), np.concatenate(near).astype(int)
