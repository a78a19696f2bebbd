"""Morphogens: a concentration that diffuses and decays in a body and may drive its growth.

    d(J c)/dt = ∇·(J D F⁻¹F⁻ᵀ ∇c) + J (source − decay c)       in the reference body,

with c per current volume and diffusion in the current configuration, which the tissue carries along
and dilutes as it grows; without a displacement F = 1, the reference configuration. On the mesh and
nodes of the body with scikit-fem's quadrature, exact for the products of shape functions: of order
p + 1 in space, backward Euler's first step and BDF2 after it in time. How c drives growth is
Eq. 2.33.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla
import skfem

from solver.given import all_of, node_numbers, number, numbers, one_of
from solver.mesh.body import Body
from solver.mesh.surface import Surface
from solver.physics.fields import Quantity, Unphysical, resolve, varies

# Exact for the product of two shape functions and an affine map.
ORDERS = {"hex27": 5, "hex20": 5, "hex8": 3, "tet10": 4, "tet4": 2}

Value = float | Callable[[float], float]
Motion = Callable[[float], np.ndarray]


@dataclass(frozen=True, eq=False)
class Kept:
    """Concentration of ``nodes`` (numbers, or a mask (n,)) kept at ``value``, maybe of the time."""

    nodes: np.ndarray
    value: Value


@dataclass(frozen=True, eq=False)
class Influx:
    """Amount that enters through a surface per reference area and time, maybe of the time."""

    surface: Surface
    value: Value


@dataclass(frozen=True, eq=False)
class Course:
    """Concentrations over time: ``t`` (k,), ``c`` (k, n) at the nodes of ``body``."""

    body: Body
    t: np.ndarray
    c: np.ndarray

    @property
    def last(self) -> np.ndarray:
        """c (n,) at the end."""
        return self.c[-1]

    def at(self, t: float) -> np.ndarray:
        """c (n,) at a time, linear between the instants and kept beyond them."""
        k = int(np.clip(np.searchsorted(self.t, t) - 1, 0, len(self.t) - 2))
        share = np.clip((t - self.t[k]) / (self.t[k + 1] - self.t[k]), 0.0, 1.0)
        return (1 - share) * self.c[k] + share * self.c[k + 1]

    def drives(self, f: Callable[[np.ndarray], np.ndarray]) -> Callable[[float], np.ndarray]:
        """A quantity f(c) of the load e = t, (m, q) at the body's points: what a growth, or the
        baseline of a :class:`solver.viscous.feedback.Feedback`, takes for g."""
        return lambda t: f(self.at(t)[self.body.cells] @ self.body.shapes.T)


class Morphogen:
    """What is produced, diffuses and decays in a body.

    ``diffusivity`` > 0 in length²/time, ``decay`` ≥ 0 in 1/time, ``source`` in concentration/time:
    each a number, per cell (m,), or a function of the time, or of time and position, as in
    :mod:`solver.physics.fields` (values per point are of the body's own quadrature, which is
    another). Nothing leaves through what is neither ``kept`` nor given an ``influx``. Where
    √(diffusivity/decay) is shorter than an element c over- and undershoots.
    """

    def __init__(
        self,
        body: Body,
        diffusivity: Quantity,
        decay: Quantity = 0.0,
        source: Quantity = 0.0,
        *,
        kept: Sequence[Kept] = (),
        influx: Sequence[Influx] = (),
    ):
        """Raises ValueError for quantities of wrong shape, Unphysical for a diffusivity that is not
        positive and a decay that is negative, and ValueError for nodes that are kept twice."""
        self.body = one_of("body", Body, body, "Body.build")
        self.diffusivity, self.decay, self.source = diffusivity, decay, source
        self.kept, self.influx = all_of("kept", Kept, kept), all_of("influx", Influx, influx)
        n = len(body.nodes)
        self._kept = [node_numbers(k.nodes, n) for k in self.kept]
        times = np.bincount(np.concatenate([*self._kept, np.zeros(0, int)]), minlength=n)
        if (times > 1).any():
            raise ValueError(f"node {times.argmax()} is kept twice; name each node once")
        self._free = np.flatnonzero(times == 0)
        if not len(self._free):
            raise ValueError("all nodes are kept, so nothing is left to be found")
        self._basis = skfem.Basis(body.mesh, body.reference, intorder=ORDERS[body.element])
        fields = [self._basis.basis[a][0] for a in range(body.cells.shape[1])]
        self._N = np.stack([np.broadcast_to(np.asarray(f), self._basis.dx.shape) for f in fields])
        self._G = np.stack([f.grad for f in fields])
        self._coefficients(0.0)

    def steady(self, t: float = 0.0, u: np.ndarray | None = None) -> np.ndarray:
        """c (n,) that no longer changes with all quantities as at the time t; ``u`` (n, 3): of the
        deformed body.

        Raises ValueError where neither decay nor kept nodes decide how much there is.
        """
        if len(self._free) == len(self.body.nodes) and not self._coefficients(t)[1].any():
            raise ValueError("nothing decays and no node is kept; any amount is steady: march(…)")
        _, K, b = self._matrices(t, u)
        c = self._values(t)
        free = self._free
        c[free] = sla.spsolve(K[free][:, free].tocsc(), (b - K @ c)[free])
        return c

    def march(
        self,
        until: float,
        dt: float,
        *,
        c: np.ndarray | float = 0.0,
        t: float = 0.0,
        u: Motion | None = None,
    ) -> Course:
        """c over time from ``c`` at ``t``, in equal steps of at most ``dt``; ``u``: displacement
        (n, 3) of the time, of a body that moves.

        Raises ValueError for a time that is not ahead, a step ≤ 0 and c of another shape.
        """
        if not number("until", until) > number("t", t):
            raise ValueError(f"until = {until:g}; expected a time after t = {t:g}")
        number("dt", dt, above=0.0)
        start = numbers("c", c)
        if start.shape not in ((), (len(self.body.nodes),)) or not np.isfinite(start).all():
            raise ValueError(
                f"c has shape {start.shape}; expected a finite number or ({len(self.body.nodes)},)"
            )
        steps = ceil((until - t) / dt * (1 - 1e-12))
        times = np.linspace(t, until, steps + 1)
        dt, free = (until - t) / steps, self._free
        still = u is None and not (varies(self.diffusivity) or varies(self.decay))
        first = np.where(self._mask(), self._values(t), start)
        M, K, b = self._matrices(t, None if u is None else u(t))
        found, amounts, factors = [first], [M @ first], {}
        for k, now in enumerate(times[1:]):
            if still:
                b = self._load(now, None)
            else:
                M, K, b = self._matrices(now, u(now) if u else None)
            # BDF2, and backward Euler where only one instant lies behind.
            a = 1.0 if k == 0 else 1.5
            past = amounts[-1] if k == 0 else 2 * amounts[-1] - 0.5 * amounts[-2]
            whole, c = a / dt * M + K, self._values(now)
            if not still or a not in factors:
                factors[a] = sla.splu(whole[free][:, free].tocsc())
            c[free] = factors[a].solve((b + past / dt - whole @ c)[free])
            found.append(c)
            amounts = [amounts[-1], M @ c]
        return Course(self.body, times, np.array(found))

    def amount(self, c: np.ndarray, u: np.ndarray | None = None) -> float:
        """∫ c dV over the body, deformed by u (n, 3) if given; c (n,)."""
        return float((self._matrices(0.0, u)[0] @ c).sum())

    def error(self, c: np.ndarray, exact: Callable[[np.ndarray], np.ndarray]) -> float:
        """√∫ (c − exact)² dV over √∫ exact² dV, by the quadrature of the mesh with exact(X) of
        positions X (m, q, 3)."""
        want, dx = exact(self._points()), self._basis.dx
        found = np.einsum("amq,ma->mq", self._N, c[self.body.cells])
        return float(np.sqrt((dx * (found - want) ** 2).sum() / (dx * want**2).sum()))

    def _points(self) -> np.ndarray:
        return np.moveaxis(np.asarray(self._basis.global_coordinates()), 0, -1)

    def _coefficients(self, t: float) -> list[np.ndarray]:
        """Diffusivity, decay and source, (1 | m, 1 | q)."""
        shape = self._basis.dx.shape
        given = (
            ("the diffusivity", self.diffusivity),
            ("the decay", self.decay),
            ("the source", self.source),
        )
        D, k, s = (resolve(name, value, t, shape, self._points) for name, value in given)
        if not (D > 0).all():
            raise Unphysical(f"diffusivity = {D.min():g} at t = {t:g}; expected more than 0")
        if not (k >= 0).all():
            raise Unphysical(f"decay = {k.min():g} at t = {t:g}; expected 0 or more")
        return [D, k, s]

    def _volume(self, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None]:
        """J dV₀ (m, q) and F⁻¹F⁻ᵀ (m, q, 3, 3), None of a body that is not deformed."""
        if u is None:
            return self._basis.dx, None
        u = numbers("u", u)
        if u.shape != self.body.nodes.shape:
            raise ValueError(f"u has shape {u.shape}; expected {self.body.nodes.shape}")
        F = np.eye(3) + np.einsum("mai,ajmq->mqij", u[self.body.cells], self._G)
        J = np.linalg.det(F)
        if not (J > 0).all():
            raise Unphysical("the displacement turns an element inside out; give another one")
        inverse = np.linalg.inv(F)
        return J * self._basis.dx, inverse @ np.swapaxes(inverse, -1, -2)

    def _matrices(self, t, u):
        """Mass, stiffness with decay (n, n) and load (n,)."""
        (D, k, _), (dV, metric) = self._coefficients(t), self._volume(u)
        slopes = self._G
        if metric is not None:
            slopes = np.einsum("mqij,ajmq->aimq", metric, slopes)
        mass = np.einsum("amq,bmq,mq->mab", self._N, self._N, dV, optimize=True)
        decay = np.einsum("amq,bmq,mq->mab", self._N, self._N, k * dV, optimize=True)
        stiff = np.einsum("aimq,bimq,mq->mab", self._G, slopes, D * dV, optimize=True)
        return self._assembled(mass), self._assembled(stiff + decay), self._load(t, u)

    def _assembled(self, parts: np.ndarray) -> sp.csr_array:
        cells, n = self.body.cells, len(self.body.nodes)
        rows = np.repeat(cells, cells.shape[1], axis=1).ravel()
        columns = np.tile(cells, (1, cells.shape[1])).ravel()
        return sp.coo_array((parts.ravel(), (rows, columns)), shape=(n, n)).tocsr()

    def _load(self, t: float, u: np.ndarray | None) -> np.ndarray:
        source, (dV, _) = self._coefficients(t)[2], self._volume(u)
        b = np.zeros(len(self.body.nodes))
        np.add.at(b, self.body.cells, np.einsum("amq,mq->ma", self._N, source * dV))
        for part in self.influx:
            value = number("an influx", part.value(t) if callable(part.value) else part.value)
            s = part.surface
            np.add.at(b, s.nodes, value * np.einsum("fqk,fq->fk", s.shapes, s.weights))
        return b

    def _mask(self) -> np.ndarray:
        mask = np.ones(len(self.body.nodes), bool)
        mask[self._free] = False
        return mask

    def _values(self, t: float) -> np.ndarray:
        """c (n,) of the kept nodes, 0 elsewhere."""
        c = np.zeros(len(self.body.nodes))
        for part, nodes in zip(self.kept, self._kept, strict=True):
            c[nodes] = number("a kept value", part.value(t) if callable(part.value) else part.value)
        return c
