"""The lung (chapter 3): a shell of epithelium pushed through a cage of muscle by pressure.

Lengths in units of the epithelium's outer radius R, stresses in units of its Young's modulus E_ep.
Inflation raises the pressure to 0.11; the puncture takes a tenth of it away while the muscle
contracts by 40 % along its fibres (§3.4.3). A stage goes from one (pressure, contraction) to
another with e from 0 to 1, and any number of stages may follow each other:

    lung = Lung()
    body = hexahedra(lung, 2)
    inflated = run(scene(body, lung, Tissue(), REST, INFLATED))
    stage = scene(body, lung, Tissue(), INFLATED, PUNCTURED)
    punctured = run(stage, inflated.last.x, steps=20, over="settle")

Fibres run along the great circle of the nearest bundle. Where three bundles meet, the planes that
halve the angles divide the joint among them, as a carpenter's mitre does: each part keeps the
direction of the bundle that it prolongs, so the joint has the symmetry of its three bundles, every
point shortens along one direction by the same amount, and the jumps of the direction lie on faces
between elements. ``fibres="blended"`` takes the mean of f ⊗ f over the bundles instead, weighted by
how near they are: continuous, and isotropic in the sphere at the middle of a joint.

The primitive model (§3.5.4) has small strains, a linear material and the dead traction −p N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.cases.lung.geometry import PARTS, Lung, unit
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.paths.continuation import Path, trace
from solver.paths.stable import StableSteps
from solver.paths.steppers import ArcLength, LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.growth import AlongFibre, General, Growth, Isotropic
from solver.physics.loads import Traction
from solver.physics.materials import NeoHookean, SmallStrain
from solver.physics.pressure import Pressure
from solver.physics.supports import Fixed, Row, rotation_row, translation_row

FIBRES = ("along", "isotropic", "blended")
MODELS = ("advanced", "primitive")
ROUND = 1e-9  # of R: a node on a mirror plane


@dataclass(frozen=True)
class Tissue:
    """E_sm/E_ep, Poisson's ratio of both, how the muscle contracts, and the physics.

    ``fibres``: "along" I + g f ⊗ f, "isotropic" (1 + g) I, or "blended"; ``model``: "advanced"
    (neo-Hookean, follower pressure) or "primitive". Raises ValueError for other names and for a
    stiffness that is not positive.
    """

    stiffness: float = 75.0
    nu: float = 0.3
    fibres: str = "along"
    model: str = "advanced"

    def __post_init__(self):
        if self.fibres not in FIBRES or self.model not in MODELS:
            raise ValueError(
                f"fibres {self.fibres!r}, model {self.model!r}; expected one of "
                f"{', '.join(FIBRES)} and one of {', '.join(MODELS)}"
            )
        if not (self.stiffness > 0 and np.isfinite(self.stiffness)):
            raise ValueError(f"stiffness = {self.stiffness}; expected E_sm/E_ep > 0")


@dataclass(frozen=True)
class State:
    """Pressure over E_ep, the muscle's contraction g, −1 < g (negative shortens), and how far the
    epithelium proliferates: its lengths, unhindered, grow by this fraction, (1 + q) I, −1 < q."""

    pressure: float
    contraction: float = 0.0
    proliferation: float = 0.0

    def __post_init__(self):
        if not (self.proliferation > -1 and np.isfinite(self.proliferation)):
            raise ValueError(
                f"proliferation {self.proliferation}; expected a finite number above -1 (0.1 makes "
                "what is free a tenth longer)"
            )
        if not np.isfinite(self.pressure) or not self.contraction > -1:
            raise ValueError(
                f"pressure {self.pressure}, contraction {self.contraction}; expected a finite "
                "pressure and a contraction above -1 (-0.4 shortens by 40 %)"
            )


REST, INFLATED, PUNCTURED = State(0.0), State(0.11), State(0.099, -0.4)


def part_of(body: Body) -> str:
    """Which part of the lung a body is: "wedge", "octant" or "sphere"."""
    for name in ("wedge", "octant"):
        if (body.nodes @ PARTS[name].T > -1e-6).all():
            return name
    return "sphere"


def mirrors(body: Body, part: str) -> list[Fixed]:
    """Supports on the part's mirror planes, all of which pass through the centre."""
    return [Fixed(np.flatnonzero(np.abs(body.nodes @ n) < ROUND), n) for n in PARTS[part]]


def rigid_rows(body: Body) -> list[Row]:
    """No mean translation, no mean rotation (Eqs. 2.13, 2.17)."""
    return [make(body, axis) for make in (translation_row, rotation_row) for axis in range(3)]


def fibre_directions(lung: Lung, X: np.ndarray) -> np.ndarray:
    """Unit vectors along the nearest bundle at positions X (..., 3), of the same shape."""
    flat = X.reshape(-1, 3)
    normals = lung.tiling.normals[lung.tiling.nearest_edge(flat)]
    return unit(np.cross(normals, flat)).reshape(X.shape)


def blended_fibres(lung: Lung, X: np.ndarray) -> np.ndarray:
    """Mean of f ⊗ f, of trace 1, over the bundles near positions X (..., 3): (..., 3, 3).

    The weight of a bundle is (1 − d²/w²)² of the angle d to its arc within the width w, so that one
    bundle alone remains a width away from a joint.
    """
    t, d = lung.tiling, unit(X.reshape(-1, 3))
    out = np.zeros((len(d), 3, 3))
    nearest, angles = t.nearest_edge(d), t.angles(d)
    weight = np.clip(1 - (angles / lung.bundle) ** 2, 0, None) ** 2
    # Outside of all bundles the nearest one counts, however far.
    every = np.arange(len(d))
    weight[every, nearest] = np.maximum(weight[every, nearest], 1e-12)
    at, edge = np.nonzero(weight)
    f = unit(np.cross(t.normals[edge], d[at]))
    np.add.at(out, at, weight[at, edge, None, None] * f[:, :, None] * f[:, None, :])
    return (out / weight.sum(axis=1)[:, None, None]).reshape(*X.shape, 3)


def scene(
    body: Body,
    lung: Lung,
    tissue: Tissue,
    start: State = REST,
    end: State = INFLATED,
    *,
    linear: str = "auto",
) -> Scene:
    """The stage from ``start`` (e = 0) to ``end`` (e = 1), straight in pressure and contraction.

    A wedge or octant is held by its mirror planes, the whole sphere by rows against rigid motion. A
    body without muscle has no growth; a stage without contraction has none either. Raises
    ValueError for a contraction without muscle.
    """
    return staged(body, lung, tissue, (start, end), linear=linear)


def muscle_of(body: Body) -> np.ndarray:
    """Which cells are muscle, (m,)."""
    if "muscle" in (body.mesh.subdomains or {}):
        return body.cells_of("muscle")
    return np.zeros(len(body.cells), bool)


def staged(
    body: Body,
    lung: Lung,
    tissue: Tissue,
    states: Sequence[State],
    *,
    linear: str = "auto",
    ball: Body | None = None,
) -> Scene:
    """As :func:`scene`, through several states in turn: e = k in state k, straight in between.

    ``ball``: of a body that is no sphere the same mesh on one, from which fibres go along. Raises
    ValueError for fewer than two states, and for blended fibres without a sphere, too.
    """
    if len(states) < 2:
        raise ValueError(f"{len(states)} states; expected two at least: where to start and end")
    part = part_of(body)
    fixed = mirrors(body, part)
    muscle = muscle_of(body)

    def pressure(e: float) -> float:
        return between([state.pressure for state in states], e)

    growth = None
    contractions = [state.contraction for state in states]
    if any(contractions):
        if not muscle.any():
            raise ValueError("a contraction but no muscle; give the lung a cage or contract by 0")
        growth = _growth(body, lung, tissue, contractions, muscle, ball)
    proliferation = [state.proliferation for state in states]
    if any(proliferation):
        growth = _proliferating(body.weights.shape, growth, proliferation, muscle)
    E = np.where(muscle, tissue.stiffness, 1.0)
    wall = body.surface("inner")
    if tissue.model == "advanced":
        terms = [
            Elastic(body, NeoHookean(E, tissue.nu), growth),
            Pressure(body, wall, pressure, potential="volume", fixed=fixed),
        ]
    else:
        out = -wall.normals
        terms = [
            Elastic(body, SmallStrain(E, tissue.nu), growth),
            Traction(body, wall, lambda e: pressure(e) * out),
        ]
    rows = rigid_rows(body) if part == "sphere" else ()
    return Scene(body, terms, fixed=fixed, rows=rows, linear=linear)


def between(values: Sequence[float], e: float) -> float:
    """What goes straight from value to value, the next one at each whole e, and on beyond both."""
    k = min(max(int(np.floor(e)), 0), len(values) - 2)
    return values[k] + (e - k) * (values[k + 1] - values[k])


def _proliferating(shape, growth: Growth | None, values: Sequence[float], muscle) -> Growth:
    """(1 + q) I in the epithelium beside the muscle's growth; ``shape`` (m, q) of the points."""

    def tensor(e: float) -> np.ndarray:
        F = np.broadcast_to((1 + between(values, e)) * np.eye(3), (*shape, 3, 3)).copy()
        own = np.eye(3) if growth is None else growth.tensor(e, shape)
        F[muscle] = np.broadcast_to(own, F.shape)[muscle]
        return F

    return General(tensor)


def _growth(
    body, lung, tissue, contractions: Sequence[float], muscle: np.ndarray, ball: Body | None
) -> Growth:
    def g(e: float) -> float:
        return between(contractions, e)

    if tissue.fibres == "isotropic":
        return Isotropic(g, cells=muscle)
    if tissue.fibres == "along":
        along = fibre_directions(lung, (ball or body).points())
        if ball is not None:
            carry = np.einsum("mki,mqkj->mqij", body.nodes[body.cells], ball.gradients)
            along = unit(np.einsum("mqij,mqj->mqi", carry, along))
        return AlongFibre(g, along, cells=muscle)
    if ball is not None:
        raise ValueError('blended fibres are known on the sphere only; take "along"')
    dyads = blended_fibres(lung, body.points())
    return General(lambda e: np.eye(3) + g(e) * dyads, cells=muscle)


def run(
    stage: Scene,
    x: np.ndarray | None = None,
    *,
    steps: int = 10,
    rtol: float = 1e-7,
    events: bool = True,
    over: str | None = "arc",
) -> Path:
    """The stage from the unknowns ``x`` (None: undeformed) to e = 1.

    Load steps as far as they go. Where one fails the path passes a limit, or nearly so, and
    ``over`` says how it goes on: "arc" over limit points by arc length, until it meets e = 1 or is
    back at its start; "settle" down the energy to the next stable state, as a real lung would;
    None ends there. The outcome says whether e = 1 was reached, the events where the path turned.

    Raises ValueError for another ``over``.
    """
    if over not in ("arc", "settle", None):
        raise ValueError(f"over = {over!r}; expected 'arc', 'settle' or None")
    x = np.zeros(stage.size) if x is None else x
    loads = LoadSteps(rtol=rtol, step=1 / steps, smallest=0.05)
    path = trace(stage, x, loads, max_steps=40 * steps, events=events)
    if path.reached or over is None or not path.points:
        return path
    last = path.last
    if over == "settle":
        stepper, bounds = StableSteps(loads, cuts=1, locate=False), (-np.inf, np.inf)
    else:
        stepper = ArcLength(rtol=rtol, a=max(last.metric.a, 1e-4), b=0.3 / steps)
        bounds = (0.0, np.inf)
    more = trace(
        stage, last, stepper, max_steps=6 * steps, events=events and over == "arc", bounds=bounds
    )
    points, events = (*path.points, *more.points[1:]), (*path.events, *more.events)
    return Path(points, more.outcome, events, more.warnings, more.detail)


def to_limit(stage: Scene, path: Path, *, step: float, rtol: float = 1e-7) -> Path:
    """From the end of a path of load steps by arc length to the limit point ahead, where the load
    is largest, and ends there (REACHED). ``step``: the arc's first step in e."""
    arc = ArcLength(rtol=rtol, a=max(path.last.metric.a, 1e-4), b=step)
    return trace(stage, path.last, arc, until=lambda p: p.tangent[-1], max_steps=100, events=False)


def inner_stretch(body: Body, lung: Lung, u: np.ndarray) -> float:
    """Mean current radius of the lumen's wall over its reference radius."""
    wall = body.nodes_of("inner")
    return float(np.linalg.norm(body.nodes[wall] + u[wall], axis=1).mean() / (1 - lung.epithelium))
