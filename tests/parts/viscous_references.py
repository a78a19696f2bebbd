"""Independent solutions of homogeneous viscoelastic deformation, and trees of parts to test."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

from solver.physics.materials import lame
from solver.viscous.rheology import (
    SLS,
    Dashpot,
    GeneralisedMaxwell,
    KelvinVoigt,
    Maxwell,
    Parallel,
    Series,
    Spring,
)

TREES = {
    "Kelvin-Voigt": KelvinVoigt(2.0, 0.3, 0.7),
    "Maxwell": Maxwell(2.0, 0.3, 0.7),
    "SLS": SLS(1.0, 2.0, 0.3, 0.7),
    "generalised Maxwell": GeneralisedMaxwell(1.0, 0.3, (2.0, 0.5), (0.5, 3.0)),
    "spring before Kelvin-Voigt": Series(KelvinVoigt(1.0, 0.3, 0.5), Spring(2.0, 0.3)),
    "Burgers": Series(Spring(2.0, 0.3), Dashpot(2.0), KelvinVoigt(1.0, 0.3, 0.5)),
    "nested": Parallel(
        Spring(1.0, 0.3), Series(Spring(2.0, 0.3), Parallel(Dashpot(0.4), Maxwell(1.0, 0.3, 0.3)))
    ),
}


def kirchhoff(E, nu, stretch, flow=0.0):
    """Principal Kirchhoff stresses μ(λₑ² − 1) + λ ln Jₑ of a neo-Hookean spring after flow."""
    lam, mu = lame(E, nu)
    log = np.log(stretch) - flow
    return mu * (np.exp(2 * log) - 1) + lam * log.sum()


def sls_path(E, E_m, nu, eta, times, *, stress=None, stretch=None):
    """Axial stretch and axial nominal stress of a standard linear solid, pulled from t = 0 on.

    ``stress``: constant nominal stress, or ``stretch``: constant axial stretch. The logarithmic
    flow ε of the dashpot obeys η dε/dt = τ of the branch; sides are free of stress.
    """

    def solved(flow, guess=(1.0, 1.0)):
        def off(x):
            pull = np.array([stretch if stress is None else x[0], x[1], x[1]])
            tau = kirchhoff(E, nu, pull) + kirchhoff(E_m, nu, pull, flow)
            return [x[0] - stretch if stress is None else tau[0] / x[0] - stress, tau[1]]

        x = root(off, guess, tol=1e-13).x
        return np.array([x[0], x[1], x[1]])

    def rate(_, flow):
        return kirchhoff(E_m, nu, solved(flow), flow) / eta

    done = solve_ivp(rate, (0, times[-1]), np.zeros(3), "DOP853", times, rtol=1e-11, atol=1e-13)
    pulls = np.array([solved(flow) for flow in done.y.T])
    tau = [
        kirchhoff(E, nu, p)[0] + kirchhoff(E_m, nu, p, f)[0]
        for p, f in zip(pulls, done.y.T, strict=True)
    ]
    return pulls[:, 0], np.array(tau) / pulls[:, 0]


def kelvin_voigt_path(E, nu, eta, times, stress):
    """Axial stretch under constant nominal stress: η d ln λ/dt = P λ − τ of the spring."""

    def rate(_, log):
        pull = np.exp(log)
        return (np.array([stress * pull[0], 0, 0]) - kirchhoff(E, nu, pull)) / eta

    done = solve_ivp(rate, (0, times[-1]), np.zeros(3), "DOP853", times, rtol=1e-11, atol=1e-13)
    return np.exp(done.y[0])
