"""The design space: nondimensional groups, sampling, and conversion to physical quantities.

Scales: length l_s (total length of the passive sheet), stress E_s, density rho_s. The weight enters
as Γ = E_s h_s² / (rho_s g l_s³), large for a light and stiff unit. Subscript i is the active layer,
s the passive layer and the panels. Bounds: dissertation §4.2.2 and §4.6.3.

In the patterned space (§4.8.3) the active layer is n strips of width w along the sheet, a gap s
between two and half of one at each edge of the hinge: b_i = n (w + s).

Groups, bounds and conversions are one table read in both directions, and stay in one file.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from foldlab.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

STANDARD_GRAVITY = 9.80665  # m/s²
# A design written to a file and read back may miss its bound by the last digits.
BOUND_RTOL = 1e-9
# Designs in one sample; more would fill the memory before anything is written.
MOST_DESIGNS = 10**7


@dataclass(frozen=True)
class Parameter:
    """One nondimensional group with its bounds and the scale on which it is sampled.

    ``whole``: whether it counts something and has whole numbers only. On its scale each of them
    then has the interval of half a unit to both sides.
    """

    name: str
    symbol: str
    low: float
    high: float
    scale: Literal["log", "linear"]
    meaning: str
    whole: bool = False

    def __post_init__(self):
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise InputError(
                f"{self.name}: bounds {self.low:g} … {self.high:g} are not an interval; "
                "give a finite lower bound below a finite upper bound"
            )
        if self.scale not in ("log", "linear"):
            raise InputError(f"{self.name}: scale {self.scale!r}; expected 'log' or 'linear'")
        if self.scale == "log" and self.low <= 0:
            raise InputError(
                f"{self.name}: lower bound {self.low:g} on a log scale; expected above 0"
            )
        if self.whole and not (float(self.low).is_integer() and float(self.high).is_integer()):
            raise InputError(
                f"{self.name}: bounds {self.low:g} … {self.high:g} of a whole number; give whole "
                "numbers"
            )

    def to_unit(self, value):
        """Map values in [low, high] to [0, 1] on the parameter's own scale."""
        low, high = self._ends()
        return (self._scaled(np.asarray(value, dtype=float)) - low) / (high - low)

    def from_unit(self, unit):
        """Map [0, 1] to [low, high]; the inverse of :meth:`to_unit`."""
        low, high = self._ends()
        scaled = low + np.asarray(unit, dtype=float) * (high - low)
        value = 10.0**scaled if self.scale == "log" else scaled
        return np.clip(np.rint(value) if self.whole else value, self.low, self.high)

    def _scaled(self, value):
        return np.log10(value) if self.scale == "log" else value

    def _ends(self):
        half = 0.5 if self.whole else 0.0
        return self._scaled(np.float64(self.low - half)), self._scaled(np.float64(self.high + half))


@dataclass(frozen=True)
class DesignSpace:
    """An ordered set of parameters; tables of designs are frames with their names as columns."""

    name: str
    parameters: tuple[Parameter, ...]

    def __repr__(self) -> str:
        groups = ", ".join(f"{p.name} {p.low:g} to {p.high:g}" for p in self.parameters)
        return f"DesignSpace({self.name}: {groups})"

    def _repr_html_(self) -> str:
        from foldlab.shown import html_table

        rows = [
            (p.name, p.symbol, p.meaning, f"{p.low:g} to {p.high:g}", p.scale)
            for p in self.parameters
        ]
        head = ("group", "symbol", "meaning", "bounds", "scale")
        return html_table(f"design space {self.name}", rows, head)

    @property
    def names(self) -> list[str]:
        return [p.name for p in self.parameters]

    def __len__(self) -> int:
        return len(self.parameters)

    def __getitem__(self, name: str) -> Parameter:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise InputError(
            f"no group {name!r} in the {self.name} space; it has: {', '.join(self.names)}"
        )

    def with_bounds(self, **bounds: tuple[float, float]) -> DesignSpace:
        """The same space with narrower (or wider) bounds for some groups."""
        for name in bounds:
            self[name]
        return replace(
            self,
            parameters=tuple(
                replace(p, low=float(bounds[p.name][0]), high=float(bounds[p.name][1]))
                if p.name in bounds
                else p
                for p in self.parameters
            ),
        )

    def sample(
        self, n: int, *, seed: int, optimization: Literal["random-cd", "lloyd"] | None = None
    ) -> pd.DataFrame:
        """Latin hypercube of ``n`` designs, uniform on each parameter's own scale.

        ``optimization`` spreads the points further (SciPy's options); its cost grows as n².
        """
        # Its import takes most of a second, and every worker process imports this module.
        from scipy.stats import qmc

        if n < 1:
            raise InputError(f"n = {n}: a sample needs at least one design")
        if n > MOST_DESIGNS:
            raise InputError(
                f"n = {n}: a sample has at most {MOST_DESIGNS} designs; draw several, each with "
                "its own seed"
            )
        engine = qmc.LatinHypercube(d=len(self), rng=seed, optimization=optimization)
        return self.from_unit(engine.random(n))

    def to_unit(self, designs: pd.DataFrame) -> np.ndarray:
        """Designs as points of the unit cube, shape (n, number of groups)."""
        return np.column_stack(
            [p.to_unit(designs[p.name].to_numpy(float)) for p in self.parameters]
        )

    def from_unit(self, points: np.ndarray) -> pd.DataFrame:
        """Points of the unit cube, shape (n, number of groups), as a frame of designs."""
        import pandas as pd

        points = np.atleast_2d(np.asarray(points, dtype=float))
        return pd.DataFrame({p.name: p.from_unit(points[:, k]) for k, p in enumerate(self)})

    def __iter__(self):
        return iter(self.parameters)

    def validate(self, designs: pd.DataFrame, *, bounds: bool = True) -> pd.DataFrame:
        """The group columns of a table, as floats, in the space's order.

        Other columns are left out. Raises :class:`InputError` for an empty table, missing or
        non-numeric columns, NaN or infinite values, and (with ``bounds``) designs outside it.
        """
        import pandas as pd

        from foldlab.tables import as_frame

        designs = as_frame(designs)
        if not isinstance(designs, pd.DataFrame):
            raise InputError(f"designs came as {type(designs).__name__}; give a table with names")
        if len(designs) == 0:
            raise InputError("the table of designs is empty; give at least one row")
        self._complete(list(designs.columns))
        if list(designs.columns) == self.names and set(designs.dtypes) == {np.dtype(float)}:
            values = designs.to_numpy(copy=True)
        else:
            values = np.column_stack([self._column(designs, name) for name in self.names])
        for p, column in zip(self.parameters, values.T, strict=True):
            self._check(p, column, bounds)
        columns = dict(zip(self.names, values.T, strict=True))
        return pd.DataFrame(columns, index=designs.index)

    @staticmethod
    def _column(designs: pd.DataFrame, name: str) -> np.ndarray:
        if (count := list(designs.columns).count(name)) > 1:
            raise InputError(f"column {name} stands {count} times; keep the one that counts")
        try:
            return designs[name].to_numpy(dtype=float, na_value=np.nan)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"column {name} is not numeric ({error}); give plain numbers"
            ) from None

    def validate_one(self, design: Mapping[str, float], *, bounds: bool = True) -> dict[str, float]:
        """As :meth:`validate`, for one design; without pandas, whose 60 MB no label needs."""
        self._complete(design)
        groups = {}
        for p in self.parameters:
            try:
                groups[p.name] = float(design[p.name])
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"{p.name} is {design[p.name]!r} ({error}); give a plain number"
                ) from None
            self._check(p, np.array([groups[p.name]]), bounds)
        return groups

    def _complete(self, columns: Collection) -> None:
        missing = [name for name in self.names if name not in columns]
        if missing:
            raise InputError(
                f"the table lacks {', '.join(missing)}; it has "
                f"{', '.join(map(str, columns)) or 'no columns'}; "
                f"the {self.name} space needs {', '.join(self.names)}"
            )

    @staticmethod
    def _check(p: Parameter, values: np.ndarray, bounds: bool) -> None:
        bad = ~np.isfinite(values)
        if bad.any():
            raise InputError(
                f"{p.name} is {values[bad][0]} in row {int(np.argmax(bad))} "
                f"({int(bad.sum())} such rows); give finite numbers"
            )
        if p.scale == "log" and (values <= 0).any():
            row = int(np.argmax(values <= 0))
            raise InputError(f"{p.name} is {values[row]:g} in row {row}; it must be above 0")
        if p.whole and (values != np.rint(values)).any():
            row = int(np.argmax(values != np.rint(values)))
            raise InputError(f"{p.name} is {values[row]:g} in row {row}; give whole numbers")
        if not bounds:
            return
        outside = (values < p.low * (1 - BOUND_RTOL)) | (values > p.high * (1 + BOUND_RTOL))
        if outside.any():
            row = int(np.argmax(outside))
            raise InputError(
                f"{p.name} = {values[row]:g} in row {row} ({int(outside.sum())} such rows) lies "
                f"outside {p.low:g} … {p.high:g}; change it, or widen the bounds of the space"
            )


_E = Parameter("E_ratio", "E_i/E_s", 1e-3, 1e3, "log", "stiffness, active over passive")
_H = Parameter("h_ratio", "h_i/h_s", 0.1, 10, "log", "thickness, active over passive")
_T = Parameter("slenderness", "h_s/l_s", 1e-3, 1e-1, "log", "sheet thickness over total length")

REDUCED = DesignSpace("reduced", (_E, _H, _T))
FULL = DesignSpace(
    "full",
    (
        _E,
        Parameter("rho_ratio", "rho_i/rho_s", 0.1, 10, "log", "density, active over passive"),
        Parameter("hinge_length", "l_i/l_s", 0.05, 0.5, "linear", "hinge over total length"),
        Parameter("hinge_width", "b_i/b_s", 0.25, 1, "linear", "hinge over panel width"),
        _H,
        Parameter("stiffness_to_weight", "Gamma", 1e-2, 1e2, "log", "E_s h_s² / (rho_s g l_s³)"),
        Parameter("aspect", "b_s/l_s", 0.05, 1, "log", "sheet width over total length"),
        _T,
        Parameter("contraction", "|g_i|", 0.02, 0.4, "linear", "contraction of the active layer"),
    ),
)
PATTERNED = DesignSpace(
    "patterned",
    (
        *FULL.parameters,
        Parameter("strips", "n", 1, 10, "log", "active strips side by side", whole=True),
        Parameter("strip_share", "w/(w+s)", 0.3, 0.95, "linear", "strip width over pitch"),
    ),
)
SPACES = {space.name: space for space in (REDUCED, FULL, PATTERNED)}


def space_named(name: str) -> DesignSpace:
    """``'reduced'``, ``'full'`` or ``'patterned'``."""
    if name not in SPACES:
        raise InputError(f"no design space {name!r}; there are: {', '.join(SPACES)}")
    return SPACES[name]


def space_of(designs: pd.DataFrame) -> DesignSpace:
    """The largest space whose groups are all columns of the table."""
    for space in (PATTERNED, FULL, REDUCED):
        if all(name in designs.columns for name in space.names):
            return space
    raise InputError(
        f"the table has columns {', '.join(map(str, designs.columns)) or '(none)'}; "
        f"expected at least the groups of the reduced space: {', '.join(REDUCED.names)}"
    )


# physical quantity: (group, scale): quantity = group * scale
RATIOS = {
    "E_i": ("E_ratio", "E_s"),
    "rho_i": ("rho_ratio", "rho_s"),
    "l_i": ("hinge_length", "l_s"),
    "h_s": ("slenderness", "l_s"),
    "b_s": ("aspect", "l_s"),
    "h_i": ("h_ratio", "h_s"),
    "b_i": ("hinge_width", "b_s"),
}
PHYSICAL = {
    "E_s": "Pa",
    "E_i": "Pa",
    "rho_s": "kg/m³",
    "rho_i": "kg/m³",
    "l_s": "m",
    "l_i": "m",
    "b_s": "m",
    "b_i": "m",
    "h_s": "m",
    "h_i": "m",
    "g_earth": "m/s²",
    "contraction": "1",
}
# Groups that say how an active layer is cut in strips.
STRIPS = ("strips", "strip_share")
# Width of an active strip and of the gap between two.
PATTERN = {"w_i": "m", "s_i": "m"}
_SCALES = ("E_s", "rho_s", "l_s", "g_earth")


def to_physical(groups: pd.DataFrame, **scales: float | np.ndarray) -> pd.DataFrame:
    """SI quantities (names and units: :data:`PHYSICAL`, of strips :data:`PATTERN`) of designs given
    as groups.

    Each of the scales ``E_s``, ``rho_s``, ``l_s``, ``g_earth`` is a number or one value per design.
    Γ ties the four together: with ``stiffness_to_weight`` among the groups give exactly three, and
    the fourth follows; without it give those that the other groups need. Inverse of
    :func:`to_groups`.
    """
    import pandas as pd

    unknown = [name for name in scales if name not in _SCALES]
    if unknown:
        raise InputError(
            f"no scale {', '.join(unknown)}; the scales are {', '.join(_SCALES)} (SI units)"
        )
    known = {name: _positive(name, value, len(groups)) for name, value in scales.items()}
    groups = groups.reset_index(drop=True)
    if "stiffness_to_weight" in groups:
        if len(known) != 3:
            raise InputError(
                f"Γ ties E_s, rho_s, l_s and g_earth together: give exactly three of them, "
                f"not {len(known)} ({', '.join(known) or 'none'})"
            )
        weight = _positive("stiffness_to_weight", groups["stiffness_to_weight"], len(groups))
        thin2 = _positive("slenderness", groups["slenderness"], len(groups)) ** 2
        # Γ = E_s (h_s/l_s)² / (rho_s g l_s)
        (absent,) = set(_SCALES) - set(known)
        if absent == "E_s":
            known["E_s"] = weight * known["rho_s"] * known["g_earth"] * known["l_s"] / thin2
        else:
            rest = np.prod([known[k] for k in ("rho_s", "l_s", "g_earth") if k != absent], axis=0)
            known[absent] = known["E_s"] * thin2 / (weight * rest)
    out = dict(known)
    for quantity, (group, scale) in RATIOS.items():
        if group not in groups:
            continue
        if scale not in out:
            raise InputError(f"{quantity} = {group} × {scale}: give {scale} in SI units")
        out[quantity] = _positive(group, groups[group], len(groups)) * out[scale]
    if "contraction" in groups:
        out["contraction"] = _positive("contraction", groups["contraction"], len(groups))
    if "b_i" in out and all(name in groups for name in ("strips", "strip_share")):
        PATTERNED._check(PATTERNED["strips"], groups["strips"].to_numpy(float), False)
        pitch = out["b_i"] / _positive("strips", groups["strips"], len(groups))
        fraction = _positive("strip_share", groups["strip_share"], len(groups))
        out |= {"w_i": fraction * pitch, "s_i": (1 - fraction) * pitch}
    return pd.DataFrame({name: out[name] for name in (*PHYSICAL, *PATTERN) if name in out})


def to_groups(physical: pd.DataFrame) -> pd.DataFrame:
    """Nondimensional groups of designs given in SI units, as far as the columns reach.

    Raises :class:`InputError` if a column is unknown, not positive, or if no group follows.
    """
    import pandas as pd

    known = {**PHYSICAL, **PATTERN}
    unknown = [name for name in physical.columns if name not in known]
    if unknown:
        raise InputError(
            f"no physical quantity {', '.join(map(str, unknown))}; "
            f"there are {', '.join(f'{k} [{u}]' for k, u in known.items())}"
        )
    q = {name: _positive(name, physical[name], len(physical)) for name in physical.columns}
    groups = {
        group: q[quantity] / q[scale]
        for quantity, (group, scale) in RATIOS.items()
        if quantity in q and scale in q
    }
    if all(name in q for name in (*_SCALES, "h_s")):
        groups["stiffness_to_weight"] = (
            q["E_s"] * q["h_s"] ** 2 / (q["rho_s"] * q["g_earth"] * q["l_s"] ** 3)
        )
    if "contraction" in q:
        groups["contraction"] = q["contraction"]
    if all(name in q for name in ("b_i", *PATTERN)):
        pitch = q["w_i"] + q["s_i"]
        groups["strips"] = np.rint(q["b_i"] / pitch)
        groups["strip_share"] = q["w_i"] / pitch
        off = np.abs(q["b_i"] / pitch - groups["strips"]) > 1e-6 * groups["strips"]
        if off.any():
            row = int(np.argmax(off))
            raise InputError(
                f"b_i holds {(q['b_i'] / pitch)[row]:.6g} strips with their gaps in row {row}; "
                "expected b_i = n (w_i + s_i) with a whole n"
            )
    if not groups:
        raise InputError(
            f"no group follows from {', '.join(q) or 'an empty table'}; "
            "give both quantities of a ratio, such as E_i and E_s"
        )
    return pd.DataFrame({name: groups[name] for name in PATTERNED.names if name in groups})


def _positive(name: str, value, n: int) -> np.ndarray:
    try:
        array = np.broadcast_to(np.asarray(value, dtype=float), (n,))
    except (TypeError, ValueError):
        raise InputError(
            f"{name}: expected a number or {n} numbers, one per design; got {value!r}"
        ) from None
    if not (np.isfinite(array).all() and (array > 0).all()):
        bad = array[~(np.isfinite(array) & (array > 0))][0]
        raise InputError(f"{name} = {bad:g}; it must be a finite number above 0")
    return array


def groups_from_settings(settings: Mapping[str, float], space: DesignSpace) -> dict[str, float]:
    """Check ``name=value`` settings against a space: known names, values inside the bounds."""
    for name, value in settings.items():
        space._check(space[name], np.array([value], dtype=float), True)
    return dict(settings)
