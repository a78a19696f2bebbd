"""Hinges as moment–angle laws between panels that are rigid.

A panel is one linear tetrahedron: its first node at the panel's centroid, the others a length off
along x, y, z, so that every point of the panel is a fixed combination of four nodes, and so is
every direction (affine bodies, Lan et al. 2022). A hinge of length l joins two panels a and b at
the middles of its sides; t is its axis, s the direction from a to b in the panel, n the normal,
each of them once in a and once in b. It bends by θ about t; s' and n' are s and n of a turned by
θ/2, where the middle of an arc stands. With D from a's side to b's, ω the small turns beyond θ and
the strip's own stretch λ₀

    r = (θ − θ₀(e), ω·n', ω·s', D·t, D·s' − λ₀ l sin(θ/2)/(θ/2), D·n'),    E = ½ Σ k r²,

which is a beam's energy in the frame of its middle: its stiffnesses k are B w/l in bending,
12 B w/l³ in shear across the sheet, E A/l in stretch, and those of a wide strip in its plane and in
torsion (2 (1 − ν) B w/l of a plate, and B w/l (w/l)² as its sides stay straight). By θ₀ the active
layer folds the hinge, by k it resists.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from solver.cases.structure.pattern import Hinge
from solver.cases.unit import section
from solver.given import positive
from solver.mesh.body import Body, NodeGraph
from solver.physics.term import Evaluation

POINTS = 33  # of a law over the contraction
SHEAR = 5 / 6  # of a rectangular section


@dataclass(frozen=True)
class Layer:
    """A layer: Young's modulus, density, thickness; ``contraction``: at e = 1, 0 of a passive one.

    In SI units, or in any others that fit together. Raises ValueError for what is not positive.
    """

    E: float
    rho: float
    h: float
    contraction: float = 0.0

    def __post_init__(self):
        positive(self, "E", "rho", "h")
        if not 0 <= self.contraction < 0.95:
            raise ValueError(
                f"contraction = {self.contraction!r}; expected a number from 0 to below 0.95"
            )


@dataclass(frozen=True, eq=False)
class Law:
    """What a hinge does over its layer's contraction, from 0 to full in even steps.

    ``angle`` (k,): θ₀, rad; ``stiffness`` (k,): moment per radian; ``stretch`` (k,): λ₀;
    ``stretching``: E A per length of the strip; ``twist``: moment per radian about s; ``length``
    and ``width`` of the strip; ``error``: of the angle, as a ratio, None where it is not known.
    """

    angle: np.ndarray
    stiffness: np.ndarray
    stretch: np.ndarray
    stretching: float
    twist: float
    length: float
    width: float
    nu: float = 0.3
    error: float | None = None
    _curves: tuple = field(init=False, repr=False)

    def __post_init__(self):
        at = np.linspace(0, 1, len(self.angle))
        rows = (self.angle, self.stiffness, self.stretch)
        object.__setattr__(self, "_curves", tuple(PchipInterpolator(at, row) for row in rows))

    def at(self, e: float) -> tuple[float, float, float]:
        """θ₀, stiffness in bending and λ₀ at the fraction e of the contraction."""
        return tuple(float(curve(e)) for curve in self._curves)

    def stiffnesses(self, bending: float) -> tuple[float, ...]:
        """Of the six residuals (see the module), by that in bending."""
        in_plane = self.stretching * self.width**2 / 12
        shear = SHEAR * self.stretching * (1 - self.nu) / 2
        along = 1 / (self.length**3 / (12 * in_plane) + self.length / shear)
        across = 12 * bending / self.length**2
        return (
            bending, in_plane / self.length, self.twist, along, self.stretching / self.length,
            across,
        )  # fmt: skip

    @classmethod
    def of_section(
        cls, sheet: Layer, layer: Layer, length: float, width: float, nu: float = 0.3
    ) -> Law:
        """Of the bilayer's section in pure bending; see :mod:`solver.cases.unit.section`.

        Raises ValueError where the section has no natural state up to the full contraction.
        """
        m, n = layer.h / sheet.h, layer.E / sheet.E
        table = np.zeros((POINTS, 3))
        if not section.natural(m, n, layer.contraction, nu, table):
            raise ValueError(
                f"a hinge with h_i/h_s = {m:.3g}, E_i/E_s = {n:.3g} and contraction "
                f"{layer.contraction:.3g} has no natural state; its layer is crushed"
            )
        bending = sheet.E * sheet.h**3 * table[:, 1] * width
        stretching = (sheet.E * sheet.h + layer.E * layer.h) * width / (1 - nu**2)
        angle = table[:, 0] * length / sheet.h
        return cls._of(angle, bending, table[:, 2], stretching, length, width, nu)

    @classmethod
    def of_sheet(cls, sheet: Layer, length: float, width: float, nu: float = 0.3) -> Law:
        """Of a crease without an active layer: the sheet's own plate stiffness."""
        flat = np.zeros(2)
        bending = np.full(2, sheet.E * sheet.h**3 / (12 * (1 - nu**2)) * width)
        stretching = sheet.E * sheet.h * width / (1 - nu**2)
        return cls._of(flat, bending, flat + 1, stretching, length, width, nu)

    @classmethod
    def _of(cls, angle, bending, stretch, stretching, length, width, nu) -> Law:
        # Of a wide strip every fibre is sheared by as much as it lies off the middle.
        twist = (2 * (1 - nu) + (width / length) ** 2) * float(bending[0]) / length
        return cls(angle, bending / length, stretch, stretching, twist, length, width, nu)

    def with_angle(self, angle: np.ndarray, error: float) -> Law:
        """The law with another angle (k,) over the contraction, known to ``error``."""
        return replace(self, angle=angle, error=error)

    @cached_property
    def half(self) -> Law:
        """Of which two in a row are this one: the line between them is free to turn, but for its
        warping, which a whole strip's twist has in it."""
        return replace(
            self, angle=self.angle / 2, stiffness=2 * self.stiffness, twist=2 * self.twist,
            length=self.length / 2,
        )  # fmt: skip


class Hinges:
    """All hinges of a structure on the nodes of its panels; see the module.

    ``laws``: one per hinge. ``about`` (hinges,): angles near which θ is sought, so that it may pass
    π; at rest all are 0.
    """

    name = "hinges"
    symmetric = True

    def __init__(
        self,
        body: Body,
        hinges: Sequence[Hinge],
        laws: Sequence[Law],
        about: np.ndarray | None = None,
    ):
        self.body, self.hinges, self.laws = body, tuple(hinges), tuple(laws)
        self.about = np.zeros(len(hinges)) if about is None else about
        pairs = np.array([h.faces for h in hinges]).reshape(-1, 2)
        self.nodes = (4 * pairs[:, :, None] + np.arange(4)).reshape(-1, 8)
        self.graph = NodeGraph.of(len(body.nodes), self.nodes)
        self._where = self.graph.positions(self.nodes)
        self._V, self._W = self._forms(pairs)
        kinds = [
            (law, h.crease.fold, h.crease.start, h.crease.end)
            for h, law in zip(self.hinges, self.laws, strict=True)
        ]
        self._kinds = list(dict.fromkeys(kinds))
        self._kind = np.array([self._kinds.index(kind) for kind in kinds], int)

    def moved(self, u: np.ndarray) -> Hinges:
        """The term for the step from u (n, 3): angles go on from those there."""
        new = object.__new__(Hinges)
        new.__dict__ = self.__dict__ | {"about": self.angles(u)}
        return new

    def _forms(self, pairs) -> tuple[np.ndarray, np.ndarray]:
        """Weights (hinges, 10, 8) of the vectors whose products are the ten scalars p."""
        m = len(pairs)
        at = {k: np.zeros((m, 2, 8)) for k in ("t", "s", "n", "x")}
        for k, hinge in enumerate(self.hinges):
            axis = np.array([*hinge.axis, 0.0])
            across = np.array([-axis[1], axis[0], 0.0])
            for side in (0, 1):
                own = slice(4 * side, 4 * side + 4)
                for name, v in (("t", axis), ("s", across), ("n", np.array([0.0, 0.0, 1.0]))):
                    at[name][k, side, own] = direction_weights(self.body, pairs[k, side], v)
                place = np.array([*hinge.sides[side], 0.0])
                at["x"][k, side, own] = point_weights(self.body, pairs[k, side], place)
        self._places, self._axes = at["x"], at["t"]
        (ta, tb), (sa, sb), (na, nb) = (at[k].transpose(1, 0, 2) for k in "tsn")
        D = at["x"][:, 1] - at["x"][:, 0]
        V = np.stack([sb, nb, sb, nb, tb, tb, D, D, D, D], axis=1)
        W = np.stack([na, sa, sa, na, sa, na, ta, tb, sa, na], axis=1)
        return V, W

    def sides(self, u: np.ndarray) -> np.ndarray:
        """Ends (hinges, 2, 2, 3) of each strip's side on a and of that on b, along the axis."""
        y = (self.body.nodes + u)[self.nodes]
        half = np.array([h.width / 2 for h in self.hinges])[:, None, None]
        middle, axis = self._places @ y, self._axes @ y
        return np.stack([middle - half * axis, middle + half * axis], axis=2)

    def angles(self, u: np.ndarray) -> np.ndarray:
        """θ of each hinge, rad, positive where the panels rise towards its upper side."""
        p = self._products(self.body.nodes + u)[0]
        return self._angle(p[:, 0] - p[:, 1], p[:, 2] + p[:, 3])

    def _angle(self, sine, cosine) -> np.ndarray:
        raw = np.arctan2(sine, cosine)
        return raw + 2 * np.pi * np.round((self.about - raw) / (2 * np.pi))

    def _products(self, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        y = Y[self.nodes]
        v, w = self._V @ y, self._W @ y
        return np.einsum("hpi,hpi->hp", v, w), v, w

    def _at(self, e: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stiffnesses (h, 6), natural angles (h,) and lengths (h,) at the load e."""
        k, angle, length = [], [], []
        for law, fold, start, end in self._kinds:
            on = min(max((e - start) / (end - start), 0.0), 1.0) if fold else 0.0
            theta, stiff, stretch = law.at(on)
            k.append(law.stiffnesses(stiff))
            angle.append(fold * theta)
            length.append(stretch * law.length)
        return tuple(np.array(values)[self._kind] for values in (k, angle, length))

    def evaluate(self, u: np.ndarray, e: float, order: int = 2) -> Evaluation:
        """Energy, force (n, 3) and blocks; inf where a hinge's sides have turned away from each
        other beyond what its angle tells."""
        p, v, w = self._products(self.body.nodes + u)
        N, C = p[:, 0] - p[:, 1], p[:, 2] + p[:, 3]
        square = N * N + C * C
        if not (square > 1e-4).all():
            return Evaluation(np.inf)
        k, natural, length = self._at(e)
        theta = self._angle(N, C)
        r, first, second = _residuals(theta, p, natural, length)
        energy = float((k * r * r).sum() / 2)
        if order < 1:
            return Evaluation(energy)
        # By (θ, q₁, q₂, g_t, g_s, g_n), then by (N, C, q₁ …).
        kr = k * r
        g = np.einsum("hr,hrz->hz", kr, first)
        theta_N, theta_C = C / square, -N / square
        bending = g[:, :1] * np.stack([theta_N, theta_C], axis=1)
        slope = np.concatenate([bending, g[:, 1:]], axis=1)
        f = slope @ LINEAR
        V, W = self._V, self._W
        force = np.zeros_like(self.body.nodes)
        pulls = np.einsum("hp,hpk,hpi->hki", f, V, w) + np.einsum("hp,hpk,hpi->hki", f, W, v)
        np.add.at(force, self.nodes, pulls)
        if order < 2:
            return Evaluation(energy, force)
        # ∂p/∂y, (h, p, 8, 3)
        grad = V[..., None] * w[:, :, None, :] + W[..., None] * v[:, :, None, :]
        h = np.einsum("hr,hrz,hrx->hzx", k, first, first)
        h[:, 0, :] += np.einsum("hr,hrz->hz", kr, second)
        h[:, 1:, 0] += np.einsum("hr,hrz->hz", kr, second)[:, 1:]
        to = np.zeros((len(p), 6, 7))
        to[:, 0, 0], to[:, 0, 1] = theta_N, theta_C
        to[:, np.arange(1, 6), np.arange(2, 7)] = 1.0
        H = np.einsum("hza,hzx,hxb->hab", to, h, to)
        bent = g[:, 0] / square**2
        H[:, 0, 0] += -2 * N * C * bent
        H[:, 1, 1] += 2 * N * C * bent
        H[:, 0, 1] += (N * N - C * C) * bent
        H[:, 1, 0] += (N * N - C * C) * bent
        G = np.einsum("zp,hpki->hzki", LINEAR, grad)
        blocks = np.einsum("hab,haki,hblj->hklij", H, G, G, optimize=True)
        pairs = np.einsum("hp,hpk,hpl->hkl", f, V, W)
        pairs = pairs + pairs.transpose(0, 2, 1)
        blocks[..., range(3), range(3)] += pairs[..., None]
        stiffness = np.zeros((self.graph.blocks, 3, 3))
        np.add.at(stiffness, self._where, blocks)
        return Evaluation(energy, force, stiffness, own=True)


# (N, C, q₁, q₂, g_t, g_s, g_n) of the ten products.
LINEAR = np.zeros((7, 10))
LINEAR[0, :2] = 1, -1
LINEAR[1, 2:4] = 1, 1
LINEAR[2, 4] = LINEAR[3, 5] = 1
LINEAR[4, 6:8] = 0.5
LINEAR[5, 8] = LINEAR[6, 9] = 1


def _residuals(theta, p, natural, length):
    """r (h, 6), ∂r/∂z (h, 6, 6) and ∂²r/∂θ∂z (h, 6, 6) of z = (θ, q₁, q₂, g_t, g_s, g_n)."""
    c, s = np.cos(theta / 2), np.sin(theta / 2)
    q1, q2, gs, gn = p[:, 4], p[:, 5], p[:, 8], p[:, 9]
    gt = (p[:, 6] + p[:, 7]) / 2
    j, j1, j2 = _chord(theta / 2)
    zero, one = np.zeros_like(theta), np.ones_like(theta)
    r = np.stack(
        [theta - natural, c * q1 + s * q2, s * q1 - c * q2, gt,
         c * gs + s * gn - length * j, -s * gs + c * gn], axis=1,
    )  # fmt: skip
    first = np.array([
        [one, zero, zero, zero, zero, zero],
        [(-s * q1 + c * q2) / 2, c, s, zero, zero, zero],
        [(c * q1 + s * q2) / 2, s, -c, zero, zero, zero],
        [zero, zero, zero, one, zero, zero],
        [(-s * gs + c * gn - length * j1) / 2, zero, zero, zero, c, s],
        [(-c * gs - s * gn) / 2, zero, zero, zero, -s, c],
    ])  # fmt: skip
    second = np.array([
        [zero] * 6,
        [(-c * q1 - s * q2) / 4, -s / 2, c / 2, zero, zero, zero],
        [(-s * q1 + c * q2) / 4, c / 2, s / 2, zero, zero, zero],
        [zero] * 6,
        [(-c * gs - s * gn - length * j2) / 4, zero, zero, zero, -s / 2, c / 2],
        [(s * gs - c * gn) / 4, zero, zero, zero, -c / 2, -s / 2],
    ])  # fmt: skip
    return r, first.transpose(2, 0, 1), second.transpose(2, 0, 1)


def _chord(h):
    """sin h / h and its first two derivatives."""
    small = np.abs(h) < 1e-3
    x = np.where(small, 1.0, h)
    s, c = np.sin(x), np.cos(x)
    j = np.where(small, 1 - h * h / 6, s / x)
    j1 = np.where(small, -h / 3 + h**3 / 30, (x * c - s) / x**2)
    j2 = np.where(small, -1 / 3 + h * h / 10, -s / x - 2 * (x * c - s) / x**3)
    return j, j1, j2


def direction_weights(body: Body, panel: int, v: np.ndarray) -> np.ndarray:
    """Weights (4,) on a panel's nodes that give a direction (3,) of it, moving with it."""
    X = body.nodes[4 * panel : 4 * panel + 4]
    parts = np.linalg.solve((X[1:] - X[0]).T, v)
    return np.array([-parts.sum(), *parts])


def point_weights(body: Body, panel: int, place: np.ndarray) -> np.ndarray:
    """Weights (4,) on a panel's nodes that give a point of it, by its position (3,) at rest."""
    weights = direction_weights(body, panel, place - body.nodes[4 * panel])
    weights[0] += 1.0
    return weights
