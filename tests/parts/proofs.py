"""Bodies, states and the derivative contract that the tests of the terms share."""

import numpy as np
import scipy.sparse as sp
import skfem
from pytest import approx

from solver.mesh.body import Body

ELEMENTS = ["hex27", "hex20", "hex8", "tet10", "tet4"]


def block(element: str, cells=(2, 2, 1), distort=0.12) -> Body:
    """A box 1 × 1.5 × 0.8 whose inner planes are shifted and bent, so cells are no boxes."""
    axes = [np.linspace(0, size, n + 1) for size, n in zip((1, 1.5, 0.8), cells, strict=True)]
    kind = skfem.MeshTet if element.startswith("tet") else skfem.MeshHex
    mesh = kind.init_tensor(*axes)
    rng = np.random.default_rng(3)
    p = mesh.p + distort * rng.uniform(-1, 1, mesh.p.shape) * np.array([[0.5], [0.75], [0.8]])
    outer = np.isclose(mesh.p, 0) | np.isclose(mesh.p, np.array([[1], [1.5], [0.8]]))
    p = np.where(outer, mesh.p, p)
    return Body.build(type(mesh)(p, mesh.t), element)


BODIES = {element: block(element) for element in ELEMENTS}


def state(body: Body, seed=0, size=0.15, noise=0.01) -> np.ndarray:
    """A deformed state with no symmetry: affine part and noise."""
    rng = np.random.default_rng(seed)
    return body.nodes @ rng.uniform(-size, size, (3, 3)) + noise * rng.standard_normal(
        body.nodes.shape
    )


def matrix(term, stiffness) -> sp.csr_array:
    g = term.graph
    return sp.csr_array(sp.bsr_array((stiffness, g.indices, g.indptr), shape=(3 * g.n, 3 * g.n)))


def slope(f, h):
    """Central difference of fourth order at 0."""
    return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)


def prove(term, u, e, *, step=1e-4, rtol=1e-6):
    """Force is dE/du, stiffness d force/du; fails where the term sleeps."""
    before = u.copy()
    at = term.evaluate(u, e, 2)
    size = np.abs(at.force).max()
    assert size > 1e-8, "the term does not act in this state; the proof would be 0 = 0"
    rng = np.random.default_rng(1)
    for _ in range(2):
        d = rng.standard_normal(u.shape)
        if at.energy is not None:
            rate = slope(lambda h, d=d: term.evaluate(u + h * d, e, 0).energy, step)
            assert (at.force * d).sum() == approx(rate, rel=rtol)
        d = rng.standard_normal(u.shape)
        rate = slope(lambda h, d=d: term.evaluate(u + h * d, e, 1).force, step)
        if term.graph is None:
            assert np.abs(rate).max() < rtol * size
            continue
        K = matrix(term, at.stiffness)
        found = (K @ d.ravel()).reshape(-1, 3)
        for c, g in at.dyads:
            found += c * (g * d).sum() * g
        assert np.abs(found).max() > 1e-8, "no stiffness in this state"
        np.testing.assert_allclose(found, rate, rtol=0, atol=rtol * np.abs(rate).max())
        if term.symmetric:
            assert abs(K - K.T).max() < 1e-12 * abs(K).max()
    # Lower orders give the same numbers, nothing was changed, and a second call agrees.
    assert term.evaluate(u, e, 0).energy == at.energy
    np.testing.assert_array_equal(term.evaluate(u, e, 1).force, at.force)
    np.testing.assert_array_equal(u, before)
