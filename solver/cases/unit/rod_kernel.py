"""Energy, Newton's method and stable path of a heavy rod on one-sided ground, compiled.

The right half of a symmetric rod, nodes 0 … n from the middle to the free end. Unknowns x are the
height z₀ of the middle and the turn q_i of each interval; angles and heights follow from them,

    θ_{i+1} = θ_i + q_i,    z_{i+1} = z_i + a_i sin(θ_i + q_i/2),    θ_0 = 0,

so the rod never stretches and all forces are vertical. Its energy is

    Σ k_i (q_i − φ_i)²/2 + Σ_j [w_j z_j + v_j cos θ_j + A_j r κ b((z_j + c (1 − cos θ_j) + d)/r)]

with stiffness k, natural turn φ, weight w and its moment v about the line, and the barrier b of
:mod:`solver.physics.ground` under the underside, which lies c below the line (z = 0 at rest).

The Hessian in (z₀, q) is dense, but heights and angles pass from node to node: one backward
(Riccati) recursion factorises it in O(n). Its pivots are those of L D Lᵀ, so that the number of
negative ones is the number of unstable modes (Sylvester).
"""

from __future__ import annotations

import numba
import numpy as np

# Columns of intervals, of nodes, of the ground, and rows of a shape.
STRETCHED, STIFF, TURN = range(3)
WEIGHT, OFFSET, AREA = range(3)
KAPPA, RANGE, DEPTH, BELOW = range(4)
ANGLE, HEIGHT, COS, SIN, COS_MID, SIN_MID = range(6)


@numba.njit(cache=True)
def _barrier(t):
    """b = −(t − 1)² ln t, of t < 1, and its first two derivatives."""
    ln, d = np.log(t), t - 1
    return -d * d * ln, -2 * d * ln - d * d / t, -2 * ln - 4 * d / t + d * d / t**2


@numba.njit(cache=True)
def energy(x, rods, nodes, ground, shape):
    """Of unknowns (n + 1), whose ``shape`` (6, n + 1) it sets; inf below the ground's floor."""
    n = len(rods)
    total, theta, z = 0.0, 0.0, x[0]
    for j in range(n + 1):
        cos, sin = np.cos(theta), np.sin(theta)
        shape[ANGLE, j], shape[HEIGHT, j], shape[COS, j], shape[SIN, j] = theta, z, cos, sin
        total += nodes[j, WEIGHT] * z + nodes[j, OFFSET] * cos
        if ground[KAPPA] > 0:
            t = (z + ground[BELOW] * (1 - cos) + ground[DEPTH]) / ground[RANGE]
            if not t > 0:
                return np.inf
            if t < 1:
                total += nodes[j, AREA] * ground[KAPPA] * ground[RANGE] * _barrier(t)[0]
        if j == n:
            break
        q = x[j + 1]
        total += 0.5 * rods[j, STIFF] * (q - rods[j, TURN]) ** 2
        cos, sin = np.cos(theta + 0.5 * q), np.sin(theta + 0.5 * q)
        shape[COS_MID, j], shape[SIN_MID, j] = cos, sin
        theta += q
        z += rods[j, STRETCHED] * sin
    return total


@numba.njit(cache=True)
def solve(x, rods, nodes, ground, shape, load, given, step, gains):
    """δ of H δ = f at the unknowns of a ``shape``, into ``step`` (n + 1).

    f is ``load`` (n + 1) where it is ``given``, else minus the energy's gradient, put there.
    Negative pivots count as positive, L |D| Lᵀ δ = f, so that δ descends. ``gains`` (n + 1, 3) is
    scratch. Returns the number of negative pivots, of modes with θ_0 = 0; whether there is one more
    among those with z_0 held and θ_0 free (rocking); and fᵀδ.
    """
    n = len(rods)
    kappa, r, below = ground[KAPPA], ground[RANGE], ground[BELOW]
    yz = yt = vz = vt = 0.0  # ∂/∂(z, θ) of the energy beyond a node, and of the quadratic model
    pzz = pzt = ptt = 0.0  # second derivatives of the latter
    negative = 0
    for i in range(n, -1, -1):
        cos, sin = shape[COS, i], shape[SIN, i]
        yz += nodes[i, WEIGHT]
        yt -= nodes[i, OFFSET] * sin
        ptt -= nodes[i, OFFSET] * cos
        if kappa > 0:
            t = (shape[HEIGHT, i] + below * (1 - cos) + ground[DEPTH]) / r
            if t < 1:
                _, first, second = _barrier(t)
                force, stiff = nodes[i, AREA] * kappa * first, nodes[i, AREA] * kappa / r * second
                lever = below * sin
                yz += force
                yt += force * lever
                pzz += stiff
                pzt += stiff * lever
                ptt += stiff * lever**2 + force * below * cos
        if i == 0:
            break
        C = rods[i - 1, STRETCHED] * shape[COS_MID, i - 1]
        k, curved = rods[i - 1, STIFF], -yz * rods[i - 1, STRETCHED] * shape[SIN_MID, i - 1]
        if not given:
            load[i] = -(k * (x[i] - rods[i - 1, TURN]) + yt + 0.5 * yz * C)
        # δz' = δz + C (δθ + δq/2), δθ' = δθ + δq; ``curved`` is what bends heights.
        uz, ut = 0.5 * C * pzz + pzt, 0.5 * C * pzt + ptt
        pivot = k + 0.25 * curved + 0.5 * C * uz + ut
        qz, qt = uz, 0.5 * curved + C * uz + ut
        if pivot <= 0:
            negative += 1
        pivot = max(abs(pivot), 1e-6 * k) * (-1 if pivot <= 0 else 1)
        qu = 0.5 * C * vz + vt - load[i]
        gains[i, 0], gains[i, 1], gains[i, 2] = qu / abs(pivot), qz / pivot, qt / pivot
        ptt += curved + 2 * C * pzt + C * C * pzz - qt * qt / pivot
        pzt += C * pzz - qz * qt / pivot
        pzz -= qz * qz / pivot
        vt += C * vz - qt * qu / pivot
        vz -= qz * qu / pivot
        yt += C * yz
    rocking = 1 if ptt <= 0 else 0
    if not given:
        load[0] = -yz
    dz = 0.0
    if kappa > 0:
        negative += 1 if pzz <= 0 else 0
        dz = (load[0] - vz) / max(abs(pzz), 1e-9 * nodes[0, AREA] * kappa / r)
    step[0], work, dt = dz, load[0] * dz, 0.0
    for i in range(1, n + 1):
        dq = -gains[i, 0] - gains[i, 1] * dz - gains[i, 2] * dt
        step[i] = dq
        work += load[i] * dq
        dz += rods[i - 1, STRETCHED] * shape[COS_MID, i - 1] * (dt + 0.5 * dq)
        dt += dq
    return negative, rocking, work


@numba.njit(cache=True)
def settle(x, rods, nodes, ground, shape, work, gains, tolerance, most):
    """Newton's method with a line search on the energy, to a minimum near x, in place.

    ``work`` (3, n + 1) is scratch. Ends where no node turns by more than ``tolerance`` (rad) any
    more. Returns iterations (negative: not found), rocking, and the most a node has turned by.
    """
    load, step, trial = work[0], work[1], work[2]
    n = len(rods)
    now = energy(x, rods, nodes, ground, shape)
    begun = shape[ANGLE].copy()
    rocking = 0
    for iteration in range(1, most + 1):
        negative, rocking, work_done = solve(
            x, rods, nodes, ground, shape, load, False, step, gains
        )
        turned = largest = 0.0
        for i in range(1, n + 1):
            turned += step[i]
            largest = max(largest, abs(turned))
        # No step turns a node by more than half a radian.
        fraction = min(1.0, 0.5 / largest) if largest > 0 else 1.0
        height = abs(step[0]) / ground[RANGE]
        done = largest < tolerance and height < tolerance
        new = np.inf
        for _ in range(40):
            for i in range(n + 1):
                trial[i] = x[i] + fraction * step[i]
            new = energy(trial, rods, nodes, ground, shape)
            # Near the end a difference of energies is nothing but rounding.
            close = max(largest, height) < 1e-5 and np.isfinite(new)
            if close or new <= now - 1e-4 * fraction * work_done:
                break
            fraction *= 0.5
        else:
            return -iteration, rocking, 0.0
        x[:], now = trial, new
        if done and fraction == 1.0:
            if negative == 0:
                moved = 0.0
                for j in range(n + 1):
                    moved = max(moved, abs(shape[ANGLE, j] - begun[j]))
                return iteration, rocking, moved
            # A saddle has no slope to go down along; leave it by a small bend.
            for i in range(n):
                x[i + 1] += 1e-4 * rods[i, STRETCHED]
            now = energy(x, rods, nodes, ground, shape)
    return -most, rocking, 0.0


@numba.njit(cache=True)
def set_load(e, lengths, hinge, width, table, end, rods):
    """Stretch, stiffness and natural turn of the hinge's intervals at the load e.

    ``table`` (4, 4): κ, B per width, λ₀ and turn of the hinge's end at e = 0, ⅓, ⅔, 1, and cubic
    between; ``end``: rotation of that end per moment and 1/width.
    """
    t = 3 * e
    parts = np.array([
        (1 - t) * (2 - t) * (3 - t) / 6, t * (2 - t) * (3 - t) / 2,
        -t * (1 - t) * (3 - t) / 2, t * (1 - t) * (2 - t) / 6,
    ])  # fmt: skip
    curvature = bending = stretch = turn = 0.0
    for k in range(4):
        curvature += parts[k] * table[k, 0]
        bending += parts[k] * table[k, 1]
        stretch += parts[k] * table[k, 2]
        turn += parts[k] * table[k, 3]
    for i in range(hinge):
        last = i == hinge - 1
        rods[i, STRETCHED] = lengths[i] * stretch
        rods[i, STIFF] = width / (lengths[i] / bending + (end if last else 0.0))
        rods[i, TURN] = curvature * lengths[i] + (turn if last else 0.0)


# Columns of the history.
LOAD, TIP_ANGLE, HINGE_ANGLE, TIP, LOWEST, ROCKING, SNAP, SOFTNESS = range(8)
SOFTENING = 3
# Endings.
LOST, REACHED, CLOSED, TOO_LONG = range(4)


@numba.njit(cache=True)
def follow(lengths, hinge, width, table, end, rods, nodes, ground, rules, x, history):
    """The stable path from rest at e = 0 to e = 1, or to a full turn; the last state in ``x``.

    ``lengths`` (n): of the intervals, the first ``hinge`` of them the hinge's; ``rods`` (n, 3)
    holds the panels' already. ``rules``: first, longest and shortest step of e, tolerance, and the
    most by which a node may turn from where it was expected (rad): else the step is halved, and at
    the shortest step the rod has jumped, down in energy. ``history`` (states, 8). Returns the
    ending, the number of states and of iterations.
    """
    n = len(rods)
    shape, work, gains = np.zeros((6, n + 1)), np.zeros((3, n + 1)), np.zeros((n + 1, 3))
    first, longest, shortest, tolerance, most_turn = rules
    kept, before, slow = x.copy(), x.copy(), np.ones(n + 1)
    e = target = ratio = 0.0
    count = iterations = 0
    while True:
        set_load(target, lengths, hinge, width, table, end, rods)
        falling = count > 0 and target - e <= 1.0001 * shortest
        for i in range(n + 1):
            x[i] = kept[i] + (0.0 if falling or i == 0 else ratio * (kept[i] - before[i]))
        if not np.isfinite(energy(x, rods, nodes, ground, shape)):
            x[:] = kept
        used, rocking, moved = settle(
            x, rods, nodes, ground, shape, work, gains, tolerance,
            500 if count == 0 or falling else 15,
        )  # fmt: skip
        iterations += abs(used)
        far = moved > most_turn and count > 0
        if used < 0 or far:
            if count == 0 or (falling and used < 0):
                return LOST, count, iterations
            if not falling:
                target = e + max(0.25 * (target - e), shortest)
                ratio = 0.0
                continue
        # The softest symmetric mode against its bending energy, by inverse iterations from a hinge
        # that turns as one.
        softness, slow[:], slow[1 : hinge + 1] = 1.0, 0.0, 1.0
        for _ in range(SOFTENING):
            load, step = work[0], work[1]
            load[0] = 0.0
            for i in range(n):
                load[i + 1] = rods[i, STIFF] * slow[i + 1]
            solve(x, rods, nodes, ground, shape, load, True, step, gains)
            top = bottom = 0.0
            for i in range(n):
                top += load[i + 1] * step[i + 1]
                bottom += rods[i, STIFF] * step[i + 1] ** 2
            softness = top / bottom
            slow[:] = step / np.sqrt(bottom)
        row = history[count]
        row[LOAD], row[TIP_ANGLE], row[HINGE_ANGLE] = target, shape[ANGLE, n], shape[ANGLE, hinge]
        row[TIP], row[LOWEST] = shape[HEIGHT, n], shape[HEIGHT].min()
        row[ROCKING], row[SNAP], row[SOFTNESS] = rocking, moved if far else 0.0, softness
        count += 1
        if abs(shape[ANGLE, n]) >= np.pi:
            return CLOSED, count, iterations
        if target >= 1.0:
            return REACHED, count, iterations
        if count == len(history):
            return TOO_LONG, count, iterations
        taken = target - e
        step_e = first
        if count > 1:
            step_e = min(longest, taken * (2.0 if used <= 5 else 1.0))
        before[:], kept[:], e = kept, x, target
        target = min(1.0, e + step_e)
        if 1.0 - target < 0.3 * step_e:
            target = 1.0
        ratio = (target - e) / taken if count > 1 and not far else 0.0
