"""A gradient of a morphogen along a bar that grows along itself at the rate α c (Eq. 2.33).

The bar 0 ≤ x ≤ L is free but for planes that hold it against rigid motion, and c is kept at 1 at
x = 0. At rest c = cosh((L − x)/λ)/cosh(L/λ) with λ = √(D/k), exp(−x/λ) of a long bar; after it was
set in at once a Fourier series comes to that. Growth along the bar alone leaves it free of stress,
F = Fg, so that with γ = ln F₁₁ what it becomes follows from

    γ̇ = α c,      d(exp(γ) c)/dt = ∂/∂X (D exp(−γ) ∂c/∂X) − k exp(γ) c,

here at Chebyshev points, if c lives in the deformed bar; with exp(γ) = 1 in the second, if in the
reference one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics.supports import Fixed
from solver.transport.morphogen import Course, Kept, Morphogen
from solver.viscous.evolution import History, TimeSteps, evolve, start
from solver.viscous.feedback import Feedback, Growing
from solver.viscous.rheology import Spring

WIDTH = 0.2


@dataclass(frozen=True)
class Gradient:
    """``length`` L, ``diffusivity`` D (length²/time), ``decay`` k (1/time), ``rate`` α of growth,
    1/(concentration · time)."""

    length: float = 3.0
    diffusivity: float = 0.25
    decay: float = 1.0
    rate: float = 0.5

    @property
    def reach(self) -> float:
        """λ = √(D/k)."""
        return float(np.sqrt(self.diffusivity / self.decay))

    def body(self, cells: int, element: str) -> Body:
        """The bar, a fifth wide and high, ``cells`` along it."""
        grid = np.linspace(0, self.length, cells + 1), [0, WIDTH], [0, WIDTH]
        return Body.build(box(*grid, tets=element.startswith("tet")), element)

    def morphogen(self, body: Body) -> Morphogen:
        """Kept at 1 at x = 0."""
        kept = [Kept(body.nodes[:, 0] < 1e-9, 1.0)]
        return Morphogen(body, self.diffusivity, self.decay, kept=kept)

    def steady(self, x: np.ndarray) -> np.ndarray:
        """c at rest at positions x."""
        return np.cosh((self.length - x) / self.reach) / np.cosh(self.length / self.reach)

    def series(self, x: np.ndarray, t: float, terms: int = 400) -> np.ndarray:
        """c at a time t > 0 after c = 0, by separation of variables."""
        mu = (np.arange(terms) + 0.5) * np.pi / self.length
        weight = 2 / self.length * mu / (mu**2 + 1 / self.reach**2)
        fades = weight * np.exp(-(self.diffusivity * mu**2 + self.decay) * t)
        return self.steady(x) - np.sin(np.multiply.outer(x, mu)) @ fades

    def scene(self, body: Body, course: Course, dt: float) -> Scene:
        """The free bar that grows along x where c is; e is the time."""
        baseline = course.drives(lambda c: self.rate * c)
        law = Feedback(0.0, 0.0, baseline, fibre=(1.0, 0.0, 0.0))
        fixed = [Fixed(body.nodes[:, k] < 1e-9, np.eye(3)[k]) for k in range(3)]
        return Scene(body, [Growing(body, Spring(1.0, 0.3), law, dt=dt)], fixed=fixed)

    def grown(
        self, body: Body, until: float, steps: int, *, sweeps: int = 0, rtol: float = 1e-8
    ) -> tuple[History, Scene, list[float]]:
        """The bar's path from the gradient at rest, its scene, and its length after each sweep.

        Without ``sweeps`` c lives in the reference bar; each of them follows c through the motion
        that the last one found (waveform relaxation), and so leads to c in the deformed bar.
        """
        dt, morphogen, lengths = until / steps, self.morphogen(body), []
        first = morphogen.steady()
        course = morphogen.march(until, dt, c=first)
        for sweep in range(sweeps + 1):
            scene = self.scene(body, course, dt)
            path = evolve(scene, start(scene), TimeSteps(rtol, dt), until=until)
            if not path.reached:
                raise ArithmeticError(f"the bar did not grow to its end: {path.reason}")
            end = scene.displacement(path.last.x, until)[:, 0].max()
            lengths.append(self.length + float(end))
            if sweep < sweeps:
                motion = _motion(scene, path)
                course = morphogen.march(until, dt, c=first, u=motion)
        return path, scene, lengths

    def exact(self, until: float, *, deformed: bool, n: int = 24) -> float:
        """The bar's length at a time, by an integrator of its own."""
        k = np.arange(n + 1)
        s = -np.cos(np.pi * k / n)
        # Trefethen, Spectral Methods in MATLAB, Eq. 6.5.
        w = np.where((k == 0) | (k == n), 2.0, 1.0) * (-1.0) ** k
        D = np.outer(w, 1 / w) / (np.subtract.outer(s, s) + np.eye(n + 1))
        D = (D - np.diag(D.sum(axis=1))) * 2 / self.length
        x = self.length * (s + 1) / 2
        c0 = self.steady(x)

        def speed(_, flat):
            c, gamma = np.split(flat, 2)
            stretch = np.exp(gamma) if deformed else np.ones_like(c)
            flux = self.diffusivity * (D @ c) / stretch
            flux[-1] = 0.0
            rise = (D @ flux) / stretch - self.decay * c
            if deformed:
                rise = rise - self.rate * c * c  # dilution
            rise[0] = 0.0
            return np.concatenate([rise, self.rate * c])

        start_at = np.concatenate([c0, np.zeros_like(c0)])
        end = solve_ivp(speed, (0, until), start_at, method="LSODA", rtol=1e-10, atol=1e-12).y[
            :, -1
        ]
        fit = np.polynomial.chebyshev.Chebyshev.fit(x, np.exp(end[n + 1 :]), n, [0, self.length])
        whole = fit.integ()
        return float(whole(self.length) - whole(0.0))


def _motion(scene: Scene, path: History):
    """u (n, 3) of the time, linear between the states of a path."""
    t = path.times
    u = np.array([scene.displacement(state.x, state.e) for state in path.states])

    def of(time: float) -> np.ndarray:
        k = int(np.clip(np.searchsorted(t, time) - 1, 0, len(t) - 2))
        share = np.clip((time - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0)
        return (1 - share) * u[k] + share * u[k + 1]

    return of
