"""Locking: elements that are too stiff for what they are asked, said before and after solving.

Where an element curves, fully integrated quadratic ones stretch as they bend: with the curvature κ,
the length L and the body's thickness H they are stiffer in bending by about Σ (κL²/H)²/30, summed
over the directions along the surface. κL² is eight times the rise of an edge's middle node over its
chord. Straight ones shear as they bend, by about 0.4 (L/H)². Reduced points (hex20, or the axis
that is ``bent``) take no part in the first, and quadratic elements none in the second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from solver.mesh.body import Body

# Excess of stiffness below which the default element stays, and above which it is said: coarse
# meshes of ordinary bodies cost 1 or 2 % anyhow.
NEGLIGIBLE, CURVED = 0.01, 0.03
# Of linear elements, which are worse: those more than twice as long as the body is thick.
LINEAR = 0.4 * 2.0**2
# Poisson's ratios from which on Cook's membrane of 8² elements is 2 % and more too stiff.
NEARLY = {"hex27": 0.499, "tet10": 0.499, "hex8": 0.49, "tet4": 0.49}
SAMPLES = 24


class Locking(UserWarning):
    """A body's elements are too stiff for its shape or material.

    ``cause``: "curved", "linear" or "incompressible"; ``element``; ``excess``: about the stiffness
    in bending too much, over the right one (nan for a material).
    """

    def __init__(self, cause: str, element: str, excess: float, text: str):
        super().__init__(cause, element, excess, text)  # all of them, to be pickled
        self.cause, self.element, self.excess = cause, element, excess

    def __str__(self) -> str:
        """The text."""
        return self.args[-1]


def of_shape(body: Body, u: np.ndarray | None = None) -> tuple[Locking, ...]:
    """What the shape of a body's elements costs, displaced by u (n, 3) if given.

    Of linear elements only u tells, for a slice in plane strain doesn't bend however thin it is.
    """
    linear = body.element in ("hex8", "tet4")
    too_much = excess(body, u)
    if too_much < (LINEAR if linear else CURVED):
        return ()
    loss = 100 * too_much / (1 + too_much)
    shape = "much longer than the body is thick" if linear else "curved in a thin body"
    when = "" if u is None or linear else " at the end of the path"
    cure = "; or name the axis along which they curve as bent" if body.element == "hex27" else ""
    text = (
        f"{body.element} elements are {shape}{when}: where they bend they move about "
        f"{min(loss, 99):.0f} % too little; take hex20 or shorter elements{cure}"
    )
    return (Locking("linear" if linear else "curved", body.element, too_much, text),)


def of_material(body: Body, nu: float) -> tuple[Locking, ...]:
    """What a Poisson's ratio, the largest in the body, will cost."""
    if not nu >= NEARLY.get(body.element, np.inf):
        return ()
    loss = "half and more" if body.element in ("hex8", "tet4") else "some percent"
    text = (
        f"{body.element} elements with nu = {nu:g}: nearly incompressible, they move {loss} too "
        "little unless the mesh is very fine; take hex20"
    )
    return (Locking("incompressible", body.element, np.nan, text),)


def excess(body: Body, u: np.ndarray | None = None) -> float:
    """Stiffness in bending too much, over the right one: the largest of a sample of cells.

    The cells' shape is that of the body displaced by u (n, 3), their body's thickness that at rest.
    """
    if body.element == "hex20":
        return 0.0
    if body.element in ("hex8", "tet4"):
        return 0.0 if u is None else _sheared(body, u)
    X = body.nodes if u is None else body.nodes + u
    rises = []
    for edges in _edges(body.reference.doflocs, body.element, body.bent):
        start, middle, end = (X[body.cells[:, edges[:, i]]] for i in range(3))  # (m, edges, 3)
        rises.append(8 * (middle - (start + end) / 2))
    corners = body.cells[:, : body.mesh.nnodes]
    # No cell is thinner than this: most bodies are cleared by it, and need no thickness.
    least = body.weights.sum(axis=1) / (np.ptp(body.nodes[corners], axis=1) ** 2).sum(axis=1)
    bound = sum((r**2).sum(axis=-1).max(axis=1) for r in rises) / (30 * least**2)
    cells = _sample(bound, NEGLIGIBLE)
    rest, now = _axes(body.nodes[corners[cells]]), _axes(X[corners[cells]])
    worst = 0.0
    # A ring may be cut thinner than it is, so each direction counts with its own thickness.
    for k in range(3):
        up = (
            sum((np.einsum("sej,sj->se", r[cells], now[:, k]) ** 2).max(axis=1) for r in rises) / 30
        )
        able = up > NEGLIGIBLE * least[cells] ** 2
        thickness = thickness_at(body, cells[able], rest[able, k])
        worst = max(worst, (up[able] / thickness**2).max(initial=0.0))
    return float(worst)


def _sheared(body: Body, u: np.ndarray) -> float:
    """The same of linear elements, where u moves them across their thinnest direction."""
    edges = np.concatenate(_edges(body.reference.doflocs, body.element, None))
    ends = body.nodes[body.cells[:, edges]]
    longest = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1).max(axis=1)
    cells = _sample(0.4 * (longest**3 / body.weights.sum(axis=1)) ** 2, LINEAR)
    across = _axes(body.nodes[body.cells[cells]])[:, 2]
    moved = np.abs(np.einsum("skj,sj->sk", u[body.cells[cells]], across)).max(axis=1)
    bends = moved > 0.1 * np.linalg.norm(u, axis=1).max()
    cells, across = cells[bends], across[bends]
    ratio = longest[cells] / thickness_at(body, cells, across)
    return float((0.4 * ratio**2).max(initial=0.0))


def _sample(bound: np.ndarray, least: float) -> np.ndarray:
    """Some of the cells whose bound is above ``least``, from the smallest to the largest."""
    suspects = np.flatnonzero(bound > least)
    some = np.linspace(0, len(suspects) - 1, min(SAMPLES, len(suspects))).astype(int)
    return suspects[np.argsort(bound[suspects])][some]


def _edges(at: np.ndarray, element: str, bent: int | None) -> list[np.ndarray]:
    """Per axis of a hexahedron, or once, nodes (edges, 2 | 3): start, (middle,) end."""
    hexes = element.startswith("hex")
    corners = range(8 if hexes else 4)
    axes: dict[int, list] = {}
    for a in corners:
        for b in corners:
            along = np.flatnonzero(at[a] != at[b])
            if a >= b or (hexes and len(along) > 1):
                continue
            middle = np.flatnonzero(np.abs(at - (at[a] + at[b]) / 2).max(axis=1) < 1e-9)
            axes.setdefault(along[0] if hexes else 0, []).append([a, *middle[:1], b])
    return [np.array(edges) for axis, edges in axes.items() if axis != bent]


def _axes(corners: np.ndarray) -> np.ndarray:
    """Directions (s, 3, 3) in which cells with corners (s, k, 3) are longest to thinnest."""
    return np.linalg.svd(corners - corners.mean(axis=1, keepdims=True))[2]


def thickness_at(body: Body, cells: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Thickness of the body (s,) at the centres of ``cells`` (s,) in ``directions`` (s, 3).

    Between the nearest boundary facets, as flat as their corners are, on either side.
    """
    mesh = body.mesh
    facets = mesh.p[:, mesh.facets[:, mesh.boundary_facets()]].transpose(2, 1, 0)  # (f, k, 3)
    k = facets.shape[1]
    around = [(a, (a + 1) % k) for a in range(k)] if k == 4 else [(0, 1)]
    third = facets.mean(axis=1) if k == 4 else facets[:, 2]
    a = np.concatenate([facets[:, i] for i, _ in around])
    b = np.concatenate([facets[:, j] for _, j in around]) - a
    c = np.concatenate([third] * len(around)) - a
    centres = mesh.p[:, mesh.t[:, cells]].mean(axis=1).T
    out = np.full(len(cells), np.inf)
    for s, (centre, d) in enumerate(zip(centres, directions, strict=True)):
        # Where the line centre + t d meets a + x b + y c.
        across = np.cross(d, c)
        with np.errstate(divide="ignore", invalid="ignore"):
            over = 1 / np.einsum("fi,fi->f", b, across)
            off = centre - a
            x = np.einsum("fi,fi->f", off, across) * over
            turned = np.cross(off, b)
            y = turned @ d * over
            t = np.einsum("fi,fi->f", c, turned) * over
            hit = t[(x > -1e-6) & (y > -1e-6) & (x + y < 1 + 1e-6)]
        if (hit > 0).any() and (hit < 0).any():
            out[s] = hit[hit > 0].min() - hit[hit < 0].max()
    return out
