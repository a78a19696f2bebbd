"""Units whose files are made and read back: a plain one, a narrow hinge, narrow strips."""

import numpy as np

from foldlab.making.geometry import Geometry

UNITS = {
    "plain": Geometry(40.0, 10.0, 0.1, 10.0, 10.0, 0.2),
    "narrow": Geometry(61.37, 17.9, 0.37, 7.43, 6.01, 0.119),
    "strips": Geometry(100.0, 25.0, 1.0, 20.0, 15.0, 1.0, strips=7, strip_share=0.6),
}


def bent(unit: Geometry, angle: float) -> np.ndarray:
    """Mid-line (1000, 3) of a sheet whose hinge is an arc and whose panels are straight, mm."""
    s = np.linspace(-unit.length / 2, unit.length / 2, 1000)
    half = unit.hinge_length / 2
    inside, radius = np.clip(s, -half, half), unit.hinge_length / angle
    turn, rest = inside / radius, s - inside
    x = radius * np.sin(turn) + rest * np.cos(turn)
    z = radius * (1 - np.cos(turn)) + rest * np.sin(turn)
    return np.column_stack([x, 0 * x, z])
