"""Predictors: where the next point of a path is looked for, and which of them is taken.

Every polynomial through what is known of the path is a candidate. The residual ranks them
(Eq. 2.74). In a thin body that is not enough: a guess off by a hair compresses it, a stiffness
that buckles in every element is what Newton's method then sees, and it strays however small the
residual is; the tangent's guess stretches the body and is safe, whatever its residual. So a guess
whose stiffness has more unstable modes than the last point has gives way to the next one.
"""

from __future__ import annotations

import numpy as np

from solver.equilibrium.linear import SingularMatrix
from solver.equilibrium.scene import Scene, System
from solver.paths.point import Metric, Point

Node = tuple[float, np.ndarray, np.ndarray | None]


def extrapolate(nodes: list[Node], s: float) -> list[np.ndarray]:
    """Polynomials through values and slopes (s_i, z_i, z_i'), newest first, evaluated at s.

    Confluent Newton form; a slope may be None. Entry k has order k + 1 and uses the newest k + 2 of
    the data: with slopes the tangent, the parabola through the point before, Hermite's cubic, and
    so on; without, the chord, the parabola through three points, and so on.
    """
    data = [node for node in nodes for _ in range(1 if node[2] is None else 2)]
    at = [s_i for s_i, _, _ in data]
    column = [z for _, z, _ in data]
    p, factor, out = column[0], 1.0, []
    for j in range(1, len(at)):
        column = [
            data[i][2] if at[i + j] == at[i] else (column[i + 1] - column[i]) / (at[i + j] - at[i])
            for i in range(len(at) - j)
        ]
        factor *= s - at[j - 1]
        p = p + factor * column[0]
        out.append(p)
    return out


def misfit(scene: Scene, x: np.ndarray, e: float) -> float:
    """‖R‖, inf where not admissible: what guesses are ranked by (Eq. 2.74)."""
    R = scene.residual(x, e)
    return np.inf if R is None else float(np.linalg.norm(R))


def guesses(point: Point, metric: Metric, order: int) -> list[np.ndarray]:
    """Guesses (x, e) at the metric's distance 1 from a point, (size + 1,); the tangent's first.

    The polynomials up to ``order``: with the tangents of the last points, and through these points
    alone. Points are known to more digits than tangents where a body is so thin that its stiffness
    is known to few.
    """
    here, way = point.z, metric.unit(point.tangent)
    nodes, s, last = [(0.0, here, way)], 0.0, here
    for e, x, t in point.history:
        z = np.append(x, e)
        s -= metric.norm(z - last)
        nodes.append((s, z, metric.unit(t)))
        last = z
    out = [here + way]
    with_slopes = nodes[: max(order // 2, 1) + 1]
    for known, orders in (
        (with_slopes, range(1, order)),
        ([(s, z, None) for s, z, _ in nodes], range(order)),
    ):
        for k in orders:
            t = 1.0
            for _ in range(3):
                options = extrapolate(known, t)
                if k >= len(options):
                    break
                t /= max(metric.norm(options[k] - here), 0.5)
            else:
                out.append(here + metric.unit(extrapolate(known, t)[k] - here))
    return out


def choose(
    scene: Scene, options: list[np.ndarray], unstable: int | None
) -> tuple[np.ndarray, System | None, int]:
    """The guess to start from, its system if that was put together, and how many were refused.

    The one of least residual that has no more than ``unstable`` modes, those of the last point; if
    there is none, as beyond a critical point, the one with the fewest. Each guess that is refused
    cost a factorisation. Without a count (None, or a scene that isn't symmetric) the residual alone
    decides.
    """
    ranked = sorted(options, key=lambda z: misfit(scene, z[:-1], z[-1]))
    if unstable is None or not scene.symmetric or len(ranked) == 1:
        return ranked[0], None, 0
    best, fewest, tried = (ranked[0], None), np.inf, 0
    for z in ranked:
        system = scene.system(z[:-1], float(z[-1]))
        if system is None:
            break  # the rest is not admissible either
        try:
            count = system.unstable
        except SingularMatrix:
            count = None
        tried += 1
        if count is None or count <= unstable:
            return z, system, tried - 1
        if count < fewest:
            best, fewest = (z, system), count
    return *best, max(tried - 1, 0)
