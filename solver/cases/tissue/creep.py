"""Creep of a bar (§5.3): Kelvin–Voigt, Maxwell and standard linear solid, loaded and unloaded.

The bar 0 ≤ x ≤ 4, one wide and high, lies against three mirror planes and is pulled by σ on its
end for 0 < t < 1. With an isotropic dashpot (stress η D) deviator and volume retard apart, with the
moduli 2μ and 3K in the place of E:

    ε_axial = σ (⅔ J_d + ⅓ J_v),   ε_lateral = σ (−⅓ J_d + ⅓ J_v),

which is not the one-dimensional ε = σ J. J(t) of the standard linear solid has the retardation time
η (E_s + E_m)/(E_s E_m); the text under (5.50) prints the relaxation time η/E_m.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics.loads import Traction
from solver.physics.supports import Fixed
from solver.viscous.rheology import SLS, KelvinVoigt, Maxwell, Rheology, Spring, channel
from solver.viscous.term import Viscous

NU = 0.3
END = 1.0  # of the load


@dataclass(frozen=True)
class Model:
    """Moduli and viscosity of one of the models; E is the spring's, E_m the Maxwell branch's.

    ``E`` = 0: no spring beside the branch; ``E_m`` = 0: the dashpot alone is in its place.
    """

    name: str
    E: float
    E_m: float
    eta: float
    nu: float = NU

    def rheology(self) -> Rheology:
        """Its springs and dashpots."""
        if not self.E_m:
            return KelvinVoigt(self.E, self.nu, self.eta)
        if not self.E:
            return Maxwell(self.E_m, self.nu, self.eta)
        return SLS(self.E, self.E_m, self.nu, self.eta)

    def compliance(self, t: np.ndarray, factor: float = 1.0) -> np.ndarray:
        """J(t) with the moduli times ``factor``, 0 before t = 0."""
        E, E_m, eta = factor * self.E, factor * self.E_m, self.eta
        s = np.maximum(t, 0.0)
        if not self.E_m:
            J = (1 - np.exp(-E * s / eta)) / E
        elif not self.E:
            J = 1 / E_m + s / eta
        else:
            tau = eta * (E + E_m) / (E * E_m)
            J = (1 - E_m / (E + E_m) * np.exp(-s / tau)) / E
        return np.where(t < 0, 0.0, J)

    def response(self, t: np.ndarray, factor: float = 1.0) -> np.ndarray:
        """J of the load on [0, 1], and just before the jump at its end."""
        t = np.asarray(t, dtype=float)
        after = np.where(t > END, self.compliance(t - END, factor), 0.0)
        return self.compliance(t, factor) - after

    def exact(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axial and lateral strain per σ of the three-dimensional small-strain solution."""
        deviator, volume = (self.response(t, f) for f in factors(self.nu))
        return 2 / 3 * deviator + volume / 3, volume / 3 - deviator / 3


def factors(nu: float) -> tuple[float, float]:
    """2μ/E and 3K/E."""
    return 1 / (1 + nu), 1 / (1 - 2 * nu)


MODELS = {
    m.name: m
    for m in (
        Model("Kelvin-Voigt", 100.0, 0.0, 10.0),
        Model("Maxwell", 0.0, 200.0, 200.0),
        Model("SLS 2/3", 100.0, 200.0, 2 / 3),
        Model("SLS 2", 100.0, 200.0, 2.0),
        Model("SLS 10", 100.0, 200.0, 10.0),
    )
}


def scene(
    rheology: Rheology,
    stress: float | Callable[[float], float],
    dt: float,
    *,
    element: str = "hex8",
) -> Scene:
    """The bar under a dead traction; a number acts for 0 < t < 1, a function of t always."""
    body = Body.build(box(np.linspace(0, 4, 5), [0, 1], [0, 1]), element)
    at = stress if callable(stress) else (lambda t: stress if 0 < t < END else 0.0)
    terms = [
        Viscous(body, rheology, dt=dt),
        Traction(body, body.surface("x+"), lambda t: np.array([at(t), 0.0, 0.0])),
    ]
    planes = [(np.flatnonzero(np.abs(body.nodes[:, k]) < 1e-12), np.eye(3)[k]) for k in range(3)]
    return Scene(body, terms, fixed=[Fixed(nodes, normal) for nodes, normal in planes])


def strains(scene: Scene, x: np.ndarray) -> tuple[float, float]:
    """Axial and lateral engineering strain of the bar's far corner."""
    u, X = scene.displacement(x, 0.0), scene.body.nodes
    corner = np.argmax(X.sum(axis=1))
    return float(u[corner, 0] / X[corner, 0]), float(u[corner, 1] / X[corner, 1])


def stepped(rheology: Rheology, nu: float, dts: np.ndarray, loads: np.ndarray, order: int):
    """Axial and lateral strain of the time-discrete small-strain scheme, (n, 2), of any tree.

    ``dts`` (n,), ``loads`` (n,): step and σ of each; all springs have the ratio ``nu``. ``order``
    as in :class:`solver.viscous.evolution.TimeSteps`, with backward Euler in the first step.
    """
    out = []
    for factor in factors(nu):
        values = [
            leaf.value * (factor if isinstance(leaf, Spring) else 1) for leaf in rheology.leaves()
        ]
        K, N = channel(rheology, np.array(values))
        x = [np.zeros(len(K))] * 2
        path = []
        for n, (dt, load) in enumerate(zip(dts, loads, strict=True)):
            r = dt / dts[n - 1] if order == 2 and n else 0.0
            a1, a2 = 1 + r, r * r / (1 + r)
            right = np.eye(len(K))[0] * load + N @ (a1 * x[0] - a2 * x[1]) / dt
            x = [np.linalg.solve(K + (a1 - a2) * N / dt, right), x[0]]
            path.append(x[0][0])
        out.append(np.array(path))
    deviator, volume = out
    return np.stack([2 / 3 * deviator + volume / 3, volume / 3 - deviator / 3], axis=1)
