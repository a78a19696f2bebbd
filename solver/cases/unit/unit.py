"""The folding unit as a design: nondimensional groups, effects and growths that it may have."""

from __future__ import annotations

from dataclasses import dataclass, fields

EFFECTS = ("gravity", "ground")  # by default; panels touch only where it is asked for


KNOWN = (*EFFECTS, "contact")


GROWTHS = {
    # fractions of the contraction along x, y, z as functions of e
    "uniaxial": (0.0, lambda e: e, 0.0),
    "isotropic": (lambda e: e, lambda e: e, lambda e: e),
    "release": (lambda e: e, 1.0, lambda e: e),  # from uniaxial to isotropic
}


@dataclass(frozen=True)
class Unit:
    """One design; lengths in l_s, stresses in E_s, see the module.

    ``strips``: number of active strips side by side along the hinge, each along y, 0 for a solid
    layer; ``strip_share``: what part of the width they cover. Raises ValueError for values that are
    no unit.
    """

    E_ratio: float
    rho_ratio: float
    hinge_length: float
    hinge_width: float
    h_ratio: float
    stiffness_to_weight: float
    aspect: float
    slenderness: float
    contraction: float
    nu: float = 0.3
    strips: int = 0
    strip_share: float = 0.5

    def __post_init__(self):
        for f in fields(self):
            value = getattr(self, f.name)
            low = 0.0 if f.name in ("contraction", "nu", "strips") else 1e-300
            if not low <= value <= 1e30:
                raise ValueError(f"{f.name} = {value:g}; expected a number above 0, at most 1e30")
        if not float(self.strips).is_integer():
            raise ValueError(f"strips = {self.strips:g}; expected a whole number")
        most = {"hinge_length": 0.95, "hinge_width": 1.0, "contraction": 0.95, "strip_share": 1.0}
        for name, limit in most.items():
            if getattr(self, name) > limit:
                raise ValueError(f"{name} = {getattr(self, name):g}; expected at most {limit:g}")

    @property
    def active(self) -> float:
        """h_i, in l_s."""
        return self.h_ratio * self.slenderness

    @property
    def width(self) -> float:
        """b_i, in l_s."""
        return self.hinge_width * self.aspect

    @property
    def weight(self) -> float:
        """ρ_s g in E_s / l_s."""
        return self.slenderness**2 / self.stiffness_to_weight

    @property
    def curvature(self) -> float:
        """Timoshenko's κ l_s at the full contraction (Eq. 4.14)."""
        m, n = self.h_ratio, self.E_ratio
        factor = 6 * (1 + m) / (3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n)))
        return factor * self.contraction / self.slenderness

    @property
    def fold_angle(self) -> float:
        """Timoshenko's κ l_i (Eq. 4.15) in rad."""
        return self.curvature * self.hinge_length
