"""Scenes of the verification cases, and what is measured on them; E is chosen so that B = 1.

Strips lie along x, y is their width (held, so plane strain; ν = 0 unless the case says otherwise),
z their thickness, z = 0 the mid-plane.
"""

import numpy as np

from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box, graded, joined, polar, spherical
from solver.paths.continuation import trace
from solver.paths.steppers import LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.growth import General, Orthotropic
from solver.physics.loads import Gravity, Traction
from solver.physics.materials import NeoHookean, SmallStrain
from solver.physics.pressure import Pressure
from solver.physics.supports import Fixed

AXES = np.eye(3)


STEPS = LoadSteps(rtol=1e-8, step=0.1)


def walked(scene, stepper=STEPS, **options):
    """The path from the unloaded state to e = 1, which must be reached."""
    options = {"max_steps": 400, "events": False} | options
    path = trace(scene, np.zeros(scene.size), stepper, **options)
    assert path.reached, path.outcome.value
    return path


def at_end(scene, stepper=STEPS, **options):
    point = walked(scene, stepper, **options).last
    return point.x, point.e


def near(axis, value):
    return lambda X: np.abs(X[:, axis] - value) < 1e-9


def held(body, axis, value, *directions):
    nodes = body.nodes_where(near(axis, value))
    return [Fixed(nodes, AXES[k]) for k in directions]


def modulus(h):
    """E of unit bending stiffness per width, B = E h³/12 = 1 (ν = 0)."""
    return 12 / h**3


def strip(h, n, *, element="hex27", bent=0, length=1.0, layers=1):
    """Strip of unit length, as wide as thick, and the supports that keep it plane."""
    z = np.linspace(-h / 2, h / 2, layers + 1)
    bent = bent if element == "hex27" else None
    body = Body.build(box(np.linspace(0, length, n + 1), [0, h], z), element, bent=bent)
    return body, [*held(body, 1, 0.0, 1), *held(body, 1, h, 1)]


class MidLine:
    """Deformed mid-line of a strip, and the tip's drop, shortening and turning."""

    def __init__(self, scene):
        X = scene.body.nodes
        edge = np.abs(X[:, 1] - X[:, 1].min()) < 1e-9
        on = np.flatnonzero(edge & (np.abs(X[:, 2]) < 1e-9))
        end = np.flatnonzero(edge & (np.abs(X[:, 0] - X[:, 0].max()) < 1e-9))
        self.scene, self.on = scene, on[np.argsort(X[on, 0])]
        self.end = end[np.argsort(X[end, 2])]

    def __call__(self, x, e):
        """Positions of the mid-line's nodes from x = 0 to the tip, (n, 3)."""
        return (self.scene.body.nodes + self.scene.displacement(x, e))[self.on]

    def tip(self, x, e):
        """Drop (along −z), shortening, and turning in rad (counted along the strip)."""
        p = self(x, e)
        chords = np.diff(p, axis=0)
        turned = np.unwrap(np.arctan2(chords[:, 2], chords[:, 0]))[-1]
        # The end face tells the angle, the chords how often it has gone round.
        face = (self.scene.body.nodes + self.scene.displacement(x, e))[self.end]
        d = face[-1] - face[0]
        angle = np.arctan2(-d[0], d[2])
        angle += 2 * np.pi * np.round((turned - angle) / (2 * np.pi))
        moved = p[-1] - self.scene.body.nodes[self.on[-1]]
        return -moved[2], -moved[0], angle


def cantilever(*, tip_load=0.0, weight=0.0, h=0.01, n=10, element="hex27", bent=0):
    """Clamped at x = 0; dead end load α downward, or own weight γ = wL³/B along −z, times e."""
    body, fixed = strip(h, n, element=element, bent=bent)
    terms = [Elastic(body, NeoHookean(modulus(h), 0.0))]
    if tip_load:
        end = body.surface(near(0, 1.0))
        terms.append(Traction(body, end, lambda e: np.array([0, 0, -e * tip_load / h])))
    if weight:
        terms.append(Gravity(body, 1.0, lambda e: e * weight / h))
    return Scene(body, terms, fixed=[*fixed, *held(body, 0, 0.0, 0, 1, 2)])


def ring(*, h=0.02, n=16, nu=0.3, element="hex27"):
    """§0: Fg = diag(1 − κ₀ζ, 1, 1) with κ₀L = 2π closes a circle free of stress."""
    body, fixed = strip(h, n, element=element)
    z = body.points()[..., 2]

    def tensor(e):
        Fg = np.broadcast_to(np.eye(3), (*z.shape, 3, 3)).copy()
        Fg[..., 0, 0] = 1 - e * 2 * np.pi * z
        return Fg

    terms = [Elastic(body, NeoHookean(1.0, nu), General(tensor))]
    return Scene(body, terms, fixed=[*fixed, *held(body, 0, 0.0, 0), *_point(body, [0, 0, 0], 2)])


def _point(body, at, *directions):
    nodes = body.nodes_where(lambda X: np.linalg.norm(X - at, axis=1) < 1e-9)
    return [Fixed(nodes, AXES[k]) for k in directions]


def bilayer(
    g, *, m=5.0, n=0.1, nu=0.3, plane="strain", growth="uniaxial", elements=20, layers=(2, 3)
):
    """A long bilayer (passive layer below, thickness 1) that bends alike all along; half of it.

    §3 measures pure bending: the turning per length far from the free end, over 50 h_s.
    """
    length = 8 * (1 + m)
    z = joined(np.linspace(0, 1, layers[0] + 1), np.linspace(1, 1 + m, layers[1] + 1))
    width = 1.0 if plane == "strain" else 0.25
    x = graded(0, length, elements, toward="b", ratio=4)
    body = Body.build(box(x, [0, width], z), "hex27", bent=0)
    active = body.cells_where(lambda X: X[:, 2] > 1)
    strains = {"uniaxial": (1, 0, 0), "in-plane": (1, 1, 0), "isotropic": (1, 1, 1)}[growth]
    Fg = Orthotropic([lambda e, k=k: e * g * k for k in strains], cells=active)
    term = Elastic(body, NeoHookean(np.where(active, n, 1.0), nu), Fg)
    fixed = [*held(body, 0, 0.0, 0), *held(body, 1, 0.0, 1), *_point(body, [0, 0, 0], 2)]
    if plane == "strain":
        fixed += held(body, 1, width, 1)
    return Scene(body, [term], fixed=fixed)


def bilayer_curvature(scene, x, e):
    """Turning per reference length near the middle of the strip."""
    X = scene.body.nodes
    column = np.flatnonzero(
        (np.abs(X[:, 1]) < 1e-9) & (np.abs(X[:, 0] - np.unique(X[:, 0].round(9))[8]) < 1e-6)
    )
    column = column[np.argsort(X[column, 2])]
    u = scene.displacement(x, e)[column]
    d = (X[column] + u)[-1] - (X[column] + u)[0]
    return np.arctan2(-d[0], d[2]) / X[column[0], 0]


def sphere(*, h=0.05, nu=0.3, n=3, layers=1, closed=True, e_to=0.03):
    """A 24th of a thick sphere of mid radius 1 under inner pressure e·e_to (E = 1)."""
    a = np.linspace(0, np.pi / 4, n + 1)
    r = np.linspace(1 - h / 2, 1 + h / 2, layers + 1)
    body = Body.build(box(r, a, a, shape=spherical), "hex27")
    X = body.nodes
    fixed = [
        Fixed(np.flatnonzero(np.abs(X @ normal) < 1e-9), normal)
        for normal in (AXES[1], AXES[2], np.array([1.0, -1, 0]), np.array([1.0, 0, -1]))
    ]
    inner = body.surface(lambda X: np.linalg.norm(X, axis=1) < 1)
    load = Pressure(
        body, inner, lambda e: e * e_to, potential="volume" if closed else None, fixed=fixed
    )
    return Scene(body, [Elastic(body, NeoHookean(1.0, nu)), load], fixed=fixed)


def cylinder(*, h=0.2, nu=0.3, n=4, layers=2, e_to=0.07):
    """A quarter of a thick cylinder of mid radius 1 in plane strain, inner pressure e·e_to."""
    r = np.linspace(1 - h / 2, 1 + h / 2, layers + 1)
    body = Body.build(box(r, np.linspace(0, np.pi / 2, n + 1), [0, 0.3], shape=polar), "hex27")
    fixed = [*held(body, 0, 0.0, 0), *held(body, 1, 0.0, 1)]
    fixed += [*held(body, 2, 0.0, 2), *held(body, 2, 0.3, 2)]
    inner = body.surface(
        lambda X: (
            (np.hypot(X[:, 0], X[:, 1]) < 1 - 0.4 * h) & (X[:, 2] > 1e-6) & (X[:, 2] < 0.3 - 1e-6)
        )
    )
    load = Pressure(body, inner, lambda e: e * e_to)
    return Scene(body, [Elastic(body, NeoHookean(1.0, nu)), load], fixed=fixed)


def inner_stretch(scene, x, e):
    """Mean radius of the inner surface over its reference radius (spheres and cylinders)."""
    X = scene.body.nodes
    flat = 2 if np.ptp(X[:, 2]) < 0.5 else 3
    R = np.linalg.norm(X[:, :flat], axis=1)
    inner = R.min() + 1e-6 > R
    now = np.linalg.norm((X + scene.displacement(x, e))[:, :flat], axis=1)
    return float((now[inner] / R[inner]).mean())


def cook(*, element="hex27", n=8, nu=1 / 3, E=1.0, load=1.0, material=SmallStrain, plane="stress",
         ratio=1.0):  # fmt: skip
    """Cook's membrane (48, 44, 16) under a shear load e·load on the right edge; thickness 1.

    ``ratio``: longest over shortest step; it is graded to the clamped corner that opens widest.
    """
    s, t = (graded(0, 1, n, toward=end, ratio=ratio) for end in "ab")

    def shape(X):
        x, t = 48 * X[:, 0], X[:, 1]
        low, high = 44 * X[:, 0], 44 + 16 * X[:, 0]
        return np.stack([x, low + t * (high - low), X[:, 2]], axis=-1)

    thick = 1.0 if plane == "strain" else 0.02
    mesh = box(s, t, [0, thick], shape=shape, quadratic=False, tets=element.startswith("tet"))
    body = Body.build(mesh, element)
    fixed = [*held(body, 0, 0.0, 0, 1), *held(body, 2, 0.0, 2)]
    if plane == "strain":
        fixed += held(body, 2, thick, 2)
    right = body.surface(near(0, 48.0))
    shear = Traction(body, right, lambda e: np.array([0, e * load / 16, 0]))
    return Scene(body, [Elastic(body, material(E, nu)), shear], fixed=fixed), right
