"""What no equilibrium can be found of, refused in words: rows that contradict each other, cells
without material, and parts of a body that can move freely."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from solver.given import numbers
from solver.mesh.body import Body
from solver.physics.fields import Unphysical
from solver.physics.supports import Row
from solver.physics.term import Term


def checked_terms(terms: Sequence[Term], body: Body) -> tuple[Term, ...]:
    """The terms as a tuple; ValueError for what is none, or one of another body."""
    terms = tuple(terms) if isinstance(terms, Iterable) else (terms,)
    for term in terms:
        if not hasattr(term, "evaluate"):
            raise ValueError(f"the terms hold {term!r:.60}; expected such as Elastic or Gravity")
        n = len(getattr(term, "body", body).nodes) if term.graph is None else term.graph.n
        if n != len(body.nodes):
            raise ValueError(
                f"the term {term.name!r} acts on a body of {n} nodes, and the scene's has "
                f"{len(body.nodes)}; make all terms of one body"
            )
    return terms


def row_matrix(rows: Sequence[Row], n: int, to_local) -> sp.csr_array:
    """The coefficients of all rows in the nodes' frames, (rows, 3 n), by ``to_local`` of (n, 3).

    Raises ValueError for coefficients of another shape, or that are zero or not finite, and for a
    value that is no finite number at e = 0.
    """
    local = []
    for row in rows:
        c = numbers(f"row {row.name!r}", row.coefficients)
        if c.shape != (n, 3) or not np.isfinite(c).all() or not c.any():
            raise ValueError(
                f"row {row.name!r} has coefficients of shape {c.shape}; expected ({n}, 3), finite "
                "and not all zero"
            )
        row_value(row, 0.0)
        local.append(sp.csr_array(to_local(c).reshape(1, -1)))
    return sp.csr_array(sp.vstack(local)) if local else sp.csr_array((0, 3 * n))


def row_value(row: Row, e: float) -> float:
    """What a row's sum is to be at the load e; ValueError for what is no finite number."""
    value = row.value(e) if callable(row.value) else row.value
    target = numbers(f"the value of row {row.name!r}", value)
    if target.shape or not np.isfinite(target):
        raise ValueError(
            f"row {row.name!r} has the value {target} at e = {e:g}; expected one finite number"
        )
    return float(target)


def refuse_rows(rows: Sequence[Row], C: sp.csr_array, own: sp.csr_array) -> None:
    """Raises ValueError for rows that see nothing free, and rows that follow from others.

    ``C`` as of :func:`row_matrix`; ``own`` (rows, n_free): what of it is free. Either makes the
    matrix singular, and where their values differ there is no solution.
    """
    if not rows:
        return
    size, whole = sp.linalg.norm(own, axis=1), sp.linalg.norm(C, axis=1)
    for row, seen in zip(rows, size > 1e-12 * whole, strict=True):
        if not seen:
            raise ValueError(
                f"row {row.name!r} sees only what is held by Fixed: it is met already or "
                "contradicts it; drop one of the two"
            )
    own = sp.csr_array(own.multiply(1 / size[:, None]))
    values, vectors = np.linalg.eigh((own @ own.T).toarray())
    if values[0] > 1e-13:
        return
    names = ", ".join(
        repr(row.name) for row, part in zip(rows, vectors[:, 0], strict=True) if abs(part) > 0.01
    )
    raise ValueError(
        f"the rows {names} are not independent on what is free: they repeat or contradict each "
        "other; drop one of them"
    )


def refuse_free_motion(scene, x: np.ndarray, e: float) -> None:
    """Raises ValueError if nodes of the scene's body have no stiffness at (x, e), or the body or a
    part of it can be moved rigidly without any resistance.

    A term with a barrier (``longest_step``) may hold the body later, so scenes with one may move.
    """
    barrier = any(hasattr(term, "longest_step") for term in scene.terms)
    sentence = loose(scene, x, e, parts=not barrier)
    if sentence:
        raise ValueError(sentence)


def inadmissible(scene, x: np.ndarray, e: float) -> str:
    """Which term doesn't admit the state, and why; empty where all of them do."""
    u = scene.displacement(x, e)
    for term in scene.terms:
        try:
            if term.evaluate(u, e, 0).energy != np.inf:
                continue
        except Unphysical as error:
            return str(error)
        barrier = hasattr(term, "longest_step")
        what = "a point lies beyond the barrier" if barrier else "an element is turned inside out"
        return f"{what} of the term {term.name!r}"
    return ""


def loose(scene, x: np.ndarray, e: float, *, parts: bool = True) -> str:
    """What nothing holds at (x, e), in words: nodes without stiffness, and with ``parts`` rigid
    motions of the body or a part of it without resistance; empty if there is none."""
    body = scene.body
    u = scene.displacement(x, e)
    stiffness = scene.evaluate(u, e, 2).stiffness
    if stiffness is None:
        return ""
    graph, held = scene.graph, scene.frame.held
    a = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    diagonal = np.abs(stiffness[a == graph.indices]).max(axis=(1, 2))
    empty = np.flatnonzero((diagonal == 0) & held.free.reshape(-1, 3).any(axis=1))
    if len(empty):
        return (
            f"{len(empty)} nodes have no stiffness, the first at {_place(body.nodes[empty[0]])}: "
            "cells without material; give each cell an Elastic or Viscous term"
        )
    if not parts:
        return ""
    pairs = (np.ones(graph.blocks, bool), graph.indices, graph.indptr)
    n, part = connected_components(sp.csr_array(pairs, shape=(graph.n, graph.n)))
    modes = np.concatenate([_rigid(body.nodes + u, part == k) for k in range(n)])
    M = np.column_stack([held.to_local(m.copy()).ravel() for m in modes])
    fixed = ~held.free
    fixed[held.tied] = False
    apart = M[held.tied] - held.signs[:, None] * M[held.masters]
    against = np.vstack([M[fixed], apart, scene.frame.C @ M])
    free = np.eye(len(modes))
    if len(against):
        _, sizes, rest = np.linalg.svd(np.linalg.qr(against, mode="r"), full_matrices=True)
        free = rest[np.sum(sizes > 1e-9 * max(sizes.max(), 1e-300)) :].T
    if not free.size:
        return ""
    motions = np.stack([held.to_global((M @ k).reshape(-1, 3)) for k in free.T])
    pull = np.einsum("bij,kbj->kbi", stiffness, motions[:, graph.indices])
    work = np.einsum("kbi,lbi->kl", pull, motions[:, a])
    size = diagonal.max() * (motions**2).sum((1, 2)).max()
    values, vectors = np.linalg.eigh((work + work.T) / 2)
    idle = np.abs(values) < 1e-10 * size
    if not idle.any():
        return ""
    where = ""
    if n > 1:
        motion = ((free @ vectors[:, idle]) ** 2).reshape(n, 6, -1).sum(axis=(1, 2))
        inner = body.nodes[part == motion.argmax()].mean(axis=0)
        where = f", of the part around {_place(inner)} at least one"
    return (
        f"{idle.sum()} of the body's rigid motions meet no resistance{where}; hold them by "
        "Fixed, or by translation_row and rotation_row"
    )


def _rigid(positions: np.ndarray, part: np.ndarray) -> list[np.ndarray]:
    """Three translations and three rotations of a part, 0 elsewhere; each (n, 3)."""
    arm = positions - positions[part].mean(axis=0)
    arm = np.where(part[:, None], arm / np.abs(arm[part]).max(), 0.0)
    modes = [part[:, None] * axis for axis in np.eye(3)]
    return modes + [np.cross(axis, arm) for axis in np.eye(3)]


def _place(X: np.ndarray) -> str:
    return "({:.4g}, {:.4g}, {:.4g})".format(*X)
