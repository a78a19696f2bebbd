"""What furrow and neural tube have in common: the tissue of §5.5.3, its path in time, and measures.

Stresses in kPa, times in s, lengths in units of the case. E_s = E_m = 5 kPa, ν = 0.3,
η = 1000 Pa s, so η/E_m = 0.2 s; g grows linearly over t_fin = 1 s (Eq. 5.63). The strain of (5.62),
Fg = I/(1 − g β), contracts for g < 0, so g_fin enters with its sign turned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver.equilibrium.scene import Scene
from solver.mesh.body import Body, Surface
from solver.physics.elastic import Elastic
from solver.physics.growth import Apical
from solver.physics.materials import Material, NeoHookean
from solver.physics.supports import Fixed
from solver.physics.term import Term
from solver.viscous.rheology import SLS, Rheology
from solver.viscous.term import Viscous

Beta = np.ndarray | Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Tissue:
    """Standard linear solid, moduli in kPa and viscosity in kPa s; numbers, or arrays per cell or
    quadrature point."""

    E: float | np.ndarray = 5.0
    E_m: float | np.ndarray = 5.0
    nu: float = 0.3
    eta: float | np.ndarray = 1.0

    @property
    def tau(self) -> float:
        """Shortest relaxation time η/E_m in s."""
        return float(np.min(np.asarray(self.eta) / self.E_m))

    def rheology(self) -> Rheology:
        """Its springs and dashpot."""
        return SLS(self.E, self.E_m, self.nu, self.eta)

    def slow(self) -> Material:
        """What remains of it in an infinitely slow process: the spring."""
        return NeoHookean(self.E, self.nu)

    def fast(self) -> Material:
        """What it is in an infinitely fast one: both springs."""
        return NeoHookean(self.E + self.E_m, self.nu)


@dataclass(frozen=True, eq=False)
class Model:
    """A body, what holds it, β at its quadrature points (m, q), and terms beside the tissue."""

    body: Body
    fixed: tuple[Fixed, ...]
    beta: np.ndarray
    tissue: Tissue
    contraction: float
    terms: tuple[Term, ...] = ()

    def growth(self) -> Apical:
        """Fg at e, the fraction of the final contraction."""
        return Apical(lambda e: -self.contraction * e, self.beta)

    def viscous(self, dt: float) -> Scene:
        """The scene of a path in time; its load is the fraction of the contraction."""
        term = Viscous(self.body, self.tissue.rheology(), self.growth(), dt=dt)
        return Scene(self.body, [term, *self.terms], fixed=self.fixed)

    def elastic(self, material: Material) -> Scene:
        """The same without time."""
        term = Elastic(self.body, material, self.growth())
        return Scene(self.body, [term, *self.terms], fixed=self.fixed)


def ramp(t_fin: float) -> Callable[[float], float]:
    """Fraction of the contraction: linear in time up to t_fin (Eq. 5.63), then held."""
    if not t_fin > 0:
        raise ValueError(f"t_fin = {t_fin}; expected a time > 0")
    return lambda t: min(t / t_fin, 1.0)


def meshed(mesh: Callable, shape, counts, element: str, beta: Beta | None):
    """Body of ``mesh(shape, counts, element)``, and β at its quadrature points, (m, q).

    ``beta``: the pattern of the shape (None), a function of positions (m, q, 3), or values at the
    quadrature points or per cell. Raises ValueError for values outside of [0, 1] and what the mesh
    refuses.
    """
    body = Body.build(mesh(shape, counts, element), element)
    return body, evaluated(body, shape.beta if beta is None else beta)


def evaluated(body: Body, beta: Beta) -> np.ndarray:
    """β at the quadrature points, (m, q); raises ValueError for values outside of [0, 1]."""
    values = np.asarray(beta(body.points()) if callable(beta) else beta, dtype=float)
    shape = body.weights.shape
    if values.shape not in (shape, shape[:1]):
        raise ValueError(
            f"beta has shape {values.shape}; expected {shape}, one per quadrature point, or "
            f"{shape[:1]}, one per cell"
        )
    if not ((values >= 0) & (values <= 1)).all():
        raise ValueError(
            f"beta runs from {np.nanmin(values):.4g} to {np.nanmax(values):.4g}; expected values "
            "in [0, 1]: scale the pattern and put its strength into the contraction"
        )
    return values


def enclosed(surface: Surface, nodes: np.ndarray, u: np.ndarray) -> float:
    """⅓ ∫ x·n dA over a deformed surface, outward normals of the body; u (n, 3).

    The volume within the surface, negative for that of a cavity; what a mirror plane through the
    origin cuts off adds nothing.
    """
    x = np.einsum("fqk,fki->fqi", surface.shapes, (nodes + u)[surface.nodes])
    t = surface.frames + np.einsum("fqkt,fki->fqti", surface.tangents, u[surface.nodes])
    n = np.cross(t[:, :, 0], t[:, :, 1])
    return float(np.einsum("fq,fqi,fqi->", surface.weights, x, n) / 3)
