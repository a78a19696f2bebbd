"""Does growth time over relaxation time decide the final shape? What do steps and unknowns cost?

The dissertation's claim about the ratio, on the ventral furrow: once with its tissue, one standard
linear solid everywhere, and once with Maxwell branches in the passive part only. Without loads a
shape does not depend on the modulus, so slow and fast limit of the first are the same state. Then
the order in time, and one step with C_v as global unknowns (the dissertation's way) beside local.
"""

from __future__ import annotations

import sys
import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import scipy.sparse as sp

from foldlab.plots import LINES, STYLE
from solver.cases.tissue import furrow
from solver.cases.tissue.model import Model, Tissue, ramp
from solver.equilibrium.linear import make_solver
from solver.equilibrium.newton import newton
from solver.paths.continuation import trace
from solver.paths.steppers import LoadSteps
from solver.viscous.evolution import TimeSteps, Unresolved, evolve, start, viscous
from solver.viscous.kernel import inverse, nine, six
from solver.viscous.rheology import branches
from solver.viscous.term import Past
from solver.viscous.tree import pair
from solver.viscous.tree import spring as spring_response

from .common import main, save_figure


@dataclass(frozen=True)
class Config:
    """``ratios``: growth time over η/E_m; ``tolerance`` of steps in strain; ``stiff``: E_m of the
    passive part over E_s in the second tissue; ``rest``: relaxation times waited for after the
    contraction; ``divisions``: numbers of steps for the order; ``mesh``: element:level."""

    seed: int = 0
    mesh: str = "hex20:0"
    ratios: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
    tolerance: float = 1e-3
    stiff: float = 4.0
    rest: float = 40.0
    contraction: float = 0.5
    divisions: tuple[int, ...] = (10, 20, 40, 80, 160)
    cost_meshes: tuple[str, ...] = ("hex20:0", "hex27:0")


TINY = Config(
    ratios=(0.1, 10.0),
    tolerance=1e-2,
    contraction=0.1,
    divisions=(2, 4, 8),
    cost_meshes=("hex20:0",),
    mesh="hex8:0",
)


def run(config: Config, tracker) -> dict[str, Any]:
    shapes = pd.DataFrame(shape_study(config))
    orders = pd.DataFrame(order_study(config))
    costs = pd.DataFrame([cost(config, mesh) for mesh in config.cost_meshes])
    for name, table in (("shapes", shapes), ("orders", orders), ("costs", costs)):
        tracker.table(name, table)
    figure = plot(config, shapes, orders)
    save_figure(figure, "viscous_rates")
    tracker.figure("viscous_rates", figure)
    return {
        "table": shapes.to_dict("records"),
        "orders": orders.to_dict("records"),
        "costs": costs.to_dict("records"),
        **verdict(shapes),
        **{f"order_{k}": slope(orders[orders["order"] == k]) for k in (1, 2)},
    }


def built(config: Config, mesh: str, tissue: Tissue | None = None) -> Model:
    element, level = mesh.split(":")
    return furrow.build(int(level), element=element, contraction=config.contraction, tissue=tissue)


def tissues(config: Config) -> dict[str, Tissue]:
    """The dissertation's, and one whose passive part alone has a Maxwell branch, ``stiff`` times
    as stiff; both have one relaxation time everywhere."""
    beta = built(config, config.mesh).beta
    E_m = 5.0 * config.stiff * np.maximum(1 - beta / beta.max(), 1e-3)
    return {
        "the same everywhere": Tissue(),
        "viscous where passive": Tissue(E_m=E_m, eta=0.2 * E_m),
    }


def shape_study(config: Config) -> list[dict]:
    """Depth and indentation at the end of the contraction and after a long rest, and those
    of the elastic limits."""
    rows = []
    for name, tissue in tissues(config).items():
        model = built(config, config.mesh, tissue)
        tau = tissue.tau
        for limit, material in (("slow", tissue.slow()), ("fast", tissue.fast())):
            scene = model.elastic(material)
            path = trace(
                scene, np.zeros(scene.size), LoadSteps(1e-8, 0.1), max_steps=200, events=False
            )
            rows.append(measured(model, scene, path.last.x, name, limit, np.nan, path))
        for ratio in config.ratios:
            t_fin = ratio * tau
            scene = model.viscous(t_fin / 50)
            # A hundredth of the time scale that is shorter, to begin with.
            stepper = TimeSteps(1e-8, 0.01 * min(tau, t_fin), tolerance=config.tolerance)
            options = {"load": ramp(t_fin), "breaks": (t_fin,)}
            path = evolve(scene, start(scene), stepper, until=t_fin, **options)
            rows.append(measured(model, scene, path.last.x, name, "grown", ratio, path))
            path = evolve(scene, path.last, stepper, until=t_fin + config.rest * tau, **options)
            rows.append(measured(model, scene, path.last.x, name, "rested", ratio, path))
    return rows


def measured(model, scene, x, tissue: str, when: str, ratio: float, path) -> dict:
    measures = model.measure(scene.displacement(x, 1.0))
    row = {
        "tissue": tissue,
        "when": when,
        "ratio": None if np.isnan(ratio) else ratio,
        "depth": measures.depth,
        "indentation": measures.indentation,
        "cavity": measures.cavity,
        "steps": len(path.points if hasattr(path, "points") else path.states) - 1,
        "outcome": path.outcome.value,
    }
    print(row, file=sys.stderr)
    return row


def verdict(shapes: pd.DataFrame) -> dict[str, Any]:
    """How far apart shapes of different ratios are, over the slow limit's indentation."""
    out = {}
    for tissue, part in shapes.groupby("tissue", sort=False):
        key = tissue.replace(" ", "_")
        slow, fast = (part[part["when"] == w].iloc[0] for w in ("slow", "fast"))
        scale = abs(slow["indentation"])
        grown, rested = (part[part["when"] == w] for w in ("grown", "rested"))
        out[f"limits_differ_{key}"] = abs(slow["indentation"] - fast["indentation"]) / scale
        out[f"grown_spread_{key}"] = float(np.ptp(grown["indentation"])) / scale
        out[f"rested_spread_{key}"] = float(np.ptp(rested["indentation"])) / scale
        first, last = grown.iloc[0], grown.iloc[-1]
        out[f"fast_limit_error_{key}"] = abs(first["indentation"] - fast["indentation"]) / scale
        out[f"slow_limit_error_{key}"] = abs(last["indentation"] - slow["indentation"]) / scale
        decides = out[f"grown_spread_{key}"] > 0.05
        out[f"verdict_{key}"] = (
            f"{tissue}: the ratio {'decides' if decides else 'does not decide'} the shape at the "
            f"end of the contraction (indentations differ by {out[f'grown_spread_{key}']:.1%}, the "
            f"elastic limits by {out[f'limits_differ_{key}']:.1%}); after a rest they differ by "
            f"{out[f'rested_spread_{key}']:.1%}"
        )
    return out


def order_study(config: Config) -> list[dict]:
    """Error of the displacement at the end of the contraction over the number of steps, t_fin =
    2 τ, against four times the finest number."""
    tissue = tissues(config)["viscous where passive"]
    model = built(config, config.mesh, tissue)
    t_fin = 2 * tissue.tau

    def end(n, order):
        scene = model.viscous(t_fin / n)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Unresolved)
            # Smooth in time, so that order is seen: no jump of the rate at the start.
            path = evolve(scene, start(scene), TimeSteps(1e-11, t_fin / n, order=order),
                          until=t_fin, load=lambda t: (t / t_fin) ** 3)  # fmt: skip
        return scene.displacement(path.last.x, 1.0)

    exact = end(4 * config.divisions[-1], 2)
    size = np.abs(exact).max()
    return [
        {"order": order, "n": n, "error": float(np.abs(end(n, order) - exact).max() / size)}
        for order in (1, 2)
        for n in config.divisions
    ]


def slope(part: pd.DataFrame) -> float:
    """Measured order of the last halvings."""
    tail = part.tail(2)
    return float(-np.diff(np.log(tail["error"]))[0] / np.diff(np.log(tail["n"]))[0])


def cost(config: Config, mesh: str) -> dict[str, Any]:
    """One step of backward Euler from a contracted state, with local and with global unknowns."""
    model = built(config, mesh)
    dt, half = 0.05, 0.2
    scene = model.viscous(dt)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Unresolved)
        path = evolve(scene, start(scene), TimeSteps(1e-9, dt, order=1), until=half)
    before = path.last
    term = viscous(scene)[0].stepped(Past(before.level.memories[0], dt))
    now, e = scene.with_terms([term]), half + dt
    newton(now, before.x, e, rtol=1e-9)  # compiled, analysed
    clock = time.perf_counter()
    local = newton(now, before.x, e, rtol=1e-9)
    seconds = time.perf_counter() - clock
    system = now.system(local.x, e)
    clock = time.perf_counter()
    system.factorise().solve(system.residual)
    factor = time.perf_counter() - clock
    whole = GlobalStep(now, model, before, dt, e)
    y, iterations, spent, solving = whole.solve(before.x)
    u = now.displacement(local.x, e)
    return {
        "mesh": mesh,
        "local_unknowns": now.size,
        "global_unknowns": whole.size,
        "local_seconds": seconds,
        "global_seconds": spent,
        "local_iterations": local.iterations,
        "global_iterations": iterations,
        "local_solve_seconds": factor,
        "global_solve_seconds": solving,
        "difference": float(np.abs(now.displacement(y, e) - u).max() / np.abs(u).max()),
    }


class GlobalStep:
    """The same step with Y = C_v⁻¹ at every quadrature point among the unknowns of one system."""

    def __init__(self, scene, model: Model, before, dt: float, e: float):
        self.scene, self.e = scene, e
        body, tissue = model.body, model.tissue
        self.body = body
        inverse_g, J = model.growth().evaluate(e, body.weights.shape, body.points)
        inverse_g = np.broadcast_to(inverse_g, (*body.weights.shape, 3, 3))
        self.start = inverse_g.reshape(-1, 3, 3)
        self.gradients = np.einsum("mqkj,mqjl->mqkl", body.gradients, inverse_g)
        self.weights = (body.weights * J).ravel()
        n = self.weights.size
        (spring,), _, (((branch,), (dashpot,)),) = branches(tissue.rheology())
        table = [s.material.properties(0.0, (1, 1))[0, 0] for s in (spring, branch)]
        self.moduli = [np.broadcast_to(row, (n, 2)).T for row in table]
        self.k = dashpot.eta / (8 * dt)
        self.C1 = before.level.memories[0].strains[:, :, 0].reshape(-1, 6)
        self.Y = inverse(self.C1)
        self.size = scene.size + 6 * n

    def solve(self, x: np.ndarray, rtol: float = 1e-9):
        """Newton; the displacement's unknowns, iterations, seconds, and those of one solve."""
        scene, Y, solver, solving = self.scene, self.Y.copy(), None, []
        clock = time.perf_counter()
        k = 0
        while k < 30:
            k += 1
            R, matrix = self.assembled(x, Y)
            upper = sp.triu(matrix, format="csr")
            upper.sort_indices()
            solver = solver or make_solver(upper.indptr, upper.indices, symmetric=True)
            now = time.perf_counter()
            step = -solver.factorise(upper.data).solve(R)
            solving.append(time.perf_counter() - now)
            dx, dY = step[: scene.size], step[scene.size :].reshape(-1, 6)
            ratio = np.abs(np.linalg.eigvals(nine(inverse(Y)) @ nine(dY))).max()
            fraction = min(1.0, 0.6 / ratio)
            x, Y = x + fraction * dx, Y + fraction * dY
            if np.abs(dx).max() <= rtol * scene.scales.length and fraction == 1:
                break
        return x, k, time.perf_counter() - clock, min(solving)

    def assembled(self, x, Y):
        """Residual and matrix of (u, Y)."""
        body, scene = self.body, self.scene
        u = scene.displacement(x, self.e)
        F = self.start + np.einsum("mki,mqkj->mqij", u[body.cells], self.gradients).reshape(
            -1, 3, 3
        )
        C = np.swapaxes(F, 1, 2) @ F
        _, g, H = spring_response(C, *self.moduli[0])
        lam, mu = self.moduli[1]
        c, y = inverse(six(C)), inverse(Y)
        x_log = (np.log(np.linalg.det(C)) + np.log(np.linalg.det(nine(Y)))) / 2
        s = (lam * x_log - mu) / 2
        R3 = nine(y) @ nine(inverse(self.C1)) @ nine(y)
        g = g + mu[:, None] / 2 * Y + s[:, None] * c
        gY = mu[:, None] / 2 * six(C) + s[:, None] * y + self.k * (self.C1 - six(R3))
        dyad = lam[:, None, None] / 4

        def outer(a, b):
            return dyad * a[:, :, None] * b[:, None, :]

        H = H + outer(c, c) - s[:, None, None] * pair(nine(c), nine(c))
        HY = outer(y, y) - s[:, None, None] * pair(nine(y), nine(y))
        HY = HY + 2 * self.k * pair(nine(y), R3)
        HCY = outer(c, y) + mu[:, None, None] / 2 * np.eye(6)
        n, w = len(F), self.weights
        P = 2 * F @ nine(g)
        D = nine(np.moveaxis(nine(H), 1, -1))
        A = 4 * np.einsum("niI,nkK,nIJKL->niJkL", F, F, D, optimize=True)
        A += 2 * np.einsum("ik,nJL->niJkL", np.eye(3), nine(g))
        dP = 2 * np.einsum("niI,nIJb->niJb", F, nine(np.moveaxis(HCY, 1, -1)).transpose(0, 2, 3, 1))
        m, q, k = self.gradients.shape[:3]
        B = np.zeros((m, q, 3, 3, k, 3))
        for i in range(3):
            B[:, :, i, :, :, i] = np.swapaxes(self.gradients, 2, 3)
        B = B.reshape(n, 9, 3 * k)
        Bt = np.swapaxes(B, 1, 2) * w[:, None, None]
        force = (Bt @ P.reshape(n, 9, 1)).reshape(m, q, -1).sum(1)
        Kuu = (Bt @ A.reshape(n, 9, 9) @ B).reshape(m, q, 3 * k, 3 * k).sum(1)
        KuY = Bt @ dP.reshape(n, 9, 6)
        KYY = w[:, None, None] * HY
        cells = np.repeat(np.arange(m), q)
        # Which component of which node each unknown is: here they are the nodes' own.
        which = scene.unknowns(np.arange(body.unknowns, dtype=float).reshape(-1, 3)).astype(int)
        number = np.full(body.unknowns, -1)
        number[which] = np.arange(scene.n_free)
        dofs = number[(3 * body.cells[:, :, None] + np.arange(3)).reshape(m, -1)]
        inner = scene.size + np.arange(6 * n).reshape(n, 6)
        R = np.zeros(self.size)
        np.add.at(R, dofs[dofs >= 0], force[dofs >= 0])
        R[scene.size :] = (w[:, None] * gY).ravel()
        rows, cols, values = [], [], []
        for a, b, K in ((dofs, dofs, Kuu), (dofs[cells], inner, KuY), (inner, inner, KYY)):
            i, j = np.broadcast_arrays(a[:, :, None], b[:, None, :])
            keep = (i >= 0) & (j >= 0)
            rows.append(i[keep])
            cols.append(j[keep])
            values.append(K[keep])
        shape = (self.size, self.size)
        data = np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))
        return R, sp.coo_array(data, shape=shape).tocsr()


def plot(config: Config, shapes: pd.DataFrame, orders: pd.DataFrame):
    """Indentation over the ratio for both tissues, with their limits; error over the step."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.9), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
        for colour, (tissue, part) in zip(
            LINES, shapes.groupby("tissue", sort=False), strict=False
        ):
            later = f"{config.rest:g} relaxation times later"
            for when, marker, text in (
                ("grown", "o-", "end of contraction"),
                ("rested", "s:", later),
            ):
                rows = part[part["when"] == when]
                left.semilogx(rows["ratio"].astype(float), rows["indentation"], marker,
                              color=colour, ms=3, lw=1, label=f"{tissue}, {text}")  # fmt: skip
            for when, style in (("slow", "-"), ("fast", "--")):
                level = part[part["when"] == when]["indentation"].iloc[0]
                left.axhline(level, color=colour, lw=0.6, ls=style, alpha=0.5)
        low, high = left.get_ylim()
        left.set_ylim(low, high + 0.75 * (high - low))
        left.legend(
            fontsize=7,
            loc="upper left",
            title="thin: elastic limits, slow —, fast - -",
            title_fontsize=7,
        )
        left.set_xlabel(r"growth time over relaxation time $t_\mathrm{fin} E_m/\eta$")
        left.set_ylabel("indentation (half lengths)")
        for order, colour in ((1, LINES[3]), (2, LINES[2])):
            rows = orders[orders["order"] == order]
            right.loglog(rows["n"], rows["error"], "o-", color=colour, ms=3, lw=1,
                         label=f"order {order}: slope {slope(rows):.2f}")  # fmt: skip
        right.set_xticks(config.divisions, [str(n) for n in config.divisions])
        right.minorticks_off()
        right.set_xlabel(r"steps over $t_\mathrm{fin} = 2\tau$")
        right.set_ylabel("largest error of displacement (fraction)")
        right.legend(fontsize=7)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
