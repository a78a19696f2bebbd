"""A second look at a state of a folding unit, by a code path of its own.

Plain NumPy over nodes and cells: the state is mirrored to the whole unit, and energy, forces and
stiffness are integrated there from the formulas, with tensor-product shape functions, stresses as
complex-step derivatives of ψ and tangents as those of the stress. No support remains: the whole
unit must be at rest on the ground, or in empty space, by itself. What the solver's kernels, scene,
supports, rows, symmetry classes and PARDISO say has no part in it; only the mesh and the
displacement are taken.

Whether the stiffness is positive definite is decided by LAPACK's banded Cholesky factorisation, of
which a matrix with a negative eigenvalue has none. Where it fails, Lanczos' method finds the
negative eigenvalues, and a factorisation with as many further components held proves that there
are no more of them.

It is one file on purpose: what checks the solver is read from top to bottom, by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded, qr
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu
from scipy.spatial import cKDTree

from solver.cases.unit.model import Model
from solver.cases.unit.path import Folding
from solver.cases.unit.unit import GROWTHS, Unit
from solver.mesh.body import ELEMENTS

TINY = 1e-30  # complex step
CELLS = 128  # in one go


@dataclass(frozen=True)
class Audit:
    """What the second code path finds in a state.

    ``energy`` of the whole unit in E_s l_s³. ``residual``: largest force on a node over the largest
    single contribution to any. ``correction``: what an independent Newton step would still move,
    max|Δu| in l_s. ``moment`` that a unit leans with on what holds its rotations about x and y, in
    E_s l_s³; residual and correction are beside it. ``held``: unstable modes of a unit whose
    rotations about x and y are held, ``free``: of one that may tip over; None where they could not
    be counted. ``finite``: whether all of it is; without that the rest means nothing.
    """

    energy: float
    residual: float
    correction: float
    moment: float
    held: int | None
    free: int | None
    finite: bool = True


def faults(folding: Folding, *, rtol: float = 1e-6) -> tuple[str, ...]:
    """What an audit of a path's last state finds wrong with it, in words; empty: nothing.

    ``rtol``: what the path was followed with. A path without states has nothing to be wrong.
    Raises ValueError for what :func:`audit` doesn't know.
    """
    if not folding.states:
        return ()
    model, state = folding.model, folding.last
    seen = audit(model, folding.x, state.e)
    if not seen.finite or not np.isfinite(state.curves).all():
        return ("the state is not finite",)
    complaints = []
    energy = state.energy * 2 ** len(model.mirrors)
    # An energy is a difference of numbers of the size of E times volume.
    roundoff = 1e-14 * unit_volume(model.unit)
    if abs(seen.energy - energy) > 1e-6 * abs(energy) + roundoff:
        complaints.append(f"the energy is {seen.energy:.6g}, not {energy:.6g}")
    if not seen.correction <= rtol:
        complaints.append(f"an independent Newton step still moves it by {seen.correction:.2g}")
    if seen.held is None:
        complaints.append("its unstable modes could not be counted independently")
    elif seen.held != state.unstable:
        complaints.append(f"it has {seen.held} unstable modes, not {state.unstable}")
    elif model.upright and state.topples != (seen.free > seen.held):
        complaints.append(f"let go it has {seen.free} unstable modes; topples is {state.topples}")
    elif not model.upright and seen.free:
        complaints.append(f"it tips over: {seen.free} unstable modes")
    return tuple(complaints)


def unit_volume(unit: Unit) -> float:
    """Size of E times volume, in E_s l_s³."""
    hinge = unit.hinge_length * unit.width * (unit.slenderness + unit.E_ratio * unit.active)
    return hinge + (1 - unit.hinge_length) * unit.aspect * unit.slenderness


def audit(model: Model, x: np.ndarray, e: float) -> Audit:
    """The state ``x`` (size,) of a model at the load ``e``, looked at again.

    Raises ValueError for what this path doesn't know: other elements than hex27, the exponential
    barrier, friction, and materials that change.
    """
    body, unit = model.body, model.unit
    physics = model.physics
    known = physics.barrier == "surface" and not (physics.changes or physics.friction)
    if body.element != "hex27" or not known:
        raise ValueError(
            "an audit knows only hex27, the surface barrier, no friction and materials that last"
        )
    u = model.scene.displacement(x, e)
    if not np.isfinite(u).all():
        return Audit(np.nan, np.nan, np.nan, np.nan, None, None, finite=False)
    axes = [{"x": [0], "y": [1], "turn": [0, 1]}[m] for m in model.mirrors]
    given = {row.name: row.coefficients for row in model.scene.rows if model.heavy}
    given = {
        name: whole(body.nodes, c, body.cells, axes, sums=True)[1] for name, c in given.items()
    }
    nodes, u, cells = whole(body.nodes, u, body.cells, axes)
    bent = 1 if body.weights.shape[1] == 18 else None
    energy, force, size, K = elastic(unit, model.growth, nodes, u, cells, e, bent)
    if model.heavy:
        parts = weight(unit, nodes, u, cells, bent), ground(unit, nodes, u, cells, model.upright)
        for own, push, stiffness in parts:
            energy, force = energy + own, force + push
            size = max(size, np.abs(push).max())
            K = K + sp.diags_array(stiffness.ravel())
    if not (np.isfinite(energy) and np.isfinite(force).all()):
        return Audit(energy, np.nan, np.nan, np.nan, None, None, finite=False)
    now = nodes + u
    arms = now - now.mean(axis=0)
    turns = [np.cross(axis, arms).ravel() for axis in np.eye(3)]
    shifts = [np.broadcast_to(axis, now.shape).ravel() for axis in np.eye(3)]
    idle = [*shifts[:2], turns[2]] if model.heavy else [*shifts, *turns]
    # Motions that cost nothing are pinned, each at one component: the inertia is the same.
    pins = qr(np.array(idle), pivoting=True, mode="r")[1][: len(idle)]
    kept = np.setdiff1d(np.arange(3 * len(nodes)), pins)
    K, R = sp.csc_array(K)[kept][:, kept], force.ravel()
    rows = None
    if model.heavy:
        volume = volumes(nodes, cells, bent)
        arms = now - volume @ now / volume.sum()
        rows = [volume[:, None] * np.cross(axis, arms) for axis in np.eye(3)[:2]]
        rows = np.array(
            [
                given.get(f"rotation {name}", row).ravel()
                for name, row in zip("xy", rows, strict=True)
            ]
        )
    moment = 0.0
    if given and model.upright:
        # A couple on a lopsided body may have parts that the other rows take.
        every = np.array([row.ravel() for row in given.values()])
        pull = np.linalg.lstsq(every.T, R)[0] @ every
        R = R - pull
        moment = float(np.linalg.norm(np.cross(arms, pull.reshape(-1, 3)).sum(axis=0)))
    rows = None if rows is None else rows[:, kept]
    held, free, step = stability(K, R[kept], rows)
    return Audit(
        float(energy), float(np.abs(R).max() / size), float(np.abs(step).max()), moment, held, free
    )


# -- the whole unit ------------------------------------------------------------------------------


def whole(
    nodes: np.ndarray,
    u: np.ndarray,
    cells: np.ndarray,
    axes: list[list[int]],
    *,
    sums: bool = False,
):
    """Nodes, displacement and cells of the body whose part symmetries keep, each of ``axes`` being
    what changes its sign: one for a mirror plane, x and y for a half-turn, whose cut is y = 0.

    Cells keep the order of their nodes, so mirrored ones are left-handed. ``sums``: u is a sum over
    cells, such as a force, to which on a mirror plane both sides add.
    """
    for flipped in axes:
        sign = np.where(np.isin(np.arange(3), flipped), -1.0, 1.0)
        on = np.abs(nodes[:, flipped[-1]]) < 1e-12
        # What lies in the plane is its own image, or under a half-turn that of what is opposite.
        twin = np.flatnonzero(on)
        off, there = cKDTree(nodes[on]).query(nodes[on] * sign)
        if off.max() > 1e-9:
            raise ValueError("the mesh on the cut is not that of the other side")
        twin = twin[there]
        if sums:
            u = u.copy()
            u[on] = u[on] + sign * u[twin]
        elif np.abs(u[on] - sign * u[twin]).max(initial=0) > 0:
            raise ValueError(f"the state leaves its symmetry about {'xyz'[flipped[-1]]} = 0")
        image = np.arange(len(nodes))
        image[on] = twin
        image[~on] = len(nodes) + np.arange((~on).sum())
        nodes, u = (np.vstack([f, f[~on] * sign]) for f in (nodes, u))
        cells = np.vstack([cells, image[cells]])
    return nodes, u, cells


def shapes(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quadratic shape functions (q, 27) and their derivatives (q, 27, 3) on the unit cube."""
    places = np.round(2 * ELEMENTS["hex27"][0]().doflocs).astype(int)  # 0, 1, 2 along each axis
    s = points[..., None]
    value = np.concatenate([(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)], axis=-1)
    slope = np.concatenate([4 * s - 3, 4 - 8 * s, 4 * s - 1], axis=-1)
    along = [[f[:, k, places[:, k]] for k in range(3)] for f in (value, slope)]
    N = along[0][0] * along[0][1] * along[0][2]
    dN = [np.prod([along[int(j == k)][j] for j in range(3)], axis=0) for k in range(3)]
    return N, np.stack(dN, axis=-1)


def rule(bent: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points (q, 3) and weights of the unit cube, two points along the axis ``bent``."""
    lines = [np.polynomial.legendre.leggauss(2 if k == bent else 3) for k in range(3)]
    grid = np.meshgrid(*[(x + 1) / 2 for x, _ in lines], indexing="ij")
    weights = np.einsum("i,j,k->ijk", *[w / 2 for _, w in lines])
    return np.stack([x.ravel() for x in grid], axis=-1), weights.ravel()


def gradients(X: np.ndarray, bent: int | None):
    """Shape functions, ∂N/∂X (m, q, 27, 3) and volumes (m, q) of cells with nodes X (m, 27, 3)."""
    points, weights = rule(bent)
    N, dN = shapes(points)
    jacobian = np.einsum("mai,qaj->mqij", X, dN)
    volume = weights * np.abs(np.linalg.det(jacobian))
    return N, np.einsum("qaj,mqji->mqai", dN, np.linalg.inv(jacobian)), volume


# -- energy, forces, stiffness -------------------------------------------------------------------


def psi(F: np.ndarray, lam, mu) -> np.ndarray:
    """Neo-Hookean energy per volume, of complex F too."""
    ln = np.log(np.linalg.det(F))
    return mu / 2 * ((F * F).sum(axis=(-2, -1)) - 3 - 2 * ln) + lam / 2 * ln * ln


def stress(F: np.ndarray, lam, mu) -> np.ndarray:
    """∂ψ/∂F, of complex F too."""
    back = np.swapaxes(np.linalg.inv(F), -1, -2)
    ln = np.log(np.linalg.det(F))[..., None, None]
    return mu[..., None, None] * (F - back) + lam[..., None, None] * ln * back


def derivative(function, F: np.ndarray, *parameters) -> np.ndarray:
    """∂function/∂F by complex steps; the two indices of F come last."""
    out = []
    for k in range(9):
        step = np.zeros((3, 3), complex)
        step.flat[k] = 1j * TINY
        out.append(function(F + step, *parameters).imag / TINY)
    return np.stack(out, axis=-1).reshape(*out[0].shape, 3, 3)


def elastic(unit: Unit, growth: str, nodes, u, cells, e: float, bent: int | None):
    """Energy, forces (n, 3), the largest contribution to one, and stiffness (3n, 3n)."""
    fractions = [s(e) if callable(s) else s for s in GROWTHS[growth]]
    force, energy, size, parts = np.zeros_like(nodes), 0.0, 0.0, []
    for start in range(0, len(cells), CELLS):
        some = cells[start : start + CELLS]
        _, g, volume = gradients(nodes[some], bent)
        active = nodes[some][..., 2].mean(axis=1) > unit.slenderness
        grown = 1 - unit.contraction * np.outer(active, fractions)  # (m, 3), along the axes
        volume = volume * grown.prod(axis=1)[:, None]
        g = g / grown[:, None, None, :]
        F = np.eye(3) / grown[:, None, None, :] + np.einsum("mai,mqaj->mqij", u[some], g)
        if not (np.linalg.det(F) > 0).all():
            return np.inf, force, np.inf, sp.csr_array((3 * len(nodes),) * 2)
        E = np.where(active, unit.E_ratio, 1.0)[:, None] * np.ones(volume.shape[1])
        lam, mu = E * unit.nu / ((1 + unit.nu) * (1 - 2 * unit.nu)), E / (2 * (1 + unit.nu))
        energy += (volume * psi(F, lam, mu)).sum()
        P = derivative(psi, F, lam, mu)
        push = np.einsum("mq,mqij,mqaj->mqai", volume, P, g)
        size = max(size, np.abs(push).max())
        np.add.at(force, some, push.sum(axis=1))
        A = derivative(stress, F, lam, mu) * volume[..., None, None, None, None]
        pulled = np.einsum("mqiJkL,mqbL->mqJikb", A, g, optimize=True)
        m, q = volume.shape
        slopes = np.moveaxis(g, 2, -1).reshape(m, 3 * q, 27)
        blocks = np.swapaxes(slopes, 1, 2) @ pulled.reshape(m, 3 * q, 9 * 27)
        blocks = blocks.reshape(m, 27, 3, 3, 27).swapaxes(3, 4)  # a, i, b, k
        where = (3 * some[:, :, None] + np.arange(3)).reshape(m, 81)
        parts.append((blocks.reshape(m, 81, 81), where))
    rows = np.concatenate([np.repeat(w, 81, axis=1).ravel() for _, w in parts])
    cols = np.concatenate([np.tile(w, (1, 81)).ravel() for _, w in parts])
    values = np.concatenate([b.ravel() for b, _ in parts])
    K = sp.coo_array((values, (rows, cols)), shape=(3 * len(nodes),) * 2).tocsr()
    return energy, force, size, (K + K.T) / 2


def volumes(nodes, cells, bent) -> np.ndarray:
    """∫ N_a dV of each node, (n,)."""
    nodal = np.zeros(len(nodes))
    for start in range(0, len(cells), CELLS):
        N, _, volume = gradients(nodes[cells[start : start + CELLS]], bent)
        np.add.at(nodal, cells[start : start + CELLS], np.einsum("mq,qa->ma", volume, N))
    return nodal


def weight(unit: Unit, nodes, u, cells, bent):
    """∫ ρ g z dV₀."""
    force = np.zeros_like(nodes)
    for start in range(0, len(cells), CELLS):
        some = cells[start : start + CELLS]
        N, _, volume = gradients(nodes[some], bent)
        active = nodes[some][..., 2].mean(axis=1) > unit.slenderness
        density = unit.weight * np.where(active, unit.rho_ratio, 1.0)
        np.add.at(force[:, 2], some, np.einsum("m,mq,qa->ma", density, volume, N))
    return (force * (nodes + u)).sum(), force, 0 * force


def ground(unit: Unit, nodes, u, cells, upright):
    """The barrier at the nodes of the underside, or of all outer faces; areas by Simpson's rule.

    κ r b(s/r), b(t) = −(t − 1)² ln t, from a tenth of h_s below the ground to a tenth above, and κ
    such that the hinge's own weight per area rests at 0.
    """
    places = np.round(2 * ELEMENTS["hex27"][0]().doflocs).astype(int)
    sides = {}
    for axis in range(3):
        for side in (0, 2):
            local = np.flatnonzero(places[:, axis] == side)
            across = [k for k in range(3) if k != axis]
            local = local[np.lexsort(places[local][:, across].T[::-1])]
            for face in cells[:, local]:
                sides.setdefault(tuple(np.sort(face)), []).append(face)
    faces = np.array([group[0] for group in sides.values() if len(group) == 1])
    if upright:
        faces = faces[np.abs(nodes[faces, 2]).max(axis=1) < 1e-9]
    corner = nodes[faces]  # (f, 9, 3), in the order of a 3 × 3 grid
    one, two = (corner[:, 6] - corner[:, 0]), (corner[:, 2] - corner[:, 0])
    size = np.linalg.norm(np.cross(one, two), axis=1)
    simpson = np.outer([1, 4, 1], [1, 4, 1]).ravel() / 36
    area = np.zeros(len(nodes))
    np.add.at(area, faces, size[:, None] * simpson)
    depth, reach = 0.1 * unit.slenderness, 0.2 * unit.slenderness
    pressure = unit.weight * (unit.slenderness + unit.rho_ratio * unit.active)
    t = ((nodes + u)[:, 2] + depth) / reach
    acts = (area > 0) & (t < 1)
    t = np.where(acts, t, 1.0)
    if (t <= 0).any():
        return np.inf, np.zeros_like(nodes), np.zeros_like(nodes)

    def slope(t):
        return 2 * (1 - t) * np.log(t) - (t - 1) ** 2 / t

    kappa = pressure / -slope(0.5)
    energy = kappa * reach * (area * -((t - 1) ** 2) * np.log(t)).sum()
    force, stiffness = np.zeros_like(nodes), np.zeros_like(nodes)
    force[:, 2] = kappa * area * slope(t)
    second = -2 * np.log(t) + 2 * (1 - t) / t - 2 * (t - 1) / t + (t - 1) ** 2 / t**2
    stiffness[:, 2] = kappa / reach * area * second
    return energy, force, stiffness


# -- stability -----------------------------------------------------------------------------------


def cholesky(K: sp.csc_array):
    """A solver of K x = b; raises LinAlgError unless K is positive definite."""
    diagonal = K.diagonal()
    if not (diagonal > 0).all():
        raise LinAlgError("a diagonal entry is not positive")
    scale = 1 / np.sqrt(diagonal)
    order = reverse_cuthill_mckee(sp.csr_matrix(K), symmetric_mode=True)
    S = (K * scale * scale[:, None]).tocsc()[order][:, order].tocoo()
    low = S.row >= S.col
    row, col = S.row[low], S.col[low]
    band = np.zeros(((row - col).max() + 1, K.shape[0]))
    band[row - col, col] = S.data[low]
    factor = cholesky_banded(band, lower=True)

    def solve(b):
        x = np.empty_like(b)
        x[order] = cho_solve_banded((factor, True), (scale * b)[order])
        return scale * x

    return solve


def stability(K: sp.csc_array, force: np.ndarray, rows: np.ndarray | None):
    """Unstable modes with ``rows`` (k, n) held and without, and a Newton step that keeps them."""
    held = free = 0
    try:
        solve = cholesky(K)
    except LinAlgError:
        solve = splu(K).solve
        held = free = negatives(K, solve)
    step = -solve(force)
    if rows is None:
        return held, free, step
    flexible = np.column_stack([solve(row) for row in rows])
    inner = rows @ flexible
    if free:
        # Haynsworth's inertia formula for the matrix bordered by the rows.
        held = free + int((np.linalg.eigvalsh(-(inner + inner.T)) < 0).sum()) - len(rows)
    return held, free, step - flexible @ np.linalg.solve(inner, rows @ step)


def negatives(K: sp.csc_array, solve) -> int | None:
    """Number of negative eigenvalues; None where it could not be proven."""
    scale = 1 / np.sqrt(np.abs(K.diagonal()))
    S = (K * scale * scale[:, None]).tocsc()
    inverse = LinearOperator(S.shape, lambda b: solve(b.ravel() / scale) / scale)
    for count in (8, 32):
        try:
            values = eigsh(
                S,
                k=count,
                sigma=0,
                OPinv=inverse,
                v0=np.ones(len(scale)),
                return_eigenvectors=False,
            )
        except ArpackError:
            return None
        lowest = values.min()
        if -0.9 * values.max() < lowest < 0:
            break
    else:
        return None
    try:
        # None lies below the lowest that was found, which isn't the farthest from 0.
        cholesky((S - 1.01 * lowest * sp.eye_array(len(scale))).tocsc())
    except LinAlgError:
        return None
    return int((values < 0).sum())
