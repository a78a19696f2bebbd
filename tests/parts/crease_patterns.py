"""Crease patterns that people know."""

import numpy as np

from solver.cases.structure.hinges import Law, Layer
from solver.cases.structure.model import EFFECTS, build
from solver.cases.structure.parts import Structure
from solver.cases.structure.path import fold
from solver.cases.structure.pattern import Crease, Pattern

THICKNESS, MODULUS = 4e-3, 1e6


def squares(cells, length=0.1, fold=lambda cell, way: 1, **times) -> Pattern:
    """Unit squares with their lower left corners at ``cells``; ``fold(cell, way)``: the sign of the
    crease on the far side of a cell, ``way`` (1, 0) or (0, 1)."""
    number: dict = {}
    faces, creases = [], []

    def vertex(*at):
        return number.setdefault(at, len(number))

    for i, j in cells:
        faces.append([vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)])
    for i, j in cells:
        for way, ends in (
            ((1, 0), ((i + 1, j), (i + 1, j + 1))),
            ((0, 1), ((i, j + 1), (i + 1, j + 1))),
        ):
            if (i + way[0], j + way[1]) in cells:
                pair = tuple(vertex(*end) for end in ends)
                creases.append(Crease(pair, fold((i, j), way), length, **times))
    return Pattern(np.array(list(number), float), faces, creases)


def two_panels(length=0.2, half=0.5, width=0.2, **crease) -> Pattern:
    """A folding unit: the fold along y at x = 0."""
    x, y = half, width / 2
    vertices = [[-x, -y], [0, -y], [x, -y], [x, y], [0, y], [-x, y]]
    crease = Crease((1, 4), 1, length) if not crease else Crease((1, 4), length=length, **crease)
    return Pattern(vertices, [[0, 1, 4, 5], [1, 2, 3, 4]], [crease])


def miura_vertex(alpha: float, length: float) -> Pattern:
    """Four creases from the middle of a square of 2 × 2: along x and at ±alpha (45 to 90 degrees)
    from it; the acute sectors lie beside +x, whose crease is the odd one."""
    t = 1 / np.tan(alpha)
    vertices = [[0, 0], [1, 0], [t, 1], [-1, 0], [t, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]]
    faces = [[0, 1, 5, 2], [0, 2, 6, 3], [0, 3, 7, 4], [0, 4, 8, 1]]
    signs = (-1, 1, 1, 1)
    creases = [Crease((0, k + 1), sign, length) for k, sign in enumerate(signs)]
    return Pattern(vertices, faces, creases)


def structure(pattern, *, contraction=0.05, gamma=10.0, h=THICKNESS, **layer) -> Structure:
    """With Γ = E h² / (ρ g l³) of a length l = 1."""
    E = MODULUS
    own = Layer(**({"E": E, "rho": 1.0, "h": h, "contraction": contraction} | layer))
    return Structure.of(pattern, Layer(E, 1.0, h), own, g=E * h**2 / gamma)


def for_angle(angle: float, length: float, h=THICKNESS) -> float:
    """The contraction at which a hinge of equal layers folds by an angle (rad), by its section."""
    from scipy.optimize import brentq

    def off(c):
        law = Law.of_section(Layer(1, 1, h), Layer(1, 1, h, c), length, 1.0)
        return law.angle[-1] - angle

    return brentq(off, 1e-6, 0.4)


def folded(pattern, angle, *, length=0.1, effects=EFFECTS, gamma=10.0, upright=False, **options):
    """Followed with layers that would fold each hinge by ``angle`` (rad)."""
    made = structure(pattern, contraction=for_angle(angle, length), gamma=gamma)
    return fold(build(made, effects, upright=upright), **options)
