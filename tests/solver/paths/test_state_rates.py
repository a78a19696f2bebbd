"""How equilibria answer to forces, both ways, with constraint rows and unsymmetric stiffness."""

import numpy as np
import pytest
from proofs import BODIES, slope
from pytest import approx

from solver.equilibrium.newton import newton
from solver.equilibrium.scene import Scene
from solver.paths.sensitivity import Sensitivity
from solver.physics.elastic import Elastic
from solver.physics.growth import AlongFibre
from solver.physics.loads import PointLoad
from solver.physics.materials import NeoHookean
from solver.physics.pressure import Pressure
from solver.physics.supports import Fixed, rotation_row, translation_row

BODY = BODIES["hex8"]
BELOW = np.flatnonzero(BODY.nodes[:, 2] < 1e-9)
RNG = np.random.default_rng(0)
PULLS = 0.02 * RNG.standard_normal((*BODY.nodes.shape, 2))


def scene(kind: str, p) -> Scene:
    """The block under p times two fields of forces."""
    force = PULLS @ np.asarray(p)
    terms = [Elastic(BODY, NeoHookean(1.0, 0.3), AlongFibre(0.2, (1, 1, 0)))]
    fixed = [Fixed(BELOW, axis) for axis in np.eye(3)]
    if kind == "rows":
        rows = [translation_row(BODY, 0), translation_row(BODY, 1), rotation_row(BODY, 2)]
        terms.append(PointLoad(BODY, np.arange(len(BODY.nodes)), force))
        return Scene(BODY, terms, fixed=fixed[2:], rows=rows)
    if kind == "follower":
        terms.append(Pressure(BODY, BODY.surface(lambda X: X[:, 2] > 0.79), 0.1))
    terms.append(PointLoad(BODY, np.arange(len(BODY.nodes)), force))
    return Scene(BODY, terms, fixed=fixed)


def solved(kind, p, x=None):
    at = scene(kind, p)
    result = newton(at, np.zeros(at.size) if x is None else x, 1.0, rtol=1e-12)
    assert result.converged
    return at, result


@pytest.mark.parametrize("kind", ["held", "rows", "follower"])
def test_forward_and_backward_are_the_differences_of_states_solved_anew(kind):
    p = np.array([0.7, -0.4])
    at, result = solved(kind, p)
    assert at.symmetric == (kind != "follower")
    answers = Sensitivity(at, at.system(result.x, 1.0))
    # A dead load enters the residual with its sign turned.
    rates = answers.rate(-PULLS)
    assert answers.rate(-PULLS[..., 1]) == approx(rates[:, 1], abs=1e-12)
    for k, d in enumerate(np.eye(2)):
        wanted = slope(lambda h, d=d: solved(kind, p + h * d, result.x)[1].x, 1e-3)
        assert np.abs(rates[:, k] - wanted).max() < 1e-8 * np.abs(wanted).max()
    weights = RNG.standard_normal(BODY.nodes.shape)
    back = answers.adjoint(weights)
    direct = [(weights * at.step_displacement(dx)).sum() for dx in rates.T]
    assert np.einsum("nik,ni->k", -PULLS, back) == approx(direct, rel=1e-9)


def test_a_tangent_that_was_overwritten_is_factorised_again():
    at, result = solved("held", [0.7, -0.4])
    answers = Sensitivity(at, at.system(result.x, 1.0))
    before = answers.rate(-PULLS)
    at.system(0.5 * result.x, 1.0).factorise()
    assert answers.rate(-PULLS) == approx(before, abs=1e-14)
