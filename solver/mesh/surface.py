"""Facets of a body with their own shape functions, for loads on surfaces.

What a facet needs is in its own plane: with ξ = a + s (b − a) + t (d − a) from the corners a, b, d
of its reference, the area is |∂X/∂s × ∂X/∂t| and slopes along the surface are those by s and t.
Nothing is inverted that a thin cell would make inaccurate.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import skfem
from skfem.quadrature import get_quadrature

from solver.mesh import checks


@dataclass(frozen=True, eq=False)
class Surface:
    """Facets of a body with their own shape functions, for loads on surfaces.

    ``nodes`` (f, k): nodes of each facet; ``shapes`` (f, q, k); ``tangents`` (f, q, k, 2):
    gradients of the shapes along two orthonormal reference tangents t₁, t₂ with t₁ × t₂ = outward
    normal; ``weights`` (f, q): reference area; ``normals`` (f, q, 3), outward, reference.
    """

    nodes: np.ndarray
    shapes: np.ndarray
    tangents: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    frames: np.ndarray = field(repr=False)  # (f, q, 2, 3): t₁, t₂

    @classmethod
    def of(
        cls,
        mesh: skfem.Mesh,
        element: skfem.Element,
        cells: np.ndarray,
        facets: np.ndarray,
        order: int,
    ) -> Surface:
        """Facets by scikit-fem index of a mesh with ``cells`` (m, k); ``order`` of quadrature."""
        ref = mesh.elem.refdom
        at, rule = get_quadrature(ref.brefdom, order)
        own = mesh.f2t[0, facets]
        side = (mesh.t2f[:, own] == facets).argmax(axis=0)
        f, q = len(facets), len(rule)
        values = None
        for number, corners in enumerate(ref.facets):
            mine = np.flatnonzero(side == number)
            if not len(mine):
                continue
            a, b, d = (ref.p[:, corners[i]].astype(float) for i in (0, 1, -1))
            along = np.stack([b - a, d - a])
            points = a[:, None] + along.T @ at
            local = [element.lbasis(points, n) for n in range(cells.shape[1])]
            N = np.stack([np.broadcast_to(value, q) for value, _ in local], -1)
            slopes = np.stack([along @ np.broadcast_to(slope, (3, q)) for _, slope in local])
            # Only the shapes that live on the facet: the others vanish there.
            live = np.flatnonzero(np.abs(N).max(axis=0) > 1e-7)
            J = checks.jacobians(mesh, points, own[mine])
            first, second = np.einsum("mijq,tj->tmqi", J, along)
            area = np.cross(first, second)
            size = np.linalg.norm(area, axis=-1)
            outward = np.sign(np.cross(*along) @ (a - ref.p.mean(axis=1)))
            mirrored = np.sign(np.linalg.det(np.moveaxis(J, -1, 1)))
            normals = area * (outward * mirrored / size)[..., None]
            frames = _frames(normals)
            # c with t = c₁ ∂X/∂s + c₂ ∂X/∂t
            B = np.einsum("mqti,amqi->mqta", frames, np.stack([first, second]))
            tangents = np.einsum("kaq,mqat->mqkt", slopes[live], np.linalg.inv(B))
            nodes = cells[own[mine]][:, live]
            shapes = np.broadcast_to(N[:, live], tangents.shape[:-1])
            parts = nodes, shapes, tangents, size * rule, normals, frames
            if values is None:
                values = [np.empty((f, *part.shape[1:]), part.dtype) for part in parts]
            for whole, part in zip(values, parts, strict=True):
                whole[mine] = part
        return cls(*values)


def _frames(normals: np.ndarray) -> np.ndarray:
    """t₁, t₂ (..., 2, 3) with t₁ × t₂ = normal."""
    least = np.eye(3)[np.argmin(np.abs(normals), axis=-1)]
    first = np.cross(least, normals)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(normals, first)], axis=-2)
