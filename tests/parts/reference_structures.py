"""Scenes of the cases that snap, buckle and branch: arches, roofs, frames, columns, domes."""

import numpy as np
from reference_scenes import AXES, held, modulus, near, strip

from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.lines import Line
from solver.mesh.structured import box, graded, polar
from solver.physics.elastic import Elastic
from solver.physics.ground import Ground
from solver.physics.growth import General
from solver.physics.loads import Gravity, LineLoad, PointLoad, Traction
from solver.physics.materials import NeoHookean, SmallStrain
from solver.physics.rows import mean_displacement_row
from solver.physics.supports import Fixed, Row, rotation_row


def hinge(body, face, components):
    """Rows that keep the mean of u over the thickness at 0 along an end face; ``face``: nodes.

    A hinge on one line of a solid lets that line sink into it, which a shell's hinge does not.
    """
    rows = []
    for z in np.unique(body.nodes[face, 2].round(9)):
        line = Line.of(body, face[np.abs(body.nodes[face, 2] - z) < 1e-6])
        # On the mirror plane z = 0 the component along z is held already.
        along = [k for k in components if k != 2 or abs(z) > 1e-9]
        rows += [mean_displacement_row(body, line, AXES[k]) for k in along]
    return rows


def arch(*, hinged, n=16, e_to=1.0, whole=False, h=0.1875):
    """Shallow circular arch, R = 133.114, half angle 7.3397°, crown load e·e_to (unit width).

    Half of it by symmetry, or the whole with antisymmetric freedom. ν = 0; ends clamped or hinged.
    """
    R, half = 133.114, np.radians(7.3397)
    low = np.pi / 2 - half
    high = np.pi / 2 + half if whole else np.pi / 2
    angles = np.linspace(low, high, (2 if whole else 1) * n + 1)
    mesh = box(np.linspace(R - h / 2, R + h / 2, 3), angles, [0, 1.0], shape=polar)
    body = Body.build(mesh, "hex27", bent=1)
    X = body.nodes
    angle = np.arctan2(X[:, 1], X[:, 0])
    radius = np.hypot(X[:, 0], X[:, 1])
    fixed = [*held(body, 2, 0.0, 2), *held(body, 2, 1.0, 2)]
    rows = []
    for end in (low, high) if whole else (low,):
        face = np.flatnonzero(np.abs(angle - end) < 1e-9)
        if hinged:
            rows += hinge(body, face, (0, 1))
        else:
            fixed += [Fixed(face, AXES[0]), Fixed(face, AXES[1])]
    if not whole:
        fixed += [Fixed(np.flatnonzero(np.abs(X[:, 0]) < 1e-9), AXES[0])]
    crown = np.flatnonzero((np.abs(X[:, 0]) < 1e-9) & (np.abs(radius - R) < 1e-6))
    share = 1.0 if whole else 0.5
    load = LineLoad(body, Line.of(body, crown), lambda e: (0, -e * e_to * share, 0))
    return Scene(body, [Elastic(body, NeoHookean(1e7, 0.0)), load], fixed=fixed, rows=rows), crown


def toggle(*, n=6, e_to=50.0):
    """Half of Williams' toggle (1964), lb and in: clamped legs of length 12.943 that rise by 0.386,
    sections 0.753 wide and 0.243 deep, E = 1.03e7; crown load e·e_to. And the crown's nodes."""
    length, rise, wide, deep = 12.943, 0.386, 0.753, 0.243
    half = np.sqrt(length**2 - rise**2)

    def shape(X):
        s, t, z = X.T
        return np.stack([s, rise * s / half + t, z], -1)

    mesh = box(np.linspace(0, half, n + 1), [-deep / 2, deep / 2], [0, wide], shape=shape)
    body = Body.build(mesh, "hex27", bent=0)
    fixed = [*held(body, 2, 0.0, 2), *held(body, 0, 0.0, 0, 1), *held(body, 0, half, 0)]
    at = (half, rise)
    crown = body.nodes_where(lambda X: np.abs(X[:, :2] - at).max(axis=1) < 1e-9)
    load = LineLoad(body, Line.of(body, crown), lambda e: (0, -e * e_to / 2 / wide, 0))
    return Scene(body, [Elastic(body, NeoHookean(1.03e7, 0.0)), load], fixed=fixed), crown


def deep_arch(*, n=16, e_to=1000.0):
    """DaDeppo and Schmidt's (1975) arch of 215°, R = 100, EI = 1e6, EA = 1e8 (unit width, ν = 0),
    one end clamped, the other hinged; crown load e·e_to, which is greatest near 897. And the crown.
    """
    R, h = 100.0, np.sqrt(12 * 1e6 / 1e8)
    low, high = np.radians([90 - 107.5, 90 + 107.5])
    mesh = box([R - h / 2, R + h / 2], np.linspace(low, high, n + 1), [0, 1.0], shape=polar)
    body = Body.build(mesh, "hex27", bent=1)
    x, y = body.nodes[:, :2].T
    angle = (np.arctan2(y, x) - low + 1e-9) % (2 * np.pi) + low - 1e-9
    clamped = np.flatnonzero(np.abs(angle - high) < 1e-8)
    fixed = [*held(body, 2, 0.0, 2), *held(body, 2, 1.0, 2)]
    fixed += [Fixed(clamped, AXES[0]), Fixed(clamped, AXES[1])]
    rows = hinge(body, np.flatnonzero(np.abs(angle - low) < 1e-8), (0, 1))
    crown = np.flatnonzero((np.abs(x) < 1e-6) & (np.abs(np.hypot(x, y) - R) < 1e-6))
    load = LineLoad(body, Line.of(body, crown), lambda e: (0, -e * e_to, 0))
    term = Elastic(body, NeoHookean(1e8 / h, 0.0))
    return Scene(body, [term, load], fixed=fixed, rows=rows), crown


def roof(*, h=12.7, n=6, e_to=3.0):
    """A quarter of the hinged cylindrical roof of Sze, Liu and Lo (2004), crown load 1000 e·e_to.

    Arc in the x–y plane, axis along z; its straight edges are hinged. A shell does not dent: the
    load is spread through the thickness, and ``crown`` is the line whose mean sink tells W.
    """
    R, half, angle = 2540.0, 254.0, 0.1
    angles = graded(np.pi / 2 - angle, np.pi / 2, n, toward="b", ratio=2)
    r = np.linspace(R - h / 2, R + h / 2, 3)
    z = graded(0, half, n, toward="a", ratio=2)
    body = Body.build(box(r, angles, z, shape=polar), "hex27")
    X = body.nodes
    at = np.arctan2(X[:, 1], X[:, 0])
    rows = hinge(body, np.flatnonzero(np.abs(at - angles[0]) < 1e-9), (0, 1, 2))
    fixed = [*held(body, 0, 0.0, 0), *held(body, 2, 0.0, 2)]
    crown = np.flatnonzero((np.abs(X[:, 0]) < 1e-6) & (np.abs(X[:, 2]) < 1e-6))
    load = LineLoad(body, Line.of(body, crown), lambda e: (0, -e * e_to * 1000 / 4 / h, 0))
    term = Elastic(body, NeoHookean(3102.75, 0.3))
    return Scene(body, [term, load], fixed=fixed, rows=rows), crown


def hemisphere(body):
    """A quarter of MacNeal and Harder's (1985) pinched hemisphere with a hole of 18°, R = 10,
    thickness 0.04, E = 6.825e7, ν = 0.3; forces 2 e outwards along x, inwards along y.

    ``body``: of :func:`hemisphere_mesh`. And the nodes at the force along x: they move by 0.0940
    in linear theory.
    """
    fixed = [*held(body, 0, 0.0, 0), *held(body, 1, 0.0, 1)]
    equator = np.abs(body.nodes[:, 2]) < 1e-9
    lines = [np.flatnonzero(equator & (np.abs(body.nodes[:, k]) < 1e-9)) for k in (1, 0)]
    fixed.append(Fixed(lines[0][:1], AXES[2]))
    loads = [
        PointLoad(body, line, lambda e, f=force / line.size: e * f)
        for line, force in zip(lines, (AXES[0], -AXES[1]), strict=True)
    ]
    return Scene(body, [Elastic(body, SmallStrain(6.825e7, 0.3)), *loads], fixed=fixed), lines[0]


def hemisphere_mesh(n, *, layers=1, tets=False, thickness=0.04):
    """n × n cells on that quarter."""

    def shape(X):
        r, around, up = X.T
        return np.stack(
            [r * np.cos(up) * np.cos(around), r * np.cos(up) * np.sin(around), r * np.sin(up)], -1
        )

    r = np.linspace(10 - thickness / 2, 10 + thickness / 2, layers + 1)
    around, up = np.linspace(0, np.pi / 2, n + 1), np.linspace(0, np.radians(72), n + 1)
    return box(r, around, up, shape=shape, tets=tets)


def column(*, h=0.02, n=10, end_load=0.0, weight=0.0):
    """A column along x, standing on a clamped end x = 0; load or weight along −x, times e."""
    body, fixed = strip(h, n)
    terms = [Elastic(body, NeoHookean(modulus(h), 0.0))]
    if end_load:
        end = body.surface(near(0, 1.0))
        terms.append(Traction(body, end, lambda e: np.array([-e * end_load / h, 0, 0])))
    if weight:
        terms.append(Gravity(body, 1.0, lambda e: np.array([-e * weight / h, 0, 0])))
    return Scene(body, terms, fixed=[*fixed, *held(body, 0, 0.0, 0, 1, 2)])


def squeezed_column(*, h, shortening, n=16):
    """A column clamped at both ends, one of which comes down by e·shortening; and its nodes."""
    body, fixed = strip(h, n)
    top = body.nodes_where(near(0, 1.0))
    fixed += held(body, 0, 0.0, 0, 1, 2)
    fixed += [Fixed(top, AXES[0], value=lambda e: -e * shortening), Fixed(top, AXES[2])]
    return Scene(body, [Elastic(body, NeoHookean(modulus(h), 0.0))], fixed=fixed), top


def frame(*, n=(6, 2, 6), corner=2.0):
    """Lee's frame: column and beam of length 120 and thickness 2, pinned at both far ends.

    Unit width, E = 2160 and ν = 0 make EI = 1440, EA = 4320. The strips meet in a mitre; sections
    lean towards it within ``corner``. Dead load −e along y on the beam, 24 from the corner.
    """
    L, h = 120.0, 2.0
    column, beam = np.linspace(0, L - corner, n[0] + 1), np.linspace(L + corner, L + 24, n[1] + 1)
    s = np.concatenate([column, [L], beam, np.linspace(L + 24, 2 * L, n[2] + 1)[1:]])

    def shape(X):
        s, t, z = X.T
        lean = t * np.clip(1 - np.abs(s - L) / corner, 0, 1)
        up = s <= L
        return np.stack([np.where(up, -t, s - L - lean), np.where(up, s + lean, L + t), z], -1)

    body = Body.build(box(s, [-h / 2, h / 2], [0, 1.0], shape=shape), "hex27", bent=0)
    rows = hinge(body, body.nodes_where(near(1, 0.0)), (0, 1))
    rows += hinge(body, body.nodes_where(near(0, L)), (0, 1))
    fixed = [*held(body, 2, 0.0, 2), *held(body, 2, 1.0, 2)]
    at = body.nodes_where(lambda X: np.abs(X[:, :2] - (24, L)).max(axis=1) < 1e-9)
    load = LineLoad(body, Line.of(body, at), lambda e: (0, -e, 0))
    return Scene(body, [Elastic(body, NeoHookean(2160.0, 0.0)), load], fixed=fixed, rows=rows), at


def disc(*, h=0.02, n=4, e_to=6.0):
    """A quarter of a disc of radius 1 whose free curvature κ_T is alike in all directions.

    Growth 1 − κ_T z in the plane with κ_T a²/h = e·e_to; ν = 0.3, mirror planes x = 0 and y = 0.
    A square in the middle and two blocks around it keep the mesh regular.
    """
    inner, corner = np.array([0.45, 0.0]), np.array([0.36, 0.36])
    s = np.concatenate([np.linspace(0, 1, n + 1), 1 + np.linspace(0, 1, n + 1)[1:]])

    def shape(X):
        across, up = X[:, :1], X[:, 1:2]
        x, y = np.maximum(across, up), np.minimum(across, up)
        square = across * inner + up * inner[::-1] + across * up * (corner - inner - inner[::-1])
        edge = inner + y * (corner - inner)
        rim = np.hstack([np.cos(np.pi / 4 * y), np.sin(np.pi / 4 * y)])
        block = edge + (x - 1) * (rim - edge)
        block = np.where(up > across, block[:, ::-1], block)
        return np.column_stack([np.where(x <= 1, square, block), X[:, 2]])

    mesh = box(s, s, [-h / 2, h / 2], keep=lambda X: X[:, :2].min(axis=1) < 1, shape=shape)
    body = Body.build(mesh, "hex27")
    z = body.points()[..., 2]

    def tensor(e):
        Fg = np.broadcast_to(np.eye(3), (*z.shape, 3, 3)).copy()
        Fg[..., 0, 0] = Fg[..., 1, 1] = 1 - e * e_to * h * z
        return Fg

    foot = body.nodes_where(lambda X: np.linalg.norm(X, axis=1) < 1e-9)
    fixed = [*held(body, 0, 0.0, 0), *held(body, 1, 0.0, 1), Fixed(foot, AXES[2])]
    return Scene(body, [Elastic(body, NeoHookean(1.0, 0.3), General(tensor))], fixed=fixed)


def centre_curvature(scene, x, e, axis):
    """Of the disc's mid-plane along x or y, from w = κr²/2 + c r⁴ near the centre."""
    X = scene.body.nodes
    on = (np.abs(X[:, [1 - axis, 2]]).max(axis=1) < 1e-9) & (X[:, axis] < 0.3)
    r, w = X[on, axis], scene.displacement(x, e)[on, 2]
    terms = np.stack([r**2 / 2, r**4], -1)
    return np.linalg.lstsq(terms, w - w[np.argmin(r)], rcond=None)[0][0]


def twisted(scene, x, e):
    """Unstable modes of the disc odd about both mirror planes, (x, e) held where they meet it."""
    body, u, fixed = scene.body, scene.displacement(x, e), []
    for axis in (0, 1):
        on = body.nodes_where(near(axis, 0.0))
        along = [k for k in range(3) if k != axis]
        fixed += [Fixed(on, AXES[k], value=u[on, k]) for k in along]
    about = rotation_row(body, 2).coefficients
    odd = Scene(body, scene.terms, fixed=fixed, rows=[Row(about, value=(about * u).sum())])
    return odd.system(odd.unknowns(u), e).unstable


def heavy_strip(*, curvature, weight, hinge=1.0, panel=1.0, h=0.01, n=(8, 16)):
    """Half of references.md §2's heavy strip on rigid frictionless ground, and its ground.

    The hinge, s < 0.1 of 0.5, is grown free of stress to e·curvature; ``hinge`` and ``panel`` are
    stiffnesses per width, ``weight`` is per length. Panels rise where the curvature is positive.
    The barrier is a hundredth of the thickness deep, for the reference's ground is rigid.
    """
    s = np.concatenate(
        [
            graded(0, 0.1, n[0], toward="both", ratio=3),
            graded(0.1, 0.5, n[1], toward="both", ratio=4)[1:],
        ]
    )
    body = Body.build(box(s, [0, h], np.linspace(-h / 2, h / 2, 3)), "hex27", bent=0)
    fixed = [*held(body, 1, 0.0, 1), *held(body, 1, h, 1), *held(body, 0, 0.0, 0)]
    curved = body.cells_where(lambda X: X[:, 0] < 0.1)
    z = body.points()[..., 2] * curved[:, None]

    def tensor(e):
        Fg = np.broadcast_to(np.eye(3), (*z.shape, 3, 3)).copy()
        Fg[..., 0, 0] = 1 - e * curvature * z
        return Fg

    E = np.where(curved, hinge, panel) * modulus(h)
    ground = Ground(
        body, body.surface(near(2, -h / 2)), thickness=h, pressure=weight, height=-h / 2,
        depth=0.01, reach=0.01,
    )  # fmt: skip
    terms = [Elastic(body, NeoHookean(E, 0.0), General(tensor)), Gravity(body, 1.0, weight / h)]
    return Scene(body, [*terms, ground], fixed=fixed), ground


def section(scene, x, e, s):
    """Height of the mid-line and rotation in rad of the section at s, by its lowest and top node.

    The rotation lies in (−π, π].
    """
    X = scene.body.nodes
    at = np.flatnonzero((np.abs(X[:, 0] - s) < 1e-9) & (np.abs(X[:, 1]) < 1e-9))
    at = at[np.argsort(X[at, 2])]
    now = (X + scene.displacement(x, e))[at]
    d = now[-1] - now[0]
    return now[len(at) // 2, 2], np.arctan2(-d[0], d[2])
