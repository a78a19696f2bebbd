"""How an equilibrium R(x, p) = 0 answers to its parameters p, with the tangent K factorised once.

Forward, a triangular solve for each parameter, and backward, one transposed solve for each quantity
j(x) that is asked for, whatever the number of parameters:

    dx/dp = −K⁻¹ ∂R/∂p,        dj/dp = −λᵀ ∂R/∂p with Kᵀ λ = ∂j/∂x

(direct and adjoint method; Haftka and Gürdal, *Elements of Structural Optimization*, ch. 7).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.equilibrium.scene import Scene, System


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Of an equilibrium of a scene; ``system``: its own, as that of a converged
    :class:`solver.equilibrium.newton.NewtonResult`.

    At a critical point there are no derivatives; both methods raise
    :class:`solver.equilibrium.linear.SingularMatrix` where the factorisation meets one.
    """

    scene: Scene
    system: System

    def rate(self, force: np.ndarray) -> np.ndarray:
        """dx/dp (size,) or (size, k) of the unknowns, from how the force on the nodes changes with
        the parameters while nothing moves, (n, 3) or (n, 3, k)."""
        columns = force if force.ndim == 3 else force[..., None]
        pulls = np.stack([self.scene.pulls(f) for f in np.moveaxis(columns, -1, 0)], axis=1)
        answer = -self.system.factorise().solve(pulls)
        return answer if force.ndim == 3 else answer[:, 0]

    def adjoint(self, slope: np.ndarray) -> np.ndarray:
        """−λ as a field on the nodes (n, 3), from ∂j/∂u (n, 3): dj/dp is its product with the
        change of the force that :meth:`rate` takes."""
        pull = self.scene.pulls(slope)
        return self.scene.step_displacement(-self.system.factorise().solve(pull, transposed=True))
