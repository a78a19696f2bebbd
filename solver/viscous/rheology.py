"""Rheology: springs and dashpots in series and parallel, any nesting, at finite strain.

Parts in parallel share the deformation, F = F₁ = F₂ (Eq. 5.12); in series it multiplies,
F = F₁ F₂ (5.14). A spring stores ψ(C) (neo-Hookean, 5.9), a dashpot has the dissipation potential
φ = (η/2) D : D (5.10), so its stress is η D, isotropic: at small strain axial and lateral parts
retard differently. The energy-rate functional (5.15) with backward Euler (5.17, 5.18) is stationary
where the incremental potential Σ ψ + Δt Σ φ is, over the displacement and, at each point on its
own, over what series leave open:

    w(C) = min over U of [w_left(U⁻¹ C U⁻¹) + w_right(U²)],      F = F_left U.

The dashpot's Δt φ = η/(8 Δt) [tr(C C₁⁻¹) + tr(C⁻¹ C₁) − 6] with C₁ one step before. In the log
strain ε of C₁ → C that is (η/2Δt) sinh² ε: the potential of backward Euler up to ε⁴, which needs no
matrix logarithm and grows without bound as C loses its determinant, so that C stays positive. (The
form printed under 5.11, I_v : I_v with I_v = ½ Ċ C⁻¹, is D : D only where Ċ and C commute.) Second
order (BDF2) is a difference of two such potentials, (1 + r) d₁² − r²/(1 + r) d₂² with r the ratio
of the steps (r = 1: Matthes and Plazotta 2019).

Materials without memory are put first in a series, F = Fe Fv (5.2), whatever order they are given
in; F_right = U without rotation then means nothing physical unless two parts have a memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la

from solver.physics.fields import Points, Quantity, Unphysical, resolve, varies
from solver.physics.materials import NeoHookean


class Rheology:
    """A tree of springs and dashpots."""

    def leaves(self) -> Iterator[Spring | Dashpot]:
        """Springs and dashpots, in the order in which memories hold the dashpots."""
        raise NotImplementedError

    @property
    def springs(self) -> list[Spring]:
        """All springs."""
        return [leaf for leaf in self.leaves() if isinstance(leaf, Spring)]

    @property
    def dashpots(self) -> list[Dashpot]:
        """All dashpots."""
        return [leaf for leaf in self.leaves() if isinstance(leaf, Dashpot)]

    @property
    def joints(self) -> int:
        """How many tensors U its series leave open."""
        return 0

    @property
    def moving(self) -> bool:
        """Whether a property is a function of e."""
        return any(leaf.moving for leaf in self.leaves())

    def shortest_time(self, e: float, shape: tuple[int, int], points: Points | None = None):
        """Shortest relaxation or retardation time of the one-dimensional model, over all points.

        With moduli E, as §5.4.3 takes τ = η/E. inf without a dashpot or where nothing relaxes.
        """
        values = [
            resolve(leaf.symbol, leaf.value, e, shape, points).ravel() for leaf in self.leaves()
        ]
        table = np.unique(np.stack(np.broadcast_arrays(*values), axis=-1), axis=0)
        return min(
            (min(times(self, row), default=np.inf) for row in _thinned(table)), default=np.inf
        )


@dataclass(frozen=True, eq=False)
class Spring(Rheology):
    """Neo-Hookean spring (Eq. 5.9), E in stress and ν as for :class:`NeoHookean`.

    Raises ValueError unless E > 0 and −1 < ν < 0.5.
    """

    E: Quantity
    nu: Quantity
    symbol = "E"

    def __post_init__(self):
        object.__setattr__(self, "material", NeoHookean(self.E, self.nu))

    def leaves(self):
        yield self

    @property
    def value(self) -> Quantity:
        return self.E

    @property
    def moving(self) -> bool:
        return self.material.moving


@dataclass(frozen=True, eq=False)
class Dashpot(Rheology):
    """Dashpot of the potential φ = (η/2) D : D (Eq. 5.10), η > 0 in stress · time.

    Raises ValueError for η ≤ 0.
    """

    eta: Quantity
    symbol = "eta"

    def __post_init__(self):
        if not varies(self.eta):
            _check_viscosity(np.asarray(self.eta, dtype=float))

    def leaves(self):
        yield self

    @property
    def value(self) -> Quantity:
        return self.eta

    @property
    def moving(self) -> bool:
        return varies(self.eta)

    def viscosity(self, e: float, shape: tuple[int, int], points: Points | None = None):
        """η at the points, (1 | m, 1 | q); raises Unphysical where it isn't positive."""
        eta = resolve("eta", self.eta, e, shape, points)
        _check_viscosity(eta)
        return eta


def _check_viscosity(eta: np.ndarray) -> None:
    if not (eta > 0).all():
        raise Unphysical(
            f"eta = {np.min(eta):g}; expected eta > 0: a dashpot takes energy, it gives none"
        )


class _Group(Rheology):
    def __init__(self, *parts: Rheology):
        for part in parts:
            if not isinstance(part, Rheology):
                raise ValueError(
                    f"{part!r} in a {type(self).__name__}; expected Spring, Dashpot, Parallel or "
                    "Series"
                )
        flat = []
        for part in parts:
            flat += part.parts if isinstance(part, type(self)) else [part]
        if not flat:
            raise ValueError(f"{type(self).__name__}() has no parts; give at least one")
        self.parts: tuple[Rheology, ...] = tuple(flat)
        if len({id(dashpot) for dashpot in self.dashpots}) < len(self.dashpots):
            raise ValueError(
                "one Dashpot stands twice in the tree, and each has a memory of its own; make "
                "another one with the same eta"
            )

    def leaves(self):
        for part in self.parts:
            yield from part.leaves()


class Parallel(_Group):
    """Parts that share the deformation; their stresses add (Eq. 5.12)."""

    @property
    def joints(self) -> int:
        return sum(part.joints for part in self.parts)


class Series(_Group):
    """Parts that share the stress; their deformations multiply (Eq. 5.14).

    Parts without memory come first, so that F = Fe Fv.
    """

    def __init__(self, *parts: Rheology):
        super().__init__(*parts)
        self.parts = tuple(sorted(self.parts, key=lambda part: bool(part.dashpots)))

    @property
    def joints(self) -> int:
        return len(self.parts) - 1 + sum(part.joints for part in self.parts)


def KelvinVoigt(E: Quantity, nu: Quantity, eta: Quantity) -> Rheology:
    """A spring and a dashpot in parallel (§5.3.2)."""
    return Parallel(Spring(E, nu), Dashpot(eta))


def Maxwell(E: Quantity, nu: Quantity, eta: Quantity) -> Rheology:
    """A spring and a dashpot in series (§5.3.3)."""
    return Series(Spring(E, nu), Dashpot(eta))


def SLS(E: Quantity, E_m: Quantity, nu: Quantity, eta: Quantity) -> Rheology:
    """Standard linear solid: a spring E beside a Maxwell branch E_m, η (§5.3.4)."""
    return Parallel(Spring(E, nu), Maxwell(E_m, nu, eta))


def GeneralisedMaxwell(E: Quantity | None, nu: Quantity, *branches) -> Rheology:
    """Maxwell branches (E_m, η) beside a spring E; None: without it, a fluid."""
    spring = [] if E is None else [Spring(E, nu)]
    return Parallel(*spring, *(Maxwell(E_m, nu, eta) for E_m, eta in branches))


def branches(tree: Rheology) -> tuple[list[Spring], list[Dashpot], list[tuple]] | None:
    """Springs, dashpots and Maxwell branches in parallel; None for a tree that is more than that.

    A Maxwell branch is (springs, dashpots), each of them parts in parallel.
    """
    springs, dashpots, maxwell = [], [], []
    for part in tree.parts if isinstance(tree, Parallel) else (tree,):
        if isinstance(part, Spring):
            springs.append(part)
        elif isinstance(part, Dashpot):
            dashpots.append(part)
        elif isinstance(part, Series) and len(part.parts) == 2:
            left, right = part.parts
            flat = [p.parts if isinstance(p, Parallel) else (p,) for p in (left, right)]
            if not all(isinstance(p, Spring) for p in flat[0]):
                return None
            if not all(isinstance(p, Dashpot) for p in flat[1]):
                return None
            maxwell.append((list(flat[0]), list(flat[1])))
        else:
            return None
    return springs, dashpots, maxwell


def channel(tree: Rheology, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """K and N of the one-dimensional model N ẋ + K x = (σ, 0, …), x = (ε, strains of joints).

    ``values``: modulus or viscosity per leaf. With moduli 2μ or 3K it is a channel of the exact
    three-dimensional small-strain solution.
    """
    n = 1 + tree.joints
    K, N = np.zeros((n, n)), np.zeros((n, n))
    given, open_ = iter(values), iter(range(1, n))

    def visit(part, strain):
        if isinstance(part, Parallel):
            for p in part.parts:
                visit(p, strain)
        elif isinstance(part, Series):
            for p in part.parts[:-1]:
                rest = np.eye(n)[next(open_)]
                visit(p, strain - rest)
                strain = rest
            visit(part.parts[-1], strain)
        else:
            target = K if isinstance(part, Spring) else N
            target += next(given) * np.outer(strain, strain)

    visit(tree, np.eye(n)[0])
    return K, N


def times(tree: Rheology, values: np.ndarray) -> list[float]:
    """Finite relaxation (ε held) and retardation (σ held) times of :func:`channel`."""
    K, N = channel(tree, values)
    finite = []
    for k in (0, 1):
        if len(K) > k:
            rates, _ = la.eig(K[k:, k:], N[k:, k:], homogeneous_eigvals=True)
            a, b = np.abs(rates)
            scale = a > 1e-9 * np.abs(K).max(), b > 1e-9 * np.abs(N).max()
            finite += list(b[scale[0] & scale[1]] / a[scale[0] & scale[1]])
    return sorted(float(t) for t in finite)


def _thinned(table: np.ndarray, most: int = 64) -> np.ndarray:
    """Rows of a table with each column's extremes among them."""
    if len(table) <= most:
        return table
    ends = [f(table[:, j]) for j in range(table.shape[1]) for f in (np.argmin, np.argmax)]
    return table[np.unique([*ends, *np.linspace(0, len(table) - 1, most, dtype=int)])]
