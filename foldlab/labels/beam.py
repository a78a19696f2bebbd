"""Beam formulas: what the groups of a design mean for its fold, in closed form and microseconds.

Small angles, plane sections, level panels, the hinge resting on the ground at its middle. Every
turning is of the whole sheet, in rad, over π|g|, which is what "folds" asks for (F1, Eq. 4.21), so
that 1 is the threshold; lengths are over l_s. A unit folds where

    T + E − W − S > 1,

turning of the free hinge, of the ends of its active layer, what weight takes from the hinge and
what it takes from the panels. Nothing in it is fitted to labels. ``design`` is a table of the full
or the patterned space's groups everywhere (strips count as a softer solid layer); what comes back
has shape (n,).
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from foldlab.design import PATTERNED
from foldlab.labels.foldability import Thresholds
from foldlab.labels.timoshenko import bilayer_stiffness, fold_angle, hinge_turning, smeared

NU = 0.3


def turning(design) -> np.ndarray:
    """T: Timoshenko's angle κ l_i of the free hinge (Eq. 4.15), over π|g|."""
    groups = ("h_ratio", "slenderness", "hinge_length", "contraction")
    return fold_angle(smeared(design), *(design[name] for name in groups)) / _need(design)


def weight(design) -> np.ndarray:
    """W: by what the weight of level panels and of the hinge itself bends the hinge, over π|g|.

    Each half of the hinge is a cantilever of length a = l_i/2 that carries a panel of length L and
    weight w = h_s³/Γ per length and width: ∫ M ds/B = (w L²/2 a + w L a²/2 + w_i a³/6)/B, with B
    of the bilayer about its neutral axis (transformed section; Gere and Goodno, *Mechanics of
    Materials*, composite beams) and w_i = w b_i/b_s (1 + ρ_i h_i/(ρ_s h_s)).
    """
    a, length = design["hinge_length"] / 2, panel_length(design)
    own = design["hinge_width"] * (1 + design["rho_ratio"] * design["h_ratio"])
    bent = length**2 * a / 2 + length * a**2 / 2 + own * a**3 / 6
    bent /= bilayer_stiffness(design["h_ratio"], smeared(design)) * design["hinge_width"]
    return 2 * bent / design["stiffness_to_weight"] / _need(design)


def sag(design) -> np.ndarray:
    """S: by what both panels sag as cantilevers under their own weight, over π|g|.

    The end of a cantilever of stiffness B = E_s h_s³/12 turns by w L³/(6 B) (Gere and Goodno,
    table of deflections and slopes), which is 2 L³/Γ.
    """
    return 4 * panel_length(design) ** 3 / design["stiffness_to_weight"] / _need(design)


def lift_off(design) -> np.ndarray:
    """Γ over the Γ at which rigid panels on a short hinge would leave the ground.

    T over W of a short hinge without weight of its own, as
    :func:`foldlab.labels.timoshenko.lift_off_stiffness` has it.
    """
    taken = 2 * hinge_turning(design) / design["stiffness_to_weight"] / _need(design)
    return turning(design) / taken


def edge(design) -> np.ndarray:
    """E: what the two ends of the active layer add to T (or take), over π|g|; signed.

    Suhir's bimetal (*J. Appl. Mech.* 53, 1986, 657): the force N between the layers grows from an
    end as 1 − exp(−λ y), λ² = K [1/(E_s h_s) + 1/(E_i h_i) + (h_s + h_i)²/(4 (B_s + B_i))] with
    the shear compliance 1/K = h_s/(3 G_s) + h_i/(3 G_i). Two things follow.

    The hinge loses of its curvature κ what is not yet carried there, tanh(λ l_i/2)/λ at each end.

    The interface also carries a couple P = N h_s/2 − κ B_s = κ B_i − N h_i/2: a stiff layer stays
    straight, yet its shear pulls at the sheet's face and not at its middle. Taken by peel, as by a
    Winkler foundation 1/k = h_s/E_s + h_i/E_i, the couple turns the sheet's free end by
    θ = P/(B_s β), β⁴ = k (1/B_s + 1/B_i)/4 (Hetényi, *Beams on Elastic Foundation*: a
    semi-infinite beam with a couple at its end); spread over the length 1/λ by the reciprocal
    e^{−βa} cos βa, it is λ (λ + β)/((λ + β)² + β²) of that.

    With the whole thicknesses in 1/k a rigid layer turns by 3.16 |g| at both ends together;
    the solid has 3.11.
    """
    # In units of h_s and E_s.
    m, n = np.asarray(design["h_ratio"], float), np.asarray(smeared(design), float)
    active, length = n * m**3 / 12, design["hinge_length"] / design["slenderness"]
    passive, arm = 1 / 12, (1 + m) / 2
    kappa = np.asarray(fold_angle(n, m, 1.0, 1.0, 1.0))
    force = kappa * (passive + active) / arm
    couple = kappa * active - force * m / 2
    shear = 3 / (2 * (1 + NU)) / (1 + m / n)
    lag = np.sqrt(shear * (1 + 1 / (n * m) + arm**2 / (passive + active)))
    beta = (1 / (1 + m / n) * (1 / passive + 1 / active) / 4) ** 0.25
    spread = lag * (lag + beta) / ((lag + beta) ** 2 + beta**2)
    turns = 2 * (couple / (passive * beta) * spread - kappa * np.tanh(lag * length / 2) / lag)
    return np.asarray(turns / np.pi)


def panel_length(design):
    """L: length of one panel over l_s."""
    return (1 - design["hinge_length"]) / 2


def _need(design):
    return Thresholds().angle(design["contraction"])


def formulas(designs: pd.DataFrame) -> pd.DataFrame:
    """The formulas of this module for a table of designs, one column each, and two sums of them.

    ``net``: T + E − W − S, the turning with level panels; 1 folds. ``ratio``: (T + E)/(1 + W + S),
    what turns over what must be turned; 1 folds too, and far from there it stays of order 1.
    """
    # Arrays: for one design pandas' own arithmetic takes ten times as long.
    columns = {n: designs[n].to_numpy(float) for n in PATTERNED.names if n in designs}
    # A hinge of the whole sheet has no panels to lift, and infinity says so.
    with np.errstate(all="ignore"):
        parts = {f.__name__: np.asarray(f(columns)) for f in (turning, weight, sag, lift_off, edge)}
    parts["net"] = parts["turning"] + parts["edge"] - parts["weight"] - parts["sag"]
    parts["ratio"] = (parts["turning"] + parts["edge"]) / (1 + parts["weight"] + parts["sag"])
    return pd.DataFrame(parts)
