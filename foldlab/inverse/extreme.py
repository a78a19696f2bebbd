"""The least of something among designs that do as wished by the rod, near a draft.

Sequential linear programming with an exact penalty and a trust region (Fletcher, *Practical Methods
of Optimization*, ch. 12 and 14) in the logarithms that a region leaves free: its limits are linear
there, what the rod says is made so by finite differences. What comes back is a local least: a
better one may lie elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.optimize import linprog

from foldlab.errors import InputError
from foldlab.inverse.draft import Draft, driven
from foldlab.inverse.points import groups_of
from foldlab.inverse.region import Region
from foldlab.inverse.rungs import LOST, Rungs
from foldlab.inverse.wish import MASS_NEEDS, Angle, Wish, masses_of, quantities_of
from foldlab.materials import read_materials

STEP = 1e-3  # decades: of differences, far above what the rod's own tolerance leaves
TRUST, FINEST = 0.1, 2e-3  # decades that a step may take at first, and at least
STEPS = 60
# A search that stalls on the bent edge of what the rod may do goes on when it starts afresh: at
# most so often, as long as that brings so many decades.
ROUNDS, WORTH = 4, 2e-3
# Most rad per decade of Γ by which an angle may hang on the weight, 0.07 rad per per cent of it;
# and decades of that difference. Where weight is about to win, the angle hangs on it without
# bounds, and nobody can make that unit.
STEEP, WEIGHED = 16.0, 2e-3
EDGE = 1e-6  # decades from a limit that count as on it
RESTORING = 4  # secants that lead a step back to what the rod must do
PENALTY = 1.0  # decades of cost that a rad too little or too much counts for
BACK = np.linspace(0, 1, 21)  # of the way back to the draft
# Of the way back to where a design started: designs that the source may confirm where it says of
# the least one that it does not do as wished.
RETURNS = (0.0, 0.1, 0.25, 0.5, 1.0)
ALIKE = 1e-3  # relative difference of two values that count as one design


def least(
    draft: Draft,
    rungs: Rungs,
    cost: Callable[[np.ndarray], np.ndarray],
    holds: Callable[[Draft], bool] = lambda draft: True,
    room: float = 0.0,
) -> Draft:
    """The draft with less ``cost``, decades, of its log10 variables (n, names) → (n,); itself where
    there is none.

    A label keeps ``room`` rad to spare by the rod, an angle is kept. ``holds``: what else must be
    true; of the way back to the draft the first point is taken where it is.
    """
    value = float(cost(draft.x[None])[0])
    for _ in range(ROUNDS):
        there = _lesser(draft, rungs, cost, holds, room)
        before, value = value, float(cost(there.x[None])[0])
        draft = there
        if before - value < WORTH:
            break
    return draft


def _lesser(draft: Draft, rungs: Rungs, cost, holds, room: float) -> Draft:
    """The end of one search of :func:`least`."""
    region, x0 = draft.region, draft.x
    basis, (A, b) = region.free
    angle = isinstance(rungs.wish.want, Angle)

    def spare(x):
        """rad to spare (n,), of an angle its deviation."""
        groups = groups_of(region, x)
        if not angle:
            return np.maximum(rungs.rooms(groups), LOST) - room
        off = rungs.rod(groups)["angle"].to_numpy() - rungs.wish.want.value
        return np.where(np.isfinite(off), off, LOST)

    def over(x):
        out = np.maximum(region.excess(x), -1.0)
        return np.maximum(out, _steep(groups_of(region, x), rungs)) if angle else out

    def missed(off, over):
        return (abs(off) if angle else max(-off, 0.0)) + max(over, 0.0)

    x = _climbed(x0, basis, A, b, cost, spare, over, missed, angle)
    before = float(cost(x0[None])[0])
    for back in BACK[:-1]:
        there: Draft | None = replace(draft, x=x + back * (x0 - x))
        if angle:
            there = driven(there, rungs)
        elif float(spare(there.x[None])[0]) < -1e-6:
            there = None
        if there is None or region.excess(there.x[None])[0] > 1e-9:
            continue
        if float(cost(there.x[None])[0]) < before and holds(there):
            return there
    return draft


def _steep(groups, rungs: Rungs) -> np.ndarray:
    """Decades by which the angle hangs more on the weight than :data:`STEEP` allows, (n,)."""
    sides = [groups.assign(stiffness_to_weight=groups["stiffness_to_weight"] * 10.0**d)
             for d in (-WEIGHED, WEIGHED)]  # fmt: skip
    low, high = (rungs.rod(side)["angle"].to_numpy() for side in sides)
    slope = np.abs(high - low) / (2 * WEIGHED)
    return np.where(np.isfinite(slope), np.log10(np.maximum(slope, 1e-6) / STEEP), 1.0)


def _climbed(x, basis, A, b, cost, spare, over, missed, angle) -> np.ndarray:
    """The end of the steps from x; outside of what the rod may do by little."""
    k = basis.shape[1]
    trust, here = TRUST, None
    for _ in range(STEPS):
        if trust < FINEST or k == 0:
            break
        if here is None:
            rows = np.vstack([x, x + STEP * basis.T])
            values = np.column_stack([cost(rows), spare(rows), over(rows)])
            here = values[0]
            rates = (values[1:] - here) / STEP
        step = _step(rates, here, basis, A, b - A @ x, trust, angle)
        if step is None:
            trust /= 2
            continue
        there = _restored(x + basis @ step, basis, A, b, rates[:, 1], spare, angle)
        after = cost(there[None])[0], spare(there[None])[0], over(there[None])[0]
        gain = here[0] - after[0] + PENALTY * (missed(*here[1:]) - missed(*after[1:]))
        if gain > 1e-5:
            x, here, trust = there, None, min(1.5 * trust, 2 * TRUST)
        else:
            trust /= 2
    return x


def _restored(x, basis, A, b, fold, spare, angle: bool) -> np.ndarray:
    """x moved within its limits, along what changes the rod the most, until it does as it must, by
    secants."""
    slack = b - A @ x
    edges = A[slack < EDGE] @ basis
    along = fold if not len(edges) else fold - np.linalg.pinv(edges) @ (edges @ fold)
    if not along @ fold > 0:
        return x
    direction = basis @ along / (along @ fold)
    rate = A[slack >= EDGE] @ direction
    reach = slack[slack >= EDGE]
    high = np.min(reach[rate > 0] / rate[rate > 0], initial=np.inf)
    low = -np.min(reach[rate < 0] / -rate[rate < 0], initial=np.inf)
    t, f, slope = [0.0], [float(spare(x[None])[0])], 1.0
    for _ in range(RESTORING):
        if abs(f[-1]) < 1e-4 or (f[-1] > 0 and not angle) or f[-1] <= LOST:
            break
        t.append(float(np.clip(t[-1] - f[-1] / slope, low, high)))
        f.append(float(spare((x + t[-1] * direction)[None])[0]))
        slope = (f[-1] - f[-2]) / (t[-1] - t[-2]) if t[-1] != t[-2] else 0.0
        if not slope > 0.1:
            break
    k = int(np.argmin(np.abs(f) if angle else np.abs(np.minimum(f, 0))))
    return x + t[k] * direction


def _step(rates, here, basis, A, slack, trust: float, angle: bool):
    """(k,): with the least cost and penalty, all made linear; None where no step is allowed."""
    k = len(rates)
    fold, over = rates[:, 1], rates[:, 2]
    rows = [np.hstack([A @ basis, np.zeros((len(A), 2))])]
    limits = [np.maximum(slack, 0)]
    # The penalties t of the rod and s of mass and thickness.
    rows.append(np.r_[-fold, -1.0, 0.0][None])
    limits.append([here[1]])
    if angle:
        rows.append(np.r_[fold, -1.0, 0.0][None])
        limits.append([-here[1]])
    rows.append(np.r_[over, 0.0, -1.0][None])
    limits.append([-here[2]])
    result = linprog(
        np.r_[rates[:, 0], PENALTY, PENALTY],
        A_ub=np.vstack(rows), b_ub=np.concatenate(limits),
        bounds=[(-trust, trust)] * k + [(0, None)] * 2, method="highs",
    )  # fmt: skip
    return result.x[:k] if result.status == 0 else None


@dataclass(frozen=True)
class Price:
    """What a design costs: its ``wish.least``, in kg, in the currency of the prices, or in m.

    Raises :class:`InputError` where the wish leaves open what the value depends on, or where a
    material of the pair has no price.
    """

    wish: Wish
    pair: tuple[str | None, str | None]
    region: Region

    def __post_init__(self):
        needs = ("l_s",) if self.wish.least == "size" else MASS_NEEDS
        absent = [name for name in needs if name not in self.region.names]
        if absent:
            raise InputError(
                f"the least {self.wish.least} also depends on {', '.join(absent)}: give materials "
                "and sizes, or leave --least out"
            )
        if self.wish.least == "cost":
            object.__setattr__(self, "prices", self._prices())

    def _prices(self) -> dict[str, float]:
        """Price per kg of each layer: the middle of its range."""
        table, out = read_materials(self.wish.materials), {}
        for layer, name in zip(("passive", "active"), self.pair, strict=True):
            ends = [np.nan] if name is None else table.loc[name, ["price_low", "price_high"]]
            out[layer] = float(np.mean(np.asarray(ends, float)))
            if not np.isfinite(out[layer]):
                raise InputError(
                    f"the {layer} material ({name or 'none is named'}) has no price; give "
                    "price_low and price_high per kg in --materials, or ask for --least mass"
                )
        return out

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The value of log10 variables (n, names), shape (n,)."""
        if self.wish.least == "size":
            return 10.0 ** x[:, self.region.names.index("l_s")]
        masses = masses_of(quantities_of(x, self.region.names))
        if self.wish.least == "mass":
            return sum(masses.values())
        return sum(self.prices[layer] * mass for layer, mass in masses.items())


def frugal(drafts: list[Draft], wish: Wish, worst: Callable[[Draft, Rungs], float]) -> list[Draft]:
    """The drafts, each with as little of ``wish.least`` as the rod allows near it, the least first.

    Local optima (:func:`least`), each followed by designs on the way back
    to where it started. ``worst``: room in the box of the wished margin, rad, which is kept ≥ 0.
    Raises :class:`InputError` as :class:`Price` does.
    """
    meet = any(Rungs(wish).second(_row(draft)).max() < 0 for draft in drafts)
    rungs = Rungs(wish, meet=meet, rocking=True)
    out: list[tuple[float, Draft]] = []
    for draft in drafts:
        price = Price(wish, draft.pair, draft.region)
        room = 0.0
        if wish.margin > 0:
            room = max(float(rungs.rooms(_row(draft))[0]) - worst(draft, rungs), 0.0)
        there = least(
            draft, rungs, lambda x, price=price: np.log10(price(x)),
            lambda d: wish.margin == 0 or worst(d, rungs) >= 0, room,
        )  # fmt: skip
        for back in RETURNS:
            here: Draft | None = replace(there, x=there.x + back * (draft.x - there.x))
            if back and isinstance(wish.want, Angle):
                here = driven(here, rungs)
            if here is not None:
                out.append((float(price(here.x[None])[0]), here))
    chosen: list[tuple[float, Draft]] = []
    for value, draft in sorted(out, key=lambda entry: entry[0]):
        if not any(abs(value - other) <= ALIKE * other and draft.pair == one.pair
                   for other, one in chosen):  # fmt: skip
            chosen.append((value, draft))
    return [draft for _, draft in chosen]


def _row(draft: Draft) -> pd.DataFrame:
    return pd.DataFrame([draft.groups])
