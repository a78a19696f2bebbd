"""β(X; p): a pattern of contraction with parameters, and forces that follow from its changes."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.physics.elastic import Elastic
from solver.physics.growth import Apical


class Field(Protocol):
    """A pattern with k parameters; ``names`` (k), ``low`` and ``high`` (k,): their bounds, finite,
    whose difference is a parameter's range: the scale on which its uncertainty is large or small.
    """

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray

    def values(self, p: np.ndarray, X: np.ndarray) -> np.ndarray:
        """β at positions (..., 3) for parameters (k,)."""
        ...

    def slopes(self, p: np.ndarray, X: np.ndarray) -> np.ndarray:
        """∂β/∂p at positions (..., 3), (..., k)."""
        ...


def spread(body: Body, stress: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Forces (n, 3, k) on the nodes of the stresses ``stress`` (m, q, 3, 3) per change of β where β
    changes by ``slopes`` (m, q, k)."""
    at = _at_nodes(body, stress)
    parts = np.matmul(at.reshape(*at.shape[:2], -1).swapaxes(1, 2), slopes)
    out = np.zeros((*body.nodes.shape, slopes.shape[-1]))
    np.add.at(out, body.cells, parts.reshape(*body.cells.shape, 3, -1))
    return out


def gathered(body: Body, stress: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The work (m, q) on a field v (n, 3) of the same forces, per change of β at each point: what
    :func:`spread` does, the other way round."""
    return np.einsum("mqki,mki->mq", _at_nodes(body, stress), v[body.cells])


def _at_nodes(body: Body, stress: np.ndarray) -> np.ndarray:
    """w S ∂N_a/∂X at each point, (m, q, k, 3)."""
    return np.einsum("mq,mqij,mqkj->mqki", body.weights, stress, body.gradients, optimize=True)


def contracting(terms) -> Elastic:
    """The one term whose growth is :class:`solver.physics.growth.Apical`; ValueError for none or
    more than one."""
    found = [t for t in terms if isinstance(getattr(t, "growth", None), Apical)]
    if len(found) != 1:
        raise ValueError(
            f"{len(found)} terms of the scene grow by Apical(g, beta); expected one, whose beta is "
            "looked for"
        )
    return found[0]


def contracted(scene: Scene, term: Elastic, beta: np.ndarray) -> Scene:
    """The scene whose contracting term has another beta (cells, points)."""
    growth = Apical(term.growth.g, beta, cells=term.growth.cells)
    other = term.with_growth(growth)
    return scene.with_terms([other if t is term else t for t in scene.terms])


def refused(beta: np.ndarray) -> str:
    """Why a pattern can't be one, in words; empty where it can."""
    if not np.isfinite(beta).all():
        return "beta would not be finite"
    low, high = float(beta.min()), float(beta.max())
    inside = low >= 0 and high <= 1
    return "" if inside else f"beta would run from {low:.4g} to {high:.4g}, outside of [0, 1]"
