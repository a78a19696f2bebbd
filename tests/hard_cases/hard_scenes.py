"""Scenes and measures that the hard cases share; lengths and stresses in units of their own."""

import numpy as np
from reference_scenes import AXES, held, modulus, near, strip

from foldlab.labels import foldability
from solver.cases.unit import mesh as unit_mesh
from solver.cases.unit.path import Ending, fold
from solver.cases.unit.unit import Unit
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box, graded, joined
from solver.paths.continuation import load, trace
from solver.paths.steppers import LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.ground import Ground
from solver.physics.growth import General, Orthotropic
from solver.physics.loads import Gravity
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed, Row, translation_row

# Problem P as a unit (physics.md §4), and meshes that are coarse but converge in their geometry.
P = Unit(
    E_ratio=0.1, rho_ratio=1.0, hinge_length=0.2, hinge_width=1.0, h_ratio=5.0,
    stiffness_to_weight=1.0, aspect=0.2, slenderness=4e-3, contraction=0.3,
)  # fmt: skip
COARSE = unit_mesh.Sizes(0.5, 3, 1.6, 0.0, 3.0, 1)


def lame(E, nu):
    """λ and μ, written once more so that references don't lean on the solver's."""
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


def section_curvature(g, *, m, n, nu=0.3, growth=(1, 0, 0), order=10):
    """Curvature × h_s of a long bilayer in plane strain, finite strains: exact pure bending.

    Sections stay plane: the stretch along the strip is a + k z of the current height z(Z), and
    energy per length is stationary in a, k and z. The passive layer has thickness 1, the active one
    m, n = E_i/E_s. ``growth``: shares of g along the strip, across it and through the thickness.
    z' is a polynomial in each layer; no finite elements.
    """
    s, w = np.polynomial.legendre.leggauss(2 * order)
    s, w = (s + 1) / 2, np.concatenate([w, m * w]) / 2
    active = np.arange(4 * order) >= 2 * order
    E = np.where(active, n, 1.0)
    lam, mu = lame(E, nu)
    powers = [np.polynomial.Legendre.basis(k, domain=[0, 1]) for k in range(order)]
    slopes = np.stack([f(s) for f in powers], axis=-1)
    heights = np.stack([f.integ()(s) - f.integ()(0.0) for f in powers], axis=-1)
    tops = np.array([f.integ()(1.0) - f.integ()(0.0) for f in powers])
    none = np.zeros_like(slopes)
    rate = np.block([[slopes, none], [none, slopes]])
    height = np.block([[heights, none], [np.tile(tops, (len(s), 1)), m * heights]])

    def gradient(p, g):
        Gy, Gx, Gz = (np.where(active, 1 + g * k, 1.0) for k in growth)
        z, thick = height @ p[2:], rate @ p[2:] / Gz
        a = (p[0] + p[1] * z) / Gy
        ln = np.log(a * thick / Gx)
        along = w * Gx * Gz * (mu * (a - 1 / a) + lam * ln / a)
        across = w * Gx * Gy * (mu * (thick - 1 / thick) + lam * ln / thick)
        return np.concatenate(
            [
                [along.sum(), along @ z],
                p[1] * height.T @ along + rate.T @ across,
            ]
        )

    flat = np.zeros(2 * order)
    flat[[0, order]] = 1.0
    found = np.concatenate([[1.0, 0.0], flat])
    for part in np.linspace(0, g, 13)[1:]:
        for _ in range(20):  # Newton's method with complex steps
            slope = [gradient(found + 1e-30j * d, part).imag / 1e-30 for d in np.eye(len(found))]
            step = np.linalg.solve(np.stack(slope, axis=-1), gradient(found, part))
            found = found - step
            if np.abs(step).max() < 1e-11:
                break
        else:
            raise ArithmeticError("the section found no rest")
    return abs(found[1])


def bilayer(g, *, m, n, nu=0.3, growth=(1, 0, 0), length=None, elements=8, element="hex27"):
    """Half of a long bilayer strip in plane strain (see :func:`section_curvature`), graded to its
    free end, and a function that measures curvature × h_s on its middle.

    ``length``: in thicknesses h_s + h_i; the layers share stress over about √n of them.
    """
    length = (1 + m) * (8 if length is None else length)
    z = joined(np.array([0, 0.5, 1]), 1 + m * np.array([0, 0.25, 1]))
    x = graded(0, length, elements, toward="b", ratio=4)
    bent = 0 if element == "hex27" else None
    body = Body.build(box(x, [0, 1.0], z), element, bent=bent)
    active = body.cells_where(lambda X: X[:, 2] > 1)
    strains = [lambda e, k=k: e * g * k for k in growth]
    material = NeoHookean(np.where(active, n, 1.0), nu)
    foot = body.nodes_where(lambda X: np.linalg.norm(X, axis=1) < 1e-9)
    fixed = [*held(body, 0, 0.0, 0), *held(body, 1, 0.0, 1), *held(body, 1, 1.0, 1)]
    fixed.append(Fixed(foot, AXES[2]))
    scene = Scene(body, [Elastic(body, material, Orthotropic(strains, cells=active))], fixed=fixed)

    def curvature(x_, e):
        X = body.nodes
        on = np.flatnonzero((np.abs(X[:, 1]) < 1e-9) & (np.abs(X[:, 0] - x[1]) < 1e-9))
        on = on[np.argsort(X[on, 2])]
        now = (X + scene.displacement(x_, e))[on]
        d = now[-1] - now[0]
        return np.arctan2(-d[0], d[2]) / x[1]

    return scene, curvature


def block(size, cells, *, tilt=0.0, lift=0.0, weight=1e-3, E=1.0, nu=0.3, base=None, spin=True):
    """A block on frictionless ground under its weight per volume ``weight``, all of its surface
    able to touch; and the displacement that tilts it about its lower edge along x and lifts it.

    Held are only its mean x and y displacement and its mean rotation about z. ``base``: mask of
    centres of the facets that may touch.
    """
    axes = [np.linspace(-s / 2, s / 2, k + 1) for s, k in zip(size[:2], cells[:2], strict=True)]
    body = Body.build(box(*axes, np.linspace(0, size[2], cells[2] + 1)), "hex27")
    u = tilted(body.nodes, tilt, size[1] / 2) - body.nodes + np.array([0, 0, lift])
    surface = body.surface(body.mesh.boundary_facets() if base is None else base)
    ground = Ground(body, surface, thickness=min(size), pressure=weight * size[2])
    terms = [Elastic(body, NeoHookean(E, nu)), Gravity(body, 1.0, weight), ground]
    shift = [
        Row(r.coefficients, value=float((r.coefficients * u).sum()))
        for r in (translation_row(body, 0), translation_row(body, 1))
    ]
    if spin:
        # On the lines x = 0 nothing moves along x: no turning about z, and none about y.
        on = body.nodes_where(near(0, 0.0))
        return Scene(body, terms, fixed=[Fixed(on, AXES[0])], rows=shift[1:]), ground, u
    return Scene(body, terms, rows=shift), ground, u


def tilted(X, angle, arm):
    """Positions turned by ``angle`` about the line y = arm, z = 0, so that the other side rises."""
    c, s = np.cos(angle), np.sin(angle)
    y, z = X[:, 1] - arm, X[:, 2]
    return np.stack([X[:, 0], arm + c * y + s * z, -s * y + c * z], axis=-1)


def lift(scene, ground, x, e):
    """Vertical force of the ground on the body."""
    return -ground.evaluate(scene.displacement(x, e), e, 1).force[:, 2].sum()


def weight_of(scene):
    """Total weight of a scene's body."""
    (gravity,) = [t for t in scene.terms if t.name == "gravity"]
    return -gravity.weights(0.0)[:, 2].sum()


def half_strip(h, n, kappa, *, length=0.5, nu=0.0):
    """Half of a strip in plane strain whose free curvature is ``kappa(e, x)``; and its supports."""
    body, fixed = strip(h, n, length=length)
    z = body.points()[..., 2]

    def tensor(e, X):
        Fg = np.broadcast_to(np.eye(3), (*z.shape, 3, 3)).copy()
        Fg[..., 0, 0] = 1 - kappa(e, X[..., 0]) * z
        return Fg

    term = Elastic(body, NeoHookean(modulus(h), nu), General(tensor))
    return body, term, [*fixed, *held(body, 0, 0.0, 0)]


# -- units ---------------------------------------------------------------------------------------


def fold_angle(folding):
    """m1 of a folding's last state, in rad."""
    return foldability.measure(folding.last.curves, folding.model.unit.hinge_length).m1


def reached(model, **options):
    """The folding of a model, which must reach its full contraction in a stable state."""
    found = fold(model, **options)
    assert found.ending is Ending.REACHED, found.detail
    assert found.last.unstable == 0
    return found


def envelope(model, steps=8):
    """Energy gained along the path of a weightless unit, and ∫ ∂E/∂e de at fixed displacement.

    At an equilibrium E changes with the load only: dE/de = ∂E/∂e. The integral is Gauss's over the
    loads, at each of which the path ends; the partial derivative is a central difference.
    """
    x, e, past = np.zeros(model.scene.size), 0.0, []
    places, weights = np.polynomial.legendre.leggauss(steps)
    loads = (1 + places) / 2
    for until in (*loads, 1.0):
        path = trace(
            model.scene, x, LoadSteps(rtol=1e-8, step=0.125), e=e, until=load(until), max_steps=50,
            events=False,
        )  # fmt: skip
        assert path.reached and path.last.unstable == 0
        x, e = path.last.x, path.last.e
        past.append(path.last)
    h = 1e-4
    rates = [
        (model.scene.energy(p.x, p.e + h) - model.scene.energy(p.x, p.e - h)) / (2 * h)
        for p in past[:-1]
    ]
    gained = past[-1].energy - model.scene.energy(np.zeros(model.scene.size), 0.0)
    return gained, float(weights @ rates / 2)
