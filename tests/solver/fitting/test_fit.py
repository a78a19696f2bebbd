"""Fits: posteriors of linear models in closed form, shapes of the block, what can go wrong."""

from types import SimpleNamespace

import numpy as np
import pytest
from grown_blocks import Slope, clamped
from pytest import approx
from scipy.stats import chi2, norm

from solver.fitting.elastic import Equilibria, States, Unreached
from solver.fitting.fit import Combination, Ending, Prior, fit, misfit
from solver.fitting.skin import Skin
from solver.fitting.targets import Cloud, Landmarks, Measured

RNG = np.random.default_rng(11)


class Line:
    """A forward model u = start + U p without any mechanics."""

    def __init__(self, low, high, fails=lambda p: False):
        k = len(low)
        self.field = SimpleNamespace(
            names=tuple("abcd"[:k]), low=np.array(low, float), high=np.array(high, float),
            slopes=lambda p, X: X[..., :k], values=lambda p, X: X[..., :k] @ p,
        )  # fmt: skip
        self.U = np.random.default_rng(3).standard_normal((7, 3, k))
        self.fails, self.calls = fails, []

    def solve(self, p, at, near=None):
        self.calls.append(np.array(p))
        if self.fails(p):
            return Unreached("it broke", 0.5)
        states = [SimpleNamespace(e=e, u=e * self.U @ p, rates=e * self.U) for e in at]
        return States(np.array(p), tuple(states))


class All:
    """Every coordinate of every node."""

    size = 21

    def __init__(self, given, sigma):
        self.given, self.sigma = given, sigma

    def residual(self, u):
        return (self.given - u.ravel()) / self.sigma

    def slope(self, u, du):
        return -du.reshape(21, -1) / self.sigma


TRUE = np.array([0.3, -0.2])


def seen(line, p=TRUE, sigma=0.05, rng=RNG):
    return All((line.U @ p).ravel() + sigma * rng.standard_normal(21), sigma)


@pytest.mark.parametrize("known", [False, True])
def test_of_a_linear_model_it_is_the_gaussian_posterior(known):
    line = Line([-5, -5], [5, 5])
    data = seen(line)
    prior = Prior(np.array([[2.0, 1.0], [0.0, 3.0]]), np.array([0.1, 0.4])) if known else None
    found = fit(line, [(1.0, data)], prior=prior)
    U = line.U.reshape(21, 2) / 0.05
    precision = U.T @ U
    right = U.T @ (data.given / 0.05)
    assert found.information == approx(precision)
    if known:
        right = right + prior.A.T @ prior.A @ prior.m
        precision = precision + prior.A.T @ prior.A
    exact = np.linalg.inv(precision)
    assert found.fitted and found.ending is Ending.FITTED and not found.at_bound.any()
    assert found.p == approx(exact @ right, rel=1e-7)
    assert found.covariance == approx(exact) and found.sd == approx(np.sqrt(np.diag(exact)))
    wide = norm.ppf(0.95) * found.sd
    assert found.interval(0.9) == approx(np.stack([found.p - wide, found.p + wide], axis=1))
    r = (data.given - (line.U @ found.p).ravel()) / 0.05
    assert found.residuals == approx(r) and found.chi_square == approx(r @ r)
    assert found.freedom == approx(21 - np.trace(exact @ found.information))
    assert known or found.freedom == approx(19)
    assert found.probability == approx(chi2.sf(r @ r, found.freedom)) and found.explained
    # A step of one deviation along an axis of the ellipsoid.
    values, vectors = np.linalg.eigh(exact)
    p = found.p + np.sqrt(values[1]) * vectors[:, 1]
    assert found.distance(p) == approx(chi2.cdf(1.0, 2))
    X = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 0.0]])
    beta, half = found.band(X, 0.9)
    sd = np.sqrt([X[0, :2] @ exact @ X[0, :2], exact[1, 1]])
    assert beta == approx(X[:, :2] @ found.p) and half == approx(norm.ppf(0.95) * sd)
    assert found.band(X, 0.9, everywhere=True)[1] == approx(np.sqrt(chi2.ppf(0.9, 2)) * sd)


def test_intervals_hold_as_often_as_they_say():
    line, rng = Line([-5, -5], [5, 5]), np.random.default_rng(0)
    fits = [fit(line, [(1.0, seen(line, rng=rng))]) for _ in range(200)]
    inside = [(f.interval(0.9)[:, 0] < TRUE) & (f.interval(0.9)[:, 1] > TRUE) for f in fits]
    # 0.9 to three deviations of a share of 400 and 200.
    assert np.mean(inside) == approx(0.9, abs=0.05)
    assert np.mean([f.distance(TRUE) < 0.9 for f in fits]) == approx(0.9, abs=0.064)
    assert np.mean([f.probability < 0.5 for f in fits]) == approx(0.5, abs=0.11)


def test_data_at_more_than_one_load_count_together():
    line = Line([-5, -5], [5, 5])
    one, two = seen(line), seen(line, 8 * TRUE)
    both = fit(line, [(8.0, two), (1.0, one)])
    U = line.U.reshape(21, 2) / 0.05
    assert both.information == approx(65 * U.T @ U)
    assert both.p == approx(TRUE, abs=4 * both.sd.max())
    assert [s.e for s in both.states.at] == [1.0, 8.0]


def test_what_the_data_do_not_fix_is_told():
    line = Line([0, 0, -1], [4, 1, 1])
    line.U[..., 1] = 3 * line.U[..., 0]
    data = All((line.U @ [1.0, 0.5, 0.2]).ravel() + 0.05 * RNG.standard_normal(21), 0.05)
    found = fit(line, [(1.0, data)])
    (lost,) = found.unfixed
    # 3 a of b's changes undo one of a; in ranges 4 and 1: (1/4, −1/3) of length 1.
    weights = np.array([lost.weights[n] for n in "abc"])
    wanted = np.array([0.25 * 3, -1, 0]) / np.hypot(0.75, 1)
    assert np.sign(weights[0]) * weights == approx(wanted, abs=1e-6)
    assert lost.sd == np.inf and not lost.fixed and "not at all" in str(lost)
    assert " a" in str(lost) and " b" in str(lost) and " c" not in str(lost)
    assert found.sd[0] > 10 and found.sd[1] > 10 and found.sd[2] < 0.1
    assert found.fitted and found.explained and found.freedom == approx(19, abs=1e-3)
    # A prior fixes it, and the data still don't.
    known = fit(line, [(1.0, data)], prior=Prior.gaussian([1.0, 0.5, 0.0], [9.0, 0.1, 9.0]))
    assert known.sd[1] == approx(0.1, rel=0.05) and len(known.unfixed) == 1
    assert [c.fixed for c in known.combinations] == [False, True, True]


def test_a_combination_is_fixed_where_it_is_narrower_than_its_range():
    assert Combination({"a": 1.0}, 0.28).fixed and not Combination({"a": 1.0}, 0.29).fixed
    shown = str(Combination({"a": 0.1, "b": -0.6, "c": 0.79}, 0.0123))
    assert shown == "+0.79 c -0.60 b: the data fix it to 0.012 of the ranges"


def test_a_shape_that_no_parameters_make_is_not_explained():
    line = Line([-5, -5], [5, 5])
    data = seen(line)
    data.given = data.given + 0.15 * np.sign(RNG.standard_normal(21))
    found = fit(line, [(1.0, data)])
    assert found.fitted and not found.explained and found.probability < 1e-3
    assert found.chi_square > 5 * found.freedom


def test_bounds_hold_and_are_told():
    line = Line([-1, 0], [1, 1])
    found = fit(line, [(1.0, seen(line, np.array([0.3, -0.8])))])
    assert found.at_bound.tolist() == [False, True] and found.p[1] == approx(0.0, abs=1e-6)


def test_parameters_without_a_state_are_steps_refused():
    # The first step of Gauss–Newton is the exact one, far beyond where states end.
    line = Line([-5, -5], [5, 5], fails=lambda p: np.abs(p - 4.0).min() > 2 and p[0] > -1)
    line.fails = lambda p: p[0] < 0.28
    found = fit(line, [(1.0, seen(line, np.array([0.3, 4.0]), 0.001))], start=[2.0, 4.0])
    assert found.fitted and found.p[0] == approx(0.3, abs=0.01)
    stuck = fit(line, [(1.0, seen(line, np.array([0.2, 4.0]), 0.01))], start=[2.0, 4.0])
    assert stuck.p[0] >= 0.28 and not stuck.explained


def test_no_state_at_the_start_is_a_result():
    line = Line([-5, -5], [5, 5], fails=lambda p: True)
    found = fit(line, [(1.0, seen(line))])
    assert found.ending is Ending.NO_STATE and found.detail == "it broke, at 0.5"
    assert not found.fitted and not found.explained and found.states is None
    assert found.p == approx(np.zeros(2)) and len(line.calls) == 1


def test_evaluations_that_are_used_up_are_told():
    line = Line([-5, -5], [5, 5])

    def bent(p, at, near=None):
        u = np.tile(np.exp(line.U @ p), (1, 1))
        state = SimpleNamespace(e=1.0, u=u, rates=u[..., None] * line.U)
        return States(np.array(p), (state,))

    given = All(np.exp(line.U @ [1.0, -1.0]).ravel(), 0.01)
    line.solve = bent
    short = fit(line, [(1.0, given)], start=[-1, 2], most=3)
    assert short.ending is Ending.NOT_CONVERGED and not short.fitted and not short.explained
    assert fit(line, [(1.0, given)], start=[-1, 2]).p == approx([1.0, -1.0])


@pytest.mark.parametrize("how", ["elsewhere", "nowhere"])
def test_a_state_that_growth_does_not_lead_to_is_told(how):
    line = Line([-5, -5], [5, 5])
    solve = line.solve

    def other(p, at, near=None):
        if near is None and len(line.calls) > 1:
            if how == "nowhere":
                return Unreached("it broke", 0.7)
            state = solve(p, at).at[0]
            return States(p, (SimpleNamespace(e=1.0, u=state.u + 0.1, rates=state.rates),))
        return solve(p, at)

    line.solve = other
    found = fit(line, [(1.0, seen(line))], start=[0, 0])
    assert found.ending is Ending.OTHER_BRANCH and not found.fitted and not found.explained
    assert found.detail == ("it broke, at 0.7" if how == "nowhere" else "they are 0.1 apart")
    assert found.p == approx(TRUE, abs=0.1)


def test_wrong_questions_are_refused():
    line = Line([-5, -5], [5, 5])
    data = [(1.0, seen(line))]
    with pytest.raises(ValueError, match="there are no data"):
        fit(line, [])
    for start in ([0.0], [6.0, 0.0], [np.nan, 0.0]):
        with pytest.raises(ValueError, match="expected 2 parameters from"):
            fit(line, data, start=start)
    with pytest.raises(ValueError, match="prior is of 3 parameters, the field has 2"):
        fit(line, data, prior=Prior.gaussian([0, 0, 0], 1.0))


def test_priors():
    rows = np.array([[1.0, -2.0, 1.0]])
    assert Prior.smooth(rows, 0.5).precision == approx(4 * rows.T @ rows)
    one = Prior.gaussian([1.0, 2.0], [0.5, 0.25])
    assert one.precision == approx(np.diag([4.0, 16.0])) and one.m.tolist() == [1.0, 2.0]


# -- a body ----------------------------------------------------------------------------------------

P = np.array([0.4, 0.25])


@pytest.fixture(scope="module")
def block():
    scene = clamped("hex20")
    facets = scene.body.mesh.boundary_facets()
    low = scene.body.mesh.p[2, scene.body.mesh.facets[:, facets]].max(axis=0)
    return Equilibria(scene, Slope()), Skin(scene.body, facets[low > 1e-9])


def looked(block, p=P, sigma=1e-3, rng=RNG, load=1.0):
    equilibria, skin = block
    (state,) = equilibria.solve(p, [load]).at
    points = skin.scattered(equilibria.scene.body.nodes + state.u, 150, rng)
    return load, Cloud(skin, points + sigma * rng.standard_normal(points.shape), sigma)


def test_a_contraction_is_found_in_a_cloud_of_points(block):
    found = fit(block[0], [looked(block)])
    assert found.fitted and found.explained and not found.unfixed
    assert found.distance(P) < 0.999 and found.p == approx(P, abs=0.01)
    assert 1e-5 < found.sd.max() < 0.01
    assert found.evaluations < 15


def test_the_derivative_of_a_misfit_is_that_by_differences(block):
    data = [looked(block), looked(block, load=0.5), (1.0, _marks(block))]
    p, d = P + np.array([0.05, -0.06]), np.array([0.6, -0.8])

    def at(h):
        return misfit(block[0].solve(p + h * d, [0.5, 1.0]), data)

    half, slope = at(0.0)
    field = block[0].field.slopes(p, block[0].points)
    h = 1e-3
    wanted = (8 * (at(h)[0] - at(-h)[0]) - (at(2 * h)[0] - at(-2 * h)[0])) / (12 * h)
    assert np.einsum("mq,mqk,k", slope, field, d) == approx(wanted, rel=1e-6)
    residuals = [t.residual(s.u) for s, (_, t) in _pairs(block, p, data)]
    assert half == approx(sum(r @ r for r in residuals) / 2)
    with pytest.raises(ValueError, match="Measured has no matrix"):
        misfit(block[0].solve(p, [1.0]), [(1.0, Measured(("a",), lambda u: u[0, 0], [0.0], 1.0))])


def _marks(block):
    nodes = block[0].scene.body.nodes[10:14]
    return Landmarks(block[0].scene.body, nodes, nodes + 0.05, 0.1)


def _pairs(block, p, data):
    states = {s.e: s for s in block[0].solve(p, [0.5, 1.0]).at}
    return [(states[load], (load, target)) for load, target in data]


def test_another_material_is_seen_in_the_misfit(block):
    # Of a body that is free to contract the shape says nothing of the stress: this one is clamped.
    other = Equilibria(clamped("hex27", contraction=0.6), Slope(True))
    p = np.array([0.5, 0.0, -0.2])
    (state,) = other.solve(p, [1.0]).at
    body = other.scene.body
    facets = body.mesh.boundary_facets()
    low = body.mesh.p[2, body.mesh.facets[:, facets]].max(axis=0)
    points = Skin(body, facets[low > 1e-9]).scattered(body.nodes + state.u, 150, RNG)
    found = fit(block[0], [(1.0, Cloud(block[1], points, 1e-3))])
    assert found.fitted and not found.explained and found.chi_square > 3 * found.freedom


def test_one_length_does_not_fix_two_parameters(block):
    (state,) = block[0].solve(P, [1.0]).at
    top = np.argmax(block[0].scene.body.nodes.sum(axis=1))
    height = Measured(("height",), lambda u: u[top, 2], [state.u[top, 2]], 1e-3)
    found = fit(block[0], [(1.0, height)])
    assert found.fitted and len(found.unfixed) == 1 and found.unfixed[0].sd == np.inf
    assert found.chi_square < 1e-6 and found.freedom == approx(0.0, abs=1e-3) and found.explained
    # A length that no contraction gives.
    far = Measured(("height",), lambda u: u[top, 2], [1.0], 1e-3)
    assert not fit(block[0], [(1.0, far)]).explained
